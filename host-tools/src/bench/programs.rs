//! The programs of the crate `benchmarks`: builds them, runs them in QEMU or under valgrind, and measures their size.
//!
//! They are built in a separate folder below the target folder, with their own lock file.

use super::BenchError;
use crate::setup::{self, QEMU, TARGET};
use object::{Object, ObjectSection, SectionKind};
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};

/// Largest number of cycles that a program under valgrind may report.
const CYCLES_MAX: u64 = 1 << 20;

/// The program with copp, and the feature that it needs.
pub(super) const OPTIMUM: &str = "optimum";

/// Platform of a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Machine {
    /// This computer.
    Host,
    /// The emulated Cortex-M7.
    CortexM7,
}

fn failed(program: &str, cause: impl std::fmt::Display) -> BenchError {
    BenchError::Program {
        program: program.to_owned(),
        cause: cause.to_string(),
    }
}

fn build_dir() -> PathBuf {
    setup::target_dir().join("benchmarks")
}

fn path(machine: Machine, program: &str) -> PathBuf {
    let folder = match machine {
        Machine::Host => build_dir(),
        Machine::CortexM7 => build_dir().join(TARGET),
    };
    folder.join("release").join(program)
}

/// Builds programs of one machine.
pub(super) fn build(machine: Machine, programs: &[&str]) -> Result<(), BenchError> {
    let manifest = setup::workspace().join("benchmarks/Cargo.toml");
    let mut command = setup::cargo();
    command.args(["build", "--release", "--locked", "--manifest-path"]);
    // Incremental builds inline less: the figures would depend on the caller's environment.
    command.env("CARGO_INCREMENTAL", "0");
    command.arg(&manifest).arg("--target-dir").arg(build_dir());
    if machine == Machine::CortexM7 {
        setup::ensure_target()?;
        command.args(["--target", TARGET, "--no-default-features", "--features", "cortex-m7"]);
    }
    for program in programs {
        command.args(["--bin", program]);
        if *program == OPTIMUM {
            command.args(["--features", OPTIMUM]);
        }
    }
    match command.stdout(Stdio::null()).status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(failed(
            "cargo",
            format_args!("the benchmarks could not be built ({status})"),
        )),
        Err(cause) => Err(failed("cargo", cause)),
    }
}

/// Runs a program in the emulator to its end; returns its output.
pub(super) fn emulate(program: &str) -> Result<String, BenchError> {
    setup::ensure_qemu()?;
    let mut command = Command::new(QEMU);
    command.args([
        "-M",
        "mps2-an500",
        "-display",
        "none",
        "-monitor",
        "none",
        "-serial",
        "none",
    ]);
    // An instruction takes 1,024 ns of virtual time, which the program's timer resolves.
    command.args([
        "-icount",
        "shift=10",
        "-semihosting-config",
        "enable=on,target=native",
        "-kernel",
    ]);
    command.arg(path(Machine::CortexM7, program));
    output(program, &mut command)
}

/// Counts the instructions of one cycle with callgrind.
pub(super) fn callgrind(subject: &str, case: &str) -> Result<u64, BenchError> {
    setup::ensure_program("valgrind")?;
    let file = build_dir().join(format!("callgrind-{}.out", std::process::id()));
    let mut command = Command::new("valgrind");
    command.args(["--quiet", "--tool=callgrind", "--toggle-collect=*counted_part*"]);
    command.arg(format!("--callgrind-out-file={}", file.display()));
    command.arg(path(Machine::Host, "callgrind")).args([subject, case]);
    let printed = output("valgrind", &mut command);
    let profile = std::fs::read_to_string(&file);
    // A file that cannot be removed only takes space.
    let _ = std::fs::remove_file(&file);
    let cycles: u64 = printed?
        .trim()
        .parse()
        .map_err(|cause| failed("callgrind", format_args!("number of cycles: {cause}")))?;
    let profile = profile.map_err(|cause| failed("valgrind", cause))?;
    let instructions = profile
        .lines()
        .find_map(|line| line.strip_prefix("summary:")?.trim().parse::<u64>().ok())
        .ok_or_else(|| failed("valgrind", "its output has no summary"))?;
    if instructions == 0 || !(1..=CYCLES_MAX).contains(&cycles) {
        return Err(failed(
            "callgrind",
            format_args!("{instructions} instructions in {cycles} cycles"),
        ));
    }
    Ok((instructions + cycles / 2) / cycles)
}

/// Bytes of code and constants in a program of the emulated board.
pub(super) fn code_bytes(program: &str) -> Result<u64, BenchError> {
    let bytes = std::fs::read(path(Machine::CortexM7, program)).map_err(|cause| failed(program, cause))?;
    let image = object::File::parse(bytes.as_slice()).map_err(|cause| failed(program, cause))?;
    let loaded = image.sections().filter(|section| {
        matches!(
            section.kind(),
            SectionKind::Text | SectionKind::ReadOnlyData | SectionKind::Data
        )
    });
    Ok(loaded.map(|section| section.size()).sum())
}

/// Starts a program on this computer with pipes for standard input and output.
pub(super) fn start(program: &str) -> Result<Child, BenchError> {
    Command::new(path(Machine::Host, program))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .map_err(|cause| failed(program, cause))
}

/// Runs a program on this computer to its end with `input` as its standard input; returns its output.
pub(super) fn answer(program: &str, input: &str) -> Result<String, BenchError> {
    let mut command = Command::new(path(Machine::Host, program));
    command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut child = command.spawn().map_err(|cause| failed(program, cause))?;
    if let Some(mut pipe) = child.stdin.take() {
        // The program reads all input before it prints, and reports missing input itself.
        let _ = pipe.write_all(input.as_bytes());
    }
    finished(program, child.wait_with_output())
}

fn output(program: &str, command: &mut Command) -> Result<String, BenchError> {
    finished(program, command.stdin(Stdio::null()).output())
}

fn finished(program: &str, output: io::Result<Output>) -> Result<String, BenchError> {
    let output = output.map_err(|cause| failed(program, cause))?;
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).trim().to_owned();
    if output.status.success() {
        return Ok(text(&output.stdout));
    }
    let said = format!("{}\n{}\n{}", output.status, text(&output.stdout), text(&output.stderr));
    Err(failed(program, said.trim()))
}
