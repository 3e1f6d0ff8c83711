//! Volatile access to the Ethernet controller's registers.

use core::arch::global_asm;
use etherpen::ethernet::lan9118::{self, Register, Registers, WORD_BYTES};

const BASE: usize = 0xa000_0000;
/// Words moved by one instruction; the data FIFOs answer at as many addresses in a row.
const BLOCK_WORDS: usize = 8;

type Block = [[u8; WORD_BYTES]; BLOCK_WORDS];

// r0: buffer, aligned to a word; r1: blocks of eight words, at least one; r2: address of the FIFO.
global_asm!(
    ".syntax unified",
    ".thumb",
    ".section .text.etherpen_fifo_read, \"ax\", %progbits",
    ".global etherpen_fifo_read",
    ".type etherpen_fifo_read, %function",
    ".thumb_func",
    "etherpen_fifo_read:",
    "    push {{r4-r10}}",
    "1:  ldm r2, {{r3-r10}}",
    "    stm r0!, {{r3-r10}}",
    "    subs r1, #1",
    "    bne 1b",
    "    pop {{r4-r10}}",
    "    bx lr",
    ".size etherpen_fifo_read, . - etherpen_fifo_read",
    ".section .text.etherpen_fifo_write, \"ax\", %progbits",
    ".global etherpen_fifo_write",
    ".type etherpen_fifo_write, %function",
    ".thumb_func",
    "etherpen_fifo_write:",
    "    push {{r4-r10}}",
    "1:  ldm r0!, {{r3-r10}}",
    "    stm r2, {{r3-r10}}",
    "    subs r1, #1",
    "    bne 1b",
    "    pop {{r4-r10}}",
    "    bx lr",
    ".size etherpen_fifo_write, . - etherpen_fifo_write",
);

unsafe extern "C" {
    fn etherpen_fifo_read(buffer: *mut Block, blocks: usize, fifo: usize);
    fn etherpen_fifo_write(buffer: *const Block, blocks: usize, fifo: usize);
}

/// The controller's registers; there is one value of this type.
pub(crate) struct Mmio(());

impl Mmio {
    /// Takes the registers.
    ///
    /// # Safety
    /// Call it once: two owners would interleave their accesses to the FIFOs.
    pub(crate) const unsafe fn take() -> Self {
        Self(())
    }
}

impl Registers for Mmio {
    fn read(&mut self, register: Register) -> u32 {
        read(register)
    }

    fn write(&mut self, register: Register, value: u32) {
        // SAFETY: the address is a register of the controller, aligned to a word, and `self` is its only owner; the
        // controller reads no memory of its own, so no write can reach Rust's objects.
        unsafe { core::ptr::write_volatile((BASE + register as usize) as *mut u32, value) }
    }

    fn read_data(&mut self, words: &mut [[u8; WORD_BYTES]]) {
        let (blocks, rest) = words.as_chunks_mut::<BLOCK_WORDS>();
        if !blocks.is_empty() && blocks.as_ptr().addr().is_multiple_of(WORD_BYTES) {
            // SAFETY: the buffer is borrowed for writing, aligned, and as long as the number of blocks says; the FIFO
            // answers at the eight addresses from the register's on, `self` is its only owner, and the frame's status
            // has announced that many words. No interrupt is above the tasks that come here, so none repeats a load.
            unsafe { etherpen_fifo_read(blocks.as_mut_ptr(), blocks.len(), BASE + Register::RxData as usize) }
            read_words(rest);
        } else {
            read_words(words);
        }
    }

    fn write_data(&mut self, words: &[[u8; WORD_BYTES]]) {
        let (blocks, rest) = words.as_chunks::<BLOCK_WORDS>();
        let aligned = blocks.as_ptr().addr().is_multiple_of(WORD_BYTES);
        let rest = if !blocks.is_empty() && aligned {
            // SAFETY: as for reading; the FIFO's level has shown that there is room.
            unsafe { etherpen_fifo_write(blocks.as_ptr(), blocks.len(), BASE + Register::TxData as usize) }
            rest
        } else {
            words
        };
        for word in rest {
            self.write(Register::TxData, u32::from_le_bytes(*word));
        }
    }
}

fn read_words(words: &mut [[u8; WORD_BYTES]]) {
    for word in words {
        *word = read(Register::RxData).to_le_bytes();
    }
}

fn read(register: Register) -> u32 {
    // SAFETY: the address is a register of the controller, aligned to a word; reading it reaches no memory.
    unsafe { core::ptr::read_volatile((BASE + register as usize) as *const u32) }
}

/// The controller's free-running counter. Reading it changes nothing, so it needs no owner.
pub(crate) fn free_run() -> u32 {
    read(Register::FreeRun)
}

/// Number of frames waiting in the controller. Reading the level changes nothing, so it needs no owner.
pub(crate) fn frames_waiting() -> u32 {
    lan9118::frames_waiting(read(Register::RxFifoInf))
}
