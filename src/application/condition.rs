//! Inputs of the operating modes, once a millisecond: conditions of robot and bus, progress of the trajectory.
//!
//! Plain data. Invariant: no code here takes a decision.

use super::Fault;
use crate::board::Interlock;
use crate::robots::{AXES, JointAngles};

/// Report of the critical tasks about one millisecond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Condition {
    /// Measured pose; a joint angle is valid only on a referenced axis.
    pub pose: JointAngles,
    /// The first axis that is not referenced (homed), from 0.
    pub unreferenced: Option<u8>,
    /// Whether all four drives are in operation enabled.
    pub powered: bool,
    /// Whether no drive has power.
    pub unpowered: bool,
    /// Whether the axes are led to their home switches.
    pub searching: bool,
    /// Whether all axes are at rest.
    pub standstill: bool,
    /// Fault of the first drive that reports one: [`Fault::Drive`].
    pub drive_fault: Option<Fault>,
    /// Place in the chain, from 0, of the first axis whose drive sends no valid inputs.
    pub silent: Option<u8>,
    /// Fault latched by the critical tasks; the drives are already stopping.
    pub fault: Option<Fault>,
    /// Input that keeps the drives in quick stop.
    pub interlock: Option<Interlock>,
    /// Fault of the first input of a terminal that keeps the drives from getting power: [`Fault::StopInput`].
    pub stop_input: Option<Fault>,
    /// The first input that holds drawings: its place in the configuration's `io`, from 0.
    pub hold_input: Option<u8>,
    /// Whether a start input is closed, and was open before.
    pub start_input: bool,
}

impl Condition {
    /// State before the first report.
    pub const UNKNOWN: Self = Self {
        pose: JointAngles([0.0; AXES]),
        unreferenced: Some(0),
        powered: false,
        unpowered: true,
        searching: false,
        standstill: false,
        drive_fault: None,
        silent: Some(0),
        fault: None,
        interlock: None,
        stop_input: None,
        hold_input: None,
        start_input: false,
    };
}

/// State of the bus as its supervisor reports it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BusCondition {
    /// All drives are operational.
    Operational,
    /// A slave is missing or in another state.
    Failed(Fault),
    /// The supervisor has given up: the bus could not be brought up, or a slave could not be brought back.
    Refused(Fault),
}

/// State of the trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// Whether the trajectory is at rest with nothing left to do and has taken all orders.
    pub idle: bool,
    /// Whether the trajectory is at rest on a held path.
    pub held: bool,
    /// How long a motion that should progress has made no progress, ms; 0 if none has stalled.
    pub stalled_ms: u16,
    /// Vertices of the path fully executed.
    pub executed: u32,
}
