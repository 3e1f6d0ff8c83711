//! Descriptions of the supported servo drives.
//!
//! Adding a drive type takes one file and one line. The file is in this folder, is declared below, and contains one
//! [`DriveDescription`]: how the drive is recognised, its modes and for each the process data objects to be assigned or
//! written, the value of a digit of its demand, and the settings to write before use. The line is in
//! [`DRIVES`](crate::ethercat::factory::DRIVES). Everything else is shared: the process data are found wherever the
//! drive maps them ([`layout`]), and the state machine is that of CiA 402 ([`cia402`]). [`generic`] is the example.
//!
//! Invariant: a description is data and pure functions; it never accesses the bus.

pub mod akd;
pub mod ax2000;
pub mod cia402;
pub mod generic;
pub mod layout;

use crate::config::{Axis, AxisMode};
use crate::ethercat::wire::coe::Object;
use cia402::{ControlWord, StatusWord};
use core::f64::consts::TAU;
use heapless::Vec;

/// Most settings written to a drive before use.
pub const SETTINGS_MAX: usize = 8;
/// Control word, 16 bits.
pub const CONTROL_WORD: Object = Object::new(0x6040, 0);
/// Status word, 16 bits.
pub const STATUS_WORD: Object = Object::new(0x6041, 0);
/// Mode of operation, 8 bits.
pub const OPERATION_MODE: Object = Object::new(0x6060, 0);
/// Mode of operation in effect, 8 bits.
pub const OPERATION_MODE_DISPLAY: Object = Object::new(0x6061, 0);
/// Position in the drive's own increments, 32 bits; some drives report it instead of [`POSITION`].
pub const POSITION_INTERNAL: Object = Object::new(0x6063, 0);
/// Position, 32 bits.
pub const POSITION: Object = Object::new(0x6064, 0);
/// Actual torque or current, 16 bits.
pub const TORQUE: Object = Object::new(0x6077, 0);
/// Target position, 32 bits.
pub const TARGET_POSITION: Object = Object::new(0x607A, 0);
/// Quick-stop deceleration, 32 bits.
pub const QUICK_STOP_DECELERATION: Object = Object::new(0x6085, 0);

/// Values that a drive reports each cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriveInput {
    /// Position in increments, wrapping.
    pub position: i32,
    /// CiA 402 status word.
    pub status: StatusWord,
    /// Whether the mode in effect is the one that was set; true if the drive does not report the mode each cycle.
    pub mode_in_effect: bool,
}

/// Values sent to a drive each cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriveOutput {
    /// Velocity or torque demand, depending on the mode, in the drive's digits; limited to the object's range.
    pub demand_digits: i32,
    /// Present position of the drive. Drives that map a target position get it as target, so that no mode change causes
    /// a jump.
    pub position: i32,
    /// CiA 402 control word.
    pub control: ControlWord,
}

/// One object to write before a drive is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setting {
    /// The object.
    pub object: Object,
    /// Its value, little-endian, signed values sign-extended.
    pub value: u32,
    /// Bytes of the object, 1 to 4.
    pub length: u8,
    /// The object that has to read back as this value afterwards, if any.
    pub verify: Option<Object>,
    /// Whether the drive may refuse the object.
    pub optional: bool,
}

impl Setting {
    /// A setting that is written and not read back.
    pub const fn new(index: u16, sub: u8, value: u32, length: u8) -> Self {
        Self::of(Object::new(index, sub), value, length)
    }

    /// A setting of `object` that is written and not read back.
    pub const fn of(object: Object, value: u32, length: u8) -> Self {
        Self {
            object,
            value,
            length,
            verify: None,
            optional: false,
        }
    }

    /// This setting, read back from the object itself.
    pub const fn verified(self) -> Self {
        Self {
            verify: Some(self.object),
            ..self
        }
    }

    /// This setting, read back from another object.
    pub const fn shown_by(self, object: Object) -> Self {
        Self {
            verify: Some(object),
            ..self
        }
    }

    /// This setting for an object that not every drive of the type has.
    pub const fn optional(self) -> Self {
        Self { optional: true, ..self }
    }
}

/// The settings of one drive, in the order they are written.
pub type Settings = Vec<Setting, SETTINGS_MAX>;

/// An object in the process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The object; index 0 is a gap.
    pub object: Object,
    /// Bits it takes.
    pub bits: u8,
}

impl Entry {
    /// An entry for an object and its length in bits.
    pub const fn new(object: Object, bits: u8) -> Self {
        Self { object, bits }
    }

    /// The entry described by the value of a mapping object (0x16xx, 0x1Axx): index, sub-index and bits (CiA 301).
    pub const fn from_mapping(value: u32) -> Self {
        Self::new(Object::new((value >> 16) as u16, (value >> 8) as u8), value as u8)
    }

    /// The value of the mapping object for this entry.
    pub const fn mapping(&self) -> u32 {
        (self.object.index as u32) << 16 | (self.object.sub as u32) << 8 | self.bits as u32
    }
}

/// The process data object of one direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PdoChoice {
    /// Its index: from 0x1600 for outputs, from 0x1A00 for inputs.
    pub pdo: u16,
    /// Its entries, fixed or to be written.
    pub entries: &'static [Entry],
    /// Whether the entries have to be written; otherwise they are fixed in the drive.
    pub written: bool,
}

impl PdoChoice {
    /// A process data object whose entries are fixed in the drive.
    pub const fn fixed(pdo: u16, entries: &'static [Entry]) -> Self {
        Self {
            pdo,
            entries,
            written: false,
        }
    }

    /// A process data object whose entries are written.
    pub const fn written(pdo: u16, entries: &'static [Entry]) -> Self {
        Self {
            pdo,
            entries,
            written: true,
        }
    }
}

/// Description of one mode of a drive.
#[derive(Clone, Copy, Debug)]
pub struct ModeDescription {
    /// Value of the mode of operation (0x6060).
    pub operation_mode: i8,
    /// The object that takes the demand: 32 bits for a velocity, 16 bits for a torque.
    pub demand: Object,
    /// Outputs to be assigned.
    pub outputs: PdoChoice,
    /// Inputs to be assigned.
    pub inputs: PdoChoice,
    /// Unit of a digit of the demand.
    pub digits: Digits,
}

/// Unit of a digit of a demand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Digits {
    /// Part of a velocity, as configured.
    Velocity,
    /// Part of the drive's peak current; the value is the number of digits at peak current.
    PeakCurrent(f64),
    /// Part of the motor's rated torque; the value is the number of digits at rated torque.
    RatedTorque(f64),
}

impl Digits {
    /// Digits for one unit at the motor of an axis: 1 rad/s for a velocity, 1 N m for a torque.
    pub fn per_unit(self, axis: &Axis) -> f64 {
        match self {
            Self::Velocity => axis.digits_per_rpm * 60.0 / TAU,
            Self::PeakCurrent(digits) => digits / (axis.peak_current_a * axis.torque_constant_nm_a),
            Self::RatedTorque(digits) => digits / axis.rated_torque_nm,
        }
    }
}

/// How a drive type is recognised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Recognition {
    /// By vendor and product in its SII.
    Product {
        /// Vendor number.
        vendor: u32,
        /// Product code.
        product: u32,
    },
    /// By its device type (object 0x1000), if no other description knows its product.
    DeviceType(u32),
}

/// Addresses of the process data in the slave's memory, used if its SII has none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Windows {
    /// Start of the outputs: sync manager 2.
    pub outputs: u16,
    /// Start of the inputs: sync manager 3.
    pub inputs: u16,
}

/// Use of the distributed clocks, if the SII does not describe it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clocks {
    /// AssignActivate: the value of registers 0x0980 (low byte) and 0x0981 (high byte).
    pub assign_activate: u16,
}

impl Clocks {
    /// Cyclic operation with SYNC0.
    pub const SYNC0: Self = Self {
        assign_activate: 0x0300,
    };

    /// Whether the drive needs SYNC0.
    pub const fn uses_sync0(&self) -> bool {
        self.assign_activate & 0x0200 != 0
    }

    /// Whether the drive needs SYNC1.
    pub const fn uses_sync1(&self) -> bool {
        self.assign_activate & 0x0400 != 0
    }
}

/// Description of a drive type for the master.
#[derive(Debug)]
pub struct DriveDescription {
    /// Name for messages; unique for each type.
    pub name: &'static str,
    /// How the drive type is recognised.
    pub recognition: Recognition,
    /// Velocity mode, if the drive has one.
    pub velocity: Option<ModeDescription>,
    /// Torque mode, if the drive has one.
    pub torque: Option<ModeDescription>,
    /// Addresses of the process data if the SII has none.
    pub windows: Windows,
    /// Use of the distributed clocks if the SII does not describe it.
    pub clocks: Clocks,
    /// Settings for an axis, written in PREOP; `None` when a value does not fit the drive's object.
    pub settings: fn(&Axis) -> Option<Settings>,
}

impl DriveDescription {
    /// Description of a mode; `None` when the drive does not have it.
    pub const fn mode(&self, mode: AxisMode) -> Option<&ModeDescription> {
        match mode {
            AxisMode::Velocity => self.velocity.as_ref(),
            AxisMode::Torque => self.torque.as_ref(),
        }
    }
}

impl PartialEq for DriveDescription {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Eq for DriveDescription {}

/// A drive type.
pub type DriveKind = &'static DriveDescription;

/// Quick-stop deceleration in the units of object 0x6085: position increments per second squared at the motor.
///
/// `None` when it does not fit 32 bits or is below 1.
pub fn quick_stop_increments_s2(axis: &Axis) -> Option<u32> {
    let motor_rad_s2 = axis.quick_stop_rad_s2 * axis.gear.abs();
    let increments_s2 = motor_rad_s2 / TAU * f64::from(axis.increments_per_revolution);
    (1.0..=f64::from(u32::MAX))
        .contains(&increments_s2)
        .then_some(increments_s2 as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quick_stop_is_written_in_increments_and_bounded() {
        let mut axis = Axis::default();
        // 100 rad/s2 at the joint are 1200 rad/s2, that is 190.99 revolutions/s2, at the motor.
        assert_eq!(quick_stop_increments_s2(&axis), Some(200_263_264));
        axis.quick_stop_rad_s2 = 1e9;
        assert_eq!(quick_stop_increments_s2(&axis), None);
        axis.quick_stop_rad_s2 = f64::NAN;
        assert_eq!(quick_stop_increments_s2(&axis), None);
    }

    #[test]
    fn a_mapping_value_and_its_entry_are_the_same_thing() {
        let entry = Entry::from_mapping(0x60C1_0120);
        assert_eq!(entry, Entry::new(Object::new(0x60C1, 1), 32));
        assert_eq!(entry.mapping(), 0x60C1_0120);
    }

    #[test]
    fn assign_activate_tells_which_sync_signals_are_used() {
        assert!(Clocks::SYNC0.uses_sync0() && !Clocks::SYNC0.uses_sync1());
        let free_run = Clocks { assign_activate: 0 };
        assert!(!free_run.uses_sync0());
    }
}
