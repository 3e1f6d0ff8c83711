//! Diagnosis messages that a slave keeps: object 0x10F3 (ETG.1020).
//!
//! Sub-index 1 is the room for messages and 2 the sub-index of the newest; the messages are a ring from sub-index 6 on.

use super::access::{self, AccessError, BusAccess};
use super::value::hex;
use crate::error::ProgramError;
use etherpen::ethercat::diagnostics::ServiceError;
use etherpen::ethercat::wire::coe::Object;
use serde::Serialize;

/// The history.
const HISTORY: u16 = 0x10F3;
/// Sub-indices: room, newest message, and the first message.
const ROOM: u8 = 1;
const NEWEST: u8 = 2;
const FIRST: u8 = 6;
/// Most messages that are read of one slave.
const MESSAGES_MAX: u8 = 8;
/// Bytes of a message before its parameters.
const HEAD: usize = 16;
/// Low word of the code of a message that carries an emergency's error code in the upper word.
const EMERGENCY: u32 = 0xE800;

/// One message.
#[derive(Debug, PartialEq, Eq, Serialize)]
pub(crate) struct MessageView {
    /// Diagnosis code.
    pub(crate) code: u32,
    /// Error code of the emergency (object 0x603F), if the message is about one.
    pub(crate) error_code: Option<u16>,
    /// `information`, `warning`, `error` or `unknown`.
    pub(crate) kind: &'static str,
    /// Number of the text in the slave's description file.
    pub(crate) text_id: u16,
    /// Time of the slave's clock, ns.
    pub(crate) time_ns: u64,
    /// Parameters of the text, as they are on the wire.
    pub(crate) parameters: String,
}

impl MessageView {
    /// Decodes a message; `None` for an empty place.
    fn parse(bytes: &[u8]) -> Option<Self> {
        let (head, parameters) = bytes.split_first_chunk::<HEAD>()?;
        let [c0, c1, c2, c3, f0, _, t0, t1, time @ ..] = *head;
        let code = u32::from_le_bytes([c0, c1, c2, c3]);
        (code != 0).then(|| Self {
            code,
            error_code: (code & 0xFFFF == EMERGENCY).then_some((code >> 16) as u16),
            kind: match f0 & 0x0F {
                0 => "information",
                1 => "warning",
                2 => "error",
                _ => "unknown",
            },
            text_id: u16::from_le_bytes([t0, t1]),
            time_ns: u64::from_le_bytes(time),
            parameters: hex(parameters),
        })
    }

    /// The message in words.
    pub(crate) fn text(&self) -> String {
        let error = self
            .error_code
            .map_or_else(String::new, |code| format!(", error code {code:#06x}"));
        let parameters = match self.parameters.as_str() {
            "" => String::new(),
            bytes => format!(", parameters {bytes}"),
        };
        let seconds = self.time_ns as f64 / 1e9;
        format!(
            "{} {:#010x}{error}, text {:#06x}, at {seconds:.3} s of its clock{parameters}",
            self.kind, self.code, self.text_id
        )
    }
}

/// Reads the newest messages of a slave, from 1, newest first; none if it keeps no history.
///
/// # Errors
/// The bus was lost.
pub(crate) fn read(access: &mut dyn BusAccess, slave: u8) -> Result<Vec<MessageView>, ProgramError> {
    let mut messages = Vec::new();
    let [Some(room), Some(newest)] = [value(access, slave, ROOM)?, value(access, slave, NEWEST)?].map(|bytes| {
        // Both are one byte.
        bytes.and_then(|bytes| bytes.first().copied())
    }) else {
        return Ok(messages);
    };
    let last = FIRST.saturating_add(room.saturating_sub(1));
    if room == 0 || !(FIRST..=last).contains(&newest) {
        return Ok(messages);
    }
    let mut sub = newest;
    for _ in 0..room.min(MESSAGES_MAX) {
        let Some(message) = value(access, slave, sub)?.and_then(|bytes| MessageView::parse(&bytes)) else {
            break;
        };
        messages.push(message);
        sub = if sub == FIRST { last } else { sub - 1 };
    }
    Ok(messages)
}

/// A part of the history; `None` if the slave has none.
fn value(access: &mut dyn BusAccess, slave: u8, sub: u8) -> Result<Option<Vec<u8>>, ProgramError> {
    match access::upload(access, slave, Object::new(HISTORY, sub), false) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(AccessError::Refused(ServiceError::Bus(_))) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::code;
    use etherpen::ethercat::diagnostics::{PIECE_BYTES_MAX, ServiceReply, ServiceRequest};
    use etherpen::ethercat::error::BusError;

    /// A slave's history as its dictionary shows it.
    struct Slave {
        room: u8,
        newest: u8,
        places: Vec<Vec<u8>>,
        is_there: bool,
        is_lost: bool,
    }

    impl Slave {
        /// A ring with `room` places after messages with the codes 1 to `written`.
        fn ring(room: u8, written: u32) -> Self {
            let mut places = vec![Vec::new(); room.into()];
            for code in 1..=written {
                places[(code as usize - 1) % usize::from(room)] = message(code);
            }
            Self {
                room,
                newest: match written.checked_sub(1) {
                    Some(last) => 6 + (last % u32::from(room)) as u8,
                    None => 0,
                },
                places,
                is_there: true,
                is_lost: false,
            }
        }

        fn codes(mut self) -> Vec<u32> {
            let messages = read(&mut self, 1).expect("the bus is there");
            messages.iter().map(|message| message.code).collect()
        }
    }

    impl BusAccess for Slave {
        fn request(&mut self, request: ServiceRequest) -> Result<ServiceReply, AccessError> {
            if self.is_lost {
                return Err(AccessError::Lost(ProgramError::new(code::FAILED, "the cable is out")));
            }
            let ServiceRequest::Upload { object, offset, .. } = request else {
                panic!("{request:?}");
            };
            let value = match object.sub {
                1 => vec![self.room],
                2 => vec![self.newest],
                sub => match self.places.get(usize::from(sub) - 6) {
                    Some(message) => message.clone(),
                    None => vec![],
                },
            };
            if !self.is_there || object.index != 0x10F3 {
                let abort = BusError::SdoAbort {
                    object,
                    code: 0x0602_0000,
                };
                return Err(AccessError::Refused(ServiceError::Bus(abort)));
            }
            let rest = &value[usize::from(offset)..];
            Ok(ServiceReply::Piece {
                total: value.len() as u16,
                piece: rest.iter().copied().take(PIECE_BYTES_MAX).collect(),
            })
        }
    }

    /// An error with this diagnosis code, without parameters.
    fn message(code: u32) -> Vec<u8> {
        let mut bytes = code.to_le_bytes().to_vec();
        bytes.extend([2, 0, 1, 0]);
        bytes.extend(u64::from(code).to_le_bytes());
        bytes
    }

    #[test]
    fn the_newest_eight_messages_of_a_ring_are_read_newest_first() {
        let newest = |last: u32, number: u32| -> Vec<u32> { (0..number).map(|before| last - before).collect() };
        for (room, written, expected) in [
            (8, 0, newest(0, 0)),
            (8, 1, newest(1, 1)),
            (8, 3, newest(3, 3)),
            (8, 8, newest(8, 8)),
            (8, 9, newest(9, 8)),
            (8, 13, newest(13, 8)),
            (8, 800, newest(800, 8)),
            (3, 100, newest(100, 3)),
            (1, 5, newest(5, 1)),
            (20, 7, newest(7, 7)),
            (20, 23, newest(23, 8)),
            (250, 251, newest(251, 8)),
        ] {
            assert_eq!(
                Slave::ring(room, written).codes(),
                expected,
                "{written} messages in {room} places"
            );
        }
    }

    #[test]
    fn a_slave_without_history_and_damaged_contents_give_what_can_be_read() {
        let without = Slave {
            is_there: false,
            ..Slave::ring(8, 5)
        };
        assert_eq!(without.codes(), Vec::<u32>::new());
        for (room, newest) in [(0, 6), (8, 5), (8, 14), (8, 255), (255, 5), (8, 0)] {
            let damaged = Slave {
                room,
                newest,
                ..Slave::ring(8, 5)
            };
            assert_eq!(
                damaged.codes(),
                Vec::<u32>::new(),
                "newest message {newest}, {room} places"
            );
        }
        // The room promises more than the slave keeps: the places behind the last one are empty.
        let promised = Slave {
            room: 255,
            ..Slave::ring(8, 3)
        };
        assert_eq!(promised.codes(), [3, 2, 1]);
        // A message that is cut off, or without a code, ends what can be read.
        for damage in [message(4)[..15].to_vec(), Vec::new(), vec![0; 16]] {
            let mut damaged = Slave::ring(8, 13);
            damaged.places[10 % 8] = damage;
            assert_eq!(damaged.codes(), [13, 12]);
        }
        let mut lost = Slave::ring(8, 5);
        lost.is_lost = true;
        assert!(read(&mut lost, 1).is_err());
    }

    #[test]
    fn a_message_is_decoded_and_an_empty_place_is_none() {
        let mut bytes = vec![0x00, 0xE8, 0x10, 0x23, 0x02, 0x00, 0x34, 0x12];
        bytes.extend(1_500_000_000_u64.to_le_bytes());
        bytes.extend([7, 0]);
        let message = MessageView::parse(&bytes).expect("a message");
        assert_eq!((message.error_code, message.kind), (Some(0x2310), "error"));
        assert_eq!((message.text_id, message.time_ns), (0x1234, 1_500_000_000));
        assert_eq!(
            message.text(),
            "error 0x2310e800, error code 0x2310, text 0x1234, at 1.500 s of its clock, parameters 0700"
        );
        assert_eq!(MessageView::parse(&bytes[..15]), None);
        assert_eq!(MessageView::parse(&[0; 16]), None);
    }
}
