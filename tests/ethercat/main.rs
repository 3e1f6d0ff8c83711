//! The master against the virtual cell, in virtual time.

mod bring_up;
mod rig;
mod services;
