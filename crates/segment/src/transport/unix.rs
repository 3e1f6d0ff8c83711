//! Frames through a Unix socket of type SOCK_SEQPACKET (unix(7)): one Ethernet frame in a message.
//!
//! Invariant: a stale socket file is replaced; a socket on which a program listens never is.

use super::{Endpoint, Master, SegmentPort, Transport, TransportError, unless_blocked, wait_for};
use etherpen_ethercat::wire::FRAME_LEN_MAX;
use rustix::event::{PollFd, PollFlags};
use rustix::io::Errno;
use rustix::net::{
    AddressFamily, RecvFlags, SendFlags, SocketAddrUnix, SocketFlags, SocketType, accept_with, bind, connect, listen,
    recv, send, socket_with,
};
use std::fs;
use std::io::{self, ErrorKind};
use std::os::fd::OwnedFd;
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Connections that may wait to be accepted.
const BACKLOG: i32 = 8;
/// Most masters at a time.
const MASTERS_MAX: usize = 16;

fn failed(path: &Path) -> impl Fn(Errno) -> TransportError + '_ {
    move |error| TransportError::failed(format!("the Unix socket {}", path.display()))(error.into())
}

fn socket() -> rustix::io::Result<OwnedFd> {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None)
}

/// A master's end.
pub(super) struct UnixTransport {
    socket: OwnedFd,
}

impl UnixTransport {
    pub(super) fn open(path: &Path) -> Result<Self, TransportError> {
        let address = SocketAddrUnix::new(path).map_err(failed(path))?;
        let socket = socket().map_err(failed(path))?;
        match connect(&socket, &address) {
            Ok(()) => Ok(Self { socket }),
            Err(Errno::CONNREFUSED | Errno::NOENT) => Err(TransportError::Nobody(path.into())),
            Err(Errno::PROTOTYPE | Errno::NOTSOCK) => Err(TransportError::NoSocket(path.into())),
            Err(error) => Err(failed(path)(error)),
        }
    }
}

impl Transport for UnixTransport {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        unless_blocked(send(&self.socket, frame, SendFlags::NOSIGNAL)).map(|_| ())
    }

    fn receive(&mut self, frame: &mut [u8], wait: Duration) -> io::Result<Option<usize>> {
        wait_for(&mut [PollFd::new(&self.socket, PollFlags::IN)], wait)?;
        match unless_blocked(recv(&self.socket, frame, RecvFlags::empty()))? {
            Some((_, 0)) => Err(ErrorKind::UnexpectedEof.into()),
            received => Ok(received.map(|(_, length)| length)),
        }
    }
}

/// A segment's end.
pub(super) struct UnixPort {
    path: PathBuf,
    listener: OwnedFd,
    masters: Vec<(u64, OwnedFd)>,
    next: u64,
}

impl UnixPort {
    pub(super) fn listen(path: &Path) -> Result<Self, TransportError> {
        remove_if_left_behind(path)?;
        let address = SocketAddrUnix::new(path).map_err(failed(path))?;
        let listener = socket().map_err(failed(path))?;
        bind(&listener, &address).map_err(|error| match error {
            Errno::ADDRINUSE => TransportError::PathInUse(path.into()),
            error => failed(path)(error),
        })?;
        let port = Self {
            path: path.into(),
            listener,
            masters: Vec::new(),
            next: 0,
        };
        listen(&port.listener, BACKLOG).map_err(failed(path))?;
        Ok(port)
    }

    fn accept(&mut self) {
        let accepted = accept_with(&self.listener, SocketFlags::CLOEXEC | SocketFlags::NONBLOCK);
        if let Ok(master) = accepted
            && self.masters.len() < MASTERS_MAX
        {
            self.masters.push((self.next, master));
            self.next = self.next.wrapping_add(1);
        }
    }

    /// A frame that is already there; masters that have disconnected are removed.
    fn receive_now(&mut self) -> Option<(Master, Vec<u8>)> {
        let mut frame = vec![0; FRAME_LEN_MAX];
        let mut found = None;
        self.masters.retain(|(number, socket)| {
            if found.is_some() {
                return true;
            }
            match recv(socket, &mut frame[..], RecvFlags::empty()) {
                Ok((_, length)) if length > 0 => {
                    found = Some((*number, length));
                    true
                }
                Err(Errno::AGAIN | Errno::INTR) => true,
                Ok(_) | Err(_) => false,
            }
        });
        let (number, length) = found?;
        frame.truncate(length);
        // The other masters come first in the next call.
        if let Some(place) = self.masters.iter().position(|(other, _)| *other == number) {
            self.masters.rotate_left(place + 1);
        }
        Some((Master::Unix(number), frame))
    }
}

impl SegmentPort for UnixPort {
    fn endpoint(&self) -> Endpoint {
        Endpoint::Unix(self.path.clone())
    }

    fn receive(&mut self, wait: Duration) -> io::Result<Option<(Master, Vec<u8>)>> {
        let mut waited = vec![PollFd::new(&self.listener, PollFlags::IN)];
        waited.extend(
            self.masters
                .iter()
                .map(|(_, socket)| PollFd::new(socket, PollFlags::IN)),
        );
        wait_for(&mut waited, wait)?;
        self.accept();
        Ok(self.receive_now())
    }

    fn send(&mut self, master: Master, frame: &[u8]) -> io::Result<()> {
        let is_it = |(number, _): &&(u64, OwnedFd)| master == Master::Unix(*number);
        if let Some((_, socket)) = self.masters.iter().find(is_it) {
            // The next call notices that a master has disconnected.
            let _ = send(socket, frame, SendFlags::NOSIGNAL);
        }
        Ok(())
    }
}

impl Drop for UnixPort {
    fn drop(&mut self) {
        // What cannot be removed is replaced at the next start.
        let _ = fs::remove_file(&self.path);
    }
}

/// Removes a socket file if no program listens on it.
fn remove_if_left_behind(path: &Path) -> Result<(), TransportError> {
    let Ok(there) = fs::symlink_metadata(path) else {
        return Ok(());
    };
    if !there.file_type().is_socket() {
        return Err(TransportError::NoSocket(path.into()));
    }
    match UnixTransport::open(path) {
        Err(TransportError::Nobody(_)) => {
            fs::remove_file(path).map_err(TransportError::failed(format!("{} cannot be removed", path.display())))
        }
        Ok(_) | Err(TransportError::NoSocket(_)) => Err(TransportError::PathInUse(path.into())),
        Err(error) => Err(error),
    }
}
