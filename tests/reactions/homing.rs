//! Homing by switches: where the motors are afterwards, and what happens when a switch fails.

use crate::robot::Robot;
use crate::{STILL_RAD_S, assert_described_standstill};
use etherpen::application::{Fault, Mode, Refusal};
use etherpen::config::{Config, HomeSwitch, IoPoint, IoRole};
use etherpen::control::search::SearchFailure;
use etherpen::messages::Command;
use host_tools::cell::{CellOptions, Fault as CellFault};
use host_tools::settings::machines::MACHINES;

/// How far a homed axis may be from where the controller believes it is, rad: 0.05 mm of a linear axis.
const APART_RAD: f64 = 5e-4;
/// Longest search of the gantry, ms.
const SEARCH_MAX_MS: u32 = 30_000;

fn gantry() -> Config {
    MACHINES[1].load().unwrap()
}

/// Two crossed belts with a switch at the lower end of x and of y.
fn belts() -> Config {
    let mut config = MACHINES[2].load().unwrap();
    // Where both switches open, at -168 mm: the belts are at the sum and the difference.
    let [x_rad, y_rad] = [-1.68, -1.68];
    for (number, (name, at_rad)) in [("x_home", x_rad + y_rad), ("y_home", x_rad - y_rad)]
        .into_iter()
        .enumerate()
    {
        let io = config.io.len() as u8;
        let point = IoPoint {
            name: name.try_into().unwrap(),
            slave: 1,
            bit: Some(1 + number as u16),
            role: IoRole::Home,
            ..IoPoint::default()
        };
        config.io.push(point).unwrap();
        let axis = &mut config.axes[number];
        axis.sync_angle_rad = at_rad;
        axis.home = HomeSwitch {
            io: Some(io),
            speed_rad_s: -0.6,
            pull_off_rad: 0.2,
            travel_max_rad: 3.7,
            ..HomeSwitch::default()
        };
    }
    config.check_io().unwrap();
    config
}

/// A gantry with power that is not homed.
fn powered(seed: u64) -> Robot {
    powered_of(&gantry(), seed)
}

/// A machine with power that is not homed.
fn powered_of(config: &Config, seed: u64) -> Robot {
    let options = CellOptions {
        seed,
        ..CellOptions::default()
    };
    let mut robot = Robot::of(config, options);
    robot.configure(config);
    robot.wait_for(Mode::DrivesOff);
    assert_eq!(robot.command(Command::Home), Err(Refusal::NeedsPower));
    robot.command(Command::Enable).unwrap();
    robot.wait_for(Mode::Unreferenced);
    robot
}

/// Whether the controller knows where the motors are.
fn assert_knows_its_pose(robot: &mut Robot) {
    robot.run(100);
    let truth = robot.cell().joints.0;
    let believed = robot.samples.last().expect("samples").measured_rad;
    let driven = usize::from(robot.config.bus.drives).min(3);
    for axis in 0..driven {
        let apart_rad = (truth[axis] - f64::from(believed[axis])).abs();
        assert!(apart_rad < APART_RAD, "axis {axis}: {apart_rad} rad");
    }
}

#[test]
pub(crate) fn a_gantry_finds_its_switches_from_wherever_it_stands_and_never_touches_an_end_stop() {
    for seed in 1..=4 {
        let mut robot = powered(seed);
        let from = robot.cell().joints.0;
        robot.command(Command::Home).unwrap();
        robot.wait_for(Mode::Homing);
        let mut fastest = [0.0_f64; 3];
        let mut ms = 0;
        while robot.mode() == Mode::Homing {
            robot.run(1);
            ms += 1;
            assert!(ms < SEARCH_MAX_MS, "{:?}", robot.fault());
            let speeds = robot.cell().velocities.0;
            for (fastest, speed) in fastest.iter_mut().zip(speeds) {
                *fastest = fastest.max(speed.abs());
            }
        }
        assert_eq!((robot.mode(), robot.fault()), (Mode::Idle, None));
        assert_knows_its_pose(&mut robot);
        assert_eq!(robot.cell().end_stop_ms, 0);
        // The speeds of the file, 60, 60 and 20 mm/s, and what a drive overshoots; with clocks its outputs come later.
        assert!(
            fastest[0] < 0.66 && fastest[1] < 0.66 && fastest[2] < 0.23,
            "{fastest:?}"
        );
        println!("seed {seed}: from {from:?} rad in {ms} ms, fastest {fastest:?} rad/s");
    }
}

#[test]
pub(crate) fn an_axis_that_stands_at_its_switch_leaves_it_first() {
    let mut robot = powered(1);
    robot.command(Command::Home).unwrap();
    // The switch of the height stands at 3 mm.
    robot.run_until("the first switch opens", |robot| robot.cell().joints.0[2] > 0.03);
    // At its switch, the search is ended and begun again.
    robot.command(Command::Cancel).unwrap();
    robot.wait_for(Mode::Unreferenced);
    robot.command(Command::Home).unwrap();
    robot.run_until("homed", |robot| robot.mode() == Mode::Idle);
    assert_knows_its_pose(&mut robot);
}

/// Homed, then the search begins again and is ended in the middle of its way.
#[test]
pub(crate) fn a_search_that_is_ended_early_leaves_a_homed_machine_unhomed_where_it_stands() {
    for (after_ms, stops) in [(0, false), (40, false), (900, false), (900, true)] {
        let mut robot = powered(1);
        robot.command(Command::Home).unwrap();
        robot.run_until("homed", |robot| robot.mode() == Mode::Idle);
        // The motors lag behind the end of the ramp.
        robot.run(20);
        robot.command(Command::Home).unwrap();
        let before = robot.cell().joints.0;
        robot.run(after_ms);
        if after_ms == 40 {
            // Nothing jumps as the search begins.
            for (after, before) in robot.cell().joints.0.iter().zip(before) {
                assert!((after - before).abs() < 0.01, "{after} rad, {before} rad before");
            }
        }
        if stops {
            robot.command(Command::Stop).unwrap();
            assert_described_standstill(&mut robot, |fault| matches!(fault, Fault::EmergencyStop(_)));
            robot.command(Command::Acknowledge).unwrap();
            robot.wait_for(Mode::DrivesOff);
            robot.command(Command::Enable).unwrap();
        } else {
            robot.command(Command::Cancel).unwrap();
        }
        robot.wait_for(Mode::Unreferenced);
        assert!(!robot.status.as_ref().unwrap().referenced);
        robot.run(20);
        robot.command(Command::Home).unwrap();
        robot.run_until("homed", |robot| robot.mode() == Mode::Idle);
        assert_knows_its_pose(&mut robot);
    }
}

#[test]
pub(crate) fn a_way_that_is_too_short_ends_the_search_before_the_end_stop() {
    let mut config = gantry();
    for axis in &mut config.axes {
        (axis.home.pull_off_rad, axis.home.travel_max_rad) = (0.03, 0.05);
    }
    let mut robot = Robot::of(&gantry(), CellOptions::default());
    robot.configure(&config);
    robot.wait_for(Mode::DrivesOff);
    robot.command(Command::Enable).unwrap();
    robot.wait_for(Mode::Unreferenced);
    robot.command(Command::Home).unwrap();
    assert_described_standstill(&mut robot, |fault| {
        matches!(
            fault,
            Fault::HomingFailed {
                axis: 2,
                failure: SearchFailure::NeverOpens
            }
        )
    });
    assert_eq!(robot.cell().end_stop_ms, 0);
}

/// Makes a switch fail, or mends it.
type Failing = fn(&mut Robot, bool);

#[test]
pub(crate) fn each_failure_of_a_switch_ends_at_standstill_with_its_cause_and_the_machine_comes_back() {
    let failures: [(&str, SearchFailure, Failing); 2] = [
        ("the wires are broken", SearchFailure::StaysOpen, |robot, fails| {
            robot.change_cell(|cell| cell.break_switches(fails));
        }),
        ("the switches never open", SearchFailure::NeverOpens, |robot, fails| {
            robot.change_cell(|cell| cell.remove_switches(fails));
        }),
    ];
    for (what, expected, fail) in failures {
        let mut robot = powered(2);
        fail(&mut robot, true);
        robot.command(Command::Home).unwrap();
        assert_described_standstill(&mut robot, |fault| {
            matches!(fault, Fault::HomingFailed { axis: 2, failure } if *failure == expected)
                // Without switches the height runs against its end stop before its longest way is over.
                || expected == SearchFailure::NeverOpens && matches!(fault, Fault::FollowingError { axis: 2, .. } | Fault::FeedbackDeviation { axis: 2, .. })
        });
        println!("{what}: {:?}", robot.fault());
        fail(&mut robot, false);
        comes_back(&mut robot);
    }
}

/// Acknowledges, homes and ends enabled.
fn comes_back(robot: &mut Robot) {
    robot.command(Command::Acknowledge).unwrap();
    robot.wait_for(Mode::DrivesOff);
    robot.command(Command::Enable).unwrap();
    robot.run_until("power", |robot| matches!(robot.mode(), Mode::Unreferenced | Mode::Idle));
    robot.command(Command::Home).unwrap();
    robot.run_until("homed", |robot| robot.mode() == Mode::Idle);
    assert_eq!(robot.fault(), None);
    assert_knows_its_pose(robot);
}

#[test]
pub(crate) fn a_search_ends_at_a_stop_a_lost_terminal_a_lost_drive_and_a_silent_host() {
    let mut robot = powered(3);
    robot.command(Command::Home).unwrap();
    robot.run(300);
    robot.command(Command::Stop).unwrap();
    assert_described_standstill(&mut robot, |fault| matches!(fault, Fault::EmergencyStop(_)));
    comes_back(&mut robot);
    let mut robot = powered(3);
    robot.command(Command::Home).unwrap();
    robot.run(300);
    robot.plugged = false;
    robot.run(900);
    assert!(robot.speed_rad_s() < STILL_RAD_S, "nobody watches the search");
    robot.plugged = true;
    robot.wait_for(Mode::Unreferenced);
    robot.command(Command::Home).unwrap();
    robot.run_until("homed", |robot| robot.mode() == Mode::Idle);
    assert_knows_its_pose(&mut robot);
    for slave in [2, 4] {
        let mut robot = powered(3);
        robot.command(Command::Home).unwrap();
        robot.run(300);
        robot.inject(CellFault::Power(slave, 500));
        assert_described_standstill(&mut robot, |fault| {
            matches!(
                fault,
                Fault::SlaveLost { .. }
                    | Fault::SlaveState { .. }
                    | Fault::Drive { .. }
                    | Fault::HomingFailed {
                        failure: SearchFailure::Missing,
                        ..
                    }
            )
        });
        robot.run(2_000);
        comes_back(&mut robot);
    }
}

#[test]
pub(crate) fn two_belts_find_the_switches_of_both_slides_from_wherever_they_stand() {
    for (seed, orders) in [(1, [0, 0]), (2, [0, 1]), (3, [1, 0]), (4, [0, 0])] {
        let mut config = belts();
        for (axis, order) in config.axes.iter_mut().zip(orders) {
            axis.home.order = order;
        }
        let mut robot = powered_of(&config, seed);
        let from = robot.cell().joints.0;
        robot.command(Command::Home).unwrap();
        robot.wait_for(Mode::Homing);
        let mut fastest = 0.0_f64;
        for ms in 0.. {
            robot.run(1);
            assert!(ms < SEARCH_MAX_MS, "{:?}", robot.fault());
            // Each slide keeps the speed of its search.
            let [a, b, ..] = robot.cell().velocities.0;
            fastest = fastest.max((0.5 * (a + b)).abs()).max((0.5 * (a - b)).abs());
            assert!(a.abs().max(b.abs()) < 1.26, "{a} and {b} rad/s");
            if robot.mode() != Mode::Homing {
                break;
            }
        }
        assert_eq!((robot.mode(), robot.fault()), (Mode::Idle, None));
        assert_knows_its_pose(&mut robot);
        assert_eq!(robot.cell().end_stop_ms, 0);
        assert!(fastest < 0.66, "{fastest} rad/s");
        println!("seed {seed}: from {from:?} rad, fastest {fastest} rad/s");
    }
}

#[test]
pub(crate) fn a_search_of_two_belts_fails_as_any_other_and_the_machine_comes_back() {
    let failures: [(SearchFailure, Failing); 2] = [
        (SearchFailure::StaysOpen, |robot, fails| {
            robot.change_cell(|cell| cell.break_switches(fails));
        }),
        (SearchFailure::NeverOpens, |robot, fails| {
            robot.change_cell(|cell| cell.remove_switches(fails));
        }),
    ];
    for (expected, fail) in failures {
        let mut robot = Robot::of(&belts(), CellOptions::default());
        let mut config = belts();
        if expected == SearchFailure::NeverOpens {
            // Not as far as the end stop.
            for axis in &mut config.axes {
                (axis.home.pull_off_rad, axis.home.travel_max_rad) = (0.03, 0.05);
            }
        }
        robot.configure(&config);
        robot.wait_for(Mode::DrivesOff);
        robot.command(Command::Enable).unwrap();
        robot.wait_for(Mode::Unreferenced);
        fail(&mut robot, true);
        robot.command(Command::Home).unwrap();
        assert_described_standstill(
            &mut robot,
            |fault| matches!(fault, Fault::HomingFailed { axis: 0 | 1, failure } if *failure == expected),
        );
        assert_eq!(robot.cell().end_stop_ms, 0);
        println!("{expected:?}: {:?}", robot.fault());
        fail(&mut robot, false);
        robot.command(Command::Acknowledge).unwrap();
        robot.wait_for(Mode::DrivesOff);
        robot.configure(&belts());
        robot.wait_for(Mode::DrivesOff);
        robot.command(Command::Enable).unwrap();
        robot.wait_for(Mode::Unreferenced);
        robot.command(Command::Home).unwrap();
        robot.run_until("homed", |robot| robot.mode() == Mode::Idle);
        assert_knows_its_pose(&mut robot);
    }
    for after_ms in [0, 40, 900] {
        let mut robot = powered_of(&belts(), 6);
        robot.command(Command::Home).unwrap();
        robot.run(after_ms);
        robot.command(Command::Cancel).unwrap();
        robot.wait_for(Mode::Unreferenced);
        robot.command(Command::Home).unwrap();
        robot.run(after_ms);
        robot.command(Command::Stop).unwrap();
        assert_described_standstill(&mut robot, |fault| matches!(fault, Fault::EmergencyStop(_)));
        comes_back(&mut robot);
    }
}
