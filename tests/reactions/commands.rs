//! Random commands, several in one millisecond: whatever was pressed, the robot can draw afterwards.

use crate::bursts::Random;
use crate::liveness::{come_back, with};
use crate::robot::Robot;
use etherpen::application::Mode;
use etherpen::messages::Command;
use etherpen::motion::Pen;
use etherpen::robots::Position;

/// Seeds that are always tried.
const SEEDS: std::ops::Range<u64> = 0..10;
/// Milliseconds in which something is pressed.
const PRESSED_MS: u32 = 2_500;
/// Most commands of one millisecond.
const AT_ONCE_MAX: u64 = 4;
/// Acknowledgements that may be needed.
const ACKNOWLEDGEMENTS_MAX: u32 = 2;

fn any(random: &mut Random, robot: &Robot) -> Command {
    let near = Position {
        x_mm: random.below(80) as f64 - 40.0,
        y_mm: random.below(80) as f64 - 40.0,
        z_mm: -840.0,
    };
    match random.below(24) {
        0 | 1 => Command::Home,
        2 => Command::HomeAt {
            pose: robot.cell().joints,
            position: None,
        },
        3..=5 => Command::Enable,
        6 => Command::Disable,
        7..=9 => Command::Jog {
            velocity_mm_s: [random.below(60) as f32 - 30.0, 10.0, 0.0],
        },
        10 | 11 => Command::Move { position: near },
        12 => Command::Draw { job: 999 },
        13 => Command::Hold,
        14 => Command::Resume,
        15 | 16 => Command::Cancel,
        17 => Command::Override {
            percent: 50 + random.below(100) as u8,
        },
        18 => Command::Pen { pen: Pen::Up },
        19 => Command::Pen { pen: Pen::Down },
        20 => Command::Stop,
        _ => Command::Acknowledge,
    }
}

/// Presses at random, then leaves the robot alone and draws.
fn walk(seed: u64) {
    println!("seed {seed}");
    let mut random = Random::new(seed);
    let mut robot = with(random.below(2) == 0).enabled();
    for _ in 0..PRESSED_MS {
        if random.below(6) == 0 {
            for _ in 0..=random.below(AT_ONCE_MAX) {
                let command = any(&mut random, &robot);
                robot.send_at_once(command);
            }
        }
        robot.run(1);
    }
    // A drawing whose path never comes is cancelled; everything else comes to an end by itself.
    for _ in 0..60_000 {
        match robot.mode() {
            Mode::Drawing | Mode::Holding => drop(robot.command(Command::Cancel)),
            Mode::Homing | Mode::Moving | Mode::Stopping => {}
            Mode::Startup | Mode::BusConfiguring => {}
            Mode::DrivesOff | Mode::Unreferenced | Mode::Idle | Mode::Fault => break,
        }
        robot.run(1);
    }
    robot
        .command(Command::Override { percent: 100 })
        .expect("it is in bounds");
    come_back(&mut robot, ACKNOWLEDGEMENTS_MAX);
}

#[test]
pub(crate) fn whatever_was_pressed_at_once_the_robot_draws_afterwards() {
    SEEDS.for_each(walk);
}

#[test]
pub(crate) fn a_reference_and_a_motion_at_once_never_leave_the_robot_moving() {
    let position = Position {
        x_mm: 20.0,
        y_mm: 0.0,
        z_mm: -840.0,
    };
    let jog = Command::Jog {
        velocity_mm_s: [20.0, 0.0, 0.0],
    };
    for motion in [
        Command::Move { position },
        jog,
        Command::Pen { pen: Pen::Up },
        Command::Draw { job: 900 },
    ] {
        for at in [false, true] {
            let mut robot = with(false).enabled();
            let reference = match at {
                false => Command::Home,
                true => Command::HomeAt {
                    pose: robot.cell().joints,
                    position: None,
                },
            };
            robot.send_at_once(reference);
            robot.send_at_once(motion);
            robot.run(300);
            let _ = robot.command(Command::Cancel);
            robot.run_until("it is at rest", |robot| robot.mode() == Mode::Idle);
            come_back(&mut robot, 0);
        }
    }
}
