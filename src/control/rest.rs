//! Rest of an axis, from its measured positions.
//!
//! An encoder shows an axis that stands between two increments at either of them. A coarse one makes that look like motion: with
//! less than 630,000 increments for a turn of the joint, one increment in a millisecond is faster than [`STANDSTILL_RAD_S`].
//!
//! Invariant: a second increment in the same direction within [`STANDSTILL_MS`] is motion.

use crate::config::Axis;
use core::f64::consts::TAU;

/// How long an axis must be at rest, by its speed or between two increments, ms.
pub const STANDSTILL_MS: u16 = 20;
/// Speed below which an axis is at rest, rad/s.
const STANDSTILL_RAD_S: f64 = 0.01;
/// Largest step of an axis at rest, increments: one, and the rounding of angles.
const STEP_INCREMENTS: f64 = 1.5;
/// Milliseconds in a second.
const MS_PER_S: f64 = 1_000.0;

/// How an axis has moved last.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rest {
    /// Speed of the largest step at rest, rad/s.
    step_rad_s: f64,
    /// Whether the last step led upwards.
    was_up: bool,
    /// Milliseconds since the last step, at most [`STANDSTILL_MS`].
    still_ms: u16,
}

impl Rest {
    pub(super) const UNKNOWN: Self = Self {
        step_rad_s: 0.0,
        was_up: false,
        still_ms: 0,
    };

    /// An axis with this encoder and gear.
    pub(super) fn of(axis: &Axis) -> Self {
        let increments = f64::from(axis.increments_per_revolution) * axis.gear.abs() / TAU;
        Self {
            step_rad_s: STEP_INCREMENTS * MS_PER_S / increments,
            ..Self::UNKNOWN
        }
    }

    /// Whether an axis with this speed in the last millisecond, rad/s, is at rest.
    #[inline(always)]
    pub(super) fn is_at(&mut self, speed_rad_s: f64) -> bool {
        if speed_rad_s.abs() < STANDSTILL_RAD_S {
            self.still_ms = (self.still_ms + 1).min(STANDSTILL_MS);
            return true;
        }
        let is_up = speed_rad_s > 0.0;
        let goes_on = self.still_ms < STANDSTILL_MS && is_up == self.was_up;
        (self.was_up, self.still_ms) = (is_up, 0);
        speed_rad_s.abs() <= self.step_rad_s && !goes_on
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
            let is_at_rest = rest.is_at((angle_rad - before_rad) * MS_PER_S);
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
        for each_ms in 2..STANDSTILL_MS as i32 {
            let longest_ms = rests_ms(&coarse, (1..500).map(|ms| 10_000 + ms / each_ms));
            assert!(
                longest_ms < each_ms as u32,
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
