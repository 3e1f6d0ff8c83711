//! Polls an async task's future once after each release, without the future's own wake-ups.
//!
//! The library's supervisor and IP stack are written as sequences of waits for the next poll. The supervisor requests
//! no wake-up, because it waits for critical tasks, which may not take the critical section that protects a waker; the
//! IP stack's wake-ups are ignored. A task of higher priority, but not a critical one, releases them every millisecond.

use core::cell::Cell;
use core::future::poll_fn;
use core::pin::Pin;
use core::task::{Context, Waker};
use critical_section::Mutex;

/// Releases one async task; keeps its waker while it waits.
pub(crate) struct Release(Mutex<Cell<Option<Waker>>>);

impl Release {
    pub(crate) const fn new() -> Self {
        Self(Mutex::new(Cell::new(None)))
    }

    /// Releases the task in [`Self::poll_each`], whose future is polled as soon as that task may run. Not for critical
    /// tasks.
    pub(crate) fn release(&self) {
        let waiting = critical_section::with(|section| self.0.borrow(section).take());
        if let Some(waker) = waiting {
            waker.wake();
        }
    }

    /// Polls `future` at once and after every [`Self::release`]; releases that come while it is being polled count as
    /// one.
    ///
    /// The caller pins the future: passed by value, it would take its memory twice.
    pub(crate) async fn poll_each<T>(&self, mut future: Pin<&mut impl Future<Output = T>>) -> T {
        poll_fn(|context| {
            let waker = context.waker().clone();
            critical_section::with(|section| self.0.borrow(section).set(Some(waker)));
            future.as_mut().poll(&mut Context::from_waker(Waker::noop()))
        })
        .await
    }
}
