//! File access over EtherCAT (FoE): messages that read and write files of a slave through its mailbox.
//!
//! A message has an operation, a reserved byte and four bytes whose meaning depends on the operation; a name, data or a
//! text follow. Layout and error codes: IEC 61158-6-12, FoE. One structure serves both sides, so that a virtual slave
//! can use it too.
//!
//! Invariant: a parsed message borrows only bytes of its input.

use super::{Error, check_len, check_room, read_u8, read_u16, read_u32, write_bytes};

/// Bytes before name, data or text.
pub const FOE_HEADER_LEN: usize = 6;

const READ: u8 = 1;
const WRITE: u8 = 2;
const DATA: u8 = 3;
const ACKNOWLEDGE: u8 = 4;
const ERROR: u8 = 5;
const BUSY: u8 = 6;

/// Error code: the packet number is wrong.
pub const ERROR_PACKET_NUMBER: u32 = 0x8005;
/// Error code: the message makes no sense here.
pub const ERROR_ILLEGAL: u32 = 0x8004;

/// A message of file access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Foe<'a> {
    /// Asks for a file; answered by the first packet.
    Read {
        /// Password; 0 for none.
        password: u32,
        /// Name of the file.
        name: &'a [u8],
    },
    /// Begins to write a file; answered by an acknowledgement of packet 0.
    Write {
        /// Password; 0 for none.
        password: u32,
        /// Name of the file.
        name: &'a [u8],
    },
    /// A packet of the file. One that does not fill the mailbox is the last.
    Data {
        /// Number of the packet, from 1.
        packet: u32,
        /// Content.
        data: &'a [u8],
    },
    /// Acknowledges a packet.
    Acknowledge {
        /// Number of the packet.
        packet: u32,
    },
    /// Ends the transfer.
    Error {
        /// Reason, see [`error_text`].
        code: u32,
        /// Text of the sender; may be empty.
        text: &'a [u8],
    },
    /// The receiver is not ready; the last message is to be sent again later.
    Busy {
        /// Progress, in parts of `entire`.
        done: u16,
        /// The whole.
        entire: u16,
    },
}

impl<'a> Foe<'a> {
    /// Parses the service data of a mailbox message.
    ///
    /// # Errors
    /// [`Error::Truncated`] or [`Error::Value`] for an unknown operation.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, Error> {
        check_len(bytes, FOE_HEADER_LEN)?;
        let number = read_u32(bytes, 2);
        let rest = bytes.get(FOE_HEADER_LEN..).unwrap_or(&[]);
        Ok(match read_u8(bytes, 0) {
            READ => Self::Read {
                password: number,
                name: rest,
            },
            WRITE => Self::Write {
                password: number,
                name: rest,
            },
            DATA => Self::Data {
                packet: number,
                data: rest,
            },
            ACKNOWLEDGE => Self::Acknowledge { packet: number },
            ERROR => Self::Error {
                code: number,
                text: rest,
            },
            BUSY => Self::Busy {
                done: read_u16(bytes, 2),
                entire: read_u16(bytes, 4),
            },
            other => return Err(Error::Value { actual: other.into() }),
        })
    }

    /// Operation, the four bytes behind the reserved one, and what follows.
    fn parts(&self) -> (u8, [u8; 4], &'a [u8]) {
        match *self {
            Self::Read { password, name } => (READ, password.to_le_bytes(), name),
            Self::Write { password, name } => (WRITE, password.to_le_bytes(), name),
            Self::Data { packet, data } => (DATA, packet.to_le_bytes(), data),
            Self::Acknowledge { packet } => (ACKNOWLEDGE, packet.to_le_bytes(), &[]),
            Self::Error { code, text } => (ERROR, code.to_le_bytes(), text),
            Self::Busy { done, entire } => {
                let [[a, b], [c, d]] = [done.to_le_bytes(), entire.to_le_bytes()];
                (BUSY, [a, b, c, d], &[])
            }
        }
    }

    /// Length of the message, bytes.
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        FOE_HEADER_LEN + self.parts().2.len()
    }

    /// Writes the message.
    ///
    /// # Errors
    /// [`Error::Room`].
    pub fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        check_room(bytes, self.len())?;
        let (operation, number, rest) = self.parts();
        write_bytes(bytes, 0, &[operation, 0]);
        write_bytes(bytes, 2, &number);
        write_bytes(bytes, FOE_HEADER_LEN, rest);
        Ok(())
    }
}

/// Text of an error code.
pub const fn error_text(code: u32) -> &'static str {
    match code {
        0x8001 => "file not found",
        0x8002 => "access denied",
        0x8003 => "disk full",
        0x8004 => "illegal operation",
        0x8005 => "wrong packet number",
        0x8006 => "file exists already",
        0x8007 => "no user",
        0x8008 => "in bootstrap only",
        0x8009 => "not in bootstrap",
        0x800A => "wrong password or no rights",
        0x800B => "program error",
        0x800C => "wrong checksum",
        0x800D => "the firmware does not fit this hardware",
        0x800F => "no file to read",
        0x8010 => "the file header is missing",
        0x8011 => "flash memory error",
        0x8012 => "the file does not fit this device",
        _ => "unknown error",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn messages_are_read_as_they_were_written() {
        for message in [
            Foe::Read {
                password: 7,
                name: b"a.bin",
            },
            Foe::Write {
                password: u32::MAX,
                name: b"",
            },
            Foe::Data {
                packet: 3,
                data: &[1, 2, 3],
            },
            Foe::Acknowledge { packet: 0 },
            Foe::Error {
                code: 0x8001,
                text: b"no",
            },
            Foe::Busy { done: 1, entire: 100 },
        ] {
            let mut bytes = [0xEE; 16];
            assert_eq!(message.emit(&mut bytes), Ok(()));
            assert_eq!(Foe::parse(&bytes[..message.len()]), Ok(message));
            assert!(message.emit(&mut bytes[..message.len() - 1]).is_err());
        }
    }

    #[test]
    fn the_bytes_are_those_of_the_standard() {
        let mut bytes = [0xEE; 8];
        let request = Foe::Read {
            password: 0x0102_0304,
            name: b"fw",
        };
        assert_eq!(request.emit(&mut bytes), Ok(()));
        assert_eq!(bytes, [1, 0, 4, 3, 2, 1, b'f', b'w']);
    }

    #[test]
    fn no_bytes_break_it() {
        let mut random = Random::new(31);
        for _ in 0..10_000 {
            let mut bytes = [0; 12];
            bytes.iter_mut().for_each(|byte| *byte = random.next() as u8 & 7);
            let length = random.next() as usize % 13;
            if let Ok(message) = Foe::parse(&bytes[..length]) {
                assert!(message.len() <= length.max(FOE_HEADER_LEN));
            }
        }
    }
}
