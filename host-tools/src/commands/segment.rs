//! `etherpen segment`: runs the virtual segment alone, in real time, for any master.
//!
//! The cell's time is this computer's, less the time in which this program was not scheduled: a real segment never
//! pauses, so a busy computer must not look like a silent master.

use super::emulate::read_faults;
use super::endpoint::SegmentArguments;
use super::{ConfigArguments, ended_by_a_signal, print_json};
use crate::cell::{AlState, Cell, CellOptions, SCRIPT_HELP, SlaveKind, SlaveListError, SlaveState, parse_slaves};
use crate::error::{ProgramError, code};
use crate::output_file::OutputFile;
use crate::output_file::{refuse_input, unwritable};
use crate::terminal::counted;
use etherpen::ethercat::state::al_code_text;
use etherpen_segment::capture::{Capture, Direction};
use etherpen_segment::transport::{self, SegmentPort};
use serde::Serialize;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Options of `etherpen segment`.
#[derive(clap::Args, Debug)]
#[command(after_long_help = SCRIPT_HELP)]
pub struct Arguments {
    #[command(flatten)]
    segment: SegmentArguments,
    /// The slaves in the order of the chain: ax2000, cia402, ek1100 or sii:FILE, with *N for N of a kind, for instance
    /// ax2000*4,ek1100. Without it an AX2000 for each of the configured drives.
    #[arg(long, value_name = "LIST", value_parser = slave_list)]
    slaves: Option<SlaveList>,
    /// Scripted faults, one a line; the long help (--help) describes the language.
    #[arg(long, value_name = "FILE")]
    faults: Option<PathBuf>,
    /// Record every frame in both directions as pcapng, for Wireshark.
    #[arg(long, value_name = "FILE")]
    pcap: Option<PathBuf>,
    /// Print a summary as JSON on stdout at the end.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    config: ConfigArguments,
}

/// A chain of slaves.
#[derive(Clone, Debug)]
struct SlaveList {
    slaves: Vec<SlaveKind>,
    /// The files named in it.
    files: Vec<PathBuf>,
}

fn slave_list(text: &str) -> Result<SlaveList, SlaveListError> {
    let files = text.split(',').filter_map(|kind| kind.trim().strip_prefix("sii:"));
    let without_count = |file: &str| PathBuf::from(file.rsplit_once('*').map_or(file, |(file, _)| file));
    Ok(SlaveList {
        slaves: parse_slaves(text)?,
        files: files.map(without_count).collect(),
    })
}

/// All files that the command reads.
fn inputs(arguments: &Arguments) -> Vec<PathBuf> {
    let config = arguments.config.file().map(|(path, _)| path);
    let slaves = arguments.slaves.iter().flat_map(|list| list.files.iter().cloned());
    slaves.chain(arguments.faults.clone()).chain(config).collect()
}

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

/// What happened, for the end.
#[derive(Debug, Serialize)]
struct Summary {
    /// Where the segment was.
    listens: String,
    /// How long it ran.
    seconds: f64,
    /// Time in which this program was not run and the segment stood still.
    paused_ms: u64,
    /// EtherCAT frames from masters.
    frames: u64,
    /// Frames sent back.
    replies: u64,
    /// Frames that were no EtherCAT.
    ignored: u64,
    /// The slaves in chain order.
    slaves: Vec<SlaveSummary>,
}

/// One slave at the end; counted from 1.
#[derive(Debug, Serialize)]
struct SlaveSummary {
    slave: usize,
    kind: &'static str,
    powered: bool,
    al_state: &'static str,
    al_status_code: u16,
    al_status_text: &'static str,
    /// Nothing where there is no drive.
    drive: Option<String>,
    drive_error: u16,
}

impl SlaveSummary {
    fn new(slave: usize, kind: &SlaveKind, state: &SlaveState) -> Self {
        Self {
            slave,
            kind: match kind {
                SlaveKind::Ax2000 => "ax2000",
                SlaveKind::Cia402 => "cia402",
                SlaveKind::Ek1100 => "ek1100",
                SlaveKind::Sii(_) => "sii",
            },
            powered: state.powered,
            al_state: match state.al_state {
                AlState::Init => "INIT",
                AlState::PreOperational => "PREOP",
                AlState::SafeOperational => "SAFEOP",
                AlState::Operational => "OP",
            },
            al_status_code: state.al_status_code,
            al_status_text: al_code_text(state.al_status_code),
            drive: kind.is_drive().then(|| format!("{:?}", state.drive)),
            drive_error: state.drive_error,
        }
    }
}

/// Runs the command until it is interrupted.
///
/// # Errors
/// The transport cannot be opened or was lost, or a file cannot be read or written.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    if let Some(pcap) = &arguments.pcap {
        refuse_input(pcap, &inputs(arguments))?;
    }
    let config = arguments.config.load()?;
    let slaves = match &arguments.slaves {
        Some(list) => list.slaves.clone(),
        None => vec![SlaveKind::Ax2000; usize::from(config.bus.drives)],
    };
    let faults = read_faults(arguments.faults.as_deref(), slaves.len())?;
    let options = CellOptions {
        faults,
        slaves: slaves.clone(),
        ..CellOptions::default()
    };
    let cell = Cell::new(&config, options);
    let ended = ended_by_a_signal()?;
    let port =
        transport::listen(&arguments.segment.endpoint()).map_err(|error| ProgramError::new(code::CONNECTION, error))?;
    let capture = arguments.pcap.as_deref().map(capture).transpose()?;
    let listens = port.endpoint().to_string();
    if arguments.json {
        eprintln!("{listens}");
    } else {
        writeln!(io::stdout(), "{listens}").map_err(|cause| ProgramError::failed("stdout", cause))?;
    }
    eprintln!(
        "{}; Ctrl-C ends the segment.",
        counted(cell.state().slaves.len(), "slave")
    );
    let mut running = Running {
        cell,
        slaves,
        port,
        capture,
        clock: Clock::new(),
        replies: 0,
        ignored: 0,
    };
    let begun = Instant::now();
    while !ended.load(Ordering::Relaxed) {
        running.step()?;
    }
    let summary = running.finish(listens, begun.elapsed())?;
    if arguments.json {
        print_json(&summary)
    } else {
        tell(&summary);
        Ok(())
    }
}

/// Starts a capture, which replaces an existing file and grows under its name.
fn capture(path: &Path) -> Result<Capture<BufWriter<File>>, ProgramError> {
    let opened = OutputFile::create(path).and_then(|out| {
        let capture = Capture::new(BufWriter::new(out.stream()?))?;
        out.commit()?;
        Ok(capture)
    });
    opened.map_err(|cause| unwritable(path, &cause))
}

/// The segment at work.
struct Running {
    cell: Cell,
    slaves: Vec<SlaveKind>,
    port: Box<dyn SegmentPort>,
    capture: Option<Capture<BufWriter<File>>>,
    clock: Clock,
    replies: u64,
    ignored: u64,
}

impl Running {
    /// Waits for a frame, at most a millisecond, and answers it.
    fn step(&mut self) -> Result<(), ProgramError> {
        let lost = |cause| ProgramError::new(code::CONNECTION, format!("the way to the masters was lost: {cause}"));
        let received = self.port.receive(STEP).map_err(lost)?;
        let now_us = self.clock.now_us();
        let Some((master, frame)) = received else {
            self.cell.advance_to(now_us);
            return Ok(());
        };
        let frames = self.cell.frames();
        let replies = self.cell.frame(now_us, &frame);
        if self.cell.frames() == frames {
            self.ignored += 1;
            return Ok(());
        }
        if frames == 0 {
            eprintln!("the first frame has come");
        }
        self.record(now_us, Direction::Sent, &frame)?;
        for reply in replies {
            self.port.send(master, &reply).map_err(lost)?;
            self.replies += 1;
            let seen = self.port.on_the_wire(master, &reply);
            self.record(now_us, Direction::Received, &seen)?;
        }
        Ok(())
    }

    fn record(&mut self, now_us: u64, direction: Direction, frame: &[u8]) -> Result<(), ProgramError> {
        let Some(capture) = &mut self.capture else {
            return Ok(());
        };
        capture
            .record(now_us, direction, frame)
            .map_err(|cause| ProgramError::failed("the capture", cause))
    }

    fn finish(self, listens: String, ran: Duration) -> Result<Summary, ProgramError> {
        if let Some(capture) = self.capture {
            capture
                .finish()
                .map_err(|cause| ProgramError::failed("the capture", cause))?;
        }
        let state = self.cell.state();
        let slaves = (1..).zip(self.slaves.iter().zip(&state.slaves));
        Ok(Summary {
            listens,
            seconds: ran.as_secs_f64(),
            paused_ms: u64::try_from(self.clock.paused.as_millis()).unwrap_or(u64::MAX),
            frames: state.frames,
            replies: self.replies,
            ignored: self.ignored,
            slaves: slaves
                .map(|(slave, (kind, state))| SlaveSummary::new(slave, kind, state))
                .collect(),
        })
    }
}

/// Prints the summary at the end.
fn tell(summary: &Summary) {
    eprintln!(
        "{} in, {} out in {:.1} s; not EtherCAT: {}; {} ms without the processor",
        counted(summary.frames, "frame"),
        summary.replies,
        summary.seconds,
        summary.ignored,
        summary.paused_ms
    );
    for slave in &summary.slaves {
        let error = match slave.al_status_code {
            0 => String::new(),
            number => format!(", AL status code {number:#06x}: {}", slave.al_status_text),
        };
        let drive = slave.drive.as_ref().map_or(String::new(), |drive| format!(", {drive}"));
        eprintln!(
            "slave {}: {}, {}{drive}{error}",
            slave.slave, slave.kind, slave.al_state
        );
    }
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
