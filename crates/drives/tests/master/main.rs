//! The master with drives: bring-up, loss and repair against a small chain that answers at once.

mod bring_up;
mod drives;
mod fake;
mod identity;
mod odd_devices;
mod repair;
mod rig;
mod services;
