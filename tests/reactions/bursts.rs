//! Bursts of faults of every kind, by seed: once all faults have ended, the operator can draw again.
//!
//! A seed decides whether the clocks run, what the robot does when it begins, which faults come when, what the operator
//! presses meanwhile, and when all faults end. `ETHERPEN_BURSTS=FIRST..LAST` runs other seeds.

use crate::liveness::{come_back, with};
use crate::robot::{Robot, path};
use etherpen::application::Mode;
use etherpen::ethercat::diagnostics::ServiceRequest;
use etherpen::ethercat::state::AlState as Wanted;
use etherpen::messages::Command;
use host_tools::cell::{AlState, Fault, MailFault, MailStep, Product, ResolverFault, SiiFault};
use host_tools::random::XorshiftStar;
use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Seeds that are always tried.
const SEEDS: std::ops::Range<u64> = 0..12;
/// Longest time from the first to the last fault of a burst, ms.
const BURST_MAX_MS: u64 = 2_000;
/// Longest duration of a fault that ends by itself, ms.
const LASTS_MAX_MS: u64 = 1_500;
/// Time in which everything that ends by itself has ended, ms.
const QUIET_MS: u32 = 1_600;
/// Most acknowledgements needed once all faults have ended; each fault that waits for the next request of its kind may
/// cost one more.
const ACKNOWLEDGEMENTS_MAX: u32 = 2;

/// Choices by chance.
pub(crate) struct Random(XorshiftStar);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(XorshiftStar::new((seed + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15)))
    }

    /// A number below a bound.
    pub(crate) fn below(&mut self, bound: u64) -> u64 {
        self.0.below(bound)
    }

    pub(crate) fn one_of<T: Copy>(&mut self, values: &[T]) -> T {
        values[self.below(values.len() as u64) as usize]
    }
}

/// An event of a burst.
#[derive(Clone, Copy, Debug)]
enum Event {
    Cell(Fault),
    /// A fault hits this many frames.
    Frames(Fault, u64),
    EmergencyStop,
    /// Someone requests a state of a slave.
    State(u8, Wanted),
    Press(Command),
}

const CODES: [u16; 5] = [0, 0x001A, 0x001B, 0x002C, 0xFFFF];

/// States that a slave may fall back to.
const LOWER: [AlState; 3] = [AlState::Init, AlState::PreOperational, AlState::SafeOperational];

fn of_frames(random: &mut Random) -> Event {
    let fault = match random.below(14) {
        0 => Fault::Drop,
        1 => Fault::Lose,
        2 => Fault::Delay(1 + random.below(4)),
        3 => Fault::Duplicate,
        4 => Fault::Truncate(random.below(60) as usize),
        5 => Fault::Overlong(random.below(40) as u16),
        6 => Fault::Index(1 + random.below(200) as u8),
        7 => Fault::Counter(random.below(5) as i16 - 2),
        8 => Fault::Type(random.below(16) as u8),
        9 => Fault::More,
        10 => Fault::Circulate,
        11 => Fault::Vlan,
        12 => Fault::Foreign,
        _ => Fault::Reflect,
    };
    Event::Frames(fault, 1 + random.below(60))
}

fn of_a_slave(random: &mut Random) -> Fault {
    let slave = 1 + random.below(4) as usize;
    let (ms, code) = (1 + random.below(LASTS_MAX_MS), random.one_of(&CODES));
    let states = [AlState::PreOperational, AlState::SafeOperational, AlState::Operational];
    match random.below(15) {
        0 => Fault::Stall(ms),
        1 => Fault::Cut(slave - 1),
        2 => Fault::Crc(slave - 1, 1 + random.below(100)),
        3 => Fault::Remove(slave),
        4 => Fault::Swap(
            slave,
            random.one_of(&[Product::Ax2000, Product::Cia402, Product::Ek1100]),
        ),
        5 | 6 => Fault::Power(slave, ms),
        7 => Fault::Fall(slave, random.one_of(&LOWER), code),
        8 => Fault::Refuse(slave, random.one_of(&states), code),
        9 => Fault::Processor(slave, ms),
        10 => {
            let kinds = [
                SiiFault::Busy,
                SiiFault::Acknowledge,
                SiiFault::Blank,
                SiiFault::Damaged,
                SiiFault::Owned,
            ];
            Fault::Sii(slave, random.one_of(&kinds))
        }
        11 => Fault::Silence(slave, ms),
        12 => {
            let faults = [
                MailFault::Abort(0x0800_0020),
                MailFault::Silent,
                MailFault::Lost,
                MailFault::Counter,
                MailFault::Flood(6),
            ];
            Fault::Mailbox(
                slave,
                MailStep::Request(1 + random.below(12) as u32),
                random.one_of(&faults),
            )
        }
        13 if random.below(2) == 0 => Fault::Resolver(slave, ResolverFault::Stuck, ms),
        13 => Fault::Mains(slave, ms),
        _ => Fault::Drive(slave, 0x2310),
    }
}

fn event(random: &mut Random) -> Event {
    match random.below(12) {
        0 | 1 => of_frames(random),
        2 => Event::EmergencyStop,
        3 => {
            let states = [
                Wanted::Init,
                Wanted::PreOperational,
                Wanted::SafeOperational,
                Wanted::Operational,
            ];
            Event::State(random.below(4) as u8, random.one_of(&states))
        }
        4 | 5 => Event::Press(random.one_of(&[
            Command::Acknowledge,
            Command::Acknowledge,
            Command::Acknowledge,
            Command::Stop,
            Command::Enable,
            Command::Disable,
            Command::Hold,
            Command::Resume,
            Command::Cancel,
            Command::Home,
        ])),
        _ => Event::Cell(of_a_slave(random)),
    }
}

fn happen(robot: &mut Robot, event: Event) {
    match event {
        Event::Cell(fault) => robot.inject(fault),
        Event::Frames(fault, count) => (0..count).for_each(|_| robot.inject(fault)),
        Event::EmergencyStop => robot.emergency_stop(true),
        Event::State(slave, state) => robot.ask(ServiceRequest::SetState { slave, state }),
        Event::Press(command) => drop(robot.send(command)),
    }
}

/// Faults that wait for the next request of their kind.
fn waits(event: &Event) -> bool {
    matches!(event, Event::Cell(Fault::Refuse(..) | Fault::Mailbox(..)))
}

/// Ends all faults: what was cut, removed, swapped or damaged is restored.
fn clear_faults(robot: &mut Robot, events: &[(u64, Event)]) {
    robot.emergency_stop(false);
    robot.inject(Fault::Join);
    for slave in 1..=4 {
        robot.inject(Fault::Insert(slave));
        robot.inject(Fault::Sii(slave, SiiFault::Whole));
    }
    let other = |event: &Event| match event {
        Event::Cell(Fault::Swap(slave, product)) if *product != Product::Ax2000 => Some(*slave),
        _ => None,
    };
    let swapped: BTreeSet<usize> = events.iter().filter_map(|(_, event)| other(event)).collect();
    for slave in swapped {
        robot.inject(Fault::Swap(slave, Product::Ax2000));
    }
}

/// Runs one burst; returns the number of acknowledgements.
fn burst(seed: u64) -> u32 {
    let mut random = Random::new(seed);
    let clocks = random.below(2) == 0;
    let start = random.below(3);
    let mut robot = with(clocks).enabled();
    match start {
        0 => {
            robot.command(Command::Disable).expect("it is at rest");
            robot.wait_for(Mode::DrivesOff);
        }
        1 => {}
        _ => robot = robot.in_a_drawing(),
    }
    let count = 1 + random.below(6);
    let mut events: Vec<(u64, Event)> = (0..count)
        .map(|_| (random.below(BURST_MAX_MS), event(&mut random)))
        .collect();
    events.sort_by_key(|(at_ms, _)| *at_ms);
    let healed_ms = random.below(3_000);
    println!("seed {seed}: clocks {clocks}, start {start}, {events:?}, healed {healed_ms} ms after the last");
    let mut now_ms = 0;
    for (at_ms, event) in &events {
        robot.run((at_ms - now_ms) as u32);
        now_ms = *at_ms;
        happen(&mut robot, *event);
    }
    robot.run(healed_ms as u32);
    clear_faults(&mut robot, &events);
    robot.run(QUIET_MS);
    if matches!(robot.mode(), Mode::Drawing | Mode::Moving | Mode::Holding) {
        robot.send(Command::Cancel);
        robot.run_until("it is cancelled", |robot| {
            matches!(robot.mode(), Mode::Idle | Mode::Fault)
        });
    }
    let waiting = events.iter().filter(|(_, event)| waits(event)).count() as u32;
    let tries = come_back(&mut robot, ACKNOWLEDGEMENTS_MAX + waiting);
    println!("seed {seed}: {tries} acknowledgements, {} vertices drawn", path().len());
    tries
}

fn seeds() -> std::ops::Range<u64> {
    let asked = std::env::var("ETHERPEN_BURSTS").ok();
    let range = asked.as_deref().and_then(|range| range.split_once(".."));
    let parsed = range.and_then(|(first, last)| Some(first.parse().ok()?..last.parse().ok()?));
    parsed.unwrap_or(SEEDS)
}

#[test]
fn after_bursts_of_faults_of_every_kind_the_robot_draws_again() {
    let seeds = seeds();
    let mut failed = Vec::new();
    let mut most = 0;
    for seed in seeds.clone() {
        match catch_unwind(AssertUnwindSafe(|| burst(seed))) {
            Ok(tries) => most = most.max(tries),
            Err(_) => failed.push(seed),
        }
    }
    println!("seeds {seeds:?}: at most {most} acknowledgements, failed {failed:?}");
    assert!(failed.is_empty(), "seeds {failed:?}");
}
