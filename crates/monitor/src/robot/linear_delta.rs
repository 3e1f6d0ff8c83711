//! Linear delta: three carriages on upright towers hold a platform with rods of equal length.

use super::spheres::below;
use crate::vector::Vector;
use std::f64::consts::TAU;

/// Number of towers.
const TOWERS: usize = super::MAIN_AXES;
/// Smallest sine of a rod's angle above the horizontal in a work area.
const ROD_SINE_MIN: f64 = 0.35;

/// Dimensions of a linear delta.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearDeltaDimensions {
    /// Distance of the rods' upper joints from the axis less that of the lower ones from the platform's centre, mm.
    pub radius_mm: f64,
    /// Length of a rod, mm.
    pub rod_mm: f64,
    /// Azimuths of the towers, degrees.
    pub azimuths_deg: [f64; TOWERS],
    /// Travel of a carriage for a turn, mm.
    pub carriage_mm_per_turn: f64,
}

/// A linear delta. The platform hangs below the carriages.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearDelta {
    dimensions: LinearDeltaDimensions,
}

impl LinearDelta {
    /// A linear delta of these dimensions. Dimensions that are no robot have no tool position.
    #[must_use]
    pub fn new(dimensions: &LinearDeltaDimensions) -> Self {
        Self {
            dimensions: *dimensions,
        }
    }

    /// Position of the platform's centre, mm; `None` if the rods do not meet.
    pub(super) fn tool(&self, carriages_rad: [f64; TOWERS]) -> Option<Vector> {
        let LinearDeltaDimensions {
            radius_mm,
            rod_mm,
            azimuths_deg,
            carriage_mm_per_turn,
        } = self.dimensions;
        let mut centres = [[0.0; 3]; TOWERS];
        for (centre, (angle_rad, azimuth_deg)) in centres.iter_mut().zip(carriages_rad.iter().zip(azimuths_deg)) {
            let (sine, cosine) = azimuth_deg.to_radians().sin_cos();
            *centre = [
                radius_mm * cosine,
                radius_mm * sine,
                angle_rad / TAU * carriage_mm_per_turn,
            ];
        }
        below(centres, rod_mm * rod_mm)
    }

    /// Largest change of a carriage's angle for a millimetre of the platform, rad/mm.
    pub(super) fn slope_max_rad_mm(&self) -> f64 {
        TAU / (self.dimensions.carriage_mm_per_turn * ROD_SINE_MIN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KOSSEL: LinearDeltaDimensions = LinearDeltaDimensions {
        radius_mm: 134.0,
        rod_mm: 265.0,
        azimuths_deg: [90.0, 210.0, 330.0],
        carriage_mm_per_turn: 40.0,
    };

    #[test]
    fn equal_carriages_hold_the_platform_on_the_axis_at_the_height_that_pythagoras_gives() {
        let [x, y, z] = LinearDelta::new(&KOSSEL).tool([TAU * 8.0; 3]).unwrap();
        let expected = 320.0 - (265.0_f64 * 265.0 - 134.0 * 134.0).sqrt();
        assert!(
            x.abs() < 1e-9 && y.abs() < 1e-9 && (z - expected).abs() < 1e-9,
            "{x} {y} {z}"
        );
    }

    #[test]
    fn rods_that_are_too_short_hold_nothing() {
        let short = LinearDeltaDimensions {
            rod_mm: 130.0,
            ..KOSSEL
        };
        assert_eq!(LinearDelta::new(&short).tool([TAU; 3]), None);
    }
}
