//! The machine's handling of orders and events, without clock, port or thread.
//!
//! Invariants: every order gets exactly one answer. When a client program ends, its motion ends and nothing else does.
//! A broken connection ends every order except a drawing that the firmware may still hold; only an order resumes that
//! drawing.

use super::lanes::{Envelope, Written, overtaken};
use super::{Answer, DrawOrder, Failure, MachineOptions, News, Order, Reply, Shared};
use crate::error::code;
use crate::job::error::{JobError, Phase};
use crate::job::progress::PathMeasure;
use crate::job::{Control, DrawTask, Job, JobEvent, JobOptions, JobReport, Life, Task};
use etherpen::application::{Mode, Refusal};
use etherpen::config::Config;
use etherpen::ethercat::diagnostics::ServiceResult;
use etherpen::messages::{Command, PathVertex, Sample};
use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::sync::mpsc::Sender;

/// Time between two reports of progress, ms.
const PROGRESS_MS: u64 = 100;
/// Most stops waiting for their answer.
const STOPS_MAX: usize = 256;
/// Time within which the firmware reports, unasked, which path it holds, ms.
const ARRIVAL_MAX_MS: u64 = 500;

/// A task that was ordered.
struct Active {
    reply: Sender<Answer>,
    /// Signs of life of the program that ordered the task, if it is another one; the task ends with that program.
    life: Option<Life>,
    /// What a drawing needs to continue.
    drawing: Option<Underway>,
}

/// A drawing that may span several connections.
struct Underway {
    order: DrawOrder,
    /// Whether the connection broke while the firmware had the drawing.
    interrupted: bool,
    samples: Vec<Sample>,
    /// Merged reports of the earlier connections.
    before: Option<JobReport>,
}

/// Jogs are coalesced: one is in progress, the newest one waits.
#[derive(Default)]
struct Jogging {
    under_way: Option<u16>,
    next: Option<[f32; 3]>,
}

/// Unanswered stops. The session repeats only the newest one, so its answer answers all of them.
#[derive(Default)]
struct Stopping {
    newest: u16,
    replies: VecDeque<Sender<Answer>>,
}

/// The machine's orders and its connection.
pub(super) struct Work {
    config: Config,
    options: MachineOptions,
    shared: Arc<Shared>,
    job: Option<Job>,
    active: Option<Active>,
    told: HashMap<u16, Sender<Answer>>,
    stopping: Stopping,
    asked: VecDeque<Sender<Answer>>,
    measured: VecDeque<Sender<Answer>>,
    jogging: Jogging,
    /// Stops not yet written to the port.
    written: Vec<(u16, Written)>,
    shown_ms: u64,
    /// Time since which the firmware's state has been known on this connection, ms.
    known_ms: Option<u64>,
}

impl Work {
    pub(super) fn new(config: Config, options: MachineOptions, shared: Arc<Shared>) -> Self {
        Self {
            config,
            options,
            shared,
            job: None,
            active: None,
            told: HashMap::new(),
            stopping: Stopping::default(),
            asked: VecDeque::new(),
            measured: VecDeque::new(),
            jogging: Jogging::default(),
            written: Vec::new(),
            shown_ms: 0,
            known_ms: None,
        }
    }

    /// Takes a newly opened port: greets the firmware. The time of [`step`](Self::step) restarts at 0.
    pub(super) fn connect(&mut self, session: u32) {
        let options = JobOptions {
            session,
            acknowledge: self.options.acknowledge,
            forward_samples: true,
            ..JobOptions::default()
        };
        self.job = Some(Job::new(self.config.clone(), Task::Look, options));
        self.shown_ms = 0;
        self.known_ms = None;
    }

    /// Whether the firmware has answered the greeting.
    pub(super) fn is_connected(&self) -> bool {
        self.job.as_ref().is_some_and(|job| job.phase() != Phase::Connecting)
    }

    /// Why the connection is broken, if it is.
    pub(super) fn broken(&self) -> Option<&JobError> {
        self.job.as_ref().and_then(Job::broken)
    }

    /// Handles the loss of the connection.
    pub(super) fn lose(&mut self, why: &Failure) {
        let job = self.job.take();
        self.jogging = Jogging::default();
        for (_, written) in self.written.drain(..) {
            written();
        }
        let orders = self.told.drain().map(|(_, reply)| reply);
        let orders = orders.chain(self.stopping.replies.drain(..));
        for reply in orders.chain(self.asked.drain(..)).chain(self.measured.drain(..)) {
            // The program that gave the order may have ended.
            let _ = reply.send(Err(why.clone()));
        }
        let had_begun = job.as_ref().is_some_and(|job| job.phase() == Phase::Drawing);
        if let Some(mut active) = self.active.take() {
            match &mut active.drawing {
                Some(underway) if had_begun || underway.interrupted => {
                    underway.interrupted = true;
                    if let Some(mut job) = job {
                        underway.before = Some(merged(underway.before.take(), job.take_report()));
                    }
                    self.active = Some(active);
                }
                _ => {
                    let report = job.map(|mut job| job.take_report());
                    finish(&self.shared, &self.config, active, Err(why.clone()), report);
                }
            }
        }
        let interrupted = self.is_interrupted();
        self.shared.change(|snapshot| {
            snapshot.welcome = None;
            snapshot.path = None;
            snapshot.lost = Some(why.clone());
            snapshot.phase = None;
            snapshot.interrupted = interrupted;
        });
        self.shared.publish(News::Lost(why.clone()));
    }

    fn underway(&mut self) -> Option<&mut Underway> {
        self.active.as_mut().and_then(|active| active.drawing.as_mut())
    }

    fn is_interrupted(&self) -> bool {
        let drawing = self.active.as_ref().and_then(|active| active.drawing.as_ref());
        drawing.is_some_and(|underway| underway.interrupted)
    }

    /// Answers an order that arrives while there is no connection.
    pub(super) fn refuse(&mut self, envelope: &Envelope, why: &Failure) {
        if envelope.order == Order::Cancel {
            self.forget(why);
        }
        // The program that gave the order may have ended.
        let _ = envelope.reply.send(Err(why.clone()));
    }

    /// Takes an order.
    pub(super) fn order(&mut self, mut envelope: Envelope) {
        let Some(job) = &mut self.job else {
            let why = Failure::new(code::CONNECTION, "there is no connection to the machine");
            return self.refuse(&envelope, &why);
        };
        let reply = envelope.reply.clone();
        match envelope.order.clone() {
            Order::Tell(Command::Stop) | Order::Stop => {
                let written = envelope.take_written();
                self.stop(reply, written);
            }
            Order::Tell(command) => {
                let id = job.command(command);
                self.told.insert(id, reply);
            }
            Order::Hold => self.control(Control::Hold, reply),
            Order::HoldAtPenUp => self.control(Control::HoldAtPenUp, reply),
            Order::Resume => self.resume(reply),
            Order::Cancel => self.cancel(reply),
            Order::Override(percent) => self.control(Control::Override(percent), reply),
            Order::Jog(velocity_mm_s) => self.jog(velocity_mm_s, reply),
            Order::Settle(command) => self.begin(Task::Tell(command), None, None, reply),
            Order::Prepare(ready) => self.begin(Task::Prepare(ready), None, None, reply),
            Order::Motion(motion) => self.begin(Task::Motion(motion), None, envelope.life.take(), reply),
            Order::Draw(order) => self.begin(Task::Draw(order.drawing.clone()), Some(order), None, reply),
            Order::Bus(request) => {
                job.bus(request);
                self.asked.push_back(reply);
            }
            Order::Measure(request) => {
                job.question(request);
                self.measured.push_back(reply);
            }
        }
    }

    fn begin(&mut self, task: Task, order: Option<DrawOrder>, life: Option<Life>, reply: Sender<Answer>) {
        let Some(job) = &mut self.job else { return };
        if self.active.is_some() {
            let busy = "the machine is busy with another order; wait for it, or end it (etherpen cancel)";
            let _ = reply.send(Err(Failure::new(code::FAILED, busy)));
            return;
        }
        job.begin(task);
        if let Some(life) = &life {
            job.live_on(life.clone());
        }
        if let Some(order) = &order {
            self.shared.publish(News::Begun {
                name: order.name.clone(),
                drawing: order.drawing.clone(),
            });
        }
        let name = order.as_ref().map(|order| order.name.clone());
        self.shared.change(|snapshot| {
            snapshot.drawing = name;
            snapshot.progress = None;
        });
        let drawing = order.map(|order| Underway {
            order,
            interrupted: false,
            samples: Vec::new(),
            before: None,
        });
        self.active = Some(Active { reply, life, drawing });
    }

    fn control(&mut self, control: Control, reply: Sender<Answer>) {
        let Some(job) = &mut self.job else { return };
        match job.control(control) {
            Some(id) => drop(self.told.insert(id, reply)),
            None => drop(reply.send(Ok(Reply::Done))),
        }
    }

    fn stop(&mut self, reply: Sender<Answer>, written: Option<Written>) {
        let Some(job) = &mut self.job else { return };
        let id = job.command(Command::Stop);
        self.written.extend(written.map(|written| (id, written)));
        for (_, reply) in self.told.drain() {
            let _ = reply.send(Err(overtaken()));
        }
        self.jogging = Jogging::default();
        self.stopping.newest = id;
        self.stopping.replies.push_back(reply);
        if self.stopping.replies.len() > STOPS_MAX
            && let Some(oldest) = self.stopping.replies.pop_front()
        {
            let _ = oldest.send(Err(overtaken()));
        }
    }

    /// Reports the stops that have been written to the port.
    pub(super) fn tell_written(&mut self) {
        let Some(job) = &self.job else { return };
        for (_, written) in self.written.extract_if(.., |(id, _)| job.has_sent(*id)) {
            written();
        }
    }

    /// Resumes the held drawing. A drawing of an earlier connection is streamed again from the vertex that the firmware
    /// expects.
    fn resume(&mut self, reply: Sender<Answer>) {
        let (Some(job), Some(active)) = (&mut self.job, &mut self.active) else {
            return self.tell(Command::Resume, reply);
        };
        let Some(underway) = active.drawing.as_mut().filter(|underway| underway.interrupted) else {
            return self.tell(Command::Resume, reply);
        };
        underway.interrupted = false;
        let drawing = DrawTask {
            held: true,
            ..underway.order.drawing.clone()
        };
        job.begin(Task::Draw(drawing.clone()));
        self.shared.publish(News::Begun {
            name: underway.order.name.clone(),
            drawing,
        });
        self.shared.change(|snapshot| snapshot.interrupted = false);
        let _ = reply.send(Ok(Reply::Done));
    }

    fn tell(&mut self, command: Command, reply: Sender<Answer>) {
        if let Some(job) = &mut self.job {
            let id = job.command(command);
            self.told.insert(id, reply);
        }
    }

    fn cancel(&mut self, reply: Sender<Answer>) {
        let interrupted = self.is_interrupted();
        let Some(job) = &mut self.job else { return };
        if !interrupted {
            return self.control(Control::Cancel, reply);
        }
        job.begin(Task::Rest);
        if let Some(underway) = self.underway() {
            underway.interrupted = false;
        }
        self.shared.change(|snapshot| snapshot.interrupted = false);
        let _ = reply.send(Ok(Reply::Done));
    }

    fn jog(&mut self, velocity_mm_s: [f32; 3], reply: Sender<Answer>) {
        let Some(job) = &mut self.job else { return };
        if self.active.is_some() {
            let busy = "the machine is busy with another order; wait for it, or end it (etherpen cancel)";
            let _ = reply.send(Err(Failure::new(code::FAILED, busy)));
        } else if self.jogging.under_way.is_some() {
            self.jogging.next = Some(velocity_mm_s);
            let _ = reply.send(Ok(Reply::Done));
        } else {
            let id = job.command(Command::Jog { velocity_mm_s });
            self.jogging.under_way = Some(id);
            self.told.insert(id, reply);
        }
    }

    /// Advances the connection by about a millisecond.
    pub(super) fn step(&mut self, now_ms: u64, incoming: &[u8], outgoing: &mut Vec<u8>, room: usize) {
        self.end_abandoned();
        let Some(job) = &mut self.job else { return };
        job.step(now_ms, incoming, outgoing, room);
        while let Some(event) = self.job.as_mut().and_then(Job::next_event) {
            self.take(event);
        }
        self.show(now_ms);
        self.end_forgotten(now_ms);
        self.end_task();
    }

    /// Ends a motion whose program has gone.
    fn end_abandoned(&mut self) {
        let active = self.active.as_mut();
        let gone = active.and_then(|active| active.life.take_if(|life| life.has_ended()));
        if let (Some(_), Some(job)) = (gone, &mut self.job)
            && job.outcome().is_none()
        {
            job.control(Control::Cancel);
        }
    }

    /// Ends an interrupted drawing once it is clear that the firmware no longer has it. A drawing that has ended while the
    /// firmware was not connected, at its end or before, is completed: what was drawn of it is told.
    fn end_forgotten(&mut self, now_ms: u64) {
        let Some(number) = self.interrupted_number() else {
            return;
        };
        let Some(job) = &self.job else { return };
        let Some(status) = job.status() else { return };
        let known_ms = *self.known_ms.get_or_insert(now_ms);
        let held = job.held_path().filter(|ack| ack.job == number);
        let waits = now_ms.saturating_sub(known_ms) <= ARRIVAL_MAX_MS;
        let has_ended = held.is_some_and(|ack| ack.finished || !waits);
        let error = match (status.mode, status.fault) {
            (Mode::Fault, Some(fault)) => JobError::Fault { fault, before: false },
            (Mode::Startup | Mode::BusConfiguring | Mode::DrivesOff | Mode::Unreferenced, _) => JobError::Forgotten,
            (Mode::Idle, _) if has_ended => return self.resume(std::sync::mpsc::channel().0),
            (Mode::Idle | Mode::Moving, _) if held.is_none() && !waits => JobError::Forgotten,
            _ => return,
        };
        self.forget(&Failure::from(&error));
    }

    /// Ends an interrupted drawing.
    fn forget(&mut self, why: &Failure) {
        if let Some(active) = self.active.take() {
            self.shared.change(|snapshot| {
                snapshot.drawing = None;
                snapshot.interrupted = false;
            });
            finish(&self.shared, &self.config, active, Err(why.clone()), None);
        }
    }

    fn interrupted_number(&self) -> Option<u16> {
        let underway = self.active.as_ref()?.drawing.as_ref()?;
        underway.interrupted.then_some(underway.order.drawing.number)
    }

    fn take(&mut self, event: JobEvent) {
        match event {
            JobEvent::Connected(welcome) => {
                self.shared.change(|snapshot| {
                    snapshot.welcome = Some(welcome.clone());
                    snapshot.lost = None;
                });
                self.shared.publish(News::Connected(welcome));
            }
            JobEvent::Status(status) => {
                self.keep_held(status.mode);
                self.shared.change(|snapshot| snapshot.status = Some((*status).clone()));
                self.shared.publish(News::Status(status));
            }
            JobEvent::Samples { missing, samples } => {
                let last = samples.last().copied();
                self.shared
                    .change(|snapshot| snapshot.sample = last.or(snapshot.sample));
                if let Some(underway) = self.underway().filter(|underway| underway.order.keep_samples) {
                    underway.samples.extend_from_slice(&samples);
                }
                self.shared.publish(News::Samples { missing, samples });
            }
            JobEvent::Told { id, command, result } => self.answer(id, command, result),
            JobEvent::Bus(result) => self.answer_bus(result),
            JobEvent::Measured(answer) => {
                if let Some(reply) = self.measured.pop_front() {
                    let _ = reply.send(Ok(Reply::Measured(answer)));
                }
            }
            other => self.shared.publish(News::Job(other)),
        }
    }

    /// Holds a drawing that still runs on vertices sent before the connection broke; only an order resumes it.
    fn keep_held(&mut self, mode: Mode) {
        let looking = self.job.as_ref().is_some_and(|job| job.phase() == Phase::Inspecting);
        if self.is_interrupted()
            && looking
            && mode == Mode::Drawing
            && let Some(job) = &mut self.job
        {
            job.command(Command::Hold);
        }
    }

    fn answer(&mut self, id: u16, command: Command, result: Result<(), Refusal>) {
        if self.jogging.under_way == Some(id) {
            self.jogging.under_way = None;
            if let (Some(velocity_mm_s), Some(job)) = (self.jogging.next.take(), &mut self.job) {
                self.jogging.under_way = Some(job.command(Command::Jog { velocity_mm_s }));
            }
        }
        let answer = result.map(|()| Reply::Done).map_err(|refusal| {
            let error = JobError::Refused(command, refusal);
            Failure::from(&error)
        });
        if self.stopping.newest == id {
            for reply in self.stopping.replies.drain(..) {
                let _ = reply.send(answer.clone());
            }
        }
        if let Some(reply) = self.told.remove(&id) {
            let _ = reply.send(answer);
        }
    }

    fn answer_bus(&mut self, result: ServiceResult) {
        let Some(reply) = self.asked.pop_front() else { return };
        let _ = reply.send(Ok(Reply::Bus(result)));
    }

    /// Reports the progress of a drawing.
    fn show(&mut self, now_ms: u64) {
        let drawing = self.active.as_ref().is_some_and(|active| active.drawing.is_some());
        let Some(job) = &self.job else { return };
        let over = job.outcome().is_some();
        if !over && now_ms.saturating_sub(self.shown_ms) < PROGRESS_MS {
            return;
        }
        self.shown_ms = now_ms;
        let phase = (!over).then(|| job.phase().to_string());
        let path = job.held_path().copied();
        // What an earlier connection found missing stays so.
        let underway = self.active.as_ref().and_then(|active| active.drawing.as_ref());
        let before = underway.and_then(|underway| underway.before.as_ref());
        let missing_from = before.and_then(|before| before.progress.missing_from());
        let progress =
            (drawing && matches!(job.task(), Task::Draw(_))).then(|| job.progress().complete_to(missing_from));
        self.shared.change(|snapshot| {
            snapshot.phase = phase;
            snapshot.path = path;
            snapshot.progress = progress.or(snapshot.progress);
        });
        if let Some(progress) = progress {
            self.shared.publish(News::Progress(progress));
        }
    }

    /// Answers the task's order when the task has ended; an interrupted drawing waits.
    fn end_task(&mut self) {
        if self.is_interrupted() {
            return;
        }
        let Some(job) = &mut self.job else { return };
        let Some(outcome) = job.outcome().copied() else { return };
        // A broken connection is reported by `lose`, which knows the port's error.
        if job.broken().is_some() {
            return;
        }
        let Some(active) = self.active.take() else { return };
        let result = outcome.map_err(|error| Failure::from(&error));
        let report = active.drawing.is_some().then(|| job.take_report());
        self.shared.change(|snapshot| {
            snapshot.phase = None;
            snapshot.drawing = None;
        });
        finish(&self.shared, &self.config, active, result, report);
    }
}

/// Answers a task's order and publishes the result.
fn finish(
    shared: &Shared,
    config: &Config,
    active: Active,
    mut result: Result<(), Failure>,
    report: Option<JobReport>,
) {
    let report = active.drawing.map(|mut underway| {
        let last = report.unwrap_or_default();
        let mut report = merged(underway.before.take(), last);
        result = judged(result.clone(), &mut report, &underway.order.drawing.vertices, config);
        report.samples = std::mem::take(&mut underway.samples);
        Arc::new(report)
    });
    shared.publish(News::Ended {
        result: result.clone(),
        report,
    });
    let _ = active.reply.send(result.map(|()| Reply::Done));
}

/// The result of a drawing of `path` by what all its connections found: parts that an earlier one found missing were not drawn
/// by a later one. A path that has ended counts as drawn up to the first stroke that is not whole.
pub(super) fn judged(
    result: Result<(), Failure>,
    report: &mut JobReport,
    path: &[PathVertex],
    config: &Config,
) -> Result<(), Failure> {
    let is_incomplete = |failure: &Failure| failure.code == code::INCOMPLETE;
    let verdict = report.verification.verdict();
    let Some(error) = verdict
        .error()
        .filter(|_| result.as_ref().err().is_none_or(is_incomplete))
    else {
        return result;
    };
    if (verdict.complete_vertices as usize) < report.progress.vertices {
        let elapsed_s = report.progress.elapsed_s;
        report.progress = PathMeasure::new(path, config).progress(0, verdict.complete_vertices, elapsed_s);
    }
    Err(Failure::from(&error))
}

/// Merges the reports of a drawing that spanned several connections.
pub(super) fn merged(before: Option<JobReport>, last: JobReport) -> JobReport {
    let Some(before) = before else { return last };
    let mut progress = last.progress;
    // A connection that ended early may have heard nothing of it; one that found parts missing counts what is before them.
    let is_less = progress.vertices < before.progress.vertices && last.verification.verdict().error().is_none();
    if progress.vertices_total == 0 || is_less {
        progress = before.progress;
    }
    progress.elapsed_s = before.drawn_s + last.drawn_s;
    let mut verification = before.verification;
    verification.merge(&last.verification);
    progress = progress.complete_to(verification.complete_vertices());
    JobReport {
        progress,
        verification,
        drawn_s: before.drawn_s + last.drawn_s,
        held_s: before.held_s + last.held_s,
        welcome: last.welcome.or(before.welcome),
        status: last.status.or(before.status),
        status_before: before.status_before.or(last.status_before),
        ..last
    }
}
