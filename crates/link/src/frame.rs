//! Frames of the link: COBS(postcard(message), CRC-32 little endian), 0x00.
//!
//! A serial line loses, damages and repeats bytes. COBS keeps 0x00 out of a frame's content, so the receiver is
//! synchronised again at the next 0x00; the CRC decides whether the bytes between two zeros are a message. Invariant:
//! [`Decoder`] returns a message only if its CRC is correct; it counts everything else, and no input makes either side
//! panic.

use crate::message::MESSAGE_BYTES_MAX;
use crc::{CRC_32_ISO_HDLC, Crc};
use postcard::ser_flavors::crc::CrcModifier;
use postcard::ser_flavors::{Cobs, Slice};
use serde::{Serialize, de::DeserializeOwned};

/// Bytes of the CRC behind a message.
pub const CRC_BYTES: usize = 4;
/// Longest message with its CRC, before COBS, bytes.
pub const PAYLOAD_BYTES_MAX: usize = MESSAGE_BYTES_MAX + CRC_BYTES;
/// Longest frame on the wire, bytes: COBS adds one byte for every 254 bytes or part thereof, then the 0x00 follows.
pub const FRAME_BYTES_MAX: usize = PAYLOAD_BYTES_MAX + PAYLOAD_BYTES_MAX / 254 + 2;

/// CRC-32/ISO-HDLC, as in Ethernet and zip (catalogue of parametrised CRC algorithms).
static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Why a frame was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkError {
    /// The encoded message does not fit into the output buffer.
    NoRoom {
        /// Size of the buffer, bytes.
        room_bytes: usize,
    },
    /// More bytes arrived without a 0x00 than the longest frame has.
    Overlong {
        /// The longest payload, bytes.
        limit_bytes: usize,
    },
    /// The 0x00 came inside a COBS block, or before a complete CRC.
    Truncated {
        /// Payload bytes received so far.
        received_bytes: usize,
    },
    /// The CRC does not match the bytes.
    Damaged {
        /// CRC of the bytes received.
        expected: u32,
        /// CRC received in the frame.
        received: u32,
    },
    /// The CRC is correct, but the bytes are not a message of this protocol.
    NoMessage {
        /// Length of the message, bytes.
        length_bytes: usize,
    },
}

/// Encodes a message as one frame into the front of `out` and returns the frame's length in bytes.
///
/// # Errors
/// [`LinkError::NoRoom`] when the frame does not fit; `out` is then undefined.
pub fn encode(message: &impl Serialize, out: &mut [u8]) -> Result<usize, LinkError> {
    let no_room = LinkError::NoRoom { room_bytes: out.len() };
    let cobs = Cobs::try_new(Slice::new(out)).map_err(|_| no_room)?;
    let frame = postcard::serialize_with_flavor(message, CrcModifier::new(cobs, CRC.digest())).map_err(|_| no_room)?;
    Ok(frame.len())
}

/// Reads a message from the payload of a frame; bytes behind the message are ignored.
///
/// # Errors
/// [`LinkError::NoMessage`].
pub fn decode<T: DeserializeOwned>(payload: &[u8]) -> Result<T, LinkError> {
    postcard::from_bytes(payload).map_err(|_| LinkError::NoMessage {
        length_bytes: payload.len(),
    })
}

/// Reads the protocol version from a greeting ([`Hello`](crate::message::Hello) to the firmware,
/// [`Welcome`](crate::message::Welcome) to the host) of any version: both are the first variant of their enum, and
/// the version is their first field.
///
/// Returns `None` if the payload is not a greeting.
pub fn greeting_version(payload: &[u8]) -> Option<u16> {
    let (0u8, rest) = postcard::take_from_bytes(payload).ok()? else {
        return None;
    };
    postcard::take_from_bytes(rest).ok().map(|(version, _)| version)
}

/// Counters of a decoder since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCounts {
    /// Frames with a correct CRC.
    pub good: u32,
    /// Frames that were too long, truncated or damaged.
    pub bad: u32,
}

/// Extracts frames from a stream of bytes.
#[derive(Debug)]
pub struct Decoder<const BYTES: usize = PAYLOAD_BYTES_MAX> {
    payload: [u8; BYTES],
    length: usize,
    /// Bytes still to come in the current COBS block.
    block_left: u8,
    /// Whether a zero belongs between the current block and the next.
    zero_follows: bool,
    begun: bool,
    overlong: bool,
    complete: bool,
    counts: FrameCounts,
}

impl<const BYTES: usize> Default for Decoder<BYTES> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const BYTES: usize> Decoder<BYTES> {
    /// A decoder between two frames.
    pub const fn new() -> Self {
        Self {
            payload: [0; BYTES],
            length: 0,
            block_left: 0,
            zero_follows: false,
            begun: false,
            overlong: false,
            complete: false,
            counts: FrameCounts { good: 0, bad: 0 },
        }
    }

    /// Counters of the frames received.
    pub const fn counts(&self) -> FrameCounts {
        self.counts
    }

    /// Takes one byte. At the end of a frame it returns the payload without the CRC, or why the frame was rejected.
    pub fn push(&mut self, byte: u8) -> Option<Result<&[u8], LinkError>> {
        if self.complete {
            self.restart();
        }
        if byte != 0 {
            self.unstuff(byte);
            return None;
        }
        if !self.begun {
            return None;
        }
        self.complete = true;
        match self.check() {
            Ok(message_bytes) => {
                self.counts.good = self.counts.good.wrapping_add(1);
                self.payload.get(..message_bytes).map(Ok)
            }
            Err(error) => {
                self.counts.bad = self.counts.bad.wrapping_add(1);
                Some(Err(error))
            }
        }
    }

    fn restart(&mut self) {
        self.length = 0;
        self.block_left = 0;
        self.zero_follows = false;
        self.begun = false;
        self.overlong = false;
        self.complete = false;
    }

    fn unstuff(&mut self, byte: u8) {
        self.begun = true;
        if self.block_left > 0 {
            self.block_left -= 1;
            self.store(byte);
            return;
        }
        if self.zero_follows {
            self.store(0);
        }
        self.block_left = byte - 1;
        self.zero_follows = byte != u8::MAX;
    }

    fn store(&mut self, byte: u8) {
        match self.payload.get_mut(self.length) {
            Some(place) => {
                *place = byte;
                self.length += 1;
            }
            None => self.overlong = true,
        }
    }

    /// Length of the message in the payload, bytes.
    fn check(&self) -> Result<usize, LinkError> {
        let truncated = LinkError::Truncated {
            received_bytes: self.length,
        };
        if self.overlong {
            return Err(LinkError::Overlong { limit_bytes: BYTES });
        }
        if self.block_left > 0 {
            return Err(truncated);
        }
        let payload = self.payload.get(..self.length).ok_or(truncated)?;
        let (message, crc) = payload.split_last_chunk::<CRC_BYTES>().ok_or(truncated)?;
        let (expected, received) = (CRC.checksum(message), u32::from_le_bytes(*crc));
        if expected != received {
            return Err(LinkError::Damaged { expected, received });
        }
        Ok(message.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example::{Example, configuration};
    use crate::message::Hello;

    type HostMessage = crate::message::HostMessage<Example>;

    fn messages() -> [HostMessage; 3] {
        [
            HostMessage::Hello(Hello {
                protocol: 3,
                session: 7,
            }),
            HostMessage::Heartbeat,
            HostMessage::Configure {
                id: 1,
                config: configuration(),
            },
        ]
    }

    fn feed<'a>(
        decoder: &mut Decoder,
        bytes: impl IntoIterator<Item = &'a u8>,
    ) -> (heapless::Vec<HostMessage, 4>, usize) {
        let (mut taken, mut errors) = (heapless::Vec::new(), 0);
        for byte in bytes {
            match decoder.push(*byte) {
                Some(Ok(payload)) => taken.push(decode(payload).unwrap()).unwrap(),
                Some(Err(_)) => errors += 1,
                None => {}
            }
        }
        (taken, errors)
    }

    #[test]
    fn messages_come_out_as_they_went_in_and_contain_no_zero_but_the_last() {
        let mut decoder = Decoder::new();
        for message in messages() {
            let mut buffer = [0; FRAME_BYTES_MAX];
            let length = encode(&message, &mut buffer).unwrap();
            assert_eq!(buffer[..length].iter().position(|byte| *byte == 0), Some(length - 1));
            assert_eq!(feed(&mut decoder, &buffer[..length]).0.as_slice(), &[message]);
        }
        assert_eq!(decoder.counts(), FrameCounts { good: 3, bad: 0 });
    }

    #[test]
    fn the_longest_payload_fits_the_longest_frame() {
        for fill in [0u8, 1, 255] {
            let mut decoder: Decoder = Decoder::new();
            let mut buffer = [0; FRAME_BYTES_MAX];
            let message = [fill; MESSAGE_BYTES_MAX - 2];
            let length = encode(&&message[..], &mut buffer).unwrap();
            assert!(length <= FRAME_BYTES_MAX);
            let ends = buffer[..length]
                .iter()
                .filter_map(|byte| decoder.push(*byte).map(|r| r.is_ok()));
            assert!(ends.eq([true]));
        }
    }

    #[test]
    fn a_frame_without_room_is_refused() {
        let mut buffer = [0; 10];
        let message = &messages()[2];
        assert_eq!(encode(message, &mut buffer), Err(LinkError::NoRoom { room_bytes: 10 }));
        assert_eq!(encode(message, &mut []), Err(LinkError::NoRoom { room_bytes: 0 }));
    }

    #[test]
    fn any_one_damaged_byte_costs_its_frame_only_and_is_counted() {
        let mut frame = [0; FRAME_BYTES_MAX];
        let length = encode(&messages()[2], &mut frame).unwrap();
        let mut after = [0; 32];
        let after_length = encode(&HostMessage::Heartbeat, &mut after).unwrap();
        for place in 0..length {
            for flip in [1, 0x80, 0xff] {
                let mut decoder = Decoder::new();
                let mut damaged = frame;
                damaged[place] ^= flip;
                let (taken, errors) = feed(&mut decoder, &damaged[..length]);
                assert!(taken.is_empty() && (errors > 0 || place == length - 1), "byte {place}");
                let (taken, errors) = feed(&mut decoder, [0].iter().chain(&after[..after_length]));
                assert_eq!(taken.as_slice(), &[HostMessage::Heartbeat]);
                assert!(errors <= 1);
            }
        }
    }

    #[test]
    fn overlong_and_truncated_frames_are_named() {
        let mut decoder: Decoder<16> = Decoder::new();
        for _ in 0..100 {
            assert!(decoder.push(0x20).is_none());
        }
        assert_eq!(decoder.push(0), Some(Err(LinkError::Overlong { limit_bytes: 16 })));
        assert!(decoder.push(5).is_none());
        assert_eq!(decoder.push(0), Some(Err(LinkError::Truncated { received_bytes: 0 })));
        assert_eq!(decoder.counts(), FrameCounts { good: 0, bad: 2 });
    }

    #[test]
    fn a_greeting_of_any_version_shows_its_version() {
        assert_eq!(greeting_version(&[0, 9]), Some(9));
        assert_eq!(greeting_version(&[0, 0x80, 0x02, 1, 2, 3]), Some(256));
        assert_eq!(greeting_version(&[1, 9]), None);
        assert_eq!(greeting_version(&[0]), None);
        assert_eq!(greeting_version(&[]), None);
    }
}
