//! The 1 kHz side: sampler, position and velocity controllers, supervision, monitors of the position feedback.

mod cycle;
pub mod feedback;
pub mod io;
mod limit;
pub mod path_stop;
pub mod pen_switch;
pub mod position;
mod rest;
pub mod robot_axes;
pub mod sampler;
pub mod search;
pub mod supervision;
pub mod tool;
pub mod torque_feedback;
pub mod velocity;
mod window;
