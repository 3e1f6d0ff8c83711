//! Linear axes: the joint is a pulley or screw, and its angle stands for a length.

use super::geometry::GeometryError;
use core::f64::consts::TAU;

/// A range that ends at no position that a machine has, mm.
pub(super) const ENDLESS_MM: [f64; 2] = [-1.0e6, 1.0e6];

/// Usual limits of an axis with a belt: speed, mm/s, and acceleration, mm/s2.
pub(super) const BELT_LIMITS: [f64; 2] = [1000.0, 10_000.0];
/// Usual limits of a light upright axis: speed, mm/s, and acceleration, mm/s2.
pub(super) const LIFT_LIMITS: [f64; 2] = [200.0, 3000.0];

/// A linear axis of known travel per turn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Linear {
    /// Angle for a millimetre, rad/mm.
    pub(super) rad_per_mm: f64,
    /// Length for a radian, mm/rad.
    pub(super) mm_per_rad: f64,
}

impl Linear {
    /// An axis that travels this far for one turn of its pulley or screw, mm.
    ///
    /// # Errors
    /// [`GeometryError::NotFinite`], or [`GeometryError::Travel`] if the travel is not positive.
    pub(super) fn new(mm_per_turn: f64) -> Result<Self, GeometryError> {
        if !mm_per_turn.is_finite() {
            return Err(GeometryError::NotFinite);
        }
        if mm_per_turn <= 0.0 {
            return Err(GeometryError::Travel { mm_per_turn });
        }
        Ok(Self {
            rad_per_mm: TAU / mm_per_turn,
            mm_per_rad: mm_per_turn / TAU,
        })
    }

    /// Angles at both ends of a range, rad.
    pub(super) fn range_rad(&self, range_mm: [f64; 2]) -> [f64; 2] {
        range_mm.map(|length_mm| length_mm * self.rad_per_mm)
    }
}

/// Angles of a pulley or screw at both ends of a range, rad; 0 for a travel that is not positive.
pub(super) fn angles_rad(range_mm: [f64; 2], mm_per_turn: f64) -> [f64; 2] {
    Linear::new(mm_per_turn).map_or([0.0; 2], |axis| axis.range_rad(range_mm))
}

/// Speed and acceleration of a joint, rad/s and rad/s2, for those of its length, mm/s and mm/s2.
pub(super) fn limits_rad([speed_mm_s, acceleration_mm_s2]: [f64; 2], mm_per_turn: f64) -> [f64; 2] {
    angles_rad([speed_mm_s, acceleration_mm_s2], mm_per_turn)
}

/// Checks that a range has two finite ends in order.
///
/// # Errors
/// [`GeometryError::NotFinite`] or [`GeometryError::Stroke`].
pub(super) fn check_stroke([low_mm, high_mm]: [f64; 2]) -> Result<(), GeometryError> {
    if !(low_mm.is_finite() && high_mm.is_finite()) {
        return Err(GeometryError::NotFinite);
    }
    if low_mm >= high_mm {
        return Err(GeometryError::Stroke { low_mm, high_mm });
    }
    Ok(())
}
