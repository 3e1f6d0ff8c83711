//! Exhaustive search through the operating modes.
//!
//! The search is breadth first from the start, with all commands, any number of them in one millisecond, and with
//! everything that the bus, the drives, the trajectory and the host may do meanwhile, until no new state is found.
//! Times are distinguished only where the state machine does so: a state holds which of its thresholds each timer has
//! passed, and time advances by a millisecond or up to the next threshold. This loses nothing, because at most one of
//! the long timers runs at a time (asserted).
//!
//! From each state found, the world is then free of faults and the operator acts sensibly, without a stop: the robot
//! has to reach [`Idle`](super::Mode::Idle).

extern crate std;

mod graph;
mod inputs;
mod trajectory;
mod world;

use std::boxed::Box;
use std::collections::{HashMap, HashSet, VecDeque};
use std::println;
use std::sync::LazyLock;
use std::vec::Vec;
use world::{Move, State};

/// Longest time from any state to Idle in a world without faults, ms of virtual time.
const WAY_MAX_MS: u32 = 15_000;
/// Most commands that the operator gives in this time.
const COMMANDS_MAX: u32 = 6;

/// Result of the search.
struct Found {
    states: Vec<State>,
    transitions: usize,
    modes: HashMap<std::string::String, usize>,
    changes: graph::Changes,
}

/// One search serves all tests.
static FOUND: LazyLock<Found> = LazyLock::new(search);

/// Finds all states and checks all their transitions.
fn search() -> Found {
    let (mut seen, mut open) = (HashSet::new(), VecDeque::new());
    let mut found = Found {
        states: Vec::new(),
        transitions: 0,
        modes: HashMap::new(),
        changes: graph::Changes::new(),
    };
    let first = State::new();
    seen.insert(first.key());
    open.push_back(first);
    while let Some(state) = open.pop_front() {
        for step in Move::all(&state) {
            let mut after = state.clone();
            after.make(step);
            after.check(&state, step);
            found.transitions += 1;
            let (was, is) = (&state.application, &after.application);
            if was.mode != is.mode {
                let events = found.changes.entry((was.mode.number(), is.mode.number())).or_default();
                events.insert(graph::Event::of(was, step, is));
            }
            if seen.insert(after.key()) {
                open.push_back(after);
            }
        }
        *found
            .modes
            .entry(std::format!("{:?}", state.application.mode))
            .or_default() += 1;
        found.states.push(state);
    }
    found
}

/// Time, ms, and commands from a state to Idle; the state that repeats if Idle is not reached.
fn way_to_idle(from: &State, known: &mut HashMap<world::Key, (u32, u32)>) -> Result<(u32, u32), Box<State>> {
    let mut state = from.clone();
    state.heal();
    let mut way: Vec<(world::Key, u32, u32)> = Vec::new();
    let (mut waited_ms, mut commands) = (0, 0);
    let rest = loop {
        let key = state.key();
        if let Some(rest) = known.get(&key) {
            break *rest;
        }
        if state.is_idle() {
            break (0, 0);
        }
        if way.iter().any(|(before, ..)| *before == key) {
            return Err(Box::new(state));
        }
        way.push((key, waited_ms, commands));
        let (ms, given) = state.operate_sensibly();
        (waited_ms, commands) = (waited_ms + ms, commands + given);
    };
    let total = (waited_ms + rest.0, commands + rest.1);
    for (key, at_ms, given) in way {
        known.insert(key, (total.0 - at_ms, total.1 - given));
    }
    Ok(total)
}

#[test]
fn every_state_leads_back_to_idle_and_no_refused_command_has_an_effect() {
    let found = &*FOUND;
    println!("{} states, {} transitions", found.states.len(), found.transitions);
    println!("{:?}", found.modes);
    assert_eq!(found.modes.len(), 11, "every mode is reached");
    let mut known = HashMap::new();
    let (mut longest_ms, mut most_commands) = (0, 0);
    for state in &found.states {
        match way_to_idle(state, &mut known) {
            Ok((ms, commands)) => (longest_ms, most_commands) = (longest_ms.max(ms), most_commands.max(commands)),
            Err(end) => panic!("no way from\n{state:?}\nit ends in\n{end:?}\n"),
        }
    }
    println!("to Idle at most {longest_ms} ms and {most_commands} commands");
    assert!(longest_ms <= WAY_MAX_MS && most_commands <= COMMANDS_MAX);
}
