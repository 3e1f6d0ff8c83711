//! Ways for EtherCAT frames through this computer: network interface, UDP, Unix socket.
//!
//! A master opens a [`Transport`], the virtual segment a [`SegmentPort`]; both deal in Ethernet frames without check
//! sequence, whatever carries them. On an interface the frames are as they are; in UDP the EtherCAT header and the
//! datagrams are the payload (IEC 61158-4-12, EtherCAT in UDP); a Unix socket of type SOCK_SEQPACKET carries one frame
//! in a message.
//!
//! Invariant: no call waits longer than it was told; a frame that cannot be sent at once is lost, as on a wire; a way
//! that cannot be opened says what to try.

mod error;
mod raw;
mod udp;
mod unix;

pub use error::TransportError;

use etherpen::ethercat::wire::{ETHERTYPE, FRAME_LEN_MAX, UDP_PORT};
use rustix::event::{PollFd, Timespec, poll};
use rustix::io::Errno;
use std::fmt;
use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, ToSocketAddrs};
use std::path::PathBuf;
use std::time::Duration;

/// Bytes of an Ethernet header.
const ETHERNET_HEADER: usize = 14;

/// Where a segment is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Endpoint {
    /// On this network interface.
    Interface(String),
    /// At this UDP address.
    Udp(SocketAddrV4),
    /// At this Unix socket.
    Unix(PathBuf),
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Interface(name) => write!(f, "interface:{name}"),
            Self::Udp(address) => write!(f, "udp:{address}"),
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
        }
    }
}

/// Reads `HOST`, `HOST:PORT` or `:PORT`; the port is 34980 unless given, the host any address of this computer.
///
/// # Errors
/// That it is no IPv4 address, which EtherCAT in UDP needs.
pub fn udp_address(text: &str) -> Result<SocketAddrV4, String> {
    let (host, port) = match text.rsplit_once(':') {
        Some((host, port)) => (
            host,
            port.parse().map_err(|_| format!("'{port}' is no port (0 to 65535)"))?,
        ),
        None => (text, UDP_PORT),
    };
    if host.is_empty() {
        return Ok(SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, port));
    }
    let found = (host, port)
        .to_socket_addrs()
        .map_err(|cause| format!("'{host}' is not known ({cause})"))?;
    found
        .filter_map(|address| match address {
            std::net::SocketAddr::V4(address) => Some(address),
            std::net::SocketAddr::V6(_) => None,
        })
        .next()
        .ok_or_else(|| format!("'{host}' has no IPv4 address, which EtherCAT in UDP needs"))
}

/// A master's way to a segment.
pub trait Transport: Send {
    /// Sends an Ethernet frame; what does not fit into the socket at once is lost.
    ///
    /// # Errors
    /// That the way does not exist any more.
    fn send(&mut self, frame: &[u8]) -> io::Result<()>;

    /// The next Ethernet frame, written to `frame`: its length; `None` when none came within `wait`.
    ///
    /// # Errors
    /// That the way does not exist any more.
    fn receive(&mut self, frame: &mut [u8], wait: Duration) -> io::Result<Option<usize>>;
}

/// A segment's way to its masters.
pub trait SegmentPort {
    /// Where it listens.
    fn endpoint(&self) -> Endpoint;

    /// The next Ethernet frame and the master that sent it; `None` when none came within `wait`.
    ///
    /// # Errors
    /// That the way does not exist any more.
    fn receive(&mut self, wait: Duration) -> io::Result<Option<(Master, Vec<u8>)>>;

    /// Answers a master; what does not fit into the socket at once, or comes after the master has gone, is lost.
    ///
    /// # Errors
    /// That the way does not exist any more.
    fn send(&mut self, master: Master, frame: &[u8]) -> io::Result<()>;

    /// An answer as a tap at the wire would see it.
    fn on_the_wire(&self, master: Master, frame: &[u8]) -> Vec<u8> {
        let _ = master;
        frame.to_vec()
    }
}

/// Which master a frame came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Master {
    /// Whoever is on the interface.
    Interface,
    /// At a UDP address.
    Udp(SocketAddrV4),
    /// A connection of the Unix socket.
    Unix(u64),
}

/// Opens a master's way to a segment.
///
/// # Errors
/// What is missing and what to try.
pub fn open(endpoint: &Endpoint) -> Result<Box<dyn Transport>, TransportError> {
    Ok(match endpoint {
        Endpoint::Interface(name) => Box::new(raw::RawTransport::open(name)?),
        Endpoint::Udp(address) => Box::new(udp::UdpTransport::open(*address)?),
        Endpoint::Unix(path) => Box::new(unix::UnixTransport::open(path)?),
    })
}

/// Opens a segment's way to its masters.
///
/// # Errors
/// What is missing or in use, and what to try.
pub fn listen(endpoint: &Endpoint) -> Result<Box<dyn SegmentPort>, TransportError> {
    Ok(match endpoint {
        Endpoint::Interface(name) => Box::new(raw::RawPort::open(name)?),
        Endpoint::Udp(address) => Box::new(udp::UdpPort::listen(*address)?),
        Endpoint::Unix(path) => Box::new(unix::UnixPort::listen(path)?),
    })
}

/// Waits until one of the descriptors has something, or `wait` is over.
fn wait_for(waited: &mut [PollFd<'_>], wait: Duration) -> io::Result<()> {
    let timeout = Timespec::try_from(wait).unwrap_or(Timespec { tv_sec: 1, tv_nsec: 0 });
    match poll(waited, Some(&timeout)) {
        Ok(_) | Err(Errno::INTR) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

/// What became of a non-blocking call: `None` when it has to be tried later.
fn unless_blocked<T>(result: rustix::io::Result<T>) -> io::Result<Option<T>> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(Errno::AGAIN | Errno::INTR | Errno::NOBUFS) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

/// The EtherCAT part of an Ethernet frame: header and datagrams without padding; nothing of another frame.
fn ethercat_part(frame: &[u8]) -> Option<&[u8]> {
    let kind = frame.get(12..ETHERNET_HEADER)?;
    let part = frame.get(ETHERNET_HEADER..)?;
    let [low, high, ..] = *part else { return None };
    let length = 2 + usize::from(u16::from_le_bytes([low, high]) & 0x07FF);
    (kind == ETHERTYPE.to_be_bytes()).then(|| part.get(..length).unwrap_or(part))
}

const _: () = assert!(FRAME_LEN_MAX == 1500 + ETHERNET_HEADER, "a frame is an Ethernet frame");

#[cfg(test)]
mod tests;
