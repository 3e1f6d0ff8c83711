//! Jobs on a machine, from the greeting on: inspect, command, prepare, move, draw.
//!
//! The phases are connect, inspect, configure, wait for the bus, reference, enable, work, bring to rest. Each phase
//! waits for a report of the firmware, never for a fixed time, and has a time limit after which the job reports what it
//! waited for. A job keeps its connection when its task has ended, and takes further tasks.
//!
//! Invariants: a fault that is found is reported, and acknowledged only if the options or the task say so. Progress
//! counts executed vertices, not sent ones. A drawing is done when the pen was measured along its path, not when the
//! firmware says so. If a task that moves the robot ends early for any reason, the job asks the robot to come to rest
//! and to switch off the power that the task switched on. A step does only a bounded part of a drawing's verification,
//! so that STOP never waits for it. A drawing held since another connection is resumed only if the firmware still holds
//! exactly that drawing.

#[cfg(test)]
mod damaged_tests;
pub mod error;
mod events;
pub mod history;
pub mod ink;
pub mod logged;
pub mod over_port;
mod phases;
pub mod progress;
pub mod reference;
pub mod remainder;
pub mod resume;
pub mod task;
pub mod verification;

use crate::link::measurement::Reader;
use crate::link::session::{Session, SessionCounts};
use error::{JobError, Phase};
use etherpen::application::{Fault, Mode};
use etherpen::config::Config;
use etherpen::ethercat::diagnostics::ServiceRequest;
use etherpen::link::message::PathAck;
use etherpen::measurement::MeasurementRequest;
use etherpen::messages::{Command, PathVertex, RecordRequest, Sample, Status, Welcome};
pub use phases::{BUS_MAX_MS, SILENCE_MAX_MS, STEP_MAX_MS};
use progress::{PathMeasure, Progress};
use std::collections::VecDeque;
use std::sync::Arc;
pub use task::{Control, DrawTask, JobEvent, JobOptions, JobReport, Life, Motion, Ready, Task, path_hash, path_number};
use verification::{Verification, Verifier};

/// Looks at a leg of the path that verification may take in one step. A look takes some tens of nanoseconds.
const LOOKS_PER_STEP: usize = 10_000;
/// Looks when a report is taken before verification has finished, because the connection is lost.
const LOOKS_AT_LAST: usize = 500_000;
/// Signs of life that a jog requires; without a [`Life`] the jog depends on this process alone.
#[derive(Clone, Debug, Default)]
struct Lifeline {
    life: Option<Life>,
    /// Signs already used.
    seen: u64,
    /// Time of the last used sign, ms.
    seen_ms: u64,
}

impl Lifeline {
    /// Uses the new signs; returns whether there was any since the last call.
    fn take_sign(&mut self, now_ms: u64) -> bool {
        let Some(life) = &self.life else { return true };
        let signs = life.signs();
        let fresh = signs != self.seen;
        if fresh {
            (self.seen, self.seen_ms) = (signs, now_ms);
        }
        fresh
    }
}

/// A connection and the tasks carried out over it, as a state machine.
pub struct Job {
    session: Session,
    options: JobOptions,
    config: Config,
    task: Task,
    measure: PathMeasure,
    now_ms: u64,
    phase: Phase,
    entered_ms: u64,
    /// Number of the phase's own command, until it is answered.
    awaited: Option<u16>,
    /// Whether the phase's command was accepted.
    accepted: bool,
    retry_ms: u64,
    inquired_ms: u64,
    fault_since_ms: Option<u64>,
    /// Time since which the robot has been at rest before the end of the path, ms.
    over_since_ms: Option<u64>,
    /// Whether a status arrived since the last accepted command.
    fresh: bool,
    /// Whether the drives had power at the start of the task.
    found_powered: bool,
    /// Whether the drawing is to be held as soon as the pen is up.
    hold_at_pen_up: bool,
    /// Why the task is being ended early.
    ending: Option<JobError>,
    outcome: Option<Result<(), JobError>>,
    /// Why the connection is broken, if it is.
    broken: Option<JobError>,
    welcome: Option<Welcome>,
    status: Option<Status>,
    status_before: Option<Status>,
    sample: Option<Sample>,
    ack: PathAck,
    /// Vertices that were already executed when this connection resumed the drawing.
    executed_before: u32,
    drawing_ms: Option<u64>,
    drawn_ms: u64,
    held_ms: u64,
    samples: Vec<Sample>,
    /// Verifies the drawing from its telemetry.
    verifier: Option<Verifier>,
    verification: Verification,
    /// Vertices before the first incomplete stroke, if the path ended with incomplete strokes.
    complete: Option<u32>,
    /// Reads the firmware's measurements once the robot is at rest.
    reader: Option<Reader>,
    /// Signs of life that a jog requires.
    life: Lifeline,
    /// For each unanswered measurement request: whether the job itself made it.
    questions: VecDeque<bool>,
    events: VecDeque<JobEvent>,
}

/// Whether the machine stands in a fault of another configuration that this one may resolve: the bus is not the one that the
/// other expects. That a slave was not configured may have other causes, so this has to be acknowledged.
pub(crate) fn is_resolved_by(config: &Config, status: &Status, acknowledge: bool) -> bool {
    let stands = status.mode == Mode::Fault && !status.recovering;
    let is_other = status.config != config.hash();
    let is_of_configuration = |fault: Fault| match fault {
        Fault::BusConfiguration { .. } => acknowledge,
        fault => fault.is_of_configuration(),
    };
    stands && is_other && status.fault.is_some_and(is_of_configuration)
}

impl Job {
    /// A job that connects and carries out `task`.
    pub fn new(config: Config, task: Task, options: JobOptions) -> Self {
        let mut session = Session::new(options.session);
        session.connect();
        Self {
            session,
            options,
            measure: measure_of(&task, &config),
            config,
            task,
            now_ms: 0,
            phase: Phase::Connecting,
            entered_ms: 0,
            awaited: None,
            accepted: false,
            retry_ms: 0,
            inquired_ms: 0,
            fault_since_ms: None,
            over_since_ms: None,
            fresh: false,
            found_powered: false,
            hold_at_pen_up: false,
            ending: None,
            outcome: None,
            broken: None,
            welcome: None,
            status: None,
            status_before: None,
            sample: None,
            ack: PathAck::default(),
            executed_before: 0,
            drawing_ms: None,
            drawn_ms: 0,
            held_ms: 0,
            samples: Vec::new(),
            verifier: None,
            verification: Verification::default(),
            complete: None,
            reader: None,
            life: Lifeline::default(),
            questions: VecDeque::new(),
            events: VecDeque::new(),
        }
    }

    /// A job that draws `vertices` with this configuration.
    pub fn draw(config: Config, vertices: impl Into<Arc<[PathVertex]>>, options: JobOptions) -> Self {
        Self::new(config, Task::Draw(DrawTask::new(vertices)), options)
    }

    /// Starts another task over the present connection, after the last one has ended.
    pub fn begin(&mut self, task: Task) {
        self.measure = measure_of(&task, &self.config);
        self.task = task;
        (self.ending, self.outcome) = (None, None);
        (self.fault_since_ms, self.over_since_ms) = (None, None);
        (self.found_powered, self.hold_at_pen_up) = (false, false);
        (self.ack, self.executed_before) = (PathAck::default(), 0);
        (self.drawing_ms, self.drawn_ms, self.held_ms) = (None, 0, 0);
        (self.samples, self.reader) = (Vec::new(), None);
        (self.verifier, self.complete) = (None, None);
        self.verification = Verification::default();
        self.life = Lifeline::default();
        self.status_before = None;
        if let Some(broken) = self.broken {
            return self.fail(broken);
        }
        self.enter(match self.phase {
            Phase::Connecting => Phase::Connecting,
            _ => Phase::Inspecting,
        });
    }

    /// Makes a jog depend on signs of life of the program that ordered it: each repetition of the jog needs a new sign,
    /// so the firmware's dead-man switch also acts if that program fails while this one runs.
    pub fn live_on(&mut self, life: Life) {
        self.life = Lifeline {
            life: Some(life),
            ..Lifeline::default()
        };
    }

    /// Advances by about a millisecond: takes the received bytes and appends at most `room` bytes to `outgoing`.
    ///
    /// `now_ms` starts near 0 and does not go back; in lockstep it is the firmware's millisecond.
    pub fn step(&mut self, now_ms: u64, incoming: &[u8], outgoing: &mut Vec<u8>, room: usize) {
        self.count_held(now_ms.saturating_sub(self.now_ms));
        self.now_ms = now_ms;
        self.session.receive(incoming, now_ms);
        while let Some(event) = self.session.next_event() {
            self.take(event);
        }
        self.watch_connection();
        if self.outcome.is_none() {
            self.supervise();
        }
        if self.outcome.is_none() {
            self.advance();
        }
        let before = outgoing.len();
        outgoing.resize(before.saturating_add(room), 0);
        let filled = self
            .session
            .transmit(now_ms, outgoing.get_mut(before..).unwrap_or_default());
        outgoing.truncate(before.saturating_add(filled));
        if let Some(verifier) = &mut self.verifier {
            verifier.work(LOOKS_PER_STEP);
        }
    }

    /// How the task ended; `None` while it runs or while samples of a finished drawing are still to be verified.
    pub fn outcome(&self) -> Option<&Result<(), JobError>> {
        let is_verified = self.broken.is_some() || !self.verifier.as_ref().is_some_and(Verifier::is_behind);
        self.outcome.as_ref().filter(|_| is_verified)
    }

    /// Why the connection is broken, if it is; a broken connection needs a new job.
    pub fn broken(&self) -> Option<&JobError> {
        self.broken.as_ref()
    }

    /// The collected data, whether the task has succeeded, failed or is still running.
    pub fn into_report(mut self) -> JobReport {
        self.take_report()
    }

    /// The data collected so far; the job continues.
    pub fn take_report(&mut self) -> JobReport {
        if let Some(verifier) = self.verifier.take() {
            self.verification = verifier.finish_within(LOOKS_AT_LAST, self.ack.finished);
        }
        let progress = self.progress();
        JobReport {
            progress,
            verification: std::mem::take(&mut self.verification),
            drawn_s: progress.elapsed_s,
            held_s: self.held_ms as f64 / 1_000.0,
            welcome: self.welcome.clone(),
            samples: std::mem::take(&mut self.samples),
            measurements: self.reader.take().and_then(Reader::into_readings),
            link: self.session.counts(),
            status: self.status.clone(),
            status_before: self.status_before.take(),
        }
    }

    /// The phase the job is in.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// The task.
    pub fn task(&self) -> &Task {
        &self.task
    }

    /// The configuration sent by this job.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The last status.
    pub fn status(&self) -> Option<&Status> {
        self.status.as_ref()
    }

    /// The last sample.
    pub fn sample(&self) -> Option<&Sample> {
        self.sample.as_ref()
    }

    /// The firmware's answer to the greeting.
    pub fn welcome(&self) -> Option<&Welcome> {
        self.welcome.as_ref()
    }

    /// Counters of the connection.
    pub fn counts(&self) -> SessionCounts {
        self.session.counts()
    }

    /// State of a path that the firmware has from another connection.
    pub fn held_path(&self) -> Option<&PathAck> {
        self.session.held_path()
    }

    /// The samples so far.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Progress of the drawing.
    pub fn progress(&self) -> Progress {
        let elapsed_ms = match self.drawing_ms {
            Some(_) if self.drawn_ms > 0 => self.drawn_ms,
            Some(since_ms) => self.now_ms.saturating_sub(since_ms).saturating_sub(self.held_ms),
            None => 0,
        };
        let executed = self.complete.unwrap_or(self.ack.executed);
        let progress = self
            .measure
            .progress(self.executed_before, executed, elapsed_ms as f64 / 1000.0);
        let verification = self.verifier.as_ref().map_or(&self.verification, Verifier::so_far);
        progress.complete_to(verification.complete_vertices())
    }

    /// The oldest event not yet taken.
    pub fn next_event(&mut self) -> Option<JobEvent> {
        self.events.pop_front()
    }

    /// Sends a command in addition to the task's own; the answer is [`JobEvent::Told`] with the number returned here.
    /// [`Command::Stop`] overtakes everything; earlier requests without an answer are dropped.
    pub fn command(&mut self, command: Command) -> u16 {
        if command == Command::Stop {
            self.awaited = None;
        }
        self.session.command(command)
    }

    /// Whether a command was passed to the port completely, or no longer has to be sent.
    pub fn has_sent(&self, id: u16) -> bool {
        self.session.has_sent(id)
    }

    /// Sends a request to the bus; the answer is [`JobEvent::Bus`].
    pub fn bus(&mut self, request: ServiceRequest) {
        self.session.bus(request);
    }

    /// Sends a request to what the firmware records of itself; the answer is [`JobEvent::Measured`].
    pub fn question(&mut self, request: RecordRequest) {
        self.questions.push_back(false);
        self.session.measure(request);
    }

    fn own_question(&mut self, request: MeasurementRequest) {
        self.questions.push_back(true);
        self.session.measure(request.into());
    }

    /// Carries out an operator's control; returns the number of the command sent for it, if any.
    pub fn control(&mut self, control: Control) -> Option<u16> {
        let running = self.outcome.is_none();
        let drawing = running && matches!(self.task, Task::Draw(_));
        let holding = self.status.as_ref().is_some_and(|status| status.mode == Mode::Holding);
        let command = match control {
            // Before the drawing there is nothing to hold, so the drawing does not start.
            Control::Hold | Control::HoldAtPenUp if drawing && self.phase != Phase::Drawing => {
                self.ending.get_or_insert(JobError::Cancelled);
                return None;
            }
            Control::HoldAtPenUp => {
                self.hold_at_pen_up = drawing;
                return None;
            }
            Control::Hold => Command::Hold,
            Control::Resume if !holding => return None,
            Control::Resume => Command::Resume,
            Control::Override(percent) => Command::Override { percent },
            Control::Stop => Command::Stop,
            Control::Cancel if running => {
                self.ending.get_or_insert(JobError::Cancelled);
                return None;
            }
            Control::Cancel => Command::Cancel,
        };
        self.hold_at_pen_up = false;
        Some(self.command(command))
    }

    fn count_held(&mut self, passed_ms: u64) {
        let held = self.status.as_ref().is_some_and(|status| status.mode == Mode::Holding);
        if held && self.phase == Phase::Drawing && self.outcome.is_none() {
            self.held_ms = self.held_ms.saturating_add(passed_ms);
        }
    }

    /// Streams the path from the next vertex that the firmware expects.
    fn start_path(&mut self) {
        let Task::Draw(drawing) = &self.task else { return };
        self.executed_before = self.session.held_path().map_or(0, |ack| ack.executed);
        let (number, vertices) = (drawing.number, drawing.vertices.clone());
        if !drawing.held {
            self.executed_before = 0;
        }
        self.verifier = Some(Verifier::new(&vertices, &self.config, !drawing.held));
        self.session.start_path(number, vertices);
        self.ack.executed = self.executed_before;
        self.drawing_ms = Some(self.now_ms);
        self.enter(Phase::Drawing);
    }

    /// Whether the task gives the machine its configuration, and the machine stands in a fault that this may resolve.
    fn resolves_fault(&self, status: &Status) -> bool {
        let configures = match &self.task {
            Task::Prepare(_) | Task::Motion(_) => true,
            Task::Draw(drawing) => !drawing.held,
            Task::Look | Task::Tell(_) | Task::Rest => false,
        };
        configures && is_resolved_by(&self.config, status, self.options.acknowledge)
    }

    fn enter(&mut self, phase: Phase) {
        if phase == Phase::BusUp && matches!(self.task, Task::Draw(_)) {
            // Measurements from before the bus came up do not belong to the drawing.
            self.own_question(MeasurementRequest::Reset);
        }
        if phase == Phase::Starting {
            self.status_before = self.status.clone();
        }
        self.phase = phase;
        self.entered_ms = self.now_ms;
        self.awaited = None;
        self.accepted = false;
        self.retry_ms = self.now_ms;
        self.fresh = false;
        self.inquired_ms = self.now_ms;
        self.session.inquire();
        self.events.push_back(JobEvent::Phase(phase));
    }

    fn succeed(&mut self) {
        self.outcome.get_or_insert(Ok(()));
    }

    fn fail(&mut self, error: JobError) {
        self.session.end_path();
        if let Some(verifier) = &mut self.verifier {
            verifier.close();
        }
        self.outcome.get_or_insert(Err(error));
    }

    fn lose(&mut self, error: JobError) {
        self.broken.get_or_insert(error);
        self.fail(error);
    }
}

fn measure_of(task: &Task, config: &Config) -> PathMeasure {
    match task {
        Task::Draw(drawing) => PathMeasure::new(&drawing.vertices, config),
        _ => PathMeasure::default(),
    }
}

#[cfg(test)]
mod tests;
