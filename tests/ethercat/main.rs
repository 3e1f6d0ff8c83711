//! The master against the virtual cell, in virtual time.

mod bring_up;
mod diagnosis;
mod frame_faults;
mod rig;
mod services;
mod slave_faults;
