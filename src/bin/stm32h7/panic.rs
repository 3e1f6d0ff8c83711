//! End of the firmware: stores the cause in the crash record, stops the drives, resets the chip.
//!
//! No logger and no lock is used, because the failed code may hold any of them. The reset ends the cyclic frames, and
//! the drives' own watchdogs stop the motors. These watchdogs are the guarantee; this code only reports the cause and
//! stops the drives earlier. The first cause is stored until the next start-up reads it: a second one during start-up
//! does not replace it.

use super::clocks::CORE_HZ;
use super::crash_record;
use crate::board::EXTERNAL_CLOCK;
use crate::shared::final_telegram;
use core::fmt;
use core::panic::PanicInfo;
use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};
use stm32_metapac::RCC;

/// Time for the last frame to leave: the longest takes 123 us at 100 Mbit/s.
const FRAME_CYCLES: u32 = CORE_HZ / 5_000;

/// Ends the firmware: stores the cause, stops the drives, and restarts the chip.
pub(crate) fn end(cause: fmt::Arguments) -> ! {
    cortex_m::interrupt::disable();
    // SAFETY: interrupts are masked, and nothing returns from here.
    unsafe {
        crash_record::store_cause(cause);
        if final_telegram::send(|_| ()) {
            cortex_m::asm::delay(FRAME_CYCLES);
        }
    }
    SCB::sys_reset()
}

#[panic_handler]
fn panic(information: &PanicInfo) -> ! {
    end(format_args!("{information}"))
}

/// Bus, memory and usage faults escalate to here: their own handlers are not enabled.
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    end(format_args!(
        "hard fault at {:#010x}, return address {:#010x}",
        frame.pc(),
        frame.lr()
    ))
}

/// The clock security system: the external clock has stopped, and the hardware has switched to its internal oscillator.
#[exception]
unsafe fn NonMaskableInt() -> ! {
    let clock_failed = RCC.cifr().read().hsecssf();
    RCC.cicr().write(|clear| clear.set_hsecssc(true));
    if clock_failed {
        end(format_args!("clock failure: {EXTERNAL_CLOCK} stopped"))
    }
    end(format_args!("non-maskable interrupt without a known cause"))
}

/// An interrupt that no task serves.
#[exception]
unsafe fn DefaultHandler(number: i16) -> ! {
    end(format_args!("no task for interrupt {number}"))
}
