//! CANopen over EtherCAT: service data objects and emergencies inside a mailbox.
//!
//! The service data of a CoE mailbox start with a two-byte CoE header that names the service. A service data object
//! ([`Sdo`]), information about the object dictionary ([`Information`]) or an [`Emergency`] follows. Layout: IEC
//! 61158-6-12, CoE, and CiA 301 for the SDO command bytes. One structure serves both sides, so that a virtual slave can
//! use it too.
//!
//! Invariant: a parsed message borrows only bytes of its input.

mod information;
mod sdo;

pub use information::{
    ACCESS_MAPPABLE_RX, ACCESS_MAPPABLE_TX, ACCESS_READ, ACCESS_WRITE, EntryDescription, INFORMATION_HEADER_LEN,
    Information, InformationRepr, ObjectDescription, ObjectList, VALUE_INFO_ACCESS,
};
pub use sdo::{SDO_LEN, SEGMENT_DATA_MIN, SEGMENT_HEADER_LEN, Sdo};

use super::{Error, check_len, check_room, read_u8, read_u16, write_bytes};

/// Bytes of the CoE header.
pub const COE_HEADER_LEN: usize = 2;

/// Service numbers of the CoE header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Service {
    /// The slave reports an emergency.
    Emergency = 1,
    /// SDO request of the master.
    SdoRequest = 2,
    /// SDO response of the slave.
    SdoResponse = 3,
    /// Process data through the mailbox, slave to master.
    TxPdo = 4,
    /// Process data through the mailbox, master to slave.
    RxPdo = 5,
    /// Request of the master for process data through the mailbox, slave to master.
    TxPdoRequest = 6,
    /// Request of the slave for process data through the mailbox, master to slave.
    RxPdoRequest = 7,
    /// Information about the object dictionary.
    SdoInformation = 8,
}

impl Service {
    /// Parses the service in the CoE header.
    ///
    /// # Errors
    /// [`Error::Truncated`] or [`Error::Value`] for an unknown service.
    pub fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, COE_HEADER_LEN)?;
        Ok(match read_u16(bytes, 0) >> 12 {
            1 => Self::Emergency,
            2 => Self::SdoRequest,
            3 => Self::SdoResponse,
            4 => Self::TxPdo,
            5 => Self::RxPdo,
            6 => Self::TxPdoRequest,
            7 => Self::RxPdoRequest,
            8 => Self::SdoInformation,
            actual => return Err(Error::Value { actual }),
        })
    }

    fn emit(self, bytes: &mut [u8]) {
        write_bytes(bytes, 0, &((self as u16) << 12).to_le_bytes());
    }
}

/// An object of the dictionary.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Object {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
}

impl Object {
    /// The object `index:sub`.
    pub const fn new(index: u16, sub: u8) -> Self {
        Self { index, sub }
    }
}

/// An emergency message (CiA 301).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Emergency {
    /// Error code of the device profile.
    pub code: u16,
    /// Error register, object 0x1001.
    pub register: u8,
    /// Manufacturer-specific data, five bytes.
    pub data: [u8; 5],
}

impl Emergency {
    /// Length of the message with its CoE header, bytes.
    pub const LEN: usize = COE_HEADER_LEN + 8;

    /// Parses an emergency (CoE header included).
    ///
    /// # Errors
    /// [`Error::Truncated`].
    pub fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, Self::LEN)?;
        let data = core::array::from_fn(|n| read_u8(bytes, 5 + n));
        Ok(Self {
            code: read_u16(bytes, 2),
            register: read_u8(bytes, 4),
            data,
        })
    }

    /// Writes the message with its CoE header.
    ///
    /// # Errors
    /// [`Error::Room`].
    pub fn emit(&self, bytes: &mut [u8]) -> Result<usize, Error> {
        check_room(bytes, Self::LEN)?;
        Service::Emergency.emit(bytes);
        write_bytes(bytes, 2, &self.code.to_le_bytes());
        write_bytes(bytes, 4, &[self.register]);
        write_bytes(bytes, 5, &self.data);
        Ok(Self::LEN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_emergency_survives_emit_and_parse() {
        let emergency = Emergency {
            code: 0x8130,
            register: 0x11,
            data: [1, 2, 3, 4, 5],
        };
        let mut bytes = [0; Emergency::LEN];
        assert_eq!(emergency.emit(&mut bytes), Ok(10));
        assert_eq!(Service::parse(&bytes), Ok(Service::Emergency));
        assert_eq!(Emergency::parse(&bytes), Ok(emergency));
    }

    /// Start of a frame that a servo drive's simulator sent to SOEM: all sub-indices of object 0x1C00.
    const RECORDED: [u8; 49] = [
        0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x01, 0x01, 0x01, 0x01, 0x01, 0x01, 0x88, 0xA4, 0x8C, 0x10, 0x04, 0x06,
        0x01, 0x10, 0x00, 0x14, 0x80, 0x00, 0x00, 0x00, 0x0F, 0x00, 0x00, 0x00, 0x00, 0x13, 0x00, 0x30, 0x51, 0x00,
        0x1C, 0x00, 0x05, 0x00, 0x00, 0x00, 0x04, 0x01, 0x02, 0x03, 0x04, 0x00, 0x00,
    ];

    #[test]
    fn a_recorded_answer_is_taken_apart_from_the_frame_to_the_value() {
        use crate::wire::mailbox::{MailboxRepr, Protocol, service_data};
        use crate::wire::{Address, Command, DatagramRepr, FrameView};
        let mut frame = [0; 156];
        frame[..RECORDED.len()].copy_from_slice(&RECORDED);
        frame[154] = 1;
        let view = FrameView::new_checked(&frame).unwrap();
        let datagram = view.datagrams().next().unwrap().unwrap();
        let repr = DatagramRepr::parse(&datagram).unwrap();
        assert_eq!(
            (repr.command, repr.address),
            (Command::Fprd, Address::station(0x1001, 0x1400))
        );
        assert_eq!((datagram.data().len(), datagram.working_counter()), (128, 1));
        let header = MailboxRepr::parse(datagram.data()).unwrap();
        assert_eq!((header.protocol, header.counter, header.length), (Protocol::Coe, 1, 15));
        let answer = Sdo::parse_response(service_data(datagram.data()).unwrap()).unwrap();
        let object = Object::new(0x1C00, 0);
        assert_eq!(
            answer,
            Sdo::UploadNormal {
                object,
                size: 5,
                data: &[4, 1, 2, 3, 4]
            }
        );
    }
}
