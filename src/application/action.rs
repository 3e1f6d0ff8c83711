//! Actions that the operating modes request from the other tasks.
//!
//! Plain data. Invariant: no code here takes a decision.

use crate::motion::MotionCommand;
use crate::robots::JointAngles;

/// Power state requested from the drives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Power {
    /// No power.
    #[default]
    Off,
    /// Power, following the setpoints of an epoch.
    On,
    /// Quick stop, then standstill under power.
    QuickStop,
    /// Braking on the path as fast as the quick stop's deceleration allows, then [`Power::QuickStop`] at rest; at once
    /// where there is no path to brake on.
    PathStop,
    /// Reset of a drive fault.
    FaultReset,
}

impl Power {
    /// Whether the drives are under power, or stopping.
    pub const fn is_on(self) -> bool {
        matches!(self, Self::On | Self::QuickStop | Self::PathStop)
    }
}

/// A request from the application to the other tasks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Power of the drives.
    Power(Power),
    /// Clear the latched fault of the critical tasks.
    ClearFault,
    /// Home: take the encoders' present angles as the joint angles, where they do not know the turns on those nearest to a
    /// pose, or nearest to the synchronisation marks if there is no pose.
    Home {
        /// The pose.
        near: Option<JointAngles>,
    },
    /// Lead the axes to their home switches, and home them there.
    Search,
    /// End a search early; the axes stop.
    EndSearch,
    /// Start the trajectory from this pose; its setpoints carry the epoch from then on.
    Place {
        /// The pose at rest.
        pose: JointAngles,
        /// Number of this start.
        epoch: u8,
    },
    /// Follow the setpoints of this epoch only.
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
    /// Set an output of a terminal.
    SetOutput {
        /// The output: its place in the configuration's `io`, from 0.
        io: u8,
        /// Its bits.
        value: u32,
    },
}
