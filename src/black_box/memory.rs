//! The memory of the black box: words, and where each area lies.
//!
//! | area | words | contents |
//! |---|---|---|
//! | header | 16 | state, version, counters of the areas, see the constants below |
//! | samples | 2,001 of 16 each | a ring; the slot behind the newest one may be torn and is never announced |
//! | events | 100 of 20 each | a ring: millisecond, length of the encoding in bytes, encoding |
//! | frames | the rest | a ring of frames of different lengths: time, millisecond, length and direction, bytes |

use crate::board::RunEnd;
use core::sync::atomic::{AtomicU32, Ordering, fence};

/// Size of the black box, bytes.
pub const MEMORY_BYTES: usize = 262_144;
const WORDS: usize = MEMORY_BYTES / 4;

/// Samples that can be read.
pub const SAMPLES: usize = 2_000;
/// One slot is being written while the others are complete.
const SAMPLE_SLOTS: usize = SAMPLES + 1;
/// Events that can be read.
pub(super) const EVENTS: usize = 100;
/// Words of an event: millisecond, length, encoding.
pub(super) const EVENT_WORDS: usize = 20;

const HEADER_WORDS: usize = 16;
/// Whether recordings go on; see the values of [`State`].
const STATE: usize = 0;
/// [`LAYOUT`], so that another version's memory is not misread.
const VERSION: usize = 1;
const SAMPLE_NEXT: usize = 2;
const SAMPLE_COUNT: usize = 3;
const EVENT_NEXT: usize = 4;
const EVENT_COUNT: usize = 5;
const FRAME_FIRST: usize = 6;
const FRAME_NEXT: usize = 7;
/// Counts in a second of the counter that stamps frames.
const COUNTS_PER_S: usize = 8;
/// Frames that passed but were not recorded.
const FRAMES_MISSED: usize = 9;
/// Milliseconds until recordings continue after the host has read.
const PAUSE_MS: usize = 10;
/// Whether the host wants the contents discarded.
const DISCARD: usize = 11;

/// Version of this layout and of the encodings in it.
const LAYOUT: u32 = 2;
/// How long recordings rest after a read.
const PAUSE_AFTER_READ_MS: u32 = 5_000;

const SAMPLES_AT: usize = HEADER_WORDS;
const EVENTS_AT: usize = SAMPLES_AT + SAMPLE_SLOTS * super::SAMPLE_WORDS;
const FRAMES_AT: usize = EVENTS_AT + EVENTS * EVENT_WORDS;
/// Words of the ring of frames.
pub const FRAME_WORDS: usize = WORDS - FRAMES_AT;

/// State of the memory, as stored. The values differ in many bits from memory that was never written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum State {
    /// Recordings go on.
    Recording = 0x626C_6B31,
    /// An earlier run's recording, kept until the host discards it.
    KeptAfterCrash = 0x626C_6B32,
    /// An earlier run's recording, kept until a drive is enabled, for two minutes at most.
    KeptAfterReset = 0x626C_6B33,
}

impl State {
    pub(super) fn from_word(word: u32) -> Option<Self> {
        [Self::Recording, Self::KeptAfterCrash, Self::KeptAfterReset]
            .into_iter()
            .find(|state| *state as u32 == word)
    }
}

/// What a start makes of the earlier contents.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keep {
    /// The memory had no power: there are none.
    Nothing,
    /// The run ended with a reset from outside: they are kept until a drive is enabled, for two minutes at most.
    UntilEnabled,
    /// The run ended with a panic or by the watchdog: they are kept until they are discarded.
    UntilDiscarded,
}

impl Keep {
    /// What becomes of a recording after this end of its run.
    pub const fn after(end: &RunEnd) -> Self {
        match end {
            RunEnd::PowerOff => Self::Nothing,
            RunEnd::Reset => Self::UntilEnabled,
            RunEnd::Watchdog | RunEnd::Panic(_) => Self::UntilDiscarded,
        }
    }
}

/// The memory. Every access is one word.
#[repr(C, align(32))]
pub struct Memory([AtomicU32; WORDS]);

impl Default for Memory {
    fn default() -> Self {
        Self::new()
    }
}

impl Memory {
    /// A memory of zeros.
    pub const fn new() -> Self {
        Self([const { AtomicU32::new(0) }; WORDS])
    }

    /// Decides what becomes of the earlier contents; call it at the start, before a [`Recorder`](super::Recorder) runs. An earlier
    /// recording that is still kept stays.
    pub fn start(&self, keep: Keep) {
        let known = keep != Keep::Nothing && self.load(VERSION) == LAYOUT;
        let kept = match State::from_word(self.load(STATE)).filter(|_| known) {
            Some(State::Recording) if self.load(SAMPLE_COUNT) > 0 => Some(match keep {
                Keep::UntilDiscarded => State::KeptAfterCrash,
                Keep::UntilEnabled | Keep::Nothing => State::KeptAfterReset,
            }),
            Some(State::Recording) | None => None,
            // A firmware that crashes again and again is recorded from the second time on.
            Some(State::KeptAfterReset) if keep == Keep::UntilDiscarded => None,
            kept => kept,
        };
        match kept {
            Some(state) => {
                self.store(DISCARD, 0);
                self.store(PAUSE_MS, 0);
                self.store(STATE, state as u32);
            }
            None => self.clear(),
        }
    }

    /// Ends recordings before a restart that is no failure: nothing is kept of them. An earlier run's recording stays.
    pub fn end(&self) {
        if self.state() == Some(State::Recording) {
            self.store(STATE, 0);
        }
    }

    /// Empties all areas and records from now on.
    pub(super) fn clear(&self) {
        self.store(STATE, 0);
        for word in VERSION..HEADER_WORDS {
            if word != COUNTS_PER_S {
                self.store(word, 0);
            }
        }
        self.store(VERSION, LAYOUT);
        self.store(STATE, State::Recording as u32);
    }

    /// Sets the rate of the counter that stamps frames, Hz; call it after [`Self::start`]. A kept recording is of the same
    /// board and has the same rate.
    pub fn set_counts_per_s(&self, counts_per_s: u32) {
        self.store(COUNTS_PER_S, counts_per_s);
    }

    /// Whether the memory holds an earlier run's recording.
    pub fn is_kept(&self) -> bool {
        matches!(self.state(), Some(State::KeptAfterCrash | State::KeptAfterReset))
    }

    pub(super) fn state(&self) -> Option<State> {
        State::from_word(self.load(STATE))
    }

    /// Whether recordings go on and no host is reading.
    pub(super) fn takes(&self) -> bool {
        self.state() == Some(State::Recording) && !self.is_read()
    }

    pub(super) fn has_no_events(&self) -> bool {
        self.load(EVENT_COUNT) == 0
    }

    /// Whether a host is reading.
    pub(super) fn is_read(&self) -> bool {
        self.load(PAUSE_MS) != 0
    }

    /// Interrupts recordings for a while.
    pub(super) fn pause(&self) {
        self.store(PAUSE_MS, PAUSE_AFTER_READ_MS);
    }

    /// Lets a millisecond of the interruption pass.
    pub(super) fn shorten_pause(&self) {
        self.store(PAUSE_MS, self.load(PAUSE_MS).saturating_sub(1));
    }

    /// Asks the recorder to empty the memory.
    pub(super) fn discard(&self) {
        self.store(DISCARD, 1);
    }

    pub(super) fn is_to_be_discarded(&self) -> bool {
        self.load(DISCARD) != 0
    }

    /// The word at an index of the whole memory; `None` behind its end.
    pub fn word(&self, index: usize) -> Option<u32> {
        self.0.get(index).map(|word| word.load(Ordering::Relaxed))
    }

    fn load(&self, index: usize) -> u32 {
        self.word(index).unwrap_or_default()
    }

    fn store(&self, index: usize, value: u32) {
        if let Some(word) = self.0.get(index) {
            word.store(value, Ordering::Relaxed);
        }
    }

    /// Writes a sample into the next slot, then announces it.
    pub(super) fn put_sample(&self, words: &[u32; super::SAMPLE_WORDS]) {
        let slot = self.load(SAMPLE_NEXT) as usize % SAMPLE_SLOTS;
        self.put(SAMPLES_AT + slot * super::SAMPLE_WORDS, words);
        self.announce(SAMPLE_NEXT, SAMPLE_COUNT, slot, (SAMPLE_SLOTS, SAMPLES));
    }

    /// Writes an event into the next slot, then announces it. The oldest one is no longer announced meanwhile.
    pub(super) fn put_event(&self, words: &[u32; EVENT_WORDS]) {
        let slot = self.load(EVENT_NEXT) as usize % EVENTS;
        self.store(EVENT_COUNT, self.load(EVENT_COUNT).min(EVENTS as u32 - 1));
        fence(Ordering::Release);
        self.put(EVENTS_AT + slot * EVENT_WORDS, words);
        self.announce(EVENT_NEXT, EVENT_COUNT, slot, (EVENTS, EVENTS));
    }

    fn put(&self, start: usize, words: &[u32]) {
        for (index, word) in (start..).zip(words) {
            self.store(index, *word);
        }
    }

    fn announce(&self, next: usize, count: usize, slot: usize, (slots, most): (usize, usize)) {
        // The entry is in the memory before it is announced.
        fence(Ordering::Release);
        let following = if slot + 1 < slots { slot + 1 } else { 0 };
        // In this order: a reset between the two leaves one entry unannounced, and never announces one too many.
        self.store(next, following as u32);
        self.store(count, (self.load(count) + 1).min(most as u32));
    }

    /// First and next position of the ring of frames.
    pub(super) fn frame_positions(&self) -> (usize, usize) {
        let position = |index| self.load(index) as usize % (2 * FRAME_WORDS);
        (position(FRAME_FIRST), position(FRAME_NEXT))
    }

    pub(super) fn set_frame_first(&self, position: usize) {
        self.store(FRAME_FIRST, position as u32);
        // The oldest frame is taken back before it is overwritten.
        fence(Ordering::Release);
    }

    pub(super) fn set_frame_next(&self, position: usize) {
        fence(Ordering::Release);
        self.store(FRAME_NEXT, position as u32);
    }

    /// The word at a position of the ring of frames.
    pub(super) fn frame_word(&self, position: usize) -> u32 {
        self.load(FRAMES_AT + ring_index(position))
    }

    pub(super) fn set_frame_word(&self, position: usize, word: u32) {
        self.store(FRAMES_AT + ring_index(position), word);
    }

    pub(super) fn count_missed_frames(&self, frames: u32) {
        self.store(FRAMES_MISSED, self.load(FRAMES_MISSED).wrapping_add(frames));
    }
}

/// Positions of the ring of frames run through it twice, so that a full ring differs from an empty one.
fn ring_index(position: usize) -> usize {
    if position < FRAME_WORDS {
        position
    } else {
        position - FRAME_WORDS
    }
}

/// The position so many words behind another one.
pub(super) fn frame_position(position: usize, words: usize) -> usize {
    let sum = position + words;
    if sum < 2 * FRAME_WORDS {
        sum
    } else {
        sum - 2 * FRAME_WORDS
    }
}

/// Words from one position of the ring of frames to a later one.
pub(super) fn frame_distance(from: usize, to: usize) -> usize {
    if to >= from {
        to - from
    } else {
        to + 2 * FRAME_WORDS - from
    }
}

/// The parts of a memory that was read, for [`super::recording`].
pub(super) struct Image<'a>(pub(super) &'a [u8]);

impl Image<'_> {
    pub(super) fn word(&self, index: usize) -> Option<u32> {
        let bytes = self.0.get(index * 4..index * 4 + 4)?;
        bytes.try_into().ok().map(u32::from_le_bytes)
    }

    pub(super) fn state(&self) -> Option<State> {
        let known = self.word(VERSION)? == LAYOUT;
        State::from_word(self.word(STATE)?).filter(|_| known)
    }

    pub(super) fn counts_per_s(&self) -> u32 {
        self.word(COUNTS_PER_S).unwrap_or_default()
    }

    pub(super) fn frames_missed(&self) -> u32 {
        self.word(FRAMES_MISSED).unwrap_or_default()
    }

    /// First words of the samples, oldest first.
    pub(super) fn samples(&self) -> impl Iterator<Item = usize> + use<> {
        let entries = self.entries(SAMPLE_NEXT, SAMPLE_COUNT, (SAMPLE_SLOTS, SAMPLES));
        entries.map(|slot| SAMPLES_AT + slot * super::SAMPLE_WORDS)
    }

    /// First words of the events, oldest first.
    pub(super) fn events(&self) -> impl Iterator<Item = usize> + use<> {
        let entries = self.entries(EVENT_NEXT, EVENT_COUNT, (EVENTS, EVENTS));
        entries.map(|slot| EVENTS_AT + slot * EVENT_WORDS)
    }

    fn entries(&self, next: usize, count: usize, (slots, most): (usize, usize)) -> impl Iterator<Item = usize> + use<> {
        let next = self.word(next).unwrap_or_default() as usize % slots;
        let count = (self.word(count).unwrap_or_default() as usize).min(most);
        (0..count).map(move |index| (next + slots - count + index) % slots)
    }

    /// First and next position of the ring of frames.
    pub(super) fn frame_positions(&self) -> (usize, usize) {
        let position = |index| self.word(index).unwrap_or_default() as usize % (2 * FRAME_WORDS);
        (position(FRAME_FIRST), position(FRAME_NEXT))
    }

    pub(super) fn frame_word(&self, position: usize) -> u32 {
        self.word(FRAMES_AT + ring_index(position)).unwrap_or_default()
    }
}

const _: () = assert!(size_of::<Memory>() == MEMORY_BYTES && FRAMES_AT < WORDS);
