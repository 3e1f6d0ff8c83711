//! Acceleration of the tool: in sound motion it keeps the configured limit.
//!
//! Of three positions [`WINDOW_MS`] apart, the middle one is at most a T^2 / 2 beside the middle of the others, whatever the
//! acceleration was between them, as long as it was at most a. Twice this distance is judged, with twice the following error of
//! steady motion (`Cell::undisturbed_mm`) and [`MARGIN`] for what the drives add: with an error of 0.02 mm that is 300 mm/s2
//! more than the limit, with the errors of drives in torque mode far more. Upwards and downwards, the acceleration of the pen's
//! lift comes on top.

use crate::scene::{Finding, Scene};
use crate::vector::{Vector, add, scale, subtract};
use crate::violation::Rule;
use std::collections::VecDeque;

/// Time from one of the three positions to the next, ms.
const WINDOW_MS: usize = 12;
/// Part of the limit that the drives may add.
const MARGIN: f64 = 0.02;

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct ToolAcceleration {
    /// The last positions without a disturbance.
    positions: VecDeque<Vector>,
}

impl ToolAcceleration {
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        let Some(tool) = scene
            .motion
            .tool
            .filter(|_| scene.is_sound() && scene.more_mm == Some(0.0))
        else {
            self.positions.clear();
            return Ok(());
        };
        if !scene.motion.is_steady {
            self.positions.clear();
        }
        self.positions.push_back(tool);
        let (Some(middle), Some(first)) = (self.positions.get(WINDOW_MS), self.positions.front()) else {
            return Ok(());
        };
        if self.positions.len() <= 2 * WINDOW_MS {
            return Ok(());
        }
        let beside = subtract(add(tool, *first), scale(*middle, 2.0));
        self.positions.pop_front();
        let squared_s2 = (WINDOW_MS * WINDOW_MS) as f64 * 1.0e-6;
        let cell = scene.cell;
        let [x, y, z] = beside;
        let (level, upright) = (
            cell.tool_acceleration_mm_s2,
            cell.tool_acceleration_mm_s2 + cell.pen_acceleration_mm_s2,
        );
        for (name, beside_mm, limit_mm_s2) in [("level", x.hypot(y), level), ("upright", z.abs(), upright)] {
            let bound_mm = (1.0 + MARGIN) * limit_mm_s2 * squared_s2 + 2.0 * cell.undisturbed_mm;
            if beside_mm > bound_mm {
                let (is, may) = (beside_mm / squared_s2, bound_mm / squared_s2);
                let text =
                    format!("{name}, the tool accelerates by {is:.0} mm/s2 for {WINDOW_MS} ms, bound {may:.0} mm/s2");
                return Err((Rule::Acceleration, text));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::cell::Cell;
    use crate::rig::{Rig, broken};
    use crate::violation::{Rule, Violation};

    /// Moves the tool from rest to rest in 100 ms: it begins with 600/s2 times the way.
    fn go(way_mm: [f64; 3], pen_acceleration_mm_s2: f64) -> Result<(), Violation> {
        let mut rig = Rig::with(Cell {
            undisturbed_mm: 0.02,
            tool_acceleration_mm_s2: 1_000.0,
            pen_acceleration_mm_s2,
            ..Cell::default()
        });
        rig = rig.at_height(-800.0).in_motion();
        let [x, y, z] = way_mm;
        rig.go_to([x, y, z - 800.0], 100)
    }

    #[test]
    fn a_gap_in_the_time_is_no_acceleration() {
        let mut rig = Rig::with(Cell {
            undisturbed_mm: 0.02,
            tool_acceleration_mm_s2: 1_000.0,
            ..Cell::default()
        })
        .at_height(-800.0)
        .in_motion();
        assert_eq!(rig.go_to([1.6, 0.0, -800.0], 100), Ok(()));
        // Unseen, it moves as far again.
        rig.miss([3.2, 0.0, -800.0], 100);
        assert_eq!(rig.go_to([4.8, 0.0, -800.0], 100), Ok(()));
    }

    #[test]
    fn the_tool_keeps_its_acceleration_and_the_pen_has_one_of_its_own() {
        assert_eq!(go([1.6, 0.0, 0.0], 0.0), Ok(()));
        assert_eq!(go([0.0, 0.0, 1.6], 0.0), Ok(()));
        for way_mm in [[3.2, 0.0, 0.0], [0.0, -3.2, 0.0], [2.3, 2.3, 0.0], [0.0, 0.0, 3.2]] {
            assert!(broken(&go(way_mm, 0.0), Rule::Acceleration), "{way_mm:?}");
        }
        assert_eq!(go([0.0, 0.0, 3.2], 1_000.0), Ok(()));
        assert!(broken(&go([3.2, 0.0, 0.0], 1_000.0), Rule::Acceleration));
    }
}
