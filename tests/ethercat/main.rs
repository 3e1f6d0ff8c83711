//! The master against the virtual cell, in virtual time.

mod bring_up;
mod device_images;
mod diagnosis;
mod files;
mod frame_faults;
mod homing;
mod real_chain;
mod rig;
mod services;
mod slave_faults;
mod terminals;
mod without_drivers;
