//! The resolver on a motor's shaft, and its faults.
//!
//! A resolver fault does not affect the motor: the drive's own loops continue with the true angle.

use crate::random::Random;
use std::f64::consts::TAU;

/// Fault of a resolver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResolverFault {
    /// The position is frozen.
    Stuck,
    /// The position follows only this percentage of the motion; the loss is permanent.
    Slip(i64),
    /// The position moves in the reverse direction.
    Reversed,
    /// Every position has a random error of at most this many increments.
    Noise(u32),
}

/// Error of a resolver that repeats with every turn of the motor, without a fault.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ResolverError {
    /// Amplitude of the part that repeats once a turn, rad.
    pub once_rad: f64,
    /// Amplitude of the part that repeats twice a turn, rad.
    pub twice_rad: f64,
}

/// Gives the phases of the error random numbers of their own.
const PHASE_SEED: u64 = 0x9A5E;

/// A resolver.
#[derive(Clone, Debug)]
pub(crate) struct Resolver {
    fault: Option<ResolverFault>,
    left_ms: u64,
    /// Motor angle and position shown when the fault began, rad.
    motor_rad: f64,
    shown_rad: f64,
    /// Permanent slip angle, rad.
    slipped_rad: f64,
    /// Angle of another motor's shaft that is shown instead, rad.
    foreign_rad: Option<f64>,
    /// Error that repeats with every turn, and its phases, rad.
    periodic: ResolverError,
    phases_rad: [f64; 2],
    /// Noise amplitude of a resolver without a fault, and present noise, rad.
    noise_rad: f64,
    error_rad: f64,
    random: Random,
}

impl Resolver {
    /// A resolver without a fault, with noise of this amplitude, rad.
    pub(crate) fn new(noise_rad: f64, seed: u64) -> Self {
        Self {
            fault: None,
            left_ms: 0,
            motor_rad: 0.0,
            shown_rad: 0.0,
            slipped_rad: 0.0,
            foreign_rad: None,
            periodic: ResolverError::default(),
            phases_rad: [0.0; 2],
            noise_rad,
            error_rad: 0.0,
            random: Random::new(seed),
        }
    }

    /// This resolver with an error that repeats with every turn; the seed gives its phases.
    pub(crate) fn with_error(self, periodic: ResolverError, seed: u64) -> Self {
        let mut random = Random::new(seed ^ PHASE_SEED);
        Self {
            periodic,
            phases_rad: [random.unit() * TAU, random.unit() * TAU],
            ..self
        }
    }

    /// Error that repeats with every turn at this angle, rad.
    fn periodic_rad(&self, angle_rad: f64) -> f64 {
        let ResolverError { once_rad, twice_rad } = self.periodic;
        if once_rad == 0.0 && twice_rad == 0.0 {
            return 0.0;
        }
        let [once, twice] = self.phases_rad;
        once_rad * (angle_rad + once).sin() + twice_rad * (2.0 * angle_rad + twice).sin()
    }

    /// Speed that the resolver shows for a speed of 1 rad/s at this angle.
    pub(crate) fn speed_share(&self, angle_rad: f64) -> f64 {
        let ResolverError { once_rad, twice_rad } = self.periodic;
        let [once, twice] = self.phases_rad;
        1.0 + once_rad * (angle_rad + once).cos() + 2.0 * twice_rad * (2.0 * angle_rad + twice).cos()
    }

    /// Sets a fault for some milliseconds; 0 repairs the resolver, including its mounting angle.
    pub(crate) fn set_fault(&mut self, fault: ResolverFault, milliseconds: u64, motor_rad: f64) {
        let shown_rad = self.shown_rad(motor_rad);
        self.clear_faults(motor_rad);
        if milliseconds > 0 {
            (self.motor_rad, self.shown_rad) = (motor_rad, shown_rad);
            (self.fault, self.left_ms) = (Some(fault), milliseconds);
        } else {
            self.slipped_rad = 0.0;
        }
    }

    /// Makes the resolver slip by an angle, at once and permanently.
    pub(crate) fn slip(&mut self, angle_rad: f64) {
        self.slipped_rad += angle_rad;
        self.shown_rad += angle_rad;
    }

    /// Makes the resolver show another motor's shaft, or its own again.
    pub(crate) fn show_foreign(&mut self, foreign_rad: Option<f64>) {
        self.foreign_rad = foreign_rad;
    }

    /// Advances by one millisecond; `increment_rad` is the angle of an increment.
    pub(crate) fn step(&mut self, motor_rad: f64, increment_rad: f64) {
        if self.left_ms > 0 {
            self.left_ms -= 1;
            if self.left_ms == 0 {
                self.clear_faults(motor_rad);
            }
        }
        let amplitude_rad = match self.fault {
            Some(ResolverFault::Noise(increments)) => f64::from(increments) * increment_rad,
            _ => self.noise_rad,
        };
        self.error_rad = match amplitude_rad {
            0.0 => 0.0,
            amplitude_rad => (2.0 * self.random.unit() - 1.0) * amplitude_rad,
        };
    }

    /// The angle shown while the motor is at `motor_rad`, rad.
    pub(crate) fn shown_rad(&self, motor_rad: f64) -> f64 {
        let own_rad = self.foreign_rad.unwrap_or(motor_rad) + self.slipped_rad;
        let own_rad = own_rad + self.periodic_rad(own_rad);
        let moved_rad = motor_rad - self.motor_rad;
        let shown_rad = match self.fault {
            Some(ResolverFault::Stuck) => return self.shown_rad,
            Some(ResolverFault::Slip(percent)) => self.shown_rad + moved_rad * percent as f64 / 100.0,
            Some(ResolverFault::Reversed) => self.shown_rad - moved_rad,
            Some(ResolverFault::Noise(_)) | None => own_rad,
        };
        shown_rad + self.error_rad
    }

    fn clear_faults(&mut self, motor_rad: f64) {
        if let Some(ResolverFault::Slip(percent)) = self.fault {
            self.slipped_rad -= (motor_rad - self.motor_rad) * (100 - percent) as f64 / 100.0;
        }
        (self.fault, self.left_ms) = (None, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_begins_where_the_resolver_stands_and_what_slipped_stays() {
        let mut resolver = Resolver::new(0.0, 1);
        let shown = |resolver: &Resolver, motor_rad: f64| (resolver.shown_rad(motor_rad) * 1000.0).round();
        for (fault, at_three, healed) in [
            (ResolverFault::Stuck, 1.0, 3.0),
            (ResolverFault::Reversed, -1.0, 3.0),
            (ResolverFault::Slip(75), 2.5, 2.5),
        ] {
            resolver.set_fault(fault, 2, 1.0);
            assert_eq!(shown(&resolver, 1.0), 1000.0, "{fault:?}");
            resolver.step(2.0, 1.0e-6);
            assert_eq!(shown(&resolver, 3.0), 1000.0 * at_three, "{fault:?}");
            resolver.step(3.0, 1.0e-6);
            assert_eq!(shown(&resolver, 3.0), 1000.0 * healed, "{fault:?}");
        }
        resolver.slip(0.5);
        assert_eq!(shown(&resolver, 3.0), 3000.0);
        resolver.show_foreign(Some(7.0));
        assert_eq!(shown(&resolver, 3.0), 7000.0);
    }

    #[test]
    fn a_periodic_error_has_its_amplitudes_and_repeats_with_every_turn() {
        let periodic = ResolverError {
            once_rad: 2.9e-3,
            twice_rad: 0.9e-3,
        };
        let resolver = Resolver::new(0.0, 1).with_error(periodic, 7);
        let error = |angle_rad: f64| resolver.shown_rad(angle_rad) - angle_rad;
        // Fourier sums over one turn: amplitude of the first five harmonics.
        let steps = 360;
        for (harmonic, expected) in [(0.0, 0.0), (1.0, 2.9e-3), (2.0, 0.9e-3), (3.0, 0.0), (4.0, 0.0)] {
            let sum = |of: fn(f64) -> f64| -> f64 {
                let angles = (0..steps).map(|step| f64::from(step) * TAU / f64::from(steps));
                angles.map(|angle| error(angle) * of(harmonic * angle)).sum::<f64>() * 2.0 / f64::from(steps)
            };
            let amplitude = sum(f64::sin).hypot(sum(f64::cos));
            assert!((amplitude - expected).abs() < 1e-9, "harmonic {harmonic}: {amplitude}");
        }
        assert!((error(1.0) - error(1.0 + 3.0 * TAU)).abs() < 1e-12);
        let slope = (resolver.shown_rad(1.0 + 1e-6) - resolver.shown_rad(1.0 - 1e-6)) / 2e-6;
        assert!((resolver.speed_share(1.0) - slope).abs() < 1e-8);
        let other = Resolver::new(0.0, 1).with_error(periodic, 8);
        assert!(
            (other.shown_rad(1.0) - resolver.shown_rad(1.0)).abs() > 1e-5,
            "another phase"
        );
    }

    #[test]
    fn noise_stays_within_its_amplitude_and_has_no_mean() {
        let mut resolver = Resolver::new(0.0, 5);
        resolver.set_fault(ResolverFault::Noise(100), 100_000, 0.0);
        let (mut sum, mut most) = (0.0, 0.0_f64);
        for _ in 0..10_000 {
            resolver.step(0.0, 0.01);
            let shown_rad = resolver.shown_rad(0.0);
            (sum, most) = (sum + shown_rad, most.max(shown_rad.abs()));
        }
        assert!(
            most <= 1.0 && most > 0.99 && (sum / 10_000.0_f64).abs() < 0.02,
            "{most}, {sum}"
        );
    }
}
