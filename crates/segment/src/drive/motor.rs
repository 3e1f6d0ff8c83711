//! A servo motor under a first-order velocity loop, moved exactly.
//!
//! One step is one millisecond. The loop's differential equation is solved in closed form, so the result has no
//! numerical integration error. Angles are the motor's, in radians.

/// Length of a step, seconds.
pub const STEP_S: f64 = 1e-3;

/// Highest speed of the motor under any load, limited by its voltage.
const SPEED_MAX_RAD_S: f64 = 700.0;

/// Action on the motor during one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Action {
    /// The velocity loop follows this speed, rad/s.
    Speed(f64),
    /// The speed falls to zero with this deceleration, rad/s2.
    Ramp(f64),
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
}

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
        }
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

    /// Torque of the current loop, N m at the motor; 0 outside torque mode.
    #[inline]
    pub(crate) fn torque_nm(&self) -> f64 {
        self.torque_nm
    }

    /// Whether the motor is at rest.
    pub(crate) fn is_still(&self) -> bool {
        self.speed_rad_s == 0.0
    }

    /// Moves the motor for one millisecond.
    pub(crate) fn step(&mut self, action: Action) {
        self.torque_nm = 0.0;
        match action {
            Action::Torque(torque_nm) => self.torque_nm = torque_nm,
            Action::Speed(target_rad_s) => self.follow(target_rad_s),
            Action::Ramp(deceleration_rad_s2) => self.slow_down(deceleration_rad_s2),
        }
    }

    /// Moves the motor with this acceleration, rad/s2, for a duration.
    pub(crate) fn accelerate(&mut self, rad_s2: f64, duration_s: f64) {
        let change_rad_s = rad_s2 * duration_s;
        self.angle_rad += (self.speed_rad_s + 0.5 * change_rad_s) * duration_s;
        self.speed_rad_s = (self.speed_rad_s + change_rad_s).clamp(-SPEED_MAX_RAD_S, SPEED_MAX_RAD_S);
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
