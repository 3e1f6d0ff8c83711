//! The virtual segment alone, in real time, for any master.
//!
//! The cell's time is this computer's, less the time in which this program was not scheduled: a real segment never
//! pauses, so a busy computer must not look like a silent master.

pub(crate) mod control;

use crate::cell::{AlState, Cell, SlaveKind, SlaveState};
use crate::error::{ProgramError, code};
use crate::output_file::{OutputFile, unwritable};
use control::{Control, Surroundings};
use etherpen::ethercat::state::al_code_text;
use etherpen_segment::capture::{Capture, Direction};
use etherpen_segment::transport::SegmentPort;
use serde::Serialize;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Period in which the cell's time advances without frames.
const STEP: Duration = Duration::from_millis(1);
/// Time between two wake-ups beyond which this program counts as not scheduled.
const PAUSE: Duration = Duration::from_millis(5);

/// The cell's clock.
struct Clock {
    looked: Instant,
    now_us: u64,
    paused: Duration,
}

impl Clock {
    fn new() -> Self {
        Self {
            looked: Instant::now(),
            now_us: 0,
            paused: Duration::ZERO,
        }
    }

    /// The cell's time, microseconds.
    fn now_us(&mut self) -> u64 {
        let now = Instant::now();
        self.pass(now.saturating_duration_since(self.looked));
        self.looked = now;
        self.now_us
    }

    fn pass(&mut self, elapsed: Duration) {
        let passed = if elapsed > PAUSE { STEP } else { elapsed };
        self.paused += elapsed - passed.min(elapsed);
        self.now_us += u64::try_from(passed.as_micros()).unwrap_or(0);
    }
}

/// Summary of a segment's run.
#[derive(Debug, Serialize)]
pub(crate) struct SegmentSummary {
    /// Address at which masters reached the segment.
    pub(crate) listens: String,
    /// Duration of the run, s.
    pub(crate) seconds: f64,
    /// Time in which this program was not scheduled and the segment was paused, ms.
    pub(crate) paused_ms: u64,
    /// EtherCAT frames from masters.
    pub(crate) frames: u64,
    /// Frames sent back.
    pub(crate) replies: u64,
    /// Frames that were not EtherCAT.
    pub(crate) ignored: u64,
    /// The slaves in chain order.
    pub(crate) slaves: Vec<SlaveSummary>,
}

/// State of one slave at the end.
#[derive(Debug, Serialize)]
pub(crate) struct SlaveSummary {
    /// Place in the chain, from 1.
    pub(crate) slave: usize,
    pub(crate) kind: &'static str,
    pub(crate) powered: bool,
    pub(crate) al_state: &'static str,
    pub(crate) al_status_code: u16,
    pub(crate) al_status_text: &'static str,
    /// State of the drive; `None` for a slave without one.
    pub(crate) drive: Option<String>,
    pub(crate) drive_error: u16,
}

impl SlaveSummary {
    fn new(slave: usize, kind: &SlaveKind, state: &SlaveState) -> Self {
        Self {
            slave,
            kind: kind.name(),
            powered: state.powered,
            al_state: state_name(state.al_state),
            al_status_code: state.al_status_code,
            al_status_text: al_code_text(state.al_status_code),
            drive: kind.is_drive().then(|| format!("{:?}", state.drive)),
            drive_error: state.drive_error,
        }
    }
}

/// Common name of a state.
pub(crate) fn state_name(state: AlState) -> &'static str {
    match state {
        AlState::Init => "INIT",
        AlState::PreOperational => "PREOP",
        AlState::Bootstrap => "BOOT",
        AlState::SafeOperational => "SAFEOP",
        AlState::Operational => "OP",
    }
}

/// The time of this computer, ns since 1970.
fn wall_clock_ns() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}

/// A cell that serves masters over a port.
pub(crate) struct ServedSegment {
    cell: Cell,
    slaves: Vec<SlaveKind>,
    port: Box<dyn SegmentPort>,
    capture: Option<Capture<BufWriter<File>>>,
    clock: Clock,
    replies: u64,
    ignored: u64,
    looked: Instant,
}

impl ServedSegment {
    /// Starts to serve; every frame is recorded in `capture`.
    pub(crate) fn new(
        cell: Cell,
        slaves: Vec<SlaveKind>,
        port: Box<dyn SegmentPort>,
        capture: Option<Capture<BufWriter<File>>>,
    ) -> Self {
        Self {
            cell,
            slaves,
            port,
            capture,
            clock: Clock::new(),
            replies: 0,
            ignored: 0,
            looked: Instant::now(),
        }
    }

    /// Carries out the commands that have come, at most once a millisecond.
    ///
    /// # Errors
    /// stdout is closed.
    pub(crate) fn obey(&mut self, control: &mut Control) -> Result<(), ProgramError> {
        if self.looked.elapsed() < STEP {
            return Ok(());
        }
        self.looked = Instant::now();
        let surroundings = Surroundings {
            paused_ms: self.paused_ms(),
        };
        control.serve(self.cell.segment_mut(), surroundings)
    }

    /// Time in which this program was not scheduled and the segment stood still, ms.
    pub(crate) fn paused_ms(&self) -> u64 {
        u64::try_from(self.clock.paused.as_millis()).unwrap_or(u64::MAX)
    }

    /// Waits for a frame, at most a millisecond, and answers it. `first` is called for the first EtherCAT frame.
    ///
    /// # Errors
    /// The port was lost, or the capture cannot be written.
    pub(crate) fn step(&mut self, first: &mut dyn FnMut()) -> Result<(), ProgramError> {
        let lost = |cause| ProgramError::new(code::CONNECTION, format!("the way to the masters was lost: {cause}"));
        let received = self.port.receive(STEP).map_err(lost)?;
        let received_ns = wall_clock_ns();
        let now_us = self.clock.now_us();
        let Some((master, frame)) = received else {
            self.cell.advance_to(now_us);
            return Ok(());
        };
        let frames = self.cell.frames();
        let replies = self.cell.frame(now_us, &frame);
        let is_ethercat = self.cell.frames() != frames;
        if is_ethercat {
            if frames == 0 {
                first();
            }
            self.record(received_ns, Direction::Sent, &frame)?;
        } else {
            self.ignored += 1;
        }
        for reply in replies {
            self.port.send(master, &reply).map_err(lost)?;
            if is_ethercat {
                self.replies += 1;
                let seen = self.port.on_the_wire(master, &reply);
                self.record(wall_clock_ns(), Direction::Received, &seen)?;
            }
        }
        Ok(())
    }

    fn record(&mut self, time_ns: u64, direction: Direction, frame: &[u8]) -> Result<(), ProgramError> {
        let Some(capture) = &mut self.capture else {
            return Ok(());
        };
        capture
            .record_ns(time_ns, direction, frame)
            .map_err(|cause| ProgramError::failed("the capture", cause))
    }

    /// Completes the capture and summarises the run, whose duration was `ran`.
    ///
    /// # Errors
    /// The capture cannot be written.
    pub(crate) fn finish(self, listens: String, ran: Duration) -> Result<SegmentSummary, ProgramError> {
        let paused_ms = self.paused_ms();
        if let Some(capture) = self.capture {
            capture
                .finish()
                .map_err(|cause| ProgramError::failed("the capture", cause))?;
        }
        let state = self.cell.state();
        let slaves = (1..).zip(self.slaves.iter().zip(&state.slaves));
        Ok(SegmentSummary {
            listens,
            seconds: ran.as_secs_f64(),
            paused_ms,
            frames: state.frames,
            replies: self.replies,
            ignored: self.ignored,
            slaves: slaves
                .map(|(slave, (kind, state))| SlaveSummary::new(slave, kind, state))
                .collect(),
        })
    }
}

/// Starts a capture that replaces an existing file and is visible under its name while it grows.
///
/// # Errors
/// The file cannot be written.
pub(crate) fn capture(path: &Path) -> Result<Capture<BufWriter<File>>, ProgramError> {
    let opened = OutputFile::create(path).and_then(|out| {
        let capture = Capture::new(BufWriter::new(out.stream()?))?;
        out.commit()?;
        Ok(capture)
    });
    opened.map_err(|cause| unwritable(path, &cause))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_without_the_processor_does_not_pass_in_the_cell() {
        let mut clock = Clock::new();
        clock.pass(Duration::from_micros(1_500));
        clock.pass(PAUSE);
        assert_eq!((clock.now_us, clock.paused), (6_500, Duration::ZERO));
        clock.pass(Duration::from_secs(2));
        assert_eq!((clock.now_us, clock.paused), (7_500, Duration::from_millis(1_999)));
    }
}
