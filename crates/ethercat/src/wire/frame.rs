//! The encapsulation: Ethernet II with ethertype 0x88A4 and the two-byte EtherCAT header.
//!
//! [`FrameBuilder`] packs datagrams into a buffer one after the other and closes the frame; [`FrameView`] opens a
//! received one. A slave controller sets [`SOURCE_BIT`] in the first byte of the source address of frames that it
//! passes on. This distinguishes replies from a frame that came back unprocessed.
//!
//! Invariant: a frame closed by the builder has a consistent chain and is at least [`FRAME_LEN_MIN`] bytes long.

use super::{
    Address, Command, DATAGRAM_HEADER_LEN, DatagramRepr, Datagrams, Error, check_len, check_room, read_u16, write_bytes,
};
use smoltcp::wire::{EthernetAddress, EthernetFrame, EthernetProtocol};

/// Ethertype of EtherCAT.
pub const ETHERTYPE: u16 = 0x88A4;
/// Bytes of the header between Ethernet's header and the first datagram.
pub const ETHERCAT_HEADER_LEN: usize = 2;
/// Where the first datagram starts in an Ethernet frame.
pub const PAYLOAD_OFFSET: usize = 14 + ETHERCAT_HEADER_LEN;
/// Shortest Ethernet frame without its check sequence; shorter ones are padded with zeros.
pub const FRAME_LEN_MIN: usize = 60;
/// Longest Ethernet frame without its check sequence.
pub const FRAME_LEN_MAX: usize = 1514;
/// Bit of the first source address byte that the first slave controller sets.
pub const SOURCE_BIT: u8 = 0x02;

const LENGTH_MASK: u16 = 0x07FF;
const TYPE_SHIFT: u16 = 12;

/// Six bytes of an Ethernet address.
pub type MacAddress = [u8; 6];

/// Type of the content behind the EtherCAT header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum EtherCatType {
    /// Datagrams: the only type slaves process.
    Datagrams = 1,
    /// Network variables between masters.
    NetworkVariables = 4,
    /// Mailbox data through a gateway.
    Mailbox = 5,
}

/// A received frame with a complete EtherCAT header.
#[derive(Clone, Copy, Debug)]
pub struct FrameView<'a> {
    frame: &'a [u8],
    payload: &'a [u8],
}

impl<'a> FrameView<'a> {
    /// Opens an Ethernet frame (without check sequence) that carries datagrams.
    ///
    /// # Errors
    /// [`Error::Truncated`], [`Error::EtherType`] or [`Error::FrameType`]; a VLAN tag counts as another EtherType.
    pub fn new_checked(frame: &'a [u8]) -> Result<Self, Error> {
        check_len(frame, PAYLOAD_OFFSET)?;
        let ethertype = u16::from(EthernetFrame::new_unchecked(frame).ethertype());
        if ethertype != ETHERTYPE {
            return Err(Error::EtherType { actual: ethertype });
        }
        let header = read_u16(frame, PAYLOAD_OFFSET - ETHERCAT_HEADER_LEN);
        let kind = (header >> TYPE_SHIFT) as u8;
        if kind != EtherCatType::Datagrams as u8 {
            return Err(Error::FrameType { actual: kind });
        }
        let end = PAYLOAD_OFFSET + usize::from(header & LENGTH_MASK);
        match frame.get(PAYLOAD_OFFSET..end) {
            Some(payload) => Ok(Self { frame, payload }),
            None => Err(Error::Truncated {
                expected: end,
                actual: frame.len(),
            }),
        }
    }

    /// The source address, as the slaves left it.
    pub fn source(&self) -> MacAddress {
        EthernetFrame::new_unchecked(self.frame).src_addr().0
    }

    /// The chain of datagrams, without padding.
    pub fn payload(&self) -> &'a [u8] {
        self.payload
    }

    /// Walks the datagrams.
    pub fn datagrams(&self) -> Datagrams<'a> {
        Datagrams::new(self.payload)
    }
}

/// Packs datagrams into one frame.
#[derive(Debug)]
pub struct FrameBuilder<'a> {
    frame: &'a mut [u8],
    end: usize,
    last: Option<usize>,
}

impl<'a> FrameBuilder<'a> {
    /// Starts an empty broadcast frame from `source`.
    ///
    /// # Errors
    /// [`Error::Room`] when `frame` is shorter than [`FRAME_LEN_MIN`].
    pub fn new(frame: &'a mut [u8], source: MacAddress) -> Result<Self, Error> {
        check_room(frame, FRAME_LEN_MIN)?;
        let mut ethernet = EthernetFrame::new_unchecked(&mut *frame);
        ethernet.set_dst_addr(EthernetAddress::BROADCAST);
        ethernet.set_src_addr(EthernetAddress(source));
        ethernet.set_ethertype(EthernetProtocol::Unknown(ETHERTYPE));
        Ok(Self {
            frame,
            end: PAYLOAD_OFFSET,
            last: None,
        })
    }

    /// Longest data of one more datagram, bytes; `None` if none fits.
    pub fn room(&self) -> Option<usize> {
        self.frame
            .len()
            .min(FRAME_LEN_MAX)
            .checked_sub(self.end + DATAGRAM_HEADER_LEN + 2)
    }

    /// Adds a datagram with zeroed data and returns its data to be filled in.
    ///
    /// # Errors
    /// [`Error::Room`] when it does not fit; the frame is then unchanged.
    pub fn push(&mut self, command: Command, index: u8, address: Address, length: usize) -> Result<&mut [u8], Error> {
        let actual = self.room().unwrap_or(0);
        if self.room().is_none_or(|room| room < length) {
            return Err(Error::Room {
                expected: length,
                actual,
            });
        }
        let start = self.end;
        let repr = DatagramRepr::request(command, index, address, length as u16);
        let target = self.frame.get_mut(start..start + repr.len()).unwrap_or(&mut []);
        target.fill(0);
        repr.emit(target)?;
        if let Some(last) = self.last {
            let more = read_u16(self.frame, last + 6) | 1 << 15;
            write_bytes(self.frame, last + 6, &more.to_le_bytes());
        }
        self.last = Some(start);
        self.end = start + repr.len();
        let data = start + DATAGRAM_HEADER_LEN;
        Ok(self.frame.get_mut(data..data + length).unwrap_or(&mut []))
    }

    /// Closes the frame: writes the EtherCAT header and pads. Returns the frame's length in bytes.
    pub fn finish(self) -> usize {
        let length = (self.end - PAYLOAD_OFFSET) as u16 & LENGTH_MASK;
        let header = length | (EtherCatType::Datagrams as u16) << TYPE_SHIFT;
        write_bytes(self.frame, PAYLOAD_OFFSET - ETHERCAT_HEADER_LEN, &header.to_le_bytes());
        if let Some(padding) = self.frame.get_mut(self.end..FRAME_LEN_MIN) {
            padding.fill(0);
        }
        self.end.max(FRAME_LEN_MIN)
    }
}

const _: () = {
    assert!(
        FRAME_LEN_MAX - PAYLOAD_OFFSET <= LENGTH_MASK as usize,
        "a full frame's length fits the header"
    );
};

#[cfg(test)]
mod tests {
    use super::*;

    const SOURCE: MacAddress = [0x10, 0x20, 0x30, 0x40, 0x50, 0x60];

    #[test]
    fn a_built_frame_opens_to_the_datagrams_it_was_made_of() {
        let mut bytes = [0xAA; 200];
        let mut builder = FrameBuilder::new(&mut bytes, SOURCE).unwrap();
        builder
            .push(Command::Lrd, 7, Address::logical(0x1_0000), 6)
            .unwrap()
            .copy_from_slice(b"inputs");
        builder.push(Command::Brd, 7, Address::broadcast(0x0130), 2).unwrap();
        let length = builder.finish();
        assert_eq!(length, 60);
        let view = FrameView::new_checked(&bytes[..length]).unwrap();
        assert_eq!(view.source(), SOURCE);
        assert_eq!(view.payload().len(), 18 + 14);
        let reprs: [_; 2] =
            core::array::from_fn(|n| DatagramRepr::parse(&view.datagrams().nth(n).unwrap().unwrap()).unwrap());
        assert_eq!(
            (reprs[0].command, reprs[0].length, reprs[0].more),
            (Command::Lrd, 6, true)
        );
        assert_eq!(
            (reprs[1].command, reprs[1].length, reprs[1].more),
            (Command::Brd, 2, false)
        );
        assert_eq!(view.datagrams().next().unwrap().unwrap().data(), b"inputs");
        assert!(bytes[48..60].iter().all(|&byte| byte == 0));
        assert_eq!(bytes[60], 0xAA);
    }

    #[test]
    fn a_full_frame_takes_no_further_datagram() {
        let mut bytes = [0; FRAME_LEN_MAX];
        let mut builder = FrameBuilder::new(&mut bytes, SOURCE).unwrap();
        let room = builder.room().unwrap();
        assert_eq!(room, 1486);
        assert!(builder.push(Command::Fpwr, 0, Address::default(), room + 1).is_err());
        builder.push(Command::Fpwr, 0, Address::default(), room).unwrap();
        assert_eq!(builder.room(), None);
        assert!(builder.push(Command::Fpwr, 0, Address::default(), 0).is_err());
        assert_eq!(builder.finish(), FRAME_LEN_MAX);
    }

    #[test]
    fn a_frame_ends_at_its_longest_length_in_a_longer_buffer_too() {
        let mut bytes = [0; FRAME_LEN_MAX + 100];
        let mut builder = FrameBuilder::new(&mut bytes, SOURCE).unwrap();
        let room = builder.room().unwrap();
        let refused = builder.push(Command::Fpwr, 0, Address::default(), room + 1).err();
        assert_eq!(
            refused,
            Some(Error::Room {
                expected: 1487,
                actual: 1486
            })
        );
        assert_eq!(builder.room(), Some(room), "the frame is unchanged");
        builder.push(Command::Fpwr, 0, Address::default(), room).unwrap();
        assert!(builder.push(Command::Fpwr, 0, Address::default(), 0).is_err());
        assert_eq!(builder.finish(), FRAME_LEN_MAX);
    }

    #[test]
    fn other_protocols_types_and_cut_frames_are_distinguished() {
        let mut bytes = [0; 60];
        let mut builder = FrameBuilder::new(&mut bytes, SOURCE).unwrap();
        builder.push(Command::Brd, 0, Address::broadcast(0), 40 - 12).unwrap();
        builder.finish();
        let cut = FrameView::new_checked(&bytes[..50]).err();
        assert_eq!(
            cut,
            Some(Error::Truncated {
                expected: 56,
                actual: 50
            })
        );
        bytes[15] = 0x40;
        assert_eq!(
            FrameView::new_checked(&bytes).err(),
            Some(Error::FrameType { actual: 4 })
        );
        bytes[12] = 0x81;
        bytes[13] = 0x00;
        assert_eq!(
            FrameView::new_checked(&bytes).err(),
            Some(Error::EtherType { actual: 0x8100 })
        );
        assert_eq!(
            FrameView::new_checked(&bytes[..9]).err(),
            Some(Error::Truncated {
                expected: 16,
                actual: 9
            })
        );
    }
}
