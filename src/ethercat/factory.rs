//! From a slave's identity to what it is used as.
//!
//! Unknown products get no driver: they are reported with their identity, stay in INIT, carry no process data and
//! disturb nobody. A new drive type is a line in [`DriveKind::ALL`].
//!
//! Invariant: only vendor and product decide; revisions and serial numbers do not.

use super::wire::sii::Identity;
use crate::drives::DriveKind;

/// The drive type of an identity; `None` for everything that is not driven.
pub fn drive_kind(identity: &Identity) -> Option<DriveKind> {
    DriveKind::ALL.into_iter().find(|kind| {
        let description = kind.description();
        (description.vendor, description.product) == (identity.vendor, identity.product)
    })
}

/// Name of a slave for people.
pub fn name(identity: &Identity) -> &'static str {
    drive_kind(identity).map_or("unknown device", |kind| kind.description().name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_drive_is_recognised_in_any_revision_and_others_are_not() {
        let identity = Identity {
            vendor: 2,
            product: 0x07D0_6014,
            revision: 0x110A,
            serial: 7,
        };
        assert_eq!(drive_kind(&identity), Some(DriveKind::Ax2000Velocity));
        assert_eq!(
            drive_kind(&Identity {
                revision: 1,
                ..identity
            }),
            Some(DriveKind::Ax2000Velocity)
        );
        assert_eq!(drive_kind(&Identity { product: 1, ..identity }), None);
        assert_eq!(name(&Identity::default()), "unknown device");
    }
}
