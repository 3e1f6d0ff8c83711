//! Messages between a host and its firmware.
//!
//! Every message is encoded by postcard, followed by a CRC-32 and framed with COBS (see [`frame`](crate::frame)). An
//! unknown protocol version is refused with both versions named; [`Hello`] and [`Welcome`] never change their first
//! field.

use crate::Protocol;
use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

/// Longest encoded message before framing, bytes.
pub const MESSAGE_BYTES_MAX: usize = 2088;
/// Vertices in one path message.
pub const VERTICES_PER_MESSAGE: usize = 16;
/// Samples in one telemetry message.
pub const SAMPLES_PER_MESSAGE: usize = 4;

/// Samples of one message.
pub type Samples<P> = Vec<<P as Protocol>::Sample, SAMPLES_PER_MESSAGE>;

/// Vertices of one message.
pub type PathVertices<P> = Vec<<P as Protocol>::Vertex, VERTICES_PER_MESSAGE>;

/// Greeting of the host.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// The host's [`Protocol::VERSION`].
    pub protocol: u16,
    /// Number of this connection: not 0 and not the previous one. A greeting with an unchanged number is a repetition.
    pub session: u32,
}

/// Answer of the firmware to [`Hello`], sent even if the versions differ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct Welcome<P: Protocol> {
    /// The firmware's [`Protocol::VERSION`].
    pub protocol: u16,
    /// Session of the [`Hello`] that is answered; 0 when the firmware has none, for instance after a reset.
    pub session: u32,
    /// Version of the firmware package.
    pub firmware: String<16>,
    /// Name of the board.
    pub board: String<16>,
    /// Hash of the configuration in force, if there is one.
    pub config: Option<u64>,
    /// Vertices the firmware can hold when nothing is queued.
    pub capacity: u16,
    /// How the previous run ended.
    pub previous: P::PreviousRun,
}

/// Message from the host to the firmware.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
#[allow(clippy::large_enum_variant)] // one is alive at a time, in static memory
pub enum HostMessage<P: Protocol> {
    /// First message of a connection.
    Hello(Hello),
    /// Keeps the connection alive when there is nothing else to send.
    Heartbeat,
    /// Use this configuration. Repeated until an answer with this `id` arrives.
    Configure {
        /// Number of this request.
        id: u16,
        /// The configuration.
        config: P::Config,
    },
    /// Carry out this command. Repeated until an answer with this `id` arrives; carried out once.
    Command {
        /// Number of this request.
        id: u16,
        /// What to do.
        command: P::Command,
    },
    /// Part of the path, go-back-N.
    Path {
        /// The job of [`CommandEffect::OpensPath`](crate::CommandEffect::OpensPath).
        job: u16,
        /// Index of the first vertex in `vertices`, counted from 0 within the job.
        first: u32,
        /// The vertices.
        vertices: PathVertices<P>,
        /// Whether the last vertex in `vertices` ends the path.
        last: bool,
    },
    /// Ask for a [`DeviceMessage::Status`] now.
    Inquire,
    /// Request to the bus. Repeated until an answer with this `id` arrives; carried out once. One at a time.
    Bus {
        /// Number of this request.
        id: u16,
        /// The request.
        request: P::BusRequest,
    },
    /// Request to the measurements. Repeated until an answer with this `id` arrives. One at a time.
    Measure {
        /// Number of this request.
        id: u16,
        /// The request.
        request: P::MeasurementRequest,
    },
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
    /// Whether the path was executed to its end; never if a vertex of it was refused.
    pub finished: bool,
}

/// Message from the firmware to the host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
#[allow(clippy::large_enum_variant)] // one is alive at a time, in static memory
pub enum DeviceMessage<P: Protocol> {
    /// Answer to [`HostMessage::Hello`].
    Welcome(Welcome<P>),
    /// Answer to [`HostMessage::Configure`]: the configuration's hash, or why it was refused.
    Configured {
        /// Number of the request.
        id: u16,
        /// The hash, or why it was refused.
        result: Result<u64, P::ConfigRefusal>,
    },
    /// Answer to [`HostMessage::Command`].
    Answer {
        /// Number of the request.
        id: u16,
        /// Accepted, or why not.
        result: Result<(), P::Refusal>,
    },
    /// Answer to [`HostMessage::Bus`].
    Bus {
        /// Number of the request.
        id: u16,
        /// The answer, or why there is none.
        result: P::BusResult,
    },
    /// Path acknowledgement with credit and progress.
    Ack(PathAck),
    /// A vertex was refused; no more vertices of this path are taken.
    VertexRefused {
        /// The job.
        job: u16,
        /// The refused vertex and the reason.
        refusal: P::VertexRefusal,
    },
    /// Status; sent on every change and at least twice a second.
    Status(P::Status),
    /// Samples, one a millisecond.
    Telemetry {
        /// Sequence number of the first sample; a gap means that samples were dropped.
        sequence: u32,
        /// The samples.
        #[serde(serialize_with = "P::serialize_samples", deserialize_with = "P::deserialize_samples")]
        samples: Samples<P>,
    },
    /// Answer to [`HostMessage::Measure`].
    Measured {
        /// Number of the request.
        id: u16,
        /// The answer.
        answer: P::MeasurementAnswer,
    },
}
