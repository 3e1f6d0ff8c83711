//! Packet capture: both directions of the wire as a pcapng file.
//!
//! The minimum of the format (draft-ietf-opsawg-pcapng): a section header, one Ethernet interface with nanosecond time
//! stamps, and an enhanced packet block with its direction for each frame. Blocks are written immediately, so a capture
//! that is cut short is readable up to its last complete block.

use std::io::{self, Write};

const SECTION_HEADER: u32 = 0x0A0D_0D0A;
const INTERFACE_DESCRIPTION: u32 = 1;
const ENHANCED_PACKET: u32 = 6;
const BYTE_ORDER_MAGIC: u32 = 0x1A2B_3C4D;
const LINK_TYPE_ETHERNET: u16 = 1;
const OPTION_END: u16 = 0;
const OPTION_EPB_FLAGS: u16 = 2;
const OPTION_IF_NAME: u16 = 2;
const OPTION_IF_TSRESOL: u16 = 9;
/// Time stamps count 10^-9 s.
const TIME_RESOLUTION_NANOSECONDS: u8 = 9;
const INTERFACE_NAME: &[u8] = b"segment";

/// Direction of a frame, seen from the master.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From the segment to the master.
    Received,
    /// From the master to the segment.
    Sent,
}

/// Writes frames as pcapng to a byte sink.
#[derive(Debug)]
pub struct Capture<W: Write> {
    sink: W,
    block: Vec<u8>,
}

impl<W: Write> Capture<W> {
    /// Starts a capture: writes the section header and the interface.
    ///
    /// # Errors
    /// Error of the sink.
    pub fn new(sink: W) -> io::Result<Self> {
        let mut capture = Self {
            sink,
            block: Vec::new(),
        };
        let mut body = Vec::new();
        body.extend_from_slice(&BYTE_ORDER_MAGIC.to_le_bytes());
        body.extend_from_slice(&1u16.to_le_bytes());
        body.extend_from_slice(&0u16.to_le_bytes());
        body.extend_from_slice(&u64::MAX.to_le_bytes());
        capture.write_block(SECTION_HEADER, &body)?;
        body.clear();
        body.extend_from_slice(&LINK_TYPE_ETHERNET.to_le_bytes());
        body.extend_from_slice(&0u16.to_le_bytes());
        body.extend_from_slice(&0u32.to_le_bytes());
        put_option(&mut body, OPTION_IF_NAME, INTERFACE_NAME);
        put_option(&mut body, OPTION_IF_TSRESOL, &[TIME_RESOLUTION_NANOSECONDS]);
        put_option(&mut body, OPTION_END, &[]);
        capture.write_block(INTERFACE_DESCRIPTION, &body)?;
        Ok(capture)
    }

    /// Adds one Ethernet frame (without its check sequence), with its time in microseconds.
    ///
    /// # Errors
    /// Error of the sink.
    pub fn record(&mut self, time_us: u64, direction: Direction, frame: &[u8]) -> io::Result<()> {
        self.record_ns(time_us.saturating_mul(1_000), direction, frame)
    }

    /// Adds one Ethernet frame (without its check sequence), with its time in nanoseconds: of the caller's clock, or since
    /// 1970.
    ///
    /// # Errors
    /// Error of the sink.
    pub fn record_ns(&mut self, time_ns: u64, direction: Direction, frame: &[u8]) -> io::Result<()> {
        let length = u32::try_from(frame.len()).unwrap_or(u32::MAX);
        let mut body = Vec::with_capacity(frame.len() + 40);
        body.extend_from_slice(&0u32.to_le_bytes());
        body.extend_from_slice(&((time_ns >> 32) as u32).to_le_bytes());
        body.extend_from_slice(&(time_ns as u32).to_le_bytes());
        body.extend_from_slice(&length.to_le_bytes());
        body.extend_from_slice(&length.to_le_bytes());
        body.extend_from_slice(frame);
        pad(&mut body);
        let flags: u32 = match direction {
            Direction::Received => 1,
            Direction::Sent => 2,
        };
        put_option(&mut body, OPTION_EPB_FLAGS, &flags.to_le_bytes());
        put_option(&mut body, OPTION_END, &[]);
        self.write_block(ENHANCED_PACKET, &body)
    }

    /// Flushes the sink.
    ///
    /// # Errors
    /// Error of the sink.
    pub fn flush(&mut self) -> io::Result<()> {
        self.sink.flush()
    }

    /// Ends the capture and returns the sink.
    ///
    /// # Errors
    /// Error of the sink when it is flushed.
    pub fn finish(mut self) -> io::Result<W> {
        self.sink.flush()?;
        Ok(self.sink)
    }

    fn write_block(&mut self, kind: u32, body: &[u8]) -> io::Result<()> {
        let length = u32::try_from(body.len() + 12)
            .map_err(|_| io::Error::new(io::ErrorKind::InvalidInput, "a frame too long for a capture"))?;
        self.block.clear();
        self.block.extend_from_slice(&kind.to_le_bytes());
        self.block.extend_from_slice(&length.to_le_bytes());
        self.block.extend_from_slice(body);
        self.block.extend_from_slice(&length.to_le_bytes());
        self.sink.write_all(&self.block)
    }
}

fn put_option(body: &mut Vec<u8>, code: u16, value: &[u8]) {
    body.extend_from_slice(&code.to_le_bytes());
    body.extend_from_slice(&(value.len() as u16).to_le_bytes());
    body.extend_from_slice(value);
    pad(body);
}

/// Pads to a multiple of four bytes.
fn pad(body: &mut Vec<u8>) {
    body.resize(body.len().next_multiple_of(4), 0);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Type and total length of each block.
    fn blocks(mut file: &[u8]) -> Vec<(u32, usize)> {
        let mut found = Vec::new();
        while file.len() >= 12 {
            let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().expect("four bytes"));
            let length = word(4) as usize;
            assert_eq!(word(length - 4) as usize, length, "the length closes the block");
            found.push((word(0), length));
            file = &file[length..];
        }
        assert!(file.is_empty());
        found
    }

    #[test]
    fn blocks_are_closed_and_aligned() {
        let mut capture = Capture::new(Vec::new()).expect("memory");
        for length in [0usize, 1, 59, 60, 61, 1514] {
            capture.record(7, Direction::Sent, &vec![0xAA; length]).expect("memory");
        }
        let file = capture.finish().expect("memory");
        let blocks = blocks(&file);
        assert_eq!(blocks[0], (SECTION_HEADER, 28));
        assert_eq!(blocks[1].0, INTERFACE_DESCRIPTION);
        assert_eq!(blocks.len(), 8);
        for (length, block) in [0usize, 1, 59, 60, 61, 1514].into_iter().zip(&blocks[2..]) {
            assert_eq!(*block, (ENHANCED_PACKET, 44 + length.next_multiple_of(4)));
        }
    }

    #[test]
    fn time_is_split_into_high_and_low_words() {
        let mut capture = Capture::new(Vec::new()).expect("memory");
        let start = capture.sink.len();
        capture
            .record_ns(0x0001_0000_0002, Direction::Received, &[1, 2, 3])
            .expect("memory");
        let file = capture.finish().expect("memory");
        assert_eq!(file[start + 12..start + 20], [1, 0, 0, 0, 2, 0, 0, 0]);
    }
}
