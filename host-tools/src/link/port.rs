//! Real ports: a serial line, a TCP or a Unix socket, and the wall clock that drives the communication over one.
//!
//! A reader thread passes on received bytes; the calling thread steps the job about once a millisecond and writes no
//! faster than the line carries, so that no bytes queue ahead of a stop. Invariant: a port that has disappeared is an
//! error with its name and what to try, never a wait.

use super::ownership::{self, Owner, Ownership};
pub use super::port_name::PortName;
use crate::error::{ProgramError, code};
use etherpen::link::device::LINE_BYTES_PER_MS;
use std::fmt;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

/// Baud rate of serial ports.
pub const BAUD: u32 = 921_600;
/// Longest time that a read blocks before it checks whether the job has ended.
const READ_MAX: Duration = Duration::from_millis(100);
/// Longest wait for a TCP connection.
const CONNECT_MAX: Duration = Duration::from_secs(5);
/// Longest time that a write may block before the port counts as stuck.
const WRITE_MAX: Duration = Duration::from_millis(1_000);
/// Most milliseconds of line time that are caught up at once after the program was not scheduled.
const BURST_MS: u64 = 20;

const _: () = assert!(BAUD as usize / 10_000 == LINE_BYTES_PER_MS);

/// Error of a port.
#[derive(Debug)]
pub enum PortError {
    /// Another program uses the port.
    Occupied {
        /// The port.
        port: PortName,
        /// The program, if known.
        owner: Option<Owner>,
    },
    /// The port could not be opened.
    Open {
        /// The port.
        port: PortName,
        /// The cause.
        source: io::Error,
    },
    /// The other side has closed the port, or the cable was pulled.
    Closed {
        /// The port.
        port: PortName,
    },
    /// The port could not be read or written.
    Failed {
        /// The port.
        port: PortName,
        /// The cause.
        source: io::Error,
    },
}

impl fmt::Display for PortError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Occupied {
                port,
                owner: Some(owner),
            } => write!(f, "{port} is in use by {owner}; end that program, or work through it"),
            Self::Occupied { port, owner: None } => {
                write!(
                    f,
                    "{port} is in use by another program; end that program, then try again"
                )
            }
            Self::Open { port, source } => write!(f, "{port} could not be opened ({source}); {}", remedy(port, source)),
            Self::Closed { port } => write!(
                f,
                "{port} was closed by the other side; check cable and board (or that the emulator still runs), then \
                 connect again"
            ),
            Self::Failed { port, source } => {
                write!(f, "{port} failed ({source}); check the cable, then connect again")
            }
        }
    }
}

impl std::error::Error for PortError {}

impl From<&PortError> for ProgramError {
    fn from(error: &PortError) -> Self {
        Self::new(code::CONNECTION, error)
    }
}

fn remedy(port: &PortName, error: &io::Error) -> String {
    match (port, error.kind()) {
        (PortName::Serial(_), ErrorKind::PermissionDenied) => {
            "add yourself to the port's group (sudo usermod -aG dialout $USER) and log in again".into()
        }
        (PortName::Unix(_), ErrorKind::PermissionDenied) => "the socket belongs to another user".into(),
        (PortName::Serial(_), ErrorKind::NotFound) => format!("plug in the board; {}", ports_present()),
        (_, ErrorKind::NotFound | ErrorKind::ConnectionRefused) => {
            "nothing listens there; start etherpen emulate and use the port it prints".into()
        }
        _ => "check the name and the cable".into(),
    }
}

fn ports_present() -> String {
    let ports = serial2::SerialPort::available_ports().unwrap_or_default();
    let names: Vec<String> = ports.iter().map(|port| port.display().to_string()).collect();
    if names.is_empty() {
        "there is no serial port now".into()
    } else {
        format!("present are {}", names.join(", "))
    }
}

/// An open port: its two directions, and its ownership.
pub struct Port {
    name: PortName,
    reader: Box<dyn Read + Send>,
    writer: Box<dyn Write + Send>,
    ownership: Option<Arc<Ownership>>,
}

impl Port {
    /// Opens a port; a serial one with [`BAUD`], 8 data bits, no parity, 1 stop bit, no flow control.
    ///
    /// # Errors
    /// [`PortError::Occupied`] and [`PortError::Open`].
    pub fn open(name: &PortName) -> Result<Self, PortError> {
        let ownership = own(name)?;
        Self::open_owned(name, ownership)
    }

    /// Opens a port that the program already owns.
    ///
    /// # Errors
    /// [`PortError::Occupied`] by a program that does not take part in the ownership protocol, and [`PortError::Open`].
    pub fn open_owned(name: &PortName, ownership: Option<Arc<Ownership>>) -> Result<Self, PortError> {
        let opened = match name {
            PortName::Serial(path) => {
                if let Some(owner) = ownership::holder_of(path) {
                    let (port, owner) = (name.clone(), Some(owner));
                    return Err(PortError::Occupied { port, owner });
                }
                open_serial(path)
            }
            PortName::Tcp(address) => open_tcp(address),
            PortName::Unix(path) => open_unix(path),
        };
        let (reader, writer) = opened.map_err(|source| match source.kind() {
            ErrorKind::ResourceBusy => PortError::Occupied {
                port: name.clone(),
                owner: None,
            },
            _ => PortError::Open {
                port: name.clone(),
                source,
            },
        })?;
        Ok(Self {
            name: name.clone(),
            reader,
            writer,
            ownership,
        })
    }
}

/// Takes the ownership of a port; `None` where no folder for ownership files exists.
///
/// # Errors
/// [`PortError::Occupied`].
pub fn own(name: &PortName) -> Result<Option<Arc<Ownership>>, PortError> {
    match Ownership::take(name) {
        Ok(Ok(ownership)) => Ok(Some(Arc::new(ownership))),
        Ok(Err(owner)) => Err(PortError::Occupied {
            port: name.clone(),
            owner: Some(owner),
        }),
        Err(_) => Ok(None),
    }
}

type Directions = (Box<dyn Read + Send>, Box<dyn Write + Send>);

fn open_serial(path: &PathBuf) -> io::Result<Directions> {
    let mut writer = serial2::SerialPort::open(path, BAUD)?;
    // The kernel refuses programs that open the device later.
    rustix::termios::ioctl_tiocexcl(&writer)?;
    writer.set_read_timeout(READ_MAX)?;
    writer.set_write_timeout(WRITE_MAX)?;
    writer.discard_buffers()?;
    let reader = writer.try_clone()?;
    Ok((Box::new(reader), Box::new(writer)))
}

fn open_tcp(address: &str) -> io::Result<Directions> {
    let mut last = io::Error::new(ErrorKind::NotFound, "the address has no meaning");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT_MAX) {
            Ok(writer) => {
                writer.set_nodelay(true)?;
                writer.set_read_timeout(Some(READ_MAX))?;
                writer.set_write_timeout(Some(WRITE_MAX))?;
                return Ok((Box::new(writer.try_clone()?), Box::new(writer)));
            }
            Err(error) => last = error,
        }
    }
    Err(last)
}

fn open_unix(path: &PathBuf) -> io::Result<Directions> {
    let writer = UnixStream::connect(path)?;
    writer.set_read_timeout(Some(READ_MAX))?;
    writer.set_write_timeout(Some(WRITE_MAX))?;
    Ok((Box::new(writer.try_clone()?), Box::new(writer)))
}

/// A port driven by the wall clock: received bytes are passed on, outgoing bytes are sent as fast as the line carries
/// them.
pub struct Line {
    name: PortName,
    writer: Box<dyn Write + Send>,
    arrived: Receiver<io::Result<Vec<u8>>>,
    ended: Arc<AtomicBool>,
    reading: Option<thread::JoinHandle<()>>,
    begun: Instant,
    stepped_ms: u64,
    outgoing: Vec<u8>,
    _ownership: Option<Arc<Ownership>>,
}

impl Line {
    /// Starts the clock.
    pub fn start(port: Port) -> Self {
        let Port {
            name,
            reader,
            writer,
            ownership,
        } = port;
        let ended = Arc::new(AtomicBool::new(false));
        let (sender, arrived) = mpsc::channel();
        let reading = thread::spawn({
            let ended = ended.clone();
            move || read_until_ended(reader, &sender, &ended)
        });
        Self {
            name,
            writer,
            arrived,
            ended,
            reading: Some(reading),
            begun: Instant::now(),
            stepped_ms: 0,
            outgoing: Vec::new(),
            _ownership: ownership,
        }
    }

    /// Waits about a millisecond, then calls `step` with the milliseconds since the start, the received bytes, the
    /// buffer for bytes to send, and the number of bytes for which the line has time. Returns the milliseconds.
    ///
    /// # Errors
    /// [`PortError::Closed`] or [`PortError::Failed`].
    pub fn exchange(&mut self, step: impl FnOnce(u64, &[u8], &mut Vec<u8>, usize)) -> Result<u64, PortError> {
        let failed = |source| PortError::Failed {
            port: self.name.clone(),
            source,
        };
        let incoming = match self.arrived.recv_timeout(Duration::from_millis(1)) {
            Ok(Ok(bytes)) if !bytes.is_empty() => bytes,
            Err(RecvTimeoutError::Timeout) => Vec::new(),
            Ok(Err(source)) => return Err(failed(source)),
            Ok(Ok(_)) | Err(RecvTimeoutError::Disconnected) => {
                return Err(PortError::Closed {
                    port: self.name.clone(),
                });
            }
        };
        let now_ms = self.begun.elapsed().as_millis() as u64;
        let room = (now_ms - self.stepped_ms).min(BURST_MS) as usize * LINE_BYTES_PER_MS;
        self.stepped_ms = now_ms;
        self.outgoing.clear();
        step(now_ms, &incoming, &mut self.outgoing, room);
        self.writer.write_all(&self.outgoing).map_err(failed)?;
        Ok(now_ms)
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        if let Some(reading) = self.reading.take() {
            // A reader that panicked has closed its channel, which counts as the end of the port.
            let _ = reading.join();
        }
    }
}

/// Passes on received bytes; sends an error last, or an empty block when the other side has closed.
fn read_until_ended(mut reader: Box<dyn Read + Send>, sender: &mpsc::Sender<io::Result<Vec<u8>>>, ended: &AtomicBool) {
    let mut block = [0; 4096];
    while !ended.load(Ordering::Relaxed) {
        let result = match reader.read(&mut block) {
            Err(error) if is_pause(&error) => continue,
            Err(error) => Err(error),
            Ok(length) => Ok(block[..length].to_vec()),
        };
        let last = !matches!(&result, Ok(bytes) if !bytes.is_empty());
        if sender.send(result).is_err() || last {
            return;
        }
    }
}

fn is_pause(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_cannot_be_opened_names_itself_and_what_to_try() {
        let open = |name: &str| Port::open(&name.parse().unwrap()).err().unwrap().to_string();
        assert!(open("/dev/etherpen-absent").contains("plug in the board"));
        assert!(open("unix:/absent/socket").contains("etherpen emulate"));
        let denied = PortError::Open {
            port: PortName::Serial("/dev/ttyACM0".into()),
            source: ErrorKind::PermissionDenied.into(),
        };
        assert!(denied.to_string().contains("dialout"));
    }
}
