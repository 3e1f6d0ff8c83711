//! Reads consecutive little-endian numbers from bytes.
//!
//! MCAP's records and CDR's messages differ in the position of a number, not in its format. Invariant: missing bytes
//! give `None`.

/// Bytes that are read from the front.
pub(super) trait Numbers {
    /// The bytes of the next number.
    fn array<const N: usize>(&mut self) -> Option<[u8; N]>;

    fn byte(&mut self) -> Option<u8> {
        self.array().map(u8::from_le_bytes)
    }

    fn short(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn word(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn long(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn double(&mut self) -> Option<f64> {
        self.array().map(f64::from_le_bytes)
    }
}
