//! Slave configuration: addresses, SII, sync managers, FMMUs, watchdog, objects.
//!
//! Each function is one step from an unknown chain to a slave in SAFEOP. Most slaves need each step only once, but
//! every step may be repeated, so a repair uses the code of the first bring-up.
//!
//! Invariant: steps for one slave touch no other slave, except [`discovery::reset_all`].

pub mod discovery;
pub mod identification;
pub mod information;
pub(crate) mod objects;
pub mod own_data;
mod pre_operational;

pub use objects::{Direction, Entry, PdoChoice, Setting, Windows};
pub use pre_operational::PreOperational;
