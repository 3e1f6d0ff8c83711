//! Polls a future once every millisecond, whatever the future thinks of wakers.
//!
//! The supervisor is written as a sequence of waits for the next look at the bus. It registers no waker, because the tasks
//! it waits for must take no critical section; so it is looked at in every tick of a task that may.

use core::cell::Cell;
use core::future::poll_fn;
use core::pin::pin;
use core::task::{Context, Waker};
use critical_section::Mutex;

static WAITING: Mutex<Cell<Option<Waker>>> = Mutex::new(Cell::new(None));

/// One tick: the future of [`every_tick`] is polled as soon as its task may run.
pub(crate) fn tick() {
    let waiting = critical_section::with(|section| WAITING.borrow(section).take());
    if let Some(waker) = waiting {
        waker.wake();
    }
}

/// Polls `future` now and after every [`tick`]; ticks that come while it is being polled count as one.
pub(crate) async fn every_tick<T>(future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    poll_fn(|context| {
        let waker = context.waker().clone();
        critical_section::with(|section| WAITING.borrow(section).set(Some(waker)));
        future.as_mut().poll(&mut Context::from_waker(Waker::noop()))
    })
    .await
}
