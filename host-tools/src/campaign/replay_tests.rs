//! Recordings of faults that were injected at random replay to the same millisecond; changed ones do not.

use super::generate::{Profile, episode};
use super::machine::{DEFAULT_MACHINE, Machine};
use super::operator::Operator;
use super::{LIMIT_MS, prepared};
use crate::black_box::contents::{Contents, EventEntry, SampleEntry};
use crate::black_box::image;
use crate::black_box::replay::{Replay, replay};
use crate::simulation::{self, Host, Surroundings};
use etherpen::black_box::{Event, Memory};
use etherpen::config::Config;
use etherpen::motion::PERIOD_MS;
use std::collections::BTreeSet;

/// Seeds whose first faults are replayed.
const SEEDS: std::ops::Range<u64> = 2_000..2_120;

/// Keeps the black box of the first fault.
struct Recorded<'e> {
    operator: Operator<'e>,
    memory: Option<Vec<u8>>,
}

impl Host for Recorded<'_> {
    fn exchange(&mut self, ms: u32, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
        self.operator.exchange(ms, from_firmware, to_firmware, room);
    }

    fn recorded(&mut self, black_box: &Memory) {
        if self.operator.hears_a_fault() {
            self.memory.get_or_insert_with(|| image(black_box));
        }
    }

    fn surroundings(&mut self) -> Surroundings {
        self.operator.surroundings()
    }

    fn is_over(&self) -> bool {
        self.memory.is_some() || self.operator.is_over()
    }
}

/// The recording of a seed's first fault, if it has one, and its configuration.
fn first_fault(seed: u64) -> Option<(Contents, Config)> {
    let machine = Machine::load(DEFAULT_MACHINE).ok()?;
    let episode = episode(&machine, seed, Profile::All);
    let (config, mut world) = prepared(&episode).ok()?;
    let mut host = Recorded {
        operator: Operator::new(&episode, config.clone(), world.clone()),
        memory: None,
    };
    simulation::run(&mut world, &mut host, LIMIT_MS);
    let contents = Contents::of(&host.memory?).expect("a recording");
    Some((contents, config))
}

/// Where a recording's own samples first show a latched fault, s before its end.
fn latched_s(contents: &Contents) -> Option<f64> {
    let pairs = contents.samples.windows(2);
    let mut latched = pairs.filter(|pair| pair[1].fault && !pair[0].fault);
    latched.next().map(|pair| pair[1].before_end_s)
}

fn kind(replay: &Replay) -> Option<String> {
    let fault = replay.faults.first()?.fault?;
    let text = format!("{fault:?}");
    text.split([' ', '(', '{']).next().map(str::to_owned)
}

#[test]
fn faults_replay_to_the_millisecond_in_which_they_were_latched() {
    let (mut kinds, mut replayed, mut ended) = (BTreeSet::new(), 0, 0);
    for seed in SEEDS {
        let Some((contents, config)) = first_fault(seed) else {
            continue;
        };
        let Ok(replay) = replay(&contents, &config) else {
            continue;
        };
        assert_eq!(replay.difference, None, "seed {seed}");
        ended += u32::from(replay.not_recorded.is_some());
        if let Some(first) = replay.faults.first() {
            assert_eq!(Some(first.before_end_s), latched_s(&contents), "seed {seed}");
            kinds.extend(kind(&replay));
            replayed += 1;
        }
    }
    println!("{replayed} faults replayed, {ended} with causes outside the recording: {kinds:?}");
    assert!(
        replayed >= 30 && ended <= replayed / 3,
        "{replayed} replayed, {ended} not"
    );
    assert!(kinds.len() >= 6, "{kinds:?}");
}

#[test]
fn a_fault_of_another_task_may_have_its_event_a_planner_period_later() {
    let mut delayed = 0;
    for seed in SEEDS {
        let Some((mut contents, config)) = first_fault(seed) else {
            continue;
        };
        let outcome = |contents: &Contents| {
            replay(contents, &config)
                .ok()
                .map(|replay| (replay.not_recorded, replay.difference))
        };
        let Some((Some(ended), None)) = outcome(&contents) else {
            continue;
        };
        let sample = contents
            .samples
            .iter()
            .find(|sample| sample.before_end_s == ended.before_end_s);
        let latched_ms = sample.expect("it is a sample").t_ms;
        let is_told = |entry: &&mut EventEntry| {
            ended.fault.is_some()
                && entry.event == Some(Event::Fault(ended.fault))
                && entry.t_ms.wrapping_sub(latched_ms).wrapping_add(1) <= PERIOD_MS as u32
        };
        let Some(told) = contents.events.iter_mut().find(is_told) else {
            continue;
        };
        told.t_ms = latched_ms + PERIOD_MS as u32;
        assert_eq!(outcome(&contents), Some((Some(ended), None)), "seed {seed}");
        delayed += 1;
    }
    println!("{delayed} events delayed");
    assert!(delayed >= 3, "{delayed} recordings have such a fault");
}

#[test]
fn a_recording_that_was_changed_differs_where_it_was_changed() {
    let sound = SEEDS.into_iter().find_map(|seed| {
        let (contents, config) = first_fault(seed)?;
        let replayed = replay(&contents, &config).ok()?;
        let before_ms = replayed.faults.first().map_or(0.0, |fault| {
            1e3 * (contents.samples.last().map_or(0.0, |last| -last.before_end_s) + fault.before_end_s)
        });
        let is_long = f64::from(replayed.agreed_ms) - before_ms > 100.0 && replayed.not_recorded.is_none();
        (is_long && !replayed.faults.is_empty()).then_some((contents, config))
    });
    let (contents, config) = sound.expect("a seed with a fault");
    let first = replay(&contents, &config).expect("as before").faults[0].before_end_s;
    let is_first = |sample: &SampleEntry| sample.before_end_s == first;
    let fault = contents.samples.iter().position(is_first).expect("it is a sample");
    let differs_at = |contents: &Contents| {
        let replayed = replay(contents, &config).expect("as long as before");
        replayed.difference.map(|difference| difference.before_end_s)
    };

    let mut later = contents.clone();
    later.samples[fault].fault = false;
    assert_eq!(
        differs_at(&later),
        Some(contents.samples[fault].before_end_s),
        "the fault came later"
    );

    let before = fault - 40;
    let mut elsewhere = contents.clone();
    elsewhere.samples[before].measured_rad[1] += 1.0e-4;
    let place = Some(contents.samples[before].before_end_s);
    assert_eq!(differs_at(&elsewhere), place, "an angle that no position gives");

    let mut standing = contents.clone();
    standing.samples[before].standstill ^= true;
    assert_eq!(differs_at(&standing), place, "standstill is a result");

    let mut early = contents.clone();
    early.samples[before].fault = true;
    assert_eq!(differs_at(&early), place, "a fault without a cause");
}
