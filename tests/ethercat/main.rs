//! The master against the virtual cell, in virtual time.

#[macro_use]
#[path = "../again/mod.rs"]
mod again;
mod axes;
mod bench;
mod bring_up;
mod clocks;
mod device_images;
mod diagnosis;
mod disturbances;
mod files;
mod frame_faults;
mod homing;
mod odd_controllers;
mod other_masters;
mod own_driver;
mod real_chain;
mod returned;
mod rig;
mod services;
mod several_frames;
mod slave_faults;
mod terminals;
mod without_drivers;
