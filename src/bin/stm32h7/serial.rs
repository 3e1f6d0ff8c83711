//! USART3 on the ST-LINK's virtual serial port: bytes between its FIFOs and the link's queues.
//!
//! The interrupt occurs when the receive FIFO is half full or the line becomes idle, and when the transmit FIFO is
//! empty while bytes wait: eight times fewer interrupts than bytes. Line errors are counted, never waited for; the
//! link's checksums detect the damage.

use super::clocks::{HSI_HZ, PERIPHERAL_HZ};
use core::sync::atomic::{AtomicU32, Ordering};
use etherpen::controller::HostBytes;
use stm32_metapac::{RCC, USART3};

/// Rate of the line; 8 data bits, no parity, 1 stop bit.
pub(crate) const BAUD: u32 = 921_600;
/// Divider from the kernel clock.
const DIVIDER: u32 = divider(PERIPHERAL_HZ);
/// Divider before the clock tree has been started.
const DIVIDER_OF_HSI: u32 = divider(HSI_HZ);
/// Bytes of either FIFO (RM0433, USART implementation).
const FIFO_DEPTH: usize = 16;
/// FIFO threshold codes: receive half full, transmit empty.
const RECEIVE_HALF_FULL: u8 = 0b010;
const TRANSMIT_EMPTY: u8 = 0b101;

/// A receiver tolerates an error of 2 % of both ends together; this end stays below 1 %.
const _: () = assert!((PERIPHERAL_HZ / DIVIDER).abs_diff(BAUD) * 100 < BAUD);
const _: () = assert!((HSI_HZ / DIVIDER_OF_HSI).abs_diff(BAUD) * 100 < BAUD);
const _: () = assert!(DIVIDER >= 16 && DIVIDER <= u16::MAX as u32);

/// Bytes that were lost or damaged on the line or found the queue full.
pub(crate) static BYTES_LOST: AtomicU32 = AtomicU32::new(0);

/// Divider from a kernel clock, rounded to the nearest.
const fn divider(hz: u32) -> u32 {
    (hz + BAUD / 2) / BAUD
}

/// Clocks the port and resets it.
fn clock_and_reset() {
    RCC.apb1lenr().modify(|enable| enable.set_usart3en(true));
    // The clock enable takes effect two bus cycles later; a read back spends them.
    let _ = RCC.apb1lenr().read();
    RCC.apb1lrstr().modify(|reset| reset.set_usart3rst(true));
    RCC.apb1lrstr().modify(|reset| reset.set_usart3rst(false));
}

/// Opens the port for [`put`] while the chip runs on its reset clocks; the pins must be assigned already.
pub(crate) fn open_on_internal_oscillator() {
    clock_and_reset();
    USART3.brr().write(|rate| rate.0 = DIVIDER_OF_HSI);
    USART3.cr1().write(|control| {
        control.set_te(true);
        control.set_ue(true);
    });
}

/// Whether [`put`] may send a byte.
pub(crate) fn has_room() -> bool {
    USART3.isr().read().txe()
}

/// Sends a byte.
pub(crate) fn put(byte: u8) {
    USART3.tdr().write(|data| data.0 = u32::from(byte));
}

/// The port with the link's ends of the byte queues.
pub(crate) struct Serial {
    bytes: &'static mut HostBytes<'static>,
}

impl Serial {
    /// Configures and enables the port; the pins must be assigned already.
    pub(crate) fn new(bytes: &'static mut HostBytes<'static>) -> Self {
        clock_and_reset();
        USART3.brr().write(|rate| rate.0 = DIVIDER);
        USART3.cr3().write(|control| {
            control.set_rxftcfg(RECEIVE_HALF_FULL);
            control.set_txftcfg(TRANSMIT_EMPTY);
            control.set_rxftie(true);
        });
        // The FIFO's switch only moves while the port is disabled.
        USART3.cr1().write(|control| control.set_fifoen(true));
        USART3.cr1().modify(|control| {
            control.set_idleie(true);
            control.set_te(true);
            control.set_re(true);
            control.set_ue(true);
        });
        Serial { bytes }
    }

    /// Empties the receive FIFO and fills the transmit FIFO; bounded by two FIFOs of bytes either way.
    pub(crate) fn service(&mut self) {
        let status = USART3.isr().read();
        if status.ore() || status.fe() || status.ne() {
            BYTES_LOST.fetch_add(1, Ordering::Relaxed);
        }
        USART3.icr().write(|clear| {
            clear.set_ore(true);
            clear.set_fe(true);
            clear.set_ne(true);
            clear.set_idle(true);
        });
        self.receive();
        self.transmit();
    }

    fn receive(&mut self) {
        let mut bytes = [0; 2 * FIFO_DEPTH];
        let mut count = 0;
        for slot in &mut bytes {
            if !USART3.isr().read().rxne() {
                break;
            }
            *slot = USART3.rdr().read().0 as u8;
            count += 1;
        }
        let received = bytes.get(..count).unwrap_or_default();
        let lost = received.len() - self.bytes.received(received).min(received.len());
        BYTES_LOST.fetch_add(lost as u32, Ordering::Relaxed);
    }

    fn transmit(&mut self) {
        let mut waiting = true;
        for _ in 0..2 * FIFO_DEPTH {
            let mut byte = [0];
            // With the FIFO on, TXE means that the FIFO is not full.
            if !USART3.isr().read().txe() {
                break;
            }
            if self.bytes.to_send(&mut byte) == 0 {
                waiting = false;
                break;
            }
            USART3.tdr().write(|data| data.0 = u32::from(byte[0]));
        }
        USART3.cr3().modify(|control| control.set_txftie(waiting));
    }
}
