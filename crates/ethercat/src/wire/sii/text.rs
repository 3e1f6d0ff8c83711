//! The strings of the SII, counted from 1, each preceded by its length.
//!
//! Invariant: an index without a string gives `None`, whatever the lengths say.

use crate::wire::read_u8;

/// A view of the category [`CATEGORY_STRINGS`](super::CATEGORY_STRINGS).
#[derive(Clone, Copy, Debug, Default)]
pub struct Strings<'a> {
    data: &'a [u8],
}

impl<'a> Strings<'a> {
    /// A view of the category's data; an empty slice has no strings.
    pub const fn new(data: &'a [u8]) -> Self {
        Self { data }
    }

    /// Number of strings that the category announces.
    pub fn count(&self) -> u8 {
        read_u8(self.data, 0)
    }

    /// The bytes of a string up to its first NUL. `None` for index 0, which means no string, for an index beyond the
    /// count, and for a string that exceeds the category.
    pub fn get(&self, index: u8) -> Option<&'a [u8]> {
        if index == 0 || index > self.count() {
            return None;
        }
        let mut rest = self.data.get(1..)?;
        for _ in 1..index {
            let (&length, behind) = rest.split_first()?;
            rest = behind.get(usize::from(length)..)?;
        }
        let (&length, behind) = rest.split_first()?;
        let whole = behind.get(..usize::from(length))?;
        whole.split(|&byte| byte == 0).next()
    }

    /// The string of [`Self::get`] as text, up to the first byte that is not UTF-8; empty if there is none.
    pub fn text(&self, index: u8) -> &'a str {
        let bytes = self.get(index).unwrap_or(&[]);
        match core::str::from_utf8(bytes) {
            Ok(text) => text,
            Err(error) => bytes
                .get(..error.valid_up_to())
                .and_then(|valid| core::str::from_utf8(valid).ok())
                .unwrap_or(""),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strings_are_found_by_index_and_nothing_else_is() {
        let strings = Strings::new(&[4, 2, b'a', b'b', 0, 4, b'c', 0, 0, 0, 2, b'd', 0xFF]);
        assert_eq!(strings.count(), 4);
        assert_eq!(strings.get(0), None);
        assert_eq!(strings.get(1), Some(&b"ab"[..]));
        assert_eq!(strings.get(2), Some(&b""[..]));
        assert_eq!(strings.get(3), Some(&b"c"[..]), "padding is no text");
        assert_eq!(strings.text(4), "d", "0xFF is no text");
        assert_eq!((strings.get(5), strings.text(5)), (None, ""));
        assert_eq!(Strings::new(&[]).get(1), None);
    }

    #[test]
    fn a_string_that_reaches_out_of_the_category_is_none_and_hides_those_behind() {
        let strings = Strings::new(&[3, 1, b'a', 9, b'b', b'c']);
        assert_eq!(strings.text(1), "a");
        assert_eq!((strings.get(2), strings.get(3)), (None, None));
        assert_eq!(Strings::new(&[255]).get(255), None);
    }
}
