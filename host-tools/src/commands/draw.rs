//! `etherpen draw`: draws a file on paper, on a running machine or emulator.
//!
//! The machine is shared during the drawing, so that other terminals can hold, resume, cancel and stop it. Every
//! drawing is recorded in the job log, from which an interrupted one can be resumed.

mod layers;
mod session;

use super::display::Display;
use super::operator::{Key, Operator};
use super::pen_change::PenChangeArguments;
use super::ports::PortArguments;
use super::{DrawingArguments, print_json};
use crate::drawing::preparation::outline::around;
use crate::drawing::preparation::prepare::{Prepared, prepare_with};
use crate::drawing::preparation::source::SourceArguments;
use crate::drawing::preparation::wire::to_wire;
use crate::drawing::take_photograph;
use crate::error::{ProgramError, code};
use crate::job::history::{self, Record, hash_text};
use crate::job::resume::{self, MachineState, ResumePlan, Resumption};
use crate::job::{JobReport, Motion, path_hash};
use crate::machine::drawing::DrawingRun;
use crate::machine::{Machine, MachineOptions, Order};
use crate::output_file::make_folder;
use crate::report::output::{Outcome, refuse_inputs_in};
use crate::report::summary::summarise;
use etherpen::config::Config;
use etherpen::messages::PathVertex;
use etherpen::robots::Position;
use layers::draw_layers;
use session::{LOOK, attend};
use std::path::{Path, PathBuf};
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

/// Path speed while the pen goes around a drawing's border, percent, slow enough to watch, and the default speed.
const OUTLINE_PACE: u8 = 20;
const PACE_FULL: u8 = 100;
/// Longest wait for the answer to a change of speed.
const ANSWER_MAX: Duration = Duration::from_secs(2);

/// Options of `etherpen draw`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Photograph (PNG, JPEG, WebP), vectors (SVG, G-code, HPGL) or CSV to draw; - reads it from standard input.
    #[arg(required_unless_present_any = ["camera", "resume"], conflicts_with = "camera")]
    file: Option<PathBuf>,
    /// Take a photograph with a V4L2 device (/dev/video0), or from a recorded stream of JPEG pictures, and draw it. The
    /// picture is kept beside the job log, so that the drawing can be resumed.
    #[arg(long, value_name = "DEVICE", conflicts_with = "resume")]
    camera: Option<PathBuf>,
    #[command(flatten)]
    port: PortArguments,
    /// First acknowledge a latched fault, which brings lost drives back, and cancel an abandoned drawing.
    #[arg(long)]
    acknowledge: bool,
    /// Continue an interrupted drawing: with the path that the firmware still holds, else from the job log (etherpen
    /// jobs) with a small overlap. JOB is a name in that log, or the beginning of one; file and options come from the
    /// log. Without JOB: the last job of FILE that drew something, with the same options. The configuration may have
    /// changed, but not the paper or the limits of motion.
    #[arg(long, value_name = "JOB", num_args = 0..=1, default_missing_value = "", conflicts_with = "acknowledge")]
    resume: Option<String>,
    /// Draw layer by layer. The drives have no power between two layers, so that you can change the pen, and Enter draws
    /// the next one. Results go to DIR/layer-N. With --resume, FILE and the same options: go on with the first layer
    /// that the job log does not know as drawn.
    #[arg(long, conflicts_with = "camera")]
    pause: bool,
    #[command(flatten)]
    pen_change: PenChangeArguments,
    /// First trace the drawing's border slowly with the pen up, to show where it lies on the paper; then wait, without
    /// power, for Enter. Without a terminal, a line on standard input counts as Enter; if standard input ends first,
    /// nothing is drawn.
    #[arg(long, conflicts_with = "resume")]
    outline: bool,
    #[command(flatten)]
    drawing: DrawingArguments,
}

/// Runs the command.
///
/// # Errors
/// The file or the configuration cannot be used, there is no connection, or the drawing failed.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let config = arguments.drawing.config.load()?;
    let resumption = resumption(arguments)?;
    let file = file(arguments, resumption.as_ref())?;
    let source = &source(arguments, resumption.as_ref())?;
    let mut operator = Operator::start();
    if arguments.outline {
        outline(arguments, &config, &file, &mut operator)?;
    }
    if arguments.pause {
        return draw_layers(arguments, &config, &file, source, &mut operator);
    }
    let part = Part {
        file: &file,
        source: source.clone(),
        out: arguments.drawing.out.clone(),
        then_to: None,
        name: file.display().to_string(),
    };
    draw(arguments, &config, &part, resumption.as_ref(), &mut operator).map_err(|end| end.error)
}

/// Traces the drawing's border with the pen up, and waits until the operator starts the drawing.
fn outline(arguments: &Arguments, config: &Config, file: &Path, operator: &mut Operator) -> Result<(), ProgramError> {
    if file.as_os_str() == "-" {
        let text = "--outline reads the file once more for the drawing: standard input cannot be read again";
        return Err(ProgramError::new(code::USAGE, text));
    }
    let prepared = prepare_with(file, config, &arguments.drawing.source)?;
    let Some((border, [width_mm, height_mm])) = around(&prepared.path, config) else {
        return Ok(());
    };
    let machine = start(arguments, config)?;
    // A machine whose state is not known goes at the default pace.
    let pace = machine
        .known_state()?
        .status
        .map_or(PACE_FULL, |status| status.override_percent);
    // A machine that refuses the pace goes at its own.
    let paced = |percent: u8| drop(machine.order(Order::Override(percent)).recv_timeout(ANSWER_MAX));
    paced(OUTLINE_PACE);
    let plan = ResumePlan::whole(&border, None);
    let drawing = DrawingRun::begin(&machine, config, &border, plan, "outline");
    let ended = attend(drawing, operator, display(arguments));
    paced(pace);
    ended?.result?;
    drop(machine);
    eprintln!(
        "etherpen: the pen went around {width_mm:.1} x {height_mm:.1} mm without touching; Enter draws, Ctrl-C ends"
    );
    match operator.wait_or_early() {
        Some(Key::Enter) => Ok(()),
        Some(Key::Interrupt | Key::Terminate) | None => Err(ProgramError::new(
            code::INTERRUPTED,
            "ended after the outline; nothing was drawn",
        )),
    }
}

fn display(arguments: &Arguments) -> Display {
    match arguments.drawing.json {
        true => Display::lines_of_json(),
        false => Display::new(),
    }
}

fn start(arguments: &Arguments, config: &Config) -> Result<Machine, ProgramError> {
    let options = MachineOptions {
        acknowledge: arguments.acknowledge,
        ..MachineOptions::default()
    };
    Machine::start(arguments.port.port.clone(), config.clone(), options)
        .map_err(|cause| ProgramError::new(code::CONNECTION, cause))
}

/// The part of a drawing between two pauses.
struct Part<'a> {
    file: &'a Path,
    source: SourceArguments,
    out: Option<PathBuf>,
    /// Where the robot goes when the part is drawn, pen up.
    then_to: Option<Position>,
    name: String,
}

/// Why a part was not drawn to its end.
struct EarlyEnd {
    error: ProgramError,
    /// Whether the robot had begun to draw it.
    begun: bool,
}

impl From<ProgramError> for EarlyEnd {
    fn from(error: ProgramError) -> Self {
        Self { error, begun: false }
    }
}

/// Prepares, draws, then switches the power off.
fn draw(
    arguments: &Arguments,
    config: &Config,
    part: &Part,
    resumption: Option<&Resumption>,
    operator: &mut Operator,
) -> Result<(), EarlyEnd> {
    if let Some(dir) = &part.out {
        refuse_inputs_in(dir, &part.source.inputs(part.file, arguments.drawing.config.path()))?;
    }
    let prepared = prepare_with(part.file, config, &part.source)?;
    if let Some(dir) = &part.out {
        make_folder(dir)?;
    }
    let path: Vec<PathVertex> = prepared.path.iter().map(to_wire).collect();
    let hash = hash_text(path_hash(&path));
    let before = match resumption {
        Some(resumption) => resumption.candidates(&hash, part.file)?,
        None => Vec::new(),
    };
    let machine = start(arguments, config)?;
    let plan = match before.is_empty() {
        false => resume::plan(before, &known(&machine)?, config, &path)?,
        true => ResumePlan::whole(&path, begin_log(arguments, part, config, &path)),
    };
    if !plan.notice.is_empty() {
        eprintln!("{}", plan.notice);
    }
    let drawing = DrawingRun::begin(&machine, config, &path, plan, &part.name);
    // From here on the robot may have drawn.
    let begun = |error: ProgramError| EarlyEnd { error, begun: true };
    let ended = attend(drawing, operator, display(arguments)).map_err(begun)?;
    let (result, job) = (ended.result, ended.report);
    let finished = finish(arguments, config, part, &prepared, &job, result.is_ok());
    result.map_err(|failure| EarlyEnd {
        error: failure.into(),
        begun: job.progress.vertices > 0 || job.progress.strokes > 0 || job.verification.verdict().error().is_some(),
    })?;
    if let Some(position) = part.then_to {
        go_to(&machine, position, operator).map_err(begun)?;
    }
    finished.map_err(begun)
}

fn known(machine: &Machine) -> Result<MachineState, ProgramError> {
    Ok(machine.known_state()?.into())
}

/// Moves to a place with the pen up; a key ends the motion. A robot that does not get there stays where it is.
///
/// # Errors
/// The program was asked to end meanwhile.
fn go_to(machine: &Machine, position: Position, operator: &mut Operator) -> Result<(), ProgramError> {
    let mut is_asked_to_end = false;
    let answer = machine.order(Order::Motion(Motion::Move(position)));
    loop {
        match answer.recv_timeout(LOOK) {
            Err(RecvTimeoutError::Timeout) => {}
            Ok(Ok(_)) | Err(RecvTimeoutError::Disconnected) => break,
            Ok(Err(failure)) => {
                eprintln!("etherpen: the robot is not at the place for changing the pen: {failure}");
                break;
            }
        }
        if let Some(key) = operator.next_key().filter(|key| *key != Key::Enter) {
            is_asked_to_end |= key == Key::Terminate;
            drop(machine.order(Order::Cancel));
        }
    }
    match is_asked_to_end {
        true => Err(ProgramError::new(code::INTERRUPTED, "ended after a layer")),
        false => Ok(()),
    }
}

/// The target of `--resume`. Without a file argument, a value that is not a job in the log but a file selects that
/// file: `draw --resume FILE`.
fn resumption(arguments: &Arguments) -> Result<Option<Resumption>, ProgramError> {
    let Some(name) = &arguments.resume else {
        return Ok(None);
    };
    match (name.as_str(), &arguments.file) {
        (name, Some(_)) if arguments.pause && !name.is_empty() => {
            let text = "--pause --resume goes on with the layers of FILE: leave the name of the job out";
            Err(ProgramError::new(code::USAGE, text))
        }
        ("", Some(file)) => Ok(Some(Resumption::Last(file.clone()))),
        ("", None) => {
            let text = "--resume needs a file, or the name of a job: etherpen jobs lists them";
            Err(ProgramError::new(code::USAGE, text))
        }
        (name, None) if Path::new(name).is_file() => Ok(Some(Resumption::Last(name.into()))),
        (_, None) if arguments.pause => {
            let text = "--pause --resume needs the file and the options with which it was drawn";
            Err(ProgramError::new(code::USAGE, text))
        }
        (name, _) => resume::named(name).map(|record| Some(Resumption::Job(Box::new(record)))),
    }
}

/// The file to draw: the given one, that of the job to resume, or a photograph from a camera.
fn file(arguments: &Arguments, resumption: Option<&Resumption>) -> Result<PathBuf, ProgramError> {
    let Some(device) = &arguments.camera else {
        let of_job = || resumption.map(|resumption| resumption.file().to_owned());
        return Ok(arguments.file.clone().or_else(of_job).unwrap_or_default());
    };
    let unusable =
        |cause: &dyn std::fmt::Display| ProgramError::new(code::INPUT, format!("{}: {cause}", device.display()));
    let picture = take_photograph(device).map_err(|cause| unusable(&cause))?;
    let file = history::keep_picture(&picture)?;
    eprintln!(
        "etherpen: {} x {} pixels from {}, kept as {}",
        picture.width(),
        picture.height(),
        device.display(),
        file.display()
    );
    Ok(file)
}

/// Options of the conversion into strokes: the given ones, or those of the job to resume.
fn source(arguments: &Arguments, resumption: Option<&Resumption>) -> Result<SourceArguments, ProgramError> {
    let given = &arguments.drawing.source;
    let Some(resumption) = resumption.filter(|_| arguments.file.is_none()) else {
        return Ok(given.clone());
    };
    match resumption.source()? {
        Some(_) if given.is_given() => {
            let text =
                "--resume JOB takes the options of the file from the log of jobs: leave them out, or name the file too";
            Err(ProgramError::new(code::USAGE, text))
        }
        Some(of_job) => Ok(of_job),
        None => Ok(given.clone()),
    }
}

/// Creates the drawing's entry in the job log; `None` if the log cannot be written.
fn begin_log(arguments: &Arguments, part: &Part, config: &Config, path: &[PathVertex]) -> Option<Record> {
    let begun = resume::begin_record(part.file, &part.source, &arguments.port.port, config, path);
    begun
        .map_err(|cause| eprintln!("this drawing is not in the log and cannot be resumed: {cause}"))
        .ok()
}

/// Writes and prints the result of the drawing, also after a failure.
fn finish(
    arguments: &Arguments,
    config: &Config,
    part: &Part,
    prepared: &Prepared,
    job: &JobReport,
    completed: bool,
) -> Result<(), ProgramError> {
    let outcome = Outcome::of_machine(config, prepared, job, completed);
    let report = outcome.report();
    // A drawing that never began has nothing to show.
    if let Some(dir) = &part.out
        && !job.samples.is_empty()
    {
        outcome.write(dir, &report)?;
    }
    if completed {
        summarise(&report, part.out.as_deref());
    }
    if arguments.drawing.json {
        print_json(&report)?;
    }
    Ok(())
}
