//! Reads a recording, entry by entry.
//!
//! Invariant: unreadable parts are counted and reported; all readable parts are returned.

use super::mcap::{Ending, Message, Notice, Reader, Source};
use super::messages::{BLACK_BOX, Event, Gap, NAMES, State};
use super::moment::{Moment, SampleAxes};
use etherpen::config::Config;
use std::fs::File;
use std::io::{self, BufReader};
use std::path::Path;

/// Largest configuration read from a recording, bytes.
const CONFIG_BYTES_MAX: usize = 256 << 10;

/// One entry of a recording.
#[derive(Clone, Debug, PartialEq)]
pub enum RecordingEntry {
    /// A millisecond.
    Moment(Moment),
    /// A gap: samples are missing here.
    Gap(Gap),
    /// State of the controller.
    State(State),
    /// An event.
    Event(Event),
}

/// A recording being read.
pub struct Playback<R> {
    reader: Reader<R>,
    /// The axes in its samples, once one has been read.
    axes: Option<SampleAxes>,
    /// Number of messages that do not belong to a recording.
    foreign: u64,
}

impl Playback<BufReader<File>> {
    /// Opens a file.
    ///
    /// # Errors
    /// The file cannot be read, or is not an uncompressed MCAP file.
    pub fn open(path: &Path) -> io::Result<Self> {
        Self::new(BufReader::new(File::open(path)?))
    }
}

impl<R: Source> Playback<R> {
    /// Reads from a source.
    ///
    /// # Errors
    /// As [`open`](Playback::open).
    pub fn new(source: R) -> io::Result<Self> {
        let mut reader = Reader::new(source)?;
        reader.begin()?;
        Ok(Self {
            reader,
            axes: None,
            foreign: 0,
        })
    }

    /// Leaves out earlier and later entries, s since the beginning of the recording.
    pub fn select(&mut self, from_s: Option<f64>, to_s: Option<f64>) {
        // The conversion saturates at the largest number.
        let ns = |seconds: f64| (seconds * 1e9).round() as u64;
        self.reader.select(from_s.map_or(0, ns), to_s.map_or(u64::MAX, ns));
    }

    /// The configuration that was in effect.
    pub fn config(&self) -> Option<Config> {
        let bytes = self.reader.attachment("etherpen.toml")?;
        let text = std::str::from_utf8(bytes)
            .ok()
            .filter(|text| text.len() <= CONFIG_BYTES_MAX)?;
        toml::from_str(text).ok()
    }

    /// A property of the recording: `source`, `config_hash`, `program`.
    pub fn fact(&self, name: &str) -> Option<&str> {
        let all = self.reader.metadata().iter().flat_map(|(_, entries)| entries);
        all.into_iter()
            .find(|(key, _)| key == name)
            .map(|(_, value)| value.as_str())
    }

    /// The next entry and its time, s since the beginning of the recording; `None` at the end.
    ///
    /// # Errors
    /// The rest of the file cannot be read.
    pub fn next_entry(&mut self) -> io::Result<Option<(f64, RecordingEntry)>> {
        loop {
            let start_ns = self.reader.start_ns();
            let Some(message) = self.reader.next_message()? else {
                return Ok(None);
            };
            let entry = decode(&message, &mut self.axes);
            let time_ns = message.time_ns;
            let since_ns = time_ns.saturating_sub(start_ns.unwrap_or(time_ns));
            match entry {
                Some(entry) => return Ok(Some((since_ns as f64 / 1e9, entry))),
                None if message.topic == BLACK_BOX => {}
                None => self.foreign += 1,
            }
        }
    }

    /// Damage found in the file, in words; complete once there are no more entries.
    pub fn notices(&self) -> Vec<String> {
        let start_ns = self.reader.start_ns().unwrap_or(0);
        let seconds = |ns: u64| ns.saturating_sub(start_ns) as f64 / 1e9;
        let mut notices: Vec<String> = self
            .reader
            .notices()
            .iter()
            .map(|notice| match notice {
                Notice::DamagedChunk { start_ns, end_ns } => format!(
                    "{:.3} to {:.3} s are damaged and left out",
                    seconds(*start_ns),
                    seconds(*end_ns)
                ),
                Notice::Malformed { kind } => format!("a record of kind {kind} is damaged and left out"),
            })
            .collect();
        if self.reader.notices_left_out() > 0 {
            notices.push(format!(
                "{} more places are damaged and left out",
                self.reader.notices_left_out()
            ));
        }
        if self.foreign > 0 {
            notices.push(format!(
                "{} messages are none of a recording and left out",
                self.foreign
            ));
        }
        if self.reader.ending() == Some(Ending::CutOff) {
            notices.push("the file has no end (the recorder was stopped in the middle); all there is was read".into());
        }
        notices
    }

    /// Whether the file has its regular end, once there are no more entries.
    pub fn is_complete(&self) -> bool {
        self.reader.ending() == Some(Ending::Complete)
    }
}

fn decode(message: &Message<'_>, axes: &mut Option<SampleAxes>) -> Option<RecordingEntry> {
    let [sample, gap, status, event] = NAMES;
    let data = message.data;
    match message.topic {
        name if name == sample => {
            // Without a definition nobody knows what the numbers are.
            let axes = match axes {
                Some(axes) => axes,
                None => axes.insert(SampleAxes::of_schema(message.schema)?),
            };
            Moment::decode(axes, data).map(RecordingEntry::Moment)
        }
        name if name == gap => Gap::decode(data).map(RecordingEntry::Gap),
        name if name == status => State::decode(data).map(RecordingEntry::State),
        name if name == event => Event::decode(data).map(RecordingEntry::Event),
        _ => None,
    }
}
