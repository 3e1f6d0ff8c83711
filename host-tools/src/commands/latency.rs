//! `etherpen bench latency`: the latency of the critical tasks, with and without disturbance.

use super::print_json;
use crate::bench::BenchReport;
use crate::bench::latency::{self, Disturbance, Isolation, LatencyPlan, LatencyReport, plot};
use crate::bench::table::table;
use crate::error::ProgramError;
use crate::output_file::write_text;
use std::io::Write;
use std::path::PathBuf;

/// Options of `etherpen bench latency`.
#[derive(clap::Args, Debug)]
pub(super) struct Arguments {
    /// Cycles of each run; the paper's number is 10000000 (about an hour a run).
    #[arg(long, value_name = "N", default_value_t = 100_000)]
    cycles: u64,
    /// Loads of the firmware: none, all, or several of serial, planner, log, network, separated by commas. The firmware
    /// is also measured without load.
    #[arg(long, value_name = "LIST", default_value = "all")]
    disturbance: Disturbance,
    /// With primask, the loaded run is repeated with ordinary critical sections, which mask the critical tasks too.
    #[arg(long, value_enum, default_value_t = Isolation::Basepri)]
    isolation: Isolation,
    /// Repeat the loaded run at 2, 4, 8 kHz up to this rate, until a deadline is missed. The planner's load is left
    /// out: its path is timed for 1 kHz.
    #[arg(long, value_name = "KHZ", default_value_t = 1, value_parser = rate)]
    rate: u32,
    /// One instruction takes 2^N ns of virtual time. At 3, the timer counts every 5 instructions; 6 resolves less than
    /// one, but is too slow for the planner.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..=7))]
    shift: u8,
    /// Seed of the planner's path and of the moments at which the loads meet the cycle.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Keep this seed's runs in a folder, and report all runs in it as one. A seed that the folder has is not measured
    /// again. Runs of other options, another version or another firmware image are refused: use another folder, or
    /// remove the file.
    #[arg(long, value_name = "DIR")]
    merge: Option<PathBuf>,
    /// Print the figures and the curves as JSON on stdout.
    #[arg(long)]
    json: bool,
    /// Draw the curves into this file.
    #[arg(long, value_name = "OUT.svg")]
    plot: Option<PathBuf>,
}

fn rate(text: &str) -> Result<u32, String> {
    match text {
        "1" | "2" | "4" | "8" => text.parse().map_err(|_| "1, 2, 4 or 8".to_owned()),
        _ => Err("1, 2, 4 or 8".to_owned()),
    }
}

/// Runs the command.
///
/// # Errors
/// A tool is missing, the firmware could not be measured, or a file could not be written. A missed target is not an
/// error.
pub(super) fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let plan = LatencyPlan {
        cycles: arguments.cycles.max(1),
        disturbance: arguments.disturbance,
        at_rest: true,
        isolation: arguments.isolation,
        rate_khz: arguments.rate,
        instruction_shift: arguments.shift,
        seed: arguments.seed,
    };
    let report = match &arguments.merge {
        Some(folder) => latency::run_merged(&plan, folder, |what| eprintln!("etherpen: {what}"))?,
        None => measure(&plan)?,
    };
    if let Some(path) = &arguments.plot {
        write_text(path, &plot::svg(&report))?;
        eprintln!("etherpen: curves in {}", path.display());
    }
    if arguments.json {
        return print_json(&report);
    }
    let figures = BenchReport {
        bench: report.bench,
        rows: report.rows.clone(),
    };
    let verdict = if report.passed {
        "all targets met"
    } else {
        "a target was missed"
    };
    std::io::stdout()
        .write_all(format!("{}{verdict}\n", table(&figures)).as_bytes())
        .or_else(ProgramError::of_stdout)
}

/// Measures, with progress on stderr.
pub(super) fn measure(plan: &LatencyPlan) -> Result<LatencyReport, ProgramError> {
    latency::run(plan, |what| eprintln!("etherpen: {what}")).map_err(ProgramError::from)
}
