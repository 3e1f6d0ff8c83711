//! Reads an MCAP file from the front, with or without its end.
//!
//! Every complete chunk can be read, and the last one as far as it was written. Chunks outside the selected time are
//! skipped by their headers. Invariant: invalid content only causes an error, and memory holds one chunk.

use super::super::bytes::Numbers;
use super::{CRC, MAGIC, kind};
use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufReader, PipeReader, Read};

/// Longest record read into memory, bytes; all records of a recording are shorter.
const RECORD_BYTES_MAX: u64 = 64 << 20;
/// Longest schema kept, bytes; all schemas of a recording are shorter.
const SCHEMA_BYTES_MAX: usize = 64 << 10;
/// Most notices kept; further ones are counted.
const NOTICES_MAX: usize = 100;

/// Source of a file.
pub trait Source: Read {
    /// Skips bytes.
    ///
    /// # Errors
    /// Errors of the source.
    fn skip(&mut self, bytes: u64) -> io::Result<()>;
}

impl Source for BufReader<File> {
    fn skip(&mut self, bytes: u64) -> io::Result<()> {
        match i64::try_from(bytes) {
            Ok(bytes) => self.seek_relative(bytes),
            Err(_) => Err(io::ErrorKind::UnexpectedEof.into()),
        }
    }
}

impl Source for BufReader<PipeReader> {
    fn skip(&mut self, bytes: u64) -> io::Result<()> {
        io::copy(&mut self.take(bytes), &mut io::sink()).map(|_| ())
    }
}

impl Source for &[u8] {
    fn skip(&mut self, bytes: u64) -> io::Result<()> {
        io::copy(&mut self.take(bytes), &mut io::sink()).map(|_| ())
    }
}

/// One message.
#[derive(Clone, Copy, Debug)]
pub struct Message<'a> {
    /// Name of its channel; empty if the file does not define it.
    pub topic: &'a str,
    /// The definition of its content; empty if the file does not have it.
    pub schema: &'a str,
    /// Its time, ns.
    pub time_ns: u64,
    /// Its data.
    pub data: &'a [u8],
}

/// How a file ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// With its regular end.
    Complete,
    /// In the middle: the recorder was killed or the disk was full.
    CutOff,
}

/// Damage in a file that is readable otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Notice {
    /// A chunk's checksum is wrong; its messages are left out.
    DamagedChunk {
        /// First time in it, ns.
        start_ns: u64,
        /// Last time in it, ns.
        end_ns: u64,
    },
    /// A record is malformed.
    Malformed {
        /// Its kind.
        kind: u8,
    },
}

/// Reads one file.
pub struct Reader<R> {
    source: R,
    /// Selected time, ns since the file's first message.
    range_ns: (u64, u64),
    /// First time of the file, ns.
    start_ns: Option<u64>,
    /// Topics by channel number, with the numbers of their schemas.
    topics: HashMap<u16, (String, u16)>,
    /// Schemas by number.
    schemas: HashMap<u16, String>,
    attachments: Vec<(String, Vec<u8>)>,
    metadata: Vec<(String, Vec<(String, String)>)>,
    /// Records of the open chunk, and how far they have been read.
    chunk: Vec<u8>,
    read: usize,
    notices: Vec<Notice>,
    /// Number of notices that were not kept.
    notices_left_out: u64,
    ending: Option<Ending>,
}

/// Channel, time and position of a message in the chunk.
struct Found {
    channel: u16,
    time_ns: u64,
    begin: usize,
    end: usize,
}

impl<R: Source> Reader<R> {
    /// Starts reading.
    ///
    /// # Errors
    /// Errors of the source; [`io::ErrorKind::InvalidData`] when the source is not an MCAP file.
    pub fn new(mut source: R) -> io::Result<Self> {
        let mut magic = Vec::new();
        (&mut source).take(MAGIC.len() as u64).read_to_end(&mut magic)?;
        if magic != MAGIC {
            return Err(invalid("this is no MCAP file"));
        }
        Ok(Self {
            source,
            range_ns: (0, u64::MAX),
            start_ns: None,
            topics: HashMap::new(),
            schemas: HashMap::new(),
            attachments: Vec::new(),
            metadata: Vec::new(),
            chunk: Vec::new(),
            read: 0,
            notices: Vec::new(),
            notices_left_out: 0,
            ending: None,
        })
    }

    /// Reads up to the first chunk: attachments and metadata come before it.
    ///
    /// # Errors
    /// As [`next_message`](Self::next_message).
    pub fn begin(&mut self) -> io::Result<()> {
        while self.chunk.is_empty() && self.ending.is_none() {
            self.next_record()?;
        }
        Ok(())
    }

    /// Leaves out earlier and later messages, ns since the file's first message.
    pub fn select(&mut self, from_ns: u64, to_ns: u64) {
        self.range_ns = (from_ns, to_ns);
    }

    /// First time of the file, ns, once a message was read.
    pub fn start_ns(&self) -> Option<u64> {
        self.start_ns
    }

    /// An attachment, if it has been read already.
    pub fn attachment(&self, name: &str) -> Option<&[u8]> {
        let found = self.attachments.iter().find(|(its_name, _)| its_name == name);
        found.map(|(_, data)| data.as_slice())
    }

    /// Names and values of the metadata read so far.
    pub fn metadata(&self) -> &[(String, Vec<(String, String)>)] {
        &self.metadata
    }

    /// Damage found so far: the first hundred places.
    pub fn notices(&self) -> &[Notice] {
        &self.notices
    }

    /// How many more damaged places were found.
    pub fn notices_left_out(&self) -> u64 {
        self.notices_left_out
    }

    fn notice(&mut self, notice: Notice) {
        if self.notices.len() < NOTICES_MAX {
            self.notices.push(notice);
        } else {
            self.notices_left_out += 1;
        }
    }

    /// How the file ended, once there are no more messages.
    pub fn ending(&self) -> Option<Ending> {
        self.ending
    }

    /// The next message, `None` at the end.
    ///
    /// # Errors
    /// Errors of the source; [`io::ErrorKind::InvalidData`] for a compressed chunk or a record that is too long.
    pub fn next_message(&mut self) -> io::Result<Option<Message<'_>>> {
        let found = loop {
            match self.next_in_chunk() {
                Some(found) if self.wants(found.time_ns) => break found,
                Some(_) => {}
                None if self.ending.is_some() => return Ok(None),
                None => self.next_record()?,
            }
        };
        let topic = self.topics.get(&found.channel);
        Ok(Some(Message {
            topic: topic.map_or("", |(name, _)| name),
            schema: topic
                .and_then(|(_, id)| self.schemas.get(id))
                .map_or("", String::as_str),
            time_ns: found.time_ns,
            data: self.chunk.get(found.begin..found.end).unwrap_or(&[]),
        }))
    }

    /// Whether a time is in the selected range; the first time read is the origin of the range.
    fn wants(&mut self, time_ns: u64) -> bool {
        let since = time_ns.saturating_sub(*self.start_ns.get_or_insert(time_ns));
        (self.range_ns.0..=self.range_ns.1).contains(&since)
    }

    fn next_in_chunk(&mut self) -> Option<Found> {
        while self.read < self.chunk.len() {
            let mut fields = Fields::new(self.chunk.get(self.read..)?);
            let (Some(kind), Some(length)) = (fields.byte(), fields.long()) else {
                break;
            };
            let begin = self.read + fields.place;
            let end = begin.saturating_add(usize::try_from(length).unwrap_or(usize::MAX));
            if end > self.chunk.len() {
                break;
            }
            self.read = end;
            match kind {
                kind::MESSAGE => {
                    let message = (fields.short(), fields.word(), fields.long(), fields.long());
                    if let (Some(channel), Some(_), Some(time_ns), Some(_)) = message
                        && begin + MESSAGE_FIELDS <= end
                    {
                        return Some(Found {
                            channel,
                            time_ns,
                            begin: begin + MESSAGE_FIELDS,
                            end,
                        });
                    }
                    self.notice(Notice::Malformed { kind });
                }
                kind::CHANNEL | kind::SCHEMA => {
                    let content = self.chunk.get(begin..end).unwrap_or(&[]).to_vec();
                    self.take_record(kind, &[], &content);
                }
                _ => {}
            }
        }
        self.read = self.chunk.len();
        None
    }

    /// Reads one record of the file.
    fn next_record(&mut self) -> io::Result<()> {
        let head = self.bytes(9)?;
        let mut fields = Fields::new(&head);
        let (Some(kind), Some(length)) = (fields.byte(), fields.long()) else {
            self.ending = Some(Ending::CutOff);
            return Ok(());
        };
        match kind {
            kind::CHUNK => self.take_chunk(length)?,
            kind::MESSAGE | kind::CHANNEL | kind::SCHEMA | kind::ATTACHMENT | kind::METADATA => {
                match self.content(length)? {
                    Some(content) => self.take_record(kind, &head, &content),
                    None => self.ending = Some(Ending::CutOff),
                }
            }
            kind::FOOTER => self.ending = Some(Ending::Complete),
            _ => self.source.skip(length)?,
        }
        Ok(())
    }

    fn take_record(&mut self, kind: u8, head: &[u8], content: &[u8]) {
        match kind {
            kind::CHANNEL => self.take_channel(content),
            kind::SCHEMA => self.take_schema(content),
            kind::ATTACHMENT => self.take_attachment(content),
            kind::METADATA => match metadata(content) {
                Some(metadata) => self.metadata.push(metadata),
                None => self.notice(Notice::Malformed { kind }),
            },
            // A message outside a chunk counts as a chunk.
            _ => {
                self.chunk = [head, content].concat();
                self.read = 0;
            }
        }
    }

    /// Up to `count` bytes, as many as there are.
    fn bytes(&mut self, count: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        (&mut self.source).take(count).read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    /// The content of a record; `None` if the file ends inside it.
    fn content(&mut self, length: u64) -> io::Result<Option<Vec<u8>>> {
        if length > RECORD_BYTES_MAX {
            return Err(invalid(format!("a record of {length} bytes is not one of a recording")));
        }
        let content = self.bytes(length)?;
        Ok((content.len() as u64 == length).then_some(content))
    }

    fn take_chunk(&mut self, length: u64) -> io::Result<()> {
        let head = self.bytes(CHUNK_TIMES + 4)?;
        let mut fields = Fields::new(&head);
        let times = (
            fields.long(),
            fields.long(),
            fields.long(),
            fields.word(),
            fields.word(),
        );
        let (Some(start_ns), Some(end_ns), Some(_), Some(crc), Some(name_length)) = times else {
            self.ending = Some(Ending::CutOff);
            return Ok(());
        };
        if name_length > 0 {
            let name = self.bytes(u64::from(name_length.min(16)))?;
            let name = String::from_utf8_lossy(&name);
            return Err(invalid(format!(
                "its messages are compressed ({name}); only recordings without compression can be read, \
                 `mcap compress --compression none` makes one"
            )));
        }
        let Some(rest) = length.checked_sub(CHUNK_TIMES + 4) else {
            self.notice(Notice::Malformed { kind: kind::CHUNK });
            return Ok(());
        };
        let first_ns = *self.start_ns.get_or_insert(start_ns);
        let (from_ns, to_ns) = self.range_ns;
        if end_ns.saturating_sub(first_ns) < from_ns || start_ns.saturating_sub(first_ns) > to_ns {
            return self.source.skip(rest);
        }
        if rest > RECORD_BYTES_MAX {
            return Err(invalid(format!("a chunk of {rest} bytes is not one of a recording")));
        }
        self.bytes(8)?;
        let size = rest.saturating_sub(8);
        self.chunk.clear();
        self.read = 0;
        (&mut self.source).take(size).read_to_end(&mut self.chunk)?;
        let whole = self.chunk.len() as u64 == size;
        if whole && crc != 0 && crc != CRC.checksum(&self.chunk) {
            self.chunk.clear();
            self.notice(Notice::DamagedChunk { start_ns, end_ns });
        }
        Ok(())
    }

    fn take_channel(&mut self, content: &[u8]) {
        let mut fields = Fields::new(content);
        match (fields.short(), fields.short(), fields.text()) {
            (Some(id), Some(schema), Some(topic)) => {
                self.topics.entry(id).or_insert_with(|| (topic.to_owned(), schema));
            }
            _ => self.notice(Notice::Malformed { kind: kind::CHANNEL }),
        }
    }

    fn take_schema(&mut self, content: &[u8]) {
        let mut fields = Fields::new(content);
        match (fields.short(), fields.text(), fields.text(), fields.text()) {
            (Some(id), Some(_), Some(_), Some(schema)) if schema.len() <= SCHEMA_BYTES_MAX => {
                self.schemas.entry(id).or_insert_with(|| schema.to_owned());
            }
            // It is left out, and nobody asks for it.
            (Some(_), Some(_), Some(_), Some(_)) => {}
            _ => self.notice(Notice::Malformed { kind: kind::SCHEMA }),
        }
    }

    fn take_attachment(&mut self, content: &[u8]) {
        let mut fields = Fields::new(content);
        let head = (
            fields.long(),
            fields.long(),
            fields.text(),
            fields.text(),
            fields.long(),
        );
        let data = match head {
            (Some(_), Some(_), Some(name), Some(_), Some(size)) => fields.take(size).map(|data| (name, data)),
            _ => None,
        };
        match data {
            Some((name, data)) => self.attachments.push((name.to_owned(), data.to_vec())),
            None => self.notice(Notice::Malformed { kind: kind::ATTACHMENT }),
        }
    }
}

/// Length of a message's fields before its data.
const MESSAGE_FIELDS: usize = 2 + 4 + 8 + 8;
/// Length of a chunk's fields before the name of its compression.
const CHUNK_TIMES: u64 = 8 + 8 + 8 + 4;

fn invalid(text: impl Into<String>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, text.into())
}

fn metadata(content: &[u8]) -> Option<(String, Vec<(String, String)>)> {
    let mut fields = Fields::new(content);
    let name = fields.text()?.to_owned();
    let length = fields.word()?;
    let mut map = Fields::new(fields.take(length.into())?);
    let mut entries = Vec::new();
    while let (Some(key), Some(value)) = (map.text(), map.text()) {
        entries.push((key.to_owned(), value.to_owned()));
    }
    Some((name, entries))
}

/// Reads consecutive little-endian fields.
struct Fields<'a> {
    bytes: &'a [u8],
    place: usize,
}

impl<'a> Fields<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, place: 0 }
    }

    fn take(&mut self, count: u64) -> Option<&'a [u8]> {
        let end = self.place.checked_add(usize::try_from(count).ok()?)?;
        let taken = self.bytes.get(self.place..end)?;
        self.place = end;
        Some(taken)
    }

    fn text(&mut self) -> Option<&'a str> {
        let length = self.word()?;
        std::str::from_utf8(self.take(length.into())?).ok()
    }
}

impl Numbers for Fields<'_> {
    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N as u64)?.try_into().ok()
    }
}
