//! Start-up: bounded waits, and the indication of a failed start.
//!
//! No step of the start-up can hang forever. The firmware's own waits have a limit in milliseconds and panic with the
//! name of the part. Any other hang (a driver's wait, a bus that does not answer) is ended by the watchdog, which runs
//! from the first lines on. In both cases the chip is reset, and the crash record names the step that failed
//! (`crash_record.rs`). The next start-up reports that before it tries again: at that moment the chip runs on its
//! internal oscillator with everything else off, so lamps and serial line do not depend on the failed part.

use super::clocks::HSI_HZ;
use super::{serial, watchdog};
use cortex_m::peripheral::{SYST, syst::SystClkSource};
use etherpen::board::Lamps;

/// Longest wait for parts that get ready in less than a millisecond, ms.
const READY_MS: u32 = 100;
/// Time for which a failed start is shown before the next one, and duration of one step of its pattern, ms.
const REPORT_MS: u32 = 4_000;
const PATTERN_MS: u32 = 250;
/// Time for a byte to leave the serial line, ms.
const BYTE_MS: u32 = 2;

/// All lamps on: the firmware is starting. This also tests the lamps.
pub(crate) const STARTING: Lamps = Lamps {
    green: true,
    yellow: true,
    red: true,
};
/// Pattern of a failed start: red and yellow in turn.
const FAILED: [Lamps; 2] = [
    Lamps {
        green: false,
        yellow: true,
        red: false,
    },
    Lamps {
        green: false,
        yellow: false,
        red: true,
    },
];

/// Waits with a limit, by the core's timer.
pub(crate) struct Waits<'a> {
    timer: &'a mut SYST,
}

impl<'a> Waits<'a> {
    pub(crate) fn new(timer: &'a mut SYST) -> Self {
        timer.set_clock_source(SystClkSource::Core);
        let mut waits = Self { timer };
        waits.clocked_at(HSI_HZ);
        waits.timer.enable_counter();
        waits
    }

    /// Stops the core's timer. Its exception has hardware priority 0 after a reset, above the critical tasks.
    pub(crate) fn end(self) {
        self.timer.disable_interrupt();
        self.timer.disable_counter();
        self.timer.set_clock_source(SystClkSource::Core);
    }

    /// Sets the frequency of the core from now on, Hz.
    pub(crate) fn clocked_at(&mut self, hz: u32) {
        self.timer.set_reload(hz / 1_000 - 1);
        self.timer.clear_current();
    }

    /// Waits until `ready` holds, at most `ms` milliseconds, and feeds the watchdog meanwhile. Returns whether it
    /// holds.
    pub(crate) fn wait(&mut self, ms: u32, ready: impl Fn() -> bool) -> bool {
        let mut left = ms;
        while !ready() {
            if self.timer.has_wrapped() {
                watchdog::feed();
                left = left.saturating_sub(1);
            }
            if left == 0 {
                return false;
            }
        }
        true
    }

    /// Waits until a required part is ready.
    ///
    /// # Panics
    ///
    /// When it does not get ready in time.
    pub(crate) fn require(&mut self, what: &str, ready: impl Fn() -> bool) {
        assert!(self.wait(READY_MS, ready), "start-up: {what} does not come");
    }

    /// Shows on the lamps that the last start failed, and sends the cause on the serial line, for four seconds.
    ///
    /// The chip must run on its internal oscillator, and the serial line's pins must be assigned.
    pub(crate) fn report_failure(&mut self, cause: &str, show: impl Fn(Lamps)) {
        serial::open_on_internal_oscillator();
        for step in 0..(REPORT_MS / PATTERN_MS) as usize {
            show(FAILED[step % FAILED.len()]);
            if step % 4 == 0 {
                for text in ["\r\netherpen: the start failed: ", cause, "; trying again\r\n"] {
                    self.send(text);
                }
            }
            self.wait(PATTERN_MS, || false);
        }
        show(STARTING);
    }

    fn send(&mut self, text: &str) {
        for byte in text.bytes() {
            if self.wait(BYTE_MS, serial::has_room) {
                serial::put(byte);
            }
        }
    }
}
