//! Transports that carry EtherCAT frames to the segment.

pub mod raw;
