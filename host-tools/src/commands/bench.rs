//! `etherpen bench`: the project's figures beside those of its peers, measured in one run.

use super::{CommandError, code, print_json};
use crate::bench::{BenchError, Report, Row, Selection, ethercat};
use std::io::Write;

/// Options of `etherpen bench`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    bench: Bench,
}

#[derive(clap::Subcommand, Debug)]
enum Bench {
    /// The EtherCAT master beside ethercrab: instructions of a cycle, memory, code, frames of a bring-up.
    Ethercat(Options),
    /// The firmware in the emulator: late cycles, lost frames, release jitter, delays, execution times, load.
    Latency(super::latency::Arguments),
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
}

/// Runs the command.
///
/// # Errors
/// A tool is missing, or something could not be measured. A target that is missed is no error.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let options = match &arguments.bench {
        Bench::Ethercat(options) => options,
        Bench::Latency(arguments) => return super::latency::run(arguments),
    };
    let selection = Selection {
        case: options.case.clone(),
        subject: options.subject.clone(),
    };
    let report = ethercat::run(&selection, |what| eprintln!("etherpen: {what}")).map_err(|error| match error {
        BenchError::Setup(error) => CommandError::from(error),
        BenchError::Program { .. } => CommandError::new(code::FAILED, error),
    })?;
    if report.rows.is_empty() {
        return Err(CommandError::new(
            code::USAGE,
            "no case has that name; without --case all are shown",
        ));
    }
    if options.json {
        return print_json(&report);
    }
    std::io::stdout()
        .write_all(table(&report).as_bytes())
        .map_err(|cause| CommandError::failed("stdout", cause))
}

/// One line a case: our figure, its target, the peer's figure, and how many times ours that is.
pub(super) fn table(report: &Report) -> String {
    let mut text = format!(
        "{:<38} {:>9} {:<13} {:>16} {:>20} {:>7}\n",
        "case", "etherpen", "", "target", "peer", "ratio"
    );
    let ours = report.rows.iter().filter(|row| row.subject == "etherpen");
    for row in ours {
        let peer = report
            .rows
            .iter()
            .find(|peer| peer.case == row.case && peer.subject != row.subject);
        let theirs = peer.map_or_else(String::new, |peer| format!("{} {}", peer.subject, peer.value));
        let ratio = peer.map_or_else(String::new, |peer| format!("{:.2}", peer.value / row.value));
        let line = format!(
            "{:<38} {:>9} {:<13} {:>16} {theirs:>20} {ratio:>7}",
            row.case,
            row.value,
            row.unit,
            target(row)
        );
        text.push_str(line.trim_end());
        text.push('\n');
    }
    let alone = |row: &&Row| row.subject != "etherpen" && !report.rows.iter().any(|other| other.subject == "etherpen");
    for row in report.rows.iter().filter(alone) {
        text.push_str(&format!(
            "{:<38} {:>9} {:<13} {}\n",
            row.case, row.value, row.unit, row.subject
        ));
    }
    text
}

fn target(row: &Row) -> String {
    match (row.target, row.met()) {
        (Some(target), Some(true)) => format!("<= {target} met"),
        (Some(target), _) => format!("<= {target} missed"),
        (None, _) => String::new(),
    }
}
