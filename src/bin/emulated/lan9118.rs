//! Where the Ethernet controller is: volatile access to its registers.

use etherpen::ethernet::lan9118::{self, Register, Registers};

const BASE: usize = 0xa000_0000;

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
}

fn read(register: Register) -> u32 {
    // SAFETY: the address is a register of the controller, aligned to a word; reading it reaches no memory.
    unsafe { core::ptr::read_volatile((BASE + register as usize) as *const u32) }
}

/// The controller's free-running counter. Reading it changes nothing, so it needs no owner.
pub(crate) fn free_run() -> u32 {
    read(Register::FreeRun)
}

/// Frames that wait in the controller. Reading the level changes nothing, so it needs no owner.
pub(crate) fn frames_waiting() -> u32 {
    lan9118::frames_waiting(read(Register::RxFifoInf))
}
