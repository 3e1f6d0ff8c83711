//! `etherpen doctor`: checks everything that the other commands need, and shows what to try where something is wrong.

use super::ports::OptionalPort;
use super::{ConfigArguments, print_json};
use crate::doctor::{Check, CheckVerdict, check_all};
use crate::error::{ProgramError, code};
use crate::terminal::{counted, in_colour};

/// Options of `etherpen doctor`.
///
/// A warning means that something is missing that only some commands need; a failure means that something present or
/// requested does not work. With --port, the firmware is greeted: a program connected to it loses its connection, and
/// its drawing is held. Exit codes: 0 nothing failed; 1 something failed; 2 wrong usage.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    port: OptionalPort,
    /// Print the checks as a JSON array on stdout.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    config: ConfigArguments,
}

/// Runs the command.
///
/// # Errors
/// A port's name is invalid, or a check failed.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let port = arguments.port.unless(None)?;
    let checks = check_all(arguments.config.path().as_deref(), port.as_ref());
    if arguments.json {
        print_json(&checks)?;
    } else {
        checks.iter().for_each(print);
    }
    match checks
        .iter()
        .filter(|check| check.verdict == CheckVerdict::Failed)
        .count()
    {
        0 => Ok(()),
        failed => Err(ProgramError::new(
            code::FAILED,
            format!("{failed} of {} failed", counted(checks.len(), "check")),
        )),
    }
}

fn print(check: &Check) {
    let verdict = match check.verdict {
        CheckVerdict::Ok => in_colour("ok     ", "32"),
        CheckVerdict::Warning => in_colour("warning", "33"),
        CheckVerdict::Failed => in_colour("failed ", "31"),
    };
    println!("{verdict}  {:13}  {}", check.check, check.found);
    for line in check.remedy.lines() {
        println!("                        {line}");
    }
}
