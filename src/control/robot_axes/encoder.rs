//! Arithmetic of encoder positions.

use crate::config::Axis;
use core::f64::consts::TAU;

/// Maps an encoder's difference over a cycle to the nearest one within half a revolution.
#[inline]
pub(super) fn turned(difference: i32, revolution: i32) -> i32 {
    let half = revolution / 2;
    let is_near = |difference: i32| -half <= difference && difference < revolution - half;
    if is_near(difference) {
        return difference;
    }
    // A single-turn encoder that has passed the end of its range is off by one revolution.
    let back = match difference < 0 {
        true => difference.wrapping_add(revolution),
        false => difference.wrapping_sub(revolution),
    };
    if is_near(back) {
        return back;
    }
    // Half a revolution fits 32 bits.
    nearest_turn(difference.into(), revolution.into()) as i32
}

/// A position in floating point, rounded once as by `as f64`, for which there is no instruction.
#[inline]
pub(super) fn float(position: i64) -> f64 {
    f64::from((position >> 32) as i32) * 4_294_967_296.0 + f64::from(position as u32)
}

/// Wraps a difference of less than 2^33 increments to the nearest within half of a revolution of at most 2^24.
///
/// In floating point, which divides without a loop: both numbers and the whole part of their quotient are exact.
pub(super) fn nearest_turn(difference: i64, revolution: i64) -> i64 {
    let turns = libm::floor((difference + revolution / 2) as f64 / revolution as f64);
    difference - turns as i64 * revolution
}

/// Angle of a joint whose single-turn resolver shows `increments`, rad, on the turn nearest to `near_rad`, or nearest
/// to the synchronisation mark if `near_rad` is `None`.
pub fn resolver_angle_rad(axis: &Axis, increments: i64, near_rad: Option<f64>) -> f64 {
    let revolution = i64::from(axis.increments_per_revolution.max(1));
    let off_mark = increments - i64::from(axis.sync_increments);
    let off_mark = nearest_turn(off_mark, revolution);
    let turn_rad = TAU / axis.gear;
    let at_mark_rad = axis.sync_angle_rad + turn_rad * (off_mark as f64 / revolution as f64);
    match near_rad {
        Some(near_rad) => at_mark_rad + turn_rad * libm::round((near_rad - at_mark_rad) / turn_rad),
        None => at_mark_rad,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_without_a_resolution_has_an_angle_that_is_a_number() {
        let axis = Axis {
            increments_per_revolution: 0,
            ..Axis::default()
        };
        for near_rad in [None, Some(0.5)] {
            assert!(resolver_angle_rad(&axis, 12_345, near_rad).is_finite());
        }
    }
}
