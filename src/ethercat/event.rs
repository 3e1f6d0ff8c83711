//! Commands to the supervisor and events from it.
//!
//! Invariant: every event stands alone; if one is lost the others remain valid.

use super::error::BusError;
use super::state::AlReport;
use super::wire::coe::Emergency;
use super::wire::sii::Identity;
use crate::application::{BusCondition, Fault};
use crate::board::PortState;
use crate::config::{Axis, Bus};
use crate::robot::AXES;

/// Expected bus.
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
    /// Bring the bus up from any state.
    Start(BusSetup),
    /// Bring lost slaves back; if the last bring-up failed, bring the bus up again.
    Recover,
    /// Send safe outputs, take all slaves out of OP, then leave the bus alone.
    Stop,
    /// The Ethernet port's link state changed.
    Port(PortState),
}

/// A step of bring-up or repair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Step {
    /// Counting the slaves.
    Discover,
    /// Bringing all slaves to INIT.
    Reset,
    /// Assigning station addresses.
    Address,
    /// Reading identity and mailbox from the SII.
    Identify,
    /// Finding a lost slave in the chain.
    Locate,
    /// Going to INIT.
    Init,
    /// Setting up the mailbox.
    Mailbox,
    /// Going to PREOP.
    PreOperational,
    /// Writing objects by CoE.
    Objects,
    /// Setting up sync managers, FMMUs and watchdogs.
    ProcessData,
    /// Going to SAFEOP.
    SafeOperational,
    /// Waiting for cyclic inputs.
    CyclicData,
    /// Going to OP.
    Operational,
    /// Setting up the distributed clocks.
    Clocks,
    /// Another slave changed during a bring-up or a repair.
    Watch,
}

/// Event from the supervisor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusEvent {
    /// The slaves in the chain were counted.
    Found {
        /// Number of slaves.
        slaves: u16,
    },
    /// A slave was identified or changed its state.
    Slave {
        /// Place in the chain, from 0.
        position: u8,
        /// Identity.
        identity: Identity,
        /// Name for display.
        name: &'static str,
        /// The axis it drives, if it is used.
        axis: Option<u8>,
        /// AL state, error flag and code.
        report: AlReport,
    },
    /// All drives are in OP.
    Operational,
    /// A slave no longer answers.
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
        /// Content of the emergency.
        emergency: Emergency,
    },
    /// A cable damages frames or has lost its link.
    CableErrors {
        /// The slave at whose port the errors were counted: place in the chain, from 0.
        position: u8,
        /// The port, 0 to 3.
        port: u8,
        /// The slave at the other end; `None` if it is the master or not known.
        partner: Option<u8>,
        /// Increase of the port's counters.
        count: u16,
    },
    /// A slave's processor stopped for longer than its watchdog allows, while its slave controller went on answering.
    ProcessorStopped {
        /// Place in the chain, from 0.
        position: u8,
        /// Expiries counted by its watchdog.
        expiries: u8,
    },
    /// Bring-up or repair failed.
    Refused {
        /// The slave concerned, if any: place in the chain, from 0.
        position: Option<u8>,
        /// The step that failed.
        step: Step,
        /// Why it failed.
        error: BusError,
    },
}

impl BusEvent {
    /// Bus condition for the operating modes; `None` if the event does not affect them.
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
