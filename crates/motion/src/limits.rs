//! Limits of motion as the scan uses them: squared speeds, accelerations of the axes as linear rows, and the
//! platform's.
//!
//! The platform's acceleration is bounded by a circle in the plane of path acceleration and centripetal acceleration.
//! The scan uses slightly less than the configured limits, because its bounds are exact only at the points of the grid
//! and in the middle of its curved intervals.

use crate::robots::{JointRows, MAIN_AXES};
use crate::settings::Settings;
use crate::settings::input_shaper::Copies;

/// Part of the acceleration limits that the scan uses.
const ACCELERATION_PART: f64 = 0.9998;
/// Part of the speed limits that the scan uses.
const SPEED_PART: f64 = 0.9998;
/// Part of the joints' speed limits that the scan uses where a joint moves the tool in one direction alone, see
/// `Geometry::needs_fine_curves`: on 800 random paths the 1 ms setpoints exceed this part by at most 0.12 % of the
/// limit.
const ONE_DIRECTION_PART: f64 = 0.999;
/// Part of the joints' limits that the scan uses with an input shaper, which sums copies of the tool's places and not of the
/// angles: on 2,500 random paths the setpoints of joints that are no slides exceed this part by at most 0.7 %.
const COPIES_PART: f64 = 0.99;
/// Part of the pen's vertical limits that the scan uses: on 250 random paths with lifts the 1 ms setpoints exceed this
/// part by at most 0.4 % of the limit.
const PEN_PART: f64 = 0.985;

/// Limits at one point of the grid, in terms of the path.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Row {
    pub(crate) joints: JointRows,
    /// Curvature, 1/mm.
    pub(crate) curvature: f64,
    /// Slope of the fourth axis, rad/mm.
    pub(crate) turn: f64,
    /// Vertical part of the tangent, and its derivative with respect to arc length, 1/mm.
    pub(crate) rise: f64,
    pub(crate) rise_change: f64,
}

impl Row {
    /// A row that allows no motion.
    pub(crate) const NONE: Self = Self {
        joints: JointRows::NONE,
        curvature: 0.0,
        turn: 0.0,
        rise: 0.0,
        rise_change: 0.0,
    };
}

/// Limits of the scan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    joint_speed_squared: [f64; MAIN_AXES],
    /// Acceleration of the joints, rad/s2.
    pub(crate) joint_acceleration: [f64; MAIN_AXES],
    /// Acceleration of the platform, mm/s2.
    pub(crate) acceleration: f64,
    drawing_squared: f64,
    travel_squared: f64,
    /// Squared speed and acceleration of the fourth axis, rad2/s2 and rad/s2.
    pub(crate) turn_speed_squared: f64,
    pub(crate) turn_acceleration: f64,
    /// Whether the pen's vertical limits are tighter than the limits of all motion.
    pub(crate) pen_limited: bool,
    pub(crate) pen_speed_squared: f64,
    pub(crate) pen_acceleration: f64,
}

impl Limits {
    /// Limits that allow no motion.
    pub(crate) const NONE: Self = Self {
        joint_speed_squared: [0.0; MAIN_AXES],
        joint_acceleration: [0.0; MAIN_AXES],
        acceleration: 0.0,
        drawing_squared: 0.0,
        travel_squared: 0.0,
        turn_speed_squared: 0.0,
        turn_acceleration: 0.0,
        pen_limited: false,
        pen_speed_squared: 0.0,
        pen_acceleration: 0.0,
    };

    pub(crate) fn new(Settings { geometry, motion, .. }: &Settings) -> Self {
        let copies = Copies::new(motion);
        let by_copies = if copies.is_some() { COPIES_PART } else { 1.0 };
        let joint_part = if geometry.needs_fine_curves() {
            ONE_DIRECTION_PART * by_copies
        } else {
            by_copies
        };
        let acceleration = |limit: f64| copies.map_or(limit, |copies| copies.planned_acceleration(limit));
        let speed_squared = |speed: f64, acceleration: f64| {
            let speed = copies.map_or(speed, |copies| copies.planned_speed(speed, acceleration));
            speed * speed * SPEED_PART * SPEED_PART
        };
        let [a, b, c, fourth_speed] = motion.joint_speed_rad_s;
        let [d, e, f, fourth_acceleration] = motion.joint_acceleration_rad_s2;
        Self {
            joint_speed_squared: [[a, d], [b, e], [c, f]]
                .map(|[speed, acceleration]| speed_squared(speed * joint_part, acceleration)),
            joint_acceleration: [d, e, f].map(|limit| acceleration(limit) * by_copies * ACCELERATION_PART),
            acceleration: acceleration(motion.acceleration_mm_s2) * ACCELERATION_PART,
            drawing_squared: speed_squared(motion.speed_mm_s, motion.acceleration_mm_s2),
            travel_squared: speed_squared(motion.travel_speed_mm_s, motion.acceleration_mm_s2),
            turn_speed_squared: speed_squared(fourth_speed, fourth_acceleration),
            turn_acceleration: acceleration(fourth_acceleration) * ACCELERATION_PART,
            pen_limited: motion.pen_speed_mm_s > 0.0 || motion.pen_acceleration_mm_s2 > 0.0,
            pen_speed_squared: speed_squared(or_none(motion.pen_speed_mm_s) * PEN_PART, motion.acceleration_mm_s2),
            pen_acceleration: acceleration(or_none(motion.pen_acceleration_mm_s2)) * PEN_PART,
        }
    }

    /// Squared path speed with the pen down or up, mm2/s2.
    pub(crate) fn path_speed_squared(&self, drawn: bool) -> f64 {
        if drawn {
            self.drawing_squared
        } else {
            self.travel_squared
        }
    }

    /// Largest squared path speed that the joints' speeds and centripetal acceleration allow at a point, mm2/s2.
    pub(crate) fn cap(&self, row: &Row) -> f64 {
        let (joints, curvature) = (&row.joints, row.curvature);
        let mut cap = f64::MAX;
        for ((slope, bend), (speed_squared, acceleration)) in joints
            .slope
            .iter()
            .zip(&joints.bend)
            .zip(self.joint_speed_squared.iter().zip(&self.joint_acceleration))
        {
            let slope_squared = slope * slope;
            if slope_squared * cap > *speed_squared {
                cap = speed_squared / slope_squared;
            }
            // Where the slope vanishes, only the bend bounds the speed.
            if bend.abs() * cap > *acceleration && slope_squared < SLOPE_SMALL * SLOPE_SMALL {
                cap = acceleration / bend.abs();
            }
        }
        if curvature * cap > self.acceleration {
            cap = self.acceleration / curvature;
        }
        cap
    }

    /// Lowers a cap for the fourth axis: the larger slope of the two ends bounds the speed on the whole interval.
    pub(crate) fn cap_turning(&self, cap: f64, slopes: [f64; 2], change: f64) -> f64 {
        let [start, end] = slopes.map(f64::abs);
        let (slope, change) = (start.max(end), change.abs());
        let mut cap = cap;
        if slope * slope * cap > self.turn_speed_squared {
            cap = self.turn_speed_squared / (slope * slope);
        }
        // Where the coefficient of the path acceleration vanishes, only the change bounds the speed.
        let vanishing = start.min((3.0 * slopes[1] - 2.0 * slopes[0]).abs());
        if change * cap > self.turn_acceleration && vanishing < SLOPE_SMALL {
            cap = self.turn_acceleration / change;
        }
        cap
    }

    /// Lowers a cap for the pen's vertical speed and acceleration.
    pub(crate) fn cap_pen(&self, cap: f64, row: &Row) -> f64 {
        let squared = row.rise * row.rise;
        let mut cap = cap;
        if squared * cap > self.pen_speed_squared {
            cap = self.pen_speed_squared / squared;
        }
        if row.rise_change.abs() * cap > self.pen_acceleration && row.rise.abs() < SLOPE_SMALL {
            cap = self.pen_acceleration / row.rise_change.abs();
        }
        cap
    }
}

/// Replaces a limit of 0, which means unlimited.
fn or_none(limit: f64) -> f64 {
    if limit > 0.0 { limit } else { LIMIT_NONE }
}

/// Limit that no motion reaches, mm/s and mm/s2.
const LIMIT_NONE: f64 = 1.0e9;

/// Slope below which the path acceleration has no effect on a joint's acceleration, rad/mm.
const SLOPE_SMALL: f64 = 1.0e-9;

#[cfg(test)]
mod tests {
    use super::*;

    /// Row of a joint with this slope, rad/mm, and bend, rad/mm2; the other joints do not move.
    fn row(slope: f64, bend: f64) -> Row {
        let mut row = Row::NONE;
        (row.joints.slope[0], row.joints.bend[0]) = (slope, bend);
        row
    }

    #[test]
    fn the_bend_bounds_the_speed_only_where_the_slope_vanishes() {
        let limits = Limits {
            joint_speed_squared: [4.0; MAIN_AXES],
            joint_acceleration: [2.0; MAIN_AXES],
            acceleration: 1_000.0,
            ..Limits::NONE
        };
        // Elsewhere the path acceleration can make up for the bend.
        for (slope, expected) in [(0.0, 2.0 / 0.5), (0.01, 4.0 / 0.0001)] {
            let cap = limits.cap(&row(slope, 0.5));
            assert!((cap / expected - 1.0).abs() < 1.0e-12, "{cap} with a slope of {slope}");
        }
    }
    #[test]
    fn the_change_of_the_rise_bounds_the_pens_speed_only_where_the_rise_vanishes() {
        let limits = Limits {
            pen_speed_squared: 100.0,
            pen_acceleration: 50.0,
            ..Limits::NONE
        };
        // Elsewhere the path acceleration can make up for the change.
        for (rise, expected) in [(0.0, 50.0 / 0.5), (0.1, 100.0 / 0.01), (-0.1, 100.0 / 0.01)] {
            let row = Row {
                rise,
                rise_change: -0.5,
                ..Row::NONE
            };
            let cap = limits.cap_pen(f64::MAX, &row);
            assert!((cap / expected - 1.0).abs() < 1.0e-12, "{cap} with a rise of {rise}");
        }
    }
}
