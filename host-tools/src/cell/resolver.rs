//! The resolver on a motor's shaft: what it shows, which is the truth only while nothing is wrong with it.
//!
//! The motor moves on, and the drive's own loops hold it, whatever is shown: the truth is the motor's.

use super::random::Random;

/// What is wrong with a resolver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResolverFault {
    /// It stays where it is.
    Stuck,
    /// It shows so many per cent of the motion; what it lost stays lost.
    Slip(i64),
    /// It shows the motion the other way round.
    Reversed,
    /// Every position is wrong by chance, by so many increments at most.
    Noise(u32),
}

/// A resolver.
#[derive(Clone, Debug)]
pub(super) struct Resolver {
    fault: Option<ResolverFault>,
    left_ms: u64,
    /// Motor angle at which the fault began, and what was shown there, rad.
    motor_rad: f64,
    shown_rad: f64,
    /// Angle that it has slipped by for good, rad.
    slipped_rad: f64,
    /// Angle of another motor's shaft that is shown instead.
    foreign_rad: Option<f64>,
    /// Noise of a sound resolver, and what it is now, rad.
    noise_rad: f64,
    error_rad: f64,
    random: Random,
}

impl Resolver {
    /// A sound resolver with noise of this amplitude, rad.
    pub(super) fn new(noise_rad: f64, seed: u64) -> Self {
        Self {
            fault: None,
            left_ms: 0,
            motor_rad: 0.0,
            shown_rad: 0.0,
            slipped_rad: 0.0,
            foreign_rad: None,
            noise_rad,
            error_rad: 0.0,
            random: Random::new(seed),
        }
    }

    /// Something is wrong from now on for some milliseconds; 0 puts it right, and back to where it was mounted.
    pub(super) fn set_fault(&mut self, fault: ResolverFault, milliseconds: u64, motor_rad: f64) {
        let shown_rad = self.shown_rad(motor_rad);
        self.heal(motor_rad);
        if milliseconds > 0 {
            (self.motor_rad, self.shown_rad) = (motor_rad, shown_rad);
            (self.fault, self.left_ms) = (Some(fault), milliseconds);
        } else {
            self.slipped_rad = 0.0;
        }
    }

    /// It slips by an angle, at once and for good.
    pub(super) fn slip(&mut self, angle_rad: f64) {
        self.slipped_rad += angle_rad;
        self.shown_rad += angle_rad;
    }

    /// It shows another motor's shaft, or its own again.
    pub(super) fn show_foreign(&mut self, foreign_rad: Option<f64>) {
        self.foreign_rad = foreign_rad;
    }

    /// One millisecond; `increment_rad` is the angle of an increment.
    pub(super) fn step(&mut self, motor_rad: f64, increment_rad: f64) {
        if self.left_ms > 0 {
            self.left_ms -= 1;
            if self.left_ms == 0 {
                self.heal(motor_rad);
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

    /// The angle that it shows while the motor stands at this one, rad.
    pub(super) fn shown_rad(&self, motor_rad: f64) -> f64 {
        let own_rad = self.foreign_rad.unwrap_or(motor_rad) + self.slipped_rad;
        let moved_rad = motor_rad - self.motor_rad;
        let shown_rad = match self.fault {
            Some(ResolverFault::Stuck) => return self.shown_rad,
            Some(ResolverFault::Slip(percent)) => self.shown_rad + moved_rad * percent as f64 / 100.0,
            Some(ResolverFault::Reversed) => self.shown_rad - moved_rad,
            Some(ResolverFault::Noise(_)) | None => own_rad,
        };
        shown_rad + self.error_rad
    }

    fn heal(&mut self, motor_rad: f64) {
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
