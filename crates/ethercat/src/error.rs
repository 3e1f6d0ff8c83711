//! Errors of the bus as seen by the slow side.
//!
//! One flat enum for the slow side; the critical side uses counters ([`BusCounters`](super::cyclic::BusCounters)).
//!
//! Invariant: every variant carries the expected and actual value, or what was tried for how long.

use super::port_state::PortState;
use super::wire::coe::Object;

/// A property that tells slaves apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum IdentityProperty {
    /// Vendor number.
    Vendor,
    /// Product code.
    Product,
    /// Revision of the product.
    Revision,
    /// Serial number.
    Serial,
    /// Configured alias.
    Alias,
    /// Number set with the identification switches.
    Switch,
    /// Station address: the order of the slaves since the bring-up.
    Station,
}

/// Why a step of bring-up or repair failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum BusError {
    /// The frames did not come back.
    Lost {
        /// How often it was tried.
        tries: u8,
    },
    /// Frames came back, but the expected slaves did not execute the datagram.
    WorkingCounter {
        /// Working counter expected.
        expected: u16,
        /// Working counter found.
        actual: u16,
    },
    /// The number of slaves differs from the expected one.
    SlaveCount {
        /// Slaves expected.
        expected: u16,
        /// Slaves found.
        actual: u16,
    },
    /// Fewer slaves with a driver than members.
    MemberCount {
        /// Members expected.
        expected: u8,
        /// Slaves found.
        actual: u8,
    },
    /// A slave was replaced by a different product.
    Identity {
        /// Product code expected.
        expected: u32,
        /// Product code found.
        actual: u32,
    },
    /// The slave is not the one that belongs to this place.
    WrongSlave {
        /// The property in which it differs.
        property: IdentityProperty,
        /// Value expected.
        expected: u32,
        /// Value found.
        actual: u32,
        /// Where the expected slave is, or where the one found belongs, if that is known: place in the chain, from 0.
        other: Option<u8>,
    },
    /// Another slave's station address at this place: the chain was changed.
    Station {
        /// Station address expected.
        expected: u16,
        /// Station address found.
        actual: u16,
    },
    /// The SII stayed busy.
    SiiBusy {
        /// Time waited, ms.
        waited_ms: u32,
    },
    /// The SII reports an error.
    Sii {
        /// The SII's control and status register.
        status: u16,
    },
    /// The slave has no mailbox, or its mailbox is too long for a datagram.
    MailboxLength {
        /// Longest allowed, bytes.
        expected: u16,
        /// Length found, bytes.
        actual: u16,
    },
    /// The slave did not accept or send a mailbox message in time.
    MailboxTimeout {
        /// Time waited, ms.
        waited_ms: u32,
    },
    /// The slave answered with a mailbox error.
    Mailbox {
        /// Reason, see [`error_text`](super::wire::mailbox::error_text).
        detail: u16,
    },
    /// The slave aborted an SDO transfer.
    SdoAbort {
        /// The object.
        object: Object,
        /// The abort code, see [`abort_text`](super::coe::abort_text).
        code: u32,
    },
    /// The slave's answer does not belong to the request.
    SdoAnswer {
        /// The object requested.
        object: Object,
    },
    /// The slave's toggle bit did not alternate: a segment was lost or repeated.
    SdoToggle {
        /// The object.
        object: Object,
    },
    /// An object's length differs from the expected one.
    SdoLength {
        /// The object.
        object: Object,
        /// Bytes expected.
        expected: u32,
        /// Bytes found.
        actual: u32,
    },
    /// The slave ended a file transfer.
    FileError {
        /// The error code, see [`error_text`](super::wire::foe::error_text).
        code: u32,
    },
    /// A packet of a file has a wrong number.
    FilePacket {
        /// Number expected.
        expected: u32,
        /// Number found.
        actual: u32,
    },
    /// The slave's answer does not belong to a file transfer.
    FileAnswer,
    /// The slave was not ready for the next packet of a file.
    FileBusy {
        /// Time waited, ms.
        waited_ms: u32,
    },
    /// An object reads back differently after it was written.
    ReadBack {
        /// The object.
        object: Object,
        /// Value written.
        expected: u32,
        /// Value read.
        actual: u32,
    },
    /// A required object is missing in the drive's process data, or its length differs.
    Mapping {
        /// The object.
        object: Object,
        /// Bits expected.
        expected: u8,
        /// Bits found; 0 when it is not mapped.
        actual: u8,
    },
    /// An object in the process data does not begin at a byte boundary.
    Alignment {
        /// The object.
        object: Object,
        /// Its first bit.
        bit: u16,
    },
    /// A slave has too much process data in one direction, or a terminal other data than before.
    ProcessLength {
        /// Most bytes allowed; or those of the terminal before, at least.
        expected: u16,
        /// Bytes found.
        actual: u16,
    },
    /// A value of the configuration does not fit the drive's object.
    Range {
        /// The object.
        object: Object,
    },
    /// The slave refused a state or went to a different one.
    State {
        /// AL state requested.
        expected: u8,
        /// Actual AL state with the error flag.
        actual: u8,
        /// AL status code, see [`al_code_text`](super::state::al_code_text).
        code: u16,
    },
    /// The slave did not reach a state in time.
    StateTimeout {
        /// AL state requested.
        expected: u8,
        /// Actual AL state with the error flag.
        actual: u8,
        /// Time waited, ms.
        waited_ms: u32,
    },
    /// The slave answers, but its processor does not read the requests for a state: it may be starting up.
    RequestUnread {
        /// AL state requested, with the acknowledge bit.
        requested: u8,
        /// Time waited, ms.
        waited_ms: u32,
    },
    /// The chain has more slaves than the master supports.
    TooManySlaves {
        /// Most slaves supported.
        expected: u16,
        /// Slaves found.
        actual: u16,
    },
    /// The cyclic datagrams leave too little room in the frame for this datagram.
    NoRoom {
        /// Bytes of data to send.
        expected: u16,
        /// Longest data that would fit, bytes.
        actual: u16,
    },
    /// The cyclic exchange did not take the plan, or gets no inputs of this slave.
    NoInputs {
        /// Time waited, ms.
        waited_ms: u32,
    },
    /// The Ethernet port has no link.
    NoLink {
        /// State that its PHY reports.
        port: PortState,
    },
    /// A slave's clock does not follow the reference.
    ClockDifference {
        /// Largest difference allowed, ns.
        expected_ns: u32,
        /// Actual difference, ns; positive when the slave is ahead.
        actual_ns: i32,
        /// Time waited, ms.
        waited_ms: u32,
    },
    /// Two values that the application wants share a bit of a slave's outputs.
    SharedOutput {
        /// The first, by its number in [`BusSetup::values`](super::event::BusSetup::values), from 0.
        first: u8,
        /// The second.
        second: u8,
    },
    /// A slave's process data are in more sync managers than the master keeps, or than its controller has FMMUs.
    SyncManagers {
        /// Most sync managers allowed.
        expected: u8,
        /// Sync managers found.
        actual: u8,
    },
    /// A file of the slave is being transferred in BOOT.
    FileOpen,
    /// A drive's positions repeat after a number that is not a whole number of motor turns.
    PositionRange {
        /// Increments of a motor turn.
        expected: u32,
        /// Number of positions until they repeat.
        actual: u32,
    },
}

impl BusError {
    /// The slave's own code of the error: AL status code or SDO abort code; 0 if there is none.
    pub const fn code(&self) -> u32 {
        match self {
            Self::SdoAbort { code, .. } | Self::FileError { code } => *code,
            Self::State { code, .. } => *code as u32,
            Self::Mailbox { detail } => *detail as u32,
            Self::Sii { status } => *status as u32,
            _ => 0,
        }
    }
}
