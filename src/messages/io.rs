//! The named inputs and outputs in a sample and in a status.
//!
//! Invariant: a point that is not exchanged has no value.

use crate::config::{SAMPLE_WORD_BYTES_MAX, SAMPLE_WORDS_MAX};
use serde::{Deserialize, Serialize};

/// The named inputs and outputs in one millisecond: a bit for each in the order of the configuration, from the lowest bit,
/// and the values of the first words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct IoValues {
    /// Points whose value is not 0: inputs as last read, outputs as written for the next output
    /// telegram.
    pub set: u16,
    /// Points that are not exchanged.
    pub missing: u16,
    /// Values of the [sampled words](crate::config::sampled_words), in their order; 0 while one is missing.
    pub words: IoWords,
}

impl IoValues {
    /// Points of which nothing is known.
    pub const UNKNOWN: Self = Self {
        set: 0,
        missing: u16::MAX,
        words: IoWords::NONE,
    };

    /// Whether the value of a point, from 0, is not 0; `None` while it is missing.
    pub const fn get(self, io: usize) -> Option<bool> {
        if io >= u16::BITS as usize || self.missing >> io & 1 != 0 {
            return None;
        }
        Some(self.set >> io & 1 != 0)
    }
}

/// The values of the first named words in one millisecond: their bits, the highest bits 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct IoWords {
    /// Two bits for the size of each word, from the lowest bits: no word, 1, 2 or 4 bytes, the fewest that hold its value.
    sizes: u8,
    /// The words, little-endian, without gaps; 0 behind the last one.
    bytes: [u8; SAMPLE_WORD_BYTES_MAX],
}

const _: () = assert!(2 * SAMPLE_WORDS_MAX <= u8::BITS as usize, "two bits for each word");

/// Bytes of a word by its size.
const fn length(size: u8) -> usize {
    match size & 3 {
        3 => 4,
        size => size as usize,
    }
}

/// Bytes of each word by their sizes, up to the first place without a word.
fn lengths(sizes: u8) -> impl Iterator<Item = usize> {
    let sizes = (0..SAMPLE_WORDS_MAX).map(move |word| sizes >> (2 * word));
    sizes.map(length).take_while(|length| *length > 0)
}

impl IoWords {
    /// No words.
    pub const NONE: Self = Self {
        sizes: 0,
        bytes: [0; SAMPLE_WORD_BYTES_MAX],
    };

    /// The values.
    pub fn values(&self) -> impl Iterator<Item = u32> {
        let mut rest = self.bytes.as_slice();
        lengths(self.sizes).map(move |length| {
            let (bytes, behind) = rest.split_at_checked(length).unwrap_or_default();
            rest = behind;
            bytes.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte))
        })
    }

    /// Sizes and bytes of the words.
    pub(super) fn packed(&self) -> (u8, &[u8]) {
        let length = lengths(self.sizes).sum();
        (self.sizes, self.bytes.get(..length).unwrap_or(&self.bytes))
    }

    /// Words of these sizes from the front of `rest`, and what is behind them; `None` if they are not
    /// [packed](Self::packed) words.
    pub(super) fn unpack(sizes: u8, rest: &[u8]) -> Option<(Self, &[u8])> {
        let (packed, behind) = rest.split_at_checked(lengths(sizes).sum())?;
        let mut words = Self { sizes, ..Self::NONE };
        words.bytes.get_mut(..packed.len())?.copy_from_slice(packed);
        (words == words.values().collect()).then_some((words, behind))
    }
}

/// Values beyond [`SAMPLE_WORDS_MAX`] and [`SAMPLE_WORD_BYTES_MAX`] are left out.
impl FromIterator<u32> for IoWords {
    fn from_iter<T: IntoIterator<Item = u32>>(values: T) -> Self {
        let (mut words, mut used) = (Self::NONE, 0);
        for (word, value) in values.into_iter().take(SAMPLE_WORDS_MAX).enumerate() {
            let size = match value {
                0..=0xFF => 1,
                0x100..=0xFFFF => 2,
                _ => 3,
            };
            let place = words.bytes.get_mut(used..used + length(size));
            let (Some(place), value) = (place, value.to_le_bytes()) else {
                break;
            };
            place.iter_mut().zip(value).for_each(|(place, byte)| *place = byte);
            words.sizes |= size << (2 * word);
            used += length(size);
        }
        words
    }
}

/// State of a named input or output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct IoState {
    /// Its bits: of an input as last read, of an output as written.
    pub raw: u32,
    /// Whether its terminal exchanges it.
    pub valid: bool,
}
