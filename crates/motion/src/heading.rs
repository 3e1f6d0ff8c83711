//! The fourth axis on a path: the direction of the path in plan view, as a continuous angle.
//!
//! Where the path has no direction in plan view, during lifting or lowering the pen, the angle is free: a vertical leg
//! turns it to the direction of the next leg. Where the direction jumps, at an exact stop, the axis turns at rest by
//! the shorter way; a half turn goes towards 0, so that strokes to and fro do not wind the axis up.
//!
//! Between two points of the grid the angle is a quadratic function of arc length, so the axis's acceleration has its
//! largest values at the points and the scan's rows there are exact bounds. The intervals come in pairs: at both ends
//! of a pair the angle is the path's, and the slope in its middle connects the two.

use super::curve::direction;
use super::limits::Limits;
use super::shaping::{Change, Piece};
use crate::robots::vector::{Vector, length, root, scale};
use core::f64::consts::{PI, TAU};

/// Distance from a half turn within which both ways count as equally long, rad.
const HALF_TURN_RAD: f64 = 1.0e-6;
/// Difference of angles that counts as zero, rad.
pub(crate) const NONE_RAD: f64 = 1.0e-9;

/// Turn from an angle to a direction by the shorter way, rad; a half turn goes towards the angle 0.
pub(crate) fn turn_to(angle: f64, direction: f64) -> f64 {
    let difference = direction - angle;
    let turn = difference - TAU * libm::round(difference / TAU);
    let either_way = turn.abs() > PI - HALF_TURN_RAD;
    if either_way && turn > 0.0 && angle > 0.0 {
        turn - TAU
    } else if either_way && turn < 0.0 && angle <= 0.0 {
        turn + TAU
    } else {
        turn
    }
}

/// Derivative of the direction with respect to arc length, rad/mm, for a unit tangent and a curvature vector.
fn slope(tangent: &Vector, bend: &Vector) -> f64 {
    let across = tangent[0] * bend[1] - tangent[1] * bend[0];
    across / (tangent[0] * tangent[0] + tangent[1] * tangent[1])
}

/// Angle of the fourth axis after each leg of a path. The shaped path turns at a vertex by the angle between its legs,
/// so [`Course`] has this angle at the end of each leg too.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Winding {
    angle: f64,
}

impl Winding {
    /// Starts at an angle, rad.
    pub(crate) fn new(angle: f64) -> Self {
        Self { angle }
    }

    /// The axis's angle, rad.
    pub(crate) fn angle_rad(&self) -> f64 {
        self.angle
    }

    /// The state after a leg.
    pub(crate) fn over(self, leg: &Vector) -> Self {
        let whole = length(leg);
        let tangent = scale(leg, if whole > 0.0 { 1.0 / whole } else { 0.0 });
        let turn = direction(&tangent).map_or(0.0, |direction| turn_to(self.angle, direction));
        Self {
            angle: self.angle + turn,
        }
    }
}

/// The axis's angle along one interval of the grid.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Turning {
    /// Slope at the end of the interval, rad/mm.
    pub(crate) end_slope: f64,
    /// Derivative of the slope with respect to arc length, rad/mm2.
    pub(crate) change: f64,
}

/// Computes the axis's angle, one interval of the grid after the other.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Course {
    /// Whether the axis follows the path.
    pub(crate) follows: bool,
    /// Angle at the end of the grid, rad.
    pub(crate) angle: f64,
    /// Angle at the beginning of the present piece.
    piece_angle: f64,
    /// Angle and slope at the end of the present pair of intervals.
    pair_angle: f64,
    pair_slope: f64,
}

impl Course {
    pub(crate) const fn new() -> Self {
        Self {
            follows: false,
            angle: 0.0,
            piece_angle: 0.0,
            pair_angle: 0.0,
            pair_slope: 0.0,
        }
    }

    /// Number of intervals of a piece; an even number where the axis follows the path.
    pub(crate) fn intervals(&self, piece: &Piece) -> u16 {
        let intervals = piece.intervals.max(1);
        if self.follows {
            intervals.saturating_add(intervals & 1)
        } else {
            intervals
        }
    }

    /// Turns at rest to the direction in which a piece begins.
    pub(crate) fn depart(&mut self, piece: &Piece) {
        if let Some(direction) = direction(&piece.curve.frame(0.0).tangent).filter(|_| self.follows) {
            let turn = turn_to(self.angle, direction);
            if turn.abs() > NONE_RAD {
                self.angle += turn;
            }
        }
    }

    /// Advances over interval `index` of a piece, from a point of the grid with the slope `start_slope`.
    pub(crate) fn advance(&mut self, piece: &Piece, index: u16, start_slope: f64) -> Turning {
        let intervals = f64::from(self.intervals(piece));
        let at = |index: u16| (f64::from(index) / intervals).min(1.0);
        let (from, to) = (at(index), at(index.saturating_add(1)));
        let length = piece.curve.arc(from, to);
        if index == 0 {
            self.piece_angle = self.angle;
        }
        let end_slope = if index.is_multiple_of(2) {
            let end = at(index.saturating_add(2));
            (self.pair_angle, self.pair_slope) = self.at(piece, end);
            let turn = self.pair_angle - self.angle;
            if turn.abs() <= NONE_RAD && start_slope == 0.0 && self.pair_slope == 0.0 {
                self.pair_angle = self.angle;
                return Turning {
                    end_slope: 0.0,
                    change: 0.0,
                };
            }
            let second = piece.curve.arc(to, end);
            (2.0 * turn - start_slope * length - self.pair_slope * second) / (length + second)
        } else {
            self.pair_slope
        };
        self.angle = if index.is_multiple_of(2) {
            self.angle + 0.5 * (start_slope + end_slope) * length
        } else {
            self.pair_angle
        };
        Turning {
            end_slope,
            change: (end_slope - start_slope) / length,
        }
    }

    /// Angle and slope of the axis at a parameter of a piece.
    fn at(&self, piece: &Piece, parameter: f64) -> (f64, f64) {
        let frame = piece.curve.frame(parameter);
        if let Change::Turn(target) = piece.change {
            let turn = turn_to(self.piece_angle, target);
            let square = parameter * parameter;
            let angle = self.piece_angle + turn * square * (3.0 - 2.0 * parameter);
            let stretch = piece.curve.stretch(parameter);
            return (angle, 6.0 * turn * (parameter - square) / stretch);
        }
        match direction(&frame.tangent) {
            Some(direction) => (
                self.angle + turn_to(self.angle, direction),
                slope(&frame.tangent, &frame.bend),
            ),
            None => (self.angle, 0.0),
        }
    }
}

/// A pause at an exact stop: the axis turns, then the pen waits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pause {
    from: f64,
    turn: f64,
    speed: f64,
    acceleration: f64,
    turn_s: f64,
    dwell_s: f64,
    elapsed_s: f64,
}

impl Pause {
    /// A turn from one angle to another, rad, then a wait of `dwell_s`.
    pub(crate) fn new(limits: &Limits, from: f64, to: f64, dwell_s: f64) -> Self {
        let turn = to - from;
        let acceleration = limits.turn_acceleration;
        let speed = root((turn.abs() * acceleration).min(limits.turn_speed_squared));
        let turn_s = if speed > 0.0 {
            turn.abs() / speed + speed / acceleration
        } else if turn != 0.0 {
            f64::INFINITY
        } else {
            0.0
        };
        Self {
            from,
            turn,
            speed,
            acceleration,
            turn_s,
            dwell_s,
            elapsed_s: 0.0,
        }
    }

    /// Whether the pause is empty.
    pub(crate) fn is_none(&self) -> bool {
        self.turn_s + self.dwell_s <= 0.0
    }

    /// Ends the pause after the turn.
    pub(crate) fn cut(&mut self) {
        self.dwell_s = 0.0;
    }

    /// Advances the pause by a time; returns the time left over.
    pub(crate) fn run(&mut self, time_s: f64) -> f64 {
        self.elapsed_s += time_s;
        (self.elapsed_s - self.turn_s - self.dwell_s).max(0.0)
    }

    pub(crate) fn complete(&self) -> bool {
        self.elapsed_s >= self.turn_s + self.dwell_s
    }

    /// The axis's angle, rad.
    pub(crate) fn angle(&self) -> f64 {
        let left_s = self.turn_s - self.elapsed_s;
        if left_s <= 0.0 {
            return self.from + self.turn;
        }
        let ramp_s = self.speed / self.acceleration;
        let whole = self.turn.abs();
        let passed = if self.elapsed_s < ramp_s.min(left_s) {
            0.5 * self.acceleration * self.elapsed_s * self.elapsed_s
        } else if left_s < ramp_s {
            whole - 0.5 * self.acceleration * left_s * left_s
        } else {
            self.speed * (self.elapsed_s - 0.5 * ramp_s)
        };
        if self.turn < 0.0 {
            self.from - passed
        } else {
            self.from + passed
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::curve::Curve;
    use super::*;

    #[test]
    fn turns_go_the_shorter_way_and_half_turns_towards_zero() {
        assert!((turn_to(3.0, -3.0) - (TAU - 6.0)).abs() < 1.0e-12);
        assert!((turn_to(100.0 * TAU + 0.5, 0.2) + 0.3).abs() < 1.0e-9);
        assert!((turn_to(0.5, 0.5 - PI) + PI).abs() < 1.0e-9);
        assert!((turn_to(0.5, 0.5 + PI) + PI).abs() < 1.0e-9);
        assert!((turn_to(-0.5, PI - 0.5) - PI).abs() < 1.0e-9);
        assert_eq!(turn_to(0.7, 0.7), 0.0);
    }

    #[test]
    fn a_vertical_tangent_has_no_direction() {
        assert_eq!(direction(&[0.0, 0.0, -1.0]), None);
        assert_eq!(direction(&[0.0, 1.0, 0.0]), Some(PI / 2.0));
    }
    #[test]
    fn where_a_piece_departs_in_another_direction_the_axis_has_turned_before() {
        for (follows, expected) in [(true, PI / 2.0), (false, 0.3)] {
            let mut course = Course {
                follows,
                angle: 0.3,
                ..Course::new()
            };
            let piece = Piece {
                curve: Curve::line(&[10.0, 0.0, -850.0], &[10.0, 25.0, -850.0]),
                intervals: 4,
                ..Piece::NONE
            };
            course.depart(&piece);
            assert!((course.angle - expected).abs() < 1.0e-12, "{} rad", course.angle);
            let up = Piece {
                curve: Curve::line(&[10.0, 0.0, -850.0], &[10.0, 0.0, -840.0]),
                ..piece
            };
            course.depart(&up);
            assert!((course.angle - expected).abs() < 1.0e-12, "{} rad", course.angle);
        }
    }
}
