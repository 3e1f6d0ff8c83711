//! Latency of the critical tasks: the firmware in the emulator, at rest and under every load that it can generate.
//!
//! Repeats the measurement of *Using Real-time Java for Industrial Robot Control*: the fraction of the requests that
//! are not serviced within a time, without and with disturbance. The firmware measures itself
//! (`etherpen::measurement`), its histograms are read over the link at the end, and no result depends on the speed of
//! this computer.
//!
//! Invariant: a run counts only if it kept its period: every millisecond had a release.

mod cable;
mod peer;
pub mod plot;
mod rows;
mod saved;

pub use rows::{Curve, LatencyReport};

use super::BenchError;
use crate::cell::{Cell, CellOptions};
use crate::emulator::{Emulator, Options as EmulatorOptions};
use crate::firmware_image::image_hash;
use crate::link::measurement::Readings;
use crate::setup;
use cable::Cable;
use etherpen::config::Config;
use etherpen::measurement::disturbance;
use etherpen::messages::Counters;
use peer::{Outcome, Peer};
use saved::Saved;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Artificial loads of the firmware.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Disturbance {
    /// The serial link full in both directions.
    pub serial: bool,
    /// The planner on a path that keeps its window full.
    pub planner: bool,
    /// Continuous log output.
    pub log: bool,
    /// Foreign frames around every release.
    pub network: bool,
}

impl Disturbance {
    /// All loads.
    pub const ALL: Self = Self {
        serial: true,
        planner: true,
        log: true,
        network: true,
    };

    /// Bits of the request to the firmware.
    fn bits(self) -> u8 {
        let bit = |on: bool, bit: u8| if on { bit } else { 0 };
        bit(self.serial, disturbance::SERIAL)
            | bit(self.log, disturbance::LOG)
            | bit(self.network, disturbance::NETWORK)
    }
}

impl std::str::FromStr for Disturbance {
    type Err = String;

    fn from_str(list: &str) -> Result<Self, String> {
        let mut chosen = Self::default();
        for word in list.split(',') {
            match word.trim() {
                "none" => {}
                "all" => chosen = Self::ALL,
                "serial" => chosen.serial = true,
                "planner" => chosen.planner = true,
                "log" => chosen.log = true,
                "network" => chosen.network = true,
                other => {
                    return Err(format!(
                        "`{other}` is no disturbance: none, all, or several of serial, planner, log, network"
                    ));
                }
            }
        }
        Ok(chosen)
    }
}

/// Isolation of the critical tasks from the other tasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
pub enum Isolation {
    /// Critical sections mask everything but the critical tasks.
    Basepri,
    /// Critical sections mask everything, including the critical tasks: no isolation.
    Primask,
}

/// Plan of the measurement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LatencyPlan {
    /// Cycles of each run.
    pub cycles: u64,
    /// The load of the second run.
    pub disturbance: Disturbance,
    /// Whether to measure the firmware without load too.
    pub at_rest: bool,
    /// With `Primask`, the loaded run is repeated without isolation.
    pub isolation: Isolation,
    /// Highest loop rate to try, kHz: 1, 2, 4 or 8.
    pub rate_khz: u32,
    /// One instruction takes 2^shift ns of virtual time.
    pub instruction_shift: u8,
    /// Seed of the planner's path and of the moments at which the loads meet the cycle.
    pub seed: u64,
}

/// One run of the firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Case {
    pub(crate) disturbance: Disturbance,
    pub(crate) isolation: Isolation,
    pub(crate) rate_khz: u32,
}

/// Result of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct LatencyRun {
    pub(crate) case: Case,
    /// Hash of the firmware image that ran.
    pub(crate) image: String,
    pub(crate) readings: Readings,
    /// Counters of the measurement alone.
    pub(crate) counters: Counters,
}

/// Settling time of the firmware under its load before the measurement, ms; the seed adds less than a second.
const SETTLE_MS: u32 = 1_000;
const SETTLE_BY_SEED_MS: u64 = 997;
/// Wall time without any progress after which a run is given up.
const ANSWER_WITHIN: Duration = Duration::from_secs(60);
/// Wall time between two checks of a run.
const LOOK: Duration = Duration::from_millis(50);

/// Runs the measurements; `progress` gets a description of each step.
///
/// # Errors
/// A tool is missing, the emulator ended, or the firmware had a fault.
pub fn run(plan: &LatencyPlan, mut progress: impl FnMut(&str)) -> Result<LatencyReport, BenchError> {
    Ok(rows::report(plan, &measure_all(plan, &mut progress)?))
}

/// Keeps the runs of the plan's seed in a folder, and reports all runs in the folder as one. Measures the seed only if
/// the folder does not have it.
///
/// # Errors
/// A tool is missing, the emulator ended, or the firmware had a fault. A file of the folder cannot be read or written,
/// contradicts itself, or was measured with other options, another version of this program or another firmware image:
/// nothing is measured then.
pub fn run_merged(
    plan: &LatencyPlan,
    folder: &Path,
    mut progress: impl FnMut(&str),
) -> Result<LatencyReport, BenchError> {
    let images = images(plan, &mut progress)?;
    let mut all = Saved::all(folder, plan, &images)?;
    if all.iter().all(|saved| saved.plan.seed != plan.seed) {
        let runs = measure_all(plan, &mut progress)?;
        check_unchanged(&runs, &images)?;
        Saved::new(plan, runs).write(folder)?;
        // Another process may have added a seed meanwhile.
        all = Saved::all(folder, plan, &images)?;
    }
    let seeds: Vec<String> = all.iter().map(|saved| saved.plan.seed.to_string()).collect();
    progress(&format!("seeds {} together", seeds.join(", ")));
    Ok(rows::report(plan, &saved::merged(&all)))
}

/// Cases of a plan in the order of their runs, those at 1 kHz first.
fn cases(plan: &LatencyPlan) -> Vec<Case> {
    let idle = Case {
        disturbance: Disturbance::default(),
        isolation: Isolation::Basepri,
        rate_khz: 1,
    };
    let loaded = Case {
        disturbance: plan.disturbance,
        ..idle
    };
    let mut cases = Vec::new();
    if plan.at_rest || loaded == idle {
        cases.push(idle);
    }
    if loaded != idle {
        cases.push(loaded);
    }
    if plan.isolation == Isolation::Primask {
        cases.push(Case {
            isolation: Isolation::Primask,
            ..loaded
        });
    }
    // The path is planned for a loop of 1 kHz: at a higher rate it would be too fast for the drives.
    let disturbance = Disturbance {
        planner: false,
        ..plan.disturbance
    };
    let rates_khz = [2, 4, 8].into_iter().filter(|rate_khz| *rate_khz <= plan.rate_khz);
    cases.extend(rates_khz.map(|rate_khz| Case {
        disturbance,
        rate_khz,
        ..idle
    }));
    cases
}

/// Measures the cases of a plan in order; the first missed deadline at a higher rate is the last run.
fn measure_all(plan: &LatencyPlan, progress: &mut impl FnMut(&str)) -> Result<Vec<LatencyRun>, BenchError> {
    setup::ensure_qemu()?;
    let mut runs = Vec::new();
    for case in cases(plan) {
        let measured = measure(plan, case, progress)?;
        let missed = case.rate_khz > 1 && rows::late(&measured) > 0;
        runs.push(measured);
        if missed {
            break;
        }
    }
    Ok(runs)
}

/// Builds the image of a case: the emulated board, or a variant of it in a separate folder.
fn image(case: Case) -> Result<PathBuf, BenchError> {
    let rate = format!("rate-{}khz", case.rate_khz);
    let mut features = Vec::new();
    if case.isolation == Isolation::Primask {
        features.push("primask");
    }
    if case.rate_khz > 1 {
        features.push(&rate);
    }
    Ok(setup::build_variant("emulated", &features)?)
}

/// Builds the images of a plan's cases; returns each case with the hash of its image.
fn images(plan: &LatencyPlan, progress: &mut impl FnMut(&str)) -> Result<Vec<(Case, String)>, BenchError> {
    let built = |case| {
        progress(&format!("building the firmware: {}", rows::name(case)));
        Ok((case, hash(&image(case)?)?))
    };
    cases(plan).into_iter().map(built).collect()
}

fn hash(image: &Path) -> Result<String, BenchError> {
    image_hash(image).map_err(|error| BenchError::Program {
        program: "the firmware cannot be identified".to_owned(),
        cause: error.message,
    })
}

/// Checks that every run had the image that was built for its case before the first run.
fn check_unchanged(runs: &[LatencyRun], images: &[(Case, String)]) -> Result<(), BenchError> {
    for (run, (_, image)) in runs.iter().zip(images) {
        if run.image != *image {
            return Err(BenchError::Program {
                program: format!("the firmware, {}", rows::name(run.case)),
                cause: format!(
                    "its image changed from {image} to {} during the measurement, so nothing was kept; measure again \
                     without changing the sources",
                    run.image
                ),
            });
        }
    }
    Ok(())
}

fn measure(plan: &LatencyPlan, case: Case, progress: &mut impl FnMut(&str)) -> Result<LatencyRun, BenchError> {
    let name = rows::name(case);
    progress(&format!("building the firmware: {name}"));
    let image = image(case)?;
    progress(&format!("measuring {} cycles: {name}", plan.cycles));
    measure_image(&image, plan, case, progress)
}

/// Runs an image through one case.
fn measure_image(
    image: &Path,
    plan: &LatencyPlan,
    case: Case,
    progress: &mut impl FnMut(&str),
) -> Result<LatencyRun, BenchError> {
    let image_hash = hash(image)?;
    let config = Config::default();
    let options = CellOptions {
        faults: cable::faults(case.disturbance.network),
        seed: CellOptions::default().seed ^ plan.seed,
        ..CellOptions::default()
    };
    let cable = Cable::new(Cell::new(&config, options));
    let milliseconds = u32::try_from(plan.cycles.div_ceil(case.rate_khz.into())).unwrap_or(u32::MAX);
    let settle_ms = SETTLE_MS + (plan.seed % SETTLE_BY_SEED_MS) as u32;
    let peer = Peer::new(config, case.disturbance, plan.seed, settle_ms, milliseconds);
    let peer = Arc::new(Mutex::new(peer));
    let emulator_options = EmulatorOptions {
        instruction_shift: plan.instruction_shift,
        // The log is only a load here; it is not decoded.
        decode_log: !case.disturbance.log,
        answer_within: ANSWER_WITHIN,
        ..EmulatorOptions::default()
    };
    let failed = |cause: String| BenchError::Program {
        program: format!("the firmware in the emulator, {}", rows::name(case)),
        cause,
    };
    let emulator = Emulator::start(image, &emulator_options, cable, Arc::clone(&peer), |_| {})
        .map_err(|error| failed(error.to_string()))?;
    let mut tenths = 0;
    let outcome = loop {
        let (outcome, measured_ms) = {
            let mut peer = peer.lock().unwrap_or_else(PoisonError::into_inner);
            (peer.take_outcome(), peer.measured_ms())
        };
        if outcome.is_some() || !emulator.is_running() {
            break outcome;
        }
        let done = u64::from(measured_ms) * 10 / u64::from(milliseconds.max(1));
        if done > tenths {
            tenths = done;
            progress(&format!("{} %", tenths * 10));
        }
        std::thread::sleep(LOOK);
    };
    let ended = emulator.stop();
    match outcome {
        Some(Outcome::Measured { readings, counters }) => Ok(LatencyRun {
            case,
            image: image_hash,
            readings,
            counters,
        }),
        Some(Outcome::Failed(cause)) => Err(failed(cause)),
        None => Err(failed(match ended {
            Err(error) => error.to_string(),
            Ok(_) => "it ended before it was measured".to_owned(),
        })),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_of_disturbances_is_read_and_a_wrong_word_named() {
        let read = |list: &str| list.parse::<Disturbance>();
        assert_eq!(read("none"), Ok(Disturbance::default()));
        assert_eq!(read("all"), Ok(Disturbance::ALL));
        assert_eq!(read("serial,planner,log,network"), Ok(Disturbance::ALL));
        assert_eq!(read("log").map(Disturbance::bits), Ok(disturbance::LOG));
        assert!(read("flood").is_err_and(|message| message.contains("flood")));
    }

    fn plan(disturbance: Disturbance) -> LatencyPlan {
        LatencyPlan {
            cycles: 5_000,
            disturbance,
            at_rest: false,
            isolation: Isolation::Basepri,
            rate_khz: 1,
            instruction_shift: 3,
            seed: 0,
        }
    }

    #[test]
    fn the_cases_of_a_plan_are_idle_loaded_without_isolation_and_faster_ones_without_a_path() {
        let case = |disturbance, isolation, rate_khz| Case {
            disturbance,
            isolation,
            rate_khz,
        };
        let idle = case(Disturbance::default(), Isolation::Basepri, 1);
        let loaded = case(Disturbance::ALL, Isolation::Basepri, 1);
        assert_eq!(cases(&plan(Disturbance::default())), [idle]);
        assert_eq!(cases(&plan(Disturbance::ALL)), [loaded]);
        let whole = LatencyPlan {
            at_rest: true,
            isolation: Isolation::Primask,
            rate_khz: 4,
            ..plan(Disturbance::ALL)
        };
        let pathless = Disturbance {
            planner: false,
            ..Disturbance::ALL
        };
        let expected = [
            idle,
            loaded,
            case(Disturbance::ALL, Isolation::Primask, 1),
            case(pathless, Isolation::Basepri, 2),
            case(pathless, Isolation::Basepri, 4),
        ];
        assert_eq!(cases(&whole), expected);
    }

    #[test]
    fn a_measurement_whose_image_changed_meanwhile_is_refused() {
        let case = cases(&plan(Disturbance::ALL))[0];
        let run = LatencyRun {
            case,
            image: "fnv1a64:1".to_owned(),
            readings: Readings::default(),
            counters: Counters::default(),
        };
        assert!(check_unchanged(std::slice::from_ref(&run), &[(case, run.image.clone())]).is_ok());
        let refused = check_unchanged(&[run], &[(case, "fnv1a64:2".to_owned())]).expect_err("another image");
        assert!(refused.to_string().contains("measure again"), "{refused}");
    }

    /// Two runs of the loaded firmware.
    #[test]
    fn under_every_disturbance_no_cycle_is_late_or_lost_and_the_release_waits_for_one_run_at_most() {
        setup::ensure_qemu().expect("the emulator can be had");
        let plan = plan(Disturbance::ALL);
        let image = setup::build_firmware("emulated").expect("the firmware builds");
        let case = |disturbance| Case {
            disturbance,
            isolation: Isolation::Basepri,
            rate_khz: 1,
        };
        let quiet = Disturbance {
            network: false,
            ..Disturbance::ALL
        };
        for (disturbance, jitter_max) in [(quiet, 5.0), (Disturbance::ALL, rows::JITTER_FOREIGN_MAX_INSTRUCTIONS)] {
            let measured = measure_image(&image, &plan, case(disturbance), &mut |_| {}).expect("the firmware runs");
            assert_eq!(rows::late(&measured), 0, "{disturbance:?}");
            assert_eq!(measured.counters.frames_lost, 0, "{disturbance:?}");
            assert_eq!(measured.counters.working_counter_errors, 0, "{disturbance:?}");
            assert!(
                u64::from(measured.counters.cycles) >= plan.cycles,
                "{:?}",
                measured.counters
            );
            let jitter = rows::jitter_instructions(&measured, plan.instruction_shift).expect("releases were measured");
            assert!(jitter <= jitter_max, "{disturbance:?}: {jitter} instructions");
        }
    }
}
