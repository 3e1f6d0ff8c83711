//! Triggered capture: telemetry around an event, millisecond by millisecond.
//!
//! Works like an oscilloscope: an armed capture waits for an edge, a level or a fault, then for the time after the
//! event. Invariant: it fires once, on the first row that fulfils the condition after arming.

use super::signals::SignalRow;
use etherpen::application::Mode;

/// Longest capture, ms.
pub const CAPTURE_MAX_MS: u64 = 60_000;

/// Trigger condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Condition {
    /// The signal rises to the level.
    Rising,
    /// The signal falls to the level.
    Falling,
    /// The signal is at the level or above.
    Above,
    /// The signal is at the level or below.
    Below,
    /// A fault is latched.
    Fault,
}

/// An armed capture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trigger {
    /// Number of the signal in the catalogue.
    pub signal: usize,
    /// The condition.
    pub condition: Condition,
    /// The level, in the signal's unit.
    pub level: f32,
    /// Time before the event, ms.
    pub before_ms: u64,
    /// Time after the event, ms.
    pub after_ms: u64,
}

/// The span caught by a trigger, console time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Caught {
    /// Beginning, ms.
    pub from_ms: u64,
    /// The event, ms.
    pub event_ms: u64,
    /// End, ms.
    pub to_ms: u64,
}

/// An armed capture.
#[derive(Clone, Copy, Debug)]
pub struct SignalCapture {
    trigger: Trigger,
    last: Option<(f32, Mode)>,
    event_ms: Option<u64>,
}

impl SignalCapture {
    /// Arms a trigger; the sum of its times is limited to [`CAPTURE_MAX_MS`].
    pub fn new(mut trigger: Trigger) -> Self {
        trigger.before_ms = trigger.before_ms.min(CAPTURE_MAX_MS);
        trigger.after_ms = trigger.after_ms.min(CAPTURE_MAX_MS - trigger.before_ms);
        Self {
            trigger,
            last: None,
            event_ms: None,
        }
    }

    /// Takes the next row; returns the span once it is complete.
    pub fn step(&mut self, row: &SignalRow) -> Option<Caught> {
        let value = row.value(self.trigger.signal);
        if self.event_ms.is_none() && self.fires(value, row.mode) {
            self.event_ms = Some(row.time_ms);
        }
        self.last = Some((value, row.mode));
        let event_ms = self.event_ms?;
        let to_ms = event_ms + self.trigger.after_ms;
        (row.time_ms >= to_ms).then(|| Caught {
            from_ms: event_ms.saturating_sub(self.trigger.before_ms),
            event_ms,
            to_ms,
        })
    }

    /// Whether the event has occurred.
    pub fn has_fired(&self) -> bool {
        self.event_ms.is_some()
    }

    fn fires(&self, value: f32, mode: Mode) -> bool {
        let level = self.trigger.level;
        match (self.trigger.condition, self.last) {
            (Condition::Above, _) => value >= level,
            (Condition::Below, _) => value <= level,
            (Condition::Rising, Some((last, _))) => last < level && value >= level,
            (Condition::Falling, Some((last, _))) => last > level && value <= level,
            (Condition::Fault, Some((_, last))) => last != Mode::Fault && mode == Mode::Fault,
            (Condition::Rising | Condition::Falling | Condition::Fault, None) => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::signals::{Rows, tests::sample};
    use super::*;
    use etherpen::config::Config;

    fn caught(condition: Condition, level: f32, fault_at_ms: u64) -> Option<Caught> {
        let trigger = Trigger {
            signal: 1,
            condition,
            level,
            before_ms: 20,
            after_ms: 30,
        };
        let (mut capture, mut rows) = (SignalCapture::new(trigger), Rows::new(&Config::default()));
        (0..200).find_map(|t_ms| {
            let mut row = rows.take(&sample(t_ms, 1.0 - (t_ms as f32 - 100.0).abs() / 100.0));
            if row.time_ms >= fault_at_ms {
                row.mode = Mode::Fault;
            }
            capture.step(&row)
        })
    }

    #[test]
    fn edges_levels_and_faults_fire_where_they_happen() {
        let event = |condition, level| caught(condition, level, 77).map(|caught| caught.event_ms);
        assert_eq!(event(Condition::Rising, 0.5), Some(50));
        assert_eq!(event(Condition::Falling, 0.5), Some(150));
        assert_eq!(event(Condition::Above, -1.0), Some(0));
        assert_eq!(event(Condition::Below, 0.0), Some(0));
        assert_eq!(event(Condition::Fault, 0.0), Some(77));
        assert_eq!(event(Condition::Rising, 2.0), None);
    }

    #[test]
    fn the_span_reaches_before_and_after_the_event() {
        let span = caught(Condition::Rising, 0.5, 999).unwrap();
        assert_eq!((span.from_ms, span.event_ms, span.to_ms), (30, 50, 80));
    }

    #[test]
    fn a_fault_that_was_there_before_does_not_fire() {
        assert_eq!(caught(Condition::Fault, 0.0, 0), None);
    }
}
