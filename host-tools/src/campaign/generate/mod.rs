//! Makes episodes from seeds: `setup` chooses the machine, `mechanism` its dimensions, gears and encoders, `orders` what the
//! operator wants, `seldom` what hardly ever happens by itself, `mishaps` what befalls the program's own jobs and their log.
//!
//! A seed and a profile always give the same episode. Lengths, speeds and times are spread over scales, not over ranges,
//! so that small values are as likely as large ones.

mod mechanism;
mod mishaps;
mod orders;
mod seldom;
mod setup;
mod switches;
#[cfg(test)]
mod tests;

use super::chance::Chance;
use super::episode::{Episode, Event, Figure, FileUse, What};
use super::machine::Machine;
use super::{figures, trouble};
use clap::ValueEnum;
use etherpen::messages::Command;
use orders::{command, wish};

/// Which faults an episode may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Profile {
    /// Everything below, several at once.
    All,
    /// No faults: random drawings and commands on a sound machine.
    Quiet,
    /// Frames, cables, power and slaves of the bus.
    Bus,
    /// Drives and their position feedback.
    Drives,
    /// The serial line and the operator's program.
    Link,
    /// Inputs, clock and processor of the board.
    Board,
    /// Commands at any time, several in one millisecond.
    Operator,
    /// Terminals behind the drives, and outputs that are lost on their way.
    Terminals,
    /// Drives at each other's places, told apart by their serial numbers, and outputs that are lost on their way.
    Cables,
    /// The program that draws, its computer and its log of jobs.
    Files,
}

/// Longest time of an episode before everything is healed, ms.
const DURATION_MAX_MS: f64 = 25_000.0;
/// Most events of an episode.
const EVENTS_MAX: u64 = 14;
/// One command beside the session in so many brings others with it, at most this many.
const CROWD_ONE_IN: u64 = 6;
const CROWD_MAX: u64 = 60;
/// Time in which a new connection is made, ms.
const RECONNECTING_MS: u64 = 60;
/// Gives the commands that follow an event random numbers of their own.
const CROWD_SEED: u64 = 0x0C20_3D00_0000;

/// The episode of a seed on a machine.
#[must_use]
pub fn episode(machine: &Machine, seed: u64, profile: Profile) -> Episode {
    let mut chance = Chance::new(seed ^ 0x5EED_0000_0000_0000);
    let duration_ms = chance.scaled(3_000.0, DURATION_MAX_MS) as u32;
    let figures: Vec<Figure> = (0..1 + chance.below(3))
        .map(|_| figures::figure(&mut chance, machine))
        .collect();
    let wishes = (0..1 + chance.below(6))
        .map(|_| wish(&mut chance, machine, figures.len()))
        .collect();
    let mut episode = Episode {
        found: String::new(),
        machine: machine.name.clone(),
        seed: chance.below(1 << 40),
        duration_ms,
        patience_ms: chance.scaled(10.0, 1_000.0) as u32,
        draws: true,
        by_jobs: profile == Profile::Files,
        wishes,
        figures,
        config: setup::configuration(&mut chance, machine),
        events: Vec::new(),
    };
    if profile == Profile::Files {
        mishaps::befall(&mut episode, &machine.config.motion, seed);
        setup::keep_valid(&mut episode);
        mechanism::vary(&mut episode, seed);
        mechanism::change_encoders(&mut episode, seed);
        return episode;
    }
    setup::vary(&mut episode, machine, seed, &mut chance);
    mechanism::vary(&mut episode, seed);
    switches::add(&mut episode, seed);
    seldom::handle(&mut episode, seed);
    match profile {
        Profile::Terminals if machine.chain.terminals.is_empty() => setup::with_terminals(&mut episode, machine),
        Profile::Cables => setup::with_serial_numbers(&mut episode, machine),
        _ => {}
    }
    if profile != Profile::Quiet {
        let mut crowds = Chance::new(seed ^ CROWD_SEED);
        episode.events = events(&mut chance, &mut crowds, machine, profile, duration_ms);
        episode
            .events
            .extend(seldom::events(machine, seed, profile, duration_ms));
        seldom::lone(&mut episode, machine, seed, profile);
        episode.events.sort_by_key(|event| event.at_ms);
    }
    mechanism::change_encoders(&mut episode, seed);
    // Last: quick stops become weaker before.
    switches::make_room_behind(&mut episode);
    episode
}

/// Events at random times, now and then several in one burst.
///
/// `crowds` has the chances of the commands that follow an event, so that they change no other one.
fn events(
    chance: &mut Chance,
    crowds: &mut Chance,
    machine: &Machine,
    profile: Profile,
    duration_ms: u32,
) -> Vec<Event> {
    // Faults of one kind of frames can be counted exactly.
    let only = (profile == Profile::Bus && chance.one_in(6)).then(|| trouble::of_frames(chance));
    let mut events = Vec::new();
    let mut at_ms = 0;
    for _ in 0..chance.below(EVENTS_MAX) {
        let in_a_burst = chance.one_in(3);
        at_ms = match in_a_burst {
            true => at_ms + chance.one_of(&[0, 0, 1, 4]),
            false => chance.below(duration_ms.into()) as u32,
        };
        let what = match &only {
            Some(words) => What::Frames(words.clone(), chance.scaled(1.0, 80.0) as u32),
            None => what(chance, machine, profile),
        };
        if let What::Fault(words) = &what
            && let Some(end) = trouble::end_of(chance, words)
        {
            let at_ms = at_ms.saturating_add(chance.milliseconds(3_000)).min(duration_ms);
            events.push(Event {
                at_ms,
                what: What::Fault(end),
            });
        }
        let at_ms = at_ms.min(duration_ms);
        let followers = followers(crowds, machine, &what);
        events.push(Event { at_ms, what });
        events.extend(followers.into_iter().map(|(later_ms, command)| Event {
            at_ms: at_ms + later_ms,
            what: What::Beside(command),
        }));
    }
    events.sort_by_key(|event| event.at_ms);
    events
}

/// Commands beside the session that may follow an event, each with its time after it, ms: as many as the line takes for some
/// ten milliseconds with a stop behind them, orders that pile up while the trajectory waits and a stop among them, or a stop
/// while a new connection is being made.
fn followers(chance: &mut Chance, machine: &Machine, what: &What) -> Vec<(u32, Command)> {
    match what {
        What::Beside(_) if chance.one_in(CROWD_ONE_IN) => {
            let mut crowd: Vec<_> = (0..chance.below(CROWD_MAX))
                .map(|_| (0, command(chance, machine)))
                .collect();
            crowd.push((0, Command::Stop));
            crowd
        }
        What::TrajectoryWaits(ms) if chance.one_in(2) => {
            let mut then = |_| chance.below(u64::from(*ms) + 1) as u32;
            let stop = (then(0), Command::Stop);
            let moments: Vec<u32> = (0..CROWD_MAX).map(&mut then).collect();
            let orders = moments.into_iter().map(|later_ms| {
                // Each of them is an order for the trajectory, in every mode.
                let percent = 10 + chance.below(191) as u8;
                (later_ms, Command::Override { percent })
            });
            orders.chain([stop]).collect()
        }
        What::Reconnect if chance.one_in(2) => vec![(chance.below(RECONNECTING_MS) as u32, Command::Stop)],
        _ => Vec::new(),
    }
}

/// One event.
pub(super) fn what(chance: &mut Chance, machine: &Machine, profile: Profile) -> What {
    let chain = &machine.chain;
    let profile = match profile {
        Profile::All | Profile::Quiet => chance.one_of(&[
            Profile::Bus,
            Profile::Bus,
            Profile::Drives,
            Profile::Drives,
            Profile::Link,
            Profile::Board,
            Profile::Operator,
        ]),
        one => one,
    };
    match profile {
        Profile::Bus if chance.one_in(3) => What::Frames(trouble::of_frames(chance), chance.scaled(1.0, 80.0) as u32),
        Profile::Bus if chance.one_in(10) => {
            What::State(chance.below(chain.slaves as u64) as u8, chance.one_of(&[1, 2, 3, 4, 8]))
        }
        Profile::Bus if chance.one_in(20) => {
            let [bootstrap, writes, closes] = [(); 3].map(|()| chance.one_in(2));
            let file = FileUse {
                bootstrap,
                writes,
                closes,
            };
            What::File(chance.below(chain.slaves as u64) as u8, file)
        }
        Profile::Bus => What::Fault(trouble::of_the_bus(chance, chain)),
        Profile::Drives => What::Fault(trouble::of_a_drive(chance, chain)),
        Profile::Terminals if chance.one_in(4) => What::Fault(trouble::of_the_bus(chance, chain)),
        Profile::Terminals => What::Fault(trouble::of_a_terminal(chance, chain)),
        Profile::Cables => What::Fault(trouble::of_exchanged_cables(chance, chain)),
        Profile::Link => match chance.below(4) {
            0 => What::Reconnect,
            1 => What::Unplug(chance.milliseconds(4_000)),
            _ => What::Noise(chance.milliseconds(4_000), chance.scaled(1.0, 300.0) as u32),
        },
        Profile::Board => match chance.below(6) {
            0 => What::SubstituteClock(chance.milliseconds(2_000)),
            1 => What::TrajectoryWaits(chance.milliseconds(90)),
            2 => What::PortDown(chance.milliseconds(2_000)),
            _ => What::StopInput(chance.milliseconds(2_000)),
        },
        // The events of `Files` are mishaps; `All` and `Quiet` were replaced above.
        Profile::Operator | Profile::Files | Profile::All | Profile::Quiet if chance.one_in(2) => {
            What::Beside(command(chance, machine))
        }
        Profile::Operator | Profile::Files | Profile::All | Profile::Quiet => What::Command(command(chance, machine)),
    }
}
