//! The firmware image in QEMU without lockstep: virtual time follows wall time, and UART0, the link, is a TCP port.
//!
//! For manual use, not for measurements: a busy computer makes frames late and skips milliseconds, which the firmware
//! counts and tolerates.

use super::error::EmulatorError;
use super::lockstep::Incoming;
use super::log::{self, Decoder, LogLine};
use super::process::{Directory, Process};
use super::{FIRMWARE_SOCKET, Segment, bind, cable, machine, send};
use defmt_decoder::Table;
use std::ffi::OsString;
use std::io::{self, ErrorKind};
use std::net::TcpListener;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// The Ethernet cable to the emulator's user network: 10.0.2.0/24 with a DHCP server, where 10.0.2.2 is this computer's
/// loopback interface.
const USER_NETWORK: &str = "user,id=cable";
/// Time to wait for a frame before the log and the emulator are checked.
const RECEIVE_TIMEOUT: Duration = Duration::from_millis(20);
const FRAME_BYTES_MAX: usize = 2048;

/// A running emulator; dropping it ends the emulator.
pub struct FreeRunning {
    port: u16,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<(), EmulatorError>>>,
}

impl FreeRunning {
    /// Starts the firmware `image` with `segment` on its cable. UART0 listens on TCP port `port` of the loopback
    /// interface; 0 selects a free port.
    ///
    /// # Errors
    /// A missing image or emulator, no free port, or a working directory that cannot be made.
    pub fn start(
        image: &Path,
        qemu: &Path,
        port: u16,
        segment: impl Segment + Send + 'static,
        line: impl FnMut(&LogLine) + Send + 'static,
    ) -> Result<Self, EmulatorError> {
        let directory = Directory::make()?;
        let wire = Wire {
            socket: bind(&directory)?,
            firmware: directory.join(FIRMWARE_SOCKET),
            segment,
            started: Instant::now(),
        };
        Self::start_at(image, qemu, port, directory, &cable(), Some(wire), line)
    }

    /// Starts the firmware `image` on the emulator's user network, for EtherCAT in UDP: the firmware reaches a segment
    /// that listens on this computer's loopback interface as 10.0.2.2.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn start_on_user_network(
        image: &Path,
        qemu: &Path,
        port: u16,
        line: impl FnMut(&LogLine) + Send + 'static,
    ) -> Result<Self, EmulatorError> {
        let directory = Directory::make()?;
        Self::start_at(
            image,
            qemu,
            port,
            directory,
            USER_NETWORK,
            None::<Wire<NoSegment>>,
            line,
        )
    }

    fn start_at(
        image: &Path,
        qemu: &Path,
        port: u16,
        directory: Directory,
        cable: &str,
        wire: Option<Wire<impl Segment + Send + 'static>>,
        line: impl FnMut(&LogLine) + Send + 'static,
    ) -> Result<Self, EmulatorError> {
        let table = log::table(image)?;
        let log = Incoming::new(directory.fifo_from_firmware("log")?);
        let port = free_port(port).map_err(EmulatorError::io(format!("TCP port {port}")))?;
        let mut arguments = machine(image, cable)?;
        let uart = format!("socket,id=uart,host=127.0.0.1,port={port},server=on,wait=off");
        // Counted instructions keep the firmware's tasks in proportion when the computer is busy; the clock still
        // follows wall time.
        let clock = ["-icount", "shift=3,sleep=on"];
        arguments.extend(
            clock
                .into_iter()
                .chain(["-chardev", &uart, "-serial", "chardev:uart"])
                .map(OsString::from),
        );
        let process = Process::start(qemu, &arguments, directory)?;
        let stop = Arc::new(AtomicBool::new(false));
        let peer = Peer {
            process,
            log,
            wire,
            stop: Arc::clone(&stop),
        };
        let thread = std::thread::Builder::new()
            .name("emulator".to_owned())
            .spawn(move || peer.run(table.as_ref(), line))
            .map_err(EmulatorError::io("starting the emulator's thread"))?;
        Ok(Self {
            port,
            stop,
            thread: Some(thread),
        })
    }

    /// The TCP port of the link.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Whether the emulator still runs; if not, [`FreeRunning::stop`] returns why.
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }

    /// Ends the emulator.
    ///
    /// # Errors
    /// An earlier error, if there was one.
    pub fn stop(mut self) -> Result<(), EmulatorError> {
        self.join()
    }

    fn join(&mut self) -> Result<(), EmulatorError> {
        self.stop.store(true, Ordering::Relaxed);
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            Some(Err(_)) | None => Err(EmulatorError::PeerPanicked),
        }
    }
}

impl Drop for FreeRunning {
    fn drop(&mut self) {
        // The owner did not ask for the result.
        let _ = self.join();
    }
}

/// The requested port, or a free one for 0. If another program takes it before the emulator does, the emulator reports
/// an error.
fn free_port(port: u16) -> io::Result<u16> {
    Ok(TcpListener::bind(("127.0.0.1", port))?.local_addr()?.port())
}

/// Data owned by the thread; the emulator ends with it.
struct Peer<S> {
    process: Process,
    log: Incoming,
    wire: Option<Wire<S>>,
    stop: Arc<AtomicBool>,
}

/// This program's end of the Ethernet cable.
struct Wire<S> {
    socket: UnixDatagram,
    firmware: PathBuf,
    segment: S,
    started: Instant,
}

/// Placeholder for a cable without a segment.
enum NoSegment {}

impl Segment for NoSegment {
    fn frame(&mut self, _: u64, _: &[u8]) -> Vec<Vec<u8>> {
        match *self {}
    }

    fn advance_to(&mut self, _: u64) {
        match *self {}
    }
}

impl<S: Segment> Peer<S> {
    fn run(mut self, table: Option<&Table>, mut line: impl FnMut(&LogLine)) -> Result<(), EmulatorError> {
        if let Some(Wire { socket, .. }) = &self.wire {
            let set_up = socket
                .set_nonblocking(false)
                .and_then(|()| socket.set_read_timeout(Some(RECEIVE_TIMEOUT)));
            set_up.map_err(EmulatorError::io("setting up the Ethernet socket"))?;
        }
        let mut decoder = Decoder::new(table);
        while !self.stop.load(Ordering::Relaxed) {
            match &mut self.wire {
                Some(wire) => wire.answer().map_err(EmulatorError::io("answering the emulator"))?,
                None => std::thread::sleep(RECEIVE_TIMEOUT),
            }
            self.log
                .read()
                .map_err(EmulatorError::io("reading the log of the emulator"))?;
            decoder.take(&self.log.take(), &mut line);
            if let Some(status) = self.process.ended() {
                return Err(EmulatorError::Ended {
                    status,
                    said: self.process.said(),
                    log: decoder.last(),
                    black_box: self.process.take_black_box(),
                });
            }
        }
        Ok(())
    }
}

impl<S: Segment> Wire<S> {
    /// Answers one frame, or advances the time.
    fn answer(&mut self) -> io::Result<()> {
        let mut frame = [0; FRAME_BYTES_MAX];
        let received = self.socket.recv(&mut frame);
        let time_us = u64::try_from(self.started.elapsed().as_micros()).unwrap_or(u64::MAX);
        self.segment.advance_to(time_us);
        match received {
            Ok(length) => {
                let frame = frame.get(..length).unwrap_or_default();
                for reply in self.segment.frame(time_us, frame) {
                    // Nobody waits for a reply that is not taken.
                    let _taken = send(&self.socket, &self.firmware, &reply)?;
                }
                Ok(())
            }
            Err(error) if is_timeout(&error) => Ok(()),
            Err(error) => Err(error),
        }
    }
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
    )
}
