//! `etherpen identify`: measures delay and gain of the drives with a small test motion, and stores the resulting
//! values.
//!
//! The motion runs twice: with the present values, and with the values found, so that the stored values have been
//! tested.

mod axes;

use super::display::Display;
use super::operator::Operator;
use super::ports::OptionalPort;
use super::{CellArguments, ConfigArguments};
use crate::cell::{CellOptions, Physics};
use crate::error::{ProgramError, code};
use crate::identification::test_path;
use crate::job::over_port::{OverPortError, run_job};
use crate::job::{Job, JobOptions, JobReport};
use crate::link::port::{Port, PortName};
use crate::link::session::session_number;
use crate::report::identified::{Identified, identify};
use crate::run::{self, RunTask};
use crate::settings::check_target;
use crate::terminal::counted;
use etherpen::config::Config;
use etherpen::messages::PathVertex;
use etherpen::robots::AXES;
use std::path::PathBuf;

/// Options of `etherpen identify`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Try it on the virtual cell, in virtual time.
    #[arg(long)]
    simulate: bool,
    #[command(flatten)]
    port: OptionalPort,
    /// Instead of measuring, move one axis after the other and ask what moved: finds drives that are exchanged or turn the other way.
    #[arg(long, conflicts_with_all = ["output", "store"])]
    axes: bool,
    /// Change only this axis, from 1, or with --axes move only it; the main axes still share their lead and feedback gain.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=AXES as i64))]
    axis: Option<u8>,
    /// Store the values in this file; the rest of it is unchanged.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Store the values in the configuration file in use, or in `etherpen.toml` if there is none.
    #[arg(long, conflicts_with = "output")]
    store: bool,
    /// Print the result as JSON on stdout.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    cell: CellArguments,
    #[command(flatten)]
    config: ConfigArguments,
}

/// Runs the command.
///
/// # Errors
/// Errors of the configuration, the machine or the file, or a requested axis without an estimate.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let config = arguments.config.load()?;
    let physics = arguments.cell.load_if(arguments.simulate)?;
    let port = arguments.port.unless(arguments.simulate.then_some("--simulate"))?;
    if port.is_none() && !arguments.simulate {
        let text =
            "which machine? Name its port (--port /dev/ttyACM0, tcp:host:port or unix:path), or try it with --simulate";
        return Err(ProgramError::new(code::USAGE, text));
    }
    let only = arguments.axis.map(|axis| usize::from(axis) - 1);
    if let Some(axis) = arguments.axis.filter(|axis| *axis > config.bus.drives) {
        let text = format!(
            "there is no axis {axis}: the machine has {}",
            counted(config.bus.drives, "drive")
        );
        return Err(ProgramError::new(code::USAGE, text));
    }
    if arguments.axes {
        return axes::run(arguments, &config, port.as_ref(), physics);
    }
    let target = target(arguments, &config)?;
    let mut operator = port.as_ref().map(|_| Operator::start());
    let mut result = identify(&config, only, |config| {
        drive(port.as_ref(), config, test_path(config), physics, operator.as_mut())
    })?;
    print(&result);
    if let Some(path) = target {
        let changed = result.store(&path)?;
        eprintln!("{} changed in {}.", counted(changed, "value"), path.display());
    }
    if arguments.json {
        super::print_json(&result)?;
    }
    Ok(())
}

/// The file for the values, if they are to be stored.
fn target(arguments: &Arguments, config: &Config) -> Result<Option<PathBuf>, ProgramError> {
    match &arguments.output {
        Some(path) => {
            check_target(path, config.geometry.kind())?;
            Ok(Some(path.clone()))
        }
        None if arguments.store => arguments.config.file_to_store(config).map(Some),
        None => Ok(None),
    }
}

/// Drives a motion once, on the machine at a port or in a virtual cell.
fn drive(
    port: Option<&PortName>,
    config: &Config,
    path: Vec<PathVertex>,
    physics: Physics,
    operator: Option<&mut Operator>,
) -> Result<JobReport, ProgramError> {
    let mut display = Display::new();
    let (Some(port), Some(operator)) = (port, operator) else {
        let task = RunTask {
            config: config.clone(),
            path,
            cell: CellOptions {
                physics,
                ..CellOptions::default()
            },
        };
        let drawn =
            run::simulate(&task, None, &mut |job| display.update(job)).map_err(|error| ProgramError::from(&error))?;
        display.finish();
        return match drawn.outcome {
            Some(Ok(())) => Ok(drawn.job),
            Some(Err(error)) => Err(ProgramError::from(&error)),
            None => Err(ProgramError::new(code::FAILED, "the run ended before the motion did")),
        };
    };
    let port = Port::open(port).map_err(|cause| ProgramError::new(code::CONNECTION, cause))?;
    let options = JobOptions {
        session: session_number(),
        ..JobOptions::default()
    };
    let mut job = Job::draw(config.clone(), path, options);
    let result = run_job(port, &mut job, &mut || operator.next_control(), &mut |show| {
        display.show(&show);
    });
    display.finish();
    result.map_err(|error| match error {
        OverPortError::Job(error) => ProgramError::from(&*error),
        OverPortError::Port(error) => ProgramError::new(code::CONNECTION, error),
    })?;
    Ok(job.into_report())
}

fn print(result: &Identified) {
    eprintln!();
    for axis in &result.axes {
        let (lead, gain, feedback) = (
            &axis.feed_forward_lead_ms,
            &axis.feed_forward_gain,
            &axis.feedback_gain_per_s,
        );
        match &axis.not_measured {
            Some(cause) => eprintln!("axis {}: {cause}.", axis.axis),
            None => eprintln!(
                "axis {}: lead {:.3} -> {:.3} ms (+-{:.3}), Kff {:.4} -> {:.4} (+-{:.4}), Kfb {:.1} -> {:.1} /s",
                axis.axis,
                lead.before,
                lead.after,
                lead.uncertainty.unwrap_or(0.0),
                gain.before,
                gain.after,
                gain.uncertainty.unwrap_or(0.0),
                feedback.before,
                feedback.after
            ),
        }
        if let Some(lead) = &axis.position_lead_ms {
            eprintln!(
                "axis {}: lead of the targets {:.3} -> {:.3} ms (+-{:.3})",
                axis.axis,
                lead.before,
                lead.after,
                lead.uncertainty.unwrap_or(0.0)
            );
        }
    }
    let (before, after) = (&result.tracking_before, &result.tracking_after);
    eprintln!(
        "The pen followed the test motion within {:.3} mm ({:.3} mm rms) before, {:.3} mm ({:.3} mm rms) after.",
        before.max_mm, before.rms_mm, after.max_mm, after.rms_mm
    );
}
