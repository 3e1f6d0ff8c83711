//! Interface of the application: what it learns once a millisecond and what it orders.
//!
//! Plain data between the state machine and the tasks around it. Invariant: no code here takes a decision.

use super::Fault;
use crate::board::Interlock;
use crate::motion::MotionCommand;
use crate::robot::{AXES, JointAngles};

/// Power state that the drives are asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Power {
    /// No power.
    #[default]
    Off,
    /// Power, following the references of an epoch.
    On,
    /// Quick stop, then standstill under power.
    QuickStop,
    /// Reset of a drive fault.
    FaultReset,
}

/// An order from the application to the other tasks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Power of the drives.
    Power(Power),
    /// Forget the latched fault of the critical tasks.
    ClearFault,
    /// Take the present resolver angles as the reference, on the turns nearest to a pose, or nearest to the
    /// synchronisation marks if there is no pose.
    TakeReference {
        /// The pose.
        near: Option<JointAngles>,
    },
    /// Start the trajectory from this pose; its references carry the epoch from then on.
    Place {
        /// The pose at rest.
        pose: JointAngles,
        /// Number of this start.
        epoch: u8,
    },
    /// Follow the references of this epoch only.
    Follow {
        /// Number of the start.
        epoch: u8,
    },
    /// Begin a path.
    BeginPath,
    /// Pass a command to the trajectory.
    Motion(MotionCommand),
    /// Bring lost slaves back.
    RecoverBus,
}

/// What the critical tasks report about a millisecond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Condition {
    /// Measured pose; a joint angle is valid only on a referenced axis.
    pub pose: JointAngles,
    /// The first axis without a reference, from 0.
    pub unreferenced: Option<u8>,
    /// Whether all four drives are in operation enabled.
    pub powered: bool,
    /// Whether no drive has power.
    pub unpowered: bool,
    /// Whether all axes are at rest.
    pub standstill: bool,
    /// Fault of the first drive that reports one: [`Fault::Drive`].
    pub drive_fault: Option<Fault>,
    /// The first axis whose drive sends no valid inputs, from 0.
    pub silent: Option<u8>,
    /// Fault latched by the critical tasks; the drives are already in quick stop.
    pub fault: Option<Fault>,
    /// Board input that keeps the drives in quick stop.
    pub interlock: Option<Interlock>,
}

impl Condition {
    /// State before the first report.
    pub const UNKNOWN: Self = Self {
        pose: JointAngles([0.0; AXES]),
        unreferenced: Some(0),
        powered: false,
        unpowered: true,
        standstill: false,
        drive_fault: None,
        silent: Some(0),
        fault: None,
        interlock: None,
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
    /// How long a motion that should go on has made no progress, ms; 0 if none has stalled.
    pub stalled_ms: u16,
    /// Vertices of the path fully executed.
    pub executed: u32,
}
