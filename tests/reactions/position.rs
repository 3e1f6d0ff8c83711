//! Position mode with faults: what the motors and the ink do when targets are missing, late or false, and afterwards.

use crate::feedback::{apart_mm, with};
use crate::liveness::come_back;
use crate::robot::Robot;
use crate::{STILL_RAD_S, assert_described_standstill, assert_recovers_and_draws, path};
use etherpen::application::{Fault, Mode};
use etherpen::config::{AxisMode, Config};
use etherpen::messages::Command;
use etherpen::robots::AXES;
use host_tools::cell::{
    CellOptions, DriveState, Fault as CellFault, InkStroke, OneTurn, PlaceOptions, Product, ResolverFault,
};
use std::f64::consts::TAU;

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
pub(crate) fn enabling_and_holding_moves_no_joint_and_a_pushed_target_is_not_taken_over() {
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
pub(crate) fn single_lost_targets_leave_no_trace_because_the_drives_extrapolate() {
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
pub(crate) fn three_lost_targets_in_a_row_let_the_drives_stand_for_a_moment_and_the_drawing_goes_on() {
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
pub(crate) fn whatever_stops_the_robot_in_position_mode_the_next_drawing_comes_out_right() {
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
pub(crate) fn a_drive_replaced_by_another_of_its_kind_is_homed_and_draws() {
    let config = config(SPEEDS_MM_S[0]);
    for slave in [1, 4] {
        let mut robot = Robot::idle_with(&config).in_a_drawing();
        robot.inject(CellFault::Swap(slave, Product::Cia402));
        robot.run_until("a fault is told", |robot| robot.mode() == Mode::Fault);
        robot.run(1_000);
        come_back(&mut robot, 2);
    }
}

#[test]
pub(crate) fn a_stop_and_a_hold_end_at_rest_with_the_targets_where_the_motors_are() {
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

/// Drives that count one motor turn only.
fn one_turn(one_turn: OneTurn) -> CellOptions {
    let place = PlaceOptions {
        one_turn: Some(one_turn),
        ..PlaceOptions::default()
    };
    CellOptions {
        places: vec![place; AXES],
        ..CellOptions::default()
    }
}

/// Joint angles at which the joints pass an end of their drives' turns in a drawing, with the configuration for them: the
/// angles half-way through a drawing.
fn with_ends_in_a_drawing(speed_mm_s: f64) -> (Config, [f64; AXES]) {
    let mut config = config(speed_mm_s);
    let mut robot = Robot::idle_with(&config).in_a_drawing();
    let mut least = robot.cell().joints.0;
    let mut most = least;
    while !robot.has_drawn() {
        robot.run(1);
        for (axis, angle_rad) in robot.cell().joints.0.into_iter().enumerate() {
            least[axis] = least[axis].min(angle_rad);
            most[axis] = most[axis].max(angle_rad);
        }
    }
    let ends: [f64; AXES] = std::array::from_fn(|axis| (least[axis] + most[axis]) / 2.0);
    for (axis, end_rad) in config.axes.iter_mut().zip(ends) {
        let turns = (axis.sync_angle_rad - end_rad) * axis.gear / TAU;
        let increments = f64::from(axis.increments_per_revolution);
        axis.sync_increments = (turns.rem_euclid(1.0) * increments) as i32;
    }
    (config, ends)
}

#[test]
pub(crate) fn drives_that_count_one_turn_draw_across_its_end_as_those_that_count_all_turns() {
    for speed_mm_s in SPEEDS_MM_S {
        let (config, ends) = with_ends_in_a_drawing(speed_mm_s);
        let expected = sound(&config);
        let mut robot = Robot::of(&config, one_turn(OneTurn::Told)).enabled().in_a_drawing();
        let mut passes = [0; AXES];
        let mut before = robot.cell().joints.0;
        while !robot.has_drawn() {
            robot.run(1);
            let now = robot.cell().joints.0;
            for axis in 0..AXES {
                passes[axis] += u32::from((before[axis] < ends[axis]) != (now[axis] < ends[axis]));
            }
            before = now;
        }
        assert_eq!(robot.fault(), None);
        let apart_mm = apart_mm(&robot.ink(), &expected);
        println!("{speed_mm_s} mm/s: ends passed {passes:?} times, ink {apart_mm:.4} mm from that of other drives");
        assert!(passes[..3].iter().all(|passes| *passes > 0), "{passes:?}");
        let limit_mm = AFTERWARDS_MM + 0.5e-3 * speed_mm_s;
        assert!(apart_mm < limit_mm, "{apart_mm} mm");
    }
}

#[test]
pub(crate) fn drives_that_hold_at_the_end_of_their_turn_stay_there_whatever_is_missing() {
    let (config, ends) = with_ends_in_a_drawing(SPEEDS_MM_S[0]);
    let mut robot = Robot::of(&config, one_turn(OneTurn::Told)).enabled().in_a_drawing();
    robot.run_until("an arm is at the end of its turn", |robot| {
        let joints = robot.cell().joints.0;
        (0..3).any(|axis| (joints[axis] - ends[axis]).abs() < 1e-3)
    });
    robot.command(Command::Hold).unwrap();
    robot.run(2_000);
    assert_eq!((robot.mode(), robot.fault()), (Mode::Holding, None));
    let held = robot.cell().joints.0;
    robot.inject(CellFault::Stall(3));
    robot.run(500);
    for (after, before) in robot.cell().joints.0.iter().zip(held) {
        assert!((after - before).abs() < 1e-5, "{after} rad, {before} rad before");
    }
    robot.command(Command::Resume).unwrap();
    finish(&mut robot);
    assert_eq!(robot.fault(), None);
}

#[test]
pub(crate) fn a_drive_that_does_not_tell_that_it_counts_one_turn_stops_the_robot_at_its_end() {
    for speed_mm_s in SPEEDS_MM_S {
        let (config, ends) = with_ends_in_a_drawing(speed_mm_s);
        let mut robot = Robot::of(&config, one_turn(OneTurn::Untold)).enabled();
        robot.draw(path());
        robot.run_until("a fault is told", |robot| robot.fault().is_some());
        let passed = robot.cell().joints.0;
        let nearest = (0..3).map(|axis| (passed[axis] - ends[axis]).abs());
        let nearest_rad = nearest.fold(f64::INFINITY, f64::min);
        let mut moved_rad = 0.0_f64;
        for _ in 0..300 {
            robot.run(1);
            for (now, passed) in robot.cell().joints.0.iter().zip(passed) {
                moved_rad = moved_rad.max((now - passed).abs());
            }
        }
        println!(
            "{speed_mm_s} mm/s: {:?}, {nearest_rad:.4} rad from the end of a turn, then moved by {moved_rad:.4} rad",
            robot.fault()
        );
        assert!(
            robot
                .fault()
                .is_some_and(|fault| matches!(fault, Fault::ReferenceLost { .. })),
            "{:?}",
            robot.fault()
        );
        assert!(robot.speed_rad_s() < STILL_RAD_S);
        // A turn of a motor is 0.52 rad at the joint.
        assert!(
            nearest_rad < 0.02 && moved_rad < 0.05,
            "{nearest_rad} rad, {moved_rad} rad"
        );
    }
}
