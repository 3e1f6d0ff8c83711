//! The grid of a plan: points on the path, each with the interval that begins at it.
//!
//! A point carries the inputs of the scan (the joints' row, the caps of its speed); an interval carries its place on
//! its piece. Invariant: an interval's parameter grows with its arc length, and no point of it lies outside its two
//! ends.

use super::limits::Limits;
use super::scan::{Interval, Middle, Row};
use super::shaping::Piece;

/// Newton steps from arc length to parameter.
const ARC_STEPS: usize = 2;
/// Remaining length of an interval that counts as its end, mm.
pub(super) const ARRIVED_MM: f64 = 1.0e-9;

/// The interval that begins at a point of the grid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub(super) length_mm: f64,
    pub(super) piece: u32,
    pub(super) parameter: [f64; 2],
    /// Derivative of the arc length with respect to the parameter at both ends, mm.
    pub(super) stretch: [f64; 2],
    /// Angle of the fourth axis at the beginning, rad, and the change of its slope, rad/mm2.
    pub(super) heading: f64,
    pub(super) turn_change: f64,
    /// Whether the pen is lifted or lowered.
    pub(super) lifts: bool,
    /// Whether the interval lies on a curve, where the limits in its middle apply too.
    pub(super) curved: bool,
    pub(super) middle: Middle,
}

impl Span {
    pub(super) const NONE: Self = Self {
        length_mm: 0.0,
        piece: 0,
        parameter: [0.0; 2],
        stretch: [0.0; 2],
        heading: 0.0,
        turn_change: 0.0,
        lifts: false,
        curved: false,
        middle: Middle::NONE,
    };
}

#[derive(Clone, Copy, Debug)]
pub(super) struct GridPoint {
    pub(super) row: Row,
    /// Largest squared speed that the robot allows, mm2/s2.
    pub(super) cap: f64,
    /// Squared speed of the path at 100 % override, mm2/s2.
    pub(super) nominal: f64,
    /// Largest squared speed from which the motion can come to rest at the end of the plan, mm2/s2.
    pub(super) reach: f64,
    pub(super) span: Span,
    pub(super) stop: bool,
    pub(super) dwell: bool,
}

impl GridPoint {
    pub(super) const NONE: Self = Self {
        row: Row::NONE,
        cap: 0.0,
        nominal: 0.0,
        reach: 0.0,
        span: Span::NONE,
        stop: false,
        dwell: false,
    };

    /// The interval that begins at this point, or `offset_mm` later.
    pub(super) fn interval<'a>(
        &self,
        limits: &'a Limits,
        start: &'a Row,
        next: &'a Self,
        offset_mm: f64,
    ) -> Interval<'a> {
        let ahead_mm = 0.5 * self.span.length_mm - offset_mm;
        Interval {
            limits,
            start,
            end: &next.row,
            length_mm: self.span.length_mm - offset_mm,
            end_squared: next.reach,
            turn_change: self.span.turn_change,
            lifts: self.span.lifts,
            middle: (self.span.curved && ahead_mm > 0.0).then_some((self.span.middle, ahead_mm)),
        }
    }

    /// Angle of the fourth axis on the interval, rad.
    pub(super) fn heading_at(&self, offset_mm: f64) -> f64 {
        self.span.heading + offset_mm * (self.row.turn + 0.5 * self.span.turn_change * offset_mm)
    }
}

impl Span {
    /// Parameter at half of the arc length, from the cubic through both ends.
    pub(super) fn middle_parameter(&self) -> f64 {
        let [from, to] = self.parameter;
        let [stretch_from, stretch_to] = self.stretch;
        let parameter = 0.5 * (from + to) + 0.125 * self.length_mm * (1.0 / stretch_from - 1.0 / stretch_to);
        if from < parameter && parameter < to {
            parameter
        } else {
            0.5 * (from + to)
        }
    }

    /// Parameter at an arc length from the span's beginning: a cubic through both ends, then Newton's method.
    pub(super) fn parameter_at(&self, piece: &Piece, offset_mm: f64) -> f64 {
        let [from, to] = self.parameter;
        let [stretch_from, stretch_to] = self.stretch;
        let part = offset_mm / self.length_mm;
        let (square, cube) = (part * part, part * part * part);
        let mut parameter = from
            + (3.0 * square - 2.0 * cube) * (to - from)
            + (cube - 2.0 * square + part) * (self.length_mm / stretch_from)
            + (cube - square) * (self.length_mm / stretch_to);
        for _ in 0..ARC_STEPS {
            let error = piece.curve.arc(from, parameter) - offset_mm;
            let stretch = piece.curve.stretch(parameter);
            if error.abs() <= ARRIVED_MM || stretch <= 0.0 {
                break;
            }
            parameter -= error / stretch;
        }
        if parameter.is_finite() {
            parameter.clamp(from, to)
        } else {
            from
        }
    }
}
