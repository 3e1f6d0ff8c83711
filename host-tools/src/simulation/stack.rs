//! The firmware's IP stack in virtual time.
//!
//! The stack reads the one clock of its process, and several simulations may run in one process: whoever polls a stack holds
//! the clock meanwhile, and sets it to the milliseconds of its own simulation.

use embassy_time::{Duration, MockDriver};
use std::future::Future;
use std::pin::Pin;
use std::sync::{Mutex, PoisonError};
use std::task::{Context, Poll, Waker};

/// Held by the simulation whose time the clock shows.
static CLOCK: Mutex<()> = Mutex::new(());

/// Polls a stack at this time of its simulation, ms.
pub(super) fn poll<F: Future>(stack: Pin<&mut F>, ms: u32) -> Poll<F::Output> {
    let _held = CLOCK.lock().unwrap_or_else(PoisonError::into_inner);
    let clock = MockDriver::get();
    clock.reset();
    clock.advance(Duration::from_millis(ms.into()));
    stack.poll(&mut Context::from_waker(Waker::noop()))
}
