//! `etherpen reference`, `etherpen home`: finds the pose by the home switches, or takes the encoders' angles as the robot's, at the
//! marks or at a known pose, and stores them.

mod multi_turn;

use super::ports::SessionPort;
use super::{CellArguments, ConfigArguments, home, print_json};
use crate::axes::{AxisView, Motion, Quantity, axes};
use crate::cell::{Cell, CellOptions};
use crate::error::{ProgramError, code};
use crate::job::reference::{Pose, ReferenceJob, Referenced, Wanted};
use crate::link::port::{Line, Port};
use crate::link::session::session_number;
use crate::link::text;
use crate::machine::{Client, reference_through};
use crate::settings::store_reference;
use crate::simulation;
use crate::terminal::counted;
use etherpen::config::Config;
use etherpen::motion::Outside;
use etherpen::robots::{AXES, JointAngles, Kinematics, Position};
use serde::Serialize;
use std::io::Write;

/// Longest simulated time, ms.
const SIMULATED_MAX_MS: u32 = 300_000;

/// Options of `etherpen reference`.
///
/// A machine with home switches powers its drives and goes to its switches, homed or not; it moves. Without switches the
/// drives may have power or not, and the robot is not moved.
///
/// A resolver is absolute within one motor turn; at a gear of 1:12 a joint repeats every 30 degrees. Without --pose and
/// --position, the joints must be within half a motor turn (15 degrees) of their synchronisation marks. If another
/// program has the port, the reference is taken through it. A multi-turn encoder knows the turn by itself once it was calibrated;
/// --store also stores its drive's serial number, so that another drive is refused. An incremental encoder knows nothing: its joint
/// must be exactly at its mark, or exactly at --pose or --position.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Try it on the virtual cell, in virtual time.
    #[arg(long)]
    simulate: bool,
    #[command(flatten)]
    port: SessionPort,
    /// Joint positions of the present pose, one for each axis, in rad or mm as `status` shows them. The resolvers must agree
    /// with them; only --position finds an error of a complete motor turn.
    #[arg(long, value_name = "Q1,Q2,..", allow_hyphen_values = true, value_parser = listed)]
    pose: Option<Listed>,
    /// Present position of the tool, mm, within about 20. Alone, it gives the joint angles, with axis 4 on the motor
    /// turn nearest to 0; with --pose, it checks that pose.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = numbers::<3>)]
    position: Option<Numbers<3>>,
    /// The resolvers' offsets are unknown (another motor, drive or resolver): the pose sets them, and only --position
    /// checks it. Without --pose and --position, the joints must be exactly at their marks.
    #[arg(long)]
    calibrate: bool,
    /// Store this pose as the synchronisation marks in the configuration file in use, or in `etherpen.toml` if there is
    /// none; the rest of the file is unchanged. An axis with a home switch has no mark: its switch stays where it is.
    #[arg(long)]
    store: bool,
    /// First acknowledge a latched fault, which brings lost drives back.
    #[arg(long)]
    acknowledge: bool,
    /// Print the result as JSON on stdout.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    cell: CellArguments,
    #[command(flatten)]
    config: ConfigArguments,
}

/// Numbers with commas between them.
#[derive(Clone, Copy, Debug)]
struct Numbers<const N: usize>([f64; N]);

fn numbers<const N: usize>(text: &str) -> Result<Numbers<N>, String> {
    let numbers = listed(text).ok().and_then(|Listed(numbers)| numbers.try_into().ok());
    match numbers {
        Some(numbers) => Ok(Numbers(numbers)),
        None => Err(format!("{N} finite numbers with commas between them are needed")),
    }
}

/// A number for each axis.
#[derive(Clone, Debug)]
struct Listed(Vec<f64>);

fn listed(text: &str) -> Result<Listed, String> {
    let number = |number: &str| number.trim().parse::<f64>().ok().filter(|number| number.is_finite());
    let numbers: Option<Vec<f64>> = text.split(',').map(number).collect();
    numbers
        .map(Listed)
        .ok_or_else(|| "finite numbers with commas between them are needed".to_owned())
}

/// One axis' result.
#[derive(Clone, Copy, Debug, Serialize)]
struct AxisResult {
    axis: usize,
    /// Position of a rotary axis.
    #[serde(skip_serializing_if = "Option::is_none")]
    angle_rad: Option<f64>,
    /// Position of a linear axis.
    #[serde(skip_serializing_if = "Option::is_none")]
    position_mm: Option<f64>,
    /// What the encoder shows: within its motor turn, or all that a multi-turn or incremental one does.
    increments: i32,
}

impl AxisResult {
    fn new(axis: &AxisView, found: &Referenced) -> Self {
        let position = axis.of(&found.pose.0);
        Self {
            axis: axis.index + 1,
            angle_rad: (axis.motion == Motion::Rotary).then_some(position),
            position_mm: (axis.motion == Motion::Linear).then_some(position),
            increments: found.increments.get(axis.index).copied().unwrap_or_default(),
        }
    }

    fn text(&self) -> String {
        let place = match (self.angle_rad, self.position_mm) {
            (_, Some(mm)) => format!("{mm:+.3} mm"),
            (angle_rad, None) => {
                let angle_rad = angle_rad.unwrap_or_default();
                format!("{angle_rad:+.6} rad ({:+.3} deg)", angle_rad.to_degrees())
            }
        };
        format!(
            "axis {}    {place}, {:>7} increments at the encoder\n",
            self.axis, self.increments
        )
    }
}

/// What the command prints.
#[derive(Clone, Debug, Serialize)]
struct Answer {
    axes: Vec<AxisResult>,
    /// The platform by forward kinematics; absent where the links do not meet.
    position_mm: Option<[f64; 3]>,
    stored: Option<String>,
}

/// Runs the command.
///
/// # Errors
/// Errors of the configuration or the machine, a pose that disagrees with the resolvers or the measured position, or
/// errors of the file.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let config = arguments.config.load()?;
    let kinematics = Kinematics::new(&config.geometry).map_err(|cause| {
        let text = text::config_refusal(&cause.into());
        ProgramError::new(code::USAGE, text)
    })?;
    let wanted = wanted(arguments, &config, &kinematics)?;
    let store = arguments.store.then(|| arguments.config.file_to_store(&config));
    let store = store.transpose()?;
    let found = take(arguments, &config, wanted)?;
    let position = kinematics.forward(&found.pose).ok();
    let mut answer = Answer {
        axes: axes(&config).iter().map(|axis| AxisResult::new(axis, &found)).collect(),
        position_mm: position.map(Into::into),
        stored: None,
    };
    let switched = home::switched(&config);
    if store.is_some() && !switched.is_empty() {
        eprintln!(
            "{} homed by a switch; what the configuration says of its place there stays as it is.",
            match switched.as_slice() {
                [one] => format!("axis {one} is"),
                several => format!("axes {} are", several.join(", ")),
            }
        );
    }
    if let Some(path) = store.filter(|_| switched.len() < answer.axes.len()) {
        let mut marked = found.marked();
        multi_turn::name_drives(arguments, &mut marked)?;
        let changed = store_reference(&path, &marked, found.increments, found.pose.0)?;
        eprintln!(
            "{} changed in {}, read back and checked.",
            counted(changed, "value"),
            path.display()
        );
        answer.stored = Some(path.display().to_string());
    }
    match arguments.json {
        true => print_json(&answer),
        false => print(&answer, &kinematics),
    }
}

fn wanted(arguments: &Arguments, config: &Config, kinematics: &Kinematics) -> Result<Wanted, ProgramError> {
    if arguments.calibrate && home::switched(config).len() == usize::from(config.bus.drives) {
        let text = "--calibrate sets synchronisation marks, and every axis of this machine has a home switch instead";
        return Err(ProgramError::new(code::USAGE, text));
    }
    let position = arguments.position.map(|Numbers(position)| Position::from(position));
    let pose = match (&arguments.pose, &position) {
        (Some(Listed(pose)), _) => Pose::Joints(joints(config, pose)?),
        (None, Some(position)) => Pose::MainAxes(kinematics.inverse(position).map_err(|cause| {
            let why = text::outside(&Outside::Kinematics(cause));
            ProgramError::new(code::USAGE, format!("the platform cannot stand at --position: {why}"))
        })?),
        (None, None) => Pose::Marks,
    };
    Ok(Wanted {
        pose,
        position,
        calibrate: arguments.calibrate,
    })
}

/// The joint angles of positions in the units of the axes; an axis without a drive is at its mark.
fn joints(config: &Config, positions: &[f64]) -> Result<JointAngles, ProgramError> {
    let axes = axes(config);
    if positions.len() != axes.len() {
        let names = axes
            .iter()
            .map(|axis| format!("{} {}", axis.label, axis.motion.unit(Quantity::Position)));
        let names: Vec<String> = names.collect();
        let text = format!(
            "--pose takes {} numbers, one for each axis ({}), and there are {}",
            axes.len(),
            names.join(", "),
            positions.len()
        );
        return Err(ProgramError::new(code::USAGE, text));
    }
    let mut angles: [f64; AXES] = config.axes.each_ref().map(|axis| axis.sync_angle_rad);
    for (angle, (axis, position)) in angles.iter_mut().zip(axes.iter().zip(positions)) {
        *angle = position / axis.motion.factor();
    }
    Ok(JointAngles(angles))
}

fn take(arguments: &Arguments, config: &Config, wanted: Wanted) -> Result<Referenced, ProgramError> {
    let physics = arguments.cell.load_if(arguments.simulate)?;
    let at_marks = wanted.pose == Pose::Marks && wanted.position.is_none() && !wanted.calibrate;
    if at_marks && config.has_home_switches() {
        return match arguments.port.find_unless(arguments.simulate.then_some("--simulate"))? {
            Some(name) => home::at_port(config, &name),
            None => home::simulated(
                config,
                CellOptions {
                    physics,
                    ..CellOptions::default()
                },
            ),
        };
    }
    let mut job = ReferenceJob::new(config.clone(), wanted, session_number()).acknowledging(arguments.acknowledge);
    match arguments.port.find_unless(arguments.simulate.then_some("--simulate"))? {
        Some(name) => {
            if let Some(client) = Client::find(&name) {
                return reference_through(client, arguments.acknowledge, config, &wanted);
            }
            let lost = |cause| ProgramError::new(code::CONNECTION, cause);
            let mut line = Line::start(Port::open(&name).map_err(lost)?);
            while job.outcome().is_none() {
                line.exchange(|now_ms, incoming, outgoing, room| job.step(now_ms, incoming, outgoing, room))
                    .map_err(lost)?;
            }
        }
        None => {
            let options = CellOptions {
                physics,
                ..CellOptions::default()
            };
            let mut cell = Cell::new(config, options);
            simulation::run(&mut cell, &mut job, SIMULATED_MAX_MS);
        }
    }
    match job.outcome() {
        Some(Ok(found)) => Ok(found.clone()),
        Some(Err(error)) => Err(error.into()),
        None => Err(ProgramError::new(
            code::FAILED,
            "the run ended before the reference was taken",
        )),
    }
}

fn print(answer: &Answer, kinematics: &Kinematics) -> Result<(), ProgramError> {
    let mut shown: String = answer.axes.iter().map(AxisResult::text).collect();
    match answer.position_mm {
        Some([x, y, z]) => shown.push_str(&format!("platform  {x:.2} {y:.2} {z:.2} mm\n")),
        None => shown.push_str(&format!(
            "platform  with these positions the {} do not meet: a wrong motor turn?\n",
            kinematics.words().last_links
        )),
    }
    std::io::stdout()
        .write_all(shown.as_bytes())
        .or_else(ProgramError::of_stdout)
}
