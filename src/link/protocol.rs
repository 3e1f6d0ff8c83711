//! Messages between the host and the firmware.
//!
//! Every message is postcard-encoded, followed by a CRC-32 and framed with COBS (see `frame`). An unknown protocol
//! version is refused with both versions named; [`Hello`] and [`Welcome`] never change their first field.

pub use crate::application::Command;

use crate::application::{Fault, Mode, Refusal};
use crate::board::{Interlock, PortState, PreviousRun};
use crate::config::{Config, ConfigError};
use crate::ethercat::diagnostics::{ServiceRequest, ServiceResult};
use crate::measurement::{MeasurementAnswer, MeasurementRequest};
use crate::motion::Pen;
use crate::robots::{AXES, GeometryError};
use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

/// Version of this protocol; both ends must agree.
pub const PROTOCOL_VERSION: u16 = 8;
/// Longest encoded message before framing, bytes.
pub const MESSAGE_BYTES_MAX: usize = 1400;
/// Vertices in one path message.
pub const VERTICES_PER_MESSAGE: usize = 16;
/// Samples in one telemetry message.
pub const SAMPLES_PER_MESSAGE: usize = 4;
/// Slaves described in a status.
pub const SLAVES_REPORTED: usize = 8;

/// Greeting of the host.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// The host's [`PROTOCOL_VERSION`].
    pub protocol: u16,
    /// Number of this connection: not 0 and not the previous one. A greeting with an unchanged number is a repetition.
    pub session: u32,
}

/// Answer of the firmware to [`Hello`], also when the versions differ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Welcome {
    /// The firmware's [`PROTOCOL_VERSION`].
    pub protocol: u16,
    /// Session of the [`Hello`] that is answered; 0 when the firmware has none, for instance after a reset.
    pub session: u32,
    /// Version of the firmware package.
    pub firmware: String<16>,
    /// Name of the board: `nucleo`, `emulated` or `simulation`.
    pub board: String<16>,
    /// Hash of the configuration in force, if there is one.
    pub config: Option<u64>,
    /// Vertices the firmware can hold when nothing is queued.
    pub capacity: u16,
    /// How the previous run ended.
    pub previous: PreviousRun,
}

/// A vertex of the path on the wire: micrometres in the robot's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PathVertex {
    /// Position in the robot's frame, micrometres.
    pub position_um: [i32; 3],
    /// Whether the pen draws on the way to this vertex.
    pub pen: Pen,
    /// Index of the stroke this vertex belongs to.
    pub stroke: u32,
}

/// Message from the host to the firmware.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // one is alive at a time, in static memory
pub enum HostMessage {
    /// First message of a connection.
    Hello(Hello),
    /// Keeps the connection alive when there is nothing else to send.
    Heartbeat,
    /// Use this configuration. Repeated until an answer with this `id` arrives.
    Configure {
        /// Number of this request.
        id: u16,
        /// The configuration.
        config: Config,
    },
    /// Carry out this command. Repeated until an answer with this `id` arrives; carried out once.
    Command {
        /// Number of this request.
        id: u16,
        /// What to do.
        command: Command,
    },
    /// Part of the path, go-back-N.
    Path {
        /// The job of [`Command::Draw`].
        job: u16,
        /// Index of the first vertex in `vertices`, counted from 0 within the job.
        first: u32,
        /// The vertices.
        vertices: Vec<PathVertex, VERTICES_PER_MESSAGE>,
        /// Whether the last vertex in `vertices` ends the path.
        last: bool,
    },
    /// Ask for a [`DeviceMessage::Status`] now.
    Inquire,
    /// Request to the bus. Repeated until an answer with this `id` arrives; carried out once. One at a time.
    Bus {
        /// Number of this request.
        id: u16,
        /// What is asked.
        request: ServiceRequest,
    },
    /// Request to the measurements. Repeated until an answer with this `id` arrives. One at a time.
    Measure {
        /// Number of this request.
        id: u16,
        /// What is asked.
        request: MeasurementRequest,
    },
}

/// State of the controller in one millisecond.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// Milliseconds since the firmware started.
    pub t_ms: u32,
    /// Operating mode.
    pub mode: Mode,
    /// Stroke being drawn or travelled to.
    pub stroke: u32,
    /// Pen state in the setpoint.
    pub pen: Pen,
    /// Commanded joint positions, rad.
    #[serde(rename = "reference_rad")]
    pub setpoint_rad: [f32; AXES],
    /// Measured joint positions, rad.
    pub measured_rad: [f32; AXES],
    /// Commanded joint velocities, rad/s.
    #[serde(rename = "reference_rad_s")]
    pub setpoint_rad_s: [f32; AXES],
    /// Measured joint velocities, rad/s.
    pub measured_rad_s: [f32; AXES],
}

/// Counters of the firmware since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Counters {
    /// Released samples.
    pub cycles: u32,
    /// Cycles in which the output telegram did not reach the MAC in time.
    pub cycles_late: u32,
    /// Telegrams without a reply.
    pub frames_lost: u32,
    /// Replies with an unexpected working counter after the bus became operational.
    pub working_counter_errors: u32,
    /// Replies that were dropped: late, duplicated, foreign or damaged.
    pub frames_ignored: u32,
    /// Milliseconds without a setpoint while the controller was following setpoints.
    #[serde(rename = "reference_underruns")]
    pub setpoint_underruns: u32,
    /// Times the path ran out of vertices while drawing.
    pub path_starvations: u32,
    /// Releases of the trajectory task before it had finished the previous period.
    pub trajectory_overruns: u32,
    /// Samples dropped because the telemetry ring or the link had no room.
    pub telemetry_dropped: u32,
    /// Damaged frames received on the link.
    pub link_errors: u32,
    /// Frames that the board's Ethernet controller dropped or could not send, and errors of its DMA.
    pub ethernet_errors: u32,
}

/// One slave on the bus.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SlaveStatus {
    /// Vendor from the SII.
    pub vendor: u32,
    /// Product code from the SII.
    pub product: u32,
    /// AL state, 1 INIT, 2 PREOP, 4 SAFEOP, 8 OP; bit 4 is the error flag. 0 while the slave does not answer.
    pub al_state: u8,
    /// AL status code.
    pub al_code: u16,
    /// The last CiA 402 status word received.
    pub status_word: u16,
}

/// State of the controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Operating mode.
    pub mode: Mode,
    /// The latched fault.
    pub fault: Option<Fault>,
    /// Whether the fault was acknowledged and the bus and drives are still recovering.
    pub recovering: bool,
    /// Board input that keeps the drives in quick stop.
    pub interlock: Option<Interlock>,
    /// State of the bus's Ethernet port.
    pub port: PortState,
    /// Whether the joint angles are referenced.
    pub referenced: bool,
    /// Whether the joint angles were referenced since start-up and no longer are: the robot may be anywhere.
    pub reference_lost: bool,
    /// Resolver position of each axis within its motor turn, increments; `None` where no position arrives.
    pub increments: [Option<u32>; AXES],
    /// Hash of the configuration in force.
    pub config: Option<u64>,
    /// Path speed override, percent.
    pub override_percent: u8,
    /// Counters.
    pub counters: Counters,
    /// Slaves in chain order.
    pub slaves: Vec<SlaveStatus, SLAVES_REPORTED>,
}

/// Cumulative acknowledgement of the path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PathAck {
    /// The job.
    pub job: u16,
    /// The next vertex expected; all vertices before it have been taken.
    pub next: u32,
    /// How many vertices from `next` on may be sent.
    pub credit: u16,
    /// Whether later vertices arrived and were dropped because `next` was lost.
    pub missing: bool,
    /// Vertices fully executed.
    pub executed: u32,
    /// Whether the end of the path was received.
    pub complete: bool,
    /// Whether the path was executed to its end.
    pub finished: bool,
}

/// Why a configuration was refused. The former one stays in force.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ConfigRefusal {
    /// A value is out of bounds.
    Bounds(ConfigError),
    /// The mode does not allow another configuration.
    NotInMode(Mode),
    /// The dimensions do not form a valid robot.
    Geometry(GeometryError),
}

impl From<GeometryError> for ConfigRefusal {
    fn from(error: GeometryError) -> Self {
        Self::Geometry(error)
    }
}

impl From<ConfigError> for ConfigRefusal {
    fn from(error: ConfigError) -> Self {
        Self::Bounds(error)
    }
}

/// Message from the firmware to the host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // one is alive at a time, in static memory
pub enum DeviceMessage {
    /// Answer to [`HostMessage::Hello`].
    Welcome(Welcome),
    /// Answer to [`HostMessage::Configure`]: the configuration's hash, or why it was refused.
    Configured {
        /// Number of the request.
        id: u16,
        /// The hash, or why it was refused.
        result: Result<u64, ConfigRefusal>,
    },
    /// Answer to [`HostMessage::Command`].
    Answer {
        /// Number of the request.
        id: u16,
        /// Accepted, or why not.
        result: Result<(), Refusal>,
    },
    /// Answer to [`HostMessage::Bus`].
    Bus {
        /// Number of the request.
        id: u16,
        /// The answer, or why there is none.
        result: ServiceResult,
    },
    /// Path acknowledgement with credit and progress.
    Ack(PathAck),
    /// A vertex was refused; no more vertices of this path are taken.
    VertexRefused {
        /// The job.
        job: u16,
        /// The refused vertex and the reason.
        refusal: crate::motion::Refusal,
    },
    /// Status; sent on every change and at least twice a second.
    Status(Status),
    /// Samples, one a millisecond.
    Telemetry {
        /// Sequence number of the first sample; a gap means that samples were dropped.
        sequence: u32,
        /// The samples.
        samples: Vec<Sample, SAMPLES_PER_MESSAGE>,
    },
    /// Answer to [`HostMessage::Measure`].
    Measured {
        /// Number of the request.
        id: u16,
        /// The answer.
        answer: MeasurementAnswer,
    },
}
