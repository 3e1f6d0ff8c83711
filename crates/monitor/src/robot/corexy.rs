//! CoreXY: both belts together move x and y.

use crate::vector::Vector;
use std::f64::consts::{SQRT_2, TAU};

/// A machine with two crossed belts, the first of which moves by x + y and the second by x - y, and a linear axis for z.
#[derive(Clone, Debug, PartialEq)]
pub struct CoreXy {
    belt_mm_per_turn: f64,
    z_mm_per_turn: f64,
}

impl CoreXy {
    /// A machine whose belts and z travel this far for a turn, mm.
    #[must_use]
    pub fn new(belt_mm_per_turn: f64, z_mm_per_turn: f64) -> Self {
        Self {
            belt_mm_per_turn,
            z_mm_per_turn,
        }
    }

    /// Position of the tool, mm. A belt that moves alone by 2 mm moves the tool by 1 mm in x and in y.
    pub(super) fn tool(&self, [first, second, z]: [f64; 3]) -> Vector {
        let [first_mm, second_mm] = [first, second].map(|angle_rad| angle_rad / TAU * self.belt_mm_per_turn);
        let (by_first, by_second) = (first_mm / 2.0, second_mm / 2.0);
        [by_first + by_second, by_first - by_second, z / TAU * self.z_mm_per_turn]
    }

    /// Largest change of a joint's angle for a millimetre of the tool, rad/mm: a belt moves fastest along a diagonal.
    pub(super) fn slope_max_rad_mm(&self) -> f64 {
        (SQRT_2 * TAU / self.belt_mm_per_turn).max(TAU / self.z_mm_per_turn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn belts_that_turn_alike_move_x_and_opposite_ones_y() {
        let machine = CoreXy::new(40.0, 8.0);
        assert_eq!(machine.tool([TAU, TAU, TAU]), [40.0, 0.0, 8.0]);
        assert_eq!(machine.tool([TAU, -TAU, 0.0]), [0.0, 40.0, 0.0]);
        assert_eq!(machine.tool([TAU, 0.0, 0.0]), [20.0, 20.0, 0.0]);
    }
}
