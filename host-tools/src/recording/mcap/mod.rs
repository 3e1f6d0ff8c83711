//! The MCAP container: chunks of time-stamped messages with their schemas, in a file that is readable without its end.
//!
//! Written after the format's specification, version 0 (<https://mcap.dev/spec>). A recording needs only a small part:
//! uncompressed chunks, one writer, one reader from the front. The `mcap` crate (0.26) would add twenty crates that are
//! not used otherwise, two of them C libraries. Chunks are not compressed, so a chunk that was cut off can be read up
//! to the cut.
//!
//! Invariant: everything written before the last [`Writer::flush`] can be read, whatever happens afterwards.

mod reader;
mod writer;

pub use reader::{Ending, Message, Notice, Reader, Source};
pub use writer::Writer;

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use std::borrow::Cow;

/// First and last bytes of a file.
pub const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
/// Bytes before the content of a record: its kind and length.
const RECORD_HEAD: usize = 9;
/// The checksum of chunks, attachments and the summary.
const CRC: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISO_HDLC);

/// Kinds of records.
mod kind {
    pub(super) const HEADER: u8 = 0x01;
    pub(super) const FOOTER: u8 = 0x02;
    pub(super) const SCHEMA: u8 = 0x03;
    pub(super) const CHANNEL: u8 = 0x04;
    pub(super) const MESSAGE: u8 = 0x05;
    pub(super) const CHUNK: u8 = 0x06;
    pub(super) const MESSAGE_INDEX: u8 = 0x07;
    pub(super) const CHUNK_INDEX: u8 = 0x08;
    pub(super) const ATTACHMENT: u8 = 0x09;
    pub(super) const ATTACHMENT_INDEX: u8 = 0x0a;
    pub(super) const STATISTICS: u8 = 0x0b;
    pub(super) const METADATA: u8 = 0x0c;
    pub(super) const METADATA_INDEX: u8 = 0x0d;
    pub(super) const SUMMARY_OFFSET: u8 = 0x0e;
    pub(super) const DATA_END: u8 = 0x0f;
}

/// A channel and the schema of its messages; the channel's number is its place in the list of topics, from 1.
#[derive(Clone, Debug)]
pub struct Topic {
    /// Name of the channel, `/sample`.
    pub name: &'static str,
    /// Name of the schema, `package/msg/Type`.
    pub schema_name: &'static str,
    /// The schema, a ROS 2 message definition.
    pub schema: Cow<'static, str>,
}

/// Encoding of the schemas.
const SCHEMA_ENCODING: &str = "ros2msg";
/// Encoding of the messages.
const MESSAGE_ENCODING: &str = "cdr";

#[cfg(test)]
mod tests;
