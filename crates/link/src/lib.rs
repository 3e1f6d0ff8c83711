#![doc = include_str!("../README.md")]
//!
//! # Layers
//!
//! A module imports modules of lower layers only.
//!
//! 1. `message`, `ports`: messages; which of two ports holds the link
//! 2. `frame`, `receiver`, `sender`, `requests`: frames; both ends of a path; requests with their answers
//! 3. `outgoing`: a frame on its way to the line
//! 4. `device`, `host`: both ends of the link
#![no_std]
#![forbid(unsafe_code)]

#[cfg(feature = "host")]
extern crate alloc;
#[cfg(test)]
extern crate std;

pub mod device;
#[cfg(test)]
mod example;
pub mod frame;
#[cfg(feature = "host")]
pub mod host;
pub mod message;
mod outgoing;
pub mod ports;
mod receiver;
mod requests;
#[cfg(feature = "host")]
mod sender;

use core::fmt::Debug;
use message::Samples;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::DeserializeOwned};

/// What a message may contain: a value that serde can encode and decode without borrowed parts.
pub trait Content: Clone + Debug + PartialEq + Serialize + DeserializeOwned {}

impl<T: Clone + Debug + PartialEq + Serialize + DeserializeOwned> Content for T {}

/// The content of the messages of one machine. Both ends of a link use the same protocol.
///
/// The implementing type is a marker without values; it derives `Clone`, `Debug` and `PartialEq` so that the messages
/// can. Each encoded message must fit into [`message::MESSAGE_BYTES_MAX`]; a longer one is not sent.
pub trait Protocol: Clone + Debug + PartialEq {
    /// Version of the protocol; both ends must agree. Raise it with every change of a type below.
    const VERSION: u16;
    /// A configuration.
    type Config: Content;
    /// Why a configuration was refused.
    type ConfigRefusal: Content;
    /// A command.
    type Command: Content;
    /// Why a command was refused.
    type Refusal: Content;
    /// A vertex of the path.
    type Vertex: Content;
    /// Why a vertex was refused, and which.
    type VertexRefusal: Content;
    /// State of the machine.
    type Status: Content;
    /// State of the machine in one millisecond.
    type Sample: Content;
    /// How the firmware's previous run ended.
    type PreviousRun: Content;
    /// A request that may take seconds, such as reading an object of a slave on a bus.
    type BusRequest: Content;
    /// Answer to a [`Self::BusRequest`].
    type BusResult: Content;
    /// A request to the firmware's measurements of itself.
    type MeasurementRequest: Content;
    /// Answer to a [`Self::MeasurementRequest`].
    type MeasurementAnswer: Content;

    /// Reported until [`DeviceEndpoint::set_previous_run`](device::DeviceEndpoint::set_previous_run) says otherwise.
    const NO_PREVIOUS_RUN: Self::PreviousRun;

    /// What an accepted command means to the link.
    fn effect(command: &Self::Command) -> CommandEffect;

    /// Writes the samples of one message, up to [`message::SAMPLES_PER_MESSAGE`]. A protocol whose samples are much alike
    /// can write them shorter than one after the other.
    ///
    /// # Errors
    /// Errors of the serializer.
    fn serialize_samples<S: Serializer>(samples: &[Self::Sample], serializer: S) -> Result<S::Ok, S::Error> {
        samples.serialize(serializer)
    }

    /// Reads what [`Self::serialize_samples`] has written.
    ///
    /// # Errors
    /// Errors of the deserializer; more samples than a message has.
    fn deserialize_samples<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Samples<Self>, D::Error> {
        Samples::<Self>::deserialize(deserializer)
    }
}

/// What a command means to the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandEffect {
    /// Nothing.
    None,
    /// The path of this job begins at vertex 0.
    OpensPath {
        /// Number of the job.
        job: u16,
    },
    /// No more vertices of the path are taken.
    ClosesPath,
    /// Closes the path like [`ClosesPath`](Self::ClosesPath); the host also drops all its earlier requests.
    Stops,
}
