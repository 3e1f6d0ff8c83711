//! CoreXY: two belts whose motors together move x and y, and a linear axis for z.
//!
//! Belt a moves by x + y, belt b by x - y (both motors alike: x; opposite: y). The frame's origin is where belts and z
//! are at 0 mm; z points up.
//!
//! Invariant: a result is finite or an error; no input panics.

use super::errors::GeometryError;
use super::linear::{BELT_LIMITS, LIFT_LIMITS, Linear, WHEEL, angles_rad, check_stroke};
use super::vector::Vector;
use super::{ConditioningMin, JointAngles, JointRanges, JointRows, KinematicsError, MAIN_AXES, Position, Words};
use crate::bounds::{Bound, bound};
use crate::work_volume::WorkVolume;
use serde::{Deserialize, Serialize};

/// Nouns for messages.
pub(super) const WORDS: Words = Words {
    joint: "axis",
    singular: "beam and carriage in line",
    last_links: "axes",
};
/// The machine has no singularities.
pub(super) const CONDITIONING_MIN: ConditioningMin = ConditioningMin {
    ratio: 0.0,
    determinant: 0.0,
};

/// Dimensions of a machine with two crossed belts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CoreXyGeometry {
    /// Lowest and highest x, mm.
    pub x_range_mm: [f64; 2],
    /// Lowest and highest y, mm.
    pub y_range_mm: [f64; 2],
    /// Lowest and highest z, mm.
    pub z_range_mm: [f64; 2],
    /// Margin kept from both ends of each range, mm.
    pub margin_mm: f64,
    /// Lowest and highest angle of the fourth axis, radians.
    pub turn_range_rad: [f64; 2],
}

impl Default for CoreXyGeometry {
    /// A frame for sheets of 300 mm: belts over pulleys of 20 teeth with a pitch of 2 mm, and a screw with a pitch of
    /// 8 mm.
    fn default() -> Self {
        Self {
            x_range_mm: [0.0, 350.0],
            y_range_mm: [0.0, 350.0],
            z_range_mm: [-50.0, 0.0],
            margin_mm: 1.0,
            turn_range_rad: [-6_283.0, 6_283.0],
        }
    }
}

impl CoreXyGeometry {
    /// Hard bounds of the dimensions, named as configuration files write them.
    pub(super) fn bounds(&self) -> [Bound; 9] {
        let [[x_low, x_high], [y_low, y_high], [z_low, z_high]] = [self.x_range_mm, self.y_range_mm, self.z_range_mm];
        let [turn_low_rad, turn_high_rad] = self.turn_range_rad;
        [
            bound("geometry.x_range_mm[0]", x_low, -5000.0, x_high),
            bound("geometry.x_range_mm[1]", x_high, x_low, 5000.0),
            bound("geometry.y_range_mm[0]", y_low, -5000.0, y_high),
            bound("geometry.y_range_mm[1]", y_high, y_low, 5000.0),
            bound("geometry.z_range_mm[0]", z_low, -2000.0, z_high),
            bound("geometry.z_range_mm[1]", z_high, z_low, 2000.0),
            bound("geometry.margin_mm", self.margin_mm, 0.0, 100.0),
            bound("geometry.turn_range_rad[0]", turn_low_rad, -6300.0, 0.0),
            bound("geometry.turn_range_rad[1]", turn_high_rad, 0.0, 6300.0),
        ]
    }

    /// Lowest and highest angle of each main axis, rad. The belts' are those of the corners of the ranges of x and y,
    /// which themselves are borders of [`Self::work_volume`].
    pub(super) fn ranges_rad(&self) -> [[f64; 2]; MAIN_AXES] {
        let ([x_low, x_high], [y_low, y_high]) = (self.x_range_mm, self.y_range_mm);
        [
            angles_rad([x_low + y_low, x_high + y_high]),
            angles_rad([x_low - y_high, x_high - y_low]),
            angles_rad(self.z_range_mm),
        ]
    }

    /// Lowest and highest angle that stand for x, y and z, rad.
    pub(super) fn slide_ranges_rad(&self) -> [[f64; 2]; MAIN_AXES] {
        [self.x_range_mm, self.y_range_mm, self.z_range_mm].map(angles_rad)
    }

    /// Angles of the margin, rad. The belts' is 0, because x and y keep theirs.
    pub(super) fn margins_rad(&self) -> [f64; MAIN_AXES] {
        let [_, margin] = angles_rad([0.0, self.margin_mm]);
        [0.0, 0.0, margin]
    }

    /// Usual highest speed and acceleration of each main axis, rad/s and rad/s2.
    pub(super) fn usual_limits(&self) -> [[f64; 2]; MAIN_AXES] {
        let belt = angles_rad(BELT_LIMITS);
        [belt, belt, angles_rad(LIFT_LIMITS)]
    }

    /// The volume that the ranges leave without their margins.
    pub(super) fn work_volume(&self) -> WorkVolume {
        WorkVolume::of_box(
            [self.x_range_mm, self.y_range_mm, self.z_range_mm]
                .map(|[low, high]| [low + self.margin_mm, high - self.margin_mm]),
        )
    }

    /// This geometry with ranges that end at no position that a machine has.
    pub(super) fn without_ranges(self) -> Self {
        let endless = super::linear::ENDLESS_MM;
        Self {
            x_range_mm: endless,
            y_range_mm: endless,
            z_range_mm: endless,
            ..self
        }
    }
}

/// A machine with two crossed belts, of known dimensions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoreXy {
    belt: Linear,
    z: Linear,
    ranges_rad: [[f64; 2]; MAIN_AXES],
}

impl CoreXy {
    /// Makes a robot from its dimensions.
    ///
    /// # Errors
    /// Why the dimensions do not form a valid machine, see [`GeometryError`].
    pub(super) fn new(geometry: &CoreXyGeometry) -> Result<Self, GeometryError> {
        for range_mm in [geometry.x_range_mm, geometry.y_range_mm, geometry.z_range_mm] {
            check_stroke(range_mm)?;
        }
        Ok(Self {
            belt: WHEEL,
            z: WHEEL,
            ranges_rad: geometry.ranges_rad(),
        })
    }

    /// Angles of belts and z for a position, rad.
    ///
    /// # Errors
    /// The position is not finite, or the first joint that is outside its range.
    pub(super) fn inverse(&self, position: &Position) -> Result<[f64; MAIN_AXES], KinematicsError> {
        let point = Vector::from(*position);
        if !point.iter().all(|value| value.is_finite()) {
            return Err(KinematicsError::NotFinite);
        }
        super::in_range(self.angles(&point), &self.ranges_rad)
    }

    /// Angles of belts and z without checks, rad.
    #[inline(never)]
    pub(super) fn angles(&self, [x, y, z]: &Vector) -> [f64; MAIN_AXES] {
        [
            (x + y) * self.belt.rad_per_mm,
            (x - y) * self.belt.rad_per_mm,
            z * self.z.rad_per_mm,
        ]
    }

    /// Derivatives of the angles along a path with the unit tangent `tangent` and the curvature vector `bend` (1/mm).
    #[inline(never)]
    pub(super) fn rows(&self, tangent: &Vector, bend: &Vector) -> JointRows {
        JointRows {
            slope: self.angles(tangent),
            bend: self.angles(bend),
        }
    }

    /// Whether every joint is in its range.
    #[inline(never)]
    pub(super) fn clears(&self, point: &Vector, ranges: &JointRanges) -> bool {
        self.angles(point)
            .iter()
            .zip(&ranges.rad)
            .all(|(angle, [low, high])| angle >= low && angle <= high)
    }

    /// Position of the tool for joint angles.
    ///
    /// # Errors
    /// [`KinematicsError::NotFinite`].
    pub(super) fn forward(&self, joints: &JointAngles) -> Result<Position, KinematicsError> {
        let [a, b, z, _] = joints.0;
        let half = 0.5 * self.belt.mm_per_rad;
        super::finite(joints, [(a + b) * half, (a - b) * half, z * self.z.mm_per_rad])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robots::LINEAR_MM_PER_RAD;

    /// Values in mm of the joints, 1e-9 of which an angle may differ.
    fn check(angles: [f64; MAIN_AXES], expected_mm: [f64; MAIN_AXES]) {
        for (angle, expected) in angles.iter().zip(expected_mm) {
            assert!(
                (angle * LINEAR_MM_PER_RAD - expected).abs() < 1.0e-9,
                "{angles:?}, {expected_mm:?}"
            );
        }
    }

    /// Calculated with numpy in twice the precision.
    #[test]
    fn positions_and_derivatives_are_those_of_the_golden_points() {
        let machine = CoreXy::new(&CoreXyGeometry::default()).unwrap();
        for (point, tangent, bend, q, slope, second) in [
            (
                [120.5, -40.25, 5.0],
                [0.6, -0.8, 0.0],
                [0.02, 0.01, 0.0],
                [80.25, 160.75, 5.0],
                [-0.2, 1.4, 0.0],
                [0.03, 0.01, 0.0],
            ),
            (
                [0.0; 3],
                [1.0, 0.0, 0.0],
                [0.0, 0.1, 0.0],
                [0.0; 3],
                [1.0, 1.0, 0.0],
                [0.1, -0.1, 0.0],
            ),
            (
                [-33.3, 250.0, -2.5],
                [0.0, 0.0, 1.0],
                [0.0; 3],
                [216.7, -283.3, -2.5],
                [0.0, 0.0, 1.0],
                [0.0; 3],
            ),
        ] {
            check(machine.angles(&point), q);
            let rows = machine.rows(&tangent, &bend);
            check(rows.slope, slope);
            check(rows.bend, second);
        }
    }

    #[test]
    fn an_error_of_one_motor_moves_both_axes_by_half_of_it() {
        let machine = CoreXy::new(&CoreXyGeometry::default()).unwrap();
        let tool = machine.forward(&JointAngles([0.4, 0.0, 0.0, 0.0])).unwrap();
        assert!(
            (tool.x_mm - 20.0).abs() < 1.0e-12 && (tool.y_mm - 20.0).abs() < 1.0e-12,
            "{tool:?}"
        );
    }
}
