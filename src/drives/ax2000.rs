//! The AX2000-B110 servo drive (EtherCAT option of the AX2006) in digital speed.
//!
//! Process data are fixed objects of six bytes each way: velocity demand and control word out, position and status word
//! in. Layout and object numbers: the drive's public EtherCAT documentation.
//!
//! Invariant: exactly [`PROCESS_LENGTH`] bytes in each direction.

use super::{DriveDescription, DriveInput, DriveOutput, Setting, Settings};
use crate::config::Axis;
use crate::drives::cia402::StatusWord;
use core::f64::consts::TAU;

/// Vendor number.
pub const VENDOR: u32 = 0x0000_0002;
/// Product code.
pub const PRODUCT: u32 = 0x07D0_6014;
/// Bytes of process data in each direction.
pub const PROCESS_LENGTH: usize = 6;
/// Output object: velocity demand (INT32) and control word (UINT16).
pub const RX_PDO_VELOCITY: u16 = 0x1702;
/// Input object: position (INT32) and status word (UINT16).
pub const TX_PDO_POSITION: u16 = 0x1B01;
/// Operation mode (object 0x6060, INT8): digital speed.
pub const MODE_DIGITAL_SPEED: i8 = -2;

/// The description for the master.
pub const VELOCITY: DriveDescription = DriveDescription {
    name: "AX2000-B110",
    vendor: VENDOR,
    product: PRODUCT,
    output_start: 0x1100,
    output_length: PROCESS_LENGTH as u16,
    input_start: 0x1140,
    input_length: PROCESS_LENGTH as u16,
    settings,
    decode,
    encode,
};

/// Quick-stop deceleration as object 0x6085 takes it: position increments per second squared at the motor.
///
/// `None` when it does not fit 32 bits or is below 1.
pub fn quick_stop_increments_s2(axis: &Axis) -> Option<u32> {
    let motor_rad_s2 = axis.quick_stop_rad_s2 * axis.gear.abs();
    let increments_s2 = motor_rad_s2 / TAU * f64::from(axis.increments_per_revolution);
    (1.0..=f64::from(u32::MAX))
        .contains(&increments_s2)
        .then_some(increments_s2 as u32)
}

fn settings(axis: &Axis) -> Option<Settings> {
    let quick_stop = quick_stop_increments_s2(axis)?;
    let list = [
        Setting::new(0x1C12, 0, 0, 1).or_fixed(),
        Setting::new(0x1C12, 1, RX_PDO_VELOCITY as u32, 2).or_fixed(),
        Setting::new(0x1C12, 0, 1, 1).or_fixed(),
        Setting::new(0x1C13, 0, 0, 1).or_fixed(),
        Setting::new(0x1C13, 1, TX_PDO_POSITION as u32, 2).or_fixed(),
        Setting::new(0x1C13, 0, 1, 1).or_fixed(),
        Setting::new(0x6060, 0, MODE_DIGITAL_SPEED as u32, 1).shown_by(0x6061, 0),
        // Interpolation period: 1 times 10^-3 s.
        Setting::new(0x60C2, 1, 1, 1),
        Setting::new(0x60C2, 2, -3_i32 as u32, 1),
        Setting::new(0x6085, 0, quick_stop, 4).verified(),
    ];
    Settings::from_slice(&list).ok()
}

fn decode(bytes: &[u8]) -> Option<DriveInput> {
    let (position, rest) = bytes.split_first_chunk::<4>()?;
    let status = rest.first_chunk::<2>()?;
    Some(DriveInput {
        position: i32::from_le_bytes(*position),
        status: StatusWord(u16::from_le_bytes(*status)),
    })
}

fn encode(output: &DriveOutput, bytes: &mut [u8]) {
    let Some(target) = bytes.first_chunk_mut::<PROCESS_LENGTH>() else {
        return;
    };
    let [a, b, c, d] = output.velocity_digits.to_le_bytes();
    let [e, f] = output.control.0.to_le_bytes();
    *target = [a, b, c, d, e, f];
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drives::cia402::ControlWord;

    #[test]
    fn process_data_have_the_layout_of_the_objects() {
        let mut bytes = [0; PROCESS_LENGTH];
        encode(
            &DriveOutput {
                velocity_digits: -2,
                control: ControlWord(0x000F),
            },
            &mut bytes,
        );
        assert_eq!(bytes, [0xFE, 0xFF, 0xFF, 0xFF, 0x0F, 0x00]);
        let input = decode(&[0x00, 0x00, 0x10, 0x00, 0x37, 0x06]).unwrap();
        assert_eq!(
            input,
            DriveInput {
                position: 1 << 20,
                status: StatusWord(0x0637)
            }
        );
        assert_eq!(decode(&bytes[..5]), None);
    }

    #[test]
    fn the_quick_stop_is_written_in_increments_and_bounded() {
        let mut axis = Axis::default();
        // 100 rad/s2 at the joint are 1200 rad/s2, that is 190.99 revolutions/s2, at the motor.
        assert_eq!(quick_stop_increments_s2(&axis), Some(200_263_264));
        axis.quick_stop_rad_s2 = 1e9;
        assert_eq!(settings(&axis), None);
        axis.quick_stop_rad_s2 = f64::NAN;
        assert_eq!(settings(&axis), None);
    }
}
