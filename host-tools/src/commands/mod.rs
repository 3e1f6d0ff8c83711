//! The commands of the program: options, calls, printed results and exit codes.
//!
//! A command prints data on stdout, progress and messages on stderr, and ends with one of the documented exit codes.

pub mod bench;
pub mod blackbox;
pub mod bus;
pub mod calibrate;
pub mod campaign;
pub mod configuration;
pub mod console;
pub mod demo;
mod display;
pub mod doctor;
pub mod draw;
pub mod emulate;
pub mod endpoint;
pub mod flash;
pub mod home;
pub mod identify;
pub mod kinematics;
mod latency;
mod nightly;
pub mod operate;
mod operator;
pub mod order;
pub mod paper;
mod pen_change;
pub mod plan;
pub mod ports;
pub mod preview;
pub mod record;
pub mod recorded;
pub mod reference;
pub mod segment;
pub mod shell;
pub mod simulate;
pub mod vectorize;
pub mod verify;

use crate::axes;
use crate::cell::{CellChoice, Physics};
use crate::drawing::preparation::source::SourceArguments;
use crate::error::{ProgramError, code};
use crate::settings::machines::{MACHINES, MachineChoice};
use crate::settings::{check_target, load};
use etherpen::config::Config;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// What the option `--machine` takes: the names of [`MACHINES`], or a file.
const MACHINE_NAMES: &str = "irb340|gantry|corexy|scara|linear-delta|FILE";

/// Options of every command that uses a configuration.
#[derive(clap::Args, Debug, Default)]
pub struct ConfigArguments {
    /// Configuration file. Default: `etherpen.toml` in this folder, else the built-in IRB 340.
    #[arg(long, value_name = "FILE", env = "ETHERPEN_CONFIG")]
    pub config: Option<PathBuf>,
    /// Machine: one of the bundled ones, or a configuration file.
    #[arg(
        long,
        value_name = MACHINE_NAMES,
        conflicts_with = "config"
    )]
    pub machine: Option<MachineChoice>,
}

/// Option of every command that makes a virtual cell.
#[derive(clap::Args, Debug, Default)]
pub struct CellArguments {
    /// Virtual cell: nominal is an ideal robot, pessimistic one that is hard to control, FILE has values of your own
    /// (docs/cell.md lists them). Default: nominal.
    #[arg(long, value_name = "nominal|pessimistic|FILE")]
    cell: Option<CellChoice>,
}

impl CellArguments {
    /// The option's name, if it is given.
    #[must_use]
    pub fn given(&self) -> Option<&'static str> {
        self.cell.as_ref().map(|_| "--cell")
    }

    /// The file of the cell, if it has one.
    #[must_use]
    pub fn file(&self) -> Option<PathBuf> {
        self.cell.as_ref()?.file().map(Path::to_owned)
    }

    /// Reads and checks the cell's values for a command that has a cell only with --simulate.
    ///
    /// # Errors
    /// The option was given without --simulate, or the file or a value cannot be used.
    pub fn load_if(&self, simulate: bool) -> Result<Physics, ProgramError> {
        match self.given() {
            Some(name) if !simulate => Err(ProgramError::new(
                code::USAGE,
                format!("{name} is for the virtual cell: add --simulate"),
            )),
            _ => self.load(),
        }
    }

    /// Reads and checks the cell's values.
    ///
    /// # Errors
    /// The file and the value that cannot be used.
    pub fn load(&self) -> Result<Physics, ProgramError> {
        self.cell.as_ref().map_or(Ok(Physics::NOMINAL), CellChoice::load)
    }
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
    pub source: SourceArguments,
}

impl ConfigArguments {
    /// The configuration file in use, and how it was given; `None` for the built-in configuration.
    #[must_use]
    pub fn file(&self) -> Option<(PathBuf, &'static str)> {
        match &self.machine {
            Some(MachineChoice::Bundled(_)) => None,
            Some(MachineChoice::File(path)) => Some((path.clone(), "flag --machine")),
            None => configuration::named(self.config.as_ref()),
        }
    }

    /// The configuration file in use; `None` for the built-in configuration.
    #[must_use]
    pub fn path(&self) -> Option<PathBuf> {
        self.file().map(|(path, _)| path)
    }

    /// The configuration file in which values of this machine are stored: the one in use, or `etherpen.toml` in this folder.
    ///
    /// # Errors
    /// The machine is a bundled one, or the file describes another kind of machine.
    pub fn file_to_store(&self, config: &Config) -> Result<PathBuf, ProgramError> {
        let kind = config.geometry.kind();
        if let Some(MachineChoice::Bundled(machine)) = &self.machine {
            let text = format!(
                "--machine {} is bundled and cannot be changed: write a file of your own first (etherpen config new --kind \
                 {}), and use that one",
                machine.name,
                kind.name()
            );
            return Err(ProgramError::new(code::USAGE, text));
        }
        let path = self.path().unwrap_or_else(|| PathBuf::from("etherpen.toml"));
        check_target(&path, kind)?;
        Ok(path)
    }

    /// Reads and checks the configuration.
    ///
    /// # Errors
    /// The file and the place in it that cannot be used.
    pub fn load(&self) -> Result<Config, ProgramError> {
        let config = match &self.machine {
            Some(MachineChoice::Bundled(machine)) => machine.load(),
            Some(MachineChoice::File(path)) if !path.exists() => {
                let names = MACHINES.map(|machine| machine.name).join(", ");
                let text = format!(
                    "--machine {}: there is no such file, and no bundled machine of that name; those are {names}",
                    path.display()
                );
                return Err(ProgramError::new(code::USAGE, text));
            }
            _ => load(self.path().as_deref()),
        }?;
        axes::set_machine(config.geometry.kind());
        Ok(config)
    }
}

/// A flag that a signal sets, so that the program reports its end and completes its files.
fn ended_by_a_signal() -> Result<Arc<AtomicBool>, ProgramError> {
    let ended = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, ended.clone())
            .map_err(|cause| ProgramError::failed("watching for signals", cause))?;
    }
    Ok(ended)
}

/// Prints a value as JSON on stdout.
///
/// # Errors
/// stdout is closed.
pub fn print_json(value: &impl serde::Serialize) -> Result<(), ProgramError> {
    use std::io::Write;
    let text = serde_json::to_string_pretty(value).map_err(|cause| ProgramError::failed("the report", cause))?;
    writeln!(std::io::stdout(), "{text}").or_else(ProgramError::of_stdout)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(clap::Parser)]
    struct Simulation {
        #[command(flatten)]
        cell: CellArguments,
    }

    #[test]
    fn every_bundled_machine_is_named_in_the_help_and_in_the_documentation() {
        let names = MACHINES.map(|machine| machine.name).join("|");
        assert_eq!(MACHINE_NAMES, format!("{names}|FILE"));
        assert!(include_str!("../../../docs/cli.md").contains(MACHINE_NAMES));
        for kind in etherpen::robots::Kind::ALL {
            let quoted = format!("\"{}\"", kind.name());
            assert!(
                include_str!("../../../samples/etherpen.toml").contains(&quoted),
                "{quoted}"
            );
        }
    }

    fn parsed(words: &[&str]) -> CellArguments {
        Simulation::parse_from([&["simulate"], words].concat()).cell
    }

    #[test]
    fn the_cell_is_nominal_pessimistic_or_a_file() {
        assert_eq!(parsed(&[]).load().unwrap(), Physics::NOMINAL);
        assert_eq!(parsed(&["--cell", "nominal"]).load().unwrap(), Physics::NOMINAL);
        let pessimistic = parsed(&["--cell", "pessimistic"]);
        assert_eq!(pessimistic.load().unwrap(), Physics::PESSIMISTIC);
        assert_eq!((pessimistic.file(), pessimistic.given()), (None, Some("--cell")));
        let file = parsed(&["--cell", "no/such.toml"]);
        assert_eq!(file.file(), Some(PathBuf::from("no/such.toml")));
        let error = file.load().unwrap_err();
        assert_eq!(error.code, code::USAGE);
        assert!(error.message.contains("no/such.toml"), "{}", error.message);
    }

    #[test]
    fn a_cell_without_a_simulation_is_refused() {
        assert!(parsed(&[]).load_if(false).is_ok());
        assert!(parsed(&["--cell", "pessimistic"]).load_if(true).is_ok());
        let error = parsed(&["--cell", "pessimistic"]).load_if(false).unwrap_err();
        assert!(error.message.contains("--simulate"), "{}", error.message);
    }

    #[test]
    fn the_sample_configuration_lists_the_defaults() {
        let path = crate::setup::workspace().join("samples/etherpen.toml");
        let arguments = ConfigArguments {
            config: Some(path),
            machine: None,
        };
        let config = arguments.load().unwrap();
        assert_eq!(config, Config::default());
    }
}
