//! The phases of a job: what each waits for, and what ends it early.

use super::Job;
use super::error::{JobError, Phase};
use super::task::{DrawTask, Motion, Ready, Task};
use crate::link::measurement::Reader;
use crate::link::text;
use etherpen::application::Mode;
use etherpen::config::Axis;
use etherpen::link::message::PathAck;
use etherpen::messages::Command;

/// Longest silence of the firmware after connecting, ms.
pub const SILENCE_MAX_MS: u64 = 3_000;
/// Longest wait for the bus, ms.
pub const BUS_MAX_MS: u64 = 60_000;
/// Longest wait for an answer, a reference, power or a standstill, ms.
pub const STEP_MAX_MS: u64 = 15_000;
/// Time between two inquiries while waiting for a mode, ms.
const INQUIRE_MS: u64 = 250;
/// Longest time at rest before the end of the path until the drawing counts as ended early, ms.
const EARLY_END_MS: u64 = 3_000;
/// Longest wait for what the firmware sends unasked after a greeting, ms: samples, and the state of a path.
const ARRIVAL_MAX_MS: u64 = 500;
/// Longest wait for the firmware's measurements once the robot is at rest, ms.
const MEASUREMENTS_MAX_MS: u64 = 10_000;
/// Time between two repetitions of a jog, ms; less than half the firmware's dead-man time.
const JOG_REPEAT_MS: u64 = 40;
/// Silence of the program that ordered a jog after which the jog is not continued, ms. By then the firmware's dead-man
/// switch has stopped the robot.
const ABANDONED_MS: u64 = 500;

const _: () = assert!(MEASUREMENTS_MAX_MS < STEP_MAX_MS);

impl Job {
    /// Detects a firmware that no longer sends, with or without a task.
    pub(super) fn watch_connection(&mut self) {
        if self.phase == Phase::Connecting || self.broken.is_some() {
            return;
        }
        if let Some(silent_ms) = self.session.silence_ms(self.now_ms).filter(|ms| *ms > SILENCE_MAX_MS) {
            self.lose(JobError::LinkLost { silent_ms });
        }
    }

    /// Whether the axes go to their home switches even if the machine is referenced.
    fn searches_anew(&self) -> bool {
        self.task == Task::Prepare(Ready::Homed) && self.config.has_home_switches()
    }

    /// Whether an early end has to bring the robot to rest.
    fn has_to_rest(&self) -> bool {
        let touches = !matches!(self.task, Task::Look | Task::Tell(_));
        touches && !matches!(self.phase, Phase::Inspecting | Phase::Resting)
    }

    /// Checks the time limits and faults, which can end any phase.
    pub(super) fn supervise(&mut self) {
        let waited_ms = self.now_ms.saturating_sub(self.entered_ms);
        if self.phase == Phase::Connecting {
            if self.ending.is_some() {
                return self.fail(JobError::Cancelled);
            }
            if waited_ms > self.options.connect_max_ms {
                self.lose(JobError::NoAnswer { waited_ms });
            }
            return;
        }
        let waits_for_bus = matches!(self.phase, Phase::Telling | Phase::Acknowledging | Phase::BusUp);
        if waits_for_bus && self.status.as_ref().is_some_and(text::waits_for_slave) {
            // The firmware ends this wait.
            self.entered_ms = self.now_ms;
        }
        if self.faulted() {
            return;
        }
        if let Some(error) = self.ending
            && self.phase != Phase::Resting
        {
            if !self.has_to_rest() {
                return self.fail(error);
            }
            self.session.end_path();
            self.enter(Phase::Resting);
            return;
        }
        let limit_ms = match (self.phase, &self.task) {
            (Phase::Drawing, _) => return,
            (Phase::BusUp, _) => BUS_MAX_MS,
            (Phase::Moving, Task::Motion(Motion::Jog { for_ms, .. })) => STEP_MAX_MS + u64::from(*for_ms),
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

    /// Whether a fault ends the task; the task ends once the robot is at rest.
    fn faulted(&mut self) -> bool {
        if matches!(self.task, Task::Look | Task::Rest | Task::Tell(_)) {
            return false;
        }
        if self.options.acknowledge && matches!(self.phase, Phase::Inspecting | Phase::Acknowledging) {
            return false;
        }
        let Some(status) = self.status.as_ref().filter(|_| self.fresh) else {
            return self.fault_since_ms.is_some();
        };
        let mode = status.mode;
        let is_ending = matches!(self.phase, Phase::Inspecting | Phase::Configuring) && self.resolves_fault(status);
        let Some(fault) = status.fault.filter(|_| !is_ending) else {
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

    pub(super) fn advance(&mut self) {
        if self.phase == Phase::Connecting || self.fault_since_ms.is_some() {
            return;
        }
        if self.now_ms.saturating_sub(self.inquired_ms) >= INQUIRE_MS && self.phase != Phase::Drawing {
            self.inquired_ms = self.now_ms;
            self.session.inquire();
        }
        if self.phase == Phase::Moving {
            self.repeat_jog();
        }
        let Some(status) = self.status.as_ref().filter(|_| self.fresh) else {
            return;
        };
        let (mode, referenced) = (status.mode, status.referenced);
        match self.phase {
            Phase::Connecting | Phase::Configuring => {}
            Phase::Inspecting => self.inspect(mode),
            Phase::Acknowledging => match mode {
                Mode::Fault => self.request(Command::Acknowledge),
                Mode::Drawing | Mode::Holding | Mode::Moving => self.request(Command::Cancel),
                Mode::Stopping => {}
                _ => self.enter(Phase::Inspecting),
            },
            Phase::Telling => self.tell(mode),
            Phase::BusUp => {
                if matches!(mode, Mode::DrivesOff | Mode::Unreferenced | Mode::Idle) {
                    if !referenced && self.needs_a_person() {
                        self.ending.get_or_insert(JobError::NotReferenced);
                        return;
                    }
                    let is_searched = self.searches_anew() || !referenced && self.config.has_home_switches();
                    self.ready(
                        Ready::Bus,
                        if is_searched {
                            Phase::Powering
                        } else {
                            Phase::Referencing
                        },
                    );
                }
            }
            Phase::Powering if mode != Mode::DrivesOff => self.enter(Phase::Referencing),
            Phase::Powering => self.request(Command::Enable),
            Phase::Referencing if referenced && mode != Mode::Homing && (self.accepted || !self.searches_anew()) => {
                self.ready(Ready::Homed, Phase::Enabling);
            }
            Phase::Referencing => self.reference(mode),
            Phase::Enabling if mode == Mode::Idle => self.ready(Ready::Enabled, Phase::Starting),
            Phase::Enabling => self.request(Command::Enable),
            Phase::Starting => match &self.task {
                Task::Draw(drawing) if drawing.held => self.request(Command::Resume),
                Task::Draw(drawing) => {
                    let job = drawing.number;
                    self.request(Command::Draw { job });
                }
                _ => self.enter(Phase::Moving),
            },
            Phase::Moving => self.watch_motion(mode),
            Phase::Drawing => self.watch_drawing(mode),
            Phase::Resting => self.rest(mode),
        }
    }

    fn inspect(&mut self, mode: Mode) {
        let waited_ms = self.now_ms.saturating_sub(self.entered_ms);
        match &self.task {
            Task::Look if self.sample.is_some() || waited_ms > ARRIVAL_MAX_MS => return self.succeed(),
            Task::Look => return,
            Task::Tell(_) => return self.enter(Phase::Telling),
            Task::Rest => {
                self.ending = Some(JobError::Cancelled);
                return self.enter(Phase::Resting);
            }
            Task::Draw(drawing) if drawing.held => {
                let drawing = drawing.clone();
                return self.take_up(mode, &drawing, waited_ms);
            }
            Task::Prepare(_) | Task::Motion(_) | Task::Draw(_) => {}
        }
        let busy = matches!(mode, Mode::Moving | Mode::Drawing | Mode::Holding | Mode::Stopping);
        if busy && !self.options.acknowledge {
            return self.fail(JobError::Busy(mode));
        }
        let is_resolved = self.status.as_ref().is_some_and(|status| self.resolves_fault(status));
        if busy || mode == Mode::Fault && !is_resolved {
            return self.enter(Phase::Acknowledging);
        }
        self.found_powered = matches!(mode, Mode::Idle | Mode::Unreferenced);
        let in_force = self.status.as_ref().and_then(|status| status.config);
        if in_force.is_some() && in_force == self.config.hash() {
            return self.enter(Phase::BusUp);
        }
        self.enter(Phase::Configuring);
        self.session.configure(self.config.clone());
    }

    /// Resumes a drawing that the firmware has held since another connection, if it is this drawing.
    fn take_up(&mut self, mode: Mode, drawing: &DrawTask, waited_ms: u64) {
        let in_force = self.status.as_ref().and_then(|status| status.config);
        let held = self
            .session
            .held_path()
            .filter(|ack| ack.job == drawing.number && ack.next as usize <= drawing.vertices.len())
            .copied();
        // Whatever ends this, what is executed is told.
        self.ack = held.unwrap_or(self.ack);
        match (mode, held) {
            (_, None) if waited_ms <= ARRIVAL_MAX_MS => {}
            (Mode::Stopping, _) => {}
            (_, Some(_)) if in_force != self.config.hash() => self.fail(JobError::ConfigHash {
                ours: self.config.hash(),
                firmware: in_force.unwrap_or_default(),
            }),
            (Mode::Holding, Some(_)) => self.enter(Phase::Starting),
            (Mode::Drawing, Some(_)) => {
                self.status_before = self.status.clone();
                self.start_path();
            }
            // Everything had been sent when the connection broke. The report that it has ended may be lost: a robot that
            // is idle after the last vertex has ended it.
            (Mode::Idle, Some(ack)) if ack.finished || has_executed(&ack, drawing) => self.enter(Phase::Resting),
            // A vertex was refused, or somebody else has cancelled it.
            (Mode::Idle, Some(ack)) if waited_ms > ARRIVAL_MAX_MS => {
                self.ending.get_or_insert(JobError::EndedEarly {
                    executed: ack.executed,
                    total: drawing.vertices.len(),
                });
                self.enter(Phase::Resting);
            }
            (Mode::Idle, Some(_)) => {}
            _ => self.fail(JobError::NotHeld(mode)),
        }
    }

    /// The machine has reached `ready`: ends the task or enters `next`.
    fn ready(&mut self, ready: Ready, next: Phase) {
        match self.task {
            Task::Prepare(wanted) if wanted <= ready => self.succeed(),
            _ => self.enter(next),
        }
    }

    /// Whether only a person can say where an axis is, and none has.
    fn needs_a_person(&self) -> bool {
        let mut axes = self.config.axes.iter().take(self.config.bus.drives.into());
        let is_wanted = self.task != Task::Prepare(Ready::Bus);
        is_wanted && !self.options.at_marks && !self.searches_anew() && axes.any(Axis::is_blind)
    }

    /// Homes the joints, by their encoders, at their marks or by their switches; fails if the reference at marks was lost, or if
    /// the drawing does not allow it and not all encoders know the pose.
    fn reference(&mut self, mode: Mode) {
        let by_switches = self.config.has_home_switches();
        let is_lost = self.status.as_ref().is_some_and(|status| status.reference_lost);
        let is_elsewhere = matches!(&self.task, Task::Draw(drawing) if !drawing.may_reference);
        let mut axes = self.config.axes.iter().take(self.config.bus.drives.into());
        let knows_pose = !by_switches && axes.all(Axis::knows_turns);
        if is_lost && !by_switches || is_elsewhere && !knows_pose {
            self.ending.get_or_insert(JobError::NotReferenced);
            return;
        }
        match mode {
            // The firmware ends a search that takes too long.
            Mode::Homing => self.entered_ms = self.now_ms,
            _ => self.request(Command::Home),
        }
    }

    /// Waits for the effect of a command.
    fn tell(&mut self, mode: Mode) {
        let Task::Tell(command) = self.task else { return };
        if !self.accepted {
            return self.request(command);
        }
        let under_way = match command {
            Command::Acknowledge => mode == Mode::Fault,
            Command::Enable => mode == Mode::DrivesOff,
            Command::Disable | Command::Cancel => {
                matches!(mode, Mode::Stopping | Mode::Drawing | Mode::Holding | Mode::Moving)
            }
            Command::Move { .. } | Command::Pen { .. } => mode == Mode::Moving,
            _ => false,
        };
        match self.status.as_ref().and_then(|status| status.fault) {
            _ if !under_way => self.succeed(),
            // The time limit of the firmware's recovery is shorter than this job's.
            Some(fault) if self.now_ms.saturating_sub(self.entered_ms) > STEP_MAX_MS - INQUIRE_MS => {
                self.fail(JobError::Fault { fault, before: true });
            }
            _ => {}
        }
    }

    /// Repeats a jog within the firmware's dead-man time until its duration is over.
    fn repeat_jog(&mut self) {
        let Task::Motion(Motion::Jog { velocity_mm_s, for_ms }) = self.task else {
            return;
        };
        let over = self.now_ms.saturating_sub(self.entered_ms) >= u64::from(for_ms);
        if self.awaited.is_some() || self.now_ms < self.retry_ms || self.ending.is_some() {
            return;
        }
        if !over && !self.life.take_sign(self.now_ms) {
            let since_ms = self.life.seen_ms.max(self.entered_ms);
            if self.now_ms.saturating_sub(since_ms) > ABANDONED_MS {
                self.ending = Some(JobError::Abandoned);
            }
            return;
        }
        if !over {
            self.retry_ms = self.now_ms + JOG_REPEAT_MS;
            self.awaited = Some(self.session.command(Command::Jog { velocity_mm_s }));
        } else if !self.found_still() {
            self.awaited = Some(self.session.command(Command::Jog {
                velocity_mm_s: [0.0; 3],
            }));
            self.retry_ms = u64::MAX;
        }
    }

    /// Whether the robot is known to be at rest.
    fn found_still(&self) -> bool {
        let status = self.status.as_ref().filter(|_| self.fresh);
        status.is_some_and(|status| status.mode == Mode::Idle)
    }

    fn watch_motion(&mut self, mode: Mode) {
        let Task::Motion(motion) = self.task else { return };
        let done = match motion {
            Motion::Move(position) => {
                self.request(Command::Move { position });
                self.accepted
            }
            Motion::Pen(pen) => {
                self.request(Command::Pen { pen });
                self.accepted
            }
            Motion::Jog { for_ms, .. } => self.now_ms.saturating_sub(self.entered_ms) >= u64::from(for_ms),
        };
        if done && mode == Mode::Idle && self.awaited.is_none() && self.fresh {
            self.enter(Phase::Resting);
        }
    }

    fn watch_drawing(&mut self, mode: Mode) {
        let Task::Draw(drawing) = &self.task else { return };
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
                total: drawing.vertices.len(),
            });
        }
    }

    /// Whether the drives keep their power at the end of the task.
    fn keeps_power(&self) -> bool {
        self.found_powered && !matches!(self.task, Task::Draw(_))
    }

    /// Brings the robot to rest from any mode; switches the power off unless it was on before the task.
    fn rest(&mut self, mode: Mode) {
        match mode {
            Mode::Drawing | Mode::Holding | Mode::Moving | Mode::Homing if self.ending.is_some() => {
                self.request(Command::Cancel);
            }
            Mode::Idle | Mode::Unreferenced if self.keeps_power() => self.end(),
            Mode::Idle | Mode::Unreferenced => {
                self.accepted = false;
                self.request(Command::Disable);
            }
            // The drives may still be switching on; the firmware accepts this command only if they are not.
            Mode::DrivesOff if !self.accepted => self.request(Command::Disable),
            Mode::DrivesOff | Mode::Startup | Mode::BusConfiguring | Mode::Fault => {
                let waited_ms = self.now_ms.saturating_sub(self.entered_ms);
                let wants_nothing = self.ending.is_some() || !matches!(self.task, Task::Draw(_));
                // A finished drawing is kept even if a bad line prevents reading its measurements.
                if wants_nothing || waited_ms > MEASUREMENTS_MAX_MS || self.measured() {
                    self.end();
                }
            }
            Mode::Drawing | Mode::Holding | Mode::Homing | Mode::Moving | Mode::Stopping => {}
        }
    }

    /// Ends the task once the samples of its drawing have been verified.
    fn end(&mut self) {
        if let Some(verifier) = &mut self.verifier {
            verifier.close();
            if verifier.is_behind() {
                return;
            }
        }
        let error = self.ending.take().or_else(|| self.verify());
        self.outcome.get_or_insert(error.map_or(Ok(()), Err));
    }

    /// The parts of the ended drawing that were not drawn according to the telemetry, as an error.
    fn verify(&mut self) -> Option<JobError> {
        self.verification = self.verifier.take()?.finish(true);
        let verdict = self.verification.verdict();
        let error = verdict.error()?;
        self.complete = Some(verdict.complete_vertices);
        Some(error)
    }

    /// Whether the measurements have been read; requests them if not.
    fn measured(&mut self) -> bool {
        if self.reader.is_none() {
            let reader = Reader::new();
            if let Some(request) = reader.request() {
                self.own_question(request);
            }
            self.reader = Some(reader);
        }
        self.reader.as_ref().is_none_or(|reader| reader.request().is_none())
    }

    /// Sends the phase's request unless it is pending or was accepted.
    fn request(&mut self, command: Command) {
        if self.awaited.is_none() && !self.accepted && self.now_ms >= self.retry_ms {
            self.awaited = Some(self.session.command(command));
        }
    }
}

/// Whether the firmware has executed a drawing to its last vertex.
fn has_executed(ack: &PathAck, drawing: &DrawTask) -> bool {
    ack.complete && ack.executed as usize >= drawing.vertices.len()
}
