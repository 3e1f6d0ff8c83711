//! `etherpen record`: writes all data from the firmware into an MCAP file, until Ctrl-C.
//!
//! Recording never moves the robot. At a port it listens, and also records the effects of other programs' commands. If
//! another program has the port (a drawing, the console), that program passes its data on. Invariant: the file is
//! readable however the recording ends; the message says how much it contains.

use super::ports::SessionPort;
use super::{CellArguments, ConfigArguments, ended_by_a_signal};
use crate::cell::Physics;
use crate::drawing::preparation::prepare::prepare;
use crate::error::{ProgramError, code};
use crate::job::Control;
use crate::link::port::PortName;
use crate::machine::{Account, Client, Machine, MachineOptions, NoNews, Source, refuse_other_configuration};
use crate::output_file::refuse_input;
use crate::recording::file::RecordingFile;
use crate::recording::{About, Recorder};
use crate::run;
use crate::run::task;
use crate::terminal::counted;
use etherpen::config::Config;
use serde::Serialize;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Most news queued while the disk is slow: more than a minute of samples.
const NEWS_MAX: usize = 16_384;
/// Longest wait for news before checking whether the recording has ended.
const WAIT: Duration = Duration::from_millis(100);
/// Time between two flushes.
const FLUSH: Duration = Duration::from_secs(1);
/// Flushes between two lines of progress.
const LINE_EVERY: u32 = 10;

/// Options of `etherpen record`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Recording to write, an MCAP file; an existing file is replaced.
    #[arg(short, long, value_name = "FILE.mcap")]
    output: PathBuf,
    #[command(flatten)]
    port: SessionPort,
    /// Record a drawing of this file (photograph or CSV) in virtual time instead.
    #[arg(long, value_name = "FILE")]
    simulate: Option<PathBuf>,
    /// Stop after this many seconds. Default: Ctrl-C stops the recording.
    #[arg(long, value_name = "S", value_parser = super::recorded::seconds)]
    duration: Option<f64>,
    /// Print what was recorded as JSON on stdout.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    cell: CellArguments,
    #[command(flatten)]
    config: ConfigArguments,
}

/// What the command prints.
#[derive(Debug, Serialize)]
struct Recorded {
    file: String,
    samples: u64,
    missing: u64,
    gaps: u64,
    bytes: u64,
    /// Largest resident memory of this process, MB.
    memory_max_mb: Option<f64>,
}

/// Runs the command.
///
/// # Errors
/// The file cannot be written, there is no connection, or the drawing failed.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let config_file = arguments.config.file().map(|(path, _)| path);
    let files = arguments.simulate.iter().cloned().chain(arguments.cell.file());
    let inputs: Vec<PathBuf> = files.chain(config_file).collect();
    refuse_input(&arguments.output, &inputs)?;
    let config = arguments.config.load()?;
    let physics = arguments.cell.load_if(arguments.simulate.is_some())?;
    let port = (arguments.port).find_unless(arguments.simulate.as_ref().map(|_| "--simulate"))?;
    match (port, &arguments.simulate) {
        (Some(port), _) => listen(arguments, &config, &port),
        (None, file) => simulate(arguments, &config, physics, file.as_deref().unwrap_or(Path::new("-"))),
    }
}

/// Ends the file and prints what it contains.
fn end(recording: RecordingFile, arguments: &Arguments, json: bool) -> Result<(), ProgramError> {
    let written = recording.end()?;
    let shown = arguments.output.display();
    eprintln!(
        "{} in {shown}, {:.1} MB; {} missing in {}.",
        counted(written.samples, "sample"),
        written.bytes as f64 / 1e6,
        written.missing,
        counted(written.gaps, "gap")
    );
    if !json {
        return Ok(());
    }
    super::print_json(&Recorded {
        file: shown.to_string(),
        samples: written.samples,
        missing: written.missing,
        gaps: written.gaps,
        bytes: written.bytes,
        memory_max_mb: memory_max_mb(),
    })
}

/// Largest resident memory of this process, MB, from proc(5).
fn memory_max_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes / 1_000.0)
}

/// Draws in virtual time and records it.
fn simulate(arguments: &Arguments, config: &Config, physics: Physics, file: &Path) -> Result<(), ProgramError> {
    let prepared = prepare(file, config)?;
    let about = About {
        config,
        source: "simulation",
        begin_ns: 0,
    };
    let mut recording = RecordingFile::begin(&arguments.output, &about)?;
    let ended = ended_by_a_signal()?;
    let longest = arguments.duration.map(|seconds| (seconds * 1_000.0) as usize);
    let (mut seen, mut over) = (0, false);
    let task = task(config, &prepared).in_cell(physics);
    let drawn = run::simulate(&task, None, &mut |job| {
        while let Some(event) = job.next_event() {
            if let Some(account) = Account::of_job(&event) {
                recording.write(|recorder| account.record(recorder));
            }
        }
        let samples = job.samples().get(seen..).unwrap_or(&[]);
        let left = longest.map_or(samples.len(), |longest| longest.saturating_sub(seen));
        let wanted = samples.get(..left).unwrap_or(samples);
        recording.write(|recorder| recorder.samples(0, wanted));
        seen += samples.len();
        if let Some(status) = job.status() {
            recording.write(|recorder| recorder.status(status));
        }
        let enough = longest.is_some_and(|longest| seen >= longest) || ended.load(Ordering::Relaxed);
        if (recording.has_failed() || enough) && !over {
            over = true;
            job.control(Control::Cancel);
        }
    });
    let drawn = drawn.map_err(|error| ProgramError::from(&error))?;
    end(recording, arguments, arguments.json)?;
    match drawn.outcome {
        Some(Err(error)) if !over => Err(ProgramError::from(&error)),
        _ => Ok(()),
    }
}

/// The machine at a port, or the program that has the port.
fn source(config: &Config, port: &PortName) -> Result<Source, ProgramError> {
    if let Some(mut client) = Client::find(port) {
        refuse_other_configuration(&mut client, config)?;
        eprintln!("through {}", client.owner());
        return Ok(Source::follow(client)?);
    }
    let (machine, news) = Machine::start_with_news(port.clone(), config.clone(), MachineOptions::default(), NEWS_MAX)
        .map_err(|cause| ProgramError::new(code::CONNECTION, cause))?;
    Ok(Source::Own(machine, news))
}

/// Listens to a machine and records it.
fn listen(arguments: &Arguments, config: &Config, port: &PortName) -> Result<(), ProgramError> {
    let mut source = source(config, port)?;
    let about = About {
        config,
        source: &port.to_string(),
        begin_ns: now_ns(),
    };
    let mut recording = RecordingFile::begin(&arguments.output, &about)?;
    let ended = ended_by_a_signal()?;
    let until = arguments
        .duration
        .map(|seconds| Instant::now() + Duration::from_secs_f64(seconds));
    let (mut connected, mut flushed, mut flushes) = (false, Instant::now(), 0_u32);
    let is_over = || ended.load(Ordering::Relaxed) || until.is_some_and(|until| Instant::now() >= until);
    while !recording.has_failed() && !is_over() {
        match source.next_within(WAIT) {
            Ok(Account::Lost(failure)) if !connected => {
                end(recording, arguments, false)?;
                return Err(failure.into());
            }
            Ok(account) => {
                // The greeting may have arrived before this program started to listen.
                let is_greeting = matches!(account, Account::Connected(_));
                if let Some(welcome) = source.welcome().filter(|_| !connected && !is_greeting) {
                    recording.write(|recorder| take(recorder, &Account::Connected(welcome)));
                    connected = true;
                }
                connected |= is_greeting;
                recording.write(|recorder| take(recorder, &account));
            }
            Err(NoNews::Timeout) => {}
            Err(NoNews::Closed) => {
                end(recording, arguments, arguments.json)?;
                let text = "the program that had the port has ended; record again to continue in another file";
                return Err(ProgramError::new(code::CONNECTION, text));
            }
        }
        if flushed.elapsed() >= FLUSH {
            flushed = Instant::now();
            flushes += 1;
            recording.write(|recorder| {
                recorder.set_time(now_ns());
                recorder.flush()
            });
            if flushes.is_multiple_of(LINE_EVERY) {
                let taken = recording.taken();
                eprintln!("{}, {} missing", counted(taken.samples, "sample"), taken.missing);
            }
        }
    }
    end(recording, arguments, arguments.json)
}

/// Nanoseconds since 1970.
fn now_ns() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}

/// Writes an event of a machine; relevant ones are printed too.
fn take(recorder: &mut Recorder<File>, account: &Account) -> io::Result<()> {
    recorder.set_time(now_ns());
    if let Some((_, _, text)) = account.event() {
        eprintln!("{text}");
    }
    account.record(recorder)
}
