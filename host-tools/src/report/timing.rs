//! The firmware's own time measurements in the report.
//!
//! Invariant: instructions are only given where they are counted, in the emulator in lockstep. In other runs, and in
//! virtual time without a processor, they are `null`.

use crate::link::measurement::{Distribution, Readings};
use etherpen::measurement::Quantity;
use serde::Serialize;

const NS_PER_S: f64 = 1e9;

/// Four figures of a distribution; a quantile is the upper end of the histogram's bin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Smallest value.
    pub min: f64,
    /// Median.
    pub median: f64,
    /// Upper bound of 999 of 1,000 values.
    pub p999: f64,
    /// Largest value.
    pub max: f64,
}

/// Delay of the releases of `sample`, relative to the earliest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Jitter {
    /// Upper bound of half of the releases, ns.
    pub p50: f64,
    /// Upper bound of 999 of 1,000 releases, ns.
    pub p999: f64,
    /// The latest release, ns.
    pub max: f64,
}

/// Execution times, load and jitter since the bus came up; `null` where nothing was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Timing {
    /// Instructions of the task `sample`, without the lockstep.
    pub sample_instructions: Option<Spread>,
    /// Instructions of all critical tasks in a millisecond.
    pub critical_path_instructions: Option<Spread>,
    /// Instructions of the trajectory task in a release, without the tasks that preempted it.
    pub planner_instructions: Option<Spread>,
    /// Duration of all critical tasks in a millisecond, ns.
    pub critical_path_ns: Option<Spread>,
    /// Duration of a release of the trajectory task, without the tasks that preempted it, ns.
    pub planner_ns: Option<Spread>,
    /// Share of the time in which the core did not sleep, 0 to 1.
    pub cpu_load: Option<f64>,
    /// Jitter of the releases.
    pub release_jitter_ns: Option<Jitter>,
}

impl Timing {
    /// The figures of a board; `ns_per_instruction` if its time is counted in instructions.
    pub fn new(readings: &Readings, ns_per_instruction: Option<f64>) -> Self {
        let instructions = |quantity| {
            let ns = ns_per_instruction?;
            readings.of(quantity).map(|distribution| spread(distribution, ns))
        };
        let durations = |quantity| readings.of(quantity).map(|distribution| spread(distribution, 1.0));
        Self {
            sample_instructions: instructions(Quantity::Sample),
            critical_path_instructions: instructions(Quantity::CriticalPath),
            planner_instructions: instructions(Quantity::Trajectory),
            critical_path_ns: durations(Quantity::CriticalPath),
            planner_ns: durations(Quantity::Trajectory),
            cpu_load: readings.cpu_load(),
            release_jitter_ns: readings.of(Quantity::ReleaseDelay).map(jitter),
        }
    }
}

fn ns(distribution: &Distribution, counts: u32) -> f64 {
    f64::from(counts) * NS_PER_S / f64::from(distribution.counts_per_s)
}

fn spread(distribution: &Distribution, unit_ns: f64) -> Spread {
    let value = |counts| ns(distribution, counts) / unit_ns;
    Spread {
        min: value(distribution.smallest),
        median: value(distribution.quantile(0.5)),
        p999: value(distribution.quantile(0.999)),
        max: value(distribution.largest),
    }
}

fn jitter(distribution: &Distribution) -> Jitter {
    let moved = |counts: u32| ns(distribution, counts - distribution.smallest);
    Jitter {
        p50: moved(distribution.quantile(0.5)),
        p999: moved(distribution.quantile(0.999)),
        max: moved(distribution.largest),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::measurement::Reader;
    use etherpen::measurement::Measurements;

    fn readings(measurements: &Measurements) -> Readings {
        let mut reader = Reader::new();
        while let Some(request) = reader.request() {
            reader.take(&measurements.answer(request));
        }
        reader.into_readings().expect("everything was read")
    }

    #[test]
    fn counts_become_instructions_and_nanoseconds() {
        let measurements = Measurements::new();
        measurements.set_counts_per_s(25_000_000);
        for counts in [10, 12, 11] {
            measurements.record(Quantity::Sample, counts);
            measurements.record(Quantity::ReleaseDelay, counts);
        }
        let timing = Timing::new(&readings(&measurements), Some(8.0));
        let sample = timing.sample_instructions.expect("it was measured");
        assert_eq!((sample.min, sample.median, sample.max), (50.0, 55.0, 60.0));
        let jitter = timing.release_jitter_ns.expect("it was measured");
        assert_eq!((jitter.p50, jitter.max), (40.0, 80.0));
        assert_eq!(timing.planner_instructions, None);
    }

    #[test]
    fn a_run_that_measures_nothing_has_nothing_to_report() {
        let nothing = readings(&Measurements::new());
        assert_eq!(Timing::new(&nothing, None), Timing::default());
    }
}
