//! CANopen over EtherCAT: service data objects and emergencies inside a mailbox.
//!
//! The service data of a CoE mailbox start with a two-byte CoE header; a service data object (SDO) message adds a
//! command byte, the object's index and sub-index and four bytes of data or size. Layout: IEC 61158-6-12, CoE, and
//! CiA 301 for the command bytes. One structure serves both sides, so that a virtual slave can use it too.
//!
//! Invariant: a parsed message borrows only bytes that are there.

use super::{Error, check_len, check_room, read_u8, read_u16, read_u32, write_bytes};
use serde::{Deserialize, Serialize};

/// Bytes of the CoE header.
pub const COE_HEADER_LEN: usize = 2;
/// Bytes of CoE header and SDO header: command, index, sub-index and four bytes of data or size.
pub const SDO_LEN: usize = COE_HEADER_LEN + 8;
/// Bytes of CoE header and the command byte of a segment.
pub const SEGMENT_HEADER_LEN: usize = COE_HEADER_LEN + 1;
/// Fewest bytes of data in a segment; shorter ones are padded and say how many bytes are void.
pub const SEGMENT_DATA_MIN: usize = 7;

/// Service numbers of the CoE header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Service {
    /// The slave reports an emergency.
    Emergency = 1,
    /// The master asks for an SDO.
    SdoRequest = 2,
    /// The slave answers an SDO.
    SdoResponse = 3,
    /// Process data by mailbox, slave to master.
    TxPdo = 4,
    /// Process data by mailbox, master to slave.
    RxPdo = 5,
    /// Information about the object dictionary.
    SdoInformation = 8,
}

impl Service {
    /// Reads the service out of the CoE header.
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
            8 => Self::SdoInformation,
            actual => return Err(Error::Value { actual }),
        })
    }

    fn emit(self, bytes: &mut [u8]) {
        write_bytes(bytes, 0, &((self as u16) << 12).to_le_bytes());
    }
}

/// An object of the dictionary.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
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

/// An SDO message without its CoE header's service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sdo<'a> {
    /// Request to write at most four bytes.
    DownloadExpedited {
        /// What is written.
        object: Object,
        /// The value, 1 to 4 bytes.
        data: &'a [u8],
    },
    /// Request to write more; `data` are the first bytes, the rest follows in segments.
    DownloadNormal {
        /// What is written.
        object: Object,
        /// Bytes of the whole value.
        size: u32,
        /// The first bytes of the value.
        data: &'a [u8],
    },
    /// Answer to a download.
    DownloadDone {
        /// What was written.
        object: Object,
    },
    /// A further part of a download.
    DownloadSegment {
        /// Alternates, beginning with `false`.
        toggle: bool,
        /// No more follow.
        last: bool,
        /// This part.
        data: &'a [u8],
    },
    /// Answer to a part of a download.
    DownloadSegmentDone {
        /// That of the request.
        toggle: bool,
    },
    /// Request to read.
    Upload {
        /// What is to be read.
        object: Object,
    },
    /// Answer to an upload with at most four bytes.
    UploadExpedited {
        /// What was read.
        object: Object,
        /// The value, 1 to 4 bytes.
        data: &'a [u8],
    },
    /// Answer to an upload; the rest is fetched in segments when `size` is more than `data` holds.
    UploadNormal {
        /// What was read.
        object: Object,
        /// Bytes of the whole value.
        size: u32,
        /// The first bytes of the value.
        data: &'a [u8],
    },
    /// Request for a further part of an upload.
    UploadSegment {
        /// Alternates, beginning with `false`.
        toggle: bool,
    },
    /// A further part of an upload.
    UploadSegmentData {
        /// That of the request.
        toggle: bool,
        /// No more follow.
        last: bool,
        /// This part.
        data: &'a [u8],
    },
    /// Either side gives up.
    Abort {
        /// What was to be transferred.
        object: Object,
        /// Why, see the abort codes of CiA 301.
        code: u32,
    },
}

const SPECIFIER_SHIFT: u8 = 5;
const SIZE_BIT: u8 = 1;
const EXPEDITED_BIT: u8 = 1 << 1;
const TOGGLE_BIT: u8 = 1 << 4;
const LAST_BIT: u8 = 1;

/// The data of an expedited transfer: as many of the four bytes as the command byte says.
fn expedited(bytes: &[u8], command: u8) -> &[u8] {
    let unused = if command & SIZE_BIT != 0 {
        usize::from(command >> 2 & 3)
    } else {
        0
    };
    bytes.get(6..SDO_LEN - unused).unwrap_or(&[])
}

/// The data of a segment: all that follow, or as many of seven as the command byte says.
fn segment(bytes: &[u8], command: u8) -> &[u8] {
    let data = bytes.get(SEGMENT_HEADER_LEN..).unwrap_or(&[]);
    if data.len() > SEGMENT_DATA_MIN {
        return data;
    }
    let unused = usize::from(command >> 1 & 7);
    data.get(..SEGMENT_DATA_MIN.saturating_sub(unused).min(data.len()))
        .unwrap_or(&[])
}

impl<'a> Sdo<'a> {
    /// Reads a request of a master (CoE header included).
    ///
    /// # Errors
    /// [`Error::Truncated`] or [`Error::Value`] for an unknown command byte.
    pub fn parse_request(bytes: &'a [u8]) -> Result<Self, Error> {
        check_len(bytes, SEGMENT_HEADER_LEN)?;
        let command = read_u8(bytes, 2);
        let toggle = command & TOGGLE_BIT != 0;
        match command >> SPECIFIER_SHIFT {
            0 => {
                let last = command & LAST_BIT != 0;
                return Ok(Self::DownloadSegment {
                    toggle,
                    last,
                    data: segment(bytes, command),
                });
            }
            3 => return Ok(Self::UploadSegment { toggle }),
            _ => check_len(bytes, SDO_LEN)?,
        }
        let object = Object::new(read_u16(bytes, 3), read_u8(bytes, 5));
        Ok(match command >> SPECIFIER_SHIFT {
            1 if command & EXPEDITED_BIT != 0 => Self::DownloadExpedited {
                object,
                data: expedited(bytes, command),
            },
            1 => Self::DownloadNormal {
                object,
                size: read_u32(bytes, 6),
                data: bytes.get(SDO_LEN..).unwrap_or(&[]),
            },
            2 => Self::Upload { object },
            4 => Self::Abort {
                object,
                code: read_u32(bytes, 6),
            },
            _ => {
                return Err(Error::Value {
                    actual: u16::from(command),
                });
            }
        })
    }

    /// Reads an answer of a slave (CoE header included).
    ///
    /// # Errors
    /// [`Error::Truncated`] or [`Error::Value`] for an unknown command byte.
    pub fn parse_response(bytes: &'a [u8]) -> Result<Self, Error> {
        check_len(bytes, SEGMENT_HEADER_LEN)?;
        let command = read_u8(bytes, 2);
        let toggle = command & TOGGLE_BIT != 0;
        match command >> SPECIFIER_SHIFT {
            0 => {
                let last = command & LAST_BIT != 0;
                return Ok(Self::UploadSegmentData {
                    toggle,
                    last,
                    data: segment(bytes, command),
                });
            }
            1 => return Ok(Self::DownloadSegmentDone { toggle }),
            _ => check_len(bytes, SDO_LEN)?,
        }
        let object = Object::new(read_u16(bytes, 3), read_u8(bytes, 5));
        Ok(match command >> SPECIFIER_SHIFT {
            2 if command & EXPEDITED_BIT != 0 => Self::UploadExpedited {
                object,
                data: expedited(bytes, command),
            },
            2 => Self::UploadNormal {
                object,
                size: read_u32(bytes, 6),
                data: bytes.get(SDO_LEN..).unwrap_or(&[]),
            },
            3 => Self::DownloadDone { object },
            4 => Self::Abort {
                object,
                code: read_u32(bytes, 6),
            },
            _ => {
                return Err(Error::Value {
                    actual: u16::from(command),
                });
            }
        })
    }

    /// Bytes of the message with its CoE header.
    pub fn len(&self) -> usize {
        match self {
            Self::DownloadNormal { data, .. } | Self::UploadNormal { data, .. } => SDO_LEN + data.len(),
            Self::DownloadSegment { data, .. } | Self::UploadSegmentData { data, .. } => {
                SEGMENT_HEADER_LEN + data.len().max(SEGMENT_DATA_MIN)
            }
            _ => SDO_LEN,
        }
    }

    /// Never: a message has a header at least.
    pub const fn is_empty(&self) -> bool {
        false
    }

    /// Whether it is a slave's message; an abort counts as a master's here.
    const fn is_response(&self) -> bool {
        matches!(
            self,
            Self::DownloadDone { .. }
                | Self::DownloadSegmentDone { .. }
                | Self::UploadExpedited { .. }
                | Self::UploadNormal { .. }
                | Self::UploadSegmentData { .. }
        )
    }

    /// Writes the message with its CoE header; an abort as a request, which is what both sides use (CiA 301). Gives its
    /// length in bytes.
    ///
    /// # Errors
    /// [`Error::Room`], or [`Error::Value`] when expedited data are not 1 to 4 bytes.
    pub fn emit(&self, bytes: &mut [u8]) -> Result<usize, Error> {
        let length = self.len();
        check_room(bytes, length)?;
        let target = bytes.get_mut(..length).unwrap_or(&mut []);
        target.fill(0);
        if self.is_response() {
            Service::SdoResponse
        } else {
            Service::SdoRequest
        }
        .emit(target);
        let head = |target: &mut [u8], command: u8, object: Object| {
            write_bytes(target, 2, &[command]);
            write_bytes(target, 3, &object.index.to_le_bytes());
            write_bytes(target, 5, &[object.sub]);
        };
        match *self {
            Self::DownloadExpedited { object, data } | Self::UploadExpedited { object, data } => {
                if data.is_empty() || data.len() > 4 {
                    return Err(Error::Value {
                        actual: data.len() as u16,
                    });
                }
                let specifier = if self.is_response() { 2 } else { 1 };
                let unused = (4 - data.len() as u8) << 2;
                head(
                    target,
                    specifier << SPECIFIER_SHIFT | unused | EXPEDITED_BIT | SIZE_BIT,
                    object,
                );
                write_bytes(target, 6, data);
            }
            Self::DownloadNormal { object, size, data } | Self::UploadNormal { object, size, data } => {
                let specifier = if self.is_response() { 2 } else { 1 };
                head(target, specifier << SPECIFIER_SHIFT | SIZE_BIT, object);
                write_bytes(target, 6, &size.to_le_bytes());
                write_bytes(target, SDO_LEN, data);
            }
            Self::DownloadSegment { toggle, last, data } | Self::UploadSegmentData { toggle, last, data } => {
                let unused = SEGMENT_DATA_MIN.saturating_sub(data.len()) as u8;
                let command = u8::from(toggle) << 4 | unused << 1 | u8::from(last);
                write_bytes(target, 2, &[command]);
                write_bytes(target, SEGMENT_HEADER_LEN, data);
            }
            Self::DownloadDone { object } => head(target, 3 << SPECIFIER_SHIFT, object),
            Self::DownloadSegmentDone { toggle } => {
                write_bytes(target, 2, &[1 << SPECIFIER_SHIFT | u8::from(toggle) << 4]);
            }
            Self::Upload { object } => head(target, 2 << SPECIFIER_SHIFT, object),
            Self::UploadSegment { toggle } => {
                write_bytes(target, 2, &[3 << SPECIFIER_SHIFT | u8::from(toggle) << 4]);
            }
            Self::Abort { object, code } => {
                head(target, 4 << SPECIFIER_SHIFT, object);
                write_bytes(target, 6, &code.to_le_bytes());
            }
        }
        Ok(length)
    }
}

/// An emergency message (CiA 301).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Emergency {
    /// Error code of the device profile.
    pub code: u16,
    /// Error register, object 0x1001.
    pub register: u8,
    /// Five bytes of the manufacturer.
    pub data: [u8; 5],
}

impl Emergency {
    /// Bytes of the message with its CoE header.
    pub const LEN: usize = COE_HEADER_LEN + 8;

    /// Reads an emergency (CoE header included).
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

    fn round_trip(message: Sdo<'_>) {
        let mut bytes = [0xAA; 64];
        let length = message.emit(&mut bytes).unwrap();
        let parsed = if message.is_response() {
            assert_eq!(Service::parse(&bytes), Ok(Service::SdoResponse));
            Sdo::parse_response(&bytes[..length])
        } else {
            assert_eq!(Service::parse(&bytes), Ok(Service::SdoRequest));
            Sdo::parse_request(&bytes[..length])
        };
        assert_eq!(parsed, Ok(message));
        assert!(message.emit(&mut bytes[..length - 1]).is_err());
    }

    #[test]
    fn every_message_survives_emit_and_parse() {
        let object = Object::new(0x1C12, 1);
        for length in 1..=4 {
            round_trip(Sdo::DownloadExpedited {
                object,
                data: &[1, 2, 3, 4][..length],
            });
            round_trip(Sdo::UploadExpedited {
                object,
                data: &[1, 2, 3, 4][..length],
            });
        }
        round_trip(Sdo::DownloadNormal {
            object,
            size: 300,
            data: &[9; 20],
        });
        round_trip(Sdo::UploadNormal {
            object,
            size: 7,
            data: b"AX2000!",
        });
        round_trip(Sdo::DownloadDone { object });
        round_trip(Sdo::Upload { object });
        round_trip(Sdo::Abort {
            object,
            code: 0x0601_0002,
        });
        for toggle in [false, true] {
            round_trip(Sdo::UploadSegment { toggle });
            round_trip(Sdo::DownloadSegmentDone { toggle });
            for length in [0, 1, 6, 7, 8, 40] {
                round_trip(Sdo::UploadSegmentData {
                    toggle,
                    last: !toggle,
                    data: &[5; 40][..length],
                });
                round_trip(Sdo::DownloadSegment {
                    toggle,
                    last: toggle,
                    data: &[5; 40][..length],
                });
            }
        }
    }

    #[test]
    fn an_expedited_write_has_the_bytes_of_the_standard() {
        let mut bytes = [0; SDO_LEN];
        let message = Sdo::DownloadExpedited {
            object: Object::new(0x6060, 0),
            data: &[0xFE],
        };
        assert_eq!(message.emit(&mut bytes), Ok(10));
        assert_eq!(bytes, [0x00, 0x20, 0x2F, 0x60, 0x60, 0x00, 0xFE, 0, 0, 0]);
    }

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
        use crate::ethercat::wire::mailbox::{MailboxRepr, Protocol, service_data};
        use crate::ethercat::wire::{Address, Command, DatagramRepr, FrameView};
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

    #[test]
    fn no_byte_pattern_panics() {
        for command in 0..=255 {
            for length in 0..16 {
                let bytes = [command; 16];
                let _ = Sdo::parse_request(&bytes[..length]);
                if let Ok(Sdo::UploadSegmentData { data, .. }) = Sdo::parse_response(&bytes[..length]) {
                    assert!(data.len() + SEGMENT_HEADER_LEN <= length);
                }
            }
        }
    }
}
