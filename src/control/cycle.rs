//! What passes between the sampler and the slower tasks.
//!
//! Commands and references come from below, a report of every millisecond goes there. All of it is plain data that the
//! lock-free queues copy; what it does is the sampler's.
//!
//! Invariant: a report holds all that a slower task may know of its millisecond; nobody asks the sampler for more.

use crate::application::{Fault, Power};
use crate::board::Interlock;
use crate::config::{Axis, Bus};
use crate::ethercat::cyclic::BusCounters;
use crate::motion::Reference;
use crate::robot::{AXES, JointAngles};

/// A reference on its way to the sampler, with the start it belongs to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Queued {
    /// The start ([`crate::application::Action::Place`]) this reference belongs to.
    pub epoch: u8,
    /// The reference.
    pub reference: Reference,
}

/// What the slower side asks of the sampler.
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
    /// Take the resolvers' present angles as the reference, on the turns nearest to a pose, or to the marks.
    TakeReference {
        /// The pose.
        near: Option<JointAngles>,
    },
    /// Follow the references of this start.
    Follow {
        /// Number of the start.
        epoch: u8,
    },
    /// Forget the latched fault.
    ClearFault,
}

/// What the sampler has counted since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SamplerCounters {
    /// Released samples.
    pub cycles: u32,
    /// Output telegrams later than [`OUTPUT_LATE_NS`](super::sampler::OUTPUT_LATE_NS), or not sent at all.
    pub cycles_late: u32,
    /// Milliseconds without a reference while following.
    pub underruns: u32,
    /// Reports that found no room in their queue.
    pub reports_dropped: u32,
}

/// One millisecond as the sampler saw it.
#[derive(Clone, Copy, Debug, Default)]
pub struct CycleReport {
    /// Number of the millisecond.
    pub cycle: u32,
    /// The reference that was followed.
    pub reference: Reference,
    /// Whether a reference was followed.
    pub following: bool,
    /// Measured or predicted joint positions, rad.
    pub measured_rad: [f64; AXES],
    /// Measured joint velocities, rad/s.
    pub measured_rad_s: [f64; AXES],
    /// Status words of the drives.
    pub status_word: [u16; AXES],
    /// Whether each axis delivered a valid position.
    pub valid: [bool; AXES],
    /// What the drives' encoders showed last, increments since an unknown turn.
    pub increments: [i64; AXES],
    /// Whether each axis is referenced.
    pub referenced: [bool; AXES],
    /// Whether all axes stand still.
    pub standstill: bool,
    /// Phase of the sample against the bus clock, ns, positive when it came too late; `None` without a clock.
    pub clock_error_ns: Option<i32>,
    /// The latched fault.
    pub fault: Option<Fault>,
    /// What on the board keeps the drives in quick stop.
    pub interlock: Option<Interlock>,
    /// The sampler's counters.
    pub counters: SamplerCounters,
    /// The bus' counters.
    pub bus: BusCounters,
}

impl CycleReport {
    /// What the drives' encoders show, increments since an unknown turn; `None` where nothing came.
    pub fn shown(&self) -> [Option<i64>; AXES] {
        core::array::from_fn(|axis| self.valid[axis].then_some(self.increments[axis]))
    }
}
