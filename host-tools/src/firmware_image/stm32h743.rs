//! The STM32H743ZI's memory map, and whether the chip can start an image.

use super::Image;

/// Flash memory of an STM32H743ZI (RM0433, memory map): start and length.
const FLASH: (u32, u32) = (0x0800_0000, 2 * 1024 * 1024);
/// Memory in which the image's stack may begin: DTCM and AXI SRAM.
const STACK: [(u32, u32); 2] = [(0x2000_0000, 128 * 1024), (0x2400_0000, 512 * 1024)];
/// Section of the vector table. It begins with the start of the stack and the address of the first instruction.
const VECTORS: &str = ".vector_table";

/// Checks that the chip can start an image.
///
/// # Errors
/// Why the chip cannot start it, and what to try.
pub fn check(image: &Image) -> Result<(), String> {
    let vectors = image
        .section(VECTORS)
        .ok_or_else(|| format!("it has no section {VECTORS}; build one with: cargo nucleo"))?;
    if vectors.address != FLASH.0 {
        return Err(format!(
            "its vector table is at {:#010x}, this chip starts at {:#010x}: it is the image of another board; build one \
             with: cargo nucleo",
            vectors.address, FLASH.0
        ));
    }
    for load in image.loads() {
        if !within(FLASH, load.address, load.size) {
            return Err(format!(
                "{} bytes at {:#010x} are outside the flash memory of {} KiB at {:#010x}",
                load.size,
                load.address,
                FLASH.1 / 1024,
                FLASH.0
            ));
        }
    }
    let stack = image.word(FLASH.0).unwrap_or_default();
    if !STACK.iter().any(|memory| within(*memory, stack, 0)) {
        return Err(format!(
            "its stack would begin at {stack:#010x}, where this chip has no memory for it"
        ));
    }
    let entry = image.word(FLASH.0 + 4).unwrap_or_default();
    if entry & 1 == 0 || !within(FLASH, entry & !1, 2) {
        return Err(format!(
            "it would begin at {entry:#010x}, which is no Thumb code in the flash memory"
        ));
    }
    Ok(())
}

/// Whether `size` bytes at an address are inside a memory.
fn within((start, length): (u32, u32), address: u32, size: u32) -> bool {
    let offset = address.checked_sub(start);
    offset
        .and_then(|offset| offset.checked_add(size))
        .is_some_and(|end| end <= length)
}
