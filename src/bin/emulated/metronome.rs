//! Polls a future once every millisecond, without wakers.
//!
//! The supervisor and the IP stack are written as sequences of waits for the next poll. They register no waker, because
//! the tasks that they wait for must not take a critical section. They are therefore polled in every tick of a task
//! that may take one.

use core::cell::Cell;
use core::future::poll_fn;
use core::pin::pin;
use core::task::{Context, Waker};
use critical_section::Mutex;

/// Polls one task's future.
pub(crate) struct Metronome(Mutex<Cell<Option<Waker>>>);

impl Metronome {
    pub(crate) const fn new() -> Self {
        Self(Mutex::new(Cell::new(None)))
    }

    /// One tick: the future of [`Self::every_tick`] is polled as soon as its task may run.
    pub(crate) fn tick(&self) {
        let waiting = critical_section::with(|section| self.0.borrow(section).take());
        if let Some(waker) = waiting {
            waker.wake();
        }
    }

    /// Polls `future` now and after every [`Self::tick`]; ticks that come while it is being polled count as one.
    pub(crate) async fn every_tick<T>(&self, future: impl Future<Output = T>) -> T {
        let mut future = pin!(future);
        poll_fn(|context| {
            let waker = context.waker().clone();
            critical_section::with(|section| self.0.borrow(section).set(Some(waker)));
            future.as_mut().poll(&mut Context::from_waker(Waker::noop()))
        })
        .await
    }
}
