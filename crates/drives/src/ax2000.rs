//! The AX2000-B110 servo drive (EtherCAT option of the AX2006) in digital speed and digital current.
//!
//! Its process data objects have fixed contents; one of each direction is assigned. Objects, modes and scales: the
//! drive's public EtherCAT documentation.
//!
//! It has no position mode here. The drive has one (mode -1), and the numbers of its objects suggest 0x1701 for it, but
//! no public source shows what 0x1701 holds, and whether a target counts one motor turn, as 0x6064 does, or all of them.
//! The public configurations of its sister, the SERVOSTAR 600, have 0x1702 and 0x1703 with the contents below, and no
//! other. A guess would move a motor.

use super::{
    CONTROL_WORD, Clocks, Digits, DriveDescription, DriveSettings, ModeDescription, POSITION, QUICK_STOP_DECELERATION,
    Recognition, STATUS_WORD, SettingList, TORQUE, interpolation_settings, quick_stop_increments_s2,
};
use etherpen_ethercat::driver::{Entry, PdoChoice, Setting, Windows};
use etherpen_ethercat::wire::coe::Object;

/// Digits of the current demand at the drive's peak current.
pub const PEAK_CURRENT_DIGITS: f64 = 3_280.0;

const SPEED_DEMAND: Object = Object::new(0x606B, 0);
const CURRENT_DEMAND: Object = Object::new(0x6074, 0);

/// Description of the drive for the master.
pub static AX2000: DriveDescription = DriveDescription {
    name: "AX2000-B110",
    recognition: Recognition::Product {
        vendor: 0x0000_0002,
        product: 0x07D0_6014,
    },
    velocity: Some(ModeDescription {
        operation_mode: -2,
        demand: SPEED_DEMAND,
        outputs: PdoChoice::fixed(0x1702, &[Entry::new(SPEED_DEMAND, 32), Entry::new(CONTROL_WORD, 16)]),
        inputs: PdoChoice::fixed(0x1B01, &[Entry::new(POSITION, 32), Entry::new(STATUS_WORD, 16)]),
        digits: Digits::Velocity,
    }),
    torque: Some(ModeDescription {
        operation_mode: -3,
        demand: CURRENT_DEMAND,
        outputs: PdoChoice::fixed(0x1703, &[Entry::new(CURRENT_DEMAND, 16), Entry::new(CONTROL_WORD, 16)]),
        inputs: PdoChoice::fixed(
            0x1B03,
            &[
                Entry::new(POSITION, 32),
                Entry::new(TORQUE, 16),
                Entry::new(STATUS_WORD, 16),
            ],
        ),
        digits: Digits::PeakCurrent(PEAK_CURRENT_DIGITS),
    }),
    position: None,
    windows: Windows::standard(0x1100, 0x1140),
    clocks: Clocks::SYNC0,
    settings,
};

fn settings(axis: &DriveSettings, cycle_ns: u32) -> Option<SettingList> {
    let quick_stop = quick_stop_increments_s2(axis)?;
    let mut settings = interpolation_settings(axis, cycle_ns)?;
    let ramp = Setting::of(QUICK_STOP_DECELERATION, quick_stop, 4).rounded();
    settings.push(ramp).ok()?;
    Some(settings)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peak_current_is_3280_digits() {
        let axis = DriveSettings::default();
        let peak_torque_nm = axis.peak_current_a * axis.torque_constant_nm_a;
        assert!((peak_torque_nm * Digits::PeakCurrent(PEAK_CURRENT_DIGITS).per_unit(&axis) - 3_280.0).abs() < 1.0e-9);
    }

    #[test]
    fn one_revolution_per_minute_is_139_81_digits() {
        let digits = Digits::Velocity.per_unit(&DriveSettings::default()) * core::f64::consts::TAU / 60.0;
        assert!((digits - 262_144.0 / 1_875.0).abs() < 1.0e-9);
    }

    #[test]
    fn a_setting_that_does_not_fit_its_object_refuses_all() {
        let axis = DriveSettings {
            quick_stop_rad_s2: 1.0e9,
            ..DriveSettings::default()
        };
        assert_eq!(settings(&axis, 1_000_000), None);
    }
}
