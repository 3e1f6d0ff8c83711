//! Braking on the committed path: the setpoints of the ring, passed ever more slowly.
//!
//! Time along the path passes with a rate that falls from 1 to 0. Each millisecond it falls as fast as every joint's
//! quick-stop deceleration a allows: a joint with the velocity q' and the acceleration q'' of the ring accelerates with
//! q'' rate^2 + q' d(rate)/dt, which stays above -a in the direction of its motion. Where that would brake the joint that
//! is fastest for its deceleration by less than `SHARE_MIN` of it, that joint is braked by this share, and another joint
//! exceeds its deceleration. Between the ring's setpoints a cubic through them is followed (Catmull and Rom, 1974), so
//! that the joints stay on the path whatever the rate is.
//!
//! The setpoints whose commands have been sent are kept: the motors are not yet there. So the first command of the
//! millisecond in which the stop begins brakes already, and the command has no step.
//!
//! `Envelope` supervises the stop each millisecond, in the way of a safe stop 1 with a monitored ramp (SS1-r, IEC
//! 61800-5-2): each joint's measured velocity stays near the planned one, and the time is limited. What is left of it, and by
//! which joint, is a [`PathStopFailure`].
//!
//! Invariants: every setpoint is on the path that the ring holds; the rate never grows; it is 0 within `1 / SHARE_MIN` of
//! the time that the quick stop would take, for a path on which the joints keep their speed.

use super::cycle::Queued;
use super::window::Window;
use crate::application::PathStopFailure;
use crate::config::Axis;
use crate::motion::Setpoint;
use crate::robots::AXES;
use core::f64::consts::TAU;
use heapless::spsc::Consumer;

/// Least share of its quick-stop deceleration with which the joint brakes that is fastest for its deceleration.
const SHARE_MIN: f64 = 0.6;
/// Longest time that a quick stop may take for the path to be kept, s: a longer one would leave no time for a quick stop
/// after the stop on the path has failed, before the brakes close.
const QUICK_STOP_MAX_S: f64 = 0.4;
/// Length of a step, s.
const STEP_S: f64 = 1.0e-3;
/// Speed below which a joint does not bound the deceleration, rad/s.
const NEGLIGIBLE_RAD_S: f64 = 1.0e-9;

/// Setpoints that the cubic needs from the present one on.
const NEEDED: usize = 3;

/// A stop on the path; not active at first.
#[derive(Debug)]
pub(super) struct PathStop {
    is_active: bool,
    /// Setpoints of the ring from the one before the present place on.
    ahead: Window,
    /// Present place between the first two of them, 0 to 1.
    place: f64,
    /// Milliseconds of the path in a millisecond, 0 to 1.
    rate: f64,
    last: Setpoint,
    envelope: Envelope,
}

impl PathStop {
    pub(super) fn new() -> Self {
        Self {
            is_active: false,
            ahead: Window::new(),
            place: 0.0,
            rate: 0.0,
            last: Setpoint::default(),
            envelope: Envelope::default(),
        }
    }

    /// Whether a stop on the path is under way.
    #[inline]
    pub(super) fn is_active(&self) -> bool {
        self.is_active
    }

    pub(super) fn end(&mut self) {
        self.is_active = false;
    }

    /// Begins a stop: the first `kept` setpoints of the window stay, the others become its path. `axes` are those that have
    /// drives. Returns whether the path can be kept.
    #[cold]
    pub(super) fn begin(&mut self, window: &mut Window, kept: usize, axes: &[Axis]) -> bool {
        let kept = kept.min(window.length());
        let Some(last) = kept.checked_sub(1).and_then(|last| window.get(last)) else {
            return false;
        };
        let quick_stop_s = quick_stop_s(&last.velocity_rad_s, axes);
        if quick_stop_s > QUICK_STOP_MAX_S {
            return false;
        }
        (self.last, self.place, self.rate) = (*last, 0.0, 1.0);
        self.ahead.clear();
        for place in kept - 1..window.length() {
            if let Some(setpoint) = window.get(place) {
                self.ahead.push(setpoint);
            }
        }
        window.truncate(kept);
        self.envelope = Envelope::new(quick_stop_s, kept, axes);
        self.is_active = true;
        true
    }

    /// The next setpoint behind those kept; `None` if the ring has run dry. `axes` are those that have drives.
    #[cold]
    pub(super) fn step(&mut self, ring: &mut Consumer<'_, Queued>, epoch: u8, axes: &[Axis]) -> Option<Setpoint> {
        if self.rate <= 0.0 {
            self.last.velocity_rad_s = [0.0; AXES];
            return Some(self.last);
        }
        self.ahead.fill(ring, epoch);
        let rate = self.next_rate(&self.cubic()?, axes);
        self.place += (self.rate + rate) / 2.0;
        self.rate = rate;
        if self.place >= 1.0 {
            self.ahead.advance();
            self.place -= 1.0;
        }
        let (cubic, setpoint) = (self.cubic()?, self.ahead.get(1)?);
        let position_rad = cubic.position_rad(self.place);
        let before_rad = self.last.position_rad;
        self.last = Setpoint {
            position_rad,
            velocity_rad_s: differences(&position_rad, &before_rad).map(|change_rad| change_rad / STEP_S),
            ..*setpoint
        };
        Some(self.last)
    }

    /// Judges a millisecond: `measured_rad_s` and `planned_rad_s` are the joints' velocities at the same moment, and
    /// `still_ms` is how long they have been at rest.
    #[cold]
    pub(super) fn watch(&mut self, measured_rad_s: &[f64], planned_rad_s: &[f64], still_ms: u16) -> Progress {
        let is_over = self.rate <= 0.0 && still_ms >= STILL_MS && self.envelope.passed_ms >= STILL_MS;
        match self.envelope.step(measured_rad_s, planned_rad_s) {
            Ok(is_time_over) if is_over || is_time_over => Progress::Stands,
            Ok(_) => Progress::Brakes,
            Err(failure) => Progress::Left(failure),
        }
    }

    fn cubic(&self) -> Option<Cubic<'_>> {
        let [first, second, third] = [self.ahead.get(0)?, self.ahead.get(1)?, self.ahead.get(NEEDED - 1)?];
        Some(Cubic { first, second, third })
    }

    /// The rate a millisecond later.
    fn next_rate(&self, cubic: &Cubic<'_>, axes: &[Axis]) -> f64 {
        let (mut allowed_per_s, mut needed_per_s) = (f64::NEG_INFINITY, 0.0);
        let mut longest_s = 0.0;
        for (axis, config) in axes.iter().enumerate().take(AXES) {
            let [velocity, acceleration] = cubic.motion(axis, self.place);
            let (speed, limit) = (velocity.abs(), config.quick_stop_rad_s2.abs());
            if speed <= NEGLIGIBLE_RAD_S {
                continue;
            }
            // Acceleration in the direction of the motion that the path itself demands.
            let own = acceleration * if velocity < 0.0 { -1.0 } else { 1.0 } * self.rate * self.rate;
            allowed_per_s = f64::max(allowed_per_s, (-limit - own) / speed);
            if speed / limit > longest_s {
                longest_s = speed / limit;
                needed_per_s = (-SHARE_MIN * limit - own) / speed;
            }
        }
        // What is left can be stopped within the millisecond.
        if longest_s * self.rate <= STEP_S {
            return 0.0;
        }
        let change_per_s = allowed_per_s.min(needed_per_s).min(0.0);
        (self.rate + change_per_s * STEP_S).max(0.0)
    }
}

/// How much each axis has moved from `before` to `now`, rad.
fn differences(now: &[f64; AXES], before: &[f64; AXES]) -> [f64; AXES] {
    let mut moved = *now;
    moved
        .iter_mut()
        .zip(before)
        .for_each(|(moved, before)| *moved -= before);
    moved
}

/// Time that a quick stop takes from these velocities, s; infinite if one of them is not a number.
fn quick_stop_s(velocities_rad_s: &[f64; AXES], axes: &[Axis]) -> f64 {
    let each = velocities_rad_s.iter().zip(axes);
    each.fold(0.0, |longest, (speed, axis)| {
        let own = speed.abs() / axis.quick_stop_rad_s2.abs();
        match own {
            own if own <= longest => longest,
            own if own.is_finite() => own,
            _ => f64::INFINITY,
        }
    })
}

/// The path between two setpoints of the ring, with the slopes of their neighbours' differences.
struct Cubic<'a> {
    first: &'a Setpoint,
    second: &'a Setpoint,
    third: &'a Setpoint,
}

impl Cubic<'_> {
    /// Velocities of an axis at both ends, rad/s: each setpoint's velocity is the difference over the millisecond before.
    fn ends_rad_s(&self, axis: usize) -> [f64; 2] {
        let of = |setpoint: &Setpoint| setpoint.velocity_rad_s.get(axis).copied().unwrap_or(0.0);
        let [first, second, third] = [of(self.first), of(self.second), of(self.third)];
        [(first + second) / 2.0, (second + third) / 2.0]
    }

    /// Velocity and acceleration of an axis at a place while time passes on the path as planned, rad/s and rad/s2.
    fn motion(&self, axis: usize, place: f64) -> [f64; 2] {
        let [begin, end] = self.ends_rad_s(axis);
        [begin + (end - begin) * place, (end - begin) / STEP_S]
    }

    /// Positions at a place, rad.
    fn position_rad(&self, place: f64) -> [f64; AXES] {
        let (left, place_2) = (1.0 - place, place * place);
        let mut positions_rad = self.first.position_rad;
        for (axis, (position_rad, to)) in positions_rad.iter_mut().zip(&self.second.position_rad).enumerate() {
            let [begin, end] = self.ends_rad_s(axis).map(|rad_s| rad_s * STEP_S);
            let from = *position_rad;
            *position_rad =
                from + (to - from) * place_2 * (3.0 - 2.0 * place) + begin * place * left * left - end * place_2 * left;
        }
        positions_rad
    }
}

/// How a stop on the path goes on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Progress {
    /// It brakes, within its envelope.
    Brakes,
    /// The joints stand.
    Stands,
    /// The envelope is left: a joint is too fast or too slow, or the time is over.
    Left(PathStopFailure),
}

/// Time for which all joints have to be at rest at the end, ms.
const STILL_MS: u16 = 10;
/// Least slope of a joint's ramp, as a part of the planned deceleration.
const SLOPE: f64 = 0.8;
/// Part of a joint's first speed by which it may be off its ramp.
const SPEED_SHARE: f64 = 0.05;
/// Time by which a joint may brake later or earlier than planned, s.
const LATER_S: f64 = 4.0e-3;
/// Steps of the encoder in a millisecond by which a measured speed may be wrong.
const STEPS: f64 = 2.0;
/// Longest stop as a part of the longest planned one, and its addition, ms.
const TIME_SHARE: f64 = 1.2;
const TIME_ADDED_MS: u16 = 10;
/// Speed with which the position controllers may still take the last error away when the time is over, rad/s.
const SETTLING_RAD_S: f64 = 0.1;
/// Milliseconds in a row in which a joint has to be off its ramp: a drive may report a position twice, and then two
/// milliseconds of motion at once.
const OFF_RAMP_MS: u8 = 3;

/// What a stop on the path may not leave.
///
/// A joint's velocity may differ from that planned for the moment of the measurement by what a ramp with [`SLOPE`] of the
/// planned deceleration, [`SPEED_SHARE`] of the joint's first speed, a delay of [`LATER_S`] and the encoder's steps make. A
/// joint that is slower than that has a false feedback, or it does not follow the path. The supervision watches the distance
/// to the path: it is the following error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Envelope {
    passed_ms: u16,
    longest_ms: u16,
    /// The joints' fastest speeds, rad/s.
    first_rad_s: [f64; AXES],
    /// What a delay and the encoders' steps add, rad/s.
    added_rad_s: [f64; AXES],
    /// Speeds up to which the joints count as standing when the time is over, rad/s; [`SPEED_SHARE`] of their first speeds
    /// comes on top.
    settling_rad_s: [f64; AXES],
    off_ramp_ms: u8,
}

impl Envelope {
    fn new(quick_stop_s: f64, kept: usize, axes: &[Axis]) -> Self {
        let planned_ms = quick_stop_s / STEP_S / SHARE_MIN + kept as f64;
        let (mut added_rad_s, mut settling_rad_s) = ([0.0; AXES], [0.0; AXES]);
        for ((added, settling), axis) in added_rad_s.iter_mut().zip(&mut settling_rad_s).zip(axes) {
            let steps_per_rad = axis.gear.abs() * f64::from(axis.increments_per_revolution) / TAU;
            let steps_rad_s = STEPS / steps_per_rad / STEP_S;
            *added = axis.quick_stop_rad_s2.abs() * LATER_S + steps_rad_s;
            *settling = SETTLING_RAD_S + steps_rad_s;
        }
        Self {
            longest_ms: (TIME_SHARE * planned_ms) as u16 + TIME_ADDED_MS,
            added_rad_s,
            settling_rad_s,
            ..Self::default()
        }
    }

    /// Advances by a millisecond; returns whether the time is over, with all joints as slow as their controllers that take
    /// the last error away.
    ///
    /// # Errors
    /// The part of the envelope that is left, with the joint that is farthest outside.
    fn step(&mut self, measured_rad_s: &[f64], planned_rad_s: &[f64]) -> Result<bool, PathStopFailure> {
        self.passed_ms = self.passed_ms.saturating_add(1);
        let mut worst = (1.0, 0, 0.0, 0.0);
        let mut is_near = true;
        let joints = measured_rad_s.iter().zip(planned_rad_s);
        let own = self.first_rad_s.iter_mut().zip(&self.added_rad_s);
        for (axis, ((measured, planned), (first, added))) in (0..).zip(joints.zip(own)) {
            *first = first.max(planned.abs());
            let most = (1.0 - SLOPE) * (*first - planned.abs()) + SPEED_SHARE * *first + added;
            let off = (measured - planned).abs() / most;
            if off > worst.0 || off.is_nan() {
                is_near = false;
                worst = (off, axis, *measured, *planned);
            }
        }
        self.off_ramp_ms = if is_near { 0 } else { self.off_ramp_ms.saturating_add(1) };
        let (_, axis, measured, planned) = worst;
        if self.off_ramp_ms >= OFF_RAMP_MS {
            return Err(PathStopFailure::Speed {
                axis,
                measured_rad_s: measured as f32,
                planned_rad_s: planned as f32,
            });
        }
        if self.passed_ms <= self.longest_ms {
            return Ok(false);
        }
        let mut joints = measured_rad_s
            .iter()
            .zip(self.settling_rad_s.iter().zip(&self.first_rad_s));
        match joints.all(|(measured, (settling, first))| measured.abs() <= settling + SPEED_SHARE * first) {
            true => Ok(true),
            false => Err(self.too_long(measured_rad_s)),
        }
    }

    /// Names the fastest joint of a stop that takes too long.
    fn too_long(&self, measured_rad_s: &[f64]) -> PathStopFailure {
        let joints = (0..).zip(measured_rad_s);
        let (axis, measured_rad_s) = joints.fold((0, 0.0_f64), |fastest, (axis, measured)| {
            let is_faster = measured.abs() > fastest.1.abs();
            if is_faster { (axis, *measured) } else { fastest }
        });
        PathStopFailure::Time {
            axis,
            measured_rad_s: measured_rad_s as f32,
            passed_ms: self.passed_ms,
        }
    }
}

/// Longest stop on the path, ms, with what was kept of the window.
pub const PATH_STOP_MAX_MS: u32 =
    (TIME_SHARE * (QUICK_STOP_MAX_S / STEP_S / SHARE_MIN + super::window::LOOK_AHEAD as f64)) as u32
        + TIME_ADDED_MS as u32;

#[cfg(test)]
mod tests;
