//! A clock that counts instructions in QEMU's mps2-an500, for the programs that run there.
//!
//! With `-icount shift=10` every instruction takes 1,024 ns of virtual time, which a timer of 25 MHz resolves: the counts
//! are exact. A loop of known length is counted first, and a wrong result ends the run.

use core::sync::atomic::{Ordering, compiler_fence};

/// CMSDK APB timer 0: control, value, reload.
const TIMER: *mut u32 = 0x4000_0000 as *mut u32;
/// Counts of the timer and the instructions that take as long at shift 10: 40 ns against 1,024 ns.
const INSTRUCTIONS_PER_COUNT: (i64, i64) = (5, 128);
/// The loop that checks the clock: two instructions a round and one before.
const KNOWN_ROUNDS: u32 = 10_000;

/// Starts the timer over its whole range.
pub(crate) fn start() {
    // SAFETY: nothing else uses the timer, and writing its registers does nothing but set it going.
    unsafe {
        TIMER.add(2).write_volatile(u32::MAX);
        TIMER.add(1).write_volatile(u32::MAX);
        TIMER.write_volatile(1);
    }
}

/// Counts since the start; wraps.
#[inline(always)]
pub(crate) fn now() -> u32 {
    compiler_fence(Ordering::SeqCst);
    // SAFETY: reading the value of a timer changes nothing.
    let value = unsafe { TIMER.add(1).read_volatile() };
    compiler_fence(Ordering::SeqCst);
    !value
}

/// Instructions that take as long as these counts.
pub(crate) fn instructions(counts: i64) -> i64 {
    let (numerator, denominator) = INSTRUCTIONS_PER_COUNT;
    (counts * numerator + denominator / 2) / denominator
}

/// Makes sure that the clock counts instructions; `count` runs the work and gives its counts.
///
/// # Panics
/// It does not count them.
pub(crate) fn check(count: impl FnOnce(fn()) -> i64) {
    let counted = instructions(count(known));
    let known = i64::from(2 * KNOWN_ROUNDS);
    // The call, a register that has to be loaded first, the return.
    assert!(
        (known..=known + 8).contains(&counted),
        "{known} instructions were counted as {counted}"
    );
}

#[inline(never)]
fn known() {
    // SAFETY: counts a register of its own down to zero.
    unsafe {
        core::arch::asm!("2: subs {0}, {0}, #1", "bne 2b", inout(reg) KNOWN_ROUNDS => _);
    }
}
