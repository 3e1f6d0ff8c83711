//! A datagram inside a passing frame, and the envelope around the datagrams.
//!
//! Views only: nothing is copied, the slaves change the frame's own bytes. An envelope that does not fit the frame
//! gives no datagrams, and a chain that exceeds the frame stops there; no byte pattern makes a view leave the frame.

use etherpen_ethercat::wire::{Command, DATAGRAM_HEADER_LEN, ETHERCAT_HEADER_LEN, ETHERTYPE, SOURCE_BIT};

/// Bytes of the working counter behind the data.
const COUNTER: usize = 2;
const ETHERNET_HEADER: usize = 14;
const SOURCE_ADDRESS: usize = 6;
const ETHERTYPE_OFFSET: usize = 12;
const ETHERTYPE_IPV4: u16 = 0x0800;
const UDP_PORT: u16 = 0x88A4;
const UDP_HEADER: usize = 8;
/// The last field of the UDP header.
const UDP_CHECKSUM_BYTES: usize = 2;
const IP_PROTOCOL_UDP: u8 = 17;
const FRAME_LENGTH_MASK: u16 = 0x07FF;
const FRAME_TYPE_DATAGRAMS: u16 = 1;
const LENGTH_MASK: u16 = 0x07FF;
const MORE_FOLLOW: u16 = 0x8000;
const CIRCULATING: u16 = 0x4000;

/// One datagram: header, data and working counter in place.
#[derive(Debug)]
pub(crate) struct Datagram<'frame> {
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

    /// Its command; an unknown number counts as no operation.
    pub(crate) fn command(&self) -> Command {
        let [number, ..] = *self.header;
        Command::from_number(number).unwrap_or(Command::Nop)
    }

    /// Position counter or station address.
    pub(crate) fn device(&self) -> u16 {
        let [_, _, low, high, ..] = *self.header;
        u16::from_le_bytes([low, high])
    }

    /// Replaces the position counter.
    pub(crate) fn set_device(&mut self, value: u16) {
        let [low, high] = value.to_le_bytes();
        let [_, _, old_low, old_high, ..] = &mut *self.header;
        (*old_low, *old_high) = (low, high);
    }

    /// Physical address inside the slave.
    pub(crate) fn register(&self) -> u16 {
        let [_, _, _, _, low, high, ..] = *self.header;
        u16::from_le_bytes([low, high])
    }

    /// Logical address.
    pub(crate) fn logical_address(&self) -> u32 {
        u32::from(self.device()) | u32::from(self.register()) << 16
    }

    /// The data.
    pub(crate) fn data(&self) -> &[u8] {
        self.data
    }

    /// The data, mutable.
    pub(crate) fn data_mut(&mut self) -> &mut [u8] {
        self.data
    }

    /// Adds to the working counter.
    pub(crate) fn count(&mut self, by: u16) {
        *self.counter = u16::from_le_bytes(*self.counter).wrapping_add(by).to_le_bytes();
    }

    /// Sets events in the interrupt field, beside those of the slaves before.
    pub(crate) fn report(&mut self, events: u16) {
        let [.., low, high] = &mut *self.header;
        let [new_low, new_high] = events.to_le_bytes();
        *low |= new_low;
        *high |= new_high;
    }

    /// Whether another datagram follows.
    pub(crate) fn has_more(&self) -> bool {
        self.flags() & MORE_FOLLOW != 0
    }

    /// Scripted fault: sets the bit that announces another datagram.
    pub(crate) fn set_more(&mut self) {
        self.set_flags(self.flags() | MORE_FOLLOW);
    }

    /// Scripted fault: sets the circulating bit.
    pub(crate) fn set_circulating(&mut self) {
        self.set_flags(self.flags() | CIRCULATING);
    }

    fn flags(&self) -> u16 {
        let [_, _, _, _, _, _, low, high, ..] = *self.header;
        u16::from_le_bytes([low, high])
    }

    fn set_flags(&mut self, flags: u16) {
        let [low, high] = flags.to_le_bytes();
        let [_, _, _, _, _, _, old_low, old_high, ..] = &mut *self.header;
        (*old_low, *old_high) = (low, high);
    }

    /// Scripted fault: changes the index.
    pub(crate) fn change_index(&mut self, by: u8) {
        let [_, index, ..] = &mut *self.header;
        *index = index.wrapping_add(by);
    }
}

/// The datagrams of a frame, one after the other.
#[derive(Debug)]
pub(crate) struct Datagrams<'frame> {
    chain: &'frame mut [u8],
}

impl<'frame> Datagrams<'frame> {
    /// The datagrams of an Ethernet frame; `None` if it carries no EtherCAT datagrams or its header does not fit.
    pub(crate) fn of_frame(frame: &'frame mut [u8]) -> Option<Self> {
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
    pub(crate) fn next(&mut self) -> Option<Datagram<'_>> {
        let chain = std::mem::take(&mut self.chain);
        let (datagram, rest) = Datagram::split(chain)?;
        self.chain = rest;
        Some(datagram)
    }
}

/// Whether a frame says that it carries EtherCAT, whatever its content.
pub(crate) fn is_ethercat(frame: &[u8]) -> bool {
    payload_start(frame).is_some()
}

/// Marks a frame as processed, as the first slave controller does in the source address. Clears a UDP checksum, which
/// the changed data would invalidate.
pub(crate) fn mark_processed(frame: &mut [u8]) {
    if let Some(checksum) = payload_start(frame)
        .filter(|start| *start > ETHERNET_HEADER)
        .and_then(|start| frame.get_mut(start - UDP_CHECKSUM_BYTES..start))
    {
        checksum.fill(0);
    }
    if let Some(byte) = frame.get_mut(SOURCE_ADDRESS) {
        *byte |= SOURCE_BIT;
    }
}

/// Scripted fault: changes length and type of the EtherCAT header.
pub(crate) fn set_frame_header(frame: &mut [u8], change: impl FnOnce(u16, u8) -> (u16, u8)) {
    let place = payload_start(frame)
        .and_then(|start| frame.get_mut(start..))
        .and_then(|payload| payload.first_chunk_mut::<ETHERCAT_HEADER_LEN>());
    if let Some(place) = place {
        let header = u16::from_le_bytes(*place);
        let (length, kind) = change(header & FRAME_LENGTH_MASK, (header >> 12) as u8);
        *place = (length.min(FRAME_LENGTH_MASK) | u16::from(kind) << 12).to_le_bytes();
    }
}

/// Offset of the EtherCAT header, in a raw frame or in UDP.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::*;

    fn commands(frame: &mut [u8]) -> Vec<Command> {
        let mut found = Vec::new();
        if let Some(mut datagrams) = Datagrams::of_frame(frame) {
            while let Some(datagram) = datagrams.next() {
                found.push(datagram.command());
            }
        }
        found
    }

    #[test]
    fn a_chain_ends_where_no_more_follow_or_the_header_says() {
        let mut frame = frame_of(&[(BRD, 0, 0, &[0; 2]), (LRW, 0, 0, &[0; 8]), (FPRD, 0, 0, &[0; 4])]);
        assert_eq!(commands(&mut frame), [Command::Brd, Command::Lrw, Command::Fprd]);
        frame[23] = 0;
        assert_eq!(commands(&mut frame), [Command::Brd]);
        let mut frame = frame_of(&[(BRD, 0, 0, &[0; 2]), (LRW, 0, 0, &[0; 40])]);
        frame[14] -= 1;
        assert_eq!(commands(&mut frame), [Command::Brd], "the second one leaves the chain");
        frame.truncate(60);
        assert_eq!(commands(&mut frame), [], "the chain leaves the frame");
    }

    #[test]
    fn a_frame_in_udp_is_processed_and_its_checksum_switched_off() {
        let raw = frame_of(&[(BRD, 0, 0x0130, &[0; 2])]);
        let mut frame = raw[..12].to_vec();
        frame.extend_from_slice(&[0x08, 0x00, 0x45, 0, 0, 60, 0, 0, 0, 0, 64, 17, 0, 0]);
        frame.extend_from_slice(&[10, 0, 0, 1, 10, 0, 0, 2, 0x88, 0xA4, 0x88, 0xA4, 0, 40, 0xAB, 0xCD]);
        frame.extend_from_slice(&raw[14..]);
        assert_eq!(commands(&mut frame), [Command::Brd]);
        mark_processed(&mut frame);
        assert_eq!(frame[40..42], [0, 0]);
        frame[37] = 0xA5;
        assert_eq!(commands(&mut frame), [], "another port");
    }
}
