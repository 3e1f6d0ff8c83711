//! Frames on their way from a board's Ethernet controller into the memory.
//!
//! A critical task only notes where a frame lies; the recorder fetches it from there within the next milliseconds.

use super::memory::{FRAME_WORDS, Memory, frame_distance, frame_position};
use core::sync::atomic::{AtomicU32, Ordering, compiler_fence};

/// Notes kept for the recorder.
const NOTES: usize = 32;
/// Words ahead of a frame's bytes: time, millisecond, length and direction.
pub(super) const FRAME_HEADER_WORDS: usize = 3;
/// Longest recorded frame, bytes; the rest of a longer one is cut off.
pub(super) const FRAME_BYTES_MAX: usize = 1_514;

const RECEIVED: u32 = 1 << 31;
const LENGTH_MASK: u32 = 0xFFFF;

/// Which way a frame went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From this board.
    Sent,
    /// To this board.
    Received,
}

/// Where a frame lies, and when it passed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameNote {
    /// Number of the note since the start, wrapping.
    pub number: u32,
    /// Where the board finds the frame: an address.
    pub place: u32,
    /// The board's counter.
    pub counts: u32,
    /// Length and direction, as stored.
    stored: u32,
}

impl FrameNote {
    /// Length of the frame, bytes.
    pub fn length(&self) -> usize {
        length(self.stored)
    }

    /// Which way it went.
    pub fn direction(&self) -> Direction {
        direction(self.stored)
    }
}

pub(super) fn length(stored: u32) -> usize {
    ((stored & LENGTH_MASK) as usize).min(FRAME_BYTES_MAX)
}

pub(super) fn direction(stored: u32) -> Direction {
    match stored & RECEIVED {
        0 => Direction::Sent,
        _ => Direction::Received,
    }
}

/// Words of a recorded frame.
pub(super) fn frame_words(length: usize) -> usize {
    FRAME_HEADER_WORDS + length.div_ceil(4)
}

/// Notes of the frames that passed lately. Critical tasks write, the recorder reads.
pub struct FrameNotes {
    /// The last word is not used: an address is a shift then.
    notes: [[AtomicU32; 4]; NOTES],
    next: AtomicU32,
}

impl Default for FrameNotes {
    fn default() -> Self {
        Self::new()
    }
}

impl FrameNotes {
    /// No notes.
    pub const fn new() -> Self {
        Self {
            notes: [const { [const { AtomicU32::new(0) }; 4] }; NOTES],
            next: AtomicU32::new(0),
        }
    }

    /// Notes a frame of `length` bytes. Only critical tasks may call this.
    #[inline]
    pub fn note(&self, direction: Direction, place: u32, length: usize, counts: u32) {
        let next = self.next.load(Ordering::Relaxed);
        let [stored_place, stored_counts, stored, _] = &self.notes[next as usize % NOTES];
        stored_place.store(place, Ordering::Relaxed);
        stored_counts.store(counts, Ordering::Relaxed);
        let direction = match direction {
            Direction::Sent => 0,
            Direction::Received => RECEIVED,
        };
        stored.store(length as u32 | direction, Ordering::Relaxed);
        // The reader is interrupted by the writer and runs on the same core: the order of instructions is enough.
        compiler_fence(Ordering::Release);
        self.next.store(next.wrapping_add(1), Ordering::Relaxed);
    }

    /// Number of notes since the start, wrapping.
    pub fn count(&self) -> u32 {
        let count = self.next.load(Ordering::Relaxed);
        compiler_fence(Ordering::Acquire);
        count
    }

    /// The note with a number; `None` if it has not been written yet or was replaced.
    pub fn get(&self, number: u32) -> Option<FrameNote> {
        let [place, counts, stored, _] = &self.notes[number as usize % NOTES];
        let note = FrameNote {
            number,
            place: place.load(Ordering::Relaxed),
            counts: counts.load(Ordering::Relaxed),
            stored: stored.load(Ordering::Relaxed),
        };
        compiler_fence(Ordering::Acquire);
        let since = self.count().wrapping_sub(number);
        // The oldest one may be in the middle of its replacement.
        (1..NOTES as u32).contains(&since).then_some(note)
    }
}

/// A board's frames, for the recorder.
pub trait FrameSource {
    /// The notes of the frames.
    fn notes(&self) -> &FrameNotes;

    /// Word `index` of a frame, little endian; any value behind its end.
    fn word(&self, note: &FrameNote, index: usize) -> u32;

    /// Whether what [`Self::word`] has returned was this frame to the end.
    fn is_intact(&self, note: &FrameNote) -> bool;
}

/// A board whose frames are not recorded.
#[derive(Default)]
pub struct NoFrames(FrameNotes);

impl FrameSource for NoFrames {
    fn notes(&self) -> &FrameNotes {
        &self.0
    }

    fn word(&self, _: &FrameNote, _: usize) -> u32 {
        0
    }

    fn is_intact(&self, _: &FrameNote) -> bool {
        false
    }
}

/// Copies frames into the ring of frames.
pub(super) struct FrameRing {
    /// Number of the next note to take.
    next: u32,
}

impl FrameRing {
    pub(super) const fn new() -> Self {
        Self { next: 0 }
    }

    /// Passes over all frames noted so far.
    pub(super) fn skip(&mut self, source: &impl FrameSource) {
        self.next = source.notes().count();
    }

    /// Copies all frames noted since the last call.
    pub(super) fn take(&mut self, memory: &Memory, source: &impl FrameSource, cycle: u32) {
        let count = source.notes().count();
        let mut missed = 0;
        let waiting = count.wrapping_sub(self.next);
        if waiting >= NOTES as u32 {
            missed = waiting - (NOTES as u32 - 1);
            self.next = self.next.wrapping_add(missed);
        }
        while self.next != count {
            let copied = source
                .notes()
                .get(self.next)
                .is_some_and(|note| copy(memory, source, &note, cycle));
            missed += u32::from(!copied);
            self.next = self.next.wrapping_add(1);
        }
        if missed > 0 {
            memory.count_missed_frames(missed);
        }
    }
}

/// Copies a frame and announces it if it was still there; the oldest ones make room.
fn copy(memory: &Memory, source: &impl FrameSource, note: &FrameNote, cycle: u32) -> bool {
    let (words, (mut first, start)) = (frame_words(note.length()), memory.frame_positions());
    while frame_distance(first, start) + words > FRAME_WORDS {
        let header = frame_position(first, FRAME_HEADER_WORDS - 1);
        first = frame_position(first, frame_words(length(memory.frame_word(header))));
        memory.set_frame_first(first);
    }
    for (index, word) in [note.counts, cycle, note.stored].into_iter().enumerate() {
        memory.set_frame_word(frame_position(start, index), word);
    }
    for index in FRAME_HEADER_WORDS..words {
        let word = source.word(note, index - FRAME_HEADER_WORDS);
        memory.set_frame_word(frame_position(start, index), word);
    }
    let intact = source.is_intact(note);
    if intact {
        memory.set_frame_next(frame_position(start, words));
    }
    intact
}
