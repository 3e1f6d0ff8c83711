//! A black box's memory taken apart.

use super::event::{EVENT_BYTES, Event};
use super::frames::{Direction, FRAME_HEADER_WORDS, direction, frame_words, length};
use super::memory::{Image, State, frame_distance, frame_position};
use super::sample::{SAMPLE_WORDS, Sample};
use super::{FRAME_WORDS, MEMORY_BYTES};

/// Whose recording it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// The present run.
    Present,
    /// An earlier run that ended with a panic or by the watchdog.
    Crashed,
    /// An earlier run that was reset from outside.
    Reset,
}

/// Why bytes are not a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoRecording {
    /// There are fewer or more bytes than a black box has.
    Length,
    /// The memory was never written, or by a firmware with another layout.
    Unknown,
}

/// A frame as recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameHeader {
    /// The board's counter when the frame passed.
    pub counts: u32,
    /// Millisecond in which it was recorded.
    pub cycle: u32,
    /// Which way it went.
    pub direction: Direction,
    /// Length, bytes.
    pub length: usize,
    start: usize,
}

/// The contents of a black box.
#[derive(Clone, Copy)]
pub struct Recording<'a> {
    memory: &'a [u8],
    origin: Origin,
}

impl<'a> Recording<'a> {
    /// The recording in a memory of [`MEMORY_BYTES`] bytes.
    ///
    /// # Errors
    /// See [`NoRecording`].
    pub fn new(memory: &'a [u8]) -> Result<Self, NoRecording> {
        if memory.len() != MEMORY_BYTES {
            return Err(NoRecording::Length);
        }
        let origin = match Image(memory).state() {
            Some(State::Recording) => Origin::Present,
            Some(State::KeptAfterCrash) => Origin::Crashed,
            Some(State::KeptAfterReset) => Origin::Reset,
            None => return Err(NoRecording::Unknown),
        };
        Ok(Self { memory, origin })
    }

    fn image(&self) -> Image<'a> {
        Image(self.memory)
    }

    /// Whose recording it is.
    pub fn origin(&self) -> Origin {
        self.origin
    }

    /// Counts in a second of the counter that stamps frames; 0 if the board has not told it.
    pub fn counts_per_s(&self) -> u32 {
        self.image().counts_per_s()
    }

    /// Frames that passed but were not recorded.
    pub fn frames_missed(&self) -> u32 {
        self.image().frames_missed()
    }

    /// Samples, oldest first.
    pub fn samples(&self) -> impl Iterator<Item = Sample> + 'a {
        let image = self.image();
        image.samples().map(move |first| {
            let words: [u32; SAMPLE_WORDS] =
                core::array::from_fn(|index| image.word(first + index).unwrap_or_default());
            Sample::from_words(&words)
        })
    }

    /// Events with their milliseconds, oldest first; `None` where the bytes are not an event.
    pub fn events(&self) -> impl Iterator<Item = (u32, Option<Event>)> + 'a {
        let image = self.image();
        image.events().map(move |first| {
            let word = |index| image.word(first + index).unwrap_or_default();
            let from = (first + 2) * 4;
            let length = (word(1) as usize).min(EVENT_BYTES);
            let bytes = image.0.get(from..from + length).unwrap_or_default();
            (word(0), postcard::from_bytes(bytes).ok())
        })
    }

    /// Frames, oldest first; ends where the bytes are not a frame.
    pub fn frames(&self) -> impl Iterator<Item = FrameHeader> + 'a {
        let image = self.image();
        let (mut position, next) = image.frame_positions();
        let mut left = Some(frame_distance(position, next))
            .filter(|words| *words <= FRAME_WORDS)
            .unwrap_or(0);
        core::iter::from_fn(move || {
            let word = |index| image.frame_word(frame_position(position, index));
            let stored = word(2);
            let words = frame_words(length(stored));
            left = left.checked_sub(words)?;
            let header = FrameHeader {
                counts: word(0),
                cycle: word(1),
                direction: direction(stored),
                length: length(stored),
                start: frame_position(position, FRAME_HEADER_WORDS),
            };
            position = frame_position(position, words);
            Some(header)
        })
    }

    /// The bytes of a frame of this recording.
    pub fn frame_bytes(&self, frame: &FrameHeader) -> impl Iterator<Item = u8> + 'a {
        let (image, start) = (self.image(), frame.start);
        (0..frame.length).map(move |index| {
            let word = image.frame_word(frame_position(start, index / 4));
            (word >> (index % 4 * 8)) as u8
        })
    }
}
