//! Frames on a network interface: an AF_PACKET socket bound to it (Linux, packet(7)).
//!
//! Invariant: only frames that may carry EtherCAT are handed on; the socket never blocks.

use super::{Endpoint, Master, SegmentPort, Transport, TransportError, unless_blocked, wait_for};
use etherpen_ethercat::wire::{ETHERTYPE, FRAME_LEN_MAX};
use nix::errno::Errno;
use nix::ifaddrs::getifaddrs;
use nix::net::if_::InterfaceFlags;
use nix::sys::socket::{AddressFamily, LinkAddr, SockFlag, SockProtocol, SockType, bind, socket};
use rustix::event::{PollFd, PollFlags};
use rustix::net::{RecvFlags, SendFlags, recv, send};
use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::path::PathBuf;
use std::time::Duration;

/// Most frames of other kinds that one call passes over.
const PASSED_OVER_MAX: usize = 256;

/// A socket on one interface.
struct Raw {
    interface: String,
    socket: OwnedFd,
}

/// The link address that names an interface to the system, and whether it is up.
fn find(interface: &str) -> Result<(LinkAddr, bool), TransportError> {
    let mut present = Vec::new();
    let listed = getifaddrs().map_err(|error| TransportError::Failed {
        what: "the network interfaces cannot be listed".into(),
        source: error.into(),
    })?;
    for entry in listed {
        let Some(link) = entry.address.as_ref().and_then(|address| address.as_link_addr()) else {
            continue;
        };
        if entry.interface_name == interface {
            return Ok((*link, entry.flags.contains(InterfaceFlags::IFF_UP)));
        }
        present.push(entry.interface_name);
    }
    Err(TransportError::NoInterface {
        interface: interface.into(),
        present,
    })
}

impl Raw {
    fn open(interface: &str) -> Result<Self, TransportError> {
        let (link, is_up) = find(interface)?;
        let failed = |error: Errno| match error {
            Errno::EPERM | Errno::EACCES => TransportError::Rights {
                interface: interface.into(),
                program: std::env::current_exe().unwrap_or_else(|_| PathBuf::from("etherpen")),
            },
            error => TransportError::Failed {
                what: format!("raw frames on {interface}"),
                source: error.into(),
            },
        };
        let flags = SockFlag::SOCK_CLOEXEC | SockFlag::SOCK_NONBLOCK;
        let socket = socket(AddressFamily::Packet, SockType::Raw, flags, SockProtocol::EthAll).map_err(failed)?;
        bind(socket.as_raw_fd(), &link).map_err(failed)?;
        if !is_up {
            return Err(TransportError::Down {
                interface: interface.into(),
            });
        }
        let raw = Self {
            interface: interface.into(),
            socket,
        };
        raw.discard_frames_before_binding();
        Ok(raw)
    }

    /// Until it is bound, a packet socket receives from every interface.
    fn discard_frames_before_binding(&self) {
        let mut frame = [0; FRAME_LEN_MAX];
        for _ in 0..PASSED_OVER_MAX {
            if recv(&self.socket, &mut frame[..], RecvFlags::empty()).is_err() {
                return;
            }
        }
    }

    fn send(&self, frame: &[u8]) -> io::Result<()> {
        unless_blocked(send(&self.socket, frame, SendFlags::empty())).map(|_| ())
    }

    fn receive(&self, frame: &mut [u8], wait: Duration) -> io::Result<Option<usize>> {
        if let Some(length) = self.receive_now(frame)? {
            return Ok(Some(length));
        }
        wait_for(&mut [PollFd::new(&self.socket, PollFlags::IN)], wait)?;
        self.receive_now(frame)
    }

    fn receive_now(&self, frame: &mut [u8]) -> io::Result<Option<usize>> {
        for _ in 0..PASSED_OVER_MAX {
            let Some((_, length)) = unless_blocked(recv(&self.socket, &mut *frame, RecvFlags::empty()))? else {
                return Ok(None);
            };
            if frame.get(12..14) == Some(&ETHERTYPE.to_be_bytes()[..]) {
                return Ok(Some(length));
            }
        }
        Ok(None)
    }
}

/// A master's end.
pub(super) struct FramePort(Raw);

impl FramePort {
    pub(super) fn open(interface: &str) -> Result<Self, TransportError> {
        Raw::open(interface).map(Self)
    }
}

impl Transport for FramePort {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        self.0.send(frame)
    }

    fn receive(&mut self, frame: &mut [u8], wait: Duration) -> io::Result<Option<usize>> {
        self.0.receive(frame, wait)
    }
}

/// A segment's end.
pub(super) struct RawPort(Raw);

impl RawPort {
    pub(super) fn open(interface: &str) -> Result<Self, TransportError> {
        Raw::open(interface).map(Self)
    }
}

impl SegmentPort for RawPort {
    fn endpoint(&self) -> Endpoint {
        Endpoint::Interface(self.0.interface.clone())
    }

    fn receive(&mut self, wait: Duration) -> io::Result<Option<(Master, Vec<u8>)>> {
        let mut frame = vec![0; FRAME_LEN_MAX];
        let received = self.0.receive(&mut frame, wait)?;
        Ok(received.map(|length| {
            frame.truncate(length);
            (Master::Interface, frame)
        }))
    }

    fn send(&mut self, _: Master, frame: &[u8]) -> io::Result<()> {
        self.0.send(frame)
    }
}
