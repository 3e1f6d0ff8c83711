//! Tolerance: where nothing is disturbed, a pen that draws keeps the tolerance of its line.
//!
//! In plan view the pen is within the tolerance of a leg, 0.02 mm for the following error in steady motion
//! (`Cell::undisturbed_mm`), and half the acceleration times the square of a lag of 4 ms. Judged is a pen that touches
//! far from every leg of travel, once nothing has been disturbed, stopped or switched for a second.

use crate::scene::{Finding, Scene};
use crate::violation::Rule;

/// Time for which nothing must have been disturbed, ms: after it no correction of an earlier disturbance is under way.
const QUIET_MS: u32 = 1_000;

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tolerance {
    quiet_ms: u32,
}

impl Tolerance {
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        let was_quiet_ms = self.quiet_ms;
        self.quiet_ms = if scene.is_sound() {
            was_quiet_ms.saturating_add(1)
        } else {
            0
        };
        let is_judged = scene.moment.pen_touches && scene.place.is_some_and(|place| place.draws);
        let Some(tool) = scene.motion.tool.filter(|_| is_judged && was_quiet_ms >= QUIET_MS) else {
            return Ok(());
        };
        let bound_mm = scene.bounds.undisturbed_mm;
        if scene.drawing.has_line_within(&tool, bound_mm) {
            return Ok(());
        }
        let [x, y, _] = tool;
        let text = format!("the pen draws at {x:.3}, {y:.3} mm, more than {bound_mm:.4} mm beside every line");
        Err((Rule::Tolerance, text))
    }
}

#[cfg(test)]
mod tests {
    use crate::cell::Cell;
    use crate::rig::{Rig, broken};
    use crate::violation::{Rule, Violation};

    /// Draws a line that ends so far beside the ordered one, after this time.
    fn draw_beside(beside_mm: f64, waited_ms: u32) -> Result<(), Violation> {
        let cell = Cell {
            undisturbed_mm: 0.02,
            tool_acceleration_mm_s2: 1_000.0,
            pen_acceleration_mm_s2: 10_000.0,
            ..Cell::default()
        };
        let mut rig = Rig::drawing_on_paper_with(cell);
        assert_eq!(rig.run(waited_ms), Ok(()));
        rig.go_to([30.0, beside_mm, -850.0], 600)
    }

    #[test]
    fn a_line_that_is_drawn_beside_its_place_breaks_the_rule() {
        assert_eq!(draw_beside(0.07, 1_100), Ok(()), "0.05 mm, 0.02 mm and 0.008 mm");
        assert!(broken(&draw_beside(0.1, 1_100), Rule::Tolerance));
    }

    #[test]
    fn a_pen_that_was_disturbed_a_moment_ago_is_not_judged() {
        assert_eq!(draw_beside(0.1, 10), Ok(()));
    }
}
