//! SCARA: two links that turn in the horizontal plane, and a linear axis for z.

use crate::vector::Vector;
use std::f64::consts::TAU;

/// Smallest sine of the elbow's angle in a work area.
const ELBOW_SINE_MIN: f64 = 0.3;

/// A SCARA. The elbow's angle is measured against the inner link.
#[derive(Clone, Debug, PartialEq)]
pub struct Scara {
    inner_mm: f64,
    outer_mm: f64,
    z_mm_per_turn: f64,
}

impl Scara {
    /// A SCARA with links of these lengths, mm, and the travel of z for a turn, mm.
    #[must_use]
    pub fn new(inner_mm: f64, outer_mm: f64, z_mm_per_turn: f64) -> Self {
        Self {
            inner_mm,
            outer_mm,
            z_mm_per_turn,
        }
    }

    /// Position of the tool, mm: the outer link is turned by the elbow and moved along the inner link, then both are
    /// turned by the shoulder.
    pub(super) fn tool(&self, [shoulder, elbow, z]: [f64; 3]) -> Vector {
        let (sine, cosine) = elbow.sin_cos();
        let (along, across) = (self.inner_mm + self.outer_mm * cosine, self.outer_mm * sine);
        let (sine, cosine) = shoulder.sin_cos();
        [
            along * cosine - across * sine,
            along * sine + across * cosine,
            z / TAU * self.z_mm_per_turn,
        ]
    }

    /// Largest change of a joint's angle for a millimetre of the tool, rad/mm. The elbow turns fastest along the line to
    /// the shoulder: there the lever is the distance of the shoulder from the outer link's line.
    pub(super) fn slope_max_rad_mm(&self) -> f64 {
        let reach_mm = self.inner_mm + self.outer_mm;
        let turning = reach_mm / (self.inner_mm * self.outer_mm * ELBOW_SINE_MIN).max(1.0);
        turning.max(TAU / self.z_mm_per_turn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn a_right_angle_at_the_elbow_puts_the_tool_beside_it() {
        let scara = Scara::new(225.0, 175.0, 20.0);
        let near = |tool: Vector, expected: Vector| {
            for (value, expected) in tool.iter().zip(expected) {
                assert!((value - expected).abs() < 1e-9, "{tool:?}");
            }
        };
        near(scara.tool([0.0, 0.0, -TAU]), [400.0, 0.0, -20.0]);
        near(scara.tool([0.0, FRAC_PI_2, 0.0]), [225.0, 175.0, 0.0]);
        near(scara.tool([FRAC_PI_2, FRAC_PI_2, 0.0]), [-175.0, 225.0, 0.0]);
    }
}
