//! What the hub sends to viewers, and the bounds of what it keeps for them.

use super::*;
use crate::console::capture::Condition;
use crate::console::signals::tests::sample;
use crate::random::Lcg;

fn hub() -> Hub {
    Hub::new(&Config::default(), "test")
}

#[test]
fn only_what_has_changed_is_news_and_each_change_once() {
    let mut hub = hub();
    let mut version = 0;
    let mut news = |hub: &Hub| {
        let news = hub.news_since(version);
        version = news.last().map_or(version, |(last, _)| *last);
        news.len()
    };
    assert_eq!(news(&hub), 3);
    hub.say(Topic::Preparation, &"a");
    hub.say(Topic::Preparation, &"a");
    hub.say(Topic::Preparation, &"b");
    assert_eq!(news(&hub), 1);
    assert_eq!(news(&hub), 0);
}

#[test]
fn the_log_keeps_its_last_lines_and_their_numbers() {
    let mut hub = hub();
    (0..2 * LOG_LINES).for_each(|line| hub.note(Level::Info, line.to_string()));
    let (lines, next) = hub.log_since(0);
    assert_eq!((lines.len(), next), (LOG_LINES, 2 * LOG_LINES as u64));
    assert_eq!(lines.first().map(|line| line.number), Some(LOG_LINES as u64));
    assert!(hub.log_since(next).0.is_empty());
}

#[test]
fn a_trigger_catches_for_its_viewer_only_and_once() {
    let mut hub = hub();
    let trigger = Trigger {
        signal: 1,
        condition: Condition::Rising,
        level: 0.5,
        before_ms: 10,
        after_ms: 10,
    };
    hub.arm(7, trigger);
    let samples: Vec<_> = (0..100).map(|t_ms| sample(t_ms, t_ms as f32 / 100.0)).collect();
    hub.take_samples(0, &samples);
    assert!(hub.take_caught(8).is_none());
    let (caught, snapshot) = hub.take_caught(7).unwrap();
    assert_eq!((caught.from_ms, caught.to_ms), (40, 60));
    assert_eq!(snapshot.rows(40, 60).count(), 21);
    assert!(hub.take_caught(7).is_none() && hub.capture_state(7).is_none());
}

#[test]
fn no_more_viewers_than_there_is_room_for_and_those_without_the_token_go_first() {
    let mut hub = hub();
    let trusted: Vec<_> = (0..VIEWERS_MAX - GUESTS_MAX)
        .map(|_| {
            let (viewer, leaving) = hub.enter().unwrap();
            assert_eq!(leaving, None);
            hub.trust(viewer);
            viewer
        })
        .collect();
    let guests: Vec<_> = (0..GUESTS_MAX).map(|_| hub.enter().unwrap()).collect();
    assert!(guests.iter().all(|(_, leaving)| leaving.is_none()));
    for (guest, _) in guests {
        let (viewer, leaving) = hub.enter().unwrap();
        assert_eq!(leaving, Some(guest), "the oldest guest goes");
        hub.trust(viewer);
    }
    assert_eq!(hub.viewers.len(), VIEWERS_MAX);
    assert_eq!(hub.enter(), None, "nobody with the token goes");
    hub.leave(trusted[0], 0);
    assert!(hub.enter().is_some());
}

#[test]
fn little_is_kept_and_armed_whoever_asks() {
    for seed in 1..50_u64 {
        let mut hub = hub();
        let viewers: Vec<_> = (0..20).filter_map(|_| hub.enter()).map(|(viewer, _)| viewer).collect();
        let trusted: Vec<_> = viewers
            .iter()
            .copied()
            .filter(|viewer| viewer % 3 == seed % 3)
            .collect();
        trusted.iter().for_each(|viewer| hub.trust(*viewer));
        let trigger = Trigger {
            signal: 1,
            condition: Condition::Above,
            level: 9.0,
            before_ms: 10,
            after_ms: 10,
        };
        let mut random = Lcg::new(seed);
        for _ in 0..200 {
            let viewer = viewers[random.below(viewers.len())];
            let snapshot = hub.history().snapshot();
            let is_trusted = trusted.contains(&viewer);
            assert!(hub.keep(viewer, snapshot) || !is_trusted, "seed {seed}");
            hub.arm(viewer, trigger);
            assert!(
                hub.kept.len() <= KEPT_MAX && hub.captures.len() <= ARMED_MAX,
                "seed {seed}"
            );
        }
    }
}
