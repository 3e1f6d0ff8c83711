//! The serial link between the host's tools and the firmware.
//!
//! Both ends use the types of [`protocol`]. Frames are COBS with a CRC. The path travels in a window with credit.
//! Commands are answered one by one and overtake the path. Telemetry is best effort and counts the samples that it
//! drops.
//!
//! Invariant: the link carries messages and does not know what they do: no file here imports a task or the coordinator
//! (`tests/layers.rs`).

pub mod device;
pub mod frame;
pub mod path;
pub mod ports;
pub mod protocol;
