//! UART0, the serial link of the free-running mode.
//!
//! The CMSDK UART has a one-byte buffer in each direction, and the emulator gives it no baud rate. The rate is
//! therefore limited here: at most [`LINK_BYTES_MAX`] bytes are sent in a millisecond, each one when the previous one
//! has left. In lockstep the link does not use the UART (see `lockstep`).

use super::lockstep::LINK_BYTES_MAX;

/// Registers of the CMSDK UART, in their order ("Cortex-M System Design Kit Technical Reference Manual", APB UART).
#[repr(C)]
struct Registers {
    data: u32,
    state: u32,
    control: u32,
    interrupt: u32,
    divider: u32,
}

const STATE_TX_FULL: u32 = 1 << 0;
const STATE_RX_FULL: u32 = 1 << 1;
const CONTROL_TX: u32 = 1 << 0;
const CONTROL_RX: u32 = 1 << 1;
const CONTROL_TX_INTERRUPT: u32 = 1 << 2;
const CONTROL_RX_INTERRUPT: u32 = 1 << 3;
const INTERRUPT_TX: u32 = 1 << 0;
const INTERRUPT_RX: u32 = 1 << 1;
/// Smallest divider the UART takes; the emulator ignores it beyond that.
const DIVIDER_MIN: u32 = 16;

/// UART0, interrupts 0 (received) and 1 (sent).
pub(crate) struct Uart {
    registers: *mut Registers,
    pending: [u8; LINK_BYTES_MAX],
    next: usize,
    end: usize,
}

// SAFETY: the address is that of a device and valid everywhere; the `Uart` is owned by tasks of one priority.
unsafe impl Send for Uart {}

impl Uart {
    /// Takes UART0 and switches it on.
    ///
    /// # Safety
    /// Call it once.
    pub(crate) unsafe fn start() -> Self {
        let uart = Self {
            registers: 0x4000_4000 as *mut Registers,
            pending: [0; LINK_BYTES_MAX],
            next: 0,
            end: 0,
        };
        let control = CONTROL_TX | CONTROL_RX | CONTROL_TX_INTERRUPT | CONTROL_RX_INTERRUPT;
        // SAFETY: the fields are the registers of the UART that `uart` owns.
        unsafe {
            (&raw mut (*uart.registers).divider).write_volatile(DIVIDER_MIN);
            (&raw mut (*uart.registers).control).write_volatile(control);
        }
        uart
    }

    /// Sends the bytes that `fill` writes into the buffer, unless the last millisecond's bytes have not all left.
    pub(crate) fn send(&mut self, fill: impl FnOnce(&mut [u8]) -> usize) {
        if self.next == self.end {
            self.next = 0;
            self.end = fill(&mut self.pending).min(LINK_BYTES_MAX);
        }
        self.transmit();
    }

    /// Clears the interrupt of a byte that has left and sends the next.
    pub(crate) fn on_sent(&mut self) {
        self.clear(INTERRUPT_TX);
        self.transmit();
    }

    /// Clears the interrupt of a received byte and returns the byte.
    pub(crate) fn on_received(&mut self) -> Option<u8> {
        self.clear(INTERRUPT_RX);
        if self.state() & STATE_RX_FULL == 0 {
            return None;
        }
        // SAFETY: `self` owns the UART; reading takes the byte from its buffer.
        Some(unsafe { (&raw const (*self.registers).data).read_volatile() } as u8)
    }

    fn transmit(&mut self) {
        while self.next < self.end && self.state() & STATE_TX_FULL == 0 {
            let byte = u32::from(self.pending[self.next]);
            // SAFETY: `self` owns the UART, and its buffer is empty.
            unsafe { (&raw mut (*self.registers).data).write_volatile(byte) };
            self.next += 1;
        }
    }

    fn state(&self) -> u32 {
        // SAFETY: reading the state changes nothing.
        unsafe { (&raw const (*self.registers).state).read_volatile() }
    }

    fn clear(&mut self, interrupt: u32) {
        // SAFETY: `self` owns the UART; writing the bit clears that interrupt only.
        unsafe { (&raw mut (*self.registers).interrupt).write_volatile(interrupt) };
    }
}
