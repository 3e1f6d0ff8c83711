//! Polynomial pieces of the shaped path: lines, spans of a cubic B-spline, and quintic corner blends.
//!
//! A curve's parameter runs from 0 to 1. All three kinds are polynomials of degree five at most, so the grid, the scan
//! and the interpolator need one form only. Curvature is zero at both ends of a line and of a blend.

use crate::robots::vector::{Vector, add_scaled, dot, length, root, scale, subtract};

/// Coefficients of a curve.
const COEFFICIENTS: usize = 6;
/// Newton steps to the parameter at which a curve reaches a point: a spline's legs differ by a factor of six at most,
/// and the first step is then a fifth too short.
const REACH_STEPS: usize = 4;
/// Offset and weights of three-point Gauss quadrature.
const GAUSS_OFFSET: f64 = 0.774_596_669_241_483_4;
const GAUSS_OUTER: f64 = 5.0 / 9.0;
const GAUSS_INNER: f64 = 8.0 / 9.0;
/// Shape of a blend by turn angle, 30 degrees a row from 0: distances of the second and third control point from the
/// corner, as parts of the first's. Of the shapes in steps of 0.05, these are the shortest in time whose 1 ms setpoints
/// keep every limit, on zigzags and stars at 2 and 10 m/s2 and under the joints' limits alone: 0.3 to 1.3 % shorter
/// than the shapes with the smallest peak of curvature. The first two rows are the shortest in steps of 0.01 on strokes
/// of short legs that turn by 0.3 rad and less, as in portraits.
const BLEND_SHAPES: [(f64, f64); 7] = [
    (0.82, 0.27),
    (0.81, 0.24),
    (0.85, 0.20),
    (0.85, 0.25),
    (0.85, 0.20),
    (0.85, 0.35),
    (0.85, 0.30),
];

/// Smallest horizontal part of a unit tangent that has a direction in plan view.
const HORIZONTAL_MIN: f64 = 0.1;

/// Direction of a unit tangent in plan view, rad; `None` if the tangent is vertical.
pub(crate) fn direction(tangent: &Vector) -> Option<f64> {
    let [x, y, _] = *tangent;
    (x * x + y * y >= HORIZONTAL_MIN * HORIZONTAL_MIN).then(|| libm::atan2(y, x))
}

/// A polynomial curve over a parameter from 0 to 1, mm.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Curve {
    coefficients: [Vector; COEFFICIENTS],
}

/// Point, tangent and curvature of a curve at one parameter.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame {
    pub(crate) point: Vector,
    /// Unit tangent.
    pub(crate) tangent: Vector,
    /// Curvature vector, 1/mm.
    pub(crate) bend: Vector,
}

/// Proportions of a blend for a corner.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlendShape {
    second: f64,
    third: f64,
}

impl BlendShape {
    /// Shape for the cosine of the turn angle.
    pub(crate) fn for_turn(cosine: f64) -> Self {
        let rows = libm::acos(cosine.clamp(-1.0, 1.0)) * (6.0 / core::f64::consts::PI);
        let row = rows as usize;
        let part = rows - row as f64;
        let (low, high) = (
            BLEND_SHAPES.get(row).copied().unwrap_or_default(),
            BLEND_SHAPES.get(row + 1).copied().unwrap_or_default(),
        );
        Self {
            second: low.0 + (high.0 - low.0) * part,
            third: low.1 + (high.1 - low.1) * part,
        }
    }

    /// Distance of the blend's middle from the corner, for a first control point at distance 1 and legs whose unit
    /// vectors differ by a vector of length 1.
    pub(crate) fn deviation(&self) -> f64 {
        (1.0 + 5.0 * self.second + 10.0 * self.third) / 32.0
    }
}

impl Curve {
    /// A curve that is one point, the origin.
    pub(crate) const NONE: Self = Self {
        coefficients: [[0.0; 3]; COEFFICIENTS],
    };

    pub(crate) fn line(from: &Vector, to: &Vector) -> Self {
        let mut curve = Self::default();
        curve.coefficients[0] = *from;
        curve.coefficients[1] = subtract(to, from);
        curve
    }

    /// Coefficients by powers of the parameter, mm.
    pub(crate) fn coefficients(&self) -> &[Vector; COEFFICIENTS] {
        &self.coefficients
    }

    /// Whether the curve is a line.
    pub(crate) fn is_straight(&self) -> bool {
        self.coefficients
            .iter()
            .skip(2)
            .all(|coefficient| *coefficient == [0.0; 3])
    }

    /// One span of a uniform cubic B-spline.
    pub(crate) fn spline(control: &[Vector; 4]) -> Self {
        let mut curve = Self::default();
        let [c0, c1, c2, c3] = control;
        for axis in 0..3 {
            let (a, b, c, d) = (c0[axis], c1[axis], c2[axis], c3[axis]);
            curve.coefficients[0][axis] = (a + 4.0 * b + c) / 6.0;
            curve.coefficients[1][axis] = (c - a) / 2.0;
            curve.coefficients[2][axis] = (a - 2.0 * b + c) / 2.0;
            curve.coefficients[3][axis] = (d - a + 3.0 * (b - c)) / 6.0;
        }
        curve
    }

    /// Blend around a corner between legs of the unit vectors `before` and `after`, from `trim` mm before the corner
    /// to `trim` mm after it.
    pub(crate) fn blend(corner: &Vector, before: &Vector, after: &Vector, trim: f64, shape: BlendShape) -> Self {
        let [first, second, third] = [trim, shape.second * trim, shape.third * trim];
        let control = [
            add_scaled(corner, before, -first),
            add_scaled(corner, before, -second),
            add_scaled(corner, before, -third),
            add_scaled(corner, after, third),
            add_scaled(corner, after, second),
            add_scaled(corner, after, first),
        ];
        let mut curve = Self::default();
        let mut differences = control;
        let mut binomial = 1.0;
        for (order, coefficient) in curve.coefficients.iter_mut().enumerate() {
            *coefficient = scale(&differences[0], binomial);
            binomial = binomial * (5.0 - order as f64) / (order as f64 + 1.0);
            for index in 0..differences.len() - 1 {
                differences[index] = subtract(&differences[index + 1], &differences[index]);
            }
        }
        curve
    }

    /// Point at a parameter.
    pub(crate) fn at(&self, parameter: f64) -> Vector {
        let mut point = [0.0; 3];
        for coefficient in self.coefficients.iter().rev() {
            point = add_scaled(coefficient, &point, parameter);
        }
        point
    }

    fn first_derivative(&self, parameter: f64) -> Vector {
        let [_, c1, c2, c3, c4, c5] = &self.coefficients;
        let mut result = scale(c5, 5.0);
        for (coefficient, factor) in [(c4, 4.0), (c3, 3.0), (c2, 2.0), (c1, 1.0)] {
            result = add_scaled(&scale(&result, parameter), coefficient, factor);
        }
        result
    }

    fn second_derivative(&self, parameter: f64) -> Vector {
        let [_, _, c2, c3, c4, c5] = &self.coefficients;
        let mut result = scale(c5, 20.0);
        for (coefficient, factor) in [(c4, 12.0), (c3, 6.0), (c2, 2.0)] {
            result = add_scaled(&scale(&result, parameter), coefficient, factor);
        }
        result
    }

    /// Derivative of the arc length with respect to the parameter, mm.
    pub(crate) fn stretch(&self, parameter: f64) -> f64 {
        length(&self.first_derivative(parameter))
    }

    /// Parameter at which a curve that begins before a point is level with the point, measured along a direction.
    pub(crate) fn reaches(&self, point: &Vector, direction: &Vector) -> f64 {
        let mut parameter = 0.0;
        for _ in 0..REACH_STEPS {
            let left = dot(&subtract(point, &self.at(parameter)), direction);
            let pace = dot(&self.first_derivative(parameter), direction);
            if pace <= 0.0 {
                break;
            }
            parameter = (parameter + left / pace).clamp(0.0, 1.0);
        }
        parameter
    }

    /// Frame at a parameter.
    pub(crate) fn frame(&self, parameter: f64) -> Frame {
        let first = self.first_derivative(parameter);
        let second = self.second_derivative(parameter);
        let stretch_squared = dot(&first, &first);
        let stretch = root(stretch_squared);
        let inverse = if stretch > 0.0 { 1.0 / stretch } else { 0.0 };
        let tangent = scale(&first, inverse);
        let along = dot(&second, &tangent);
        Frame {
            point: self.at(parameter),
            tangent,
            bend: scale(&add_scaled(&second, &tangent, -along), inverse * inverse),
        }
    }

    /// Arc length between two parameters, mm.
    pub(crate) fn arc(&self, from: f64, to: f64) -> f64 {
        let (half, middle) = (0.5 * (to - from), 0.5 * (to + from));
        let offset = half * GAUSS_OFFSET;
        half * (GAUSS_OUTER * (self.stretch(middle - offset) + self.stretch(middle + offset))
            + GAUSS_INNER * self.stretch(middle))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: &Vector, b: &Vector) -> bool {
        length(&subtract(a, b)) < 1.0e-12
    }

    #[test]
    fn a_blend_joins_its_legs_without_curvature_and_keeps_its_deviation() {
        let (before, after) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        let shape = BlendShape::for_turn(0.0);
        let curve = Curve::blend(&[5.0, 0.0, 0.0], &before, &after, 0.4, shape);
        let (start, end) = (curve.frame(0.0), curve.frame(1.0));
        assert!(close(&start.point, &[4.6, 0.0, 0.0]) && close(&start.tangent, &before));
        assert!(close(&end.point, &[5.0, 0.4, 0.0]) && close(&end.tangent, &after));
        assert!(length(&start.bend) < 1.0e-9 && length(&end.bend) < 1.0e-9);
        let deviation = length(&subtract(&curve.at(0.5), &[5.0, 0.0, 0.0]));
        assert!((deviation - 0.4 * shape.deviation() * libm::sqrt(2.0)).abs() < 1.0e-12);
    }

    #[test]
    fn neighbouring_spline_spans_join_with_the_same_curvature() {
        let points = [
            [0.0, 0.0, 0.0],
            [1.0, 0.1, 0.0],
            [2.0, 0.4, 0.2],
            [2.9, 1.0, 0.2],
            [3.5, 1.9, 0.1],
        ];
        let first = Curve::spline(&[points[0], points[1], points[2], points[3]]).frame(1.0);
        let second = Curve::spline(&[points[1], points[2], points[3], points[4]]).frame(0.0);
        assert!(close(&first.point, &second.point) && close(&first.tangent, &second.tangent));
        assert!(close(&first.bend, &second.bend));
    }

    #[test]
    fn a_curve_that_does_not_come_nearer_reaches_a_point_at_a_parameter_all_the_same() {
        let (x, y) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        let curve = Curve::spline(&[[0.0; 3], x, scale(&x, 2.0), scale(&x, 3.0)]);
        for (direction, point) in [
            (y, [1.5, 0.0, 0.0]),
            (y, [1.5, 1.0, 0.0]),
            (scale(&x, -1.0), [1.5, 0.0, 0.0]),
        ] {
            assert_eq!(curve.reaches(&point, &direction), 0.0, "along {direction:?}");
        }
        assert!((curve.reaches(&[1.5, 0.0, 0.0], &x) - 0.5).abs() < 1.0e-6);
    }

    #[test]
    fn arc_length_adds_up() {
        let curve = Curve::blend(
            &[0.0; 3],
            &[1.0, 0.0, 0.0],
            &[0.0, 1.0, 0.0],
            1.0,
            BlendShape::for_turn(0.0),
        );
        let (mut coarse, mut fine, mut before) = (0.0, 0.0, curve.at(0.0));
        for step in 0..8 {
            coarse += curve.arc(f64::from(step) / 8.0, f64::from(step + 1) / 8.0);
        }
        for step in 1..=100_000 {
            let point = curve.at(f64::from(step) / 100_000.0);
            fine += length(&subtract(&point, &before));
            before = point;
        }
        assert!((coarse - fine).abs() < 1.0e-6, "{coarse} against {fine}");
    }
}
