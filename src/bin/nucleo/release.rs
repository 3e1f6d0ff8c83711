//! Releases an async task from a task of higher priority, once per call.
//!
//! The library's supervisor is polled every millisecond and never requests a wake-up. Its task stores its waker here at
//! each poll; the millisecond task takes and calls it. Not for critical tasks: the waker is protected by a critical
//! section.

use core::cell::Cell;
use core::task::Waker;
use critical_section::Mutex;

/// The waiting task's waker, if it waits.
pub(crate) struct Release(Mutex<Cell<Option<Waker>>>);

impl Release {
    pub(crate) const fn new() -> Self {
        Release(Mutex::new(Cell::new(None)))
    }

    /// Stores the waker for the next [`Release::now`].
    pub(crate) fn wait(&self, waker: &Waker) {
        let waker = waker.clone();
        critical_section::with(|section| self.0.borrow(section).set(Some(waker)));
    }

    /// Wakes the task if it waits.
    pub(crate) fn now(&self) {
        if let Some(waker) = critical_section::with(|section| self.0.borrow(section).take()) {
            waker.wake();
        }
    }
}
