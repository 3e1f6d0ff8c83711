//! Driver selection: from a slave's identity to its drive type.
//!
//! A slave with an unknown product is asked for its device type, if it supports CoE; a servo drive of CiA 402 is used
//! as the generic type. All other slaves get no driver: they are reported with their identity, carry no process data
//! and affect nothing else. A new drive type is a line in [`DRIVES`], see [`drives`](crate::drives).
//!
//! Invariant: only vendor and product, or the device type, decide; revision and serial number do not.

use super::wire::sii::{FixedPart, Identity, PROTOCOL_COE};
use crate::drives::{DriveKind, Recognition, akd, ax2000, generic};

/// All drive types.
pub static DRIVES: [DriveKind; 3] = [&ax2000::AX2000, &akd::AKD, &generic::GENERIC];

/// The drive type of a product; `None` if no description has the product.
pub fn drive_kind(identity: &Identity) -> Option<DriveKind> {
    let product = Recognition::Product {
        vendor: identity.vendor,
        product: identity.product,
    };
    DRIVES.into_iter().find(|kind| kind.recognition == product)
}

/// The drive type of a device type (object 0x1000); `None` if it is not a drive.
pub fn drive_kind_by_type(device_type: u32) -> Option<DriveKind> {
    let device_type = Recognition::DeviceType(device_type);
    DRIVES.into_iter().find(|kind| kind.recognition == device_type)
}

/// Whether a slave has to be asked for its device type to select the driver.
pub fn is_to_be_asked(fixed: &FixedPart) -> bool {
    drive_kind(&fixed.identity).is_none() && fixed.protocols & PROTOCOL_COE != 0
}

/// Name of a slave for display.
pub fn name(kind: Option<DriveKind>) -> &'static str {
    kind.map_or("unknown device", |kind| kind.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    const AX2000: Identity = Identity {
        vendor: 2,
        product: 0x07D0_6014,
        revision: 0x110A,
        serial: 7,
    };

    #[test]
    fn a_product_is_recognised_in_any_revision_and_others_are_not() {
        let other_revision = Identity { revision: 1, ..AX2000 };
        for identity in [AX2000, other_revision] {
            assert_eq!(drive_kind(&identity), Some(&ax2000::AX2000));
        }
        let akd = Identity {
            vendor: 0x6A,
            product: 0x0041_4B44,
            ..AX2000
        };
        assert_eq!(name(drive_kind(&akd)), "Kollmorgen AKD");
        assert_eq!(drive_kind(&Identity { product: 1, ..AX2000 }), None);
        assert_eq!(name(None), "unknown device");
    }

    #[test]
    fn only_unknown_products_that_speak_coe_are_asked_for_their_device_type() {
        let fixed = |vendor, protocols| FixedPart {
            identity: Identity { vendor, ..AX2000 },
            protocols,
            ..FixedPart::default()
        };
        assert!(is_to_be_asked(&fixed(0x0E7E, PROTOCOL_COE)));
        assert!(!is_to_be_asked(&fixed(0x0E7E, 0)));
        assert!(!is_to_be_asked(&fixed(2, PROTOCOL_COE)));
        assert_eq!(drive_kind_by_type(0x0002_0192), Some(&generic::GENERIC));
        assert_eq!(drive_kind_by_type(0x0001_0192), None);
    }

    #[test]
    fn no_two_drive_types_share_a_name_or_a_recognition() {
        for (number, one) in DRIVES.into_iter().enumerate() {
            for other in DRIVES.into_iter().skip(number + 1) {
                assert_ne!(one.name, other.name);
                assert_ne!(one.recognition, other.recognition);
            }
        }
    }
}
