//! A drive's states, speeds, torque and position.

use super::velocity_loop::{LOOP_STEP_S, LOOP_STEPS, PiLoop};
use super::*;

fn drive() -> Drive {
    Drive::new(&DriveOptions::default(), 0)
}

fn hold(drive: &mut Drive, control: u16, velocity_digits: i32, milliseconds: u32) {
    for _ in 0..milliseconds {
        drive.step(Some(Demand {
            velocity_digits,
            control,
            ..Demand::default()
        }));
    }
}

fn enabled() -> Drive {
    let mut drive = drive();
    drive.mode = MODE_DIGITAL_SPEED;
    for control in [0x06, 0x07, 0x0F] {
        hold(&mut drive, control, 0, 2);
    }
    drive
}

#[test]
fn three_control_words_enable_the_drive_one_state_at_a_time() {
    let mut drive = drive();
    assert_eq!(drive.status() & 0x4F, 0x40);
    for (control, mask, bits) in [(0x06, 0x6F, 0x21), (0x07, 0x6F, 0x23), (0x0F, 0x6F, 0x27)] {
        hold(&mut drive, control, 0, 2);
        assert_eq!(drive.status() & mask, bits, "control word {control:#x}");
    }
}

#[test]
fn the_status_word_changes_only_every_second_millisecond() {
    let mut drive = drive();
    hold(&mut drive, 0, 0, 1);
    let before = drive.status();
    hold(&mut drive, 0x06, 0, 1);
    assert_eq!(drive.status(), before);
    hold(&mut drive, 0x06, 0, 1);
    assert_eq!(drive.status() & 0x6F, 0x21);
}

#[test]
fn a_velocity_of_one_turn_a_second_is_the_documented_number_of_digits() {
    let mut drive = enabled();
    let digits = (60.0 * 262_144.0 / 1_875.0) as i32;
    hold(&mut drive, 0x0F, digits, 200);
    let start = drive.motor.angle_rad();
    hold(&mut drive, 0x0F, digits, 1000);
    assert!(((drive.motor.angle_rad() - start) / TAU - 1.0).abs() < 1e-4);
    assert!((drive.motor.speed_rad_s() - TAU).abs() < 1e-3);
}

#[test]
fn no_demand_moves_the_motor_faster_than_it_can() {
    let mut drive = enabled();
    hold(&mut drive, 0x0F, i32::MIN, 1000);
    let limit_rad_s = -SPEED_MAX_RPM / 60.0 * TAU;
    assert!(
        (drive.motor.speed_rad_s() - limit_rad_s).abs() < 1e-5,
        "{}",
        drive.motor.speed_rad_s()
    );
}

#[test]
fn a_mode_without_velocity_does_not_move() {
    let mut drive = enabled();
    drive.mode = -1;
    hold(&mut drive, 0x0F, 100_000, 100);
    assert_eq!(drive.velocity_digits(), 0);
}

#[test]
fn a_quick_stop_ramps_down_with_the_written_deceleration() {
    let mut drive = enabled();
    hold(&mut drive, 0x0F, 100_000, 100);
    let increments_per_digit = f64::from(1 << 20) / (60.0 * 262_144.0 / 1_875.0);
    drive.quick_stop_increments_s2 = (1_000_000.0 * increments_per_digit) as u32;
    let mut milliseconds = 0;
    while drive.state() != DriveState::SwitchOnDisabled && milliseconds < 1000 {
        hold(&mut drive, 0x02, 100_000, 1);
        milliseconds += 1;
    }
    assert!((100..=102).contains(&milliseconds), "{milliseconds} ms");
    assert!(drive.motor.is_still());
}

#[test]
fn a_fault_stops_tells_and_needs_a_rising_edge() {
    let mut drive = enabled();
    hold(&mut drive, 0x8F, 50_000, 50);
    drive.fault(0x2310);
    assert_eq!(drive.take_emergency(), Some(0x2310));
    hold(&mut drive, 0x80, 0, 500);
    assert_eq!((drive.state(), drive.status() & 0x4F), (DriveState::Fault, 0x08));
    assert_eq!(drive.error_code(), 0x2310);
    hold(&mut drive, 0x00, 0, 2);
    hold(&mut drive, 0x80, 0, 2);
    assert_eq!((drive.state(), drive.error_code()), (DriveState::SwitchOnDisabled, 0));
    assert_eq!(drive.take_emergency(), Some(0));
}

#[test]
fn without_main_voltage_the_drive_is_never_ready() {
    let mut drive = drive();
    drive.set_mains(false);
    hold(&mut drive, 0x06, 0, 10);
    assert_eq!(drive.status() & 0x50, 0x40);
}

#[test]
fn the_resolver_shows_one_turn_and_the_mark_where_it_was_set() {
    let options = DriveOptions {
        zero_increments: 1000,
        ..DriveOptions::default()
    };
    assert_eq!(Drive::new(&options, 0).position(), 1000);
    let around = DriveOptions {
        angle_rad: -TAU / 4.0,
        ..options
    };
    let around = Drive::new(&around, 0);
    assert!((around.position() - (1000 + (1 << 20) * 3 / 4)).abs() <= 1);
}

fn pi() -> DriveOptions {
    DriveOptions {
        velocity_loop: VelocityLoop::Pi(PiLoop {
            bandwidth_hz: 50.0,
            integral_ms: 20.0,
            inertia_kg_m2: 1.5e-3,
            current_hz: 800.0,
            speed_filter_hz: 300.0,
        }),
        ..DriveOptions::default()
    }
}

/// Lets a drive turn an inertia of 1.5e-3 kg m2 against a constant torque, with this demand.
fn turn(drive: &mut Drive, control: u16, velocity_digits: i32, load_nm: f64, milliseconds: u32) {
    for _ in 0..milliseconds {
        hold(drive, control, velocity_digits, 1);
        for _ in 0..LOOP_STEPS {
            drive.regulate();
            if drive.is_moved_by_load() {
                let rad_s2 = (drive.true_torque_nm() - load_nm) / 1.5e-3;
                drive.motor_mut().accelerate(rad_s2, LOOP_STEP_S);
            }
        }
    }
}

fn enabled_pi(options: &DriveOptions) -> Drive {
    let mut drive = Drive::new(options, 0);
    drive.mode = MODE_DIGITAL_SPEED;
    for control in [0x06, 0x07, 0x0F] {
        turn(&mut drive, control, 0, 0.0, 2);
    }
    drive
}

#[test]
fn a_pi_drive_follows_its_demand_against_a_load_and_shows_the_torque() {
    let mut drive = enabled_pi(&pi());
    let digits = (60.0 * 262_144.0 / 1_875.0) as i32;
    turn(&mut drive, 0x0F, digits, 0.5, 1_000);
    assert!((drive.motor.speed_rad_s() - TAU).abs() < 1e-3);
    assert!((f64::from(drive.torque_digits()) * drive.torque_nm_per_digit() - 0.5).abs() < 0.01);
}

#[test]
fn a_pi_drive_stops_on_its_ramp_under_load_and_its_brake_then_holds() {
    let mut drive = enabled_pi(&pi());
    let digits = (1_000.0 * 262_144.0 / 1_875.0) as i32;
    turn(&mut drive, 0x0F, digits, 0.5, 1_000);
    let (start_rad_s, start_rad) = (drive.motor.speed_rad_s(), drive.motor.angle_rad());
    turn(&mut drive, 0x02, digits, 0.5, 200);
    assert_eq!(drive.state(), DriveState::SwitchOnDisabled);
    assert!(drive.motor.is_still() && drive.motor.torque_nm() == 0.0);
    let way_rad = drive.motor.angle_rad() - start_rad;
    let ramp_rad = start_rad_s * start_rad_s / (2.0 * 1_200.0);
    assert!(
        (way_rad / ramp_rad - 1.0).abs() < 0.1,
        "{way_rad} rad instead of {ramp_rad} rad"
    );
    turn(&mut drive, 0x00, 0, 0.5, 100);
    assert!(
        (drive.motor.angle_rad() - start_rad - way_rad).abs() < 1e-9,
        "the brake holds"
    );
}

#[test]
fn the_shown_torque_is_wrong_by_its_scale_and_its_offset() {
    let options = DriveOptions {
        torque_scale: 1.05,
        torque_offset_nm: 0.05,
        ..pi()
    };
    let mut drive = enabled_pi(&options);
    turn(&mut drive, 0x0F, 10_000, 0.5, 1_000);
    assert!((drive.true_torque_nm() - 0.5).abs() < 0.01);
    let shown_nm = f64::from(drive.torque_digits()) * drive.torque_nm_per_digit();
    assert!((shown_nm - (0.5 / 1.05 + 0.05)).abs() < 0.01, "{shown_nm} N m");
}

#[test]
fn a_coarse_resolver_shows_whole_steps_of_its_own() {
    for angle in -50..50 {
        let angle_rad = f64::from(angle) * 0.137;
        let options = DriveOptions {
            resolver_bits: 16,
            angle_rad,
            ..DriveOptions::default()
        };
        let coarse = Drive::new(&options, 0).position();
        let fine = Drive::new(
            &DriveOptions {
                resolver_bits: 20,
                ..options
            },
            0,
        )
        .position();
        assert_eq!(coarse % 16, 0);
        assert!((0..16).contains(&(fine - coarse)), "{angle_rad} rad: {fine} {coarse}");
    }
}
