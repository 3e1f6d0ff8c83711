//! The host of a measured firmware: prepares the robot, waits, and reads the histograms.
//!
//! Invariant: the counters cover everything in the histograms: they start at the last status before the reset and end
//! at the first status after the measurement.

use super::Disturbance;
use crate::emulator::{LINK_BYTES_MAX, Link};
use crate::link::measurement::{Reader, Readings};
use crate::link::session::{Event, Session};
use crate::random::XorshiftStar;
use etherpen::application::{Mode, Refusal};
use etherpen::config::Config;
use etherpen::measurement::{MeasurementAnswer, MeasurementRequest};
use etherpen::messages::{Command, Counters, PathVertex, RecordAnswer, Status};
use etherpen::motion::Pen;
use std::sync::Arc;

/// Time between two inquiries, ms.
const INQUIRE_MS: u32 = 50;
/// Time before a refused command is repeated, ms.
const RETRY_MS: u32 = 100;
/// Time limit of every step except the measurement, ms.
const STEP_MAX_MS: u32 = 60_000;
/// Vertices of the path that keeps the planner busy; it is drawn repeatedly.
const PATH_VERTICES: usize = 4_000;
/// Longest leg of that path, micrometres.
const LEG_MAX_UM: u64 = 600;
/// Half the side of the square that the path fills, micrometres.
const HALF_SIDE_UM: i32 = 30_000;
/// Heights of the pen over the paper and on it, micrometres.
const UP_UM: i32 = -847_000;
const DOWN_UM: i32 = -850_000;
/// What the path's seed is mixed with.
const SEED: u64 = 0x9E37_79B9_7F4A_7C15;

/// Result of a run.
#[derive(Clone, Debug)]
pub(super) enum Outcome {
    /// The run was measured.
    Measured {
        /// The histograms.
        readings: Readings,
        /// The counters' growth.
        counters: Counters,
    },
    /// The run failed, with the reason.
    Failed(String),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Connecting,
    Configuring,
    Referencing,
    Enabling,
    Disturbing,
    Settling,
    Measuring,
    Counting,
    Reading,
}

/// The host's end of the link.
pub(super) struct Peer {
    session: Session,
    config: Config,
    disturbance: Disturbance,
    settle_ms: u32,
    measure_ms: u32,
    path: Arc<[PathVertex]>,
    step: Step,
    now_ms: u32,
    since_ms: u32,
    inquired_ms: u32,
    retry_ms: u32,
    awaited: Option<u16>,
    status: Option<Status>,
    before: Counters,
    job: u16,
    drawing: bool,
    reader: Reader,
    outcome: Option<Outcome>,
}

impl Peer {
    pub(super) fn new(config: Config, disturbance: Disturbance, seed: u64, settle_ms: u32, measure_ms: u32) -> Self {
        let mut session = Session::new(1);
        session.connect();
        Self {
            session,
            config,
            disturbance,
            settle_ms,
            measure_ms,
            path: path(seed).into(),
            step: Step::Connecting,
            now_ms: 0,
            since_ms: 0,
            inquired_ms: 0,
            retry_ms: 0,
            awaited: None,
            status: None,
            before: Counters::default(),
            job: 0,
            drawing: false,
            reader: Reader::new(),
            outcome: None,
        }
    }

    /// Result of the run; returned once.
    pub(super) fn take_outcome(&mut self) -> Option<Outcome> {
        self.outcome.take()
    }

    /// Milliseconds measured so far.
    pub(super) fn measured_ms(&self) -> u32 {
        match self.step {
            Step::Measuring => self.now_ms.saturating_sub(self.since_ms),
            Step::Counting | Step::Reading => self.measure_ms,
            _ => 0,
        }
    }

    fn enter(&mut self, step: Step) {
        self.step = step;
        self.since_ms = self.now_ms;
        self.awaited = None;
        self.status = None;
        self.inquired_ms = self.now_ms;
        self.session.inquire();
    }

    fn fail(&mut self, cause: String) {
        self.outcome.get_or_insert(Outcome::Failed(cause));
    }

    fn take(&mut self, event: Event) {
        match event {
            Event::Connected(_) => {
                self.session.configure(self.config.clone());
                self.enter(Step::Configuring);
            }
            Event::VersionRefused { .. } | Event::Restarted => self.fail("the connection was lost".to_owned()),
            Event::Configured(Err(refusal)) => self.fail(format!("the configuration was refused: {refusal:?}")),
            Event::VertexRefused(refusal) => self.fail(format!("the path was refused: {refusal:?}")),
            Event::Answered { id, command, result } => self.take_answer(id, command, result),
            Event::Status(status) => {
                if let Some(fault) = status.fault {
                    self.fail(format!("fault: {fault:?}"));
                }
                self.status = Some(status);
            }
            Event::Ack(ack) => self.drawing &= !(ack.job == self.job && ack.finished),
            Event::Measured(RecordAnswer::Measurement(answer)) => self.take_measurement(&answer),
            Event::Measured(RecordAnswer::BlackBox(_))
            | Event::Configured(Ok(_))
            | Event::Bus(_)
            | Event::Samples { .. } => {}
        }
    }

    fn take_answer(&mut self, id: u16, command: Command, result: Result<(), Refusal>) {
        if self.awaited.take_if(|awaited| *awaited == id).is_none() {
            return;
        }
        match (command, result) {
            (Command::Draw { job }, Ok(())) => {
                self.session.start_path(job, self.path.clone());
                self.drawing = true;
            }
            (_, Ok(())) => {}
            (_, Err(_)) => self.retry_ms = self.now_ms + RETRY_MS,
        }
    }

    fn take_measurement(&mut self, answer: &MeasurementAnswer) {
        match (self.step, answer) {
            (_, MeasurementAnswer::NotOffered) => self.fail("this image makes no disturbance".to_owned()),
            (Step::Disturbing, _) => self.enter(Step::Settling),
            (Step::Reading, _) => {
                self.reader.take(answer);
                self.read_on();
            }
            _ => {}
        }
    }

    fn read_on(&mut self) {
        match self.reader.request() {
            Some(request) => self.session.measure(request.into()),
            None => {
                let counters = self.status.as_ref().map(|status| status.counters).unwrap_or_default();
                let readings = std::mem::take(&mut self.reader).into_readings().unwrap_or_default();
                self.outcome.get_or_insert(Outcome::Measured {
                    readings,
                    counters: growth(&self.before, &counters),
                });
            }
        }
    }

    fn request(&mut self, command: Command) {
        if self.awaited.is_none() && self.now_ms >= self.retry_ms {
            self.awaited = Some(self.session.command(command));
        }
    }

    fn advance(&mut self) {
        let waited_ms = self.now_ms.saturating_sub(self.since_ms);
        if self.step != Step::Measuring && waited_ms > STEP_MAX_MS + self.settle_ms {
            return self.fail(format!("{:?} took more than {STEP_MAX_MS} ms", self.step));
        }
        if self.step != Step::Connecting && self.now_ms.saturating_sub(self.inquired_ms) >= INQUIRE_MS {
            self.inquired_ms = self.now_ms;
            self.session.inquire();
        }
        let Some(status) = &self.status else { return };
        let (mode, referenced, counters) = (status.mode, status.referenced, status.counters);
        match self.step {
            Step::Connecting | Step::Disturbing | Step::Reading => {}
            Step::Configuring => {
                if matches!(mode, Mode::DrivesOff | Mode::Unreferenced) {
                    self.enter(Step::Referencing);
                }
            }
            Step::Referencing if referenced => self.enter(Step::Enabling),
            Step::Referencing => self.request(Command::Home),
            Step::Enabling if mode == Mode::Idle => {
                let bits = self.disturbance.bits();
                self.session.measure(MeasurementRequest::Disturb { bits }.into());
                self.enter(Step::Disturbing);
            }
            Step::Enabling => self.request(Command::Enable),
            Step::Settling if waited_ms >= self.settle_ms => {
                self.session.measure(MeasurementRequest::Reset.into());
                self.before = counters;
                self.step = Step::Measuring;
                self.since_ms = self.now_ms;
            }
            Step::Measuring if waited_ms >= self.measure_ms => {
                self.enter(Step::Counting);
            }
            Step::Counting => {
                self.step = Step::Reading;
                self.read_on();
            }
            Step::Settling | Step::Measuring => self.keep_planning(mode),
        }
    }

    /// Draws the path again when it has ended.
    fn keep_planning(&mut self, mode: Mode) {
        if self.disturbance.planner && !self.drawing && mode == Mode::Idle && self.awaited.is_none() {
            self.job = self.job.wrapping_add(1);
            self.request(Command::Draw { job: self.job });
        }
    }
}

impl Link for Peer {
    fn exchange(&mut self, ms: u32, from_device: &[u8], to_device: &mut Vec<u8>) {
        self.now_ms = ms;
        self.session.receive(from_device, ms.into());
        while let Some(event) = self.session.next_event() {
            self.take(event);
        }
        if self.outcome.is_none() {
            self.advance();
        }
        to_device.resize(LINK_BYTES_MAX, 0);
        let length = self.session.transmit(ms.into(), to_device);
        to_device.truncate(length);
    }
}

/// Increase of the counters between two readings.
fn growth(before: &Counters, after: &Counters) -> Counters {
    Counters {
        cycles: after.cycles.wrapping_sub(before.cycles),
        cycles_late: after.cycles_late.wrapping_sub(before.cycles_late),
        frames_lost: after.frames_lost.wrapping_sub(before.frames_lost),
        working_counter_errors: after.working_counter_errors.wrapping_sub(before.working_counter_errors),
        frames_ignored: after.frames_ignored.wrapping_sub(before.frames_ignored),
        setpoint_underruns: after.setpoint_underruns.wrapping_sub(before.setpoint_underruns),
        path_starvations: after.path_starvations.wrapping_sub(before.path_starvations),
        trajectory_overruns: after.trajectory_overruns.wrapping_sub(before.trajectory_overruns),
        telemetry_dropped: after.telemetry_dropped.wrapping_sub(before.telemetry_dropped),
        link_errors: after.link_errors.wrapping_sub(before.link_errors),
        ethernet_errors: after.ethernet_errors.wrapping_sub(before.ethernet_errors),
        path_stops_left: after.path_stops_left.wrapping_sub(before.path_stops_left),
    }
}

/// Short legs in random directions: many corners in the planner's window, each with its own speed.
fn path(seed: u64) -> Vec<PathVertex> {
    let mut random = XorshiftStar::new(SEED ^ seed);
    let mut random = |below: u64| random.below(below);
    let vertex = |x_um: i32, y_um: i32, z_um: i32, pen: Pen| PathVertex {
        position_um: [x_um, y_um, z_um],
        pen,
        stroke: 0,
    };
    let mut path = vec![vertex(0, 0, UP_UM, Pen::Up), vertex(0, 0, DOWN_UM, Pen::Up)];
    let (mut x_um, mut y_um) = (0, 0);
    for _ in 0..PATH_VERTICES {
        let mut leg = || (random(2 * LEG_MAX_UM) as i32) - LEG_MAX_UM as i32;
        let next = (
            (x_um + leg()).clamp(-HALF_SIDE_UM, HALF_SIDE_UM),
            (y_um + leg()).clamp(-HALF_SIDE_UM, HALF_SIDE_UM),
        );
        if next != (x_um, y_um) {
            (x_um, y_um) = next;
            path.push(vertex(x_um, y_um, DOWN_UM, Pen::Down));
        }
    }
    path.push(vertex(x_um, y_um, UP_UM, Pen::Up));
    path
}
