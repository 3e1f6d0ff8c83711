//! EtherCAT in UDP over the system's sockets.
//!
//! The payload of a UDP packet equals the content behind the Ethernet header of a raw frame. The segment passes on
//! complete frames with Ethernet, IPv4 and UDP headers, made from the known addresses, so that a capture shows what a
//! tap on the wire would show; in it the segment's port is always the standard's.
//!
//! Invariant: IPv4 only; a packet that is too long for a frame is dropped.

use super::{ETHERNET_HEADER, Endpoint, Master, SegmentPort, Transport, TransportError};
use super::{ethercat_part, unless_blocked, wait_for};
use etherpen_ethercat::wire::{
    ETHERTYPE, FRAME_LEN_MAX, FRAME_LEN_MIN, SOURCE_BIT, UDP_PAYLOAD_OFFSET, UDP_PORT, UdpRepr,
};
use rustix::event::{PollFd, PollFlags};
use rustix::net::{RecvFlags, SendFlags, SocketAddrAny, recvfrom, sendto};
use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::time::Duration;

const ETHERTYPE_IPV4: [u8; 2] = [0x08, 0x00];
/// Longest payload that fits a frame.
const PAYLOAD_MAX: usize = FRAME_LEN_MAX - UDP_PAYLOAD_OFFSET;

/// A master's end.
pub(super) struct UdpTransport {
    socket: UdpSocket,
    segment: SocketAddrV4,
    /// Source address of the frames sent; used as destination of the replies.
    source: [u8; 6],
}

impl UdpTransport {
    pub(super) fn open(segment: SocketAddrV4) -> Result<Self, TransportError> {
        let failed = |cause| TransportError::failed(format!("UDP to {segment}"))(cause);
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).map_err(failed)?;
        socket.set_broadcast(true).map_err(failed)?;
        socket.set_nonblocking(true).map_err(failed)?;
        Ok(Self {
            socket,
            segment,
            source: [0; 6],
        })
    }

    fn is_of_the_segment(&self, from: SocketAddrV4) -> bool {
        let one = !self.segment.ip().is_broadcast() && !self.segment.ip().is_multicast();
        from.port() == self.segment.port()
            && (!one || from.ip() == self.segment.ip() || self.segment.ip().is_unspecified())
    }
}

impl Transport for UdpTransport {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        let Some(part) = ethercat_part(frame).filter(|part| part.len() <= PAYLOAD_MAX) else {
            return Ok(());
        };
        if let Some(Ok(source)) = frame.get(6..12).map(TryInto::try_into) {
            self.source = source;
        }
        let sent = sendto(
            &self.socket,
            part,
            SendFlags::empty(),
            &SocketAddrAny::from(self.segment),
        );
        unless_blocked(sent).map(|_| ())
    }

    fn receive(&mut self, frame: &mut [u8], wait: Duration) -> io::Result<Option<usize>> {
        wait_for(&mut [PollFd::new(&self.socket, PollFlags::IN)], wait)?;
        let Some((header, payload)) = frame.split_at_mut_checked(ETHERNET_HEADER) else {
            return Ok(None);
        };
        let received = unless_blocked(recvfrom(&self.socket, &mut *payload, RecvFlags::TRUNC))?;
        let Some((_, length, Some(from))) = received else {
            return Ok(None);
        };
        if !v4(from).is_some_and(|from| self.is_of_the_segment(from)) || length > payload.len() {
            return Ok(None);
        }
        // An Ethernet frame has at least this length.
        let padded = length.max(FRAME_LEN_MIN - ETHERNET_HEADER);
        if let Some(padding) = payload.get_mut(length..padded) {
            padding.fill(0);
        }
        let [first, rest @ ..] = self.source;
        let written = [0xFF; 6].into_iter().chain([first | SOURCE_BIT]).chain(rest);
        let written = written.chain(ETHERTYPE.to_be_bytes());
        header.iter_mut().zip(written).for_each(|(place, byte)| *place = byte);
        Ok(Some(ETHERNET_HEADER + padded))
    }
}

fn v4(address: SocketAddrAny) -> Option<SocketAddrV4> {
    match SocketAddr::try_from(address).ok()? {
        SocketAddr::V4(address) => Some(address),
        SocketAddr::V6(_) => None,
    }
}

/// A segment's end.
pub(super) struct UdpPort {
    socket: UdpSocket,
    address: SocketAddrV4,
}

impl UdpPort {
    pub(super) fn listen(address: SocketAddrV4) -> Result<Self, TransportError> {
        let socket = UdpSocket::bind(address).map_err(|cause| match cause.kind() {
            ErrorKind::AddrInUse => TransportError::PortInUse(address),
            ErrorKind::AddrNotAvailable => TransportError::NotHere(address),
            _ => TransportError::failed(format!("UDP at {address}"))(cause),
        })?;
        let failed = |cause| TransportError::failed(format!("UDP at {address}"))(cause);
        socket.set_nonblocking(true).map_err(failed)?;
        let address = match socket.local_addr().map_err(failed)? {
            SocketAddr::V4(bound) => bound,
            SocketAddr::V6(_) => address,
        };
        Ok(Self { socket, address })
    }
}

impl SegmentPort for UdpPort {
    fn endpoint(&self) -> Endpoint {
        Endpoint::Udp(self.address)
    }

    fn receive(&mut self, wait: Duration) -> io::Result<Option<(Master, Vec<u8>)>> {
        wait_for(&mut [PollFd::new(&self.socket, PollFlags::IN)], wait)?;
        let mut payload = [0; PAYLOAD_MAX];
        let received = unless_blocked(recvfrom(&self.socket, &mut payload[..], RecvFlags::TRUNC))?;
        let Some((_, length, Some(from))) = received else {
            return Ok(None);
        };
        let (Some(from), Some(payload)) = (v4(from), payload.get(..length)) else {
            return Ok(None);
        };
        let segment = SocketAddrV4::new(*self.address.ip(), UDP_PORT);
        Ok(Some((Master::Udp(from), framed(from, segment, payload))))
    }

    fn send(&mut self, master: Master, frame: &[u8]) -> io::Result<()> {
        let Master::Udp(master) = master else { return Ok(()) };
        let sent = sendto(
            &self.socket,
            payload(frame),
            SendFlags::empty(),
            &SocketAddrAny::from(master),
        );
        match unless_blocked(sent) {
            // The next call reports a master that has disconnected.
            Err(error) if error.kind() == ErrorKind::ConnectionRefused => Ok(()),
            sent => sent.map(|_| ()),
        }
    }

    fn on_the_wire(&self, master: Master, frame: &[u8]) -> Vec<u8> {
        let segment = SocketAddrV4::new(*self.address.ip(), UDP_PORT);
        match master {
            Master::Udp(master) => framed(segment, master, payload(frame)),
            _ => frame.to_vec(),
        }
    }
}

/// The payload of a frame: the content behind UDP's header, or behind Ethernet's if there is no UDP header.
fn payload(frame: &[u8]) -> &[u8] {
    let whole = UdpRepr::parse(frame).ok().and_then(|(_, place)| frame.get(place));
    let is_ip = frame.get(12..ETHERNET_HEADER) == Some(&ETHERTYPE_IPV4[..]);
    let start = if is_ip { UDP_PAYLOAD_OFFSET } else { ETHERNET_HEADER };
    whole.or(frame.get(start..)).unwrap_or(&[])
}

/// A frame with Ethernet, IPv4 and UDP headers around a payload.
fn framed(from: SocketAddrV4, to: SocketAddrV4, payload: &[u8]) -> Vec<u8> {
    let headers = UdpRepr {
        source_mac: address_of(*from.ip()),
        destination_mac: address_of(*to.ip()),
        source: *from.ip(),
        destination: *to.ip(),
        source_port: from.port(),
        destination_port: to.port(),
    };
    let mut frame = vec![0; FRAME_LEN_MAX];
    let length = headers.emit(&mut frame, payload.len()).unwrap_or(0);
    let end = UDP_PAYLOAD_OFFSET + payload.len();
    if let Some(place) = frame.get_mut(UDP_PAYLOAD_OFFSET..end) {
        place.copy_from_slice(payload);
    }
    frame.truncate(length);
    frame
}

/// An artificial Ethernet address for an IPv4 address; broadcast for broadcast.
fn address_of(address: Ipv4Addr) -> [u8; 6] {
    let [a, b, c, d] = address.octets();
    if address.is_broadcast() {
        [0xFF; 6]
    } else {
        [0x10, 0, a, b, c, d]
    }
}
