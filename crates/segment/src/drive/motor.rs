//! A servo motor under its velocity loop.
//!
//! One step is one millisecond. A first-order velocity loop moves the motor by itself: its differential equation is
//! solved in closed form, so the result has no numerical integration error. Under a PI velocity loop the motor only has
//! a torque, and its load moves it. Angles are the motor's, in radians.

use super::velocity_loop::Regulator;

/// Length of a step, seconds.
pub use super::velocity_loop::STEP_S;

/// Highest speed of the motor under any load, limited by its voltage.
const SPEED_MAX_RAD_S: f64 = 700.0;

/// Action on the motor during one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Action {
    /// The velocity loop follows this speed, rad/s.
    Speed(f64),
    /// The drive lets the speed fall to zero with this deceleration, rad/s2.
    Ramp(f64),
    /// The closed brake lets the speed fall to zero with this deceleration, rad/s2.
    Brake(f64),
    /// The current loop applies this torque at the motor, N m; the load determines the motion.
    Torque(f64),
}

/// Angle and speed of one motor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motor {
    angle_rad: f64,
    speed_rad_s: f64,
    bandwidth_rad_s: f64,
    torque_nm: f64,
    /// Speed reduction of the velocity loop by dry friction before its integral compensates it, rad/s.
    friction_rad_s: f64,
    made_up_rad_s: f64,
    /// PI velocity loop; `None` for a first-order lag.
    regulator: Option<Regulator>,
    /// Speed that the PI velocity loop follows; `None` while it does not act.
    target_rad_s: Option<f64>,
    /// Whether that speed is on a ramp to zero.
    ramping: bool,
}

/// Speed below which a drive counts as standing still at the end of a ramp, rad/s: 5 revolutions per minute.
const STANDSTILL_RAD_S: f64 = 0.52;
/// Time constant in which the velocity loop's integral compensates friction, s.
const INTEGRAL_S: f64 = 0.02;
/// Speed at which dry friction has mostly built up, rad/s at the motor.
const FRICTION_SPEED_RAD_S: f64 = 0.2;

impl Motor {
    /// A motor at rest. The bandwidth of the loop is in hertz; a value below 0.1 counts as 0.1.
    pub(crate) fn new(angle_rad: f64, bandwidth_hz: f64) -> Self {
        let bandwidth_hz = if bandwidth_hz > 0.1 { bandwidth_hz } else { 0.1 };
        Self {
            angle_rad,
            speed_rad_s: 0.0,
            bandwidth_rad_s: core::f64::consts::TAU * bandwidth_hz,
            torque_nm: 0.0,
            friction_rad_s: 0.0,
            made_up_rad_s: 0.0,
            regulator: None,
            target_rad_s: None,
            ramping: false,
        }
    }

    /// This motor with a PI velocity loop, or without one.
    pub(crate) fn with_regulator(self, regulator: Option<Regulator>) -> Self {
        Self { regulator, ..self }
    }

    /// This motor with dry friction that slows its loop down by `friction_rad_s`.
    pub(crate) fn with_friction(self, friction_rad_s: f64) -> Self {
        Self { friction_rad_s, ..self }
    }

    /// Angle, radians.
    #[inline]
    pub(crate) fn angle_rad(&self) -> f64 {
        self.angle_rad
    }

    /// Speed, rad/s.
    #[inline]
    pub(crate) fn speed_rad_s(&self) -> f64 {
        self.speed_rad_s
    }

    /// Torque of the current loop, N m at the motor; 0 while the drive moves the motor by itself.
    #[inline]
    pub(crate) fn torque_nm(&self) -> f64 {
        self.torque_nm
    }

    /// Whether the motor is at rest, after a ramp of its drive.
    pub(crate) fn is_still(&self) -> bool {
        match self.target_rad_s {
            Some(target_rad_s) => target_rad_s == 0.0 && self.speed_rad_s.abs() < STANDSTILL_RAD_S,
            None => self.speed_rad_s == 0.0,
        }
    }

    /// Whether a PI velocity loop acts.
    pub(crate) fn is_regulated(&self) -> bool {
        self.target_rad_s.is_some()
    }

    /// Advances the PI velocity loop, if it acts, by one of its steps; `measured_rad_s` is the speed that it sees.
    pub(crate) fn regulate(&mut self, measured_rad_s: f64) {
        if let (Some(regulator), Some(target_rad_s)) = (&mut self.regulator, self.target_rad_s) {
            self.torque_nm = regulator.step(target_rad_s, measured_rad_s);
        }
    }

    /// Moves the motor for one millisecond.
    pub(crate) fn step(&mut self, action: Action) {
        if self.regulator.is_some() && self.set_target(action) {
            return;
        }
        self.torque_nm = 0.0;
        match action {
            Action::Torque(torque_nm) => self.torque_nm = torque_nm,
            Action::Speed(target_rad_s) => self.follow(target_rad_s),
            Action::Ramp(deceleration_rad_s2) | Action::Brake(deceleration_rad_s2) => {
                self.slow_down(deceleration_rad_s2);
            }
        }
    }

    /// Sets the target of the PI velocity loop; returns whether the loop acts.
    fn set_target(&mut self, action: Action) -> bool {
        let target_rad_s = match action {
            Action::Speed(target_rad_s) => Some(target_rad_s),
            Action::Ramp(deceleration_rad_s2) => {
                let change_rad_s = deceleration_rad_s2.max(1e-3) * STEP_S;
                // A ramp begins at the present speed.
                let from_rad_s = self.target_rad_s.filter(|_| self.ramping).unwrap_or(self.speed_rad_s);
                Some(from_rad_s.signum() * (from_rad_s.abs() - change_rad_s).max(0.0))
            }
            Action::Brake(_) | Action::Torque(_) => None,
        };
        if let (Some(regulator), None, Some(_)) = (&mut self.regulator, self.target_rad_s, target_rad_s) {
            regulator.start(self.speed_rad_s);
        }
        self.ramping = matches!(action, Action::Ramp(_));
        self.target_rad_s = target_rad_s;
        target_rad_s.is_some()
    }

    /// Moves the motor with this acceleration, rad/s2, for a duration.
    pub(crate) fn accelerate(&mut self, rad_s2: f64, duration_s: f64) {
        let change_rad_s = rad_s2 * duration_s;
        self.angle_rad += (self.speed_rad_s + 0.5 * change_rad_s) * duration_s;
        self.speed_rad_s = (self.speed_rad_s + change_rad_s).clamp(-SPEED_MAX_RAD_S, SPEED_MAX_RAD_S);
    }

    /// Turns the motor at this speed, rad/s, for a duration.
    pub(crate) fn turn(&mut self, rad_s: f64, duration_s: f64) {
        let rad_s = if rad_s.is_finite() { rad_s } else { 0.0 };
        self.speed_rad_s = rad_s.clamp(-SPEED_MAX_RAD_S, SPEED_MAX_RAD_S);
        self.angle_rad += self.speed_rad_s * duration_s;
    }

    /// Stops the motor at once at this angle: a mechanical end stop.
    pub(crate) fn block_at(&mut self, angle_rad: f64) {
        self.angle_rad = angle_rad;
        self.speed_rad_s = 0.0;
    }

    fn follow(&mut self, target_rad_s: f64) {
        let friction_rad_s = self.friction_rad_s * (self.speed_rad_s / FRICTION_SPEED_RAD_S).tanh();
        self.made_up_rad_s += (friction_rad_s - self.made_up_rad_s) * STEP_S / INTEGRAL_S;
        let target_rad_s = target_rad_s - friction_rad_s + self.made_up_rad_s;
        let error_rad_s = self.speed_rad_s - target_rad_s;
        let decay = (-self.bandwidth_rad_s * STEP_S).exp();
        self.angle_rad += target_rad_s * STEP_S + error_rad_s * (1.0 - decay) / self.bandwidth_rad_s;
        self.speed_rad_s = target_rad_s + error_rad_s * decay;
    }

    fn slow_down(&mut self, deceleration_rad_s2: f64) {
        let deceleration_rad_s2 = deceleration_rad_s2.max(1e-3);
        let moving_s = (self.speed_rad_s.abs() / deceleration_rad_s2).min(STEP_S);
        let change_rad_s = deceleration_rad_s2 * moving_s * self.speed_rad_s.signum();
        self.angle_rad += (self.speed_rad_s - 0.5 * change_rad_s) * moving_s;
        self.speed_rad_s = if moving_s < STEP_S {
            0.0
        } else {
            self.speed_rad_s - change_rad_s
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_response_has_the_given_bandwidth() {
        for bandwidth_hz in [20.0, 50.0, 100.0, 200.0] {
            let mut motor = Motor::new(0.0, bandwidth_hz);
            for step in 1..=40 {
                motor.step(Action::Speed(10.0));
                let time_s = f64::from(step) * STEP_S;
                let rate = core::f64::consts::TAU * bandwidth_hz;
                let speed = 10.0 * (1.0 - (-rate * time_s).exp());
                let angle = 10.0 * (time_s - (1.0 - (-rate * time_s).exp()) / rate);
                assert!(
                    (motor.speed_rad_s() - speed).abs() < 1e-9,
                    "{bandwidth_hz} Hz, step {step}"
                );
                assert!(
                    (motor.angle_rad() - angle).abs() < 1e-9,
                    "{bandwidth_hz} Hz, step {step}"
                );
            }
        }
    }

    #[test]
    fn a_ramp_stops_inside_a_millisecond_after_the_right_way() {
        let mut motor = Motor::new(0.0, 1e6);
        motor.step(Action::Speed(-100.0));
        let (start, speed) = (motor.angle_rad(), motor.speed_rad_s());
        let mut steps = 0;
        while !motor.is_still() && steps < 1000 {
            motor.step(Action::Ramp(3_000.0));
            steps += 1;
        }
        assert_eq!(steps, 34);
        let way = speed * speed.abs() / (2.0 * 3_000.0);
        assert!((motor.angle_rad() - start - way).abs() < 1e-9);
    }
}
