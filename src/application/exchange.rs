//! What the application is told once a millisecond, and what it answers.
//!
//! Plain data between the state machine and the tasks around it. Invariant: nothing here decides anything.

use super::Fault;
use crate::board::Interlock;
use crate::motion::MotionCommand;
use crate::robot::{AXES, JointAngles};

/// What the drives are asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Power {
    /// No power.
    #[default]
    Off,
    /// Power, following the references of an epoch.
    On,
    /// Quick stop, then standstill under power.
    QuickStop,
    /// Reset of a drive's fault.
    FaultReset,
}

/// What is to be done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Power of the drives.
    Power(Power),
    /// Forget the latched fault of the critical tasks.
    ClearFault,
    /// Take the present resolver angles as the reference, on the turns nearest to a pose, or to the synchronisation marks.
    TakeReference {
        /// The pose.
        near: Option<JointAngles>,
    },
    /// Start the trajectory from this pose; the references that follow carry the epoch.
    Place {
        /// The pose at rest.
        pose: JointAngles,
        /// Number of this start.
        epoch: u8,
    },
    /// Follow the references of this epoch and of no other.
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
    /// Measured pose; joint angles are true only of a referenced axis.
    pub pose: JointAngles,
    /// The first axis without a reference, from 0.
    pub unreferenced: Option<u8>,
    /// Whether all four drives are in operation enabled.
    pub powered: bool,
    /// Whether no drive has power.
    pub unpowered: bool,
    /// Whether all axes stand still.
    pub standstill: bool,
    /// What the first drive that reports a fault says: [`Fault::Drive`].
    pub drive_fault: Option<Fault>,
    /// The first axis whose drive sends no valid inputs, from 0.
    pub silent: Option<u8>,
    /// Fault latched by the critical tasks; the drives are in quick stop already.
    pub fault: Option<Fault>,
    /// What on the board keeps the drives in quick stop.
    pub interlock: Option<Interlock>,
}

impl Condition {
    /// Nothing was reported yet.
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

/// What the bus's supervisor reports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BusCondition {
    /// All drives are operational.
    Operational,
    /// A slave is missing or in another state.
    Failed(Fault),
    /// The bus could not be brought up, or a slave not be brought back: the supervisor has given up.
    Refused(Fault),
}

/// What the trajectory reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// Whether it is at rest with nothing left to do and has taken all orders.
    pub idle: bool,
    /// Whether it stands on a held path.
    pub held: bool,
    /// For how long a motion that has to go on has made no progress, ms; 0 where there is none that stalls.
    pub stalled_ms: u16,
    /// Vertices of the path fully executed.
    pub executed: u32,
}
