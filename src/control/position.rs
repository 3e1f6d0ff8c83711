//! The position controller: v = Kfb (x_ref(t - age) - x) + Kff v_ff(t + lead).
//!
//! A measurement is older than the moment it is used, and a command takes effect later than the moment it is computed.
//! The controller compares the measurement with the setpoint of the same age, and feeds forward the velocity setpoint
//! of the moment at which the drive will follow. Fractions of a millisecond are interpolated between neighbouring
//! setpoints. `etherpen identify` finds gains and delays.
//!
//! Invariant: the command is the output of the control law, neither clamped nor filtered, so that the supervision sees
//! a demand beyond the limit or a NaN. `control::robot_axes` clamps the value sent to a drive, and sends 0 instead of a
//! NaN.

use crate::config::Axis;

/// Greatest age of a measurement, ms; the bound of `axes.measurement_age_ms`.
pub const AGE_MAX_MS: usize = 10;
/// Greatest lead of the feed-forward, ms; the bound of `axes.feed_forward_lead_ms`.
pub const LEAD_MAX_MS: usize = 11;
/// Time from the centre of a velocity setpoint to its time stamp, ms: it is the difference over the millisecond that
/// ends there.
const DIFFERENCE_CENTRE_MS: f64 = 0.5;
/// Cycles in a second.
const CYCLES_PER_S: f64 = 1_000.0;
/// Setpoints kept: the present one, the oldest whole age, one more to interpolate to, and the one before it; a power of
/// two, so that an index is wrapped by a mask.
const HISTORY: usize = (AGE_MAX_MS + 3).next_power_of_two();
/// Upcoming setpoints that [`PositionController::step`] looks at, counted from the present one.
pub const SETPOINTS_AHEAD: usize = LEAD_MAX_MS + 3;

/// Error that a drive in position mode may leave standing, rad at the joint: friction and its encoder's steps.
const STANDING_ERROR_RAD: f64 = 2.0e-5;
/// How far the delays of a drive in position mode may be other than configured, s: late telegrams, its own clock.
const DELAY_DOUBT_S: f64 = 1.0e-3;

/// The part of a position error that a drive in position mode is expected to remove at this velocity, rad at the joint.
pub(super) fn error_removed_rad(error_rad: f64, velocity_rad_s: f64) -> f64 {
    let left_rad = STANDING_ERROR_RAD + DELAY_DOUBT_S * velocity_rad_s.abs();
    error_rad - error_rad.max(-left_rad).min(left_rad)
}

/// Position controller of one axis, stepped once a millisecond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionController {
    feedback_gain_per_s: f64,
    feed_forward_gain: f64,
    lead: Place,
    position_lead: Place,
    age: Place,
    history: [f64; HISTORY],
    newest: usize,
    filled: bool,
    setpoint_at_age_rad: f64,
}

impl PositionController {
    /// Controller with the gains and delays of an axis.
    pub fn new(axis: &Axis) -> Self {
        let within = |value: f64, limit: usize| if value > 0.0 { value.min(limit as f64) } else { 0.0 };
        Self {
            feedback_gain_per_s: axis.feedback_gain_per_s,
            feed_forward_gain: axis.feed_forward_gain,
            lead: Place::new(within(axis.feed_forward_lead_ms, LEAD_MAX_MS) + DIFFERENCE_CENTRE_MS),
            position_lead: Place::new(within(axis.position_lead_ms, LEAD_MAX_MS)),
            age: Place::new(within(axis.measurement_age_ms, AGE_MAX_MS)),
            history: [0.0; HISTORY],
            newest: 0,
            filled: false,
            setpoint_at_age_rad: 0.0,
        }
    }

    /// Discards the setpoints: the next one counts as having been constant before. Used when the axis is enabled.
    pub fn reset(&mut self) {
        self.filled = false;
    }

    /// Advances by one millisecond.
    ///
    /// `setpoint_rad` is the position setpoint of this millisecond, `measured_rad` the latest measurement. `ahead`
    /// gives the velocity setpoints from this millisecond on; after its end its last value is used.
    ///
    /// Returns the velocity command, rad/s at the joint, unclamped; not finite when an input is not.
    pub fn step(&mut self, setpoint_rad: f64, measured_rad: f64, ahead: impl IntoIterator<Item = f64>) -> f64 {
        let forward_rad_s = interpolate(ahead, self.lead);
        self.step_with(setpoint_rad, measured_rad, forward_rad_s)
    }

    /// Advances like [`Self::step`], with the velocity setpoint at [`Self::lead`].
    #[inline]
    pub(super) fn step_with(&mut self, setpoint_rad: f64, measured_rad: f64, forward_rad_s: f64) -> f64 {
        self.remember(setpoint_rad);
        let error = self.setpoint_at_age_rad - measured_rad;
        self.feedback_gain_per_s * error + self.feed_forward_gain * forward_rad_s
    }

    /// Place among the velocity setpoints from this millisecond on at which the feed-forward is read.
    #[inline]
    pub(super) fn lead(&self) -> Place {
        self.lead
    }

    /// Place among the position setpoints from this millisecond on whose value is the target of a drive in position mode.
    pub(super) fn position_lead(&self) -> Place {
        self.position_lead
    }

    /// Advances by one millisecond, for an axis whose drive takes a position; `forward_rad_s` is the velocity setpoint at
    /// [`Self::lead`].
    ///
    /// Returns the velocity by which the drive's position loop is expected to correct the error, and the velocity to add to
    /// it, rad/s at the joint.
    pub(super) fn step_for_position(&mut self, setpoint_rad: f64, measured_rad: f64, forward_rad_s: f64) -> [f64; 2] {
        self.remember(setpoint_rad);
        let error_rad = error_removed_rad(self.setpoint_at_age_rad - measured_rad, forward_rad_s);
        [
            self.feedback_gain_per_s * error_rad,
            self.feed_forward_gain * forward_rad_s,
        ]
    }

    /// Advances an axis whose velocity loop is closed by the firmware by one millisecond.
    ///
    /// Returns the velocity to compare with the measured one, rad/s at the joint. Its feed-forward is the difference of
    /// the setpoint over the millisecond over which the latest measurements were differenced.
    pub fn step_for_torque(&mut self, setpoint_rad: f64, measured_rad: f64) -> f64 {
        self.remember(setpoint_rad);
        let setpoint_rad = self.setpoint_at_age_rad;
        let forward = (setpoint_rad - self.setpoint_back(1)) * CYCLES_PER_S;
        self.feedback_gain_per_s * (setpoint_rad - measured_rad) + self.feed_forward_gain * forward
    }

    /// The setpoint to which the latest measurement is compared, rad.
    pub fn setpoint_at_age(&self) -> f64 {
        self.setpoint_at_age_rad
    }

    /// Velocity of the setpoint to which the latest measurement is compared, rad/s: the difference over the millisecond
    /// that ends there.
    pub(super) fn velocity_at_age(&self) -> f64 {
        (self.setpoint_at_age_rad - self.setpoint_back(1)) * CYCLES_PER_S
    }

    /// The setpoint this many whole milliseconds before the latest measurement, rad.
    fn setpoint_back(&self, before_ms: usize) -> f64 {
        let back = self.newest.wrapping_sub(self.age.whole + before_ms);
        let (low, high) = (
            self.history[back % HISTORY],
            self.history[back.wrapping_sub(1) % HISTORY],
        );
        self.age.between(low, high)
    }

    #[inline]
    fn remember(&mut self, setpoint_rad: f64) {
        if !self.filled {
            self.history = [setpoint_rad; HISTORY];
            self.filled = true;
        }
        self.newest = (self.newest + 1) % HISTORY;
        self.history[self.newest % HISTORY] = setpoint_rad;
        self.setpoint_at_age_rad = self.setpoint_back(0);
    }
}

/// A place in a sequence with one value a millisecond, from 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// Index of the value before the place.
    pub(super) whole: usize,
    /// Fraction of the distance to the next value, 0 to 1.
    part: f64,
}

impl Place {
    /// A place, ms from the beginning of the sequence.
    pub(super) fn new(place_ms: f64) -> Self {
        let whole = place_ms as usize;
        Self {
            whole,
            part: place_ms - whole as f64,
        }
    }

    /// The interpolated value, for `low` before the place and `high` after it.
    #[inline]
    pub(super) fn between(self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.part
    }
}

/// The value at `place` of a sequence; after the end the last value is used.
pub(super) fn interpolate(values: impl IntoIterator<Item = f64>, place: Place) -> f64 {
    let mut values = values.into_iter();
    let mut low = 0.0;
    for _ in 0..=place.whole {
        match values.next() {
            Some(value) => low = value,
            None => return low,
        }
    }
    let high = values.next().unwrap_or(low);
    place.between(low, high)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(age_ms: f64, lead_ms: f64) -> Axis {
        Axis {
            measurement_age_ms: age_ms,
            feed_forward_lead_ms: lead_ms,
            ..Axis::default()
        }
    }

    #[test]
    fn a_measurement_is_compared_with_the_setpoint_of_its_age() {
        let mut controller = PositionController::new(&axis(2.25, 0.0));
        for ms in 0..40 {
            let setpoint = 0.01 * f64::from(ms);
            let command = controller.step(setpoint, setpoint - 0.0225, [0.0; 2]);
            assert!(ms < 4 || command.abs() < 1.0e-9, "{command} at {ms} ms");
        }
    }

    #[test]
    fn the_feed_forward_is_the_velocity_at_the_lead() {
        let mut controller = PositionController::new(&axis(1.0, 3.1));
        let velocity_at = |t_ms: f64| 2.0 + 0.1 * t_ms;
        let ahead = (0..20).map(|ms| velocity_at(f64::from(ms) - 0.5));
        let command = controller.step(1.0, 1.0, ahead);
        assert!((command - velocity_at(3.1)).abs() < 1.0e-12);
    }

    #[test]
    fn setpoints_that_end_early_repeat_the_last_one() {
        let mut controller = PositionController::new(&axis(1.0, 3.1));
        assert_eq!(controller.step(1.0, 1.0, [0.5, 0.25]), 0.25);
        assert_eq!(controller.step(1.0, 1.0, []), 0.0);
    }

    #[test]
    fn the_command_is_not_clamped_so_that_the_supervision_sees_what_was_asked_for() {
        let mut controller = PositionController::new(&axis(1.0, 3.1));
        assert_eq!(controller.step(10.0, 0.0, [0.0]), 800.0);
        assert!(controller.step(0.0, f64::NAN, [0.0]).is_nan());
    }

    #[test]
    fn the_velocity_of_a_torque_axis_is_differenced_where_the_measurement_is() {
        for age_ms in [0.0, 1.0, 2.25, 10.0] {
            let mut controller = PositionController::new(&axis(age_ms, 3.1));
            for ms in 0..40 {
                let position = |ms: f64| 1.0e-4 * ms * ms;
                let measured = position(f64::from(ms) - age_ms);
                let wanted = controller.step_for_torque(position(ms.into()), measured);
                let expected = (measured - position(f64::from(ms) - age_ms - 1.0)) * CYCLES_PER_S;
                // Between two setpoints the parabola is a chord.
                assert!(
                    ms < 14 || (wanted - expected).abs() < 0.005,
                    "{wanted} at {ms} ms, age {age_ms} ms"
                );
            }
        }
    }

    #[test]
    fn enabling_forgets_old_setpoints() {
        let mut controller = PositionController::new(&axis(5.0, 0.0));
        controller.step(3.0, 3.0, [0.0]);
        controller.reset();
        assert_eq!(controller.step(1.0, 1.0, [0.0]), 0.0);
    }

    const _: () = assert!(SETPOINTS_AHEAD > LEAD_MAX_MS + 1 && HISTORY > AGE_MAX_MS + 2);
}
