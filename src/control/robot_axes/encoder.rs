//! Arithmetic of encoder positions.

use crate::config::{Axis, Encoder};
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

/// Angle of a joint whose encoder shows `increments`, rad.
///
/// A single-turn encoder tells it on the turn nearest to `near_rad`, or nearest to the synchronisation mark if `near_rad` is
/// `None`. A multi-turn encoder tells it alone; of `increments` the lower 32 bits count, those of the drive's position. An
/// incremental one tells nothing, nor does a multi-turn one that was never calibrated: the joint is at `near_rad`, or at the mark.
pub fn encoder_angle_rad(axis: &Axis, increments: i64, near_rad: Option<f64>) -> f64 {
    let revolution = i64::from(axis.increments_per_revolution.max(1));
    let off_mark = increments - i64::from(axis.sync_increments);
    let turn_rad = TAU / axis.gear;
    let angle_rad = |off_mark: i64| axis.sync_angle_rad + turn_rad * (off_mark as f64 / revolution as f64);
    match axis.encoder {
        Encoder::SingleTurn => {
            let at_mark_rad = angle_rad(nearest_turn(off_mark, revolution));
            near_rad.map_or(at_mark_rad, |near_rad| {
                at_mark_rad + turn_rad * libm::round((near_rad - at_mark_rad) / turn_rad)
            })
        }
        Encoder::MultiTurn if axis.knows_turns() => angle_rad(i64::from(off_mark as i32)),
        Encoder::MultiTurn | Encoder::Incremental => near_rad.unwrap_or(axis.sync_angle_rad),
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
        for encoder in [Encoder::SingleTurn, Encoder::MultiTurn, Encoder::Incremental] {
            let axis = Axis { encoder, ..axis };
            for near_rad in [None, Some(0.5)] {
                assert!(encoder_angle_rad(&axis, 12_345, near_rad).is_finite());
            }
        }
    }

    #[test]
    fn a_multi_turn_encoder_tells_the_turn_across_the_end_of_32_bits_too_whatever_is_near() {
        for gear in [12.0, -7.5] {
            for sync_increments in [1, 5, i32::MAX, i32::MIN, -1, 1_900_000_000] {
                let axis = Axis {
                    encoder: Encoder::MultiTurn,
                    gear,
                    increments_per_revolution: 1 << 20,
                    sync_angle_rad: 0.3,
                    sync_increments,
                    ..Axis::default()
                };
                for turns in [-900.0, -3.25, 0.0, 0.5, 1.75, 1_000.0] {
                    let off_mark = (turns * f64::from(1 << 20)) as i32;
                    let shown = i64::from(sync_increments.wrapping_add(off_mark));
                    let expected_rad = 0.3 + TAU / gear * turns;
                    for near_rad in [None, Some(0.3), Some(50.0)] {
                        // Whatever the firmware has counted above 32 bits.
                        for lap in [0, 1_i64 << 32, -(1_i64 << 32)] {
                            let found_rad = encoder_angle_rad(&axis, shown + lap, near_rad);
                            assert!(
                                (found_rad - expected_rad).abs() < 1e-9,
                                "{gear} {sync_increments} {turns}"
                            );
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn an_incremental_encoder_tells_nothing_and_neither_does_one_that_was_never_calibrated() {
        for encoder in [Encoder::Incremental, Encoder::MultiTurn] {
            let axis = Axis {
                encoder,
                sync_angle_rad: 0.3,
                ..Axis::default()
            };
            assert!(axis.is_blind());
            // Its drive may be known all the same.
            let axis = Axis { serial: 7, ..axis };
            for increments in [0, 77, -5_000_000] {
                assert_eq!(encoder_angle_rad(&axis, increments, None), 0.3);
                assert_eq!(encoder_angle_rad(&axis, increments, Some(1.1)), 1.1);
            }
        }
    }
}
