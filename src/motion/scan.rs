//! The scan: how fast each point of the grid may be passed, so that all limits hold and the path can end at rest.
//!
//! With x the squared path speed and u the path acceleration, every limit is a row a u + b x <= c, and an interval
//! of length l leads from x to x + 2 l u. Backwards from a point at rest, the largest x of each point is the largest
//! for which some u obeys the rows at both ends of the interval and leads to a speed from which the rest can be
//! reached (after Pham and Pham, "A new approach to time-optimal path parameterization based on reachability
//! analysis"). The width of the range of u is a concave function of x made of straight stretches, so Newton's method
//! from the right finds its zero exactly, in as many steps as there are stretches.
//!
//! Invariant: x = 0, u = 0 obeys every row; so whatever x a point may have, less is allowed too.

use super::limits::{DIRECTION, DIRECTIONS, Limits};
use crate::robot::{ARMS, JointRows};

/// Newton steps at most; more stretches than this do not occur, and if they did, the result is a safe bound.
const NEWTON_STEPS: usize = 10;
/// Relative steps to the inside when rounding keeps Newton's method outside; the last ones are never needed.
const HAIRS: [f64; 5] = [1.0e-12, 1.0e-10, 1.0e-8, 1.0e-4, 0.5];
/// Rounding of a range's ends, relative.
const ROUNDING: f64 = 1.0e-13;
/// Coefficients of u smaller than this count as zero.
const COEFFICIENT_SMALL: f64 = 1.0e-15;

/// Limits at one point of the grid, in terms of the path.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Row {
    pub(crate) joints: JointRows,
    /// 1/mm.
    pub(crate) curvature: f64,
    /// Slope of the fourth axis, rad/mm.
    pub(crate) turn: f64,
    /// Vertical part of the tangent, and its change with arc length, 1/mm.
    pub(crate) rise: f64,
    pub(crate) rise_change: f64,
}

impl Row {
    /// Nothing moves.
    pub(crate) const NONE: Self = Self {
        joints: JointRows::NONE,
        curvature: 0.0,
        turn: 0.0,
        rise: 0.0,
        rise_change: 0.0,
    };
}

/// Accelerations that an interval allows at one speed, mm/s2.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Range {
    pub(crate) low: f64,
    pub(crate) high: f64,
    low_slope: f64,
    high_slope: f64,
}

impl Range {
    /// Tightens the range by a u + b x <= c.
    fn restrict(&mut self, a: f64, b: f64, c: f64, x: f64) {
        let rest = c - b * x;
        if a > COEFFICIENT_SMALL {
            if rest < self.high * a {
                let inverse = 1.0 / a;
                self.high = rest * inverse;
                self.high_slope = -b * inverse;
            }
        } else if a < -COEFFICIENT_SMALL && rest < self.low * a {
            let inverse = 1.0 / a;
            self.low = rest * inverse;
            self.low_slope = -b * inverse;
        }
    }

    /// Tightens the range by |a u + b x| + room x <= c.
    fn restrict_both(&mut self, a: f64, b: f64, room: f64, c: f64, x: f64) {
        self.restrict(a, room + b, c, x);
        self.restrict(-a, room - b, c, x);
    }

    /// High less low, where rounding does not make an exact meeting of both a negative width.
    fn width(&self) -> f64 {
        self.high - self.low + ROUNDING * (self.high.abs() + self.low.abs())
    }
}

/// The rows of one interval: both ends, and the squared speed that must not be exceeded at its end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Interval<'a> {
    pub(crate) limits: &'a Limits,
    pub(crate) start: &'a Row,
    pub(crate) end: &'a Row,
    pub(crate) length_mm: f64,
    pub(crate) end_squared: f64,
    /// Change of the fourth axis' slope all along the interval, rad/mm2.
    pub(crate) turn_change: f64,
    /// The pen's vertical limits hold.
    pub(crate) lifts: bool,
    /// What the interval has between its ends.
    pub(crate) room: Room,
}

/// What is beyond the mean in the middle is multiplied with, because it can be more beside the middle.
const ROOM_FACTOR: f64 = 1.25;

/// What an interval's middle has beyond the mean of its ends, which the rows at both ends make room for.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Room {
    /// Of the curvature, 1/mm.
    pub(crate) curvature: f64,
    /// Of an arm's bend for its acceleration limit, s2/mm2: the largest of the three.
    pub(crate) arms: f64,
}

impl Room {
    pub(crate) const NONE: Self = Self {
        curvature: 0.0,
        arms: 0.0,
    };

    /// Room for the middle between two rows.
    pub(crate) fn new(limits: &Limits, start: &Row, middle: &Row, end: &Row) -> Self {
        let beyond = |start: f64, middle: f64, end: f64| middle - 0.5 * (start + end);
        let mut arms = 0.0_f64;
        for (arm, limit) in limits.joint_acceleration.iter().enumerate() {
            let of = |row: &Row| row.joints.bend.get(arm).copied().unwrap_or_default();
            if *limit <= 0.0 {
                continue;
            }
            arms = arms.max(beyond(of(start), of(middle), of(end)).abs() / limit);
        }
        Self {
            curvature: ROOM_FACTOR * beyond(start.curvature, middle.curvature, end.curvature).max(0.0),
            arms: ROOM_FACTOR * arms,
        }
    }
}

impl Interval<'_> {
    /// Whether the fourth axis moves.
    pub(crate) fn turns(&self) -> bool {
        self.turn_change != 0.0 || self.start.turn != 0.0
    }

    /// Accelerations allowed when the interval is entered with the squared speed `x`; empty (low above high) when x
    /// is too large.
    pub(crate) fn range(&self, x: f64) -> Range {
        let double = 2.0 * self.length_mm;
        let inverse = 1.0 / double;
        let mut range = Range {
            low: -x * inverse,
            high: (self.end_squared - x) * inverse,
            low_slope: -inverse,
            high_slope: -inverse,
        };
        let limits = self.limits;
        for arm in 0..ARMS {
            let limit = limits.joint_acceleration[arm];
            let room = self.room.arms * limit;
            let (a, b) = (self.start.joints.slope[arm], self.start.joints.bend[arm]);
            range.restrict_both(a, b, room, limit, x);
            let b = self.end.joints.bend[arm];
            // At the end the speed is x + 2 l u.
            let a = self.end.joints.slope[arm];
            range.restrict(a + (b + room) * double, room + b, limit, x);
            range.restrict((room - b) * double - a, room - b, limit, x);
        }
        if self.turns() {
            let (b, limit) = (self.turn_change, limits.turn_acceleration);
            range.restrict_both(self.start.turn, b, 0.0, limit, x);
            range.restrict_both(self.end.turn + b * double, b, 0.0, limit, x);
        }
        if self.lifts {
            let limit = limits.pen_acceleration;
            range.restrict_both(self.start.rise, self.start.rise_change, 0.0, limit, x);
            let b = self.end.rise_change;
            range.restrict_both(self.end.rise + b * double, b, 0.0, limit, x);
        }
        for (cosine, sine) in DIRECTION.iter().take(DIRECTIONS) {
            let b = sine * (self.start.curvature + self.room.curvature);
            range.restrict(*cosine, b, limits.acceleration, x);
            range.restrict(-cosine, b, limits.acceleration, x);
            let b = sine * (self.end.curvature + self.room.curvature);
            let turned = b * double;
            range.restrict(cosine + turned, b, limits.acceleration, x);
            range.restrict(turned - cosine, b, limits.acceleration, x);
        }
        range
    }

    /// Largest squared speed up to `cap` with which the interval may be entered.
    pub(crate) fn entry_max(&self, cap: f64) -> f64 {
        let mut x = cap;
        for _ in 0..NEWTON_STEPS {
            let range = self.range(x);
            let width = range.width();
            if width >= 0.0 {
                return x;
            }
            let slope = range.high_slope - range.low_slope;
            let next = x - width / slope;
            if !(slope < 0.0 && next < x) {
                break;
            }
            x = next.max(0.0);
        }
        // Rounding can leave the width a hair under zero.
        for hair in HAIRS {
            let below = x * (1.0 - hair);
            if self.range(below).width() >= 0.0 {
                return below;
            }
        }
        0.0
    }

    /// Strongest deceleration that the limits allow at `x` when the motion may come to rest inside the interval;
    /// negative or 0. The speed falls from `x` to 0 while the coefficients go from the start's to the end's.
    pub(crate) fn braking(&self, x: f64) -> f64 {
        let limits = self.limits;
        let mut range = Range {
            low: -limits.whole_acceleration(),
            high: 0.0,
            low_slope: 0.0,
            high_slope: 0.0,
        };
        for arm in 0..ARMS {
            let limit = limits.joint_acceleration[arm];
            let room = self.room.arms * limit;
            for row in [self.start, self.end] {
                let (a, b) = (row.joints.slope[arm], row.joints.bend[arm]);
                range.restrict_both(a, b, room, limit, x);
                range.restrict_both(a, b, room, limit, 0.0);
            }
        }
        for row in [self.start, self.end] {
            if self.turns() {
                range.restrict_both(row.turn, self.turn_change, 0.0, limits.turn_acceleration, x);
                range.restrict_both(row.turn, self.turn_change, 0.0, limits.turn_acceleration, 0.0);
            }
            if self.lifts {
                range.restrict_both(row.rise, row.rise_change, 0.0, limits.pen_acceleration, x);
                range.restrict_both(row.rise, row.rise_change, 0.0, limits.pen_acceleration, 0.0);
            }
        }
        for (cosine, sine) in DIRECTION.iter().take(DIRECTIONS) {
            let b = sine * (self.start.curvature.max(self.end.curvature) + self.room.curvature);
            range.restrict(-cosine, b, limits.acceleration, x);
        }
        range.low.min(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Motion;

    /// A seeded sequence of numbers from -1 to 1.
    fn numbers(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        move || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        }
    }

    #[test]
    fn the_largest_entry_speed_is_feasible_and_nothing_above_it_is() {
        let limits = Limits::new(&Motion::default());
        for seed in 1..500 {
            let mut number = numbers(seed);
            let mut row = || Row {
                joints: JointRows {
                    slope: [(); ARMS].map(|()| 0.004 * number()),
                    bend: [(); ARMS].map(|()| 2.0e-3 * number()),
                },
                curvature: 0.2 * number().abs(),
                turn: 0.5 * number(),
                rise: number(),
                rise_change: 0.2 * number(),
            };
            let (start, end) = (row(), row());
            let interval = Interval {
                limits: &limits,
                start: &start,
                end: &end,
                length_mm: 0.05 + number().abs(),
                end_squared: 1.0e5 * number().abs(),
                turn_change: 0.05 * number(),
                lifts: number() > 0.0,
                room: Room {
                    curvature: 0.02 * number().abs(),
                    arms: 1.0e-7 * number().abs(),
                },
            };
            let cap = 1.6e5;
            let x = interval.entry_max(cap);
            assert!((0.0..=cap).contains(&x));
            let range = interval.range(x);
            assert!(
                range.low <= range.high + 1.0e-6 * limits.acceleration,
                "seed {seed}: {x}"
            );
            let above = interval.range(x * (1.0 + 1.0e-6) + 1.0e-6);
            assert!(
                x == cap || above.low > above.high,
                "seed {seed}: {x} is not the largest"
            );
        }
    }

    #[test]
    fn a_forced_rest_gives_the_speed_from_which_it_is_reached() {
        let limits = Limits::new(&Motion::default());
        let row = Row::default();
        let interval = Interval {
            limits: &limits,
            start: &row,
            end: &row,
            length_mm: 2.0,
            end_squared: 0.0,
            turn_change: 0.0,
            lifts: false,
            room: Room::NONE,
        };
        let expected = 2.0 * 2.0 * limits.whole_acceleration();
        assert!((interval.entry_max(1.0e9) - expected).abs() < 1.0e-6 * expected);
    }
}
