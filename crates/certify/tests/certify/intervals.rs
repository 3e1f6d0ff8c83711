//! Interval arithmetic against exact integers: no result of exact arithmetic lies outside.

use crate::paths::Random;
use etherpen_certify::interval::Interval;

const ROUNDS: u32 = 200_000;
const SEED: u64 = 17;

/// A finite number as an integer times a power of two.
fn decoded(value: f64) -> (i128, i32) {
    let bits = value.to_bits();
    let exponent = ((bits >> 52) & 0x7ff) as i32;
    let fraction = (bits & ((1 << 52) - 1)) as i128;
    let (mantissa, exponent) = if exponent == 0 {
        (fraction, -1074)
    } else {
        (fraction | 1 << 52, exponent - 1075)
    };
    (if value < 0.0 { -mantissa } else { mantissa }, exponent)
}

/// Whether `value * factor` is at most an integer, exactly. A product has less than 90 bits.
fn at_most(value: f64, factor: i128, integer: i128) -> bool {
    let (mantissa, exponent) = decoded(value);
    let product = mantissa * factor;
    if exponent >= 0 {
        return product << exponent <= integer;
    }
    let room = integer.unsigned_abs().leading_zeros() as i32 - 2;
    if integer != 0 && -exponent > room {
        // Shifted, the integer is larger than every product.
        return integer > 0;
    }
    if integer == 0 {
        product <= 0
    } else {
        product <= integer << -exponent
    }
}

/// An interval with integer ends, and an integer inside.
fn integers(random: &mut Random, bits: i32) -> (Interval, i64) {
    let size = 2.0_f64.powi(1 + random.below(bits as usize - 1) as i32);
    let mut ends = [random.between(-size, size) as i64, random.between(-size, size) as i64];
    if random.below(4) == 0 {
        ends[1] = ends[0];
    }
    let inside = ends[0] + ((ends[1] - ends[0]) as f64 * random.next()) as i64;
    (Interval::between(ends[0] as f64, ends[1] as f64), inside)
}

fn holds(interval: Interval, factor: i128, integer: i128) -> bool {
    at_most(interval.low(), factor, integer) && at_most(-interval.high(), factor, -integer)
}

#[test]
fn sums_and_products_contain_the_exact_ones() {
    let mut random = Random::new(SEED);
    for round in 0..ROUNDS {
        let ((a, x), (b, y)) = (integers(&mut random, 52), integers(&mut random, 52));
        let (x, y) = (i128::from(x), i128::from(y));
        assert!(holds(a + b, 1, x + y), "round {round}: {x} + {y}");
        assert!(holds(a - b, 1, x - y), "round {round}: {x} - {y}");
        assert!(holds(a * b, 1, x * y), "round {round}: {x} * {y} not in {:?}", a * b);
        assert!(holds(a.square(), 1, x * x), "round {round}: square of {x}");
        assert!(holds(-a, 1, -x), "round {round}: minus {x}");
        // A sum of numbers with more digits than a float has.
        assert!(holds(a * b + a, 1, x * y + x), "round {round}: {x} * {y} + {x}");
    }
}

#[test]
fn quotients_and_roots_contain_the_exact_ones() {
    let mut random = Random::new(SEED);
    let mut quotients = 0;
    for round in 0..ROUNDS {
        let ((a, x), (b, y)) = (integers(&mut random, 30), integers(&mut random, 30));
        let quotient = a / b;
        if b.contains(0.0) {
            assert!(!quotient.is_bounded(), "round {round}: {a:?} over {b:?}");
        } else {
            // x / y is in the interval if x is in y times the interval.
            let (factor, integer) = if y < 0 { (-y, -x) } else { (y, x) };
            assert!(
                holds(quotient, i128::from(factor), i128::from(integer)),
                "round {round}: {x} / {y}"
            );
            quotients += 1;
        }
        let root = (a.square() + Interval::ONE).root();
        let (low, high) = (root.low(), root.high());
        assert!(
            low > 0.0 && Interval::point(low).square().low() <= (x * x + 1) as f64,
            "round {round}"
        );
        assert!(
            Interval::point(high).square().high() >= (x * x + 1) as f64,
            "round {round}"
        );
    }
    assert!(quotients > ROUNDS / 10);
}

/// Squares of the ends of a root enclose the number, exactly.
#[test]
fn the_ends_of_a_root_are_on_both_sides() {
    for number in 1_i128..200_000 {
        let root = Interval::point(number as f64).root();
        for (end, is_low) in [(root.low(), true), (root.high(), false)] {
            let (mantissa, exponent) = decoded(end);
            let (square, shifted) = (mantissa * mantissa, number << (-2 * exponent));
            assert!(
                if is_low { square < shifted } else { square > shifted },
                "root of {number}"
            );
        }
    }
}

#[test]
fn what_has_no_bound_proves_nothing() {
    let wide = Interval::between(-1.0, 1.0);
    let huge = Interval::point(f64::MAX);
    for unbounded in [
        Interval::ONE / wide,
        Interval::ONE / Interval::ZERO,
        wide.root(),
        Interval::point(-1.0).root(),
        huge * huge,
        Interval::ENTIRE * wide,
        Interval::ENTIRE + Interval::ONE,
        Interval::ENTIRE.square(),
        Interval::ENTIRE.hull(&wide),
        Interval::ONE / Interval::ENTIRE,
    ] {
        assert!(!unbounded.is_bounded(), "{unbounded:?}");
        assert_eq!(unbounded.magnitude(), f64::INFINITY);
    }
    assert_eq!(Interval::ZERO * Interval::ENTIRE, Interval::ZERO);
}

#[test]
fn every_rounding_moves_the_ends_outwards() {
    let mut random = Random::new(SEED);
    for _ in 0..ROUNDS {
        let [a, b] = [0, 1].map(|_| random.between(-1.0, 1.0) * 10.0_f64.powf(random.between(-200.0, 100.0)));
        let (one, other) = (Interval::point(a), Interval::point(b));
        for (value, interval) in [(a + b, one + other), (a * b, one * other), (a / b, one / other)] {
            assert!(
                interval.low() < value && value < interval.high(),
                "{a} and {b}: {interval:?}"
            );
        }
    }
}
