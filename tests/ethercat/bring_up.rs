//! Bring-up, motion, faults on the wire, lost slaves and their repair.

use crate::again::clocks_are_on;
use crate::rig::{idle_rig, rig};
use etherpen::control::robot_axes::{AxisCommand, Demand};
use etherpen::drives::cia402::{DriveState, DriveTarget};
use etherpen::drives::io::IoGroup;
use etherpen::ethercat::cyclic::{ExchangeKind, Ignored};
use etherpen::ethercat::error::BusError;
use etherpen::ethercat::supervisor::BusEvent;
use etherpen::robots::AXES;
use etherpen_segment::AlState;
use host_tools::cell::Fault;

#[test]
pub(crate) fn four_drives_reach_op_enable_and_follow_their_demands() {
    turn_as_told(ExchangeKind::Split);
}

#[test]
pub(crate) fn four_drives_do_the_same_when_inputs_and_outputs_are_exchanged_together() {
    turn_as_told(ExchangeKind::Combined);
}

#[test]
pub(crate) fn a_plan_is_adopted_once_and_not_in_every_cycle() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(20);
    assert!(!rig.group.renew());
}

fn turn_as_told(exchange: ExchangeKind) {
    let mut rig = idle_rig("");
    rig.setup.exchange = exchange;
    rig.start();
    let took_ms = rig.operational();
    println!(
        "{exchange:?}: OP after {took_ms} ms and {} frames",
        rig.cell.state().frames
    );
    assert!(rig.cell.state().slaves.iter().all(|slave| slave.al_status_code == 0));
    rig.lead(DriveTarget::Enabled, DriveState::OperationEnabled);
    rig.run_ms(50);
    rig.robot.home(None).expect("at rest");
    rig.millisecond();
    let before = rig.cell.state().joints.0;
    for (input, truth_rad) in rig.inputs.iter().zip(before) {
        let angle_rad = input.and_then(|input| input.angle_rad).expect("referenced");
        assert!((angle_rad - truth_rad).abs() < 1e-4, "{angle_rad} {truth_rad}");
    }

    rig.command.demand = Demand::Velocity(0.5);
    rig.run_ms(400);
    rig.command.demand = Demand::Velocity(0.0);
    rig.run_ms(100);
    for ((input, start_rad), truth_rad) in rig.inputs.iter().zip(before).zip(rig.cell.state().joints.0) {
        let angle_rad = input.and_then(|input| input.angle_rad).expect("still referenced");
        assert!((angle_rad - truth_rad).abs() < 1e-3, "{angle_rad} {truth_rad}");
        assert!(
            (truth_rad - start_rad - 0.2).abs() < 2e-3,
            "turned by {}",
            truth_rad - start_rad
        );
    }
    let counters = rig.counters();
    assert_eq!(
        (
            counters.frames_lost,
            counters.working_counter_errors,
            counters.frames_ignored()
        ),
        (0, 0, 0)
    );
}

#[test]
pub(crate) fn a_quick_stop_brakes_with_the_ramp_that_was_written() {
    let mut rig = rig("");
    rig.operational();
    rig.lead(DriveTarget::Enabled, DriveState::OperationEnabled);
    rig.command.demand = Demand::Velocity(2.0);
    rig.run_ms(100);
    let speed_rad_s = rig.cell.state().velocities.0[0];
    assert!((speed_rad_s - 2.0).abs() < 0.05, "{speed_rad_s}");
    rig.command = AxisCommand {
        target: DriveTarget::QuickStop,
        demand: Demand::Velocity(2.0),
    };
    let started_ms = rig.now_ms;
    while rig.cell.state().velocities.0[0].abs() > 0.01 {
        rig.millisecond();
        assert!(rig.now_ms - started_ms < 100, "not at rest");
    }
    // 2 rad/s with 100 rad/s2 take 20 ms, plus a few for the delay to the drive. The drive reads its control word every
    // second millisecond: where the demand of 0 comes one before it, the velocity loop takes half of the speed away.
    let took_ms = rig.now_ms - started_ms;
    let shortest_ms = if clocks_are_on() { 14 } else { 20 };
    assert!((shortest_ms..32).contains(&took_ms), "{took_ms} ms");
}

#[test]
pub(crate) fn a_drive_fault_is_seen_in_the_status_word_and_reset_by_an_edge() {
    let mut rig = rig("");
    rig.operational();
    rig.lead(DriveTarget::Enabled, DriveState::OperationEnabled);
    rig.cell.inject(Fault::Drive(3, 0x2310));
    rig.run_ms(100);
    assert_eq!(rig.drive_states()[2], Some(DriveState::Fault));
    rig.lead_one_fault_away();
    rig.lead(DriveTarget::Enabled, DriveState::OperationEnabled);
}

#[test]
pub(crate) fn disturbed_frames_delay_the_bring_up_and_cost_single_cycles() {
    let script = "chance 0.01 drop\nchance 0.01 lose\nchance 0.01 delay 1\nchance 0.01 duplicate\n\
                  chance 0.01 truncate 30\nchance 0.01 index 7\nchance 0.01 foreign\nchance 0.01 counter 1\n";
    let mut rig = rig(script);
    let took_ms = rig.operational();
    let refused = rig.log.iter().find(|event| matches!(event, BusEvent::Refused { .. }));
    assert_eq!(refused, None, "after {took_ms} ms");
    let mut missing = 0;
    for _ in 0..5_000 {
        rig.millisecond();
        missing += rig.inputs.iter().filter(|input| input.is_none()).count();
    }
    assert!(missing < 5_000 * AXES / 10, "{missing} inputs missing");
    for kind in [
        Ignored::Late,
        Ignored::Duplicate,
        Ignored::Truncated,
        Ignored::EtherType,
    ] {
        assert!(
            rig.counters().ignored[kind as usize] > 20,
            "{kind:?}: {:?}",
            rig.counters()
        );
    }
    assert!(rig.counters().frames_lost > 200 && rig.counters().working_counter_errors > 50);
    let lost = rig
        .log
        .iter()
        .find(|event| matches!(event, BusEvent::SlaveLost { .. } | BusEvent::SlaveLeft { .. }));
    assert_eq!(lost, None, "single frames are no lost slaves");
}

#[test]
pub(crate) fn a_slave_that_leaves_op_is_reported_with_its_code_and_repaired_while_the_others_go_on() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(100);
    rig.cell.inject(Fault::Retreat(2, 0x001D));
    let took_ms = rig.wait_for(100, |event| match event {
        BusEvent::SlaveLeft { position, report } => (*position, report.status, report.code) == (1, 0x14, 0x1D),
        _ => false,
    });
    println!("noticed after {took_ms} ms");
    rig.recover();
    for _ in 0..10_000 {
        if rig.millisecond().contains(&BusEvent::Operational) {
            assert!(rig.log.contains(&BusEvent::Repaired { position: 1 }));
            return;
        }
        for other in [0, 2, 3] {
            assert!(rig.inputs[other].is_some(), "axis {other} lost an input");
        }
    }
    panic!("not repaired: {:#?}", rig.log);
}

#[test]
pub(crate) fn a_bus_that_stood_still_falls_to_the_watchdog_and_is_recovered() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(100);
    rig.cell.inject(Fault::Stall(60));
    rig.wait_for(200, |event| {
        matches!(event, BusEvent::SlaveLost { .. } | BusEvent::SlaveLeft { .. })
    });
    rig.run_ms(200);
    rig.recover();
    rig.operational();
    assert!(rig.cell.state().slaves.iter().all(|slave| slave.al_status_code == 0));
    rig.lead_one_fault_away();
    rig.lead(DriveTarget::Enabled, DriveState::OperationEnabled);
}

#[test]
pub(crate) fn a_power_cycled_slave_comes_back_without_a_reference() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(100);
    rig.robot.home(None).expect("at rest");
    rig.cell.inject(Fault::Power(4, 300));
    rig.wait_for(100, |event| *event == BusEvent::SlaveLost { position: 3 });
    rig.recover();
    rig.wait_for(1_000, |event| {
        matches!(
            event,
            BusEvent::Refused {
                error: BusError::SlaveCount { expected: 4, actual: 3 },
                ..
            }
        )
    });
    rig.run_ms(400);
    rig.recover();
    rig.operational();
    rig.run_ms(10);
    assert_eq!(rig.robot.homes_lost(), [false, false, false, true]);
    assert!(rig.inputs.iter().all(Option::is_some));
}

#[test]
pub(crate) fn a_pulled_cable_is_reported_for_every_slave_behind_it_and_healed() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(100);
    rig.cell.inject(Fault::Cut(2));
    rig.wait_for(150, |event| *event == BusEvent::SlaveLost { position: 3 });
    assert!(rig.log.contains(&BusEvent::SlaveLost { position: 2 }));
    assert!(!rig.log.contains(&BusEvent::SlaveLost { position: 1 }));
    rig.cell.inject(Fault::Join);
    rig.run_ms(100);
    rig.recover();
    rig.operational();
    rig.run_ms(10);
    assert!(rig.inputs.iter().all(Option::is_some));
    let before = rig.counters().working_counter_errors;
    rig.run_ms(100);
    assert_eq!(rig.counters().working_counter_errors, before);
}

#[test]
pub(crate) fn a_bypassed_slave_is_reported_and_taken_back() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(100);
    rig.cell.inject(Fault::Remove(2));
    rig.wait_for(150, |event| *event == BusEvent::SlaveLost { position: 1 });
    rig.cell.inject(Fault::Insert(2));
    rig.run_ms(50);
    rig.recover();
    rig.operational();
}

#[test]
pub(crate) fn a_mailbox_that_stays_silent_is_a_refusal_and_a_second_try_succeeds() {
    let mut rig = rig("ms 60 silence 2 1500\n");
    rig.wait_for(5_000, |event| {
        matches!(
            event,
            BusEvent::Refused {
                position: Some(1),
                error: BusError::MailboxTimeout { .. },
                ..
            }
        )
    });
    rig.run_ms(500);
    rig.recover();
    rig.operational();
}

#[test]
pub(crate) fn a_slave_that_falls_to_any_state_is_repaired_in_either_exchange() {
    for exchange in [ExchangeKind::Split, ExchangeKind::Combined] {
        let mut rig = idle_rig("");
        rig.setup.exchange = exchange;
        rig.start();
        rig.operational();
        for slave in 1..=AXES {
            for state in [AlState::Init, AlState::PreOperational, AlState::SafeOperational] {
                rig.cell.inject(Fault::Fall(slave, state, 0x001A));
                rig.run_ms(100);
                rig.recover();
                rig.wait_for(5_000, |event| *event == BusEvent::Operational);
                rig.run_ms(20);
                assert!(
                    rig.inputs.iter().all(Option::is_some),
                    "{exchange:?}, slave {slave} was in {state:?}"
                );
            }
        }
    }
}
