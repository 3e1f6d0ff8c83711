//! The project's own master on the cell: both were written from the same tables, neither from the other.

use super::*;
use etherpen::control::robot_axes::{AxisCommand, AxisInput, Demand, RobotAxes};
use etherpen::drives::cia402::DriveTarget;
use etherpen::drives::io::IoTrigger;
use etherpen::ethercat::cyclic::Exchange;
use etherpen::ethercat::event::{BusCommand, BusEvent};
use etherpen::ethercat::supervisor::Supervisor;
use etherpen::robot_bus::{RobotBusCommand, RobotBusQueues, RobotGroup};
use std::pin::pin;
use std::task::{Context, Waker};

/// Longest test, milliseconds of the cell's time.
const TEST_MS_MAX: u64 = 20_000;

/// State that a test can read and change each millisecond.
struct Millisecond<'a> {
    now_ms: u64,
    cell: &'a mut Cell,
    robot: &'a mut RobotAxes,
    inputs: [Option<AxisInput>; AXES],
    events: Vec<BusEvent>,
    commands: &'a mut [AxisCommand; AXES],
    orders: Vec<RobotBusCommand>,
    frames_lost: u32,
    working_counter_errors: u32,
}

/// Runs the master against a cell until the test says it is over.
fn run(script: &str, mut test: impl FnMut(&mut Millisecond) -> bool) {
    let config = Config::default();
    let faults = script.parse().expect("a script");
    let options = CellOptions {
        faults,
        ..CellOptions::default()
    };
    let mut cell = Cell::new(&config, options);
    let mut queues = Box::new(RobotBusQueues::new());
    let (exchange_end, supervisor_end, mut application) = queues.split();
    let mut group = RobotGroup::new(Exchange::new(exchange_end, [0x10, 0, 0, 0, 0, 1]));
    let mut supervisor = Supervisor::new(supervisor_end);
    let mut supervision = pin!(supervisor.run());
    let mut context = Context::from_waker(Waker::noop());
    let mut robot = RobotAxes::new(&config.axes, AXES);
    let mut commands = [AxisCommand::default(); AXES];
    let setup = config.bus_setup();
    let mut orders = vec![BusCommand::Start(setup)];
    for now_ms in 0..TEST_MS_MAX {
        for order in orders.drain(..) {
            assert!(application.commands.enqueue(order).is_ok());
        }
        let frame = group.trigger_input().to_vec();
        for reply in cell.frame(now_ms * 1000, &frame) {
            group.arrived(&reply);
        }
        robot.read(&mut group);
        let inputs = robot.inputs();
        let counters = group.counters();
        let mut millisecond = Millisecond {
            now_ms,
            cell: &mut cell,
            robot: &mut robot,
            inputs,
            events: std::iter::from_fn(|| application.events.dequeue()).collect(),
            commands: &mut commands,
            orders: Vec::new(),
            frames_lost: counters.frames_lost,
            working_counter_errors: counters.working_counter_errors,
        };
        if test(&mut millisecond) {
            return;
        }
        orders = millisecond.orders;
        robot.write(&mut group, &commands);
        let frame = group.trigger_output().to_vec();
        for reply in cell.frame(now_ms * 1000 + 100, &frame) {
            group.arrived(&reply);
        }
        assert!(supervision.as_mut().poll(&mut context).is_pending());
    }
    panic!("not over after {TEST_MS_MAX} ms: {:?}", cell.state());
}

fn lead(commands: &mut [AxisCommand; AXES], target: DriveTarget, velocity_rad_s: f64) {
    let demand = Demand::Velocity(velocity_rad_s);
    *commands = [AxisCommand { target, demand }; AXES];
}

fn all_in(cell: &Cell, drive: DriveState) -> bool {
    cell.state().slaves.iter().all(|slave| slave.drive == drive)
}

#[test]
fn the_master_brings_the_drives_up_references_and_moves_them() {
    let mut operational_ms = None;
    let mut moved_ms = None;
    run("", |now| {
        if now.events.contains(&BusEvent::Operational) {
            println!("OP after {} ms and {} frames", now.now_ms, now.cell.state().frames);
            operational_ms = Some(now.now_ms);
            lead(now.commands, DriveTarget::Enabled, 0.0);
        }
        if all_in(now.cell, DriveState::OperationEnabled) && moved_ms.is_none() {
            now.robot.home(None).expect("drives at rest");
            lead(now.commands, DriveTarget::Enabled, 0.5);
            moved_ms = Some(now.now_ms);
        }
        let Some(moved_ms) = moved_ms else { return false };
        let truth = now.cell.state();
        if now.now_ms < moved_ms + 500 {
            return false;
        }
        for (axis, input) in now.inputs.iter().enumerate() {
            let angle_rad = input.and_then(|input| input.angle_rad).expect("referenced");
            let aged_rad = truth.joints.0[axis] - 0.5 * 1e-3;
            assert!(
                (angle_rad - aged_rad).abs() < 2e-6,
                "axis {axis}: {angle_rad} {aged_rad}"
            );
            assert!((truth.velocities.0[axis] - 0.5).abs() < 1e-3, "{truth:?}");
        }
        assert!(operational_ms.is_some_and(|ms| ms < 3_000));
        assert_eq!((now.frames_lost, now.working_counter_errors), (0, 0));
        true
    });
}

#[test]
fn a_bypassed_slave_is_lost_and_comes_back_on_recovery() {
    let mut steps = Vec::new();
    run("", |now| {
        for event in &now.events {
            match event {
                BusEvent::Operational if steps.is_empty() => {
                    steps.push("operational");
                    now.cell.inject(Fault::Remove(3));
                }
                BusEvent::SlaveLost { position: 2 } => {
                    steps.push("lost");
                    now.cell.inject(Fault::Insert(3));
                    now.orders.push(BusCommand::Recover);
                }
                BusEvent::Repaired { position: 2 } => steps.push("repaired"),
                _ => {}
            }
        }
        steps == ["operational", "lost", "repaired"]
            && now
                .cell
                .state()
                .slaves
                .iter()
                .all(|slave| slave.al_state == AlState::Operational)
    });
}

#[test]
fn a_power_cycled_slave_is_configured_again() {
    let mut steps = Vec::new();
    run("", |now| {
        for event in &now.events {
            match event {
                BusEvent::Operational if steps.is_empty() => {
                    steps.push("operational");
                    now.cell.inject(Fault::Power(4, 50));
                }
                BusEvent::SlaveLost { position: 3 } => steps.push("lost"),
                BusEvent::Repaired { position: 3 } => steps.push("repaired"),
                _ => {}
            }
        }
        let slave = now.cell.state().slaves[3];
        if steps.last() == Some(&"lost") && slave.powered {
            assert_eq!(slave.al_state, AlState::Init);
            steps.push("powered");
            now.orders.push(BusCommand::Recover);
        }
        steps == ["operational", "lost", "powered", "repaired"] && slave.al_state == AlState::Operational
    });
}

#[test]
fn a_slave_that_retreats_is_reported_with_its_code() {
    let mut sent = false;
    run("", |now| {
        if now.events.contains(&BusEvent::Operational) && !sent {
            now.cell.inject(Fault::Retreat(2, 0x0027));
            sent = true;
        }
        now.events.iter().any(|event| match event {
            BusEvent::SlaveLeft { position, report } => {
                assert_eq!((*position, report.status, report.code), (1, 0x14, 0x0027));
                true
            }
            _ => false,
        })
    });
}

#[test]
fn a_bus_that_damages_every_tenth_reply_is_brought_up_all_the_same() {
    let script = "chance 0.04 lose\nchance 0.02 drop\nchance 0.02 duplicate\nchance 0.01 delay 3\n\
                  chance 0.01 truncate 40\nchance 0.01 index 5\nchance 0.01 foreign";
    run(script, |now| {
        let operational = now.events.contains(&BusEvent::Operational);
        assert!(
            !now.events.iter().any(|event| matches!(event, BusEvent::Refused { .. })),
            "{:?}",
            now.events
        );
        if operational {
            println!("OP after {} ms, {} frames lost", now.now_ms, now.frames_lost);
        }
        operational
    });
}
