//! Terminals whose identity is compared: `[[terminals]]`.
//!
//! Invariant: a configuration that [`check`] has passed names each place once, and expects no device at two places.

use super::io::IoError;
use super::{Axis, Config};
use crate::ethercat::driver::ExpectedIdentity;
use crate::ethercat::event::{IDENTITIES_MAX, PlaceIdentity};
use crate::robot_bus::BUS_SLAVES_MAX;
use heapless::Vec;
use serde::{Deserialize, Serialize};

/// Most terminals whose identity is compared.
pub const TERMINALS_MAX: usize = IDENTITIES_MAX;

/// A terminal, and what tells it from others. Each property with the value 0 is not compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Terminal {
    /// Place in the chain, from 0.
    pub slave: u8,
    /// Alias.
    pub alias: u16,
    /// Number set with the identification switches.
    pub switch: u16,
    /// Serial number.
    pub serial: u32,
    /// Vendor number.
    pub vendor: u32,
    /// Product code.
    pub product: u32,
    /// Revision of the product.
    pub revision: u32,
}

/// All terminals whose identity is compared, in the order of the file.
pub type Terminals = Vec<Terminal, TERMINALS_MAX>;

impl Terminal {
    /// Identity required of the terminal.
    pub const fn identity(&self) -> ExpectedIdentity {
        ExpectedIdentity {
            alias: self.alias,
            switch: self.switch,
            serial: self.serial,
            vendor: self.vendor,
            product: self.product,
            revision: self.revision,
        }
    }

    /// Place and identity, for the bring-up of the bus.
    pub(super) const fn place_identity(&self) -> PlaceIdentity {
        PlaceIdentity {
            slave: self.slave,
            identity: self.identity(),
        }
    }
}

/// Whether only one device can have an identity.
const fn is_of_one_device(identity: &ExpectedIdentity) -> bool {
    identity.alias != 0 || identity.switch != 0 || identity.serial != 0
}

/// Checks all terminals, and that no axis expects the same device.
///
/// # Errors
/// The first [`IoError`].
pub(super) fn check(config: &Config) -> Result<(), IoError> {
    for (terminal, here) in (0_u8..).zip(&config.terminals) {
        if usize::from(here.slave) >= BUS_SLAVES_MAX {
            return Err(IoError::TerminalSlave {
                terminal,
                expected: BUS_SLAVES_MAX as u8 - 1,
                actual: here.slave,
            });
        }
        let is_same = |other: ExpectedIdentity| is_of_one_device(&other) && other == here.identity();
        for (first, before) in (0..terminal).zip(&config.terminals) {
            let second = terminal;
            if before.slave == here.slave {
                return Err(IoError::SameTerminal { first, second });
            }
            if is_same(before.identity()) {
                return Err(IoError::SameDevice { first, second });
            }
        }
        let mut axes = (0_u8..).zip(config.axes.iter().map(Axis::identity));
        if let Some((axis, _)) = axes.find(|(_, identity)| is_same(*identity)) {
            return Err(IoError::DeviceOfAxis { terminal, axis });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_place_is_named_once_and_no_device_is_expected_at_two_places() {
        let check = |terminals: &[Terminal]| {
            let mut config = Config::default();
            config.axes[2].alias = 7;
            config.terminals.extend(terminals.iter().copied());
            config.check_io()
        };
        let at = |slave, alias| Terminal {
            slave,
            alias,
            vendor: 2,
            ..Terminal::default()
        };
        assert_eq!(check(&[at(4, 1), at(5, 2), at(6, 0), at(7, 0)]), Ok(()));
        let (first, second) = (0, 2);
        let same_place = check(&[at(4, 1), at(5, 2), at(4, 3)]);
        assert_eq!(same_place, Err(IoError::SameTerminal { first, second }));
        let same_device = check(&[at(4, 1), at(5, 2), at(6, 1)]);
        assert_eq!(same_device, Err(IoError::SameDevice { first, second }));
        let of_axis = Terminal { vendor: 0, ..at(5, 7) };
        let (terminal, axis) = (1, 2);
        let expected_by_axis = check(&[at(4, 1), of_axis]);
        assert_eq!(expected_by_axis, Err(IoError::DeviceOfAxis { terminal, axis }));
        let beyond = IoError::TerminalSlave {
            terminal: 0,
            expected: BUS_SLAVES_MAX as u8 - 1,
            actual: BUS_SLAVES_MAX as u8,
        };
        assert_eq!(check(&[at(BUS_SLAVES_MAX as u8, 0)]), Err(beyond));
    }
}
