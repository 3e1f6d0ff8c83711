//! `etherpen jobs`: the drawings in this computer's job log.

use crate::commands::print_json;
use crate::error::ProgramError;
use crate::job::history::{HistoryEntry, Record, damaged, folder, list};
use crate::terminal::counted;
use serde::Serialize;

/// Options of `etherpen jobs`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Number of jobs to list, the newest first; 0 lists all.
    #[arg(long, value_name = "N", default_value_t = 20)]
    newest: usize,
    /// Print the list as JSON on stdout.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// The log cannot be read.
pub(super) fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let (records, damaged) = folder()
        .and_then(|folder| Ok((list(&folder)?, damaged(&folder)?)))
        .map_err(|cause| ProgramError::failed("the log of jobs cannot be read", cause))?;
    for name in &damaged {
        eprintln!("the entry {name} is damaged and cannot be resumed");
    }
    let mut entries: Vec<ListedJob> = records.into_iter().map(ListedJob::from).collect();
    if arguments.newest > 0 {
        let first = entries.len().saturating_sub(arguments.newest);
        entries.drain(..first);
    }
    if arguments.json {
        return print_json(&entries);
    }
    if entries.is_empty() && damaged.is_empty() {
        eprintln!("nothing was drawn yet");
    }
    for entry in &entries {
        println!("{}", line(entry));
    }
    Ok(())
}

/// A drawing and its name.
#[derive(Debug, Serialize)]
struct ListedJob {
    /// What `etherpen draw --resume` takes.
    job: String,
    #[serde(flatten)]
    entry: HistoryEntry,
}

impl From<Record> for ListedJob {
    fn from(record: Record) -> Self {
        Self {
            job: record.name(),
            entry: record.entry,
        }
    }
}

fn line(ListedJob { job, entry }: &ListedJob) -> String {
    let state = match (&entry.result, entry.completed) {
        (_, true) => "drawn".to_owned(),
        (Some(result), false) => format!("ended: {result}"),
        (None, false) => "under way, or its program was killed".to_owned(),
    };
    format!(
        "{}  {job}  {}  {} of {}, {:.2} m, {:.0} s  {state}",
        time_text(entry.begun_unix_s),
        entry.file.display(),
        entry.strokes,
        counted(entry.strokes_total, "stroke"),
        entry.pen_down_mm / 1_000.0,
        entry.drawn_s,
    )
}

/// A time as date and time of day, UTC (days to a date after Howard Hinnant's description of the civil calendar).
fn time_text(unix_s: u64) -> String {
    let (days, second) = (unix_s / 86_400, unix_s % 86_400);
    let shifted = days + 719_468;
    let era = shifted / 146_097;
    let day_of_era = shifted % 146_097;
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
    let month = if shifted_month < 10 {
        shifted_month + 3
    } else {
        shifted_month - 9
    };
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    let (hour, minute) = (second / 3_600, second / 60 % 60);
    format!("{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}Z")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_dates() {
        assert_eq!(time_text(0), "1970-01-01 00:00Z");
        assert_eq!(time_text(951_782_400), "2000-02-29 00:00Z");
        assert_eq!(time_text(1_767_225_599), "2025-12-31 23:59Z");
    }

    #[test]
    fn a_killed_drawing_is_told_from_one_that_is_done() {
        let mut job = ListedJob {
            job: "0001-ab-7".into(),
            entry: HistoryEntry::default(),
        };
        assert!(line(&job).contains("killed") && line(&job).contains("  0001-ab-7  "));
        job.entry.completed = true;
        assert!(line(&job).ends_with("drawn"));
    }
}
