//! What goes into a job and what comes out of it.
//!
//! Plain data, so that a terminal, a web page and a test can show and steer a job without knowing how it works.

use super::error::Phase;
use super::measurement::Readings;
use super::progress::Progress;
use super::session::SessionCounts;
use super::verification::Verification;
use etherpen::application::{Mode, Refusal};
use etherpen::ethercat::service::ServiceResult;
use etherpen::link::protocol::{Command, PathVertex, Sample, Status, Welcome};
use etherpen::measurement::MeasurementAnswer;
use etherpen::motion::Pen;
use etherpen::robot::Position;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Signs of life of the program that has ordered a motion, given in one thread and looked for in another.
#[derive(Clone, Debug, Default)]
pub struct Life(Arc<AtomicU64>);

impl Life {
    /// Gives a sign.
    pub fn sign(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// Signs so far.
    pub fn signs(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// What a job is given besides configuration and task.
#[derive(Clone, Copy, Debug)]
pub struct JobOptions {
    /// Number of the connection, see [`Session::new`](super::session::Session::new).
    pub session: u32,
    /// Longest wait for the firmware's answer to the greeting, ms.
    pub connect_max_ms: u64,
    /// Whether a fault that was latched before is acknowledged, and a drawing left behind cancelled.
    pub acknowledge: bool,
    /// Whether samples are handed on as [`JobEvent::Samples`] instead of being kept for the report.
    pub forward_samples: bool,
}

impl Default for JobOptions {
    fn default() -> Self {
        Self {
            session: 1,
            connect_max_ms: 5_000,
            acknowledge: false,
            forward_samples: false,
        }
    }
}

/// What a job is for.
#[derive(Clone, Debug, PartialEq)]
pub enum Task {
    /// Find out where the machine stands; nothing is commanded.
    Look,
    /// End what goes on and give up the power.
    Rest,
    /// One command as it is, whatever the machine does; done when its effect is reported.
    Tell(Command),
    /// Make the machine ready.
    Prepare(Ready),
    /// Make ready, move, leave the power as it was found.
    Motion(Motion),
    /// Make ready, draw, give up the power.
    Draw(Drawing),
}

/// How ready a machine is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Ready {
    /// Configured, the bus is operational.
    Bus,
    /// The joint angles are referenced too, at the marks.
    Referenced,
    /// The drives hold the pose too.
    Enabled,
}

/// A motion that needs no path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Motion {
    /// To a position, pen up.
    Move(Position),
    /// The pen up or down where it stands.
    Pen(Pen),
    /// With a velocity for a while.
    Jog {
        /// Velocity of the platform, mm/s.
        velocity_mm_s: [f32; 3],
        /// For how long, ms.
        for_ms: u32,
    },
}

/// A path to be drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawing {
    /// Number of the drawing, repeated in acknowledgements; [`path_number`](super::job::path_number) makes one of a path.
    pub number: u16,
    /// The path.
    pub vertices: Arc<[PathVertex]>,
    /// Whether the firmware holds this drawing since another connection, and is to go on with it.
    pub held: bool,
    /// Whether a machine that is not referenced may take the reference at its marks.
    pub may_reference: bool,
}

impl Drawing {
    /// A drawing from its beginning.
    pub fn new(vertices: impl Into<Arc<[PathVertex]>>) -> Self {
        let vertices = vertices.into();
        Self {
            number: super::job::path_number(super::job::path_hash(&vertices)),
            vertices,
            held: false,
            may_reference: true,
        }
    }
}

/// What an operator can do with a running job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Control {
    /// Decelerate on the path, lift the pen, wait.
    Hold,
    /// Hold as soon as the pen is up.
    HoldAtPenUp,
    /// Go on.
    Resume,
    /// End the drawing, park, take the power.
    Cancel,
    /// Scale the path speed, percent from 10 to 200.
    Override(u8),
    /// Quick stop, latched as a fault.
    Stop,
}

/// What there is to show to a person.
#[derive(Clone, Debug, PartialEq)]
pub enum JobEvent {
    /// The firmware has answered.
    Connected(Welcome),
    /// The job has come to this phase.
    Phase(Phase),
    /// The robot's mode has changed.
    Mode(Mode),
    /// A fault was latched; the job ends when the robot stands.
    Fault(etherpen::application::Fault),
    /// The link of the bus' Ethernet port came or went.
    Port(etherpen::board::PortState),
    /// An operator's command was refused.
    Refused(Command, Refusal),
    /// Samples of the telemetry were lost right before the one with this time.
    SamplesMissing {
        /// How many.
        missing: u32,
        /// Firmware time of the first sample after the gap, ms.
        t_ms: u32,
    },
    /// A status has come.
    Status(Arc<Status>),
    /// Samples have come; only with [`JobOptions::forward_samples`].
    Samples {
        /// Samples that were lost right before these.
        missing: u32,
        /// One a millisecond, in order.
        samples: Arc<[Sample]>,
    },
    /// A command of [`Job::command`](super::job::Job::command) was answered.
    Told {
        /// The command's number.
        id: u16,
        /// The command.
        command: Command,
        /// Accepted, or why not.
        result: Result<(), Refusal>,
    },
    /// A question to the bus was answered; answers come in the order of the questions.
    Bus(ServiceResult),
    /// A question about the measurements was answered, in order as well.
    Measured(MeasurementAnswer),
}

/// What a job leaves behind, also when it failed.
#[derive(Clone, Debug, Default)]
pub struct JobReport {
    /// The firmware that was talked to.
    pub welcome: Option<Welcome>,
    /// Telemetry of the whole job, one sample a millisecond, in order.
    pub samples: Vec<Sample>,
    /// What the firmware measured of itself since the bus came up; absent when the job ended early.
    pub measurements: Option<Readings>,
    /// What the session counted; `samples_missing` are the gaps in `samples`.
    pub link: SessionCounts,
    /// The last status, with the firmware's counters.
    pub status: Option<Status>,
    /// The last status before the drawing began.
    pub status_before: Option<Status>,
    /// How far the drawing came; where a part was not followed, up to the first stroke that is not complete.
    pub progress: Progress,
    /// What the telemetry says of the drawing.
    pub verification: Verification,
    /// Time from the accepted start to the end of the path, s, without the time in which it was held.
    pub drawn_s: f64,
    /// Time in which the drawing was held, s.
    pub held_s: f64,
}
