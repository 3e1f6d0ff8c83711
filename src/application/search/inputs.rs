//! What may come from outside in the search: commands, the supervisor's news, changes of a millisecond's report.

use super::super::*;
use crate::motion::Pen;
use crate::robots::Position;

pub(super) const BLIND: Fault = Fault::Blind {
    blind_ms: 6,
    limit_ms: 5,
};
pub(super) const DRIVE: Fault = Fault::Drive {
    axis: 2,
    status_word: 8,
};
const LEFT: Fault = Fault::SlaveState {
    slave: 1,
    al_state: 0x14,
    al_code: 0x1B,
};
const UNEXPECTED: Fault = Fault::UnexpectedBus { found: 3, expected: 4 };
const PLACE: Position = Position {
    x_mm: 0.0,
    y_mm: 0.0,
    z_mm: -840.0,
};

/// Commands, those of which the operands decide twice.
pub(super) const COMMANDS: [Command; 18] = [
    Command::Home,
    Command::HomeAt {
        pose: JointAngles([0.0; 4]),
        position: None,
    },
    Command::Enable,
    Command::Disable,
    Command::Jog {
        velocity_mm_s: [10.0, 0.0, 0.0],
    },
    Command::Jog {
        velocity_mm_s: [0.0; 3],
    },
    Command::Jog {
        velocity_mm_s: [f32::NAN, 0.0, 0.0],
    },
    Command::Move { position: PLACE },
    Command::Draw { job: 1 },
    Command::Hold,
    Command::Resume,
    Command::Cancel,
    Command::Override { percent: 100 },
    Command::Override { percent: 9 },
    Command::Pen { pen: Pen::Up },
    Command::Pen { pen: Pen::Down },
    Command::Stop,
    Command::Acknowledge,
];

/// What the bus's supervisor may say by itself, and when it was asked for something.
pub(super) const NEWS: [BusCondition; 3] = [
    BusCondition::Failed(Fault::SlaveLost { slave: 1 }),
    BusCondition::Failed(LEFT),
    BusCondition::Refused(Fault::NoLink {
        port: crate::board::PortState::Down,
    }),
];
pub(super) const ANSWERS: [BusCondition; 2] = [BusCondition::Operational, BusCondition::Refused(UNEXPECTED)];

/// A deviation of a millisecond's report from the one before, or of what else is told with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    Nothing,
    Powered(bool),
    Standstill,
    Silence,
    DriveFault,
    Referenced(bool),
    Interlock,
    Fault,
    HostSilent,
    Stalled,
}

pub(super) const CHANGES: [Change; 12] = [
    Change::Nothing,
    Change::Powered(true),
    Change::Powered(false),
    Change::Standstill,
    Change::Silence,
    Change::DriveFault,
    Change::Referenced(true),
    Change::Referenced(false),
    Change::Interlock,
    Change::Fault,
    Change::HostSilent,
    Change::Stalled,
];
