//! CPU load: the share of the time in which the core does not sleep.
//!
//! The idle task records when it goes to sleep; the first task released by an interrupt records when the sleep ended.
//! Both are plain atomics, so a critical task may call `woke`.

use crate::board::free_run;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

static ASLEEP: AtomicBool = AtomicBool::new(false);
static SLEPT_AT: AtomicU32 = AtomicU32::new(0);
static SLEPT_COUNTS: AtomicU32 = AtomicU32::new(0);

/// Counts that tasks between the critical ones and the trajectory have run for, without those that preempted them.
static URGENT_COUNTS: AtomicU32 = AtomicU32::new(0);

/// Sleeps until the next interrupt; call it in the idle task only.
pub(crate) fn sleep() {
    SLEPT_AT.store(free_run(), Ordering::Relaxed);
    ASLEEP.store(true, Ordering::Relaxed);
    cortex_m::asm::wfi();
}

/// Records that the core is awake; call it first in every task that a hardware interrupt releases.
pub(crate) fn woke() {
    // The time first, and then in one access: a task that preempts this one counts the same sleep instead, and its own run time
    // does not count as sleep.
    let now = free_run();
    if ASLEEP.swap(false, Ordering::Relaxed) {
        let slept = now.wrapping_sub(SLEPT_AT.load(Ordering::Relaxed));
        let total = SLEPT_COUNTS.load(Ordering::Relaxed).wrapping_add(slept);
        SLEPT_COUNTS.store(total, Ordering::Relaxed);
    }
}

/// Counts of the free-running counter slept since the start, wrapping.
pub(crate) fn slept_counts() -> u32 {
    SLEPT_COUNTS.load(Ordering::Relaxed)
}

/// Runs the body of a task whose priority is between the critical tasks' and the trajectory's, and counts its own run
/// time. `critical_counts` returns how long critical tasks have run.
pub(crate) fn urgent(critical_counts: impl Fn() -> u32, body: impl FnOnce()) {
    let (began_at, before) = (free_run(), critical_counts());
    body();
    let preempted = critical_counts().wrapping_sub(before);
    let taken = free_run().wrapping_sub(began_at).wrapping_sub(preempted);
    let total = URGENT_COUNTS.load(Ordering::Relaxed).wrapping_add(taken);
    URGENT_COUNTS.store(total, Ordering::Relaxed);
}

/// Counts of [`urgent`] since the start, wrapping.
pub(crate) fn urgent_counts() -> u32 {
    URGENT_COUNTS.load(Ordering::Relaxed)
}
