//! What the application tells the supervisor, and what it hears from it.
//!
//! Invariant: every event stands for itself; losing one leaves the others true.

use super::error::BusError;
use super::state::AlReport;
use super::wire::coe::Emergency;
use super::wire::sii::Identity;
use crate::application::{BusCondition, Fault};
use crate::board::PortState;
use crate::config::{Axis, Bus};
use crate::robot::AXES;

/// What the bus is expected to be.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BusSetup {
    /// The bus.
    pub bus: Bus,
    /// The axes; the first drive in the chain is the first axis.
    pub axes: [Axis; AXES],
}

/// An order to the supervisor.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // few are alive at a time, in static memory
pub enum BusCommand {
    /// Bring the bus up from whatever state it is in.
    Start(BusSetup),
    /// Bring lost slaves back; bring the bus up again if that has failed before.
    Recover,
    /// Take all slaves out of OP, after safe outputs, and leave the bus alone.
    Stop,
    /// The Ethernet port's link came or went.
    Port(PortState),
}

/// A step of bring-up or repair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Step {
    /// Counting the slaves.
    Discover,
    /// Bringing all to INIT.
    Reset,
    /// Giving station addresses.
    Address,
    /// Reading identity and mailbox from the SII.
    Identify,
    /// Finding a lost slave at its place.
    Locate,
    /// To INIT.
    Init,
    /// Setting up the mailbox.
    Mailbox,
    /// To PREOP.
    PreOperational,
    /// Writing objects by CoE.
    Objects,
    /// Setting up sync managers, FMMUs and watchdogs.
    ProcessData,
    /// To SAFEOP.
    SafeOperational,
    /// Waiting for cyclic inputs.
    CyclicData,
    /// To OP.
    Operational,
    /// Setting up the distributed clocks.
    Clocks,
    /// Other slaves changed while one was being brought up or repaired.
    Watch,
}

/// What the supervisor has to report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusEvent {
    /// That many slaves are in the chain.
    Found {
        /// Number of slaves.
        slaves: u16,
    },
    /// A slave was identified or changed its state.
    Slave {
        /// Place in the chain, from 0.
        position: u8,
        /// Who it is.
        identity: Identity,
        /// Name for people.
        name: &'static str,
        /// The axis it drives, if it is used.
        axis: Option<u8>,
        /// AL state, error flag and code.
        report: AlReport,
    },
    /// All drives are in OP.
    Operational,
    /// A slave does not answer any more.
    SlaveLost {
        /// Place in the chain, from 0.
        position: u8,
    },
    /// A slave answers, but left OP.
    SlaveLeft {
        /// Place in the chain, from 0.
        position: u8,
        /// AL state, error flag and code.
        report: AlReport,
    },
    /// A slave is back in OP.
    Repaired {
        /// Place in the chain, from 0.
        position: u8,
    },
    /// All used slaves were taken out of OP.
    Stopped,
    /// A slave has sent an emergency.
    Emergency {
        /// Place in the chain, from 0.
        position: u8,
        /// What it says.
        emergency: Emergency,
    },
    /// A cable has damaged frames or lost its link.
    CableErrors {
        /// The slave at whose port it was counted: place in the chain, from 0.
        position: u8,
        /// The port, 0 to 3.
        port: u8,
        /// The slave at the other end; `None` is the master, or not known.
        partner: Option<u8>,
        /// How much the port's counters have grown.
        count: u16,
    },
    /// A slave's processor stood still for longer than its watchdog allows, while its controller went on answering.
    ProcessorStopped {
        /// Place in the chain, from 0.
        position: u8,
        /// Expiries that its watchdog has counted.
        expiries: u8,
    },
    /// Bring-up or repair failed.
    Refused {
        /// The slave, if it is about one: place in the chain, from 0.
        position: Option<u8>,
        /// What was tried.
        step: Step,
        /// Why it failed.
        error: BusError,
    },
}

impl BusEvent {
    /// What the event means to the operating modes; `None` when nothing.
    pub fn condition(&self) -> Option<BusCondition> {
        let refused = match *self {
            Self::Operational => return Some(BusCondition::Operational),
            Self::SlaveLost { position } => {
                return Some(BusCondition::Failed(Fault::SlaveLost { slave: position }));
            }
            Self::SlaveLeft { position, report } => {
                return Some(BusCondition::Failed(Fault::SlaveState {
                    slave: position,
                    al_state: report.status,
                    al_code: report.code,
                }));
            }
            Self::Refused {
                position: Some(slave),
                error: BusError::Identity { expected, actual },
                ..
            } => Fault::OtherProduct {
                slave,
                expected,
                found: actual,
            },
            Self::ProcessorStopped { position, expiries } => Fault::ProcessorStopped {
                slave: position,
                expiries,
            },
            Self::Refused {
                error: BusError::NoLink { port },
                ..
            } => Fault::NoLink { port },
            Self::Refused {
                error: BusError::DriveCount { expected, actual },
                ..
            } => Fault::UnexpectedBus {
                found: actual,
                expected,
            },
            Self::Refused {
                step: Step::Discover,
                error: BusError::SlaveCount { expected, actual },
                ..
            } => Fault::UnexpectedBus {
                found: actual.min(255) as u8,
                expected: expected.min(255) as u8,
            },
            Self::Refused { position, step, error } => Fault::BusConfiguration {
                slave: position.unwrap_or(0),
                step: step as u8,
                code: error.code(),
            },
            Self::Found { .. }
            | Self::Slave { .. }
            | Self::Repaired { .. }
            | Self::Stopped
            | Self::Emergency { .. }
            | Self::CableErrors { .. } => return None,
        };
        Some(BusCondition::Refused(refused))
    }
}
