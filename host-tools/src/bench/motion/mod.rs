//! The planner compared with its peers: durations, peaks, planning times; and the cost of a period on the emulated
//! Cortex-M7.
//!
//! Every path is planned twice: under the joints' limits alone (25 rad/s, 250 rad/s2), and with 1 m/s and 10 m/s2 for
//! the platform as well (`PATH@10`); 0.1 mm tolerance, without the moving average, which no peer has. The optimum is
//! copp's TOPP2-RA on the curve that the planner shapes. The samples' paths are also planned on the usual machine of every
//! other kind of robot, under its joints' limits alone (`PATH@KIND`). Klipper's and grbl's formulas run on the polyline: `raw` with
//! these limits, and with limits reduced until their 1 ms references keep the given ones.

mod junction;
mod paths;

use super::programs::{self, Machine, OPTIMUM};
use super::{BenchError, BenchReport, BenchRow, Selection};
use crate::planning::{Analysis, Findings, plan};
use etherpen::config::Config;
use etherpen::motion::{Pen, Settings, Vertex};
use etherpen::robots::vector::{Vector, length, subtract};
use etherpen::robots::{Kind, Kinematics};
use junction::{Rule, Task};
use paths::Named;
use std::fmt::Write;

/// Largest ratio of the planner's duration to the optimum's.
const OPTIMUM_RATIO_MAX: f64 = 1.01;
/// Largest ratio of the planner's duration to the best legal peer's.
const PEER_RATIO_MAX: f64 = 1.0;
/// Largest ratio of a 1 ms reference to its limit.
const PEAK_RATIO_MAX: f64 = 1.001;
/// Most instructions of a period: a third of 12 ms at 480 MHz with 2.2 cycles each.
const PERIOD_INSTRUCTIONS_MAX: f64 = 900_000.0;

/// The limits of one comparison.
#[derive(Clone, Copy)]
struct LimitSet {
    /// Suffix of the path's name.
    suffix: &'static str,
    speed_mm_s: f64,
    acceleration_mm_s2: f64,
}

const LIMIT_SETS: [LimitSet; 2] = [
    LimitSet {
        suffix: "",
        speed_mm_s: 1.0e5,
        acceleration_mm_s2: 1.0e7,
    },
    LimitSet {
        suffix: "@10",
        speed_mm_s: 1_000.0,
        acceleration_mm_s2: 10_000.0,
    },
];
/// Tolerance of all comparisons, mm.
const TOLERANCE_MM: f64 = 0.1;

impl LimitSet {
    fn config(self, kind: Kind) -> Config {
        let Settings {
            geometry,
            work_area,
            paper,
            motion,
            ..
        } = Settings::usual(kind.geometry());
        let mut config = Config {
            geometry,
            work_area,
            paper,
            motion,
            ..Config::default()
        };
        let motion = &mut config.motion;
        (motion.speed_mm_s, motion.travel_speed_mm_s) = (self.speed_mm_s, self.speed_mm_s);
        motion.acceleration_mm_s2 = self.acceleration_mm_s2;
        (motion.tolerance_mm, motion.travel_tolerance_mm) = (TOLERANCE_MM, TOLERANCE_MM);
        motion.jerk_window_ms = 0;
        config
    }
}

/// Measures the selected rows; `quick` leaves out generated paths, the second set of limits and the emulator.
///
/// # Errors
/// The first failure.
pub fn run(selection: &Selection, quick: bool, mut progress: impl FnMut(&str)) -> Result<BenchReport, BenchError> {
    let mut paths = paths::samples()?;
    if !quick {
        paths.extend(paths::generated());
    }
    let sets = if quick { &LIMIT_SETS[..1] } else { &LIMIT_SETS[..] };
    let mut tasks = Vec::new();
    for set in sets {
        let config = set.config(Kind::default());
        let named = |path: &Named| {
            (
                format!("{}{}", path.name, set.suffix),
                path.vertices.clone(),
                config.clone(),
            )
        };
        tasks.extend(paths.iter().map(named));
    }
    for kind in Kind::ALL.into_iter().filter(|kind| *kind != Kind::default()) {
        let config = LIMIT_SETS[0].config(kind);
        for path in paths::samples()? {
            let name = format!("{}@{}", path.name, kind.name());
            tasks.push((name, paths::fitted(&path.vertices, &config.paper), config.clone()));
        }
    }
    let mut rows = Vec::new();
    let mut built = false;
    for (name, vertices, config) in &tasks {
        if !wants_any(selection, name) {
            continue;
        }
        if selection.wants_subject("copp") && !built {
            progress("building the optimum");
            programs::build(Machine::Host, &[OPTIMUM])?;
            built = true;
        }
        progress(&format!("planning {name}"));
        rows.extend(compare(name, vertices, config, built)?);
    }
    if !quick && selection.wants(PLANNER, "etherpen") {
        progress("building the planner for the emulator");
        programs::build(Machine::CortexM7, &["motion_m7"])?;
        progress("counting in the emulator");
        rows.extend(periods(&programs::emulate("motion_m7")?)?);
    }
    rows.retain(|row| selection.wants(&row.case, row.subject));
    Ok(BenchReport { bench: "motion", rows })
}

const PLANNER: &str = "planner_worst_instructions@cortex-m7";
const CASES: [&str; 6] = [
    "duration_s",
    "optimum_ratio",
    "peer_ratio",
    "peak_ratio",
    "duration_raw_s",
    "planning_s",
];

fn wants_any(selection: &Selection, name: &str) -> bool {
    CASES.iter().any(|case| selection.wants_case(&format!("{case}/{name}")))
}

/// All rows of one path under one set of limits.
fn compare(name: &str, path: &[Vertex], config: &Config, with_optimum: bool) -> Result<Vec<BenchRow>, BenchError> {
    let mut rows = Vec::new();
    let mut row = |case: &str, subject, value, unit, target| {
        rows.push(BenchRow {
            case: format!("{case}/{name}"),
            subject,
            value,
            unit,
            target,
        });
    };
    let own = own(name, path, config)?;
    let optimum = if with_optimum {
        Some(optimum(path, config)?)
    } else {
        None
    };
    let kinematics = Kinematics::new(&config.geometry).map_err(|cause| failed(name, format!("{cause:?}")))?;
    let points: Vec<Vector> = path.iter().map(|vertex| vertex.position.into()).collect();
    let task = Task::new(config, &kinematics, &points);
    let peers = Rule::ALL.map(|rule| (rule, task.raw(rule), task.tuned(rule)));
    let best = peers
        .iter()
        .filter_map(|(_, _, tuned)| tuned.map(|tuned| tuned.duration_s))
        .fold(f64::INFINITY, f64::min);
    let target = optimum.as_ref().map(|optimum| OPTIMUM_RATIO_MAX * optimum.duration_s);
    row("duration_s", "etherpen", own.duration_s, "s", target);
    if let Some(optimum) = &optimum {
        row("duration_s", "copp", optimum.duration_s, "s", None);
    }
    for (rule, _, tuned) in &peers {
        if let Some(tuned) = tuned {
            row("duration_s", rule.name(), tuned.duration_s, "s", None);
        }
    }
    if let Some(optimum) = &optimum {
        let ratio = own.duration_s / optimum.duration_s;
        row("optimum_ratio", "etherpen", ratio, "of copp's", Some(OPTIMUM_RATIO_MAX));
    }
    row(
        "peer_ratio",
        "etherpen",
        own.duration_s / best,
        "of best peer",
        Some(PEER_RATIO_MAX),
    );
    row(
        "peak_ratio",
        "etherpen",
        own.peak_ratio,
        "of limit",
        Some(PEAK_RATIO_MAX),
    );
    for (rule, raw, _) in &peers {
        row("peak_ratio", rule.name(), raw.peak_ratio, "of limit", None);
    }
    for (rule, raw, _) in &peers {
        row("duration_raw_s", rule.name(), raw.duration_s, "s", None);
    }
    if let Some(optimum) = &optimum {
        row("planning_s", "etherpen", optimum.own_planning_s, "s", None);
        row("planning_s", "copp", optimum.planning_s, "s", None);
    }
    Ok(rows)
}

fn failed(program: &str, cause: impl std::fmt::Display) -> BenchError {
    BenchError::Program {
        program: program.to_owned(),
        cause: cause.to_string(),
    }
}

/// Figures of this project's planner.
struct Own {
    duration_s: f64,
    peak_ratio: f64,
}

fn own(name: &str, path: &[Vertex], config: &Config) -> Result<Own, BenchError> {
    let mut analysis = Analysis::new(config, path, 0);
    let mut points: Vec<Vector> = Vec::new();
    let run = plan(config, path, |sample, _| {
        analysis.observe(sample);
        points.push(sample.point);
    })
    .map_err(|cause| failed(name, cause))?;
    let findings = analysis.finish(&run);
    if let Some(violation) = findings
        .violations
        .iter()
        .find(|violation| violation.limit_of.contains("tolerance"))
    {
        return Err(failed(name, format!("the path is left: {violation:?}")));
    }
    points.truncate(run.duration_ms as usize + 1);
    Ok(Own {
        duration_s: run.duration_ms as f64 * 1.0e-3 - unused_s(&points),
        peak_ratio: peak_ratio(&findings),
    })
}

/// Part of the last millisecond in which the motion is already at rest, s. The motion ends with constant deceleration,
/// so the remaining distance grows with the square of the time.
fn unused_s(points: &[Vector]) -> f64 {
    let [.., before, last, end] = points else { return 0.0 };
    let (two, one) = (
        length(&subtract(end, before)).sqrt(),
        length(&subtract(end, last)).sqrt(),
    );
    let needed = one / (two - one);
    if needed.is_finite() {
        1.0e-3 * (1.0 - needed).clamp(0.0, 1.0)
    } else {
        0.0
    }
}

fn peak_ratio(findings: &Findings) -> f64 {
    let (peaks, limits) = (&findings.peaks, &findings.limits);
    let axes = |peaks: &[f64], limits: &[f64]| {
        peaks
            .iter()
            .zip(limits)
            .map(|(peak, limit)| peak / limit)
            .fold(0.0, f64::max)
    };
    [
        axes(&peaks.joint_speed_rad_s, &limits.joint_speed_rad_s),
        axes(&peaks.joint_acceleration_rad_s2, &limits.joint_acceleration_rad_s2),
        peaks.speed_mm_s / limits.speed_mm_s,
        peaks.travel_speed_mm_s / limits.travel_speed_mm_s,
        peaks.acceleration_mm_s2 / limits.acceleration_mm_s2,
    ]
    .into_iter()
    .fold(0.0, f64::max)
}

/// Result of the program with copp.
struct Optimum {
    duration_s: f64,
    planning_s: f64,
    own_planning_s: f64,
}

fn optimum(path: &[Vertex], config: &Config) -> Result<Optimum, BenchError> {
    let motion = &config.motion;
    let [speed_a, speed_b, speed_c, _] = motion.joint_speed_rad_s;
    let [acceleration_a, acceleration_b, acceleration_c, _] = motion.joint_acceleration_rad_s2;
    let mut input = format!(
        "{}\n{speed_a} {speed_b} {speed_c} {acceleration_a} {acceleration_b} {acceleration_c} {} {} {}\n",
        config.geometry.kind().name(),
        motion.speed_mm_s,
        motion.acceleration_mm_s2,
        motion.tolerance_mm
    );
    for vertex in path {
        let [x, y, z] = Vector::from(vertex.position);
        // Writing into a string cannot fail.
        let _ = writeln!(input, "{x} {y} {z} {}", u8::from(vertex.pen == Pen::Down));
    }
    let lines = programs::answer(OPTIMUM, &input)?;
    let find = |figure: &str, subject: &str| {
        lines
            .lines()
            .find_map(|line| {
                line.strip_prefix(figure)?
                    .trim_start()
                    .strip_prefix(subject)?
                    .trim()
                    .parse()
                    .ok()
            })
            .ok_or_else(|| failed(OPTIMUM, format!("it printed no {figure} of {subject}:\n{lines}")))
    };
    Ok(Optimum {
        duration_s: find("duration_s", "copp")?,
        planning_s: find("planning_s", "copp")?,
        own_planning_s: find("planning_s", "etherpen")?,
    })
}

/// The worst period of all loads, and the worst of each load.
fn periods(lines: &str) -> Result<Vec<BenchRow>, BenchError> {
    let row = |case: String, value: f64| BenchRow {
        case,
        subject: "etherpen",
        value,
        unit: "instructions",
        target: Some(PERIOD_INSTRUCTIONS_MAX),
    };
    let loads: Vec<BenchRow> = lines
        .lines()
        .filter_map(|line| {
            let mut words = line.split_whitespace();
            let (name, subject, worst) = (words.next()?, words.next()?, words.next()?);
            (subject == "etherpen").then_some(())?;
            Some(row(format!("{PLANNER}/{name}"), worst.parse().ok()?))
        })
        .collect();
    let worst = loads.iter().map(|row| row.value).fold(0.0, f64::max);
    if worst <= 0.0 {
        return Err(failed("motion_m7", format!("it printed no numbers:\n{lines}")));
    }
    Ok(std::iter::once(row(PLANNER.into(), worst)).chain(loads).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_millisecond_counts_as_far_as_it_moves() {
        let at = |left_s: f64| [0.5 * 100.0 * left_s * left_s, 0.0, 0.0];
        let points = [at(2.4e-3), at(1.4e-3), at(0.4e-3), [0.0; 3]];
        assert!((unused_s(&points) - 0.6e-3).abs() < 1.0e-12);
        assert_eq!(unused_s(&points[3..]), 0.0);
    }

    #[test]
    fn the_planner_beats_both_peers_at_the_same_limits() {
        let samples = paths::samples().unwrap();
        let square = &samples[0];
        let rows = compare("square", &square.vertices, &LIMIT_SETS[0].config(Kind::Delta), false).unwrap();
        for row in rows.iter().filter(|row| row.subject == "etherpen") {
            assert_ne!(row.met(), Some(false), "{row:?}");
        }
        for (case, subject) in [("duration_s/square", "klipper"), ("peak_ratio/square", "grbl")] {
            assert!(rows.iter().any(|row| row.case == case && row.subject == subject));
        }
    }

    #[test]
    fn the_worst_load_is_the_planners_figure() {
        let rows = periods("square etherpen 1200 300 4\ntext etherpen 4000 200 9\n").unwrap();
        assert_eq!((rows[0].case.as_str(), rows[0].value), (PLANNER, 4000.0));
        assert_eq!(rows.len(), 3);
        assert!(periods("nothing\n").is_err());
    }
}
