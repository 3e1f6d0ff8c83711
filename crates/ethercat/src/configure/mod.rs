//! Slave configuration: addresses, SII, sync managers, FMMUs, watchdog, objects.
//!
//! Each function is one step from an unknown chain to a slave in SAFEOP. Most slaves need each step only once, but
//! every step may be repeated, so a repair uses the code of the first bring-up.
//!
//! Invariant: steps for one slave touch no other slave, except [`discovery::reset_all`].

pub mod discovery;
pub mod information;
mod pre_operational;
mod process_data;

pub use pre_operational::{PreOperational, ask_device_type};
pub use process_data::{LOGICAL_START, cyclic_slave, process_data};

use discovery::{mailbox_managers, write_managers};
use information::read_sii;
