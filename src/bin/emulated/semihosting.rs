//! Semihosting calls to the emulator: files in its working directory, its console, its exit.
//!
//! A call runs in the emulated processor's own thread and takes no virtual time, however long the host takes, so a busy
//! host cannot make frames late. Operations and their parameter blocks: "Semihosting for AArch32 and AArch64" (Arm).
//! File names are fixed and there are no arguments, so that the number of executed instructions never depends on where
//! or how the emulator was started.

use core::ffi::CStr;
use core::fmt::{self, Write};

const SYS_OPEN: u32 = 0x01;
const SYS_WRITE0: u32 = 0x04;
const SYS_WRITE: u32 = 0x05;
const SYS_READ: u32 = 0x06;
const SYS_EXIT_EXTENDED: u32 = 0x20;

const MODE_READ_BINARY: u32 = 1;
const MODE_WRITE_BINARY: u32 = 5;
const REASON_APPLICATION_EXIT: u32 = 0x2_0026;

/// Exit code when the firmware panicked or faulted.
pub(crate) const EXIT_PANIC: u32 = 101;
/// Exit code when the host closed a file the firmware cannot do without.
pub(crate) const EXIT_HOST_GONE: u32 = 102;
/// Exit code when the watchdog ended the firmware.
pub(crate) const EXIT_WATCHDOG: u32 = 103;

/// An open file of the host.
#[derive(Clone, Copy)]
pub(crate) struct File {
    handle: u32,
}

/// The host did not transfer all bytes: its end of the file is closed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Closed;

impl File {
    /// Opens for reading; `None` if there is no such file. A FIFO waits for its writer.
    pub(crate) fn open_to_read(name: &CStr) -> Option<Self> {
        Self::open(name, MODE_READ_BINARY)
    }

    /// Opens for writing, creating the file if there is none. A FIFO waits for its reader.
    pub(crate) fn open_to_write(name: &CStr) -> Option<Self> {
        Self::open(name, MODE_WRITE_BINARY)
    }

    fn open(name: &CStr, mode: u32) -> Option<Self> {
        let block = [name.as_ptr() as u32, mode, name.count_bytes() as u32];
        // SAFETY: the block holds the address and length of a string that outlives the call, as SYS_OPEN wants.
        let handle = unsafe { call(SYS_OPEN, block.as_ptr() as u32) };
        (handle != u32::MAX).then_some(Self { handle })
    }

    /// Writes all of `bytes`.
    pub(crate) fn write(self, bytes: &[u8]) -> Result<(), Closed> {
        let block = [self.handle, bytes.as_ptr() as u32, bytes.len() as u32];
        // SAFETY: the block names a live slice that the host only reads.
        let missing = unsafe { call(SYS_WRITE, block.as_ptr() as u32) };
        if missing == 0 { Ok(()) } else { Err(Closed) }
    }

    /// Writes `length` bytes of memory from an address on.
    ///
    /// # Safety
    /// All of them are memory that can be read. The host reads them; no reference to them is made.
    pub(crate) unsafe fn write_memory(self, address: usize, length: usize) -> Result<(), Closed> {
        let block = [self.handle, address as u32, length as u32];
        // SAFETY: the block names memory that the caller answers for and that the host only reads.
        let missing = unsafe { call(SYS_WRITE, block.as_ptr() as u32) };
        if missing == 0 { Ok(()) } else { Err(Closed) }
    }

    /// Reads the available bytes, at least one, waiting for it; returns how many.
    pub(crate) fn read(self, bytes: &mut [u8]) -> Result<usize, Closed> {
        let length = bytes.len();
        let block = [self.handle, bytes.as_mut_ptr() as u32, length as u32];
        // SAFETY: the block names a slice that is borrowed exclusively for the call, the only writer is the host.
        let missing = unsafe { call(SYS_READ, block.as_ptr() as u32) } as usize;
        match length.checked_sub(missing) {
            None | Some(0) => Err(Closed),
            Some(read) => Ok(read),
        }
    }
}

/// Ends the emulator with `code` as its exit status.
pub(crate) fn exit(code: u32) -> ! {
    let block = [REASON_APPLICATION_EXIT, code];
    loop {
        // SAFETY: the block is the two words that SYS_EXIT_EXTENDED reads; the call does not return.
        unsafe { call(SYS_EXIT_EXTENDED, block.as_ptr() as u32) };
    }
}

/// Prints `message` on the emulator's console and ends the emulator with `code`.
pub(crate) fn fail(code: u32, message: fmt::Arguments) -> ! {
    say(message);
    exit(code)
}

/// Prints `message` on the emulator's console.
pub(crate) fn say(message: fmt::Arguments) {
    let mut text = Text {
        bytes: [0; TEXT_BYTES],
        length: 0,
    };
    // A text that is too long is cut and printed up to there.
    let _ = text.write_fmt(message);
    let _ = text.write_str("\n");
    // SAFETY: the last byte of the text is never written, so the host finds the terminating zero inside the array.
    unsafe { call(SYS_WRITE0, text.bytes.as_ptr() as u32) };
}

const TEXT_BYTES: usize = 512;

struct Text {
    bytes: [u8; TEXT_BYTES],
    length: usize,
}

impl Write for Text {
    fn write_str(&mut self, s: &str) -> fmt::Result {
        for byte in s.bytes() {
            if self.length + 1 >= TEXT_BYTES {
                return Err(fmt::Error);
            }
            self.bytes[self.length] = byte;
            self.length += 1;
        }
        Ok(())
    }
}

/// One semihosting call.
///
/// # Safety
/// `parameter` must be what `operation` expects, and what it points to must be valid for the call.
unsafe fn call(operation: u32, parameter: u32) -> u32 {
    let mut result = operation;
    // SAFETY: the breakpoint hands r0 and r1 to the emulator, which changes r0 and the memory the parameter names;
    // memory is assumed clobbered (no `nomem`), the stack is not used.
    unsafe {
        core::arch::asm!("bkpt 0xab", inout("r0") result, in("r1") parameter, options(nostack));
    }
    result
}
