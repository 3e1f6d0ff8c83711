//! `etherpen status`, `hold`, `stop`, `move` and similar commands: operate a machine from any terminal.
//!
//! If another program of this user has the port and shares its machine, that program carries out the order; otherwise
//! this program opens the port. The output says which. Without `--port` the one program that shares its machine is
//! used.

mod ending;
mod jobs;
mod status;

use super::ports::{self, SessionPort};
use super::{ConfigArguments, ended_by_a_signal, print_json};
use crate::error::{ProgramError, code};
use crate::job::{Motion, Ready};
use crate::link::ownership::Owner;
use crate::link::port::{PortError, PortName};
use crate::link::text;
use crate::machine::{Answer, Client, Failure, Machine, MachineOptions, Order, Snapshot};
use ending::{END_MAX, Ending, state_text};
use etherpen::application::Mode;
use etherpen::messages::Command as Told;
use etherpen::motion::Pen;
use etherpen::robots::Position;
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

/// Time between two checks while waiting.
const LOOK: Duration = Duration::from_millis(20);
/// Longest wait for the machine's state; the link's own time limit is shorter.
const STATE_MAX: Duration = Duration::from_secs(10);
/// Longest wait for a sample of a machine whose status is known.
const SAMPLE_MAX: Duration = Duration::from_secs(1);

/// A machine from any terminal.
#[derive(clap::Subcommand, Debug)]
pub enum Command {
    /// Quick stop of all drives at once, latched as a fault (exit code 0: the robot stands).
    Stop {
        /// Stop every robot that a running program has, and the one at --port.
        #[arg(long)]
        all: bool,
        /// Which machine.
        #[command(flatten)]
        arguments: Arguments,
    },
    /// Show where the machine stands and who works with it; nothing is commanded.
    Status(Arguments),
    /// Hold the drawing: decelerate on the path, lift the pen, wait.
    Hold {
        /// Only when the pen is up between two strokes.
        #[arg(long)]
        at_pen_up: bool,
        /// Which machine.
        #[command(flatten)]
        arguments: Arguments,
    },
    /// Go on with a held drawing; only through the program that draws it.
    Resume(Arguments),
    /// End the drawing or the motion: decelerate on the path, lift the pen, forget the rest.
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
    /// Move with a velocity for a while; ends with this program.
    Jog {
        /// Velocity of the platform, mm/s.
        #[arg(value_name = "VX,VY,VZ", allow_hyphen_values = true, value_parser = velocity)]
        velocity: Velocity,
        /// For how long, s.
        #[arg(long = "for", value_name = "SECONDS", default_value_t = 1.0, value_parser = seconds)]
        seconds: f64,
        /// Which machine.
        #[command(flatten)]
        arguments: Arguments,
    },
    /// Lift or lower the pen where it stands.
    Pen {
        /// Where to.
        to: PenTo,
        /// Which machine.
        #[command(flatten)]
        arguments: Arguments,
    },
    /// Move to a position in a straight line, pen up.
    Move {
        /// Where to, mm in the robot's frame.
        #[arg(value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = position)]
        position: Position,
        /// Which machine.
        #[command(flatten)]
        arguments: Arguments,
    },
    /// Configure, bring up the bus, reference at the marks where there is no reference, and give the drives power.
    Enable(Arguments),
    /// Ramp to a standstill, close the brakes, take the power from the drives.
    Disable(Arguments),
    /// Acknowledge a fault once its cause has gone; lost drives are brought back.
    Acknowledge(Arguments),
    /// List the drawings of this computer's log, broken ones with how far they came.
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

/// Where the pen is to be.
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

fn position(text: &str) -> Result<Position, String> {
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
    let done = carry_out(&port, arguments, name, order)?;
    if arguments.json {
        print_json(&done)?;
    } else {
        done.tell();
    }
    done.ended()
}

/// Carries out an order and waits for its effect.
fn carry_out(port: &PortName, arguments: &Arguments, name: &'static str, order: Order) -> Result<Done, ProgramError> {
    let mut way = Way::find(port, arguments)?;
    let order = way.carry_out(order)?;
    let begun = Instant::now();
    let mut ending: Option<Ending> = None;
    loop {
        match way.state() {
            Ok(snapshot) => {
                let ending = ending.get_or_insert_with(|| Ending::new(order.clone(), &snapshot));
                if ending.is_reached(&snapshot) || begun.elapsed() > END_MAX {
                    return Ok(Done::new(name, ending, &snapshot, way.owner().cloned()));
                }
            }
            Err(gone) if begun.elapsed() > END_MAX => return Err(gone),
            // The program that had the port has ended, as a drawing's does after a stop: the port is opened here.
            Err(_) => {
                if let Ok(own) = Way::find(port, arguments) {
                    (way, ending) = (own, Some(Ending::after_reconnection(order.clone())));
                }
            }
        }
        std::thread::sleep(LOOK);
    }
}

/// Stops every machine of a running program, and the one at `--port`, all in parallel.
fn stop_all(arguments: &Arguments) -> Result<(), ProgramError> {
    let (sharing, alone) = ports::running()?;
    let mut all: Vec<PortName> = sharing.into_iter().map(|found| found.port).collect();
    all.extend(arguments.port.port.clone().filter(|named| !all.contains(named)));
    let stopped: Vec<_> = std::thread::scope(|scope| {
        let begin = |port| scope.spawn(move || carry_out(port, arguments, "stop", Order::Stop));
        let under_way: Vec<_> = all.iter().map(begin).collect();
        let end = |thread: std::thread::ScopedJoinHandle<'_, _>| {
            thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        };
        under_way.into_iter().map(end).collect()
    });
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
            Ok(done) => {
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
    /// Whether the state was seen that the order leads to.
    reached: bool,
    /// Where the machine stands now, in words.
    state: String,
    mode: Option<Mode>,
    fault: Option<String>,
    referenced: Option<bool>,
    override_percent: Option<u8>,
    owner: Option<Owner>,
    /// Whether a state that was not reached is an error.
    #[serde(skip)]
    is_due: bool,
}

impl Done {
    fn new(order: &'static str, ending: &Ending, snapshot: &Snapshot, owner: Option<Owner>) -> Self {
        let status = snapshot.status.as_ref();
        Self {
            order,
            done: true,
            reached: ending.is_reached(snapshot),
            state: state_text(snapshot),
            mode: status.map(|status| status.mode),
            fault: status.and_then(|status| status.fault).map(|fault| text::fault(&fault)),
            referenced: status.map(|status| status.referenced),
            override_percent: status.map(|status| status.override_percent),
            owner,
            is_due: ending.is_due(),
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

    /// An error where the end state was due and did not come.
    fn ended(&self) -> Result<(), ProgramError> {
        if self.reached || !self.is_due {
            return Ok(());
        }
        let text = format!("{} was accepted, but its end was not seen: {}", self.order, self.state);
        Err(ProgramError::new(code::FAILED, text))
    }
}

/// The way to the machine.
#[allow(clippy::large_enum_variant)] // there is one
enum Way {
    /// Through the program that has the port.
    Through(Client),
    /// The port, opened here.
    Own(Machine),
}

impl Way {
    fn find(port: &PortName, arguments: &Arguments) -> Result<Self, ProgramError> {
        if let Some(client) = Client::find(port) {
            return Ok(Self::Through(client));
        }
        let config = arguments.config.load()?;
        match Machine::start(port.clone(), config, MachineOptions::default()) {
            Ok(machine) => Ok(Self::Own(machine)),
            // Between the two looks another program has taken the port.
            Err(error @ PortError::Occupied { .. }) => Client::find(port)
                .map(Self::Through)
                .ok_or_else(|| ProgramError::new(code::CONNECTION, error)),
            Err(error) => Err(ProgramError::new(code::CONNECTION, error)),
        }
    }

    fn owner(&self) -> Option<&Owner> {
        match self {
            Self::Through(client) => Some(client.owner()),
            Self::Own(_) => None,
        }
    }

    /// Gives an order and waits for its answer; an interrupt cancels it. Gives the order that was carried out.
    fn carry_out(&mut self, order: Order) -> Result<Order, ProgramError> {
        let (order, answer) = match self {
            Self::Through(client) => (order.clone(), client.carry_out(order)),
            Self::Own(machine) => {
                let order = alone(order)?;
                let interrupted = ended_by_a_signal()?;
                (order.clone(), wait(machine, order, &interrupted))
            }
        };
        answer.map(|_| order).map_err(ProgramError::from)
    }

    /// Where the machine stands, once that is known.
    fn state(&mut self) -> Result<Snapshot, ProgramError> {
        match self {
            Self::Through(client) => Ok(client.snapshot()?),
            Self::Own(machine) => {
                let begun = Instant::now();
                loop {
                    let snapshot = machine.snapshot();
                    if let Some(lost) = snapshot.lost {
                        return Err(lost.into());
                    }
                    let sampled = snapshot.sample.is_some() || begun.elapsed() > SAMPLE_MAX;
                    let known = snapshot.status.is_some() && snapshot.phase.is_none() && sampled;
                    if known || begun.elapsed() > STATE_MAX {
                        return Ok(snapshot);
                    }
                    std::thread::sleep(LOOK);
                }
            }
        }
    }
}

/// The order to use where no program draws; waits for its effect.
fn alone(order: Order) -> Result<Order, ProgramError> {
    Ok(match order {
        Order::Hold | Order::HoldAtPenUp => Order::Settle(Told::Hold),
        Order::Cancel => Order::Settle(Told::Cancel),
        Order::Override(percent) => Order::Settle(Told::Override { percent }),
        Order::Resume => {
            let text = "no program streams a drawing over this port, so there is nothing that could go on; start it \
                        again where it broke off: etherpen draw FILE --resume";
            return Err(ProgramError::new(code::FAILED, text));
        }
        order => order,
    })
}

fn wait(machine: &Machine, order: Order, interrupted: &AtomicBool) -> Answer {
    let answer = machine.order(order);
    let mut cancelled = false;
    loop {
        match answer.recv_timeout(LOOK) {
            Ok(answer) => return answer,
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                return Err(Failure {
                    code: code::FAILED,
                    text: "the machine's thread has ended".into(),
                });
            }
        }
        if interrupted.load(Ordering::Relaxed) && !cancelled {
            cancelled = true;
            // Its effect is the other order's end.
            drop(machine.order(Order::Cancel));
        }
    }
}
