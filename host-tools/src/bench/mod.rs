//! Benchmarks: the figures that the project claims, measured together with those of its peers.
//!
//! Instructions, bytes, frames and virtual time are counted and do not depend on the computer. Figures in real or
//! processor time do: those of drawings (a program's own time, or its share of a peer's measured in the same run) and of
//! the console have targets too.
//!
//! Invariant: every row is measured in this run or left out; no value is stored.

mod bring_up;
pub mod console;
pub mod drawing;
pub mod ethercat;
pub mod latency;
pub mod motion;
mod programs;
pub mod recording;
pub mod table;

use crate::error::{ProgramError, code};
use crate::setup::SetupError;
use serde::Serialize;

/// Units of figures for which larger is better.
const MORE_IS_BETTER: [&str; 3] = ["correlation", "share", "margin"];

/// One figure.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchRow {
    /// The measured case and its platform: `cyclic/lrw@host`.
    pub case: String,
    /// `etherpen`, or the peer.
    pub subject: &'static str,
    /// The figure.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
    /// Upper limit, if there is one; lower limit where larger is better ([`BenchRow::is_more_better`]).
    pub target: Option<f64>,
}

impl BenchRow {
    /// Whether the figure is within its target; `None` without a target.
    #[must_use]
    pub fn met(&self) -> Option<bool> {
        let is_met = |target| {
            if self.is_more_better() {
                self.value >= target
            } else {
                self.value <= target
            }
        };
        self.target.map(is_met)
    }

    /// Whether a larger figure is better.
    #[must_use]
    pub fn is_more_better(&self) -> bool {
        MORE_IS_BETTER.contains(&self.unit)
    }
}

/// The figures of one benchmark.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchReport {
    /// Name of the benchmark.
    pub bench: &'static str,
    /// Its figures.
    pub rows: Vec<BenchRow>,
}

/// The figures that miss their targets, as text.
#[must_use]
pub fn missed(rows: &[BenchRow]) -> Vec<String> {
    let missed = |row: &BenchRow| {
        let bound = if row.is_more_better() { "at least" } else { "at most" };
        let target = row.target.filter(|_| row.met() == Some(false))?;
        Some(format!("{}: {} {}, {bound} {target}", row.case, row.value, row.unit))
    };
    rows.iter().filter_map(missed).collect()
}

/// Selection of a benchmark's cases.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    /// Only cases whose names contain this.
    pub case: Option<String>,
    /// Only this subject.
    pub subject: Option<String>,
}

impl Selection {
    /// Whether the figure of this case and subject is selected.
    #[must_use]
    pub fn wants(&self, case: &str, subject: &str) -> bool {
        self.wants_case(case) && self.wants_subject(subject)
    }

    fn wants_case(&self, case: &str) -> bool {
        self.case.as_ref().is_none_or(|wanted| case.contains(wanted.as_str()))
    }

    fn wants_subject(&self, subject: &str) -> bool {
        self.subject.as_ref().is_none_or(|wanted| wanted == subject)
    }
}

/// Why a figure could not be measured.
#[derive(Debug)]
pub enum BenchError {
    /// A tool is missing, or a build failed.
    Setup(SetupError),
    /// A program of the benchmark failed.
    Program {
        /// The program.
        program: String,
        /// Its output, or what was wrong with the output.
        cause: String,
    },
}

impl std::fmt::Display for BenchError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Setup(error) => error.fmt(f),
            Self::Program { program, cause } => write!(f, "{program}: {cause}"),
        }
    }
}

impl std::error::Error for BenchError {}

impl From<BenchError> for ProgramError {
    fn from(error: BenchError) -> Self {
        match error {
            BenchError::Setup(error) => error.into(),
            BenchError::Program { .. } => Self::new(code::FAILED, error),
        }
    }
}

impl From<SetupError> for BenchError {
    fn from(error: SetupError) -> Self {
        Self::Setup(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missed_target_is_told_with_its_bound_and_others_are_not() {
        let row = |case: &str, value, unit, target| BenchRow {
            case: case.to_owned(),
            subject: "etherpen",
            value,
            unit,
            target,
        };
        let rows = [
            row("met", 4.0, "frames", Some(4.0)),
            row("more", 5.0, "frames", Some(4.0)),
            row("less", 0.5, "share", Some(0.75)),
            row("none", 9.0, "frames", None),
        ];
        let expected = ["more: 5 frames, at most 4", "less: 0.5 share, at least 0.75"];
        assert_eq!(missed(&rows), expected);
    }
}
