//! How much of the time the core sleeps.
//!
//! The idle task notes when it goes to sleep; the first task that an interrupt releases notes when that ended. Both are
//! plain atomics, so a critical task may call `woke`.

use crate::lan9118::free_run;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

static ASLEEP: AtomicBool = AtomicBool::new(false);
static SLEPT_AT: AtomicU32 = AtomicU32::new(0);
static SLEPT_COUNTS: AtomicU32 = AtomicU32::new(0);

/// Sleeps until the next interrupt; call it in the idle task only.
pub(crate) fn sleep() {
    SLEPT_AT.store(free_run(), Ordering::Relaxed);
    ASLEEP.store(true, Ordering::Relaxed);
    cortex_m::asm::wfi();
}

/// Notes that the core is awake; the first thing in every task that an interrupt of the hardware releases.
pub(crate) fn woke() {
    if ASLEEP.load(Ordering::Relaxed) {
        ASLEEP.store(false, Ordering::Relaxed);
        let slept = free_run().wrapping_sub(SLEPT_AT.load(Ordering::Relaxed));
        let total = SLEPT_COUNTS.load(Ordering::Relaxed).wrapping_add(slept);
        SLEPT_COUNTS.store(total, Ordering::Relaxed);
    }
}

/// Counts of the free-running counter slept since the start, wrapping.
pub(crate) fn slept_counts() -> u32 {
    SLEPT_COUNTS.load(Ordering::Relaxed)
}
