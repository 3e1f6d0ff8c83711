//! The point at one distance from three centres, below the plane through them.
//!
//! The foot of the perpendicular from there to the plane is the centre of the circle through the three centres.

use crate::vector::{Vector, add, cross, dot, is_finite, scale, subtract};

/// Smallest squared area of the triangle of the centres, mm4: below it they lie on a line.
const AREA_SQUARED_MIN_MM4: f64 = 1.0;

/// The lower point at a distance, given as its square, mm2, from three centres, mm; `None` if there is none.
#[inline]
pub(super) fn below([first, second, third]: [Vector; 3], distance_squared: f64) -> Option<Vector> {
    let (a, b) = (subtract(second, first), subtract(third, first));
    let normal = cross(a, b);
    let normal_squared = dot(normal, normal);
    if normal_squared.is_nan() || normal_squared < AREA_SQUARED_MIN_MM4 {
        return None;
    }
    let (a_squared, b_squared) = (dot(a, a), dot(b, b));
    let towards = add(scale(cross(b, normal), a_squared), scale(cross(normal, a), b_squared));
    let foot = scale(towards, 0.5 / normal_squared);
    let height_squared = distance_squared - dot(foot, foot);
    if height_squared.is_nan() || height_squared < 0.0 {
        return None;
    }
    let height = (height_squared / normal_squared).sqrt();
    let downwards = if normal[2] > 0.0 { -height } else { height };
    let point = add(first, add(foot, scale(normal, downwards)));
    is_finite(&point).then_some(point)
}
