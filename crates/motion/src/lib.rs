#![doc = include_str!("../README.md")]
//!
//! # Layers
//!
//! A module imports modules of lower layers only.
//!
//! 1. `bounds`, `ring`, `committed`, `work_volume`: bounds of a value; a ring buffer; the executed motion for other programs;
//!    the space of a tool
//! 2. `robots`: kinds of robots and their kinematics
//! 3. `settings`, `curve`: settings of motion, with the shares of the tolerance that the moving average and the input shaper
//!    take; lines and blends
//! 4. `limits`, `work_area`, `shaping`: limits along a path; the space that a robot may use; the polyline with rounded
//!    corners
//! 5. `delay_line`: sums the copies of an input shaper
//! 6. `scan`, `micro_interpolator`, `heading`, `pen_lift`: the fastest speed over a grid; 1 ms setpoints; angle of the fourth
//!    axis; where the pen is lifted
//! 7. `grid`, `progress`, `jog`, `straight`: points of a path; motions without a path
//! 8. `stretches`, `admission`, `outline`: parts of a plan; checks of vertices; the shaped path for other programs
//! 9. `plan`, `merging`: speeds along the known path, down to rest at its end; vertices denser than the tolerance
//! 10. `trajectory`: the trajectory stage with its commands
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod admission;
mod bounds;
#[cfg(test)]
mod checks;
mod committed;
mod curve;
mod delay_line;
mod grid;
mod heading;
mod jog;
mod limits;
mod merging;
mod micro_interpolator;
mod outline;
mod pen_lift;
mod plan;
mod progress;
#[cfg(test)]
mod random;
mod ring;
pub mod robots;
mod scan;
pub mod settings;
mod shaping;
mod straight;
mod stretches;
mod trajectory;
mod work_area;
mod work_volume;

pub use admission::{Admission, LEG_CHECK_MM, LEG_MIN_MM};
pub use committed::{Observer, Passage};
pub use outline::{Outline, Section, Station};
pub use settings::Settings;
pub use settings::averaging::{effective_jerk_window_ms, resonance_min_hz, shaper_deviation_mm};
pub use settings::input_shaper::RESONANCE_HZ;
pub use trajectory::{QUEUE_VERTICES, Trajectory};
pub use work_area::{Outside, WorkArea};

use crate::robots::{AXES, Position};
use serde::{Deserialize, Serialize};

/// Period of the trajectory stage, ms: the number of setpoints from one step.
pub const PERIOD_MS: usize = 12;

/// Whether the pen touches the paper.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Pen {
    /// Lifted.
    #[default]
    Up,
    /// Drawing.
    Down,
}

/// A vertex of a path: a three-dimensional polyline in the robot's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// Position of the vertex.
    pub position: Position,
    /// Whether the pen draws on the way to this vertex.
    pub pen: Pen,
    /// Index of the stroke.
    pub stroke: u32,
}

/// One 1 ms setpoint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Setpoint {
    /// Joint positions, rad.
    pub position_rad: [f64; AXES],
    /// Joint velocities, rad/s: exact differences of the positions.
    pub velocity_rad_s: [f64; AXES],
    /// Stroke being executed.
    pub stroke: u32,
    /// Pen state on the path.
    pub pen: Pen,
    /// Vertices of the path fully executed.
    pub vertex: u32,
    /// Speed over the paper that leads to the position, mm/s, vertical motion not counted; 0 with the pen up. Averaged over
    /// one millisecond.
    pub drawing_mm_s: f32,
}

/// A vertex that was not admitted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Refusal {
    /// Index of the vertex in its path.
    pub index: u32,
    /// Why.
    pub reason: RefusalReason,
}

/// Why a vertex was not admitted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum RefusalReason {
    /// A coordinate is not a finite number.
    NotFinite,
    /// The vertex coincides with the one before it.
    Repeated {
        /// Distance between them, mm.
        distance_mm: f64,
    },
    /// The vertex lies outside the work area.
    Outside(Outside),
    /// The leg to the vertex leaves the work area.
    Leg {
        /// The first checked point of the leg that is outside.
        at: Position,
        /// Why the point is outside.
        outside: Outside,
    },
    /// The leg to the vertex turns a fourth axis that follows the path out of its range.
    Wound {
        /// Angle after the leg, rad.
        angle_rad: f64,
        /// Lowest allowed angle, rad.
        low_rad: f64,
        /// Highest allowed angle, rad.
        high_rad: f64,
    },
}

/// A command to the trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotionCommand {
    /// Begin to execute the path that has been pushed.
    Start,
    /// Decelerate on the path, lift the pen and wait; the path can be resumed.
    Hold,
    /// Continue a held path.
    Resume,
    /// Decelerate on the path, lift the pen, discard the rest.
    Cancel,
    /// Scale the path speed, percent from 10 to 200.
    Override(u8),
    /// Move in a straight line to a position.
    MoveTo(Position),
    /// Move with this velocity, mm/s, while the command is repeated.
    Jog([f64; 3]),
    /// End a jog.
    JogStop,
    /// Lift or lower the pen at the present position.
    Pen(Pen),
}

/// State of the trajectory stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum MotionState {
    /// At rest without a path.
    #[default]
    Idle,
    /// Moving along the path.
    Running,
    /// At rest on the path, waiting for path data; the pen is lifted after a dwell.
    Starved,
    /// Decelerating to a hold.
    Holding,
    /// Held: at rest, the pen lifted.
    Held,
    /// Returning to the path.
    Resuming,
    /// Decelerating to a rest that ends the path or a motion.
    Stopping,
    /// Executing a single move.
    Moving,
    /// Jogging.
    Jogging,
}

/// Why a command or a vertex was refused. A refusal changes nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotionRefusal {
    /// The command is not allowed in this state.
    State(MotionState),
    /// A path is waiting; it has to be started or cancelled first.
    PathPending,
    /// There is no pose to start from.
    NotPlaced,
    /// The queue of vertices is full.
    Full,
    /// An override outside 10 to 200 percent.
    Override {
        /// The percentage requested.
        percent: u8,
    },
    /// The target cannot be reached.
    Target(Refusal),
}
