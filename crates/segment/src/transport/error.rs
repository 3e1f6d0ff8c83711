//! Why a transport cannot be opened, and what to try.

use std::fmt;
use std::io;
use std::net::SocketAddrV4;
use std::path::PathBuf;

/// Why a transport cannot be opened.
#[derive(Debug)]
pub enum TransportError {
    /// This program may not use raw sockets.
    Rights {
        /// The requested interface.
        interface: String,
        /// This program.
        program: PathBuf,
    },
    /// The interface does not exist.
    NoInterface {
        /// The requested interface.
        interface: String,
        /// Existing interfaces.
        present: Vec<String>,
    },
    /// The interface is down.
    Down {
        /// The interface.
        interface: String,
    },
    /// Another program has the UDP port.
    PortInUse(SocketAddrV4),
    /// The address does not belong to this computer.
    NotHere(SocketAddrV4),
    /// Another program listens at the Unix socket.
    PathInUse(PathBuf),
    /// The path exists but is not a segment's socket.
    NoSocket(PathBuf),
    /// No program listens at the Unix socket.
    Nobody(PathBuf),
    /// Any other error of the operating system.
    Failed {
        /// The operation that failed.
        what: String,
        /// The cause.
        source: io::Error,
    },
}

impl TransportError {
    pub(super) fn failed(what: impl fmt::Display) -> impl FnOnce(io::Error) -> Self {
        let what = what.to_string();
        move |source| Self::Failed { what, source }
    }
}

impl fmt::Display for TransportError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rights { interface, program } => write!(
                f,
                "raw frames on {interface} need a right that this program does not have. Run it as root, or once:\n  \
                 sudo setcap cap_net_raw+ep {}",
                program.display()
            ),
            Self::NoInterface { interface, present } => write!(
                f,
                "there is no network interface {interface}; there are {}",
                present.join(", ")
            ),
            Self::Down { interface } => write!(
                f,
                "the network interface {interface} is down. Try: sudo ip link set {interface} up"
            ),
            Self::PortInUse(address) => write!(
                f,
                "UDP port {} of {} is taken by another program; end it (sudo ss -lunp shows which), or choose another \
                 port: --udp {}:{}",
                address.port(),
                address.ip(),
                address.ip(),
                address.port().saturating_add(1)
            ),
            Self::NotHere(address) => write!(
                f,
                "{} is no address of this computer; --udp 127.0.0.1 is reached by programs here, --udp 0.0.0.0 by \
                 everybody",
                address.ip()
            ),
            Self::PathInUse(path) => write!(
                f,
                "another program listens at {}; end it, or choose another path",
                path.display()
            ),
            Self::NoSocket(path) => write!(
                f,
                "{} exists and is no segment's socket; choose another path",
                path.display()
            ),
            Self::Nobody(path) => write!(
                f,
                "nobody listens at {0}; start a segment there: etherpen segment --unix {0}",
                path.display()
            ),
            Self::Failed { what, source } => write!(f, "{what}: {source}"),
        }
    }
}

impl std::error::Error for TransportError {}
