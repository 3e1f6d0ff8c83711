//! Linear axes: the joint is a wheel that rolls along the axis, and its angle stands for a length.

use super::LINEAR_MM_PER_RAD;
use super::errors::GeometryError;

/// A range that ends at no position that a machine has, mm.
pub(super) const ENDLESS_MM: [f64; 2] = [-1.0e6, 1.0e6];

/// Usual limits of an axis with a belt: speed, mm/s, and acceleration, mm/s2.
pub(super) const BELT_LIMITS: [f64; 2] = [1000.0, 10_000.0];
/// Usual limits of a light upright axis: speed, mm/s, and acceleration, mm/s2.
pub(super) const LIFT_LIMITS: [f64; 2] = [200.0, 3000.0];

/// A linear axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Linear {
    /// Angle for a millimetre, rad/mm.
    pub(super) rad_per_mm: f64,
    /// Length for a radian, mm/rad.
    pub(super) mm_per_rad: f64,
}

/// The wheel that stands for every linear axis.
pub(super) const WHEEL: Linear = Linear {
    rad_per_mm: 1.0 / LINEAR_MM_PER_RAD,
    mm_per_rad: LINEAR_MM_PER_RAD,
};

/// Angles at both ends of a range, rad; likewise speed and acceleration, rad/s and rad/s2.
pub(super) fn angles_rad(range_mm: [f64; 2]) -> [f64; 2] {
    range_mm.map(|length_mm| length_mm * WHEEL.rad_per_mm)
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
