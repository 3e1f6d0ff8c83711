//! etherpen: a robot controller that fits in a microcontroller.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod application;
pub mod config;
pub mod control;
pub mod drives;
pub mod ethercat;
pub mod ethercat_robot;
pub mod ethernet;
pub mod io;
pub mod link;
pub mod motion;
pub mod robot;
