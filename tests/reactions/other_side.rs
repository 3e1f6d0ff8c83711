//! A robot whose joint was pushed to the other side without power: no motion leads back, so the operator is told which
//! joint it is, and the robot works again once it is pushed back. The truth is the cell's: what its motors do.

use crate::STILL_RAD_S;
use crate::path_stop::{line, machine, ready, undisturbed};
use crate::robot::Robot;
use etherpen::application::{Mode, Refusal};
use etherpen::messages::Command;
use host_tools::cell::DriveState;
use host_tools::link::text;
use host_tools::settings::machines::MACHINES;

/// The joint that has two sides, from 0.
const JOINT: u8 = 1;
/// Angles far from the middle between the sides and near to it, rad.
const FAR_RAD: f64 = 1.9;
const NEAR_RAD: f64 = 0.4;

fn pushed(robot: &mut Robot, to_rad: f64) {
    robot.change_cell(|cell| cell.push(JOINT.into(), to_rad));
    let there = |robot: &Robot| (robot.cell().joints.0[usize::from(JOINT)] - to_rad).abs() < 1.0e-6;
    robot.run_until("the joint is pushed", there);
    robot.run(100);
}

/// A command that is refused because of the joint, and that gives no power and moves nothing.
fn assert_refused(robot: &mut Robot, command: Command, at_rad: f64) {
    let refused = robot.command(command).expect_err("no motion leads from there");
    let Refusal::OtherSide {
        axis,
        angle_rad,
        planned_rad,
    } = refused
    else {
        panic!("{command:?}: {refused:?}");
    };
    assert_eq!(axis, JOINT);
    assert!((f64::from(angle_rad) - at_rad).abs() < 1.0e-3, "{angle_rad}");
    assert!((f64::from(planned_rad) + at_rad).abs() < 1.0e-3, "{planned_rad}");
    let words = text::refusal(&refused);
    println!("{words}");
    assert!(words.contains("axis 2 ") && words.contains("push"), "{words}");
    for _ in 0..100 {
        robot.run(1);
        assert!(robot.speed_rad_s() < STILL_RAD_S);
    }
}

#[test]
pub(crate) fn a_joint_pushed_to_the_other_side_is_told_and_the_robot_works_again_once_it_is_pushed_back() {
    let index = MACHINES.iter().position(|machine| machine.name == "scara").unwrap();
    let (config, centre_mm, length_mm) = machine(index, 250.0);
    let path = line(&config, centre_mm, length_mm);
    for to_rad in [-FAR_RAD, -NEAR_RAD] {
        let mut robot = ready(&config);
        robot.command(Command::Disable).unwrap();
        robot.wait_for(Mode::DrivesOff);
        pushed(&mut robot, to_rad);
        assert_refused(&mut robot, Command::Enable, to_rad);
        assert_eq!(robot.mode(), Mode::DrivesOff);
        let slaves = robot.cell().slaves;
        assert!(slaves.iter().all(|slave| slave.drive != DriveState::OperationEnabled));
        pushed(&mut robot, FAR_RAD);
        robot.command(Command::Enable).unwrap();
        robot.wait_for(Mode::Idle);
        let trace = undisturbed(&mut robot, path.clone());
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
