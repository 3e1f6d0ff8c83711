//! Stops that cannot keep their path: the drives' quick stop ends them, and the operator learns which axis left which part
//! of the envelope.
//!
//! The truth is the state of the cell's drives and motors.

use crate::path_stop::{configured, line, run_to_the_middle};
use crate::robot::Robot;
use crate::{STILL_RAD_S, assert_described_standstill, assert_recovers_and_draws};
use etherpen::application::{Fault, PathStopFailure, StopSource};
use etherpen::config::{AxisMode, Config};
use etherpen::messages::Command;
use host_tools::cell::{CellOptions, DriveState, Fault as CellFault};
use host_tools::link::text;

/// Middle of the line, mm.
const CENTRE_MM: [f64; 2] = [30.0, 60.0];
/// The drive whose processor stands still, from 1: it goes on with its last command and reports its last position.
const FROZEN: usize = 2;
/// For how long, ms.
const FROZEN_MS: u64 = 40;

/// Why a stop fails.
struct Trouble {
    what: &'static str,
    speed_mm_s: f64,
    change: fn(&mut Config, &mut CellOptions),
    /// Just before the stop.
    begin: fn(&mut Robot),
    expected: fn(&PathStopFailure) -> bool,
}

/// A deceleration that leaves time.
fn soft(config: &mut Config, _: &mut CellOptions) {
    for axis in &mut config.axes {
        axis.quick_stop_rad_s2 = 30.0;
    }
}

/// Drives that follow their commands slowly, unknown to the controller.
fn slow_drives(config: &mut Config, options: &mut CellOptions) {
    soft(config, options);
    options.physics.velocity_loop.bandwidth_hz = 9.0;
    for axis in &mut config.axes {
        (axis.feedback_deviation_max_rad, axis.following_error_max_rad) = (0.1, 0.1);
    }
}

fn freeze(robot: &mut Robot) {
    robot.inject(CellFault::Processor(FROZEN, FROZEN_MS));
}

const FROZEN_AXIS: u8 = FROZEN as u8 - 1;

const TROUBLES: [Trouble; 2] = [
    Trouble {
        what: "a frozen drive at high speed",
        speed_mm_s: 500.0,
        change: soft,
        begin: freeze,
        expected: |failure| matches!(failure, PathStopFailure::Speed { axis: FROZEN_AXIS, .. }),
    },
    Trouble {
        what: "drives that brake softly",
        speed_mm_s: 300.0,
        change: slow_drives,
        begin: |_| {},
        expected: |failure| matches!(failure, PathStopFailure::Time { .. } | PathStopFailure::Speed { .. }),
    },
];

fn failures(robot: &Robot) -> u32 {
    robot
        .status
        .as_ref()
        .map_or(0, |status| status.counters.path_stops_left)
}

#[test]
pub(crate) fn a_stop_that_leaves_its_path_is_a_quick_stop_that_names_the_axis_and_the_part_of_the_envelope() {
    for trouble in &TROUBLES {
        let what = trouble.what;
        let mut config = configured(AxisMode::Velocity, trouble.speed_mm_s);
        let mut options = CellOptions::default();
        (trouble.change)(&mut config, &mut options);
        let mut robot = Robot::of(&config, options).enabled();
        robot.draw(line(&config, CENTRE_MM, 300.0));
        run_to_the_middle(&mut robot, CENTRE_MM);
        (trouble.begin)(&mut robot);
        robot.say(Command::Stop);
        let brakes = |robot: &Robot| {
            let slaves = robot.cell().slaves;
            let mut heard = slaves.iter().zip(1..).filter(|(_, number)| *number != FROZEN);
            heard.all(|(slave, _)| slave.drive != DriveState::OperationEnabled)
        };
        let before_rad_s = robot.speed_rad_s();
        let after_ms = (1..=150).find(|_| {
            robot.run(1);
            brakes(&robot)
        });
        let speed_rad_s = robot.speed_rad_s();
        println!("{what}: from {before_rad_s:.2} rad/s, quick stop after {after_ms:?} ms at {speed_rad_s:.2} rad/s");
        assert!(after_ms.is_some(), "{what}");
        robot.run(200);
        assert!(
            robot.speed_rad_s() < STILL_RAD_S,
            "{what}: {} rad/s",
            robot.speed_rad_s()
        );
        assert_described_standstill(&mut robot, |fault| {
            println!("{what}: {}", text::fault(fault));
            matches!(fault, Fault::PathStopLeft(failure) if (trouble.expected)(failure))
        });
        assert_eq!(failures(&robot), 1, "{what}");
        assert_recovers_and_draws(&mut robot);
    }
}

#[test]
pub(crate) fn a_stop_that_keeps_its_path_is_not_counted_as_one_that_left_it() {
    for speed_mm_s in [20.0, 500.0] {
        let config = configured(AxisMode::Velocity, speed_mm_s);
        let mut robot = Robot::idle_with(&config);
        robot.draw(line(&config, CENTRE_MM, 300.0));
        run_to_the_middle(&mut robot, CENTRE_MM);
        robot.say(Command::Stop);
        assert_described_standstill(&mut robot, |fault| *fault == Fault::EmergencyStop(StopSource::Link));
        assert_eq!(failures(&robot), 0, "{speed_mm_s} mm/s");
    }
}
