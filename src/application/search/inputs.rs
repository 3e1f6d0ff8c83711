//! External inputs of the search: commands, the supervisor's reports, changes of a millisecond's report.

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

/// All commands, several times where an operand makes a difference.
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

/// Reports of the bus's supervisor: [`NEWS`] at any time, [`ANSWERS`] after a request.
pub(super) const NEWS: [BusCondition; 3] = [
    BusCondition::Failed(Fault::SlaveLost { slave: 1 }),
    BusCondition::Failed(LEFT),
    BusCondition::Refused(Fault::NoLink {
        port: crate::board::PortState::Down,
    }),
];
pub(super) const ANSWERS: [BusCondition; 2] = [BusCondition::Operational, BusCondition::Refused(UNEXPECTED)];

/// A change of the millisecond's report, of the host's silence or of the trajectory's progress.
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
    /// A search for the home switches ends, with the angles or without.
    Searched(bool),
}

pub(super) const CHANGES: [Change; 14] = [
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
    Change::Searched(true),
    Change::Searched(false),
];
