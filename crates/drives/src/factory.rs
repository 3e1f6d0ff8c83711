//! Driver selection: from a slave's identity to its drive type.
//!
//! A slave with an unknown product is asked for its device type, if it supports CoE; a servo drive of CiA 402 is used
//! as the generic type. All other slaves get no driver: they are reported with their identity, and
//! exchange process data only as terminals ([`BusSetup::terminals`](etherpen_ethercat::event::BusSetup::terminals)). A new drive type is a line in [`DRIVES`].
//!
//! Invariant: only vendor and product, or the device type, decide on the type; revision, serial number, alias and switches
//! decide whether a drive may be used as the axis that expects them ([`DriveSettings::identity`]).

use crate::layout::ProcessLayout;
use crate::{DriveKind, DriveSettings, Recognition, STATUS_WORD, akd, ax2000, configuration, generic};
use etherpen_ethercat::configure::PreOperational;
use etherpen_ethercat::driver::{DeviceDescription, ExpectedIdentity, ProcessData, SlaveFactory};
use etherpen_ethercat::error::BusError;
use etherpen_ethercat::wire::sii::Identity;

/// Device type: the profile of drives, and the bits of the kinds that are used.
const PROFILE: u32 = 402;
const SERVO: u32 = 1 << 17;
const STEPPER: u32 = 1 << 18;

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
///
/// CiA 402: the profile in bits 0 to 15; bit 17 is a servo drive, bit 18 a stepper. Devices set other bits as well.
pub fn drive_kind_by_type(device_type: u32) -> Option<DriveKind> {
    let is_drive = device_type & 0xFFFF == PROFILE && device_type & (SERVO | STEPPER) != 0;
    let device_type = Recognition::DeviceType(generic::DEVICE_TYPE_SERVO);
    DRIVES
        .into_iter()
        .find(|kind| is_drive && kind.recognition == device_type)
}

/// Servo drives as the members of a bus: the first drive in the chain is member 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ServoDrives<const MEMBERS: usize>;

impl<const MEMBERS: usize> SlaveFactory for ServoDrives<MEMBERS>
where
    [DriveSettings; MEMBERS]: Default,
{
    type Device = DriveKind;
    type Layout = ProcessLayout;
    type Settings = [DriveSettings; MEMBERS];

    fn by_identity(identity: &Identity) -> Option<DriveKind> {
        drive_kind(identity)
    }

    fn by_device_type(device_type: u32) -> Option<DriveKind> {
        drive_kind_by_type(device_type)
    }

    fn describe(device: DriveKind) -> DeviceDescription {
        DeviceDescription {
            name: device.name,
            assign_activate: device.clocks.assign_activate,
            sync1_ns: device.clocks.sync1_ns,
            status: Some(STATUS_WORD),
        }
    }

    fn expected_identity(settings: &[DriveSettings; MEMBERS], member: u8) -> ExpectedIdentity {
        let settings = settings.get(usize::from(member));
        settings.map_or(ExpectedIdentity::ANY, |settings| settings.identity)
    }

    async fn configure<const MESSAGE: usize>(
        settings: &[DriveSettings; MEMBERS],
        device: DriveKind,
        member: Option<u8>,
        slave: &mut PreOperational<'_, '_, MESSAGE>,
        twin: Option<&ProcessData<Self>>,
    ) -> Result<Option<ProcessData<Self>>, BusError> {
        // A member beyond the settings is a drive that no axis uses.
        let Some(settings) = member.and_then(|member| settings.get(usize::from(member))) else {
            return configuration::unused(device, slave).await;
        };
        configuration::used(device, settings, slave, twin).await.map(Some)
    }

    async fn confirm<const MESSAGE: usize>(
        _: &[DriveSettings; MEMBERS],
        device: DriveKind,
        _: u8,
        slave: &mut PreOperational<'_, '_, MESSAGE>,
        data: &ProcessData<Self>,
    ) -> Result<(), BusError> {
        configuration::confirmed(device, &data.layout, slave).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen_ethercat::driver::is_asked_for_device_type;
    use etherpen_ethercat::wire::sii::{FixedPart, PROTOCOL_COE};

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
        assert_eq!(drive_kind(&akd).map(|kind| kind.name), Some("Kollmorgen AKD"));
        assert_eq!(drive_kind(&Identity { product: 1, ..AX2000 }), None);
    }

    #[test]
    fn only_unknown_products_that_speak_coe_are_asked_for_their_device_type() {
        let is_asked = |vendor, protocols| {
            is_asked_for_device_type::<ServoDrives<4>>(&FixedPart {
                identity: Identity { vendor, ..AX2000 },
                protocols,
                ..FixedPart::default()
            })
        };
        assert!(is_asked(0x0E7E, PROTOCOL_COE));
        assert!(!is_asked(0x0E7E, 0));
        assert!(!is_asked(2, PROTOCOL_COE));
    }

    #[test]
    fn servo_drives_are_known_by_their_device_type_and_others_are_not() {
        // Servo, servo with a maker's bits, stepper, servo and inverter.
        for servo in [0x0002_0192, 0xFF82_0192, 0x0004_0192, 0x0003_0192] {
            assert_eq!(drive_kind_by_type(servo), Some(&generic::GENERIC), "{servo:x}");
        }
        // Inverter, inputs and outputs of CiA 401, a modular device, none.
        for other in [0x0001_0192, 0x0002_0191, 0x0000_1389, 0] {
            assert_eq!(drive_kind_by_type(other), None, "{other:x}");
        }
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
