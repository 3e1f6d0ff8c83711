//! Tasks of a job, its options, events and report.
//!
//! Plain data, so that a terminal, a web page and a test can show and control a job without knowing its internals.

use super::error::Phase;
use super::progress::Progress;
use super::verification::Verification;
use crate::hash::fnv1a;
use crate::link::measurement::Readings;
use crate::link::session::SessionCounts;
use etherpen::application::{Mode, Refusal};
use etherpen::ethercat::diagnostics::ServiceResult;
use etherpen::messages::{Command, PathVertex, RecordAnswer, Sample, Status, Welcome};
use etherpen::motion::Pen;
use etherpen::robots::Position;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Counter of signs of life of the program that ordered a motion; shared by the thread that gives them and the one that
/// checks them.
#[derive(Clone, Debug, Default)]
pub struct Life(Arc<Signs>);

#[derive(Debug, Default)]
struct Signs {
    count: AtomicU64,
    ended: AtomicBool,
}

impl Life {
    /// Gives a sign of life.
    pub fn sign(&self) {
        self.0.count.fetch_add(1, Ordering::Relaxed);
    }

    /// Signs so far.
    pub fn signs(&self) -> u64 {
        self.0.count.load(Ordering::Relaxed)
    }

    /// Reports that the program has ended.
    pub fn end(&self) {
        self.0.ended.store(true, Ordering::Relaxed);
    }

    /// Whether the program has ended.
    pub fn has_ended(&self) -> bool {
        self.0.ended.load(Ordering::Relaxed)
    }
}

/// Options of a job other than configuration and task.
#[derive(Clone, Copy, Debug)]
pub struct JobOptions {
    /// Number of the connection, see [`Session::new`](crate::link::session::Session::new).
    pub session: u32,
    /// Longest wait for the firmware's answer to the greeting, ms.
    pub connect_max_ms: u64,
    /// Whether to acknowledge an earlier fault and to cancel an abandoned drawing.
    pub acknowledge: bool,
    /// Whether somebody says that the axes of which nothing else shows it are at their marks.
    pub at_marks: bool,
    /// Whether samples are reported as [`JobEvent::Samples`] instead of being kept for the report.
    pub forward_samples: bool,
}

impl Default for JobOptions {
    fn default() -> Self {
        Self {
            session: 1,
            connect_max_ms: 5_000,
            acknowledge: false,
            at_marks: false,
            forward_samples: false,
        }
    }
}

/// Task of a job.
#[derive(Clone, Debug, PartialEq)]
pub enum Task {
    /// Read the state of the machine without any command.
    Look,
    /// End all motion and switch the power off.
    Rest,
    /// Send one command in any mode; done when its effect is reported.
    Tell(Command),
    /// Make the machine ready.
    Prepare(Ready),
    /// Prepare, move, then restore the power state.
    Motion(Motion),
    /// Prepare, draw, then switch the power off.
    Draw(DrawTask),
}

/// How far a machine is prepared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Ready {
    /// Configured, and the bus is operational.
    Bus,
    /// Configured and referenced at the marks.
    Referenced,
    /// Configured and homed anew by the home switches, also if it was referenced; without switches, referenced.
    Homed,
    /// Configured, referenced and enabled: the drives hold the pose.
    Enabled,
}

/// A motion without a path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Motion {
    /// To a position, with the pen up.
    Move(Position),
    /// Lift or lower the pen at the present position.
    Pen(Pen),
    /// At a velocity for a time.
    Jog {
        /// Velocity of the tool, mm/s.
        velocity_mm_s: [f32; 3],
        /// Duration, ms.
        for_ms: u32,
    },
}

/// A path to draw.
#[derive(Clone, Debug, PartialEq)]
pub struct DrawTask {
    /// Number of the drawing, repeated in acknowledgements; [`path_number`] computes it from a
    /// path.
    pub number: u16,
    /// The path.
    pub vertices: Arc<[PathVertex]>,
    /// Whether the firmware has held this drawing since another connection and should resume it.
    pub held: bool,
    /// Whether a machine that is not referenced may be referenced at its marks.
    pub may_reference: bool,
}

impl DrawTask {
    /// A drawing from its beginning.
    pub fn new(vertices: impl Into<Arc<[PathVertex]>>) -> Self {
        let vertices = vertices.into();
        Self {
            number: path_number(path_hash(&vertices)),
            vertices,
            held: false,
            may_reference: true,
        }
    }
}

/// Hash of a path: 64-bit FNV-1a over its vertices.
#[must_use]
pub fn path_hash(vertices: &[PathVertex]) -> u64 {
    let of = |vertex: &PathVertex| {
        let pen = u32::from(vertex.pen == Pen::Down).to_le_bytes();
        let [x, y, z] = vertex.position_um.map(i32::to_le_bytes);
        [x, y, z, pen, vertex.stroke.to_le_bytes()].concat()
    };
    fnv1a(vertices.iter().flat_map(of))
}

/// The number of a path on the link: its hash folded to 16 bits, never 0.
#[must_use]
pub fn path_number(hash: u64) -> u16 {
    let [a, b, c, d] = [hash, hash >> 16, hash >> 32, hash >> 48].map(|part| part as u16);
    (a ^ b ^ c ^ d).max(1)
}

/// A control of a running job by the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Control {
    /// Decelerate on the path, lift the pen, wait.
    Hold,
    /// Hold as soon as the pen is up.
    HoldAtPenUp,
    /// Resume.
    Resume,
    /// End the drawing, park, switch the power off.
    Cancel,
    /// Scale the path speed, percent from 10 to 200.
    Override(u8),
    /// Stop at once, on the path if there is one; latched as a fault.
    Stop,
}

/// An event of a job, for display.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // few are alive at a time
pub enum JobEvent {
    /// The firmware has answered.
    Connected(Welcome),
    /// The job has entered this phase.
    Phase(Phase),
    /// The robot's mode has changed.
    Mode(Mode),
    /// A fault was latched; the job ends when the robot is at rest.
    Fault(etherpen::application::Fault),
    /// The link state of the bus's Ethernet port has changed.
    Port(etherpen::board::PortState),
    /// An operator's command was refused.
    Refused(Command, Refusal),
    /// Telemetry samples were lost directly before the one with this time.
    SamplesMissing {
        /// Number of lost samples.
        missing: u32,
        /// Firmware time of the first sample after the gap, ms.
        t_ms: u32,
    },
    /// A status has arrived.
    Status(Arc<Status>),
    /// Samples have arrived; only with [`JobOptions::forward_samples`].
    Samples {
        /// Samples lost directly before these.
        missing: u32,
        /// One a millisecond, in order.
        samples: Arc<[Sample]>,
    },
    /// A command of [`Job::command`](super::Job::command) was answered.
    Told {
        /// The command's number.
        id: u16,
        /// The command.
        command: Command,
        /// Accepted, or why not.
        result: Result<(), Refusal>,
    },
    /// A bus request was answered; answers come in the order of the requests.
    Bus(ServiceResult),
    /// A request to the firmware's records was answered; answers come in the order of the requests.
    Measured(RecordAnswer),
}

/// Result of a job, also of a failed one.
#[derive(Clone, Debug, Default)]
pub struct JobReport {
    /// The firmware of the connection.
    pub welcome: Option<Welcome>,
    /// Telemetry of the whole job, one sample a millisecond, in order.
    pub samples: Vec<Sample>,
    /// The firmware's measurements since the bus came up; absent when the job ended early.
    pub measurements: Option<Readings>,
    /// Counters of the session; `samples_missing` are the gaps in `samples`.
    pub link: SessionCounts,
    /// The last status, with the firmware's counters.
    pub status: Option<Status>,
    /// The last status before the drawing began.
    pub status_before: Option<Status>,
    /// Progress of the drawing; if a part was not followed, up to the first incomplete stroke.
    pub progress: Progress,
    /// Verification of the drawing from the telemetry.
    pub verification: Verification,
    /// Time from the accepted start to the end of the path, s, without the time on hold.
    pub drawn_s: f64,
    /// Time on hold, s.
    pub held_s: f64,
}
