//! Portraits with faults for many hours, by one controller that is never switched off.
//!
//! The faults of a soak end after seconds, so that portraits are finished between them. The memory that the program
//! uses must not grow with the hours; the controller's own is static.

use super::chance::Chance;
use super::episode::{Episode, Event, Figure, What, Wish};
use super::generate::{Profile, what};
use super::long_cables;
use super::machine::{DEFAULT_MACHINE, Machine};
use super::operator::Operator;
use super::trouble;
use super::world::World;
use crate::cell::{Cell, CellOptions};
use crate::drawing::preparation::prepare::prepare;
use crate::run::task;
use crate::simulation::{self, Host, Surroundings};
use etherpen::config::Config;
use etherpen::messages::PathVertex;
use std::collections::BTreeMap;
use std::path::Path;

/// Robot time of the soak, hours, if the variable does not name another.
const HOURS: f64 = 24.0;
const HOURS_VARIABLE: &str = "ETHERPEN_SOAK_HOURS";
const SEED_VARIABLE: &str = "ETHERPEN_SOAK_SEED";
/// Shortest and longest time from one burst of faults to the next, ms.
const PAUSE_MIN_MS: f64 = 1_000.0;
const PAUSE_MAX_MS: f64 = 600_000.0;
/// Longest time until what was cut, removed or damaged is whole again, ms.
const WHOLE_AFTER_MS: u32 = 4_000;
/// Time that the end of an episode may take, ms.
const ENDING_MS: u32 = 1_200_000;
/// Fewest portraits that are finished in an hour; one without faults takes two minutes.
const PORTRAITS_PER_HOUR_MIN: f64 = 12.0;
/// Milliseconds in an hour.
const HOUR_MS: u32 = 3_600_000;
/// Growth of the program's memory that is allowed after the first hour, pages of 4 KiB: 8 MiB.
const GROWTH_MAX_PAGES: u64 = 2_048;

/// The operator, and what is looked at every hour.
struct Watched<'e> {
    operator: Operator<'e>,
    world: World,
    /// The drawing finished last, and how many portraits were.
    finished: (Option<u16>, u32),
    /// Resident memory at each full hour, pages.
    resident_pages: Vec<u64>,
}

impl Host for Watched<'_> {
    fn exchange(&mut self, ms: u32, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
        let draws_portraits = !self.operator.is_healed();
        if ms > 0 && ms.is_multiple_of(HOUR_MS) {
            // The test figure's ink is compared with the figure.
            if draws_portraits {
                self.world.new_sheet();
            }
            let pages = resident_pages();
            println!("{} hours, {pages} pages", ms / HOUR_MS);
            self.resident_pages.push(pages);
        }
        self.operator.exchange(ms, from_firmware, to_firmware, room);
        let finished = self.operator.finished();
        if finished != self.finished.0 {
            let counts = finished.is_some() && draws_portraits;
            self.finished = (finished, self.finished.1 + u32::from(counts));
        }
    }

    fn surroundings(&mut self) -> Surroundings {
        self.operator.surroundings()
    }

    fn is_over(&self) -> bool {
        self.operator.is_over()
    }
}

/// Resident memory of this program, pages; 0 where the system does not tell.
fn resident_pages() -> u64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let mut numbers = text.split(' ').map(|word| word.parse().unwrap_or(0));
    numbers.nth(1).unwrap_or(0)
}

/// The strokes of a path.
fn figure(path: &[PathVertex], down_um: i32) -> Figure {
    let of_one_stroke = path.chunk_by(|one, next| one.stroke == next.stroke);
    let strokes = of_one_stroke.map(|vertices| {
        let on_paper = vertices.iter().filter(|vertex| vertex.position_um[2] == down_um);
        on_paper
            .map(|vertex| [vertex.position_um[0], vertex.position_um[1]])
            .collect()
    });
    Figure(strokes.collect())
}

fn portrait() -> Figure {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../samples/astronaut.png");
    let config = Config::default();
    let prepared = prepare(&file, &config).expect("the sample can be drawn");
    let down_um = (config.paper.pen_down_z_mm * 1e3).round() as i32;
    figure(&task(&config, &prepared).path, down_um)
}

fn episode(seed: u64, duration_ms: u32, portrait: Figure) -> Episode {
    let mut chance = Chance::new(seed);
    let machine = Machine::load(DEFAULT_MACHINE).expect("a bundled machine");
    let (mut events, mut at_ms) = (Vec::new(), 0);
    while at_ms < duration_ms {
        for _ in 0..1 + chance.below(3) {
            let what = what(&mut chance, &machine, Profile::All);
            let words = match &what {
                What::Fault(words) => trouble::end(words),
                _ => None,
            };
            events.push(Event { at_ms, what });
            events.extend(words.map(|words| Event {
                at_ms: at_ms + chance.milliseconds(WHOLE_AFTER_MS),
                what: What::Fault(words),
            }));
            at_ms += chance.one_of(&[0, 0, 1, 30]);
        }
        at_ms += chance.scaled(PAUSE_MIN_MS, PAUSE_MAX_MS) as u32;
    }
    events.sort_by_key(|event| event.at_ms);
    Episode {
        found: String::new(),
        machine: machine.name,
        seed,
        duration_ms,
        patience_ms: 300,
        draws: true,
        by_jobs: false,
        wishes: vec![Wish::Draw(0)],
        figures: vec![portrait],
        config: BTreeMap::new(),
        events,
    }
}

/// Soaks for some hours; returns the memory at each full hour, pages.
fn soak(seed: u64, hours: f64) -> Vec<u64> {
    let duration_ms = (hours * f64::from(HOUR_MS)) as u32;
    let episode = episode(seed, duration_ms, portrait());
    let options = CellOptions {
        seed,
        clocks: long_cables(),
        ..CellOptions::default()
    };
    let mut world = World::new(Cell::new(&Config::default(), options));
    let mut watched = Watched {
        operator: Operator::new(&episode, Config::default(), world.clone()),
        world: world.clone(),
        finished: (None, 0),
        resident_pages: Vec::new(),
    };
    let passed_ms = simulation::run(&mut world, &mut watched, duration_ms + ENDING_MS);
    let (portraits, events) = (watched.finished.1, episode.events.len());
    println!("seed {seed}: {passed_ms} ms, {events} events, {portraits} portraits");
    assert!(
        !watched.operator.presses_reset(),
        "seed {seed}: nothing but a reset helps"
    );
    let failure = watched.operator.failure();
    assert_eq!(failure, None, "seed {seed}, {passed_ms} of {duration_ms} ms");
    assert!(
        f64::from(portraits) >= (hours * PORTRAITS_PER_HOUR_MIN).floor(),
        "{portraits} portraits in {hours} hours"
    );
    watched.resident_pages
}

#[test]
fn some_minutes_of_a_portrait_with_faults_find_nothing() {
    soak(1, 0.1);
}

#[test]
#[ignore = "takes half an hour; part of cargo verify --nightly"]
fn a_day_of_portraits_with_faults_finds_nothing_and_needs_no_more_memory() {
    let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse::<f64>().ok());
    let hours = number(HOURS_VARIABLE).unwrap_or(HOURS);
    let seed = number(SEED_VARIABLE).unwrap_or(1.0) as u64;
    let pages = soak(seed, hours);
    let (first, most) = (pages.first().copied(), pages.iter().copied().max());
    let growth = most.unwrap_or(0) - first.unwrap_or(0);
    println!("{growth} pages more than after the first hour");
    assert!(growth <= GROWTH_MAX_PAGES, "{pages:?}");
}
