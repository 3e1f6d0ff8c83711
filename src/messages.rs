//! What the messages between the host and the firmware contain.
//!
//! [`link`](crate::link) carries the messages; [`RobotProtocol`] gives it the types of this robot. The type aliases
//! below are the messages with these types.

mod io;
mod samples;

pub use crate::application::Command;
pub use io::{IoState, IoValues, IoWords};

use crate::application::{Fault, Mode, Refusal};
use crate::black_box;
use crate::board::{Interlock, PortState, PreviousRun, RunEnd};
use crate::config::{CONFIG_BYTES_MAX, Config, ConfigError, IO_MAX, IoError};
use crate::ethercat::diagnostics::{ServiceRequest, ServiceResult};
use crate::link::message::{MESSAGE_BYTES_MAX, Samples};
use crate::link::{CommandEffect, Protocol, device, message};
use crate::measurement::{MeasurementAnswer, MeasurementRequest};
use crate::motion::{self, Pen};
use crate::robot_bus::BUS_SLAVES_MAX;
use crate::robots::{AXES, GeometryError};
use heapless::Vec;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Version of this protocol; both ends must agree.
pub const PROTOCOL_VERSION: u16 = 20;
/// Slaves described in a status: all that the robot's bus can have.
pub const SLAVES_REPORTED: usize = BUS_SLAVES_MAX;

/// The types of this robot's messages.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotProtocol;

impl Protocol for RobotProtocol {
    const VERSION: u16 = PROTOCOL_VERSION;
    type Config = Config;
    type ConfigRefusal = ConfigRefusal;
    type Command = Command;
    type Refusal = Refusal;
    type Vertex = PathVertex;
    type VertexRefusal = motion::Refusal;
    type Status = Status;
    type Sample = Sample;
    type PreviousRun = PreviousRun;
    type BusRequest = ServiceRequest;
    type BusResult = ServiceResult;
    type MeasurementRequest = RecordRequest;
    type MeasurementAnswer = RecordAnswer;
    const NO_PREVIOUS_RUN: PreviousRun = PreviousRun {
        end: RunEnd::PowerOff,
        fault: None,
    };

    fn effect(command: &Command) -> CommandEffect {
        match *command {
            Command::Draw { job } => CommandEffect::OpensPath { job },
            Command::Cancel => CommandEffect::ClosesPath,
            Command::Stop => CommandEffect::Stops,
            _ => CommandEffect::None,
        }
    }

    fn serialize_samples<S: Serializer>(samples: &[Sample], serializer: S) -> Result<S::Ok, S::Error> {
        samples::serialize(samples, serializer)
    }

    fn deserialize_samples<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Samples<Self>, D::Error> {
        samples::deserialize(deserializer)
    }
}

/// A request to what the firmware records of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RecordRequest {
    /// To the execution times.
    Measurement(MeasurementRequest),
    /// To the black box.
    BlackBox(black_box::Request),
}

impl From<MeasurementRequest> for RecordRequest {
    fn from(request: MeasurementRequest) -> Self {
        Self::Measurement(request)
    }
}

impl From<black_box::Request> for RecordRequest {
    fn from(request: black_box::Request) -> Self {
        Self::BlackBox(request)
    }
}

/// Answer to a [`RecordRequest`] of the same kind.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // one is alive at a time, in static memory
pub enum RecordAnswer {
    /// Of the execution times.
    Measurement(MeasurementAnswer),
    /// Of the black box.
    BlackBox(black_box::Answer),
}

/// Message from the host to the firmware.
pub type HostMessage = message::HostMessage<RobotProtocol>;
/// Message from the firmware to the host.
pub type DeviceMessage = message::DeviceMessage<RobotProtocol>;
/// Answer of the firmware to a greeting.
pub type Welcome = message::Welcome<RobotProtocol>;
/// The firmware's end of the link.
pub type DeviceEndpoint = device::DeviceEndpoint<RobotProtocol>;
/// A request of the host to the application.
pub type DeviceEvent = device::DeviceEvent<RobotProtocol>;

// Beside the configuration: the number of the variant, 1 byte, and that of the request, 3 bytes.
const _: () = assert!(CONFIG_BYTES_MAX + 4 <= MESSAGE_BYTES_MAX);
const _: () = assert!(size_of::<DeviceEndpoint>() <= 11 * 1024);

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
    /// The named inputs and outputs.
    pub io: IoValues,
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
    /// Stops on the path that left their envelope and ended in the drives' quick stop.
    pub path_stops_left: u32,
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
    /// The slave, by its place in the chain from 0, whose start the bring-up or repair waits for.
    pub waiting_for: Option<u8>,
    /// Whether the joint angles are referenced.
    pub referenced: bool,
    /// Whether the joint angles were referenced since start-up and no longer are: the robot may be anywhere.
    pub reference_lost: bool,
    /// Position of each axis as its encoder knows it, increments: within its motor turn, or that of the drive for a multi-turn
    /// or incremental encoder; `None` where no position arrives.
    pub increments: [Option<i32>; AXES],
    /// Hash of the configuration in force.
    pub config: Option<u64>,
    /// Path speed override, percent.
    pub override_percent: u8,
    /// Counters.
    pub counters: Counters,
    /// Slaves in chain order.
    pub slaves: Vec<SlaveStatus, SLAVES_REPORTED>,
    /// The named inputs and outputs, in the order of the configuration.
    pub io: Vec<IoState, IO_MAX>,
}

/// Why a configuration was refused. The previous one stays in force.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ConfigRefusal {
    /// A value is out of bounds.
    Bounds(ConfigError),
    /// The mode does not allow another configuration.
    NotInMode(Mode),
    /// The dimensions do not form a valid robot.
    Geometry(GeometryError),
    /// A named input or output cannot be used.
    Io(IoError),
}

impl From<IoError> for ConfigRefusal {
    fn from(error: IoError) -> Self {
        Self::Io(error)
    }
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

#[cfg(test)]
mod tests;
