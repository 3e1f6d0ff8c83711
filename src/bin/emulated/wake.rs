//! Sleep inside a critical task until another critical interrupt occurs; for the lockstep alone (see `wire`).

use super::device::Interrupt;
use crate::shared::critical::{CRITICAL_PRIORITY, hardware_priority};
use cortex_m::peripheral::NVIC;

/// Sleeps in a critical task until `done`, which is asked after each occurrence of `interrupt`.
///
/// The interrupt is a critical one, not the running task's own, which could not wake the core, and it was cleared
/// before its cause was set off. `done` has to clear it before it looks, so that an occurrence after the look keeps the
/// core awake. It is not asked before the first occurrence: whether that comes before or during the sleep then makes no
/// difference, not even to the count of instructions.
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
