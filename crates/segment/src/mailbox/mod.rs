//! The mailbox of a slave: CANopen over EtherCAT, the objects behind it, and the process data mapped from them.

pub(crate) mod abort;
pub(crate) mod coe;
pub(crate) mod dictionary;
pub(crate) mod live_objects;
pub(crate) mod objects;
pub(crate) mod process_data;
mod sdo_information;
