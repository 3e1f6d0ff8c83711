//! Sines, cosines and angles with proven bounds.

use crate::interval::Interval;
use std::f64::consts::PI;

/// Terms of the Taylor series of sine and cosine together; enough for angles up to half a turn.
const TERMS: u32 = 32;
/// Largest angle for which the remainder is smaller than the rounding, rad.
const ANGLE_MAX_RAD: f64 = 3.5;

/// The number pi.
fn pi() -> Interval {
    // The nearest number is too small.
    Interval::between(PI, PI.next_up())
}

/// A full turn, rad.
pub(crate) fn turn() -> Interval {
    pi() * Interval::point(2.0)
}

/// An angle given in degrees, rad, reduced to at most half a turn.
pub(crate) fn from_degrees(degrees: f64) -> Interval {
    // The remainder of a division by 360 is exact, and so is taking off a turn from what is left.
    let rest = degrees % 360.0;
    let reduced = if rest > 180.0 {
        Interval::point(rest) - Interval::point(360.0)
    } else if rest < -180.0 {
        Interval::point(rest) + Interval::point(360.0)
    } else {
        Interval::point(rest)
    };
    reduced * pi() / Interval::point(180.0)
}

/// Cosine and sine of an angle; no bounds for more than about half a turn.
pub(crate) fn cosine_and_sine(angle: Interval) -> [Interval; 2] {
    let small = angle.magnitude() <= ANGLE_MAX_RAD;
    if !small {
        return [Interval::ENTIRE; 2];
    }
    let mut sums = [Interval::ZERO; 2];
    let mut term = Interval::ONE;
    for order in 0..TERMS {
        let sum = &mut sums[(order % 2) as usize];
        *sum = if order / 2 % 2 == 0 { *sum + term } else { *sum - term };
        term = term * angle / Interval::point(f64::from(order + 1));
    }
    // Lagrange's remainder: the derivatives are at most 1.
    let remainder = Interval::around_zero(term.magnitude());
    let one = Interval::between(-1.0, 1.0);
    sums.map(|sum| (sum + remainder).meet(&one))
}

/// The angle, from -pi to pi, of a unit vector with this cosine and sine; no bounds unless both are narrow.
pub(crate) fn of_unit(cosine: Interval, sine: Interval) -> Interval {
    let near = sine.middle().atan2(cosine.middle());
    if !near.is_finite() {
        return Interval::ENTIRE;
    }
    let [c, s] = cosine_and_sine(Interval::point(near));
    // Sine and cosine of the difference between the angle and `near`.
    let (across, along) = (sine * c - cosine * s, cosine * c + sine * s);
    let near_enough = along.low() > 0.5;
    if !near_enough {
        return Interval::ENTIRE;
    }
    // Up to a third of a turn, an angle is less than 1.25 times its sine.
    let difference = across * Interval::point(1.25);
    Interval::point(near) + Interval::around_zero(difference.magnitude())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sines_and_angles_are_narrow_and_contain_the_libraries() {
        for step in -1_000_i32..=1_000 {
            let angle = PI * f64::from(step) / 1_000.0;
            let [cosine, sine] = cosine_and_sine(Interval::point(angle));
            for (interval, value) in [(cosine, angle.cos()), (sine, angle.sin())] {
                assert!(interval.high() - interval.low() < 1.0e-13, "{angle}: {interval:?}");
                // The library's last digit may be wrong.
                let near = Interval::between(value.next_down(), value.next_up());
                assert!(
                    near.high() >= interval.low() && near.low() <= interval.high(),
                    "{angle}"
                );
            }
            // Half a turn has two angles.
            if step.abs() < 1_000 {
                let back = of_unit(cosine, sine);
                assert!(
                    back.contains(angle) && back.high() - back.low() < 1.0e-12,
                    "{angle}: {back:?}"
                );
            }
        }
    }

    #[test]
    fn degrees_are_reduced_and_exact_angles_are_inside() {
        for (degrees, cosine, sine) in [
            (0.0, 1.0, 0.0),
            (90.0, 0.0, 1.0),
            (-270.0, 0.0, 1.0),
            (540.0, -1.0, 0.0),
            (330.0, 0.75_f64.sqrt(), -0.5),
        ] {
            let [c, s] = cosine_and_sine(from_degrees(degrees));
            let close = |interval: Interval, value: f64| (interval.middle() - value).abs() < 1.0e-13;
            assert!(close(c, cosine) && close(s, sine), "{degrees}: {c:?} {s:?}");
        }
    }

    #[test]
    fn what_is_no_angle_has_no_bounds() {
        assert!(!cosine_and_sine(Interval::point(4.0))[0].is_bounded());
        assert!(!of_unit(Interval::ENTIRE, Interval::ZERO).is_bounded());
        assert!(!of_unit(Interval::between(-1.0, 1.0), Interval::between(-1.0, 1.0)).is_bounded());
    }
}
