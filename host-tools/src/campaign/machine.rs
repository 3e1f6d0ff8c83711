//! The machine of an episode: its configuration, its sheet, and which slave of its chain is what.

use crate::cell::usual_slaves;
use crate::settings::load;
use crate::settings::machines::MachineChoice;
use etherpen::config::{Config, PenLiftKind};
use etherpen::robots::MAIN_AXES;

/// Name of the machine of an episode that names none.
pub const DEFAULT_MACHINE: &str = "irb340";

/// The slaves of a chain. They count from 1, as in the segment's script.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Chain {
    /// Number of slaves.
    pub(super) slaves: usize,
    /// The drives, in the order of their axes.
    pub(super) drives: Vec<usize>,
    /// The terminals that named inputs and outputs belong to.
    pub(super) terminals: Vec<usize>,
}

impl Chain {
    /// The chain of a configuration's virtual cell.
    pub(super) fn new(config: &Config) -> Self {
        let slaves = usual_slaves(config);
        let drives = (1..).zip(&slaves).filter(|(_, kind)| kind.is_drive());
        let is_terminal = |slave: &usize| config.io.iter().any(|point| usize::from(point.slave) + 1 == *slave);
        Self {
            slaves: slaves.len(),
            drives: drives.map(|(slave, _)| slave).collect(),
            terminals: (1..=slaves.len()).filter(is_terminal).collect(),
        }
    }

    /// The axis that a slave drives, from 0.
    pub(super) fn axis(&self, slave: usize) -> Option<usize> {
        self.drives.iter().position(|drive| *drive == slave)
    }

    /// Whether a slave, from 1, is a drive or a named terminal: one that the controller has to bring to OP.
    pub(super) fn is_used(&self, slave: usize) -> bool {
        self.drives.contains(&slave) || self.terminals.contains(&slave)
    }
}

/// The machine of an episode.
#[derive(Clone, Debug)]
pub struct Machine {
    /// Its name on the command line: a bundled machine or a configuration file.
    pub name: String,
    pub(super) config: Config,
    pub(super) chain: Chain,
}

impl Machine {
    /// Finds a bundled machine, or reads a configuration file.
    ///
    /// # Errors
    /// The file cannot be read, or a value cannot be used.
    pub fn load(name: &str) -> Result<Self, String> {
        let Ok(choice) = name.parse();
        let config = match choice {
            MachineChoice::Bundled(machine) => machine.load(),
            MachineChoice::File(path) => load(Some(&path)),
        };
        let config = config.map_err(|error| error.message)?;
        Ok(Self {
            name: name.to_owned(),
            chain: Chain::new(&config),
            config,
        })
    }

    /// Whether this is the machine of an episode that names none.
    pub(super) fn is_default(&self) -> bool {
        self.config == Config::default()
    }

    /// Number of axes.
    pub(super) fn axes(&self) -> usize {
        self.chain.drives.len()
    }

    /// Half the width and half the height of the part of the sheet that figures lie in, mm.
    pub(super) fn figure_mm(&self) -> [f64; 2] {
        self.config.paper.size_mm.map(|side_mm| FIGURE_PART * side_mm / 2.0)
    }
}

/// Part of the sheet's width and height in which figures lie.
const FIGURE_PART: f64 = 0.9;

/// Whether an axis moves the tool up and down; otherwise the height exists on the path only.
pub(super) fn has_height_axis(config: &Config) -> bool {
    config.pen.kind == PenLiftKind::Axis || usize::from(config.bus.drives) >= MAIN_AXES
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::machines::MACHINES;

    #[test]
    fn each_machine_knows_its_own_chain() {
        let chain = |name: &str| {
            let chain = Machine::load(name).expect("a bundled machine").chain;
            (chain.slaves, chain.drives, chain.terminals)
        };
        assert_eq!(chain("irb340"), (4, vec![1, 2, 3, 4], vec![]));
        assert_eq!(chain("gantry"), (5, vec![3, 4, 5], vec![2]));
        assert_eq!(chain("corexy"), (5, vec![4, 5], vec![2, 3]));
        assert_eq!(chain("scara"), (4, vec![1, 2, 3, 4], vec![]));
        assert_eq!(chain("linear-delta"), (3, vec![1, 2, 3], vec![]));
        let gantry = Machine::load("gantry").expect("a bundled machine");
        assert_eq!((gantry.chain.axis(4), gantry.chain.axis(2)), (Some(1), None));
        assert!(
            gantry.chain.is_used(2) && !gantry.chain.is_used(1),
            "the coupler is not used"
        );
        let searching = MACHINES.map(|machine| machine.load().expect("a bundled machine").has_home_switches());
        assert_eq!(searching, [false, true, false, false, false]);
    }

    #[test]
    fn a_machine_that_does_not_exist_is_named() {
        let found = Machine::load("no-such.toml").unwrap_err();
        assert!(found.contains("no-such.toml"), "{found}");
    }
}
