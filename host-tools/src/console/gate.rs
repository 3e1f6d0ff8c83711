//! The gate: delays all requests while a stop is being written to the port.
//!
//! Invariant: no request is started between the arrival of a stop and the moment at which it was written to the port
//! (or cannot be written, or `WAIT_MAX` has passed).

use super::lock;
use std::sync::Mutex;
use std::time::{Duration, Instant};
use tokio::sync::Notify;

/// Longest time that requests wait for a stop that the port does not accept.
const WAIT_MAX: Duration = Duration::from_secs(2);

/// Event at the gate, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Passage {
    /// A stop was requested.
    StopArrived,
    /// The stop was written to the port, or cannot be written.
    StopWritten,
    /// A request of this viewer was started; 0 for a request without a viewer.
    Begun(u64),
}

/// Called at every passage while the gate is locked: it has to be fast.
pub type Watcher = Box<dyn FnMut(Passage) + Send>;

#[derive(Default)]
struct State {
    /// Number of stops not yet written.
    stops: u32,
    /// Time of the last of these stops.
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
    /// Sets a function that observes the passages.
    pub fn watch(&self, watcher: Watcher) {
        lock(&self.state).watcher = Some(watcher);
    }

    /// Closes the gate for a stop; [`stop_written`](Self::stop_written) is called once for each.
    pub(super) fn stop_arrived(&self) {
        let mut state = lock(&self.state);
        state.stops = state.stops.saturating_add(1);
        state.since = Some(Instant::now());
        state.pass(Passage::StopArrived);
    }

    /// Reports that a stop was written to the port, or cannot be written.
    pub(super) fn stop_written(&self) {
        let mut state = lock(&self.state);
        state.stops = state.stops.saturating_sub(1);
        state.pass(Passage::StopWritten);
        drop(state);
        self.opened.notify_waiters();
    }

    /// Waits until no stop is pending, then starts a request of this viewer.
    pub(super) async fn begin(&self, viewer: u64) {
        loop {
            let opened = self.opened.notified();
            {
                let mut state = lock(&self.state);
                if !state.is_closed() {
                    return state.pass(Passage::Begun(viewer));
                }
            }
            // If the gate does not open, it is checked again.
            let _ = tokio::time::timeout(WAIT_MAX, opened).await;
        }
    }
}
