//! Drivers of the STM32H743 and its relatives, for any board with this chip.
//!
//! The board provides what differs: `crate::board` has `HSE_HZ`, the frequency of the clock on OSC_IN in Hz, and
//! `EXTERNAL_CLOCK`, the name of that clock in messages, in addition to what `shared` requires. Pins, lamps and the
//! names of interrupts belong to the board; it assigns the pins before it starts the drivers. The serial line is
//! USART3, which every NUCLEO-144 wires to its ST-LINK.
//!
//! Another chip of the family: `eth` serves every MAC that stm32-metapac calls `eth_v2` (STM32H5 and STM32H7), `timer`
//! needs a timer with separate update and compare vectors, `crash_record` and `watchdog` use the reset flags and the
//! watchdog of an H7, `clocks` and `memory` its clock tree and memory map.

pub(crate) mod clocks;
pub(crate) mod crash_record;
pub(crate) mod eth;
pub(crate) mod gpio;
pub(crate) mod health;
pub(crate) mod memory;
pub(crate) mod panic;
pub(crate) mod phy;
pub(crate) mod serial;
pub(crate) mod start_up;
mod tightly_coupled;
pub(crate) mod timer;
pub(crate) mod usb;
pub(crate) mod watchdog;

use stm32_metapac::UID;

/// Interrupt lines of the STM32H743: positions 0 to 149 of the vector table (RM0433, table of the NVIC).
pub(crate) const INTERRUPT_LINES: u16 = 150;

/// The chip's unique number.
pub(crate) fn unique_number() -> [u8; 12] {
    let mut bytes = [0; 12];
    for (word, four) in bytes.chunks_exact_mut(4).enumerate() {
        four.copy_from_slice(&UID.uid(word).read().to_le_bytes());
    }
    bytes
}
