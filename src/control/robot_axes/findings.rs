//! Reports of an axis: its reading of a cycle, and why it could not be homed.

use crate::drives::cia402::StatusWord;

/// What an axis reported in this cycle.
#[derive(Clone, Copy, Debug)]
pub struct Reading {
    /// Motor position, unwrapped.
    pub increments: i64,
    /// Joint angle, rad. Before homing it counts from where the unwrapping began, and only differences are valid.
    pub angle_rad: f64,
    /// Whether the axis is homed.
    pub homed: bool,
    /// The drive's status word.
    pub status: StatusWord,
}

/// Why an axis could not be homed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HomingError {
    /// No position arrived in this cycle.
    NoPosition {
        /// Axis, from 0.
        axis: u8,
    },
    /// The axis is moving.
    Moving {
        /// Axis, from 0.
        axis: u8,
    },
}

impl HomingError {
    /// The axis, from 0.
    pub const fn axis(&self) -> u8 {
        match self {
            Self::NoPosition { axis } | Self::Moving { axis } => *axis,
        }
    }
}
