//! Encoder positions from what is recorded of them: joint angles in single precision, and the lower 16 bits of the
//! increments.

use super::super::contents::SampleEntry;
use etherpen::config::Axis;
use etherpen::robots::AXES;
use std::f64::consts::TAU;

/// Values of 16 bits.
const RANGE: i64 = 1 << 16;
/// Beyond every encoder position, increments.
const MOST: f64 = 1e15;

/// The positions of all axes, from one sample to the next.
#[derive(Clone, Debug)]
pub(super) struct Positions {
    axes: [AxisPosition; AXES],
}

#[derive(Clone, Copy, Debug, Default)]
struct AxisPosition {
    homed: bool,
    last: Option<i64>,
    /// The increments' lower 16 bits, less those of the position that follows from the angle: whole turns that are not
    /// in the angle.
    offset: Option<i64>,
    /// By how much the positions are greater than those of the angles, increments.
    shift: i64,
}

/// An encoder position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Position {
    /// Increments, wrapping.
    pub increments: i32,
    /// Whether it is more than half a turn from the last one without a home, so that the drive was configured again.
    pub is_new: bool,
}

impl Positions {
    pub(super) fn new() -> Self {
        Self {
            axes: [AxisPosition::default(); AXES],
        }
    }

    /// The positions of a sample; `None` where none arrived.
    pub(super) fn next(&mut self, axes: &[Axis; AXES], sample: &SampleEntry) -> [Option<Position>; AXES] {
        std::array::from_fn(|axis| {
            sample.valid[axis].then(|| {
                let (angle_rad, increments) = (sample.measured_rad[axis], sample.increments[axis]);
                self.axes[axis].next(&axes[axis], sample.homed[axis], angle_rad.into(), increments)
            })
        })
    }
}

impl AxisPosition {
    fn next(&mut self, axis: &Axis, homed: bool, angle_rad: f64, lower: u16) -> Position {
        let rounded = position(axis, homed, angle_rad).round().clamp(-MOST, MOST) as i64;
        if homed != self.homed {
            // An encoder that knows nothing goes on where it was when its axis is homed.
            let before = self.last.filter(|_| homed && axis.is_blind());
            self.shift = before.map_or(0, |before| before - rounded);
            (self.homed, self.offset, self.last) = (homed, None, None);
        }
        let rounded = rounded + self.shift;
        let missing = nearest(i64::from(lower) - rounded);
        let offset = *self.offset.get_or_insert(missing);
        let exact = rounded + nearest(missing - offset);
        let half = i64::from(axis.increments_per_revolution) / 2;
        let is_new = !homed && self.last.is_some_and(|last| (exact - last).abs() > half);
        self.last = Some(exact);
        Position {
            increments: exact as i32,
            is_new,
        }
    }
}

/// Position of an encoder at a joint angle, increments. That of a homed axis is right but for whole turns; that of an
/// axis that is not homed counts from where the firmware began to count.
fn position(axis: &Axis, homed: bool, angle_rad: f64) -> f64 {
    let increments_per_rad = axis.gear * f64::from(axis.increments_per_revolution) / TAU;
    match homed {
        true => f64::from(axis.sync_increments) + (angle_rad - axis.sync_angle_rad) * increments_per_rad,
        false => angle_rad * increments_per_rad,
    }
}

/// A difference of lower 16 bits as the smallest that it can be.
fn nearest(difference: i64) -> i64 {
    (difference + RANGE / 2).rem_euclid(RANGE) - RANGE / 2
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use etherpen::config::Encoder;

    #[test]
    fn an_incremental_encoder_goes_on_where_it_was_when_its_axis_is_homed() {
        let axis = Axis {
            encoder: Encoder::Incremental,
            gear: 1.0,
            increments_per_revolution: 100_000,
            sync_angle_rad: 0.5,
            ..Axis::default()
        };
        let mut state = AxisPosition::default();
        let angle_rad = |increments: i64| increments as f64 * TAU / 100_000.0;
        let mut last = None;
        for increments in 1_000_i64..1_100 {
            last = Some(
                state
                    .next(&axis, false, angle_rad(increments), increments as u16)
                    .increments,
            );
        }
        let before = last.expect("positions");
        // Homed at its mark; then it moves by ten increments.
        for moved in 0..10_i64 {
            let homed_rad = 0.5 + angle_rad(moved);
            let found = state.next(&axis, true, homed_rad, (1_099 + moved) as u16);
            assert_eq!(i64::from(found.increments), i64::from(before) + moved);
        }
    }

    #[test]
    fn a_motion_is_followed_to_the_increment_at_any_resolution() {
        for (increments_per_revolution, gear) in [(1 << 20, 12.0), (4_096, 50.0), (10_000, -7.5), (1 << 24, 1.0)] {
            let axis = Axis {
                increments_per_revolution,
                gear,
                ..Axis::default()
            };
            let increments_per_rad = gear * f64::from(increments_per_revolution) / TAU;
            let mut random = Random::new(u64::from(increments_per_revolution));
            let (mut state, mut motor) = (AxisPosition::default(), 0.0_f64);
            // Whole turns that the angle of a homed axis does not know.
            let turns = 5 * i64::from(increments_per_revolution);
            let mut first = None;
            for _ in 0..2_000 {
                motor += (2.0 * random.unit() - 1.0) * 0.04 * increments_per_rad.abs();
                motor = motor.clamp(-0.5 * increments_per_rad.abs(), 0.5 * increments_per_rad.abs());
                let true_position = motor.round() as i64 + i64::from(axis.sync_increments);
                let angle_rad = axis.sync_angle_rad + motor.round() / increments_per_rad;
                let lower = (true_position + turns) as u16;
                let found = state.next(&axis, true, f64::from(angle_rad as f32), lower);
                let off = i64::from(found.increments) - true_position;
                // The first position is as exact as its angle, the others are exact from there on.
                assert!(off.abs() <= 2, "{increments_per_revolution}: {off}");
                assert_eq!(*first.get_or_insert(off), off, "{increments_per_revolution}");
            }
        }
    }
}
