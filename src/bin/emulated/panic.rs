//! The end of the firmware: the cause goes to the emulator's console, and the emulator ends with a failure.
//!
//! No logger and no queue takes part, since one of them may be the cause. Cyclic frames stop with the emulator; the drives'
//! own watchdogs stop the motors.

use crate::semihosting::{EXIT_PANIC, fail};
use core::panic::PanicInfo;
use cortex_m_rt::{ExceptionFrame, exception};

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    fail(EXIT_PANIC, format_args!("{info}"))
}

// SAFETY: cortex-m-rt calls this as the HardFault handler, once, and it does not return.
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    fail(EXIT_PANIC, format_args!("hard fault: {frame:?}"))
}

// SAFETY: cortex-m-rt calls this for every exception and interrupt without a handler, and it does not return.
#[exception]
unsafe fn DefaultHandler(number: i16) -> ! {
    fail(EXIT_PANIC, format_args!("interrupt {number} has no task"))
}
