//! What the master knows about one slave.
//!
//! Invariant: plain data; the supervisor is the only one to change it.

use super::mailbox::Mailbox;
use super::state::AlReport;
use super::wire::coe::Emergency;
use super::wire::register::PORTS;
use super::wire::sii::{FixedPart, Identity};
use crate::drives::layout::ProcessLayout;
use crate::drives::{DriveKind, Windows};

/// Station address of the first slave; the others follow in chain order.
pub const STATION_BASE: u16 = 0x1001;
/// Station address of a slave while it is being identified.
pub const STATION_TEMPORARY: u16 = 0x1000;

/// How a slave is doing, as far as it is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Condition {
    /// Visible, not used.
    #[default]
    Unused,
    /// Being configured.
    Configuring,
    /// In OP, exchanging process data.
    Operational,
    /// Does not answer.
    Lost,
    /// Answers, but is not in OP.
    LeftOperational,
    /// Brought below OP because someone asked for it, and left alone.
    Parked,
}

/// A slave's process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProcessData {
    /// Where outputs and inputs lie in its memory.
    pub windows: Windows,
    /// Where its values lie in them, and their lengths.
    pub layout: ProcessLayout,
}

/// One slave in the chain.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Slave {
    /// Place in the chain, from 0.
    pub position: u16,
    /// Fixed part of its SII.
    pub fixed: FixedPart,
    /// Its drive type, if it is a drive.
    pub kind: Option<DriveKind>,
    /// The axis it drives, if it is used.
    pub axis: Option<u8>,
    /// Its process data, once they have been configured.
    pub process_data: Option<ProcessData>,
    /// Its mailbox, once configured.
    pub mailbox: Mailbox,
    /// How it is doing.
    pub condition: Condition,
    /// Its ports, as the DL status register told when it was last asked.
    pub dl_status: u16,
    /// Damaged frames and lost links of each port when they were last read.
    pub port_errors: [u16; PORTS],
    /// Expiries of its processor's watchdog when they were last read.
    pub processor_stops: Option<u8>,
    /// Its last emergency since it was configured.
    pub emergency: Option<Emergency>,
    /// Its AL status when it was last asked.
    pub report: AlReport,
    /// Number of its last configuration from INIT among all on this bus, wrapping.
    pub generation: u8,
}

impl Slave {
    /// Its station address.
    pub const fn station(&self) -> u16 {
        STATION_BASE.wrapping_add(self.position)
    }

    /// Who it is.
    pub const fn identity(&self) -> Identity {
        self.fixed.identity
    }
}
