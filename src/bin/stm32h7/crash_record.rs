//! Crash record, in memory across a reset: the cause of the firmware's end, the last fault, the progress of a start-up.
//!
//! Invariant: a record is either complete or absent: its mark is removed first and written last.

use core::cell::UnsafeCell;
use core::fmt;
use core::mem::MaybeUninit;
use core::ptr;
use core::sync::atomic::{Ordering, compiler_fence};
use cortex_m::peripheral::SCB;
use etherpen::application::Fault;
use etherpen::board::{CAUSE_BYTES_MAX, PreviousRun, RunEnd};
use stm32_metapac::RCC;

/// Bytes of a stored fault.
const FAULT_BYTES_MAX: usize = 32;
/// Bytes of the name of a step of the start-up.
const STEP_BYTES_MAX: usize = 16;
/// Distinguishes a written record from memory after power-on.
const WRITTEN: u32 = 0x7061_6E63;

/// A record in memory; it has its own cache lines, so that cleaning writes nothing else back.
#[derive(Clone, Copy)]
#[repr(C, align(32))]
struct Record<const BYTES: usize> {
    written: u32,
    length: u32,
    bytes: [u8; BYTES],
    /// Written once more after the rest: the RAM's error correction holds the latest write that is shorter than its
    /// word back until the next one, and a reset would lose it (ST AN5342).
    flush: u32,
}

struct Slot<const BYTES: usize>(UnsafeCell<MaybeUninit<Record<BYTES>>>);

// SAFETY: `take`, `step_begins` and `start_up_completed` run before interrupts are enabled; after that one context at a
// time reaches a record: the link task the last fault, and whoever has masked all interrupts for good the cause.
unsafe impl<const BYTES: usize> Sync for Slot<BYTES> {}

impl<const BYTES: usize> Slot<BYTES> {
    const fn new() -> Self {
        Slot(UnsafeCell::new(MaybeUninit::uninit()))
    }

    fn record(&self) -> *mut Record<BYTES> {
        self.0.get().cast()
    }

    /// # Safety
    /// No other context may reach the record meanwhile.
    unsafe fn is_written(&self) -> bool {
        // SAFETY: any bit pattern is valid; volatile, because it comes from before the reset and the compiler must not
        // take the static for undefined. The caller keeps others away.
        unsafe { ptr::read_volatile(&raw const (*self.record()).written) == WRITTEN }
    }

    /// Takes the record, which is then absent.
    ///
    /// # Safety
    /// No other context may reach the record meanwhile.
    unsafe fn take(&self) -> Option<([u8; BYTES], usize)> {
        // SAFETY: as the caller promises; any bit pattern is valid.
        unsafe {
            if !self.is_written() {
                return None;
            }
            let record = ptr::read_volatile(self.record());
            ptr::write_volatile(&raw mut (*self.record()).written, 0);
            Some((record.bytes, (record.length as usize).min(BYTES)))
        }
    }

    /// Replaces the record.
    ///
    /// # Safety
    /// No other context may reach the record meanwhile.
    unsafe fn store(&self, bytes: &[u8; BYTES], length: usize) {
        let record = self.record();
        // SAFETY: as the caller promises.
        unsafe {
            ptr::write_volatile(&raw mut (*record).written, 0);
            ptr::write_volatile(&raw mut (*record).bytes, *bytes);
            ptr::write_volatile(&raw mut (*record).length, length as u32);
            compiler_fence(Ordering::SeqCst);
            ptr::write_volatile(&raw mut (*record).written, WRITTEN);
            self.clean();
        }
    }

    /// Removes the record.
    ///
    /// # Safety
    /// No other context may reach the record meanwhile.
    unsafe fn clear(&self) {
        // SAFETY: as the caller promises.
        unsafe {
            ptr::write_volatile(&raw mut (*self.record()).written, 0);
            self.clean();
        }
    }

    /// Brings the record from the cache into the memory.
    ///
    /// # Safety
    /// No other context may reach the record meanwhile.
    unsafe fn clean(&self) {
        let record = self.record();
        cortex_m::asm::dsb();
        // SAFETY: as the caller promises. The core's peripherals are stolen for the cache's maintenance of these lines
        // alone, which nobody else does after the start.
        unsafe {
            ptr::write_volatile(&raw mut (*record).flush, 0);
            // A cache that is off holds no valid data; cleaning it would write garbage.
            if SCB::dcache_enabled() {
                let mut core = cortex_m::Peripherals::steal();
                core.SCB
                    .clean_dcache_by_address(record as usize, size_of::<Record<BYTES>>());
            }
        }
    }
}

/// Outside .data and .bss, which a start overwrites.
#[unsafe(link_section = ".uninit.crash_cause")]
static CAUSE: Slot<CAUSE_BYTES_MAX> = Slot::new();
#[unsafe(link_section = ".uninit.crash_fault")]
static FAULT: Slot<FAULT_BYTES_MAX> = Slot::new();
#[unsafe(link_section = ".uninit.crash_step")]
static STEP: Slot<STEP_BYTES_MAX> = Slot::new();

/// State of the previous run, and whether it ended during start-up. Call it once, before interrupts are enabled.
pub(crate) fn take() -> (PreviousRun, bool) {
    let flags = RCC.rsr().read();
    RCC.rsr().modify(|status| status.set_rmvf(true));
    // SAFETY: interrupts are not enabled yet, so no other context exists.
    let (cause, fault, step) = unsafe { (CAUSE.take(), FAULT.take(), STEP.take()) };
    let failed = step.is_some() && (cause.is_some() || flags.iwdg1rstf());
    let end = match (cause, step) {
        (Some((bytes, length)), _) => PreviousRun::panicked(readable(bytes.get(..length).unwrap_or_default())),
        (None, Some((bytes, length))) if failed => {
            let mut text = Text::new();
            let step = readable(bytes.get(..length).unwrap_or_default());
            // The text has room for it.
            let _ = fmt::write(&mut text, format_args!("start-up: step \"{step}\" did not end"));
            PreviousRun::panicked(text.as_str())
        }
        _ if flags.iwdg1rstf() => RunEnd::Watchdog,
        _ if flags.porrstf() || flags.borrstf() => RunEnd::PowerOff,
        _ => RunEnd::Reset,
    };
    let fault = fault.and_then(|(bytes, length)| postcard::from_bytes(bytes.get(..length)?).ok());
    (PreviousRun { end, fault }, failed)
}

/// Records that a step of the start-up begins; a name that is too long is cut. Call before interrupts are enabled.
pub(crate) fn step_begins(step: &str) {
    let mut bytes = [0; STEP_BYTES_MAX];
    let length = step.len().min(STEP_BYTES_MAX);
    for (stored, byte) in bytes.iter_mut().zip(step.bytes()) {
        *stored = byte;
    }
    // SAFETY: interrupts are not enabled yet, so no other context exists.
    unsafe { STEP.store(&bytes, length) };
}

/// Records that the start-up has succeeded. Call before interrupts are enabled.
pub(crate) fn start_up_completed() {
    // SAFETY: interrupts are not enabled yet, so no other context exists.
    unsafe { STEP.clear() };
}

fn readable(bytes: &[u8]) -> &str {
    match core::str::from_utf8(bytes) {
        Ok(text) => text,
        Err(error) => bytes
            .get(..error.valid_up_to())
            .and_then(|valid| core::str::from_utf8(valid).ok())
            .unwrap_or_default(),
    }
}

/// Stores the first cause that ends the firmware; a second one does not replace it.
///
/// # Safety
///
/// All interrupts are masked and stay so until the reset.
pub(crate) unsafe fn store_cause(cause: fmt::Arguments) {
    // SAFETY: nothing preempts this code, and what it interrupted never continues.
    if unsafe { CAUSE.is_written() } {
        return;
    }
    let mut text = Text::new();
    // A text that does not fit is cut.
    let _ = fmt::write(&mut text, cause);
    // SAFETY: as above.
    unsafe { CAUSE.store(&text.bytes, text.length) };
}

/// Stores a fault; for the link task alone.
pub(crate) fn store_fault(fault: &Fault) {
    let mut bytes = [0; FAULT_BYTES_MAX];
    let length = postcard::to_slice(fault, &mut bytes).map_or(0, |used| used.len());
    // SAFETY: the link task is one context and does not nest.
    unsafe { FAULT.store(&bytes, length) };
}

struct Text {
    bytes: [u8; CAUSE_BYTES_MAX],
    length: usize,
}

impl Text {
    const fn new() -> Self {
        Text {
            bytes: [0; CAUSE_BYTES_MAX],
            length: 0,
        }
    }

    fn as_str(&self) -> &str {
        readable(self.bytes.get(..self.length).unwrap_or_default())
    }
}

impl fmt::Write for Text {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for byte in text.bytes() {
            let Some(slot) = self.bytes.get_mut(self.length) else {
                return Err(fmt::Error);
            };
            *slot = byte;
            self.length += 1;
        }
        Ok(())
    }
}
