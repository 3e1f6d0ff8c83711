//! How control reaches the world: triggers, groups, and velocity or torque outputs.
//!
//! The names are those of the paper: an [`IoTrigger`] moves all values between memory and wire at one moment, an
//! [`IoGroup`] holds the inputs and outputs that belong together, and an axis is a [`VelocityIo`] or a [`TorqueIo`].
//! Control code written against these traits runs over any bus, or over none.
//!
//! Invariant: reading and writing values only touches memory; only a trigger touches the wire.

use crate::drives::cia402::{DriveTarget, StatusWord};
use crate::ethercat::cyclic::{Arrival, Exchange};
use serde::{Deserialize, Serialize};

/// A motor position in encoder increments, unwrapped: it never jumps at the end of the encoder's range.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
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

/// What moves an axis.
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

/// What an axis is told in one cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisCommand {
    /// Where the drive is to be led.
    pub target: DriveTarget,
    /// What moves it; used while the drive is in operation and is to stay there, if its mode takes this kind of demand.
    pub demand: Demand,
}

/// Moves all values between memory and wire at one moment.
pub trait IoTrigger {
    /// Starts the cycle and gives the frame that fetches all inputs.
    fn trigger_input(&mut self) -> &[u8];

    /// Gives the frame that carries all outputs; empty when there are none, or when they go with the next inputs.
    fn trigger_output(&mut self) -> &[u8];

    /// Takes a frame from the wire.
    fn arrived(&mut self, frame: &[u8]) -> Arrival;
}

impl<const SLAVES: usize, const MESSAGE: usize> IoTrigger for Exchange<'_, SLAVES, MESSAGE> {
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

    /// A member; `None` beyond the last one.
    fn io(&mut self, member: usize) -> Option<Self::Io<'_>>;
}

/// An axis that is commanded by velocity.
pub trait VelocityIo {
    /// This cycle's input; `None` when none came.
    fn input(&self) -> Option<AxisInput>;

    /// Sets where the drive is to be led, and the velocity at the joint in rad/s.
    fn set_velocity(&mut self, target: DriveTarget, velocity_rad_s: f64);
}

/// An axis that is commanded by torque.
pub trait TorqueIo {
    /// This cycle's input; `None` when none came.
    fn input(&self) -> Option<AxisInput>;

    /// Sets where the drive is to be led, and the torque at the joint in newton metres.
    fn set_torque(&mut self, target: DriveTarget, torque_nm: f64);
}
