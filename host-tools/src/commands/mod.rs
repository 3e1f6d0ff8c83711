//! The commands of the program: options, order of work, messages and exit codes.
//!
//! A command prints data on stdout, progress and messages on stderr, and ends with one of the documented exit codes.

pub mod bench;
mod broken;
mod budget;
pub mod bus;
pub mod configuration;
pub mod confined;
pub mod console;
pub mod demo;
mod display;
pub mod doctor;
pub mod draw;
pub mod emulate;
pub mod endpoint;
pub mod flash;
pub mod identify;
pub mod kinematics;
mod latency;
pub mod operate;
mod operator;
pub mod order;
mod outline;
mod outputs;
pub mod plan;
pub mod ports;
pub mod prepare;
pub mod preview;
pub(crate) mod quickest;
pub mod record;
pub mod recorded;
pub mod reference;
pub mod run;
pub mod segment;
pub mod shell;
pub mod simulate;
pub mod source;
pub mod vectorize;
pub mod verify;

use crate::link::error::JobError;
use crate::setup::SetupError;
use etherpen::config::Config;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Why a command ended without success.
#[derive(Debug)]
pub struct CommandError {
    /// Exit code, as `etherpen --help` lists them.
    pub code: u8,
    /// What happened and what to try.
    pub message: String,
}

/// Exit codes.
pub mod code {
    /// The work failed.
    pub const FAILED: u8 = 1;
    /// Wrong usage, a configuration that cannot be used.
    pub const USAGE: u8 = 2;
    /// The input file cannot be used.
    pub const INPUT: u8 = 3;
    /// A tool is missing.
    pub const TOOL: u8 = 4;
    /// No connection to the machine or the emulator.
    pub const CONNECTION: u8 = 5;
    /// The firmware speaks another protocol version.
    pub const VERSION: u8 = 6;
    /// The machine stopped with a fault.
    pub const FAULT: u8 = 7;
    /// The path ended, and a part of the drawing is missing.
    pub const INCOMPLETE: u8 = 8;
    /// Interrupted by the user.
    pub const INTERRUPTED: u8 = 130;
}

impl CommandError {
    /// An error with its exit code.
    pub fn new(code: u8, message: impl std::fmt::Display) -> Self {
        Self {
            code,
            message: message.to_string(),
        }
    }

    /// The work failed while doing `what`.
    pub fn failed(what: impl std::fmt::Display, cause: impl std::fmt::Display) -> Self {
        Self::new(code::FAILED, format!("{what}: {cause}"))
    }
}

impl From<SetupError> for CommandError {
    fn from(error: SetupError) -> Self {
        Self::new(code::TOOL, error)
    }
}

/// Options of every command that uses a configuration.
#[derive(clap::Args, Debug, Default)]
pub struct ConfigArguments {
    /// Configuration file; without it `etherpen.toml` in this folder, or the built-in IRB 340.
    #[arg(long, value_name = "FILE", env = "ETHERPEN_CONFIG")]
    pub config: Option<PathBuf>,
}

/// Options of every command that draws.
#[derive(clap::Args, Debug, Default)]
pub struct DrawingArguments {
    /// Folder for the results.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the report as JSON on stdout.
    #[arg(long)]
    pub json: bool,
    /// The configuration.
    #[command(flatten)]
    pub config: ConfigArguments,
    /// How the file becomes strokes.
    #[command(flatten)]
    pub source: source::SourceArguments,
}

impl ConfigArguments {
    /// The file that is used, and how it was named; none for the built-in configuration.
    #[must_use]
    pub fn file(&self) -> Option<(PathBuf, &'static str)> {
        configuration::named(self.config.as_ref())
    }

    /// Reads and checks the configuration.
    ///
    /// # Errors
    /// The file and the place in it that cannot be used.
    pub fn load(&self) -> Result<Config, CommandError> {
        let Some((path, _)) = self.file() else {
            return Ok(Config::default());
        };
        let shown = path.display();
        let text = std::fs::read_to_string(&path).map_err(|cause| {
            CommandError::new(
                code::USAGE,
                format!("the configuration {shown} cannot be read: {cause}"),
            )
        })?;
        let config: Config = toml::from_str(&text)
            .map_err(|cause| CommandError::new(code::USAGE, format!("the configuration {shown} is wrong:\n{cause}")))?;
        config.check().map_err(|cause| {
            CommandError::new(
                code::USAGE,
                format!(
                    "the configuration {shown} is wrong: {}",
                    crate::link::text::config_error(&cause)
                ),
            )
        })?;
        Ok(config)
    }
}

/// `text` in an ANSI colour when stderr is a terminal and `NO_COLOR` is not set.
pub fn in_colour(text: &str, colour: &str) -> String {
    if std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none() {
        format!("\x1b[{colour}m{text}\x1b[0m")
    } else {
        text.to_owned()
    }
}

/// A number of things: `1 stroke`, `2 strokes`.
pub(crate) fn counted(count: impl TryInto<u64>, thing: &str) -> String {
    let count = count.try_into().unwrap_or(u64::MAX);
    format!("{count} {thing}{}", if count == 1 { "" } else { "s" })
}

/// A job's error with its exit code.
pub fn job_error(error: &JobError) -> CommandError {
    let code = match error {
        JobError::Version { .. } => code::VERSION,
        JobError::NoAnswer { .. } | JobError::LinkLost { .. } | JobError::Restarted | JobError::Forgotten => {
            code::CONNECTION
        }
        JobError::Fault { .. } => code::FAULT,
        JobError::Vertex(_) => code::INPUT,
        JobError::Config(_) | JobError::ConfigHash { .. } => code::USAGE,
        JobError::NotFollowed { .. } => code::INCOMPLETE,
        JobError::Cancelled => code::INTERRUPTED,
        _ => code::FAILED,
    };
    CommandError::new(code, error)
}

/// A number that no other connection to the firmware has had: process numbers alone come again.
pub(crate) fn session_number() -> u32 {
    let since = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .unwrap_or_default();
    (since.as_nanos() as u32 ^ std::process::id().rotate_left(16)).max(1)
}

/// A flag that a signal sets, so that the end is reported and files are completed.
fn ended_by_a_signal() -> Result<Arc<AtomicBool>, CommandError> {
    let ended = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, ended.clone())
            .map_err(|cause| CommandError::failed("watching for signals", cause))?;
    }
    Ok(ended)
}

/// Prints a value as JSON on stdout.
///
/// # Errors
/// stdout is closed.
pub fn print_json(value: &impl serde::Serialize) -> Result<(), CommandError> {
    use std::io::Write;
    let text = serde_json::to_string_pretty(value).map_err(|cause| CommandError::failed("the report", cause))?;
    writeln!(std::io::stdout(), "{text}").map_err(|cause| CommandError::failed("stdout", cause))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sample_configuration_lists_the_defaults() {
        let path = crate::setup::workspace().join("samples/etherpen.toml");
        let config = ConfigArguments { config: Some(path) }.load().unwrap();
        assert_eq!(config, Config::default());
    }
}
