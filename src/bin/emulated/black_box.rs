//! The black box of the emulated board: memory that ends with the emulator, therefore saved to the host when the
//! firmware ends.

use super::semihosting::File;
use core::slice;
use etherpen::black_box::{Keep, MEMORY_BYTES, Memory};

pub(crate) static BLACK_BOX: Memory = Memory::new();

/// Saves the memory, as the next start of a board would find it, to the file `black-box.bin` in the emulator's working directory.
///
/// # Safety
///
/// All interrupts are masked and stay so until the end.
pub(crate) unsafe fn save() {
    let Some(file) = File::open_to_write(c"black-box.bin") else {
        return;
    };
    BLACK_BOX.start(Keep::UntilDiscarded);
    // SAFETY: the memory is as long, and any bytes are valid; nobody writes to it any more.
    let bytes = unsafe { slice::from_raw_parts((&raw const BLACK_BOX).cast::<u8>(), MEMORY_BYTES) };
    // A host that does not take it gets no black box.
    let _ = file.write(bytes);
}
