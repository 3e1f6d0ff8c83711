//! Everything that can go wrong between the master and one slave.
//!
//! One flat enum for the slow side; the critical side counts instead
//! ([`BusCounters`](super::cyclic::BusCounters)).
//!
//! Invariant: every variant carries what was expected and what was found, or what was tried for how long.

use super::wire::coe::Object;
use crate::board::PortState;
use serde::{Deserialize, Serialize};

/// Why a step of bring-up or repair failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum BusError {
    /// The frames did not come back.
    Lost {
        /// How often it was tried.
        tries: u8,
    },
    /// Frames came back, but other slaves than expected executed the datagram.
    WorkingCounter {
        /// Working counter expected.
        expected: u16,
        /// Working counter found.
        actual: u16,
    },
    /// Another number of slaves than expected.
    SlaveCount {
        /// Slaves expected.
        expected: u16,
        /// Slaves found.
        actual: u16,
    },
    /// Fewer drives than axes.
    DriveCount {
        /// Drives expected.
        expected: u8,
        /// Drives found.
        actual: u8,
    },
    /// Another product at this place than before.
    Identity {
        /// Product code expected.
        expected: u32,
        /// Product code found.
        actual: u32,
    },
    /// The expected product is at this place, but with the serial number of another slave of this bus: the two were
    /// swapped.
    Serial {
        /// Serial number expected.
        expected: u32,
        /// Serial number found.
        actual: u32,
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
        /// How long was waited, ms.
        waited_ms: u32,
    },
    /// The SII reports an error.
    Sii {
        /// Its control and status register.
        status: u16,
    },
    /// The slave has no mailbox, or a larger one than a datagram may carry.
    MailboxLength {
        /// Longest allowed, bytes.
        expected: u16,
        /// Length found, bytes.
        actual: u16,
    },
    /// The slave did not take or give a mailbox in time.
    MailboxTimeout {
        /// How long was waited, ms.
        waited_ms: u32,
    },
    /// The slave answered by a mailbox error.
    Mailbox {
        /// Its reason, see [`error_text`](super::wire::mailbox::error_text).
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
        /// The object asked for.
        object: Object,
    },
    /// The slave's toggle bit did not alternate: a segment was lost or came twice.
    SdoToggle {
        /// The object.
        object: Object,
    },
    /// An object has another length than expected.
    SdoLength {
        /// The object.
        object: Object,
        /// Bytes expected.
        expected: u32,
        /// Bytes found.
        actual: u32,
    },
    /// An object was written, but reads back differently.
    ReadBack {
        /// The object.
        object: Object,
        /// Value written.
        expected: u32,
        /// Value read.
        actual: u32,
    },
    /// An object that the drive is to be used by is not in its process data, or has another length there.
    Mapping {
        /// The object.
        object: Object,
        /// Bits expected.
        expected: u8,
        /// Bits found; 0 when it is not mapped.
        actual: u8,
    },
    /// An object in the process data does not begin with a byte.
    Alignment {
        /// The object.
        object: Object,
        /// The bit it begins with.
        bit: u16,
    },
    /// A slave has more process data in one direction than there is room for.
    ProcessLength {
        /// Most bytes allowed.
        expected: u16,
        /// Bytes found.
        actual: u16,
    },
    /// A value of the configuration does not fit the drive's object.
    Range {
        /// The object.
        object: Object,
    },
    /// The slave refused a state or went to another one.
    State {
        /// AL state asked for.
        expected: u8,
        /// AL state there is, with the error flag.
        actual: u8,
        /// AL status code, see [`al_code_text`](super::state::al_code_text).
        code: u16,
    },
    /// The slave did not reach a state in time.
    StateTimeout {
        /// AL state asked for.
        expected: u8,
        /// AL state there is, with the error flag.
        actual: u8,
        /// How long was waited, ms.
        waited_ms: u32,
    },
    /// More slaves than there is room for.
    TooManySlaves {
        /// Room.
        expected: u16,
        /// Slaves found.
        actual: u16,
    },
    /// The cyclic datagrams leave no room in the frame for one this long.
    NoRoom {
        /// Bytes of data to be sent.
        expected: u16,
        /// Longest data that would fit, bytes.
        actual: u16,
    },
    /// The cyclic exchange did not take the plan or gets no inputs of this slave.
    NoInputs {
        /// How long was waited, ms.
        waited_ms: u32,
    },
    /// The Ethernet port has no link.
    NoLink {
        /// What its PHY says.
        port: PortState,
    },
    /// A slave's clock does not follow the reference.
    ClockDifference {
        /// Largest difference allowed, ns.
        expected_ns: u32,
        /// Difference there is, ns; positive when the slave is ahead.
        actual_ns: i32,
        /// How long was waited, ms.
        waited_ms: u32,
    },
}

impl BusError {
    /// The slave's own number for it: AL status code or SDO abort code; 0 where there is none.
    pub const fn code(&self) -> u32 {
        match self {
            Self::SdoAbort { code, .. } => *code,
            Self::State { code, .. } => *code as u32,
            Self::Mailbox { detail } => *detail as u32,
            Self::Sii { status } => *status as u32,
            _ => 0,
        }
    }
}
