//! CoreXY: the belts are slides along both diagonals, z is a slide of its own.

use super::{Joint, MAIN_AXES, slide};
use crate::series::Series3;

/// A machine with two crossed belts, the first of which moves by x + y and the second by x - y.
#[derive(Clone, Debug)]
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

    pub(super) fn joints(&self, point: &Series3, first: &Series3) -> [Joint; MAIN_AXES] {
        [
            slide([1.0, 1.0, 0.0], self.belt_mm_per_turn, point, first),
            slide([1.0, -1.0, 0.0], self.belt_mm_per_turn, point, first),
            slide([0.0, 0.0, 1.0], self.z_mm_per_turn, point, first),
        ]
    }
}
