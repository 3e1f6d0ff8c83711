//! The coordinator through its plain methods, with this test at the other end of its queues.

extern crate std;

use super::*;
use crate::application::{Command, Fault, Mode, Refusal};
use crate::config::{Config, IoDirection, IoPoint, NetworkSettings};
use crate::ethercat::diagnostics::{ServiceError, ServiceReply, ServiceRequest};
use crate::ethercat::error::BusError;
use crate::ethercat::event::Step;
use crate::ethercat::state::AlState;
use crate::measurement::Measurements;
use crate::messages::{ConfigRefusal, PathVertex};
use crate::motion::{Pen, RefusalReason};
use crate::robot_bus::{RobotBusCommand, RobotBusEnd};
use crate::robots::AXES;
use crate::trajectory_task::PathItem;
use heapless::spsc::{Consumer, Producer, Queue};
use std::boxed::Box;

/// All drives in operation, at rest.
fn holding() -> CycleReport {
    CycleReport {
        valid: [true; AXES],
        homed: [true; AXES],
        status_word: [0x0237; AXES],
        standstill: true,
        ..CycleReport::default()
    }
}

/// A coordinator and the other tasks' ends of its queues.
struct Tasks {
    coordinator: Coordinator<'static>,
    reports: Producer<'static, CycleReport>,
    sampler_commands: Consumer<'static, SamplerCommand>,
    vertices: Consumer<'static, PathItem>,
    motion_orders: Consumer<'static, MotionOrder>,
    bus_commands: Consumer<'static, RobotBusCommand>,
    bus_events: Producer<'static, BusEvent>,
    services: Consumer<'static, ServiceRequest>,
    answers: Producer<'static, ServiceResult>,
    network: Consumer<'static, Option<NetworkSettings>>,
    motion: Producer<'static, MotionReport>,
}

fn queue<T, const N: usize>() -> (Producer<'static, T>, Consumer<'static, T>) {
    Box::leak(Box::new(Queue::<T, N>::new())).split()
}

impl Tasks {
    fn new() -> Self {
        let (reports, reports_out) = queue::<_, 5>();
        let (sampler_commands_in, sampler_commands) = queue::<_, 17>();
        let (vertices_in, vertices) = queue::<_, 33>();
        let (motion_orders_in, motion_orders) = queue::<_, 17>();
        let (motion, motion_reports) = queue::<_, 5>();
        let (commands, bus_commands) = queue::<_, 3>();
        let (bus_events, events) = queue::<_, 9>();
        let (services_in, services) = queue::<_, 2>();
        let (answers, answers_out) = queue::<_, 2>();
        let (network_in, network) = queue::<_, 2>();
        let ends = CoordinatorEnds {
            reports: reports_out,
            sampler_commands: sampler_commands_in,
            vertices: vertices_in,
            motion_orders: motion_orders_in,
            motion_reports,
            bus: RobotBusEnd {
                commands,
                events,
                services: services_in,
                answers: answers_out,
            },
            network: network_in,
            measurements: Box::leak(Box::new(Measurements::new())),
        };
        Self {
            coordinator: Coordinator::new(ends),
            reports,
            sampler_commands,
            vertices,
            motion_orders,
            bus_commands,
            bus_events,
            services,
            answers,
            network,
            motion,
        }
    }

    /// Lets ten milliseconds pass with a report of the critical tasks.
    fn pass(&mut self, report: &mut CycleReport) {
        report.cycle += 10;
        self.reports.enqueue(*report).unwrap();
        self.coordinator.take_sample();
        self.coordinator.advance();
        self.coordinator.step(0);
    }

    /// A coordinator that has taken the default configuration, which the other tasks have taken from their queues.
    fn configured() -> Self {
        let mut tasks = Self::new();
        assert!(tasks.coordinator.configure(&Config::default()).is_ok());
        assert!(matches!(tasks.bus_commands.dequeue(), Some(BusCommand::Start(_))));
        tasks.clear();
        tasks
    }

    /// Drops what is in the queues.
    fn clear(&mut self) {
        while self.sampler_commands.dequeue().is_some() {}
        while self.motion_orders.dequeue().is_some() {}
        while self.network.dequeue().is_some() {}
    }

    fn event(&mut self, event: BusEvent) {
        self.bus_events.enqueue(event).unwrap();
        self.coordinator.take_events();
    }

    /// Whether all queues to the other tasks are empty.
    fn queues_are_empty(&self) -> bool {
        self.sampler_commands.is_empty()
            && self.motion_orders.is_empty()
            && self.bus_commands.is_empty()
            && self.network.is_empty()
            && self.vertices.is_empty()
    }
}

fn vertex(x_um: i32) -> PathVertex {
    PathVertex {
        position_um: [x_um, 0, -850_000],
        pen: Pen::Down,
        stroke: 0,
    }
}

#[test]
fn a_configuration_that_the_mode_forbids_changes_nothing() {
    let mut tasks = Tasks::configured();
    let before = tasks.coordinator.status();
    let mut other = Config::default();
    other.work_area.radius_mm = 100.0;
    other.bus.host_silence_ms += 1;
    let refused = ConfigRefusal::NotInMode(Mode::BusConfiguring);
    assert_eq!(tasks.coordinator.configure(&other), Err(refused));
    assert!(tasks.queues_are_empty());
    assert_eq!(tasks.coordinator.status(), before);
    assert_eq!(
        tasks.coordinator.path(&[vertex(150_000)], false),
        Ok(()),
        "the work area is the former one"
    );
    assert_eq!(
        tasks.coordinator.configure(&Config::default()),
        Ok(before.config.unwrap()),
        "the configuration in force is no change"
    );
    assert!(tasks.bus_commands.is_empty());
    tasks.event(BusEvent::Operational);
    assert!(tasks.coordinator.configure(&other).is_ok(), "DrivesOff allows it");
    assert!(matches!(tasks.bus_commands.dequeue(), Some(BusCommand::Start(_))));
}

#[test]
fn a_slave_that_leaves_the_bus_is_a_fault_that_names_it_and_ends_the_path() {
    let mut tasks = Tasks::configured();
    tasks.event(BusEvent::Operational);
    assert_eq!(tasks.coordinator.mode(), Mode::DrivesOff);
    assert!(!tasks.coordinator.take_abandoned());
    let report = AlReport {
        status: 0x14,
        code: 0x1b,
    };
    tasks.event(BusEvent::SlaveLeft { position: 2, report });
    let fault = Fault::SlaveState {
        slave: 2,
        al_state: 0x14,
        al_code: 0x1b,
    };
    assert_eq!(
        (tasks.coordinator.mode(), tasks.coordinator.fault()),
        (Mode::Fault, Some(fault))
    );
    assert_eq!(
        tasks.sampler_commands.dequeue(),
        Some(SamplerCommand::Power(Power::Off))
    );
    assert_eq!(tasks.motion_orders.dequeue(), Some(MotionOrder::Abandon));
    assert!(tasks.coordinator.take_abandoned());
    assert!(!tasks.coordinator.take_abandoned(), "it is told once");
    assert_eq!(
        tasks.coordinator.due_status().and_then(|status| status.fault),
        Some(fault)
    );
    assert_eq!(tasks.coordinator.due_status(), None);
}

#[test]
fn a_vertex_outside_the_work_area_is_refused_with_its_index_and_those_before_it_are_kept() {
    let mut tasks = Tasks::configured();
    let free = tasks.coordinator.free();
    assert_eq!(tasks.coordinator.path(&[vertex(0), vertex(1_000)], false), Ok(()));
    assert_eq!(tasks.coordinator.free(), free - 2);
    let part = [vertex(2_000), vertex(900_000), vertex(3_000)];
    let refusal = tasks.coordinator.path(&part, true).unwrap_err();
    assert_eq!(refusal.index, 3);
    assert!(matches!(refusal.reason, RefusalReason::Outside(_)), "{refusal:?}");
    let kept = std::iter::from_fn(|| tasks.vertices.dequeue());
    let x_mm: std::vec::Vec<_> = kept
        .map(|item| match item {
            PathItem::Vertex(vertex) => Some(vertex.position.x_mm),
            PathItem::End => None,
        })
        .collect();
    assert_eq!(x_mm, [Some(0.0), Some(1.0), Some(2.0), None]);
}

#[test]
fn a_command_is_refused_without_a_configuration_and_changes_nothing() {
    let mut tasks = Tasks::new();
    for command in [Command::Enable, Command::Home, Command::Draw { job: 1 }] {
        assert_eq!(tasks.coordinator.command(command), Err(Refusal::NotConfigured));
    }
    assert!(tasks.queues_are_empty());
    assert_eq!(tasks.coordinator.command(Command::Stop), Ok(()));
    assert_eq!(tasks.coordinator.mode(), Mode::Fault);
}

#[test]
fn the_pose_is_not_taken_before_the_positions_of_all_axes_arrive() {
    let mut tasks = Tasks::configured();
    tasks.event(BusEvent::Operational);
    let mut report = CycleReport {
        cycle: 7,
        valid: [true; AXES],
        standstill: true,
        ..CycleReport::default()
    };
    report.valid[3] = false;
    tasks.reports.enqueue(report).unwrap();
    assert_eq!(tasks.coordinator.take_sample().map(|sample| sample.t_ms), Some(7));
    assert_eq!(tasks.coordinator.take_sample(), None);
    tasks.coordinator.advance();
    assert_eq!(tasks.coordinator.now_ms(), 7);
    tasks.coordinator.step(0);
    let missing = Err(Refusal::NoPosition { axis: 3 });
    assert_eq!(tasks.coordinator.command(Command::Home), missing);
    report.valid[3] = true;
    tasks.reports.enqueue(report).unwrap();
    tasks.coordinator.take_sample();
    tasks.coordinator.step(0);
    assert_eq!(tasks.coordinator.command(Command::Home), Ok(()));
    let taken = SamplerCommand::Home { near: None };
    assert_eq!(tasks.sampler_commands.dequeue(), Some(taken));
}

#[test]
fn the_bus_is_asked_once_at_a_time_and_an_earlier_hosts_answer_is_dropped() {
    let mut tasks = Tasks::configured();
    let change = ServiceRequest::SetState {
        slave: 0,
        state: AlState::Init,
    };
    let refused = ServiceError::NotAllowed(Mode::BusConfiguring.number());
    assert_eq!(tasks.coordinator.ask_bus(1, change), Err(refused));
    assert_eq!(tasks.coordinator.ask_bus(2, ServiceRequest::Bus), Ok(()));
    assert_eq!(tasks.services.dequeue(), Some(ServiceRequest::Bus));
    let busy = Err(ServiceError::Busy);
    assert_eq!(tasks.coordinator.ask_bus(3, ServiceRequest::Bus), busy);
    assert!(tasks.services.is_empty());
    tasks.coordinator.forget_bus_request();
    tasks.answers.enqueue(Ok(ServiceReply::Done)).unwrap();
    assert_eq!(tasks.coordinator.take_bus_answer(), None, "another host asked");
    assert_eq!(tasks.coordinator.ask_bus(4, ServiceRequest::Bus), Ok(()));
    tasks.answers.enqueue(Ok(ServiceReply::Done)).unwrap();
    assert_eq!(tasks.coordinator.take_bus_answer(), Some((4, Ok(ServiceReply::Done))));
}

#[test]
fn the_supervisor_gets_one_order_at_a_time() {
    let mut tasks = Tasks::configured();
    let up = BoardState {
        port: PortState::Up,
        ethernet_errors: 3,
    };
    tasks.coordinator.set_board(up);
    tasks.event(BusEvent::SlaveLost { position: 0 });
    assert_eq!(tasks.coordinator.command(Command::Acknowledge), Ok(()));
    for _ in 0..3 {
        tasks.coordinator.advance();
    }
    assert_eq!(tasks.bus_commands.dequeue(), Some(BusCommand::Port(PortState::Up)));
    assert_eq!(tasks.bus_commands.dequeue(), None);
    tasks.coordinator.advance();
    assert_eq!(tasks.bus_commands.dequeue(), Some(BusCommand::Recover));
    assert_eq!(tasks.coordinator.status().counters.ethernet_errors, 3);
}

#[test]
fn what_the_link_and_the_sampler_drop_is_counted_in_the_status() {
    let mut tasks = Tasks::configured();
    let losses = LinkLosses { samples: 5, frames: 3 };
    tasks.coordinator.set_link_losses(losses);
    let counters = tasks.coordinator.status().counters;
    assert_eq!((counters.telemetry_dropped, counters.link_errors), (5, 3));
    let mut report = CycleReport::default();
    report.counters.reports_dropped = 2;
    tasks.reports.enqueue(report).unwrap();
    tasks.coordinator.take_sample();
    tasks.coordinator.set_link_losses(losses);
    let counters = tasks.coordinator.status().counters;
    assert_eq!((counters.telemetry_dropped, counters.link_errors), (7, 3));
}

#[test]
fn each_drawing_counts_its_vertices_from_0() {
    let mut tasks = Tasks::configured();
    tasks.event(BusEvent::Operational);
    let mut report = holding();
    let mut step = |tasks: &mut Tasks| tasks.pass(&mut report);
    step(&mut tasks);
    assert_eq!(tasks.coordinator.command(Command::Enable), Ok(()));
    for job in 1..=2 {
        // As long as the last setpoints may be in the ring.
        (0..8).for_each(|_| step(&mut tasks));
        assert_eq!(tasks.coordinator.mode(), Mode::Idle);
        assert_eq!(tasks.coordinator.command(Command::Draw { job }), Ok(()));
        let refusal = tasks.coordinator.path(&[vertex(900_000)], false).unwrap_err();
        assert_eq!(refusal.index, 0, "in drawing {job}");
        assert_eq!(tasks.coordinator.path(&[vertex(0), vertex(1_000)], true), Ok(()));
        // The trajectory is at rest, and has taken the order.
        let orders = tasks.coordinator.orders_sent;
        tasks.coordinator.motion = MotionReport {
            idle: true,
            orders,
            ..MotionReport::default()
        };
    }
}

#[test]
fn what_an_earlier_path_has_executed_is_not_told_of_the_next_one() {
    let mut tasks = Tasks::new();
    assert!(tasks.coordinator.configure(&Config::default()).is_ok());
    tasks.event(BusEvent::Operational);
    let mut report = holding();
    let mut step = |tasks: &mut Tasks, vertex: u32| {
        report.setpoint.vertex = vertex;
        tasks.pass(&mut report);
    };
    // What the trajectory reports when all orders but so many are taken.
    let moves = |tasks: &mut Tasks, orders_left: u32, executed: u32| {
        let report = MotionReport {
            idle: true,
            executed,
            orders: tasks.coordinator.orders_sent - orders_left,
            ..MotionReport::default()
        };
        tasks.motion.enqueue(report).unwrap();
        tasks.coordinator.take_events();
        tasks.coordinator.path_progress().executed
    };
    step(&mut tasks, 0);
    assert_eq!(tasks.coordinator.command(Command::Enable), Ok(()));
    step(&mut tasks, 0);
    assert_eq!(tasks.coordinator.command(Command::Draw { job: 1 }), Ok(()));
    step(&mut tasks, 20);
    assert_eq!(moves(&mut tasks, 0, 20), 20);
    assert_eq!(tasks.coordinator.command(Command::Cancel), Ok(()));
    assert_eq!(moves(&mut tasks, 0, 20), 20, "it stays told");
    (0..8).for_each(|_| step(&mut tasks, 20));
    assert_eq!(tasks.coordinator.mode(), Mode::Idle);
    assert_eq!(tasks.coordinator.command(Command::Draw { job: 1 }), Ok(()));
    assert_eq!(moves(&mut tasks, 1, 20), 0, "a report from before the order was taken");
    assert_eq!(moves(&mut tasks, 0, 3), 3);
    assert_eq!(tasks.coordinator.command(Command::Hold), Ok(()));
    assert_eq!(moves(&mut tasks, 1, 4), 4, "another order changes nothing");
}

#[test]
fn a_drawing_ends_while_overrides_are_sent_all_the_time() {
    let mut tasks = Tasks::configured();
    tasks.event(BusEvent::Operational);
    let mut report = holding();
    let mut step = |tasks: &mut Tasks| tasks.pass(&mut report);
    step(&mut tasks);
    assert_eq!(tasks.coordinator.command(Command::Enable), Ok(()));
    step(&mut tasks);
    assert_eq!(tasks.coordinator.command(Command::Draw { job: 1 }), Ok(()));
    step(&mut tasks);
    tasks.coordinator.motion = MotionReport {
        idle: true,
        finished: true,
        orders: tasks.coordinator.orders_sent,
        ..MotionReport::default()
    };
    for percent in 50..58 {
        while tasks.motion_orders.dequeue().is_some() {}
        assert_eq!(tasks.coordinator.command(Command::Override { percent }), Ok(()));
        step(&mut tasks);
    }
    assert_eq!(tasks.coordinator.mode(), Mode::Idle);
    assert!(tasks.coordinator.path_progress().finished);
}

/// An input of a terminal at the fifth place, whose failure is no fault.
fn spared_terminal() -> Config {
    let mut config = Config::default();
    let point = IoPoint {
        name: "spare".try_into().unwrap(),
        slave: 4,
        direction: IoDirection::In,
        bit: Some(0),
        ..IoPoint::default()
    };
    config.io.push(point).unwrap();
    config
}

#[test]
fn a_failed_bring_up_is_told_although_the_failing_slave_is_a_spared_terminal() {
    let mut tasks = Tasks::new();
    assert!(tasks.coordinator.configure(&spared_terminal()).is_ok());
    let step = Step::Address;
    let error = BusError::SiiBusy { waited_ms: 20 };
    let refused = BusEvent::TerminalRefused {
        position: 4,
        step,
        error,
    };
    tasks.event(refused);
    assert_eq!(tasks.coordinator.status().fault, None, "its own failure is none");
    tasks.event(BusEvent::Refused {
        position: Some(4),
        step,
        error,
    });
    let fault = Fault::BusConfiguration {
        slave: 4,
        step: step as u8,
        code: 0,
    };
    let status = tasks.coordinator.status();
    assert_eq!((status.mode, status.fault), (Mode::Fault, Some(fault)));
}
