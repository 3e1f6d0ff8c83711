//! The velocity controller of an axis whose drive takes a torque: PI with feed-forward and anti-windup.
//!
//! torque = K (e + Ti^-1 integral of e) + J a_ref(t + lead), with the velocity error e behind a first-order low-pass.
//! The outer position controller gives the wanted velocity. Wanted and measured velocity are differences over the same
//! millisecond, so that the filter delays both alike. The integral is held while the torque is at its limit and the
//! error would drive it further (conditional integration; Åström and Hägglund, *Advanced PID Control*, 3.5).
//!
//! Invariant: the torque is finite and within plus and minus the axis's limit; a non-finite value gives 0.

use super::position::{Place, interpolate};
use crate::config::Axis;
use crate::control::limit::limited;

/// Length of a step, ms and s.
const STEP_MS: f64 = 1.0;
const STEP_S: f64 = 1.0e-3;

/// Velocity controller of one axis, called once a millisecond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VelocityController {
    gain_nm_s: f64,
    integral_per_s: f64,
    inertia_kg_m2: f64,
    lead: Place,
    /// Weight of a new error in the filtered error, 0 to 1.
    filter: f64,
    limit_nm: f64,
    error_rad_s: f64,
    integral_nm: f64,
}

impl VelocityController {
    /// Controller with the gains and limits of an axis.
    pub fn new(axis: &Axis) -> Self {
        let filter_ms = axis.velocity_filter_ms.max(0.0);
        Self {
            gain_nm_s: axis.velocity_gain_nm_s,
            integral_per_s: axis.velocity_integral_per_s,
            inertia_kg_m2: axis.inertia_kg_m2,
            lead: Place::new(axis.torque_lead_ms.clamp(0.0, super::position::LEAD_MAX_MS as f64)),
            filter: 1.0 - libm::exp(-STEP_MS / filter_ms),
            limit_nm: axis.torque_max_nm.abs(),
            error_rad_s: 0.0,
            integral_nm: 0.0,
        }
    }

    /// Place among the velocity setpoints from this millisecond on at which the torque feed-forward is read.
    pub(super) fn lead(&self) -> Place {
        self.lead
    }

    /// Resets the error and the integral. Used while the drive takes no torque.
    pub fn reset(&mut self) {
        self.error_rad_s = 0.0;
        self.integral_nm = 0.0;
    }

    /// Advances by one millisecond; returns the torque command, N m at the joint.
    ///
    /// `wanted_rad_s` and `measured_rad_s` are velocities at the joint. `ahead` gives the velocity setpoints from this
    /// millisecond on, each the difference over the millisecond that ends there. Their differences are the acceleration
    /// for the torque feed-forward, which is 0 without setpoints.
    pub fn step(&mut self, wanted_rad_s: f64, measured_rad_s: f64, mut ahead: impl Iterator<Item = f64>) -> f64 {
        let error_rad_s = wanted_rad_s - measured_rad_s;
        self.error_rad_s += self.filter * (error_rad_s - self.error_rad_s);
        let mut before = ahead.next().unwrap_or(0.0);
        let accelerations = ahead.map(|velocity| (velocity - core::mem::replace(&mut before, velocity)) / STEP_S);
        let forward_nm = self.inertia_kg_m2 * interpolate(accelerations, self.lead);
        let proportional_nm = self.gain_nm_s * self.error_rad_s;
        let integral_nm = self.integral_nm + proportional_nm * self.integral_per_s * STEP_S;
        let wanted_nm = forward_nm + proportional_nm + integral_nm;
        if !wanted_nm.is_finite() {
            self.reset();
            return 0.0;
        }
        let torque_nm = limited(wanted_nm, self.limit_nm);
        let winds_up = (wanted_nm - torque_nm) * proportional_nm > 0.0;
        if !winds_up {
            self.integral_nm = limited(integral_nm, self.limit_nm);
        }
        torque_nm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::position::PositionController;
    use std::collections::VecDeque;

    /// An axis in torque mode: inertia, load torque, and a millisecond from command to motor and from motor to
    /// position.
    struct Plant {
        inertia_kg_m2: f64,
        load_nm: f64,
        angle_rad: f64,
        speed_rad_s: f64,
        commands: VecDeque<f64>,
        positions: VecDeque<f64>,
    }

    impl Plant {
        fn new(inertia_kg_m2: f64, load_nm: f64) -> Self {
            Self {
                inertia_kg_m2,
                load_nm,
                angle_rad: 0.0,
                speed_rad_s: 0.0,
                commands: VecDeque::from([0.0]),
                positions: VecDeque::from([0.0, 0.0]),
            }
        }

        /// Advances by one millisecond, in which the motor obeys the previous command.
        fn step(&mut self, torque_nm: f64) -> f64 {
            self.commands.push_back(torque_nm);
            let torque_nm = self.commands.pop_front().unwrap() + self.load_nm;
            let change_rad_s = torque_nm / self.inertia_kg_m2 * STEP_S;
            self.angle_rad += (self.speed_rad_s + 0.5 * change_rad_s) * STEP_S;
            self.speed_rad_s += change_rad_s;
            self.positions.push_back(self.angle_rad);
            self.positions.pop_front().unwrap()
        }
    }

    fn axis() -> Axis {
        Axis {
            feedback_gain_per_s: 40.0,
            ..Axis::default()
        }
    }

    /// Position and velocity loop around a plant on a smooth path; largest following error after the first 100 ms, rad.
    fn worst_error_rad(axis: &Axis, plant: &mut Plant, position: impl Fn(f64) -> f64) -> f64 {
        let (mut outer, mut inner) = (PositionController::new(axis), VelocityController::new(axis));
        let (mut measured_rad, mut worst_rad) = (0.0, 0.0_f64);
        for ms in 0..2_000 {
            let setpoint = |ahead: f64| position(f64::from(ms) + ahead);
            let before_rad = measured_rad;
            measured_rad = plant.positions[0];
            let wanted_rad_s = outer.step_for_torque(setpoint(0.0), measured_rad);
            let ahead = (0..12).map(|k| (setpoint(k.into()) - setpoint(f64::from(k) - 1.0)) / STEP_S);
            let torque_nm = inner.step(wanted_rad_s, (measured_rad - before_rad) / STEP_S, ahead);
            plant.step(torque_nm);
            if ms > 100 {
                worst_rad = worst_rad.max((outer.setpoint_at_age() - measured_rad).abs());
            }
        }
        worst_rad
    }

    /// 0.3 rad back and forth twice a second, from rest: up to 3.8 rad/s and 47 rad/s2.
    fn swing(ms: f64) -> f64 {
        0.3 * (1.0 - libm::cos(core::f64::consts::TAU * 2.0 * ms.max(0.0) / 1_000.0))
    }

    #[test]
    fn a_path_is_followed_closely_with_the_right_and_with_a_wrong_inertia() {
        for (scale, limit_rad) in [(1.0, 0.001), (0.7, 0.02), (1.4, 0.02)] {
            let mut plant = Plant::new(scale * axis().inertia_kg_m2, 0.0);
            let worst_rad = worst_error_rad(&axis(), &mut plant, swing);
            std::println!("inertia {scale}: following error {worst_rad:.6} rad");
            assert!(worst_rad < limit_rad, "{worst_rad} rad with {scale} times the inertia");
        }
    }

    #[test]
    fn a_load_is_held_by_the_integral() {
        let mut plant = Plant::new(axis().inertia_kg_m2, -10.0);
        worst_error_rad(&axis(), &mut plant, |_| 0.0);
        assert!(
            plant.angle_rad.abs() < 1.0e-4,
            "{} rad after two seconds",
            plant.angle_rad
        );
        assert!(plant.speed_rad_s.abs() < 1.0e-3);
    }

    #[test]
    fn the_torque_stays_within_its_limit_and_the_integral_does_not_wind_up() {
        let mut controller = VelocityController::new(&axis());
        let none = core::iter::empty::<f64>;
        for _ in 0..1_000 {
            assert_eq!(controller.step(20.0, 0.0, none()), axis().torque_max_nm);
        }
        // Where the integral had wound up, the torque would stay at its limit.
        for _ in 0..10 {
            controller.step(0.0, 0.0, none());
        }
        let torque_nm = controller.step(0.0, 0.0, none());
        assert!(torque_nm.abs() < 0.1 * axis().torque_max_nm, "{torque_nm}");
    }

    #[test]
    fn the_feed_forward_is_the_acceleration_at_the_lead() {
        let mut controller = VelocityController::new(&Axis {
            velocity_gain_nm_s: 0.0,
            ..axis()
        });
        // 1 rad/s2 for two milliseconds, then 3: at 1.5 ms it is 2.
        let ahead = [0.0, 0.001, 0.002, 0.005, 0.008];
        let torque_nm = controller.step(0.0, 0.0, ahead.into_iter());
        assert!((torque_nm - 2.0 * axis().inertia_kg_m2).abs() < 1.0e-9, "{torque_nm}");
    }

    #[test]
    fn what_is_not_a_number_gives_no_torque_and_is_forgotten() {
        let mut controller = VelocityController::new(&axis());
        let none = core::iter::empty::<f64>;
        assert_eq!(controller.step(f64::NAN, 0.0, none()), 0.0);
        assert_eq!(controller.step(1.0, f64::INFINITY, none()), 0.0);
        assert!(controller.step(1.0, 0.0, none()) > 0.0);
    }

    #[test]
    fn the_integral_stays_within_the_limit_while_the_feed_forward_works_against_it() {
        let axis = axis();
        let mut controller = VelocityController::new(&axis);
        // The setpoint brakes all the time, and the axis is always too slow.
        let braking = || (0..12).map(|ms| -400.0 * f64::from(ms) * STEP_S);
        for _ in 0..20_000 {
            let torque_nm = controller.step(1.0, 0.0, braking());
            assert!(torque_nm.abs() <= axis.torque_max_nm);
        }
        assert!(
            controller.integral_nm <= axis.torque_max_nm,
            "{}",
            controller.integral_nm
        );
        assert!(
            controller.integral_nm > 0.9 * axis.torque_max_nm,
            "{}",
            controller.integral_nm
        );
    }
}
