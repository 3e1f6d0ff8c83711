//! A fieldbus memory management unit: maps logical bits to physical memory.
//!
//! Register layout: 0x0600 to 0x06FF of the slave controller's register description, 16 bytes each: logical start
//! u32, length u16, logical start and stop bit, physical start u16, physical start bit, type, activate.

/// Bytes of one unit's register block.
pub(crate) const BLOCK: usize = 16;

const TYPE_READ: u8 = 0x01;
const TYPE_WRITE: u8 = 0x02;

/// One active mapping.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fmmu {
    logical_start: u32,
    length: u16,
    start_bit: u8,
    stop_bit: u8,
    physical_start: u16,
    physical_bit: u8,
    /// Whether the bus may read through the mapping.
    pub(crate) reads: bool,
    /// Whether the bus may write through the mapping.
    pub(crate) writes: bool,
}

/// The part of a datagram that one unit maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Overlap {
    /// Whole bytes: datagram offset, physical address, length.
    Bytes {
        /// First byte of the datagram's data.
        offset: usize,
        /// First physical address.
        address: u16,
        /// Length, bytes.
        length: usize,
    },
    /// Single bits: `count` bits from a bit of the datagram to a bit of physical memory.
    Bits {
        /// First bit of the datagram's data, counted from its first byte's bit 0.
        offset_bits: usize,
        /// First physical bit, counted from address 0's bit 0.
        physical_bits: usize,
        /// Number of bits.
        count: usize,
    },
}

impl Fmmu {
    /// Parses a register block; `None` if the unit is not active or maps nothing.
    pub(crate) fn from_block(block: [u8; BLOCK]) -> Option<Self> {
        let [
            l0,
            l1,
            l2,
            l3,
            n0,
            n1,
            start_bit,
            stop_bit,
            p0,
            p1,
            physical_bit,
            kind,
            activate,
            _,
            _,
            _,
        ] = block;
        let unit = Self {
            logical_start: u32::from_le_bytes([l0, l1, l2, l3]),
            length: u16::from_le_bytes([n0, n1]),
            start_bit: start_bit & 7,
            stop_bit: stop_bit & 7,
            physical_start: u16::from_le_bytes([p0, p1]),
            physical_bit: physical_bit & 7,
            reads: kind & TYPE_READ != 0,
            writes: kind & TYPE_WRITE != 0,
        };
        (activate & 1 != 0 && unit.length > 0).then_some(unit)
    }

    /// The part of `length` bytes at the logical address `logical` that this unit maps.
    pub(crate) fn overlap(&self, logical: u32, length: usize) -> Option<Overlap> {
        let first = u64::from(self.logical_start) * 8 + u64::from(self.start_bit);
        let last = (u64::from(self.logical_start) + u64::from(self.length) - 1) * 8 + u64::from(self.stop_bit);
        let asked_first = u64::from(logical) * 8;
        let asked_end = asked_first + 8 * length as u64;
        let from = first.max(asked_first);
        let end = (last + 1).min(asked_end);
        if from >= end {
            return None;
        }
        let physical = u64::from(self.physical_start) * 8 + u64::from(self.physical_bit) + (from - first);
        let offset = from - asked_first;
        let count = end - from;
        if offset % 8 == 0 && physical % 8 == 0 && count % 8 == 0 {
            let address = u16::try_from(physical / 8).ok()?;
            return Some(Overlap::Bytes {
                offset: (offset / 8) as usize,
                address,
                length: (count / 8) as usize,
            });
        }
        Some(Overlap::Bits {
            offset_bits: offset as usize,
            physical_bits: physical as usize,
            count: count as usize,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(logical: u32, length: u16, bits: [u8; 3], physical: u16) -> [u8; BLOCK] {
        let mut block = [0; BLOCK];
        block[..4].copy_from_slice(&logical.to_le_bytes());
        block[4..6].copy_from_slice(&length.to_le_bytes());
        block[6..8].copy_from_slice(&bits[..2]);
        block[8..10].copy_from_slice(&physical.to_le_bytes());
        block[10] = bits[2];
        block[11] = 3;
        block[12] = 1;
        block
    }

    #[test]
    fn whole_bytes_map_with_their_offset() {
        let unit = Fmmu::from_block(block(0x1_0004, 6, [0, 7, 0], 0x1140)).expect("active");
        assert_eq!(
            unit.overlap(0x1_0000, 16),
            Some(Overlap::Bytes {
                offset: 4,
                address: 0x1140,
                length: 6
            })
        );
        assert_eq!(
            unit.overlap(0x1_0006, 2),
            Some(Overlap::Bytes {
                offset: 0,
                address: 0x1142,
                length: 2
            })
        );
        assert_eq!(unit.overlap(0x1_000A, 4), None);
        assert_eq!(unit.overlap(0xFFFF_FFFF, 4096), None);
    }

    #[test]
    fn single_bits_map_across_byte_borders() {
        let unit = Fmmu::from_block(block(0, 2, [6, 1, 3], 0x1000)).expect("active");
        let expected = Overlap::Bits {
            offset_bits: 6,
            physical_bits: 0x8003,
            count: 4,
        };
        assert_eq!(unit.overlap(0, 2), Some(expected));
    }

    #[test]
    fn an_inactive_or_empty_unit_maps_nothing() {
        let mut inactive = block(0, 2, [0, 7, 0], 0x1000);
        inactive[12] = 0;
        assert_eq!(Fmmu::from_block(inactive), None);
        assert_eq!(Fmmu::from_block(block(0, 0, [0, 7, 0], 0x1000)), None);
    }
}
