//! Ways for EtherCAT frames to reach the segment.

pub mod raw;
