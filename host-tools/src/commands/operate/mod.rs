//! `etherpen status`, `hold`, `stop`, `move` and similar commands: operate a machine from any terminal.
//!
//! If another program of this user has the port and shares its machine, that program carries out the order; otherwise
//! this program opens the port. The output says which. Without `--port` the one program that shares its machine is
//! used.

mod io;
mod jobs;
mod status;

use super::ports::{self, SessionPort};
use super::{ConfigArguments, ended_by_a_signal, print_json};
use crate::error::{ProgramError, code};
use crate::job::{Motion, Ready};
use crate::link::ownership::Owner;
use crate::link::port::PortName;
use crate::link::text;
use crate::machine::Order;
use crate::machine::access::{self, Effect, OwnPort};
use crate::machine::ending::{END_MAX, state_text};
use etherpen::application::Mode;
use etherpen::messages::Command as Told;
use etherpen::motion::Pen;
use etherpen::robots::Position;
use serde::Serialize;

/// A machine from any terminal.
#[derive(clap::Subcommand, Debug)]
pub enum Command {
    /// Stop the robot at once, on its path if it moves, and latch a fault (exit code 0: the robot is at a standstill).
    Stop {
        /// Stop every robot that a running program owns, and the one at --port.
        #[arg(long)]
        all: bool,
        /// Which machine.
        #[command(flatten)]
        arguments: Arguments,
    },
    /// Show the machine's state and which program owns it; sends no command.
    Status(Arguments),
    /// Hold the drawing: decelerate on the path, lift the pen, wait.
    Hold {
        /// Wait until the pen is up between two strokes.
        #[arg(long)]
        at_pen_up: bool,
        /// Which machine.
        #[command(flatten)]
        arguments: Arguments,
    },
    /// Resume a held drawing; only through the program that draws it.
    Resume(Arguments),
    /// Cancel the drawing or the motion: decelerate on the path, lift the pen, discard the rest.
    Cancel(Arguments),
    /// Scale the path speed.
    Override {
        /// Percent of the configured speed, 10 to 200.
        #[arg(value_parser = clap::value_parser!(u8).range(10..=200))]
        percent: u8,
        /// Which machine.
        #[command(flatten)]
        arguments: Arguments,
    },
    /// Move at a velocity for a time; stops when this program ends.
    Jog {
        /// Velocity of the tool, mm/s.
        #[arg(value_name = "VX,VY,VZ", allow_hyphen_values = true, value_parser = velocity)]
        velocity: Velocity,
        /// Duration, s.
        #[arg(long = "for", value_name = "SECONDS", default_value_t = 1.0, value_parser = seconds)]
        seconds: f64,
        /// Which machine.
        #[command(flatten)]
        arguments: Arguments,
    },
    /// Lift or lower the pen at its present position.
    Pen {
        /// Up or down.
        to: PenTo,
        /// Which machine.
        #[command(flatten)]
        arguments: Arguments,
    },
    /// Move to a position in a straight line, pen up.
    Move {
        /// Target position, mm in the robot's frame.
        #[arg(value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = position)]
        position: Position,
        /// Which machine.
        #[command(flatten)]
        arguments: Arguments,
    },
    /// Configure the firmware, bring up the bus, home at the marks if necessary, and power the drives.
    Enable(Arguments),
    /// Ramp to a standstill, close the brakes, switch the drives' power off.
    Disable(Arguments),
    /// Acknowledge a fault after its cause is gone; brings lost drives back.
    Acknowledge(Arguments),
    /// List the named inputs and outputs of terminals, or show or set one of them.
    Io(io::IoArguments),
    /// List the drawings in this computer's job log, with the progress of unfinished ones.
    Jobs(jobs::Arguments),
}

/// Options of every command that works with a running machine.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    port: SessionPort,
    /// Print the result as JSON on stdout.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    config: ConfigArguments,
}

/// Position of the pen.
#[derive(clap::ValueEnum, Clone, Copy, Debug)]
pub enum PenTo {
    /// Off the paper.
    Up,
    /// On the paper.
    Down,
}

/// A velocity of the platform, mm/s.
#[derive(Clone, Copy, Debug)]
pub struct Velocity([f32; 3]);

fn three(text: &str) -> Result<[f64; 3], String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse::<f64>()).collect();
    let numbers: Option<[f64; 3]> = numbers.ok().and_then(|numbers| numbers.try_into().ok());
    let finite = numbers.filter(|numbers| numbers.iter().all(|number| number.is_finite()));
    finite.ok_or_else(|| "three finite numbers with commas between them are needed".into())
}

fn velocity(text: &str) -> Result<Velocity, String> {
    three(text).map(|numbers| Velocity(numbers.map(|number| number as f32)))
}

pub(super) fn position(text: &str) -> Result<Position, String> {
    three(text).map(Position::from)
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if (0.0..=600.0).contains(&seconds) => Ok(seconds),
        _ => Err("a number of seconds from 0 to 600 is needed".into()),
    }
}

/// Runs one of the commands.
///
/// # Errors
/// There is no machine, it refused the order, or it stopped with a fault.
pub fn run(command: &Command) -> Result<(), ProgramError> {
    let (arguments, name, order) = match command {
        Command::Status(arguments) => return status::run(arguments),
        Command::Jobs(arguments) => return jobs::run(arguments),
        Command::Io(arguments) => return io::run(arguments),
        Command::Hold { at_pen_up, arguments } => (
            arguments,
            "hold",
            if *at_pen_up { Order::HoldAtPenUp } else { Order::Hold },
        ),
        Command::Resume(arguments) => (arguments, "resume", Order::Resume),
        Command::Cancel(arguments) => (arguments, "cancel", Order::Cancel),
        Command::Stop { all: true, arguments } => return stop_all(arguments),
        Command::Stop { arguments, .. } => (arguments, "stop", Order::Stop),
        Command::Override { percent, arguments } => (arguments, "override", Order::Override(*percent)),
        Command::Jog {
            velocity,
            seconds,
            arguments,
        } => {
            let for_ms = (seconds * 1_000.0).round() as u32;
            let velocity_mm_s = velocity.0;
            (arguments, "jog", Order::Motion(Motion::Jog { velocity_mm_s, for_ms }))
        }
        Command::Pen { to, arguments } => {
            let pen = match to {
                PenTo::Up => Pen::Up,
                PenTo::Down => Pen::Down,
            };
            (arguments, "pen", Order::Motion(Motion::Pen(pen)))
        }
        Command::Move { position, arguments } => (arguments, "move", Order::Motion(Motion::Move(*position))),
        Command::Enable(arguments) => (arguments, "enable", Order::Prepare(Ready::Enabled)),
        Command::Disable(arguments) => (arguments, "disable", Order::Settle(Told::Disable)),
        Command::Acknowledge(arguments) => (arguments, "acknowledge", Order::Settle(Told::Acknowledge)),
    };
    let port = arguments.port.find()?;
    let done = Done::new(
        name,
        arguments.with_own_port(|own| access::carry_out(&port, own, order))?,
    );
    if arguments.json {
        print_json(&done)?;
    } else {
        done.tell();
    }
    done.ended()
}

impl Arguments {
    /// Calls `work` with what is needed to open the port here.
    fn with_own_port<T>(&self, work: impl FnOnce(OwnPort) -> T) -> T {
        work(OwnPort {
            config: &|| self.config.load(),
            interrupted: &ended_by_a_signal,
            tell: &|waiting| eprintln!("{waiting}"),
        })
    }
}

/// Stops every machine of a running program, and the one at `--port`, all in parallel.
fn stop_all(arguments: &Arguments) -> Result<(), ProgramError> {
    let (sharing, alone) = ports::running()?;
    let mut all: Vec<PortName> = sharing.into_iter().map(|found| found.port).collect();
    all.extend(arguments.port.port.clone().filter(|named| !all.contains(named)));
    let stopped = arguments.with_own_port(|own| access::stop_all(&all, own));
    let mut result = match all.is_empty() {
        true => Err(ProgramError::new(
            code::CONNECTION,
            "no running program has a robot that could be stopped",
        )),
        false => Ok(()),
    };
    let mut answers = Vec::new();
    for (port, stopped) in all.iter().zip(stopped) {
        let ended = match stopped {
            Ok(effect) => {
                let done = Done::new("stop", effect);
                eprint!("{port}: ");
                done.tell();
                let ended = done.ended();
                answers.push(done);
                ended
            }
            Err(error) => {
                eprintln!("{port}: NOT STOPPED: {}", error.message);
                Err(ProgramError::new(error.code, "not every robot was stopped"))
            }
        };
        result = result.and(ended);
    }
    for found in &alone {
        let (port, owner) = (&found.port, &found.owner);
        eprintln!("{port}: NOT STOPPED: {owner} takes no orders; Ctrl-C in its terminal ends it");
        result = result.and(Err(ProgramError::new(code::FAILED, "not every robot was stopped")));
    }
    if arguments.json {
        print_json(&answers)?;
    }
    result
}

/// What a command prints with `--json`.
#[derive(Debug, Serialize)]
struct Done {
    order: &'static str,
    /// Whether the machine accepted the order.
    done: bool,
    /// Whether the end state of the order was reached.
    reached: bool,
    /// State of the machine in words.
    state: String,
    mode: Option<Mode>,
    fault: Option<String>,
    referenced: Option<bool>,
    override_percent: Option<u8>,
    owner: Option<Owner>,
    /// Whether missing the end state is an error.
    #[serde(skip)]
    is_due: bool,
}

impl Done {
    fn new(order: &'static str, effect: Effect) -> Self {
        let status = effect.snapshot.status.as_ref();
        Self {
            order,
            done: true,
            reached: effect.reached,
            state: state_text(&effect.snapshot),
            mode: status.map(|status| status.mode),
            fault: status.and_then(text::fault_of),
            referenced: status.map(|status| status.referenced),
            override_percent: status.map(|status| status.override_percent),
            owner: effect.owner,
            is_due: effect.is_due,
        }
    }

    fn tell(&self) {
        let Self { order, state, .. } = self;
        let through = match &self.owner {
            Some(owner) => format!(" (through {owner})"),
            None => String::new(),
        };
        let waited_s = END_MAX.as_secs();
        match self.reached {
            true => eprintln!("{order}: {state}{through}"),
            false => eprintln!("{order}: accepted, but not carried out within {waited_s} s: {state}{through}"),
        }
    }

    /// An error if the end state was due and was not reached.
    fn ended(&self) -> Result<(), ProgramError> {
        if self.reached || !self.is_due {
            return Ok(());
        }
        let text = format!("{} was accepted, but its end was not seen: {}", self.order, self.state);
        Err(ProgramError::new(code::FAILED, text))
    }
}
