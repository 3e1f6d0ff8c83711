//! The gantry: three linear axes at right angles, each with its own motor.
//!
//! The frame's origin is where all three axes are at 0 mm; z points up.
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
/// A gantry has no singularities.
pub(super) const CONDITIONING_MIN: ConditioningMin = ConditioningMin {
    ratio: 0.0,
    determinant: 0.0,
};

/// Dimensions of a gantry.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GantryGeometry {
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

impl Default for GantryGeometry {
    /// A plotter for A2: belts over pulleys of 20 teeth with a pitch of 2 mm, and a screw with a pitch of 8 mm.
    fn default() -> Self {
        Self {
            x_range_mm: [0.0, 600.0],
            y_range_mm: [0.0, 450.0],
            z_range_mm: [-60.0, 0.0],
            margin_mm: 1.0,
            turn_range_rad: [-6_283.0, 6_283.0],
        }
    }
}

impl GantryGeometry {
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

    /// Lowest and highest angle of each main axis, rad.
    pub(super) fn ranges_rad(&self) -> [[f64; 2]; MAIN_AXES] {
        [
            angles_rad(self.x_range_mm),
            angles_rad(self.y_range_mm),
            angles_rad(self.z_range_mm),
        ]
    }

    /// Angles of the margin, rad.
    pub(super) fn margins_rad(&self) -> [f64; MAIN_AXES] {
        let [_, margin] = angles_rad([0.0, self.margin_mm]);
        [margin; MAIN_AXES]
    }

    /// Usual highest speed and acceleration of each main axis, rad/s and rad/s2.
    pub(super) fn usual_limits(&self) -> [[f64; 2]; MAIN_AXES] {
        [
            angles_rad(BELT_LIMITS),
            angles_rad(BELT_LIMITS),
            angles_rad(LIFT_LIMITS),
        ]
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

/// A gantry of known dimensions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gantry {
    axes: [Linear; MAIN_AXES],
    ranges_rad: [[f64; 2]; MAIN_AXES],
}

impl Gantry {
    /// Makes a robot from its dimensions.
    ///
    /// # Errors
    /// Why the dimensions do not form a valid gantry, see [`GeometryError`].
    pub(super) fn new(geometry: &GantryGeometry) -> Result<Self, GeometryError> {
        for range_mm in [geometry.x_range_mm, geometry.y_range_mm, geometry.z_range_mm] {
            check_stroke(range_mm)?;
        }
        Ok(Self {
            axes: [WHEEL, WHEEL, WHEEL],
            ranges_rad: geometry.ranges_rad(),
        })
    }

    /// Axis angles for a position, rad.
    ///
    /// # Errors
    /// The position is not finite, or the first axis that is outside its range.
    pub(super) fn inverse(&self, position: &Position) -> Result<[f64; MAIN_AXES], KinematicsError> {
        let point = Vector::from(*position);
        if !point.iter().all(|value| value.is_finite()) {
            return Err(KinematicsError::NotFinite);
        }
        super::in_range(self.angles(&point), &self.ranges_rad)
    }

    /// Axis angles without checks, rad.
    #[inline(never)]
    pub(super) fn angles(&self, point: &Vector) -> [f64; MAIN_AXES] {
        let ([x, y, z], [of_x, of_y, of_z]) = (point, &self.axes);
        [x * of_x.rad_per_mm, y * of_y.rad_per_mm, z * of_z.rad_per_mm]
    }

    /// Derivatives of the angles along a path with the unit tangent `tangent` and the curvature vector `bend` (1/mm).
    #[inline(never)]
    pub(super) fn rows(&self, tangent: &Vector, bend: &Vector) -> JointRows {
        JointRows {
            slope: self.angles(tangent),
            bend: self.angles(bend),
        }
    }

    /// Whether every axis is in its range.
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
        let ([x, y, z, _], [of_x, of_y, of_z]) = (joints.0, &self.axes);
        super::finite(joints, [x * of_x.mm_per_rad, y * of_y.mm_per_rad, z * of_z.mm_per_rad])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_is_an_angle_of_the_wheel() {
        let gantry = Gantry::new(&GantryGeometry::default()).unwrap();
        let at = |x_mm, y_mm, z_mm| gantry.inverse(&Position { x_mm, y_mm, z_mm });
        assert_eq!(at(40.0, 120.0, -4.0), Ok([0.4, 1.2, -0.04]));
        assert!(matches!(
            at(600.5, 0.0, 0.0),
            Err(KinematicsError::Range { joint: 0, .. })
        ));
        assert!(matches!(
            at(0.0, -0.5, 0.0),
            Err(KinematicsError::Range { joint: 1, .. })
        ));
        assert!(matches!(
            at(0.0, 0.0, -60.5),
            Err(KinematicsError::Range { joint: 2, .. })
        ));
        assert_eq!(at(f64::NAN, 0.0, 0.0), Err(KinematicsError::NotFinite));
    }

    #[test]
    fn dimensions_that_do_not_form_a_machine_are_refused() {
        let refuse = |change: fn(&mut GantryGeometry)| {
            let mut geometry = GantryGeometry::default();
            change(&mut geometry);
            Gantry::new(&geometry).unwrap_err()
        };
        assert_eq!(refuse(|g| g.y_range_mm[1] = f64::INFINITY), GeometryError::NotFinite);
        let stroke = refuse(|g| g.x_range_mm = [5.0, 5.0]);
        assert!(matches!(stroke, GeometryError::Stroke { .. }));
    }
}
