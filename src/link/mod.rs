//! The serial link between the host's tools and the firmware.
//!
//! Both ends use the types of [`protocol`]; frames are COBS with a CRC, the path travels in a window with credit,
//! commands are answered one by one and overtake the path, telemetry is best effort and counts what it drops.

pub mod device;
mod ends;
pub mod frame;
pub mod path;
pub mod ports;
pub mod protocol;
pub mod task;
