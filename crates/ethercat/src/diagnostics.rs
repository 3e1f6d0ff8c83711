//! Service requests: diagnosis and configuration of the bus by a person or a tool.
//!
//! On a computer, requests reach the supervisor through its queues; in the firmware they come over the link. The
//! supervisor carries them out between its own duties, in the free space of the cyclic frames. Long values travel in
//! pieces of [`PIECE_BYTES_MAX`]: the first piece (offset 0) fetches the value from the slave, further pieces come from
//! the supervisor's memory.
//!
//! Invariant: every request gets exactly one answer; no request disturbs the cyclic data of another slave.

use super::error::BusError;
use super::state::{AlReport, AlState};
use super::wire::coe::{Emergency, Object};
use super::wire::register::{PORTS, PortErrors};
use super::wire::sii::{Identity, MailboxWindow};
use heapless::{String, Vec};

/// Most bytes of a value in one answer or request.
pub const PIECE_BYTES_MAX: usize = 256;
/// Most indices of objects in one answer.
pub const INDICES_MAX: usize = 100;
/// Longest name in an answer, bytes.
pub const NAME_BYTES_MAX: usize = 64;

/// A part of a value.
pub type Piece = Vec<u8, PIECE_BYTES_MAX>;
/// A name for display; a longer one is cut off.
pub type Name = String<NAME_BYTES_MAX>;

/// A service request. Slaves are counted in chain order, from 0.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[allow(clippy::large_enum_variant)] // one is alive at a time, in static memory
pub enum ServiceRequest {
    /// Number of slaves and state of the frames; answered by [`ServiceReply::Bus`].
    Bus,
    /// Identity and configuration of a slave; answered by [`ServiceReply::Slave`].
    Slave {
        /// The slave.
        slave: u8,
    },
    /// Bring a slave to a state, step by step; answered by [`ServiceReply::State`].
    ///
    /// A slave that was brought below OP stays there until it is requested to go up again.
    SetState {
        /// The slave.
        slave: u8,
        /// Target state.
        state: AlState,
    },
    /// Read an object by SDO; answered by [`ServiceReply::Piece`]. Needs the mailbox: a slave in INIT is first brought
    /// to PREOP.
    Upload {
        /// The slave.
        slave: u8,
        /// The object; with `complete`, the first sub-index (0 or 1).
        object: Object,
        /// All sub-indices in one value (complete access).
        complete: bool,
        /// First byte of the piece wanted.
        offset: u16,
    },
    /// Write an object by SDO; answered by [`ServiceReply::Done`]. The transfer begins with the piece that completes
    /// the value.
    Download {
        /// The slave.
        slave: u8,
        /// The object; with `complete`, the first sub-index (0 or 1).
        object: Object,
        /// All sub-indices in one value (complete access).
        complete: bool,
        /// Length of the complete value, bytes.
        total: u16,
        /// Offset of this piece; pieces come in order.
        offset: u16,
        /// The piece.
        piece: Piece,
    },
    /// The indices of a slave's object dictionary (SDO information); answered by [`ServiceReply::Objects`].
    Objects {
        /// The slave.
        slave: u8,
        /// Number of the first index wanted, from 0.
        first: u16,
    },
    /// The description of an object (SDO information); answered by [`ServiceReply::Object`].
    DescribeObject {
        /// The slave.
        slave: u8,
        /// Index of the object.
        index: u16,
    },
    /// The description of an entry of an object (SDO information); answered by [`ServiceReply::Entry`].
    DescribeEntry {
        /// The slave.
        slave: u8,
        /// The entry.
        object: Object,
    },
    /// Read registers or memory of a slave controller; answered by [`ServiceReply::Piece`].
    Registers {
        /// The slave.
        slave: u8,
        /// First register.
        address: u16,
        /// Length, bytes; at most [`PIECE_BYTES_MAX`].
        length: u16,
    },
    /// Read the slave information memory; answered by [`ServiceReply::Piece`], shorter where the memory ends.
    Information {
        /// The slave.
        slave: u8,
        /// First word.
        word: u16,
        /// Length, bytes; at most [`PIECE_BYTES_MAX`].
        length: u16,
    },
    /// The error counters of a slave's ports; answered by [`ServiceReply::Errors`].
    Errors {
        /// The slave.
        slave: u8,
    },
    /// Reset the error counters of all slaves; answered by [`ServiceReply::Done`].
    ClearErrors,
    /// Open a file of a slave (FoE); answered by [`ServiceReply::Done`]. One file is open at a time.
    OpenFile {
        /// The slave.
        slave: u8,
        /// The file.
        file: FileRequest,
    },
    /// Read the next piece of the open file; answered by [`ServiceReply::FilePiece`].
    ReadFile {
        /// The slave.
        slave: u8,
    },
    /// Write the next piece of the open file; answered by [`ServiceReply::Done`].
    WriteFile {
        /// The slave.
        slave: u8,
        /// The piece; may be empty.
        piece: Piece,
        /// Whether this is the last piece.
        last: bool,
    },
    /// Close the open file, completed or not; answered by [`ServiceReply::Done`]. A slave in BOOT goes to INIT.
    CloseFile {
        /// The slave.
        slave: u8,
    },
}

/// A file of a slave, and how it is opened.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct FileRequest {
    /// Name of the file.
    pub name: Name,
    /// Password; 0 for none.
    pub password: u32,
    /// Whether the file is written; otherwise it is read.
    pub writes: bool,
    /// Whether the slave is brought to BOOT first, through INIT. Otherwise its mailbox is used as it is, and a slave in
    /// INIT is brought to PREOP.
    pub bootstrap: bool,
}

impl ServiceRequest {
    /// The slave that the request is about; `None` for requests about the whole bus.
    pub const fn slave(&self) -> Option<u8> {
        match *self {
            Self::Bus | Self::ClearErrors => None,
            Self::Slave { slave }
            | Self::SetState { slave, .. }
            | Self::Upload { slave, .. }
            | Self::Download { slave, .. }
            | Self::Objects { slave, .. }
            | Self::DescribeObject { slave, .. }
            | Self::DescribeEntry { slave, .. }
            | Self::Registers { slave, .. }
            | Self::Information { slave, .. }
            | Self::OpenFile { slave, .. }
            | Self::ReadFile { slave }
            | Self::WriteFile { slave, .. }
            | Self::CloseFile { slave }
            | Self::Errors { slave } => Some(slave),
        }
    }

    /// Whether the request may change a slave's state, objects, files or counters, or belongs to a transfer that does: it is
    /// carried out only where the application allows a change, and is not repeated after an interruption. Requests for the
    /// pieces of a file that is read count too. Other requests may still bring a slave in INIT to PREOP, to use its mailbox.
    pub const fn changes(&self) -> bool {
        let writes = matches!(self, Self::SetState { .. } | Self::Download { .. } | Self::ClearErrors);
        writes || self.is_about_files()
    }

    /// Whether the request belongs to a file transfer.
    pub const fn is_about_files(&self) -> bool {
        matches!(
            self,
            Self::OpenFile { .. } | Self::ReadFile { .. } | Self::WriteFile { .. } | Self::CloseFile { .. }
        )
    }
}

/// State of the whole bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BusInfo {
    /// Slaves that the supervisor knows.
    pub slaves: u8,
    /// Slaves that answered in the last cycle.
    pub answering: u16,
    /// The slaves' AL status registers, OR-ed together.
    pub al_status: u16,
    /// Whether all members were brought to OP.
    pub operational: bool,
    /// The slave with the reference clock, if clocks are distributed.
    pub reference_clock: Option<u8>,
}

/// One port of a slave controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PortInfo {
    /// Whether the port has a link to a partner.
    pub link: bool,
    /// Whether the port's loop is closed.
    pub loop_closed: bool,
    /// Whether the port receives frames.
    pub communicates: bool,
    /// The slave at the other end of the cable.
    pub partner: Option<u8>,
}

/// A slave's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ClockInfo {
    /// Whether the system time has 64 bits; otherwise it has 32.
    pub is_64_bit: bool,
    /// Delay of the frames from the reference clock, ns.
    pub delay_ns: u32,
    /// Difference to the reference clock as measured by the slave, ns; bits beyond 31 are cut off.
    pub difference_ns: i32,
}

/// Description of one slave.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SlaveInfo {
    /// Station address.
    pub station: u16,
    /// Configured alias from the SII.
    pub alias: u16,
    /// Number set with its identification switches, if it has such.
    pub switch: Option<u16>,
    /// Identity.
    pub identity: Identity,
    /// Name from the SII, or else of the driver; empty if there is neither.
    pub name: Name,
    /// Name of the driver; empty for devices without a driver.
    pub driver: Name,
    /// Its number among the application's members, if it is used.
    pub member: Option<u8>,
    /// AL state, error flag and code.
    pub report: AlReport,
    /// Status word, if the device type has one and the mailbox works.
    pub status_word: Option<u16>,
    /// Mailbox that the master writes.
    pub mailbox_out: MailboxWindow,
    /// Mailbox that the master reads.
    pub mailbox_in: MailboxWindow,
    /// Mailbox protocols, see [`sii`](super::wire::sii).
    pub protocols: u16,
    /// Bytes of cyclic outputs: those that are exchanged, or would be in SAFEOP as the slave describes them. 0 for a slave
    /// with a driver that has not chosen them yet.
    pub output_bytes: u16,
    /// Bytes of cyclic inputs, likewise.
    pub input_bytes: u16,
    /// The ports, 0 to 3.
    pub ports: [PortInfo; PORTS],
    /// Its clock, if it has one.
    pub clock: Option<ClockInfo>,
    /// Its last emergency since it was configured.
    pub emergency: Option<Emergency>,
}

/// Error counters of one slave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SlaveErrors {
    /// The ports, 0 to 3.
    pub ports: [PortErrors; PORTS],
    /// The slave at the other end of each port's cable.
    pub partners: [Option<u8>; PORTS],
    /// Errors of the processing unit: frames that were not EtherCAT.
    pub processing_unit: u8,
    /// Errors of the slave's own processor interface.
    pub processor_interface: u8,
    /// Expiries of the process-data watchdog.
    pub watchdog: u8,
}

/// The description of an object.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ObjectInfo {
    /// Index.
    pub index: u16,
    /// Data type, CiA 301's number.
    pub data_type: u16,
    /// Highest sub-index.
    pub sub_max: u8,
    /// Kind: 7 variable, 8 array, 9 record.
    pub code: u8,
    /// Name.
    pub name: Name,
}

/// The description of an entry.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct EntryInfo {
    /// The entry.
    pub object: Object,
    /// Data type, CiA 301's number.
    pub data_type: u16,
    /// Length, bits.
    pub bits: u16,
    /// Access: bits 0 to 2 read in PREOP, SAFEOP, OP; bits 3 to 5 write; bit 6 RxPDO, bit 7 TxPDO.
    pub access: u16,
    /// Name.
    pub name: Name,
}

/// An answer.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[allow(clippy::large_enum_variant)] // one is alive at a time, in static memory
pub enum ServiceReply {
    /// The request was carried out.
    Done,
    /// Answer to [`ServiceRequest::Bus`].
    Bus(BusInfo),
    /// Answer to [`ServiceRequest::Slave`].
    Slave(SlaveInfo),
    /// Answer to [`ServiceRequest::SetState`]: the actual state.
    State(AlReport),
    /// A part of a value.
    Piece {
        /// Length of the complete value, bytes.
        total: u16,
        /// The requested part.
        piece: Piece,
    },
    /// Answer to [`ServiceRequest::Objects`].
    Objects {
        /// Number of objects in total.
        total: u16,
        /// Indices from the first one requested.
        indices: Vec<u16, INDICES_MAX>,
    },
    /// Answer to [`ServiceRequest::DescribeObject`].
    Object(ObjectInfo),
    /// Answer to [`ServiceRequest::DescribeEntry`].
    Entry(EntryInfo),
    /// Answer to [`ServiceRequest::Errors`].
    Errors(SlaveErrors),
    /// Answer to [`ServiceRequest::ReadFile`].
    FilePiece {
        /// The piece; may be empty.
        piece: Piece,
        /// Whether the file ends behind it.
        last: bool,
    },
}

/// Why a request was not carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ServiceError {
    /// There is no such slave.
    NoSlave {
        /// Number of slaves.
        slaves: u8,
    },
    /// The slave has no mailbox, or does not support CoE.
    NoCoe,
    /// The slave has no mailbox, or does not support FoE.
    NoFoe,
    /// The application does not allow the request at present; the number is its reason.
    NotAllowed(u8),
    /// Another request is in progress, or the bus is being brought up or repaired.
    Busy,
    /// The bus changed meanwhile; repeat the request.
    Interrupted,
    /// Pieces are out of order, or the value is too long.
    Piece {
        /// Longest value, bytes.
        room: u16,
    },
    /// The request failed on the bus.
    Bus(BusError),
}

/// Result of a service request.
pub type ServiceResult = Result<ServiceReply, ServiceError>;
