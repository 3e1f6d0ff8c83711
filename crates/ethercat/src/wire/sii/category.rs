//! The chain of categories behind the fixed part, parsed header by header.
//!
//! [`CategoryWalker`] does not access memory: it names the word that it needs next and takes its content. A master
//! reads the SII through registers, a few bytes at a time, and thus fetches only the headers and the categories that it
//! needs; [`Categories`] walks over bytes in memory.
//!
//! Invariant: every step moves forward, and there are at most [`CATEGORIES_MAX`] steps.

use super::{CATEGORY_END, WORD_CATEGORIES};
use crate::wire::read_u16;

/// Most categories of a chain; a longer one counts as endless.
pub const CATEGORIES_MAX: u8 = 64;
/// Words of a category's header: kind and length.
pub const CATEGORY_HEADER_WORDS: u16 = 2;

/// Type without meaning; with length 0 it marks memory that was never written.
const CATEGORY_NOP: u16 = 0;
/// Types reserved for device-specific use.
const DEVICE_SPECIFIC: core::ops::RangeInclusive<u16> = 1..=9;
/// First of the vendor-specific types.
const VENDOR_SPECIFIC_FIRST: u16 = 0x0800;

/// Place of a category.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CategoryHeader {
    /// Type of the category, see the `CATEGORY_` constants.
    pub kind: u16,
    /// Word address of its first word of data.
    pub word: u16,
    /// Length of the data, words.
    pub words: u16,
}

impl CategoryHeader {
    /// Whether the category is device-specific or vendor-specific.
    pub fn is_private(&self) -> bool {
        DEVICE_SPECIFIC.contains(&self.kind) || (VENDOR_SPECIFIC_FIRST..CATEGORY_END).contains(&self.kind)
    }
}

/// Why a chain ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChainEnd {
    /// At its end mark; erased memory looks like an end mark too.
    Marked,
    /// At zeros: memory that was never written.
    Blank,
    /// The memory ends where a header is expected.
    Missing,
    /// A category exceeds the memory; this category and all behind it are void.
    Outside {
        /// Header of that category.
        category: CategoryHeader,
    },
    /// The chain has more than [`CATEGORIES_MAX`] categories.
    Endless,
}

/// Walks a chain of categories without accessing memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CategoryWalker {
    word: u16,
    words: u16,
    seen: u8,
    private: u8,
    end: Option<ChainEnd>,
}

impl CategoryWalker {
    /// A walk through a memory of `words` words.
    pub const fn new(words: u16) -> Self {
        let mut walker = Self {
            word: WORD_CATEGORIES,
            words,
            seen: 0,
            private: 0,
            end: None,
        };
        walker.check_room();
        walker
    }

    const fn check_room(&mut self) {
        // The end mark has no length, so it may be the last word.
        if self.word >= self.words {
            self.end = Some(ChainEnd::Missing);
        }
    }

    /// Word address of the next header, [`CATEGORY_HEADER_WORDS`] long; `None` when the chain has ended.
    pub const fn next_word(&self) -> Option<u16> {
        match self.end {
            None => Some(self.word),
            Some(_) => None,
        }
    }

    /// Why the chain has ended; `None` before its end.
    pub const fn end(&self) -> Option<ChainEnd> {
        self.end
    }

    /// Number of device-specific and vendor-specific categories so far.
    pub const fn private_count(&self) -> u8 {
        self.private
    }

    /// Takes the header at [`Self::next_word`] and returns the category; `None` when the chain ends there.
    pub fn feed(&mut self, kind: u16, length_words: u16) -> Option<CategoryHeader> {
        if self.end.is_some() {
            return None;
        }
        let category = CategoryHeader {
            kind,
            word: self.word.saturating_add(CATEGORY_HEADER_WORDS),
            words: length_words,
        };
        let behind = u32::from(self.word) + u32::from(CATEGORY_HEADER_WORDS) + u32::from(length_words);
        self.end = match kind {
            CATEGORY_END => Some(ChainEnd::Marked),
            CATEGORY_NOP if length_words == 0 => Some(ChainEnd::Blank),
            _ if behind > u32::from(self.words) => Some(ChainEnd::Outside { category }),
            _ if self.seen >= CATEGORIES_MAX => Some(ChainEnd::Endless),
            _ => None,
        };
        if self.end.is_some() {
            return None;
        }
        self.seen += 1;
        self.private += u8::from(category.is_private());
        self.word = behind as u16;
        self.check_room();
        Some(category)
    }
}

/// The categories of an SII in memory, from word 0.
#[derive(Clone, Debug)]
pub struct Categories<'a> {
    image: &'a [u8],
    walker: CategoryWalker,
}

impl<'a> Categories<'a> {
    /// Walks the categories in `image`, which starts at word 0; an odd last byte is ignored.
    pub fn new(image: &'a [u8]) -> Self {
        let words = u16::try_from(image.len() / 2).unwrap_or(u16::MAX);
        Self {
            image,
            walker: CategoryWalker::new(words),
        }
    }

    /// State of the walk: why it ended, and how many private categories it found.
    pub const fn walker(&self) -> &CategoryWalker {
        &self.walker
    }
}

impl<'a> Iterator for Categories<'a> {
    type Item = (CategoryHeader, &'a [u8]);

    fn next(&mut self) -> Option<Self::Item> {
        let at = usize::from(self.walker.next_word()?) * 2;
        let category = self
            .walker
            .feed(read_u16(self.image, at), read_u16(self.image, at + 2))?;
        let start = usize::from(category.word) * 2;
        let data = self.image.get(start..start + usize::from(category.words) * 2);
        Some((category, data.unwrap_or(&[])))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An SII of `words` words with the given chain behind the fixed part.
    fn image<const BYTES: usize>(chain: &[u16]) -> [u8; BYTES] {
        let mut bytes = [0; BYTES];
        for (target, word) in bytes[128..].chunks_exact_mut(2).zip(chain) {
            target.copy_from_slice(&word.to_le_bytes());
        }
        bytes
    }

    fn walk(image: &[u8]) -> (usize, Option<ChainEnd>, u8) {
        let mut categories = Categories::new(image);
        let count = categories.by_ref().count();
        (count, categories.walker().end(), categories.walker().private_count())
    }

    #[test]
    fn private_categories_are_passed_over_and_counted() {
        let chain = [0x0800, 1, 0xAAAA, 7, 0, 40, 1, 0x0201, 0xFFFF];
        let bytes: [u8; 200] = image(&chain);
        assert_eq!(walk(&bytes), (3, Some(ChainEnd::Marked), 2));
        let fmmus = Categories::new(&bytes).find(|(category, _)| category.kind == 40);
        assert_eq!(
            fmmus.map(|(category, data)| (category.word, data)),
            Some((0x47, &[1, 2][..]))
        );
    }

    #[test]
    fn a_chain_ends_at_blank_memory_at_the_memorys_end_and_at_a_category_that_is_cut() {
        assert_eq!(walk(&image::<200>(&[40, 1, 1])), (1, Some(ChainEnd::Blank), 0));
        assert_eq!(walk(&[0xFF; 200]), (0, Some(ChainEnd::Marked), 0));
        assert_eq!(walk(&[0; 200]), (0, Some(ChainEnd::Blank), 0));
        assert_eq!(walk(&image::<134>(&[40, 1, 1])), (1, Some(ChainEnd::Missing), 0));
        assert_eq!(walk(&image::<136>(&[40, 1, 1, 0xFFFF])), (1, Some(ChainEnd::Marked), 0));
        let category = CategoryHeader {
            kind: 41,
            word: 0x45,
            words: 0xFFFF,
        };
        let cut = image::<200>(&[40, 1, 1, 41, 0xFFFF]);
        assert_eq!(walk(&cut), (1, Some(ChainEnd::Outside { category }), 0));
        for length in 0..=129 {
            assert_eq!(walk(&cut[..length]), (0, Some(ChainEnd::Missing), 0), "{length}");
        }
    }

    #[test]
    fn an_endless_chain_is_left_after_the_longest_one_allowed() {
        let mut bytes = [0; 4096];
        bytes[128..].chunks_exact_mut(4).for_each(|header| header[0] = 40);
        assert_eq!(walk(&bytes), (usize::from(CATEGORIES_MAX), Some(ChainEnd::Endless), 0));
    }

    #[test]
    fn a_master_reads_only_the_headers_that_the_walker_asks_for() {
        let bytes: [u8; 200] = image(&[10, 3, 0, 0, 0, 40, 1, 0x0201, 0xFFFF]);
        let mut walker = CategoryWalker::new(100);
        let mut asked = heapless::Vec::<u16, 8>::new();
        while let Some(word) = walker.next_word() {
            asked.push(word).unwrap();
            let at = usize::from(word) * 2;
            walker.feed(read_u16(&bytes, at), read_u16(&bytes, at + 2));
        }
        assert_eq!(asked, [0x40, 0x45, 0x48]);
        assert_eq!(walker.end(), Some(ChainEnd::Marked));
    }
}
