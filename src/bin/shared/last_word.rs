//! The last telegram: when the firmware ends, the drives are told to stop before their watchdogs find out.
//!
//! Best effort, bounded, without a lock: the watchdogs are the guarantee. The critical tasks own the sampler and the port;
//! they contain no panic (a test reads the machine code), so when a panic, a fault or a failed clock ends the firmware
//! they either are not running, and never will again, or are what was interrupted, and then nothing is said.

use crate::Port;
use core::ptr;
use core::sync::atomic::{AtomicPtr, Ordering};
use cortex_m::interrupt::InterruptNumber;
use cortex_m::peripheral::NVIC;
use etherpen::control::sampler::Sampler;
use etherpen::ethercat::transport::raw::RawTransport;

static SAMPLER: AtomicPtr<Sampler<'static>> = AtomicPtr::new(ptr::null_mut());
static TRANSPORT: AtomicPtr<RawTransport<Port>> = AtomicPtr::new(ptr::null_mut());

/// Notes what the last word is said with; for statics of the critical tasks only. Safe in a critical task.
pub(crate) fn prepare(sampler: &mut Sampler<'static>, transport: &mut RawTransport<Port>) {
    SAMPLER.store(sampler, Ordering::Relaxed);
    TRANSPORT.store(transport, Ordering::Relaxed);
}

/// Says it, once, unless one of the `critical` tasks was interrupted; `before` is done to the port first. Whether
/// something was said.
///
/// # Safety
///
/// All interrupts are masked and stay so until the end.
pub(crate) unsafe fn say<I: InterruptNumber>(critical: &[I], before: impl FnOnce(&mut Port)) -> bool {
    if critical.iter().any(|interrupt| NVIC::is_active(*interrupt)) {
        return false;
    }
    let sampler = SAMPLER.swap(ptr::null_mut(), Ordering::Relaxed);
    let transport = TRANSPORT.swap(ptr::null_mut(), Ordering::Relaxed);
    // SAFETY: both are null or come from `prepare`, of statics. Their owners, the critical tasks, are not active, as was
    // just asked, and with interrupts masked until the end none will be again: these are the only references in use.
    let (Some(sampler), Some(transport)) = (unsafe { sampler.as_mut() }, unsafe { transport.as_mut() }) else {
        return false;
    };
    before(transport.driver_mut());
    sampler.say_last_word(transport);
    true
}
