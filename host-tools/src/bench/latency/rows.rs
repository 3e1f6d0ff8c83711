//! Converts histograms and counters into figures with their bounds.
//!
//! Invariant: every bound is checked against the largest value that occurred, never against a mean or a quantile.

use super::{Case, Disturbance, Isolation, LatencyPlan, LatencyRun};
use crate::bench::BenchRow;
use crate::link::measurement::{Distribution, Readings};
use etherpen::measurement::Quantity;
use serde::Serialize;

/// Most instructions by which a release may move with foreign frames on the wire: one run of `bus_frame`.
pub(super) const JITTER_FOREIGN_MAX_INSTRUCTIONS: f64 = 1_500.0;
/// Most instructions of all critical tasks in a millisecond.
const CRITICAL_PATH_MAX_INSTRUCTIONS: f64 = 4_000.0;
/// Most instructions of the trajectory task in a release.
const PLANNER_MAX_INSTRUCTIONS: f64 = 900_000.0;
/// Share of the period after which an output telegram that the MAC does not have is late: 500 us at 1 kHz.
const LATE_SHARE: f64 = 0.5;
/// Time between two releases, in periods, beyond which a release counts as missed.
const LEFT_OUT: f64 = 1.5;
const NS_PER_MS: f64 = 1e6;
const NS_PER_S: f64 = 1e9;

/// A measured distribution, ready to plot.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Curve {
    /// The run.
    pub label: String,
    /// The quantity: `total_delay`, `send_delay`, `round_trip`, `release_delay`.
    pub quantity: &'static str,
    /// A time, ns, and the fraction of the requests not serviced within it.
    pub points: Vec<(f64, f64)>,
}

/// The figures and the curves.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LatencyReport {
    /// Always `latency`.
    pub bench: &'static str,
    /// The figures.
    pub rows: Vec<BenchRow>,
    /// Instructions in a microsecond of virtual time.
    pub instructions_per_us: f64,
    /// Whether every figure with a target meets it.
    pub passed: bool,
    /// The distributions of every run.
    pub curves: Vec<Curve>,
}

/// Name of the run, for display and as a suffix of its figures.
pub(crate) fn name(case: Case) -> String {
    let Disturbance {
        serial,
        planner,
        log,
        network,
    } = case.disturbance;
    let named = [
        (serial, "serial"),
        (planner, "planner"),
        (log, "log"),
        (network, "network"),
    ];
    let words: Vec<&str> = named.iter().filter(|(on, _)| *on).map(|(_, word)| *word).collect();
    let mut name = if words.is_empty() {
        "idle".to_owned()
    } else {
        words.join("+")
    };
    if case.isolation == Isolation::Primask {
        name.push_str(", primask");
    }
    if case.rate_khz > 1 {
        name.push_str(&format!(", {} kHz", case.rate_khz));
    }
    name
}

fn ns(distribution: &Distribution, counts: f64) -> f64 {
    counts * NS_PER_S / f64::from(distribution.counts_per_s)
}

fn period_ns(case: Case) -> f64 {
    NS_PER_MS / f64::from(case.rate_khz)
}

/// Cycles with late output, plus missed releases.
pub(crate) fn late(measured: &LatencyRun) -> u64 {
    let above = |quantity, limit_ns: f64| {
        measured.readings.of(quantity).map_or(0, |distribution| {
            let limit = limit_ns * f64::from(distribution.counts_per_s) / NS_PER_S;
            distribution.above(limit as u32)
        })
    };
    let period_ns = period_ns(measured.case);
    let seen = above(Quantity::TotalDelay, LATE_SHARE * period_ns) + above(Quantity::Period, LEFT_OUT * period_ns);
    seen.max(measured.counters.cycles_late.into())
}

/// Range by which the releases moved, instructions; at the resolution of the board's counter.
pub(crate) fn jitter_instructions(measured: &LatencyRun, shift: u8) -> Option<f64> {
    let delay = measured.readings.of(Quantity::ReleaseDelay)?;
    Some(instructions(delay, delay.largest - delay.smallest, shift))
}

fn instructions(distribution: &Distribution, counts: u32, shift: u8) -> f64 {
    ns(distribution, counts.into()) / f64::from(1_u32 << shift)
}

/// Most instructions by which the release may move.
fn jitter_target(measured: &LatencyRun, shift: u8) -> Option<f64> {
    let delay = measured.readings.of(Quantity::ReleaseDelay)?;
    let protected = measured.case.isolation == Isolation::Basepri && measured.case.rate_khz == 1;
    protected.then(|| match measured.case.disturbance.network {
        true => JITTER_FOREIGN_MAX_INSTRUCTIONS,
        false => instructions(delay, 1, shift),
    })
}

/// Suffix of a run's figures; empty for the requested run.
fn suffix(plan: &LatencyPlan, case: Case) -> String {
    if case.rate_khz > 1 {
        return format!("/{}khz", case.rate_khz);
    }
    if case.disturbance == plan.disturbance && case.isolation == plan.isolation {
        return String::new();
    }
    if case.disturbance == Disturbance::default() {
        return "/idle".to_owned();
    }
    "/basepri".to_owned()
}

/// Figures of one run.
fn run_rows(plan: &LatencyPlan, measured: &LatencyRun, rows: &mut Vec<BenchRow>) {
    let shift = plan.instruction_shift;
    let suffix = suffix(plan, measured.case);
    let protected = measured.case.isolation == Isolation::Basepri;
    let asked = protected && measured.case.rate_khz == 1;
    let zero = protected.then_some(0.0).filter(|_| measured.case.rate_khz == 1);
    let mut row = |case: &str, value: f64, unit, target: Option<f64>| {
        rows.push(BenchRow {
            case: format!("{case}{suffix}"),
            subject: "etherpen",
            value,
            unit,
            target,
        });
    };
    let readings = &measured.readings;
    let cycles = readings.of(Quantity::ReleaseDelay).map_or(0, Distribution::count);
    row("cycles", cycles as f64, "cycles", None);
    row("cycles_late", late(measured) as f64, "cycles", zero);
    row("frames_lost", measured.counters.frames_lost.into(), "frames", zero);
    if let Some(jitter) = jitter_instructions(measured, shift) {
        row(
            "release_jitter_max_instructions",
            jitter,
            "instructions",
            jitter_target(measured, shift),
        );
    }
    execution_rows(readings, shift, asked, &mut row);
    delay_rows(readings, &mut row);
    // Counted from its lateness: 0 if none was late.
    if let Some(lateness) = readings.of(Quantity::Lateness) {
        row("lateness_max_ns", ns(lateness, lateness.largest.into()), "ns", None);
    }
    if let Some(load) = readings.cpu_load() {
        row("cpu_load", load, "1", None);
    }
    for (case, count) in [
        ("frames_ignored", measured.counters.frames_ignored),
        ("link_errors", measured.counters.link_errors),
        ("trajectory_overruns", measured.counters.trajectory_overruns),
        ("telemetry_dropped", measured.counters.telemetry_dropped),
    ] {
        row(case, count.into(), "1", None);
    }
}

/// Adds one row: case, value, unit, target.
type AddRow<'a> = dyn FnMut(&str, f64, &'static str, Option<f64>) + 'a;

/// Execution times. The targets hold for the requested runs at 1 kHz.
fn execution_rows(readings: &Readings, shift: u8, asked: bool, row: &mut AddRow) {
    let executions = [
        (
            "critical_path_max_instructions",
            Quantity::CriticalPath,
            Some(CRITICAL_PATH_MAX_INSTRUCTIONS),
        ),
        ("sample_max_instructions", Quantity::Sample, None),
        ("bus_frame_max_instructions", Quantity::BusFrame, None),
        ("bus_deadline_max_instructions", Quantity::BusDeadline, None),
        (
            "planner_max_instructions",
            Quantity::Trajectory,
            Some(PLANNER_MAX_INSTRUCTIONS),
        ),
    ];
    for (case, quantity, target) in executions {
        if let Some(distribution) = readings.of(quantity) {
            let target = target.filter(|_| asked);
            let mean = ns(distribution, 1.0) / f64::from(1_u32 << shift) * distribution.mean();
            row(&case.replace("_max_", "_mean_"), mean.round(), "instructions", None);
            row(
                case,
                instructions(distribution, distribution.largest, shift),
                "instructions",
                target,
            );
        }
    }
}

/// Delays within a cycle.
fn delay_rows(readings: &Readings, row: &mut AddRow) {
    let delays = [
        ("release_delay_max_ns", Quantity::ReleaseDelay),
        ("send_delay_max_ns", Quantity::SendDelay),
        ("round_trip_max_ns", Quantity::RoundTrip),
        ("total_delay_max_ns", Quantity::TotalDelay),
    ];
    for (case, quantity) in delays {
        if let Some(distribution) = readings.of(quantity) {
            row(case, ns(distribution, distribution.largest.into()), "ns", None);
        }
    }
}

fn curves(measured: &LatencyRun, curves: &mut Vec<Curve>) {
    let quantities = [
        ("total_delay", Quantity::TotalDelay),
        ("send_delay", Quantity::SendDelay),
        ("round_trip", Quantity::RoundTrip),
        ("release_delay", Quantity::ReleaseDelay),
    ];
    for (quantity, of) in quantities {
        if let Some(distribution) = measured.readings.of(of) {
            let exceeded = distribution.exceeded();
            curves.push(Curve {
                label: name(measured.case),
                quantity,
                points: exceeded
                    .iter()
                    .map(|(counts, fraction)| (ns(distribution, f64::from(*counts)), *fraction))
                    .collect(),
            });
        }
    }
}

/// All figures and curves.
pub(super) fn report(plan: &LatencyPlan, runs: &[LatencyRun]) -> LatencyReport {
    let (mut rows, mut all) = (Vec::new(), Vec::new());
    // The requested run comes first.
    let order = |measured: &&LatencyRun| !suffix(plan, measured.case).is_empty();
    let mut ordered: Vec<&LatencyRun> = runs.iter().collect();
    ordered.sort_by_key(order);
    for measured in ordered {
        run_rows(plan, measured, &mut rows);
    }
    for measured in runs {
        curves(measured, &mut all);
    }
    if plan.rate_khz > 1 {
        let in_time = runs.iter().filter(|measured| late(measured) == 0);
        let highest = in_time.map(|measured| measured.case.rate_khz).max().unwrap_or(0);
        rows.push(BenchRow {
            case: "loop_rate_max_khz".to_owned(),
            subject: "etherpen",
            value: highest.into(),
            unit: "kHz",
            target: None,
        });
    }
    LatencyReport {
        bench: "latency",
        passed: rows.iter().all(|row| row.met() != Some(false)),
        rows,
        instructions_per_us: 1_000.0 / f64::from(1_u32 << plan.instruction_shift),
        curves: all,
    }
}
