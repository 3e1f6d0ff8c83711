//! Reactions to the board's own inputs: emergency stop and Ethernet port.

use crate::robot::{Overrun, Robot, path};
use crate::{STILL_RAD_S, assert_described_standstill, assert_recovers_and_draws};
use etherpen::application::{Fault, Mode, Refusal, StopSource};
use etherpen::board::{Interlock, PortState};
use etherpen::config::Config;
use etherpen::measurement::disturbance;
use etherpen::messages::Command;
use host_tools::cell::{DriveState, Fault as CellFault};

const BY_INPUT: Fault = Fault::EmergencyStop(StopSource::Input);

#[test]
pub(crate) fn an_open_emergency_stop_is_a_quick_stop_that_no_acknowledgement_ends() {
    let mut robot = Robot::drawing();
    robot.emergency_stop(true);
    let mut quick_stop_after_ms = None;
    for ms in 1..=20 {
        robot.run(1);
        let slaves = robot.cell().slaves;
        if slaves.iter().all(|slave| slave.drive != DriveState::OperationEnabled) {
            quick_stop_after_ms.get_or_insert(ms);
        }
    }
    println!("all drives brake {quick_stop_after_ms:?} ms after the contact opened");
    assert!(quick_stop_after_ms.is_some_and(|ms| ms <= 8), "{quick_stop_after_ms:?}");
    assert_described_standstill(&mut robot, |fault| *fault == BY_INPUT);
    assert_eq!(robot.status.as_ref().unwrap().interlock, Some(Interlock::EmergencyStop));
    for _ in 0..3 {
        assert_eq!(
            robot.command(Command::Acknowledge),
            Err(Refusal::CauseRemains(BY_INPUT))
        );
        robot.run(200);
        assert_eq!((robot.mode(), robot.fault()), (Mode::Fault, Some(BY_INPUT)));
    }
    robot.emergency_stop(false);
    robot.run(1_000);
    assert_eq!(
        (robot.mode(), robot.fault()),
        (Mode::Fault, Some(BY_INPUT)),
        "a released button alone moves nothing"
    );
    assert_recovers_and_draws(&mut robot);
}

#[test]
pub(crate) fn a_pulse_on_the_emergency_stop_wire_stops_nothing() {
    let mut robot = Robot::drawing();
    for _ in 0..20 {
        robot.emergency_stop(true);
        robot.run(1);
        robot.emergency_stop(false);
        robot.run(20);
    }
    robot.run_until("the path is executed", |robot| robot.ack.finished);
    assert_eq!(robot.fault(), None);
}

#[test]
pub(crate) fn an_open_emergency_stop_while_another_fault_is_latched_keeps_it_latched() {
    let mut robot = Robot::drawing();
    robot.command(Command::Stop).unwrap();
    robot.wait_for(Mode::Fault);
    robot.emergency_stop(true);
    robot.run(50);
    assert_eq!(
        robot.fault(),
        Some(Fault::EmergencyStop(StopSource::Link)),
        "the first cause stays"
    );
    assert_eq!(
        robot.command(Command::Acknowledge),
        Err(Refusal::CauseRemains(BY_INPUT))
    );
    robot.emergency_stop(false);
    robot.run(200);
    assert_recovers_and_draws(&mut robot);
}

#[test]
pub(crate) fn an_emergency_stop_that_is_open_from_the_start_is_acknowledged_once_it_is_closed() {
    let mut robot = Robot::new();
    robot.emergency_stop(true);
    robot.wait_for(Mode::Fault);
    assert_eq!(robot.fault(), Some(BY_INPUT));
    assert_eq!(
        robot.command(Command::Acknowledge),
        Err(Refusal::CauseRemains(BY_INPUT))
    );
    robot.emergency_stop(false);
    robot.run(200);
    robot.command(Command::Acknowledge).unwrap();
    robot.wait_for(Mode::Startup);
    robot.configure(&Config::default());
    robot.wait_for(Mode::DrivesOff);
}

#[test]
pub(crate) fn a_pulled_cable_is_told_as_such_and_the_bus_comes_back_with_it() {
    let mut robot = Robot::drawing();
    for _ in 0..400 {
        robot.inject(CellFault::Lose);
        robot.inject(CellFault::Lose);
        robot.run(1);
        robot.port(PortState::Down);
    }
    let told = robot.status.as_ref().unwrap();
    assert_eq!(told.port, PortState::Down);
    assert_described_standstill(&mut robot, |fault| *fault == Fault::NoLink { port: PortState::Down });
    robot.command(Command::Acknowledge).unwrap();
    robot.run(500);
    assert_eq!(robot.mode(), Mode::Fault, "the cable is not back yet");
    robot.run(15_000);
    robot.port(PortState::Up);
    robot.run(100);
    assert_eq!(robot.status.as_ref().unwrap().port, PortState::Up);
    assert_recovers_and_draws(&mut robot);
}

#[test]
pub(crate) fn a_board_without_link_at_the_start_waits_for_it_and_then_says_so() {
    for (state, wait_ms) in [(PortState::Down, 2_000), (PortState::NoPhy, 4_000)] {
        let mut robot = Robot::new();
        robot.port(state);
        robot.configure(&Config::default());
        robot.run(wait_ms);
        assert_eq!((robot.mode(), robot.fault()), (Mode::BusConfiguring, None));
        robot.port(PortState::Up);
        robot.wait_for(Mode::DrivesOff);
    }
    let mut robot = Robot::new();
    robot.port(PortState::NoPhy);
    robot.configure(&Config::default());
    robot.wait_for(Mode::Fault);
    assert_eq!(robot.fault(), Some(Fault::NoLink { port: PortState::NoPhy }));
    robot.port(PortState::Up);
    robot.run(100);
    robot.command(Command::Acknowledge).unwrap();
    robot.wait_for(Mode::DrivesOff);
    robot.command(Command::Home).unwrap();
    robot.run(100);
    robot.command(Command::Enable).unwrap();
    robot.wait_for(Mode::Idle);
    robot.draw(path());
    robot.run_until("the path is executed", |robot| robot.ack.finished);
    assert!(robot.speed_rad_s() < STILL_RAD_S);
}

#[test]
pub(crate) fn a_failed_clock_stops_the_drives_and_nothing_moves_on_its_substitute() {
    let mut robot = Robot::drawing();
    robot.surround(|around| around.substitute_clock = true);
    assert_described_standstill(&mut robot, |fault| *fault == Fault::ClockFailure);
    let refused = robot.command(Command::Acknowledge);
    assert_eq!(refused, Err(Refusal::CauseRemains(Fault::ClockFailure)));
    assert_eq!(robot.mode(), Mode::Fault);
}

#[test]
pub(crate) fn a_trajectory_task_that_is_late_by_most_of_its_period_costs_nothing() {
    let mut robot = Robot::drawing();
    for _ in 0..20 {
        robot.surround(|around| around.trajectory_waits = true);
        robot.run(10);
        robot.surround(|around| around.trajectory_waits = false);
        robot.run(26);
    }
    robot.run_until("the path is executed", |robot| robot.ack.finished);
    robot.run(600);
    assert_eq!(robot.fault(), None);
    assert_eq!(robot.status.as_ref().unwrap().counters.setpoint_underruns, 0);
}

#[test]
pub(crate) fn a_trajectory_task_that_hangs_in_motion_is_a_quick_stop() {
    let mut robot = Robot::drawing();
    robot.surround(|around| around.trajectory_waits = true);
    assert_described_standstill(&mut robot, |fault| *fault == Fault::SetpointUnderrun);
    robot.surround(|around| around.trajectory_waits = false);
    robot.run(100);
    let counters = robot.status.as_ref().unwrap().counters;
    assert_eq!(counters.setpoint_underruns, 1, "the first one stopped the drives");
    assert_recovers_and_draws(&mut robot);
}

#[test]
pub(crate) fn bytes_that_the_serial_port_overruns_are_sent_again_and_the_drawing_is_the_same() {
    let draw = |overrun| {
        let mut robot = Robot::idle();
        robot.overrun = overrun;
        robot.draw(path());
        robot.run_until("the path is executed", |robot| robot.ack.finished);
        robot.overrun = None;
        robot.run(200);
        assert_eq!(robot.fault(), None);
        let errors = robot.status.as_ref().unwrap().counters.link_errors;
        (robot.ink(), errors)
    };
    let (undisturbed, _) = draw(None);
    // As many as the receiver's FIFO holds.
    let overrun = Overrun {
        bytes: 16,
        period_ms: 3,
    };
    let (ink, errors) = draw(Some(overrun));
    println!("{errors} damaged messages");
    assert!(errors > 0, "the line lost something");
    assert_eq!(ink.len(), undisturbed.len());
    for (stroke, same) in ink.iter().zip(&undisturbed) {
        // A stroke has a point for each millisecond.
        assert!(stroke.points_mm.len().abs_diff(same.points_mm.len()) <= 1);
        let apart_mm = stroke
            .points_mm
            .iter()
            .zip(&same.points_mm)
            .map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
        assert!(apart_mm.fold(0.0, f64::max) < 0.2);
    }
}

#[test]
pub(crate) fn errors_of_the_ethernet_dma_are_told_and_a_drawing_survives_the_frames_that_they_cost() {
    let mut robot = Robot::drawing();
    for errors in 1..=3 {
        // The controller's reset takes less than two milliseconds; both telegrams of each are lost.
        for _ in 0..2 {
            robot.inject(CellFault::Lose);
            robot.inject(CellFault::Lose);
            robot.run(1);
        }
        robot.surround(|around| around.board.ethernet_errors = errors);
        robot.run(100);
    }
    robot.run_until("the path is executed", |robot| robot.ack.finished);
    robot.run(100);
    assert_eq!(robot.fault(), None);
    assert_eq!(robot.status.as_ref().unwrap().counters.ethernet_errors, 3);
}

#[test]
pub(crate) fn the_emulated_board_stops_for_its_emergency_stop_input_and_for_its_clock_and_recovers() {
    let mut robot = Robot::emulated_drawing();
    robot.disturb(disturbance::EMERGENCY_STOP);
    assert_described_standstill(&mut robot, |fault| *fault == BY_INPUT);
    assert_eq!(robot.status.as_ref().unwrap().interlock, Some(Interlock::EmergencyStop));
    assert_eq!(
        robot.command(Command::Acknowledge),
        Err(Refusal::CauseRemains(BY_INPUT))
    );
    robot.disturb(0);
    robot.run(300);
    assert_recovers_and_draws(&mut robot);

    robot.disturb(disturbance::CLOCK);
    assert_described_standstill(&mut robot, |fault| *fault == Fault::ClockFailure);
    assert_eq!(
        robot.command(Command::Acknowledge),
        Err(Refusal::CauseRemains(Fault::ClockFailure))
    );
    robot.disturb(0);
    robot.run(300);
    assert_recovers_and_draws(&mut robot);
}
