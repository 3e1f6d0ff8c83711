//! The gantry: three linear axes at right angles.

use crate::vector::Vector;
use std::f64::consts::TAU;

/// A gantry. Each axis travels by a fixed length for a turn of its pulley or screw.
#[derive(Clone, Debug, PartialEq)]
pub struct Gantry {
    /// Of x, y and z, mm.
    mm_per_turn: [f64; 3],
}

impl Gantry {
    /// A gantry whose axes travel this far for a turn, mm.
    #[must_use]
    pub fn new(mm_per_turn: [f64; 3]) -> Self {
        Self { mm_per_turn }
    }

    /// Position of the tool, mm.
    pub(super) fn tool(&self, angles_rad: [f64; 3]) -> Vector {
        let mut tool = angles_rad.map(|angle_rad| angle_rad / TAU);
        for (length, mm_per_turn) in tool.iter_mut().zip(self.mm_per_turn) {
            *length *= mm_per_turn;
        }
        tool
    }

    /// Largest change of an axis's angle for a millimetre of the tool, rad/mm.
    pub(super) fn slope_max_rad_mm(&self) -> f64 {
        TAU / self.mm_per_turn.into_iter().fold(f64::INFINITY, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_of_each_axis_moves_the_tool_by_its_travel() {
        let gantry = Gantry::new([40.0, 60.0, 8.0]);
        assert_eq!(gantry.tool([TAU, -TAU, 2.5 * TAU]), [40.0, -60.0, 20.0]);
        assert_eq!(gantry.slope_max_rad_mm(), TAU / 8.0);
    }
}
