//! Kinds of slaves, their words in a list, and the devices that they make.

use crate::devices::Device;
use crate::devices::akd;
use crate::devices::ax2000;
use crate::devices::coupler::Coupler;
use crate::devices::generic_drive;
use crate::devices::image_device::ImageDevice;
use crate::devices::servo_device::ServoDevice;
use crate::devices::terminal;
use crate::drive::servo::Servo;
use crate::eeprom::esi::EsiDevice;
use std::sync::Arc;

/// One kind of slave.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SlaveKind {
    /// `ax2000`: servo drive AX2000-B110.
    Ax2000,
    /// `cia402`: generic CiA 402 servo drive.
    Cia402,
    /// `ek1100`: bus coupler.
    Ek1100,
    /// `ek1122`: junction for two branches, at its ports 2 and 3.
    Ek1122,
    /// `akd`: servo drive AKD.
    Akd,
    /// `el1004`: terminal with four digital inputs.
    El1004,
    /// `el1008`: terminal with eight digital inputs.
    El1008,
    /// `el2004`: terminal with four digital outputs.
    El2004,
    /// `el2008`: terminal with eight digital outputs.
    El2008,
    /// `ai2`: terminal with two analogue inputs of 16 bits, of no manufacturer.
    Ai2,
    /// `ao2`: terminal with two analogue outputs of 16 bits, of no manufacturer.
    Ao2,
    /// `blank`: a board whose information memory was never written; nothing answers its state requests.
    Blank,
    /// `sii:FILE`: a slave with this information memory.
    Sii(Arc<[u8]>),
    /// `esi:FILE`: a slave as an EtherCAT slave information file describes it.
    Esi(Arc<EsiDevice>),
}

impl SlaveKind {
    /// Words of a list, but for images from files.
    pub(crate) const NAMES: [(&'static str, Self); 12] = [
        ("ax2000", Self::Ax2000),
        ("cia402", Self::Cia402),
        ("akd", Self::Akd),
        ("ek1100", Self::Ek1100),
        ("ek1122", Self::Ek1122),
        ("el1004", Self::El1004),
        ("el1008", Self::El1008),
        ("el2004", Self::El2004),
        ("el2008", Self::El2008),
        ("ai2", Self::Ai2),
        ("ao2", Self::Ao2),
        ("blank", Self::Blank),
    ];

    /// The kind with this word, but for images from files.
    pub(crate) fn named(word: &str) -> Option<Self> {
        let known = Self::NAMES.into_iter().find(|(name, _)| *name == word);
        known.map(|(_, kind)| kind)
    }

    /// Its word in a list; `sii` or `esi` for a slave from a file.
    #[must_use]
    pub fn name(&self) -> &'static str {
        let known = Self::NAMES.iter().find(|(_, kind)| kind == self);
        match (known, self) {
            (Some((name, _)), _) => name,
            (None, Self::Esi(_)) => "esi",
            (None, _) => "sii",
        }
    }

    /// Whether a further slave can be connected to this port, 1 to 3.
    #[must_use]
    pub fn has_port(&self, port: u8) -> bool {
        match self {
            Self::Ek1122 | Self::Sii(_) | Self::Esi(_) => (1..=3).contains(&port),
            Self::Ek1100 => (1..=2).contains(&port),
            _ => port == 1,
        }
    }

    /// Whether the slave has a motor.
    #[must_use]
    pub fn is_drive(&self) -> bool {
        matches!(self, Self::Ax2000 | Self::Cia402 | Self::Akd)
    }

    /// Makes the device; a drive kind takes the servo.
    pub(crate) fn device(&self, servo: Option<Servo>, serial: u32) -> Box<dyn Device> {
        match (self, servo) {
            (Self::Ax2000, Some(servo)) => Box::new(ServoDevice::new(&ax2000::MODEL, servo, serial)),
            (Self::Cia402, Some(servo)) => Box::new(ServoDevice::new(&generic_drive::MODEL, servo, serial)),
            (Self::Akd, Some(servo)) => Box::new(ServoDevice::new(&akd::MODEL, servo, serial)),
            (Self::Ek1122, None) => Box::new(Coupler::junction()),
            (Self::Esi(device), _) => {
                Box::new(ImageDevice::from_file(device.image().to_vec()).with_objects(device.objects().to_vec()))
            }
            (Self::Sii(image), _) => Box::new(ImageDevice::from_file(image.to_vec())),
            (Self::El1004, _) => Box::new(terminal::EL1004.device()),
            (Self::El1008, _) => Box::new(terminal::EL1008.device()),
            (Self::El2004, _) => Box::new(terminal::EL2004.device()),
            (Self::El2008, _) => Box::new(terminal::EL2008.device()),
            (Self::Ai2, _) => Box::new(terminal::AI2.device()),
            (Self::Ao2, _) => Box::new(terminal::AO2.device()),
            (Self::Blank, _) => Box::new(ImageDevice::blank()),
            (_, servo) => Box::new(Coupler::new(servo)),
        }
    }
}
