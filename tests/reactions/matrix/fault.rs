//! The rows of the matrix: faults, how they begin and end.

use crate::robot::{Overrun, Robot};
use etherpen::board::PortState;
use etherpen::config::AxisMode;
use etherpen::messages::Command;
use host_tools::cell::{Fault, Product, ResolverFault};

/// What a robot has besides its four drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Machine {
    /// Nothing.
    Usual,
    /// An alias in each drive that tells it from the others.
    Aliases,
    /// Behind the drives a coupler, a terminal with an emergency stop, and one with an output that nothing needs.
    Terminals,
}

/// Places of the terminals, from 1.
pub(super) const STOP_TERMINAL: usize = 6;
pub(super) const OUTPUT_TERMINAL: usize = 7;
/// The contacts of the terminal with the emergency stop: closed.
pub(super) const CLOSED: u8 = 1;

/// A fault of the matrix.
pub(super) struct Trouble {
    pub(super) name: &'static str,
    /// The drives that it hits, from 1; empty for faults of the bus, the board or the operator's line.
    pub(super) hits: &'static [usize],
    pub(super) machine: Machine,
    /// How long it lasts, ms.
    pub(super) lasts_ms: u32,
    pub(super) begin: fn(&mut Robot),
    pub(super) end: fn(&mut Robot),
}

impl Trouble {
    /// This fault as one that hits these drives.
    const fn of_drives(mut self, hits: &'static [usize]) -> Self {
        self.hits = hits;
        self
    }

    /// This fault in a robot of this kind.
    const fn of_machine(mut self, machine: Machine) -> Self {
        self.machine = machine;
        self
    }
}

/// Drive of the second axis, from 1.
const DRIVE: usize = 2;
const THIRD: usize = 3;
/// Longest duration of a fault of the feedback, ms: it is ended by hand.
const LONG_MS: u64 = 1_000_000;
/// What is lost by a slip, percent of what stays.
const HALF: i64 = 50;
/// A jump of the feedback of 0.02 rad, and noise of 0.004 rad, increments.
const JUMP: i32 = 40_000;
const NOISE: u32 = 8_000;

fn nothing(_: &mut Robot) {}

fn true_again(robot: &mut Robot) {
    for drive in [DRIVE, THIRD] {
        robot.inject(Fault::Resolver(drive, ResolverFault::Stuck, 0));
    }
    robot.inject(Fault::Exchange(DRIVE, THIRD, 0));
}

const fn of_feedback(name: &'static str, begin: fn(&mut Robot)) -> Trouble {
    Trouble {
        name,
        hits: &[DRIVE],
        machine: Machine::Usual,
        lasts_ms: 3_500,
        begin,
        end: true_again,
    }
}

/// Ends by itself.
const fn by_itself(name: &'static str, begin: fn(&mut Robot)) -> Trouble {
    Trouble {
        name,
        hits: &[],
        machine: Machine::Usual,
        lasts_ms: 0,
        begin,
        end: nothing,
    }
}

const fn for_a_second(name: &'static str, begin: fn(&mut Robot), end: fn(&mut Robot)) -> Trouble {
    Trouble {
        name,
        hits: &[],
        machine: Machine::Usual,
        lasts_ms: 1_000,
        begin,
        end,
    }
}

fn frozen(robot: &mut Robot) {
    robot.inject(Fault::Resolver(DRIVE, ResolverFault::Stuck, LONG_MS));
}

/// The robot's drives, and another product: an AX2000 has no position mode.
fn products(robot: &Robot) -> (Product, Product) {
    match robot.config().axes[DRIVE - 1].mode {
        AxisMode::Position => (Product::Cia402, Product::Ax2000),
        AxisMode::Velocity | AxisMode::Torque => (Product::Ax2000, Product::Cia402),
    }
}

fn unplugged(robot: &mut Robot) {
    robot.plugged = false;
}

/// The rows.
pub(super) static FAULTS: [Trouble; 34] = [
    by_itself("one frame is lost", |robot| robot.inject(Fault::Lose)),
    by_itself("no frames for 20 ms", |robot| robot.inject(Fault::Stall(20))),
    by_itself("no frames for 500 ms", |robot| robot.inject(Fault::Stall(500))),
    by_itself("50 frames damaged by a cable", |robot| robot.inject(Fault::Crc(1, 50))),
    for_a_second(
        "a cable is pulled and joined",
        |robot| robot.inject(Fault::Cut(DRIVE)),
        |robot| robot.inject(Fault::Join),
    ),
    by_itself("a drive without control supply for 300 ms", |robot| {
        robot.inject(Fault::Power(DRIVE, 300));
    })
    .of_drives(&[DRIVE]),
    for_a_second(
        "a drive is taken out and put back",
        |robot| robot.inject(Fault::Remove(DRIVE)),
        |robot| robot.inject(Fault::Insert(DRIVE)),
    )
    .of_drives(&[DRIVE]),
    for_a_second(
        "another product in a drive's place",
        |robot| robot.inject(Fault::Swap(DRIVE, products(robot).1)),
        |robot| robot.inject(Fault::Swap(DRIVE, products(robot).0)),
    )
    .of_drives(&[DRIVE]),
    by_itself("a drive replaced by another of its kind", |robot| {
        robot.inject(Fault::Swap(DRIVE, products(robot).0));
    })
    .of_drives(&[DRIVE]),
    for_a_second(
        "two drives at each other's places, without losing power",
        |robot| robot.inject(Fault::Recable(DRIVE, THIRD)),
        |robot| robot.inject(Fault::Recable(DRIVE, THIRD)),
    )
    .of_drives(&[DRIVE, THIRD]),
    for_a_second(
        "two drives with aliases, off for 200 ms, back at each other's places",
        |robot| {
            robot.inject(Fault::Power(DRIVE, 200));
            robot.inject(Fault::Power(THIRD, 200));
            robot.inject(Fault::Recable(DRIVE, THIRD));
        },
        |robot| robot.inject(Fault::Recable(DRIVE, THIRD)),
    )
    .of_drives(&[DRIVE, THIRD])
    .of_machine(Machine::Aliases),
    for_a_second(
        "the emergency stop of a terminal opens",
        |robot| robot.set_inputs(STOP_TERMINAL, 0),
        |robot| robot.set_inputs(STOP_TERMINAL, CLOSED),
    )
    .of_machine(Machine::Terminals),
    by_itself("a terminal with an emergency stop without supply for 300 ms", |robot| {
        robot.inject(Fault::Power(STOP_TERMINAL, 300));
    })
    .of_machine(Machine::Terminals),
    by_itself("a terminal that nothing needs without supply for 300 ms", |robot| {
        robot.inject(Fault::Power(OUTPUT_TERMINAL, 300));
    })
    .of_machine(Machine::Terminals),
    by_itself("a terminal that nothing needs falls back to SAFEOP", |robot| {
        robot.inject(Fault::Retreat(OUTPUT_TERMINAL, 0x001B));
    })
    .of_machine(Machine::Terminals),
    by_itself("a drive falls back to SAFEOP", |robot| {
        robot.inject(Fault::Retreat(DRIVE, 0x001B));
    })
    .of_drives(&[DRIVE]),
    by_itself("a drive's processor stands still for 900 ms", |robot| {
        robot.inject(Fault::Processor(DRIVE, 900));
    })
    .of_drives(&[DRIVE]),
    by_itself("no outputs reach the drives for 500 ms", |robot| {
        robot.inject(Fault::Mute(500))
    }),
    by_itself("a drive takes no outputs for 500 ms", |robot| {
        robot.inject(Fault::Deaf(DRIVE, 500));
    })
    .of_drives(&[DRIVE]),
    by_itself("a drive faults", |robot| robot.inject(Fault::Drive(DRIVE, 0x2310))).of_drives(&[DRIVE]),
    by_itself("a drive without mains for 500 ms", |robot| {
        robot.inject(Fault::Mains(DRIVE, 500));
    })
    .of_drives(&[DRIVE]),
    of_feedback("feedback frozen", frozen),
    of_feedback("feedback slips, half of the motion lost", |robot| {
        robot.inject(Fault::Resolver(DRIVE, ResolverFault::Slip(HALF), LONG_MS));
    }),
    of_feedback("feedback jumps by 0.02 rad", |robot| {
        robot.inject(Fault::Jump(DRIVE, JUMP));
    }),
    of_feedback("feedback reversed", |robot| {
        robot.inject(Fault::Resolver(DRIVE, ResolverFault::Reversed, LONG_MS));
    }),
    of_feedback("feedback exchanged with another axis's", |robot| {
        robot.inject(Fault::Exchange(DRIVE, THIRD, LONG_MS));
    })
    .of_drives(&[DRIVE, THIRD]),
    of_feedback("feedback noisy, 0.004 rad at most", |robot| {
        robot.inject(Fault::Resolver(DRIVE, ResolverFault::Noise(NOISE), LONG_MS));
    }),
    for_a_second(
        "the emergency-stop input opens",
        |robot| robot.emergency_stop(true),
        |robot| robot.emergency_stop(false),
    ),
    for_a_second(
        "the board's Ethernet port has no link",
        |robot| robot.port(PortState::Down),
        |robot| robot.port(PortState::Up),
    ),
    for_a_second(
        "the board runs on its substitute clock",
        |robot| robot.surround(|around| around.substitute_clock = true),
        |robot| robot.surround(|around| around.substitute_clock = false),
    ),
    Trouble {
        name: "the trajectory task does not run for 20 ms",
        hits: &[],
        machine: Machine::Usual,
        lasts_ms: 20,
        begin: |robot| robot.surround(|around| around.trajectory_waits = true),
        end: |robot| robot.surround(|around| around.trajectory_waits = false),
    },
    for_a_second("the operator's cable is pulled", unplugged, |robot| {
        robot.plugged = true;
    }),
    for_a_second(
        "the operator's line loses bytes",
        |robot| {
            robot.overrun = Some(Overrun { bytes: 3, period_ms: 7 });
        },
        |robot| robot.overrun = None,
    ),
    by_itself("STOP", |robot| robot.say(Command::Stop)),
];
