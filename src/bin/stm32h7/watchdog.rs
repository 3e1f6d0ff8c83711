//! The independent watchdog: resets the chip when a required task does not run.
//!
//! The watchdog has its own oscillator. It runs from the first lines of the start-up on, with a long timeout, so that a
//! hanging start-up ends (`start_up.rs`). Afterwards the sample feeds it, and only while the trajectory task keeps up,
//! as decided by `etherpen::board::may_feed`. Once started it cannot be stopped, except while a debug probe has halted
//! the core.

use stm32_metapac::{DBGMCU, IWDG1};

/// Keys of the key register (RM0433, IWDG_KR).
const START: u32 = 0xCCCC;
const UNLOCK: u32 = 0x5555;
const FEED: u32 = 0xAAAA;
/// Counts per millisecond: the low-speed oscillator's 32 kHz, within 5 %, divided by 4 as after a reset.
const COUNTS_PER_MS: u32 = 8;
/// Timeout while the tasks run, ms; the timeout after a reset is the longest one, 512 ms.
const TIMEOUT_MS: u32 = 50;
const _: () = assert!(COUNTS_PER_MS * TIMEOUT_MS < 1 << 12);

/// Starts the watchdog with the longest timeout.
pub(crate) fn start() {
    DBGMCU.apb4fzr1().modify(|freeze| freeze.set_iwdg1(true));
    IWDG1.kr().write(|key| key.0 = START);
}

/// Shortens the timeout to that of the tasks; the watchdog has to be fed within it.
pub(crate) fn tighten() {
    IWDG1.kr().write(|key| key.0 = UNLOCK);
    IWDG1
        .rlr()
        .write(|reload| reload.set_rl((COUNTS_PER_MS * TIMEOUT_MS) as u16));
    feed();
}

/// Feeds the watchdog. Safe in a critical task: one register write.
pub(crate) fn feed() {
    IWDG1.kr().write(|key| key.0 = FEED);
}
