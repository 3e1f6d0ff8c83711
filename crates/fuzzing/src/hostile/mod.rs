//! Files of 10 MiB that demand as much memory and time as their format lets them.
//!
//! Every format has files of its weak places: depth, counts, lengths, announced sizes, and pairs of lists that a simple
//! reader compares with each other.

mod binary;
mod picture;
mod text;
mod vector;

/// Length of a file, bytes; some end a little earlier.
pub const FILE_BYTES: usize = 10 << 20;

/// A file that demands much.
#[derive(Clone, Copy)]
pub struct Hostile {
    /// Name of the file; its extension says what it claims to be.
    pub name: &'static str,
    /// Makes its content.
    pub make: fn() -> Vec<u8>,
}

/// All files.
#[must_use]
pub fn files() -> Vec<Hostile> {
    [vector::FILES, text::FILES, picture::FILES, binary::FILES].concat()
}

/// A part repeated between a head and a tail.
fn filled(head: &str, part: &str, tail: &str) -> Vec<u8> {
    let count = (FILE_BYTES - head.len() - tail.len()) / part.len();
    format!("{head}{}{tail}", part.repeat(count)).into_bytes()
}

/// Numbered parts between a head and a tail, as many as fit.
fn numbered(head: &str, part: impl Fn(usize) -> String, tail: &str) -> Vec<u8> {
    let mut text = head.to_owned();
    for number in 0.. {
        let part = part(number);
        if text.len() + part.len() + tail.len() > FILE_BYTES {
            break;
        }
        text += &part;
    }
    (text + tail).into_bytes()
}
