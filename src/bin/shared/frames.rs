//! The frames that the Ethernet driver has in its buffers, for the black box.
//!
//! The critical tasks note the address of each frame's buffer; the recorder reads it from there, below them.

use crate::board;
use core::ptr;
use etherpen::black_box::{Direction, FrameNote, FrameNotes, FrameSource};

static NOTES: FrameNotes = FrameNotes::new();

/// Notes a frame in one of the driver's buffers, which are static, aligned to words, and have room for each frame in
/// whole words. Safe in a critical task.
pub(crate) fn note(direction: Direction, buffer: *const u8, length: usize, counts: u32) {
    NOTES.note(direction, buffer.expose_provenance() as u32, length, counts);
}

/// The noted frames; for the recorder alone.
pub(crate) struct Frames;

impl FrameSource for Frames {
    fn notes(&self) -> &FrameNotes {
        &NOTES
    }

    fn word(&self, note: &FrameNote, index: usize) -> u32 {
        let word = note.place as usize + index * size_of::<u32>();
        // SAFETY: `note` got the address of a static buffer with room for the frame in whole words, and the recorder
        // asks for no word behind them. Only critical tasks and the DMA write there; the former run to their end before
        // this task goes on, so no reference of theirs is alive now, and what the latter has changed meanwhile is
        // thrown away (`is_intact`). Volatile, because the compiler cannot know of either.
        u32::from_le(unsafe { ptr::read_volatile(ptr::with_exposed_provenance::<u32>(word)) })
    }

    fn is_intact(&self, note: &FrameNote) -> bool {
        let is_readable = board::is_readable(note);
        // Last: who has refilled the buffer meanwhile has also noted all frames between.
        let later = NOTES.count().wrapping_sub(note.number).wrapping_sub(1);
        is_readable && later < board::FRAME_BUFFERS
    }
}
