//! The coordinator: decides what the robot does with the host's requests and the other tasks' reports.
//!
//! The host's requests, the bus's events, the critical tasks' reports and the trajectory's progress meet only here.
//! [`Application`] decides the operating modes. The coordinator checks input from outside, passes the decisions to the
//! queues of the faster tasks and describes the state. The queues hold what arrives while the trajectory task delays
//! it.
//!
//! It takes requests as plain values and returns plain answers; which bytes carry them is the
//! [`LinkTask`](crate::link_task::LinkTask)'s work. Each millisecond the caller takes the answers and samples, passes
//! on the requests that have arrived, and then calls [`Coordinator::step`].
//!
//! Invariant: a refused configuration, command or bus request changes nothing; a refused vertex ends the path, and the
//! vertices before it are kept.

mod bus_condition;
mod ends;
mod io;
mod requests;
mod status;

pub use bus_condition::bus_condition;
use bus_condition::terminal_event;
pub use ends::CoordinatorEnds;
pub use status::STATUS_PERIOD_MS;

use crate::application::homing::HomingCheck;
use crate::application::{Action, Application, Condition, Fault, Mode, Power, Progress};
use crate::board::{BoardState, PortState};
use crate::control::sampler::{CycleReport, SamplerCommand};
use crate::ethercat::diagnostics::ServiceResult;
use crate::ethercat::event::{BusCommand, BusEvent};
use crate::ethercat::state::AlReport;
use crate::messages::{Counters, SLAVES_REPORTED, Sample, SlaveStatus};
use crate::motion::Admission;
use crate::robots::{AXES, Kind};
use crate::trajectory_task::{MotionOrder, MotionReport};
use heapless::Vec;
use io::Io;
use status::Told;

/// Progress of the path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathProgress {
    /// Vertices executed and followed by the drives.
    pub executed: u32,
    /// Room for vertices.
    pub free: usize,
    /// Whether the path was executed to its end.
    pub finished: bool,
}

/// What the link lost since start-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkLosses {
    /// Samples that found no room.
    pub samples: u32,
    /// Damaged frames, and frames without a valid message.
    pub frames: u32,
}

/// Operating modes, admission and configuration, between the host and the other tasks.
pub struct Coordinator<'a> {
    ends: CoordinatorEnds<'a>,
    application: Application,
    /// Checks positions against the configuration. Absent until a configuration has been taken.
    admission: Option<Admission>,
    /// Heights of the pen, down and up, mm, on a machine whose pen has no others.
    pen_heights_mm: Option<[f64; 2]>,
    /// Checks poses against the configuration. Absent until a configuration has been taken.
    homing_check: Option<HomingCheck>,
    config_hash: Option<u64>,
    condition: Condition,
    /// Whether the joint angles were referenced at any time since start-up.
    was_referenced: bool,
    motion: MotionReport,
    report: Option<CycleReport>,
    slaves: Vec<SlaveStatus, SLAVES_REPORTED>,
    /// Place in the chain of each axis's drive.
    places: [u8; AXES],
    io: Io,
    /// The slave whose start the bring-up or repair waits for.
    waiting_for: Option<u8>,
    counters: Counters,
    vertices_admitted: u32,
    orders_sent: u32,
    /// Orders sent when the present path had been begun: the trajectory's earlier reports are about another one.
    path_orders: u32,
    /// Bus request in progress, with its number; the inner `None` if an earlier session made it.
    asked: Option<Option<u16>>,
    now_ms: u64,
    board: BoardState,
    /// Port state last passed to the supervisor.
    port_passed_on: PortState,
    /// Whether the supervisor still has to be asked to bring lost slaves back.
    recovery_due: bool,
    /// Whether the path was abandoned since [`Self::take_abandoned`].
    abandoned: bool,
    told: Told,
    told_ms: u32,
}

impl<'a> Coordinator<'a> {
    /// A coordinator without a configuration.
    pub fn new(ends: CoordinatorEnds<'a>) -> Self {
        Self {
            ends,
            application: Application::new(),
            admission: None,
            pen_heights_mm: None,
            homing_check: None,
            config_hash: None,
            condition: Condition::UNKNOWN,
            was_referenced: false,
            motion: MotionReport::default(),
            report: None,
            slaves: Vec::new(),
            places: core::array::from_fn(|axis| axis as u8),
            io: Io::new(),
            waiting_for: None,
            counters: Counters::default(),
            vertices_admitted: 0,
            orders_sent: 0,
            path_orders: 0,
            asked: None,
            now_ms: 0,
            board: BoardState::default(),
            port_passed_on: PortState::Unknown,
            recovery_due: false,
            abandoned: false,
            told: Told::NOTHING,
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

    /// Milliseconds since start-up, as of the last [`Self::advance`].
    pub fn now_ms(&self) -> u64 {
        self.now_ms
    }

    /// Sets the state of the board.
    pub fn set_board(&mut self, board: BoardState) {
        self.board = board;
        self.counters.ethernet_errors = board.ethernet_errors;
    }

    /// Sets what the link lost since start-up.
    pub fn set_link_losses(&mut self, losses: LinkLosses) {
        let not_reported = self.report.map_or(0, |report| report.counters.reports_dropped);
        self.counters.telemetry_dropped = losses.samples.wrapping_add(not_reported);
        self.counters.link_errors = losses.frames;
    }

    /// Takes what the supervisor and the trajectory task have reported.
    pub fn take_events(&mut self) {
        while let Some(event) = self.ends.bus.events.dequeue() {
            self.take_event(&event);
        }
        while let Some(report) = self.ends.motion_reports.dequeue() {
            let is_earlier = report.orders.wrapping_sub(self.path_orders) > u32::MAX / 2;
            let executed = if is_earlier { 0 } else { report.executed };
            self.motion = MotionReport { executed, ..report };
            self.counters.path_starvations = report.starvations;
            self.counters.trajectory_overruns = report.overruns;
        }
    }

    /// Takes the supervisor's next answer, with the number of its request. Drops answers to requests of an earlier
    /// session.
    pub fn take_bus_answer(&mut self) -> Option<(u16, ServiceResult)> {
        loop {
            let result = self.ends.bus.answers.dequeue()?;
            if let Some(Some(id)) = self.asked.take() {
                return Some((id, result));
            }
        }
    }

    /// Takes the sampler's next report and returns its sample for the host.
    pub fn take_sample(&mut self) -> Option<Sample> {
        let report = self.ends.reports.dequeue()?;
        let sample = self.sample(&report);
        self.counters.cycles = report.counters.cycles;
        self.counters.cycles_late = report.counters.cycles_late;
        self.counters.setpoint_underruns = report.counters.underruns;
        self.counters.path_stops_left = report.counters.path_stops_left;
        self.counters.frames_lost = report.bus.frames_lost;
        self.counters.frames_ignored = report.bus.frames_ignored();
        self.counters.working_counter_errors = report.bus.working_counter_errors;
        self.io.take(&report.io);
        self.condition = status::condition(&report, &self.places);
        self.was_referenced |= self.condition.unreferenced.is_none();
        self.report = Some(report);
        Some(sample)
    }

    /// Advances to the time of the last sample and instructs the supervisor. Call it once a millisecond, after the
    /// samples.
    pub fn advance(&mut self) {
        self.instruct_supervisor();
        // Milliseconds come from the sampler: calls merge into one while the trajectory task delays them.
        let cycle = self.report.map_or(0, |report| report.cycle);
        let passed_ms = cycle.wrapping_sub(self.now_ms as u32);
        self.now_ms = self.now_ms.wrapping_add(u64::from(passed_ms));
    }

    /// Steps the operating modes, after the requests of this millisecond. `host_silence_ms` is the time since the host
    /// was last heard.
    pub fn step(&mut self, host_silence_ms: u32) {
        let up_to_date = self.motion.orders == self.orders_sent;
        let progress = Progress {
            idle: self.motion.idle && up_to_date,
            held: self.motion.held && up_to_date,
            stalled_ms: self.motion.stalled_ms,
            executed: self.motion.executed,
        };
        for action in self
            .application
            .step(self.now_ms as u32, &self.condition, progress, host_silence_ms)
        {
            self.carry_out(action);
        }
        self.follow_mode();
    }

    /// Whether the path was abandoned since the last call: the drives are stopping by themselves, and no more vertices
    /// of it may be passed on.
    pub fn take_abandoned(&mut self) -> bool {
        core::mem::take(&mut self.abandoned)
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

    fn take_event(&mut self, event: &BusEvent) {
        // Whatever comes next ends the wait.
        self.waiting_for = match *event {
            BusEvent::Waiting { position, .. } => Some(position),
            _ => None,
        };
        if self.waiting_for.is_some() {
            self.application.bus_waits();
        }
        match *event {
            BusEvent::Slave {
                position,
                identity,
                report,
                member,
                ..
            } => {
                let axis = member.and_then(|member| self.places.get_mut(usize::from(member)));
                axis.into_iter().for_each(|place| *place = position);
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
        let position = terminal_event(event);
        if position.is_some_and(|position| self.io.is_spared(position)) {
            return;
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

    /// Carries out the actions of the operating modes.
    fn carry_out_all(&mut self) {
        for action in self.application.take_actions() {
            self.carry_out(action);
        }
    }

    fn carry_out(&mut self, action: Action) {
        match action {
            Action::Power(power) => {
                self.tell_sampler(SamplerCommand::Power(power));
                if power != Power::On && power != Power::FaultReset {
                    self.abandoned = true;
                }
                // A stop on the path needs the setpoints of the path until it ends.
                if matches!(power, Power::QuickStop | Power::Off) {
                    self.tell_trajectory(MotionOrder::Abandon);
                }
            }
            Action::ClearFault => self.tell_sampler(SamplerCommand::ClearFault),
            Action::Home { near } => self.tell_sampler(SamplerCommand::Home { near }),
            Action::Search => self.tell_sampler(SamplerCommand::Search { kind: self.kind() }),
            Action::EndSearch => self.tell_sampler(SamplerCommand::EndSearch),
            Action::Follow { epoch } => self.tell_sampler(SamplerCommand::Follow { epoch }),
            Action::Place { pose, epoch } => self.tell_trajectory(MotionOrder::Place { pose, epoch }),
            Action::BeginPath => self.tell_trajectory(MotionOrder::BeginPath),
            Action::Motion(command) => self.tell_trajectory(MotionOrder::Command(command)),
            Action::RecoverBus => self.recovery_due = true,
            Action::SetOutput { io, value } => self.tell_sampler(SamplerCommand::SetOutput { io, value }),
        }
    }

    /// Kind of the configured robot.
    fn kind(&self) -> Kind {
        let check = self.homing_check.as_ref();
        check.map_or_else(Kind::default, HomingCheck::kind)
    }

    fn tell_sampler(&mut self, command: SamplerCommand) {
        // The sampler empties its queue every millisecond; a step gives it fewer commands than the queue holds.
        let _ = self.ends.sampler_commands.enqueue(command);
    }

    fn tell_trajectory(&mut self, order: MotionOrder) {
        // The trajectory task empties its queue every 12 ms; commands come from a person or a host's job.
        let counted = u32::from(order.is_counted());
        if self.ends.motion_orders.enqueue(order).is_ok() {
            self.orders_sent = self.orders_sent.wrapping_add(counted);
        }
    }
}

#[cfg(test)]
mod tests;
