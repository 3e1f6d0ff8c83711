//! Critical sections that never delay the critical tasks.
//!
//! The default implementation masks every interrupt. This one raises BASEPRI to the level just below the tasks of the 1
//! kHz loop, so that logging, wakers and the HAL cannot make a frame late. The price is a rule: a critical task must
//! not use anything that takes a critical section. `start_up_check` enforces the other half: it refuses to run if an
//! interrupt that is not critical could preempt a critical section, which is where a HAL's defaults would put it.
//!
//! The Cortex-M7 of the STM32H743 is r1p1; it does not have the erratum of r0p1, in which a write to BASEPRI takes
//! effect late.

use core::sync::atomic::{Ordering, compiler_fence};
use cortex_m::peripheral::{NVIC, SYST, syst::SystClkSource};
use cortex_m::register::{basepri, basepri_max};
use critical_section::RawRestoreState;
use stm32_metapac::{Interrupt, NVIC_PRIO_BITS};

/// RTIC priority of the critical tasks; 16 is left out because BASEPRI cannot mask it in a lock of its own.
pub(crate) const CRITICAL_PRIORITY: u8 = 15;

/// The most urgent hardware priority (lowest number) that a critical section masks.
const MASKED_FROM: u8 = hardware_priority(CRITICAL_PRIORITY - 1);

/// Interrupt lines of the STM32H743: positions 0 to 149 of the vector table (RM0433, table of the NVIC).
const INTERRUPT_LINES: u16 = 150;

const _: () = assert!(MASKED_FROM > hardware_priority(CRITICAL_PRIORITY));
const _: () = assert!(hardware_priority(CRITICAL_PRIORITY) > 0);

/// NVIC priority of an RTIC priority: the upper bits count, and a lower number is more urgent.
const fn hardware_priority(logical: u8) -> u8 {
    ((1 << NVIC_PRIO_BITS) - logical) << (8 - NVIC_PRIO_BITS)
}

struct BelowCritical;
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

/// Panics unless every interrupt of `critical` has the critical priority, and every other enabled one can be masked.
pub(crate) fn start_up_check(systick: &mut SYST, critical: &[Interrupt]) {
    // SysTick keeps hardware priority 0 after reset and nothing here needs it.
    systick.disable_interrupt();
    systick.disable_counter();
    systick.set_clock_source(SystClkSource::Core);
    for number in 0..INTERRUPT_LINES {
        let interrupt = Line(number);
        let priority = NVIC::get_priority(interrupt);
        if critical.iter().any(|named| *named as u16 == number) {
            assert!(
                priority == hardware_priority(CRITICAL_PRIORITY),
                "critical interrupt {number}: {priority}"
            );
        } else if NVIC::is_enabled(interrupt) {
            assert!(
                priority >= MASKED_FROM,
                "interrupt {number} preempts critical sections: {priority}"
            );
        }
    }
}

/// An interrupt by its position.
#[derive(Clone, Copy)]
struct Line(u16);

// SAFETY: only positions below `INTERRUPT_LINES` are made, by `start_up_check`, which reads the NVIC with them.
unsafe impl cortex_m::interrupt::InterruptNumber for Line {
    fn number(self) -> u16 {
        self.0
    }
}
