//! Real ports: a serial line, a TCP or a Unix socket, and the wall clock that drives a job over one.
//!
//! A reader thread passes on received bytes; the calling thread steps the job about once a millisecond and writes no
//! faster than the line carries, so that no bytes queue ahead of a stop. Invariant: a port that has disappeared is an
//! error with its name and what to try, never a wait.

use super::error::JobError;
use super::job::{Control, Job, JobEvent};
use super::ownership::{self, Owner, Ownership};
use super::progress::Progress;
use etherpen::link::device::LINE_BYTES_PER_MS;
use std::fmt;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::str::FromStr;
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
/// Time between two reports of progress, ms.
const PROGRESS_MS: u64 = 100;
/// Most milliseconds of line time that are caught up at once after the program was not scheduled.
const BURST_MS: u64 = 20;

const _: () = assert!(BAUD as usize / 10_000 == LINE_BYTES_PER_MS);

/// Address of the firmware.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PortName {
    /// A serial device, for instance `/dev/ttyACM0`.
    Serial(PathBuf),
    /// `tcp:host:port`.
    Tcp(String),
    /// `unix:path`.
    Unix(PathBuf),
}

impl FromStr for PortName {
    type Err = PortError;

    fn from_str(text: &str) -> Result<Self, PortError> {
        let name = match text.split_once(':') {
            Some(("tcp", address)) if address.contains(':') => Self::Tcp(address.into()),
            Some(("unix", path)) if !path.is_empty() => Self::Unix(path.into()),
            Some(("tcp" | "unix", _)) => return Err(PortError::Name(text.into())),
            _ if text.is_empty() => return Err(PortError::Name(text.into())),
            Some((host, port)) if !host.contains('/') && port.parse::<u16>().is_ok() => {
                return Err(PortError::Scheme(text.into()));
            }
            _ => Self::Serial(text.into()),
        };
        Ok(name)
    }
}

impl fmt::Display for PortName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial(path) => write!(f, "{}", path.display()),
            Self::Tcp(address) => write!(f, "tcp:{address}"),
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
        }
    }
}

/// Error of a port.
#[derive(Debug)]
pub enum PortError {
    /// The name is not a valid port name.
    Name(String),
    /// The name is a network address without its scheme.
    Scheme(String),
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
            Self::Name(name) => {
                write!(f, "'{name}' is no port; use /dev/tty.., tcp:host:port or unix:path")
            }
            Self::Scheme(name) => write!(f, "'{name}' is a network address; write tcp:{name}"),
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

/// Why a job over a port ended early.
#[derive(Debug)]
pub enum RunError {
    /// The job failed.
    Job(Box<JobError>),
    /// The port failed.
    Port(PortError),
}

impl fmt::Display for RunError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Job(error) => error.fmt(f),
            Self::Port(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for RunError {}

/// What a running job reports.
#[derive(Clone, Copy, Debug)]
pub enum Show<'a> {
    /// Something happened.
    Event(&'a JobEvent),
    /// Progress of the drawing, ten times a second.
    Progress(&'a Progress),
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

/// Runs a job over a port by the wall clock until it ends; [`Job::into_report`] returns the collected data.
///
/// Controls returned by `control` are carried out at once.
///
/// # Errors
/// The job's error, or the port's.
pub fn run_job(
    port: Port,
    job: &mut Job,
    control: &mut dyn FnMut() -> Option<Control>,
    show: &mut dyn FnMut(Show<'_>),
) -> Result<(), RunError> {
    let mut line = Line::start(port);
    let mut shown_ms = 0;
    loop {
        let now_ms = line
            .exchange(|now_ms, incoming, outgoing, room| {
                while let Some(control) = control() {
                    job.control(control);
                }
                job.step(now_ms, incoming, outgoing, room);
            })
            .map_err(RunError::Port)?;
        while let Some(event) = job.next_event() {
            show(Show::Event(&event));
        }
        let outcome = job.outcome().copied();
        if outcome.is_some() || now_ms.saturating_sub(shown_ms) >= PROGRESS_MS {
            shown_ms = now_ms;
            show(Show::Progress(&job.progress()));
        }
        if let Some(outcome) = outcome {
            return outcome.map_err(|error| RunError::Job(Box::new(error)));
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
    use super::super::bench::{Bench, path, serve};
    use super::super::job::JobOptions;
    use super::*;
    use etherpen::config::Config;
    use std::net::TcpListener;
    use std::os::unix::net::UnixListener;

    fn job(count: usize) -> Job {
        Job::draw(Config::default(), path(count), JobOptions::default())
    }

    #[test]
    fn a_drawing_goes_over_a_socket_by_the_wall_clock() {
        let place = std::env::temp_dir().join(format!("etherpen-port-{}", std::process::id()));
        let _ = std::fs::remove_file(&place);
        let listener = UnixListener::bind(&place).unwrap();
        let firmware = thread::spawn(move || {
            let mut bench = Bench::new(1, 0);
            serve(&mut bench, &listener.accept().unwrap().0);
            bench
        });
        let port = Port::open(&format!("unix:{}", place.display()).parse().unwrap()).unwrap();
        let (mut job, mut last) = (job(100), Progress::default());
        run_job(port, &mut job, &mut || None, &mut |show| {
            if let Show::Progress(progress) = show {
                last = *progress;
            }
        })
        .unwrap();
        std::fs::remove_file(&place).unwrap();
        assert_eq!(firmware.join().unwrap().vertices, path(100));
        assert_eq!((last.vertices, last.vertices_total), (100, 100));
    }

    #[test]
    fn a_port_that_the_other_side_closes_is_an_error_at_once() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let name = PortName::Tcp(listener.local_addr().unwrap().to_string());
        let port = Port::open(&name).unwrap();
        drop(listener.accept().unwrap());
        let error = run_job(port, &mut job(1), &mut || None, &mut |_| {}).unwrap_err();
        assert!(matches!(
            error,
            RunError::Port(PortError::Closed { .. } | PortError::Failed { .. })
        ));
    }

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

    #[test]
    fn names_of_ports_are_told_apart() {
        let name = |text: &str| text.parse::<PortName>().ok();
        assert_eq!(name("tcp:localhost:7000"), Some(PortName::Tcp("localhost:7000".into())));
        assert_eq!(name("unix:/run/a"), Some(PortName::Unix("/run/a".into())));
        assert_eq!(name("/dev/ttyACM0"), Some(PortName::Serial("/dev/ttyACM0".into())));
        assert_eq!([name(""), name("tcp:7000"), name("unix:")], [None, None, None]);
        let hint = "127.0.0.1:5000".parse::<PortName>().unwrap_err().to_string();
        assert!(hint.contains("tcp:127.0.0.1:5000"), "{hint}");
    }
}
