//! What a machine's surroundings do to a firmware, made by the firmware itself, when the host asks for it.
//!
//! Virtual time hides what the host does, so a load that is to meet a release of `sample` must come from within. While
//! serial or log load is on, SysTick interrupts as often as a serial line brings bytes; its period does not divide the
//! millisecond, so that in the long run a tick meets every phase of the loop. Frames of another protocol are asked for in
//! the millisecond and delivered around the next release, at a moment that sweeps over it.
//!
//! Invariant: with nothing asked for, SysTick is off and nothing here runs.

use crate::wire::Wire;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use etherpen::ethercat::transport::raw::RawTransport;
use etherpen::measurement::disturbance::{LOG, SERIAL};

/// Counts between two ticks: 92,000 ticks a second, as the bytes of a line of 921,600 baud.
const TICK_COUNTS: u32 = 271;
/// Lines logged at a tick: half of the core's time goes into them.
const LINES_PER_TICK: u32 = 2;
/// Bytes of a message of noise, end included.
const NOISE_BYTES: u32 = 60;
/// Delivery of foreign frames: this many counts before the release at first, later by a step every millisecond, and from
/// the beginning again behind the release.
const SWEEP_BEFORE: u32 = 400;
const SWEEP_COUNTS: u32 = 470;
const SWEEP_STEP: u32 = 7;

const _: () = assert!(!SWEEP_COUNTS.is_multiple_of(SWEEP_STEP));

/// Asks the other end of the cable for foreign frames: a broadcast of the EtherType for local experiments (IEEE 802).
const FOREIGN_REQUEST: [u8; 60] = {
    let mut frame = [0; 60];
    let (header, _) = frame.split_at_mut(14);
    header.copy_from_slice(&[
        0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x02, 0x00, 0x00, 0x00, 0x00, 0x01, 0x88, 0xB5,
    ]);
    frame
};

/// SysTick's control, reload and current value (ARMv7-M Architecture Reference Manual, B3.3).
const SYSTICK_CONTROL: usize = 0xE000_E010;
const SYSTICK_RELOAD: usize = 0xE000_E014;
/// Enabled, interrupting, on the core's clock.
const SYSTICK_ON: u32 = 1 << 2 | 1 << 1 | 1 << 0;

static TICKING: AtomicBool = AtomicBool::new(false);
static LINES: AtomicU32 = AtomicU32::new(0);

fn write_systick(register: usize, value: u32) {
    // SAFETY: the addresses above are SysTick's, which reaches no memory; only this module writes them.
    unsafe { core::ptr::write_volatile(register as *mut u32, value) };
}

/// Starts or ends the ticks that the asked `bits` need; once a millisecond.
pub(crate) fn apply(bits: u8) {
    let wanted = bits & (SERIAL | LOG) != 0;
    if TICKING.swap(wanted, Ordering::Relaxed) != wanted {
        write_systick(SYSTICK_RELOAD, TICK_COUNTS - 1);
        write_systick(SYSTICK_CONTROL, if wanted { SYSTICK_ON } else { 0 });
    }
}

/// Stops the ticks, so that virtual time stands still; see `wire`.
pub(crate) fn pause() {
    if TICKING.load(Ordering::Relaxed) {
        write_systick(SYSTICK_CONTROL, 0);
    }
}

/// Goes on after [`pause`].
pub(crate) fn resume() {
    if TICKING.load(Ordering::Relaxed) {
        write_systick(SYSTICK_CONTROL, SYSTICK_ON);
    }
}

/// Logs the lines of a tick.
pub(crate) fn log() {
    for _ in 0..LINES_PER_TICK {
        let line = LINES.load(Ordering::Relaxed).wrapping_add(1);
        LINES.store(line, Ordering::Relaxed);
        defmt::debug!("flood, line {=u32}", line);
    }
}

/// Makes foreign frames arrive around the next release.
pub(crate) fn foreign_frames(transport: &mut RawTransport<Wire>, millisecond: u32) {
    let swept = millisecond.wrapping_mul(SWEEP_STEP) % SWEEP_COUNTS;
    transport.driver_mut().clock.deliver_around_release(SWEEP_BEFORE, swept);
    // One that the controller has no room for comes a millisecond later.
    let _ = transport.send(&FOREIGN_REQUEST);
}

/// Bytes of messages that nobody understands.
pub(crate) struct Noise {
    state: u32,
    left: u32,
}

impl Noise {
    pub(crate) const fn new() -> Self {
        Self {
            state: 0x2545_F491,
            left: NOISE_BYTES,
        }
    }

    /// Whether a message has begun and not ended.
    pub(crate) fn is_open(&self) -> bool {
        self.left != NOISE_BYTES
    }

    /// Ends the present message; its last byte.
    pub(crate) fn end(&mut self) -> u8 {
        self.left = NOISE_BYTES;
        0
    }

    /// The next byte: zero ends a message on the link.
    pub(crate) fn next(&mut self) -> u8 {
        self.left -= 1;
        if self.left == 0 {
            return self.end();
        }
        // Xorshift (Marsaglia, 2003).
        self.state ^= self.state << 13;
        self.state ^= self.state >> 17;
        self.state ^= self.state << 5;
        (self.state as u8).max(1)
    }
}
