//! The master's record of one slave.
//!
//! Invariant: plain data; only the supervisor changes it.

use super::mailbox::Mailbox;
use super::state::AlReport;
use super::wire::coe::Emergency;
use super::wire::register::PORTS;
use super::wire::sii::{FixedPart, Identity};
use crate::configure::discovery::STATION_BASE;
use crate::configure::identification::KnownIdentity;
use crate::configure::own_data::OwnData;
use crate::driver::{Direction, ProcessData, SlaveFactory};

/// Condition of a slave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Condition {
    /// Visible, not in use.
    #[default]
    Unused,
    /// Being configured.
    Configuring,
    /// In OP, exchanging process data.
    Operational,
    /// The slave does not answer.
    Lost,
    /// The slave answers, but is not in OP.
    LeftOperational,
    /// A slave answers at the address of one that was lost: it may be another one.
    Returned,
    /// Brought below OP on request, and left there.
    Parked,
}

/// Process data of a slave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SlaveData<F: SlaveFactory> {
    /// Not configured, or not known.
    #[default]
    Unknown,
    /// As its driver has configured them.
    OfDriver(ProcessData<F>),
    /// As the slave itself describes them.
    Own(OwnData),
}

impl<F: SlaveFactory> SlaveData<F> {
    /// Whether the process data are known.
    pub const fn is_known(&self) -> bool {
        !matches!(self, Self::Unknown)
    }

    /// Those that a driver has configured.
    pub const fn of_driver(&self) -> Option<&ProcessData<F>> {
        match self {
            Self::OfDriver(data) => Some(data),
            Self::Unknown | Self::Own(_) => None,
        }
    }

    /// Those that the slave itself describes.
    pub const fn own(&self) -> Option<&OwnData> {
        match self {
            Self::Own(data) => Some(data),
            Self::Unknown | Self::OfDriver(_) => None,
        }
    }
}

/// One slave in the chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slave<F: SlaveFactory> {
    /// Place in the chain, from 0.
    pub position: u16,
    /// Fixed part of its SII.
    pub fixed: FixedPart,
    /// Its identity, as last compared with an expectation.
    pub known: KnownIdentity,
    /// Number of its switches, once it was asked for a diagnosis; 0 if it tells none.
    pub switch: Option<u16>,
    /// Its device type, if there is a driver for it.
    pub device: Option<F::Device>,
    /// Its number among the application's members, if it is one.
    pub member: Option<u8>,
    /// Whether it takes part with its own process data.
    pub is_terminal: bool,
    /// Its process data.
    pub data: SlaveData<F>,
    /// Its mailbox, once configured.
    pub mailbox: Mailbox,
    /// Condition of the slave.
    pub condition: Condition,
    /// Link states of its ports: the last DL status register read.
    pub dl_status: u16,
    /// Damaged frames and lost links of each port, as last read.
    pub port_errors: [u16; PORTS],
    /// Expiries of its processor's watchdog, as last read.
    pub processor_stops: Option<u8>,
    /// Its last emergency since it was configured.
    pub emergency: Option<Emergency>,
    /// Its AL status, as last read.
    pub report: AlReport,
    /// Number of its last configuration from INIT, counted over all slaves of this bus, wrapping.
    pub generation: u8,
}

impl<F: SlaveFactory> Slave<F> {
    /// A slave at a place in the chain, of which nothing else is known.
    pub fn at(position: u16) -> Self {
        Self {
            position,
            fixed: FixedPart::default(),
            known: KnownIdentity::default(),
            switch: None,
            device: None,
            member: None,
            is_terminal: false,
            data: SlaveData::Unknown,
            mailbox: Mailbox::default(),
            condition: Condition::default(),
            dl_status: 0,
            port_errors: [0; PORTS],
            processor_stops: None,
            emergency: None,
            report: AlReport::default(),
            generation: 0,
        }
    }

    /// Whether the application uses the slave.
    pub const fn is_used(&self) -> bool {
        self.member.is_some() || self.is_terminal
    }

    /// Whether it is a terminal whose process data could not be found: what was read of it before may have been damaged.
    pub const fn is_refused_terminal(&self) -> bool {
        self.is_terminal && self.data.own().is_none()
    }

    /// Whether it is a terminal of whose information memory nothing was read yet.
    pub fn is_unread_terminal(&self) -> bool {
        self.is_terminal && self.fixed == FixedPart::default()
    }

    /// Whether its process data are those that the slave itself describes: it is a terminal, or has no driver.
    pub const fn has_own_data(&self) -> bool {
        self.is_terminal || self.device.is_none()
    }

    /// Bytes of its outputs and of its inputs; 0 while they are not known.
    pub fn lengths(&self) -> (u16, u16) {
        match self.data {
            SlaveData::OfDriver(data) => (data.output_length, data.input_length),
            SlaveData::Own(data) => (data.length(Direction::Outputs), data.length(Direction::Inputs)),
            SlaveData::Unknown => (0, 0),
        }
    }

    /// Its station address.
    pub const fn station(&self) -> u16 {
        STATION_BASE.wrapping_add(self.position)
    }

    /// Name of its device type for messages.
    pub fn name(&self) -> &'static str {
        self.device.map_or("unknown device", |device| F::describe(device).name)
    }

    /// Whether it is of the product of an identity.
    pub const fn is_of_product(&self, identity: &Identity) -> bool {
        let own = self.identity();
        own.vendor == identity.vendor && own.product == identity.product
    }

    /// Identity of the slave.
    pub const fn identity(&self) -> Identity {
        self.fixed.identity
    }
}
