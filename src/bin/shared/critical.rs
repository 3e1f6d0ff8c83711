//! Critical sections that never delay the critical tasks.
//!
//! The default implementation masks every interrupt. This one raises BASEPRI to the level just below the tasks of the 1
//! kHz loop, so that logging, queues, wakers and drivers of lower tasks cannot make a frame late. The price is a rule:
//! a critical task must not use anything that takes a critical section; a test reads the machine code of the NUCLEO's
//! image for that. `start_up_check` enforces the other half: it refuses to run if an interrupt that is not critical
//! could preempt a critical section.
//!
//! Revision r0p1 of the Cortex-M7 has an erratum: a write to BASEPRI takes effect late. The STM32H743 has r1p1, and the
//! emulator models no erratum.

use crate::board::{CRITICAL, INTERRUPT_LINES, NVIC_PRIO_BITS};
use core::sync::atomic::{Ordering, compiler_fence};
use cortex_m::peripheral::NVIC;
use cortex_m::register::{basepri, basepri_max};
use critical_section::RawRestoreState;

/// RTIC priority of the critical tasks; 16 is left out because BASEPRI cannot mask it in a lock of its own.
pub(crate) const CRITICAL_PRIORITY: u8 = 15;

/// The most urgent hardware priority (lowest number) that a critical section masks.
const MASKED_FROM: u8 = hardware_priority(CRITICAL_PRIORITY - 1);

const _: () = assert!(MASKED_FROM > hardware_priority(CRITICAL_PRIORITY));
const _: () = assert!(hardware_priority(CRITICAL_PRIORITY) > 0);

/// NVIC priority of an RTIC priority: the upper bits count, and a lower number is more urgent.
pub(crate) const fn hardware_priority(logical: u8) -> u8 {
    ((1 << NVIC_PRIO_BITS) - logical) << (8 - NVIC_PRIO_BITS)
}

/// The variant `primask` of the emulated board has another implementation, to show the effect of this one.
#[cfg_attr(all(feature = "primask", feature = "emulated"), allow(dead_code))]
struct BelowCritical;
#[cfg(not(all(feature = "primask", feature = "emulated")))]
critical_section::set_impl!(BelowCritical);

// SAFETY: between `acquire` and `release` no code of priority 14 or lower runs except the caller's own, and code of
// priority 15 takes no critical section (its tasks use rings, atomics and `rtic::pend` only), so nothing that respects
// critical sections interleaves. `basepri_max` only raises the level, hence a section inside another one or inside an
// RTIC lock cannot unmask; `release` restores the level found on entry.
unsafe impl critical_section::Impl for BelowCritical {
    unsafe fn acquire() -> RawRestoreState {
        let before = basepri::read();
        basepri_max::write(MASKED_FROM);
        compiler_fence(Ordering::SeqCst);
        before
    }

    unsafe fn release(before: RawRestoreState) {
        compiler_fence(Ordering::SeqCst);
        // SAFETY: `before` is the level found by the matching `acquire`; sections nest, so only this one ends.
        unsafe { basepri::write(before) };
    }
}

/// Checks the priorities of all interrupts; call it in `init`, when RTIC has enabled them.
///
/// # Panics
/// When an interrupt of [`CRITICAL`] is disabled or lacks the critical priority, or when another enabled interrupt
/// cannot be masked by a critical section.
pub(crate) fn start_up_check() {
    assert!(
        CRITICAL.iter().all(|interrupt| NVIC::is_enabled(*interrupt)),
        "the check comes before the interrupts are enabled"
    );
    for number in 0..INTERRUPT_LINES {
        let interrupt = Line(number);
        if !NVIC::is_enabled(interrupt) {
            continue;
        }
        let priority = NVIC::get_priority(interrupt);
        if CRITICAL.iter().any(|named| *named as u16 == number) {
            assert!(
                priority == hardware_priority(CRITICAL_PRIORITY),
                "critical interrupt {number} has priority {priority}"
            );
        } else {
            assert!(
                priority >= MASKED_FROM,
                "interrupt {number} has priority {priority}, critical sections mask from {MASKED_FROM} on"
            );
        }
    }
}

/// An interrupt by its position in the vector table.
#[derive(Clone, Copy)]
struct Line(u16);

// SAFETY: only positions below `INTERRUPT_LINES` are made, by `start_up_check`, which reads the NVIC with them.
unsafe impl cortex_m::interrupt::InterruptNumber for Line {
    fn number(self) -> u16 {
        self.0
    }
}
