//! The robot: geometry, kinematics, limits and work area.
//!
//! Lengths are millimetres, angles radians. The base (shoulder) plane is z = 0, z points up, the platform works at
//! z < 0, and a positive arm angle turns the upper arm below the horizontal.

mod kinematics;
pub mod vector;
mod work_area;

pub use kinematics::{Change, Conditioning, Delta, GeometryError, JointRows, KinematicsError, RATIO_SINGULAR};
pub use work_area::{DETERMINANT_MIN, Outside, RATIO_MIN, WorkArea};

use serde::{Deserialize, Serialize};

/// Number of axes: three arms and the rotating fourth axis.
pub const AXES: usize = 4;
/// Number of parallel arms.
pub const ARMS: usize = 3;

/// Position of the platform's centre in the robot's frame, millimetres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Position {
    /// Towards arm 1's azimuth, mm.
    pub x_mm: f64,
    /// Completes the right-handed frame, mm.
    pub y_mm: f64,
    /// Upwards from the shoulder plane, mm; negative where the robot works.
    pub z_mm: f64,
}

/// Angles of the four joints, radians: three arms, then the fourth axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointAngles(pub [f64; AXES]);

/// Velocities of the four joints, radians per second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointVelocities(pub [f64; AXES]);
