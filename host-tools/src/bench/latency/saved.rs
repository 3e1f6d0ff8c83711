//! Measurements kept in files, so that a long one can be made of several runs, on several days.
//!
//! Each file is one seed's runs. Files of one folder were made with the same options.

use super::{LatencyPlan, LatencyRun};
use crate::bench::BenchError;
use crate::link::measurement::Readings;
use crate::output_file;
use etherpen::messages::Counters;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The runs of one seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Saved {
    /// Format of the file, and the version of the program that measured.
    format: u32,
    version: String,
    pub(super) plan: LatencyPlan,
    pub(super) runs: Vec<LatencyRun>,
}

/// Format of these files.
const FORMAT: u32 = 1;

fn failed(path: &Path, cause: impl ToString) -> BenchError {
    BenchError::Program {
        program: path.display().to_string(),
        cause: cause.to_string(),
    }
}

fn file(folder: &Path, seed: u64) -> PathBuf {
    folder.join(format!("seed-{seed}.json"))
}

impl Saved {
    pub(super) fn new(plan: &LatencyPlan, runs: Vec<LatencyRun>) -> Self {
        Self {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            plan: plan.clone(),
            runs,
        }
    }

    fn read(path: &Path) -> Result<Self, BenchError> {
        let text = std::fs::read_to_string(path).map_err(|cause| failed(path, cause))?;
        let saved: Self = serde_json::from_str(&text).map_err(|cause| failed(path, cause))?;
        match saved.format {
            FORMAT => Ok(saved),
            other => Err(failed(path, format!("format {other}, this program reads {FORMAT}"))),
        }
    }

    /// Keeps it in a folder.
    pub(super) fn write(&self, folder: &Path) -> Result<(), BenchError> {
        std::fs::create_dir_all(folder).map_err(|cause| failed(folder, cause))?;
        let path = file(folder, self.plan.seed);
        let text = serde_json::to_string(self).map_err(|cause| failed(&path, cause))?;
        output_file::write(&path, text.as_bytes()).map_err(|cause| failed(&path, cause))
    }

    /// The runs of a plan's seed that a folder has.
    ///
    /// # Errors
    /// The file cannot be read, or was made with other options.
    pub(super) fn of(folder: &Path, plan: &LatencyPlan) -> Result<Option<Self>, BenchError> {
        let path = file(folder, plan.seed);
        if !path.exists() {
            return Ok(None);
        }
        let saved = Self::read(&path)?;
        match saved.plan == *plan {
            true => Ok(Some(saved)),
            false => Err(failed(&path, "measured with other options; use another folder")),
        }
    }

    /// All runs of a folder that were measured with a plan's options, ordered by seed.
    ///
    /// # Errors
    /// A file cannot be read, or was made with other options.
    pub(super) fn all(folder: &Path, plan: &LatencyPlan) -> Result<Vec<Self>, BenchError> {
        let entries = std::fs::read_dir(folder).map_err(|cause| failed(folder, cause))?;
        let mut all = Vec::new();
        for path in entries.flatten().map(|entry| entry.path()) {
            let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
            if !(name.starts_with("seed-") && name.ends_with(".json")) {
                continue;
            }
            let saved = Self::read(&path)?;
            let same = LatencyPlan {
                seed: saved.plan.seed,
                ..plan.clone()
            };
            if saved.plan != same {
                return Err(failed(&path, "measured with other options; use another folder"));
            }
            all.push(saved);
        }
        all.sort_by_key(|saved| saved.plan.seed);
        Ok(all)
    }
}

/// The runs of several seeds as one: of each case one run with the sums of all.
pub(super) fn merged(all: &[Saved]) -> Vec<LatencyRun> {
    let mut runs: Vec<LatencyRun> = Vec::new();
    for run in all.iter().flat_map(|saved| &saved.runs) {
        match runs.iter_mut().find(|earlier| earlier.case == run.case) {
            Some(earlier) => {
                earlier.readings = Readings::merged(&earlier.readings, &run.readings);
                earlier.counters = sum(&earlier.counters, &run.counters);
            }
            None => runs.push(run.clone()),
        }
    }
    runs
}

fn sum(one: &Counters, other: &Counters) -> Counters {
    Counters {
        cycles: one.cycles.saturating_add(other.cycles),
        cycles_late: one.cycles_late.saturating_add(other.cycles_late),
        frames_lost: one.frames_lost.saturating_add(other.frames_lost),
        working_counter_errors: one.working_counter_errors.saturating_add(other.working_counter_errors),
        frames_ignored: one.frames_ignored.saturating_add(other.frames_ignored),
        setpoint_underruns: one.setpoint_underruns.saturating_add(other.setpoint_underruns),
        path_starvations: one.path_starvations.saturating_add(other.path_starvations),
        trajectory_overruns: one.trajectory_overruns.saturating_add(other.trajectory_overruns),
        telemetry_dropped: one.telemetry_dropped.saturating_add(other.telemetry_dropped),
        link_errors: one.link_errors.saturating_add(other.link_errors),
        ethernet_errors: one.ethernet_errors.saturating_add(other.ethernet_errors),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Case, Disturbance, Isolation};
    use super::*;

    fn plan(seed: u64) -> LatencyPlan {
        LatencyPlan {
            cycles: 1_000,
            disturbance: Disturbance::ALL,
            at_rest: false,
            isolation: Isolation::Basepri,
            rate_khz: 1,
            instruction_shift: 3,
            seed,
        }
    }

    fn run(cycles: u32) -> LatencyRun {
        LatencyRun {
            case: Case {
                disturbance: Disturbance::ALL,
                isolation: Isolation::Basepri,
                rate_khz: 1,
            },
            readings: Readings::default(),
            counters: Counters {
                cycles,
                ..Counters::default()
            },
        }
    }

    #[test]
    fn runs_are_found_again_and_added_and_other_options_are_refused() {
        let folder = std::env::temp_dir().join(format!("etherpen-latency-{}", std::process::id()));
        assert!(matches!(Saved::of(&folder, &plan(1)), Ok(None)));
        for (seed, cycles) in [(1, 1_000), (2, 1_001)] {
            Saved::new(&plan(seed), vec![run(cycles)])
                .write(&folder)
                .expect("it is written");
        }
        let found = Saved::of(&folder, &plan(2)).expect("it can be read");
        assert_eq!(found.map(|saved| saved.runs), Some(vec![run(1_001)]));
        let all = Saved::all(&folder, &plan(7)).expect("both can be read");
        assert_eq!(merged(&all), vec![run(2_001)]);
        let other = LatencyPlan { cycles: 5, ..plan(1) };
        let refused = Saved::all(&folder, &other).expect_err("another number of cycles");
        assert!(refused.to_string().contains("other options"), "{refused}");
        assert!(Saved::of(&folder, &other).is_err());
        std::fs::write(folder.join("seed-3.json"), "{").expect("it is written");
        assert!(Saved::all(&folder, &plan(1)).is_err());
        std::fs::remove_dir_all(&folder).expect("it is removed");
    }
}
