//! The mailbox of a slave: CANopen over EtherCAT, the objects behind it, the process data mapped from them, and files.

pub(crate) mod abort;
pub(crate) mod coe;
pub(crate) mod dictionary;
pub(crate) mod foe;
pub(crate) mod live_objects;
pub(crate) mod objects;
pub(crate) mod process_data;
mod sdo_information;
