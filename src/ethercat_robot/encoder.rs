//! Arithmetic of encoder positions.

use crate::application::homing::nearest_turn;

/// Takes an encoder's difference over a cycle for the nearest one within half a revolution.
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
