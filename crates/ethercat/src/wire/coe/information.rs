//! SDO information: lists of indices, objects and their entries in a slave's dictionary.
//!
//! An answer may come in fragments, each with its own header; the header counts the fragments that are left. Only the
//! first fragment of a list starts with the list's number. Layout: IEC 61158-6-12, CoE (SDO information).
//!
//! Invariant: a parsed message borrows only bytes of its input.

use super::{COE_HEADER_LEN, Object, Service};
use crate::wire::{Error, check_len, check_room, read_u8, read_u16, read_u32, write_bytes};

/// Bytes of CoE header and information header.
pub const INFORMATION_HEADER_LEN: usize = COE_HEADER_LEN + 4;

/// [`EntryDescription::access`]: can be read, in PREOP, SAFEOP and OP from the lowest bit on.
pub const ACCESS_READ: u16 = 0b111;
/// [`EntryDescription::access`]: can be written, in PREOP, SAFEOP and OP from the lowest bit on.
pub const ACCESS_WRITE: u16 = 0b111 << 3;
/// [`EntryDescription::access`]: can be mapped to a PDO that the slave receives.
pub const ACCESS_MAPPABLE_RX: u16 = 1 << 6;
/// [`EntryDescription::access`]: can be mapped to a PDO that the slave sends.
pub const ACCESS_MAPPABLE_TX: u16 = 1 << 7;

/// [`EntryDescription::value_info`]: access rights, category and mapping, which take no extra bytes.
pub const VALUE_INFO_ACCESS: u8 = 0b111;
const VALUE_INFO_UNIT: u8 = 1 << 3;
const VALUE_INFO_VALUES: [u8; 3] = [1 << 4, 1 << 5, 1 << 6];
const UNIT_LEN: usize = 4;

const OPCODE_MASK: u8 = 0x7F;
const INCOMPLETE_BIT: u8 = 1 << 7;
const GET_LIST: u8 = 1;
const LIST: u8 = 2;
const GET_OBJECT: u8 = 3;
const OBJECT: u8 = 4;
const GET_ENTRY: u8 = 5;
const ENTRY: u8 = 6;
const ERROR: u8 = 7;
const OBJECT_LEN: usize = 6;
const ENTRY_LEN: usize = 10;

/// Kinds of object lists.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u16)]
pub enum ObjectList {
    /// No indices; the lengths of the five lists.
    Lengths = 0,
    /// All objects.
    #[default]
    All = 1,
    /// Objects that can be mapped to a PDO that the slave receives.
    MappableRx = 2,
    /// Objects that can be mapped to a PDO that the slave sends.
    MappableTx = 3,
    /// Objects to be kept when the device is replaced.
    Backup = 4,
    /// Objects to be written at start-up.
    Settings = 5,
}

/// Description of an object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ObjectDescription<'a> {
    /// Index.
    pub index: u16,
    /// Data type: index of the type area of CiA 301.
    pub data_type: u16,
    /// Highest sub-index.
    pub sub_max: u8,
    /// 7 is a variable, 8 an array, 9 a record (CiA 301).
    pub code: u8,
    /// Name, not terminated.
    pub name: &'a [u8],
}

/// Description of one entry of an object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EntryDescription<'a> {
    /// Index and sub-index.
    pub object: Object,
    /// Which values precede the name.
    pub value_info: u8,
    /// Data type: index of the type area of CiA 301.
    pub data_type: u16,
    /// Bits of the value.
    pub bits: u16,
    /// Access rights, see the `ACCESS_` constants.
    pub access: u16,
    /// Unit, default, lowest and highest value, as far as [`Self::value_info`] announces them, then the name.
    pub data: &'a [u8],
}

impl<'a> EntryDescription<'a> {
    /// The name, not terminated.
    pub fn name(&self) -> &'a [u8] {
        let value_len = usize::from(self.bits).div_ceil(8);
        let values = VALUE_INFO_VALUES
            .iter()
            .filter(|&&bit| self.value_info & bit != 0)
            .count();
        let unit = if self.value_info & VALUE_INFO_UNIT != 0 {
            UNIT_LEN
        } else {
            0
        };
        self.data.get(unit + values * value_len..).unwrap_or(&[])
    }
}

/// An SDO information message without its headers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Information<'a> {
    /// Request for a list.
    GetList {
        /// Number of the list, see [`ObjectList`].
        list: u16,
    },
    /// A fragment of a list.
    List {
        /// Indices, 16 bits each; in the first fragment the list's number comes first.
        data: &'a [u8],
    },
    /// Request for an object's description.
    GetObject {
        /// Index.
        index: u16,
    },
    /// An object's description.
    Object(ObjectDescription<'a>),
    /// Request for an entry's description.
    GetEntry {
        /// Index and sub-index.
        object: Object,
        /// Values requested, see [`EntryDescription::value_info`].
        value_info: u8,
    },
    /// An entry's description.
    Entry(EntryDescription<'a>),
    /// Refusal by the slave.
    Error {
        /// Reason, see the abort codes of CiA 301.
        code: u32,
    },
}

/// A message of the SDO information service, one fragment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InformationRepr<'a> {
    /// Whether further fragments follow.
    pub incomplete: bool,
    /// Number of fragments that follow.
    pub fragments_left: u16,
    /// Content.
    pub body: Information<'a>,
}

impl<'a> InformationRepr<'a> {
    /// A request.
    pub const fn request(body: Information<'a>) -> Self {
        Self {
            incomplete: false,
            fragments_left: 0,
            body,
        }
    }

    /// Parses a message (CoE header included).
    ///
    /// # Errors
    /// [`Error::Truncated`] or [`Error::Value`] for another service or an unknown operation.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, Error> {
        check_len(bytes, INFORMATION_HEADER_LEN)?;
        let service = Service::parse(bytes)?;
        if service != Service::SdoInformation {
            return Err(Error::Value { actual: service as u16 });
        }
        let operation = read_u8(bytes, 2);
        let data = bytes.get(INFORMATION_HEADER_LEN..).unwrap_or(&[]);
        Ok(Self {
            incomplete: operation & INCOMPLETE_BIT != 0,
            fragments_left: read_u16(bytes, 4),
            body: Information::parse(operation & OPCODE_MASK, data)?,
        })
    }

    /// Length of the message with its headers, bytes.
    pub fn len(&self) -> usize {
        INFORMATION_HEADER_LEN + self.body.len()
    }

    /// Always false: a message has at least a header.
    pub const fn is_empty(&self) -> bool {
        false
    }

    /// Writes the message with its headers and returns its length in bytes.
    ///
    /// # Errors
    /// [`Error::Room`].
    pub fn emit(&self, bytes: &mut [u8]) -> Result<usize, Error> {
        let length = self.len();
        check_room(bytes, length)?;
        Service::SdoInformation.emit(bytes);
        let incomplete = if self.incomplete { INCOMPLETE_BIT } else { 0 };
        write_bytes(bytes, 2, &[self.body.operation() | incomplete, 0]);
        write_bytes(bytes, 4, &self.fragments_left.to_le_bytes());
        if let Some(data) = bytes.get_mut(INFORMATION_HEADER_LEN..length) {
            self.body.emit(data);
        }
        Ok(length)
    }
}

impl<'a> Information<'a> {
    fn parse(operation: u8, data: &'a [u8]) -> Result<Self, Error> {
        let needed = match operation {
            LIST => 0,
            GET_LIST | GET_OBJECT => 2,
            GET_ENTRY | ERROR => 4,
            OBJECT => OBJECT_LEN,
            ENTRY => ENTRY_LEN,
            other => {
                return Err(Error::Value {
                    actual: u16::from(other),
                });
            }
        };
        check_len(data, needed)?;
        let first = read_u16(data, 0);
        let object = Object::new(first, read_u8(data, 2));
        Ok(match operation {
            LIST => Self::List { data },
            GET_LIST => Self::GetList { list: first },
            GET_OBJECT => Self::GetObject { index: first },
            GET_ENTRY => Self::GetEntry {
                object,
                value_info: read_u8(data, 3),
            },
            ERROR => Self::Error {
                code: read_u32(data, 0),
            },
            OBJECT => Self::Object(ObjectDescription {
                index: first,
                data_type: read_u16(data, 2),
                sub_max: read_u8(data, 4),
                code: read_u8(data, 5),
                name: data.get(OBJECT_LEN..).unwrap_or(&[]),
            }),
            _ => Self::Entry(EntryDescription {
                object,
                value_info: read_u8(data, 3),
                data_type: read_u16(data, 4),
                bits: read_u16(data, 6),
                access: read_u16(data, 8),
                data: data.get(ENTRY_LEN..).unwrap_or(&[]),
            }),
        })
    }

    const fn operation(&self) -> u8 {
        match self {
            Self::GetList { .. } => GET_LIST,
            Self::List { .. } => LIST,
            Self::GetObject { .. } => GET_OBJECT,
            Self::Object(_) => OBJECT,
            Self::GetEntry { .. } => GET_ENTRY,
            Self::Entry(_) => ENTRY,
            Self::Error { .. } => ERROR,
        }
    }

    fn len(&self) -> usize {
        match self {
            Self::GetList { .. } | Self::GetObject { .. } => 2,
            Self::GetEntry { .. } | Self::Error { .. } => 4,
            Self::List { data } => data.len(),
            Self::Object(description) => OBJECT_LEN + description.name.len(),
            Self::Entry(description) => ENTRY_LEN + description.data.len(),
        }
    }

    /// Writes the message behind its headers; `data` has its exact length.
    fn emit(&self, data: &mut [u8]) {
        match self {
            Self::GetList { list: number } | Self::GetObject { index: number } => {
                write_bytes(data, 0, &number.to_le_bytes());
            }
            Self::List { data: indices } => write_bytes(data, 0, indices),
            Self::GetEntry { object, value_info } => {
                write_bytes(data, 0, &object.index.to_le_bytes());
                write_bytes(data, 2, &[object.sub, *value_info]);
            }
            Self::Error { code } => write_bytes(data, 0, &code.to_le_bytes()),
            Self::Object(description) => {
                write_bytes(data, 0, &description.index.to_le_bytes());
                write_bytes(data, 2, &description.data_type.to_le_bytes());
                write_bytes(data, 4, &[description.sub_max, description.code]);
                write_bytes(data, OBJECT_LEN, description.name);
            }
            Self::Entry(description) => {
                write_bytes(data, 0, &description.object.index.to_le_bytes());
                write_bytes(data, 2, &[description.object.sub, description.value_info]);
                write_bytes(data, 4, &description.data_type.to_le_bytes());
                write_bytes(data, 6, &description.bits.to_le_bytes());
                write_bytes(data, 8, &description.access.to_le_bytes());
                write_bytes(data, ENTRY_LEN, description.data);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round_trip(message: InformationRepr<'_>) {
        let mut bytes = [0xAA; 64];
        let length = message.emit(&mut bytes).unwrap();
        assert_eq!(length, message.len());
        assert_eq!(InformationRepr::parse(&bytes[..length]), Ok(message));
        assert!(message.emit(&mut bytes[..length - 1]).is_err());
    }

    #[test]
    fn every_message_survives_emit_and_parse() {
        let object = Object::new(0x1018, 4);
        for body in [
            Information::GetList { list: 1 },
            Information::List { data: &[1, 0, 0, 0x10] },
            Information::List { data: &[] },
            Information::GetObject { index: 0x1018 },
            Information::Object(ObjectDescription {
                index: 0x1018,
                data_type: 0x23,
                sub_max: 4,
                code: 9,
                name: b"Identity",
            }),
            Information::GetEntry {
                object,
                value_info: VALUE_INFO_ACCESS,
            },
            Information::Entry(EntryDescription {
                object,
                value_info: 0,
                data_type: 7,
                bits: 32,
                access: ACCESS_READ,
                data: b"Serial number",
            }),
            Information::Error { code: 0x0602_0000 },
        ] {
            round_trip(InformationRepr::request(body));
            round_trip(InformationRepr {
                incomplete: true,
                fragments_left: 0x0102,
                body,
            });
        }
    }

    #[test]
    fn a_request_for_the_list_of_all_objects_has_the_bytes_of_the_standard() {
        let mut bytes = [0xAA; 8];
        let list = ObjectList::All as u16;
        InformationRepr::request(Information::GetList { list })
            .emit(&mut bytes)
            .unwrap();
        assert_eq!(bytes, [0x00, 0x80, 0x01, 0, 0, 0, 0x01, 0x00]);
    }

    #[test]
    fn an_entrys_name_stands_behind_unit_and_values() {
        let entry = |value_info, bits| EntryDescription {
            value_info,
            bits,
            data: b"unitdefaminimaxiName",
            ..EntryDescription::default()
        };
        assert_eq!(entry(0b111_1111, 32).name(), b"Name");
        assert_eq!(entry(0b000_1111, 32).name(), b"defaminimaxiName");
        assert_eq!(entry(VALUE_INFO_ACCESS, 32).name(), b"unitdefaminimaxiName");
        assert_eq!(entry(0b001_0000, 25).name(), b"defaminimaxiName");
        assert_eq!(
            entry(0b111_1111, u16::MAX).name(),
            b"",
            "a value longer than the message"
        );
    }

    #[test]
    fn other_services_and_operations_are_refused() {
        let mut bytes = [0, 0x80, 8, 0, 0, 0, 0, 0];
        assert_eq!(InformationRepr::parse(&bytes), Err(Error::Value { actual: 8 }));
        bytes[1] = 0x20;
        assert_eq!(InformationRepr::parse(&bytes), Err(Error::Value { actual: 2 }));
        assert_eq!(
            InformationRepr::parse(&bytes[..5]),
            Err(Error::Truncated { expected: 6, actual: 5 })
        );
    }
}
