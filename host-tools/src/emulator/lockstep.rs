//! The host's half of the lockstep: one thread that answers the firmware's records in their order.

use super::error::EmulatorError;
use super::log::{Decoder, LogLine};
use super::process::{Directory, Process};
use super::{Area, Around, LINK_BYTES_MAX, Link, Pace, Segment, Traffic};
use defmt_decoder::Table;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::ops::RangeInclusive;
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Time to wait for a record before checking whether the emulator still runs.
const POLL_PERIOD: Timespec = Timespec {
    tv_sec: 0,
    tv_nsec: 50_000_000,
};
const FRAME_BYTES_MAX: usize = 2048;
const BUS_RECORD_BYTES: usize = 8;
const LINK_HEADER_BYTES: usize = 9;
/// Most replies to one frame that fit the controller's receive FIFO, whatever their length.
pub(crate) const REPLIES_MAX: u8 = 6;
/// Frame lengths that the emulated controller accepts, bytes.
pub(crate) const REPLY_BYTES: RangeInclusive<usize> = 14..=1514;

/// First bytes of what comes before the link's record: a request for memory, and conditions of the board.
const MEMORY: u8 = 0xFF;
const AROUND: u8 = 0xFE;

const _: () = assert!(LINK_BYTES_MAX < AROUND as usize);

/// The FIFOs of the lockstep.
pub(super) struct Files {
    bus_up: Incoming,
    bus_down: File,
    link_up: Incoming,
    link_down: File,
    log: Incoming,
}

impl Files {
    pub(super) fn make(directory: &Directory) -> Result<Self, EmulatorError> {
        let incoming = |name| directory.fifo_from_firmware(name).map(Incoming::new);
        Ok(Self {
            bus_up: incoming("bus.up")?,
            bus_down: directory.fifo_to_firmware("bus.down")?,
            link_up: incoming("link.up")?,
            link_down: directory.fifo_to_firmware("link.down")?,
            log: incoming("log")?,
        })
    }

    /// Waits until the firmware has written something, has closed its end, or the period is over.
    fn wait(&self) -> io::Result<()> {
        let mut waited =
            [&self.bus_up, &self.link_up, &self.log].map(|incoming| PollFd::new(&incoming.file, PollFlags::IN));
        match poll(&mut waited, Some(&POLL_PERIOD)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}

/// A FIFO, with bytes that do not form a complete record yet.
pub(super) struct Incoming {
    file: File,
    bytes: Vec<u8>,
}

impl Incoming {
    pub(super) fn new(file: File) -> Self {
        Self {
            file,
            bytes: Vec::new(),
        }
    }

    /// Reads the available bytes; returns false if there are none.
    pub(super) fn read(&mut self) -> io::Result<bool> {
        let mut bytes = [0; 16_384];
        match self.file.read(&mut bytes) {
            Ok(length) => {
                self.bytes.extend_from_slice(bytes.get(..length).unwrap_or_default());
                Ok(length > 0)
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Takes everything read so far.
    pub(super) fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.bytes)
    }

    /// Takes one record of `length` bytes, if it is complete.
    fn record(&mut self, length: usize) -> Option<Vec<u8>> {
        (self.bytes.len() >= length).then(|| self.bytes.drain(..length).collect())
    }
}

/// Options of the thread.
pub(super) struct Options {
    pub(super) pace: Pace,
    pub(super) answer_within: Duration,
}

/// Data owned by the thread; the emulator ends with it.
pub(super) struct Lockstep<S, L> {
    process: Process,
    files: Files,
    socket: UnixDatagram,
    firmware: PathBuf,
    segment: S,
    link: L,
    options: Options,
    stop: Arc<AtomicBool>,
    traffic: Traffic,
    /// The latest time passed to the segment, us.
    time_us: u64,
    /// The conditions that the firmware was told last.
    around: Around,
    started: Instant,
    answered: Instant,
}

impl<S: Segment, L: Link> Lockstep<S, L> {
    pub(super) fn new(
        process: Process,
        files: Files,
        (socket, firmware): (UnixDatagram, PathBuf),
        (segment, link): (S, L),
        options: Options,
        stop: Arc<AtomicBool>,
    ) -> Self {
        Self {
            process,
            files,
            socket,
            firmware,
            segment,
            link,
            options,
            stop,
            traffic: Traffic::default(),
            time_us: 0,
            around: Around::default(),
            started: Instant::now(),
            answered: Instant::now(),
        }
    }

    /// Answers until the emulator ends or the thread is asked to stop.
    pub(super) fn run(
        mut self,
        table: Option<&Table>,
        mut line: impl FnMut(&LogLine),
    ) -> Result<Traffic, EmulatorError> {
        let mut decoder = Decoder::new(table);
        while !self.stop.load(Ordering::Relaxed) {
            if !self.answer()? && !self.log(&mut decoder, &mut line)? {
                if let Some(error) = self.trouble(&decoder) {
                    return Err(error);
                }
                self.files.wait().map_err(failed("waiting for"))?;
            }
        }
        self.log(&mut decoder, &mut line)?;
        Ok(self.traffic)
    }

    /// Answers one record of each kind; returns false if there was none.
    fn answer(&mut self) -> Result<bool, EmulatorError> {
        let bus = self.answer_bus().map_err(failed("answering"))?;
        let link = self.answer_link()?;
        if bus || link {
            self.answered = Instant::now();
        }
        Ok(bus || link)
    }

    fn answer_bus(&mut self) -> io::Result<bool> {
        self.files.bus_up.read()?;
        let Some(record) = self.files.bus_up.record(BUS_RECORD_BYTES) else {
            return Ok(false);
        };
        let time_us = record.iter().rev().fold(0, |sum, byte| sum << 8 | u64::from(*byte));
        self.time_us = self.time_us.max(time_us);
        let mut frame = [0; FRAME_BYTES_MAX];
        let mut replies = 0;
        match self.socket.recv(&mut frame) {
            Ok(length) => {
                self.traffic.frames += 1;
                let frame = frame.get(..length).unwrap_or_default();
                for reply in self.segment.frame(time_us, frame) {
                    if replies < REPLIES_MAX && self.send(&reply)? {
                        replies += 1;
                    } else {
                        self.traffic.replies_dropped += 1;
                    }
                }
                self.traffic.replies += u64::from(replies);
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => self.traffic.frames_missing += 1,
            Err(error) => return Err(error),
        }
        self.files.bus_down.write_all(&[replies])?;
        Ok(true)
    }

    /// Sends without waiting, since the emulator reads nothing while the firmware waits for its token; returns false if
    /// the frame would not reach the controller, so that the firmware must not wait for it.
    fn send(&mut self, reply: &[u8]) -> io::Result<bool> {
        if !REPLY_BYTES.contains(&reply.len()) {
            return Ok(false);
        }
        super::send(&self.socket, &self.firmware, reply)
    }

    fn answer_link(&mut self) -> Result<bool, EmulatorError> {
        self.files.link_up.read().map_err(failed("reading from"))?;
        let Some([a, b, c, d, e, f, g, h, length]) = self.files.link_up.bytes.first_chunk().copied() else {
            return Ok(false);
        };
        let length = usize::from(length);
        check_length("link.up", length)?;
        let Some(record) = self.files.link_up.record(LINK_HEADER_BYTES + length) else {
            return Ok(false);
        };
        let ms = u32::from_le_bytes([a, b, c, d]);
        self.traffic.milliseconds = ms;
        let early_us = i32::from_le_bytes([e, f, g, h]);
        let time_us = (u64::from(ms) * 1000).saturating_add_signed(-i64::from(early_us));
        if time_us > self.time_us {
            self.time_us = time_us;
            self.segment.advance_to(time_us);
        }
        let from_device = record.get(LINK_HEADER_BYTES..).unwrap_or_default();
        let mut bytes = Vec::with_capacity(LINK_BYTES_MAX);
        self.link.exchange(ms, from_device, &mut bytes);
        bytes.truncate(LINK_BYTES_MAX);
        while let Some(area) = self.link.wants() {
            let Some(memory) = self.read_memory(area)? else {
                // The emulator has ended, which its owner tells, or is to end.
                return Ok(false);
            };
            self.link.take_memory(area, memory);
        }
        let mut to_device = Vec::with_capacity(LINK_BYTES_MAX + 3);
        let around = self.link.around();
        if around != self.around {
            self.around = around;
            to_device.extend([AROUND, around.bits()]);
        }
        to_device.push(bytes.len() as u8);
        to_device.extend_from_slice(&bytes);
        self.keep_pace(ms);
        self.files
            .link_down
            .write_all(&to_device)
            .map_err(failed("answering"))?;
        Ok(true)
    }

    /// Reads an area of the firmware's memory, while the firmware waits for its record; `None` if the emulator ends, or does not
    /// answer in time.
    fn read_memory(&mut self, area: Area) -> Result<Option<Vec<u8>>, EmulatorError> {
        self.files
            .link_down
            .write_all(&[MEMORY, area.number()])
            .map_err(failed("asking"))?;
        let asked = Instant::now();
        loop {
            if let Some(memory) = self.files.link_up.record(area.bytes()) {
                return Ok(Some(memory));
            }
            // A critical task may interrupt the firmware between two pieces, and wait for its frame's replies.
            let bus = self.answer_bus().map_err(failed("answering"))?;
            if !self.files.link_up.read().map_err(failed("reading the memory of"))? && !bus {
                let is_late = asked.elapsed() > self.options.answer_within;
                if is_late || self.process.ended().is_some() {
                    return Ok(None);
                }
                self.files.wait().map_err(failed("waiting for"))?;
            }
        }
    }

    fn keep_pace(&self, ms: u32) {
        if self.options.pace == Pace::RealTime {
            let due = self.started + Duration::from_millis(ms.into());
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
    }

    /// Takes new log data of the firmware; returns false if there are none.
    fn log(&mut self, decoder: &mut Decoder, line: &mut dyn FnMut(&LogLine)) -> Result<bool, EmulatorError> {
        let some = self.files.log.read().map_err(failed("reading the log of"))?;
        decoder.take(&self.files.log.take(), line);
        Ok(some)
    }

    /// Why the emulator will not continue, if so.
    fn trouble(&mut self, decoder: &Decoder) -> Option<EmulatorError> {
        if let Some(status) = self.process.ended() {
            return Some(EmulatorError::Ended {
                status,
                said: self.process.said(),
                log: decoder.last(),
                black_box: self.process.take_black_box(),
            });
        }
        let waited = self.answered.elapsed();
        (waited > self.options.answer_within).then(|| EmulatorError::Silent {
            waited,
            milliseconds: self.traffic.milliseconds,
            said: self.process.said(),
            log: decoder.last(),
        })
    }
}

/// A record longer than the protocol allows is an error: the rest of the stream would be misread.
fn check_length(file: &'static str, length: usize) -> Result<(), EmulatorError> {
    if length <= LINK_BYTES_MAX {
        Ok(())
    } else {
        Err(EmulatorError::Record {
            file,
            length,
            length_max: LINK_BYTES_MAX,
        })
    }
}

fn failed(what: &str) -> impl FnOnce(io::Error) -> EmulatorError {
    EmulatorError::io(format!("{what} the emulator"))
}
