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
    use std::collections::BTreeMap;

    /// A ring for eight messages.
    const EIGHT: u8 = 8;

    /// Slaves of which one, the third, has these entries of object 0x10F3.
    struct Slaves {
        entries: BTreeMap<u8, Vec<u8>>,
        /// Requests until the bus is lost.
        left: usize,
    }

    impl BusAccess for Slaves {
        fn request(&mut self, request: ServiceRequest) -> Result<ServiceReply, AccessError> {
            self.left = self
                .left
                .checked_sub(1)
                .ok_or_else(|| AccessError::Lost(ProgramError::new(code::FAILED, "gone")))?;
            let ServiceRequest::Upload {
                slave, object, offset, ..
            } = request
            else {
                panic!("{request:?}");
            };
            let entry = Some(object)
                .filter(|object| slave == 2 && object.index == HISTORY)
                .and_then(|object| self.entries.get(&object.sub));
            let refused = BusError::SdoAbort {
                object,
                code: 0x0602_0000,
            };
            let value = entry.ok_or(AccessError::Refused(ServiceError::Bus(refused)))?;
            let rest = value.get(usize::from(offset)..).unwrap_or_default();
            let length = rest.len().min(PIECE_BYTES_MAX);
            Ok(ServiceReply::Piece {
                total: value.len() as u16,
                piece: rest[..length].try_into().expect("a piece"),
            })
        }
    }

    /// The message with this number.
    fn message(number: u16) -> Vec<u8> {
        let mut bytes = (u32::from(number) << 16 | EMERGENCY).to_le_bytes().to_vec();
        bytes.extend([0x02, 0x01, 0x01, 0x01]);
        bytes.extend((1_000_000 * u64::from(number)).to_le_bytes());
        bytes.extend([0x06, 0x00, number as u8, 0x00]);
        bytes
    }

    /// A ring of this room after so many messages, numbered from 1.
    fn ring(room: u8, written: u16) -> Slaves {
        let mut entries: BTreeMap<u8, Vec<u8>> = (0..room).map(|place| (FIRST + place, Vec::new())).collect();
        let place = |number: u16| FIRST + ((number - 1) % u16::from(room)) as u8;
        for number in 1..=written {
            entries.insert(place(number), message(number));
        }
        let newest = if written == 0 { 0 } else { place(written) };
        entries.extend([(ROOM, vec![room]), (NEWEST, vec![newest])]);
        Slaves { entries, left: 1_000 }
    }

    /// The numbers of the messages that are read, newest first.
    fn numbers(slaves: &mut Slaves) -> Vec<u16> {
        let messages = read(slaves, 3).expect("the bus is there");
        messages
            .iter()
            .map(|message| message.error_code.expect("an emergency"))
            .collect()
    }

    #[test]
    fn the_ring_is_read_backwards_from_the_newest_across_its_end() {
        assert_eq!(numbers(&mut ring(EIGHT, 1)), [1]);
        assert_eq!(numbers(&mut ring(EIGHT, 3)), [3, 2, 1]);
        assert_eq!(numbers(&mut ring(EIGHT, 8)), [8, 7, 6, 5, 4, 3, 2, 1]);
        for written in 9..=40 {
            let newest_first: Vec<u16> = (written - 7..=written).rev().collect();
            assert_eq!(numbers(&mut ring(EIGHT, written)), newest_first, "{written} messages");
        }
        let told = &read(&mut ring(EIGHT, 11), 3).expect("the bus is there")[0];
        assert_eq!(
            (told.time_ns, told.kind, told.parameters.as_str()),
            (11_000_000, "error", "06000b00")
        );
    }

    #[test]
    fn a_greater_ring_gives_its_newest_eight_and_a_smaller_one_what_it_has() {
        assert_eq!(numbers(&mut ring(20, 47)), [47, 46, 45, 44, 43, 42, 41, 40]);
        assert_eq!(numbers(&mut ring(3, 10)), [10, 9, 8]);
        assert_eq!(numbers(&mut ring(1, 5)), [5]);
        assert_eq!(numbers(&mut ring(250, 1)), [1], "places without a message");
    }

    #[test]
    fn no_message_yet_and_no_history_are_no_messages() {
        assert!(numbers(&mut ring(EIGHT, 0)).is_empty());
        assert!(
            read(&mut ring(EIGHT, 3), 1).expect("the bus is there").is_empty(),
            "another slave"
        );
        let mut without = ring(EIGHT, 3);
        without.entries.remove(&NEWEST);
        assert!(numbers(&mut without).is_empty());
    }

    #[test]
    fn damaged_contents_end_the_list_and_a_lost_bus_is_an_error() {
        let with = |changes: &[(u8, Vec<u8>)]| {
            let mut slaves = ring(EIGHT, 11);
            slaves.entries.extend(changes.iter().cloned());
            slaves
        };
        let (short, none) = (message(9)[..HEAD - 1].to_vec(), vec![0; HEAD]);
        // Of eleven messages the newest is at 8, the one before at 7, and the tenth newest would be at the end of the ring.
        for (what, changes, expected) in [
            ("a message that is cut off", vec![(6, short)], vec![11, 10]),
            ("a message of zeros", vec![(13, none)], vec![11, 10, 9]),
            ("a newest message below the ring", vec![(NEWEST, vec![5])], vec![]),
            ("a newest message behind the ring", vec![(NEWEST, vec![14])], vec![]),
            ("no room", vec![(ROOM, vec![0])], vec![]),
            ("an empty number", vec![(ROOM, vec![])], vec![]),
            (
                "a ring up to the last sub-index",
                vec![(ROOM, vec![255])],
                vec![11, 10, 9],
            ),
        ] {
            assert_eq!(numbers(&mut with(&changes)), expected, "{what}");
        }
        let mut long = with(&[(8, [message(11), vec![0xAA; 700]].concat())]);
        let told = &read(&mut long, 3).expect("the bus is there")[0];
        assert_eq!(told.parameters.len(), 2 * (4 + 700), "in pieces");
        for requests in 0..10 {
            let mut lost = ring(EIGHT, 11);
            lost.left = requests;
            assert!(read(&mut lost, 3).is_err(), "after {requests} requests");
        }
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
