//! From a list of coordinates to 1 ms references.

use crate::robot::{AXES, Position};
use serde::{Deserialize, Serialize};

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
    /// Lift or lower the pen where it stands.
    Pen(Pen),
}
