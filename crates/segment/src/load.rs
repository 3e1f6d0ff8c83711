//! What the motors turn: the seam between the drives and a machine.
//!
//! Every millisecond the drives move their motors according to their velocity loops and ramps, or only set a torque.
//! Then the load gets the shafts: it moves those whose drive only sets a torque, and stops those that hit an end stop.
//! Without a machine, use a [`Flywheel`] on each motor.

use crate::drive::Drive;

/// Length of a step, seconds.
pub use crate::drive::motor::STEP_S;

/// A machine that the motors of a segment turn.
pub trait Load {
    /// Advances by one millisecond; `time_ms` counts them from 1. The shafts are in the order of the chain, one for
    /// each drive, already moved by the drives that are not in torque mode.
    fn step(&mut self, time_ms: u64, shafts: &mut [Shaft<'_>]);
}

/// The shaft of one motor.
#[derive(Debug)]
pub struct Shaft<'a> {
    slave: usize,
    drive: &'a mut Drive,
}

impl<'a> Shaft<'a> {
    pub(crate) fn new(slave: usize, drive: &'a mut Drive) -> Self {
        Self { slave, drive }
    }

    /// The slave that has the motor, from 1.
    #[must_use]
    #[inline]
    pub fn slave(&self) -> usize {
        self.slave
    }

    /// Angle, rad.
    #[must_use]
    #[inline]
    pub fn angle_rad(&self) -> f64 {
        self.drive.motor().angle_rad()
    }

    /// Speed, rad/s.
    #[must_use]
    #[inline]
    pub fn speed_rad_s(&self) -> f64 {
        self.drive.motor().speed_rad_s()
    }

    /// Torque of the motor, N m, if the load decides how it moves; `None` where the drive has moved it.
    #[must_use]
    #[inline]
    pub fn torque_nm(&self) -> Option<f64> {
        self.drive.is_in_torque_mode().then(|| self.drive.motor().torque_nm())
    }

    /// Moves the shaft with this acceleration, rad/s2, for a duration.
    pub fn accelerate(&mut self, rad_s2: f64, duration_s: f64) {
        self.drive.motor_mut().accelerate(rad_s2, duration_s);
    }

    /// Stops the shaft at once at this angle, rad: a mechanical end stop.
    pub fn block_at(&mut self, angle_rad: f64) {
        self.drive.motor_mut().block_at(angle_rad);
    }
}

/// A flywheel with friction on each motor, and nothing between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flywheel {
    /// Inertia of rotor and wheel, kg m2; above 0.
    pub inertia_kg_m2: f64,
    /// Friction that grows with the speed, N m s/rad.
    pub viscous_nm_s: f64,
    /// Dry friction, N m.
    pub dry_nm: f64,
}

/// Speed at which dry friction has mostly built up, rad/s.
const DRY_FRICTION_RAD_S: f64 = 0.2;

impl Default for Flywheel {
    fn default() -> Self {
        Self {
            inertia_kg_m2: 5.0e-4,
            viscous_nm_s: 5.0e-4,
            dry_nm: 0.02,
        }
    }
}

impl Load for Flywheel {
    fn step(&mut self, _time_ms: u64, shafts: &mut [Shaft<'_>]) {
        for shaft in shafts {
            let Some(torque_nm) = shaft.torque_nm() else { continue };
            let speed_rad_s = shaft.speed_rad_s();
            let dry_nm = self.dry_nm * (speed_rad_s / DRY_FRICTION_RAD_S).tanh();
            let friction_nm = self.viscous_nm_s * speed_rad_s + dry_nm;
            shaft.accelerate((torque_nm - friction_nm) / self.inertia_kg_m2, STEP_S);
        }
    }
}
