//! The operating mode.

use serde::{Deserialize, Serialize};

/// Operating mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// Waiting for a configuration.
    #[default]
    Startup,
    /// The bus is being brought up.
    BusConfiguring,
    /// The bus is operational; the drives have no power.
    DrivesOff,
    /// The drives hold the pose; the joint angles are not known.
    Unreferenced,
    /// Enabled and at rest.
    Idle,
    /// A jog or a single move.
    Moving,
    /// A path is being drawn.
    Drawing,
    /// A drawing is held on its path.
    Holding,
    /// Decelerating to a standstill, after a cancel or before the drives lose power.
    Stopping,
    /// A fault is latched.
    Fault,
    /// The axes are led to their home switches.
    Homing,
}

impl Mode {
    /// All modes in the order of their numbers, from 0.
    pub const ALL: [Self; 11] = [
        Self::Startup,
        Self::BusConfiguring,
        Self::DrivesOff,
        Self::Unreferenced,
        Self::Idle,
        Self::Moving,
        Self::Drawing,
        Self::Holding,
        Self::Stopping,
        Self::Fault,
        Self::Homing,
    ];

    /// Its number.
    pub const fn number(self) -> u8 {
        self as u8
    }

    /// The mode with a number; `None` beyond the last one.
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }
}
