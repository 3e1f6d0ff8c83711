//! The sampler over drives in memory: no bus, no robot, four motors that follow their digits.

use super::*;
use crate::config::Config;
use crate::drives::cia402::ControlWord;
use crate::drives::io::GroupDrive;
use crate::drives::{DriveInput, MemoryGroup, PositionRange, ax2000};
use crate::ethercat::cyclic::ExchangeKind;
use crate::motion::Setpoint;
use crate::network::NetworkQueues;
use core::task::Context;
use embassy_net_driver::{Capabilities, HardwareAddress, LinkState, RxToken, TxToken};
use heapless::spsc::Queue;
use std::boxed::Box;
use std::vec::Vec;

type Group = MemoryGroup<AXES>;

/// A port that discards what is sent and returns one reply a cycle.
#[derive(Default)]
struct Port {
    reply: Option<Vec<u8>>,
}

struct Received(Vec<u8>);

impl RxToken for Received {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(mut self, f: F) -> R {
        f(&mut self.0)
    }
}

struct Swallowed;

impl TxToken for Swallowed {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, length: usize, f: F) -> R {
        f(&mut std::vec![0; length])
    }
}

impl Driver for Port {
    type RxToken<'a> = Received;
    type TxToken<'a> = Swallowed;

    fn receive(&mut self, _: &mut Context) -> Option<(Received, Swallowed)> {
        Some((Received(self.reply.take()?), Swallowed))
    }

    fn transmit(&mut self, _: &mut Context) -> Option<Swallowed> {
        Some(Swallowed)
    }

    fn link_state(&mut self, _: &mut Context) -> LinkState {
        LinkState::Up
    }

    fn capabilities(&self) -> Capabilities {
        Capabilities::default()
    }

    fn hardware_address(&self) -> HardwareAddress {
        HardwareAddress::Ethernet([0x10, 0, 0, 0, 0, 1])
    }
}

/// A sampler, its drives, and the slower tasks' ends of its queues.
struct Rig {
    sampler: Sampler<'static, Group>,
    port: FramePort<Port>,
    commands: Producer<'static, SamplerCommand>,
    setpoints: Producer<'static, Queued>,
    reports: Consumer<'static, CycleReport>,
    /// Motor positions, increments, with their fractions.
    motors: [f64; AXES],
}

fn rig() -> Rig {
    let (commands, commands_out) = Box::leak(Box::new(Queue::<SamplerCommand, 17>::new())).split();
    let (setpoints, setpoints_out) = Box::leak(Box::new(Queue::<Queued, 40>::new())).split();
    let (reports_in, reports) = Box::leak(Box::new(Queue::<CycleReport, 33>::new())).split();
    let (network, _, _) = Box::leak(Box::new(NetworkQueues::new())).split();
    let drive = GroupDrive {
        kind: &ax2000::AX2000,
        mode: AxisMode::Velocity,
        range: PositionRange::WHOLE,
        operational: true,
        generation: 0,
    };
    let mut group = Group::new([Some(drive); AXES]);
    group.state.al_status = Some(8);
    group.inputs = [Some(DriveInput {
        mode_in_effect: true,
        ..DriveInput::default()
    }); AXES];
    Rig {
        sampler: Sampler::new(group, network, commands_out, setpoints_out, reports_in),
        port: FramePort::new(Port::default()),
        commands,
        setpoints,
        reports,
        motors: [0.0; AXES],
    }
}

impl Rig {
    fn command(&mut self, command: SamplerCommand) {
        assert!(self.commands.enqueue(command).is_ok());
    }

    /// One millisecond, in which the drives report or are silent.
    fn millisecond(&mut self, answered: bool) -> CycleReport {
        self.sampler.sample(&mut self.port, 0, 0);
        if answered {
            self.port.driver_mut().reply = Some(Group::ARRIVED.to_vec());
            self.sampler.bus_frame(&mut self.port, 100_000);
        }
        self.sampler.bus_deadline(&mut self.port, 300_000);
        self.drives();
        self.reports.dequeue().expect("a report each millisecond")
    }

    /// The drives take their control words, and the motors follow their demands at once.
    fn drives(&mut self) {
        let group = &mut self.sampler.group;
        for (axis, motor) in self.motors.iter_mut().enumerate() {
            let output = group.outputs[axis];
            let input = group.inputs[axis].as_mut().unwrap();
            input.status.0 = match output.control {
                ControlWord::SHUTDOWN => 0x0231,
                ControlWord::SWITCH_ON => 0x0233,
                ControlWord::ENABLE_OPERATION => 0x0237,
                _ => 0x0250,
            };
            // A revolution a minute is 140 digits, and 17.5 increments a millisecond.
            let per_minute = f64::from(output.demand_digits) / Axis::default().digits_per_rpm;
            *motor += per_minute / 60_000.0 * f64::from(1 << 20);
            input.position = *motor as i32;
        }
    }

    /// Configured, homed and in operation.
    fn ready(self) -> Self {
        self.ready_with(&Config::default())
    }

    /// Configured like this, homed and in operation.
    fn ready_with(mut self, config: &Config) -> Self {
        self.command(SamplerCommand::Configure {
            axes: config.controlled_axes().map(|axis| Axis {
                sync_angle_rad: Axis::default().sync_angle_rad,
                ..axis
            }),
            bus: config.bus.clone(),
        });
        (0..30).for_each(|_| _ = self.millisecond(true));
        self.command(SamplerCommand::Home { near: None });
        self.command(SamplerCommand::Power(Power::On));
        (0..30).for_each(|_| _ = self.millisecond(true));
        assert!(self.sampler.robot.is_homed() && self.sampler.robot.is_in_operation());
        self
    }

    /// Queues the setpoints of `count` milliseconds from `first` on: 0.2 rad/s.
    fn queue(&mut self, first: u32, count: u32) {
        for number in first..first + count {
            let setpoint = Setpoint {
                position_rad: [f64::from(number) * 0.2e-3; AXES],
                velocity_rad_s: [0.2; AXES],
                ..Setpoint::default()
            };
            assert!(self.setpoints.enqueue(Queued { epoch: 1, setpoint }).is_ok());
        }
    }
}

#[test]
fn the_leads_are_those_of_the_exchange_that_runs() {
    let demands = |exchange| {
        let mut config = Config::default();
        config.bus.exchange = exchange;
        // The drives in memory answer in two telegrams whatever is configured, as a bus does where a slave needs it.
        let mut rig = rig().ready_with(&config);
        rig.command(SamplerCommand::Follow { epoch: 1 });
        let mut demands = Vec::new();
        for number in 1..=100_u32 {
            // The speed rises: each millisecond of lead is another demand.
            let speed_rad_s = 2.0e-3 * f64::from(number);
            let setpoint = Setpoint {
                position_rad: [1.0e-6 * f64::from(number * number); AXES],
                velocity_rad_s: [speed_rad_s; AXES],
                ..Setpoint::default()
            };
            assert!(rig.setpoints.enqueue(Queued { epoch: 1, setpoint }).is_ok());
            if number > 20 {
                assert_eq!(rig.millisecond(true).fault, None);
                demands.push(rig.sampler.group.outputs.map(|output| output.demand_digits));
            }
        }
        demands
    };
    let [split, combined] = [ExchangeKind::Split, ExchangeKind::Combined].map(demands);
    assert!(split.last() > split.first());
    assert_eq!(split, combined);
}

#[test]
fn motors_in_memory_follow_the_setpoints_as_on_a_bus() {
    let mut rig = rig().ready();
    rig.command(SamplerCommand::Follow { epoch: 1 });
    rig.queue(1, 20);
    for number in 1..=500 {
        let report = rig.millisecond(true);
        assert_eq!((report.fault, report.valid), (None, [true; AXES]));
        rig.queue(number + 20, 1);
        if number > 100 {
            let joint_rad = rig
                .motors
                .map(|motor| motor / f64::from(1 << 20) * core::f64::consts::TAU / 12.0);
            let setpoint_rad = report.setpoint.position_rad[0];
            for joint_rad in joint_rad {
                assert!(
                    (joint_rad - setpoint_rad).abs() < 0.002,
                    "{joint_rad} for {setpoint_rad}"
                );
            }
        }
    }
}

#[test]
fn of_an_axis_that_a_new_configuration_has_no_drive_for_nothing_is_shown_that_was_measured_before() {
    let mut rig = rig().ready();
    rig.command(SamplerCommand::Follow { epoch: 1 });
    rig.queue(1, 39);
    let before = (0..30).map(|_| rig.millisecond(true)).last().unwrap();
    assert!(before.measured_rad_s.iter().all(|rad_s| *rad_s > 0.1), "{before:?}");
    assert!(
        before.shown().iter().all(|at| at.is_some_and(|at| at > 0)),
        "{before:?}"
    );
    for drives in [3, 2, 1] {
        let mut config = Config::default();
        config.bus.drives = drives;
        rig.command(SamplerCommand::Configure {
            axes: config.controlled_axes(),
            bus: config.bus.clone(),
        });
        let after = rig.millisecond(true);
        for axis in usize::from(drives)..AXES {
            let shown = (after.measured_rad_s[axis], after.shown()[axis]);
            assert_eq!(shown, (0.0, Some(0)), "axis {axis} of {drives}");
        }
    }
}

#[test]
fn silent_drives_in_motion_are_stopped_and_the_fault_stays_until_it_is_cleared() {
    let mut rig = rig().ready();
    rig.command(SamplerCommand::Follow { epoch: 1 });
    rig.queue(1, 39);
    (0..10).for_each(|_| _ = rig.millisecond(true));
    assert!(rig.sampler.group.outputs.iter().all(|output| output.demand_digits > 0));
    let stopped_ms = (1..20).find(|_| rig.millisecond(false).fault.is_some());
    assert!(stopped_ms.is_some_and(|ms| ms <= 6), "{stopped_ms:?}");
    for output in &rig.sampler.group.outputs {
        assert_eq!((output.demand_digits, output.control), (0, ControlWord::QUICK_STOP));
    }
    assert!(
        rig.millisecond(true).fault.is_some(),
        "the drives have come back, the fault is latched"
    );
    assert_eq!(rig.sampler.group.outputs[0].demand_digits, 0);
    rig.command(SamplerCommand::Power(Power::Off));
    rig.command(SamplerCommand::ClearFault);
    assert_eq!(rig.millisecond(true).fault, None);
}

#[test]
fn reports_that_nobody_takes_are_counted() {
    let mut rig = rig();
    for _ in 0..40 {
        rig.sampler.sample(&mut rig.port, 0, 0);
        rig.sampler.bus_deadline(&mut rig.port, 300_000);
    }
    let kept = std::iter::from_fn(|| rig.reports.dequeue()).count();
    assert_eq!(kept, 32, "the places of the queue");
    assert_eq!(rig.millisecond(true).counters.reports_dropped, 8);
}

#[test]
fn an_output_telegram_that_leaves_too_late_is_counted() {
    let mut rig = rig();
    let mut counts = Vec::new();
    for elapsed_ns in [OUTPUT_LATE_NS, OUTPUT_LATE_NS + 1, 0, PERIOD_NS] {
        rig.sampler.sample(&mut rig.port, 0, 0);
        rig.sampler.bus_deadline(&mut rig.port, elapsed_ns);
        counts.push(rig.reports.dequeue().map(|report| report.counters.cycles_late));
    }
    assert_eq!(counts, [0, 1, 1, 2].map(Some));
}
