//! The robot in the monitor's numbers: each kind has a file of its own.

mod delta;

pub(super) use delta::{ranges_rad, robot};
