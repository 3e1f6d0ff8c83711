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
