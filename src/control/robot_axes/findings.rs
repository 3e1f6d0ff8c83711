//! What an axis tells: its reading of a cycle, and why it could not be referenced.

use crate::drives::cia402::StatusWord;

/// What an axis reported in this cycle.
#[derive(Clone, Copy, Debug)]
pub struct Reading {
    /// Motor position, unwrapped.
    pub increments: i64,
    /// Joint angle, rad; before there is a reference from where the unwrapping began, good for differences.
    pub angle_rad: f64,
    /// Whether there is a reference.
    pub referenced: bool,
    /// The drive's status word.
    pub status: StatusWord,
}

/// Why an axis could not be referenced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReferenceError {
    /// No position came in this cycle.
    NoPosition {
        /// Axis, from 0.
        axis: u8,
    },
    /// The axis moves.
    Moving {
        /// Axis, from 0.
        axis: u8,
    },
}
