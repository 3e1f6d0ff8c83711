//! A datagram inside a passing frame, and the envelope around the datagrams.
//!
//! Views only: nothing is copied, the slaves change the frame's own bytes. An envelope that does not fit the frame
//! gives no datagrams, a chain that runs over its end stops there; no byte pattern can make a view leave the frame.

use etherpen::ethercat::wire::{Command, DATAGRAM_HEADER_LEN, ETHERCAT_HEADER_LEN, ETHERTYPE, SOURCE_BIT};

/// Bytes of the working counter behind the data.
const COUNTER: usize = 2;
const ETHERNET_HEADER: usize = 14;
const SOURCE_ADDRESS: usize = 6;
const ETHERTYPE_OFFSET: usize = 12;
const ETHERTYPE_IPV4: u16 = 0x0800;
const UDP_PORT: u16 = 0x88A4;
const UDP_HEADER: usize = 8;
const IP_PROTOCOL_UDP: u8 = 17;
const FRAME_LENGTH_MASK: u16 = 0x07FF;
const FRAME_TYPE_DATAGRAMS: u16 = 1;
const LENGTH_MASK: u16 = 0x07FF;
const MORE_FOLLOW: u16 = 0x8000;

/// One datagram: header, data and working counter in place.
#[derive(Debug)]
pub(super) struct Datagram<'frame> {
    header: &'frame mut [u8; DATAGRAM_HEADER_LEN],
    data: &'frame mut [u8],
    counter: &'frame mut [u8; COUNTER],
}

impl<'frame> Datagram<'frame> {
    /// Splits the first datagram off a chain; the rest is empty when no more follow.
    fn split(chain: &'frame mut [u8]) -> Option<(Self, &'frame mut [u8])> {
        let (header, rest) = chain.split_first_chunk_mut::<DATAGRAM_HEADER_LEN>()?;
        let [_, _, _, _, _, _, low, high, _, _] = *header;
        let length_and_flags = u16::from_le_bytes([low, high]);
        let length = usize::from(length_and_flags & LENGTH_MASK);
        let (data, rest) = rest.split_at_mut_checked(length)?;
        let (counter, rest) = rest.split_first_chunk_mut::<COUNTER>()?;
        let rest = if length_and_flags & MORE_FOLLOW != 0 {
            rest
        } else {
            &mut []
        };
        Some((Self { header, data, counter }, rest))
    }

    /// What it asks for; a number that is no command asks for nothing.
    pub(super) fn command(&self) -> Command {
        let [number, ..] = *self.header;
        Command::from_number(number).unwrap_or(Command::Nop)
    }

    /// Position counter or station address.
    pub(super) fn device(&self) -> u16 {
        let [_, _, low, high, ..] = *self.header;
        u16::from_le_bytes([low, high])
    }

    /// Replaces the position.
    pub(super) fn set_device(&mut self, value: u16) {
        let [low, high] = value.to_le_bytes();
        let [_, _, old_low, old_high, ..] = &mut *self.header;
        (*old_low, *old_high) = (low, high);
    }

    /// Physical address inside the slave.
    pub(super) fn register(&self) -> u16 {
        let [_, _, _, _, low, high, ..] = *self.header;
        u16::from_le_bytes([low, high])
    }

    /// Logical address.
    pub(super) fn logical_address(&self) -> u32 {
        u32::from(self.device()) | u32::from(self.register()) << 16
    }

    /// The data.
    pub(super) fn data(&self) -> &[u8] {
        self.data
    }

    /// The data, to be changed in passing.
    pub(super) fn data_mut(&mut self) -> &mut [u8] {
        self.data
    }

    /// Adds to the working counter.
    pub(super) fn count(&mut self, by: u16) {
        *self.counter = u16::from_le_bytes(*self.counter).wrapping_add(by).to_le_bytes();
    }

    /// Replaces the index: a scripted fault.
    pub(super) fn change_index(&mut self, by: u8) {
        let [_, index, ..] = &mut *self.header;
        *index = index.wrapping_add(by);
    }
}

/// The datagrams of a frame, one after the other.
#[derive(Debug)]
pub(super) struct Datagrams<'frame> {
    chain: &'frame mut [u8],
}

impl<'frame> Datagrams<'frame> {
    /// The chain of an Ethernet frame; nothing if it carries no EtherCAT datagrams or its header does not fit.
    pub(super) fn of_frame(frame: &'frame mut [u8]) -> Option<Self> {
        let start = payload_start(frame)?;
        let payload = frame.get_mut(start..)?;
        let (header, chain) = payload.split_first_chunk_mut::<ETHERCAT_HEADER_LEN>()?;
        let header = u16::from_le_bytes(*header);
        if header >> 12 != FRAME_TYPE_DATAGRAMS {
            return None;
        }
        let chain = chain.get_mut(..usize::from(header & FRAME_LENGTH_MASK))?;
        Some(Self { chain })
    }

    /// The next datagram.
    pub(super) fn next(&mut self) -> Option<Datagram<'_>> {
        let chain = std::mem::take(&mut self.chain);
        let (datagram, rest) = Datagram::split(chain)?;
        self.chain = rest;
        Some(datagram)
    }
}

/// Marks a frame as processed: what the first slave controller does to the source address.
pub(super) fn mark_processed(frame: &mut [u8]) {
    if let Some(byte) = frame.get_mut(SOURCE_ADDRESS) {
        *byte |= SOURCE_BIT;
    }
}

/// Where the EtherCAT header starts, in a raw frame or in UDP.
fn payload_start(frame: &[u8]) -> Option<usize> {
    match big_endian(frame, ETHERTYPE_OFFSET)? {
        ETHERTYPE => Some(ETHERNET_HEADER),
        ETHERTYPE_IPV4 => {
            let internet_header = 4 * usize::from(frame.get(ETHERNET_HEADER)? & 0x0F);
            let udp = ETHERNET_HEADER + internet_header;
            let is_udp = *frame.get(ETHERNET_HEADER + 9)? == IP_PROTOCOL_UDP;
            (is_udp && big_endian(frame, udp + 2)? == UDP_PORT).then_some(udp + UDP_HEADER)
        }
        _ => None,
    }
}

fn big_endian(frame: &[u8], at: usize) -> Option<u16> {
    frame.get(at..)?.first_chunk().map(|bytes| u16::from_be_bytes(*bytes))
}
