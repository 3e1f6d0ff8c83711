//! Diagnosis of an EtherCAT bus: its slaves, their states, objects, registers and error counters.
//!
//! A `connection` carries the requests of `access`: with a master on this computer, or with a running firmware's.
//! The other modules turn the answers into records for people and programs.

pub(crate) mod access;
pub(crate) mod connection;
pub(crate) mod counters;
pub(crate) mod diagnosis;
pub(crate) mod files;
pub(crate) mod objects;
pub(crate) mod process_data;
pub(crate) mod registers;
pub(crate) mod slaves;
pub(crate) mod value;
