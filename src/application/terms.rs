//! Modes, faults and refusals: the words in which the firmware tells where it stands.

use crate::board::PortState;
use crate::control::feedback::Implausible;
use serde::{Deserialize, Serialize};

/// AL state OP without the error flag.
const AL_OPERATIONAL: u8 = 8;

/// Operating mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// Waiting for a configuration.
    #[default]
    Startup,
    /// The bus is being brought up.
    BusConfiguring,
    /// The bus is operational, the drives are without power.
    DrivesOff,
    /// The drives hold the pose, the joint angles are not known.
    Unreferenced,
    /// Enabled and at rest.
    Idle,
    /// A jog or a single move.
    Moving,
    /// A path is being drawn.
    Drawing,
    /// A drawing is held on its path.
    Holding,
    /// On the way to a standstill, before the power is taken from the drives.
    Stopping,
    /// A fault is latched.
    Fault,
}

/// Who asked for an emergency stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StopSource {
    /// A command over the link.
    Link,
    /// The board's input.
    Input,
}

/// The cause of a fault, with what was measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Fault {
    /// Emergency stop.
    EmergencyStop(StopSource),
    /// No valid measurement for longer than the blind limit.
    Blind {
        /// Milliseconds without a measurement.
        blind_ms: u16,
        /// The limit.
        limit_ms: u16,
    },
    /// A slave stopped answering.
    SlaveLost {
        /// Position in the chain, from 0.
        slave: u8,
    },
    /// A slave left the operational state.
    SlaveState {
        /// Position in the chain, from 0.
        slave: u8,
        /// AL state with the error flag.
        al_state: u8,
        /// AL status code.
        al_code: u16,
    },
    /// A drive reported a fault.
    Drive {
        /// Axis, from 0.
        axis: u8,
        /// CiA 402 status word.
        status_word: u16,
    },
    /// The measured position is too far from its reference.
    FollowingError {
        /// Axis, from 0.
        axis: u8,
        /// Measured error, rad.
        error_rad: f32,
        /// Limit, rad.
        limit_rad: f32,
    },
    /// The controller asked for more than the output limit for longer than a moment.
    OutputLimit {
        /// Axis, from 0.
        axis: u8,
        /// Velocity asked for, rad/s.
        output_rad_s: f32,
        /// Limit, rad/s.
        limit_rad_s: f32,
    },
    /// Positions were missing in motion for so long that the turn is no longer known.
    ReferenceLost {
        /// Axis, from 0.
        axis: u8,
    },
    /// Too many late cycles within a second.
    CyclesLate {
        /// Late cycles in the last second.
        late: u16,
        /// The limit.
        limit: u16,
    },
    /// The ring of references ran dry.
    ReferenceUnderrun,
    /// The drives did not take power in time.
    EnableTimeout {
        /// How long was waited, ms.
        waited_ms: u16,
    },
    /// The bus could not be brought up.
    BusConfiguration {
        /// Position in the chain, from 0.
        slave: u8,
        /// Step that failed.
        step: u8,
        /// AL status or SDO abort code.
        code: u32,
    },
    /// Other drives on the bus than the configuration expects.
    UnexpectedBus {
        /// Drives found.
        found: u8,
        /// Drives expected.
        expected: u8,
    },
    /// The bus clock did not come any more.
    ClockLost {
        /// Cycles in a row without a clock value.
        missing_cycles: u8,
        /// The limit.
        limit_cycles: u8,
    },
    /// The bus clock or the sample left its phase.
    ClockJump {
        /// Phase of the sample against the bus clock, ns; positive when the sample came too late.
        error_ns: i32,
        /// The limit, ns.
        limit_ns: u32,
    },
    /// The bus' Ethernet port has no link.
    NoLink {
        /// What its PHY says.
        port: PortState,
    },
    /// The board's exact clock has failed; it runs on a substitute.
    ClockFailure,
    /// Another product than before stands in a slave's place.
    OtherProduct {
        /// Position in the chain, from 0.
        slave: u8,
        /// Product code expected.
        expected: u32,
        /// Product code found.
        found: u32,
    },
    /// The bus was not repaired in time, and why is not known yet.
    RepairTimeout {
        /// How long was waited, ms.
        waited_ms: u16,
    },
    /// The planner made no progress on a motion that has to go on.
    MotionStalled {
        /// Vertices of the path fully executed.
        vertex: u32,
        /// How long it was waited for, ms.
        waited_ms: u16,
    },
    /// An axis's measured motion is not the motion that was commanded: its feedback is frozen, slips, is reversed or
    /// belongs to another axis, or its drive does not follow.
    FeedbackDeviation {
        /// Axis, from 0.
        axis: u8,
        /// Commanded less measured motion, rad.
        deviation_rad: f32,
        /// Limit, rad.
        limit_rad: f32,
    },
    /// An axis's measured position jumps about as no motor can.
    FeedbackNoise {
        /// Axis, from 0.
        axis: u8,
        /// Mean acceleration measured, rad/s2.
        acceleration_rad_s2: f32,
        /// Limit, rad/s2.
        limit_rad_s2: f32,
    },
    /// A slave's processor stood still: its watchdog expired, and what the slave showed was old.
    ProcessorStopped {
        /// Position in the chain, from 0.
        slave: u8,
        /// Expiries of the watchdog since the slave was brought up.
        expiries: u8,
    },
}

impl Fault {
    /// The fault of an axis, from 0, whose feedback cannot be true.
    pub fn feedback(axis: u8, implausible: Implausible) -> Self {
        match implausible {
            Implausible::Deviation {
                deviation_rad,
                limit_rad,
            } => Self::FeedbackDeviation {
                axis,
                deviation_rad,
                limit_rad,
            },
            Implausible::Noise {
                acceleration_rad_s2,
                limit_rad_s2,
            } => Self::FeedbackNoise {
                axis,
                acceleration_rad_s2,
                limit_rad_s2,
            },
        }
    }

    /// Whether it tells more about what `known` was latched for: the supervisor knows which slave and why, the critical
    /// tasks only that something is wrong. A slave that answers in OP again only waits to be taken back.
    pub(super) fn names_better(&self, known: &Self) -> bool {
        let slave_of = |fault: &Self| match fault {
            Self::SlaveLost { slave } | Self::SlaveState { slave, .. } => Some(*slave),
            _ => None,
        };
        if matches!(self, Self::NoLink { .. }) {
            // Whatever the bus is missed for, this is why.
            return matches!(
                known,
                Self::Blind { .. }
                    | Self::SlaveLost { .. }
                    | Self::SlaveState { .. }
                    | Self::UnexpectedBus { .. }
                    | Self::RepairTimeout { .. }
            );
        }
        let is_specific = !matches!(self, Self::SlaveState { al_state, .. } if *al_state == AL_OPERATIONAL);
        let is_vague = matches!(
            known,
            Self::Blind { .. } | Self::RepairTimeout { .. } | Self::SlaveState { slave: u8::MAX, .. }
        );
        is_specific && (is_vague || slave_of(known).is_some() && slave_of(known) == slave_of(self))
    }
}

/// Why a command was refused; nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Refusal {
    /// The mode does not allow it.
    NotInMode(Mode),
    /// There is no configuration yet.
    NotConfigured,
    /// The joint angles are not referenced.
    NotReferenced,
    /// The target is outside what the robot may use.
    Target(crate::motion::Refusal),
    /// The override is outside 10 to 200 percent.
    OverrideRange(u8),
    /// The cause of the fault is still there.
    CauseRemains(Fault),
    /// The robot is moving.
    Moving,
    /// A value is not a finite number.
    NotFinite,
    /// No position of the axis arrives.
    NoPosition {
        /// Axis, from 0.
        axis: u8,
    },
    /// The axis' resolver shows another angle than the pose says.
    PoseResolver {
        /// Axis, from 0.
        axis: u8,
        /// What it shows, on the turn nearest to the pose, minus the pose, rad.
        difference_rad: f32,
    },
    /// Forward kinematics of the pose does not lead to the measured position.
    PosePosition {
        /// The axis that differs most, from 0.
        axis: u8,
        /// By how much, rad: near a multiple of a motor turn where the turn is the wrong one.
        difference_rad: f32,
        /// Distance between the two positions, mm.
        distance_mm: f32,
    },
    /// Too many commands at once.
    Busy,
    /// The fault was acknowledged before, and bus and drives are being brought back.
    Recovering,
}
