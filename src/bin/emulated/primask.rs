//! The default critical section, which masks every interrupt, for comparison with the firmware's own.
//!
//! Only the variant with the feature `primask` uses it, for `etherpen bench latency --isolation primask`: with it a log
//! line or a queue of the lowest priority delays the critical tasks.

use core::sync::atomic::{Ordering, compiler_fence};
use cortex_m::register::primask;
use critical_section::RawRestoreState;

struct Everything;
critical_section::set_impl!(Everything);

// SAFETY: between `acquire` and `release` no interrupt is taken at all; `release` unmasks only if the matching
// `acquire` found the mask clear, so an inner section does not end an outer one.
unsafe impl critical_section::Impl for Everything {
    unsafe fn acquire() -> RawRestoreState {
        let was_clear = primask::read().is_active(); // "active" are the interrupts, not the mask
        cortex_m::interrupt::disable();
        compiler_fence(Ordering::SeqCst);
        u8::from(was_clear)
    }

    unsafe fn release(was_clear: RawRestoreState) {
        compiler_fence(Ordering::SeqCst);
        if was_clear != 0 {
            // SAFETY: the mask was clear before the section that ends here.
            unsafe { cortex_m::interrupt::enable() };
        }
    }
}
