//! What the images for the code's size have in common: an Ethernet controller nobody knows, and a silent end.

use core::hint::black_box;

/// Sends a frame and waits for its reply.
#[inline(never)]
pub(crate) fn wire(frame: &mut [u8]) {
    black_box(frame);
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {
        cortex_m::asm::bkpt();
    }
}
