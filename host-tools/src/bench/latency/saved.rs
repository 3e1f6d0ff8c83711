//! Measurements kept in files, so that a long one can be made of several runs, on several days.
//!
//! Each file holds the runs of one seed and is named after it. Invariant: all runs of a folder that are reported together
//! have the same options, the same version of this program, the same firmware images and the same counter; a file that
//! differs is refused, never left out silently.

use super::{Case, LatencyPlan, LatencyRun, rows};
use crate::bench::BenchError;
use crate::link::measurement::Readings;
use crate::output_file;
use etherpen::messages::Counters;
use serde::{Deserialize, Serialize};
use std::ffi::OsStr;
use std::io::ErrorKind;
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

/// The part of a file that every format has.
#[derive(Deserialize)]
struct Format {
    format: u32,
}

/// Format of these files.
const FORMAT: u32 = 2;
const VERSION: &str = env!("CARGO_PKG_VERSION");

fn failed(path: &Path, cause: impl ToString) -> BenchError {
    BenchError::Program {
        program: path.display().to_string(),
        cause: cause.to_string(),
    }
}

/// The error of a file that cannot be merged, with what to do about it.
fn refused(path: &Path, cause: impl std::fmt::Display) -> BenchError {
    failed(path, format!("{cause}; use another folder, or remove this file"))
}

fn file_name(seed: u64) -> String {
    format!("seed-{seed}.json")
}

/// Whether a file is named as one of runs; also true for a copy with another name, which [`Saved::check`] refuses.
fn is_named_as_runs(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with("seed-") && name.ends_with(".json")
}

impl Saved {
    pub(super) fn new(plan: &LatencyPlan, runs: Vec<LatencyRun>) -> Self {
        Self {
            format: FORMAT,
            version: VERSION.to_owned(),
            plan: plan.clone(),
            runs,
        }
    }

    fn read(path: &Path) -> Result<Self, BenchError> {
        let text = std::fs::read_to_string(path).map_err(|cause| failed(path, cause))?;
        let Format { format } = serde_json::from_str(&text).map_err(|cause| refused(path, cause))?;
        if format != FORMAT {
            let cause = format!("has format {format}, and this program reads format {FORMAT}");
            return Err(refused(path, cause));
        }
        serde_json::from_str(&text).map_err(|cause| refused(path, cause))
    }

    /// Keeps it in a folder.
    pub(super) fn write(&self, folder: &Path) -> Result<(), BenchError> {
        std::fs::create_dir_all(folder).map_err(|cause| failed(folder, cause))?;
        let path = folder.join(file_name(self.plan.seed));
        let text = serde_json::to_string(self).map_err(|cause| failed(&path, cause))?;
        output_file::write(&path, text.as_bytes()).map_err(|cause| failed(&path, cause))
    }

    /// Checks that this file's runs can be added to others of a plan and of these images, the hash for each case.
    fn check(&self, path: &Path, plan: &LatencyPlan, images: &[(Case, String)]) -> Result<(), BenchError> {
        let name = file_name(self.plan.seed);
        if path.file_name() != Some(OsStr::new(&name)) {
            let cause = format!("holds seed {}, whose file is {name}", self.plan.seed);
            return Err(failed(
                path,
                format!("{cause}; move this file to another folder, or remove it"),
            ));
        }
        if self.version != VERSION {
            let cause = format!("measured with version {} of etherpen, this is {VERSION}", self.version);
            return Err(refused(path, cause));
        }
        let same = LatencyPlan {
            seed: self.plan.seed,
            ..plan.clone()
        };
        if self.plan != same {
            return Err(refused(path, "measured with other options"));
        }
        // Runs at a higher rate end with the first missed deadline.
        let cases_min = images.iter().filter(|(case, _)| case.rate_khz == 1).count();
        let wanted = images.iter().take(self.runs.len()).map(|(case, _)| *case);
        if self.runs.len() < cases_min || !self.runs.iter().map(|run| run.case).eq(wanted) {
            return Err(refused(path, "does not hold the runs of its options"));
        }
        for (run, (case, image)) in self.runs.iter().zip(images) {
            let name = rows::name(*case);
            if run.image != *image {
                let cause = format!("measured with firmware image {}, this is {image} ({name})", run.image);
                return Err(refused(path, cause));
            }
            let checked = run.readings.check();
            checked.map_err(|error| refused(path, format!("damaged ({name}): {error}")))?;
        }
        Ok(())
    }

    /// All runs of a folder, ordered by seed; none if there is no such folder.
    ///
    /// # Errors
    /// A file cannot be read, is not named after its seed, contradicts itself, or was measured with other options,
    /// another version of this program, another firmware image or another counter.
    pub(super) fn all(folder: &Path, plan: &LatencyPlan, images: &[(Case, String)]) -> Result<Vec<Self>, BenchError> {
        let entries = match std::fs::read_dir(folder) {
            Ok(entries) => entries,
            Err(cause) if cause.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            Err(cause) => return Err(failed(folder, cause)),
        };
        let mut paths: Vec<PathBuf> = Vec::new();
        for entry in entries {
            let path = entry.map_err(|cause| failed(folder, cause))?.path();
            if is_named_as_runs(&path) {
                paths.push(path);
            }
        }
        paths.sort();
        let mut all = Vec::new();
        let mut counts_per_s = None;
        for path in paths {
            let saved = Self::read(&path)?;
            saved.check(&path, plan, images)?;
            for actual in saved.runs.iter().filter_map(|run| run.readings.counts_per_s()) {
                let expected = *counts_per_s.get_or_insert(actual);
                if actual != expected {
                    let cause = format!("its counter has {actual} counts per second, that of other runs {expected}");
                    return Err(refused(&path, cause));
                }
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
        path_stops_left: one.path_stops_left.saturating_add(other.path_stops_left),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Disturbance, Isolation};
    use super::*;
    use crate::link::measurement::Reader;
    use etherpen::measurement::{Measurements, Quantity};
    use serde_json::{Value, json};

    const CASE: Case = Case {
        disturbance: Disturbance::ALL,
        isolation: Isolation::Basepri,
        rate_khz: 1,
    };
    const IMAGE: &str = "fnv1a64:00000000000000a1";

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

    fn images() -> [(Case, String); 1] {
        [(CASE, IMAGE.to_owned())]
    }

    fn readings(delays: &[u32]) -> Readings {
        let measurements = Measurements::new();
        measurements.set_counts_per_s(25_000_000);
        delays
            .iter()
            .for_each(|delay| measurements.record(Quantity::TotalDelay, *delay));
        let mut reader = Reader::new();
        while let Some(request) = reader.request() {
            reader.take(&measurements.answer(request));
        }
        reader.into_readings().expect("everything was read")
    }

    fn run(cycles: u32, delays: &[u32]) -> LatencyRun {
        LatencyRun {
            case: CASE,
            image: IMAGE.to_owned(),
            readings: readings(delays),
            counters: Counters {
                cycles,
                ..Counters::default()
            },
        }
    }

    /// A folder of its own for one test, with the files of two seeds; removed at the end.
    struct Folder(PathBuf);

    impl Folder {
        fn of(test: &str) -> Self {
            let folder = std::env::temp_dir().join(format!("etherpen-latency-{test}-{}", std::process::id()));
            for (seed, cycles) in [(1, 1_000), (2, 1_001)] {
                let runs = vec![run(cycles, &[7, 100 * cycles])];
                Saved::new(&plan(seed), runs).write(&folder).expect("it is written");
            }
            Self(folder)
        }

        fn all(&self, plan: &LatencyPlan) -> Result<Vec<Saved>, BenchError> {
            Saved::all(&self.0, plan, &images())
        }

        /// The error, which has to name the file of seed 2.
        fn refusal(&self, plan: &LatencyPlan) -> String {
            let refusal = self.all(plan).expect_err("a file is refused").to_string();
            assert!(refusal.contains("seed-2"), "{refusal}");
            assert!(refusal.contains("another folder, or remove"), "{refusal}");
            refusal
        }

        /// Changes the file of seed 2.
        fn change(&self, change: impl FnOnce(&mut Value)) {
            let path = self.0.join("seed-2.json");
            let text = std::fs::read_to_string(&path).expect("it can be read");
            let mut content = serde_json::from_str(&text).expect("it is JSON");
            change(&mut content);
            std::fs::write(&path, content.to_string()).expect("it is written");
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            // What is left in the folder for temporary files does no harm.
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    #[test]
    fn runs_are_found_again_and_added() {
        let folder = Folder::of("added");
        let all = folder.all(&plan(7)).expect("both can be read");
        let seeds: Vec<u64> = all.iter().map(|saved| saved.plan.seed).collect();
        assert_eq!(seeds, [1, 2]);
        assert_eq!(merged(&all), [run(2_001, &[7, 100_000, 7, 100_100])]);
        let nowhere = folder.0.join("nowhere");
        let none = Saved::all(&nowhere, &plan(1), &images()).expect("no folder is no error");
        assert!(none.is_empty(), "{none:?}");
    }

    #[test]
    fn runs_of_other_options_another_version_or_another_image_are_refused() {
        let folder = Folder::of("others");
        let other = LatencyPlan { cycles: 5, ..plan(1) };
        let refused = folder.all(&other).expect_err("another number of cycles").to_string();
        assert!(
            refused.contains("seed-1.json: measured with other options"),
            "{refused}"
        );
        folder.change(|content| content["runs"][0]["image"] = json!("fnv1a64:00000000000000b2"));
        let refused = folder.refusal(&plan(1));
        assert!(refused.contains("b2") && refused.contains(IMAGE), "{refused}");
        folder.change(|content| content["version"] = json!("0.0.0-other"));
        assert!(folder.refusal(&plan(1)).contains("version 0.0.0-other"));
        folder.change(|content| *content = json!({"format": 1}));
        assert!(folder.refusal(&plan(1)).contains("format 1"));
    }

    #[test]
    fn no_seed_counts_twice_under_another_name() {
        for name in ["seed-2-old.json", "seed-02.json", "seed-3.json"] {
            let folder = Folder::of("name");
            std::fs::copy(folder.0.join("seed-2.json"), folder.0.join(name)).expect("it is copied");
            let refused = folder.all(&plan(1)).expect_err("a copy").to_string();
            assert!(refused.contains(name), "{refused}");
            assert!(refused.contains("holds seed 2, whose file is seed-2.json"), "{refused}");
        }
    }

    #[test]
    fn damaged_files_are_refused() {
        let folder = Folder::of("damaged");
        let total = Quantity::TotalDelay as usize;
        folder.change(|content| content["runs"][0]["readings"]["distributions"][total]["smallest"] = json!(u32::MAX));
        let refused = folder.refusal(&plan(1));
        assert!(refused.contains("the smallest value"), "{refused}");
        folder.change(|content| {
            let distributions = content["runs"][0]["readings"]["distributions"].as_array_mut();
            for distribution in distributions.expect("distributions") {
                distribution["smallest"] = json!(0);
                distribution["counts_per_s"] = json!(1_000);
            }
        });
        let refused = folder.refusal(&plan(1));
        assert!(refused.contains("1000 counts per second"), "{refused}");
        folder.change(|content| content["runs"] = json!([]));
        assert!(folder.refusal(&plan(1)).contains("does not hold the runs"));
        std::fs::write(folder.0.join("seed-2.json"), "{").expect("it is written");
        folder.refusal(&plan(1));
    }
}
