//! Identification: what tells a slave from others of its kind.
//!
//! A serial number is in the slave's SII, an alias in register 0x0012, and the number of its switches in the AL status
//! code (0x0134) while the master asks for it with bit 5 of AL control ([`state::switch`](crate::state::switch)). Sources: IEC 61158-6-12 (alias, AL control);
//! public manuals of drives with identification switches.
//!
//! Invariant: only the properties that are expected are compared; 0 expects nothing.

use crate::acyclic::AcyclicPort;
use crate::error::{BusError, IdentityProperty};
use crate::wire::register;
use crate::wire::sii::Identity;

/// The identity that is required of a slave. Each property with the value 0 is not checked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ExpectedIdentity {
    /// Configured alias.
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

/// The identity that a slave has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct KnownIdentity {
    /// Vendor, product, revision and serial number.
    pub identity: Identity,
    /// Alias; 0 for none, and if it was not read.
    pub alias: u16,
    /// Number of its switches; 0 for none, and if it was not read.
    pub switch: u16,
}

/// A property in which a slave differs from the one that is expected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Difference {
    /// The property.
    pub property: IdentityProperty,
    /// Value expected.
    pub expected: u32,
    /// Value found.
    pub actual: u32,
}

impl ExpectedIdentity {
    /// Accepts any slave.
    pub const ANY: Self = Self {
        alias: 0,
        switch: 0,
        serial: 0,
        vendor: 0,
        product: 0,
        revision: 0,
    };

    /// Whether nothing is checked.
    pub fn is_any(&self) -> bool {
        *self == Self::ANY
    }

    /// The first property in which a slave differs; `None` for a slave that is accepted.
    pub fn difference(&self, slave: &KnownIdentity) -> Option<Difference> {
        use IdentityProperty::{Alias, Product, Revision, Serial, Switch, Vendor};
        let KnownIdentity {
            identity,
            alias,
            switch,
        } = *slave;
        let properties = [
            (Vendor, self.vendor, identity.vendor),
            (Product, self.product, identity.product),
            (Revision, self.revision, identity.revision),
            (Alias, self.alias.into(), alias.into()),
            (Switch, self.switch.into(), switch.into()),
            (Serial, self.serial, identity.serial),
        ];
        let mut differences = properties
            .into_iter()
            .filter(|(_, expected, actual)| *expected != 0 && expected != actual);
        differences.next().map(|(property, expected, actual)| Difference {
            property,
            expected,
            actual,
        })
    }
}

/// Reads a slave's alias; 0 if it has none.
///
/// # Errors
/// As [`AcyclicPort::send_until_counted`].
pub async fn alias<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>, station: u16) -> Result<u16, BusError> {
    port.read_u16(station, register::STATION_ALIAS).await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_configured_accepts_any_slave_and_the_first_difference_is_told() {
        let slave = KnownIdentity {
            identity: Identity {
                vendor: 1,
                product: 2,
                revision: 3,
                serial: 4,
            },
            alias: 5,
            switch: 6,
        };
        assert_eq!(ExpectedIdentity::ANY.difference(&slave), None);
        let right = ExpectedIdentity {
            alias: 5,
            switch: 6,
            serial: 4,
            vendor: 1,
            product: 2,
            revision: 3,
        };
        assert_eq!(right.difference(&slave), None);
        let differs = |expected: ExpectedIdentity| expected.difference(&slave).map(|difference| difference.property);
        assert_eq!(
            differs(ExpectedIdentity { alias: 6, ..right }),
            Some(IdentityProperty::Alias)
        );
        assert_eq!(
            differs(ExpectedIdentity { switch: 7, ..right }),
            Some(IdentityProperty::Switch)
        );
        assert_eq!(
            differs(ExpectedIdentity { serial: 5, ..right }),
            Some(IdentityProperty::Serial)
        );
        assert_eq!(
            differs(ExpectedIdentity { revision: 4, ..right }),
            Some(IdentityProperty::Revision)
        );
        let product = ExpectedIdentity {
            product: 9,
            alias: 6,
            ..ExpectedIdentity::ANY
        };
        let expected = Difference {
            property: IdentityProperty::Product,
            expected: 9,
            actual: 2,
        };
        assert_eq!(product.difference(&slave), Some(expected));
    }
}
