//! Faults and the reactions of the operating modes, with firmware tasks and virtual cell.
//!
//! Everything runs in virtual time. The cell gives the true state of the drives; the operator knows only what the
//! firmware reports over the link.

#[macro_use]
#[path = "../again/mod.rs"]
mod again;
mod akd;
mod axes;
mod board;
mod bursts;
mod clocks;
mod commands;
mod dense;
mod encoder_turns;
mod feedback;
mod feedback_scan;
mod feedback_soak;
mod homing;
mod identity;
mod io;
mod io_samples;
mod io_words;
mod limits;
mod liveness;
mod matrix;
mod other_side;
mod outputs;
mod outside;
mod path_stop;
mod path_stop_left;
mod pen_output;
mod pen_servo;
mod pen_ways;
mod position;
mod robot;
mod stale;
mod tool;
mod tool_stops;
mod true_times;
mod unreferenced;

use etherpen::application::{Fault, Mode, Refusal, StopSource};
use etherpen::config::Config;
use etherpen::messages::{Command, ConfigRefusal, PathVertex};
use etherpen::motion::{Pen, RefusalReason};
use etherpen::robots::{DeltaGeometry, Geometry, Position};
use host_tools::cell::{AlState, DriveState, Fault as CellFault, ResolverFault};
use robot::{Robot, path};

/// Speed below which a joint is at rest, rad/s.
const STILL_RAD_S: f64 = 1.0e-3;

/// Asserts the one reaction to every fault: standstill, brakes, power off, refusal of motion until acknowledged.
fn assert_described_standstill(robot: &mut Robot, expected: impl Fn(&Fault) -> bool) {
    robot.run_until("a fault is told", |robot| robot.fault().is_some());
    robot.run(150);
    assert!(
        robot.speed_rad_s() < STILL_RAD_S,
        "still moving at {} rad/s",
        robot.speed_rad_s()
    );
    robot.wait_for(Mode::Fault);
    robot.run(200);
    let fault = robot.fault().unwrap();
    assert!(expected(&fault), "{fault:?}");
    let cell = robot.cell();
    assert!(
        cell.slaves
            .iter()
            .all(|slave| slave.drive != DriveState::OperationEnabled),
        "{:?}",
        cell.slaves
    );
    assert_eq!(robot.command(Command::Enable), Err(Refusal::NotInMode(Mode::Fault)));
    assert_eq!(
        robot.command(Command::Draw { job: 9 }),
        Err(Refusal::NotInMode(Mode::Fault))
    );
}

/// Acknowledges and powers up again; `meanwhile` is called every millisecond while the robot then rests.
fn assert_recovers_with(robot: &mut Robot, meanwhile: impl Fn(&Robot)) {
    robot.command(Command::Acknowledge).unwrap();
    robot.wait_for(Mode::DrivesOff);
    assert_eq!(robot.fault(), None);
    if !robot.status.as_ref().unwrap().referenced {
        // A drive that has just come back has to be seen at rest first.
        robot.run(50);
        robot.command(Command::Home).unwrap();
        robot.run(100);
    }
    robot.command(Command::Enable).unwrap();
    robot.wait_for(Mode::Idle);
    for _ in 0..500 {
        robot.run(1);
        meanwhile(robot);
    }
}

/// Acknowledges, powers up again and draws to the end.
fn assert_recovers_and_draws(robot: &mut Robot) {
    assert_recovers_with(robot, |_| {});
    robot.draw(path());
    robot.run_until("the path is executed", |robot| {
        robot.ack.finished && robot.mode() == Mode::Idle
    });
    assert_eq!(robot.fault(), None);
}

#[test]
fn a_stop_ends_in_a_latched_standstill_and_is_recovered() {
    let mut robot = Robot::drawing();
    robot.command(Command::Stop).unwrap();
    assert_described_standstill(&mut robot, |fault| *fault == Fault::EmergencyStop(StopSource::Link));
    assert_recovers_and_draws(&mut robot);
}

#[test]
fn a_drive_fault_stops_all_axes_names_the_axis_and_is_reset() {
    let mut robot = Robot::drawing();
    robot.inject(CellFault::Drive(2, 0x2310));
    assert_described_standstill(&mut robot, |fault| matches!(fault, Fault::Drive { axis: 1, .. }));
    let states = robot.cell().slaves;
    assert!(
        states.iter().all(|slave| slave.al_state == AlState::Operational),
        "the bus keeps running: {states:?}"
    );
    assert_recovers_and_draws(&mut robot);
}

#[test]
fn a_lost_slave_stops_the_others_and_is_brought_back_after_the_acknowledgement() {
    let mut robot = Robot::drawing();
    robot.inject(CellFault::Remove(3));
    assert_described_standstill(&mut robot, |fault| matches!(fault, Fault::SlaveLost { slave: 2 }));
    let others = robot.cell().slaves;
    assert!(
        [0, 1, 3].iter().all(|k| others[*k].al_state == AlState::Operational),
        "the rest of the bus runs: {others:?}"
    );
    robot.command(Command::Acknowledge).unwrap();
    robot.run(1_000);
    assert_eq!(robot.mode(), Mode::Fault, "it is not back yet");
    robot.run(15_000);
    robot.inject(CellFault::Insert(3));
    robot.run(100);
    assert_recovers_and_draws(&mut robot);
}

#[test]
fn stalled_frames_stop_the_motors_by_the_drives_own_watchdog() {
    let mut robot = Robot::drawing();
    robot.inject(CellFault::Stall(300));
    robot.run(150);
    assert!(
        robot.speed_rad_s() < STILL_RAD_S,
        "the watchdog has stopped the motors while nothing got through"
    );
    assert_described_standstill(&mut robot, |fault| {
        matches!(
            fault,
            Fault::Blind { .. } | Fault::SlaveState { .. } | Fault::SlaveLost { .. }
        )
    });
    assert_recovers_and_draws(&mut robot);
}

#[test]
fn motors_that_stop_answering_are_stopped_by_the_quick_stop_that_still_arrives() {
    let mut robot = Robot::drawing();
    let mut quick_stop_seen = false;
    for _ in 0..400 {
        robot.inject(CellFault::Lose);
        robot.inject(CellFault::Lose);
        robot.run(1);
        let cell = robot.cell();
        quick_stop_seen |= cell
            .slaves
            .iter()
            .any(|slave| slave.drive == DriveState::QuickStopActive);
    }
    assert!(quick_stop_seen, "braking under control, not coasting");
    assert!(robot.speed_rad_s() < STILL_RAD_S);
    assert_described_standstill(&mut robot, |fault| {
        matches!(fault, Fault::Blind { .. } | Fault::SlaveLost { .. })
    });
    assert_recovers_and_draws(&mut robot);
}

#[test]
fn a_repeated_stop_does_not_keep_the_robot_stopping() {
    let mut robot = Robot::drawing();
    for _ in 0..20 {
        robot.command(Command::Stop).unwrap();
        robot.run(30);
    }
    assert_eq!(robot.mode(), Mode::Fault);
}

#[test]
fn a_stop_before_any_configuration_is_acknowledged() {
    let mut robot = Robot::new();
    robot.run(200);
    robot.command(Command::Stop).unwrap();
    robot.wait_for(Mode::Fault);
    robot.configure(&Config::default());
    assert_eq!(
        robot.configured[0],
        Err(ConfigRefusal::NotInMode(Mode::Fault)),
        "a fault is acknowledged first"
    );
    robot.command(Command::Acknowledge).unwrap();
    robot.run(600);
    robot.configure(&Config::default());
    robot.wait_for(Mode::DrivesOff);
}

#[test]
fn a_slave_that_leaves_op_is_named_with_its_al_code() {
    let mut robot = Robot::drawing();
    robot.inject(CellFault::Retreat(4, 0x001A));
    let expected = |fault: &Fault| {
        matches!(
            fault,
            Fault::SlaveState {
                slave: 3,
                al_code: 0x001A,
                ..
            }
        )
    };
    assert_described_standstill(&mut robot, expected);
    assert_recovers_and_draws(&mut robot);
}

#[test]
fn a_power_cycled_drive_comes_back_without_its_reference() {
    let mut robot = Robot::drawing();
    robot.inject(CellFault::Power(4, 500));
    assert_described_standstill(&mut robot, |fault| matches!(fault, Fault::SlaveLost { slave: 3 }));
    robot.run(1_000);
    robot.command(Command::Acknowledge).unwrap();
    robot.wait_for(Mode::DrivesOff);
    assert!(
        !robot.status.as_ref().unwrap().referenced,
        "repair never restores a reference"
    );
    robot.command(Command::Enable).unwrap();
    robot.wait_for(Mode::Unreferenced);
    assert_eq!(robot.command(Command::Draw { job: 2 }), Err(Refusal::NotReferenced));
    robot.command(Command::Home).unwrap();
    robot.wait_for(Mode::Idle);
    robot.draw(path());
    robot.run_until("the path is executed", |robot| robot.ack.finished);
}

#[test]
fn nothing_moves_before_the_reference_and_a_known_pose_gives_it() {
    let mut robot = Robot::new();
    robot.configure(&Config::default());
    robot.wait_for(Mode::DrivesOff);
    robot.command(Command::Enable).unwrap();
    robot.wait_for(Mode::Unreferenced);
    let position = robot.cell().platform.expect("the robot holds a platform");
    for command in [
        Command::Draw { job: 1 },
        Command::Jog {
            velocity_mm_s: [1.0; 3],
        },
        Command::Move { position },
        Command::Pen { pen: Pen::Down },
    ] {
        assert_eq!(robot.command(command), Err(Refusal::NotReferenced), "{command:?}");
    }
    let pose = robot.cell().joints;
    let mut wrong = pose;
    // One turn of the second motor.
    wrong.0[1] += std::f64::consts::TAU / Config::default().axes[1].gear;
    let refused = robot.command(Command::HomeAt {
        pose: wrong,
        position: Some(position),
    });
    assert!(
        matches!(refused, Err(Refusal::PosePosition { axis: 1, .. })),
        "{refused:?}"
    );
    let mut beside = pose;
    beside.0[2] += 0.1;
    let refused = robot.command(Command::HomeAt {
        pose: beside,
        position: None,
    });
    assert!(
        matches!(refused, Err(Refusal::PoseResolver { axis: 2, .. })),
        "{refused:?}"
    );
    robot
        .command(Command::HomeAt {
            pose,
            position: Some(position),
        })
        .unwrap();
    robot.wait_for(Mode::Idle);
    robot.run(10);
    let measured = robot.samples.last().expect("telemetry").measured_rad;
    for (measured, angle) in measured.iter().zip(robot.cell().joints.0) {
        assert!((f64::from(*measured) - angle).abs() < 1e-4, "{measured} for {angle}");
    }
}

#[test]
fn a_frozen_resolver_is_a_deviation_of_the_feedback_with_axis_and_limit() {
    let mut robot = Robot::drawing();
    robot.inject(CellFault::Resolver(1, ResolverFault::Stuck, 400));
    assert_described_standstill(
        &mut robot,
        |fault| matches!(fault, Fault::FeedbackDeviation { axis: 0, deviation_rad, limit_rad } if deviation_rad > limit_rad),
    );
    assert!(
        !robot.status.as_ref().unwrap().referenced,
        "where the joint stands is not known"
    );
}

#[test]
fn single_bad_frames_cost_one_cycle_each_and_the_drawing_goes_on() {
    let mut robot = Robot::drawing();
    let faults = [
        CellFault::Drop,
        CellFault::Lose,
        CellFault::Delay(1),
        CellFault::Duplicate,
        CellFault::Truncate(30),
        CellFault::Index(1),
        CellFault::Foreign,
        CellFault::Counter(-1),
    ];
    for fault in faults {
        robot.inject(fault);
        robot.run(40);
        assert_eq!(robot.fault(), None, "{fault:?}");
    }
    robot.run_until("the path is executed", |robot| robot.ack.finished);
    robot.run(600);
    let counters = robot.status.as_ref().unwrap().counters;
    assert!(
        counters.frames_lost >= 4 && counters.frames_ignored >= 4,
        "{counters:?}"
    );
    assert_eq!((counters.cycles_late, counters.setpoint_underruns), (0, 0));
}

#[test]
fn a_held_drawing_is_the_same_drawing() {
    let undisturbed = {
        let mut robot = Robot::drawing();
        robot.run_until("the path is executed", |robot| robot.ack.finished);
        robot.ink().iter().map(|stroke| stroke.points_mm.len()).sum::<usize>()
    };
    let mut robot = Robot::drawing();
    robot.command(Command::Hold).unwrap();
    robot.run(2_000);
    assert_eq!(robot.mode(), Mode::Holding);
    assert!(
        robot.speed_rad_s() < STILL_RAD_S && !robot.cell().pen_touches,
        "the pen is lifted while held"
    );
    assert_eq!(robot.command(Command::Hold), Err(Refusal::NotInMode(Mode::Holding)));
    robot.command(Command::Resume).unwrap();
    robot.run_until("the path is executed", |robot| {
        robot.ack.finished && robot.mode() == Mode::Idle
    });
    let held = robot.ink().iter().map(|stroke| stroke.points_mm.len()).sum::<usize>();
    assert!(
        held >= undisturbed && held < undisturbed + 300,
        "{held} points of ink, {undisturbed} undisturbed"
    );
}

#[test]
fn a_hold_before_the_path_has_come_lets_nothing_move_until_resume() {
    let mut robot = Robot::idle();
    robot.command(Command::Draw { job: 1 }).unwrap();
    robot.command(Command::Hold).unwrap();
    robot.run(500);
    assert_eq!((robot.mode(), robot.speed_rad_s() < STILL_RAD_S), (Mode::Holding, true));
    robot.command(Command::Cancel).unwrap();
    robot.wait_for(Mode::Idle);
}

#[test]
fn cancel_lifts_the_pen_and_forgets_the_rest() {
    let mut robot = Robot::drawing();
    robot.command(Command::Cancel).unwrap();
    robot.wait_for(Mode::Idle);
    assert!(robot.speed_rad_s() < STILL_RAD_S && !robot.cell().pen_touches);
    robot.run(1_000);
    assert!(!robot.ack.finished);
    robot.draw(path());
    robot.run_until("another path is executed", |robot| robot.ack.finished);
}

#[test]
fn a_silent_host_leads_to_holding_and_only_resume_moves_again() {
    let mut robot = Robot::drawing();
    robot.plugged = false;
    robot.run(1_500);
    assert!(robot.speed_rad_s() < STILL_RAD_S && !robot.cell().pen_touches);
    robot.plugged = true;
    robot.wait_for(Mode::Holding);
    robot.run(1_000);
    assert_eq!(robot.mode(), Mode::Holding);
    robot.command(Command::Resume).unwrap();
    robot.run_until("the path is executed", |robot| robot.ack.finished);
}

#[test]
fn half_speed_takes_longer_and_is_reported() {
    let mut robot = Robot::drawing();
    assert_eq!(
        robot.command(Command::Override { percent: 5 }),
        Err(Refusal::OverrideRange(5))
    );
    robot.command(Command::Override { percent: 25 }).unwrap();
    robot.run(200);
    let peak = (0..100).fold(0.0_f64, |peak, _| {
        robot.run(1);
        peak.max(robot.speed_rad_s())
    });
    assert!(peak < 0.5, "{peak} rad/s at a quarter of the speed");
    robot.run(600);
    assert_eq!(robot.status.as_ref().unwrap().override_percent, 25);
}

#[test]
fn a_jog_ends_without_its_dead_man_message() {
    let mut robot = Robot::idle();
    let jog = Command::Jog {
        velocity_mm_s: [0.0, 50.0, 0.0],
    };
    for _ in 0..6 {
        robot.command(jog).unwrap();
        robot.run(50);
    }
    assert_eq!(robot.mode(), Mode::Moving);
    assert!(robot.speed_rad_s() > 0.02);
    robot.wait_for(Mode::Idle);
    assert!(robot.speed_rad_s() < STILL_RAD_S);
    let before = robot.cell().platform.unwrap();
    assert!(before.y_mm > 5.0 && before.y_mm < 60.0, "{before:?}");
}

#[test]
fn targets_outside_the_work_area_are_refused_before_anything_moves() {
    let mut robot = Robot::idle();
    let far = Command::Move {
        position: Position {
            x_mm: 900.0,
            y_mm: 0.0,
            z_mm: -800.0,
        },
    };
    assert!(matches!(robot.command(far), Err(Refusal::Target(_))));
    let near = Position {
        x_mm: 50.0,
        y_mm: -20.0,
        z_mm: -800.0,
    };
    robot.command(Command::Move { position: near }).unwrap();
    robot.run(100);
    assert_eq!(robot.mode(), Mode::Moving);
    robot.wait_for(Mode::Idle);
    let there = robot.cell().platform.unwrap();
    assert!(
        (there.x_mm - 50.0).abs() < 0.05 && (there.z_mm + 800.0).abs() < 0.05,
        "{there:?}"
    );
}

#[test]
fn a_vertex_outside_the_work_area_is_refused_with_its_index() {
    let mut robot = Robot::idle();
    let mut path = path();
    let outside = PathVertex {
        position_um: [800_000, 0, -850_000],
        pen: Pen::Down,
        stroke: 0,
    };
    path[5] = outside;
    robot.draw(path);
    robot.run_until("the vertex is refused", |robot| !robot.refused.is_empty());
    let refusal = robot.refused[0];
    assert_eq!(refusal.index, 5);
    assert!(matches!(refusal.reason, RefusalReason::Outside(_)), "{refusal:?}");
}

#[test]
fn a_configuration_is_needed_checked_and_kept() {
    let mut robot = Robot::new();
    robot.run(200);
    assert_eq!(robot.command(Command::Enable), Err(Refusal::NotConfigured));
    let mut wrong = Config::default();
    wrong.axes[3].feedback_gain_per_s = 1.0e6;
    robot.configure(&wrong);
    assert!(matches!(robot.configured[0], Err(ConfigRefusal::Bounds(error)) if error.field.axis == Some(3)));
    assert_eq!(robot.command(Command::Enable), Err(Refusal::NotConfigured));
    let flat = Config {
        geometry: Geometry::Delta(DeltaGeometry {
            arm_azimuths_deg: [0.0, 0.0, 240.0],
            ..DeltaGeometry::default()
        }),
        ..Config::default()
    };
    robot.configure(&flat);
    assert!(
        matches!(robot.configured[1], Err(ConfigRefusal::Geometry(_))),
        "{:?}",
        robot.configured
    );

    let mut robot = Robot::idle();
    robot.configure(&Config::default());
    assert_eq!(
        robot.configured[1], robot.configured[0],
        "the same configuration disturbs nothing"
    );
    assert_eq!(robot.mode(), Mode::Idle);
    let mut other = Config::default();
    other.motion.speed_mm_s = 300.0;
    robot.configure(&other);
    assert_eq!(robot.configured[2], Err(ConfigRefusal::NotInMode(Mode::Idle)));
    assert_eq!(robot.status.as_ref().unwrap().config, Config::default().hash());
}

#[test]
fn power_is_taken_only_from_a_robot_that_stands_with_its_brakes_closed() {
    let mut robot = Robot::idle();
    robot.command(Command::Disable).unwrap();
    robot.wait_for(Mode::DrivesOff);
    let cell = robot.cell();
    assert!(
        cell.slaves
            .iter()
            .all(|slave| slave.drive == DriveState::SwitchOnDisabled),
        "{:?}",
        cell.slaves
    );
    let before = cell.joints;
    robot.run(1_000);
    assert_eq!(robot.cell().joints, before, "the platform does not sink");
}

#[test]
fn enabling_far_from_the_last_reference_is_without_a_bump() {
    let mut robot = Robot::drawing();
    robot.command(Command::Stop).unwrap();
    robot.wait_for(Mode::Fault);
    let following = robot.samples.iter().rev().find(|sample| sample.mode == Mode::Drawing);
    let last_reference = following.expect("telemetry of the drawing").setpoint_rad;
    robot.command(Command::Acknowledge).unwrap();
    robot.wait_for(Mode::DrivesOff);
    let before = robot.cell().joints;
    let pairs = before.0.iter().zip(last_reference);
    let displaced_rad = pairs.fold(0.0, |most: f64, (joint, last)| {
        most.max((joint - f64::from(last)).abs())
    });
    assert!(displaced_rad > 5e-4, "the ramp led {displaced_rad} rad away");
    robot.command(Command::Enable).unwrap();
    let mut fastest_rad_s = 0.0_f64;
    for _ in 0..1_000 {
        robot.run(1);
        fastest_rad_s = fastest_rad_s.max(robot.speed_rad_s());
    }
    assert_eq!((robot.mode(), robot.fault()), (Mode::Idle, None));
    println!("displaced by {displaced_rad:.5} rad, fastest {fastest_rad_s:.6} rad/s while enabling");
    assert!(fastest_rad_s < 1e-3, "{fastest_rad_s} rad/s");
    for (after, before) in robot.cell().joints.0.iter().zip(before.0) {
        assert!((after - before).abs() < 1e-5, "{after} rad, {before} rad before");
    }
}
