//! Any servo drive of CiA 402 in cyclic synchronous velocity, torque and position.
//!
//! Used for every product that has no description of its own and reports in object 0x1000 that it is a servo drive of
//! profile 402, servo or stepper. The entries below are mapped into the first process data object of each direction. A
//! drive that keeps its own mapping is used if the mapping contains the required objects. Objects, modes and units:
//! CiA 402; a torque digit is a thousandth of the motor's rated torque, velocity digits are as configured.

use super::{
    AxisMode, CONTROL_WORD, Clocks, Digits, DriveDescription, DriveSettings, ModeDescription, OPERATION_MODE_DISPLAY,
    POSITION, QUICK_STOP_DECELERATION, Recognition, STATUS_WORD, SettingList, TARGET_POSITION, TORQUE, VELOCITY_OFFSET,
    interpolation_settings, position_settings, quick_stop_increments_s2,
};
use etherpen_ethercat::driver::{Entry, PdoChoice, Setting, Windows};
use etherpen_ethercat::wire::coe::Object;

/// Device type of a servo drive: profile 402, servo.
pub const DEVICE_TYPE_SERVO: u32 = 0x0002_0192;
/// Mode of operation: cyclic synchronous position.
pub const CYCLIC_POSITION: i8 = 8;
/// Mode of operation: cyclic synchronous velocity.
pub const CYCLIC_VELOCITY: i8 = 9;
/// Mode of operation: cyclic synchronous torque.
pub const CYCLIC_TORQUE: i8 = 10;
/// Target velocity, 32 bits.
pub const TARGET_VELOCITY: Object = Object::new(0x60FF, 0);
/// Target torque, 16 bits.
pub const TARGET_TORQUE: Object = Object::new(0x6071, 0);

/// Quick-stop option: slow down with the quick-stop ramp, then switch off.
const QUICK_STOP_RAMP_THEN_OFF: u32 = 2;
/// Digits of rated torque.
const RATED_TORQUE_DIGITS: f64 = 1_000.0;

/// Description of the drive for the master.
pub static GENERIC: DriveDescription = DriveDescription {
    name: "CiA 402 servo drive",
    recognition: Recognition::DeviceType(DEVICE_TYPE_SERVO),
    velocity: Some(ModeDescription {
        operation_mode: CYCLIC_VELOCITY,
        demand: TARGET_VELOCITY,
        outputs: PdoChoice::written(0x1600, &[Entry::new(CONTROL_WORD, 16), Entry::new(TARGET_VELOCITY, 32)]),
        inputs: PdoChoice::written(
            0x1A00,
            &[
                Entry::new(STATUS_WORD, 16),
                Entry::new(POSITION, 32),
                Entry::new(OPERATION_MODE_DISPLAY, 8),
            ],
        ),
        digits: Digits::Velocity,
    }),
    torque: Some(ModeDescription {
        operation_mode: CYCLIC_TORQUE,
        demand: TARGET_TORQUE,
        outputs: PdoChoice::written(0x1600, &[Entry::new(CONTROL_WORD, 16), Entry::new(TARGET_TORQUE, 16)]),
        inputs: PdoChoice::written(
            0x1A00,
            &[
                Entry::new(STATUS_WORD, 16),
                Entry::new(POSITION, 32),
                Entry::new(TORQUE, 16),
                Entry::new(OPERATION_MODE_DISPLAY, 8),
            ],
        ),
        digits: Digits::RatedTorque(RATED_TORQUE_DIGITS),
    }),
    position: Some(ModeDescription {
        operation_mode: CYCLIC_POSITION,
        demand: VELOCITY_OFFSET,
        outputs: PdoChoice::written(
            0x1600,
            &[
                Entry::new(CONTROL_WORD, 16),
                Entry::new(TARGET_POSITION, 32),
                Entry::new(VELOCITY_OFFSET, 32),
            ],
        ),
        inputs: PdoChoice::written(
            0x1A00,
            &[
                Entry::new(STATUS_WORD, 16),
                Entry::new(POSITION, 32),
                Entry::new(OPERATION_MODE_DISPLAY, 8),
            ],
        ),
        digits: Digits::Velocity,
    }),
    windows: Windows::standard(0x1100, 0x1400),
    clocks: Clocks::SYNC0,
    settings,
};

/// Quick stop and period, and the supervision of the position in position mode; in the profile all of these objects but
/// the ramp are optional.
pub(super) fn settings(axis: &DriveSettings, cycle_ns: u32) -> Option<SettingList> {
    let quick_stop = quick_stop_increments_s2(axis)?;
    let mut settings = interpolation_settings(axis, cycle_ns)?;
    settings.iter_mut().for_each(|setting| *setting = setting.optional());
    let list = [
        Setting::new(0x605A, 0, QUICK_STOP_RAMP_THEN_OFF, 2).optional(),
        Setting::of(QUICK_STOP_DECELERATION, quick_stop, 4).rounded(),
    ];
    settings.extend_from_slice(&list).ok()?;
    if axis.mode == AxisMode::Position {
        settings.extend_from_slice(&position_settings(axis)?).ok()?;
    }
    Some(settings)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rated_torque_is_1000_digits() {
        let axis = DriveSettings::default();
        assert!(
            (axis.rated_torque_nm * Digits::RatedTorque(RATED_TORQUE_DIGITS).per_unit(&axis) - 1_000.0).abs() < 1.0e-9
        );
    }
}
