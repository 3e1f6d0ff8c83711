//! What the motors turn: the seam between the drives and a machine.
//!
//! Every millisecond the drives move their motors according to their velocity loops and ramps, or only set a torque.
//! Then the load gets the shafts: it moves those whose drive only sets a torque, and stops those that hit an end stop.
//! A PI velocity loop also only sets a torque: the load advances it by [`Shaft::regulate`] in steps of [`LOOP_STEP_S`],
//! [`LOOP_STEPS`] times a millisecond. Without a machine, use a [`Flywheel`] on each motor.

use crate::drive::Drive;
use crate::drive::velocity_loop::{LOOP_STEP_S, LOOP_STEPS};

/// Length of a step, seconds.
pub use crate::drive::motor::STEP_S;

/// A machine that the motors of a segment turn.
pub trait Load {
    /// Advances by one millisecond; `time_ms` counts them from 1. The shafts are in the order that their drives had in
    /// the chain at the start, one for each drive, already moved by the drives that do not only set a torque.
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

    /// The slave that has the motor: its place in the chain at the start, from 1.
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
        self.drive.is_moved_by_load().then(|| self.drive.true_torque_nm())
    }

    /// Whether the torque is that of a PI velocity loop, which [`Shaft::regulate`] advances.
    #[must_use]
    #[inline]
    pub fn is_regulated(&self) -> bool {
        self.drive.motor().is_regulated()
    }

    /// Advances a PI velocity loop, if it acts, by [`LOOP_STEP_S`] at the present speed.
    pub fn regulate(&mut self) {
        self.drive.regulate();
    }

    /// Turns the shaft at this speed, rad/s, for a duration.
    pub fn turn(&mut self, rad_s: f64, duration_s: f64) {
        self.drive.motor_mut().turn(rad_s, duration_s);
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
            if shaft.is_regulated() {
                for _ in 0..LOOP_STEPS {
                    shaft.regulate();
                    self.turn(shaft, LOOP_STEP_S);
                }
            } else {
                self.turn(shaft, STEP_S);
            }
        }
    }
}

impl Flywheel {
    fn turn(&self, shaft: &mut Shaft<'_>, duration_s: f64) {
        let Some(torque_nm) = shaft.torque_nm() else { return };
        let speed_rad_s = shaft.speed_rad_s();
        let dry_nm = self.dry_nm * (speed_rad_s / DRY_FRICTION_RAD_S).tanh();
        let friction_nm = self.viscous_nm_s * speed_rad_s + dry_nm;
        shaft.accelerate((torque_nm - friction_nm) / self.inertia_kg_m2, duration_s);
    }
}
