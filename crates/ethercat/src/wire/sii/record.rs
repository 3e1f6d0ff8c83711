//! Records of fixed length: sync managers, FMMUs, sync units, clocks, PDOs and their entries.
//!
//! A master that reads through registers parses records one by one; [`Records`] walks the bytes of a slice. Layouts:
//! IEC 61158-6-12 (slave information interface), ETG.2010 for the extended FMMUs and the sync units.
//!
//! Invariant: a record is parsed completely or not at all; excess bytes at a category's end are padding.

use crate::wire::{Error, check_len, check_room, read_u8, read_u16, read_u32, write_bytes};
use core::marker::PhantomData;

/// A record of fixed length.
pub trait Record: Sized {
    /// Bytes of one record.
    const LEN: usize;

    /// Reads a record from the start of `bytes`.
    ///
    /// # Errors
    /// [`Error::Truncated`] below [`Self::LEN`] bytes.
    fn parse(bytes: &[u8]) -> Result<Self, Error>;

    /// Writes a record to the start of `bytes`; reserved bytes become 0.
    ///
    /// # Errors
    /// [`Error::Room`] below [`Self::LEN`] bytes.
    fn emit(&self, bytes: &mut [u8]) -> Result<(), Error>;
}

/// The records of a category, one after the other.
#[derive(Clone, Debug)]
pub struct Records<'a, R> {
    data: &'a [u8],
    record: PhantomData<R>,
}

impl<'a, R: Record> Records<'a, R> {
    /// The records in `data`.
    pub const fn new(data: &'a [u8]) -> Self {
        Self {
            data,
            record: PhantomData,
        }
    }
}

impl<R: Record> Iterator for Records<'_, R> {
    type Item = R;

    fn next(&mut self) -> Option<R> {
        let record = R::parse(self.data).ok()?;
        self.data = self.data.get(R::LEN.max(1)..)?;
        Some(record)
    }
}

/// Use of a sync manager.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SyncManagerUse {
    /// Not used.
    #[default]
    Unused,
    /// Mailbox that the master writes.
    MailboxOut,
    /// Mailbox that the master reads.
    MailboxIn,
    /// Process data that the master writes.
    Outputs,
    /// Process data that the master reads.
    Inputs,
    /// An unknown use.
    Other(u8),
}

impl From<u8> for SyncManagerUse {
    fn from(number: u8) -> Self {
        match number {
            0 => Self::Unused,
            1 => Self::MailboxOut,
            2 => Self::MailboxIn,
            3 => Self::Outputs,
            4 => Self::Inputs,
            other => Self::Other(other),
        }
    }
}

impl From<SyncManagerUse> for u8 {
    fn from(usage: SyncManagerUse) -> Self {
        match usage {
            SyncManagerUse::Unused => 0,
            SyncManagerUse::MailboxOut => 1,
            SyncManagerUse::MailboxIn => 2,
            SyncManagerUse::Outputs => 3,
            SyncManagerUse::Inputs => 4,
            SyncManagerUse::Other(other) => other,
        }
    }
}

/// Default settings of a sync manager.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SyncManagerRecord {
    /// First byte of the window.
    pub start: u16,
    /// Length of the window, bytes; 0 if it depends on the PDOs.
    pub length: u16,
    /// Control byte of the register.
    pub control: u8,
    /// Status byte of the register; has no meaning here.
    pub status: u8,
    /// Flags, see the `SYNC_MANAGER_` constants.
    pub flags: u8,
    /// Use of the sync manager.
    pub usage: SyncManagerUse,
}

/// [`SyncManagerRecord::flags`]: to be enabled.
pub const SYNC_MANAGER_ENABLED: u8 = 1 << 0;
/// [`SyncManagerRecord::flags`]: its content is fixed.
pub const SYNC_MANAGER_FIXED_CONTENT: u8 = 1 << 1;
/// [`SyncManagerRecord::flags`]: a virtual sync manager without hardware.
pub const SYNC_MANAGER_VIRTUAL: u8 = 1 << 2;
/// [`SyncManagerRecord::flags`]: to be enabled in OP only.
pub const SYNC_MANAGER_OPERATIONAL_ONLY: u8 = 1 << 3;

impl Record for SyncManagerRecord {
    const LEN: usize = 8;

    fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, Self::LEN)?;
        Ok(Self {
            start: read_u16(bytes, 0),
            length: read_u16(bytes, 2),
            control: read_u8(bytes, 4),
            status: read_u8(bytes, 5),
            flags: read_u8(bytes, 6),
            usage: read_u8(bytes, 7).into(),
        })
    }

    fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        check_room(bytes, Self::LEN)?;
        write_bytes(bytes, 0, &self.start.to_le_bytes());
        write_bytes(bytes, 2, &self.length.to_le_bytes());
        write_bytes(bytes, 4, &[self.control, self.status, self.flags, self.usage.into()]);
        Ok(())
    }
}

/// Use of an FMMU; one byte each, padded with 0xFF.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FmmuUse {
    /// Not used.
    #[default]
    Unused,
    /// Process data that the master writes.
    Outputs,
    /// Process data that the master reads.
    Inputs,
    /// The status of the mailbox that the master reads.
    MailboxState,
    /// An unknown use; 0xFF is padding.
    Other(u8),
}

impl Record for FmmuUse {
    const LEN: usize = 1;

    fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, Self::LEN)?;
        Ok(match read_u8(bytes, 0) {
            0 => Self::Unused,
            1 => Self::Outputs,
            2 => Self::Inputs,
            3 => Self::MailboxState,
            other => Self::Other(other),
        })
    }

    fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        check_room(bytes, Self::LEN)?;
        let number = match self {
            Self::Unused => 0,
            Self::Outputs => 1,
            Self::Inputs => 2,
            Self::MailboxState => 3,
            Self::Other(other) => *other,
        };
        write_bytes(bytes, 0, &[number]);
        Ok(())
    }
}

/// The sync manager to which an FMMU belongs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FmmuExtended {
    /// Bit 0: to be enabled in OP only.
    pub flags: u8,
    /// The sync manager.
    pub sync_manager: u8,
    /// The sync unit.
    pub sync_unit: u8,
}

impl Record for FmmuExtended {
    const LEN: usize = 3;

    fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, Self::LEN)?;
        Ok(Self {
            flags: read_u8(bytes, 0),
            sync_manager: read_u8(bytes, 1),
            sync_unit: read_u8(bytes, 2),
        })
    }

    fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        check_room(bytes, Self::LEN)?;
        write_bytes(bytes, 0, &[self.flags, self.sync_manager, self.sync_unit]);
        Ok(())
    }
}

/// Flags of a sync unit: process data that are valid together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SyncUnit(pub u8);

impl Record for SyncUnit {
    const LEN: usize = 1;

    fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, Self::LEN)?;
        Ok(Self(read_u8(bytes, 0)))
    }

    fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        check_room(bytes, Self::LEN)?;
        write_bytes(bytes, 0, &[self.0]);
        Ok(())
    }
}

/// One operation mode of the distributed clocks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClockRecord {
    /// Cycle time of SYNC0, ns; 0 for the master's cycle time.
    pub cycle_time_ns: u32,
    /// Shift of SYNC0, ns.
    pub shift_sync0_ns: i32,
    /// Shift of SYNC1, ns.
    pub shift_sync1_ns: i32,
    /// Cycle of SYNC1 in cycles of SYNC0.
    pub factor_sync1: i16,
    /// Value of the registers 0x0980 and 0x0981; 0 for free run.
    pub assign_activate: u16,
    /// Cycle of SYNC0 in cycles of the master; negative for a fraction of a cycle.
    pub factor_sync0: i16,
    /// String number of its name.
    pub name: u8,
    /// String number of its description.
    pub description: u8,
}

impl Record for ClockRecord {
    const LEN: usize = 24;

    fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, Self::LEN)?;
        Ok(Self {
            cycle_time_ns: read_u32(bytes, 0),
            shift_sync0_ns: read_u32(bytes, 4).cast_signed(),
            shift_sync1_ns: read_u32(bytes, 8).cast_signed(),
            factor_sync1: read_u16(bytes, 12).cast_signed(),
            assign_activate: read_u16(bytes, 14),
            factor_sync0: read_u16(bytes, 16).cast_signed(),
            name: read_u8(bytes, 18),
            description: read_u8(bytes, 19),
        })
    }

    fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        check_room(bytes, Self::LEN)?;
        write_bytes(bytes, 0, &self.cycle_time_ns.to_le_bytes());
        write_bytes(bytes, 4, &self.shift_sync0_ns.to_le_bytes());
        write_bytes(bytes, 8, &self.shift_sync1_ns.to_le_bytes());
        write_bytes(bytes, 12, &self.factor_sync1.to_le_bytes());
        write_bytes(bytes, 14, &self.assign_activate.to_le_bytes());
        write_bytes(bytes, 16, &self.factor_sync0.to_le_bytes());
        write_bytes(bytes, 18, &[self.name, self.description, 0, 0, 0, 0]);
        Ok(())
    }
}
