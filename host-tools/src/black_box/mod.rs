//! Black boxes: the memory of a controller's last two seconds, read piece by piece, taken apart, exported and replayed.
//!
//! A [`Reader`] collects the memory of a running controller. [`contents::Contents`] is what a memory holds, with times
//! that count back from the end of the recording. [`export`] makes files of it.
//!
//! Invariant: no memory image makes these modules panic. What cannot be read is counted or left out.

pub mod contents;
pub mod export;
pub mod replay;

use etherpen::black_box::{Answer, MEMORY_BYTES, Memory, Request};

/// Bytes of a word: a request begins at a whole one.
const WORD_BYTES: usize = 4;

/// Collects the memory of a controller, one piece after the other.
#[derive(Clone, Debug, Default)]
pub struct Reader {
    memory: Vec<u8>,
}

impl Reader {
    /// A reader before its first request.
    pub fn new() -> Self {
        Self::default()
    }

    /// The next request; `None` when the whole memory was read.
    pub fn request(&self) -> Option<Request> {
        let offset = u32::try_from(self.memory.len()).ok()?;
        (self.memory.len() < MEMORY_BYTES).then_some(Request::Read { offset })
    }

    /// Takes the piece behind those read so far, in whole words. Returns false for any other answer and leaves it out.
    pub fn take(&mut self, answer: &Answer) -> bool {
        let Answer::Piece { offset, bytes } = answer else {
            return false;
        };
        if usize::try_from(*offset) != Ok(self.memory.len()) {
            return false;
        }
        let length = bytes.len().min(MEMORY_BYTES - self.memory.len());
        let whole = bytes.get(..length - length % WORD_BYTES).unwrap_or_default();
        self.memory.extend_from_slice(whole);
        !whole.is_empty()
    }

    /// Bytes read so far.
    pub fn bytes_read(&self) -> usize {
        self.memory.len()
    }

    /// The memory; `None` if it is incomplete.
    pub fn into_memory(self) -> Option<Vec<u8>> {
        self.request().is_none().then_some(self.memory)
    }
}

/// The bytes of a memory of this process.
pub fn image(memory: &Memory) -> Vec<u8> {
    let words = (0..).map_while(|index| memory.word(index));
    words.flat_map(u32::to_le_bytes).collect()
}

#[cfg(test)]
mod tests;
