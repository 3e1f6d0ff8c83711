//! The gantry: three slides at right angles.

use super::{Joint, MAIN_AXES, slide};
use crate::series::Series3;

/// A gantry.
#[derive(Clone, Debug)]
pub struct Gantry {
    mm_per_turn: [f64; MAIN_AXES],
}

impl Gantry {
    /// A gantry whose axes travel this far for a turn, mm.
    #[must_use]
    pub fn new(mm_per_turn: [f64; MAIN_AXES]) -> Self {
        Self { mm_per_turn }
    }

    pub(super) fn joints(&self, point: &Series3, first: &Series3) -> [Joint; MAIN_AXES] {
        let [x, y, z] = self.mm_per_turn;
        [
            slide([1.0, 0.0, 0.0], x, point, first),
            slide([0.0, 1.0, 0.0], y, point, first),
            slide([0.0, 0.0, 1.0], z, point, first),
        ]
    }
}
