//! The mailbox header: length, sender, priority, protocol and counter.
//!
//! A mailbox is a window in a slave's memory that is written or read as a whole; header and service data are at its
//! start. Layout: IEC 61158-6-12, mailbox.
//!
//! Invariant: a view only returns bytes that the header announces and that exist.

use super::{Error, check_len, check_room, read_u8, read_u16, write_bytes};

/// Bytes of the header.
pub const MAILBOX_HEADER_LEN: usize = 6;
/// Largest counter: counters run from 1 to this value and start again at 1; 0 means that no counter is used.
pub const COUNTER_MAX: u8 = 7;

/// Protocol of a mailbox message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Protocol {
    /// The slave could not process a message.
    Error = 0,
    /// ADS over EtherCAT.
    Aoe = 1,
    /// Ethernet over EtherCAT.
    Eoe = 2,
    /// CAN application protocol over EtherCAT.
    Coe = 3,
    /// File access over EtherCAT.
    Foe = 4,
    /// Servo drive profile over EtherCAT.
    Soe = 5,
    /// Defined by the vendor.
    Voe = 15,
}

impl Protocol {
    /// The protocol with a number on the wire.
    ///
    /// # Errors
    /// [`Error::Value`] for a number without meaning.
    pub const fn from_number(number: u8) -> Result<Self, Error> {
        Ok(match number {
            0 => Self::Error,
            1 => Self::Aoe,
            2 => Self::Eoe,
            3 => Self::Coe,
            4 => Self::Foe,
            5 => Self::Soe,
            15 => Self::Voe,
            other => {
                return Err(Error::Value { actual: other as u16 });
            }
        })
    }
}

/// A mailbox's header in host form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MailboxRepr {
    /// Bytes of service data behind the header.
    pub length: u16,
    /// Station address of the other side; 0 for the master.
    pub address: u16,
    /// Priority, 0 (lowest) to 3.
    pub priority: u8,
    /// Protocol of the service data.
    pub protocol: Protocol,
    /// Counter, 1 to [`COUNTER_MAX`]; 0 if none is used.
    pub counter: u8,
}

impl MailboxRepr {
    /// Reads the header.
    ///
    /// # Errors
    /// [`Error::Truncated`] or [`Error::Value`] for an unknown protocol.
    pub fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, MAILBOX_HEADER_LEN)?;
        let kind = read_u8(bytes, 5);
        Ok(Self {
            length: read_u16(bytes, 0),
            address: read_u16(bytes, 2),
            priority: read_u8(bytes, 4) >> 6,
            protocol: Protocol::from_number(kind & 0x0F)?,
            counter: kind >> 4 & 0x07,
        })
    }

    /// Writes the header.
    ///
    /// # Errors
    /// [`Error::Room`].
    pub fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        check_room(bytes, MAILBOX_HEADER_LEN)?;
        write_bytes(bytes, 0, &self.length.to_le_bytes());
        write_bytes(bytes, 2, &self.address.to_le_bytes());
        write_bytes(
            bytes,
            4,
            &[self.priority << 6, self.protocol as u8 | (self.counter & 0x07) << 4],
        );
        Ok(())
    }
}

/// The service data behind a header, with the length that the header announces.
///
/// # Errors
/// [`Error::Truncated`] when the mailbox is shorter than its header announces.
pub fn service_data(bytes: &[u8]) -> Result<&[u8], Error> {
    check_len(bytes, MAILBOX_HEADER_LEN)?;
    let end = MAILBOX_HEADER_LEN + usize::from(read_u16(bytes, 0));
    bytes.get(MAILBOX_HEADER_LEN..end).ok_or(Error::Truncated {
        expected: end,
        actual: bytes.len(),
    })
}

/// The service data of a [`Protocol::Error`] message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErrorReply {
    /// Why the slave could not process a message, see [`error_text`].
    pub detail: u16,
}

impl ErrorReply {
    /// Bytes of the service data.
    pub const LEN: usize = 4;
    /// The only defined kind of error reply.
    const KIND: u16 = 1;

    /// Parses the service data; a kind other than 1 is accepted too.
    ///
    /// # Errors
    /// [`Error::Truncated`].
    pub fn parse(data: &[u8]) -> Result<Self, Error> {
        check_len(data, Self::LEN)?;
        Ok(Self {
            detail: read_u16(data, 2),
        })
    }

    /// Writes the service data.
    ///
    /// # Errors
    /// [`Error::Room`].
    pub fn emit(&self, data: &mut [u8]) -> Result<(), Error> {
        check_room(data, Self::LEN)?;
        write_bytes(data, 0, &Self::KIND.to_le_bytes());
        write_bytes(data, 2, &self.detail.to_le_bytes());
        Ok(())
    }
}

/// Text of a mailbox error's reason.
pub const fn error_text(detail: u16) -> &'static str {
    match detail {
        1 => "malformed mailbox header",
        2 => "mailbox protocol not supported",
        3 => "mailbox channel does not fit the protocol",
        4 => "service of the protocol not supported",
        5 => "invalid service header",
        6 => "message too short",
        7 => "no memory for the message",
        8 => "length of the message inconsistent",
        9 => "service already in use",
        _ => "unknown mailbox error",
    }
}

/// The counter after `counter`: 1 to 7, then 1 again.
pub const fn next_counter(counter: u8) -> u8 {
    if counter >= COUNTER_MAX { 1 } else { counter + 1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_survives_emit_and_parse() {
        for counter in 0..=COUNTER_MAX {
            let repr = MailboxRepr {
                length: 10,
                address: 0x1001,
                priority: 3,
                protocol: Protocol::Coe,
                counter,
            };
            let mut bytes = [0; 6];
            repr.emit(&mut bytes).unwrap();
            assert_eq!(MailboxRepr::parse(&bytes), Ok(repr));
            assert_eq!(bytes, [10, 0, 0x01, 0x10, 0xC0, 0x03 | counter << 4]);
        }
        assert_eq!(MailboxRepr::parse(&[0, 0, 0, 0, 0, 9]), Err(Error::Value { actual: 9 }));
    }

    #[test]
    fn service_data_never_reach_past_the_window() {
        assert_eq!(service_data(&[2, 0, 0, 0, 0, 3, 7, 8, 9]), Ok(&[7, 8][..]));
        assert_eq!(
            service_data(&[4, 0, 0, 0, 0, 3, 7, 8, 9]),
            Err(Error::Truncated {
                expected: 10,
                actual: 9
            })
        );
    }

    #[test]
    fn an_error_reply_survives_emit_and_parse() {
        let mut data = [0xAA; 4];
        let reply = ErrorReply { detail: 8 };
        reply.emit(&mut data).unwrap();
        assert_eq!((data, ErrorReply::parse(&data)), ([1, 0, 8, 0], Ok(reply)));
        assert!(ErrorReply::parse(&data[1..]).is_err());
    }

    #[test]
    fn counters_skip_zero() {
        let mut counter = 0;
        for expected in [1, 2, 3, 4, 5, 6, 7, 1, 2] {
            counter = next_counter(counter);
            assert_eq!(counter, expected);
        }
    }
}
