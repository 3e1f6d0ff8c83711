//! Faults: why the robot was stopped, with what was measured.
//!
//! Invariant: a fault alone says which axis or slave is concerned and by how much a limit was exceeded.

use crate::config::IoRole;
use crate::control::feedback::Implausible;
use crate::control::search::SearchFailure;
use crate::ethercat::clock::steering::ClockFault;
use crate::ethercat::error::IdentityProperty;
use crate::ethercat::port_state::PortState;
use serde::{Deserialize, Serialize};

/// AL state OP without the error flag.
const AL_OPERATIONAL: u8 = 8;

/// Who requested an emergency stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StopSource {
    /// A command over the link.
    Link,
    /// The board's input.
    Input,
}

/// Why an input of a terminal stops the drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum InputCause {
    /// The input is open: 0.
    Open,
    /// The input does not arrive, or its terminal is not in operation.
    Missing,
}

/// Why a stop on the path ended in the drives' quick stop: the part of its envelope that was left.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum PathStopFailure {
    /// A joint was too far from the path.
    Distance {
        /// Axis, from 0.
        axis: u8,
        /// Distance from the setpoint, rad.
        error_rad: f32,
        /// Limit, rad.
        limit_rad: f32,
    },
    /// A joint braked too little or too much.
    Speed {
        /// Axis, from 0.
        axis: u8,
        /// Velocity measured, rad/s.
        measured_rad_s: f32,
        /// Velocity planned for the moment of the measurement, rad/s.
        planned_rad_s: f32,
    },
    /// The joints did not come to rest in time.
    Time {
        /// The fastest axis, from 0.
        axis: u8,
        /// Its measured velocity, rad/s.
        measured_rad_s: f32,
        /// Time since the stop began, ms.
        passed_ms: u16,
    },
    /// The ring of setpoints ran dry before the joints had come to rest.
    Dry,
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
    /// The measured position is too far from its setpoint.
    FollowingError {
        /// Axis, from 0.
        axis: u8,
        /// Measured error, rad.
        error_rad: f32,
        /// Limit, rad.
        limit_rad: f32,
    },
    /// The controller's output was above its limit for longer than a moment.
    OutputLimit {
        /// Axis, from 0.
        axis: u8,
        /// Velocity requested, rad/s.
        output_rad_s: f32,
        /// Limit, rad/s.
        limit_rad_s: f32,
    },
    /// Positions were missing during motion for so long that the motor turn is no longer known.
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
    /// The ring of setpoints ran empty.
    #[serde(rename = "ReferenceUnderrun")]
    SetpointUnderrun,
    /// The drives did not switch to operation enabled in time.
    EnableTimeout {
        /// Time waited, ms.
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
    /// The number of drives on the bus differs from the configuration.
    UnexpectedBus {
        /// Drives found.
        found: u8,
        /// Drives expected.
        expected: u8,
    },
    /// The bus clock is no longer received.
    ClockLost {
        /// Cycles in a row without a clock value.
        missing_cycles: u8,
        /// The limit.
        limit_cycles: u8,
    },
    /// The bus clock or the sample has lost its phase.
    ClockJump {
        /// Phase of the sample relative to the bus clock, ns; positive when the sample was late.
        error_ns: i32,
        /// The limit, ns.
        limit_ns: u32,
    },
    /// The bus's Ethernet port has no link.
    NoLink {
        /// State that its PHY reports.
        port: PortState,
    },
    /// The board's precise clock source has failed; the board runs on a substitute.
    ClockFailure,
    /// A slave was replaced by a different product.
    OtherProduct {
        /// Position in the chain, from 0.
        slave: u8,
        /// Product code expected.
        expected: u32,
        /// Product code found.
        found: u32,
    },
    /// The bus was not repaired in time; the cause is not known yet.
    RepairTimeout {
        /// Time waited, ms.
        waited_ms: u16,
    },
    /// The planner made no progress with a motion that should progress.
    MotionStalled {
        /// Vertices of the path fully executed.
        vertex: u32,
        /// Time waited for progress, ms.
        waited_ms: u16,
    },
    /// An axis's measured motion differs from its commanded motion: its feedback is frozen, slips, is reversed or
    /// belongs to another axis, or its drive does not follow.
    FeedbackDeviation {
        /// Axis, from 0.
        axis: u8,
        /// Commanded minus measured motion, rad.
        deviation_rad: f32,
        /// Limit, rad.
        limit_rad: f32,
    },
    /// An axis's measured position jumps in a way that no motor can move.
    FeedbackNoise {
        /// Axis, from 0.
        axis: u8,
        /// Mean acceleration measured, rad/s2.
        acceleration_rad_s2: f32,
        /// Limit, rad/s2.
        limit_rad_s2: f32,
    },
    /// A slave's processor had stopped: its watchdog expired and its process data were stale.
    ProcessorStopped {
        /// Position in the chain, from 0.
        slave: u8,
        /// Expiries of the watchdog since the slave was brought up.
        expiries: u8,
    },
    /// A slave is not the one that belongs to its place: cables or drives were exchanged.
    WrongSlave {
        /// Position in the chain, from 0.
        slave: u8,
        /// The property in which it differs.
        property: IdentityProperty,
        /// Value expected.
        expected: u32,
        /// Value found.
        found: u32,
        /// Where the expected slave is, or where the one found belongs, if that is known: position in the chain, from 0.
        other: Option<u8>,
    },
    /// A named input of a terminal stops the drives.
    StopInput {
        /// The input: its place in the configuration's `io`, from 0.
        io: u8,
        /// Its role.
        role: IoRole,
        /// Whether it is open or missing.
        cause: InputCause,
    },
    /// Two named outputs share a bit of a terminal's outputs: one would hold it on while the other switches it off.
    SharedOutput {
        /// The terminal: position in the chain, from 0.
        slave: u8,
        /// The first output: its place in the configuration's `io`, from 0.
        first: u8,
        /// The second output.
        second: u8,
    },
    /// Drives confirmed no outputs for the blind limit: the telegrams were lost, or had the wrong working counter.
    OutputsLost {
        /// Axis, from 0; `None` for all axes.
        axis: Option<u8>,
        /// Milliseconds without a confirmation.
        lost_ms: u16,
        /// The limit.
        limit_ms: u16,
    },
    /// An axis opened its limit switch in operation.
    LimitSwitch {
        /// Axis, from 0.
        axis: u8,
        /// The input: its place in the configuration's `io`, from 0.
        io: u8,
    },
    /// An axis could not be homed by its switch.
    HomingFailed {
        /// Axis, from 0.
        axis: u8,
        /// What the switch did.
        failure: SearchFailure,
    },
    /// A stop on the path left its envelope; the drives' quick stop ended it.
    PathStopLeft(PathStopFailure),
}

impl From<ClockFault> for Fault {
    fn from(fault: ClockFault) -> Self {
        match fault {
            ClockFault::Lost {
                missing_cycles,
                limit_cycles,
            } => Self::ClockLost {
                missing_cycles,
                limit_cycles,
            },
            ClockFault::Jump { error_ns, limit_ns } => Self::ClockJump { error_ns, limit_ns },
        }
    }
}

impl Fault {
    /// Whether another configuration may resolve it: the bus is not the one that the configuration in force expects.
    pub const fn is_of_configuration(&self) -> bool {
        matches!(
            self,
            Self::UnexpectedBus { .. }
                | Self::BusConfiguration { .. }
                | Self::OtherProduct { .. }
                | Self::WrongSlave { .. }
                | Self::SharedOutput { .. }
        )
    }

    /// The fault of an axis (from 0) whose feedback is implausible.
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

    /// Whether the robot brakes on its path for this fault: it orders a stop, and neither the drives nor their feedback are
    /// in doubt. Every other fault, and every input that protects people, is the drives' quick stop at once.
    pub const fn keeps_path(&self) -> bool {
        matches!(
            self,
            Self::EmergencyStop(StopSource::Link) | Self::CyclesLate { .. } | Self::MotionStalled { .. }
        )
    }

    /// Whether this fault tells how the stop failed that `known` ordered, or names the same failure more precisely.
    pub const fn ends_stop_for(&self, known: &Self) -> bool {
        matches!(self, Self::PathStopLeft(_))
            && (known.keeps_path() || matches!(known, Self::FollowingError { .. } | Self::SetpointUnderrun))
    }

    /// Whether this fault describes the event for which `known` was latched more precisely. The supervisor knows which
    /// slave failed and why; the critical tasks know only that something failed. A slave reported in OP names no cause;
    /// it only waits for its repair.
    pub(super) fn is_more_precise_than(&self, known: &Self) -> bool {
        let slave_of = |fault: &Self| match fault {
            Self::SlaveLost { slave } | Self::SlaveState { slave, .. } => Some(*slave),
            _ => None,
        };
        if matches!(self, Self::NoLink { .. }) {
            // This is the cause of any missing bus.
            return matches!(
                known,
                Self::Blind { .. }
                    | Self::OutputsLost { .. }
                    | Self::SlaveLost { .. }
                    | Self::SlaveState { .. }
                    | Self::UnexpectedBus { .. }
                    | Self::RepairTimeout { .. }
                    | Self::StopInput {
                        cause: InputCause::Missing,
                        ..
                    }
            );
        }
        if let (Self::SlaveLost { slave }, Self::SlaveLost { slave: behind }) = (self, known) {
            // Behind a slave or cable that was lost, all others are lost too.
            return slave < behind;
        }
        let is_specific = !matches!(self, Self::SlaveState { al_state, .. } if *al_state == AL_OPERATIONAL);
        let is_vague = matches!(
            known,
            Self::Blind { .. }
                | Self::OutputsLost { .. }
                | Self::RepairTimeout { .. }
                | Self::StopInput {
                    cause: InputCause::Missing,
                    ..
                }
                | Self::SlaveState { slave: u8::MAX, .. }
        );
        is_specific && (is_vague || slave_of(known).is_some() && slave_of(known) == slave_of(self))
    }
}
