//! Data exchanged between the sampler and the slower tasks.
//!
//! The slower tasks send commands and setpoints; the sampler sends a report every millisecond. All of it is plain data
//! that the lock-free queues copy; the logic is in the sampler.
//!
//! Invariant: a report holds everything that a slower task may know about its millisecond; no task asks the sampler for
//! more.

use crate::application::{Fault, Power};
use crate::board::Interlock;
use crate::config::{Axis, Bus, SAMPLE_WORDS_MAX};
use crate::control::io::{IoPlaces, IoReport};
use crate::control::pen_switch::PenSwitch;
use crate::control::tool::ToolOutput;
use crate::ethercat::cyclic::BusCounters;
use crate::motion::Setpoint;
use crate::robots::{AXES, JointAngles, Kind};

/// A setpoint for the sampler, with the start that it belongs to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Queued {
    /// The start ([`crate::application::Action::Place`]) this setpoint belongs to.
    pub epoch: u8,
    /// The setpoint.
    pub setpoint: Setpoint,
}

/// A command of the slower tasks to the sampler.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // a handful, in static memory
pub enum SamplerCommand {
    /// Use these axes and bus limits.
    Configure {
        /// The axes.
        axes: [Axis; AXES],
        /// The bus.
        bus: Bus,
    },
    /// Power of the drives.
    Power(Power),
    /// Home: take the encoders' present angles as the joint angles, where they do not know the turns on those nearest to a
    /// pose, or nearest to the marks if there is no pose.
    Home {
        /// The pose.
        near: Option<JointAngles>,
    },
    /// Lead the axes to their switches, and home them there.
    Search {
        /// Kind of the robot, which says how the axes go together.
        kind: Kind,
    },
    /// End a search early; the axes stop.
    EndSearch,
    /// Follow the setpoints of this start.
    Follow {
        /// Number of the start.
        epoch: u8,
    },
    /// Clear the latched fault.
    ClearFault,
    /// Use these inputs and outputs of terminals, these heights of the pen, and this output of the tool.
    ConfigureIo(IoPlaces, PenSwitch, ToolOutput),
    /// Whether the operating mode is one in which the tool may be on.
    Draws(bool),
    /// Switch off the outputs that do not keep their values at a fault, because of a fault that the critical tasks do not
    /// detect.
    SwitchOutputsOff,
    /// Request the value of an output.
    SetOutput {
        /// The output, from 0.
        io: u8,
        /// Its bits.
        value: u32,
    },
}

/// Counters of the sampler since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SamplerCounters {
    /// Released samples.
    pub cycles: u32,
    /// Output telegrams later than [`OUTPUT_LATE_NS`](super::sampler::OUTPUT_LATE_NS), or not sent at all.
    pub cycles_late: u32,
    /// Milliseconds without a setpoint while following.
    pub underruns: u32,
    /// Stops on the path that have left their envelope ([`Fault::PathStopLeft`]).
    pub path_stops_left: u32,
    /// Reports dropped because their queue was full.
    pub reports_dropped: u32,
}

/// State of one millisecond as seen by the sampler.
#[derive(Clone, Copy, Debug, Default)]
pub struct CycleReport {
    /// Number of the millisecond.
    pub cycle: u32,
    /// The setpoint that was followed.
    pub setpoint: Setpoint,
    /// Whether a setpoint was followed.
    pub following: bool,
    /// Measured or predicted joint positions, rad.
    pub measured_rad: [f64; AXES],
    /// Measured joint velocities, rad/s.
    pub measured_rad_s: [f64; AXES],
    /// Status words of the drives.
    pub status_word: [u16; AXES],
    /// Whether each axis delivered a valid position.
    pub valid: [bool; AXES],
    /// Last encoder positions of the drives, increments; the turn is known to multi-turn encoders only.
    pub increments: [i64; AXES],
    /// Whether each axis is homed.
    pub homed: [bool; AXES],
    /// Whether the axes are led to their switches.
    pub searching: bool,
    /// Whether all axes are at rest.
    pub standstill: bool,
    /// Phase of the sample relative to the bus clock, ns; positive when the sample was late; `None` without a clock.
    pub clock_error_ns: Option<i32>,
    /// The latched fault.
    pub fault: Option<Fault>,
    /// Input that keeps the drives in quick stop.
    pub interlock: Option<Interlock>,
    /// The named inputs and outputs.
    pub io: IoReport,
    /// Values of the [sampled words](crate::config::sampled_words), in their order; a missing one has its last value.
    pub io_words: [u32; SAMPLE_WORDS_MAX],
    /// The sampler's counters.
    pub counters: SamplerCounters,
    /// The bus's counters.
    pub bus: BusCounters,
}

impl CycleReport {
    /// Encoder positions of the drives, increments; the turn is known to multi-turn encoders only. `None` where no position
    /// arrived.
    pub fn shown(&self) -> [Option<i64>; AXES] {
        core::array::from_fn(|axis| self.valid[axis].then_some(self.increments[axis]))
    }
}
