//! One structural mode: the pen swings against the joints, and no encoder sees it.
//!
//! The pen is a mass on a damped spring whose other end moves with the platform. Between two milliseconds the platform
//! moves in a straight line, so the swing is the free decay of an oscillator whose speed jumps with the platform's.
//! The swing does not act back on the joints.

use super::physics::StructuralMode;
use etherpen::robots::Position;
use etherpen_segment::{Oscillator, STEP_S};

/// The pen's swing against the platform.
#[derive(Clone, Debug)]
pub(super) struct Vibration {
    /// Oscillators of x, y and z; `None` is rigid.
    oscillators: [Option<Oscillator>; 3],
    /// Deflection, mm, and its speed, mm/s.
    swings: [[f64; 2]; 3],
    /// Position of the platform a millisecond ago, and its speed until then.
    before: Option<([f64; 3], [f64; 3])>,
}

impl Vibration {
    /// The mode at rest; `None` if everything is rigid.
    pub(super) fn new(mode: &StructuralMode) -> Option<Self> {
        let oscillators =
            [mode.xy_hz, mode.xy_hz, mode.z_hz].map(|hz| (hz > 0.0).then(|| Oscillator::new(hz, mode.damping, STEP_S)));
        oscillators.iter().any(Option::is_some).then_some(Self {
            oscillators,
            swings: [[0.0; 2]; 3],
            before: None,
        })
    }

    /// Advances by one millisecond to this position of the platform; returns the pen's.
    pub(super) fn step(&mut self, platform: Position) -> Position {
        let now = [platform.x_mm, platform.y_mm, platform.z_mm];
        let (from, speeds_before) = self.before.unwrap_or((now, [0.0; 3]));
        let (mut pen, mut speeds) = (now, [0.0; 3]);
        let motion = now.into_iter().zip(from).zip(speeds_before).zip(speeds.iter_mut());
        let swings = self.oscillators.iter().zip(&mut self.swings).zip(&mut pen);
        for ((((now, from), before), speed), ((oscillator, swing), pen)) in motion.zip(swings) {
            *speed = (now - from) / STEP_S;
            if let Some(oscillator) = oscillator {
                let [deflection, swing_speed] = *swing;
                *swing = oscillator.step([deflection, swing_speed - (*speed - before)]);
                *pen += swing[0];
            }
        }
        self.before = Some((now, speeds));
        Position {
            x_mm: pen[0],
            y_mm: pen[1],
            z_mm: pen[2],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{PI, TAU};

    fn mode() -> StructuralMode {
        StructuralMode {
            xy_hz: 45.0,
            z_hz: 60.0,
            damping: 0.03,
        }
    }

    fn at(x_mm: f64, z_mm: f64) -> Position {
        Position { x_mm, y_mm: 0.0, z_mm }
    }

    /// Deflections after a jump of the platform by 1 mm in x and z within a millisecond, interpolated at zero crossings.
    fn decay() -> (Vec<f64>, Vec<f64>) {
        let mut vibration = Vibration::new(&mode()).expect("a mode");
        vibration.step(at(0.0, 0.0));
        let pens = (0..400).map(|_| vibration.step(at(1.0, 1.0)));
        pens.map(|pen| (pen.x_mm - 1.0, pen.z_mm - 1.0)).unzip()
    }

    /// Frequency by the mean distance of zero crossings, Hz, and damping by the logarithmic decrement.
    fn measured(deflections: &[f64]) -> (f64, f64) {
        let crossings: Vec<f64> = deflections
            .windows(2)
            .enumerate()
            .filter(|(_, pair)| pair[0] * pair[1] < 0.0)
            .map(|(ms, pair)| ms as f64 + pair[0] / (pair[0] - pair[1]))
            .collect();
        let periods = (crossings.len() - 1) as f64 / 2.0;
        let period_s = (crossings[crossings.len() - 1] - crossings[0]) / periods / 1000.0;
        // Energy-like sums over whole periods fall by e^(-4 pi damping) a period.
        let power = |from: usize| -> f64 { deflections[from..from + 100].iter().map(|mm| mm * mm).sum() };
        let rate_per_s = (power(0) / power(200)).ln() / 2.0 / 0.2;
        (1.0 / period_s, rate_per_s * period_s / TAU)
    }

    #[test]
    fn the_decay_has_the_frequency_and_the_damping_of_the_mode() {
        let (x, z) = decay();
        for (deflections, hz) in [(x, 45.0), (z, 60.0)] {
            let (frequency_hz, damping) = measured(&deflections);
            let damped_hz = hz * (1.0 - 0.03_f64 * 0.03).sqrt();
            assert!((frequency_hz / damped_hz - 1.0).abs() < 0.005, "{frequency_hz} Hz");
            assert!((damping / 0.03 - 1.0).abs() < 0.03, "{damping}");
        }
    }

    #[test]
    fn under_constant_acceleration_the_pen_lags_by_acceleration_over_the_square_of_the_rate() {
        let mut vibration = Vibration::new(&mode()).expect("a mode");
        let acceleration_mm_s2 = 10_000.0;
        let (mut sum, mut count) = (0.0, 0.0);
        for ms in 0..2_000 {
            let time_s = f64::from(ms) / 1000.0;
            let x_mm = 0.5 * acceleration_mm_s2 * time_s * time_s;
            let deflection = vibration.step(at(x_mm, 0.0)).x_mm - x_mm;
            if ms >= 1_000 {
                (sum, count) = (sum + deflection, count + 1.0);
            }
        }
        let expected = -acceleration_mm_s2 / (2.0 * PI * 45.0_f64).powi(2);
        assert!((sum / count / expected - 1.0).abs() < 0.01, "{} mm", sum / count);
    }

    #[test]
    fn a_rigid_robot_has_no_mode_and_a_rigid_axis_does_not_swing() {
        let rigid = StructuralMode {
            xy_hz: 0.0,
            z_hz: 0.0,
            damping: 0.03,
        };
        assert!(Vibration::new(&rigid).is_none());
        let mut vibration = Vibration::new(&StructuralMode { z_hz: 60.0, ..rigid }).expect("z swings");
        vibration.step(at(0.0, 0.0));
        let pen = vibration.step(at(1.0, 1.0));
        assert!(pen.x_mm == 1.0 && pen.z_mm != 1.0);
    }
}
