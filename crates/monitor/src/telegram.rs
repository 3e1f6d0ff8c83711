//! Frames as a master may send them: EtherCAT in Ethernet, or in UDP.
//!
//! The parser follows ETG.1000.4: an EtherCAT header of two bytes with length and type, then datagrams of ten bytes of
//! header, data and a working counter of two bytes, chained by a bit. It reads, and never changes anything.

use std::fmt;

const ETHERNET_BYTES: usize = 14;
const FRAME_BYTES_MAX: usize = 1_514;
/// Shorter frames are padded to this length.
const FRAME_BYTES_MIN: usize = 60;
const ETHERTYPE_ETHERCAT: u16 = 0x88A4;
const ETHERTYPE_IPV4: u16 = 0x0800;
const UDP_PORT: u16 = 0x88A4;
const PROTOCOL_UDP: u8 = 17;
const IPV4_BYTES_MIN: usize = 20;
const UDP_BYTES: usize = 8;
const HEADER_BYTES: usize = 2;
const DATAGRAM_BYTES: usize = 10;
const COUNTER_BYTES: usize = 2;
const LENGTH_BITS: u16 = 0x07FF;
const TYPE_DATAGRAMS: u16 = 1;
const CIRCULATING: u16 = 0x4000;
const MORE: u16 = 0x8000;
const COMMAND_MAX: u8 = 14;

/// Why a frame is not one that a master may send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Flaw {
    /// It is shorter than its headers, or longer than Ethernet allows.
    Length(usize),
    /// It is not EtherCAT.
    Foreign(u16),
    /// The EtherCAT header has another type than datagrams, or a reserved bit.
    Header(u16),
    /// The header's length is not that of the datagrams, or they leave the frame.
    Chain {
        /// Length in the header.
        header: usize,
        /// Bytes of the datagrams so far.
        datagrams: usize,
        /// Bytes of the frame behind the header.
        frame: usize,
    },
    /// Bytes that are not padding follow the datagrams.
    Rest(usize),
    /// An unknown command.
    Command(u8),
    /// A reserved bit, or the circulating bit, is set.
    Bits(u16),
    /// The working counter is not zero.
    Counter(u16),
}

impl fmt::Display for Flaw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length(bytes) => write!(f, "a frame of {bytes} bytes"),
            Self::Foreign(ethertype) => write!(f, "a frame of another protocol, EtherType {ethertype:#06x}"),
            Self::Header(header) => write!(f, "the EtherCAT header is {header:#06x}"),
            Self::Chain {
                header,
                datagrams,
                frame,
            } => write!(
                f,
                "the header announces {header} bytes, the datagrams have {datagrams}, the frame has room for {frame}"
            ),
            Self::Rest(bytes) => write!(f, "{bytes} bytes follow the datagrams"),
            Self::Command(number) => write!(f, "a datagram has the unknown command {number}"),
            Self::Bits(flags) => write!(f, "a datagram has the length and flags {flags:#06x}"),
            Self::Counter(count) => write!(f, "a working counter is {count} when it is sent"),
        }
    }
}

fn little(bytes: &[u8], at: usize) -> Option<u16> {
    let pair = bytes.get(at..at.checked_add(2)?)?;
    Some(u16::from_le_bytes(pair.try_into().ok()?))
}

fn big(bytes: &[u8], at: usize) -> Option<u16> {
    little(bytes, at).map(u16::swap_bytes)
}

/// Checks a frame. Without the wire alone, a frame of another protocol is as good as any.
pub(crate) fn check(frame: &[u8], has_the_wire_alone: bool) -> Result<(), Flaw> {
    let ethertype = match big(frame, ETHERNET_BYTES - 2) {
        Some(ethertype) if frame.len() <= FRAME_BYTES_MAX => ethertype,
        _ => return Err(Flaw::Length(frame.len())),
    };
    match ethertype {
        ETHERTYPE_ETHERCAT => check_padded(frame, ETHERNET_BYTES),
        _ if has_the_wire_alone => Err(Flaw::Foreign(ethertype)),
        ETHERTYPE_IPV4 => match udp_payload(frame) {
            Some(payload) => check_chain(payload).map(drop),
            None => Ok(()),
        },
        _ => Ok(()),
    }
}

/// The payload of EtherCAT in UDP; `None` for any other packet.
fn udp_payload(frame: &[u8]) -> Option<&[u8]> {
    let packet = frame.get(ETHERNET_BYTES..)?;
    let header_bytes = usize::from(packet.first()? & 0x0F) * 4;
    let is_udp = header_bytes >= IPV4_BYTES_MIN && *packet.get(9)? == PROTOCOL_UDP;
    let datagram = packet.get(header_bytes..).filter(|_| is_udp)?;
    let length = usize::from(big(datagram, 4)?);
    let is_ethercat = big(datagram, 2)? == UDP_PORT;
    datagram.get(UDP_BYTES..length).filter(|_| is_ethercat)
}

/// Checks a frame whose EtherCAT header begins at a place; what follows the datagrams must be padding.
fn check_padded(frame: &[u8], start: usize) -> Result<(), Flaw> {
    let payload = frame.get(start..).unwrap_or_default();
    let used = check_chain(payload)?;
    let rest = payload.get(used..).unwrap_or_default();
    let is_padding = rest.is_empty() || frame.len() <= FRAME_BYTES_MIN && rest.iter().all(|byte| *byte == 0);
    if is_padding {
        Ok(())
    } else {
        Err(Flaw::Rest(rest.len()))
    }
}

/// Checks EtherCAT header and datagrams; returns how many bytes they have.
fn check_chain(payload: &[u8]) -> Result<usize, Flaw> {
    let Some(header) = little(payload, 0) else {
        return Err(Flaw::Length(payload.len()));
    };
    if header & !LENGTH_BITS != TYPE_DATAGRAMS << 12 {
        return Err(Flaw::Header(header));
    }
    let announced = usize::from(header & LENGTH_BITS);
    let room = payload.len() - HEADER_BYTES;
    let flaw = |datagrams| Flaw::Chain {
        header: announced,
        datagrams,
        frame: room,
    };
    let Some(chain) = payload.get(HEADER_BYTES..HEADER_BYTES + announced) else {
        return Err(flaw(0));
    };
    let mut at = 0;
    loop {
        let (Some(command), Some(flags)) = (chain.get(at), little(chain, at + 6)) else {
            return Err(flaw(at));
        };
        if *command > COMMAND_MAX {
            return Err(Flaw::Command(*command));
        }
        if flags & !(LENGTH_BITS | MORE | CIRCULATING) != 0 || flags & CIRCULATING != 0 {
            return Err(Flaw::Bits(flags));
        }
        let counter_at = at + DATAGRAM_BYTES + usize::from(flags & LENGTH_BITS);
        match little(chain, counter_at) {
            Some(0) => {}
            Some(count) => return Err(Flaw::Counter(count)),
            None => return Err(flaw(at)),
        }
        at = counter_at + COUNTER_BYTES;
        if flags & MORE == 0 {
            break;
        }
    }
    if at == announced {
        Ok(HEADER_BYTES + announced)
    } else {
        Err(flaw(at))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A frame with datagrams of these data lengths.
    pub(crate) fn frame(lengths: &[u16]) -> Vec<u8> {
        let mut chain = Vec::new();
        for (number, length) in lengths.iter().enumerate() {
            let more = if number + 1 < lengths.len() { MORE } else { 0 };
            chain.extend([12, number as u8, 0, 0, 0, 0]);
            chain.extend((length | more).to_le_bytes());
            chain.extend([0, 0]);
            chain.extend(std::iter::repeat_n(0xA5, usize::from(*length)));
            chain.extend([0, 0]);
        }
        let mut frame = vec![0xFF; 12];
        frame.extend([0x88, 0xA4]);
        frame.extend((chain.len() as u16 | TYPE_DATAGRAMS << 12).to_le_bytes());
        frame.extend(chain);
        frame.resize(frame.len().max(FRAME_BYTES_MIN), 0);
        frame
    }

    fn in_udp(frame: &[u8]) -> Vec<u8> {
        let payload = &frame[ETHERNET_BYTES..];
        let mut packet = frame[..12].to_vec();
        packet.extend([0x08, 0x00, 0x45, 0, 0, 0, 0, 0, 0, 0, 64, PROTOCOL_UDP, 0, 0]);
        packet.extend([10, 0, 2, 1, 10, 0, 2, 2, 0x12, 0x34, 0x88, 0xA4]);
        packet.extend((payload.len() as u16 + 8).to_be_bytes());
        packet.extend([0, 0]);
        packet.extend(payload);
        packet
    }

    #[test]
    fn frames_of_one_or_more_datagrams_are_well_formed() {
        for lengths in [&[0][..], &[2, 64, 1], &[1_486], &[32; 20]] {
            assert_eq!(check(&frame(lengths), true), Ok(()), "{lengths:?}");
        }
        for lengths in [&[0][..], &[2, 64, 1], &[1_458], &[32; 20]] {
            assert_eq!(check(&in_udp(&frame(lengths)), false), Ok(()), "{lengths:?} in UDP");
        }
    }

    #[test]
    fn each_flaw_is_found() {
        let good = frame(&[4, 60]);
        let with = |at: usize, value: u8| {
            let mut frame = good.clone();
            frame[at] = value;
            check(&frame, true)
        };
        assert_eq!(with(12, 0x08), Err(Flaw::Foreign(0x08A4)));
        assert!(matches!(with(14, 200), Err(Flaw::Chain { header: 200, .. })));
        assert!(matches!(with(14, 80), Err(Flaw::Chain { header: 80, .. })));
        assert!(matches!(with(15, 0x40), Err(Flaw::Header(_))));
        assert!(matches!(with(15, 0x18), Err(Flaw::Header(_))), "the reserved bit");
        assert_eq!(with(16, 15), Err(Flaw::Command(15)));
        assert!(matches!(with(23, 0xC0), Err(Flaw::Bits(_))), "circulating");
        assert!(matches!(with(23, 0x90), Err(Flaw::Bits(_))), "reserved");
        assert!(
            matches!(with(23, 0x00), Err(Flaw::Chain { .. })),
            "the chain ends early"
        );
        assert_eq!(with(30, 1), Err(Flaw::Counter(1)));
        let mut longer = good.clone();
        longer.extend([0; 3]);
        assert_eq!(check(&longer, true), Err(Flaw::Rest(3)));
        assert_eq!(check(&good[..13], true), Err(Flaw::Length(13)));
        assert_eq!(check(&vec![0; 1_515], true), Err(Flaw::Length(1_515)));
        let mut counted = in_udp(&good);
        let place = 28 + ETHERNET_BYTES + 16;
        counted[place] = 3;
        assert_eq!(check(&counted, false), Err(Flaw::Counter(3)));
        assert_eq!(check(&in_udp(&good), true), Err(Flaw::Foreign(ETHERTYPE_IPV4)));
    }

    proptest! {
        #[test]
        fn no_bytes_panic(mut bytes in proptest::collection::vec(any::<u8>(), 0..200), alone in any::<bool>()) {
            let _ = check(&bytes, alone);
            if bytes.len() > 13 {
                (bytes[12], bytes[13]) = (0x88, 0xA4);
                let _ = check(&bytes, alone);
                (bytes[12], bytes[13]) = (0x08, 0x00);
                let _ = check(&bytes, alone);
            }
        }
    }
}
