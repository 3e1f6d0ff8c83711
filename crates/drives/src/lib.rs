#![doc = include_str!("../README.md")]
//!
//! # Layers
//!
//! A module imports modules of lower layers only.
//!
//! 1. `cia402`, `position_range`: CiA 402 words and states; range of a position
//! 2. `io`, `layout`, `homing`, `probe`: traits between control and I/O; where values
//!    are in process data; homing by the drive; its touch probes
//! 3. `configuration`: settings and their writing
//! 4. `generic`: any CiA 402 servo drive
//! 5. `ax2000`, `akd`: drive types
//! 6. `factory`: the drives as slaves of the master
//! 7. `servo_axis`, `ethercat_group`, `memory_group`: one axis; groups of drives behind the traits
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod akd;
pub mod ax2000;
pub mod cia402;
mod configuration;
mod ethercat_group;
mod factory;
pub mod generic;
pub mod homing;
pub mod io;
pub mod layout;
mod memory_group;
mod position_range;
pub mod probe;
mod servo_axis;

pub use ethercat_group::EtherCatGroup;
pub use factory::{DRIVES, ServoDrives, drive_kind, drive_kind_by_type};
pub use memory_group::MemoryGroup;
pub use position_range::PositionRange;
pub use servo_axis::{AxisLimits, ServoAxis};

use cia402::{ControlWord, StatusWord};
use core::f64::consts::TAU;
use etherpen_ethercat::driver::{ExpectedIdentity, PdoChoice, Setting, Windows};
use etherpen_ethercat::wire::coe::Object;
use heapless::Vec;

/// Most settings written to a drive before use.
pub const SETTINGS_MAX: usize = 12;
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
/// Following error above which the drive trips, 32 bits, increments.
pub const FOLLOWING_WINDOW: Object = Object::new(0x6065, 0);
/// Time for which the following error may be above its window, 16 bits, ms.
pub const FOLLOWING_TIME_OUT: Object = Object::new(0x6066, 0);
/// First position of a drive's range, 32 bits; the positions wrap behind the last one. A drive need not have it.
pub const POSITION_FIRST: Object = Object::new(0x607B, 1);
/// Last position of a drive's range, 32 bits.
pub const POSITION_LAST: Object = Object::new(0x607B, 2);
/// Velocity added to the position loop's, 32 bits; a drive need not have it.
pub const VELOCITY_OFFSET: Object = Object::new(0x60B1, 0);
/// Quick-stop deceleration, 32 bits.
pub const QUICK_STOP_DECELERATION: Object = Object::new(0x6085, 0);

/// Kind of demand that a drive takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "lowercase"))]
pub enum AxisMode {
    /// A velocity: the drive closes the velocity loop.
    #[default]
    Velocity,
    /// A torque: the velocity loop is closed outside the drive.
    Torque,
    /// A position: the drive interpolates between the targets and closes all loops.
    Position,
}

/// Settings of a drive, and the scale of its values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveSettings {
    /// Identity required of the drive.
    pub identity: ExpectedIdentity,
    /// Kind of demand.
    pub mode: AxisMode,
    /// Motor revolutions for one revolution of the joint; negative where the motor turns the other way.
    pub gear: f64,
    /// Encoder increments for one motor revolution.
    pub increments_per_revolution: u32,
    /// Velocity command digits for one motor revolution per minute.
    pub digits_per_rpm: f64,
    /// Quick-stop deceleration at the joint, rad/s2.
    pub quick_stop_rad_s2: f64,
    /// Torque constant of the motor, N m/A.
    pub torque_constant_nm_a: f64,
    /// Peak current of the drive, A.
    pub peak_current_a: f64,
    /// Rated torque of the motor, N m.
    pub rated_torque_nm: f64,
    /// Following error at the joint above which a drive in position mode trips, rad.
    pub following_error_max_rad: f64,
}

impl Default for DriveSettings {
    /// An axis of the ABB IRB 340 with an AX2006.
    fn default() -> Self {
        Self {
            identity: ExpectedIdentity::ANY,
            mode: AxisMode::Velocity,
            gear: 12.0,
            increments_per_revolution: 1 << 20,
            digits_per_rpm: 262_144.0 / 1_875.0,
            quick_stop_rad_s2: 100.0,
            torque_constant_nm_a: 0.7,
            peak_current_a: 12.0,
            rated_torque_nm: 2.8,
            following_error_max_rad: 0.05,
        }
    }
}

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
    /// Velocity or torque demand, depending on the mode, in the drive's digits; limited to the object's range. In
    /// position mode the velocity offset.
    pub demand_digits: i32,
    /// Target position, increments; the drive's present position while it does not follow targets, so that neither
    /// enabling nor a change of mode causes a jump.
    pub position: i32,
    /// CiA 402 control word.
    pub control: ControlWord,
}

/// The settings of one drive, in the order they are written.
pub type SettingList = Vec<Setting, SETTINGS_MAX>;

/// Description of one mode of a drive.
#[derive(Clone, Copy, Debug)]
pub struct ModeDescription {
    /// Value of the mode of operation (0x6060).
    pub operation_mode: i8,
    /// The object that takes the demand: 32 bits for a velocity, 16 bits for a torque. In position mode the velocity
    /// offset of 32 bits, which the drive may lack; the target position is always [`TARGET_POSITION`].
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
    pub fn per_unit(self, axis: &DriveSettings) -> f64 {
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

/// Use of the distributed clocks, if the SII does not describe it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clocks {
    /// AssignActivate: the value of registers 0x0980 (low byte) and 0x0981 (high byte).
    pub assign_activate: u16,
    /// Time from SYNC0 to SYNC1, ns, if AssignActivate turns SYNC1 on.
    pub sync1_ns: u32,
}

impl Clocks {
    /// Cyclic operation with SYNC0.
    pub const SYNC0: Self = Self {
        assign_activate: 0x0300,
        sync1_ns: 0,
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
    /// Position mode, if the drive has one.
    pub position: Option<ModeDescription>,
    /// Addresses of the process data if the SII has none.
    pub windows: Windows,
    /// Use of the distributed clocks if the SII does not describe it.
    pub clocks: Clocks,
    /// Settings for an axis on a bus with a cycle in ns, written in PREOP; `None` when a value does not fit the drive's
    /// object.
    pub settings: fn(&DriveSettings, u32) -> Option<SettingList>,
}

impl DriveDescription {
    /// Description of a mode; `None` when the drive does not have it.
    pub const fn mode(&self, mode: AxisMode) -> Option<&ModeDescription> {
        match mode {
            AxisMode::Velocity => self.velocity.as_ref(),
            AxisMode::Torque => self.torque.as_ref(),
            AxisMode::Position => self.position.as_ref(),
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
pub fn quick_stop_increments_s2(axis: &DriveSettings) -> Option<u32> {
    let motor_rad_s2 = axis.quick_stop_rad_s2 * axis.gear.abs();
    let increments_s2 = motor_rad_s2 / TAU * f64::from(axis.increments_per_revolution);
    (1.0..=f64::from(u32::MAX))
        .contains(&increments_s2)
        .then_some(increments_s2 as u32)
}

/// Time for which the following error of a drive in position mode may be above its window, ms: a drive whose encoder jumps
/// is to stop before it moves.
const FOLLOWING_TIME_OUT_MS: u32 = 0;

/// Index of the interpolation period: its number in sub-index 1, and the power of ten in sub-index 2, s.
pub const INTERPOLATION_PERIOD: u16 = 0x60C2;

/// The interpolation period as the drive takes it: a number of at most 255 and the power of ten; `None` for a cycle that
/// has no such number.
pub(crate) fn interpolation_period(cycle_ns: u32) -> Option<[Setting; 2]> {
    let (mut number, mut exponent) = (cycle_ns, -9_i32);
    // 10 ms are ten milliseconds, not one hundredth of a second.
    while exponent < -3 && number > 0 && number.is_multiple_of(10) {
        (number, exponent) = (number / 10, exponent + 1);
    }
    let is_told = (1..=u32::from(u8::MAX)).contains(&number);
    is_told.then_some([
        Setting::new(INTERPOLATION_PERIOD, 1, number, 1),
        Setting::new(INTERPOLATION_PERIOD, 2, exponent.cast_unsigned(), 1),
    ])
}

/// Settings that tell a drive the cycle as its interpolation period; none for a cycle that has no such number. `None` if
/// the drive needs it, in position mode.
pub(crate) fn interpolation_settings(axis: &DriveSettings, cycle_ns: u32) -> Option<SettingList> {
    match interpolation_period(cycle_ns) {
        Some(settings) => SettingList::from_slice(&settings).ok(),
        None if axis.mode == AxisMode::Position => None,
        None => Some(SettingList::new()),
    }
}

/// Settings of a drive in position mode: the window of its own following-error supervision and its time-out. A drive
/// may lack them. `None` when the window does not fit 32 bits or is below 1 increment.
fn position_settings(axis: &DriveSettings) -> Option<[Setting; 2]> {
    let motor_rad = axis.following_error_max_rad * axis.gear.abs();
    let increments = motor_rad / TAU * f64::from(axis.increments_per_revolution);
    // The greatest number switches the supervision off.
    let fits = (1.0..f64::from(u32::MAX)).contains(&increments);
    fits.then(|| {
        [
            Setting::of(FOLLOWING_WINDOW, increments as u32, 4).optional(),
            Setting::of(FOLLOWING_TIME_OUT, FOLLOWING_TIME_OUT_MS, 2).optional(),
        ]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cycle_is_a_number_and_a_power_of_ten_or_refused() {
        for (cycle_ns, number, exponent) in [
            (1_000_000, 1, -3),
            (250_000, 25, -5),
            (62_500, 0, 0),
            (500_000, 5, -4),
            (10_000_000, 10, -3),
            (1, 1, -9),
            (0, 0, 0),
            (1_000_001, 0, 0),
        ] {
            let told = interpolation_period(cycle_ns).map(|settings| settings.map(|setting| setting.value));
            let expected = (number > 0).then_some([number, i32::cast_unsigned(exponent)]);
            assert_eq!(told, expected, "{cycle_ns} ns");
            let Some([number, exponent]) = told else { continue };
            let period_s = f64::from(number) * 10_f64.powi(exponent.cast_signed());
            assert!((period_s * 1.0e9 - f64::from(cycle_ns)).abs() < 1.0e-3, "{period_s} s");
        }
    }

    #[test]
    fn the_following_window_is_written_in_increments_and_bounded() {
        let mut axis = DriveSettings::default();
        // 0.05 rad at the joint are 0.6 rad, that is 0.0955 revolutions, at the motor.
        let [window, time_out] = position_settings(&axis).unwrap();
        assert_eq!((window.value, time_out.value), (100_131, 0));
        for unfit in [0.0, 1.0e9, f64::NAN] {
            axis.following_error_max_rad = unfit;
            assert_eq!(position_settings(&axis), None, "{unfit}");
        }
    }

    #[test]
    fn the_quick_stop_is_written_in_increments_and_bounded() {
        let mut axis = DriveSettings::default();
        // 100 rad/s2 at the joint are 1200 rad/s2, that is 190.99 revolutions/s2, at the motor.
        assert_eq!(quick_stop_increments_s2(&axis), Some(200_263_264));
        axis.quick_stop_rad_s2 = 1e9;
        assert_eq!(quick_stop_increments_s2(&axis), None);
        axis.quick_stop_rad_s2 = f64::NAN;
        assert_eq!(quick_stop_increments_s2(&axis), None);
    }

    #[test]
    fn assign_activate_tells_which_sync_signals_are_used() {
        assert!(Clocks::SYNC0.uses_sync0() && !Clocks::SYNC0.uses_sync1());
        let free_run = Clocks {
            assign_activate: 0,
            ..Clocks::SYNC0
        };
        assert!(!free_run.uses_sync0());
    }
}
