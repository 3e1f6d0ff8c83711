//! Control: one viewer at a time may command.
//!
//! Control is taken and given back. A viewer that vanishes keeps it for a short time, so that a reloaded page
//! continues, but its jog stops at once. Invariant: at most one viewer holds control; requests of other viewers are
//! refused, except a stop.

/// How long a vanished viewer keeps control, ms.
pub const VANISHED_MS: u64 = 5_000;
/// Silence after which a viewer counts as vanished although it is still connected, ms.
pub const SILENT_MS: u64 = 3_000;

/// Number of a connection.
pub type ViewerId = u64;

/// The viewer that holds control.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Holder {
    viewer: ViewerId,
    /// Name of the page; unchanged by a reload.
    page: String,
    /// Time since which the viewer is silent, ms.
    vanished_ms: Option<u64>,
    heard_ms: u64,
}

/// The right to command.
#[derive(Clone, Debug, Default)]
pub struct ControlLock {
    holder: Option<Holder>,
}

/// Action required by a change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// The holder has vanished: its jog has to stop.
    Vanished,
    /// Control was released.
    Released,
}

impl ControlLock {
    /// The viewer that holds control.
    pub fn holder(&self) -> Option<ViewerId> {
        self.holder.as_ref().map(|holder| holder.viewer)
    }

    /// Whether this viewer may command.
    pub fn is_held_by(&self, viewer: ViewerId) -> bool {
        self.holder() == Some(viewer)
    }

    /// Takes control; `force` takes it from another viewer. Returns whether the viewer has control.
    pub fn take(&mut self, viewer: ViewerId, page: &str, force: bool, now_ms: u64) -> bool {
        let free = match &self.holder {
            None => true,
            Some(holder) => force || holder.viewer == viewer || (holder.vanished_ms.is_some() && holder.page == page),
        };
        if free {
            self.holder = Some(Holder {
                viewer,
                page: page.to_owned(),
                vanished_ms: None,
                heard_ms: now_ms,
            });
        }
        free
    }

    /// Gives control back to a page that was reloaded in time.
    pub fn returned(&mut self, viewer: ViewerId, page: &str, now_ms: u64) -> bool {
        let same = self
            .holder
            .as_ref()
            .is_some_and(|holder| holder.vanished_ms.is_some() && holder.page == page && !page.is_empty());
        same && self.take(viewer, page, false, now_ms)
    }

    /// Releases control; returns whether this viewer had it.
    pub fn release(&mut self, viewer: ViewerId) -> bool {
        self.holder.take_if(|holder| holder.viewer == viewer).is_some()
    }

    /// Takes a sign of life of a viewer.
    pub fn heard(&mut self, viewer: ViewerId, now_ms: u64) {
        if let Some(holder) = self.holder.as_mut().filter(|holder| holder.viewer == viewer) {
            holder.heard_ms = now_ms;
            holder.vanished_ms = None;
        }
    }

    /// Handles the end of a viewer's connection.
    pub fn gone(&mut self, viewer: ViewerId, now_ms: u64) -> Option<Change> {
        let holder = self.holder.as_mut().filter(|holder| holder.viewer == viewer)?;
        if holder.vanished_ms.is_some() {
            return None;
        }
        holder.vanished_ms = Some(now_ms);
        Some(Change::Vanished)
    }

    /// Checks the time limits.
    pub fn tick(&mut self, now_ms: u64) -> Option<Change> {
        let holder = self.holder.as_mut()?;
        match holder.vanished_ms {
            Some(since_ms) if now_ms.saturating_sub(since_ms) >= VANISHED_MS => {
                self.holder = None;
                Some(Change::Released)
            }
            None if now_ms.saturating_sub(holder.heard_ms) >= SILENT_MS => {
                holder.vanished_ms = Some(now_ms);
                Some(Change::Vanished)
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_is_held_by_one_viewer_until_it_gives_it_back() {
        let mut lock = ControlLock::default();
        assert!(lock.take(1, "a", false, 0));
        assert!(!lock.take(2, "b", false, 0));
        assert!(lock.is_held_by(1) && !lock.is_held_by(2));
        assert!(!lock.release(2));
        assert!(lock.release(1));
        assert!(lock.take(2, "b", false, 0));
        assert!(lock.take(1, "a", true, 0) && lock.is_held_by(1));
    }

    #[test]
    fn a_viewer_that_vanishes_stops_at_once_and_loses_control_after_a_time() {
        let mut lock = ControlLock::default();
        lock.take(1, "a", false, 0);
        assert_eq!(lock.gone(1, 100), Some(Change::Vanished));
        assert_eq!(lock.tick(100 + VANISHED_MS - 1), None);
        assert!(!lock.take(2, "b", false, 200));
        assert_eq!(lock.tick(100 + VANISHED_MS), Some(Change::Released));
        assert!(lock.take(2, "b", false, 6_000));
    }

    #[test]
    fn a_silent_connection_counts_as_vanished() {
        let mut lock = ControlLock::default();
        lock.take(1, "a", false, 0);
        lock.heard(1, 1_000);
        assert_eq!(lock.tick(1_000 + SILENT_MS - 1), None);
        assert_eq!(lock.tick(1_000 + SILENT_MS), Some(Change::Vanished));
        lock.heard(1, 5_000);
        assert_eq!(lock.tick(5_001), None);
        assert!(lock.is_held_by(1));
    }

    #[test]
    fn a_page_that_is_loaded_again_goes_on() {
        let mut lock = ControlLock::default();
        lock.take(1, "a", false, 0);
        assert!(!lock.returned(2, "a", 10), "the first is still there");
        lock.gone(1, 100);
        assert!(!lock.returned(3, "b", 150));
        assert!(lock.returned(2, "a", 200) && lock.is_held_by(2));
    }
}
