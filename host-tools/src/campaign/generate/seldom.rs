//! What plain chance would hardly ever try, each with random numbers of its own.

use super::super::chance::Chance;
use super::super::episode::{Episode, Event, What, Wish};
use super::super::machine::Machine;
use super::orders::velocity;
use super::{CROWD_MAX, Profile, setup};
use etherpen::messages::Command;
use etherpen::motion::Pen;

/// Gives jogs with the pen down random numbers of their own.
const HANDLING_SEED: u64 = 0x0A4D_1160_0000;
/// Gives stops before the greeting random numbers of their own.
const GREETING_SEED: u64 = 0x06EE_7160_0000;
/// Latest stop before the greeting, ms.
pub(super) const STOPPED_MAX_MS: u32 = 300;
/// Gives standstills of processors random numbers of their own.
const PROCESSOR_SEED: u64 = 0x0F0C_E550_0000;
/// Gives encoders that slip without power random numbers of their own.
const BRAKES_SEED: u64 = 0x0B4A_CE50_0000;
/// Gives faults that come alone random numbers of their own.
const LONE_SEED: u64 = 0x010A_EF00_0000;
/// Gives drives that refuse the choice of their process data random numbers of their own.
const CHOICE_SEED: u64 = 0x0C40_1CE0_0000;
/// Longest absence of a drive that comes alone, and most replies in a row that are lost, ms and frames.
const ABSENT_MAX_MS: f64 = 3_000.0;
const LOST_MAX: f64 = 4_000.0;

/// The only events of an episode, now and then: what other faults would hide. A drive without supply for longer than its
/// position may be missing; a long stop of which the controller sees nothing; more orders than there is room for while the
/// trajectory waits, and a stop behind them.
pub(super) fn lone(episode: &mut Episode, machine: &Machine, seed: u64, profile: Profile) {
    let mut chance = Chance::new(seed ^ LONE_SEED);
    if !matches!(profile, Profile::Bus | Profile::Board | Profile::All) || !chance.one_in(8) {
        return;
    }
    let at_ms = chance.below(episode.duration_ms.into()) as u32;
    let slave = chance.one_of(&machine.chain.drives);
    let kind = match profile {
        Profile::Bus => chance.below(2),
        Profile::Board => 2,
        _ => chance.below(3),
    };
    let event = |what: What| vec![Event { at_ms, what }];
    episode.events = match kind {
        0 => event(What::Fault(format!(
            "power {slave} {}",
            chance.scaled(300.0, ABSENT_MAX_MS) as u32
        ))),
        1 => {
            setup::with_gentle_stops(episode, machine, &mut chance);
            stop_without_replies(&mut chance, at_ms)
        }
        _ => orders_without_room(&mut chance, at_ms),
    };
}

/// Lost replies: the drives hear their orders and the controller hears nothing. A quick stop may have begun shortly before.
fn stop_without_replies(chance: &mut Chance, at_ms: u32) -> Vec<Event> {
    let lost = What::Frames("lose".to_owned(), chance.scaled(50.0, LOST_MAX) as u32);
    let later_ms = chance.scaled(1.0, 100.0) as u32;
    let mut events = vec![Event {
        at_ms: at_ms + later_ms,
        what: lost,
    }];
    if chance.one_in(2) {
        events.push(Event {
            at_ms,
            what: What::StopInput(500),
        });
    }
    events
}

/// Orders for a trajectory that waits, and a stop behind them.
fn orders_without_room(chance: &mut Chance, at_ms: u32) -> Vec<Event> {
    let waits = What::TrajectoryWaits(chance.below(30) as u32 + 60);
    let orders = (0..CROWD_MAX).map(|_| {
        let percent = 10 + chance.below(191) as u8;
        What::Beside(Command::Override { percent })
    });
    let events = [waits].into_iter().chain(orders).map(|what| Event { at_ms, what });
    let mut events: Vec<Event> = events.collect();
    events.push(Event {
        at_ms: at_ms + 40,
        what: What::Beside(Command::Stop),
    });
    events
}

/// Lets somebody handle the pen now and then: among the other wishes, or instead of them.
pub(super) fn handle(episode: &mut Episode, seed: u64) {
    let mut handling = Chance::new(seed ^ HANDLING_SEED);
    if !handling.one_in(5) {
        return;
    }
    let [lower, jog, draw] = with_the_pen_down(&mut handling, episode.figures.len());
    let place = handling.below(episode.wishes.len() as u64 + 1) as usize;
    match handling.one_in(2) {
        // Somebody who only tries the pen.
        true => episode.wishes = vec![lower, jog],
        false => _ = episode.wishes.splice(place..place, [lower, jog, draw]),
    }
}

/// Seldom events of a profile.
pub(super) fn events(machine: &Machine, seed: u64, profile: Profile, duration_ms: u32) -> Vec<Event> {
    let mut events = Vec::new();
    let mut noise = Chance::new(seed ^ GREETING_SEED);
    if matches!(profile, Profile::Link | Profile::All) && noise.one_in(8) {
        events.extend(stops_before_the_greeting(&mut noise));
    }
    let mut processors = Chance::new(seed ^ PROCESSOR_SEED);
    if matches!(profile, Profile::Bus | Profile::All) && processors.one_in(4) {
        events.push(standstill(&mut processors, machine, duration_ms));
    }
    let mut brakes = Chance::new(seed ^ BRAKES_SEED);
    if matches!(profile, Profile::Drives | Profile::All) && brakes.one_in(6) {
        events.extend(jump_without_power(&mut brakes, machine, duration_ms));
    }
    let mut choices = Chance::new(seed ^ CHOICE_SEED);
    if matches!(profile, Profile::Bus | Profile::All) && choices.one_in(8) {
        events.extend(refused_choice(&mut choices, machine, duration_ms));
    }
    events
}

/// A drive that refuses a request when it is set up again, as it may refuse the choice of its process data, and a drive that
/// is set up behind it, often another one.
fn refused_choice(chance: &mut Chance, machine: &Machine, duration_ms: u32) -> [Event; 3] {
    let first = chance.one_of(&machine.chain.drives);
    let other = chance.one_of(&machine.chain.drives);
    let at_ms = chance.below(duration_ms.into()) as u32;
    let later_ms = chance.scaled(500.0, 6_000.0) as u32;
    let request = 1 + chance.below(12);
    [
        (at_ms, format!("power {first} 50")),
        (at_ms + 1, format!("mailbox {first} {request} abort 0x06010002")),
        (at_ms + later_ms, format!("power {other} 50")),
    ]
    .map(|(at_ms, words)| Event {
        at_ms,
        what: What::Fault(words),
    })
}

/// Lowers the pen, jogs upwards and draws.
fn with_the_pen_down(chance: &mut Chance, figures: usize) -> [Wish; 3] {
    let lower = Command::Pen { pen: Pen::Down };
    let mut velocity_mm_s = velocity(chance);
    velocity_mm_s[2] = chance.scaled(1.0, 200.0) as f32;
    let jog = Wish::Jog(velocity_mm_s, chance.milliseconds(1_500));
    let draw = Wish::Draw(chance.below(figures as u64) as usize);
    [Wish::AtOnce(vec![lower]), jog, draw]
}

/// A line with noise on which the first greeting may be lost, while somebody presses the stop a few times.
fn stops_before_the_greeting(chance: &mut Chance) -> Vec<Event> {
    let lasts_ms = chance.scaled(20.0, 1_500.0) as u32;
    let noise = What::Noise(lasts_ms, chance.scaled(5.0, 100.0) as u32);
    let mut events = vec![Event { at_ms: 0, what: noise }];
    events.extend((0..1 + chance.below(3)).map(|_| Event {
        at_ms: chance.below(lasts_ms.min(STOPPED_MAX_MS).into()) as u32,
        what: What::Beside(Command::Stop),
    }));
    events
}

/// A drive's processor that stands still, for about as long as its watchdog takes or for longer than the report of it does.
fn standstill(chance: &mut Chance, machine: &Machine, duration_ms: u32) -> Event {
    let slave = chance.one_of(&machine.chain.drives);
    let lasts_ms = chance.scaled(60.0, 3_000.0) as u32;
    Event {
        at_ms: chance.below(duration_ms.into()) as u32,
        what: What::Fault(format!("pdi {slave} {lasts_ms}")),
    }
}

/// An encoder that slips on its shaft some time after the drives are switched off or stopped: the brakes close hard.
fn jump_without_power(chance: &mut Chance, machine: &Machine, duration_ms: u32) -> [Event; 2] {
    let at_ms = chance.below(duration_ms.into()) as u32;
    let later_ms = chance.scaled(150.0, 1_500.0) as u32;
    let off = chance.one_of(&[Command::Disable, Command::Stop, Command::Stop]);
    let slave = chance.one_of(&machine.chain.drives);
    let increments = chance.scaled(1_000.0, 200_000.0) as i64 * chance.one_of(&[-1, 1]);
    [
        (at_ms, What::Beside(off)),
        (at_ms + later_ms, What::Fault(format!("jump {slave} {increments}"))),
    ]
    .map(|(at_ms, what)| Event { at_ms, what })
}
