//! Sleep inside a critical task until another critical interrupt occurs; for the lockstep alone (see `wire`).

use super::device::Interrupt;
use crate::shared::critical::{CRITICAL_PRIORITY, hardware_priority};
use cortex_m::peripheral::NVIC;

/// Sleeps in a critical task until `done` returns true; `done` is called after each occurrence of `interrupt`.
///
/// The interrupt must be a critical one, but not that of the running task, which could not wake the core, and it must
/// have been cleared before its cause was triggered. `done` has to clear the interrupt before it checks the condition,
/// so that a later occurrence keeps the core awake. `done` is not called before the first occurrence: whether that
/// comes before or during the sleep makes no difference, not even to the count of instructions.
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
    // SAFETY: the mask was clear when the task began, tasks run with it clear, and `done` has returned.
    unsafe { cortex_m::interrupt::enable() };
}

fn set_priority(interrupt: Interrupt, priority: u8) {
    // SAFETY: the priority changes while all interrupts are masked, and it is restored before they are unmasked: no
    // task and no critical section ever sees the other value.
    unsafe { (*NVIC::PTR).ipr[interrupt as usize].write(priority) };
}
