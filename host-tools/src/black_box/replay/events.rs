//! The recorded events, for questions of the replay.

use super::super::contents::{EventEntry, SampleEntry};
use etherpen::application::{Command, Fault};
use etherpen::black_box::Event;
use etherpen::motion::PERIOD_MS;

/// Time by which an event may come after the sample that shows its effect, or before it, ms.
pub(super) const EVENT_MS: u32 = 6;
/// Time by which the event of a fault may come after its sample, ms: the task that writes events waits while the planner runs, usually for less than its
/// period.
pub(super) const FAULT_EVENT_MS: u32 = EVENT_MS + PERIOD_MS as u32;

/// Recorded events, oldest first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Events<'a>(pub &'a [EventEntry]);

impl Events<'_> {
    /// When the tasks were given the last configuration, ms.
    pub(super) fn configured_ms(self) -> Option<u32> {
        let mut configured = self.0.iter().rev();
        let last = configured.find(|entry| matches!(entry.event, Some(Event::Configured { .. })));
        last.map(|entry| entry.t_ms)
    }

    /// The last command that was given in the milliseconds from `from_ms` on, and not refused.
    pub(super) fn accepted(
        self,
        from_ms: u32,
        milliseconds: u32,
        is_meant: impl Fn(&Command) -> bool,
    ) -> Option<Command> {
        let numbered = self.0.iter().enumerate().rev();
        let mut then = numbered.filter(|(_, entry)| entry.t_ms.wrapping_sub(from_ms) < milliseconds);
        then.find_map(|(index, entry)| {
            let next = self.0.get(index + 1).and_then(|next| next.event);
            match (&entry.event, next) {
                (_, Some(Event::Refused(_))) => None,
                (Some(Event::Command(command)), _) if is_meant(command) => Some(*command),
                _ => None,
            }
        })
    }

    /// Whether something happened in the milliseconds from `from_ms` on.
    pub(super) fn happened(self, from_ms: u32, milliseconds: u32, event: &Event) -> bool {
        let is_then = |entry: &&EventEntry| entry.t_ms.wrapping_sub(from_ms) < milliseconds;
        self.0
            .iter()
            .filter(is_then)
            .any(|entry| entry.event.as_ref() == Some(event))
    }

    /// The fault that was recorded as new shortly after a sample.
    pub(super) fn fault_at(self, sample: &SampleEntry) -> Option<Fault> {
        self.0.iter().find_map(|entry| {
            // The event may have a time one millisecond earlier.
            let after_ms = entry.t_ms.wrapping_sub(sample.t_ms).wrapping_add(1);
            match entry.event {
                Some(Event::Fault(fault)) if after_ms <= FAULT_EVENT_MS => fault,
                _ => None,
            }
        })
    }

    /// Whether the events of a sample's time have been overwritten.
    pub(super) fn begin_after(self, sample: &SampleEntry) -> bool {
        let first = self.0.first();
        first.is_none_or(|first| sample.t_ms.wrapping_sub(first.t_ms) > u32::MAX / 2)
    }
}
