//! The robot's mechanism: position of the tool, end stops of the joints, and their loads.
//!
//! [`Mechanism`] is the seam between a kind of robot and the rest of the cell. [`Linked`] describes a kind by its bodies and the
//! controller's forward kinematics; a kind that this cannot describe is a file of its own here.

mod delta;
mod linked;

use super::calibration::TrueDelta;
use delta::Delta;
use etherpen::config::Geometry;
use etherpen::robots::{JointAngles, MAIN_AXES, Position};
use linked::Linked;

/// A value of each main axis.
pub(super) type MainAxes = [f64; MAIN_AXES];

/// Equation of motion at one pose: inertia * acceleration = torque + weight - carried, without friction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Equation {
    /// Inertia matrix, kg m2.
    pub(super) inertia: [MainAxes; MAIN_AXES],
    /// Torque of gravity, Nm.
    pub(super) weight_nm: MainAxes,
    /// Torque that the present speeds need to stay constant, Nm.
    pub(super) carried_nm: MainAxes,
}

/// A mechanism; without valid dimensions it holds no tool.
#[derive(Clone, Debug)]
pub(super) enum Mechanism {
    /// A delta robot.
    Delta(Delta),
    /// A machine of linear axes and links.
    Linked(Linked),
}

impl Mechanism {
    /// The mechanism of these dimensions.
    pub(super) fn new(geometry: &Geometry) -> Self {
        match geometry {
            Geometry::Delta(dimensions) => Self::Delta(Delta::new(dimensions)),
            other => Self::Linked(Linked::new(other)),
        }
    }

    /// This mechanism with a load at its tool, kg, and with other dimensions than the configured ones.
    pub(super) fn with(self, payload_kg: f64, differing: Option<TrueDelta>) -> Self {
        match self {
            Self::Delta(delta) => Self::Delta(delta.with(payload_kg, differing)),
            Self::Linked(linked) => Self::Linked(linked.with(payload_kg)),
        }
    }

    /// Position of the tool; `None` if the links do not meet.
    pub(super) fn tool(&self, joints: &JointAngles) -> Option<Position> {
        match self {
            Self::Delta(delta) => delta.platform(joints),
            Self::Linked(linked) => linked.tool(joints),
        }
    }

    /// Lowest and highest angle that the mechanical end stops of each main axis allow, rad.
    pub(super) fn end_stops_rad(&self) -> [[f64; 2]; MAIN_AXES] {
        match self {
            Self::Delta(delta) => delta.end_stops_rad(),
            Self::Linked(linked) => linked.end_stops_rad(),
        }
    }

    /// The equation of motion; `rotor` is the inertia of each motor at its joint, kg m2.
    pub(super) fn equation(&self, angles: MainAxes, speeds: MainAxes, rotor: MainAxes) -> Equation {
        match self {
            Self::Delta(delta) => delta.equation(angles, speeds, rotor),
            Self::Linked(linked) => linked.equation(angles, speeds, rotor),
        }
    }
}

/// Combines two arrays, entry by entry.
pub(super) fn combine<const N: usize>(a: [f64; N], b: [f64; N], with: impl Fn(f64, f64) -> f64) -> [f64; N] {
    let mut result = a;
    result
        .iter_mut()
        .zip(b)
        .for_each(|(left, right)| *left = with(*left, right));
    result
}
