#![doc = include_str!("../README.md")]
//!
//! # Layers
//!
//! A module imports modules of lower layers only.
//!
//! 1. `vector`, `violation`, `telegram`: vectors; the rules by name; frames as a master may send them
//! 2. `robot`: where the tool is for given joint angles
//! 3. `cell`: machine and configuration as numbers
//! 4. `bounds`, `moment`: what follows from the configuration; one millisecond
//! 5. `motion`: the true motion
//! 6. `disturbances`, `drawing`: what is disturbed; what was ordered to be drawn, and the ink
//! 7. `orders`: what the operator ordered, and what is permitted
//! 8. `scene`: everything that is known about a millisecond
//! 9. `rules`: what a controller has to keep
//! 10. `monitor`: takes one millisecond after the other
//!
//! # Invariants
//!
//! - No code is shared with what is judged: this crate depends on nothing.
//! - No input panics, and none makes a later sound input wrong.
//! - Where the monitor cannot know what the controller decided, both decisions are right.
#![forbid(unsafe_code)]

mod bounds;
mod cell;
#[cfg(test)]
mod cost;
mod disturbances;
mod drawing;
#[cfg(test)]
mod fuzz;
mod moment;
mod monitor;
mod motion;
mod orders;
#[cfg(test)]
mod rig;
pub mod robot;
mod rules;
mod scene;
#[cfg(test)]
mod session;
mod telegram;
pub mod vector;
mod violation;

pub use cell::{AXES_MAX, Cell, JointLimits, Paper, WorkArea};
pub use moment::{Clocks, Command, Count, Input, Joint, Mode, Moment, Notice, POSE_AXES, Report, WireFrame};
pub use monitor::Monitor;
pub use robot::Robot;
pub use violation::{Rule, Violation};
