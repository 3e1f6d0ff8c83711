//! Encapsulations: the headers around the datagrams.
//!
//! The headers are written once when a frame is built; sending only changes them when the frame's length has changed.
//!
//! Invariant: opening a received frame reads nothing beyond its end and only decides whose frame it is.

use super::observation::Ignored;
use super::wire::{
    self, ETHERCAT_HEADER_LEN, ETHERTYPE, EtherCatType, FRAME_LEN_MIN, MacAddress, PAYLOAD_OFFSET, SOURCE_BIT,
    UDP_PAYLOAD_OFFSET, UDP_PORT, UdpRepr, write_bytes,
};

const LENGTH_MASK: u16 = 0x07FF;
const TYPE_SHIFT: u16 = 12;

/// Transport of EtherCAT.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Encapsulation {
    /// In Ethernet frames with EtherCAT's own EtherType.
    #[default]
    Raw,
    /// In UDP, with these headers.
    Udp(UdpRepr),
    /// Without further headers: EtherCAT header and datagrams only, for transports that add their own, such as sockets.
    Bare,
}

/// A received frame without its encapsulation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Opened<'f> {
    /// The chain of datagrams.
    pub(super) payload: &'f [u8],
    /// [`SOURCE_BIT`] if a slave controller has marked the source address, else 0.
    pub(super) mark: u8,
}

impl Encapsulation {
    /// Bytes in front of the first datagram, EtherCAT header included.
    pub(super) const fn header_len(&self) -> usize {
        match self {
            Self::Raw => PAYLOAD_OFFSET,
            Self::Udp(_) => UDP_PAYLOAD_OFFSET + ETHERCAT_HEADER_LEN,
            Self::Bare => ETHERCAT_HEADER_LEN,
        }
    }

    /// Writes the headers without the lengths.
    pub(super) fn emit(&self, frame: &mut [u8], source: MacAddress) {
        match self {
            Self::Raw => {
                write_bytes(frame, 0, &[0xFF; 6]);
                write_bytes(frame, 6, &source);
                write_bytes(frame, 12, &ETHERTYPE.to_be_bytes());
            }
            // Headers that contain lengths are written when the frame is closed.
            Self::Udp(_) | Self::Bare => {}
        }
    }

    /// Writes the lengths of a frame whose datagrams end at `end`. Returns how many bytes to send; those behind `end`
    /// have to be zero.
    pub(super) fn close(&self, frame: &mut [u8], end: usize) -> usize {
        let start = self.header_len();
        let length = end.saturating_sub(start) as u16 & LENGTH_MASK;
        let header = length | (EtherCatType::Datagrams as u16) << TYPE_SHIFT;
        write_bytes(frame, start - ETHERCAT_HEADER_LEN, &header.to_le_bytes());
        match self {
            Self::Raw => end.max(FRAME_LEN_MIN),
            // Frames are built in buffers of the greatest length.
            Self::Udp(repr) => repr.emit(frame, end.saturating_sub(UDP_PAYLOAD_OFFSET)).unwrap_or(0),
            Self::Bare => end,
        }
    }

    /// Opens a received frame that `source` may have sent.
    ///
    /// # Errors
    /// [`Ignored::EtherType`], [`Ignored::FrameType`], [`Ignored::Truncated`] or [`Ignored::ForeignSource`].
    #[inline(always)]
    pub(super) fn open<'f>(&self, frame: &'f [u8], source: &MacAddress) -> Result<Opened<'f>, Ignored> {
        let (payload, mark) = match self {
            Self::Raw => open_raw(frame, source)?,
            Self::Udp(own) => (open_bare(open_udp(frame, own)?)?, 0),
            Self::Bare => (open_bare(frame)?, 0),
        };
        Ok(Opened { payload, mark })
    }
}

/// Opens EtherCAT header and datagrams without a source address.
#[inline(never)]
fn open_bare(content: &[u8]) -> Result<&[u8], Ignored> {
    let header = content.first_chunk::<2>().ok_or(Ignored::Truncated)?;
    let header = u16::from_le_bytes(*header);
    if header >> TYPE_SHIFT != EtherCatType::Datagrams as u16 {
        return Err(Ignored::FrameType);
    }
    let end = ETHERCAT_HEADER_LEN + usize::from(header & LENGTH_MASK);
    content.get(ETHERCAT_HEADER_LEN..end).ok_or(Ignored::Truncated)
}

/// Opens an Ethernet frame. Returns its datagrams and the mark of the source.
#[inline(always)]
fn open_raw<'f>(frame: &'f [u8], source: &MacAddress) -> Result<(&'f [u8], u8), Ignored> {
    let head = frame.first_chunk::<PAYLOAD_OFFSET>().ok_or(Ignored::Truncated)?;
    // The first four and the last two bytes of the addresses are compared as words.
    let [
        _,
        _,
        _,
        _,
        _,
        _,
        a,
        b,
        c,
        d,
        e,
        f,
        type_high,
        type_low,
        header_low,
        header_high,
    ] = *head;
    let [own_a, own_b, own_c, own_d, own_e, own_f] = *source;
    let differs = u32::from_le_bytes([a, b, c, d]) ^ u32::from_le_bytes([own_a, own_b, own_c, own_d]);
    let last_differs = u16::from_le_bytes([e, f]) ^ u16::from_le_bytes([own_e, own_f]);
    let sender = differs & !u32::from(SOURCE_BIT) | u32::from(last_differs);
    let protocol = u16::from_le_bytes([type_high, type_low]) ^ ETHERTYPE.swap_bytes();
    let header = u16::from_le_bytes([header_low, header_high]);
    if sender | u32::from(protocol) | u32::from(header >> TYPE_SHIFT ^ EtherCatType::Datagrams as u16) != 0 {
        return Err(refused(sender, protocol));
    }
    let end = PAYLOAD_OFFSET + usize::from(header & LENGTH_MASK);
    let payload = frame.get(PAYLOAD_OFFSET..end).ok_or(Ignored::Truncated)?;
    // Any other difference was refused above.
    Ok((payload, differs as u8))
}

/// Why a frame is not opened: the differences of its sender and of its EtherType.
#[cold]
fn refused(sender: u32, protocol: u16) -> Ignored {
    match (protocol, sender) {
        (0, 0) => Ignored::FrameType,
        (0, _) => Ignored::ForeignSource,
        _ => Ignored::EtherType,
    }
}

/// Checks the headers of Ethernet, IPv4 and UDP. Returns the UDP payload of an answer, or of one of our own packets
/// that slave controllers passed on unchanged.
#[inline(never)]
fn open_udp<'f>(frame: &'f [u8], own: &UdpRepr) -> Result<&'f [u8], Ignored> {
    let (found, payload) = UdpRepr::parse(frame).map_err(|error| match error {
        wire::Error::Truncated { .. } | wire::Error::Checksum { .. } => Ignored::Truncated,
        _ => Ignored::EtherType,
    })?;
    let answers = (found.destination, found.destination_port) == (own.source, own.source_port);
    let returns = (found.source, found.source_port) == (own.source, own.source_port);
    if answers || returns && found.destination_port == UDP_PORT {
        frame.get(payload).ok_or(Ignored::Truncated)
    } else {
        Err(Ignored::ForeignSource)
    }
}
