//! What the bus's counters have to show at the end of an episode, from what was done to the frames.
//!
//! Each fault of a frame costs exactly one event of its kind. Which frames are hit is known only while the faults are of
//! one kind: two faults may hit the same frame. Episodes in which anything else disturbs the bus are not counted, nor
//! are those with frames that are cut, delayed or get another working counter, and those over UDP.

use super::episode::{Episode, What};
use etherpen::config::{Config, Transport};
use std::collections::BTreeMap;

/// Kinds of faults that cost a telegram its reply, that add a frame which is ignored, and that do both. A cut hits only
/// frames that are longer.
const LOST: [&str; 2] = ["drop", "lose"];
const ADDED: [&str; 3] = ["duplicate", "foreign", "reflect"];
const DAMAGED: [&str; 6] = ["vlan", "type", "overlong", "index", "more", "circulate"];

/// Counters by name, with what they have to show.
pub(super) type Expected = [(&'static str, u64); 4];

/// The kinds of frame faults of an episode, if nothing else disturbs its bus.
fn kinds(episode: &Episode) -> Option<Vec<&str>> {
    let mut kinds = Vec::new();
    for event in &episode.events {
        match &event.what {
            What::Frames(words, _) => kinds.extend(words.split(' ').next()),
            What::Command(_) | What::Beside(_) | What::Reconnect | What::Unplug(_) | What::Noise(..) => {}
            What::Fault(_)
            | What::State(..)
            | What::File(..)
            | What::StopInput(_)
            | What::SubstituteClock(_)
            | What::TrajectoryWaits(_)
            | What::PortDown(_)
            | What::Program(_) => return None,
        }
    }
    kinds.sort_unstable();
    kinds.dedup();
    Some(kinds)
}

/// What the counters have to show, given the number of faults of each kind that took effect; `None` if that is not
/// known. Over UDP the IP stack's frames are hit too.
pub(super) fn expected(episode: &Episode, config: &Config, injected: &BTreeMap<&'static str, u64>) -> Option<Expected> {
    let kinds = kinds(episode).filter(|kinds| kinds.len() <= 1 && config.bus.transport == Transport::Raw)?;
    let (mut lost, mut ignored) = (0, 0);
    if let Some(kind) = kinds.first() {
        let count = injected.get(kind).copied().unwrap_or(0);
        match *kind {
            kind if LOST.contains(&kind) => lost = count,
            kind if ADDED.contains(&kind) => ignored = count,
            kind if DAMAGED.contains(&kind) => (lost, ignored) = (count, count),
            _ => return None,
        }
    }
    Some([
        ("frames_lost", lost),
        ("frames_ignored", ignored),
        ("working_counter_errors", 0),
        ("cycles_late", 0),
    ])
}

#[cfg(test)]
mod tests {
    use super::super::episode::Event;
    use super::super::generate::{Profile, episode};
    use super::super::machine::{DEFAULT_MACHINE, Machine};
    use super::*;

    fn with(whats: &[What]) -> Episode {
        let machine = Machine::load(DEFAULT_MACHINE).expect("a bundled machine");
        Episode {
            events: whats
                .iter()
                .map(|what| Event {
                    at_ms: 1,
                    what: what.clone(),
                })
                .collect(),
            ..episode(&machine, 1, Profile::Quiet)
        }
    }

    #[test]
    fn one_kind_is_counted_and_two_or_anything_else_is_not() {
        let (config, injected) = (Config::default(), BTreeMap::from([("vlan", 5), ("drop", 2)]));
        let of =
            |whats: &[What]| expected(&with(whats), &config, &injected).map(|counts| counts.map(|(_, count)| count));
        let frames = |words: &str| What::Frames(words.into(), 9);
        assert_eq!(of(&[]), Some([0; 4]));
        assert_eq!(of(&[frames("vlan"), What::Reconnect]), Some([5, 5, 0, 0]));
        assert_eq!(of(&[frames("drop"), frames("drop")]), Some([2, 0, 0, 0]));
        assert_eq!(of(&[frames("duplicate")]), Some([0; 4]));
        assert_eq!(of(&[frames("vlan"), frames("drop")]), None);
        assert_eq!(of(&[frames("counter 1")]), None);
        assert_eq!(of(&[frames("drop"), What::PortDown(3)]), None);
    }
}
