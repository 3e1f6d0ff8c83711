//! Values as CDR, little-endian: each aligned to its size from the end of the header.

use super::bytes::Numbers;

/// Header of a message: plain CDR, little-endian.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Appends values, each aligned to its size from the end of the header.
pub(super) struct Encoder<'a> {
    out: &'a mut Vec<u8>,
    begin: usize,
}

impl<'a> Encoder<'a> {
    pub(super) fn new(out: &'a mut Vec<u8>) -> Self {
        out.extend(ENCAPSULATION);
        let begin = out.len();
        Self { out, begin }
    }

    pub(super) fn put(&mut self, bytes: &[u8]) {
        let length = (self.out.len() - self.begin).next_multiple_of(bytes.len().max(1));
        self.out.resize(self.begin + length, 0);
        self.out.extend(bytes);
    }

    pub(super) fn byte(&mut self, value: u8) {
        self.out.push(value);
    }

    pub(super) fn short(&mut self, value: u16) {
        self.put(&value.to_le_bytes());
    }

    pub(super) fn word(&mut self, value: u32) {
        self.put(&value.to_le_bytes());
    }

    pub(super) fn double(&mut self, value: f64) {
        self.put(&value.to_le_bytes());
    }

    /// Writes the length including the final zero, the text, and the zero.
    pub(super) fn text(&mut self, text: &str) {
        self.word(text.len() as u32 + 1);
        self.out.extend(text.as_bytes());
        self.out.push(0);
    }
}

/// Reads what [`Encoder`] has written.
pub(super) struct Decoder<'a> {
    bytes: &'a [u8],
    place: usize,
}

impl<'a> Decoder<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Option<Self> {
        let bytes = bytes.strip_prefix(&ENCAPSULATION)?;
        Some(Self { bytes, place: 0 })
    }

    /// Whether all bytes have been read.
    pub(super) fn is_at_end(&self) -> bool {
        self.place == self.bytes.len()
    }

    pub(super) fn text(&mut self) -> Option<String> {
        let length = self.word()? as usize;
        let end = self.place.checked_add(length)?;
        let text = self.bytes.get(self.place..end)?.strip_suffix(&[0])?;
        self.place = end;
        String::from_utf8(text.to_vec()).ok()
    }
}

impl Numbers for Decoder<'_> {
    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let begin = self.place.next_multiple_of(N);
        let end = begin.checked_add(N)?;
        self.place = end;
        self.bytes.get(begin..end)?.try_into().ok()
    }
}
