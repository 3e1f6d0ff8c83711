//! Memory of the firmware that the host reads, as a debug probe would: the black box.
//!
//! The host asks for it in the lockstep (see `lockstep`). The firmware copies nothing and spends no virtual time on it. It
//! sends the memory in pieces, because a FIFO takes only a small one in a single write.

use super::black_box::BLACK_BOX;
use super::semihosting::{Closed, File};
use etherpen::black_box::MEMORY_BYTES;

/// Number of the area that the host can ask for.
const AREA_BLACK_BOX: u8 = 0;
/// Most bytes in a write: a FIFO takes them whole.
const PIECE_BYTES: usize = 4096;

const _: () = assert!(MEMORY_BYTES.is_multiple_of(PIECE_BYTES));

/// Sends an area to the host; nothing for a number that is none.
pub(crate) fn send(to: File, area: u8) -> Result<(), Closed> {
    let (first, bytes) = match area {
        AREA_BLACK_BOX => ((&raw const BLACK_BOX).addr(), MEMORY_BYTES),
        _ => return Ok(()),
    };
    for offset in (0..bytes).step_by(PIECE_BYTES) {
        // SAFETY: the area is a static. Only the host reads, as a debug probe reads memory: no reference is made, so words that
        // are in use may change between two pieces.
        unsafe { to.write_memory(first + offset, PIECE_BYTES) }?;
    }
    Ok(())
}
