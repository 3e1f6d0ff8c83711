//! The servo drives this controller knows.
//!
//! A drive type is a file with one [`DriveDescription`]: identity, windows, process data and settings, and one line in
//! [`DriveKind`] and [`DriveKind::ALL`]. The CiA 402 state machine is common to all.
//!
//! Invariant: a description is data and pure functions; it never touches the bus.

pub mod ax2000;
pub mod cia402;

use crate::config::Axis;
use crate::ethercat::wire::coe::Object;
use cia402::{ControlWord, StatusWord};
use heapless::Vec;

/// Most settings that a drive gets before it is used.
pub const SETTINGS_MAX: usize = 12;

/// What a drive reports each cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriveInput {
    /// Position in increments, wrapping.
    pub position: i32,
    /// CiA 402 status word.
    pub status: StatusWord,
}

/// What a drive is told each cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriveOutput {
    /// Velocity demand in the drive's digits.
    pub velocity_digits: i32,
    /// CiA 402 control word.
    pub control: ControlWord,
}

/// One object to be written before a drive is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setting {
    /// The object.
    pub object: Object,
    /// Its value, little-endian, signed values sign-extended.
    pub value: u32,
    /// Bytes of the object, 1 to 4.
    pub length: u8,
    /// The object that has to show the same value afterwards.
    pub verify: Option<Object>,
    /// Whether a refusal is accepted if the object has that value already.
    pub may_be_fixed: bool,
}

impl Setting {
    /// A setting that is written and not read back.
    pub const fn new(index: u16, sub: u8, value: u32, length: u8) -> Self {
        let object = Object::new(index, sub);
        Self {
            object,
            value,
            length,
            verify: None,
            may_be_fixed: false,
        }
    }

    /// The same, read back from the object itself.
    pub const fn verified(self) -> Self {
        Self {
            verify: Some(self.object),
            ..self
        }
    }

    /// The same, read back from another object.
    pub const fn shown_by(self, index: u16, sub: u8) -> Self {
        Self {
            verify: Some(Object::new(index, sub)),
            ..self
        }
    }

    /// The same, for objects that some devices keep fixed.
    pub const fn or_fixed(self) -> Self {
        Self {
            may_be_fixed: true,
            ..self
        }
    }
}

/// The settings of one drive, in the order they are written.
pub type Settings = Vec<Setting, SETTINGS_MAX>;

/// Everything the master has to know about a drive type.
#[derive(Debug)]
pub struct DriveDescription {
    /// Name for people.
    pub name: &'static str,
    /// Vendor number in the SII.
    pub vendor: u32,
    /// Product code in the SII.
    pub product: u32,
    /// Start of the outputs' sync manager (2) in the slave's memory.
    pub output_start: u16,
    /// Bytes of outputs.
    pub output_length: u16,
    /// Start of the inputs' sync manager (3) in the slave's memory.
    pub input_start: u16,
    /// Bytes of inputs.
    pub input_length: u16,
    /// Settings for an axis, written in PREOP; `None` when a value does not fit the drive's object.
    pub settings: fn(&Axis) -> Option<Settings>,
    /// Takes inputs apart; `None` when there are too few bytes.
    pub decode: fn(&[u8]) -> Option<DriveInput>,
    /// Writes outputs; what does not fit is left out.
    pub encode: fn(&DriveOutput, &mut [u8]),
}

/// The drive types.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriveKind {
    /// AX2000-B110 in digital speed.
    Ax2000Velocity,
}

impl DriveKind {
    /// All drive types that are recognised by their identity.
    pub const ALL: [Self; 1] = [Self::Ax2000Velocity];

    /// What there is to know about it.
    pub const fn description(self) -> &'static DriveDescription {
        match self {
            Self::Ax2000Velocity => &ax2000::VELOCITY,
        }
    }
}
