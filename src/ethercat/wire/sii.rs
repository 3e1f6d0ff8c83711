//! Layout of the slave information interface: the configuration memory of a slave.
//!
//! It is addressed in 16-bit words. A fixed part holds identity and mailboxes, then categories follow, each with a type
//! word and a length in words, up to [`CATEGORY_END`]. Layout: IEC 61158-6-12, slave information interface.
//!
//! Invariant: constants and plain field structures; reading them from a slave is `configure`'s work.

use super::{Error, check_len, read_u8, read_u16, read_u32};
use serde::{Deserialize, Serialize};

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

/// Category: strings, counted from 1.
pub const CATEGORY_STRINGS: u16 = 10;
/// Category: general information.
pub const CATEGORY_GENERAL: u16 = 30;
/// Category: use of the FMMUs, one byte each.
pub const CATEGORY_FMMU: u16 = 40;
/// Category: sync managers, eight bytes each.
pub const CATEGORY_SYNC_MANAGER: u16 = 41;
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

/// Who a slave is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Vendor number.
    pub vendor: u32,
    /// Product code of that vendor.
    pub product: u32,
    /// Revision of the product.
    pub revision: u32,
    /// Serial number, 0 where there is none.
    pub serial: u32,
}

/// Where a mailbox lies in the slave's memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MailboxWindow {
    /// First byte.
    pub start: u16,
    /// Bytes; 0 where there is no mailbox.
    pub length: u16,
}

/// The fixed part, as far as a master needs it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FixedPart {
    /// Who the slave is.
    pub identity: Identity,
    /// Mailbox that the master writes.
    pub mailbox_out: MailboxWindow,
    /// Mailbox that the master reads.
    pub mailbox_in: MailboxWindow,
    /// Protocols of the mailbox, see the `PROTOCOL_` constants.
    pub protocols: u16,
}

impl FixedPart {
    /// Reads the fixed part from the SII's first bytes.
    ///
    /// # Errors
    /// [`Error::Truncated`] below [`FIXED_PART_WORDS`] words.
    pub fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, 2 * FIXED_PART_WORDS)?;
        let byte = |word: u16| usize::from(word) * 2;
        let window = |word: u16| MailboxWindow {
            start: read_u16(bytes, byte(word)),
            length: read_u16(bytes, byte(word) + 2),
        };
        Ok(Self {
            identity: Identity {
                vendor: read_u32(bytes, byte(WORD_VENDOR)),
                product: read_u32(bytes, byte(WORD_PRODUCT)),
                revision: read_u32(bytes, byte(WORD_REVISION)),
                serial: read_u32(bytes, byte(WORD_SERIAL)),
            },
            mailbox_out: window(WORD_MAILBOX_OUT),
            mailbox_in: window(WORD_MAILBOX_IN),
            protocols: read_u16(bytes, byte(WORD_PROTOCOLS)),
        })
    }
}

/// Checksum over the first seven words: CRC-8 with polynomial x8+x2+x+1, start value 0xFF.
///
/// Bytes beyond the fourteenth are ignored, missing ones count as 0.
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

    /// The first 29 words of a Kollmorgen AKD's SII.
    const AKD: [u8; 58] = [
        0x09, 0x00, 0x00, 0x08, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x10, 0x00, 0x6A, 0, 0, 0, 0x44, 0x4B, 0x41, 0, 0x02, 0,
        0, 0, 0x93, 0, 0x83, 0x99, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x00, 0x18, 0x00, 0x04, 0x00, 0x1C,
        0x00, 0x04, 0x0E, 0x00,
    ];

    #[test]
    fn a_real_drives_fixed_part_is_read() {
        let part = FixedPart::parse(&AKD).unwrap();
        assert_eq!(
            (part.identity.vendor, part.identity.product, part.identity.revision),
            (0x6A, 0x0041_4B44, 2)
        );
        assert_eq!(
            part.mailbox_out,
            MailboxWindow {
                start: 0x1800,
                length: 1024
            }
        );
        assert_eq!(
            part.mailbox_in,
            MailboxWindow {
                start: 0x1C00,
                length: 1024
            }
        );
        assert_eq!(part.protocols & PROTOCOL_COE, PROTOCOL_COE);
        assert_eq!(
            FixedPart::parse(&AKD[..57]),
            Err(Error::Truncated {
                expected: 58,
                actual: 57
            })
        );
    }

    #[test]
    fn the_checksum_of_a_real_sii_is_right() {
        assert_eq!(checksum(&AKD), AKD[14]);
    }
}
