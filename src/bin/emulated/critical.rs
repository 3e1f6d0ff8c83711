//! Critical sections that never delay the critical tasks.
//!
//! The default implementation masks every interrupt. This one raises BASEPRI to the level just below the tasks of the 1
//! kHz loop, so that logging, queues and wakers of lower tasks cannot make a frame late. The price is a rule: a
//! critical task must not use anything that takes a critical section. `start_up_check` enforces the other half: it
//! refuses to run if an interrupt outside the list of critical ones could preempt a critical section.

use crate::device::{INTERRUPTS, Interrupt, NVIC_PRIO_BITS};
use core::sync::atomic::{Ordering, compiler_fence};
use cortex_m::peripheral::NVIC;
use cortex_m::register::{basepri, basepri_max};
use critical_section::RawRestoreState;

/// RTIC priority of the critical tasks; 16 is left out because BASEPRI cannot mask it in a lock of its own.
pub(crate) const CRITICAL_PRIORITY: u8 = 15;

/// The highest hardware priority (lowest number) that a critical section masks: RTIC's [`CRITICAL_PRIORITY`] - 1.
const MASKED_FROM: u8 = hardware_priority(CRITICAL_PRIORITY - 1);

const _: () = assert!(MASKED_FROM > hardware_priority(CRITICAL_PRIORITY));
const _: () = assert!(hardware_priority(CRITICAL_PRIORITY) > 0);

/// NVIC priority of an RTIC priority: the upper bits count, and a lower number is more urgent.
const fn hardware_priority(logical: u8) -> u8 {
    ((1 << NVIC_PRIO_BITS) - logical) << (8 - NVIC_PRIO_BITS)
}

/// The variant for measurements shows the effect of this implementation: see `primask`.
#[cfg_attr(feature = "primask", allow(dead_code))]
struct BelowCritical;
#[cfg(not(feature = "primask"))]
critical_section::set_impl!(BelowCritical);
#[cfg(feature = "primask")]
critical_section::set_impl!(crate::primask::Everything);

// SAFETY: between `acquire` and `release` no code of priority 14 or lower runs except the caller's own, and code of
// priority 15 takes no critical section (a rule of this firmware, checked by review of its tasks: they use atomics and
// rings only), so nothing that respects critical sections interleaves. `basepri_max` only ever raises the level, hence a
// section inside another one or inside an RTIC lock cannot unmask; `release` restores the level found on entry.
unsafe impl critical_section::Impl for BelowCritical {
    unsafe fn acquire() -> RawRestoreState {
        let before = basepri::read();
        basepri_max::write(MASKED_FROM);
        compiler_fence(Ordering::SeqCst);
        before
    }

    unsafe fn release(before: RawRestoreState) {
        compiler_fence(Ordering::SeqCst);
        // SAFETY: `before` is the level found by the matching `acquire`; sections nest, so restoring it ends this one only.
        unsafe { basepri::write(before) };
    }
}

/// Panics unless every enabled interrupt except `critical` can be masked by a critical section.
pub(crate) fn start_up_check(critical: &[Interrupt]) {
    assert!(
        critical.iter().all(|interrupt| NVIC::is_enabled(*interrupt)),
        "the check comes before the interrupts are enabled"
    );
    for number in 0..INTERRUPTS as u16 {
        let interrupt = AnyInterrupt(number);
        if !NVIC::is_enabled(interrupt) {
            continue;
        }
        let priority = NVIC::get_priority(interrupt);
        if critical.iter().any(|named| *named as u16 == number) {
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

/// Sleeps in a critical task until `done`, which is asked after each occurrence of `interrupt`.
///
/// The interrupt is a critical one, not the running task's own, which could not wake the core, and it was cleared before
/// its cause was set off. `done` has to clear it before it looks, so that an occurrence after the look keeps the core awake.
/// It is not asked before the first occurrence: whether that comes before or during the sleep then makes no difference,
/// not even to the count of instructions.
pub(crate) fn woken_by(interrupt: Interrupt, mut done: impl FnMut() -> bool) {
    // An interrupt of the running task's own priority would not wake the core; one that could preempt it does, and the
    // core's mask keeps it from being taken.
    cortex_m::interrupt::disable();
    set_priority(interrupt, 0);
    loop {
        cortex_m::asm::wfi();
        if done() {
            break;
        }
    }
    set_priority(interrupt, hardware_priority(CRITICAL_PRIORITY));
    // SAFETY: the mask was clear when the task began, tasks run with it clear, and `done` is over.
    unsafe { cortex_m::interrupt::enable() };
}

fn set_priority(interrupt: Interrupt, priority: u8) {
    // SAFETY: the priority changes while all interrupts are masked, and it is back before they are not: no task and no
    // critical section ever sees another one.
    unsafe { (*NVIC::PTR).ipr[interrupt as usize].write(priority) };
}

#[derive(Clone, Copy)]
struct AnyInterrupt(u16);

// SAFETY: only numbers below `INTERRUPTS` are made, by `start_up_check`, and they are used to read the NVIC.
unsafe impl cortex_m::interrupt::InterruptNumber for AnyInterrupt {
    fn number(self) -> u16 {
        self.0
    }
}
