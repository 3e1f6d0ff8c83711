//! A robot outside its work area, over the link: commands that lead inwards are carried out, all others are refused
//! with the reason. The truth is the cell's: where the motors have brought the platform.

use crate::STILL_RAD_S;
use crate::liveness::come_back;
use crate::robot::Robot;
use etherpen::application::{Mode, Refusal};
use etherpen::config::Config;
use etherpen::messages::Command;
use etherpen::motion::Outside;
use etherpen::motion::{Pen, RefusalReason};
use etherpen::robots::Position;

/// Radius of the work area that the robot finds itself outside of, mm.
const RADIUS_MM: f64 = 145.0;
/// Distance of the robot from the middle, mm.
const AWAY_MM: f64 = 175.0;
const Z_MM: f64 = -800.0;
const JOG_MM_S: f64 = 30.0;
/// Time between two signs of life of the operator, ms.
const SIGN_OF_LIFE_MS: u32 = 40;
/// How far the drives carry the platform over a line, mm.
const BESIDE_MM: f64 = 0.1;

fn radius_mm(robot: &Robot) -> f64 {
    let platform = robot.cell().platform.expect("the robot holds a platform");
    platform.x_mm.hypot(platform.y_mm)
}

fn at(radius_mm: f64, angle_rad: f64) -> Position {
    Position {
        x_mm: radius_mm * angle_rad.cos(),
        y_mm: radius_mm * angle_rad.sin(),
        z_mm: Z_MM,
    }
}

fn jog(angle_rad: f64) -> Command {
    Command::Jog {
        velocity_mm_s: [angle_rad.cos(), angle_rad.sin(), 0.0].map(|part| (JOG_MM_S * part) as f32),
    }
}

/// A robot with power, at rest outside its work area, in this direction from the middle.
fn beside(angle_rad: f64) -> Robot {
    let mut config = Config::default();
    let mut robot = Robot::idle_with(&config);
    robot
        .command(Command::Move {
            position: at(AWAY_MM, angle_rad),
        })
        .unwrap();
    robot.run(20);
    robot.wait_for(Mode::Idle);
    robot.command(Command::Disable).unwrap();
    robot.wait_for(Mode::DrivesOff);
    config.work_area.radius_mm = RADIUS_MM;
    robot.configure(&config);
    assert_eq!(robot.configured.last().map(Result::is_ok), Some(true));
    robot.wait_for(Mode::BusConfiguring);
    robot.wait_for(Mode::DrivesOff);
    // Bus and drives come back before the command is taken.
    robot.run_until("the bus is there", |robot| {
        robot.status.as_ref().is_some_and(|status| !status.recovering)
    });
    if !robot.status.as_ref().unwrap().referenced {
        let pose = robot.cell().joints;
        robot.command(Command::HomeAt { pose, position: None }).unwrap();
        robot.run(100);
    }
    robot.command(Command::Enable).unwrap();
    robot.wait_for(Mode::Idle);
    assert!((radius_mm(&robot) - AWAY_MM).abs() < BESIDE_MM, "{}", radius_mm(&robot));
    robot
}

/// A command that is refused because of the work area's radius, and that nothing moves.
fn assert_refused(robot: &mut Robot, command: Command) {
    let refused = robot.command(command);
    let is_radius = |refusal: &Refusal| {
        matches!(refusal, Refusal::Target(target)
            if matches!(target.reason, RefusalReason::Outside(Outside::Radius { .. })))
    };
    assert!(refused.as_ref().is_err_and(is_radius), "{command:?}: {refused:?}");
    for _ in 0..50 {
        robot.run(1);
        assert!(robot.speed_rad_s() < STILL_RAD_S, "{command:?} moved");
    }
    assert_eq!(robot.mode(), Mode::Idle);
}

#[test]
pub(crate) fn from_outside_the_work_area_the_robot_is_jogged_in_and_nowhere_else() {
    for angle_rad in [0.0, 1.1, 2.7, 4.2] {
        let mut robot = beside(angle_rad);
        assert_refused(&mut robot, jog(angle_rad));
        assert_refused(&mut robot, jog(angle_rad + 1.4));
        assert_refused(
            &mut robot,
            Command::Move {
                position: at(AWAY_MM + 20.0, angle_rad),
            },
        );
        assert_refused(&mut robot, Command::Pen { pen: Pen::Down });
        // Inwards, until the operator lets go inside.
        let inwards = jog(angle_rad + std::f64::consts::PI);
        let mut farthest_mm = radius_mm(&robot);
        for ms in 0..2_000 {
            if ms % SIGN_OF_LIFE_MS == 0 {
                robot.say(inwards);
            }
            robot.run(1);
            let now_mm = radius_mm(&robot);
            assert!(now_mm < farthest_mm + BESIDE_MM, "outwards: {now_mm} mm");
            farthest_mm = farthest_mm.min(now_mm);
        }
        robot.wait_for(Mode::Idle);
        assert!(radius_mm(&robot) < RADIUS_MM, "still outside: {} mm", radius_mm(&robot));
        come_back(&mut robot, 0);
    }
}

#[test]
pub(crate) fn a_move_brings_the_robot_in_from_outside_the_work_area() {
    let mut robot = beside(0.6);
    let position = at(30.0, 2.0);
    robot.command(Command::Move { position }).unwrap();
    robot.run(20);
    robot.wait_for(Mode::Idle);
    let platform = robot.cell().platform.expect("the robot holds a platform");
    let away_mm = (platform.x_mm - position.x_mm).hypot(platform.y_mm - position.y_mm);
    assert!(away_mm < BESIDE_MM, "{away_mm} mm from its target");
    come_back(&mut robot, 0);
}
