//! Interfaces between control and drives: triggers, groups, and axes commanded by velocity, torque or position.
//!
//! The names are those of the paper: an [`IoTrigger`] moves all values between memory and wire at one moment, an
//! [`IoGroup`] holds the inputs and outputs of drives that belong together, and an axis is a [`VelocityIo`], a
//! [`TorqueIo`] or a [`PositionIo`]. Control code written against these traits runs over EtherCAT
//! ([`EtherCatGroup`](crate::EtherCatGroup)), and without any bus ([`MemoryGroup`](crate::MemoryGroup)).
//!
//! Invariant: reading and writing values only accesses memory; only a trigger moves them to and from the wire.

use crate::cia402::DriveTarget;
use crate::position_range::PositionRange;
use crate::{AxisMode, DriveInput, DriveKind, DriveOutput};
use etherpen_ethercat::configure::Direction;
use etherpen_ethercat::cyclic::{Arrival, BusCounters, ExchangeKind};
use etherpen_ethercat::encapsulation::Encapsulation;
use etherpen_ethercat::place::Place;

/// State of the bus in a cycle, besides the drives' inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusState {
    /// AL states of the slaves in use OR-ed together, with the error flag; `None` when the broadcast did not return.
    pub al_status: Option<u8>,
    /// Station of the reference clock; `None` without distributed clocks.
    pub reference_clock: Option<u16>,
    /// Number of its time, wrapping: a new one has nothing to do with the one before.
    pub time_number: u8,
    /// The reference clock's time, ns, low 32 bits; `None` if it did not arrive in this cycle.
    pub clock_ns: Option<u32>,
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

    /// When inputs are read and outputs are written.
    fn exchange_kind(&self) -> ExchangeKind;

    /// State of the bus in this cycle.
    fn bus_state(&self) -> BusState;

    /// Counters since start-up.
    fn counters(&self) -> BusCounters;

    /// Sends the following frames in another encapsulation; frames in flight are lost.
    fn set_encapsulation(&mut self, encapsulation: Encapsulation);
}

/// A drive of a group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GroupDrive {
    /// Its type.
    pub kind: DriveKind,
    /// Kind of demand that it takes.
    pub mode: AxisMode,
    /// Whether it may be enabled: it reached OP and has not been seen in another state since.
    pub operational: bool,
    /// Range of its position; known in position mode only.
    pub range: PositionRange,
    /// Number of its last configuration, wrapping: a new number means that it may have been switched off in between.
    pub generation: u8,
}

/// Drives that are read and written together. Members are numbered from 0.
pub trait IoGroup {
    /// Takes over the bus's present configuration; returns true if a member's drive may have changed. Call it once a
    /// cycle, before the first [`Self::read`].
    fn renew(&mut self) -> bool;

    /// The drive of a member; `None` while it has none.
    fn drive(&self, member: usize) -> Option<GroupDrive>;

    /// This cycle's input of a member; `None` if none arrived.
    fn read(&self, member: usize) -> Option<DriveInput>;

    /// Members in operation that have not confirmed the outputs of the last trigger, one bit each. A group without a
    /// wire confirms them at once.
    fn unconfirmed(&self) -> u32 {
        0
    }

    /// Sets the output of a member for the next trigger; does nothing while the member has no drive.
    fn write(&mut self, member: usize, output: &DriveOutput);

    /// Number of the plan for which places of terminals' values are valid.
    fn terminal_plan(&self) -> u32 {
        0
    }

    /// Place of `bits` bits from bit `bit` on in the process data of the terminal at a place in the chain; `None` unless
    /// it is a terminal in operation that exchanges them.
    fn terminal_bits(&self, _slave: usize, _direction: Direction, _bit: u16, _bits: u8) -> Option<Place<u32>> {
        None
    }

    /// Place of a wanted value of `bits` bits, which has this number in
    /// [`BusSetup::values`](etherpen_ethercat::event::BusSetup::values), in the process data of the terminal at a place
    /// in the chain; `None` unless the terminal is in operation and exchanges it.
    fn terminal_object(&self, _slave: usize, _direction: Direction, _number: usize, _bits: u8) -> Option<Place<u32>> {
        None
    }

    /// This cycle's value at a place of a terminal; `None` if it did not arrive.
    fn terminal_value(&self, _place: &Place<u32>) -> Option<u32> {
        None
    }

    /// Whether the terminal at a place in the chain, which has outputs, has confirmed those of the last trigger. A group
    /// without a wire confirms them at once.
    fn terminal_confirms(&self, _slave: usize) -> bool {
        true
    }

    /// Sets the value at a place of a terminal's outputs for the next trigger.
    fn set_terminal_value(&mut self, _place: &Place<u32>, _value: u32) {}
}

/// An axis that is commanded by a velocity.
pub trait VelocityIo {
    /// The output that leads the drive towards `target` and, in operation, demands this velocity at the joint, rad/s.
    fn set_velocity(&mut self, target: DriveTarget, velocity_rad_s: f64) -> DriveOutput;
}

/// An axis that is commanded by a torque.
pub trait TorqueIo {
    /// The output that leads the drive towards `target` and, in operation, demands this torque at the joint, N m.
    fn set_torque(&mut self, target: DriveTarget, torque_nm: f64) -> DriveOutput;
}

/// An axis that is commanded by a position.
pub trait PositionIo {
    /// The output that leads the drive towards `target` and, in operation, demands this position, increments of the drive
    /// (wrapping at 32 bits, also where the drive's range is smaller), and adds this velocity at the joint, rad/s, to the one of the drive's position loop.
    ///
    /// `None` holds the last position that was demanded. When the drive comes into operation, that is its position then.
    fn set_position(&mut self, target: DriveTarget, position: Option<i32>, velocity_rad_s: f64) -> DriveOutput;
}
