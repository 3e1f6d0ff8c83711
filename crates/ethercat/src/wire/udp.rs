//! EtherCAT in UDP, which can pass routers and sockets.
//!
//! The UDP payload starts with the two-byte EtherCAT header, so it equals the content behind the Ethernet header of a
//! raw frame. Master and segment send to port [`UDP_PORT`]; a segment behind a socket answers to the port of the
//! request. Layout: IEC 61158-4-12 (EtherCAT in UDP), RFC 791, RFC 768.
//!
//! Slave controllers change the payload on the fly and clear the UDP checksum instead of correcting it. The checksum is
//! sent as 0 ("not used", RFC 768) and ignored on reception, because the Ethernet frame check covers these bytes too.
//!
//! Invariant: only unfragmented packets without options and with a correct header checksum are accepted.

use super::{Error, FRAME_LEN_MIN, MacAddress, check_len, check_room};
use core::net::Ipv4Addr;
use core::ops::Range;
use smoltcp::wire::{EthernetAddress, EthernetFrame, EthernetProtocol, IpProtocol, Ipv4Packet, UdpPacket};

/// UDP port of EtherCAT.
pub const UDP_PORT: u16 = 0x88A4;
/// Offset of the EtherCAT header, behind the headers of Ethernet, IPv4 and UDP.
pub const UDP_PAYLOAD_OFFSET: usize = UDP_OFFSET + UDP_HEADER_LEN;

/// Offset of the sender's Ethernet address; the receiver's is at 0.
const SOURCE_OFFSET: usize = 6;
const IP_OFFSET: usize = 14;
const IP_HEADER_LEN: usize = 20;
const UDP_OFFSET: usize = IP_OFFSET + IP_HEADER_LEN;
const UDP_HEADER_LEN: usize = 8;
const IP_VERSION: u8 = 4;
const HOPS_MAX: u8 = 64;

/// The Ethernet address at an offset of a frame that has one.
fn address(frame: &[u8], offset: usize) -> MacAddress {
    let bytes = frame.get(offset..).and_then(|rest| rest.first_chunk());
    bytes.copied().unwrap_or_default()
}

/// The three headers around an EtherCAT payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UdpRepr {
    /// The sender's Ethernet address.
    pub source_mac: MacAddress,
    /// The receiver's Ethernet address.
    pub destination_mac: MacAddress,
    /// The sender's IPv4 address.
    pub source: Ipv4Addr,
    /// The receiver's IPv4 address.
    pub destination: Ipv4Addr,
    /// The sender's port.
    pub source_port: u16,
    /// The receiver's port.
    pub destination_port: u16,
}

impl UdpRepr {
    /// A master's request from `source` to the segment at `destination`; the Ethernet destination is broadcast, which
    /// needs no address resolution.
    pub const fn request(source_mac: MacAddress, source: Ipv4Addr, destination: Ipv4Addr) -> Self {
        Self {
            source_mac,
            destination_mac: [0xFF; 6],
            source,
            destination,
            source_port: UDP_PORT,
            destination_port: UDP_PORT,
        }
    }

    /// Parses an Ethernet frame (without check sequence); returns the headers and the range of the EtherCAT header with
    /// its datagrams, without padding.
    ///
    /// # Errors
    /// [`Error::Truncated`], [`Error::EtherType`], [`Error::IpHeader`] for options and other versions,
    /// [`Error::Fragment`], [`Error::IpProtocol`], [`Error::Checksum`] of the IPv4 header, or [`Error::Port`] when
    /// neither port is EtherCAT's.
    pub fn parse(frame: &[u8]) -> Result<(Self, Range<usize>), Error> {
        check_len(frame, UDP_PAYLOAD_OFFSET)?;
        let ethernet = EthernetFrame::new_unchecked(frame);
        if ethernet.ethertype() != EthernetProtocol::Ipv4 {
            return Err(Error::EtherType {
                actual: ethernet.ethertype().into(),
            });
        }
        let ip_bytes = frame.get(IP_OFFSET..).unwrap_or(&[]);
        let ip = Ipv4Packet::new_unchecked(ip_bytes);
        check_ip(&ip, ip_bytes)?;
        let udp_bytes = frame.get(UDP_OFFSET..).unwrap_or(&[]);
        let udp = UdpPacket::new_unchecked(udp_bytes);
        let length = usize::from(udp.len());
        let room = usize::from(ip.total_len()).saturating_sub(IP_HEADER_LEN);
        if length < UDP_HEADER_LEN || length > room {
            return Err(Error::Truncated {
                expected: length.max(UDP_HEADER_LEN),
                actual: room,
            });
        }
        if udp.src_port() != UDP_PORT && udp.dst_port() != UDP_PORT {
            return Err(Error::Port { actual: udp.dst_port() });
        }
        let repr = Self {
            source_mac: address(frame, SOURCE_OFFSET),
            destination_mac: address(frame, 0),
            source: ip.src_addr(),
            destination: ip.dst_addr(),
            source_port: udp.src_port(),
            destination_port: udp.dst_port(),
        };
        Ok((repr, UDP_PAYLOAD_OFFSET..UDP_OFFSET + length))
    }

    /// Writes the headers around a payload of `payload_len` bytes at [`UDP_PAYLOAD_OFFSET`], which may be written
    /// later; pads short frames. Returns the frame's length in bytes.
    ///
    /// # Errors
    /// [`Error::Room`] when the frame does not fit.
    pub fn emit(&self, buffer: &mut [u8], payload_len: usize) -> Result<usize, Error> {
        let end = UDP_PAYLOAD_OFFSET.saturating_add(payload_len);
        let length = end.max(FRAME_LEN_MIN);
        check_room(buffer, length)?;
        let Ok(total_len) = u16::try_from(end - IP_OFFSET) else {
            return Err(Error::Room {
                expected: end - IP_OFFSET,
                actual: usize::from(u16::MAX),
            });
        };
        if let Some(padding) = buffer.get_mut(end..length) {
            padding.fill(0);
        }
        let mut ethernet = EthernetFrame::new_unchecked(&mut *buffer);
        ethernet.set_dst_addr(EthernetAddress(self.destination_mac));
        ethernet.set_src_addr(EthernetAddress(self.source_mac));
        ethernet.set_ethertype(EthernetProtocol::Ipv4);
        let mut ip = Ipv4Packet::new_unchecked(buffer.get_mut(IP_OFFSET..end).unwrap_or(&mut []));
        ip.set_version(IP_VERSION);
        ip.set_header_len(IP_HEADER_LEN as u8);
        ip.set_dscp(0);
        ip.set_ecn(0);
        ip.set_total_len(total_len);
        ip.set_ident(0);
        ip.clear_flags();
        ip.set_dont_frag(true);
        ip.set_frag_offset(0);
        ip.set_hop_limit(HOPS_MAX);
        ip.set_next_header(IpProtocol::Udp);
        ip.set_src_addr(self.source);
        ip.set_dst_addr(self.destination);
        ip.fill_checksum();
        let mut udp = UdpPacket::new_unchecked(buffer.get_mut(UDP_OFFSET..end).unwrap_or(&mut []));
        udp.set_src_port(self.source_port);
        udp.set_dst_port(self.destination_port);
        udp.set_len(total_len - IP_HEADER_LEN as u16);
        udp.set_checksum(0);
        Ok(length)
    }
}

/// Checks that the packet is complete, unfragmented, without options, undamaged, and contains UDP.
fn check_ip(ip: &Ipv4Packet<&[u8]>, bytes: &[u8]) -> Result<(), Error> {
    if ip.version() != IP_VERSION || usize::from(ip.header_len()) != IP_HEADER_LEN {
        return Err(Error::IpHeader {
            actual: super::read_u8(bytes, 0),
        });
    }
    if !ip.verify_checksum() {
        return Err(Error::Checksum { actual: ip.checksum() });
    }
    if ip.more_frags() || ip.frag_offset() != 0 {
        return Err(Error::Fragment {
            actual: ip.frag_offset(),
        });
    }
    if ip.next_header() != IpProtocol::Udp {
        return Err(Error::IpProtocol {
            actual: ip.next_header().into(),
        });
    }
    let total_len = usize::from(ip.total_len());
    check_len(bytes, total_len.max(IP_HEADER_LEN + UDP_HEADER_LEN))?;
    if total_len < IP_HEADER_LEN + UDP_HEADER_LEN {
        return Err(Error::Truncated {
            expected: IP_HEADER_LEN + UDP_HEADER_LEN,
            actual: total_len,
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const REPR: UdpRepr = UdpRepr {
        source_mac: [0x10, 0, 0, 0, 0, 1],
        destination_mac: [0xFF; 6],
        source: Ipv4Addr::new(192, 168, 1, 10),
        destination: Ipv4Addr::new(192, 168, 1, 20),
        source_port: 0x1234,
        destination_port: UDP_PORT,
    };

    fn frame() -> [u8; 100] {
        let mut bytes = [0xAA; 100];
        assert_eq!(REPR.emit(&mut bytes, 30), Ok(72));
        bytes
    }

    #[test]
    fn headers_survive_emit_and_parse_and_the_payload_is_left_alone() {
        let bytes = frame();
        assert_eq!(UdpRepr::parse(&bytes), Ok((REPR, 42..72)));
        assert!(bytes[42..].iter().all(|&byte| byte == 0xAA));
        assert_eq!(bytes[40..42], [0, 0], "UDP checksum not used");
        let mut small = [0xAA; 60];
        assert_eq!(REPR.emit(&mut small, 4), Ok(60));
        assert_eq!(UdpRepr::parse(&small), Ok((REPR, 42..46)));
        assert_eq!(small[46..], [0; 14]);
        assert_eq!(
            REPR.emit(&mut small, 19),
            Err(Error::Room {
                expected: 61,
                actual: 60
            })
        );
    }

    #[test]
    fn a_packet_without_payload_is_complete() {
        let mut bytes = [0xAA; 60];
        assert_eq!(REPR.emit(&mut bytes, 0), Ok(60));
        assert_eq!(UdpRepr::parse(&bytes), Ok((REPR, 42..42)));
    }

    #[test]
    fn the_headers_have_the_bytes_of_the_standards() {
        // The sum of the other nine 16-bit words of the header, complemented, computed by hand.
        let ip = [
            0x45, 0, 0, 58, 0, 0, 0x40, 0, 64, 17, 0xB7, 0x44, 192, 168, 1, 10, 192, 168, 1, 20,
        ];
        assert_eq!(frame()[14..34], ip);
        assert_eq!(frame()[34..42], [0x12, 0x34, 0x88, 0xA4, 0, 38, 0, 0]);
    }

    #[test]
    fn an_answer_to_the_masters_own_port_is_opened() {
        let mut bytes = [0; 100];
        let answer = UdpRepr {
            source_port: UDP_PORT,
            destination_port: 40_000,
            ..REPR
        };
        answer.emit(&mut bytes, 30).unwrap();
        assert_eq!(UdpRepr::parse(&bytes), Ok((answer, 42..72)));
    }

    /// Changes a byte of the IPv4 header and makes its checksum right again.
    fn with(offset: usize, value: u8) -> Result<(UdpRepr, Range<usize>), Error> {
        let mut bytes = frame();
        bytes[offset] = value;
        Ipv4Packet::new_unchecked(&mut bytes[14..]).fill_checksum();
        UdpRepr::parse(&bytes)
    }

    #[test]
    fn what_is_no_plain_udp_packet_for_ethercat_is_refused_by_kind() {
        assert_eq!(with(14, 0x46), Err(Error::IpHeader { actual: 0x46 }));
        assert_eq!(with(14, 0x65), Err(Error::IpHeader { actual: 0x65 }));
        assert_eq!(with(20, 0x20), Err(Error::Fragment { actual: 0 }));
        assert_eq!(with(21, 1), Err(Error::Fragment { actual: 8 }));
        assert_eq!(with(23, 6), Err(Error::IpProtocol { actual: 6 }));
        assert_eq!(with(37, 0xA5), Err(Error::Port { actual: 0x88A5 }));
        assert_eq!(with(12, 0x88), Err(Error::EtherType { actual: 0x8800 }));
        assert_eq!(
            with(17, 87),
            Err(Error::Truncated {
                expected: 87,
                actual: 86
            })
        );
        assert_eq!(
            with(39, 39),
            Err(Error::Truncated {
                expected: 39,
                actual: 38
            })
        );
        let mut bytes = frame();
        bytes[22] = 63;
        assert!(matches!(UdpRepr::parse(&bytes), Err(Error::Checksum { .. })));
    }

    #[test]
    fn a_cut_frame_is_refused_wherever_it_is_cut() {
        let bytes = frame();
        for length in 0..72 {
            assert!(
                matches!(UdpRepr::parse(&bytes[..length]), Err(Error::Truncated { .. })),
                "{length}"
            );
        }
    }
}
