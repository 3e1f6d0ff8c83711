//! Analysis of a planned path: peaks, violations of limits, deviation.
//!
//! Speeds, accelerations and jerks are differences of the 1 ms references, which are what the drives are commanded.

use super::track::Track;
use super::{PlannedSample, Run};
use etherpen::config::{Config, MotionLimits};
use etherpen::motion::{PERIOD_MS, Pen, Vertex, shaper_deviation_mm};
use etherpen::robots::AXES;
use etherpen::robots::vector::{Vector, length, subtract};
use serde::Serialize;

/// Relative excess over a limit that is tolerated.
const EXCESS: f64 = 1.0e-3;
/// Most violations listed; all are counted.
const LISTED_MAX: usize = 1_000;
/// One millisecond, s.
const TICK_S: f64 = 1.0e-3;
/// Difference of heights that counts as zero, mm.
const LEVEL_MM: f64 = 1.0e-6;
/// Rounding of the forward kinematics in an acceleration, mm/s2.
const ROUNDING_MM_S2: f64 = 0.1;

const _: () = assert!(
    PERIOD_MS > 3,
    "a run ends with enough references at rest for the last differences"
);

/// The limits in use.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Limits {
    /// Speed of each axis, rad/s.
    pub joint_speed_rad_s: [f64; AXES],
    /// Acceleration of each axis, rad/s2.
    pub joint_acceleration_rad_s2: [f64; AXES],
    /// Jerk of each axis, rad/s3: twice the acceleration over the moving average's length; absent without an average.
    pub joint_jerk_rad_s3: Option<[f64; AXES]>,
    /// Path speed with the pen down, mm/s.
    pub speed_mm_s: f64,
    /// Path speed with the pen up, mm/s.
    pub travel_speed_mm_s: f64,
    /// Acceleration of the platform, mm/s2.
    pub acceleration_mm_s2: f64,
    /// Vertical speed where the pen is lifted or lowered, mm/s; absent if only the limits of all motion apply.
    pub pen_speed_mm_s: Option<f64>,
    /// Vertical acceleration where the pen is lifted or lowered, mm/s2; absent if only the limits of all motion apply.
    pub pen_acceleration_mm_s2: Option<f64>,
    /// Distance from the path with the pen down, mm.
    pub tolerance_mm: f64,
    /// Distance from the path with the pen up, mm.
    pub travel_tolerance_mm: f64,
    /// Distance from the path beside the tolerance, mm: where an input shaper leads the setpoints of a tool that swings
    /// outward. 0 without one.
    pub shaper_deviation_mm: f64,
    /// Length of the planner's moving average, ms.
    pub jerk_window_ms: u16,
}

impl Limits {
    fn new(motion: &MotionLimits, jerk_window_ms: u16) -> Self {
        let given = |limit: f64| (limit > 0.0).then_some(limit);
        let jerk = |acceleration: f64| 2.0 * acceleration / (f64::from(jerk_window_ms) * TICK_S);
        Self {
            joint_speed_rad_s: motion.joint_speed_rad_s,
            joint_acceleration_rad_s2: motion.joint_acceleration_rad_s2,
            joint_jerk_rad_s3: (jerk_window_ms > 1).then(|| motion.joint_acceleration_rad_s2.map(jerk)),
            speed_mm_s: motion.speed_mm_s,
            travel_speed_mm_s: motion.travel_speed_mm_s,
            acceleration_mm_s2: motion.acceleration_mm_s2,
            pen_speed_mm_s: given(motion.pen_speed_mm_s),
            pen_acceleration_mm_s2: given(motion.pen_acceleration_mm_s2),
            tolerance_mm: motion.tolerance_mm,
            travel_tolerance_mm: motion.travel_tolerance_mm,
            shaper_deviation_mm: shaper_deviation_mm(motion),
            jerk_window_ms,
        }
    }
}

/// The largest values that occurred.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Peaks {
    /// Speed of each axis, rad/s.
    pub joint_speed_rad_s: [f64; AXES],
    /// Acceleration of each axis, rad/s2.
    pub joint_acceleration_rad_s2: [f64; AXES],
    /// Jerk of each axis, rad/s3.
    pub joint_jerk_rad_s3: [f64; AXES],
    /// Speed of the platform with the pen down, mm/s.
    pub speed_mm_s: f64,
    /// Speed of the platform with the pen up, mm/s.
    pub travel_speed_mm_s: f64,
    /// Acceleration of the platform, mm/s2.
    pub acceleration_mm_s2: f64,
    /// Vertical speed where the pen is lifted or lowered, mm/s.
    pub pen_speed_mm_s: f64,
    /// Vertical acceleration where the pen is lifted or lowered, mm/s2.
    pub pen_acceleration_mm_s2: f64,
    /// Jerk of the platform, mm/s3.
    pub jerk_mm_s3: f64,
}

/// A value over its limit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Violation {
    /// Time; absent if the violation does not belong to one millisecond.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub t_ms: Option<u64>,
    /// The limited quantity.
    pub limit_of: &'static str,
    /// The axis, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis: Option<usize>,
    /// The vertex, from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vertex: Option<usize>,
    /// The value.
    pub value: f64,
    /// The limit.
    pub limit: f64,
}

/// Result of the analysis.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Findings {
    /// Duration from rest at the first vertex to rest at the last, s.
    pub duration_s: f64,
    /// Length of the listed path, mm.
    pub length_mm: f64,
    /// Largest distance of a reference from the path, mm.
    pub deviation_max_mm: f64,
    /// Largest distance of a reference from the path with the pen down, mm.
    pub deviation_drawn_max_mm: f64,
    /// Largest distance of a vertex from the line through the references, mm.
    pub corner_distance_max_mm: f64,
    /// The largest values.
    pub peaks: Peaks,
    /// Their limits.
    pub limits: Limits,
    /// Values over their limits, the first thousand.
    pub violations: Vec<Violation>,
    /// Number of all violations.
    pub violation_count: u64,
    /// Times that path data did not arrive in time.
    pub underruns: u32,
    /// Most points of the planner's grid computed in one period of 12 ms.
    pub planner_points_max: u32,
}

/// Differences of the references up to now.
#[derive(Clone, Copy)]
struct Last {
    pen: Pen,
    velocity: [f64; AXES],
    acceleration: [f64; AXES],
    point: Vector,
    speed: Vector,
    change: Vector,
}

/// Analyses a path's references one after the other.
pub struct Analysis {
    limits: Limits,
    motion: MotionLimits,
    track: Track,
    /// Whether all strokes are level, so that all vertical motion lifts or lowers the pen.
    level: bool,
    peaks: Peaks,
    violations: Vec<Violation>,
    violation_count: u64,
    deviation: [f64; 2],
    last: Option<Last>,
}

impl Analysis {
    /// An analysis under the limits of a configuration; `jerk_window_ms` is the length of the planner's moving average.
    #[must_use]
    pub fn new(config: &Config, path: &[Vertex], jerk_window_ms: u16) -> Self {
        Self {
            limits: Limits::new(&config.motion, jerk_window_ms),
            motion: config.motion,
            track: Track::new(path),
            level: path.windows(2).all(|ends| match ends {
                [from, to] => to.pen == Pen::Up || (to.position.z_mm - from.position.z_mm).abs() < LEVEL_MM,
                _ => true,
            }),
            peaks: Peaks::default(),
            violations: Vec::new(),
            violation_count: 0,
            deviation: [0.0; 2],
            last: None,
        }
    }

    /// Takes the next setpoint.
    pub fn observe(&mut self, sample: &PlannedSample) {
        let setpoint = &sample.setpoint;
        let rest = Last {
            pen: setpoint.pen,
            velocity: [0.0; AXES],
            acceleration: [0.0; AXES],
            point: sample.point,
            speed: [0.0; 3],
            change: [0.0; 3],
        };
        let last = self.last.unwrap_or(rest);
        let t_ms = sample.t_ms;
        let mut here = rest;
        here.velocity = setpoint.velocity_rad_s;
        for axis in 0..AXES {
            let speed = here.velocity[axis];
            let acceleration = (speed - last.velocity[axis]) / TICK_S;
            here.acceleration[axis] = acceleration;
            let jerk = (acceleration - last.acceleration[axis]).abs() / TICK_S;
            raise(&mut self.peaks.joint_speed_rad_s[axis], speed.abs());
            raise(&mut self.peaks.joint_acceleration_rad_s2[axis], acceleration.abs());
            raise(&mut self.peaks.joint_jerk_rad_s3[axis], jerk);
            let limits = &self.limits;
            let checks = [
                ("joint_speed_rad_s", speed.abs(), limits.joint_speed_rad_s[axis]),
                (
                    "joint_acceleration_rad_s2",
                    acceleration.abs(),
                    limits.joint_acceleration_rad_s2[axis],
                ),
                (
                    "joint_jerk_rad_s3",
                    jerk,
                    limits.joint_jerk_rad_s3.map_or(f64::INFINITY, |limit| limit[axis]),
                ),
            ];
            for (limit_of, value, limit) in checks {
                self.check(Some(t_ms), limit_of, Some(axis + 1), None, value, limit);
            }
        }
        here.speed = subtract(&here.point, &last.point).map(|way| way / TICK_S);
        here.change = subtract(&here.speed, &last.speed).map(|change| change / TICK_S);
        self.cartesian(t_ms, &here, &last);
        let deviation = self.track.step(&sample.point, setpoint.vertex as usize);
        let (index, limit_of, limit) = if here.pen == Pen::Down && last.pen == Pen::Down {
            (0, "tolerance_mm", self.limits.tolerance_mm)
        } else {
            (1, "travel_tolerance_mm", self.limits.travel_tolerance_mm)
        };
        raise(&mut self.deviation[index], deviation);
        let limit = limit + self.limits.shaper_deviation_mm;
        self.check(Some(t_ms), limit_of, None, None, deviation, limit);
        self.last = Some(here);
    }

    fn cartesian(&mut self, t_ms: u64, here: &Last, last: &Last) {
        let speed = length(&here.speed);
        let acceleration = length(&here.change);
        raise(&mut self.peaks.acceleration_mm_s2, acceleration);
        raise(
            &mut self.peaks.jerk_mm_s3,
            length(&subtract(&here.change, &last.change)) / TICK_S,
        );
        // The millisecond in which the pen changes belongs to both strokes.
        let drawn = here.pen == Pen::Down && last.pen == Pen::Down;
        if self.level || !drawn {
            let vertical = [here.speed, here.change].map(|[_, _, z]| z.abs());
            let [speed, acceleration] = vertical;
            raise(&mut self.peaks.pen_speed_mm_s, speed);
            raise(&mut self.peaks.pen_acceleration_mm_s2, acceleration);
            let limit = self.limits.pen_speed_mm_s.unwrap_or(f64::INFINITY);
            self.check(Some(t_ms), "pen_speed_mm_s", None, None, speed, limit);
            let limit = self.limits.pen_acceleration_mm_s2.unwrap_or(f64::INFINITY) + ROUNDING_MM_S2;
            self.check(Some(t_ms), "pen_acceleration_mm_s2", None, None, acceleration, limit);
        }
        if drawn {
            raise(&mut self.peaks.speed_mm_s, speed);
            self.check(Some(t_ms), "speed_mm_s", None, None, speed, self.limits.speed_mm_s);
        } else {
            raise(&mut self.peaks.travel_speed_mm_s, speed);
            let limit = self.limits.travel_speed_mm_s.max(self.limits.speed_mm_s);
            self.check(Some(t_ms), "travel_speed_mm_s", None, None, speed, limit);
        }
        let limit = self.limits.acceleration_mm_s2 + ROUNDING_MM_S2;
        self.check(Some(t_ms), "acceleration_mm_s2", None, None, acceleration, limit);
    }

    fn check(
        &mut self,
        t_ms: Option<u64>,
        limit_of: &'static str,
        axis: Option<usize>,
        vertex: Option<usize>,
        value: f64,
        limit: f64,
    ) {
        if value <= limit * (1.0 + EXCESS) {
            return;
        }
        self.violation_count += 1;
        if self.violations.len() < LISTED_MAX {
            self.violations.push(Violation {
                t_ms,
                limit_of,
                axis,
                vertex,
                value,
                limit,
            });
        }
    }

    /// Ends the analysis.
    #[must_use]
    pub fn finish(mut self, run: &Run) -> Findings {
        let corners = self.track.corners();
        // Between two references the motion is not a straight line.
        let bow_mm = self.peaks.acceleration_mm_s2 * TICK_S * TICK_S / 8.0;
        let MotionLimits {
            tolerance_mm,
            travel_tolerance_mm,
            ..
        } = self.motion;
        for (limit_of, (distance, vertex), limit) in [
            ("tolerance_mm", corners.drawn, tolerance_mm),
            ("travel_tolerance_mm", corners.travel, travel_tolerance_mm),
        ] {
            let limit = limit + self.limits.shaper_deviation_mm;
            self.check(None, limit_of, None, Some(vertex), (distance - bow_mm).max(0.0), limit);
        }
        let [drawn, travel] = self.deviation;
        Findings {
            duration_s: run.duration_ms as f64 * TICK_S,
            length_mm: self.track.length_mm(),
            deviation_max_mm: drawn.max(travel),
            deviation_drawn_max_mm: drawn,
            corner_distance_max_mm: corners.drawn.0.max(corners.travel.0),
            peaks: self.peaks,
            limits: self.limits,
            violations: self.violations,
            violation_count: self.violation_count,
            underruns: run.underruns,
            planner_points_max: run.work_max,
        }
    }
}

fn raise(peak: &mut f64, value: f64) {
    // A NaN is kept.
    if value > *peak || value.is_nan() {
        *peak = value;
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::vertices;
    use super::super::{PlannedSample, plan};
    use super::*;

    fn findings(config: &Config, path: &[Vertex], limits: &Config) -> Findings {
        let mut samples: Vec<PlannedSample> = Vec::new();
        let run = plan(config, path, |sample, _| samples.push(*sample)).unwrap();
        let mut analysis = Analysis::new(limits, path, run.jerk_window_ms);
        samples.iter().for_each(|sample| analysis.observe(sample));
        analysis.finish(&run)
    }

    #[test]
    fn a_planned_path_uses_its_limits_and_violates_none() {
        let config = Config::default();
        let path = vertices(&[[-80.0, 0.0, -800.0], [80.0, 0.0, -800.0], [80.0, 60.0, -800.0]]);
        let findings = findings(&config, &path, &config);
        assert_eq!((findings.violations.as_slice(), findings.violation_count), (&[][..], 0));
        assert_eq!(findings.length_mm, 220.0);
        assert!(findings.peaks.speed_mm_s > 395.0 && findings.peaks.travel_speed_mm_s <= 401.0);
        assert!(findings.deviation_max_mm > 0.01 && findings.deviation_max_mm <= 0.05);
        assert!(findings.corner_distance_max_mm > 0.02);
        assert_eq!(findings.limits.joint_jerk_rad_s3.unwrap()[0], 2.0 * 250.0 / 0.004);
    }

    #[test]
    fn the_pens_vertical_limits_are_reported_and_kept() {
        let mut config = Config::default();
        config.motion.pen_speed_mm_s = 60.0;
        config.motion.pen_acceleration_mm_s2 = 2_000.0;
        let up = |mut vertex: Vertex| {
            vertex.pen = Pen::Up;
            vertex
        };
        let mut path = vertices(&[
            [-30.0, 0.0, -845.0],
            [-30.0, 0.0, -850.0],
            [30.0, 0.0, -850.0],
            [30.0, 0.0, -845.0],
        ]);
        for index in [0, 1, 3] {
            path[index] = up(path[index]);
        }
        let kept = findings(&config, &path, &config);
        assert_eq!((kept.violations.as_slice(), kept.violation_count), (&[][..], 0));
        assert_eq!(kept.limits.pen_speed_mm_s, Some(60.0));
        assert!(kept.peaks.pen_speed_mm_s > 55.0 && kept.peaks.pen_acceleration_mm_s2 > 1_800.0);
        let mut tighter = config.clone();
        tighter.motion.pen_speed_mm_s = 50.0;
        let over = findings(&config, &path, &tighter);
        assert!(over.violations.iter().all(|v| v.limit_of == "pen_speed_mm_s") && over.violation_count > 0);
    }

    #[test]
    fn what_is_over_a_limit_is_listed_with_time_value_and_limit() {
        let config = Config::default();
        let path = vertices(&[[-80.0, 0.0, -800.0], [80.0, 0.0, -800.0], [80.0, 60.0, -800.0]]);
        let mut tighter = config.clone();
        tighter.motion.joint_speed_rad_s[2] = 0.5;
        tighter.motion.tolerance_mm = 0.01;
        let findings = findings(&config, &path, &tighter);
        let speed = findings
            .violations
            .iter()
            .find(|v| v.limit_of == "joint_speed_rad_s")
            .unwrap();
        assert_eq!((speed.axis, speed.limit), (Some(3), 0.5));
        assert!(speed.value > 0.5 && speed.t_ms.is_some());
        let corner = findings.violations.iter().find(|v| v.vertex.is_some()).unwrap();
        assert_eq!((corner.vertex, corner.limit), (Some(1), 0.01));
        assert!(findings.violation_count >= findings.violations.len() as u64);
    }
}
