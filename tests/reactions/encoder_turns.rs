//! What encoders know when they are switched on: a machine that was pushed by several motor turns without power is homed where
//! it stands by multi-turn encoders, and elsewhere by others. The truth is the cell's motors and the end of its pen.

use crate::STILL_RAD_S;
use crate::path_stop::{line, machine, undisturbed};
use crate::robot::Robot;
use etherpen::application::{Fault, Mode, Refusal};
use etherpen::config::{Config, Encoder};
use etherpen::messages::Command;
use etherpen::robots::JointAngles;
use host_tools::cell::CellOptions;
use host_tools::settings::machines::MACHINES;
use std::f64::consts::TAU;

/// Where the belts are pushed, rad, and how many motor turns that is.
const PUSHED: [[f64; 2]; 3] = [[1.15, -0.52], [-0.9, 0.3], [0.2, 1.3]];

fn corexy(encoder: Encoder) -> (Config, [f64; 2], f64) {
    let index = MACHINES.iter().position(|machine| machine.name == "corexy").unwrap();
    let (mut config, centre_mm, length_mm) = machine(index, 150.0);
    for (axis, mark) in config.axes.iter_mut().zip([i32::MAX - 70_000, -1_234_567]) {
        axis.encoder = encoder;
        axis.sync_increments = match encoder {
            Encoder::SingleTurn => 70_000,
            Encoder::MultiTurn => mark,
            Encoder::Incremental => 0,
        };
    }
    (config, centre_mm, length_mm)
}

/// The machine without power, its belts pushed.
fn pushed(config: &Config, to_rad: [f64; 2]) -> Robot {
    let mut robot = Robot::of(config, CellOptions::default());
    robot.configure(config);
    robot.wait_for(Mode::DrivesOff);
    for (axis, to_rad) in to_rad.into_iter().enumerate() {
        robot.change_cell(|cell| cell.push(axis, to_rad));
        let there = |robot: &Robot| (robot.cell().joints.0[axis] - to_rad).abs() < 1.0e-6;
        robot.run_until("the belt is pushed", there);
    }
    robot.run(100);
    robot
}

/// Largest difference between the belts' true and reported positions, in motor turns.
fn off_turns(robot: &Robot) -> f64 {
    let believed = robot.samples.last().expect("samples").measured_rad;
    let turn_rad = TAU / robot.config().axes[0].gear.abs();
    let off = believed.iter().zip(robot.cell().joints.0).take(2);
    off.map(|(believed, angle)| (f64::from(*believed) - angle).abs() / turn_rad)
        .fold(0.0, f64::max)
}

#[test]
pub(crate) fn multi_turn_encoders_show_where_the_machine_was_pushed_and_others_do_not() {
    for to_rad in PUSHED {
        for encoder in [Encoder::SingleTurn, Encoder::MultiTurn, Encoder::Incremental] {
            let (config, ..) = corexy(encoder);
            let mut robot = pushed(&config, to_rad);
            robot.command(Command::Home).unwrap();
            robot.run(100);
            let off_turns = off_turns(&robot);
            println!("{encoder:?} {to_rad:?}: {off_turns:.6} turns");
            match encoder {
                Encoder::MultiTurn => assert!(off_turns < 1.0e-4, "{off_turns}"),
                Encoder::SingleTurn => assert!(off_turns > 0.9 && (off_turns - off_turns.round()).abs() < 1.0e-4),
                Encoder::Incremental => assert!(off_turns > 0.9, "{off_turns}"),
            }
        }
    }
}

#[test]
pub(crate) fn a_machine_pushed_by_turns_draws_where_it_should_with_multi_turn_encoders() {
    for to_rad in PUSHED {
        let (config, centre_mm, length_mm) = corexy(Encoder::MultiTurn);
        let mut robot = pushed(&config, to_rad);
        robot.command(Command::Home).unwrap();
        robot.command(Command::Enable).unwrap();
        robot.wait_for(Mode::Idle);
        let trace = undisturbed(&mut robot, line(&config, centre_mm, length_mm));
        let [x_mm, y_mm, _] = trace.last().expect("it has drawn");
        let (sin, cos) = 0.35_f64.sin_cos();
        let end_mm = [
            centre_mm[0] + length_mm / 2.0 * cos,
            centre_mm[1] + length_mm / 2.0 * sin,
        ];
        assert!((x_mm - end_mm[0]).hypot(y_mm - end_mm[1]) < 0.1, "{x_mm}, {y_mm}");
        assert_eq!(robot.fault(), None);
    }
}

#[test]
pub(crate) fn a_pose_a_turn_away_from_what_a_multi_turn_encoder_shows_is_refused_and_an_incremental_one_takes_any() {
    for encoder in [Encoder::MultiTurn, Encoder::Incremental] {
        let (config, ..) = corexy(encoder);
        let mut robot = pushed(&config, PUSHED[0]);
        let mut pose = JointAngles(robot.cell().joints.0);
        pose.0[1] += TAU / config.axes[1].gear;
        let answer = robot.command(Command::HomeAt { pose, position: None });
        match encoder {
            Encoder::MultiTurn => {
                assert!(
                    matches!(answer, Err(Refusal::PoseResolver { axis: 1, .. })),
                    "{answer:?}"
                );
                pose = JointAngles(robot.cell().joints.0);
                robot.command(Command::HomeAt { pose, position: None }).unwrap();
            }
            _ => answer.unwrap(),
        }
        robot.run(100);
        let believed = robot.samples.last().expect("samples").measured_rad;
        for (believed, wanted) in believed.iter().zip(pose.0).take(2) {
            assert!(
                (f64::from(*believed) - wanted).abs() < 1.0e-4,
                "{encoder:?}: {believed}, {wanted}"
            );
        }
    }
}

#[test]
pub(crate) fn a_position_that_starts_again_after_a_turn_is_not_believed_to_be_multi_turn() {
    let mut config = Config::default();
    for axis in &mut config.axes {
        (axis.encoder, axis.sync_increments) = (Encoder::MultiTurn, 600_000);
    }
    // Its drives show their resolvers' position within a turn.
    let mut robot = Robot::idle_with(&config);
    robot.draw(crate::robot::path());
    robot.run_until("the end of a turn is passed", |robot| robot.fault().is_some());
    assert!(
        matches!(robot.fault(), Some(Fault::ReferenceLost { .. })),
        "{:?}",
        robot.fault()
    );
    robot.run(500);
    for _ in 0..100 {
        robot.run(1);
        assert!(robot.speed_rad_s() < STILL_RAD_S);
    }
}
