//! Process data objects of the SII, each with the number of entries given in its header.
//!
//! Header and entry take eight bytes each, so a master reads one of them in each access to a slave that returns eight
//! bytes. Layout: IEC 61158-6-12 (slave information interface), ETG.2010 for the flags.
//!
//! Invariant: a PDO is returned with all its entries or not at all.

use super::record::{Record, Records};
use crate::wire::{Error, check_len, check_room, read_u8, read_u16, write_bytes};

/// Sync manager number of a PDO that is not assigned to one.
pub const SYNC_MANAGER_NONE: u8 = 0xFF;
/// [`PdoRecord::flags`]: mandatory.
pub const PDO_MANDATORY: u16 = 1 << 0;
/// [`PdoRecord::flags`]: assigned by default.
pub const PDO_DEFAULT: u16 = 1 << 1;
/// [`PdoRecord::flags`]: its entries cannot be changed.
pub const PDO_FIXED_CONTENT: u16 = 1 << 4;
/// [`PdoRecord::flags`]: its entries are defined elsewhere.
pub const PDO_VIRTUAL_CONTENT: u16 = 1 << 5;

/// A process data object's header.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PdoRecord {
    /// Object index: 0x1600 and above are received by the slave, 0x1A00 and above are sent by it.
    pub index: u16,
    /// Number of entries that follow.
    pub entries: u8,
    /// Sync manager to which the PDO is assigned, or [`SYNC_MANAGER_NONE`].
    pub sync_manager: u8,
    /// Synchronisation by distributed clocks, vendor-specific.
    pub synchronization: u8,
    /// String number of its name.
    pub name: u8,
    /// Flags, see the `PDO_` constants.
    pub flags: u16,
}

impl Record for PdoRecord {
    const LEN: usize = 8;

    fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, Self::LEN)?;
        Ok(Self {
            index: read_u16(bytes, 0),
            entries: read_u8(bytes, 2),
            sync_manager: read_u8(bytes, 3),
            synchronization: read_u8(bytes, 4),
            name: read_u8(bytes, 5),
            flags: read_u16(bytes, 6),
        })
    }

    fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        check_room(bytes, Self::LEN)?;
        write_bytes(bytes, 0, &self.index.to_le_bytes());
        write_bytes(
            bytes,
            2,
            &[self.entries, self.sync_manager, self.synchronization, self.name],
        );
        write_bytes(bytes, 6, &self.flags.to_le_bytes());
        Ok(())
    }
}

/// One object in a process data object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PdoEntryRecord {
    /// Object index; 0 is a gap.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// String number of its name.
    pub name: u8,
    /// Data type, an index of the type area of CiA 301.
    pub data_type: u8,
    /// Length, bits.
    pub bits: u8,
    /// Reserved.
    pub flags: u16,
}

impl Record for PdoEntryRecord {
    const LEN: usize = 8;

    fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, Self::LEN)?;
        Ok(Self {
            index: read_u16(bytes, 0),
            sub: read_u8(bytes, 2),
            name: read_u8(bytes, 3),
            data_type: read_u8(bytes, 4),
            bits: read_u8(bytes, 5),
            flags: read_u16(bytes, 6),
        })
    }

    fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        check_room(bytes, Self::LEN)?;
        write_bytes(bytes, 0, &self.index.to_le_bytes());
        write_bytes(bytes, 2, &[self.sub, self.name, self.data_type, self.bits]);
        write_bytes(bytes, 6, &self.flags.to_le_bytes());
        Ok(())
    }
}

/// A process data object with its entries.
#[derive(Clone, Copy, Debug)]
pub struct Pdo<'a> {
    /// Its header.
    pub record: PdoRecord,
    entries: &'a [u8],
}

impl<'a> Pdo<'a> {
    /// Its entries in the order of the process data.
    pub const fn entries(&self) -> Records<'a, PdoEntryRecord> {
        Records::new(self.entries)
    }

    /// Total length of its entries, bits.
    pub fn bits(&self) -> u32 {
        self.entries().map(|entry| u32::from(entry.bits)).sum()
    }
}

/// Walks the process data objects of a category; ends after the first error or at padding.
#[derive(Clone, Debug)]
pub struct Pdos<'a> {
    data: &'a [u8],
}

impl<'a> Pdos<'a> {
    /// The PDOs in a category's data.
    pub const fn new(data: &'a [u8]) -> Self {
        Self { data }
    }

    fn take(&mut self) -> Result<Pdo<'a>, Error> {
        let data = core::mem::take(&mut self.data);
        let record = PdoRecord::parse(data)?;
        let end = PdoRecord::LEN + usize::from(record.entries) * PdoEntryRecord::LEN;
        check_len(data, end)?;
        self.data = data.get(end..).unwrap_or(&[]);
        Ok(Pdo {
            record,
            entries: data.get(PdoRecord::LEN..end).unwrap_or(&[]),
        })
    }
}

impl<'a> Iterator for Pdos<'a> {
    /// [`Error::Truncated`] when the category ends within a PDO.
    type Item = Result<Pdo<'a>, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.data.len() < PdoRecord::LEN || read_u16(self.data, 0) == 0 {
            return None;
        }
        Some(self.take())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pdo_that_is_cut_is_an_error_and_the_last() {
        let mut data = [0; 40];
        let pdo = |index, entries| PdoRecord {
            index,
            entries,
            ..PdoRecord::default()
        };
        pdo(0x1A00, 1).emit(&mut data).unwrap();
        let entry = PdoEntryRecord {
            index: 0x6041,
            bits: 16,
            ..PdoEntryRecord::default()
        };
        entry.emit(&mut data[8..]).unwrap();
        pdo(0x1A01, 3).emit(&mut data[16..]).unwrap();
        let mut pdos = Pdos::new(&data);
        let first = pdos.next().unwrap().unwrap();
        assert_eq!((first.bits(), first.entries().next()), (16, Some(entry)));
        let error = Error::Truncated {
            expected: 32,
            actual: 24,
        };
        assert_eq!(pdos.next().map(Result::err), Some(Some(error)));
        assert!(pdos.next().is_none());
        data[18] = 0;
        assert_eq!(Pdos::new(&data).count(), 2, "zeros behind are padding");
        assert_eq!(Pdos::new(&data[..23]).count(), 1, "so is less than a header");
    }
}
