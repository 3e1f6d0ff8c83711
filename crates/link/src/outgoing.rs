//! A frame on its way to the line.
//!
//! Invariant: a frame that has been started is finished, unless it is abandoned; then a 0x00 ends it.

use crate::frame::{FRAME_BYTES_MAX, encode};
use serde::Serialize;

/// The bytes of a frame that have not been sent.
pub(crate) struct Outgoing {
    frame: [u8; FRAME_BYTES_MAX],
    length: usize,
    sent: usize,
}

impl Outgoing {
    pub(crate) const fn new() -> Self {
        Self {
            frame: [0; FRAME_BYTES_MAX],
            length: 0,
            sent: 0,
        }
    }

    /// Whether all bytes have been sent.
    pub(crate) fn is_empty(&self) -> bool {
        self.sent >= self.length
    }

    /// Takes a message. The frame before has been sent; a message that is too long is dropped.
    pub(crate) fn put(&mut self, message: &impl Serialize) {
        self.sent = 0;
        self.length = encode(message, &mut self.frame).unwrap_or(0);
    }

    /// Moves bytes to the front of `out`; returns how many.
    pub(crate) fn fill(&mut self, out: &mut [u8]) -> usize {
        let waiting = self.frame.get(self.sent..self.length).unwrap_or(&[]);
        let moved = out.iter_mut().zip(waiting).map(|(place, byte)| *place = *byte).count();
        self.sent += moved;
        moved
    }

    /// Replaces the frame by a 0x00, which ends the part of it that the line may have sent.
    pub(crate) fn abandon(&mut self) {
        (self.length, self.sent) = (1, 0);
        if let Some(first) = self.frame.first_mut() {
            *first = 0;
        }
    }
}
