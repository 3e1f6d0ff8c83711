//! End of the firmware: prints the cause on the emulator's console and ends the emulator with a failure.
//!
//! No logger and no queue is used, since one of them may be the cause. A final telegram stops the drives. The black box is saved to the host. The cyclic
//! frames end with the emulator, and the drives' own watchdogs stop the motors. The watchdog ends a firmware that hangs,
//! without a telegram.

use super::black_box;
use super::semihosting::{EXIT_PANIC, EXIT_WATCHDOG, exit, say};
use super::watchdog;
use super::wire::Wire;
use crate::shared::final_telegram;
use core::fmt;
use core::panic::PanicInfo;
use cortex_m_rt::{ExceptionFrame, exception};

fn end(cause: fmt::Arguments) -> ! {
    cortex_m::interrupt::disable();
    // First, before any further failure.
    say(cause);
    // SAFETY: interrupts are masked, and nothing returns from here.
    unsafe {
        final_telegram::send(Wire::wait_no_more);
        black_box::save();
    }
    exit(EXIT_PANIC)
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    end(format_args!("{info}"))
}

// SAFETY: cortex-m-rt calls this as the HardFault handler, once, and it does not return.
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    end(format_args!("hard fault: {frame:?}"))
}

// SAFETY: cortex-m-rt calls this for the non-maskable interrupt, and it does not return.
/// The watchdog: the cyclic frames end without a last telegram, as at a reset of the chip.
#[exception]
unsafe fn NonMaskableInt() -> ! {
    let ms = watchdog::unfed_us() / 1_000;
    say(format_args!(
        "watchdog: a required task has not run, the watchdog was not fed for {ms} ms"
    ));
    // SAFETY: no interrupt preempts this one, and it does not return.
    unsafe { black_box::save() };
    exit(EXIT_WATCHDOG)
}

// SAFETY: cortex-m-rt calls this for every exception and interrupt without a handler, and it does not return.
#[exception]
unsafe fn DefaultHandler(number: i16) -> ! {
    end(format_args!("interrupt {number} has no task"))
}
