//! `etherpen bench`: the project's figures together with those of its peers, measured in one run.

use super::print_json;
use crate::bench::drawing::DrawingPlan;
use crate::bench::table::table;
use crate::bench::{self, Selection, console, drawing, ethercat, motion, recording};
use crate::error::{ProgramError, code};
use crate::setup;
use std::io::Write;
use std::path::PathBuf;

/// Stops of each kind under each load of the console.
const CONSOLE_STOPS: usize = 20;

/// Options of `etherpen bench`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    bench: Bench,
}

#[derive(clap::Subcommand, Debug)]
enum Bench {
    /// A stop through the console under hostile load, by socket and by request: longest delay down to the port, and the
    /// console's memory.
    Console(Options),
    /// The vectoriser on the sample photographs (time, strokes, tone, edges); the order of the sample vectors compared
    /// with vpype's (linemerge linesort --two-opt); the length of two photographs as one line beside LKH's (a minute or more each);
    /// ten photographs in every style beside the drawings of hatched and
    /// plotline in the same drawing time, judged by dlib (whose face it is) and mediapipe (where its points are). vpype, the
    /// other programs, the judges and most photographs come from PyPI and are set up in separate folders below the target
    /// folder (about one and a half gigabytes).
    Drawing(DrawingOptions),
    /// The EtherCAT master compared with ethercrab: instructions of a cycle, memory, code, frames of a bring-up.
    Ethercat(Options),
    /// The firmware in the emulator: late cycles, lost frames, release jitter, delays, execution times, load.
    Latency(super::latency::Arguments),
    /// The planner compared with copp (TOPP2-RA) and Klipper's and grbl's formulas: durations at the same limits,
    /// largest values of the 1 ms setpoints, planning times, instructions of a period. A row meets its target or misses
    /// it.
    Motion(MotionOptions),
    /// A long recording through writer and reader: samples lost, bytes of a sample, growth of memory.
    Recording(RecordingOptions),
}

/// Options of the benchmark of drawings.
#[derive(clap::Args, Debug)]
struct DrawingOptions {
    /// No portraits and no tours of LKH, which take about a quarter of an hour.
    #[arg(long)]
    quick: bool,
    /// The PNG to write with the portraits side by side: a row for each photograph, with the photograph, the five styles
    /// and the other programs, each above its drawing time.
    #[arg(long, value_name = "OUT.png", conflicts_with = "quick")]
    contact_sheet: Option<PathBuf>,
    #[command(flatten)]
    options: Options,
}

/// Options of the recorder's benchmark.
#[derive(clap::Args, Debug)]
struct RecordingOptions {
    /// Hours of samples, at most a thousand; an hour takes some seconds.
    #[arg(long, default_value_t = 1.0, value_parser = hours)]
    hours: f64,
    #[command(flatten)]
    options: Options,
}

fn hours(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(hours) if hours > 0.0 && hours <= 1_000.0 => Ok(hours),
        _ => Err("give more than 0 and at most 1000 hours".into()),
    }
}

/// Options of the planner's benchmark.
#[derive(clap::Args, Debug)]
struct MotionOptions {
    /// The samples' paths under the joints' limits alone, and nothing in the emulator.
    #[arg(long)]
    quick: bool,
    #[command(flatten)]
    options: Options,
}

/// Options of every benchmark.
#[derive(clap::Args, Debug)]
struct Options {
    /// Print the figures as JSON on stdout.
    #[arg(long)]
    json: bool,
    /// Only cases with this in their names.
    #[arg(long, value_name = "TEXT")]
    case: Option<String>,
    /// Only this subject.
    #[arg(long, value_name = "NAME")]
    subject: Option<String>,
    /// A figure that misses its target is an error (exit code 1).
    #[arg(long)]
    check: bool,
}

impl Options {
    fn selection(&self) -> Selection {
        Selection {
            case: self.case.clone(),
            subject: self.subject.clone(),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// A tool is missing, or a measurement failed. A missed target is an error with `--check` only.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let progress = |what: &str| eprintln!("etherpen: {what}");
    if !matches!(arguments.bench, Bench::Recording(_) | Bench::Console(_)) {
        setup::ensure_sources()?;
    }
    let (options, report) = match &arguments.bench {
        Bench::Console(options) => {
            let program = std::env::current_exe().map_err(|cause| ProgramError::failed("this program", cause))?;
            let report = console::run(&options.selection(), &program, CONSOLE_STOPS, progress);
            (options, report)
        }
        Bench::Drawing(DrawingOptions {
            quick,
            contact_sheet,
            options,
        }) => {
            let plan = DrawingPlan {
                quick: *quick,
                contact_sheet: contact_sheet.clone(),
            };
            (options, drawing::run(&options.selection(), &plan, progress))
        }
        Bench::Ethercat(options) => (options, ethercat::run(&options.selection(), progress)),
        Bench::Latency(arguments) => return super::latency::run(arguments),
        Bench::Recording(RecordingOptions { hours, options }) => (options, recording::run(*hours)),
        Bench::Motion(MotionOptions { quick, options }) => {
            (options, motion::run(&options.selection(), *quick, progress))
        }
    };
    let report = report?;
    if report.rows.is_empty() {
        return Err(ProgramError::new(
            code::USAGE,
            "no case has that name; without --case all are shown",
        ));
    }
    if options.json {
        print_json(&report)?;
    } else {
        let shown = std::io::stdout().write_all(table(&report).as_bytes());
        shown.or_else(ProgramError::of_stdout)?;
    }
    match options.check {
        true => verdict(&bench::missed(&report.rows)),
        false => Ok(()),
    }
}

/// An error that names the figures that missed their targets, if there are any.
fn verdict(missed: &[String]) -> Result<(), ProgramError> {
    match missed {
        [] => Ok(()),
        missed => Err(ProgramError::new(
            code::FAILED,
            format!("missed: {}", missed.join("; ")),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missed_target_is_a_failure_that_names_it() {
        assert!(verdict(&[]).is_ok());
        let missed = ["a: 5 frames, at most 4", "b: 0.5 share, at least 0.75"].map(str::to_owned);
        let error = verdict(&missed).unwrap_err();
        assert_eq!(error.code, code::FAILED);
        assert!(missed.iter().all(|figure| error.message.contains(figure)), "{error:?}");
    }
}
