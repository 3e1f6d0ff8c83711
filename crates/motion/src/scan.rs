//! The scan: the largest speed at each point of the grid at which all limits hold and the path can end at rest.
//!
//! With x the squared path speed and u the path acceleration, every limit is a row a u + b x <= c, and an interval of
//! length l leads from x to x + 2 l u. The scan runs backwards from a point at rest. The largest x of each point is the
//! largest for which some u obeys the rows at both ends of the interval (on a curve those in its middle too, and the pen's at
//! its quarters) and leads
//! to a speed from which rest can be reached (after Pham and Pham, "A new approach to time-optimal path
//! parameterization based on reachability analysis"). The width of the range of u is a concave function of x made of
//! straight stretches, and of arcs where the Cartesian acceleration counts. Newton's method from the right finds its
//! zero without passing it: exactly on a stretch, with quadratic convergence on an arc.
//!
//! Invariant: x = 0, u = 0 obeys every row; so below every allowed x of a point all smaller x are allowed too.

use super::limits::Limits;
pub(crate) use super::limits::Row;
use crate::robots::vector::root;
use crate::robots::{JointRows, MAIN_AXES};

/// Most Newton steps. More are not needed; if they were, the result would still be a safe bound.
const NEWTON_STEPS: usize = 16;
/// Relative steps to the inside when rounding keeps Newton's method outside; the last ones are never needed.
const HAIRS: [f64; 5] = [1.0e-12, 1.0e-10, 1.0e-8, 1.0e-4, 0.5];
/// Rounding of a range's ends, relative.
const ROUNDING: f64 = 1.0e-13;
/// Coefficients of u smaller than this count as zero.
const COEFFICIENT_SMALL: f64 = 1.0e-15;
/// Half chords of the circle of accelerations that are shorter than this part of its radius are shortened a little, so
/// that their change with the speed stays finite where the circle ends.
const CHORD_SMALL: f64 = 1.0e-4;

/// Quarters of an interval, each with the weights of its beginning, middle and end in the rise there, by the parabola through
/// them, and in the change of the rise: between that parabola and the line through middle and far end, as it grows fastest where
/// it begins.
const QUARTERS: [(f64, [f64; 3], [f64; 3]); 2] = [
    (0.25, [0.375, 0.75, -0.125], [0.1875, 1.125, -0.3125]),
    (0.75, [-0.125, 0.75, 0.375], [-0.3125, 1.125, 0.1875]),
];

/// Range of accelerations that an interval allows at one speed, mm/s2.
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

    /// Tightens the range by |a u + b x| <= c.
    fn restrict_both(&mut self, a: f64, b: f64, c: f64, x: f64) {
        self.restrict(a, b, c, x);
        self.restrict(-a, -b, c, x);
    }

    /// Tightens the range by the circle u^2 + (k (x + d u))^2 <= c^2: path and centripetal acceleration where the
    /// curvature is k and the squared speed has grown by d u.
    fn restrict_circle(&mut self, curvature: f64, growth_mm: f64, acceleration: f64, x: f64) {
        let (squared, limit) = (curvature * curvature, acceleration * acceleration);
        let inside = |u: f64| {
            let y = x + growth_mm * u;
            u * u + squared * y * y <= limit
        };
        if inside(self.low) && inside(self.high) {
            return;
        }
        let leading = 1.0 + squared * growth_mm * growth_mm;
        let chord_squared = leading * limit - squared * x * x;
        let small = CHORD_SMALL * acceleration;
        let inverse = 1.0 / leading;
        let (half, half_slope) = if chord_squared > small * small {
            let half = root(chord_squared);
            (half, -squared * x / half)
        } else if chord_squared > 0.0 {
            (chord_squared / small, -2.0 * squared * x / small)
        } else {
            let largest = acceleration * root(leading) / curvature;
            let slope = -2.0 * squared * largest / small;
            (slope * (x - largest), slope)
        };
        let (middle, middle_slope) = (-squared * growth_mm * x, -squared * growth_mm);
        let high = (middle + half) * inverse;
        if high < self.high {
            self.high = high;
            self.high_slope = (middle_slope + half_slope) * inverse;
        }
        let low = (middle - half) * inverse;
        if low > self.low {
            self.low = low;
            self.low_slope = (middle_slope - half_slope) * inverse;
        }
    }

    /// High minus low; rounding does not make it negative where both meet exactly.
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
    /// Change of the fourth axis's slope on the whole interval, rad/mm2.
    pub(crate) turn_change: f64,
    /// Whether the pen's vertical limits apply.
    pub(crate) lifts: bool,
    /// Limits in the middle of a curve, and the distance to that middle, mm.
    pub(crate) middle: Option<(Middle, f64)>,
}

/// Limits in the middle of an interval; on a curve they can be tighter there than at both ends.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Middle {
    pub(crate) joints: JointRows,
    /// Curvature, 1/mm.
    pub(crate) curvature: f64,
    /// Largest squared speed, mm2/s2.
    pub(crate) cap: f64,
    /// Vertical part of the tangent, and its derivative with respect to arc length, 1/mm.
    pub(crate) rise: f64,
    pub(crate) rise_change: f64,
}

impl Middle {
    /// A middle that allows no motion.
    pub(crate) const NONE: Self = Self {
        joints: JointRows::NONE,
        curvature: 0.0,
        cap: 0.0,
        rise: 0.0,
        rise_change: 0.0,
    };
}

impl Interval<'_> {
    /// Whether the fourth axis moves.
    pub(crate) fn turns(&self) -> bool {
        self.turn_change != 0.0 || self.start.turn != 0.0
    }

    /// Accelerations allowed when the motion enters the interval with the squared speed `x`; empty (low above high)
    /// when `x` is too large.
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
        for axis in 0..MAIN_AXES {
            let limit = limits.joint_acceleration[axis];
            let (a, b) = (self.start.joints.slope[axis], self.start.joints.bend[axis]);
            range.restrict_both(a, b, limit, x);
            let b = self.end.joints.bend[axis];
            // At the end the speed is x + 2 l u.
            range.restrict_both(self.end.joints.slope[axis] + b * double, b, limit, x);
        }
        if self.turns() {
            let (b, limit) = (self.turn_change, limits.turn_acceleration);
            range.restrict_both(self.start.turn, b, limit, x);
            range.restrict_both(self.end.turn + b * double, b, limit, x);
        }
        if self.lifts {
            let limit = limits.pen_acceleration;
            range.restrict_both(self.start.rise, self.start.rise_change, limit, x);
            let b = self.end.rise_change;
            range.restrict_both(self.end.rise + b * double, b, limit, x);
        }
        range.restrict_circle(self.start.curvature, 0.0, limits.acceleration, x);
        range.restrict_circle(self.end.curvature, double, limits.acceleration, x);
        if let Some((middle, ahead_mm)) = &self.middle {
            let double = 2.0 * ahead_mm;
            range.restrict(double, 1.0, middle.cap, x);
            for axis in 0..MAIN_AXES {
                let b = middle.joints.bend[axis];
                let a = middle.joints.slope[axis] + b * double;
                range.restrict_both(a, b, limits.joint_acceleration[axis], x);
            }
            if self.lifts {
                let b = middle.rise_change;
                range.restrict_both(middle.rise + b * double, b, limits.pen_acceleration, x);
                // The middle is the one of this interval.
                if double == self.length_mm {
                    self.restrict_quarters(&mut range, middle, x);
                }
            }
            range.restrict_circle(middle.curvature, double, limits.acceleration, x);
        }
        range
    }

    /// Tightens the range by the pen's limit at the quarters. Where the pen begins to rise, the speed may
    /// fall to a part of itself within one interval, and the vertical acceleration has its peak at a third of the way.
    fn restrict_quarters(&self, range: &mut Range, middle: &Middle, x: f64) {
        let weighed = |weights: &[f64; 3], values: [f64; 3]| {
            weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2]
        };
        for (part, of_rise, of_change) in &QUARTERS {
            let rise = weighed(of_rise, [self.start.rise, middle.rise, self.end.rise]);
            let changes = [self.start.rise_change, middle.rise_change, self.end.rise_change];
            let change = weighed(of_change, changes);
            let grown = 2.0 * part * self.length_mm;
            range.restrict_both(rise + change * grown, change, self.limits.pen_acceleration, x);
        }
    }

    /// Largest squared speed, up to `cap`, at which the motion may enter the interval.
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
        // Rounding can make the width slightly negative.
        for hair in HAIRS {
            let below = x * (1.0 - hair);
            if self.range(below).width() >= 0.0 {
                return below;
            }
        }
        0.0
    }

    /// Strongest deceleration that the limits allow at `x` when the motion may come to rest inside the interval;
    /// negative or 0. The speed falls from `x` to 0 while the coefficients change from the start's to the end's.
    pub(crate) fn braking(&self, x: f64) -> f64 {
        let limits = self.limits;
        let mut range = Range {
            low: -limits.acceleration,
            high: 0.0,
            low_slope: 0.0,
            high_slope: 0.0,
        };
        let middle = self.middle.as_ref().map(|(middle, _)| &middle.joints);
        let curvature = self.start.curvature.max(self.end.curvature);
        let curvature = self
            .middle
            .map_or(curvature, |(middle, _)| curvature.max(middle.curvature));
        for axis in 0..MAIN_AXES {
            let limit = limits.joint_acceleration[axis];
            for joints in [Some(&self.start.joints), Some(&self.end.joints), middle]
                .into_iter()
                .flatten()
            {
                let (a, b) = (joints.slope[axis], joints.bend[axis]);
                range.restrict_both(a, b, limit, x);
                range.restrict_both(a, b, limit, 0.0);
            }
        }
        for row in [self.start, self.end] {
            if self.turns() {
                range.restrict_both(row.turn, self.turn_change, limits.turn_acceleration, x);
                range.restrict_both(row.turn, self.turn_change, limits.turn_acceleration, 0.0);
            }
            if self.lifts {
                range.restrict_both(row.rise, row.rise_change, limits.pen_acceleration, x);
                range.restrict_both(row.rise, row.rise_change, limits.pen_acceleration, 0.0);
            }
        }
        range.restrict_circle(curvature, 0.0, limits.acceleration, x);
        range.low.min(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use crate::settings::Settings;

    /// A seeded sequence of numbers from -1 to 1.
    fn numbers(seed: u64) -> impl FnMut() -> f64 {
        let mut random = Random::new(seed);
        move || random.between(-1.0, 1.0)
    }

    #[test]
    fn the_largest_entry_speed_is_feasible_and_nothing_above_it_is() {
        let limits = Limits::new(&Settings::default());
        for seed in 1..500 {
            let mut number = numbers(seed);
            let mut row = || Row {
                joints: JointRows {
                    slope: [(); MAIN_AXES].map(|()| 0.004 * number()),
                    bend: [(); MAIN_AXES].map(|()| 2.0e-3 * number()),
                },
                curvature: 0.2 * number().abs(),
                turn: 0.5 * number(),
                rise: number(),
                rise_change: 0.2 * number(),
            };
            let (start, end, middle) = (row(), row(), row());
            let length_mm = 0.05 + number().abs();
            let interval = Interval {
                limits: &limits,
                start: &start,
                end: &end,
                length_mm,
                end_squared: 1.0e5 * number().abs(),
                turn_change: 0.05 * number(),
                lifts: number() > 0.0,
                middle: (number() > 0.0).then_some((
                    Middle {
                        joints: middle.joints,
                        curvature: middle.curvature,
                        cap: 1.6e5,
                        rise: middle.rise,
                        rise_change: middle.rise_change,
                    },
                    0.5 * length_mm,
                )),
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
        let limits = Limits::new(&Settings::default());
        let row = Row::default();
        let interval = Interval {
            limits: &limits,
            start: &row,
            end: &row,
            length_mm: 2.0,
            end_squared: 0.0,
            turn_change: 0.0,
            lifts: false,
            middle: None,
        };
        let expected = 2.0 * 2.0 * limits.acceleration;
        assert!((interval.entry_max(1.0e9) - expected).abs() < 1.0e-6 * expected);
    }
}
