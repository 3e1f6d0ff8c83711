//! Recorded drives for the sampler: its inputs are what was recorded, and its outputs go nowhere.
//!
//! A port returns each telegram at once, so that the sampler sees the reply to its input telegram in the same
//! millisecond; in a millisecond without any position it returns nothing.

use embassy_net_driver::{Capabilities, Driver, HardwareAddress, LinkState, RxToken, TxToken};
use etherpen::board::Interlock;
use etherpen::config::{AxisMode, Config, Transport};
use etherpen::control::io::IoPlaces;
use etherpen::control::pen_switch::PenSwitch;
use etherpen::control::sampler::{CycleReport, OUTPUT_LATE_NS, Queued, Sampler, SamplerCommand};
use etherpen::control::tool::ToolOutput;
use etherpen::drives::io::{BusState, GroupDrive, IoGroup, IoTrigger};
use etherpen::drives::{DriveInput, DriveOutput, MemoryGroup, PositionRange, ax2000, generic};
use etherpen::ethercat::cyclic::{Arrival, BusCounters, ExchangeKind};
use etherpen::ethercat::encapsulation::Encapsulation;
use etherpen::ethercat::frame_port::FramePort;
use etherpen::network::NetworkQueues;
use etherpen::robots::AXES;
use heapless::spsc::{Consumer, Producer, Queue};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::task::Context;

type Group = MemoryGroup<AXES>;

/// Setpoints between the replay and the sampler.
const SETPOINTS: usize = 40;
/// Operational, the state of all slaves in an answer to the broadcast.
const AL_OPERATIONAL: u8 = 8;
/// Time at which the reply is overdue, ns after the release.
const DEADLINE_NS: u32 = 300_000;

/// What happens in a millisecond.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Millisecond {
    /// What each drive reports; `None` for silence.
    pub inputs: [Option<DriveInput>; AXES],
    /// The board's input that keeps the drives in quick stop.
    pub interlock: Option<Interlock>,
    /// Output telegrams that were late or not sent.
    pub late: u16,
}

/// Memory of the sampler's queues.
pub(super) struct Queues {
    commands: Queue<SamplerCommand, 17>,
    setpoints: Queue<Queued, SETPOINTS>,
    reports: Queue<CycleReport, 3>,
    network: NetworkQueues,
    group: RefCell<Group>,
}

impl Queues {
    /// Empty queues, and drives that take the configured kinds of demand.
    pub(super) fn new(config: &Config) -> Box<Self> {
        let drives = config.axes.map(|axis| {
            Some(GroupDrive {
                kind: match axis.mode {
                    AxisMode::Velocity | AxisMode::Torque => &ax2000::AX2000,
                    AxisMode::Position => &generic::GENERIC,
                },
                mode: axis.mode,
                range: PositionRange::WHOLE,
                operational: true,
                generation: 0,
            })
        });
        let mut group = Group::new(drives);
        group.state.al_status = Some(AL_OPERATIONAL);
        Box::new(Self {
            commands: Queue::new(),
            setpoints: Queue::new(),
            reports: Queue::new(),
            network: NetworkQueues::new(),
            group: RefCell::new(group),
        })
    }
}

/// The sampler and the slower tasks' ends of its queues.
pub(super) struct Control<'q> {
    sampler: Sampler<'q, Drives<'q>>,
    port: FramePort<Loopback>,
    group: &'q RefCell<Group>,
    commands: Producer<'q, SamplerCommand>,
    setpoints: Producer<'q, Queued>,
    reports: Consumer<'q, CycleReport>,
    missed: u32,
}

impl<'q> Control<'q> {
    /// A sampler with this configuration.
    pub(super) fn new(queues: &'q mut Queues, config: &Config) -> Self {
        let (commands, commands_out) = queues.commands.split();
        let (setpoints, setpoints_out) = queues.setpoints.split();
        let (reports_in, reports) = queues.reports.split();
        let (network, ..) = queues.network.split();
        let group = &queues.group;
        let mut control = Self {
            sampler: Sampler::new(Drives(group), network, commands_out, setpoints_out, reports_in),
            port: FramePort::new(Loopback::default()),
            group,
            commands,
            setpoints,
            reports,
            missed: 0,
        };
        // EtherCAT in UDP would wait for addresses.
        let mut bus = config.bus.clone();
        bus.transport = Transport::Raw;
        // The drives of a replay answer in two telegrams; the leads are those of the exchange that was configured.
        bus.exchange = ExchangeKind::Split;
        let axes = config.controlled_axes();
        control.order(SamplerCommand::Configure { axes, bus });
        // What happened at inputs is not recorded; the height of a pen that an output lifts follows from the configuration.
        control.order(SamplerCommand::ConfigureIo(
            IoPlaces::new(),
            PenSwitch::new(config),
            ToolOutput::default(),
        ));
        control
    }

    /// Gives the sampler a command for the next millisecond.
    pub(super) fn order(&mut self, command: SamplerCommand) {
        // The sampler empties its queue every millisecond, which gives it fewer commands than the queue holds.
        let _ = self.commands.enqueue(command);
    }

    /// Queues a setpoint; returns false when there is no room.
    pub(super) fn offer(&mut self, setpoint: Queued) -> bool {
        self.setpoints.enqueue(setpoint).is_ok()
    }

    /// An axis's drive was configured again.
    pub(super) fn configured_again(&mut self, axis: usize) {
        if let Some(Some(drive)) = self.group.borrow_mut().drives.get_mut(axis) {
            drive.generation = drive.generation.wrapping_add(1);
        }
    }

    /// One millisecond.
    pub(super) fn step(&mut self, now: &Millisecond) -> CycleReport {
        self.group.borrow_mut().inputs = now.inputs;
        self.missed = self.missed.wrapping_add(now.late.saturating_sub(1).into());
        self.sampler.set_interlock(now.interlock);
        self.port.driver_mut().is_silent = now.inputs.iter().all(Option::is_none);
        let arrives_ns = if now.late > 0 { OUTPUT_LATE_NS + 1 } else { 0 };
        self.sampler.sample(&mut self.port, 0, self.missed);
        while self.sampler.bus_frame(&mut self.port, arrives_ns) {}
        self.sampler.bus_deadline(&mut self.port, arrives_ns.max(DEADLINE_NS));
        while self.sampler.bus_frame(&mut self.port, arrives_ns) {}
        self.reports.dequeue().unwrap_or_default()
    }
}

/// The group of drives, shared with the replay.
struct Drives<'q>(&'q RefCell<Group>);

impl IoGroup for Drives<'_> {
    fn renew(&mut self) -> bool {
        self.0.borrow_mut().renew()
    }

    fn drive(&self, member: usize) -> Option<GroupDrive> {
        self.0.borrow().drive(member)
    }

    fn read(&self, member: usize) -> Option<DriveInput> {
        self.0.borrow().read(member)
    }

    fn write(&mut self, member: usize, output: &DriveOutput) {
        self.0.borrow_mut().write(member, output);
    }
}

impl IoTrigger for Drives<'_> {
    fn trigger_input(&mut self) -> &[u8] {
        self.0.borrow_mut().trigger_input();
        &Group::ARRIVED
    }

    fn trigger_output(&mut self) -> &[u8] {
        self.0.borrow_mut().trigger_output();
        &Group::OUTPUT
    }

    fn arrived(&mut self, frame: &[u8]) -> Arrival {
        self.0.borrow_mut().arrived(frame)
    }

    fn exchange_kind(&self) -> ExchangeKind {
        self.0.borrow().exchange_kind()
    }

    fn bus_state(&self) -> BusState {
        self.0.borrow().bus_state()
    }

    fn counters(&self) -> BusCounters {
        self.0.borrow().counters()
    }

    fn set_encapsulation(&mut self, encapsulation: Encapsulation) {
        self.0.borrow_mut().set_encapsulation(encapsulation);
    }
}

/// A port that returns what is sent, or nothing.
#[derive(Default)]
struct Loopback {
    is_silent: bool,
    waiting: VecDeque<Vec<u8>>,
}

struct Returned(Vec<u8>);

impl RxToken for Returned {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(mut self, take: F) -> R {
        take(&mut self.0)
    }
}

struct Sent<'p>(&'p mut Loopback);

impl TxToken for Sent<'_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, length: usize, fill: F) -> R {
        let mut frame = vec![0; length];
        let result = fill(&mut frame);
        if !self.0.is_silent {
            self.0.waiting.push_back(frame);
        }
        result
    }
}

impl Driver for Loopback {
    type RxToken<'a> = Returned;
    type TxToken<'a> = Sent<'a>;

    fn receive(&mut self, _: &mut Context) -> Option<(Returned, Sent<'_>)> {
        let frame = self.waiting.pop_front()?;
        Some((Returned(frame), Sent(self)))
    }

    fn transmit(&mut self, _: &mut Context) -> Option<Sent<'_>> {
        Some(Sent(self))
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
