//! The firmware image in QEMU, with a virtual EtherCAT segment and a serial peer.
//!
//! Virtual time is stopped while this side works, so a busy computer cannot make a frame late: after each Ethernet
//! frame and in each millisecond the firmware waits for an answer, in a call that takes no virtual time. One thread
//! gives all answers in the order in which the firmware asks, so the records are identical in every run. The records
//! are documented with the firmware's half, `src/bin/emulated/lockstep.rs`.
//!
//! [`Emulator::start`] runs in lockstep; [`free_running`] runs without it, for manual use of the UART.

mod client;
mod error;
pub mod free_running;
mod lockstep;
mod log;
mod process;
mod processor;
pub mod tcp_line;

pub(crate) use client::ClientSlot;
pub use error::EmulatorError;
pub(crate) use lockstep::{REPLIES_MAX, REPLY_BYTES};
pub use log::LogLine;
pub(crate) use processor::OneProcessor;

use etherpen::black_box::MEMORY_BYTES;
use lockstep::{Lockstep, Options as LockstepOptions};
use process::{Directory, Process};
use std::ffi::OsString;
use std::io::{self, ErrorKind};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Bytes of the serial link in a millisecond and direction: 921,600 baud with 10 bits a byte.
pub const LINK_BYTES_MAX: usize = 92;

const FIRMWARE_SOCKET: &str = "firmware.sock";
const HOST_SOCKET: &str = "host.sock";

/// The other end of the Ethernet cable.
pub trait Segment {
    /// Takes a frame that the firmware sent at `time_us` (since its first sample) and returns the frames that come
    /// back.
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>>;
    /// Takes a frame that the firmware sent at `time_ns` and returns the frames that come back. Segments that keep time
    /// in nanoseconds implement this; the default rounds down to microseconds.
    fn frame_at_ns(&mut self, time_ns: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.frame(time_ns / 1_000, frame)
    }
    /// Advances the segment to `time_us`, even when no frames are sent.
    fn advance_to(&mut self, time_us: u64);
}

/// The other end of the serial line.
pub trait Link {
    /// Takes the bytes that came in millisecond `ms` and appends up to [`LINK_BYTES_MAX`] for the firmware to `to_device`.
    fn exchange(&mut self, ms: u32, from_device: &[u8], to_device: &mut Vec<u8>);

    /// The next area of the firmware's memory to be read, before the firmware takes the bytes of this millisecond; asked after
    /// each [`Self::exchange`] until there is none. Reading takes no virtual time.
    fn wants(&mut self) -> Option<Area> {
        None
    }

    /// Takes an area of the firmware's memory that [`Self::wants`] has named.
    fn take_memory(&mut self, _area: Area, _bytes: Vec<u8>) {}

    /// Conditions of the board from this millisecond on; asked after each [`Self::exchange`].
    fn around(&mut self) -> Around {
        Around::default()
    }
}

/// An area of the firmware's memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Area {
    /// The black box.
    BlackBox,
}

impl Area {
    /// Length, bytes.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::BlackBox => MEMORY_BYTES,
        }
    }

    /// Its number in the lockstep.
    const fn number(self) -> u8 {
        match self {
            Self::BlackBox => 0,
        }
    }
}

/// Conditions of the board that the host controls: what its inputs, its clock and its port show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Around {
    /// The emergency-stop input shows open.
    pub stop_shows_open: bool,
    /// The board runs on its substitute clock.
    pub substitute_clock: bool,
    /// The trajectory task is not released. One that is kept waiting for longer than 96 ms starves the watchdog.
    pub trajectory_waits: bool,
    /// The Ethernet port has no link.
    pub port_is_down: bool,
}

impl Around {
    /// Its bits in the lockstep.
    fn bits(self) -> u8 {
        let conditions = [
            self.stop_shows_open,
            self.substitute_clock,
            self.trajectory_waits,
            self.port_is_down,
        ];
        (0..)
            .zip(conditions)
            .fold(0, |bits, (bit, holds)| bits | u8::from(holds) << bit)
    }
}

impl<S: Segment> Segment for Arc<Mutex<S>> {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        let mut segment = self.lock().unwrap_or_else(PoisonError::into_inner);
        segment.frame(time_us, frame)
    }

    fn frame_at_ns(&mut self, time_ns: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        let mut segment = self.lock().unwrap_or_else(PoisonError::into_inner);
        segment.frame_at_ns(time_ns, frame)
    }

    fn advance_to(&mut self, time_us: u64) {
        let mut segment = self.lock().unwrap_or_else(PoisonError::into_inner);
        segment.advance_to(time_us);
    }
}

/// A segment whose clock goes on when that of the firmware begins anew.
pub struct Later<S> {
    /// The segment.
    pub segment: S,
    /// Its time at the firmware's start, us.
    pub begun_us: u64,
}

impl<S: Segment> Segment for Later<S> {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.segment.frame(self.begun_us + time_us, frame)
    }

    fn frame_at_ns(&mut self, time_ns: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.segment.frame_at_ns(self.begun_us * 1_000 + time_ns, frame)
    }

    fn advance_to(&mut self, time_us: u64) {
        self.segment.advance_to(self.begun_us + time_us);
    }
}

impl<L: Link> Link for Arc<Mutex<L>> {
    fn exchange(&mut self, ms: u32, from_device: &[u8], to_device: &mut Vec<u8>) {
        let mut link = self.lock().unwrap_or_else(PoisonError::into_inner);
        link.exchange(ms, from_device, to_device);
    }

    fn wants(&mut self) -> Option<Area> {
        self.lock().unwrap_or_else(PoisonError::into_inner).wants()
    }

    fn take_memory(&mut self, area: Area, bytes: Vec<u8>) {
        let mut link = self.lock().unwrap_or_else(PoisonError::into_inner);
        link.take_memory(area, bytes);
    }

    fn around(&mut self) -> Around {
        self.lock().unwrap_or_else(PoisonError::into_inner).around()
    }
}

/// Pace of virtual time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// As fast as the computer can.
    Max,
    /// Never ahead of wall time.
    RealTime,
}

/// How to run the emulator.
#[derive(Clone, Debug)]
pub struct Options {
    /// The emulator's program, searched in the search path.
    pub qemu: PathBuf,
    /// One instruction takes 2^shift ns of virtual time.
    pub instruction_shift: u8,
    /// Pace of virtual time.
    pub pace: Pace,
    /// Whether the firmware's log is decoded; otherwise it is discarded.
    pub decode_log: bool,
    /// Longest wall time for the emulator to reach its next millisecond.
    pub answer_within: Duration,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            qemu: PathBuf::from("qemu-system-arm"),
            instruction_shift: 3,
            pace: Pace::Max,
            decode_log: true,
            answer_within: Duration::from_secs(20),
        }
    }
}

/// Traffic of the emulator's attachments.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Milliseconds reached by the firmware.
    pub milliseconds: u32,
    /// Frames the firmware sent.
    pub frames: u64,
    /// Frames the segment sent back.
    pub replies: u64,
    /// Replies dropped because the emulator had no room, or because they were not Ethernet frames.
    pub replies_dropped: u64,
    /// Frames that were announced but not found in the socket.
    pub frames_missing: u64,
}

/// A running emulator; dropping it ends the emulator.
pub struct Emulator {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<Traffic, EmulatorError>>>,
}

impl Emulator {
    /// Starts the firmware `image` in lockstep with `segment` and `link`; `log` gets the lines of the firmware's log.
    ///
    /// The peers are called from a thread of the emulator. To access them later, pass an `Arc<Mutex<_>>`.
    ///
    /// # Errors
    /// A missing image or emulator, or a working directory that cannot be made. Later errors are returned by
    /// [`Emulator::stop`] and [`Emulator::wait`].
    pub fn start(
        image: &Path,
        options: &Options,
        segment: impl Segment + Send + 'static,
        link: impl Link + Send + 'static,
        log: impl FnMut(&LogLine) + Send + 'static,
    ) -> Result<Self, EmulatorError> {
        let table = log::table(image)?.filter(|_| options.decode_log);
        let directory = Directory::make()?;
        let files = lockstep::Files::make(&directory)?;
        let socket = bind(&directory)?;
        let firmware_socket = directory.join(FIRMWARE_SOCKET);
        let arguments = arguments(image, options)?;
        let _together = OneProcessor::take();
        let process = Process::start(&options.qemu, &arguments, directory)?;
        let stop = Arc::new(AtomicBool::new(false));
        let lockstep = Lockstep::new(
            process,
            files,
            (socket, firmware_socket),
            (segment, link),
            LockstepOptions {
                pace: options.pace,
                answer_within: options.answer_within,
            },
            Arc::clone(&stop),
        );
        let thread = std::thread::Builder::new()
            .name("emulator".to_owned())
            .spawn(move || lockstep.run(table.as_ref(), log))
            .map_err(EmulatorError::io("starting the emulator's thread"))?;
        Ok(Self {
            stop,
            thread: Some(thread),
        })
    }

    /// Whether the emulator still runs; if not, [`Emulator::wait`] returns why.
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }

    /// Ends the emulator.
    ///
    /// # Errors
    /// An earlier error, if there was one.
    pub fn stop(mut self) -> Result<Traffic, EmulatorError> {
        self.stop.store(true, Ordering::Relaxed);
        self.join()
    }

    /// Waits until the emulator ends by itself, which happens only after an error.
    ///
    /// # Errors
    /// The error.
    pub fn wait(mut self) -> Result<Traffic, EmulatorError> {
        self.join()
    }

    fn join(&mut self) -> Result<Traffic, EmulatorError> {
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            Some(Err(_)) | None => Err(EmulatorError::PeerPanicked),
        }
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // The owner did not ask for the result.
        let _ = self.join();
    }
}

fn bind(directory: &Directory) -> Result<UnixDatagram, EmulatorError> {
    let path = directory.join(HOST_SOCKET);
    let socket = UnixDatagram::bind(&path).map_err(EmulatorError::io(format!("making {}", path.display())))?;
    socket
        .set_nonblocking(true)
        .map_err(EmulatorError::io("setting up the Ethernet socket"))?;
    Ok(socket)
}

/// Sends a reply to the emulator's end of the cable; returns false if nobody takes it now. An emulator that has just ended
/// takes none: that is no error of the cable, and its owner tells how it ended.
fn send(socket: &UnixDatagram, firmware: &Path, reply: &[u8]) -> io::Result<bool> {
    match socket.send_to(reply, firmware) {
        Ok(_) => Ok(true),
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::ConnectionRefused) => Ok(false),
        Err(error) => Err(error),
    }
}

/// Arguments of the emulator in lockstep; all file names are relative to its working directory.
fn arguments(image: &Path, options: &Options) -> Result<Vec<OsString>, EmulatorError> {
    let shift = options.instruction_shift;
    let mut arguments = machine(image, &cable())?;
    arguments.extend(["-serial", "none", "-icount", &format!("shift={shift},sleep=off")].map(OsString::from));
    Ok(arguments)
}

/// The Ethernet cable to a socket of this program.
fn cable() -> String {
    format!("dgram,id=cable,local.type=unix,local.path={FIRMWARE_SOCKET},remote.type=unix,remote.path={HOST_SOCKET}")
}

/// The arguments that every attachment needs: machine, image, semihosting and the Ethernet cable.
fn machine(image: &Path, cable: &str) -> Result<Vec<OsString>, EmulatorError> {
    let image = std::path::absolute(image).map_err(EmulatorError::io(format!("finding {}", image.display())))?;
    let fixed = [
        "-M",
        "mps2-an500",
        "-display",
        "none",
        "-monitor",
        "none",
        "-no-reboot",
        "-semihosting-config",
        "enable=on,target=native",
        "-netdev",
        cable,
        "-net",
        "nic,netdev=cable,model=lan9118",
        "-kernel",
    ];
    let mut arguments = fixed.map(OsString::from).to_vec();
    arguments.push(image.into_os_string());
    Ok(arguments)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reply_to_an_emulator_that_has_just_ended_is_not_taken_and_no_error_of_the_cable() {
        let directory = Directory::make().expect("a directory for temporary files");
        let socket = bind(&directory).expect("a socket");
        let path = directory.join(FIRMWARE_SOCKET);
        let firmware = UnixDatagram::bind(&path).expect("a socket");
        assert!(send(&socket, &path, &[1; 60]).expect("the cable is whole"));
        drop(firmware);
        assert!(!send(&socket, &path, &[1; 60]).expect("the end of the emulator is told by its process"));
        std::fs::remove_file(&path).expect("the socket's file is there");
        send(&socket, &path, &[1; 60]).expect_err("a cable that leads nowhere");
    }
}
