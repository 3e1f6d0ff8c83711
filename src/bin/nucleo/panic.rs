//! A panic leaves its cause in memory and resets the chip.
//!
//! No logger, no lock, no frame is used on the way: whatever panicked may hold any of them. The reset ends the cyclic
//! frames, and the drives' own watchdogs stop the motors; that watchdog is the guarantee, this handler only makes the
//! cause known. The first cause survives until it is taken: a second panic while starting does not replace it.

use core::cell::UnsafeCell;
use core::fmt::{self, Write};
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr;
use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};

/// Bytes of text that are kept of a cause.
const TEXT_SIZE: usize = 192;

/// Distinguishes a written record from memory after power-on.
const WRITTEN: u32 = 0x7061_6E63;

/// The cause as it lies in memory over the reset; a cache line multiple, so that cleaning writes nothing else back.
#[derive(Clone, Copy)]
#[repr(C, align(32))]
pub(crate) struct Cause {
    written: u32,
    length: u32,
    text: [u8; TEXT_SIZE],
    /// Written once more after the rest: the RAM's error correction holds the latest write that is shorter than its
    /// word back until the next one, and a reset would lose it (ST AN5342).
    flush: u32,
}

impl Cause {
    /// Source position and message, cut to the space there is.
    pub(crate) fn text(&self) -> &str {
        let length = usize::try_from(self.length).unwrap_or(TEXT_SIZE).min(TEXT_SIZE);
        let bytes = self.text.get(..length).unwrap_or_default();
        match core::str::from_utf8(bytes) {
            Ok(text) => text,
            Err(error) => bytes
                .get(..error.valid_up_to())
                .and_then(|valid| core::str::from_utf8(valid).ok())
                .unwrap_or_default(),
        }
    }
}

impl Write for Cause {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for byte in text.bytes() {
            let Some(slot) = self.text.get_mut(self.length as usize) else {
                return Err(fmt::Error);
            };
            *slot = byte;
            self.length += 1;
        }
        Ok(())
    }
}

struct Kept(UnsafeCell<MaybeUninit<Cause>>);

// SAFETY: reached by `take` before interrupts are enabled and by `keep_and_reset` after they are disabled for good, so
// never by two contexts at a time.
unsafe impl Sync for Kept {}

/// Outside .data and .bss, which a start overwrites.
#[unsafe(link_section = ".uninit.panic_cause")]
static KEPT: Kept = Kept(UnsafeCell::new(MaybeUninit::uninit()));

/// The cause of the previous run's end if it was a panic or a hard fault. Call once, before interrupts are enabled.
pub(crate) fn take() -> Option<Cause> {
    let kept = KEPT.0.get().cast::<Cause>();
    // SAFETY: every bit pattern is a valid `Cause`; volatile, because the value comes from before the reset and the
    // compiler must not take the static for undefined. Nobody else runs yet (see `Kept`).
    let cause = unsafe { ptr::read_volatile(kept) };
    if cause.written != WRITTEN {
        return None;
    }
    // SAFETY: as above.
    unsafe { ptr::write_volatile(&raw mut (*kept).written, 0) };
    Some(cause)
}

/// Keeps the first cause and resets.
fn keep_and_reset(cause: fmt::Arguments) -> ! {
    cortex_m::interrupt::disable();
    let kept = KEPT.0.get().cast::<Cause>();
    // SAFETY: interrupts stay disabled until the reset, so this context is alone (see `Kept`); any bit pattern is valid.
    if unsafe { ptr::read_volatile(&raw const (*kept).written) } != WRITTEN {
        let mut record = Cause {
            written: WRITTEN,
            length: 0,
            text: [0; TEXT_SIZE],
            flush: 0,
        };
        // A text that does not fit is cut; what fits is kept.
        let _ = record.write_fmt(cause);
        // SAFETY: as above. The cortex-m peripherals are stolen for cache maintenance only, right before the reset.
        unsafe {
            ptr::write_volatile(kept, record);
            cortex_m::asm::dsb();
            ptr::write_volatile(&raw mut (*kept).flush, 0);
            let mut core = cortex_m::Peripherals::steal();
            core.SCB.clean_dcache_by_address(kept as usize, size_of::<Cause>());
        }
    }
    SCB::sys_reset()
}

#[panic_handler]
fn panic(information: &PanicInfo) -> ! {
    keep_and_reset(format_args!("{information}"))
}

/// Bus, memory and usage faults escalate to here: their own handlers are not enabled.
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    keep_and_reset(format_args!(
        "hard fault at {:#010x}, return address {:#010x}",
        frame.pc(),
        frame.lr()
    ))
}

/// An interrupt that no task serves.
#[exception]
unsafe fn DefaultHandler(number: i16) -> ! {
    keep_and_reset(format_args!("no task for interrupt {number}"))
}
