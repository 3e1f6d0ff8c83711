//! A master, a virtual cell and a clock.
//!
//! Everything runs in virtual time: one millisecond is one input telegram, one output telegram, one poll of the
//! supervisor.

use core::future::Future;
use core::pin::Pin;
use core::task::{Context, Waker};
use etherpen::config::Config;
use etherpen::control::robot_axes::{AxisCommand, AxisInput, Demand, RobotAxes};
use etherpen::drives::cia402::{DriveState, DriveTarget};
use etherpen::drives::io::IoTrigger;
use etherpen::ethercat::cyclic::BusCounters;
use etherpen::ethercat::diagnostics::{ServiceReply, ServiceRequest, ServiceResult};
use etherpen::ethercat::supervisor::{BusCommand, BusEvent, Supervisor};
use etherpen::ethercat::wire::{Command, FrameView, register};
use etherpen::robot_bus::{RobotBusCommand, RobotBusQueues, RobotBusSetup, RobotExchange, RobotGroup};
use etherpen::robots::AXES;
use heapless::spsc::{Consumer, Producer};
use host_tools::cell::{Cell, CellOptions, Fault};

const MAC: [u8; 6] = [0x10, 0, 0, 0, 0, 1];
const NO_INPUTS: [Option<AxisInput>; AXES] = [None; AXES];

/// A master, a cell, and a clock.
pub(crate) struct Rig<'a> {
    pub(crate) cell: Cell,
    pub(crate) group: RobotGroup<'a>,
    pub(crate) supervisor: Pin<Box<dyn Future<Output = ()> + 'a>>,
    pub(crate) commands: Producer<'a, RobotBusCommand>,
    pub(crate) events: Consumer<'a, BusEvent>,
    pub(crate) services: Producer<'a, ServiceRequest>,
    pub(crate) answers: Consumer<'a, ServiceResult>,
    pub(crate) setup: RobotBusSetup,
    pub(crate) robot: RobotAxes,
    pub(crate) inputs: [Option<AxisInput>; AXES],
    pub(crate) command: AxisCommand,
    /// Fault of the next output telegram.
    pub(crate) output_fault: Option<Fault>,
    pub(crate) log: Vec<BusEvent>,
    /// Writes to AL control that the master has sent.
    pub(crate) state_requests: u32,
    pub(crate) now_ms: u64,
}

/// Number of datagrams in a frame that write to AL control.
fn state_requests(frame: &[u8]) -> u32 {
    let view = FrameView::new_checked(frame).expect("a frame of the master");
    let datagrams = view.datagrams().filter_map(Result::ok);
    let writes = datagrams.filter(|datagram| {
        let command = datagram.command_number();
        let is_write = [Command::Apwr, Command::Fpwr, Command::Bwr].map(|write| write as u8);
        is_write.contains(&command) && datagram.address().register() == register::AL_CONTROL
    });
    writes.count() as u32
}

/// A started rig with this script of faults; it lives as long as the program.
pub(crate) fn rig(script: &str) -> Rig<'static> {
    let mut rig = idle_rig(script);
    rig.start();
    rig
}

/// A rig whose supervisor has no command yet; the cell follows a fault script.
pub(crate) fn idle_rig(script: &str) -> Rig<'static> {
    idle_rig_of(CellOptions {
        faults: script.parse().expect("the script"),
        ..CellOptions::default()
    })
}

/// A rig whose supervisor has no command yet, with these options of the cell.
pub(crate) fn idle_rig_of(options: CellOptions) -> Rig<'static> {
    let config = Config::default();
    let queues = Box::leak(Box::new(RobotBusQueues::new()));
    let (exchange_end, supervisor_end, application) = queues.split();
    let setup = config.bus_setup();
    Rig {
        cell: Cell::new(&config, options),
        group: RobotGroup::new(RobotExchange::new(exchange_end, MAC)),
        supervisor: Box::pin(async move {
            let mut supervisor = Supervisor::new(supervisor_end);
            supervisor.run().await
        }),
        commands: application.commands,
        events: application.events,
        services: application.services,
        answers: application.answers,
        setup,
        robot: RobotAxes::new(&config.axes, AXES),
        inputs: NO_INPUTS,
        command: AxisCommand::default(),
        output_fault: None,
        log: Vec::new(),
        state_requests: 0,
        now_ms: 0,
    }
}

impl Rig<'_> {
    /// Tells the supervisor to bring the bus up.
    pub(crate) fn start(&mut self) {
        let setup = self.setup.clone();
        assert!(self.commands.enqueue(BusCommand::Start(setup)).is_ok());
    }

    /// Sends a service request and runs until the answer arrives; the inputs of the axes in `running` must never fail.
    pub(crate) fn ask_while(&mut self, request: ServiceRequest, running: &[usize]) -> ServiceResult {
        assert!(self.services.enqueue(request.clone()).is_ok());
        for _ in 0..10_000 {
            self.millisecond();
            for axis in running {
                assert!(
                    self.inputs[*axis].is_some(),
                    "axis {axis} lost an input at {} ms",
                    self.now_ms
                );
            }
            if let Some(answer) = self.answers.dequeue() {
                return answer;
            }
        }
        panic!("no answer to {request:?}");
    }

    /// Sends a service request and runs until the answer arrives.
    pub(crate) fn ask(&mut self, request: ServiceRequest) -> ServiceResult {
        self.ask_while(request, &[])
    }

    /// Reads a value that is one piece long.
    pub(crate) fn value(&mut self, request: ServiceRequest) -> Vec<u8> {
        match self.ask(request) {
            Ok(ServiceReply::Piece { total, piece }) => {
                assert_eq!(usize::from(total), piece.len());
                piece.to_vec()
            }
            other => panic!("{other:?}"),
        }
    }

    pub(crate) fn transfer(&mut self, frame: &[u8], time_us: u64) {
        if !frame.is_empty() {
            self.state_requests += state_requests(frame);
            for reply in self.cell.frame(time_us, frame) {
                self.group.arrived(&reply);
            }
        }
    }

    /// Advances by one millisecond; returns the new events.
    pub(crate) fn millisecond(&mut self) -> &[BusEvent] {
        let time_us = self.now_ms * 1000;
        let frame = self.group.trigger_input().to_vec();
        self.transfer(&frame, time_us);
        self.robot.read(&mut self.group);
        self.inputs = self.robot.inputs();
        self.robot.write(&mut self.group, &[self.command; AXES]);
        let frame = self.group.trigger_output().to_vec();
        if let Some(fault) = self.output_fault.take() {
            self.cell.inject(fault);
        }
        self.transfer(&frame, time_us + 200);
        let poll = self.supervisor.as_mut().poll(&mut Context::from_waker(Waker::noop()));
        assert!(poll.is_pending());
        self.now_ms += 1;
        let before = self.log.len();
        while let Some(event) = self.events.dequeue() {
            self.log.push(event);
        }
        &self.log[before..]
    }

    pub(crate) fn run_ms(&mut self, duration_ms: u32) {
        for _ in 0..duration_ms {
            self.millisecond();
        }
    }

    /// Runs until an event is `wanted`; returns the time that it took, ms.
    pub(crate) fn wait_for(&mut self, limit_ms: u64, wanted: impl Fn(&BusEvent) -> bool) -> u64 {
        for waited_ms in 1..=limit_ms {
            if self.millisecond().iter().any(&wanted) {
                return waited_ms;
            }
        }
        panic!("not within {limit_ms} ms, at {} ms: {:#?}", self.now_ms, self.log);
    }

    pub(crate) fn operational(&mut self) -> u64 {
        self.wait_for(10_000, |event| *event == BusEvent::Operational)
    }

    pub(crate) fn recover(&mut self) {
        assert!(self.commands.enqueue(BusCommand::Recover).is_ok());
    }

    pub(crate) fn drive_states(&self) -> Vec<Option<DriveState>> {
        self.inputs
            .iter()
            .map(|input| input.map(|input| input.status.state()))
            .collect()
    }

    /// Leads the drives to `target` at rest and waits until all are in `state`.
    pub(crate) fn lead(&mut self, target: DriveTarget, state: DriveState) {
        self.command = AxisCommand {
            target,
            demand: Demand::Velocity(0.0),
        };
        for _ in 0..3_000 {
            self.millisecond();
            if self.drive_states() == [Some(state); AXES] {
                return;
            }
        }
        panic!("{target:?} ended in {:?}", self.drive_states());
    }

    pub(crate) fn counters(&self) -> BusCounters {
        self.group.exchange().counters()
    }

    /// Off for a moment, then fault reset, as the application does.
    pub(crate) fn lead_one_fault_away(&mut self) {
        self.command = AxisCommand {
            target: DriveTarget::Off,
            demand: Demand::Velocity(0.0),
        };
        self.run_ms(20);
        self.lead(DriveTarget::FaultReset, DriveState::SwitchOnDisabled);
    }
}
