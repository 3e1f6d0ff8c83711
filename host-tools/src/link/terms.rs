//! What goes into a drawing job and what comes out of it.
//!
//! Plain data, so that a terminal, a web page and a test can show and steer a job without knowing how it works.

use super::error::Phase;
use super::measurement::Readings;
use super::progress::Progress;
use super::session::SessionCounts;
use etherpen::application::{Mode, Refusal};
use etherpen::link::protocol::{Command, Sample, Status, Welcome};

/// What a job is given besides configuration and path.
#[derive(Clone, Copy, Debug)]
pub struct JobOptions {
    /// Number of the connection, see [`Session::new`](super::session::Session::new).
    pub session: u32,
    /// Number of the job, repeated in acknowledgements.
    pub job: u16,
    /// Longest wait for the firmware's answer to the greeting, ms.
    pub connect_max_ms: u64,
    /// Whether a fault that was latched before is acknowledged, and a drawing left behind cancelled.
    pub acknowledge: bool,
}

impl Default for JobOptions {
    fn default() -> Self {
        Self {
            session: 1,
            job: 1,
            connect_max_ms: 5_000,
            acknowledge: false,
        }
    }
}

/// What an operator can do with a running job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Control {
    /// Decelerate on the path, lift the pen, wait.
    Hold,
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
    /// An operator's command was refused.
    Refused(Command, Refusal),
    /// Samples of the telemetry were lost right before the one with this time.
    SamplesMissing {
        /// How many.
        missing: u32,
        /// Firmware time of the first sample after the gap, ms.
        t_ms: u32,
    },
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
    /// How far the drawing came.
    pub progress: Progress,
    /// Time from the accepted start to the end of the path, s.
    pub drawn_s: f64,
}
