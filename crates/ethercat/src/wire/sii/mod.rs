//! The slave information interface (SII): the configuration memory of a slave.
//!
//! The memory is addressed in 16-bit words. A fixed part holds identity and mailboxes; categories follow, each with a
//! type word and a length in words, up to [`CATEGORY_END`]. Layout: IEC 61158-6-12, slave information interface;
//! ETG.2010.
//!
//! Two readers share the structures. [`Sii`] is a view of a complete image. A master that reads through registers asks
//! a [`CategoryWalker`] which words it needs, and parses records from the few bytes of each read access.
//!
//! Invariant: nothing is copied and every walk ends; `configure` reads from a slave.

mod category;
mod general;
mod pdo;
mod record;
mod text;

pub use category::{CATEGORIES_MAX, CATEGORY_HEADER_WORDS, Categories, CategoryHeader, CategoryWalker, ChainEnd};
pub use general::{
    COE_COMPLETE_ACCESS, COE_PDO_ASSIGN, COE_PDO_CONFIGURE, COE_SDO, COE_SDO_INFORMATION, COE_UPLOAD_AT_START,
    FLAG_IDENTITY_IN_AL_STATUS, FLAG_IDENTITY_IN_MEMORY, FLAG_MAILBOX_REPEAT, FLAG_NO_LRW, FLAG_SAFE_OPERATIONAL,
    General, PortKind,
};
pub use pdo::{
    PDO_DEFAULT, PDO_FIXED_CONTENT, PDO_MANDATORY, PDO_VIRTUAL_CONTENT, Pdo, PdoEntryRecord, PdoRecord, Pdos,
    SYNC_MANAGER_NONE,
};
pub use record::{
    ClockRecord, FmmuExtended, FmmuUse, Record, Records, SYNC_MANAGER_ENABLED, SYNC_MANAGER_FIXED_CONTENT,
    SYNC_MANAGER_OPERATIONAL_ONLY, SYNC_MANAGER_VIRTUAL, SyncManagerRecord, SyncManagerUse, SyncUnit,
};
pub use text::Strings;

use super::{Error, check_len, check_room, read_u8, read_u16, read_u32, write_bytes};

/// Word address of the PDI's control and configuration, loaded into the slave controller's registers at power-up.
pub const WORD_PDI_CONTROL: u16 = 0x00;
/// Word address of the configured station alias.
pub const WORD_ALIAS: u16 = 0x04;

/// Word address of the checksum (low byte) over the first seven words.
pub const WORD_CHECKSUM: u16 = 0x07;
/// Word address of the vendor number, 2 words.
pub const WORD_VENDOR: u16 = 0x08;
/// Word address of the product code, 2 words.
pub const WORD_PRODUCT: u16 = 0x0A;
/// Word address of the revision, 2 words.
pub const WORD_REVISION: u16 = 0x0C;
/// Word address of the serial number, 2 words.
pub const WORD_SERIAL: u16 = 0x0E;
/// Word address of the bootstrap mailbox that the master writes: offset and size.
pub const WORD_BOOTSTRAP_OUT: u16 = 0x14;
/// Word address of the bootstrap mailbox that the master reads: offset and size.
pub const WORD_BOOTSTRAP_IN: u16 = 0x16;
/// Word address of the standard mailbox that the master writes: offset and size.
pub const WORD_MAILBOX_OUT: u16 = 0x18;
/// Word address of the standard mailbox that the master reads: offset and size.
pub const WORD_MAILBOX_IN: u16 = 0x1A;
/// Word address of the mailbox protocols, see the `PROTOCOL_` constants.
pub const WORD_PROTOCOLS: u16 = 0x1C;
/// Word address of the memory's size in KiBit, minus one.
pub const WORD_SIZE: u16 = 0x3E;
/// Word address of the layout's version.
pub const WORD_VERSION: u16 = 0x3F;
/// Word address of the first category.
pub const WORD_CATEGORIES: u16 = 0x40;

/// Mailbox protocol bit: ADS over EtherCAT.
pub const PROTOCOL_AOE: u16 = 1 << 0;
/// Mailbox protocol bit: Ethernet over EtherCAT.
pub const PROTOCOL_EOE: u16 = 1 << 1;
/// Mailbox protocol bit: CAN application protocol over EtherCAT.
pub const PROTOCOL_COE: u16 = 1 << 2;
/// Mailbox protocol bit: file access over EtherCAT.
pub const PROTOCOL_FOE: u16 = 1 << 3;
/// Mailbox protocol bit: servo drive profile over EtherCAT.
pub const PROTOCOL_SOE: u16 = 1 << 4;
/// Mailbox protocol bit: defined by the vendor.
pub const PROTOCOL_VOE: u16 = 1 << 5;

/// Category: strings, counted from 1.
pub const CATEGORY_STRINGS: u16 = 10;
/// Category: data types, reserved.
pub const CATEGORY_DATA_TYPES: u16 = 20;
/// Category: general information.
pub const CATEGORY_GENERAL: u16 = 30;
/// Category: use of the FMMUs, one byte each.
pub const CATEGORY_FMMU: u16 = 40;
/// Category: sync managers, eight bytes each.
pub const CATEGORY_SYNC_MANAGER: u16 = 41;
/// Category: sync manager and sync unit of each FMMU, three bytes each.
pub const CATEGORY_FMMU_EXTENDED: u16 = 42;
/// Category: sync units, one byte each.
pub const CATEGORY_SYNC_UNIT: u16 = 43;
/// Category: process data objects sent by the slave.
pub const CATEGORY_TX_PDO: u16 = 50;
/// Category: process data objects received by the slave.
pub const CATEGORY_RX_PDO: u16 = 51;
/// Category: distributed clocks.
pub const CATEGORY_CLOCKS: u16 = 60;
/// End of the categories.
pub const CATEGORY_END: u16 = 0xFFFF;

/// Words of the fixed part that [`FixedPart::parse`] needs, from word 0.
pub const FIXED_PART_WORDS: usize = 0x1D;

/// Identity of a slave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Identity {
    /// Vendor number.
    pub vendor: u32,
    /// Product code, assigned by the vendor.
    pub product: u32,
    /// Revision of the product.
    pub revision: u32,
    /// Serial number; 0 if there is none.
    pub serial: u32,
}

/// Address and length of a mailbox in the slave's memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MailboxWindow {
    /// First byte.
    pub start: u16,
    /// Length, bytes; 0 if there is no mailbox.
    pub length: u16,
}

impl MailboxWindow {
    /// Parses the two words at a word address of the SII.
    fn parse(bytes: &[u8], word: u16) -> Self {
        let at = usize::from(word) * 2;
        Self {
            start: read_u16(bytes, at),
            length: read_u16(bytes, at + 2),
        }
    }
}

/// The fields of the fixed part that a master needs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FixedPart {
    /// Identity of the slave.
    pub identity: Identity,
    /// Mailbox that the master writes.
    pub mailbox_out: MailboxWindow,
    /// Mailbox that the master reads.
    pub mailbox_in: MailboxWindow,
    /// Protocols of the mailbox, see the `PROTOCOL_` constants.
    pub protocols: u16,
}

impl FixedPart {
    /// Parses the fixed part from the SII's first bytes.
    ///
    /// # Errors
    /// [`Error::Truncated`] below [`FIXED_PART_WORDS`] words.
    pub fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, 2 * FIXED_PART_WORDS)?;
        let byte = |word: u16| usize::from(word) * 2;
        Ok(Self {
            identity: Identity {
                vendor: read_u32(bytes, byte(WORD_VENDOR)),
                product: read_u32(bytes, byte(WORD_PRODUCT)),
                revision: read_u32(bytes, byte(WORD_REVISION)),
                serial: read_u32(bytes, byte(WORD_SERIAL)),
            },
            mailbox_out: MailboxWindow::parse(bytes, WORD_MAILBOX_OUT),
            mailbox_in: MailboxWindow::parse(bytes, WORD_MAILBOX_IN),
            protocols: read_u16(bytes, byte(WORD_PROTOCOLS)),
        })
    }
}

/// All fields before the categories, including the [`FixedPart`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// PDI control register.
    pub pdi_control: u16,
    /// PDI configuration register.
    pub pdi_configuration: u16,
    /// Length of SYNC pulses, in units of 10 ns.
    pub sync_impulse_10_ns: u16,
    /// Extended PDI configuration register.
    pub pdi_configuration_extended: u16,
    /// Configured station alias.
    pub alias: u16,
    /// Checksum over the seven words before it, as read.
    pub checksum: u8,
    /// Identity, standard mailboxes and protocols.
    pub fixed: FixedPart,
    /// Mailbox that the master writes in BOOTSTRAP.
    pub bootstrap_out: MailboxWindow,
    /// Mailbox that the master reads in BOOTSTRAP.
    pub bootstrap_in: MailboxWindow,
    /// Size of the memory in KiBit, minus one.
    pub size: u16,
    /// Version of the layout.
    pub version: u16,
}

impl Header {
    /// Bytes before the categories.
    pub const LEN: usize = 2 * WORD_CATEGORIES as usize;

    /// Parses the SII's first words.
    ///
    /// # Errors
    /// [`Error::Truncated`] below [`Self::LEN`] bytes.
    pub fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, Self::LEN)?;
        let word = |word: u16| read_u16(bytes, usize::from(word) * 2);
        Ok(Self {
            pdi_control: word(WORD_PDI_CONTROL),
            pdi_configuration: word(WORD_PDI_CONTROL + 1),
            sync_impulse_10_ns: word(WORD_PDI_CONTROL + 2),
            pdi_configuration_extended: word(WORD_PDI_CONTROL + 3),
            alias: word(WORD_ALIAS),
            checksum: word(WORD_CHECKSUM) as u8,
            fixed: FixedPart::parse(bytes)?,
            bootstrap_out: MailboxWindow::parse(bytes, WORD_BOOTSTRAP_OUT),
            bootstrap_in: MailboxWindow::parse(bytes, WORD_BOOTSTRAP_IN),
            size: word(WORD_SIZE),
            version: word(WORD_VERSION),
        })
    }

    /// Writes the SII's first words. The checksum is computed, regardless of [`Self::checksum`], and reserved words
    /// become 0.
    ///
    /// # Errors
    /// [`Error::Room`] below [`Self::LEN`] bytes.
    pub fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        check_room(bytes, Self::LEN)?;
        bytes.iter_mut().take(Self::LEN).for_each(|byte| *byte = 0);
        let identity = &self.fixed.identity;
        let mut put = |word: u16, value: &[u8]| write_bytes(bytes, usize::from(word) * 2, value);
        put(WORD_PDI_CONTROL, &self.pdi_control.to_le_bytes());
        put(WORD_PDI_CONTROL + 1, &self.pdi_configuration.to_le_bytes());
        put(WORD_PDI_CONTROL + 2, &self.sync_impulse_10_ns.to_le_bytes());
        put(WORD_PDI_CONTROL + 3, &self.pdi_configuration_extended.to_le_bytes());
        put(WORD_ALIAS, &self.alias.to_le_bytes());
        put(WORD_VENDOR, &identity.vendor.to_le_bytes());
        put(WORD_PRODUCT, &identity.product.to_le_bytes());
        put(WORD_REVISION, &identity.revision.to_le_bytes());
        put(WORD_SERIAL, &identity.serial.to_le_bytes());
        for (word, window) in [
            (WORD_BOOTSTRAP_OUT, self.bootstrap_out),
            (WORD_BOOTSTRAP_IN, self.bootstrap_in),
            (WORD_MAILBOX_OUT, self.fixed.mailbox_out),
            (WORD_MAILBOX_IN, self.fixed.mailbox_in),
        ] {
            put(word, &window.start.to_le_bytes());
            put(word + 1, &window.length.to_le_bytes());
        }
        put(WORD_PROTOCOLS, &self.fixed.protocols.to_le_bytes());
        put(WORD_SIZE, &self.size.to_le_bytes());
        put(WORD_VERSION, &self.version.to_le_bytes());
        let checksum = checksum(bytes);
        write_bytes(bytes, usize::from(WORD_CHECKSUM) * 2, &[checksum]);
        Ok(())
    }

    /// Size of the memory, bytes; at least 128.
    pub const fn memory_bytes(&self) -> u32 {
        (self.size as u32 + 1) * 128
    }

    /// Whether the memory was never written: no vendor has the number 0 or 0xFFFF_FFFF.
    pub const fn is_blank(&self) -> bool {
        matches!(self.fixed.identity.vendor, 0 | u32::MAX)
    }
}

/// An SII in memory, from word 0.
#[derive(Clone, Copy, Debug)]
pub struct Sii<'a> {
    image: &'a [u8],
}

impl<'a> Sii<'a> {
    /// A view of `image`, which may be incomplete: bytes beyond its end do not exist.
    ///
    /// # Errors
    /// [`Error::Truncated`] when the part before the categories is incomplete.
    pub fn new_checked(image: &'a [u8]) -> Result<Self, Error> {
        check_len(image, Header::LEN)?;
        Ok(Self { image })
    }

    /// All fields before the categories.
    pub fn header(&self) -> Header {
        Header::parse(self.image).unwrap_or_default()
    }

    /// Whether the checksum over the first seven words is right.
    pub fn checksum_is_right(&self) -> bool {
        checksum(self.image) == read_u8(self.image, usize::from(WORD_CHECKSUM) * 2)
    }

    /// The categories in order, including unknown ones.
    pub fn categories(&self) -> Categories<'a> {
        Categories::new(self.image)
    }

    /// The data of the first category of a kind; empty when there is none.
    pub fn category(&self, kind: u16) -> &'a [u8] {
        self.categories()
            .find(|(category, _)| category.kind == kind)
            .map_or(&[], |(_, data)| data)
    }

    /// The strings.
    pub fn strings(&self) -> Strings<'a> {
        Strings::new(self.category(CATEGORY_STRINGS))
    }

    /// The general category, if it is there.
    pub fn general(&self) -> Option<General> {
        General::parse(self.category(CATEGORY_GENERAL)).ok()
    }

    /// The use of each FMMU, padding included.
    pub fn fmmus(&self) -> Records<'a, FmmuUse> {
        Records::new(self.category(CATEGORY_FMMU))
    }

    /// The sync managers.
    pub fn sync_managers(&self) -> Records<'a, SyncManagerRecord> {
        Records::new(self.category(CATEGORY_SYNC_MANAGER))
    }

    /// The sync manager of each FMMU.
    pub fn fmmus_extended(&self) -> Records<'a, FmmuExtended> {
        Records::new(self.category(CATEGORY_FMMU_EXTENDED))
    }

    /// The sync units, padding included.
    pub fn sync_units(&self) -> Records<'a, SyncUnit> {
        Records::new(self.category(CATEGORY_SYNC_UNIT))
    }

    /// The process data objects that the slave sends.
    pub fn tx_pdos(&self) -> Pdos<'a> {
        Pdos::new(self.category(CATEGORY_TX_PDO))
    }

    /// The process data objects that the slave receives.
    pub fn rx_pdos(&self) -> Pdos<'a> {
        Pdos::new(self.category(CATEGORY_RX_PDO))
    }

    /// The supported operation modes of the distributed clocks.
    pub fn clocks(&self) -> Records<'a, ClockRecord> {
        Records::new(self.category(CATEGORY_CLOCKS))
    }
}

/// Checksum over the first seven words: CRC-8 with polynomial x8+x2+x+1, start value 0xFF.
///
/// Bytes beyond the fourteenth are ignored; missing bytes count as 0.
pub fn checksum(bytes: &[u8]) -> u8 {
    (0..2 * usize::from(WORD_CHECKSUM)).fold(0xFF, |crc, offset| {
        (0..8).fold(crc ^ read_u8(bytes, offset), |crc, _| {
            if crc & 0x80 != 0 { (crc << 1) ^ 0x07 } else { crc << 1 }
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn erased_memory_is_blank_and_a_short_one_has_no_fixed_part() {
        for byte in [0, 0xFF] {
            let image = [byte; 128];
            assert!(Sii::new_checked(&image).unwrap().header().is_blank());
        }
        let short = FixedPart::parse(&[0; 57]).err();
        let expected = Error::Truncated {
            expected: 58,
            actual: 57,
        };
        assert_eq!(short, Some(expected));
    }
}
