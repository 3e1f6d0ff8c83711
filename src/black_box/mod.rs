//! The black box: the last two seconds before a reset, in memory that survives it.
//!
//! It holds a sample of 64 bytes for each of the last 2,000 milliseconds, the last 100 events, and the last Ethernet
//! frames in both directions. A board puts a [`Memory`] where neither a cache nor its start-up code touches it, decides
//! at each start what becomes of its contents ([`Memory::start`]) and runs a [`Recorder`] below the critical tasks. The
//! [`EventLog`] belongs to the link task. The host reads the memory piece by piece ([`Request`]) and takes it apart
//! with [`recording::Recording`].
//!
//! A recording of a run that ended is kept: after a crash until it is discarded, after any other reset until a drive is
//! enabled again, for two minutes at most. Nothing is recorded meanwhile.
//!
//! Invariants: each area has one writer; what an area's counters announce is complete, whenever a reset comes; all
//! writes are whole words, because a memory with error correction holds back a part of a word until the next write.

mod event;
mod frames;
mod memory;
mod recorder;
pub mod recording;
mod sample;

pub use event::{Event, EventLog};
pub use frames::{Direction, FrameNote, FrameNotes, FrameSource, NoFrames};
pub use memory::{FRAME_WORDS, Keep, MEMORY_BYTES, Memory, SAMPLES};
pub use recorder::Recorder;
pub use sample::{Flags, SAMPLE_WORDS, Sample};

use heapless::Vec;
use serde::{Deserialize, Serialize};

/// Most bytes of a piece.
pub const PIECE_BYTES: usize = 1_024;

/// A request of the host to the black box.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Request {
    /// A piece of the memory. While recordings go on, the first request interrupts them, so that all pieces belong
    /// together; they continue five seconds after the last one.
    Read {
        /// First byte wanted, a multiple of 4.
        offset: u32,
    },
    /// Discard what is kept and record again.
    Discard,
}

/// Answer to a [`Request`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // one is alive at a time, in static memory
pub enum Answer {
    /// Bytes of the memory; fewer than [`PIECE_BYTES`] at its end, none behind it.
    Piece {
        /// First byte.
        offset: u32,
        /// The bytes.
        bytes: Vec<u8, PIECE_BYTES>,
    },
    /// The contents are discarded within a millisecond.
    Discarded,
}

impl Memory {
    /// Carries out a request of the host. For the link task.
    pub fn answer(&self, request: Request) -> Answer {
        match request {
            Request::Read { offset } => {
                self.pause();
                let mut bytes = Vec::new();
                let words = (offset as usize / 4..).map_while(|word| self.word(word));
                for word in words.take(PIECE_BYTES / 4) {
                    // There is room for as many words.
                    let _ = bytes.extend_from_slice(&word.to_le_bytes());
                }
                Answer::Piece { offset, bytes }
            }
            Request::Discard => {
                self.discard();
                Answer::Discarded
            }
        }
    }
}

#[cfg(test)]
mod tests;
