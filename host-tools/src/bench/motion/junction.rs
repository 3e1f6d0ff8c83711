//! Peers that plan with junction deviation: Klipper's and grbl's formulas, on the polyline itself.
//!
//! Both pass corners at the speed at which a circle that leaves the corner by a given distance has the given
//! centripetal acceleration, and change speed between corners with constant acceleration along the legs. Klipper also
//! bounds the corner's speed by circles that fit half of either leg, and looks ahead over the whole path; grbl looks
//! ahead over sixteen legs. The implementation is this project's, from the published formulas (Klipper,
//! docs/Kinematics.md, "Look-ahead"; grbl, planner.c, junction deviation).
//!
//! Invariant: a profile reported as legal keeps every limit in its 1 ms references, by the measure with which the
//! planner's own references are checked.

use etherpen::config::Config;
use etherpen::robots::vector::{Vector, add_scaled, dot, length, scale, subtract};
use etherpen::robots::{Kinematics, MAIN_AXES};

/// Look-ahead of grbl, legs.
const GRBL_LEGS: usize = 16;
/// Relative excess over a limit that is tolerated.
const EXCESS: f64 = 1.0e-3;
/// Distance between the places at which the joints' slopes are evaluated, mm.
const SLOPE_STEP_MM: f64 = 1.0;
/// Ratio of each acceleration tried to the previous one.
const ACCELERATION_STEP: f64 = 0.85;
const ACCELERATIONS: usize = 14;
/// Halvings between the smallest and the largest deviation tried.
const HALVINGS: usize = 16;
/// Smallest deviation tried, mm.
const DEVIATION_MIN_MM: f64 = 1.0e-9;
/// Largest deviation tried, in tolerances.
const DEVIATION_MAX: f64 = 20.0;
/// One millisecond, s.
const TICK_S: f64 = 1.0e-3;

/// Formula of a peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rule {
    /// Klipper.
    Klipper,
    /// grbl.
    Grbl,
}

impl Rule {
    /// All rules.
    pub(super) const ALL: [Self; 2] = [Self::Klipper, Self::Grbl];

    /// Name of the peer.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Klipper => "klipper",
            Self::Grbl => "grbl",
        }
    }
}

/// Settings of such a planner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tuning {
    speed: f64,
    acceleration: f64,
    deviation_mm: f64,
}

/// One leg's motion: speeds at its ends and between.
#[derive(Clone, Copy, Debug)]
struct Leg {
    from: Vector,
    direction: Vector,
    length_mm: f64,
    start: f64,
    cruise: f64,
    end: f64,
}

/// A planned path.
#[derive(Clone, Debug)]
pub(super) struct Profile {
    legs: Vec<Leg>,
    acceleration: f64,
}

/// Result of a profile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Result {
    /// Duration, s.
    pub(super) duration_s: f64,
    /// Largest value of its 1 ms references, as a part of its limit.
    pub(super) peak_ratio: f64,
}

/// A path for the peers, with the limits to keep.
pub(super) struct Task<'a> {
    config: &'a Config,
    kinematics: &'a Kinematics,
    points: &'a [Vector],
    tops: (f64, f64),
}

impl<'a> Task<'a> {
    /// A task for a path of at least two different points.
    pub(super) fn new(config: &'a Config, kinematics: &'a Kinematics, points: &'a [Vector]) -> Self {
        let mut task = Self {
            config,
            kinematics,
            points,
            tops: (0.0, 0.0),
        };
        task.tops = task.largest();
        task
    }

    /// Largest speed and acceleration along the path at which no joint limit is reached on any straight line, and the
    /// configured ones.
    fn largest(&self) -> (f64, f64) {
        let motion = &self.config.motion;
        let (mut speed, mut acceleration) = (motion.speed_mm_s, motion.acceleration_mm_s2);
        for ends in self.points.windows(2) {
            let [from, to] = ends else { continue };
            let leg = subtract(to, from);
            let leg_mm = length(&leg);
            let steps = (leg_mm / SLOPE_STEP_MM).ceil().max(1.0) as u32;
            for step in 0..=steps {
                let point = add_scaled(from, &leg, f64::from(step) / f64::from(steps));
                let rows = self.kinematics.rows(&point, &scale(&leg, 1.0 / leg_mm), &[0.0; 3]);
                for axis in 0..MAIN_AXES {
                    let slope = rows.slope[axis].abs();
                    speed = speed.min(motion.joint_speed_rad_s[axis] / slope);
                    acceleration = acceleration.min(motion.joint_acceleration_rad_s2[axis] / slope);
                }
            }
        }
        (speed, acceleration)
    }

    /// Result with the given limits and tolerance.
    pub(super) fn raw(&self, rule: Rule) -> Result {
        self.try_tuning(
            rule,
            Tuning {
                speed: self.tops.0,
                acceleration: self.tops.1,
                deviation_mm: self.config.motion.tolerance_mm,
            },
        )
    }

    /// Shortest result that keeps all limits.
    pub(super) fn tuned(&self, rule: Rule) -> Option<Result> {
        let mut best: Option<Result> = None;
        let mut next = self.tops.1;
        for _ in 0..ACCELERATIONS {
            let acceleration = next;
            next *= ACCELERATION_STEP;
            let with = |deviation_mm: f64| {
                let speed = self.tops.0;
                self.try_tuning(
                    rule,
                    Tuning {
                        speed,
                        acceleration,
                        deviation_mm,
                    },
                )
            };
            let mut low = DEVIATION_MIN_MM.ln();
            let mut high = (DEVIATION_MAX * self.config.motion.tolerance_mm).ln();
            let slowest = with(DEVIATION_MIN_MM);
            if !slowest.is_legal() {
                continue;
            }
            let mut found = slowest;
            for _ in 0..HALVINGS {
                let middle = 0.5 * (low + high);
                let tried = with(middle.exp());
                if tried.is_legal() {
                    (low, found) = (middle, tried);
                } else {
                    high = middle;
                }
            }
            if best.is_none_or(|best| found.duration_s < best.duration_s) {
                best = Some(found);
            }
        }
        best
    }

    fn try_tuning(&self, rule: Rule, tuning: Tuning) -> Result {
        let profile = Profile::new(self.points, rule, &tuning);
        Result {
            duration_s: profile.duration_s(),
            peak_ratio: self.peak_ratio(&profile),
        }
    }

    /// Largest value of the 1 ms references, as a part of its limit.
    fn peak_ratio(&self, profile: &Profile) -> f64 {
        let motion = &self.config.motion;
        let mut worst = 0.0_f64;
        let mut before: Option<([f64; MAIN_AXES], Vector)> = None;
        let mut rates: Option<([f64; MAIN_AXES], Vector)> = None;
        profile.sample(|point| {
            let joints = self.kinematics.angles(point);
            if let Some((last_joints, last_point)) = before {
                let velocity: [f64; MAIN_AXES] =
                    std::array::from_fn(|axis| (joints[axis] - last_joints[axis]) / TICK_S);
                let speed = subtract(point, &last_point).map(|way| way / TICK_S);
                let (last_velocity, last_speed) = rates.unwrap_or_default();
                for axis in 0..MAIN_AXES {
                    let change = (velocity[axis] - last_velocity[axis]).abs() / TICK_S;
                    worst = worst
                        .max(velocity[axis].abs() / motion.joint_speed_rad_s[axis])
                        .max(change / motion.joint_acceleration_rad_s2[axis]);
                }
                let change = length(&subtract(&speed, &last_speed)) / TICK_S;
                worst = worst
                    .max(length(&speed) / motion.speed_mm_s)
                    .max(change / motion.acceleration_mm_s2);
                rates = Some((velocity, speed));
            }
            before = Some((joints, *point));
        });
        worst
    }
}

impl Result {
    fn is_legal(&self) -> bool {
        self.peak_ratio <= 1.0 + EXCESS
    }
}

impl Profile {
    fn new(points: &[Vector], rule: Rule, tuning: &Tuning) -> Self {
        let mut legs: Vec<Leg> = points
            .windows(2)
            .filter_map(|ends| {
                let [from, to] = ends else { return None };
                let way = subtract(to, from);
                let length_mm = length(&way);
                (length_mm > 0.0).then(|| Leg {
                    from: *from,
                    direction: scale(&way, 1.0 / length_mm),
                    length_mm,
                    start: 0.0,
                    cruise: 0.0,
                    end: 0.0,
                })
            })
            .collect();
        let squared = junctions(&legs, rule, tuning);
        for (leg, ends) in legs.iter_mut().zip(squared.windows(2)) {
            let [start, end] = ends else { continue };
            let top = 0.5 * (start + end) + tuning.acceleration * leg.length_mm;
            leg.start = start.sqrt();
            leg.end = end.sqrt();
            leg.cruise = top.min(tuning.speed * tuning.speed).sqrt();
        }
        Self {
            legs,
            acceleration: tuning.acceleration,
        }
    }

    fn duration_s(&self) -> f64 {
        self.legs
            .iter()
            .map(|leg| leg.phases(self.acceleration).iter().sum::<f64>())
            .sum()
    }

    /// Passes the position of every millisecond to `take`, with two at rest before and after.
    fn sample(&self, mut take: impl FnMut(&Vector)) {
        let (Some(first), Some(last)) = (self.legs.first(), self.legs.last()) else {
            return;
        };
        take(&first.from);
        take(&first.from);
        let mut left_s = TICK_S;
        for leg in &self.legs {
            let duration_s: f64 = leg.phases(self.acceleration).iter().sum();
            let mut time_s = left_s;
            while time_s <= duration_s {
                take(&add_scaled(
                    &leg.from,
                    &leg.direction,
                    leg.passed_mm(self.acceleration, time_s),
                ));
                time_s += TICK_S;
            }
            left_s = time_s - duration_s;
        }
        let end = add_scaled(&last.from, &last.direction, last.length_mm);
        for _ in 0..3 {
            take(&end);
        }
    }
}

impl Leg {
    /// Durations of acceleration, constant speed and deceleration, s.
    fn phases(&self, acceleration: f64) -> [f64; 3] {
        let up_mm = (self.cruise.powi(2) - self.start.powi(2)) / (2.0 * acceleration);
        let down_mm = (self.cruise.powi(2) - self.end.powi(2)) / (2.0 * acceleration);
        [
            (self.cruise - self.start) / acceleration,
            (self.length_mm - up_mm - down_mm).max(0.0) / self.cruise,
            (self.cruise - self.end) / acceleration,
        ]
    }

    fn passed_mm(&self, acceleration: f64, time_s: f64) -> f64 {
        let [up, even, down] = self.phases(acceleration);
        if time_s <= up {
            return time_s * (self.start + 0.5 * acceleration * time_s);
        }
        if time_s <= up + even {
            let up_mm = up * (self.start + 0.5 * acceleration * up);
            return up_mm + self.cruise * (time_s - up);
        }
        let left = (up + even + down - time_s).max(0.0);
        self.length_mm - left * (self.end + 0.5 * acceleration * left)
    }
}

/// Squared speeds at the ends of the legs, both ends of the path at rest.
fn junctions(legs: &[Leg], rule: Rule, tuning: &Tuning) -> Vec<f64> {
    let Tuning {
        speed,
        acceleration,
        deviation_mm,
    } = *tuning;
    let mut squared = vec![0.0; legs.len() + 1];
    for (index, pair) in legs.windows(2).enumerate() {
        let [before, after] = pair else { continue };
        // Half of the angle between the legs: 90 degrees is straight on.
        let cosine = -dot(&before.direction, &after.direction);
        let half_sine = (0.5 * (1.0 - cosine)).max(0.0).sqrt();
        let half_cosine = (0.5 * (1.0 + cosine)).max(0.0).sqrt();
        let mut most = speed * speed;
        if half_sine < 1.0 - 1.0e-12 {
            most = most.min(acceleration * deviation_mm * half_sine / (1.0 - half_sine));
            if rule == Rule::Klipper && half_cosine > 0.0 {
                let tangent = half_sine / half_cosine;
                let shorter_mm = before.length_mm.min(after.length_mm);
                most = most.min(0.5 * shorter_mm * tangent * acceleration);
            }
        }
        if let Some(at) = squared.get_mut(index + 1) {
            *at = most;
        }
    }
    if rule == Rule::Grbl {
        let mut ahead_mm: f64 = legs.iter().take(GRBL_LEGS - 1).map(|leg| leg.length_mm).sum();
        for (index, leg) in legs.iter().enumerate() {
            if let Some(at) = squared.get_mut(index) {
                *at = at.min(2.0 * acceleration * ahead_mm);
            }
            ahead_mm += legs.get(index + GRBL_LEGS - 1).map_or(0.0, |next| next.length_mm) - leg.length_mm;
        }
    }
    let mut next = 0.0;
    for (at, leg) in squared.iter_mut().rev().skip(1).zip(legs.iter().rev()) {
        next = at.min(next + 2.0 * acceleration * leg.length_mm);
        *at = next;
    }
    let mut last = 0.0;
    for (at, leg) in squared.iter_mut().skip(1).zip(legs) {
        last = at.min(last + 2.0 * acceleration * leg.length_mm);
        *at = last;
    }
    squared
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNER: [Vector; 3] = [[0.0, 0.0, -800.0], [50.0, 0.0, -800.0], [50.0, 50.0, -800.0]];
    const TUNING: Tuning = Tuning {
        speed: 400.0,
        acceleration: 10_000.0,
        deviation_mm: 0.05,
    };

    #[test]
    fn a_right_angle_is_taken_at_the_speed_of_the_formula() {
        for rule in Rule::ALL {
            let profile = Profile::new(&CORNER, rule, &TUNING);
            let expected = (10_000.0 * 0.05 * 0.5_f64.sqrt() / (1.0 - 0.5_f64.sqrt())).sqrt();
            assert!((profile.legs[0].end - expected).abs() < 1.0e-9);
            // From rest to 400 mm/s takes 8 mm and 40 ms; the corner is slower than that.
            let leg = 0.04 + (400.0 - expected) / 10_000.0;
            let even = (50.0 - 8.0 - (160_000.0 - expected * expected) / 20_000.0) / 400.0;
            assert!((profile.duration_s() - 2.0 * (leg + even)).abs() < 1.0e-9);
        }
    }

    #[test]
    fn samples_run_from_end_to_end() {
        let profile = Profile::new(&CORNER, Rule::Klipper, &TUNING);
        let mut points = Vec::new();
        profile.sample(|point| points.push(*point));
        assert_eq!((points[0], points[points.len() - 1]), (CORNER[0], CORNER[2]));
        assert_eq!(points.len(), (profile.duration_s() / TICK_S) as usize + 5);
        assert!(
            points
                .windows(2)
                .all(|pair| length(&subtract(&pair[1], &pair[0])) < 0.4001)
        );
    }

    #[test]
    fn tuning_makes_a_profile_legal_and_slower() {
        let config = Config::default();
        let kinematics = Kinematics::new(&config.geometry).unwrap();
        let task = Task::new(&config, &kinematics, &CORNER);
        for rule in Rule::ALL {
            let (raw, tuned) = (task.raw(rule), task.tuned(rule).unwrap());
            assert!(raw.peak_ratio > 1.2, "{raw:?}");
            assert!(tuned.is_legal() && tuned.duration_s > raw.duration_s, "{tuned:?}");
        }
    }
}
