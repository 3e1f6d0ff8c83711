//! Taylor series with intervals as coefficients.
//!
//! Coefficient k of a series is the k-th derivative over k!, at one parameter or for all parameters of a box. Arithmetic
//! on series gives the series of the result, so derivatives of any formula need no formulas of their own.
//!
//! [`range`] bounds a function on a box from both kinds: the series at the middle, and the last derivative on the whole
//! box. The error shrinks with the fourth power of the box's width.

use crate::interval::Interval;
use std::ops::{Add, Mul, Neg, Sub};

/// Number of coefficients.
pub(crate) const TERMS: usize = 6;
/// Coefficients that [`range`] uses: a derivative loses the last one of a series, and no formula differentiates more
/// than twice.
const RANGE_TERMS: usize = TERMS - 2;

/// A Taylor series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Series(pub(crate) [Interval; TERMS]);

/// A vector of series.
pub(crate) type Series3 = [Series; 3];

impl Series {
    pub(crate) const ZERO: Self = Self([Interval::ZERO; TERMS]);

    /// A constant.
    pub(crate) fn constant(value: impl Into<Interval>) -> Self {
        let mut series = Self::ZERO;
        series.0[0] = value.into();
        series
    }

    /// Value at the parameters of the series.
    pub(crate) fn value(&self) -> Interval {
        self.0[0]
    }

    /// Order of the last coefficient that is not exactly 0; `None` for the function 0.
    fn degree(&self) -> Option<usize> {
        self.0.iter().rposition(|coefficient| *coefficient != Interval::ZERO)
    }

    /// Derivative with respect to the parameter. Its last coefficient is unknown.
    pub(crate) fn derivative(&self) -> Self {
        let mut result = [Interval::ENTIRE; TERMS];
        let mut factor = 0.0;
        for (place, coefficient) in result.iter_mut().zip(&self.0[1..]) {
            factor += 1.0;
            *place = *coefficient * Interval::point(factor);
        }
        Self(result)
    }

    /// The function with this derivative and this value.
    pub(crate) fn integral(&self, value: Interval) -> Self {
        let mut result = [value; TERMS];
        let mut divisor = 0.0;
        for (place, coefficient) in result[1..].iter_mut().zip(&self.0) {
            divisor += 1.0;
            *place = *coefficient / Interval::point(divisor);
        }
        Self(result)
    }

    /// The series of f(s u) from the series of f at s u.
    pub(crate) fn stretched(&self, scale: Interval) -> Self {
        let mut power = Interval::ONE;
        Self(self.0.map(|coefficient| {
            let result = coefficient * power;
            power = power * scale;
            result
        }))
    }

    pub(crate) fn times(&self, factor: Interval) -> Self {
        Self(self.0.map(|coefficient| coefficient * factor))
    }

    pub(crate) fn square(&self) -> Self {
        let mut result = *self * *self;
        result.0[0] = self.0[0].square();
        result
    }

    /// Quotient.
    pub(crate) fn over(&self, other: &Self) -> Self {
        if other.degree() == Some(0) {
            return Self(self.0.map(|coefficient| coefficient / other.0[0]));
        }
        let mut result = Self::ZERO;
        for order in 0..TERMS {
            let mut rest = self.0[order];
            for lower in 1..=order {
                rest = rest - other.0[lower] * result.0[order - lower];
            }
            result.0[order] = rest / other.0[0];
        }
        result
    }

    /// Square root.
    pub(crate) fn root(&self) -> Self {
        let mut result = Self::ZERO;
        result.0[0] = self.0[0].root();
        if self.degree() == Some(0) {
            return result;
        }
        let double = result.0[0] + result.0[0];
        for order in 1..TERMS {
            let mut rest = self.0[order];
            for lower in 1..order {
                rest = rest - result.0[lower] * result.0[order - lower];
            }
            result.0[order] = rest / double;
        }
        result
    }
}

impl Add for Series {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let mut result = self;
        for (place, added) in result.0.iter_mut().zip(other.0) {
            *place = *place + added;
        }
        result
    }
}

impl Neg for Series {
    type Output = Self;

    fn neg(self) -> Self {
        Self(self.0.map(Interval::neg))
    }
}

impl Sub for Series {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Series {
    type Output = Self;

    /// Multiplies with middles and radii, which needs no comparisons: (a + r)(b + s) differs from a b by at most |a| s +
    /// r (|b| + s).
    fn mul(self, other: Self) -> Self {
        let mut result = Self::ZERO;
        let (Some(degree), Some(other_degree)) = (self.degree(), other.degree()) else {
            return result;
        };
        if degree == 0 {
            return other.times(self.0[0]);
        }
        if other_degree == 0 {
            return self.times(other.0[0]);
        }
        let (centres, others) = (self.0.map(|c| c.centre()), other.0.map(|c| c.centre()));
        let (a, r) = (centres.map(|centre| centre.0), centres.map(|centre| centre.1));
        let (b, s) = (others.map(|centre| centre.0), others.map(|centre| centre.1));
        let sizes = b.map(f64::abs);
        let reach: [f64; TERMS] = std::array::from_fn(|order| sizes[order] + s[order]);
        for order in 0..TERMS {
            let (mut sum, mut size, mut radius) = (0.0, 0.0, 0.0);
            for lower in 0..=order {
                let (a, r) = (a[lower], r[lower]);
                sum += a * b[order - lower];
                size += a.abs() * sizes[order - lower];
                radius += a.abs() * s[order - lower] + r * reach[order - lower];
            }
            if order <= degree + other_degree {
                result.0[order] = Interval::around(sum, radius * RADIUS_ROUNDING + size * SUM_ROUNDING + SMALLEST);
            }
        }
        result
    }
}

/// Covers the rounding of a sum of positive terms.
const RADIUS_ROUNDING: f64 = 1.0 + 4.0 * TERMS as f64 * f64::EPSILON;
/// Rounding of a sum of products as a part of the sum of their absolute values: half a unit for each product and each
/// addition.
const SUM_ROUNDING: f64 = TERMS as f64 * f64::EPSILON;
/// Covers products too small for a normal number.
const SMALLEST: f64 = 64.0 * f64::MIN_POSITIVE;

/// Scalar product.
pub(crate) fn dot(a: &Series3, b: &Series3) -> Series {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Squared length.
pub(crate) fn squared_length(a: &Series3) -> Series {
    a[0].square() + a[1].square() + a[2].square()
}

/// Values of a function at distances up to `half` from the middle of a box: from its series at the middle and its series
/// on the whole box.
pub(crate) fn range(middle: &Series, whole: &Series, half: f64) -> Interval {
    let reach = Interval::point(half);
    let mut power = Interval::ONE;
    let mut sum = middle.value();
    for order in 1..RANGE_TERMS {
        power = power * reach;
        let either = if order % 2 == 0 {
            Interval::between(0.0, power.high())
        } else {
            Interval::around_zero(power.high())
        };
        let series = if order + 1 == RANGE_TERMS { whole } else { middle };
        sum = sum + series.0[order] * either;
    }
    sum.meet(&whole.value())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The function (2 + u)(u^2 - 3) / sqrt(1 + u^2), its series and its derivative's.
    fn function(at: Interval) -> (Series, Series) {
        let mut u = Series::constant(at);
        u.0[1] = Interval::ONE;
        let square = u.square();
        let root = (Series::constant(1.0) + square).root();
        let result = ((Series::constant(2.0) + u) * (square - Series::constant(3.0))).over(&root);
        (result, result.derivative())
    }

    fn exact(u: f64) -> f64 {
        (2.0 + u) * (u * u - 3.0) / (1.0 + u * u).sqrt()
    }

    #[test]
    fn the_range_of_a_box_contains_every_value_and_is_tight() {
        for step in -40..40 {
            let middle = 0.05 * f64::from(step);
            for half in [0.3, 0.03, 0.001] {
                let whole = Interval::between(middle - half, middle + half);
                let (point, box_series) = (function(Interval::point(middle)), function(whole));
                let values = range(&point.0, &box_series.0, half * 1.000_001);
                let slopes = range(&point.1, &box_series.1, half * 1.000_001);
                let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
                for part in -50..=50 {
                    let u = middle + half * f64::from(part) / 50.0;
                    let value = exact(u);
                    (low, high) = (low.min(value), high.max(value));
                    assert!(
                        values.low() - 1.0e-12 <= value && value <= values.high() + 1.0e-12,
                        "{u}"
                    );
                    let slope = (exact(u + 1.0e-5) - exact(u - 1.0e-5)) / 2.0e-5;
                    assert!(slopes.low() - 1.0e-6 <= slope && slope <= slopes.high() + 1.0e-6, "{u}");
                }
                let spare = (low - values.low()).max(values.high() - high);
                let allowed = if half < 0.1 { 0.3 * half + 1.0e-12 } else { 40.0 * half };
                assert!(spare < allowed, "{middle} {half}: {spare}");
            }
        }
    }

    #[test]
    fn an_integral_undoes_a_derivative_and_its_last_coefficient_is_unknown() {
        let (series, slope) = function(Interval::point(0.3));
        assert!(!slope.0[TERMS - 1].is_bounded());
        let back = slope.integral(series.value());
        for order in 0..TERMS {
            assert!(
                (back.0[order].middle() - series.0[order].middle()).abs() < 1.0e-12,
                "{order}"
            );
        }
    }
}
