//! Service data objects: values read and written by object, in one message or in segments.
//!
//! A message has a command byte, the object's index and sub-index and four bytes of data or size; segments have only
//! the command byte. Complete access transfers all sub-indices at once: sub-index 0 then takes 16 bits, of which the
//! upper byte is padding. Layout: IEC 61158-6-12, CoE, and CiA 301 for the command bytes.
//!
//! Invariant: a parsed message borrows only bytes of its input.

use super::{COE_HEADER_LEN, Object, Service};
use crate::wire::{Error, check_len, check_room, read_u8, read_u16, read_u32, write_bytes};

/// Bytes of CoE header and SDO header: command, index, sub-index and four bytes of data or size.
pub const SDO_LEN: usize = COE_HEADER_LEN + 8;
/// Bytes of CoE header and the command byte of a segment.
pub const SEGMENT_HEADER_LEN: usize = COE_HEADER_LEN + 1;
/// Least data of a segment, bytes; shorter data are padded, and the command byte gives the number of unused bytes.
pub const SEGMENT_DATA_MIN: usize = 7;

/// An SDO message without its CoE header's service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sdo<'a> {
    /// Request to write at most four bytes.
    DownloadExpedited {
        /// The object to write.
        object: Object,
        /// All sub-indices from the object's on.
        complete: bool,
        /// The value, 1 to 4 bytes.
        data: &'a [u8],
    },
    /// Request to write more; `data` are the first bytes, the rest follows in segments.
    DownloadNormal {
        /// The object to write.
        object: Object,
        /// All sub-indices from the object's on.
        complete: bool,
        /// Length of the complete value, bytes.
        size: u32,
        /// The first bytes of the value.
        data: &'a [u8],
    },
    /// Answer to a download.
    DownloadDone {
        /// The object that was written.
        object: Object,
    },
    /// A further part of a download.
    DownloadSegment {
        /// Alternates, beginning with `false`.
        toggle: bool,
        /// Whether this is the last part.
        last: bool,
        /// This part.
        data: &'a [u8],
    },
    /// Answer to a part of a download.
    DownloadSegmentDone {
        /// Toggle bit of the request.
        toggle: bool,
    },
    /// Request to read.
    Upload {
        /// The object to read.
        object: Object,
        /// All sub-indices from the object's on.
        complete: bool,
    },
    /// Answer to an upload with at most four bytes.
    UploadExpedited {
        /// The object that was read.
        object: Object,
        /// The value, 1 to 4 bytes.
        data: &'a [u8],
    },
    /// Answer to an upload; the rest is fetched in segments when `size` is more than `data` holds.
    UploadNormal {
        /// The object that was read.
        object: Object,
        /// Length of the complete value, bytes.
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
        /// Toggle bit of the request.
        toggle: bool,
        /// Whether this is the last part.
        last: bool,
        /// This part.
        data: &'a [u8],
    },
    /// Abort of the transfer by either side.
    Abort {
        /// The object of the transfer.
        object: Object,
        /// Reason, see the abort codes of CiA 301.
        code: u32,
    },
}

const SPECIFIER_SHIFT: u8 = 5;
const SIZE_BIT: u8 = 1;
const EXPEDITED_BIT: u8 = 1 << 1;
const TOGGLE_BIT: u8 = 1 << 4;
const COMPLETE_BIT: u8 = 1 << 4;
const LAST_BIT: u8 = 1;

/// The data of an expedited transfer: as many of the four bytes as the command byte announces.
fn expedited(bytes: &[u8], command: u8) -> &[u8] {
    let unused = if command & SIZE_BIT != 0 {
        usize::from(command >> 2 & 3)
    } else {
        0
    };
    bytes.get(6..SDO_LEN - unused).unwrap_or(&[])
}

/// The data of a segment: all that follow, or as many of seven as the command byte announces.
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
    /// Parses a request of a master (CoE header included).
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
        let complete = command & COMPLETE_BIT != 0;
        Ok(match command >> SPECIFIER_SHIFT {
            1 if command & EXPEDITED_BIT != 0 => Self::DownloadExpedited {
                object,
                complete,
                data: expedited(bytes, command),
            },
            1 => Self::DownloadNormal {
                object,
                complete,
                size: read_u32(bytes, 6),
                data: bytes.get(SDO_LEN..).unwrap_or(&[]),
            },
            2 => Self::Upload { object, complete },
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

    /// Parses a response of a slave (CoE header included).
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

    /// Length of the message with its CoE header, bytes.
    pub fn len(&self) -> usize {
        match self {
            Self::DownloadNormal { data, .. } | Self::UploadNormal { data, .. } => SDO_LEN + data.len(),
            Self::DownloadSegment { data, .. } | Self::UploadSegmentData { data, .. } => {
                SEGMENT_HEADER_LEN + data.len().max(SEGMENT_DATA_MIN)
            }
            _ => SDO_LEN,
        }
    }

    /// Always false: a message has at least a header.
    pub const fn is_empty(&self) -> bool {
        false
    }

    /// Whether the message comes from a slave; an abort counts as a master's message here.
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

    /// Whether the message requests complete access.
    const fn is_complete(&self) -> bool {
        matches!(
            self,
            Self::DownloadExpedited { complete: true, .. }
                | Self::DownloadNormal { complete: true, .. }
                | Self::Upload { complete: true, .. }
        )
    }

    /// Writes the message with its CoE header; an abort is written as a request, as both sides do (CiA 301). Returns
    /// the length in bytes.
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
        let complete = if self.is_complete() { COMPLETE_BIT } else { 0 };
        let initiate = if self.is_response() { 2 } else { 1 } << SPECIFIER_SHIFT | complete;
        match *self {
            Self::DownloadExpedited { object, data, .. } | Self::UploadExpedited { object, data } => {
                if data.is_empty() || data.len() > 4 {
                    return Err(Error::Value {
                        actual: data.len() as u16,
                    });
                }
                let unused = (4 - data.len() as u8) << 2;
                head(target, initiate | unused | EXPEDITED_BIT | SIZE_BIT, object);
                write_bytes(target, 6, data);
            }
            Self::DownloadNormal { object, size, data, .. } | Self::UploadNormal { object, size, data } => {
                head(target, initiate | SIZE_BIT, object);
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
            Self::Upload { object, .. } => head(target, 2 << SPECIFIER_SHIFT | complete, object),
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
                complete: length == 3,
                data: &[1, 2, 3, 4][..length],
            });
            round_trip(Sdo::UploadExpedited {
                object,
                data: &[1, 2, 3, 4][..length],
            });
        }
        round_trip(Sdo::DownloadNormal {
            object,
            complete: true,
            size: 300,
            data: &[9; 20],
        });
        round_trip(Sdo::UploadNormal {
            object,
            size: 7,
            data: b"AX2000!",
        });
        round_trip(Sdo::DownloadDone { object });
        round_trip(Sdo::Upload {
            object,
            complete: false,
        });
        round_trip(Sdo::Upload { object, complete: true });
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
            complete: false,
            data: &[0xFE],
        };
        assert_eq!(message.emit(&mut bytes), Ok(10));
        assert_eq!(bytes, [0x00, 0x20, 0x2F, 0x60, 0x60, 0x00, 0xFE, 0, 0, 0]);
        let whole = Sdo::Upload {
            object: Object::new(0x1C12, 0),
            complete: true,
        };
        assert_eq!(whole.emit(&mut bytes), Ok(10));
        assert_eq!(bytes, [0x00, 0x20, 0x50, 0x12, 0x1C, 0, 0, 0, 0, 0]);
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
