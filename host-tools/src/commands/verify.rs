//! `etherpen verify`: all checks of continuous integration in one command.

use super::{latency, nightly};
use crate::bench;
use crate::bench::latency::{Disturbance, Isolation, LatencyPlan};
use crate::error::{ProgramError, code};
use crate::setup::{self, TARGET};
use crate::terminal::in_colour;
use std::io::Write;
use std::process::{Command, ExitStatus};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Options of `etherpen verify`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Do what takes longer than that instead, a day in all: campaigns, mutants, fuzzing, models, Miri, certificates,
    /// the master's figures, advisories. Needs the nightly toolchain with Miri, cargo-fuzz and cargo-deny
    #[arg(long)]
    nightly: bool,
    /// With --nightly: only the steps whose names begin with this word
    #[arg(long, requires = "nightly", value_name = "STEP")]
    only: Option<String>,
}

/// One step: its name, and cargo's arguments.
type Step = (&'static str, &'static [&'static str]);

/// Steps on the host.
const HOST: [Step; 4] = [
    ("format", &["fmt", "--all", "--check"]),
    (
        "lints on the host",
        &["clippy", "--workspace", "--all-targets", "--", "-D", "warnings"],
    ),
    ("documentation", &["doc", "--workspace", "--no-deps", "--quiet"]),
    ("build of the tests", &["test", "--workspace", "--no-run"]),
];
/// Tests that run at the same time, because each alone leaves a processor idle for minutes. Every name of a test program is in
/// one of both.
const PROGRAMS: Step = (
    "tests of programs, on the host and in the emulator",
    &[
        "test",
        "--workspace",
        "--test",
        "[!c]*",
        "--test",
        "c[!o]*",
        "--test",
        "con*",
    ],
);
/// The output of these is shown when they have ended.
const LIBRARIES: [Step; 5] = [
    ("tests of libraries", &["test", "--workspace", "--lib", "--bins"]),
    (
        "tests of a master for long process data",
        &[
            "test",
            "-p",
            "etherpen-ethercat",
            "-p",
            "etherpen-segment",
            "--features",
            "etherpen-ethercat/long-process-data",
            "--lib",
            "--test",
            "master",
        ],
    ),
    ("examples of the documentation", &["test", "--workspace", "--doc"]),
    ("models of what tasks share", &nightly::MODELS),
    (
        "tests of the command line",
        &["test", "--workspace", "--test", "co[!n]*"],
    ),
];
/// Steps for the boards, run in parallel. They use separate folders below target/, and the tests wait for the parts
/// they need.
const BOARDS: [Step; 2] = [
    (
        "lints of board nucleo",
        &[
            "clippy",
            "--release",
            "-p",
            "etherpen",
            "--target",
            TARGET,
            "--features",
            "nucleo",
            "--bin",
            "nucleo",
            "--",
            "-D",
            "warnings",
        ],
    ),
    (
        "lints of board emulated",
        &[
            "clippy",
            "--release",
            "-p",
            "etherpen",
            "--target",
            TARGET,
            "--features",
            "emulated",
            "--bin",
            "emulated",
            "--",
            "-D",
            "warnings",
        ],
    ),
];

/// Runs the command.
///
/// # Errors
/// The first step that failed; it has reported why.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    if arguments.nightly {
        return nightly::run(arguments.only.as_deref());
    }
    let start = Instant::now();
    announce("set-up");
    setup::ensure_sources()?;
    setup::ensure_target()?;
    setup::ensure_component("rustfmt")?;
    setup::ensure_component("clippy")?;
    setup::ensure_qemu()?;
    for program in ["tshark", "ip", "chromium"] {
        setup::ensure_program(program)?;
    }
    setup::ensure_unicorn()?;
    setup::ensure_pysoem()?;
    // In parallel, because neither keeps all processors busy; after an error in one, the other completes its step.
    let has_failed = AtomicBool::new(false);
    let noted = |result: Result<(), ProgramError>| {
        has_failed.fetch_or(result.is_err(), Ordering::Relaxed);
        result
    };
    std::thread::scope(|scope| {
        let boards = scope.spawn(|| noted(boards(&has_failed)));
        let host = noted(steps(&HOST, &has_failed).and_then(|()| tests(&has_failed)));
        let boards = boards.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        host.and(boards)
    })?;
    eprintln!(
        "{} in {:.0} s",
        in_colour("verified", "1;32"),
        start.elapsed().as_secs_f64()
    );
    Ok(())
}

/// Feature of the firmware of `tests/panic.rs`.
const ENDS: &str = "end-while-drawing";
/// Cycles of the latency run.
const LATENCY_CYCLES: u64 = 50_000;
/// Figures that every verification checks against their bounds.
const IN_TIME: [&str; 3] = ["cycles_late", "frames_lost", "release_jitter"];

/// Measures whether the firmware is in time with foreign frames around every release; the tests apply all loads for
/// fewer cycles.
fn in_time() -> Result<(), ProgramError> {
    let mut report = latency::measure(&LatencyPlan {
        seed: 0,
        cycles: LATENCY_CYCLES,
        disturbance: Disturbance {
            network: true,
            ..Disturbance::default()
        },
        at_rest: false,
        isolation: Isolation::Basepri,
        rate_khz: 1,
        instruction_shift: 3,
    })?;
    report
        .rows
        .retain(|row| IN_TIME.iter().any(|case| row.case.starts_with(case)));
    let missed = bench::missed(&report.rows);
    if missed.is_empty() {
        return Ok(());
    }
    Err(ProgramError::new(
        code::FAILED,
        format!("latency: {}", missed.join("; ")),
    ))
}

fn steps(all: &[Step], has_failed: &AtomicBool) -> Result<(), ProgramError> {
    let mut left = all.iter().take_while(|_| !has_failed.load(Ordering::Relaxed));
    left.try_for_each(|one| step(*one))
}

/// Runs the tests, which are built.
fn tests(has_failed: &AtomicBool) -> Result<(), ProgramError> {
    if has_failed.load(Ordering::Relaxed) {
        return Ok(());
    }
    std::thread::scope(|scope| {
        let libraries = scope.spawn(|| LIBRARIES.iter().try_for_each(|one| quiet_step(*one)));
        let programs = step(PROGRAMS);
        let libraries = libraries
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        programs.and(libraries)
    })
}

/// Builds the firmware of the boards, and runs lints and the latency measurement.
fn boards(has_failed: &AtomicBool) -> Result<(), ProgramError> {
    for board in ["nucleo", "emulated"] {
        announce(&format!("firmware of board {board}"));
        let image = setup::build_firmware(board)?;
        eprintln!("{}", image.display());
    }
    steps(&BOARDS, has_failed)?;
    announce("firmware that panics or hangs, for its tests");
    setup::build_variant("emulated", &[ENDS])?;
    announce("latency with foreign frames");
    in_time()
}

fn announce(name: &str) {
    eprintln!("{} {name}", in_colour("==", "1;34"));
}

fn step((name, arguments): Step) -> Result<(), ProgramError> {
    announce(name);
    ended(name, cargo(arguments).status())
}

/// A step whose output is shown when it has ended, so that it does not mingle with that of another.
fn quiet_step((name, arguments): Step) -> Result<(), ProgramError> {
    let output = cargo(arguments).output();
    announce(name);
    if let Ok(output) = &output {
        let mut stderr = std::io::stderr().lock();
        let shown = stderr.write_all(&output.stdout);
        shown
            .and_then(|()| stderr.write_all(&output.stderr))
            .map_err(|cause| ProgramError::failed("the output of the tests", cause))?;
    }
    ended(name, output.map(|output| output.status))
}

fn cargo(arguments: &[&str]) -> Command {
    let mut command = setup::cargo();
    command.args(arguments);
    if arguments.first() == Some(&"doc") {
        command.env("RUSTDOCFLAGS", "-D warnings");
    }
    command
}

fn ended(name: &str, status: std::io::Result<ExitStatus>) -> Result<(), ProgramError> {
    match status {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(ProgramError::new(code::FAILED, format!("{name} failed ({status})"))),
        Err(cause) => Err(ProgramError::failed("cargo cannot be started", cause)),
    }
}
