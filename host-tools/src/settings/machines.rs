//! The bundled machines: a complete configuration for each kind of machine.

use super::checked;
use crate::error::ProgramError;
use etherpen::config::Config;
use std::convert::Infallible;
use std::path::PathBuf;
use std::str::FromStr;

/// A bundled machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Machine {
    /// Its name on the command line.
    pub name: &'static str,
    /// Its configuration file.
    pub text: &'static str,
}

/// The bundled machines: the delta first.
pub const MACHINES: [Machine; 5] = [
    Machine {
        name: "irb340",
        text: include_str!("../../../samples/machines/irb340.toml"),
    },
    Machine {
        name: "gantry",
        text: include_str!("../../../samples/machines/gantry.toml"),
    },
    Machine {
        name: "corexy",
        text: include_str!("../../../samples/machines/corexy.toml"),
    },
    Machine {
        name: "scara",
        text: include_str!("../../../samples/machines/scara.toml"),
    },
    Machine {
        name: "linear-delta",
        text: include_str!("../../../samples/machines/linear-delta.toml"),
    },
];

impl Machine {
    /// Reads and checks the machine's configuration.
    ///
    /// # Errors
    /// A value that cannot be used; none of the bundled machines has one.
    pub fn load(&self) -> Result<Config, ProgramError> {
        checked(self.text, &self.name)
    }
}

/// A machine as the command line names it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MachineChoice {
    /// A bundled machine.
    Bundled(Machine),
    /// A configuration file.
    File(PathBuf),
}

impl FromStr for MachineChoice {
    type Err = Infallible;

    fn from_str(name: &str) -> Result<Self, Infallible> {
        let bundled = MACHINES.into_iter().find(|machine| machine.name == name);
        Ok(bundled.map_or_else(|| Self::File(name.into()), Self::Bundled))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bundled_machine_can_be_configured_and_the_delta_is_the_built_in_one() {
        for machine in MACHINES {
            let config = machine
                .load()
                .unwrap_or_else(|error| panic!("{}: {error:?}", machine.name));
            assert!(config.hash().is_some(), "{} fits a message", machine.name);
            if machine.name == "irb340" {
                assert_eq!(config, Config::default());
            }
        }
        assert_eq!("gantry".parse(), Ok(MachineChoice::Bundled(MACHINES[1])));
        assert_eq!("my.toml".parse(), Ok(MachineChoice::File("my.toml".into())));
    }
}
