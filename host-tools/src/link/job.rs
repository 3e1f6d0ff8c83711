//! One drawing from the first greeting to drives without power.
//!
//! Connect, look, configure, wait for the bus, reference, enable, draw, bring to rest: each phase waits for what the
//! firmware reports, never for a time to pass, and has a limit after which the job says what it waited for.
//! Invariants: a fault that is found is reported, and acknowledged only when the options say so; progress counts
//! executed vertices, not sent ones; whatever ends the job early, the robot is asked to come to rest and to give up its
//! power first.

use super::error::{JobError, Phase};
use super::measurement::Reader;
use super::progress::{PathMeasure, Progress};
use super::session::{Event, Session};
pub use super::terms::{Control, JobEvent, JobOptions, JobReport};
use etherpen::application::{Mode, Refusal};
use etherpen::config::Config;
use etherpen::link::protocol::{Command, PathAck, PathVertex, Sample, Status, Welcome};
use etherpen::measurement::{MeasurementAnswer, MeasurementRequest};
use std::collections::VecDeque;
use std::sync::Arc;

/// Longest silence of the firmware once connected, ms.
pub const SILENCE_MAX_MS: u64 = 3_000;
/// Longest wait for the bus, ms.
pub const BUS_MAX_MS: u64 = 60_000;
/// Longest wait for an answer, a reference, power or a standstill, ms.
pub const STEP_MAX_MS: u64 = 15_000;
/// Time between two inquiries while a mode is waited for, ms.
const INQUIRE_MS: u64 = 250;
/// Time before a command that was refused because something still moves is tried again, ms.
const RETRY_MS: u64 = 100;
/// Longest time at rest without the path's end before a drawing counts as ended early, ms.
const EARLY_END_MS: u64 = 3_000;

/// A whole drawing as a state machine.
pub struct DrawJob {
    session: Session,
    options: JobOptions,
    config: Config,
    vertices: Arc<[PathVertex]>,
    measure: PathMeasure,
    now_ms: u64,
    phase: Phase,
    entered_ms: u64,
    /// The phase's own command, until it is answered.
    awaited: Option<u16>,
    /// Whether the phase's command was accepted.
    accepted: bool,
    retry_ms: u64,
    inquired_ms: u64,
    fault_since_ms: Option<u64>,
    /// Since when the robot has been at rest although the path has not ended.
    over_since_ms: Option<u64>,
    /// Whether a status came since the last accepted command.
    fresh: bool,
    /// Why the job comes to rest early.
    ending: Option<JobError>,
    outcome: Option<Result<(), JobError>>,
    welcome: Option<Welcome>,
    status: Option<Status>,
    ack: PathAck,
    drawing_ms: Option<u64>,
    drawn_ms: u64,
    samples: Vec<Sample>,
    /// Reads the firmware's measurements once the robot is at rest.
    reader: Option<Reader>,
    events: VecDeque<JobEvent>,
}

impl DrawJob {
    /// A job that draws `vertices` with this configuration.
    pub fn new(config: Config, vertices: impl Into<Arc<[PathVertex]>>, options: JobOptions) -> Self {
        let vertices = vertices.into();
        let mut session = Session::new(options.session);
        session.connect();
        Self {
            session,
            options,
            measure: PathMeasure::new(&vertices, &config),
            config,
            vertices,
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
            ending: None,
            outcome: None,
            welcome: None,
            status: None,
            ack: PathAck::default(),
            drawing_ms: None,
            drawn_ms: 0,
            samples: Vec::new(),
            reader: None,
            events: VecDeque::new(),
        }
    }

    /// One millisecond or so: takes the bytes that came and appends at most `room` bytes to `outgoing`.
    ///
    /// `now_ms` starts near 0 and does not go back; in lockstep it is the firmware's millisecond.
    pub fn step(&mut self, now_ms: u64, incoming: &[u8], outgoing: &mut Vec<u8>, room: usize) {
        self.now_ms = now_ms;
        self.session.receive(incoming, now_ms);
        while let Some(event) = self.session.next_event() {
            self.take(event);
        }
        if self.outcome.is_none() {
            self.supervise();
        }
        if self.outcome.is_none() {
            self.advance();
        }
        let before = outgoing.len();
        outgoing.resize(before + room, 0);
        let filled = self.session.transmit(now_ms, &mut outgoing[before..]);
        outgoing.truncate(before + filled);
    }

    /// How the job ended, `None` while it runs.
    pub fn outcome(&self) -> Option<&Result<(), JobError>> {
        self.outcome.as_ref()
    }

    /// What was collected, whether the job has succeeded, failed or is still running.
    pub fn into_report(self) -> JobReport {
        let progress = self.progress();
        JobReport {
            progress,
            drawn_s: progress.elapsed_s,
            welcome: self.welcome,
            samples: self.samples,
            measurements: self.reader.and_then(Reader::into_readings),
            link: self.session.counts(),
            status: self.status,
        }
    }

    /// The phase the job is in.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// The last status.
    pub fn status(&self) -> Option<&Status> {
        self.status.as_ref()
    }

    /// The samples so far.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// How far the drawing is.
    pub fn progress(&self) -> Progress {
        let elapsed_ms = match self.drawing_ms {
            Some(_) if self.drawn_ms > 0 => self.drawn_ms,
            Some(since_ms) => self.now_ms.saturating_sub(since_ms),
            None => 0,
        };
        self.measure.progress(self.ack.executed, elapsed_ms as f64 / 1000.0)
    }

    /// The oldest event that was not taken yet.
    pub fn next_event(&mut self) -> Option<JobEvent> {
        self.events.pop_front()
    }

    /// Does what an operator asks for.
    pub fn control(&mut self, control: Control) {
        let holding = self.status.as_ref().is_some_and(|status| status.mode == Mode::Holding);
        let command = match control {
            // Before the drawing there is nothing to hold: it does not begin.
            Control::Hold if self.phase != Phase::Drawing => {
                self.ending.get_or_insert(JobError::Cancelled);
                return;
            }
            Control::Hold => Command::Hold,
            Control::Resume if !holding => return,
            Control::Resume => Command::Resume,
            Control::Override(percent) => Command::Override { percent },
            Control::Stop => {
                self.awaited = None;
                Command::Stop
            }
            Control::Cancel => {
                self.ending.get_or_insert(JobError::Cancelled);
                return;
            }
        };
        self.session.command(command);
    }

    fn take(&mut self, event: Event) {
        match event {
            Event::Connected(welcome) => {
                self.events.push_back(JobEvent::Connected(welcome.clone()));
                self.welcome = Some(welcome);
                self.enter(Phase::Inspecting);
            }
            Event::VersionRefused { host, firmware } => self.fail(JobError::Version { host, firmware }),
            Event::Measured(answer) => self.take_measurement(&answer),
            // A job asks nothing of the bus.
            Event::Bus(_) => {}
            Event::Restarted => self.fail(JobError::Restarted),
            Event::Configured(Ok(hash)) => match self.config.hash() {
                Some(ours) if ours == hash => self.enter(Phase::BusUp),
                ours => self.fail(JobError::ConfigHash { ours, firmware: hash }),
            },
            Event::Configured(Err(refusal)) => self.fail(JobError::Config(refusal)),
            Event::Answered { id, command, result } => self.take_answer(id, command, result),
            Event::Ack(ack) => {
                if ack.finished && !self.ack.finished {
                    self.drawn_ms = self.now_ms.saturating_sub(self.drawing_ms.unwrap_or(self.now_ms));
                }
                self.ack = ack;
            }
            Event::VertexRefused(refusal) => {
                self.ending.get_or_insert(JobError::Vertex(refusal));
            }
            Event::Status(status) => self.take_status(status),
            Event::Samples { missing, samples } => {
                if let Some(first) = samples.first().filter(|_| missing > 0) {
                    let t_ms = first.t_ms;
                    self.events.push_back(JobEvent::SamplesMissing { missing, t_ms });
                }
                self.samples.extend(samples);
            }
        }
    }

    fn take_answer(&mut self, id: u16, command: Command, result: Result<(), Refusal>) {
        let own = self.awaited.take_if(|awaited| *awaited == id).is_some();
        match result {
            Ok(()) => {
                self.fresh = false;
                self.accepted |= own;
                self.inquired_ms = self.now_ms;
                self.session.inquire();
                if let Command::Draw { job } = command
                    && self.phase == Phase::Starting
                {
                    self.session.start_path(job, self.vertices.clone());
                    self.drawing_ms = Some(self.now_ms);
                    self.enter(Phase::Drawing);
                }
            }
            Err(_) if own && self.phase == Phase::Resting => self.retry_ms = self.now_ms + RETRY_MS,
            Err(Refusal::Moving) if own => self.retry_ms = self.now_ms + RETRY_MS,
            Err(refusal) if own => {
                self.ending.get_or_insert(JobError::Refused(command, refusal));
            }
            Err(refusal) => self.events.push_back(JobEvent::Refused(command, refusal)),
        }
    }

    fn take_status(&mut self, status: Status) {
        let before = self.status.as_ref();
        if before.map(|before| before.mode) != Some(status.mode) {
            self.events.push_back(JobEvent::Mode(status.mode));
        }
        if let Some(fault) = status.fault
            && before.and_then(|before| before.fault) != status.fault
        {
            self.events.push_back(JobEvent::Fault(fault));
        }
        self.fresh = true;
        self.status = Some(status);
    }

    fn enter(&mut self, phase: Phase) {
        if phase == Phase::BusUp {
            // What is measured before there is a bus is no part of the job.
            self.session.measure(MeasurementRequest::Reset);
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

    fn fail(&mut self, error: JobError) {
        self.session.end_path();
        self.outcome.get_or_insert(Err(error));
    }

    /// Limits of silence and time, and faults: what ends any phase.
    fn supervise(&mut self) {
        let waited_ms = self.now_ms.saturating_sub(self.entered_ms);
        if self.phase == Phase::Connecting {
            if self.ending.is_some() {
                return self.fail(JobError::Cancelled);
            }
            if waited_ms > self.options.connect_max_ms {
                return self.fail(JobError::NoAnswer { waited_ms });
            }
            return;
        }
        if let Some(silent_ms) = self.session.silence_ms(self.now_ms).filter(|ms| *ms > SILENCE_MAX_MS) {
            return self.fail(JobError::LinkLost { silent_ms });
        }
        if self.faulted() {
            return;
        }
        if self.ending.is_some() && self.phase != Phase::Resting {
            self.session.end_path();
            self.enter(Phase::Resting);
            return;
        }
        let limit_ms = match self.phase {
            Phase::Drawing => return,
            Phase::BusUp => BUS_MAX_MS,
            _ => STEP_MAX_MS,
        };
        if waited_ms > limit_ms {
            let late = JobError::Timeout {
                phase: self.phase,
                waited_ms,
            };
            let error = self.ending.take().unwrap_or(late);
            if self.phase == Phase::Resting {
                self.fail(error);
            } else {
                self.ending = Some(error);
            }
        }
    }

    /// Whether there is a fault; the job ends with it once the robot stands.
    fn faulted(&mut self) -> bool {
        if self.options.acknowledge && matches!(self.phase, Phase::Inspecting | Phase::Acknowledging) {
            return false;
        }
        let Some(status) = self.status.as_ref().filter(|_| self.fresh) else {
            return self.fault_since_ms.is_some();
        };
        let mode = status.mode;
        let Some(fault) = status.fault else {
            self.fault_since_ms = None;
            return false;
        };
        let since_ms = *self.fault_since_ms.get_or_insert(self.now_ms);
        if mode == Mode::Fault || self.now_ms.saturating_sub(since_ms) > STEP_MAX_MS {
            let before = self.phase == Phase::Inspecting;
            self.fail(JobError::Fault { fault, before });
        }
        true
    }

    fn advance(&mut self) {
        if self.phase == Phase::Connecting || self.fault_since_ms.is_some() {
            return;
        }
        if self.now_ms.saturating_sub(self.inquired_ms) >= INQUIRE_MS && self.phase != Phase::Drawing {
            self.inquired_ms = self.now_ms;
            self.session.inquire();
        }
        let Some(mode) = self.status.as_ref().filter(|_| self.fresh).map(|status| status.mode) else {
            return;
        };
        let referenced = self.status.as_ref().is_some_and(|status| status.referenced);
        match self.phase {
            Phase::Connecting | Phase::Configuring => {}
            Phase::Inspecting => self.inspect(mode),
            Phase::Acknowledging => match mode {
                Mode::Fault => self.request(Command::Acknowledge),
                Mode::Drawing | Mode::Holding | Mode::Moving => self.request(Command::Cancel),
                Mode::Stopping => {}
                _ => self.enter(Phase::Inspecting),
            },
            Phase::BusUp => {
                if matches!(mode, Mode::DrivesOff | Mode::Unreferenced | Mode::Idle) {
                    self.enter(Phase::Referencing);
                }
            }
            Phase::Referencing if referenced => self.enter(Phase::Enabling),
            Phase::Referencing => self.request(Command::Reference),
            Phase::Enabling if mode == Mode::Idle => self.enter(Phase::Starting),
            Phase::Enabling => self.request(Command::Enable),
            Phase::Starting => self.request(Command::Draw { job: self.options.job }),
            Phase::Drawing => self.watch_drawing(mode),
            Phase::Resting => self.rest(mode),
        }
    }

    fn inspect(&mut self, mode: Mode) {
        let busy = matches!(mode, Mode::Moving | Mode::Drawing | Mode::Holding | Mode::Stopping);
        if busy && !self.options.acknowledge {
            return self.fail(JobError::Busy(mode));
        }
        if busy || mode == Mode::Fault {
            return self.enter(Phase::Acknowledging);
        }
        let in_force = self.status.as_ref().and_then(|status| status.config);
        if in_force.is_some() && in_force == self.config.hash() {
            return self.enter(Phase::BusUp);
        }
        self.enter(Phase::Configuring);
        self.session.configure(self.config.clone());
    }

    fn watch_drawing(&mut self, mode: Mode) {
        if self.ack.finished && mode != Mode::Holding {
            return self.enter(Phase::Resting);
        }
        if !matches!(mode, Mode::Idle | Mode::DrivesOff | Mode::Unreferenced) {
            self.over_since_ms = None;
            return;
        }
        let since_ms = *self.over_since_ms.get_or_insert(self.now_ms);
        if self.now_ms.saturating_sub(since_ms) > EARLY_END_MS {
            self.ending.get_or_insert(JobError::EndedEarly {
                executed: self.ack.executed,
                total: self.vertices.len(),
            });
        }
    }

    /// Brings the robot to rest without power, whatever it does now.
    fn rest(&mut self, mode: Mode) {
        match mode {
            Mode::Drawing | Mode::Holding | Mode::Moving if self.ending.is_some() => {
                self.request(Command::Cancel);
            }
            Mode::Idle | Mode::Unreferenced => {
                self.accepted = false;
                self.request(Command::Disable);
            }
            // Power may still be on its way; the firmware accepts this only when it is not.
            Mode::DrivesOff if !self.accepted => self.request(Command::Disable),
            Mode::DrivesOff | Mode::Startup | Mode::BusConfiguring | Mode::Fault => {
                if self.ending.is_some() || self.measured() {
                    let result = self.ending.take().map_or(Ok(()), Err);
                    self.outcome.get_or_insert(result);
                }
            }
            Mode::Drawing | Mode::Holding | Mode::Moving | Mode::Stopping => {}
        }
    }

    /// Whether the measurements have been read; asks for them if not.
    fn measured(&mut self) -> bool {
        if self.reader.is_none() {
            let reader = Reader::new();
            if let Some(request) = reader.request() {
                self.session.measure(request);
            }
            self.reader = Some(reader);
        }
        self.reader.as_ref().is_none_or(|reader| reader.request().is_none())
    }

    fn take_measurement(&mut self, answer: &MeasurementAnswer) {
        let next = self.reader.as_mut().and_then(|reader| {
            reader.take(answer);
            reader.request()
        });
        if let Some(request) = next {
            self.session.measure(request);
        }
    }

    /// Makes the phase's request unless it is under way or was accepted.
    fn request(&mut self, command: Command) {
        if self.awaited.is_none() && !self.accepted && self.now_ms >= self.retry_ms {
            self.awaited = Some(self.session.command(command));
        }
    }
}

#[cfg(test)]
mod tests;
