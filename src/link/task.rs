//! The link task: runs the host protocol and the operating modes once a millisecond at low priority.
//!
//! The host's requests, the bus's events, the critical tasks' reports and the trajectory's progress meet only here.
//! [`Application`] decides. This task checks input from outside, passes the decisions to the queues of the faster tasks
//! and informs the host. The trajectory task may delay it by several milliseconds; its queues hold what arrives
//! meanwhile.

pub use super::ends::{LinkEnds, PortEnds};

use super::device::{DeviceEndpoint, DeviceEvent, Identity, LINE_BYTES_PER_MS};
use super::ports::LinkPort;
use super::protocol::{Command, ConfigRefusal, Counters, PathVertex, SLAVES_REPORTED, Sample, SlaveStatus, Status};
use crate::application::reference::{PoseCheck, positions_arrive};
use crate::application::{ACTIONS_MAX, Action, Application, Condition, Fault, Mode, Power, Progress, Refusal};
use crate::board::{BoardState, Interlock, PortState, PreviousRun};
use crate::config::Config;
use crate::control::sampler::{CycleReport, SamplerCommand};
use crate::coordinator::bus_condition;
use crate::drives::cia402::{DriveState, StatusWord};
use crate::ethercat::diagnostics::{ServiceError, ServiceRequest};
use crate::ethercat::event::{BusCommand, BusEvent};
use crate::ethercat::state::AlReport;
use crate::motion::{Admission, Pen, Vertex};
use crate::robot::{AXES, JointAngles, Position};
use crate::trajectory_task::{MotionOrder, MotionReport, PathItem};
use heapless::Vec;

/// Longest time between two status messages, ms.
pub const STATUS_PERIOD_MS: u32 = 500;
/// Bytes queued ahead for the line; few, so that an answer does not queue behind telemetry.
pub const SENT_AHEAD_BYTES: usize = 2 * LINE_BYTES_PER_MS;

/// Queue entries for the trajectory and the sampler that commands leave free: reserved for a stop and for orders that
/// the operating modes issue by themselves.
const ORDERS_KEPT_FREE: usize = ACTIONS_MAX;

/// The link task.
pub struct LinkTask<'a> {
    ends: LinkEnds<'a>,
    endpoint: DeviceEndpoint,
    application: Application,
    /// Checks positions against the configuration. Absent until a configuration has been taken.
    admission: Option<Admission>,
    /// Checks poses against the configuration. Absent until a configuration has been taken.
    pose_check: Option<PoseCheck>,
    config_hash: Option<u64>,
    condition: Condition,
    /// Whether the joint angles were referenced at any time since start-up.
    was_referenced: bool,
    motion: MotionReport,
    report: Option<CycleReport>,
    slaves: Vec<SlaveStatus, SLAVES_REPORTED>,
    counters: Counters,
    vertices_admitted: u32,
    orders_sent: u32,
    /// Bus request in progress, with its number; the inner `None` if an earlier session made it.
    asked: Option<Option<u16>>,
    now_ms: u64,
    board: BoardState,
    /// Port state last passed to the supervisor.
    port_passed_on: PortState,
    /// Whether the supervisor still has to be asked to bring lost slaves back.
    recovery_due: bool,
    told: Told,
    told_ms: u32,
}

/// What was last reported to the host, and when.
#[derive(Clone, Copy, PartialEq)]
struct Told {
    mode: Mode,
    fault: Option<Fault>,
    recovering: bool,
    interlock: Option<Interlock>,
    port: PortState,
}

impl<'a> LinkTask<'a> {
    /// A link task without a host; `board` is at most 16 bytes.
    pub fn new(board: &'static str, ends: LinkEnds<'a>) -> Self {
        let capacity = u16::try_from(ends.vertices.capacity()).unwrap_or(u16::MAX);
        Self {
            ends,
            endpoint: DeviceEndpoint::new(Identity {
                firmware: env!("CARGO_PKG_VERSION"),
                board,
                capacity,
            }),
            application: Application::new(),
            admission: None,
            pose_check: None,
            config_hash: None,
            condition: Condition::UNKNOWN,
            was_referenced: false,
            motion: MotionReport::default(),
            report: None,
            slaves: Vec::new(),
            counters: Counters::default(),
            vertices_admitted: 0,
            orders_sent: 0,
            asked: None,
            now_ms: 0,
            board: BoardState::default(),
            port_passed_on: PortState::Unknown,
            recovery_due: false,
            told: Told {
                mode: Mode::Startup,
                fault: None,
                recovering: false,
                interlock: None,
                port: PortState::Unknown,
            },
            told_ms: 0,
        }
    }

    /// The operating mode.
    pub fn mode(&self) -> Mode {
        self.application.mode()
    }

    /// The latched fault.
    pub fn fault(&self) -> Option<Fault> {
        self.application.fault()
    }

    /// Sets how the previous run ended, as reported to the host.
    pub fn set_previous_run(&mut self, previous: PreviousRun) {
        self.endpoint.set_previous_run(previous);
    }

    /// Sets the state of the board; call it at every change before [`Self::tick`].
    pub fn set_board(&mut self, board: BoardState) {
        self.board = board;
        self.counters.ethernet_errors = board.ethernet_errors;
    }

    /// Advances by one millisecond.
    pub fn tick(&mut self) {
        self.take_events();
        self.take_reports();
        self.instruct_supervisor();
        self.tell_time();
        for port in LinkPort::ALL {
            self.take_bytes(port);
        }
        let up_to_date = self.motion.orders == self.orders_sent;
        let progress = Progress {
            idle: self.motion.idle && up_to_date,
            held: self.motion.held && up_to_date,
            stalled_ms: self.motion.stalled_ms,
            executed: self.motion.executed,
        };
        let silence_ms = self.endpoint.silence_ms(self.now_ms).unwrap_or(u64::from(u32::MAX));
        let silence_ms = u32::try_from(silence_ms).unwrap_or(u32::MAX);
        for action in self
            .application
            .step(self.now_ms as u32, &self.condition, progress, silence_ms)
        {
            self.carry_out(action);
        }
        self.tell();
    }

    /// Passes the supervisor the port state, or the order to repair the bus; one at a time, so that there is always
    /// room for a new configuration.
    fn instruct_supervisor(&mut self) {
        let (commands, port) = (&mut self.ends.bus.commands, self.board.port);
        if !commands.is_empty() {
            return;
        }
        // There is room.
        if port != self.port_passed_on {
            let _ = commands.enqueue(BusCommand::Port(port));
            self.port_passed_on = port;
        } else if self.recovery_due {
            let _ = commands.enqueue(BusCommand::Recover);
            self.recovery_due = false;
        }
    }

    /// Sets the time from the sampler: releases of this task merge into one while it is delayed.
    fn tell_time(&mut self) {
        let cycle = self.report.map_or(0, |report| report.cycle);
        let passed_ms = cycle.wrapping_sub(self.now_ms as u32);
        self.now_ms = self.now_ms.wrapping_add(u64::from(passed_ms));
    }

    fn take_bytes(&mut self, port: LinkPort) {
        while let Some(byte) = self.ends.port(port).received.dequeue() {
            let free = self.free();
            let Some(Ok(payload)) = self.ends.port(port).decoder.push(byte) else {
                continue;
            };
            match self.endpoint.receive(port, payload, self.now_ms, free) {
                None => {}
                Some(DeviceEvent::Connected) => {
                    self.asked = self.asked.map(|_| None);
                    self.tell_status();
                }
                Some(DeviceEvent::Inquire) => self.tell_status(),
                Some(DeviceEvent::Configure { id, config }) => {
                    let result = self.configure(&config);
                    self.endpoint.configured(id, result);
                }
                Some(DeviceEvent::Command { id, command }) => {
                    let result = self.command(command);
                    self.endpoint.answer(id, result);
                }
                Some(DeviceEvent::Path { vertices, last }) => self.take_path(&vertices, last),
                Some(DeviceEvent::Bus { id, request }) => self.ask_bus(id, request),
                Some(DeviceEvent::Measure { id, request }) => {
                    let answer = self.ends.measurements.answer(request);
                    self.endpoint.measured(id, answer);
                }
            }
        }
    }

    /// Passes a request to the supervisor, or refuses it.
    fn ask_bus(&mut self, id: u16, request: ServiceRequest) {
        let error = if request.changes() && !self.application.may_configure() {
            ServiceError::NotAllowed(self.application.mode().number())
        } else if self.asked.is_none() && self.ends.bus.services.enqueue(request).is_ok() {
            self.asked = Some(Some(id));
            return;
        } else {
            ServiceError::Busy
        };
        self.endpoint.bus_answered(id, Err(error));
    }

    /// Room for vertices; one entry is reserved for the end of the path.
    fn free(&self) -> usize {
        (self.ends.vertices.capacity() - self.ends.vertices.len()).saturating_sub(1)
    }

    fn configure(&mut self, config: &Config) -> Result<u64, ConfigRefusal> {
        config.check()?;
        let hash = config.hash().unwrap_or_default();
        if self.config_hash == Some(hash) {
            return Ok(hash);
        }
        if !self.application.may_configure() {
            return Err(ConfigRefusal::NotInMode(self.application.mode()));
        }
        self.admission = Some(Admission::new(&config.motion_settings())?);
        self.pose_check = Some(PoseCheck::new(config));
        self.config_hash = Some(hash);
        self.slaves.clear();
        self.application.configured(config.bus.host_silence_ms);
        self.tell_sampler(SamplerCommand::Configure {
            axes: config.axes,
            bus: config.bus.clone(),
        });
        self.tell_trajectory(MotionOrder::Configure(config.motion_settings()));
        // The network task empties the queue every millisecond.
        let _ = self.ends.network.enqueue(config.bus.network());
        self.recovery_due = false;
        // There is room, see `instruct_supervisor`.
        let _ = self.ends.bus.commands.enqueue(BusCommand::Start(config.bus_setup()));
        Ok(hash)
    }

    fn command(&mut self, command: Command) -> Result<(), Refusal> {
        let (orders, demands) = (&self.ends.motion_orders, &self.ends.sampler_commands);
        let room = (orders.capacity() - orders.len()).min(demands.capacity() - demands.len());
        if room < ORDERS_KEPT_FREE && command != Command::Stop {
            return Err(Refusal::Busy);
        }
        self.check_target(command)?;
        self.check_reference(command)?;
        self.application.command(command)?;
        if let Command::Draw { .. } = command {
            self.vertices_admitted = 0;
            if let Some(admission) = &mut self.admission {
                admission.restart_at(&self.condition.pose);
            }
            self.motion = MotionReport::default();
        }
        self.carry_out_all();
        Ok(())
    }

    /// Carries out the actions of the operating modes.
    fn carry_out_all(&mut self) {
        for action in self.application.take_actions() {
            self.carry_out(action);
        }
    }

    /// Checks that a single motion has a target inside the work area, or leads into the area.
    fn check_target(&mut self, command: Command) -> Result<(), Refusal> {
        let moves = matches!(
            command,
            Command::Move { .. } | Command::Pen { .. } | Command::Jog { .. }
        );
        // In every other mode the application refuses the command, and the pose may not be known.
        if !moves || !matches!(self.application.mode(), Mode::Idle | Mode::Moving) {
            return Ok(());
        }
        let admission = self.admission.as_mut().ok_or(Refusal::NotConfigured)?;
        let pose = &self.condition.pose;
        let checked = match command {
            Command::Move { position } => admission.check_move(pose, &position),
            Command::Pen { pen } => admission.check_pen(pose, pen),
            // A jog that has begun slows down by itself before a border.
            Command::Jog { velocity_mm_s }
                if self.condition.standstill && velocity_mm_s.iter().all(|v| v.is_finite()) =>
            {
                admission.check_jog(pose, &velocity_mm_s.map(f64::from))
            }
            _ => Ok(()),
        };
        checked.map_err(Refusal::Target)
    }

    /// Checks that the positions of all axes arrive and, for a reference at a known pose, that the pose agrees with
    /// them.
    fn check_reference(&self, command: Command) -> Result<(), Refusal> {
        if !matches!(command, Command::Reference | Command::ReferenceAt { .. }) {
            return Ok(());
        }
        let check = self.pose_check.as_ref().ok_or(Refusal::NotConfigured)?;
        let increments = self.report.map_or([None; AXES], |report| report.shown());
        match command {
            Command::ReferenceAt { pose, position } => check.check(&increments, &pose, position.as_ref()),
            _ => positions_arrive(&increments),
        }
    }

    /// Resolver positions within a motor turn.
    fn increments(&self) -> [Option<u32>; AXES] {
        match (&self.pose_check, &self.report) {
            (Some(check), Some(report)) => check.within_turn(&report.shown()),
            _ => [None; AXES],
        }
    }

    fn take_path(&mut self, vertices: &[PathVertex], last: bool) {
        let Some(admission) = &mut self.admission else { return };
        for wire in vertices {
            let vertex = Vertex {
                position: millimetres(wire.position_um),
                pen: wire.pen,
                stroke: wire.stroke,
            };
            if let Err(refusal) = admission.check(self.vertices_admitted, &vertex) {
                self.endpoint.refuse_vertex(refusal);
                let _ = self.ends.vertices.enqueue(PathItem::End);
                return;
            }
            self.vertices_admitted = self.vertices_admitted.wrapping_add(1);
            // There is room: no more were taken from the line than there was room for.
            let _ = self.ends.vertices.enqueue(PathItem::Vertex(vertex));
        }
        if last {
            let _ = self.ends.vertices.enqueue(PathItem::End);
        }
    }

    fn take_events(&mut self) {
        while let Some(event) = self.ends.bus.events.dequeue() {
            self.take_event(&event);
        }
        while let Some(result) = self.ends.bus.answers.dequeue() {
            if let Some(Some(id)) = self.asked.take() {
                self.endpoint.bus_answered(id, result);
            }
        }
        while let Some(report) = self.ends.motion_reports.dequeue() {
            self.motion = report;
            self.counters.path_starvations = report.starvations;
            self.counters.trajectory_overruns = report.overruns;
        }
    }

    fn take_event(&mut self, event: &BusEvent) {
        match *event {
            BusEvent::Slave {
                position,
                identity,
                report,
                ..
            } => {
                let status = SlaveStatus {
                    vendor: identity.vendor,
                    product: identity.product,
                    al_state: report.status,
                    al_code: report.code,
                    status_word: 0,
                };
                match self.slaves.get_mut(usize::from(position)) {
                    Some(slave) => *slave = status,
                    // Slaves beyond the capacity of a status are not shown.
                    None => drop(self.slaves.push(status)),
                }
            }
            // A slave that does not answer has no state.
            BusEvent::SlaveLost { position } => self.take_state(position, AlReport::default()),
            BusEvent::SlaveLeft { position, report } => self.take_state(position, report),
            _ => {}
        }
        if let Some(condition) = bus_condition(event) {
            self.application.bus(condition);
            self.carry_out_all();
        }
    }

    fn take_state(&mut self, position: u8, report: AlReport) {
        if let Some(slave) = self.slaves.get_mut(usize::from(position)) {
            (slave.al_state, slave.al_code) = (report.status, report.code);
        }
    }

    fn take_reports(&mut self) {
        while let Some(report) = self.ends.reports.dequeue() {
            self.endpoint.sample(self.sample(&report));
            self.counters.cycles = report.counters.cycles;
            self.counters.cycles_late = report.counters.cycles_late;
            self.counters.reference_underruns = report.counters.underruns;
            self.counters.frames_lost = report.bus.frames_lost;
            self.counters.frames_ignored = report.bus.frames_ignored();
            self.counters.working_counter_errors = report.bus.working_counter_errors;
            self.condition = condition(&report);
            self.was_referenced |= self.condition.unreferenced.is_none();
            self.report = Some(report);
        }
        let counts = self.endpoint.counts();
        let not_reported = self.report.map_or(0, |report| report.counters.reports_dropped);
        self.counters.telemetry_dropped = counts.samples_dropped.wrapping_add(not_reported);
        let decoders = [&self.ends.serial.decoder, &self.ends.usb.decoder];
        let errors = decoders.map(|decoder| decoder.counts().bad);
        self.counters.link_errors = errors.into_iter().fold(counts.not_understood, u32::wrapping_add);
    }

    fn sample(&self, report: &CycleReport) -> Sample {
        let single = |values: &[f64; 4]| values.map(|value| value as f32);
        Sample {
            t_ms: report.cycle,
            mode: self.application.mode(),
            stroke: report.reference.stroke,
            pen: if report.following {
                report.reference.pen
            } else {
                Pen::Up
            },
            reference_rad: single(if report.following {
                &report.reference.position_rad
            } else {
                &report.measured_rad
            }),
            measured_rad: single(&report.measured_rad),
            reference_rad_s: if report.following {
                single(&report.reference.velocity_rad_s)
            } else {
                [0.0; 4]
            },
            measured_rad_s: single(&report.measured_rad_s),
        }
    }

    fn tell_sampler(&mut self, command: SamplerCommand) {
        // The sampler empties its queue every millisecond; a step gives it fewer commands than the queue holds.
        let _ = self.ends.sampler_commands.enqueue(command);
    }

    fn carry_out(&mut self, action: Action) {
        match action {
            Action::Power(power) => {
                self.tell_sampler(SamplerCommand::Power(power));
                if matches!(power, Power::QuickStop | Power::Off) {
                    self.endpoint.close_path();
                    self.tell_trajectory(MotionOrder::Abandon);
                }
            }
            Action::ClearFault => self.tell_sampler(SamplerCommand::ClearFault),
            Action::TakeReference { near } => self.tell_sampler(SamplerCommand::TakeReference { near }),
            Action::Follow { epoch } => self.tell_sampler(SamplerCommand::Follow { epoch }),
            Action::Place { pose, epoch } => self.tell_trajectory(MotionOrder::Place { pose, epoch }),
            Action::BeginPath => self.tell_trajectory(MotionOrder::BeginPath),
            Action::Motion(command) => self.tell_trajectory(MotionOrder::Command(command)),
            Action::RecoverBus => self.recovery_due = true,
        }
    }

    fn tell_trajectory(&mut self, order: MotionOrder) {
        // The trajectory task empties its queue every 12 ms; commands come from a person or a host's job.
        if self.ends.motion_orders.enqueue(order).is_ok() {
            self.orders_sent = self.orders_sent.wrapping_add(1);
        }
    }

    fn tell(&mut self) {
        let (free, motion) = (self.free(), self.motion);
        let finished = motion.finished && motion.orders == self.orders_sent && self.application.mode() != Mode::Drawing;
        let followed = self.report.map_or(0, |report| report.reference.vertex);
        self.endpoint.acknowledge(motion.executed.min(followed), free, finished);
        let changed = self.told != self.to_tell();
        if changed || (self.now_ms as u32).wrapping_sub(self.told_ms) >= STATUS_PERIOD_MS {
            self.tell_status();
        }
        let sent = &mut self.ends.port(self.endpoint.port()).sent;
        let room = SENT_AHEAD_BYTES.saturating_sub(sent.len());
        let mut bytes = [0; SENT_AHEAD_BYTES];
        let length = self
            .endpoint
            .transmit(self.now_ms, bytes.get_mut(..room).unwrap_or_default());
        for byte in bytes.iter().take(length) {
            // There is room: the queue is longer than SENT_AHEAD_BYTES.
            let _ = sent.enqueue(*byte);
        }
    }

    fn to_tell(&self) -> Told {
        Told {
            mode: self.application.mode(),
            fault: self.application.fault(),
            recovering: self.application.is_recovering(),
            interlock: self.condition.interlock,
            port: self.board.port,
        }
    }

    fn tell_status(&mut self) {
        (self.told, self.told_ms) = (self.to_tell(), self.now_ms as u32);
        if let Some(report) = &self.report {
            for (slave, status_word) in self.slaves.iter_mut().zip(report.status_word) {
                slave.status_word = status_word;
            }
        }
        self.endpoint.status(Status {
            mode: self.application.mode(),
            fault: self.application.fault(),
            recovering: self.application.is_recovering(),
            interlock: self.condition.interlock,
            port: self.board.port,
            referenced: self.condition.unreferenced.is_none(),
            reference_lost: self.was_referenced && self.condition.unreferenced.is_some(),
            increments: self.increments(),
            config: self.config_hash,
            override_percent: self.application.override_percent(),
            counters: self.counters,
            slaves: self.slaves.clone(),
        });
    }
}

fn millimetres(position_um: [i32; 3]) -> Position {
    let [x_mm, y_mm, z_mm] = position_um.map(|um| f64::from(um) / 1_000.0);
    Position { x_mm, y_mm, z_mm }
}

fn condition(report: &CycleReport) -> Condition {
    let status = report.status_word.map(StatusWord);
    let in_operation = |status: &StatusWord| status.state() == DriveState::OperationEnabled;
    let first = |flags: [bool; AXES]| (0..).zip(flags).find_map(|(axis, flag)| flag.then_some(axis));
    let silent = first(report.valid.map(|valid| !valid));
    let faulty = |axis: usize| report.valid[axis] && status[axis].is_fault();
    Condition {
        pose: JointAngles(report.measured_rad),
        unreferenced: first(report.referenced.map(|referenced| !referenced)),
        powered: silent.is_none() && status.iter().all(in_operation),
        // A drive that does not answer keeps its last known state.
        unpowered: !status.iter().any(|status| status.is_powered()),
        standstill: report.standstill,
        drive_fault: (0..AXES).find(|axis| faulty(*axis)).map(|axis| Fault::Drive {
            axis: axis as u8,
            status_word: report.status_word[axis],
        }),
        silent,
        fault: report.fault,
        interlock: report.interlock,
    }
}
