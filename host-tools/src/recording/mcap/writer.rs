//! Writes an MCAP file chunk by chunk.
//!
//! A chunk is assembled in memory and written with its message indexes in one write. The file is never changed
//! afterwards, so any sink for bytes can be used. Invariant: memory grows by one [`ChunkEntry`] for each chunk only.

use super::{CRC, MAGIC, MESSAGE_ENCODING, RECORD_HEAD, SCHEMA_ENCODING, Topic, kind};
use std::io::{self, Write};

/// Length of a chunk's fields before its records, without compression.
const CHUNK_FIELDS: usize = 8 + 8 + 8 + 4 + 4 + 8;
/// Length of a message's fields before its data.
const MESSAGE_FIELDS: usize = 2 + 4 + 8 + 8;

/// A channel of the file.
struct Channel {
    topic: Topic,
    /// Number of the next message.
    sequence: u32,
    messages: u64,
    /// Times and positions of the messages in the open chunk.
    index: Vec<(u64, u64)>,
}

/// Entry of a chunk in the summary.
struct ChunkEntry {
    start_ns: u64,
    end_ns: u64,
    offset: u64,
    length: u32,
    /// Messages of each channel, in order.
    messages: Box<[u32]>,
}

/// Entry of an attachment or a metadata record in the summary.
struct NamedEntry {
    offset: u64,
    length: u64,
    name: String,
    /// Time, media type and size of an attachment.
    attachment: Option<(u64, String, u64)>,
}

/// Writes one file.
pub struct Writer<W> {
    out: W,
    /// Length of the file so far, bytes.
    length: u64,
    channels: Vec<Channel>,
    /// Records of the open chunk.
    records: Vec<u8>,
    /// First and last time in the open chunk, ns.
    times_ns: Option<(u64, u64)>,
    chunks: Vec<ChunkEntry>,
    named: Vec<NamedEntry>,
}

impl<W: Write> Writer<W> {
    /// Starts a file with schemas and channels, so that a file without its end can be read.
    ///
    /// # Errors
    /// Errors of the sink.
    pub fn new(out: W, topics: &[Topic], library: &str) -> io::Result<Self> {
        let mut writer = Self {
            out,
            length: 0,
            channels: topics.iter().map(channel).collect(),
            records: Vec::new(),
            times_ns: None,
            chunks: Vec::new(),
            named: Vec::new(),
        };
        let mut head = MAGIC.to_vec();
        record(&mut head, kind::HEADER, |content| {
            put_text(content, "");
            put_text(content, library);
        });
        writer.put_channels(&mut head);
        writer.write(&head)?;
        Ok(writer)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(bytes)?;
        self.length += bytes.len() as u64;
        Ok(())
    }

    fn put_channels(&self, out: &mut Vec<u8>) {
        for (id, channel) in (1_u16..).zip(&self.channels) {
            record(out, kind::SCHEMA, |content| {
                content.extend(id.to_le_bytes());
                put_text(content, channel.topic.schema_name);
                put_text(content, SCHEMA_ENCODING);
                put_text(content, &channel.topic.schema);
            });
        }
        for (id, channel) in (1_u16..).zip(&self.channels) {
            record(out, kind::CHANNEL, |content| {
                content.extend(id.to_le_bytes());
                content.extend(id.to_le_bytes());
                put_text(content, channel.topic.name);
                put_text(content, MESSAGE_ENCODING);
                content.extend(0_u32.to_le_bytes());
            });
        }
    }

    /// Adds an attachment.
    ///
    /// # Errors
    /// Errors of the sink.
    pub fn attach(&mut self, name: &str, media_type: &str, data: &[u8], time_ns: u64) -> io::Result<()> {
        let mut bytes = Vec::new();
        record(&mut bytes, kind::ATTACHMENT, |content| {
            let begin = content.len();
            content.extend(time_ns.to_le_bytes());
            content.extend(time_ns.to_le_bytes());
            put_text(content, name);
            put_text(content, media_type);
            content.extend((data.len() as u64).to_le_bytes());
            content.extend(data);
            let crc = CRC.checksum(content.get(begin..).unwrap_or(&[]));
            content.extend(crc.to_le_bytes());
        });
        let details = (time_ns, media_type.to_owned(), data.len() as u64);
        self.write_named(&bytes, name, Some(details))
    }

    /// Adds names and values about the whole file.
    ///
    /// # Errors
    /// Errors of the sink.
    pub fn metadata(&mut self, name: &str, entries: &[(&str, String)]) -> io::Result<()> {
        let mut bytes = Vec::new();
        record(&mut bytes, kind::METADATA, |content| {
            put_text(content, name);
            sized(content, |map| {
                for (key, value) in entries {
                    put_text(map, key);
                    put_text(map, value);
                }
            });
        });
        self.write_named(&bytes, name, None)
    }

    fn write_named(&mut self, bytes: &[u8], name: &str, attachment: Option<(u64, String, u64)>) -> io::Result<()> {
        let offset = self.length;
        self.write(bytes)?;
        self.named.push(NamedEntry {
            offset,
            length: bytes.len() as u64,
            name: name.to_owned(),
            attachment,
        });
        Ok(())
    }

    /// Adds a message to the open chunk; ignored if the channel does not exist. Nothing is written before
    /// [`flush`](Self::flush).
    pub fn message(&mut self, channel: u16, time_ns: u64, data: &[u8]) {
        let place = usize::from(channel).wrapping_sub(1);
        let Some(of) = self.channels.get_mut(place) else {
            return;
        };
        of.index.push((time_ns, self.records.len() as u64));
        self.records.push(kind::MESSAGE);
        self.records
            .extend(((MESSAGE_FIELDS + data.len()) as u64).to_le_bytes());
        self.records.extend(channel.to_le_bytes());
        self.records.extend(of.sequence.to_le_bytes());
        self.records.extend(time_ns.to_le_bytes());
        self.records.extend(time_ns.to_le_bytes());
        self.records.extend(data);
        of.sequence = of.sequence.wrapping_add(1);
        let (first, last) = self.times_ns.unwrap_or((time_ns, time_ns));
        self.times_ns = Some((first.min(time_ns), last.max(time_ns)));
    }

    /// Length of the open chunk, bytes, and the time of its first message, ns.
    pub fn open_chunk(&self) -> (usize, Option<u64>) {
        (self.records.len(), self.times_ns.map(|(first, _)| first))
    }

    /// Length of the file up to the end of its last complete record, bytes.
    pub fn whole_bytes(&self) -> u64 {
        self.length
    }

    /// The sink.
    pub fn sink_mut(&mut self) -> &mut W {
        &mut self.out
    }

    /// Ends the open chunk and writes it; does nothing without messages.
    ///
    /// # Errors
    /// Errors of the sink. The chunk is lost then.
    pub fn flush(&mut self) -> io::Result<()> {
        let Some((start_ns, end_ns)) = self.times_ns.take() else {
            return Ok(());
        };
        let mut head = Vec::with_capacity(RECORD_HEAD + CHUNK_FIELDS);
        let length = (CHUNK_FIELDS + self.records.len()) as u64;
        let size = self.records.len() as u64;
        head.push(kind::CHUNK);
        head.extend(length.to_le_bytes());
        head.extend(start_ns.to_le_bytes());
        head.extend(end_ns.to_le_bytes());
        head.extend(size.to_le_bytes());
        head.extend(CRC.checksum(&self.records).to_le_bytes());
        put_text(&mut head, "");
        head.extend(size.to_le_bytes());
        let chunk_length = head.len() + self.records.len();
        head.append(&mut self.records);
        let messages: Box<[u32]> = self.channels.iter().map(|channel| channel.index.len() as u32).collect();
        for (id, channel) in (1_u16..).zip(&mut self.channels) {
            put_message_index(&mut head, id, &channel.index);
            channel.index.clear();
        }
        let offset = self.length;
        self.write(&head)?;
        for (channel, count) in self.channels.iter_mut().zip(&messages) {
            channel.messages += u64::from(*count);
        }
        // The memory of the written chunk is used for the next one.
        head.clear();
        self.records = head;
        self.chunks.push(ChunkEntry {
            start_ns,
            end_ns,
            offset,
            length: chunk_length as u32,
            messages,
        });
        Ok(())
    }

    /// Writes the rest, the summary and the end; nothing may follow.
    ///
    /// # Errors
    /// Errors of the sink; the file remains readable.
    pub fn finish(&mut self) -> io::Result<()> {
        self.flush()?;
        let mut data_end = Vec::new();
        record(&mut data_end, kind::DATA_END, |content| {
            content.extend(0_u32.to_le_bytes())
        });
        self.write(&data_end)?;
        let mut summary = Vec::new();
        let mut groups = Vec::new();
        self.put_group(&mut summary, &mut groups, kind::SCHEMA, |writer, out| {
            writer.put_channels(out)
        });
        self.put_group(&mut summary, &mut groups, kind::STATISTICS, Self::put_statistics);
        self.put_group(&mut summary, &mut groups, kind::CHUNK_INDEX, Self::put_chunk_indexes);
        self.put_group(&mut summary, &mut groups, kind::ATTACHMENT_INDEX, |writer, out| {
            writer.put_named_indexes(out, true);
        });
        self.put_group(&mut summary, &mut groups, kind::METADATA_INDEX, |writer, out| {
            writer.put_named_indexes(out, false);
        });
        let (start, offsets) = (self.length, self.length + summary.len() as u64);
        for (kind, offset, length) in groups {
            record(&mut summary, kind::SUMMARY_OFFSET, |content| {
                content.push(kind);
                content.extend(offset.to_le_bytes());
                content.extend(length.to_le_bytes());
            });
        }
        summary.push(kind::FOOTER);
        summary.extend((8_u64 + 8 + 4).to_le_bytes());
        summary.extend(start.to_le_bytes());
        summary.extend(offsets.to_le_bytes());
        summary.extend(CRC.checksum(&summary).to_le_bytes());
        summary.extend(MAGIC);
        self.write(&summary)?;
        self.out.flush()
    }

    /// Writes one kind of records into the summary, with their offset. Channels follow their schemas in one group, for
    /// which there are two offsets.
    fn put_group(
        &self,
        summary: &mut Vec<u8>,
        groups: &mut Vec<(u8, u64, u64)>,
        kind: u8,
        put: impl FnOnce(&Self, &mut Vec<u8>),
    ) {
        let begin = summary.len();
        put(self, summary);
        let channels = (kind == kind::SCHEMA).then(|| schemas_length(&self.channels));
        let (offset, length) = (self.length + begin as u64, (summary.len() - begin) as u64);
        match channels {
            _ if length == 0 => {}
            Some(schemas) => {
                groups.push((kind, offset, schemas));
                groups.push((kind::CHANNEL, offset + schemas, length - schemas));
            }
            None => groups.push((kind, offset, length)),
        }
    }

    fn put_statistics(&self, out: &mut Vec<u8>) {
        let attachments = self.named.iter().filter(|entry| entry.attachment.is_some()).count();
        let start_ns = self.chunks.iter().map(|chunk| chunk.start_ns).min().unwrap_or(0);
        let end_ns = self.chunks.iter().map(|chunk| chunk.end_ns).max().unwrap_or(0);
        let messages: u64 = self.channels.iter().map(|channel| channel.messages).sum();
        record(out, kind::STATISTICS, |content| {
            content.extend(messages.to_le_bytes());
            content.extend((self.channels.len() as u16).to_le_bytes());
            content.extend((self.channels.len() as u32).to_le_bytes());
            content.extend((attachments as u32).to_le_bytes());
            content.extend(((self.named.len() - attachments) as u32).to_le_bytes());
            content.extend((self.chunks.len() as u32).to_le_bytes());
            content.extend(start_ns.to_le_bytes());
            content.extend(end_ns.to_le_bytes());
            sized(content, |map| {
                for (id, channel) in (1_u16..).zip(&self.channels) {
                    map.extend(id.to_le_bytes());
                    map.extend(channel.messages.to_le_bytes());
                }
            });
        });
    }

    fn put_chunk_indexes(&self, out: &mut Vec<u8>) {
        for chunk in &self.chunks {
            let size = u64::from(chunk.length) - (RECORD_HEAD + CHUNK_FIELDS) as u64;
            let mut place = chunk.offset + u64::from(chunk.length);
            record(out, kind::CHUNK_INDEX, |content| {
                content.extend(chunk.start_ns.to_le_bytes());
                content.extend(chunk.end_ns.to_le_bytes());
                content.extend(chunk.offset.to_le_bytes());
                content.extend(u64::from(chunk.length).to_le_bytes());
                sized(content, |map| {
                    let present = (1_u16..).zip(&chunk.messages).filter(|(_, count)| **count > 0);
                    for (id, count) in present {
                        map.extend(id.to_le_bytes());
                        map.extend(place.to_le_bytes());
                        place += message_index_length(*count);
                    }
                });
                content.extend((place - chunk.offset - u64::from(chunk.length)).to_le_bytes());
                put_text(content, "");
                content.extend(size.to_le_bytes());
                content.extend(size.to_le_bytes());
            });
        }
    }

    fn put_named_indexes(&self, out: &mut Vec<u8>, attachments: bool) {
        for entry in &self.named {
            match &entry.attachment {
                Some((time_ns, media_type, size)) if attachments => record(out, kind::ATTACHMENT_INDEX, |content| {
                    content.extend(entry.offset.to_le_bytes());
                    content.extend(entry.length.to_le_bytes());
                    content.extend(time_ns.to_le_bytes());
                    content.extend(time_ns.to_le_bytes());
                    content.extend(size.to_le_bytes());
                    put_text(content, &entry.name);
                    put_text(content, media_type);
                }),
                None if !attachments => record(out, kind::METADATA_INDEX, |content| {
                    content.extend(entry.offset.to_le_bytes());
                    content.extend(entry.length.to_le_bytes());
                    put_text(content, &entry.name);
                }),
                _ => {}
            }
        }
    }
}

fn channel(topic: &Topic) -> Channel {
    Channel {
        topic: topic.clone(),
        sequence: 0,
        messages: 0,
        index: Vec::new(),
    }
}

/// Length of the schemas' records.
fn schemas_length(channels: &[Channel]) -> u64 {
    let texts = |topic: &Topic| topic.schema_name.len() + SCHEMA_ENCODING.len() + topic.schema.len();
    let lengths = channels
        .iter()
        .map(|channel| RECORD_HEAD + 2 + 3 * 4 + texts(&channel.topic));
    lengths.sum::<usize>() as u64
}

/// Length of a message index record.
fn message_index_length(messages: u32) -> u64 {
    RECORD_HEAD as u64 + 2 + 4 + 16 * u64::from(messages)
}

fn put_message_index(out: &mut Vec<u8>, id: u16, entries: &[(u64, u64)]) {
    if entries.is_empty() {
        return;
    }
    record(out, kind::MESSAGE_INDEX, |content| {
        content.extend(id.to_le_bytes());
        sized(content, |array| {
            for (time_ns, offset) in entries {
                array.extend(time_ns.to_le_bytes());
                array.extend(offset.to_le_bytes());
            }
        });
    });
}

/// Writes one record with the content that `fill` appends.
fn record(out: &mut Vec<u8>, kind: u8, fill: impl FnOnce(&mut Vec<u8>)) {
    out.push(kind);
    let place = out.len();
    out.extend(0_u64.to_le_bytes());
    let begin = out.len();
    fill(out);
    let length = (out.len() - begin) as u64;
    if let Some(field) = out.get_mut(place..begin) {
        field.copy_from_slice(&length.to_le_bytes());
    }
}

/// Writes an array or a map, preceded by its length in bytes.
fn sized(out: &mut Vec<u8>, fill: impl FnOnce(&mut Vec<u8>)) {
    let place = out.len();
    out.extend(0_u32.to_le_bytes());
    let begin = out.len();
    fill(out);
    let length = (out.len() - begin) as u32;
    if let Some(field) = out.get_mut(place..begin) {
        field.copy_from_slice(&length.to_le_bytes());
    }
}

fn put_text(out: &mut Vec<u8>, text: &str) {
    out.extend((text.len() as u32).to_le_bytes());
    out.extend(text.as_bytes());
}
