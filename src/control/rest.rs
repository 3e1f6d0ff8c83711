//! Rest of an axis, from its measured positions.
//!
//! An encoder shows an axis that stands between two increments at either of them. A coarse one makes that look like motion: with
//! less than 630,000 increments for a turn of the joint, one increment in a millisecond is faster than [`STANDSTILL_RAD_S`].
//!
//! Invariant: an axis that goes on in one direction is at rest for no more milliseconds in a row than it needs for two increments,
//! unless it is slower than that speed.

use crate::config::Axis;
use core::f64::consts::TAU;

/// Speed below which an axis is at rest, rad/s.
const STANDSTILL_RAD_S: f64 = 0.01;
/// How far an axis at rest may be from where it came to rest, increments: one, and the rounding of angles.
const DITHER_INCREMENTS: f64 = 1.5;

/// Where an axis came to rest.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rest {
    at_rad: f64,
    dither_rad: f64,
}

impl Rest {
    pub(super) const UNKNOWN: Self = Self {
        at_rad: 0.0,
        dither_rad: 0.0,
    };

    /// An axis with this encoder and gear.
    pub(super) fn of(axis: &Axis) -> Self {
        let increments = f64::from(axis.increments_per_revolution) * axis.gear.abs() / TAU;
        Self {
            dither_rad: DITHER_INCREMENTS / increments,
            ..Self::UNKNOWN
        }
    }

    /// Whether an axis at this angle, rad, with this speed, rad/s, is at rest.
    #[inline(always)]
    pub(super) fn is_at(&mut self, angle_rad: f64, speed_rad_s: f64) -> bool {
        let is_at_rest = speed_rad_s.abs() < STANDSTILL_RAD_S || (angle_rad - self.at_rad).abs() <= self.dither_rad;
        if !is_at_rest {
            self.at_rad = angle_rad;
        }
        is_at_rest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The longest rest, ms, of an axis at these increments in successive milliseconds.
    fn rests_ms(axis: &Axis, increments: impl IntoIterator<Item = i32>) -> u32 {
        let increment_rad = TAU / f64::from(axis.increments_per_revolution) / axis.gear.abs();
        let mut rest = Rest::of(axis);
        let (mut before_rad, mut now_ms, mut longest_ms) = (0.0, 0, 0);
        for increments in increments {
            let angle_rad = f64::from(increments) * increment_rad;
            let is_at_rest = rest.is_at(angle_rad, (angle_rad - before_rad) * 1_000.0);
            before_rad = angle_rad;
            now_ms = if is_at_rest { now_ms + 1 } else { 0 };
            longest_ms = longest_ms.max(now_ms);
        }
        longest_ms
    }

    #[test]
    fn an_axis_between_two_increments_is_at_rest_however_coarse_its_encoder_is() {
        for increments_per_revolution in [1 << 16, 10_000, 256, 1 << 24] {
            let axis = Axis {
                increments_per_revolution,
                gear: -7.592_484,
                ..Axis::default()
            };
            let dithers = (0..100).map(|ms| 500_000 + [0, 1, 0, 0, 1, 1][ms % 6]);
            assert!(rests_ms(&axis, dithers) >= 98, "{increments_per_revolution}");
        }
    }

    #[test]
    fn an_axis_that_goes_on_is_never_at_rest_for_long() {
        let axis = Axis {
            increments_per_revolution: 1 << 16,
            gear: 7.592_484,
            ..Axis::default()
        };
        // From one increment, 12.6 mrad/s, to many in a millisecond.
        for speed in [1, -1, 2, 7, -1_000] {
            let longest_ms = rests_ms(&axis, (1..500).map(|ms| 1_000_000 + speed * ms));
            assert!(
                longest_ms <= 2,
                "{longest_ms} ms at {speed} increments in a millisecond"
            );
        }
        // An increment in several milliseconds, with the coarsest encoder.
        let coarse = Axis {
            increments_per_revolution: 256,
            gear: 7.592_484,
            ..Axis::default()
        };
        for each_ms in 2..10 {
            let longest_ms = rests_ms(&coarse, (1..500).map(|ms| 10_000 + ms / each_ms));
            assert!(
                longest_ms < 2 * each_ms as u32,
                "{longest_ms} ms at an increment in {each_ms} ms"
            );
        }
        // A fine encoder: 11 mrad/s are many increments.
        let fine = Axis {
            increments_per_revolution: 1 << 24,
            gear: 12.0,
            ..Axis::default()
        };
        assert_eq!(rests_ms(&fine, (1..500).map(|ms| 352 * ms)), 0);
    }
}
