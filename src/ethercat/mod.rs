//! EtherCAT master: finds, configures, exchanges with and repairs the slaves of one segment.
//!
//! Two sides share it. The critical side ([`wire`] only) exchanges process data once a millisecond; the slow side is
//! `async` code that is polled once a millisecond. They meet in lock-free queues, and nothing here allocates, blocks or
//! panics, whatever the wire brings.

pub mod wire;
