//! A master, a virtual cell and a clock.
//!
//! Everything runs in virtual time: one millisecond is one input telegram, one output telegram, one poll of the
//! supervisor.

use crate::again::clocks_are_on;
use core::future::Future;
use core::pin::Pin;
use core::task::{Context, Waker};
use etherpen::config::Config;
use etherpen::control::robot_axes::{AxisCommand, AxisInput, Demand, RobotAxes};
use etherpen::drives::cia402::{DriveState, DriveTarget};
use etherpen::drives::io::IoTrigger;
use etherpen::ethercat::clock::steering::{ClockReading, ClockSteering};
use etherpen::ethercat::cyclic::BusCounters;
use etherpen::ethercat::diagnostics::{ServiceReply, ServiceRequest, ServiceResult};
use etherpen::ethercat::supervisor::{BusCommand, BusEvent, Supervisor};
use etherpen::ethercat::wire::{Command, FrameView, register};
use etherpen::robot_bus::{RobotBusCommand, RobotBusQueues, RobotBusSetup, RobotExchange, RobotGroup};
use etherpen::robots::AXES;
use heapless::spsc::{Consumer, Producer};
use host_tools::cell::{Cell, CellOptions, Fault};

const MAC: [u8; 6] = [0x10, 0, 0, 0, 0, 1];
const PERIOD_NS: u64 = 1_000_000;
/// Time from the input telegram to the output telegram.
pub(crate) const OUTPUTS_AFTER_NS: u64 = 200_000;
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
    /// Mailbox messages on the wire, and the one whose frame is lost.
    pub(crate) mail: Mail,
    pub(crate) now_ms: u64,
    /// The reference clock and the number of its time.
    clock: Option<(u16, u8)>,
    /// Keeps the sample's phase to the clocks of the bus.
    steering: ClockSteering,
    /// Sum of its corrections, ns.
    steered_ns: i64,
}

/// Mailbox messages that the slaves have taken and given, by the working counters on the wire.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Mail {
    /// Requests taken.
    pub(crate) requests: u32,
    /// Messages given, repetitions too.
    pub(crate) answers: u32,
    /// Requests to give the last message again.
    pub(crate) repeats: u32,
    /// The message given whose frame is lost on its way to the master, from 1; 0 for none.
    pub(crate) lost: u32,
}

/// The drives' mailboxes.
const MAILBOX_OUT: u16 = 0x1800;
const MAILBOX_IN: u16 = 0x1C00;

impl Mail {
    /// Counts the messages in a frame that has passed the slaves; returns whether it is to be lost.
    fn passes(&mut self, reply: &[u8]) -> bool {
        let Ok(view) = FrameView::new_checked(reply) else {
            return false;
        };
        let before = self.answers;
        for datagram in view.datagrams().filter_map(Result::ok) {
            let (command, at) = (datagram.command_number(), datagram.address().register());
            let is = |wanted: Command, register| command == wanted as u8 && at == register;
            if datagram.working_counter() != 1 {
                continue;
            }
            self.requests += u32::from(is(Command::Fpwr, MAILBOX_OUT));
            self.answers += u32::from(is(Command::Fprd, MAILBOX_IN));
            let activate = register::sync_manager(1) + register::SYNC_MANAGER_ACTIVATE_OFFSET;
            self.repeats += u32::from(is(Command::Fpwr, activate));
        }
        (before + 1..=self.answers).contains(&self.lost)
    }
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
    let mut config = Config::default();
    config.bus.clocks = clocks_are_on();
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
        mail: Mail::default(),
        now_ms: 0,
        clock: None,
        steering: ClockSteering::new(PERIOD_NS as u32),
        steered_ns: 0,
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

    pub(crate) fn transfer(&mut self, frame: &[u8], time_ns: u64) {
        if !frame.is_empty() {
            self.state_requests += state_requests(frame);
            for reply in self.cell.frame_at_ns(time_ns, frame) {
                if !self.mail.passes(&reply) {
                    self.group.arrived(&reply);
                }
            }
        }
    }

    /// Advances by one millisecond; returns the new events.
    pub(crate) fn millisecond(&mut self) -> &[BusEvent] {
        let time_ns = self.sample_ns();
        let frame = self.group.trigger_input().to_vec();
        self.transfer(&frame, time_ns);
        self.steer();
        self.robot.read(&mut self.group);
        self.inputs = self.robot.inputs();
        self.robot.write(&mut self.group, &[self.command; AXES]);
        let frame = self.group.trigger_output().to_vec();
        if let Some(fault) = self.output_fault.take() {
            self.cell.inject(fault);
        }
        self.transfer(&frame, time_ns + OUTPUTS_AFTER_NS);
        let poll = self.supervisor.as_mut().poll(&mut Context::from_waker(Waker::noop()));
        assert!(poll.is_pending());
        self.now_ms += 1;
        let before = self.log.len();
        while let Some(event) = self.events.dequeue() {
            self.log.push(event);
        }
        &self.log[before..]
    }

    /// Corrects the next sample's time by the clocks of the bus, as the firmware's sampler does.
    pub(crate) fn steer(&mut self) {
        let state = self.group.bus_state();
        let clock = state.reference_clock.map(|station| (station, state.time_number));
        let Some((_, time_number)) = clock else {
            return;
        };
        if self.clock != clock {
            match self.clock {
                Some((_, before)) if before == time_number => self.steering.restart(),
                _ => self.steering = ClockSteering::new(PERIOD_NS as u32),
            }
            self.clock = clock;
        }
        let correction_ns = self.steering.step(ClockReading {
            reference_ns: state.clock_ns,
            elapsed_ns: 0,
        });
        self.steered_ns += i64::from(correction_ns);
    }

    /// Time of this millisecond's input telegram, ns.
    pub(crate) fn sample_ns(&self) -> u64 {
        (self.now_ms * PERIOD_NS).saturating_add_signed(self.steered_ns)
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
