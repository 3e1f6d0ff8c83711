//! `etherpen io`: named inputs and outputs of terminals.

use super::Arguments;
use crate::commands::print_json;
use crate::error::{ProgramError, code};
use crate::machine::Order;
use crate::machine::access::{self, MachineAccess};
use etherpen::config::{Config, IoDirection, IoPoint, IoType};
use etherpen::messages::{Command as Told, Status};
use serde::Serialize;

/// Named inputs and outputs.
#[derive(clap::Args, Debug)]
#[command(args_conflicts_with_subcommands = true)]
pub struct IoArguments {
    #[command(subcommand)]
    what: Option<What>,
    #[command(flatten)]
    arguments: Arguments,
}

#[derive(clap::Subcommand, Debug)]
enum What {
    /// Show one input or output.
    Get {
        /// Its name in the configuration.
        name: String,
        #[command(flatten)]
        arguments: Arguments,
    },
    /// Set an output; it keeps the value until it is set again, and falls to 0 at a fault unless on_fault is "hold".
    Set {
        /// Its name in the configuration.
        name: String,
        /// Decimal, hexadecimal (0x), on or off.
        #[arg(allow_hyphen_values = true, value_parser = value)]
        value: i64,
        #[command(flatten)]
        arguments: Arguments,
    },
}

fn value(text: &str) -> Result<i64, String> {
    let number = match (text, text.strip_prefix("0x")) {
        ("on" | "true", _) => Some(1),
        ("off" | "false", _) => Some(0),
        (_, Some(digits)) => i64::from_str_radix(digits, 16).ok(),
        (_, None) => text.parse().ok(),
    };
    number.ok_or_else(|| "a whole number, on or off is needed".into())
}

/// A point as printed.
#[derive(Debug, Serialize)]
pub(super) struct Shown {
    name: String,
    direction: IoDirection,
    /// Place of the terminal in the chain, from 0.
    slave: u8,
    /// First bit, if the configuration names the point so.
    bit: Option<u16>,
    /// Object, if the configuration names the point so.
    object: Option<String>,
    #[serde(rename = "type")]
    kind: IoType,
    role: &'static str,
    /// Absent while the terminal does not exchange the point.
    value: Option<i64>,
}

impl Shown {
    /// The points of a configuration; none if the firmware has another one.
    pub(super) fn all(config: &Config, status: &Status) -> Vec<Self> {
        if status.config != config.hash() {
            return Vec::new();
        }
        let points = config.io.iter().enumerate();
        points.map(|(io, point)| Self::new(point, io, status)).collect()
    }

    fn new(point: &IoPoint, io: usize, status: &Status) -> Self {
        let state = status.io.get(io).filter(|state| state.valid);
        Self {
            name: point.name.to_string(),
            direction: point.direction,
            slave: point.slave,
            bit: point.bit,
            object: point.object.map(|object| object.to_string()),
            kind: point.kind,
            role: point.role.name(),
            value: state.map(|state| point.kind.value(state.raw)),
        }
    }

    pub(super) fn print(&self) {
        let value = self.value.map_or("missing".into(), |value| value.to_string());
        let direction = match self.direction {
            IoDirection::In => "in",
            IoDirection::Out => "out",
        };
        let role = if self.role == "none" { "" } else { self.role };
        println!(
            "{:16} {direction:3} {value:>11}  slave {:2}  {role}",
            self.name, self.slave
        );
    }
}

/// Runs the command.
///
/// # Errors
/// There is no machine, it has another configuration, the name is unknown, or the order was refused.
pub(super) fn run(arguments: &IoArguments) -> Result<(), ProgramError> {
    match &arguments.what {
        None => list(&arguments.arguments),
        Some(What::Get { name, arguments }) => get(arguments, name),
        Some(What::Set { name, value, arguments }) => set(arguments, name, *value),
    }
}

fn list(arguments: &Arguments) -> Result<(), ProgramError> {
    let config = arguments.config.load()?;
    let status = state(arguments, &config)?;
    let points = Shown::all(&config, &status);
    if arguments.json {
        return print_json(&points);
    }
    points.iter().for_each(Shown::print);
    if points.is_empty() {
        eprintln!("the configuration names no inputs and outputs; see [[io]] in samples/etherpen.toml");
    }
    Ok(())
}

fn get(arguments: &Arguments, name: &str) -> Result<(), ProgramError> {
    let config = arguments.config.load()?;
    let (io, point) = named(&config, name)?;
    let status = state(arguments, &config)?;
    print(arguments, &Shown::new(point, io, &status))
}

fn set(arguments: &Arguments, name: &str, value: i64) -> Result<(), ProgramError> {
    let config = arguments.config.load()?;
    let (io, point) = named(&config, name)?;
    if point.direction == IoDirection::In {
        return Err(ProgramError::new(
            code::USAGE,
            format!("{name} is an input; only outputs can be set"),
        ));
    }
    let raw = point.kind.raw(value).ok_or_else(|| {
        let (least, greatest) = point.kind.range();
        ProgramError::new(
            code::USAGE,
            format!("{name} is set to {value}, allowed is {least} to {greatest}"),
        )
    })?;
    state(arguments, &config)?;
    let order = Order::Tell(Told::SetOutput {
        io: io as u8,
        value: raw,
    });
    let port = arguments.port.find()?;
    let effect = arguments.with_own_port(|own| access::carry_out(&port, own, order))?;
    let status = effect.snapshot.status.as_ref().ok_or_else(no_state)?;
    print(arguments, &Shown::new(point, io, status))?;
    match effect.reached {
        true => Ok(()),
        false => Err(ProgramError::new(
            code::FAILED,
            format!("{name} was accepted, but does not show {value}"),
        )),
    }
}

fn print(arguments: &Arguments, point: &Shown) -> Result<(), ProgramError> {
    if arguments.json {
        return print_json(point);
    }
    point.print();
    Ok(())
}

fn named<'a>(config: &'a Config, name: &str) -> Result<(usize, &'a IoPoint), ProgramError> {
    let found = config.io.iter().enumerate().find(|(_, point)| point.name == name);
    found.ok_or_else(|| {
        let names: Vec<&str> = config.io.iter().map(|point| point.name.as_str()).collect();
        let known = match names.is_empty() {
            true => "the configuration names none".to_owned(),
            false => format!("there are {}", names.join(", ")),
        };
        ProgramError::new(code::USAGE, format!("no input or output is named {name}; {known}"))
    })
}

/// The machine's state, if it runs with this configuration: the firmware numbers the points as the configuration does.
fn state(arguments: &Arguments, config: &Config) -> Result<Status, ProgramError> {
    let port = arguments.port.find()?;
    let mut access = arguments.with_own_port(|own| MachineAccess::find(&port, own))?;
    let status = access.state()?.status.ok_or_else(no_state)?;
    match status.config {
        Some(hash) if Some(hash) == config.hash() => Ok(status),
        Some(_) => Err(ProgramError::new(
            code::FAILED,
            "the firmware runs with another configuration; name its file with --config",
        )),
        None => Err(ProgramError::new(
            code::FAILED,
            "the firmware has no configuration yet; etherpen enable passes it on",
        )),
    }
}

fn no_state() -> ProgramError {
    ProgramError::new(code::CONNECTION, "the machine has not reported its state")
}
