//! The point at equal distances from three centres: forward kinematics of robots whose links meet at the tool.

use super::vector::{Vector, add_scaled, cross, dot, length, root, scale, subtract};

/// The lower of the two points at the distance `radius_mm` from three centres, mm; `None` if no finite point is.
///
/// The frame is built from the centres, so that equal heights are no special case.
#[inline]
pub(super) fn lower_meeting([origin, second, third]: &[Vector; 3], radius_mm: f64) -> Option<Vector> {
    let (to_second, to_third) = (subtract(second, origin), subtract(third, origin));
    let side = length(&to_second);
    let x_axis = scale(&to_second, 1.0 / side);
    let along = dot(&x_axis, &to_third);
    let across = add_scaled(&to_third, &x_axis, -along);
    let height = length(&across);
    let y_axis = scale(&across, 1.0 / height);
    let z_axis = cross(&x_axis, &y_axis);
    let x = 0.5 * side;
    let y = (along * along + height * height - 2.0 * along * x) / (2.0 * height);
    let depth_squared = radius_mm * radius_mm - x * x - y * y;
    if !(depth_squared >= 0.0 && depth_squared.is_finite()) {
        return None;
    }
    let depth = if z_axis[2] > 0.0 {
        -root(depth_squared)
    } else {
        root(depth_squared)
    };
    let point = add_scaled(&add_scaled(&add_scaled(origin, &x_axis, x), &y_axis, y), &z_axis, depth);
    point.iter().all(|value| value.is_finite()).then_some(point)
}
