//! Episodes against the emulated board's image: what they find, and that a black box that is not true is found.

use super::super::episode::{Event, What};
use super::super::generate::{Profile, episode};
use super::super::machine::{DEFAULT_MACHINE, Machine};
use super::*;
use crate::random::Random;
use crate::setup;
use etherpen::black_box::{MEMORY_BYTES, SAMPLES};
use std::cell::RefCell;

/// Robot time of an episode without its end, ms.
const DURATION_MS: u32 = 4_000;
/// Words of the areas of a black box: see `docs/blackbox.md`.
const SAMPLES_AT: usize = 16;
const SAMPLE_WORDS: usize = 16;
const EVENTS_AT: usize = SAMPLES_AT + (SAMPLES + 1) * SAMPLE_WORDS;
const FRAMES_AT: usize = EVENTS_AT + 100 * 20;
/// Changes tried of each kind.
const CHANGES: usize = 40;

fn image() -> std::path::PathBuf {
    setup::ensure_qemu().expect("the emulator can be had");
    setup::build_firmware("emulated").expect("the firmware builds")
}

fn of_seed(seed: u64, profile: Profile) -> Episode {
    let machine = Machine::load(DEFAULT_MACHINE).expect("a bundled machine");
    Episode {
        duration_ms: DURATION_MS,
        ..episode(&machine, seed, profile)
    }
}

#[test]
fn episodes_against_the_emulated_board_find_nothing() {
    let (image, episode) = (image(), of_seed(3, Profile::All));
    let runs = [(); 2].map(|()| run_image(&image, &episode));
    println!("{} ms", runs[0].passed_ms);
    assert_eq!(runs[0].failure, None);
    assert!(runs[0].passed_ms > DURATION_MS);
    assert_eq!(runs[0], runs[1], "every run is the same");
    let damaged = include_str!("../../../../tests/campaign/memory-damaged-at-the-first-reading.toml");
    let run = run_image(&image, &Episode::parse(damaged).expect("a test case"));
    assert_eq!((run.failure, run.resets), (None, 1));
}

/// On a board an order may be taken a millisecond later than its event says; a drive's fault, or a position that is missing,
/// counts from then on.
#[test]
fn what_is_a_fault_as_soon_as_there_is_power_is_replayed_in_the_millisecond_in_which_the_order_was_taken() {
    let image = image();
    for (seed, profile) in [(88_000_007, Profile::Drives), (88_000_013, Profile::Bus)] {
        let run = run_image(&image, &of_seed(seed, profile));
        assert_eq!(run.failure, None, "{seed}");
    }
}

/// Its milliseconds are shorter than the computer's, so after 18 s there is half a millisecond between their counts.
#[test]
fn the_cell_is_never_ahead_of_a_board_that_follows_a_faster_clock() {
    let machine = Machine::load(DEFAULT_MACHINE).expect("a bundled machine");
    let run = run_image(&image(), &episode(&machine, 88_000_057, Profile::Quiet));
    println!("{run:?}");
    assert_eq!(run.failure, None);
    assert!(run.passed_ms > 18_000);
}

/// Short frames: the board's own request for an address, and answers that were cut off.
#[test]
fn short_frames_are_recorded_as_they_were() {
    let image = image();
    for (seed, profile) in [(88_000_040, Profile::Drives), (88_000_035, Profile::Bus)] {
        let machine = Machine::load(DEFAULT_MACHINE).expect("a bundled machine");
        let run = run_image(&image, &episode(&machine, seed, profile));
        assert_eq!(run.failure, None, "{seed}");
    }
}

/// The last black box of an episode, as it was read, and what was seen until then.
fn last_black_box(image: &Path, episode: &Episode) -> (Vec<u8>, Witness, Run) {
    let (config, world) = prepared(episode).unwrap_or_else(|failed| panic!("{failed:?}"));
    let last = RefCell::new((Vec::new(), Witness::default()));
    let keep = |memory: &mut Vec<u8>, witness: &Witness| *last.borrow_mut() = (memory.clone(), witness.copy());
    let plan = Plan {
        damage: &keep,
        ..Plan::new(image)
    };
    let mut operator = Operator::new(episode, config, world.clone());
    let run = run_watched(&plan, &mut operator, &world);
    let (memory, witness) = last.into_inner();
    (memory, witness, run)
}

/// Gives a random number below a bound.
type Below<'a> = &'a mut dyn FnMut(usize) -> usize;

#[test]
fn a_black_box_in_which_one_bit_is_changed_is_found() {
    let (image, mut episode) = (image(), of_seed(1, Profile::Quiet));
    // In velocity mode all of it is replayed.
    episode.config.clear();
    let (memory, witness, run) = last_black_box(&image, &episode);
    assert_eq!(run.failure, None);
    assert_eq!(memory.len(), MEMORY_BYTES);
    let (config, world) = prepared(&episode).unwrap_or_else(|failed| panic!("{failed:?}"));
    let operator = Operator::new(&episode, config, world);
    let examined = |memory: &[u8]| operator.examine(memory, &witness, Origin::Present);
    assert_eq!(examined(&memory), Ok(()));
    let mut random = Random::new(1);
    let mut below = |bound: usize| (random.unit() * bound as f64) as usize % bound;
    let mut found_of = |what: &str, place: &mut dyn FnMut(Below<'_>) -> (usize, u8)| {
        let mut found = 0;
        for _ in 0..CHANGES {
            let (byte, bit) = place(&mut below);
            let mut changed = memory.clone();
            changed[byte] ^= 1 << bit;
            let result = examined(&changed);
            found += usize::from(result.is_err());
            if result.is_ok() {
                println!("{what}: bit {bit} of byte {byte} is not found");
            }
        }
        println!("{what}: {found} of {CHANGES} found");
        found
    };
    let slot = |below: &mut dyn FnMut(usize) -> usize| SAMPLES_AT + below(SAMPLES + 1) * SAMPLE_WORDS;
    // A bit of a sample's millisecond; one of an angle that is more than rounding; one of the increments' lower bytes (a greater
    // step is a fault whose cause may lie before the recording). The slot that is written next is not part of the recording.
    let milliseconds = found_of("milliseconds", &mut |below| (4 * slot(below), below(8) as u8));
    let angles = found_of("angles", &mut |below| {
        (4 * (slot(below) + 5 + below(4)) + 2, below(7) as u8)
    });
    let increments = found_of("increments", &mut |below| {
        (4 * (slot(below) + 9 + below(2)) + 2 * below(2), 6)
    });
    let events = found_of("events", &mut |below| {
        (4 * (EVENTS_AT + 20 * below(6)) + 8, below(8) as u8)
    });
    let frames = found_of("frames", &mut |below| {
        (
            4 * FRAMES_AT + below(MEMORY_BYTES - 4 * FRAMES_AT - 4_096),
            below(8) as u8,
        )
    });
    // The first 25 ms of a replay are not compared.
    assert!(
        [milliseconds, angles, increments]
            .iter()
            .all(|found| *found >= CHANGES - 4)
    );
    assert!(events >= CHANGES / 2, "{events}");
    // A counter's value and the padding of a frame's last word are nobody's.
    assert!(frames >= CHANGES * 8 / 10, "{frames}");
}

#[test]
fn a_changed_byte_fails_an_episode_at_its_end() {
    let (image, episode) = (image(), of_seed(1, Profile::Quiet));
    let damage = |memory: &mut Vec<u8>, _: &Witness| memory[4 * (SAMPLES_AT + 100 * SAMPLE_WORDS + 5) + 2] ^= 0x40;
    let (config, world) = prepared(&episode).unwrap_or_else(|failed| panic!("{failed:?}"));
    let plan = Plan {
        damage: &damage,
        ..Plan::new(&image)
    };
    let mut operator = Operator::new(&episode, config, world.clone());
    let failure = run_watched(&plan, &mut operator, &world).failure;
    let failure = failure.expect("the black box is not what was seen");
    println!("{failure}");
    assert!(matches!(failure.rule, Rule::BlackBox | Rule::Replay), "{failure}");
}

#[test]
fn the_boards_inputs_reach_the_emulated_board() {
    let image = image();
    for what in [
        What::StopInput(200),
        What::SubstituteClock(200),
        What::TrajectoryWaits(80),
        What::PortDown(200),
    ] {
        let mut episode = of_seed(1, Profile::Quiet);
        episode.events = vec![Event {
            at_ms: 3_000,
            what: what.clone(),
        }];
        let (_, witness, run) = last_black_box(&image, &episode);
        println!("{what:?}: {run:?}, faults {:?}", witness.faults());
        assert_eq!(run.failure, None, "{what:?}");
        assert!(witness.faults().iter().any(Option::is_some), "{what:?} is noticed");
    }
}
