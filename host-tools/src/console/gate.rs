//! What keeps every request waiting while a stop is on its way to the port.
//!
//! Invariant: between a stop's arrival and the moment at which it has been written to the port (or cannot be, or
//! `WAIT_MAX` has passed) nobody's request is begun.

use super::lock;
use std::sync::Mutex;
use std::time::{Duration, Instant};
use tokio::sync::Notify;

/// Longest time that requests wait for a port that does not take a stop.
const WAIT_MAX: Duration = Duration::from_secs(2);

/// What passes the gate, in its order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Passage {
    /// A stop was asked for.
    StopArrived,
    /// It has been written to the port, or cannot be.
    StopWritten,
    /// A request was begun, by this viewer; 0 for one without a viewer.
    Begun(u64),
}

/// Told of every passage, while the gate is locked: it must be quick.
pub type Watcher = Box<dyn FnMut(Passage) + Send>;

#[derive(Default)]
struct State {
    /// Stops that have not been written.
    stops: u32,
    /// When the last of them came.
    since: Option<Instant>,
    watcher: Option<Watcher>,
}

impl State {
    fn pass(&mut self, passage: Passage) {
        if let Some(watcher) = &mut self.watcher {
            watcher(passage);
        }
    }

    fn is_closed(&self) -> bool {
        self.stops > 0 && self.since.is_some_and(|since| since.elapsed() < WAIT_MAX)
    }
}

/// The gate.
#[derive(Default)]
pub struct Gate {
    state: Mutex<State>,
    opened: Notify,
}

impl Gate {
    /// Lets somebody watch what passes.
    pub fn watch(&self, watcher: Watcher) {
        lock(&self.state).watcher = Some(watcher);
    }

    /// A stop has come; [`stop_written`](Self::stop_written) is called once for each.
    pub(super) fn stop_arrived(&self) {
        let mut state = lock(&self.state);
        state.stops = state.stops.saturating_add(1);
        state.since = Some(Instant::now());
        state.pass(Passage::StopArrived);
    }

    /// A stop has been written to the port, or cannot be.
    pub(super) fn stop_written(&self) {
        let mut state = lock(&self.state);
        state.stops = state.stops.saturating_sub(1);
        state.pass(Passage::StopWritten);
        drop(state);
        self.opened.notify_waiters();
    }

    /// Waits until no stop is on its way, then begins a request of this viewer.
    pub(super) async fn begin(&self, viewer: u64) {
        loop {
            let opened = self.opened.notified();
            {
                let mut state = lock(&self.state);
                if !state.is_closed() {
                    return state.pass(Passage::Begun(viewer));
                }
            }
            // What does not open is looked at again.
            let _ = tokio::time::timeout(WAIT_MAX, opened).await;
        }
    }
}
