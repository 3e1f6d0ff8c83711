//! The master against the virtual cell, in virtual time.

mod bring_up;
mod diagnosis;
mod rig;
mod services;
