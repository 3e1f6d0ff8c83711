//! Builds the tasks on a stack that is large enough for it.
//!
//! The stack of the running controller is DTCM, 128 KiB, which is plenty for tasks and far too little for moving the
//! planner's memory about while it is being built. Until interrupts are enabled the end of AXI SRAM that no static uses
//! is nobody's: there the builder runs.

use core::arch::asm;
use core::ptr;

unsafe extern "C" {
    /// First byte behind the statics (cortex-m-rt's linker script).
    static __euninit: u8;
    /// First byte behind AXI SRAM.
    static _ram_end: u8;
}

/// Least space in bytes that the builder must find: its frames take 217 KiB, counted in the image.
const SPACE_MIN: usize = 288 * 1024;

/// Runs `build` with the free end of AXI SRAM as its stack. Call it in `init`, once, before interrupts are enabled.
///
/// # Panics
///
/// When the statics leave too little space, instead of running into them.
pub(crate) fn on_large_stack<R, F: FnOnce() -> R>(build: F) -> R {
    let (bottom, top) = (&raw const __euninit as usize, &raw const _ram_end as usize);
    assert!(
        top.saturating_sub(bottom) >= SPACE_MIN,
        "AXI SRAM is too full to build the tasks"
    );
    let mut job = Job::Waiting(build);
    // SAFETY: the memory between the two symbols belongs to no static and to no heap, and is aligned to 8 bytes at its
    // end; interrupts are disabled, so nothing else uses the stack pointer meanwhile, and it is restored from r8, which
    // the called function preserves. `run` gets a pointer to `job`, which outlives the call.
    unsafe {
        asm!(
            "mov r8, sp",
            "mov sp, {top}",
            "blx {run}",
            "mov sp, r8",
            top = in(reg) top & !7,
            run = in(reg) run::<R, F> as extern "C" fn(*mut Job<R, F>),
            inout("r0") ptr::from_mut(&mut job) => _,
            // What the procedure call standard leaves to the callee; clobber_abi would name registers that this FPU lacks.
            out("r1") _, out("r2") _, out("r3") _, out("r12") _, out("lr") _,
            out("d0") _, out("d1") _, out("d2") _, out("d3") _, out("d4") _, out("d5") _, out("d6") _, out("d7") _,
            out("r8") _,
        );
    }
    match job {
        Job::Done(result) => result,
        Job::Waiting(_) | Job::Begun => panic!("the builder did not run"),
    }
}

/// What `run` does and leaves.
enum Job<R, F> {
    Waiting(F),
    Done(R),
    Begun,
}

extern "C" fn run<R, F: FnOnce() -> R>(job: *mut Job<R, F>) {
    // SAFETY: `on_large_stack` passes a pointer to its own local, which nobody else uses during the call.
    let job = unsafe { &mut *job };
    if let Job::Waiting(build) = core::mem::replace(job, Job::Begun) {
        *job = Job::Done(build());
    }
}
