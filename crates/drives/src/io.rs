//! Interfaces between control and hardware: triggers, groups, and velocity or torque outputs.
//!
//! The names are those of the paper: an [`IoTrigger`] moves all values between memory and wire at one moment, an
//! [`IoGroup`] holds inputs and outputs that belong together, and an axis is a [`VelocityIo`] or a [`TorqueIo`].
//! Control code written against these traits runs over any bus, or without a bus.
//!
//! Invariant: reading and writing values only accesses memory; only a trigger accesses the wire.

use crate::cia402::{DriveTarget, StatusWord};
use etherpen_ethercat::cyclic::{Arrival, Exchange};
use etherpen_ethercat::driver::SlaveFactory;

/// A motor position in encoder increments, unwrapped: it never jumps at the end of the encoder's range.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Increments(pub i64);

/// What an axis reports in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisInput {
    /// Motor position.
    pub position: Increments,
    /// Joint angle, rad; `None` until the axis is referenced.
    pub angle_rad: Option<f64>,
    /// The drive's status word.
    pub status: StatusWord,
}

/// Demand for an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Demand {
    /// Velocity at the joint, rad/s.
    Velocity(f64),
    /// Torque at the joint, N m.
    Torque(f64),
}

impl Default for Demand {
    /// A velocity of 0.
    fn default() -> Self {
        Self::Velocity(0.0)
    }
}

/// Command to an axis for one cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisCommand {
    /// Target state of the drive.
    pub target: DriveTarget,
    /// Demand; used while the drive is in operation and its target is operation, if its mode takes this kind of demand.
    pub demand: Demand,
}

/// Moves all values between memory and wire at one moment.
pub trait IoTrigger {
    /// Starts the cycle and returns the frame that fetches all inputs.
    fn trigger_input(&mut self) -> &[u8];

    /// Returns the frame that carries all outputs; empty when there are no outputs, or when they are sent with the next
    /// inputs.
    fn trigger_output(&mut self) -> &[u8];

    /// Takes a frame from the wire.
    fn arrived(&mut self, frame: &[u8]) -> Arrival;
}

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> IoTrigger for Exchange<'_, F, SLAVES, MESSAGE> {
    fn trigger_input(&mut self) -> &[u8] {
        self.input_telegram()
    }

    fn trigger_output(&mut self) -> &[u8] {
        self.output_telegram()
    }

    fn arrived(&mut self, frame: &[u8]) -> Arrival {
        self.receive(frame)
    }
}

/// Inputs and outputs that are read and written together.
pub trait IoGroup {
    /// One member.
    type Io<'a>
    where
        Self: 'a;

    /// Number of members.
    fn len(&self) -> usize;

    /// Whether it has no members.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The member with an index; `None` beyond the last one.
    fn io(&mut self, member: usize) -> Option<Self::Io<'_>>;
}

/// An axis that is commanded by velocity.
pub trait VelocityIo {
    /// This cycle's input; `None` when none arrived.
    fn input(&self) -> Option<AxisInput>;

    /// Sets the target state of the drive and the velocity at the joint, rad/s.
    fn set_velocity(&mut self, target: DriveTarget, velocity_rad_s: f64);
}

/// An axis that is commanded by torque.
pub trait TorqueIo {
    /// This cycle's input; `None` when none arrived.
    fn input(&self) -> Option<AxisInput>;

    /// Sets the target state of the drive and the torque at the joint, N m.
    fn set_torque(&mut self, target: DriveTarget, torque_nm: f64);
}
