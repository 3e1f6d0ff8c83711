//! Intervals of real numbers, rounded outwards.
//!
//! An operation's result contains the exact result for all numbers of its operands. Each end is computed with the
//! processor's nearest rounding and then moved outwards by more than half a unit in its last place. What cannot be
//! bounded (a division by an interval around 0, a root of a negative number) is [`Interval::ENTIRE`], so that it proves
//! nothing.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// Relative error of one nearest rounding, and what its own rounding may take away.
const ROUNDING: f64 = 0.5 * f64::EPSILON * (1.0 + f64::EPSILON);

/// All real numbers from `low` to `high`. Ends that are not numbers stand for no bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    low: f64,
    high: f64,
}

/// The smaller and the larger one of two numbers.
#[inline(always)]
fn ordered(a: f64, b: f64) -> (f64, f64) {
    (if a < b { a } else { b }, if a > b { a } else { b })
}

/// The largest number that is certainly not above a result rounded to `value`.
#[inline(always)]
fn down(value: f64) -> f64 {
    value - (value.abs() * ROUNDING + f64::MIN_POSITIVE)
}

/// The smallest number that is certainly not below a result rounded to `value`.
#[inline(always)]
fn up(value: f64) -> f64 {
    value + (value.abs() * ROUNDING + f64::MIN_POSITIVE)
}

impl Interval {
    /// The number 0.
    pub const ZERO: Self = Self { low: 0.0, high: 0.0 };
    /// The number 1.
    pub const ONE: Self = Self { low: 1.0, high: 1.0 };
    /// All numbers.
    pub const ENTIRE: Self = Self {
        low: f64::NEG_INFINITY,
        high: f64::INFINITY,
    };

    /// One number.
    #[must_use]
    pub const fn point(value: f64) -> Self {
        Self {
            low: value,
            high: value,
        }
    }

    /// All numbers between two, in any order.
    #[must_use]
    pub fn between(one: f64, other: f64) -> Self {
        Self {
            low: one.min(other),
            high: one.max(other),
        }
    }

    /// All numbers from -`radius` to `radius`.
    #[must_use]
    pub fn around_zero(radius: f64) -> Self {
        Self {
            low: -radius,
            high: radius,
        }
    }

    /// The exact quotient of two numbers.
    #[must_use]
    pub fn quotient(numerator: f64, denominator: f64) -> Self {
        Self::point(numerator) / Self::point(denominator)
    }

    /// Lower end.
    #[must_use]
    pub fn low(&self) -> f64 {
        self.low
    }

    /// Upper end.
    #[must_use]
    pub fn high(&self) -> f64 {
        self.high
    }

    /// A number near the middle.
    #[must_use]
    pub fn middle(&self) -> f64 {
        0.5 * self.low + 0.5 * self.high
    }

    /// Middle and radius; no numbers without bounds.
    #[inline(always)]
    pub(crate) fn centre(&self) -> (f64, f64) {
        let middle = 0.5 * (self.low + self.high);
        let radius = ordered(middle - self.low, self.high - middle).1;
        (middle, radius * (1.0 + f64::EPSILON) + f64::MIN_POSITIVE)
    }

    /// All numbers whose distance from `middle` is at most `radius`.
    #[inline(always)]
    pub(crate) fn around(middle: f64, radius: f64) -> Self {
        if (middle + radius).is_finite() {
            Self {
                low: down(middle - radius),
                high: up(middle + radius),
            }
        } else {
            Self::ENTIRE
        }
    }

    /// Largest absolute value; infinite without bounds.
    #[must_use]
    pub fn magnitude(&self) -> f64 {
        let magnitude = self.low.abs().max(self.high.abs());
        if self.is_bounded() { magnitude } else { f64::INFINITY }
    }

    /// Smallest absolute value.
    #[must_use]
    pub fn mignitude(&self) -> f64 {
        if self.low > 0.0 {
            self.low
        } else if self.high < 0.0 {
            -self.high
        } else {
            0.0
        }
    }

    /// Whether both ends are finite numbers.
    #[must_use]
    pub fn is_bounded(&self) -> bool {
        self.low.is_finite() && self.high.is_finite()
    }

    /// Whether a number lies in the interval.
    #[must_use]
    pub fn contains(&self, value: f64) -> bool {
        self.low <= value && value <= self.high
    }

    /// The interval from the lower to the upper ends of both.
    #[must_use]
    pub fn hull(&self, other: &Self) -> Self {
        if !(self.is_bounded() && other.is_bounded()) {
            return Self::ENTIRE;
        }
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
        }
    }

    /// The numbers that lie in both intervals, each of which contains the number in question.
    #[must_use]
    pub fn meet(&self, other: &Self) -> Self {
        Self {
            low: self.low.max(other.low),
            high: self.high.min(other.high),
        }
    }

    /// Square.
    #[must_use]
    pub fn square(&self) -> Self {
        if *self == Self::ZERO {
            return Self::ZERO;
        }
        if !self.is_bounded() {
            return Self::ENTIRE;
        }
        let (small, large) = (self.mignitude(), self.magnitude());
        Self {
            low: down(small * small).max(0.0),
            high: up(large * large),
        }
    }

    /// Square root; no bound unless the whole interval is positive.
    #[must_use]
    pub fn root(&self) -> Self {
        if *self == Self::ZERO {
            return Self::ZERO;
        }
        if !(self.low > 0.0 && self.high < f64::INFINITY) {
            return Self::ENTIRE;
        }
        Self {
            low: down(self.low.sqrt()),
            high: up(self.high.sqrt()),
        }
    }

    /// Upper bound of the square root of the upper end; 0 for negative ends.
    #[must_use]
    pub fn root_high(&self) -> f64 {
        if self.high > 0.0 { up(self.high.sqrt()) } else { 0.0 }
    }

    /// Lower bound of the square root of the lower end; 0 for negative ends.
    #[must_use]
    pub fn root_low(&self) -> f64 {
        if self.low > 0.0 {
            down(self.low.sqrt()).max(0.0)
        } else {
            0.0
        }
    }
}

impl From<f64> for Interval {
    fn from(value: f64) -> Self {
        Self::point(value)
    }
}

impl Add for Interval {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        if other == Self::ZERO {
            return self;
        }
        if self == Self::ZERO {
            return other;
        }
        Self {
            low: down(self.low + other.low),
            high: up(self.high + other.high),
        }
    }
}

impl Neg for Interval {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self {
            low: -self.high,
            high: -self.low,
        }
    }
}

impl Sub for Interval {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Interval {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        if self == Self::ZERO || other == Self::ZERO {
            return Self::ZERO;
        }
        let [a, b, c, d] = [
            self.low * other.low,
            self.low * other.high,
            self.high * other.low,
            self.high * other.high,
        ];
        // A missing bound makes a product infinite, or no number where it meets 0.
        if !(a + b + c + d).is_finite() {
            return Self::ENTIRE;
        }
        let ((a, b), (c, d)) = (ordered(a, b), ordered(c, d));
        Self {
            low: down(ordered(a, c).0),
            high: up(ordered(b, d).1),
        }
    }
}

impl Div for Interval {
    type Output = Self;

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        if !(other.low > 0.0 || other.high < 0.0) || !self.is_bounded() || !other.is_bounded() {
            return Self::ENTIRE;
        }
        if self == Self::ZERO {
            return Self::ZERO;
        }
        let [a, b, c, d] = [
            self.low / other.low,
            self.low / other.high,
            self.high / other.low,
            self.high / other.high,
        ];
        let ((a, b), (c, d)) = (ordered(a, b), ordered(c, d));
        Self {
            low: down(ordered(a, c).0),
            high: up(ordered(b, d).1),
        }
    }
}
