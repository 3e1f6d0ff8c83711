//! Reading and writing a slave's objects by SDO.
//!
//! Values of up to four bytes travel in one message, longer ones in one message as far as it reaches and then in
//! segments. Protocol: CiA 301, in the mailbox of IEC 61158-6-12.
//!
//! Invariant: an abort of the slave reaches the caller with object and code; no transfer is longer than its buffer.

use super::acyclic::{AcyclicPort, Bytes};
use super::error::BusError;
use super::mailbox::Mailbox;
use super::wire::coe::{Object, SDO_LEN, SEGMENT_DATA_MIN, SEGMENT_HEADER_LEN, Sdo, Service};
use super::wire::mailbox::Protocol;
use super::wire::read_u32;

/// Most segments of one transfer.
const SEGMENTS_MAX: usize = 128;
/// Longest message that is built here: an SDO with at most four bytes.
const MESSAGE_MAX: usize = if SDO_LEN > SEGMENT_HEADER_LEN + SEGMENT_DATA_MIN {
    SDO_LEN
} else {
    SEGMENT_HEADER_LEN + SEGMENT_DATA_MIN
};

/// One slave's object dictionary, reached through its mailbox.
pub struct ObjectDictionary<'c, 'q, const MESSAGE: usize> {
    port: &'c mut AcyclicPort<'q, MESSAGE>,
    mailbox: &'c mut Mailbox,
}

impl<'c, 'q, const MESSAGE: usize> ObjectDictionary<'c, 'q, MESSAGE> {
    /// The dictionary behind `mailbox`.
    pub fn new(port: &'c mut AcyclicPort<'q, MESSAGE>, mailbox: &'c mut Mailbox) -> Self {
        Self { port, mailbox }
    }

    /// Reads an object of at most `MESSAGE` bytes.
    ///
    /// # Errors
    /// [`BusError::SdoAbort`], [`BusError::SdoAnswer`], [`BusError::SdoLength`], or those of the mailbox.
    pub async fn upload(&mut self, object: Object) -> Result<Bytes<MESSAGE>, BusError> {
        let mut value = Bytes::new();
        let answer = self
            .ask(
                object,
                &Sdo::Upload {
                    object,
                    complete: false,
                },
            )
            .await?;
        let size = match Sdo::parse_response(&answer) {
            Ok(Sdo::UploadExpedited { data, .. }) => {
                append(&mut value, data, object)?;
                return Ok(value);
            }
            Ok(Sdo::UploadNormal { size, data, .. }) => {
                let here = data.get(..data.len().min(size as usize)).unwrap_or(data);
                append(&mut value, here, object)?;
                size
            }
            _ => return Err(BusError::SdoAnswer { object }),
        };
        let mut toggle = false;
        for _ in 0..SEGMENTS_MAX {
            if value.len() >= size as usize {
                break;
            }
            let answer = self.ask(object, &Sdo::UploadSegment { toggle }).await?;
            let Ok(Sdo::UploadSegmentData { last, data, .. }) = Sdo::parse_response(&answer) else {
                return Err(BusError::SdoAnswer { object });
            };
            append(&mut value, data, object)?;
            toggle = !toggle;
            if last {
                break;
            }
        }
        if value.len() == size as usize {
            return Ok(value);
        }
        Err(BusError::SdoLength {
            object,
            expected: size,
            actual: value.len() as u32,
        })
    }

    /// Reads an object of `length` bytes (1 to 4) as an unsigned number.
    ///
    /// # Errors
    /// [`BusError::SdoLength`] when it has another length, or as [`Self::upload`].
    pub async fn read(&mut self, object: Object, length: u8) -> Result<u32, BusError> {
        let value = self.upload(object).await?;
        if value.len() != usize::from(length) {
            return Err(BusError::SdoLength {
                object,
                expected: length.into(),
                actual: value.len() as u32,
            });
        }
        let mut padded = [0; 4];
        super::wire::write_bytes(&mut padded, 0, &value);
        Ok(read_u32(&padded, 0))
    }

    /// Writes the `length` (1 to 4) low bytes of `value` to an object.
    ///
    /// # Errors
    /// [`BusError::SdoAbort`], [`BusError::SdoAnswer`], or those of the mailbox.
    pub async fn write(&mut self, object: Object, value: u32, length: u8) -> Result<(), BusError> {
        let value = value.to_le_bytes();
        let data = value.get(..usize::from(length.clamp(1, 4))).unwrap_or(&value);
        let answer = self
            .ask(
                object,
                &Sdo::DownloadExpedited {
                    object,
                    complete: false,
                    data,
                },
            )
            .await?;
        match Sdo::parse_response(&answer) {
            Ok(Sdo::DownloadDone { .. }) => Ok(()),
            _ => Err(BusError::SdoAnswer { object }),
        }
    }

    /// Sends a request and gives the answer that belongs to `object`; an abort becomes an error.
    async fn ask(&mut self, object: Object, request: &Sdo<'_>) -> Result<Bytes<MESSAGE>, BusError> {
        let mut message = [0; MESSAGE_MAX];
        let Ok(length) = request.emit(&mut message) else {
            return Err(BusError::Range { object });
        };
        let message = message.get(..length).unwrap_or(&[]);
        let answer = self
            .mailbox
            .exchange(self.port, Protocol::Coe, message, |data| belongs(data, request, object))
            .await?;
        match Sdo::parse_response(&answer) {
            Ok(Sdo::Abort { code, .. }) => Err(BusError::SdoAbort { object, code }),
            _ => Ok(answer),
        }
    }
}

/// Whether a CoE message answers `request` for `object`; an answer to an earlier request does not.
fn belongs(data: &[u8], request: &Sdo<'_>, object: Object) -> bool {
    if !matches!(Service::parse(data), Ok(Service::SdoResponse | Service::SdoRequest)) {
        return false;
    }
    match (request, Sdo::parse_response(data)) {
        (_, Ok(Sdo::Abort { object: theirs, .. }))
        | (
            Sdo::Upload { .. },
            Ok(Sdo::UploadExpedited { object: theirs, .. } | Sdo::UploadNormal { object: theirs, .. }),
        )
        | (Sdo::DownloadExpedited { .. }, Ok(Sdo::DownloadDone { object: theirs })) => theirs == object,
        (Sdo::UploadSegment { toggle }, Ok(Sdo::UploadSegmentData { toggle: theirs, .. })) => *toggle == theirs,
        _ => false,
    }
}

fn append<const MESSAGE: usize>(value: &mut Bytes<MESSAGE>, data: &[u8], object: Object) -> Result<(), BusError> {
    value.extend_from_slice(data).map_err(|_| BusError::SdoLength {
        object,
        expected: value.capacity() as u32,
        actual: (value.len() + data.len()) as u32,
    })
}

/// Text of an SDO abort code (CiA 301 and IEC 61158-6-12 give the numbers).
pub const fn abort_text(code: u32) -> &'static str {
    match code {
        0x0503_0000 => "toggle bit did not alternate",
        0x0504_0000 => "transfer timed out",
        0x0504_0001 => "command not valid",
        0x0504_0005 => "out of memory",
        0x0601_0000 => "access not supported",
        0x0601_0001 => "object can only be written",
        0x0601_0002 => "object can only be read",
        0x0601_0003 => "sub-index cannot be written while sub-index 0 is not 0",
        0x0601_0004 => "complete access not supported",
        0x0601_0005 => "object too long for the mailbox",
        0x0601_0006 => "object is mapped, writing is blocked",
        0x0602_0000 => "object does not exist",
        0x0604_0041 => "object cannot be mapped",
        0x0604_0042 => "mapped objects are longer than the process data",
        0x0604_0043 => "parameters do not go together",
        0x0604_0047 => "internal conflict of the device",
        0x0606_0000 => "hardware error",
        0x0607_0010 => "length or type does not match",
        0x0607_0012 => "too long",
        0x0607_0013 => "too short",
        0x0609_0011 => "sub-index does not exist",
        0x0609_0030 => "value out of range",
        0x0609_0031 => "value too high",
        0x0609_0032 => "value too low",
        0x0609_0036 => "highest value is below the lowest",
        0x0800_0000 => "general error",
        0x0800_0020 => "value cannot be stored",
        0x0800_0021 => "value cannot be stored: local control",
        0x0800_0022 => "value cannot be stored in this state",
        0x0800_0023 => "no object dictionary",
        _ => "unknown abort code",
    }
}

/// What to try on an SDO abort code.
pub const fn abort_hint(code: u32) -> &'static str {
    match code {
        0x0503_0000 | 0x0504_0000 => "repeat; look for lost frames if it persists",
        0x0601_0000..=0x0601_0002 => "check the direction of the access",
        0x0601_0003 => "set sub-index 0 to 0 first",
        0x0602_0000 | 0x0609_0011 => "check index and sub-index against the device's dictionary",
        0x0607_0010..=0x0607_0013 => "check the object's type and length",
        0x0609_0030..=0x0609_0032 => "check the value against the device's limits",
        0x0601_0006 | 0x0800_0021 | 0x0800_0022 => "go to PREOP and switch the drive off first",
        _ => "look for the object in the device's manual",
    }
}
