//! The black box on one core: its memory, which a reset may cut short at every access, and the notes of frames, which
//! critical tasks write while the recorder reads.

/// Words of a sample.
pub const SAMPLE_WORDS: usize = 16;

#[allow(dead_code)]
mod memory {
    include!(concat!(env!("OUT_DIR"), "/memory.rs"));
}

#[allow(dead_code)]
mod frames {
    include!(concat!(env!("OUT_DIR"), "/frames.rs"));
}

pub use frames::{Direction, FrameNote, FrameNotes, FrameSource};
pub use memory::Memory;
use memory::{EVENT_WORDS, Image, Keep, MEMORY_BYTES};

/// An empty memory that records.
pub fn recording() -> Box<Memory> {
    let memory = Box::new(Memory::new());
    memory.start(Keep::Nothing);
    memory
}

/// Records a sample whose words are all this number.
pub fn put_sample(memory: &Memory, number: u32) {
    memory.put_sample(&[number; SAMPLE_WORDS]);
}

/// Records an event whose words are all this number.
pub fn put_event(memory: &Memory, number: u32) {
    memory.put_event(&[number; EVENT_WORDS]);
}

/// Fetches frames.
pub struct Fetcher(frames::FrameRing);

impl Fetcher {
    /// Of the notes that come from now on.
    pub fn new(source: &impl FrameSource) -> Self {
        let mut ring = frames::FrameRing::new();
        ring.skip(source);
        Self(ring)
    }

    /// Copies what has been noted since the last call.
    pub fn take(&mut self, memory: &Memory, source: &impl FrameSource) {
        self.0.take(memory, source, 0);
    }
}

/// What a reset would leave in the memory.
pub struct Left(Vec<u8>);

impl Left {
    /// Of the memory as it is now.
    pub fn by(memory: &Memory) -> Self {
        let words = (0..MEMORY_BYTES / 4).filter_map(|index| memory.word(index));
        Self(words.flat_map(u32::to_le_bytes).collect())
    }

    fn entries(&self, starts: impl Iterator<Item = usize>, words: usize) -> Vec<Vec<u32>> {
        let image = Image(&self.0);
        let entry = |start: usize| (start..start + words).filter_map(|index| image.word(index));
        starts.map(|start| entry(start).collect()).collect()
    }

    /// The samples' words, oldest first.
    pub fn samples(&self) -> Vec<Vec<u32>> {
        self.entries(Image(&self.0).samples(), SAMPLE_WORDS)
    }

    /// The events' words, oldest first.
    pub fn events(&self) -> Vec<Vec<u32>> {
        self.entries(Image(&self.0).events(), EVENT_WORDS)
    }

    /// The frames: the time when it passed, and its words; oldest first.
    pub fn frames(&self) -> Vec<(u32, Vec<u32>)> {
        let image = Image(&self.0);
        let (mut at, end) = image.frame_positions();
        let mut frames = Vec::new();
        while at != end {
            let word = |index| image.frame_word(memory::frame_position(at, index));
            let words = frames::frame_words(frames::length(word(frames::FRAME_HEADER_WORDS - 1)));
            frames.push((word(0), (frames::FRAME_HEADER_WORDS..words).map(word).collect()));
            assert!(memory::frame_distance(at, end) >= words, "a frame behind the last one");
            at = memory::frame_position(at, words);
        }
        frames
    }

    /// Frames that passed but were not recorded.
    pub fn missed(&self) -> u32 {
        Image(&self.0).frames_missed()
    }
}
