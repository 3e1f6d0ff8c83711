//! A damped oscillator without excitation, moved exactly.
//!
//! One step multiplies deflection and speed by a matrix that is computed once, so the result has no numerical
//! integration error and its energy never grows.

use core::f64::consts::TAU;

/// Highest damping ratio; beyond it the motion would not oscillate.
const DAMPING_MAX: f64 = 0.99;

/// Transition of a damped oscillator over one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Oscillator {
    transition: [[f64; 2]; 2],
}

impl Oscillator {
    /// An oscillator of this undamped frequency, Hz (at least 0.01), and damping ratio (0 to 0.99), moved in steps of
    /// `step_s` seconds.
    #[must_use]
    pub fn new(frequency_hz: f64, damping: f64, step_s: f64) -> Self {
        let rate = TAU * within(frequency_hz, 0.01, 1e6);
        let damping = within(damping, 0.0, DAMPING_MAX);
        let damped = rate * (1.0 - damping * damping).sqrt();
        let decay = (-damping * rate * step_s).exp();
        let (sine, cosine) = (damped * step_s).sin_cos();
        let share = damping * rate / damped * sine;
        Self {
            transition: [
                [decay * (cosine + share), decay * sine / damped],
                [-decay * sine * rate * rate / damped, decay * (cosine - share)],
            ],
        }
    }

    /// Deflection and its speed one step later.
    #[must_use]
    #[inline]
    pub fn step(&self, [deflection, speed]: [f64; 2]) -> [f64; 2] {
        self.transition
            .map(|[of_deflection, of_speed]| of_deflection * deflection + of_speed * speed)
    }
}

/// The value within its bounds; the lower bound for a value that is not a number.
pub(crate) fn within(value: f64, low: f64, high: f64) -> f64 {
    if value >= low { value.min(high) } else { low }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_the_textbook_solution() {
        let (frequency_hz, damping, step_s) = (45.0, 0.03, 1e-3);
        let oscillator = Oscillator::new(frequency_hz, damping, step_s);
        let mut state = [1.0, 0.0];
        for step in 1..=200 {
            state = oscillator.step(state);
            let rate = TAU * frequency_hz;
            let damped = rate * (1.0_f64 - damping * damping).sqrt();
            let time_s = f64::from(step) * step_s;
            let phase = damped * time_s;
            let expected = (-damping * rate * time_s).exp() * (phase.cos() + damping * rate / damped * phase.sin());
            assert!((state[0] - expected).abs() < 1e-12, "step {step}");
        }
    }

    #[test]
    fn energy_never_grows_and_wrong_values_do_no_harm() {
        for (frequency_hz, damping) in [(45.0, 0.0), (45.0, 2.0), (f64::NAN, f64::NAN), (-1.0, -1.0)] {
            let oscillator = Oscillator::new(frequency_hz, damping, 1e-3);
            let rate = TAU * within(frequency_hz, 0.01, 1e6);
            let mut state = [1.0, 0.0];
            let mut energy = rate * rate;
            for _ in 0..1000 {
                state = oscillator.step(state);
                let now = state[1] * state[1] + rate * rate * state[0] * state[0];
                assert!(now <= energy * (1.0 + 1e-12), "{frequency_hz} Hz, {damping}");
                energy = now;
            }
        }
    }
}
