//! The final telegram: when the firmware ends, stops the drives before their watchdogs expire.
//!
//! Best effort, bounded, without a lock: the watchdogs are the guarantee. The critical tasks own the sampler and the
//! port and contain no panic (a test reads the machine code). When a panic, a fault or a failed clock ends the
//! firmware, they are either not running and never will again, or were interrupted themselves; in the latter case no
//! telegram is sent.

use crate::board::{CRITICAL, Port};
use core::ptr;
use core::sync::atomic::{AtomicPtr, Ordering};
use cortex_m::peripheral::NVIC;
use etherpen::control::sampler::Sampler;
use etherpen::ethercat::frame_port::FramePort;

static SAMPLER: AtomicPtr<Sampler<'static>> = AtomicPtr::new(ptr::null_mut());
static FRAME_PORT: AtomicPtr<FramePort<Port>> = AtomicPtr::new(ptr::null_mut());

/// Stores what the final telegram needs; for statics of the critical tasks only. Safe in a critical task.
pub(crate) fn prepare(sampler: &mut Sampler<'static>, frame_port: &mut FramePort<Port>) {
    SAMPLER.store(sampler, Ordering::Relaxed);
    FRAME_PORT.store(frame_port, Ordering::Relaxed);
}

/// Sends one final quick-stop telegram, after calling `before` on the port. Does nothing if a critical task was
/// interrupted or if the telegram was already sent. Returns whether it was sent.
///
/// # Safety
///
/// All interrupts are masked and stay so until the end.
pub(crate) unsafe fn send(before: impl FnOnce(&mut Port)) -> bool {
    if CRITICAL.iter().any(|interrupt| NVIC::is_active(*interrupt)) {
        return false;
    }
    let sampler = SAMPLER.swap(ptr::null_mut(), Ordering::Relaxed);
    let frame_port = FRAME_PORT.swap(ptr::null_mut(), Ordering::Relaxed);
    // SAFETY: both are null or come from `prepare`, of statics. Their owners, the critical tasks, are not active, as
    // was just checked, and with interrupts masked until the end none will become active: these are the only references
    // in use.
    let (Some(sampler), Some(frame_port)) = (unsafe { sampler.as_mut() }, unsafe { frame_port.as_mut() }) else {
        return false;
    };
    before(frame_port.driver_mut());
    sampler.send_final_telegram(frame_port);
    true
}
