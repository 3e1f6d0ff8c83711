//! `etherpen identify --axes`: moves one axis after the other while a person watches, and says what is exchanged or reversed.

use super::{Arguments, drive};
use crate::axes::{AxisView, Quantity, axes};
use crate::cell::Physics;
use crate::commands::operator::Operator;
use crate::error::{ProgramError, code};
use crate::identification::one_axis::{OTHERS_RAD, OneAxis};
use crate::identification::seen::{Seen, advice};
use crate::link::port::PortName;
use etherpen::config::Config;
use etherpen::robots::MAIN_AXES;
use serde::Serialize;

/// Largest difference between what was measured and what was meant, as a share of it.
const MEASURED_SHARE: f64 = 0.2;

/// An answer to the question about an axis, from 1, of several; `None` if it is none.
fn parse(answer: &str, axis: u8, axes: u8) -> Option<Seen> {
    match answer.trim().to_lowercase().as_str() {
        "" | "y" | "yes" => Some(Seen::AsTold),
        "r" | "reversed" => Some(Seen::Reversed),
        "n" | "no" => Some(Seen::Unclear),
        number => match number.parse() {
            Ok(seen) if seen == axis => Some(Seen::AsTold),
            Ok(seen) if (1..=axes).contains(&seen) => Some(Seen::Other(seen)),
            _ => None,
        },
    }
}

/// One axis in the result.
#[derive(Debug, Serialize)]
struct Watched {
    /// The axis, from 1.
    axis: u8,
    name: String,
    /// How far it went first, in `unit`.
    by: f64,
    unit: &'static str,
    /// Where the tool went with it, mm.
    tool_mm: [f64; 3],
    /// How far its own encoder moved from one end to the other, in `unit`.
    measured: f64,
    /// The axis that a person saw move, from 1; null if none could be told.
    moved: Option<u8>,
    /// Whether it went the other way first.
    reversed: bool,
    #[serde(skip)]
    seen: Seen,
    /// Its unit for a radian of its joint.
    #[serde(skip)]
    per_rad: f64,
}

impl Watched {
    /// Whether the axis's own encoder saw the motion.
    fn has_moved(&self) -> bool {
        // The way begins near the first vertex, not at it.
        let near = OTHERS_RAD * self.per_rad;
        (self.measured - self.by.abs()).abs() < MEASURED_SHARE * self.by.abs() + near
    }

    /// What to do where a person saw it move as told, and its encoder did not.
    fn unmeasured(&self) -> Option<String> {
        (self.seen == Seen::AsTold && !self.has_moved()).then(|| {
            format!(
                "axis {} was measured to move by {:.3} {unit} instead of {:.3}: look at its encoder and its gear",
                self.axis,
                self.measured,
                self.by.abs(),
                unit = self.unit
            )
        })
    }
}

/// The result.
#[derive(Debug, Serialize)]
struct Answer {
    axes: Vec<Watched>,
    /// Whether each axis moved as it was told.
    confirmed: bool,
    /// What to do about those that did not.
    advice: Vec<String>,
}

/// Moves the axes, asks about each, and tells what follows.
///
/// # Errors
/// Errors of the machine; the person gave no answer; an axis did not move as it was told.
pub(super) fn run(
    arguments: &Arguments,
    config: &Config,
    port: Option<&PortName>,
    physics: Physics,
) -> Result<(), ProgramError> {
    let views = axes(config);
    let tools = views.len().min(MAIN_AXES);
    let wanted = |view: &&AxisView| arguments.axis.is_none_or(|only| usize::from(only) == view.index + 1);
    let mut motions = Vec::new();
    for view in views.iter().take(tools).filter(wanted) {
        let motion = OneAxis::new(config, view.index).map_err(|cause| ProgramError::new(code::INPUT, cause))?;
        motions.push((view, motion));
    }
    if motions.is_empty() {
        let text = "this axis does not move the tool; --axes moves those that do";
        return Err(ProgramError::new(code::USAGE, text));
    }
    let mut operator = Operator::start();
    eprintln!(
        "take the pen out, stand back, a hand on the emergency stop: all axes first bring the tool slowly above the sheet's centre, and \
         nobody knows yet whether they are right. Enter begins"
    );
    operator.answer().ok_or_else(unanswered)?;
    let mut watched = Vec::new();
    for (view, motion) in &motions {
        watched.push(watch(
            config,
            (view, motion),
            views.len() as u8,
            (port, physics),
            &mut operator,
        )?);
    }
    let seen: Vec<(u8, Seen)> = watched.iter().map(|axis| (axis.axis, axis.seen)).collect();
    let unmeasured = watched.iter().filter_map(Watched::unmeasured);
    let advice = unmeasured.chain(advice(&seen)).collect();
    let answer = Answer {
        confirmed: watched.iter().all(|axis| axis.seen == Seen::AsTold && axis.has_moved()),
        advice,
        axes: watched,
    };
    for line in &answer.advice {
        eprintln!("{line}");
    }
    if arguments.json {
        crate::commands::print_json(&answer)?;
    }
    match answer.confirmed {
        true => {
            let names: Vec<String> = answer.axes.iter().map(|axis| axis.axis.to_string()).collect();
            let rest = match (arguments.axis, views.len() > tools) {
                (None, true) => format!("; axis {} turns the tool in its place and was not tried", tools + 1),
                _ => String::new(),
            };
            eprintln!("moved as the configuration says: {}{rest}", names.join(", "));
            Ok(())
        }
        false => Err(ProgramError::new(
            code::FAILED,
            "not every axis moves as the configuration says; do not draw before that is mended",
        )),
    }
}

fn unanswered() -> ProgramError {
    ProgramError::new(code::INTERRUPTED, "ended without an answer")
}

/// Moves one axis and asks what was seen.
fn watch(
    config: &Config,
    (view, motion): (&AxisView, &OneAxis),
    axes: u8,
    (port, physics): (Option<&PortName>, Physics),
    operator: &mut Operator,
) -> Result<Watched, ProgramError> {
    let axis = view.index as u8 + 1;
    let unit = view.motion.unit(Quantity::Position);
    let way = ["x", "y", "z"]
        .iter()
        .zip(motion.tool_mm)
        .filter(|(_, mm)| mm.abs() >= 0.1);
    let way: Vec<String> = way.map(|(name, mm)| format!("{name} {mm:+.1} mm")).collect();
    eprintln!(
        "axis {axis} ({}) alone moves by {:+.3} {unit} and back, twice; the tool first goes {}",
        view.name,
        motion.by,
        way.join(", ")
    );
    operator.held = false;
    let job = drive(
        port,
        &motion.slow_config(config),
        motion.path.clone(),
        physics,
        Some(operator),
    )?;
    let travelled = motion.travelled_rad(&job.samples);
    let seen = loop {
        eprintln!(
            "did axis {axis} move, and first that way? Enter or y: yes; r: it, but the other way; 1 to {axes}: the axis that moved \
             instead; n: I cannot tell"
        );
        let said = operator.answer().ok_or_else(unanswered)?;
        match parse(&said, axis, axes) {
            Some(seen) => break seen,
            None => eprintln!("\"{}\" is none of the answers", said.trim()),
        }
    };
    Ok(Watched {
        axis,
        name: view.name.clone(),
        by: motion.by,
        unit,
        tool_mm: motion.tool_mm,
        measured: travelled.get(view.index).copied().unwrap_or_default() * view.motion.factor(),
        moved: match seen {
            Seen::AsTold | Seen::Reversed => Some(axis),
            Seen::Other(other) => Some(other),
            Seen::Unclear => None,
        },
        reversed: seen == Seen::Reversed,
        seen,
        per_rad: view.motion.factor(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_understood_and_others_asked_again() {
        for (said, seen) in [
            ("", Some(Seen::AsTold)),
            (" Y ", Some(Seen::AsTold)),
            ("2", Some(Seen::AsTold)),
            ("3", Some(Seen::Other(3))),
            ("r", Some(Seen::Reversed)),
            ("no", Some(Seen::Unclear)),
            ("4", None),
            ("0", None),
            ("-1", None),
            ("maybe", None),
        ] {
            assert_eq!(parse(said, 2, 3), seen, "{said}");
        }
    }
}
