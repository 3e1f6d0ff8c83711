//! Wire formats of an EtherCAT segment.
//!
//! Each structure has a view over borrowed bytes, made by `new_checked`, which never reads outside them, and a plain
//! `Repr` with `parse` and `emit`. Numbers are little-endian except those of the Ethernet header. The layouts follow
//! IEC 61158-4-12 and IEC 61158-6-12 (type 12 fieldbus).
//!
//! Invariant: no function in this module panics, whatever bytes it is given.

pub mod coe;
mod datagram;
pub mod foe;
mod frame;
pub mod mailbox;
pub mod register;
pub mod sii;
mod udp;

pub use datagram::{Address, Command, DATAGRAM_HEADER_LEN, DATAGRAM_OVERHEAD, Datagram, DatagramRepr, Datagrams};
pub use frame::{
    ETHERCAT_HEADER_LEN, ETHERTYPE, EtherCatType, FRAME_LEN_MAX, FRAME_LEN_MIN, FrameBuilder, FrameView, MacAddress,
    PAYLOAD_OFFSET, SOURCE_BIT,
};
pub use udp::{UDP_PAYLOAD_OFFSET, UDP_PORT, UdpRepr};

/// Why bytes were rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error {
    /// Fewer bytes than the structure, or its own length field, needs.
    Truncated {
        /// Bytes needed.
        expected: usize,
        /// Bytes present.
        actual: usize,
    },
    /// The Ethernet frame carries a protocol other than EtherCAT.
    EtherType {
        /// The ethertype found.
        actual: u16,
    },
    /// The EtherCAT header announces content other than datagrams.
    FrameType {
        /// The type found, 0 to 15.
        actual: u8,
    },
    /// A command number that EtherCAT does not define.
    Command {
        /// The number found.
        actual: u8,
    },
    /// The last datagram does not end where the EtherCAT header says.
    ChainLength {
        /// Bytes announced by the EtherCAT header.
        expected: usize,
        /// Bytes the datagrams take.
        actual: usize,
    },
    /// The buffer is too small for a structure.
    Room {
        /// Bytes needed.
        expected: usize,
        /// Bytes available.
        actual: usize,
    },
    /// An IPv4 header of another version or with options.
    IpHeader {
        /// Its first byte.
        actual: u8,
    },
    /// An IPv4 header whose checksum is wrong.
    Checksum {
        /// The checksum found.
        actual: u16,
    },
    /// A fragment of an IPv4 packet.
    Fragment {
        /// Offset of the fragment in the packet, bytes.
        actual: u16,
    },
    /// The IPv4 packet carries a protocol other than UDP.
    IpProtocol {
        /// The protocol found.
        actual: u8,
    },
    /// The UDP packet is neither from nor to EtherCAT's port.
    Port {
        /// The destination port found.
        actual: u16,
    },
    /// A field has an undefined value.
    Value {
        /// The value found.
        actual: u16,
    },
}

/// Reads an unsigned 8-bit number; 0 outside of `bytes`.
#[inline]
pub fn read_u8(bytes: &[u8], offset: usize) -> u8 {
    bytes.get(offset).copied().unwrap_or(0)
}

/// Reads an unsigned little-endian 16-bit number; 0 outside of `bytes`.
#[inline]
pub fn read_u16(bytes: &[u8], offset: usize) -> u16 {
    match bytes.get(offset..).and_then(|rest| rest.first_chunk::<2>()) {
        Some(chunk) => u16::from_le_bytes(*chunk),
        None => 0,
    }
}

/// Reads an unsigned little-endian 32-bit number; 0 outside of `bytes`.
#[inline]
pub fn read_u32(bytes: &[u8], offset: usize) -> u32 {
    match bytes.get(offset..).and_then(|rest| rest.first_chunk::<4>()) {
        Some(chunk) => u32::from_le_bytes(*chunk),
        None => 0,
    }
}

/// Reads an unsigned little-endian 64-bit number; missing bytes are 0.
#[inline]
pub fn read_u64(bytes: &[u8], offset: usize) -> u64 {
    u64::from(read_u32(bytes, offset)) | u64::from(read_u32(bytes, offset + 4)) << 32
}

/// Writes `value` at `offset`; writes nothing if it does not fit.
#[inline]
pub fn write_bytes(bytes: &mut [u8], offset: usize, value: &[u8]) {
    if let Some(target) = bytes.get_mut(offset..).and_then(|rest| rest.get_mut(..value.len())) {
        target.copy_from_slice(value);
    }
}

/// Fails unless `bytes` holds at least `expected` bytes.
pub(crate) fn check_len(bytes: &[u8], expected: usize) -> Result<(), Error> {
    if bytes.len() < expected {
        Err(Error::Truncated {
            expected,
            actual: bytes.len(),
        })
    } else {
        Ok(())
    }
}

/// Fails unless `bytes` offers room for at least `expected` bytes.
pub(crate) fn check_room(bytes: &[u8], expected: usize) -> Result<(), Error> {
    if bytes.len() < expected {
        Err(Error::Room {
            expected,
            actual: bytes.len(),
        })
    } else {
        Ok(())
    }
}
