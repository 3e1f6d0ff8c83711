//! `etherpen blackbox`: reads a controller's last two seconds, over its port or from a memory image.
//!
//! Reading never moves the robot. If another program has the port, the requests go through that program. Invariant: a
//! recording is discarded only after all of it was read and every file was written.

use super::ports::SessionPort;
use super::{ConfigArguments, print_json};
use crate::black_box::Reader;
use crate::black_box::contents::{Contents, EventEntry, Summary, origin_text};
use crate::black_box::export::{json, mcap, pcapng};
use crate::black_box::replay::{Latched, Replay, replay};
use crate::error::{ProgramError, code};
use crate::link::port::PortName;
use crate::link::text;
use crate::machine::{Client, Machine, MachineOptions, Order, Reply};
use crate::output_file::{self, refuse_input, unwritable};
use crate::terminal::counted;
use etherpen::black_box::recording::{NoRecording, Origin};
use etherpen::black_box::{Answer, MEMORY_BYTES, Request};
use etherpen::config::Config;
use etherpen::messages::RecordAnswer;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Longest time between two pieces. The controller records again five seconds after a request.
const PAUSE_MAX: Duration = Duration::from_secs(4);
/// Answers without the piece that was asked for, one after the other, before reading is given up.
const USELESS_MAX: u32 = 10;
/// Events that are printed as text, the last ones.
const EVENTS_SHOWN: usize = 20;

/// Options of `etherpen blackbox`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    port: SessionPort,
    /// Decode a memory image instead of asking a controller: a file of --save, a dump of a debug probe, or the
    /// black-box.bin of an emulated board that panicked.
    #[arg(long, value_name = "FILE", conflicts_with = "discard")]
    image: Option<PathBuf>,
    /// Write samples and events: as MCAP for plot, stats, Foxglove or PlotJuggler, or as JSON, with the frames.
    #[arg(short, long, value_name = "FILE.mcap|FILE.json")]
    output: Option<PathBuf>,
    /// Write the recorded Ethernet frames, for Wireshark.
    #[arg(long, value_name = "FILE.pcapng")]
    frames: Option<PathBuf>,
    /// Save the memory as it is, for --image.
    #[arg(long, value_name = "FILE.bin")]
    save: Option<PathBuf>,
    /// Discard the recording once it was read and all files were written; the controller then records again.
    #[arg(long)]
    discard: bool,
    /// Replay the recording: run the controller's 1 ms loop in virtual time with the recorded inputs, and compare its
    /// results and faults with the recorded ones. With other limits in --config, it shows the fault that they would have
    /// raised at the same positions and setpoints.
    #[arg(long)]
    replay: bool,
    /// Print the summary, all events and the replay as JSON on stdout.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    config: ConfigArguments,
}

/// Form of the file with samples and events.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    Mcap,
    Json,
}

impl Form {
    fn of(path: &Path) -> Result<Self, ProgramError> {
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("mcap") => Ok(Self::Mcap),
            Some("json") => Ok(Self::Json),
            _ => {
                let text = format!("{}: samples and events are a file .mcap or .json", path.display());
                Err(ProgramError::new(code::USAGE, text))
            }
        }
    }
}

/// What the command prints with --json.
#[derive(Debug, Serialize)]
struct Printed<'a> {
    summary: &'a Summary,
    events: &'a [EventEntry],
    #[serde(skip_serializing_if = "Option::is_none")]
    replay: Option<&'a Replay>,
}

impl Arguments {
    fn outputs(&self) -> impl Iterator<Item = &PathBuf> {
        [&self.output, &self.frames, &self.save].into_iter().flatten()
    }

    /// Refuses outputs that would replace an input or each other.
    fn check_outputs(&self) -> Result<(), ProgramError> {
        let config_file = self.config.file().map(|(path, _)| path);
        let inputs: Vec<PathBuf> = self.image.iter().cloned().chain(config_file).collect();
        for (index, output) in self.outputs().enumerate() {
            refuse_input(output, &inputs)?;
            if self.outputs().skip(index + 1).any(|other| other == output) {
                let text = format!("{} is named for two outputs; choose another file", output.display());
                return Err(ProgramError::new(code::USAGE, text));
            }
        }
        Ok(())
    }

    /// Writes samples, events and frames.
    fn write(&self, contents: &Contents, form: Option<Form>, config: &Config) -> Result<(), ProgramError> {
        if let (Some(path), Some(form)) = (&self.output, form) {
            let bytes = match form {
                Form::Mcap => mcap(contents, config_of(contents, config)),
                Form::Json => json(contents),
            };
            write_file(path, bytes)?;
        }
        match &self.frames {
            Some(path) => write_file(path, pcapng(contents)),
            None => Ok(()),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// There is no connection, the image cannot be read or is not a recording, or a file cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let form = arguments.output.as_deref().map(Form::of).transpose()?;
    arguments.check_outputs()?;
    let config = arguments.config.load()?;
    let port = (arguments.port).find_unless(arguments.image.as_ref().map(|_| "--image"))?;
    let (mut controller, memory) = match (&arguments.image, port) {
        (None, Some(port)) => {
            let mut controller = Controller::find(&port, &config)?;
            let memory = controller.read()?;
            (Some(controller), memory)
        }
        (image, _) => {
            let memory = image_file(image.as_deref().unwrap_or(Path::new("-")))?;
            (None, Memory { memory, stalled: false })
        }
    };
    if let Some(path) = &arguments.save {
        write_file(path, Ok(memory.memory.clone()))?;
    }
    let contents = Contents::of(&memory.memory).map_err(|why| no_recording(why, arguments, memory.memory.len()))?;
    if memory.stalled && contents.summary.origin == Origin::Present {
        let text = "the link stalled for more than 4 s while the black box was read, and the controller recorded \
                    meanwhile; try again";
        return Err(ProgramError::new(code::CONNECTION, text));
    }
    arguments.write(&contents, form, &config)?;
    let replayed = arguments.replay.then(|| replay_of(&contents, &config)).transpose()?;
    if arguments.json {
        print_json(&Printed {
            summary: &contents.summary,
            events: &contents.events,
            replay: replayed.as_ref(),
        })?;
    } else {
        let shown = overview(&contents) + &replayed.as_ref().map(replay_text).unwrap_or_default();
        let printed = io::stdout().write_all(shown.as_bytes());
        printed.or_else(ProgramError::of_stdout)?;
    }
    match &mut controller {
        Some(controller) if arguments.discard => controller.discard()?,
        _ => {}
    }
    match replayed.and_then(|replay| replay.difference) {
        Some(difference) => {
            let before_ms = difference.before_end_s * 1e3;
            let text = format!(
                "the replay differs {before_ms:.0} ms before the end: {}",
                difference.what
            );
            Err(ProgramError::new(code::FAILED, text))
        }
        None => Ok(()),
    }
}

/// The recording, replayed.
fn replay_of(contents: &Contents, config: &Config) -> Result<Replay, ProgramError> {
    if contents.config_hash().is_some_and(|hash| config.hash() != Some(hash)) {
        eprintln!(
            "the recording was made with another configuration; the replay shows the fault that this one would have raised at the same positions and setpoints"
        );
    }
    replay(contents, config).map_err(|why| ProgramError::new(code::INPUT, why))
}

/// What a replay has shown.
fn replay_text(replay: &Replay) -> String {
    let fault = |latched: &Latched| {
        let words = latched.fault.as_ref().map(text::fault);
        let before_ms = latched.before_end_s * 1e3;
        (
            before_ms,
            words.unwrap_or_else(|| "its event is missing, or another fault came first".to_owned()),
        )
    };
    let mut shown = format!("\nreplay: the same results in {} ms\n", replay.agreed_ms);
    for latched in &replay.faults {
        let (before_ms, words) = fault(latched);
        // Writing into a string cannot fail.
        let _ = writeln!(
            shown,
            "the same fault in the same millisecond, {before_ms:.0} ms before the end: {words}"
        );
    }
    if let Some(latched) = &replay.not_recorded {
        let (before_ms, words) = fault(latched);
        let _ = writeln!(
            shown,
            "the replay ends {before_ms:.0} ms before the end, with a fault whose cause is not, or not all, in the \
             recording: {words}"
        );
    }
    shown
}

/// The configuration, unless the recording was made with another one.
fn config_of<'a>(contents: &Contents, config: &'a Config) -> Option<&'a Config> {
    let is_other = contents.config_hash().is_some_and(|hash| config.hash() != Some(hash));
    if is_other {
        eprintln!(
            "the recording was made with another configuration, so the file has no positions of the platform; give \
             that configuration with --config"
        );
    }
    (!is_other).then_some(config)
}

fn write_file(path: &Path, bytes: io::Result<Vec<u8>>) -> Result<(), ProgramError> {
    let written = bytes.and_then(|bytes| output_file::write(path, &bytes));
    written.map_err(|cause| unwritable(path, &cause))?;
    eprintln!("wrote {}", path.display());
    Ok(())
}

/// Why the memory is not a recording, and what to try.
fn no_recording(why: NoRecording, arguments: &Arguments, length: usize) -> ProgramError {
    let from = match &arguments.image {
        Some(image) => image.display().to_string(),
        None => "the controller's black box".to_owned(),
    };
    let text = match why {
        NoRecording::Length => {
            let relation = if length < MEMORY_BYTES { "fewer" } else { "more" };
            format!("{from} has {relation} than {MEMORY_BYTES} bytes, so it is not the whole memory; save it again")
        }
        NoRecording::Unknown => format!(
            "{from} holds no recording that this program can read: nothing was recorded, or the firmware has another \
             layout; use the program and the firmware of one version"
        ),
    };
    let code = if arguments.image.is_some() {
        code::INPUT
    } else {
        code::FAILED
    };
    ProgramError::new(code, text)
}

/// Reads an image, at most one byte more than a black box has.
fn image_file(path: &Path) -> Result<Vec<u8>, ProgramError> {
    let mut memory = Vec::new();
    let read = File::open(path).and_then(|file| file.take(MEMORY_BYTES as u64 + 1).read_to_end(&mut memory));
    match read {
        Ok(_) => Ok(memory),
        Err(cause) => {
            let text = format!("{} cannot be read: {cause}", path.display());
            Err(ProgramError::new(code::INPUT, text))
        }
    }
}

/// A memory that was read.
struct Memory {
    memory: Vec<u8>,
    /// Whether the controller may have recorded while it was read.
    stalled: bool,
}

/// The controller at a port.
#[allow(clippy::large_enum_variant)] // there is one
enum Controller {
    /// Over the port, opened here.
    Own(Machine),
    /// Through the program that has the port.
    Through(Client),
}

impl Controller {
    fn find(port: &PortName, config: &Config) -> Result<Self, ProgramError> {
        if let Some(client) = Client::find(port) {
            eprintln!("through {}", client.owner());
            return Ok(Self::Through(client));
        }
        Machine::start(port.clone(), config.clone(), MachineOptions::default())
            .map(Self::Own)
            .map_err(|cause| ProgramError::new(code::CONNECTION, cause))
    }

    fn ask(&mut self, request: Request) -> Result<Answer, ProgramError> {
        let order = Order::Measure(request.into());
        let reply = match self {
            Self::Own(machine) => machine.carry_out(order)?,
            Self::Through(client) => client.carry_out(order)?,
        };
        match reply {
            Reply::Measured(RecordAnswer::BlackBox(answer)) => Ok(answer),
            _ => Err(ProgramError::failed(
                "the black box",
                "an answer to another question came; try again",
            )),
        }
    }

    /// Reads the whole memory, with progress on stderr.
    fn read(&mut self) -> Result<Memory, ProgramError> {
        let bar = ProgressBar::new(MEMORY_BYTES as u64);
        let style = ProgressStyle::with_template("reading  {bar:32} {percent:>3} %");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        let read = self.read_pieces(|bytes| bar.set_position(bytes as u64));
        bar.finish_and_clear();
        read
    }

    fn read_pieces(&mut self, progress: impl Fn(usize)) -> Result<Memory, ProgramError> {
        let mut reader = Reader::new();
        let (mut useless, mut stalled) = (0, false);
        let mut before: Option<Instant> = None;
        while let Some(request) = reader.request() {
            let asked = Instant::now();
            let answer = self.ask(request)?;
            stalled |= before.is_some_and(|before| before.elapsed() > PAUSE_MAX);
            before = Some(asked);
            useless = if reader.take(&answer) { 0 } else { useless + 1 };
            if useless > USELESS_MAX {
                let text = "the controller does not send the piece that was asked for; reset it and try again";
                return Err(ProgramError::failed("the black box", text));
            }
            progress(reader.bytes_read());
        }
        let memory = reader.into_memory().unwrap_or_default();
        Ok(Memory { memory, stalled })
    }

    fn discard(&mut self) -> Result<(), ProgramError> {
        match self.ask(Request::Discard)? {
            Answer::Discarded => {
                eprintln!("discarded; the controller records again");
                Ok(())
            }
            Answer::Piece { .. } => Err(ProgramError::failed(
                "the recording was read but not discarded",
                "an answer to another question came; try again with --discard",
            )),
        }
    }
}

/// The summary and the last events.
fn overview(contents: &Contents) -> String {
    let summary = &contents.summary;
    let mut text = String::new();
    // Writing into a string cannot fail.
    let _ = writeln!(text, "{}", origin_text(summary.origin));
    let _ = writeln!(
        text,
        "{} in {} ms, {} missing in {}; {}",
        counted(summary.samples, "sample"),
        summary.span_ms,
        summary.samples_missing,
        counted(summary.gaps, "gap"),
        counted(summary.events, "event"),
    );
    let _ = writeln!(
        text,
        "{} sent, {} received, {} not recorded",
        counted(summary.frames_sent, "frame"),
        summary.frames_received,
        summary.frames_missed
    );
    match summary.last_mode {
        Some(mode) => {
            let _ = writeln!(text, "last mode: {mode:?}, {}", text::mode(mode));
        }
        None => text.push_str("last mode: not recorded\n"),
    }
    match &summary.last_fault {
        Some(last) => {
            let before_ms = last.before_end_s * 1e3;
            let _ = writeln!(text, "last fault, {before_ms:.0} ms before the end: {}", last.text);
        }
        None => text.push_str("last fault: none recorded\n"),
    }
    let first = contents.events.len().saturating_sub(EVENTS_SHOWN);
    let last = contents.events.get(first..).unwrap_or_default();
    if !last.is_empty() {
        text.push_str("\nms before the end\n");
    }
    for entry in last {
        let _ = writeln!(text, "{:>17.0}  {}", entry.before_end_s * 1e3, entry.text);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_form_of_a_file_follows_from_its_extension() {
        let form = |name: &str| Form::of(Path::new(name)).map_err(|error| error.code);
        assert_eq!(form("a/run.mcap"), Ok(Form::Mcap));
        assert_eq!(form("run.json"), Ok(Form::Json));
        for name in ["run.csv", "mcap", "run", "-"] {
            assert_eq!(form(name), Err(code::USAGE), "{name}");
        }
    }
}
