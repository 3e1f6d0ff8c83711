//! Time base of the IP stack: milliseconds, counted by the task that runs it.
//!
//! embassy's own drivers interrupt at a priority that cannot be masked, above every critical task. The stack is polled
//! every millisecond in any case, so no wake-up and no interrupt is needed.

use core::cell::Cell;
use core::task::Waker;
use critical_section::Mutex;
use embassy_time_driver::{Driver, TICK_HZ};

const TICKS_PER_MS: u64 = TICK_HZ / 1_000;

const _: () = assert!(TICK_HZ.is_multiple_of(1_000));

struct Milliseconds(Mutex<Cell<u64>>);

embassy_time_driver::time_driver_impl!(static MILLISECONDS: Milliseconds = Milliseconds(Mutex::new(Cell::new(0))));

impl Driver for Milliseconds {
    fn now(&self) -> u64 {
        critical_section::with(|section| self.0.borrow(section).get()) * TICKS_PER_MS
    }

    fn schedule_wake(&self, _at: u64, _waker: &Waker) {}
}

/// Counts a millisecond.
pub(crate) fn tick() {
    critical_section::with(|section| {
        let milliseconds = MILLISECONDS.0.borrow(section);
        milliseconds.set(milliseconds.get() + 1);
    });
}
