//! Referencing as a state machine: connect, inspect, configure, wait for the bus, reference, read back.
//!
//! Each step waits for a report of the firmware, never for a fixed time. The drives may be with or without power; the
//! job neither moves the robot nor changes its power.
//!
//! Invariant: the result is the firmware's own angles, on the turns that its telemetry shows after the reference.

use super::error::{JobError, Phase};
use super::{BUS_MAX_MS, SILENCE_MAX_MS, STEP_MAX_MS, is_resolved_by};
use crate::link::session::{Event, Session};
use crate::simulation::Host;
use etherpen::application::{Mode, Refusal};
use etherpen::config::{Config, Encoder};
use etherpen::control::robot_axes::encoder_angle_rad;
use etherpen::messages::{Command, Sample, Status};
use etherpen::robots::{AXES, JointAngles, MAIN_AXES, Position};
use std::f64::consts::TAU;

/// Longest wait for the firmware's answer to the greeting, ms.
const GREETING_MAX_MS: u64 = 5_000;
/// Time between two inquiries, ms.
const INQUIRE_MS: u64 = 50;
/// Longest wait while the robot still moves or positions are missing, ms.
const PATIENCE_MS: u64 = 2_000;
/// Time before a refused reference is requested again, ms.
const RETRY_MS: u64 = 100;
/// Largest difference of two angles that are one, rad.
const SAME_RAD: f64 = 1.0e-6;
/// Time after which the firmware's reports certainly reflect the new reference, ms.
const SETTLE_MS: u32 = 20;

/// The pose at which the robot is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pose {
    /// Within half a motor turn of the synchronisation marks.
    Marks,
    /// Near these joint angles.
    Joints(JointAngles),
    /// With these angles of the main axes, rad, and axis 4 on the motor turn nearest to 0.
    MainAxes([f64; MAIN_AXES]),
    /// On the motor turns nearest to these joint angles, rad: the last ones measured while the robot was referenced.
    Seen([f64; AXES]),
}

/// Reference to take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// The pose at which the robot is.
    pub pose: Pose,
    /// Measured position of the platform, to check the pose.
    pub position: Option<Position>,
    /// Whether the resolvers' offsets are unknown: the pose then sets the offsets instead of being checked against
    /// them.
    pub calibrate: bool,
}

impl Wanted {
    /// The command for the firmware if its encoders show these increments.
    pub(crate) fn command(&self, config: &Config, increments: &[i32; AXES]) -> Command {
        match (self.known_pose(config, increments), self.position) {
            (None, None) => Command::Home,
            (Some(pose), position) => Command::HomeAt { pose, position },
            // The angles of the marks, checked against the measured position.
            (None, position) => Command::HomeAt {
                pose: angles(config, increments, [None; AXES]),
                position,
            },
        }
    }

    /// The known pose, if there is one.
    fn known_pose(&self, config: &Config, increments: &[i32; AXES]) -> Option<JointAngles> {
        match self.pose {
            Pose::Marks => None,
            Pose::Joints(pose) => Some(pose),
            Pose::Seen(seen_rad) => Some(angles(config, increments, seen_rad.map(Some))),
            Pose::MainAxes([first, second, third]) if self.calibrate => Some(JointAngles([first, second, third, 0.0])),
            Pose::MainAxes([first, second, third]) => {
                // The axis of an encoder that knows nothing is at its mark.
                let near_rad = config.axes.each_ref().map(|axis| match axis.encoder {
                    Encoder::SingleTurn => Some(0.0),
                    Encoder::MultiTurn | Encoder::Incremental => None,
                });
                let JointAngles([.., fourth]) = angles(config, increments, near_rad);
                Some(JointAngles([first, second, third, fourth]))
            }
        }
    }
}

/// Angles for these increments, on the turns nearest to other angles or to the marks where the encoders do not know them.
fn angles(config: &Config, increments: &[i32; AXES], near_rad: [Option<f64>; AXES]) -> JointAngles {
    let shown = config.axes.iter().zip(increments).zip(near_rad);
    let mut angles = JointAngles::default();
    for (angle, ((axis, increments), near_rad)) in angles.0.iter_mut().zip(shown) {
        *angle = encoder_angle_rad(axis, i64::from(*increments), near_rad);
    }
    angles
}

/// Reads back a reference that the firmware has taken.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Reading {
    /// Firmware time from which on its reports reflect the reference, ms.
    settled_ms: Option<u32>,
}

impl Reading {
    /// The reference, once a status and a sample certainly reflect it.
    pub(crate) fn take(&mut self, config: &Config, status: &Status, sample: Option<&Sample>) -> Option<Referenced> {
        let cycle = status.counters.cycles;
        let is_after = |ms: u32, other_ms: u32| ms.wrapping_sub(other_ms) < u32::MAX / 2;
        // The status may be older than the reference; the sample next to it is not.
        let sampled_ms = sample.map(|sample| sample.t_ms).filter(|&ms| is_after(ms, cycle));
        let known_ms = sampled_ms.unwrap_or(cycle);
        let settled_ms = *self.settled_ms.get_or_insert(known_ms.wrapping_add(SETTLE_MS));
        let increments = all(&status.increments).filter(|_| status.referenced && is_after(cycle, settled_ms))?;
        let sample = sample.filter(|sample| is_after(sample.t_ms, settled_ms))?;
        let near_rad = sample.measured_rad.map(|angle| Some(f64::from(angle)));
        Some(Referenced {
            pose: angles(config, &increments, near_rad),
            increments,
            config: config.clone(),
        })
    }
}

/// A reference that was taken.
#[derive(Clone, Debug, PartialEq)]
pub struct Referenced {
    /// Joint angles, rad.
    pub pose: JointAngles,
    /// Positions as the encoders know them, increments.
    pub increments: [i32; AXES],
    /// The configuration in effect; with new synchronisation values after a calibration.
    pub config: Config,
}

impl Referenced {
    /// The configuration with this pose as its marks: from then on a reference at the marks gives these angles. An axis with
    /// a home switch keeps its value, the place of the switch.
    pub fn marked(&self) -> Config {
        marked(&self.config, &self.pose, &self.increments)
    }
}

fn marked(config: &Config, pose: &JointAngles, increments: &[i32; AXES]) -> Config {
    let mut marked = config.clone();
    let axes = marked.axes.iter_mut().zip(pose.0).zip(increments);
    for ((axis, angle_rad), increments) in axes.filter(|((axis, _), _)| axis.home.io.is_none()) {
        // A pose that was reported in single precision is no other one.
        if (axis.sync_angle_rad - angle_rad).abs() > SAME_RAD {
            axis.sync_angle_rad = angle_rad;
        }
        match (axis.encoder, *increments) {
            (Encoder::SingleTurn | Encoder::MultiTurn, increments @ (..=-1 | 1..))
            | (Encoder::SingleTurn, increments) => {
                axis.sync_increments = increments;
            }
            // 0 is that of an encoder that was never calibrated: the mark is an increment farther.
            (Encoder::MultiTurn, 0) => {
                axis.sync_increments = 1;
                axis.sync_angle_rad += TAU / axis.gear / f64::from(axis.increments_per_revolution.max(1));
            }
            // What it shows is another number after each start.
            (Encoder::Incremental, _) => {}
        }
    }
    marked
}

/// Takes a reference, as a state machine.
pub struct ReferenceJob {
    session: Session,
    config: Config,
    wanted: Wanted,
    acknowledge: bool,
    calibrated: bool,
    now_ms: u64,
    phase: Phase,
    entered_ms: u64,
    inquired_ms: u64,
    retry_ms: u64,
    awaited: Option<u16>,
    accepted: bool,
    reading: Reading,
    status: Option<Status>,
    sample: Option<Sample>,
    outcome: Option<Result<Referenced, JobError>>,
}

impl ReferenceJob {
    /// A job over a connection with this number, see [`Session::new`].
    pub fn new(config: Config, wanted: Wanted, session: u32) -> Self {
        let mut session = Session::new(session);
        session.connect();
        Self {
            session,
            config,
            wanted,
            acknowledge: false,
            calibrated: false,
            now_ms: 0,
            phase: Phase::Connecting,
            entered_ms: 0,
            inquired_ms: 0,
            retry_ms: 0,
            awaited: None,
            accepted: false,
            reading: Reading::default(),
            status: None,
            sample: None,
            outcome: None,
        }
    }

    /// Sets whether this job acknowledges a fault that was latched before it started.
    #[must_use]
    pub fn acknowledging(self, acknowledge: bool) -> Self {
        Self { acknowledge, ..self }
    }

    /// Advances by about a millisecond: takes the received bytes and appends at most `room` bytes to `outgoing`.
    pub fn step(&mut self, now_ms: u64, incoming: &[u8], outgoing: &mut Vec<u8>, room: usize) {
        self.now_ms = now_ms;
        self.session.receive(incoming, now_ms);
        while let Some(event) = self.session.next_event() {
            self.take(event);
        }
        if self.outcome.is_none() {
            self.supervise();
        }
        if self.outcome.is_none() && self.phase != Phase::Connecting {
            self.advance();
        }
        let before = outgoing.len();
        outgoing.resize(before + room, 0);
        let filled = self.session.transmit(now_ms, &mut outgoing[before..]);
        outgoing.truncate(before + filled);
    }

    /// How the job ended; `None` while it runs.
    pub fn outcome(&self) -> Option<&Result<Referenced, JobError>> {
        self.outcome.as_ref()
    }

    fn take(&mut self, event: Event) {
        match event {
            Event::Connected(_) => self.enter(Phase::Inspecting),
            Event::VersionRefused { host, firmware } => self.fail(JobError::Version { host, firmware }),
            Event::Restarted => self.fail(JobError::Restarted),
            Event::Configured(Ok(hash)) => match self.config.hash() {
                Some(ours) if ours == hash => self.enter(Phase::BusUp),
                ours => self.fail(JobError::ConfigHash { ours, firmware: hash }),
            },
            Event::Configured(Err(refusal)) => self.fail(JobError::Config(refusal)),
            Event::Answered { id, command, result } if self.awaited == Some(id) => {
                self.awaited = None;
                self.take_answer(command, result);
            }
            Event::Status(status) => self.status = Some(status),
            Event::Samples { samples, .. } => self.sample = samples.last().copied().or(self.sample),
            Event::Answered { .. } | Event::Bus(_) | Event::Measured(_) | Event::Ack(_) | Event::VertexRefused(_) => {}
        }
    }

    fn take_answer(&mut self, command: Command, result: Result<(), Refusal>) {
        let patient = self.now_ms.saturating_sub(self.entered_ms) < PATIENCE_MS;
        match result {
            Ok(()) => {
                self.accepted = true;
                self.status = None;
            }
            Err(Refusal::Moving | Refusal::Recovering | Refusal::NoPosition { .. }) if patient => {
                self.retry_ms = self.now_ms + RETRY_MS;
            }
            Err(refusal) => self.fail(JobError::Refused(command, refusal)),
        }
    }

    fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.entered_ms = self.now_ms;
        self.retry_ms = self.now_ms;
        self.accepted = false;
        self.status = None;
        self.inquire();
    }

    fn inquire(&mut self) {
        self.inquired_ms = self.now_ms;
        self.session.inquire();
    }

    fn fail(&mut self, error: JobError) {
        self.outcome.get_or_insert(Err(error));
    }

    fn supervise(&mut self) {
        let waited_ms = self.now_ms.saturating_sub(self.entered_ms);
        if self.phase == Phase::Connecting {
            if waited_ms > GREETING_MAX_MS {
                self.fail(JobError::NoAnswer { waited_ms });
            }
            return;
        }
        if let Some(silent_ms) = self.session.silence_ms(self.now_ms).filter(|ms| *ms > SILENCE_MAX_MS) {
            return self.fail(JobError::LinkLost { silent_ms });
        }
        let patient = self.acknowledge && matches!(self.phase, Phase::Inspecting | Phase::Acknowledging);
        let is_early = matches!(self.phase, Phase::Inspecting | Phase::Configuring);
        let is_ending = |status: &Status| is_early && is_resolved_by(&self.config, status, self.acknowledge);
        let status = self
            .status
            .as_ref()
            .filter(|status| status.mode == Mode::Fault && !patient && !is_ending(status));
        if let Some(fault) = status.and_then(|status| status.fault) {
            let before = self.phase == Phase::Inspecting;
            return self.fail(JobError::Fault { fault, before });
        }
        let limit_ms = match self.phase {
            Phase::BusUp => BUS_MAX_MS,
            _ => STEP_MAX_MS,
        };
        if waited_ms > limit_ms {
            self.fail(JobError::Timeout {
                phase: self.phase,
                waited_ms,
            });
        }
    }

    fn advance(&mut self) {
        if self.now_ms.saturating_sub(self.inquired_ms) >= INQUIRE_MS {
            self.inquire();
        }
        let Some(status) = self.status.clone() else { return };
        match (self.phase, status.mode) {
            (Phase::Inspecting, Mode::Fault) if is_resolved_by(&self.config, &status, self.acknowledge) => {
                self.configure();
            }
            (Phase::Inspecting, Mode::Fault) => self.enter(Phase::Acknowledging),
            (Phase::Acknowledging, Mode::Fault) => self.acknowledge(),
            (Phase::Acknowledging, Mode::Stopping) => {}
            (Phase::Acknowledging, _) => self.enter(Phase::Inspecting),
            (_, Mode::Moving | Mode::Drawing | Mode::Holding | Mode::Stopping) => {
                self.fail(JobError::Busy(status.mode));
            }
            (Phase::Inspecting, _) if status.config.is_some() && status.config == self.config.hash() => {
                self.enter(Phase::BusUp);
            }
            (Phase::Inspecting, _) => self.configure(),
            (Phase::BusUp, Mode::DrivesOff | Mode::Unreferenced | Mode::Idle) => self.enter(Phase::Referencing),
            (Phase::Referencing, _) if self.accepted => self.read_back(&status),
            (Phase::Referencing, _) => self.reference(&status),
            _ => {}
        }
    }

    fn acknowledge(&mut self) {
        if self.awaited.is_none() && !self.accepted {
            self.awaited = Some(self.session.command(Command::Acknowledge));
        }
    }

    fn configure(&mut self) {
        self.enter(Phase::Configuring);
        self.session.configure(self.config.clone());
    }

    /// Requests the reference, once the positions that it needs have arrived.
    fn reference(&mut self, status: &Status) {
        if self.awaited.is_some() || self.now_ms < self.retry_ms {
            return;
        }
        let Some(increments) = all(&status.increments) else {
            if self.now_ms.saturating_sub(self.entered_ms) > PATIENCE_MS {
                let axis = (0u8..).zip(status.increments).find(|(_, shown)| shown.is_none());
                let axis = axis.map_or(0, |(axis, _)| axis);
                self.fail(JobError::Refused(Command::Home, Refusal::NoPosition { axis }));
            }
            return;
        };
        if self.wanted.calibrate && !self.calibrated {
            self.calibrated = true;
            let at_marks = JointAngles(self.config.axes.map(|axis| axis.sync_angle_rad));
            let pose = self.wanted.known_pose(&self.config, &increments);
            self.config = marked(&self.config, &pose.unwrap_or(at_marks), &increments);
            return self.configure();
        }
        let command = self.wanted.command(&self.config, &increments);
        self.awaited = Some(self.session.command(command));
    }

    /// Waits for a status and then a sample that reflect the reference.
    fn read_back(&mut self, status: &Status) {
        if let Some(found) = self.reading.take(&self.config, status, self.sample.as_ref()) {
            self.outcome.get_or_insert(Ok(found));
        }
    }
}

/// Positions of all axes, once all of them have one.
pub(crate) fn all(increments: &[Option<i32>; AXES]) -> Option<[i32; AXES]> {
    let shown: Vec<i32> = increments.iter().copied().flatten().collect();
    shown.try_into().ok()
}

impl Host for ReferenceJob {
    fn exchange(&mut self, ms: u32, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
        self.step(u64::from(ms), from_firmware, to_firmware, room);
    }

    fn is_over(&self) -> bool {
        self.outcome.is_some()
    }
}

#[cfg(test)]
mod tests;
