//! Position mode with faults: what the motors and the ink do when targets are missing, late or false, and afterwards.

use crate::feedback::{apart_mm, with};
use crate::robot::Robot;
use crate::{STILL_RAD_S, assert_described_standstill, assert_recovers_and_draws};
use etherpen::application::{Fault, Mode};
use etherpen::config::{AxisMode, Config};
use etherpen::messages::Command;
use host_tools::cell::{DriveState, Fault as CellFault, InkStroke, ResolverFault};

/// Speeds of the pen on the paper, mm/s: slow, and the fastest that the drawing reaches.
const SPEEDS_MM_S: [f64; 2] = [60.0, 400.0];
/// How far ink may be from the ink of a sound robot after single lost targets, mm: the drives extrapolate.
const EXTRAPOLATED_MM: f64 = 0.07;
/// Longest distance of ink after three lost targets in a row, mm: the drives stand for two of them at 400 mm/s.
const HELD_MM: f64 = 1.2;
/// Distance of ink from the same strokes of a sound robot after a fault that stopped the robot, mm, besides half the
/// distance of two points of ink.
const AFTERWARDS_MM: f64 = 0.03;

fn config(speed_mm_s: f64) -> Config {
    let mut config = with(AxisMode::Position, 250.0);
    config.motion.speed_mm_s = speed_mm_s;
    config
}

fn finish(robot: &mut Robot) {
    robot.run_until("the path is executed", Robot::has_drawn);
}

/// The ink of a sound robot.
fn sound(config: &Config) -> Vec<InkStroke> {
    let mut robot = Robot::idle_with(config).in_a_drawing();
    finish(&mut robot);
    assert_eq!(robot.fault(), None);
    robot.ink()
}

#[test]
fn enabling_and_holding_moves_no_joint_and_a_pushed_target_is_not_taken_over() {
    let mut robot = Robot::of(&config(250.0), host_tools::cell::CellOptions::default());
    robot.configure(&config(250.0));
    robot.wait_for(Mode::DrivesOff);
    robot.command(Command::Home).unwrap();
    robot.run(100);
    let before = robot.cell().joints;
    robot.command(Command::Enable).unwrap();
    let mut fastest_rad_s = 0.0_f64;
    for _ in 0..3_000 {
        robot.run(1);
        fastest_rad_s = fastest_rad_s.max(robot.speed_rad_s());
    }
    assert_eq!((robot.mode(), robot.fault()), (Mode::Idle, None));
    println!("fastest {fastest_rad_s:.6} rad/s while enabling");
    assert!(fastest_rad_s < 2e-3, "{fastest_rad_s} rad/s");
    for (after, before) in robot.cell().joints.0.iter().zip(before.0) {
        assert!((after - before).abs() < 1e-5, "{after} rad, {before} rad before");
    }
}

#[test]
fn single_lost_targets_leave_no_trace_because_the_drives_extrapolate() {
    for speed_mm_s in SPEEDS_MM_S {
        let config = config(speed_mm_s);
        let expected = sound(&config);
        let mut robot = Robot::idle_with(&config).in_a_drawing();
        let mut lost = 0;
        while !robot.has_drawn() {
            robot.inject(CellFault::Stall(1));
            robot.run(37);
            lost += 1;
            assert!(lost < 2_000 && robot.fault().is_none(), "{:?}", robot.fault());
        }
        let apart_mm = apart_mm(&robot.ink(), &expected);
        println!("{speed_mm_s} mm/s, {lost} frames lost: ink {apart_mm:.4} mm from that of a sound robot");
        assert!(lost > 10 && apart_mm < EXTRAPOLATED_MM, "{apart_mm} mm");
    }
}

#[test]
fn three_lost_targets_in_a_row_let_the_drives_stand_for_a_moment_and_the_drawing_goes_on() {
    for speed_mm_s in SPEEDS_MM_S {
        let config = config(speed_mm_s);
        let expected = sound(&config);
        let mut robot = Robot::idle_with(&config).in_a_drawing();
        robot.inject(CellFault::Stall(3));
        finish(&mut robot);
        assert_eq!(robot.fault(), None);
        let apart_mm = apart_mm(&robot.ink(), &expected);
        println!("{speed_mm_s} mm/s: ink {apart_mm:.4} mm from that of a sound robot");
        assert!(apart_mm < HELD_MM, "{apart_mm} mm");
    }
}

/// Whether a fault is one that a disturbance may lead to.
type IsExpected = fn(&Fault) -> bool;

#[test]
fn whatever_stops_the_robot_in_position_mode_the_next_drawing_comes_out_right() {
    let faults: [(&str, CellFault, IsExpected); 6] = [
        ("frames stalled", CellFault::Stall(300), |fault| {
            matches!(
                fault,
                Fault::Blind { .. } | Fault::SlaveState { .. } | Fault::SlaveLost { .. }
            )
        }),
        ("drive fault", CellFault::Drive(2, 0x2310), |fault| {
            matches!(fault, Fault::Drive { axis: 1, .. })
        }),
        ("mains lost", CellFault::Mains(1, 400), |fault| {
            matches!(fault, Fault::Drive { axis: 0, .. })
        }),
        ("power-cycled", CellFault::Power(3, 800), |fault| {
            matches!(
                fault,
                Fault::SlaveLost { slave: 2 } | Fault::SlaveState { .. } | Fault::Drive { .. }
            )
        }),
        ("processor stands", CellFault::Processor(2, 400), |fault| {
            matches!(
                fault,
                Fault::FeedbackDeviation { .. } | Fault::ProcessorStopped { .. } | Fault::Drive { .. }
            )
        }),
        (
            "frozen feedback",
            CellFault::Resolver(1, ResolverFault::Stuck, 600),
            |fault| {
                matches!(
                    fault,
                    Fault::FeedbackDeviation { axis: 0, .. } | Fault::Drive { axis: 0, .. }
                )
            },
        ),
    ];
    for speed_mm_s in SPEEDS_MM_S {
        let config = config(speed_mm_s);
        let expected = sound(&config);
        for (what, fault, is_expected) in faults {
            let mut robot = Robot::idle_with(&config).in_a_drawing();
            robot.inject(fault);
            assert_described_standstill(&mut robot, is_expected);
            println!("{speed_mm_s} mm/s, {what}: {:?}", robot.fault());
            robot.run(15_000);
            if !robot.status.as_ref().unwrap().referenced {
                // The marks are within half a motor turn: the operator takes the reference there.
                let pose = robot.cell().joints;
                robot.command(Command::Acknowledge).unwrap();
                robot.wait_for(Mode::DrivesOff);
                robot.command(Command::HomeAt { pose, position: None }).unwrap();
                robot.run(100);
                robot.command(Command::Enable).unwrap();
                robot.wait_for(Mode::Idle);
                robot.command(Command::Stop).unwrap();
                robot.wait_for(Mode::Fault);
                robot.run(100);
            }
            let strokes = robot.ink().len();
            assert_recovers_and_draws(&mut robot);
            let apart_mm = apart_mm(&robot.ink()[strokes..], &expected);
            println!("{speed_mm_s} mm/s, {what}: the next drawing is {apart_mm:.4} mm from that of a sound robot");
            let limit_mm = AFTERWARDS_MM + 0.5e-3 * speed_mm_s;
            assert!(apart_mm < limit_mm, "{what}: {apart_mm} mm");
        }
    }
}

#[test]
fn a_stop_and_a_hold_end_at_rest_with_the_targets_where_the_motors_are() {
    for speed_mm_s in SPEEDS_MM_S {
        let config = config(speed_mm_s);
        let mut robot = Robot::idle_with(&config).in_a_drawing();
        robot.command(Command::Hold).unwrap();
        robot.run(2_000);
        assert_eq!(robot.mode(), Mode::Holding);
        let held = robot.cell().joints;
        robot.run(2_000);
        for (after, before) in robot.cell().joints.0.iter().zip(held.0) {
            assert!((after - before).abs() < 1e-6, "{after} rad, {before} rad before");
        }
        robot.command(Command::Resume).unwrap();
        robot.run_until("the pen moves", |robot| robot.speed_rad_s() > 0.02);
        robot.command(Command::Stop).unwrap();
        robot.wait_for(Mode::Fault);
        robot.run(300);
        assert!(robot.speed_rad_s() < STILL_RAD_S);
        let states = robot.cell().slaves;
        assert!(states.iter().all(|slave| slave.drive != DriveState::OperationEnabled));
        assert_recovers_and_draws(&mut robot);
    }
}
