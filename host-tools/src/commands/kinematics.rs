//! `etherpen kinematics`: positions to joint angles and back, for the robot or for another geometry.

use super::print_json;
use crate::axes::{Motion, Quantity};
use crate::error::{ProgramError, code};
use crate::kinematics::Robot;
use crate::settings::load;
use crate::settings::machines::MachineChoice;
use etherpen::robots::{Geometry, Measured};
use std::io::Write;
use std::path::PathBuf;

/// Options of `etherpen kinematics`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    direction: Direction,
}

#[derive(clap::Subcommand, Debug)]
enum Direction {
    /// Joint angles for a position of the tool.
    Inverse {
        /// Position of the tool in the robot's frame, mm. z points up; the IRB 340's base is at z = 0, above its tool.
        #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = three_numbers)]
        position: Three,
        #[command(flatten)]
        options: Options,
    },
    /// Position of the tool for joint angles.
    Forward {
        /// Angles of the main axes, rad; linear axes: mm. A positive angle of the IRB 340 moves the tool down.
        #[arg(long, value_name = "Q1,Q2,Q3", allow_hyphen_values = true, value_parser = three_numbers)]
        joints: Three,
        #[command(flatten)]
        options: Options,
    },
}

/// Options of both directions.
#[derive(clap::Args, Debug)]
struct Options {
    #[arg(long, value_name = "FILE", help = geometry_help())]
    geometry: Option<PathBuf>,
    /// A bundled machine by its name, or the machine of a configuration file; its ranges are not checked.
    #[arg(long, value_name = "NAME|FILE", conflicts_with = "geometry")]
    machine: Option<MachineChoice>,
    /// Print the answer as JSON on stdout.
    #[arg(long)]
    json: bool,
}

fn geometry_help() -> String {
    format!(
        "TOML file with the dimensions of an IRB 340 or a robot like it: {}. Without it, and without --machine, the IRB \
         340, its range not checked",
        Measured::KEYS
    )
}

/// Three numbers with commas between them.
#[derive(Clone, Copy, Debug)]
struct Three([f64; 3]);

fn three_numbers(text: &str) -> Result<Three, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse::<f64>()).collect();
    match numbers.ok().and_then(|numbers| numbers.try_into().ok()) {
        Some(numbers) => Ok(Three(numbers)),
        None => Err("three numbers with commas between them are needed, like -10,0,-800".into()),
    }
}

/// Runs the command.
///
/// # Errors
/// The geometry's file cannot be used, or there is no solution: which joint and why.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let (Direction::Inverse { options, .. } | Direction::Forward { options, .. }) = &arguments.direction;
    let robot = robot(options)?;
    let answer = match &arguments.direction {
        Direction::Inverse { position, .. } => robot.inverse(position.0)?,
        Direction::Forward { joints, .. } => robot.forward_in_units(joints.0)?,
    };
    if options.json {
        return print_json(&answer);
    }
    let [x, y, z] = answer.position_mm;
    let mut shown = format!("position  {x} {y} {z} mm\n");
    for (axis, value) in answer.joints.iter() {
        let degrees = match axis.motion {
            Motion::Rotary => format!(" ({:.4} deg)", value.to_degrees()),
            Motion::Linear => String::new(),
        };
        let unit = axis.motion.unit(Quantity::Position);
        shown.push_str(&format!("{:<9} {value} {unit}{degrees}\n", axis.name));
    }
    std::io::stdout()
        .write_all(shown.as_bytes())
        .or_else(ProgramError::of_stdout)
}

fn robot(options: &Options) -> Result<Robot, ProgramError> {
    if let Some(machine) = &options.machine {
        let config = match machine {
            MachineChoice::Bundled(machine) => machine.load()?,
            MachineChoice::File(path) => load(Some(path))?,
        };
        return Robot::new(config.geometry).map_err(|cause| ProgramError::new(code::USAGE, cause));
    }
    match &options.geometry {
        None => Robot::new(Geometry::default()),
        Some(path) => std::fs::read_to_string(path)
            .map_err(|cause| format!("it cannot be read: {cause}"))
            .and_then(|text| Robot::parse(&text)),
    }
    .map_err(|cause| match &options.geometry {
        Some(path) => ProgramError::new(code::INPUT, format!("the geometry {}: {cause}", path.display())),
        None => ProgramError::new(code::FAILED, cause),
    })
}
