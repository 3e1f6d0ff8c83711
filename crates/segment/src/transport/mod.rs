//! Transports for EtherCAT frames on this computer: network interface, UDP, Unix socket.
//!
//! A master opens a [`Transport`], the virtual segment a [`SegmentPort`]; both use Ethernet frames without check
//! sequence over every transport. On an interface the frames are sent unchanged. In UDP the EtherCAT header and the
//! datagrams are the payload (IEC 61158-4-12, EtherCAT in UDP). A Unix socket of type SOCK_SEQPACKET carries one frame
//! in a message.
//!
//! Invariant: no call waits longer than its time limit; a frame that cannot be sent at once is lost, as on a wire; the
//! error of a transport that cannot be opened contains what to try.

mod error;
mod raw;
mod udp;
mod unix;

pub use error::TransportError;

use etherpen_ethercat::wire::{ETHERTYPE, FRAME_LEN_MAX, UDP_PORT};
use rustix::event::{PollFd, Timespec, poll};
use rustix::io::Errno;
use std::fmt;
use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, ToSocketAddrs};
use std::path::PathBuf;
use std::time::Duration;

/// Bytes of an Ethernet header.
const ETHERNET_HEADER: usize = 14;

/// Address of a segment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Endpoint {
    /// On a network interface.
    Interface(String),
    /// At a UDP address.
    Udp(SocketAddrV4),
    /// At a Unix socket.
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

/// Parses `HOST`, `HOST:PORT` or `:PORT`; the default port is 34980, the default host any address of this computer.
///
/// # Errors
/// The text is not an IPv4 address, which EtherCAT in UDP needs.
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

/// A master's transport to a segment.
pub trait Transport: Send {
    /// Sends an Ethernet frame; lost if it does not fit into the socket at once.
    ///
    /// # Errors
    /// The transport no longer exists.
    fn send(&mut self, frame: &[u8]) -> io::Result<()>;

    /// Writes the next Ethernet frame to `frame` and returns its length; `None` when none arrived within `wait`.
    ///
    /// # Errors
    /// The transport no longer exists.
    fn receive(&mut self, frame: &mut [u8], wait: Duration) -> io::Result<Option<usize>>;
}

/// A segment's transport to its masters.
pub trait SegmentPort {
    /// The address on which it listens.
    fn endpoint(&self) -> Endpoint;

    /// The next Ethernet frame and the master that sent it; `None` when none arrived within `wait`.
    ///
    /// # Errors
    /// The transport no longer exists.
    fn receive(&mut self, wait: Duration) -> io::Result<Option<(Master, Vec<u8>)>>;

    /// Answers a master; the answer is lost if it does not fit into the socket at once, or if the master has
    /// disconnected.
    ///
    /// # Errors
    /// The transport no longer exists.
    fn send(&mut self, master: Master, frame: &[u8]) -> io::Result<()>;

    /// An answer as a tap on the wire would see it.
    fn on_the_wire(&self, master: Master, frame: &[u8]) -> Vec<u8> {
        let _ = master;
        frame.to_vec()
    }
}

/// The master that sent a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Master {
    /// Any master on the interface.
    Interface,
    /// At a UDP address.
    Udp(SocketAddrV4),
    /// A connection of the Unix socket.
    Unix(u64),
}

/// Opens a master's transport to a segment.
///
/// # Errors
/// What is missing, and what to try.
pub fn open(endpoint: &Endpoint) -> Result<Box<dyn Transport>, TransportError> {
    Ok(match endpoint {
        Endpoint::Interface(name) => Box::new(raw::FramePort::open(name)?),
        Endpoint::Udp(address) => Box::new(udp::UdpTransport::open(*address)?),
        Endpoint::Unix(path) => Box::new(unix::UnixTransport::open(path)?),
    })
}

/// Opens a segment's transport to its masters.
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

/// Waits until one of the descriptors is ready, or `wait` is over.
fn wait_for(waited: &mut [PollFd<'_>], wait: Duration) -> io::Result<()> {
    let timeout = Timespec::try_from(wait).unwrap_or(Timespec { tv_sec: 1, tv_nsec: 0 });
    match poll(waited, Some(&timeout)) {
        Ok(_) | Err(Errno::INTR) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

/// Result of a non-blocking call; `None` when it has to be repeated later.
fn unless_blocked<T>(result: rustix::io::Result<T>) -> io::Result<Option<T>> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(Errno::AGAIN | Errno::INTR | Errno::NOBUFS) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

/// The EtherCAT part of an Ethernet frame: header and datagrams without padding; `None` for other frames.
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
