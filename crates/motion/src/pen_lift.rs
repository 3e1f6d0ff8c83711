//! Where the pen is lifted on the way from one place to another.
//!
//! A pen that the axes lift touches where the tool is low. A pen of its own, which a solenoid or a servo lowers, is on its way
//! while the tool goes down to the paper or up from it, and stands anywhere below the height of a lifted pen: a tool with such
//! a pen counts as low from there on. Moves, and the way to a path's first vertex, lead neither down nor up beside their
//! places; jogs go where they are steered.

use super::work_area::WorkArea;
use crate::robots::vector::{Vector, subtract};
use crate::settings::Settings;

/// Part of the lift below which a pen that the axes lift counts as down.
const NEAR_PAPER: f64 = 0.5;
/// Distance over the paper that a pen need not be lifted for, mm: less than the width of any line.
const BESIDE_MM: f64 = 0.01;
/// Distance below the height of a lifted pen that counts as none, mm: rounding.
const ROUNDING_MM: f64 = 1.0e-6;

/// How the pen is lifted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PenLift {
    lift_mm: f64,
    /// Whether something else than the axes lowers the pen.
    is_separate: bool,
}

impl PenLift {
    /// No lift.
    pub(crate) const NONE: Self = Self {
        lift_mm: 0.0,
        is_separate: false,
    };

    pub(crate) fn new(settings: &Settings) -> Self {
        Self {
            lift_mm: settings.paper.pen_lift_mm,
            is_separate: settings.has_separate_pen,
        }
    }

    /// Height of the tool at a place with the pen up, mm.
    pub(crate) fn up_mm(&self, area: &WorkArea, [x_mm, y_mm, _]: &Vector) -> f64 {
        area.paper().z_at_mm(*x_mm, *y_mm) + self.lift_mm
    }

    /// Whether the pen has to be lifted before the tool leaves this place.
    pub(crate) fn is_low(&self, area: &WorkArea, at: &Vector) -> bool {
        let margin_mm = if self.is_separate {
            ROUNDING_MM
        } else {
            (1.0 - NEAR_PAPER) * self.lift_mm
        };
        at[2] < self.up_mm(area, at) - margin_mm
    }

    /// Where the pen is lifted to from here; not below the present height. `None` if that is outside the work area.
    pub(crate) fn lifted(&self, area: &WorkArea, here: &Vector) -> Option<Vector> {
        let [x, y, z] = *here;
        let above = [x, y, self.up_mm(area, here).max(z)];
        area.keeps_within(&(*here).into(), &above.into()).then_some(above)
    }

    /// Places with the pen up that a way with the pen up leads over: over its beginning, and with a pen of its own over its end. A
    /// move stops at each, a path passes them as it passes other corners.
    pub(crate) fn over(&self, area: &WorkArea, from: &Vector, to: &Vector) -> [Option<Vector>; 2] {
        let [x, y, _] = subtract(to, from);
        if x * x + y * y <= BESIDE_MM * BESIDE_MM {
            return [None; 2];
        }
        let lifted = self.is_low(area, from).then(|| self.lifted(area, from));
        let above = (self.is_separate && self.is_low(area, to)).then(|| [to[0], to[1], self.up_mm(area, to)]);
        [lifted.flatten(), above]
    }

    /// Places that a single move leads over: none without a pen of its own.
    pub(crate) fn over_in_move(&self, area: &WorkArea, from: &Vector, to: &Vector) -> [Option<Vector>; 2] {
        if self.is_separate {
            self.over(area, from, to)
        } else {
            [None; 2]
        }
    }

    /// Where a move that has come to rest before its end lifts the pen to: a pen of its own would stay between up and down.
    pub(crate) fn lifted_after_move(&self, area: &WorkArea, here: &Vector) -> Option<Vector> {
        let lifts = self.is_separate && self.is_low(area, here);
        lifts.then(|| self.lifted(area, here)).flatten()
    }
}
