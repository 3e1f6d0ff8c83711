//! Three-vectors and square roots for the planner, without a heap or a software library call.
//!
//! `f64::sqrt` is not stable in `core`, and a portable square root is a software routine on the microcontroller. A
//! Newton step on the reciprocal root takes only multiplications and one subtraction. It costs less, needs no
//! instruction of the target, and gives identical bits on the host and on the Cortex-M7.

use super::Position;

/// A vector or a point, mm where it is a length.
pub type Vector = [f64; 3];

/// Magic number whose difference with half the bits of x approximates the bits of 1/sqrt(x) within 3.5 %.
const RECIPROCAL_ROOT_SEED: u64 = 0x5fe6_eb50_c7b5_37a9;
/// Newton steps on the reciprocal root: 3.5e-2, 1.8e-3, 4.7e-6, 3.3e-11, then rounding.
const RECIPROCAL_ROOT_STEPS: usize = 4;

/// 1/sqrt(x) for a normal positive `x`, within 2 units in the last place; any other input gives no meaningful value,
/// but no trap and no endless loop.
pub fn reciprocal_root(x: f64) -> f64 {
    let mut root = f64::from_bits(RECIPROCAL_ROOT_SEED.wrapping_sub(x.to_bits() >> 1));
    let half = 0.5 * x;
    for _ in 0..RECIPROCAL_ROOT_STEPS {
        root *= 1.5 - half * root * root;
    }
    root
}

/// Square root within one unit in the last place; 0 for any input that is not a positive number.
pub fn root(x: f64) -> f64 {
    if !(x >= f64::MIN_POSITIVE && x.is_finite()) {
        return 0.0;
    }
    let inverse = reciprocal_root(x);
    let root = x * inverse;
    root + 0.5 * inverse * (x - root * root)
}

/// Sum.
pub fn add(a: &Vector, b: &Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Difference a - b.
pub fn subtract(a: &Vector, b: &Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Product of a vector and a number.
pub fn scale(a: &Vector, factor: f64) -> Vector {
    [a[0] * factor, a[1] * factor, a[2] * factor]
}

/// a + factor * b.
pub fn add_scaled(a: &Vector, b: &Vector, factor: f64) -> Vector {
    [a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]]
}

/// Scalar product.
pub fn dot(a: &Vector, b: &Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Vector product.
pub fn cross(a: &Vector, b: &Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Length.
pub fn length(a: &Vector) -> f64 {
    root(dot(a, a))
}

impl From<Position> for Vector {
    fn from(position: Position) -> Self {
        [position.x_mm, position.y_mm, position.z_mm]
    }
}

impl From<Vector> for Position {
    fn from([x_mm, y_mm, z_mm]: Vector) -> Self {
        Self { x_mm, y_mm, z_mm }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roots_are_right_to_the_last_place_over_the_whole_range() {
        let mut x = 1.3e-300;
        while x < 1.0e300 {
            let expected = libm::sqrt(x);
            assert!((root(x) - expected).abs() <= 2.3e-16 * expected, "root of {x}");
            assert!((reciprocal_root(x) * expected - 1.0).abs() <= 9.0e-16, "1/root of {x}");
            x *= 1.37;
        }
        assert_eq!([root(0.0), root(-4.0), root(f64::NAN), root(f64::INFINITY)], [0.0; 4]);
    }
}
