//! Limits of motion as the scan uses them: squared speeds, and accelerations as linear rows.
//!
//! The Cartesian acceleration is a circle in the plane of path acceleration and centripetal acceleration; the scan
//! takes a polygon inside it. What the scan may use lies a little under the configured limits, because the limits
//! hold exactly only at the points of the grid.

use crate::config::Motion;
use crate::robot::{ARMS, JointRows};

/// Directions of the polygon in a quarter of the circle, both ends included.
pub(crate) const DIRECTIONS: usize = 5;
/// Cosine and sine of the directions, 22.5 degrees apart.
pub(crate) const DIRECTION: [(f64, f64); DIRECTIONS] = [
    (1.0, 0.0),
    (0.923_879_532_511_286_7, 0.382_683_432_365_089_8),
    (0.707_106_781_186_547_5, 0.707_106_781_186_547_5),
    (0.382_683_432_365_089_8, 0.923_879_532_511_286_7),
    (0.0, 1.0),
];
/// Distance of the inner polygon's sides from its centre in a circle of radius 1: cosine of 11.25 degrees.
const POLYGON: f64 = 0.980_785_280_403_230_4;
/// Part of the acceleration limits that the scan uses.
const ACCELERATION_PART: f64 = 0.998;
/// Part of the speed limits that the scan uses.
const SPEED_PART: f64 = 0.999;

/// Limits of the scan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    joint_speed_squared: [f64; ARMS],
    /// rad/s2.
    pub(crate) joint_acceleration: [f64; ARMS],
    /// Radius of the polygon's inscribed circle, mm/s2.
    pub(crate) acceleration: f64,
    drawing_squared: f64,
    travel_squared: f64,
}

impl Limits {
    /// Nothing may move.
    pub(crate) const NONE: Self = Self {
        joint_speed_squared: [0.0; ARMS],
        joint_acceleration: [0.0; ARMS],
        acceleration: 0.0,
        drawing_squared: 0.0,
        travel_squared: 0.0,
    };

    pub(crate) fn new(motion: &Motion) -> Self {
        let speed_squared = |speed: f64| speed * speed * SPEED_PART * SPEED_PART;
        let [a, b, c, _] = motion.joint_speed_rad_s;
        let [d, e, f, _] = motion.joint_acceleration_rad_s2;
        Self {
            joint_speed_squared: [a, b, c].map(speed_squared),
            joint_acceleration: [d, e, f].map(|limit| limit * ACCELERATION_PART),
            acceleration: motion.acceleration_mm_s2 * ACCELERATION_PART * POLYGON,
            drawing_squared: speed_squared(motion.speed_mm_s),
            travel_squared: speed_squared(motion.travel_speed_mm_s),
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

    /// Largest squared path speed that joint speeds and centripetal acceleration allow at a point, mm2/s2.
    pub(crate) fn cap(&self, rows: &JointRows, curvature: f64) -> f64 {
        let mut cap = f64::MAX;
        for ((slope, bend), (speed_squared, acceleration)) in rows
            .slope
            .iter()
            .zip(&rows.bend)
            .zip(self.joint_speed_squared.iter().zip(&self.joint_acceleration))
        {
            let slope_squared = slope * slope;
            if slope_squared * cap > *speed_squared {
                cap = speed_squared / slope_squared;
            }
            // Where the slope vanishes the bend alone bounds the speed.
            if bend.abs() * cap > *acceleration && slope_squared < SLOPE_SMALL * SLOPE_SMALL {
                cap = acceleration / bend.abs();
            }
        }
        if curvature * cap > self.acceleration {
            cap = self.acceleration / curvature;
        }
        cap
    }
}

/// Slope under which a joint's acceleration does not depend on the path acceleration in effect, rad/mm.
const SLOPE_SMALL: f64 = 1.0e-9;
