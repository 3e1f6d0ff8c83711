//! The independent watchdog: resets the chip when a task that has to run does not.
//!
//! It counts on an oscillator of its own. It runs from the first lines of the start on, with a long timeout, so that a start
//! that hangs ends (`start_up.rs`). Then the sample feeds it, and only while the trajectory task keeps up; whether it does
//! is `etherpen::board::may_feed`. It cannot be stopped once it runs, except while a debug probe has halted the core.

use stm32_metapac::{DBGMCU, IWDG1};

/// Keys of the key register (RM0433, IWDG_KR).
const START: u32 = 0xCCCC;
const UNLOCK: u32 = 0x5555;
const FEED: u32 = 0xAAAA;
/// Counts a second: the low-speed oscillator's 32 kHz, give or take 5 %, divided by 4 as after a reset.
const COUNTS_PER_MS: u32 = 8;
/// Time without food after which it resets when the tasks run, ms; as it is after a reset, it is the longest, 512 ms.
const TIMEOUT_MS: u32 = 50;
const _: () = assert!(COUNTS_PER_MS * TIMEOUT_MS < 1 << 12);

/// Starts it with the longest timeout.
pub(crate) fn start() {
    DBGMCU.apb4fzr1().modify(|freeze| freeze.set_iwdg1(true));
    IWDG1.kr().write(|key| key.0 = START);
}

/// Shortens the timeout to that of the tasks; the first food is due within it.
pub(crate) fn tighten() {
    IWDG1.kr().write(|key| key.0 = UNLOCK);
    IWDG1
        .rlr()
        .write(|reload| reload.set_rl((COUNTS_PER_MS * TIMEOUT_MS) as u16));
    feed();
}

/// Safe in a critical task: one register write.
pub(crate) fn feed() {
    IWDG1.kr().write(|key| key.0 = FEED);
}
