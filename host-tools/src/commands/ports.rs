//! The machine's port: from `--port`, `ETHERPEN_PORT`, or a running program.

use crate::error::{ProgramError, code};
use crate::link::ownership::{self, InUse};
use crate::link::port::PortName;
use std::fmt::Write;

/// Environment variable with the port, used without the option.
const VARIABLE: &str = "ETHERPEN_PORT";

/// Options of a command that opens a port itself.
#[derive(clap::Args, Debug)]
pub struct PortArguments {
    /// Port of the machine: /dev/tty.., tcp:host:port or unix:path.
    #[arg(long, env = VARIABLE)]
    pub port: PortName,
}

/// Options of a command whose target another option can give instead.
#[derive(clap::Args, Debug, Default)]
pub struct OptionalPort {
    /// Port of the machine: /dev/tty.., tcp:host:port or unix:path.
    #[arg(long, value_name = "PORT", env = VARIABLE, global = true)]
    pub port: Option<PortName>,
}

/// Options of a command that works through a running program, too.
#[derive(clap::Args, Debug, Default)]
pub struct SessionPort {
    /// Port of the machine: /dev/tty.., tcp:host:port or unix:path. Default: the machine that a running program owns.
    #[arg(long, value_name = "PORT", env = VARIABLE)]
    pub port: Option<PortName>,
}

impl OptionalPort {
    /// The port, unless the option `other` selects another target; the environment's port is then ignored.
    ///
    /// # Errors
    /// Both were given as options.
    pub(super) fn unless(&self, other: Option<&str>) -> Result<Option<PortName>, ProgramError> {
        unless(self.port.as_ref(), other)
    }

    /// Whether the port is the one that the environment names.
    pub(super) fn is_from_environment(&self) -> bool {
        self.port.as_ref().is_some_and(is_from_environment)
    }
}

impl SessionPort {
    /// The given port, else that of the one running program that shares its machine.
    ///
    /// # Errors
    /// No program, or several, have a port; the message lists them.
    pub(super) fn find(&self) -> Result<PortName, ProgramError> {
        self.port.clone().map_or_else(of_running_program, Ok)
    }

    /// The port as by [`find`](Self::find), unless the option `other` selects another target.
    ///
    /// # Errors
    /// As [`find`](Self::find), or both were given as options.
    pub(super) fn find_unless(&self, other: Option<&str>) -> Result<Option<PortName>, ProgramError> {
        match (unless(self.port.as_ref(), other)?, other) {
            (None, None) => of_running_program().map(Some),
            (named, _) => Ok(named),
        }
    }
}

fn unless(port: Option<&PortName>, other: Option<&str>) -> Result<Option<PortName>, ProgramError> {
    let (Some(named), Some(other)) = (port, other) else {
        return Ok(port.cloned());
    };
    match is_from_environment(named) {
        true => Ok(None),
        false => Err(ProgramError::new(
            code::USAGE,
            format!("--port and {other} exclude each other; give one of them"),
        )),
    }
}

fn is_from_environment(port: &PortName) -> bool {
    let parsed = std::env::var(VARIABLE)
        .ok()
        .and_then(|value| value.parse::<PortName>().ok());
    parsed.as_ref() == Some(port)
}

/// The ports that running programs share, and those that a program does not share.
///
/// # Errors
/// The runtime folder cannot be used.
pub(super) fn running() -> Result<(Vec<InUse>, Vec<InUse>), ProgramError> {
    let in_use = ownership::in_use()
        .map_err(|cause| ProgramError::failed("the list of running programs cannot be read", cause))?;
    Ok(in_use.into_iter().partition(|found| found.shares))
}

fn of_running_program() -> Result<PortName, ProgramError> {
    let (sharing, alone) = running()?;
    match sharing.as_slice() {
        [found] => Ok(found.port.clone()),
        _ => Err(ProgramError::new(code::USAGE, choice(&sharing, &alone))),
    }
}

/// The message if the port is not known.
fn choice(sharing: &[InUse], alone: &[InUse]) -> String {
    let mut text = match sharing {
        [] => "which machine? No running program has one to work through. Name its port: --port /dev/ttyACM0, \
               tcp:host:port or unix:path (ETHERPEN_PORT names it for every command)"
            .to_owned(),
        _ => "which machine? Several are in use. Name one of them, or stop all with: etherpen stop --all".to_owned(),
    };
    // Writing into a string cannot fail.
    for found in sharing {
        let _ = write!(text, "\n  --port {}   in use by {}", found.port, found.owner);
    }
    for found in alone {
        let (port, owner) = (&found.port, &found.owner);
        let _ = write!(
            text,
            "\n{port} is in use by {owner}, which takes no orders: Ctrl-C in its terminal ends it"
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::ownership::Owner;

    fn in_use(port: &str) -> InUse {
        InUse {
            port: port.parse().expect("the name of a port"),
            owner: Owner {
                pid: 17,
                program: "etherpen draw".into(),
            },
            shares: true,
        }
    }

    #[test]
    fn machines_to_choose_from_are_listed_as_they_are_named() {
        let none = choice(&[], &[in_use("/dev/ttyACM7")]);
        assert!(
            none.contains("--port /dev/ttyACM0")
                && none.contains("/dev/ttyACM7 is in use by etherpen draw (process 17)")
        );
        let several = choice(&[in_use("tcp:127.0.0.1:7"), in_use("unix:/a")], &[]);
        assert!(
            several.contains("--port tcp:127.0.0.1:7 ")
                && several.contains("--port unix:/a ")
                && several.contains("--all")
        );
    }
}
