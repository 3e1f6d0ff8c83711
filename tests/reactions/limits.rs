//! Limit switches: one that opens in operation stops the drives, whatever the machine does; homing is not disturbed by them.

use crate::robot::Robot;
use crate::{STILL_RAD_S, assert_described_standstill, assert_recovers_with};
use etherpen::application::{Fault, InputCause, Mode};
use etherpen::config::{Config, IoDirection, IoError, IoPoint, IoRole};
use etherpen::messages::{Command, PathVertex};
use etherpen::motion::Pen;
use host_tools::cell::{CellOptions, Fault as CellFault};
use host_tools::settings::machines::MACHINES;

/// The terminal with the inputs, from 1.
const TERMINAL: usize = 2;
/// Inputs of the CoreXY when all contacts are closed: emergency stop and three limit switches.
const CLOSED: u8 = 0b1111;
/// Longest time from a contact that opens to the first sign of braking at a motor, ms: the terminal's input, the exchange
/// and the drive.
const BRAKES_WITHIN_MS: u32 = 8;

fn limit(name: &str, bit: u16, axis: u8) -> IoPoint {
    IoPoint {
        name: name.try_into().unwrap(),
        slave: TERMINAL as u8 - 1,
        direction: IoDirection::In,
        bit: Some(bit),
        role: IoRole::Limit,
        axis: Some(axis),
        ..IoPoint::default()
    }
}

/// A CoreXY with limit switches of its belts beside the emergency stop.
fn corexy(speed_mm_s: f64) -> Config {
    let mut config = MACHINES[2].load().unwrap();
    config.motion.speed_mm_s = speed_mm_s;
    config.io.push(limit("a_low", 1, 0)).unwrap();
    config.io.push(limit("a_high", 2, 0)).unwrap();
    config.io.push(limit("b_high", 3, 1)).unwrap();
    assert_eq!(config.check_io(), Ok(()));
    config
}

/// A long line.
fn path() -> Vec<PathVertex> {
    let vertex = |x_um: i32, z_um: i32, pen: Pen| PathVertex {
        position_um: [x_um, 10_000, z_um],
        pen,
        stroke: 0,
    };
    vec![
        vertex(-80_000, 0, Pen::Up),
        vertex(-80_000, -2_000, Pen::Up),
        vertex(80_000, -2_000, Pen::Down),
        vertex(80_000, 0, Pen::Up),
    ]
}

fn drawing(config: &Config) -> Robot {
    let mut robot = Robot::idle_with(config);
    robot.draw(path());
    robot.run_until("the pen draws", |robot| {
        robot.cell().pen_touches && robot.speed_rad_s() > 0.05
    });
    robot.run(200);
    robot
}

#[test]
pub(crate) fn a_limit_switch_that_opens_while_drawing_stops_the_motors_and_names_its_axis() {
    for speed_mm_s in [20.0, 200.0] {
        for (bit, io, axis) in [(1, 2, 0), (3, 4, 1)] {
            let config = corexy(speed_mm_s);
            let mut robot = drawing(&config);
            let speed = robot.speed_rad_s();
            robot.set_inputs(TERMINAL, CLOSED & !(1 << bit));
            let mut ms = 0;
            while robot.speed_rad_s() > 0.95 * speed {
                robot.run(1);
                ms += 1;
                assert!(ms <= BRAKES_WITHIN_MS, "{speed_mm_s} mm/s: the motors do not brake");
            }
            println!("{speed_mm_s} mm/s: the motors brake after {ms} ms");
            assert_described_standstill(&mut robot, |fault| *fault == Fault::LimitSwitch { axis, io });
            // The axis is still at its switch: it gets power, and is jogged off.
            assert_recovers_with(&mut robot, |_| {});
            let before = robot.cell().joints.0;
            for _ in 0..20 {
                robot.send(Command::Jog {
                    velocity_mm_s: [-20.0, 0.0, 0.0],
                });
                robot.run(40);
            }
            robot.run(400);
            let moved_rad = robot.cell().joints.0[0] - before[0];
            assert!(moved_rad < -0.05, "jogged by {moved_rad} rad");
            robot.set_inputs(TERMINAL, CLOSED);
            robot.run(100);
            assert_eq!((robot.mode(), robot.fault()), (Mode::Idle, None));
            robot.draw(path());
            robot.run_until("drawn", |robot| robot.ack.finished && robot.mode() == Mode::Idle);
            // The contact works again: the next opening is a fault as the first one was, at rest as well.
            robot.set_inputs(TERMINAL, CLOSED & !(1 << bit));
            assert_described_standstill(&mut robot, |fault| *fault == Fault::LimitSwitch { axis, io });
        }
    }
}

#[test]
pub(crate) fn a_terminal_of_limit_switches_that_fails_is_a_fault() {
    let mut robot = drawing(&corexy(200.0));
    robot.inject(CellFault::Power(TERMINAL, 800));
    assert_described_standstill(&mut robot, |fault| {
        let is_missing = |cause: &InputCause| *cause == InputCause::Missing;
        matches!(fault, Fault::StopInput { cause, .. } if is_missing(cause))
            || matches!(
                fault,
                Fault::SlaveLost { slave: 1 } | Fault::SlaveState { .. } | Fault::Blind { .. }
            )
    });
    robot.run(2_000);
    assert_recovers_with(&mut robot, |_| {});
}

#[test]
pub(crate) fn homing_takes_no_notice_of_limit_switches_and_motion_after_it_does() {
    let mut config = MACHINES[1].load().unwrap();
    config.io.push(limit("x_end", 3, 0)).unwrap();
    let mut robot = Robot::of(&config, CellOptions::default());
    robot.configure(&config);
    robot.wait_for(Mode::DrivesOff);
    robot.command(Command::Enable).unwrap();
    robot.wait_for(Mode::Unreferenced);
    robot.command(Command::Home).unwrap();
    robot.run_until("an axis moves", |robot| robot.speed_rad_s() > 0.05);
    robot.set_inputs(TERMINAL, 0b0111);
    robot.run(200);
    assert_eq!((robot.mode(), robot.fault()), (Mode::Homing, None));
    robot.set_inputs(TERMINAL, 0b1111);
    robot.run_until("homed", |robot| robot.mode() == Mode::Idle);
    robot.set_inputs(TERMINAL, 0b0111);
    assert_described_standstill(&mut robot, |fault| *fault == Fault::LimitSwitch { axis: 0, io: 3 });
    assert!(robot.speed_rad_s() < STILL_RAD_S);
}

#[test]
pub(crate) fn a_limit_switch_without_an_axis_of_the_machine_is_refused() {
    let mut config = corexy(200.0);
    config.io[3].axis = Some(2);
    assert_eq!(config.check_io(), Err(IoError::LimitAxis { io: 3, axes: 2 }));
    config.io[3].axis = None;
    assert_eq!(config.check_io(), Err(IoError::LimitAxis { io: 3, axes: 2 }));
    let mut config = corexy(200.0);
    config.io[0].axis = Some(0);
    assert_eq!(config.check_io(), Err(IoError::LimitAxis { io: 0, axes: 2 }));
}
