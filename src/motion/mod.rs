//! From a list of coordinates to 1 ms references.
//!
//! One module a stage: admission refuses what cannot be executed, shaping makes the polyline smooth within a
//! tolerance, the plan divides it into a grid and scans it for the largest speeds that keep every limit and end at
//! rest, the micro-interpolator makes 1 ms joint references of it, and the trajectory joins them in one step every
//! 12 ms.

mod admission;
mod averaging;
#[cfg(test)]
mod checks;
mod curve;
mod grid;
mod heading;
mod jog;
mod limits;
mod micro_interpolator;
mod outline;
mod plan;
mod progress;
mod ring;
mod scan;
mod shaping;
mod straight;
mod stretches;
pub mod task;
mod trajectory;

pub use admission::{Admission, LEG_CHECK_MM, LEG_MIN_MM};
pub use outline::{Outline, Section, Station};
pub use trajectory::{QUEUE_VERTICES, Trajectory};

use crate::robot::{AXES, Outside, Position};
use serde::{Deserialize, Serialize};

/// Period of the trajectory stage, ms: references that one step gives.
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
    /// Where.
    pub position: Position,
    /// Whether the leg that leads here is drawn.
    pub pen: Pen,
    /// Index of the stroke.
    pub stroke: u32,
}

/// One 1 ms reference.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reference {
    /// Joint positions, rad.
    pub position_rad: [f64; AXES],
    /// Joint velocities, rad/s: exact differences of the positions.
    pub velocity_rad_s: [f64; AXES],
    /// Stroke being executed.
    pub stroke: u32,
    /// Pen as the path has it.
    pub pen: Pen,
    /// Vertices of the path fully executed.
    pub vertex: u32,
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
    /// The vertex lies where the one before it lies.
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
        /// Why it is.
        outside: Outside,
    },
    /// The fourth axis follows the path, and the leg to the vertex turns it out of its range.
    Wound {
        /// The angle, rad.
        angle_rad: f64,
        /// Lowest, rad.
        low_rad: f64,
        /// Highest, rad.
        high_rad: f64,
    },
}

/// What the trajectory can be told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotionCommand {
    /// Begin to execute the path that has been pushed.
    Start,
    /// Decelerate on the path, lift the pen, keep the state.
    Hold,
    /// Go on with a held path.
    Resume,
    /// Decelerate on the path, lift the pen, drop the rest.
    Cancel,
    /// Scale the path speed, percent from 10 to 200.
    Override(u8),
    /// Move in a straight line to a position.
    MoveTo(Position),
    /// Move with this velocity, mm/s, while the command is repeated.
    Jog([f64; 3]),
    /// End a jog.
    JogStop,
    /// Lift or lower the pen where it stands.
    Pen(Pen),
}

/// What the trajectory stage is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum MotionState {
    /// At rest, no path under way.
    #[default]
    Idle,
    /// On the path.
    Running,
    /// Waiting for path data, at rest on the path, with the pen lifted after a dwell.
    Starved,
    /// On the way to a hold.
    Holding,
    /// Held: at rest, the pen lifted.
    Held,
    /// On the way back to the path.
    Resuming,
    /// On the way to a rest that ends the path or a motion.
    Stopping,
    /// In a single move.
    Moving,
    /// Jogging.
    Jogging,
}

/// Why a command or a vertex was not taken; nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotionRefusal {
    /// The command does not fit what the stage is doing.
    State(MotionState),
    /// A path is waiting; it has to be started or cancelled first.
    PathPending,
    /// There is no pose to begin from.
    NotPlaced,
    /// The queue of vertices is full.
    Full,
    /// An override outside 10 to 200 percent.
    Override {
        /// What was asked for.
        percent: u8,
    },
    /// The target cannot be reached.
    Target(Refusal),
}
