//! The velocity loop of a drive: how a motor follows its velocity demand.
//!
//! [`VelocityLoop::Lag`] moves the motor by itself, whatever its load. [`VelocityLoop::Pi`] makes a torque, and the load
//! decides how the motor moves: PI controller, current loop and filter of the measured speed run [`LOOP_STEPS`] times a
//! millisecond.
//!
//! Invariant: the torque is finite and within the drive's peak torque, whatever the options and speeds.

use crate::oscillator::{Oscillator, within};
use core::f64::consts::{FRAC_1_SQRT_2, TAU};

/// Length of a step of a motor, s.
pub const STEP_S: f64 = 1e-3;
/// Steps of a PI velocity loop in a millisecond.
pub const LOOP_STEPS: u32 = 8;
/// Length of a step of a PI velocity loop, s.
pub const LOOP_STEP_S: f64 = STEP_S / LOOP_STEPS as f64;

/// How a drive follows its velocity demand.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum VelocityLoop {
    /// First-order lag of [`DriveOptions::bandwidth_hz`](crate::DriveOptions::bandwidth_hz), whatever the load.
    #[default]
    Lag,
    /// PI controller whose torque moves the load.
    Pi(PiLoop),
}

/// A PI velocity loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PiLoop {
    /// Crossover of the open loop with the inertia below, without current loop and filter, Hz; 0.1 to 1000.
    pub bandwidth_hz: f64,
    /// Integral time, ms; at least 0.1.
    pub integral_ms: f64,
    /// Inertia at the motor for which the gains are set, kg m2; at least 1e-7.
    pub inertia_kg_m2: f64,
    /// Bandwidth of the current loop, a first-order lag, Hz; at least 1.
    pub current_hz: f64,
    /// Corner frequency of the second-order filter (Butterworth) of the measured speed, Hz; at least 1.
    pub speed_filter_hz: f64,
}

/// A PI velocity loop at work.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Regulator {
    proportional_nm_s: f64,
    /// Share of the proportional gain by which the integral grows in one step.
    integral_share: f64,
    current_share: f64,
    filter: Oscillator,
    torque_max_nm: f64,
    /// Filtered speed, rad/s, and its rate.
    filtered: [f64; 2],
    integral_nm: f64,
    torque_nm: f64,
}

impl Regulator {
    /// A loop at rest whose torque is at most `torque_max_nm`.
    pub(crate) fn new(options: &PiLoop, torque_max_nm: f64) -> Self {
        let rate = TAU * within(options.bandwidth_hz, 0.1, 1000.0);
        let integral_s = within(options.integral_ms, 0.1, 1e6) / 1000.0;
        let inertia_kg_m2 = within(options.inertia_kg_m2, 1e-7, 1e3);
        // |Kp (1 + 1 / (Ti s)) / (J s)| = 1 at the crossover.
        let corner = (rate * integral_s).recip();
        Self {
            proportional_nm_s: inertia_kg_m2 * rate / (1.0 + corner * corner).sqrt(),
            integral_share: LOOP_STEP_S / integral_s,
            current_share: 1.0 - (-TAU * within(options.current_hz, 1.0, 1e6) * LOOP_STEP_S).exp(),
            filter: Oscillator::new(within(options.speed_filter_hz, 1.0, 1e6), FRAC_1_SQRT_2, LOOP_STEP_S),
            torque_max_nm,
            filtered: [0.0; 2],
            integral_nm: 0.0,
            torque_nm: 0.0,
        }
    }

    /// Starts anew at this speed, without torque.
    pub(crate) fn start(&mut self, speed_rad_s: f64) {
        self.filtered = [speed_rad_s, 0.0];
        (self.integral_nm, self.torque_nm) = (0.0, 0.0);
    }

    /// Advances by one step; returns the torque at the motor, N m.
    pub(crate) fn step(&mut self, target_rad_s: f64, measured_rad_s: f64) -> f64 {
        let [speed_rad_s, rate] = self.filtered;
        let [behind_rad_s, rate] = self.filter.step([speed_rad_s - measured_rad_s, rate]);
        self.filtered = [measured_rad_s + behind_rad_s, rate];
        let error_rad_s = target_rad_s - self.filtered[0];
        let wanted_nm = self.proportional_nm_s * error_rad_s + self.integral_nm;
        let torque_nm = wanted_nm.clamp(-self.torque_max_nm, self.torque_max_nm);
        // No wind-up: the integral stands still while more of it would only go beyond the peak torque.
        if (wanted_nm - torque_nm) * error_rad_s <= 0.0 {
            let change_nm = self.proportional_nm_s * self.integral_share * error_rad_s;
            self.integral_nm = (self.integral_nm + change_nm).clamp(-self.torque_max_nm, self.torque_max_nm);
        }
        self.torque_nm += (torque_nm - self.torque_nm) * self.current_share;
        self.torque_nm
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A loop whose current loop and filter are too fast to be seen.
    fn ideal(bandwidth_hz: f64, integral_ms: f64, inertia_kg_m2: f64) -> PiLoop {
        PiLoop {
            bandwidth_hz,
            integral_ms,
            inertia_kg_m2,
            current_hz: 1e6,
            speed_filter_hz: 1e6,
        }
    }

    /// Speeds of a free inertia after a step of the target, one for each step of the loop.
    fn speeds(options: &PiLoop, inertia_kg_m2: f64, target_rad_s: f64, steps: u32) -> Vec<f64> {
        let mut regulator = Regulator::new(options, 8.4);
        let mut speed_rad_s = 0.0;
        let steps = (0..steps).map(|_| {
            speed_rad_s += regulator.step(target_rad_s, speed_rad_s) / inertia_kg_m2 * LOOP_STEP_S;
            speed_rad_s
        });
        steps.collect()
    }

    /// Step response of w' = (Kp (1 + 1/(Ti s)) / J) (1 - w): s^2 + (Kp/J) s + Kp/(J Ti) in the denominator.
    fn analytic(gain_per_s: f64, integral_s: f64, time_s: f64) -> f64 {
        let damped = gain_per_s / 2.0;
        let square = gain_per_s / integral_s - damped * damped;
        // y = 1 - e^(-d t) (cos w t - d / w sin w t), because y'(0) = Kp / J = 2 d.
        let (cosine, sine) = if square > 0.0 {
            let rate = square.sqrt();
            ((rate * time_s).cos(), (rate * time_s).sin() / rate)
        } else {
            let rate = (-square).sqrt();
            ((rate * time_s).cosh(), (rate * time_s).sinh() / rate)
        };
        1.0 - (-damped * time_s).exp() * (cosine - damped * sine)
    }

    #[test]
    fn the_step_response_is_that_of_a_second_order_system() {
        let inertia_kg_m2 = 1.5e-3;
        for (bandwidth_hz, integral_ms) in [(20.0, 8.0), (50.0, 20.0), (50.0, 2.0)] {
            let rate = TAU * bandwidth_hz;
            let corner = 1000.0 / (rate * integral_ms);
            let gain_per_s = rate / (1.0 + corner * corner).sqrt();
            let options = ideal(bandwidth_hz, integral_ms, inertia_kg_m2);
            for (step, speed) in (1_u32..).zip(speeds(&options, inertia_kg_m2, 1.0, 800)) {
                let expected = analytic(gain_per_s, integral_ms / 1000.0, f64::from(step) * LOOP_STEP_S);
                assert!(
                    (speed - expected).abs() < 0.03,
                    "{bandwidth_hz} Hz, {integral_ms} ms, step {step}: {speed} instead of {expected}"
                );
            }
        }
    }

    #[test]
    fn the_open_loop_crosses_at_the_bandwidth() {
        // At the crossover the torque of a sine of the error moves the inertia by a sine of the same amplitude.
        let options = ideal(50.0, 20.0, 1e-3);
        let mut regulator = Regulator::new(&options, 1e9);
        let (mut speed, mut most) = (0.0, (f64::MAX, f64::MIN));
        for step in 0..16_000 {
            let phase = TAU * 50.0 * f64::from(step) * LOOP_STEP_S;
            // The sum of a cosine has no mean if its first term counts half.
            let error = if step == 0 { 0.5 } else { phase.cos() };
            speed += regulator.step(error, 0.0) / 1e-3 * LOOP_STEP_S;
            if step >= 8_000 {
                most = (most.0.min(speed), most.1.max(speed));
            }
        }
        assert!(((most.1 - most.0) / 2.0 - 1.0).abs() < 0.01, "{most:?}");
    }

    #[test]
    fn at_the_peak_torque_the_integral_does_not_wind_up() {
        let inertia_kg_m2 = 1.5e-3;
        let options = ideal(50.0, 20.0, inertia_kg_m2);
        let small = speeds(&options, inertia_kg_m2, 1.0, 2_000);
        let large = speeds(&options, inertia_kg_m2, 400.0, 2_000);
        let overshoot = |speeds: &[f64], target: f64| speeds.iter().copied().fold(0.0, f64::max) - target;
        assert!(large[399] > 200.0 && large[399] < 8.4 / inertia_kg_m2 * 0.05 * 1.001);
        // Where the torque leaves its peak, the rest of the step is one that just does not reach the peak.
        let rest_rad_s = 8.4 / Regulator::new(&options, 8.4).proportional_nm_s;
        let (large_rad_s, small_rad_s) = (overshoot(&large, 400.0), overshoot(&small, 1.0) * rest_rad_s);
        assert!(
            (large_rad_s / small_rad_s - 1.0).abs() < 0.1,
            "{large_rad_s} {small_rad_s}"
        );
        assert!((large[1999] / 400.0 - 1.0).abs() < 1e-3);
    }

    #[test]
    fn wrong_values_give_a_finite_torque_within_the_peak() {
        let nan = PiLoop {
            bandwidth_hz: f64::NAN,
            integral_ms: f64::NAN,
            inertia_kg_m2: f64::INFINITY,
            current_hz: -1.0,
            speed_filter_hz: 0.0,
        };
        let mut regulator = Regulator::new(&nan, 8.4);
        for step in 0..1000 {
            let torque_nm = regulator.step(700.0, if step % 2 == 0 { 700.0 } else { -700.0 });
            assert!(torque_nm.abs() <= 8.4);
        }
    }
}
