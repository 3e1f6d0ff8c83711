//! The watchdog: ends the emulator when a required task does not run.
//!
//! The sample feeds it as that of board nucleo does: only while the trajectory task keeps up, as decided by
//! `etherpen::board::may_feed`. The first timeout is a non-maskable interrupt, which no task and no mask holds back. It
//! ends the emulator as a panic does (`panic.rs`), but without a last telegram, like a chip that its watchdog resets. The
//! emulator does not start the firmware again: the lockstep's time would go back to 0.
//!
//! The watchdog runs in lockstep only. Free-running, the computer's delays are not the firmware's.
//!
//! "Cortex-M System Design Kit Technical Reference Manual": APB watchdog. In QEMU before 10 the counter runs whatever the
//! control register says; only its second timeout stops it. That also requests a reset for good, which therefore is
//! never enabled.

use super::device::CLOCK_HZ;
use super::lan9118::free_run;
use core::sync::atomic::{AtomicU32, Ordering};

const LOAD: usize = 0x4000_8000;
const CONTROL: usize = 0x4000_8008;
const CLEAR: usize = 0x4000_800c;

/// Counting, and interrupting at the first timeout.
const RUNNING: u32 = 1 << 0;

/// Timeout, ms: that of board nucleo.
const TIMEOUT_MS: u32 = 50;
const TIMEOUT_COUNTS: u32 = CLOCK_HZ / 1_000 * TIMEOUT_MS;
/// Least time that is left when it goes on, counts: longer than the three writes that let it go on.
const LEFT_COUNTS_MIN: u32 = 100;
/// Counts in which a load of 1 has expired twice.
const STOPPED_IN_COUNTS: u32 = 5;
const COUNTS_PER_US: u32 = CLOCK_HZ / 1_000_000;

/// When the watchdog was fed, a reading of the free-running counter.
static FED_AT: AtomicU32 = AtomicU32::new(0);

/// Time since the watchdog was fed, us.
pub(crate) fn unfed_us() -> u32 {
    free_run().wrapping_sub(FED_AT.load(Ordering::Relaxed)) / COUNTS_PER_US
}

fn write(register: usize, value: u32) {
    // SAFETY: the addresses above are the watchdog's, which reaches no memory; its one `Watchdog` is owned by tasks of
    // one priority.
    unsafe { core::ptr::write_volatile(register as *mut u32, value) };
}

/// The watchdog's registers.
pub(crate) struct Watchdog(());

impl Watchdog {
    /// Takes the watchdog, which the machine starts at reset, and stops it.
    ///
    /// # Safety
    /// Call it once: two owners would feed one watchdog.
    pub(crate) unsafe fn take() -> Self {
        let mut watchdog = Self(());
        watchdog.pause();
        watchdog
    }

    /// Restarts the timeout; `now` is a reading of the free-running counter.
    pub(crate) fn feed(&mut self, now: u32) {
        FED_AT.store(now, Ordering::Relaxed);
        write(LOAD, TIMEOUT_COUNTS);
    }

    /// Stops the watchdog: virtual time stops only when no timer runs at all.
    pub(crate) fn pause(&mut self) {
        write(CONTROL, 0);
        write(LOAD, 1);
        let began_at = free_run();
        while free_run().wrapping_sub(began_at) < STOPPED_IN_COUNTS {}
    }

    /// Restarts the watchdog for the rest of its timeout.
    pub(crate) fn resume(&mut self) {
        let due = FED_AT.load(Ordering::Relaxed).wrapping_add(TIMEOUT_COUNTS);
        let left = due.wrapping_sub(free_run());
        // A time in the past is a large number.
        let left = if left > u32::MAX / 2 { 0 } else { left };
        write(LOAD, left.max(LEFT_COUNTS_MIN));
        write(CLEAR, 1);
        write(CONTROL, RUNNING);
    }
}
