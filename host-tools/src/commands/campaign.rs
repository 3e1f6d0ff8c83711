//! `etherpen campaign`: seeded episodes of the whole cell in virtual time, judged by an independent monitor.

use crate::campaign::episode::Episode;
use crate::campaign::generate::{Profile, episode};
use crate::campaign::machine::{DEFAULT_MACHINE, Machine};
use crate::campaign::{self, Failed, Failure, Plan, Progress, Run};
use crate::error::{ProgramError, code};
use crate::output_file::{make_folder, write_text};
use crate::setup;
use crate::terminal::{counted, in_colour};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Options of `etherpen campaign`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Seeds of the episodes, without the last number.
    #[arg(long, value_name = "A..B", value_parser = seeds, default_value = "0..200")]
    seeds: (u64, u64),
    /// Which faults there are.
    #[arg(long, value_enum, default_value = "all")]
    profile: Profile,
    /// Machine: one of the bundled ones, or a configuration file.
    #[arg(long, value_name = super::MACHINE_NAMES, default_value = DEFAULT_MACHINE)]
    machine: String,
    /// Hours of robot time after which no further episode begins; further seeds follow behind the last one until then.
    #[arg(long, value_name = "H", value_parser = hours)]
    hours: Option<f64>,
    /// Episodes run at the same time. Default: one for each processor.
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Run the episodes of these test-case files instead of seeds.
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = ["seeds", "hours", "profile", "machine"])]
    replay: Vec<PathBuf>,
    /// Make each failing episode smaller and write it into this folder as a test case.
    #[arg(long, value_name = "DIR", conflicts_with = "emulated")]
    cases: Option<PathBuf>,
    /// Run the emulated board's image in QEMU instead of the firmware's tasks in this program; about twice real time for each
    /// job.
    #[arg(long)]
    emulated: bool,
    /// Print the result as JSON on stdout.
    #[arg(long)]
    json: bool,
}

fn seeds(text: &str) -> Result<(u64, u64), String> {
    let range = text.split_once("..").ok_or("give two numbers: 0..200")?;
    let number = |text: &str| text.parse::<u64>().map_err(|_| format!("'{text}' is not a number"));
    match (number(range.0)?, number(range.1)?) {
        (first, end) if first < end => Ok((first, end)),
        _ => Err("the second number has to be larger than the first one".to_owned()),
    }
}

fn hours(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(hours) if (0.0..=1.0e6).contains(&hours) => Ok(hours),
        _ => Err("give a number of hours".to_owned()),
    }
}

/// Result on stdout.
#[derive(Serialize)]
struct Report {
    /// `null` for test-case files, each of which names its own.
    machine: Option<String>,
    episodes: u64,
    virtual_hours: f64,
    /// Virtual time for each second of this run, all jobs together.
    times_real_time: f64,
    /// How often the operator reset the board, because the fault said that nothing else helps.
    board_resets: u64,
    failures: Vec<ReportedFailure>,
}

#[derive(Serialize)]
struct ReportedFailure {
    /// `null` for a test-case file.
    seed: Option<u64>,
    what: String,
    replay: String,
}

/// Runs the command.
///
/// # Errors
/// An episode failed, a file cannot be read or written, or the program was interrupted.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    // A panic of an episode is one of its results.
    std::panic::set_hook(Box::new(|_| {}));
    let begun = Instant::now();
    let Outcome {
        episodes,
        virtual_ms,
        resets,
        failures,
    } = match arguments.replay.is_empty() {
        true => of_seeds(arguments)?,
        false => of_files(arguments)?,
    };
    let virtual_hours = virtual_ms as f64 / 3.6e6;
    let times_real_time = virtual_ms as f64 / 1e3 / begun.elapsed().as_secs_f64().max(1e-9);
    eprintln!(
        "{}, {virtual_hours:.2} hours of robot time ({times_real_time:.0} times real time){}: {}",
        counted(episodes, "episode"),
        match resets {
            0 => String::new(),
            _ => format!(", {} of the board", counted(resets, "reset")),
        },
        if failures.is_empty() {
            "no failure".to_owned()
        } else {
            counted(failures.len() as u64, "failure")
        }
    );
    let count = failures.len() as u64;
    if arguments.json {
        super::print_json(&Report {
            machine: arguments.replay.is_empty().then(|| arguments.machine.clone()),
            episodes,
            virtual_hours,
            times_real_time,
            board_resets: resets,
            failures,
        })?;
    }
    match count {
        0 => Ok(()),
        _ => Err(ProgramError::new(
            code::FAILED,
            format!("{} failed", counted(count, "episode")),
        )),
    }
}

/// What the episodes have shown.
#[derive(Default)]
struct Outcome {
    episodes: u64,
    virtual_ms: u64,
    resets: u64,
    failures: Vec<ReportedFailure>,
}

/// What runs an episode.
type Runner = Box<dyn Fn(&Episode) -> Run + Sync>;

/// The firmware's tasks in this program, or the emulated board's image, which is built.
fn runner(arguments: &Arguments) -> Result<Runner, ProgramError> {
    if !arguments.emulated {
        return Ok(Box::new(campaign::run));
    }
    if arguments.replay.is_empty() && arguments.profile == Profile::Files {
        let text = "the profile files is about the program and its log, not about the board: leave --emulated out";
        return Err(ProgramError::new(code::USAGE, text));
    }
    setup::ensure_qemu()?;
    let image = setup::build_firmware("emulated")?;
    Ok(Box::new(move |episode| campaign::run_image(&image, episode)))
}

fn of_seeds(arguments: &Arguments) -> Result<Outcome, ProgramError> {
    let run = runner(arguments)?;
    let (first, end) = arguments.seeds;
    let limit_ms = arguments.hours.map(|hours| (hours * 3.6e6) as u64);
    let machine = Machine::load(&arguments.machine).map_err(|cause| ProgramError::new(code::USAGE, cause))?;
    let plan = Plan {
        machine,
        first,
        end: if limit_ms.is_some() { u64::MAX } else { end },
        profile: arguments.profile,
        limit_ms,
        jobs: arguments.jobs.unwrap_or_else(processors),
    };
    let bar = bar(&plan);
    let ended = super::ended_by_a_signal()?;
    let summary = campaign::campaign(&plan, &run, &ended, &|failed, progress| {
        show(&bar, arguments, failed, progress);
    });
    bar.finish_and_clear();
    let mut failures = Vec::new();
    for Failed { seed, failure } in &summary.failed {
        let case = match &arguments.cases {
            Some(folder) => Some(write_case(folder, &plan, *seed)?),
            None => None,
        };
        failures.push(ReportedFailure {
            seed: Some(*seed),
            what: failure.to_string(),
            replay: case.map_or_else(|| replay_seed(*seed, arguments), |case| replay_file(&case)),
        });
    }
    Ok(Outcome {
        episodes: summary.episodes,
        virtual_ms: summary.virtual_ms,
        resets: summary.resets,
        failures,
    })
}

fn of_files(arguments: &Arguments) -> Result<Outcome, ProgramError> {
    let (run, files) = (runner(arguments)?, &arguments.replay);
    let mut outcome = Outcome::default();
    for file in files {
        let run = run(&Episode::read(file)?);
        outcome.episodes += 1;
        outcome.virtual_ms += u64::from(run.passed_ms);
        outcome.resets += u64::from(run.resets);
        if let Some(failure) = run.failure {
            eprintln!("{} {}: {failure}", in_colour("failed", "1;31"), file.display());
            outcome.failures.push(ReportedFailure {
                seed: None,
                what: failure.to_string(),
                replay: replay_file(file) + emulated(arguments),
            });
        }
    }
    Ok(outcome)
}

fn processors() -> usize {
    std::thread::available_parallelism().map_or(1, Into::into)
}

fn bar(plan: &Plan) -> ProgressBar {
    let length = plan.limit_ms.unwrap_or(plan.end - plan.first);
    let bar = ProgressBar::new(length);
    let style = ProgressStyle::with_template("{wide_bar} {percent} %  {msg}  {eta} left");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}

fn show(bar: &ProgressBar, arguments: &Arguments, failed: Option<&Failed>, progress: Progress) {
    bar.set_position(if arguments.hours.is_some() {
        progress.virtual_ms
    } else {
        progress.episodes
    });
    bar.set_message(format!(
        "{}, {:.2} h",
        counted(progress.episodes, "episode"),
        progress.virtual_ms as f64 / 3.6e6
    ));
    if let Some(Failed { seed, failure }) = failed {
        let line = format!(
            "{} seed {seed}: {failure}; {}",
            in_colour("failed", "1;31"),
            replay_seed(*seed, arguments)
        );
        bar.suspend(|| eprintln!("{line}"));
    }
}

fn replay_seed(seed: u64, arguments: &Arguments) -> String {
    use clap::ValueEnum;
    let profile = arguments
        .profile
        .to_possible_value()
        .map_or_else(String::new, |value| value.get_name().to_owned());
    let (machine, emulated) = (named_machine(arguments), emulated(arguments));
    format!(
        "etherpen campaign --seeds {seed}..{} --profile {profile}{machine}{emulated}",
        seed + 1
    )
}

/// The option for another machine than the default one, for a command line.
fn named_machine(arguments: &Arguments) -> String {
    match arguments.machine.as_str() {
        DEFAULT_MACHINE => String::new(),
        name => format!(" --machine {name}"),
    }
}

/// The option for the image, if it was given, for a command line.
fn emulated(arguments: &Arguments) -> &'static str {
    if arguments.emulated { " --emulated" } else { "" }
}

fn replay_file(file: &Path) -> String {
    format!("etherpen campaign --replay {}", file.display())
}

/// Makes a failing episode smaller and writes it; returns its file.
fn write_case(folder: &Path, plan: &Plan, seed: u64) -> Result<PathBuf, ProgramError> {
    make_folder(folder)?;
    let whole = episode(&plan.machine, seed, plan.profile);
    let tries = ProgressBar::new_spinner();
    let shrunk = campaign::shrink(&whole, &mut |count| {
        tries.set_message(format!("seed {seed}: {count} smaller episodes tried"))
    });
    tries.finish_and_clear();
    let (small, failure): (Episode, Failure) = shrunk.ok_or_else(|| {
        ProgramError::new(
            code::FAILED,
            format!("seed {seed} fails only now and then: the run is not deterministic"),
        )
    })?;
    let file = folder.join(format!("seed-{seed}.toml"));
    write_text(&file, &small.to_text())?;
    eprintln!("seed {seed}: {}, {failure}", file.display());
    Ok(file)
}
