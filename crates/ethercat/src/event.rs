//! Commands to the supervisor and events from it.
//!
//! Invariant: every event stands alone; if one is lost the others remain valid.

use super::clock::Settling;
pub use super::configure::own_data::ChosenEntry;
use super::driver::{Direction, ExpectedIdentity, SlaveFactory};
use super::error::BusError;
use super::plan::{ExchangeKind, VALUES_MAX, ValueBit};
use super::port_state::PortState;
use super::slave_set::SlaveSet;
use super::state::AlReport;
use super::wire::coe::{Emergency, Object};
use super::wire::sii::Identity;
use heapless::Vec;

/// A value of a terminal that the application wants, named by its object or by its first bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WantedValue {
    /// Place in the chain of the slave, from 0.
    pub slave: u8,
    /// Whether it is among the inputs or the outputs.
    pub direction: Direction,
    /// Its bits; an entry of another length is not the value.
    pub bits: u8,
    /// Sub-index and index of the object as the slave's process data list it; apart they take less room.
    sub: u8,
    index: u16,
    /// Its first bit, for a value that is not named by an object.
    first: ValueBit,
}

impl WantedValue {
    /// A value of `bits` bits of the slave at a place in the chain, from 0, named by its object.
    pub const fn new(slave: u8, direction: Direction, object: Object, bits: u8) -> Self {
        Self {
            slave,
            direction,
            bits,
            sub: object.sub,
            index: object.index,
            first: ValueBit::MISSING,
        }
    }

    /// A value of `bits` bits of the slave at a place in the chain, from 0, that begins at a bit of its inputs or outputs.
    pub const fn at_bit(slave: u8, direction: Direction, bit: u16, bits: u8) -> Self {
        Self {
            slave,
            direction,
            bits,
            sub: 0,
            index: 0,
            first: ValueBit::at(bit),
        }
    }

    /// The first bit of a value that is named by it; [`ValueBit::MISSING`] for a value that is named by its object.
    pub const fn first(&self) -> ValueBit {
        self.first
    }

    /// The object as the slave's process data list it; index 0 for a value that is named by its first bit.
    pub const fn object(&self) -> Object {
        Object::new(self.index, self.sub)
    }
}

/// Most terminals whose identity is compared.
pub const IDENTITIES_MAX: usize = 6;

/// The identity that the application requires of the terminal at a place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlaceIdentity {
    /// Place in the chain, from 0.
    pub slave: u8,
    /// The identity.
    pub identity: ExpectedIdentity,
}

/// The bus that a bring-up expects, and how to run it.
#[derive(Clone, Debug, PartialEq)]
pub struct BusSetup<F: SlaveFactory> {
    /// Members expected: the first slaves in the chain that have a driver and are not among the terminals that are named,
    /// in chain order.
    pub members: u8,
    /// Number of slaves, those that nobody uses included, for which the bring-up waits, so that no slave that is slow to
    /// start shifts the places of those behind it. 0: enough for the members and the named terminals.
    pub slaves: u8,
    /// Places of further slaves that take part with their own process data: those of the set that are no members. A set
    /// of all places leaves members their places; any other set takes its places from them. Terminals
    /// are brought to OP, exchanged in each cycle, watched and repaired like members. One that fails keeps no member from
    /// operating.
    pub terminals: SlaveSet,
    /// Values of the terminals that the application wants; the plan tells where they are, see
    /// [`Exchange::value`](super::cyclic::Exchange::value). A terminal of which two of them share an output bit is
    /// refused with [`BusError::SharedOutput`].
    pub values: Vec<WantedValue, VALUES_MAX>,
    /// Identities required of terminals; a slave that differs is refused with [`BusError::WrongSlave`].
    pub identities: Vec<PlaceIdentity, IDENTITIES_MAX>,
    /// Process data that are assigned and mapped over CoE before the process data of a terminal are read; those of other
    /// sync managers stay as they are.
    pub chosen: &'static [ChosenEntry],
    /// Settings of the members.
    pub settings: F::Settings,
    /// When inputs are read and outputs are written.
    pub exchange: ExchangeKind,
    /// Period of the cyclic exchange, ns.
    pub cycle_ns: u32,
    /// Sync-manager watchdog of the members, ms; 0 switches it off.
    pub watchdog_ms: u16,
    /// Whether the slaves' distributed clocks are set up.
    pub clocks: bool,
    /// Time of SYNC0 after the input telegram's frame has passed the reference clock, us, for slaves that use SYNC0.
    pub sync_shift_us: u16,
    /// When a slave's clock has settled.
    pub settling: Settling,
}

impl<F: SlaveFactory> Default for BusSetup<F> {
    /// No members, no terminals, a cycle of 1 ms.
    fn default() -> Self {
        Self {
            members: 0,
            slaves: 0,
            terminals: SlaveSet::NONE,
            values: Vec::new(),
            identities: Vec::new(),
            chosen: &[],
            settings: F::Settings::default(),
            exchange: ExchangeKind::default(),
            cycle_ns: 1_000_000,
            watchdog_ms: 10,
            clocks: false,
            sync_shift_us: 500,
            settling: Settling::default(),
        }
    }
}

/// A command to the supervisor.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // few are alive at a time, in static memory
pub enum BusCommand<F: SlaveFactory> {
    /// Bring the bus up from any state.
    Start(BusSetup<F>),
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
    /// Leaving BOOT.
    Bootstrap,
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
        /// Its number among the application's members, if it is used.
        member: Option<u8>,
        /// AL state, error flag and code.
        report: AlReport,
    },
    /// All members are in OP.
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
    /// A slave in use that was lost is in the chain again, in INIT without its address, and waits for
    /// [`BusCommand::Recover`]. Told again when the chain has changed, and after a repair that did not bring it back.
    Returned {
        /// Place in the chain, from 0.
        position: u8,
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
    /// A slave's processor stopped for longer than its watchdog allows, while its slave controller continued to answer.
    ProcessorStopped {
        /// Place in the chain, from 0.
        position: u8,
        /// Expiries counted by its watchdog.
        expiries: u8,
    },
    /// A slave of [`BusSetup::terminals`] could not be brought to OP; all other slaves go on.
    TerminalRefused {
        /// Place in the chain, from 0.
        position: u8,
        /// The step that failed.
        step: Step,
        /// Why it failed.
        error: BusError,
    },
    /// A slave answers, but its processor does not read the request for a state yet: it may be starting up. The step
    /// goes on.
    Waiting {
        /// Place in the chain, from 0.
        position: u8,
        /// The step that waits.
        step: Step,
        /// Time waited, ms.
        waited_ms: u32,
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
