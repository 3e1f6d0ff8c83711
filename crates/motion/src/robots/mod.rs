//! Robots: kinematics and joints.
//!
//! [`Kinematics`] is the seam between a kind of robot and everything that moves one. Every kind is a file or folder of
//! its own here; planner, controller and host programs use only [`Kinematics`] and depend on no kind.
//!
//! Lengths are millimetres, angles radians. Each kind defines its frame's origin; z points up.
//!
//! [`Geometry`] has the dimensions of each kind, as the configuration and the messages carry them. The joint of a linear
//! axis is its pulley or screw, so that every joint has an angle.

mod corexy;
mod delta;
mod errors;
mod flat;
mod gantry;
pub(crate) mod geometry;
pub(crate) mod joint_ranges;
mod kind;
mod linear;
mod linear_delta;
mod scara;
mod spheres;
#[cfg(test)]
mod tests;
pub mod vector;

pub use corexy::CoreXyGeometry;
pub use delta::{DeltaGeometry, Measured, MeasuredError};
pub use errors::{DeltaError, GeometryError, LinearDeltaError, ScaraError};
pub use gantry::GantryGeometry;
pub use geometry::Geometry;
pub use kind::Kind;
pub use linear_delta::LinearDeltaGeometry;
pub use scara::ScaraGeometry;

use corexy::CoreXy;
use delta::Delta;
use gantry::Gantry;
use joint_ranges::JointRanges;
use linear_delta::LinearDelta;
use scara::Scara;
use serde::{Deserialize, Serialize};
use vector::{Vector, root};

/// Number of axes: the main axes and the rotating fourth axis.
pub const AXES: usize = 4;
/// Number of main axes: the axes that place the tool. They are the first of the axes.
pub const MAIN_AXES: usize = 3;

/// Travel of a linear axis for a radian of its joint, mm: the joint of a linear axis is a wheel of this radius that rolls
/// along it. With it the angles, speeds and loads of linear and rotary joints have the same order of magnitude.
pub const LINEAR_MM_PER_RAD: f64 = 100.0;

/// Smallest [`Conditioning::ratio`] at which inverse kinematics has a solution: below it the derivatives are undefined.
pub const RATIO_SINGULAR: f64 = 1.0e-6;

/// Position of the tool in the robot's frame, millimetres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Position {
    /// Towards azimuth 0 of robots with a base, along the first axis of others, mm.
    pub x_mm: f64,
    /// Completes the right-handed frame, mm.
    pub y_mm: f64,
    /// Upwards, mm; negative below the frame's origin.
    pub z_mm: f64,
}

/// Angles of the four joints, radians: the main axes, then the fourth axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointAngles(pub [f64; AXES]);

/// Velocities of the four joints, radians per second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointVelocities(pub [f64; AXES]);

/// Why a position or pose has no solution.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum KinematicsError {
    /// An input is not a finite number.
    NotFinite,
    /// A joint does not reach the position.
    Unreachable {
        /// Joint, from 0.
        joint: u8,
        /// Square of [`Conditioning::ratio`] with its sign: negative, and more negative the farther the position.
        ratio_squared: f64,
    },
    /// A joint is singular, as [`Words::singular`] says: the angle's derivative is undefined.
    Singular {
        /// Joint, from 0.
        joint: u8,
        /// The joint's [`Conditioning::ratio`], below [`RATIO_SINGULAR`].
        ratio: f64,
    },
    /// The joint's angle is outside its range.
    Range {
        /// Joint, from 0.
        joint: u8,
        /// The angle, rad.
        angle_rad: f64,
        /// Lowest angle, rad.
        low_rad: f64,
        /// Highest angle, rad.
        high_rad: f64,
    },
    /// Forward kinematics: with these angles the links do not meet at the tool.
    Apart,
}

/// Largest difference of a joint from the angle that the planner would choose there, rad.
const SAME_POSE_RAD: f64 = 1.0e-4;

/// A joint that stands on the other side than the planner would choose for the tool's position: no motion leads from one
/// side to the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OtherSide {
    /// Joint, from 0: the one whose angle differs most.
    pub joint: u8,
    /// Its angle, rad.
    pub angle_rad: f64,
    /// The angle that the planner would choose, rad.
    pub planned_rad: f64,
}

/// Derivatives of the main axes' angles along a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointRows {
    /// dq/ds, rad/mm.
    pub slope: [f64; MAIN_AXES],
    /// d2q/ds2, rad/mm2.
    pub bend: [f64; MAIN_AXES],
}

impl JointRows {
    /// Rows of joints at rest.
    pub(crate) const NONE: Self = Self {
        slope: [0.0; MAIN_AXES],
        bend: [0.0; MAIN_AXES],
    };
}

/// Distance of a position from the singularities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditioning {
    /// Smallest ratio of the joints and which joint, from 0, has it. A ratio is 0 where the joint is singular, grows away
    /// from there and is at most 1; it is negative where the joint does not reach the position. Ranges do not count.
    pub ratio: (u8, f64),
    /// Absolute determinant of the directions in which the joints hold the tool: 1 where they hold it best, 0 where one
    /// direction is not held at all.
    pub determinant: f64,
    /// Largest changes of angles, ratio and determinant by a displacement of one millimetre here.
    pub change: Change,
}

impl Conditioning {
    /// Of a robot without singularities, whose angles are in proportion to displacements.
    const REGULAR: Self = Self {
        ratio: (0, 1.0),
        determinant: 1.0,
        change: Change {
            angles: [0.0; MAIN_AXES],
            ratio: 0.0,
            determinant: 0.0,
        },
    };
}

/// Upper bounds of the changes caused by a displacement of one millimetre, for displacements small against the links.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Change {
    /// Of each main axis's angle, rad/mm. 0 for an angle in proportion to the displacement: between two positions it is
    /// between the angles of both, so that its limits hold wherever they hold at both.
    pub angles: [f64; MAIN_AXES],
    /// Of any joint's ratio, 1/mm.
    pub ratio: f64,
    /// Of the determinant, 1/mm.
    pub determinant: f64,
}

/// Smallest values of [`Conditioning`] inside a work area.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConditioningMin {
    /// Ratio of every joint.
    pub ratio: f64,
    /// Determinant.
    pub determinant: f64,
}

/// Words for messages about a kind of robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Words {
    /// A main axis with its first link.
    pub joint: &'static str,
    /// What is so of a joint at its singularity, as a phrase without a verb: `inner and outer link in line`.
    pub singular: &'static str,
    /// The links that meet at the tool.
    pub last_links: &'static str,
}

impl Default for Words {
    /// The words of the default geometry's kind.
    fn default() -> Self {
        delta::WORDS
    }
}

/// Kinematics of a robot of known dimensions.
///
/// Invariant: a result is finite or an error; no input panics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kinematics {
    /// A delta robot.
    Delta(Delta),
    /// A gantry.
    Gantry(Gantry),
    /// A machine with two crossed belts.
    CoreXy(CoreXy),
    /// A SCARA.
    Scara(Scara),
    /// A linear delta.
    LinearDelta(LinearDelta),
}

impl Kinematics {
    /// Placeholder for a robot that is not configured yet.
    pub(crate) const NONE: Self = Self::Delta(Delta::NONE);

    /// Makes a robot from its dimensions.
    ///
    /// # Errors
    /// Why the dimensions do not form a valid robot, see [`GeometryError`].
    pub fn new(geometry: &Geometry) -> Result<Self, GeometryError> {
        match geometry {
            Geometry::Delta(geometry) => Delta::new(geometry).map(Self::Delta),
            Geometry::Gantry(geometry) => Gantry::new(geometry).map(Self::Gantry),
            Geometry::CoreXy(geometry) => CoreXy::new(geometry).map(Self::CoreXy),
            Geometry::Scara(geometry) => Scara::new(geometry).map(Self::Scara),
            Geometry::LinearDelta(geometry) => LinearDelta::new(geometry).map(Self::LinearDelta),
        }
    }

    /// Kind of this robot.
    #[must_use]
    pub fn kind(&self) -> Kind {
        match self {
            Self::Delta(_) => Kind::Delta,
            Self::Gantry(_) => Kind::Gantry,
            Self::CoreXy(_) => Kind::CoreXy,
            Self::Scara(_) => Kind::Scara,
            Self::LinearDelta(_) => Kind::LinearDelta,
        }
    }

    /// Nouns for messages about this robot.
    #[must_use]
    pub fn words(&self) -> Words {
        match self {
            Self::Delta(_) => delta::WORDS,
            Self::Gantry(_) => gantry::WORDS,
            Self::CoreXy(_) => corexy::WORDS,
            Self::Scara(_) => scara::WORDS,
            Self::LinearDelta(_) => linear_delta::WORDS,
        }
    }

    /// Angles of the main axes for a position, rad.
    ///
    /// # Errors
    /// The first joint that cannot reach the position, with the reason.
    #[inline]
    pub fn inverse(&self, position: &Position) -> Result<[f64; MAIN_AXES], KinematicsError> {
        match self {
            Self::Delta(delta) => delta.inverse(position),
            Self::Gantry(gantry) => gantry.inverse(position),
            Self::CoreXy(corexy) => corexy.inverse(position),
            Self::Scara(scara) => scara.inverse(position),
            Self::LinearDelta(delta) => delta.inverse(position),
        }
    }

    /// Angles of the main axes without checks, rad, for admitted points; the nearest real pose if there is no solution.
    #[inline]
    #[must_use]
    pub fn angles(&self, point: &Vector) -> [f64; MAIN_AXES] {
        match self {
            Self::Delta(delta) => delta.angles(point),
            Self::Gantry(gantry) => gantry.angles(point),
            Self::CoreXy(corexy) => corexy.angles(point),
            Self::Scara(scara) => scara.angles(point),
            Self::LinearDelta(delta) => delta.angles(point),
        }
    }

    /// The joint that stands on the other side than the planner would choose for the tool's position `at`, if there is one.
    #[must_use]
    pub fn other_side(&self, pose: &JointAngles, at: &Position) -> Option<OtherSide> {
        let planned = self.angles(&Vector::from(*at));
        let joints = (0u8..).zip(pose.0.into_iter().zip(planned));
        let apart_rad = |side: &OtherSide| (side.angle_rad - side.planned_rad).abs();
        joints.fold(
            None,
            |farthest: Option<OtherSide>, (joint, (angle_rad, planned_rad))| {
                let side = OtherSide {
                    joint,
                    angle_rad,
                    planned_rad,
                };
                let is_same = apart_rad(&side) < SAME_POSE_RAD;
                let is_nearer = farthest.is_some_and(|farthest| apart_rad(&side) <= apart_rad(&farthest));
                if is_same || is_nearer { farthest } else { Some(side) }
            },
        )
    }

    /// Derivatives of the main axes' angles along a path through `point` with the unit tangent `tangent` and the
    /// curvature vector `bend` (1/mm). Finite wherever [`Kinematics::inverse`] has a solution.
    #[inline]
    #[must_use]
    pub fn rows(&self, point: &Vector, tangent: &Vector, bend: &Vector) -> JointRows {
        match self {
            Self::Delta(delta) => delta.rows(point, tangent, bend),
            Self::Gantry(gantry) => gantry.rows(tangent, bend),
            Self::CoreXy(corexy) => corexy.rows(tangent, bend),
            Self::Scara(scara) => scara.rows(point, tangent, bend),
            Self::LinearDelta(delta) => delta.rows(point, tangent, bend),
        }
    }

    /// Distance from the singularities at a position.
    #[inline]
    #[must_use]
    pub fn conditioning(&self, position: &Position) -> Conditioning {
        match self {
            Self::Delta(delta) => delta.conditioning(position),
            Self::Gantry(_) | Self::CoreXy(_) => Conditioning::REGULAR,
            Self::Scara(scara) => scara.conditioning(position),
            Self::LinearDelta(delta) => delta.conditioning(position),
        }
    }

    /// Smallest distance from the singularities inside the work area.
    #[inline]
    pub(crate) fn conditioning_min(&self) -> ConditioningMin {
        match self {
            Self::Delta(_) => delta::CONDITIONING_MIN,
            Self::Gantry(_) => gantry::CONDITIONING_MIN,
            Self::CoreXy(_) => corexy::CONDITIONING_MIN,
            Self::Scara(_) => scara::CONDITIONING_MIN,
            Self::LinearDelta(_) => linear_delta::CONDITIONING_MIN,
        }
    }

    /// Whether every main axis's angle is in its range and the singularities are farther away than
    /// [`Kinematics::conditioning_min`]. Costs a fraction of [`Kinematics::inverse`] and [`Kinematics::conditioning`],
    /// which also give the reason.
    #[inline]
    pub(crate) fn clears(&self, point: &Vector, ranges: &JointRanges) -> bool {
        match self {
            Self::Delta(delta) => delta.clears(point, ranges),
            Self::Gantry(gantry) => gantry.clears(point, ranges),
            Self::CoreXy(corexy) => corexy.clears(point, ranges),
            Self::Scara(scara) => scara.clears(point, ranges),
            Self::LinearDelta(delta) => delta.clears(point, ranges),
        }
    }

    /// Position of the tool for joint angles. Any angles are accepted; the fourth axis does not affect the position.
    ///
    /// # Errors
    /// [`KinematicsError::NotFinite`], or [`KinematicsError::Apart`] where the links do not meet at the tool.
    #[inline]
    pub fn forward(&self, joints: &JointAngles) -> Result<Position, KinematicsError> {
        match self {
            Self::Delta(delta) => delta.forward(joints),
            Self::Gantry(gantry) => gantry.forward(joints),
            Self::CoreXy(corexy) => corexy.forward(joints),
            Self::Scara(scara) => scara.forward(joints),
            Self::LinearDelta(delta) => delta.forward(joints),
        }
    }
}

/// Angles that are all in their ranges, rad.
///
/// # Errors
/// [`KinematicsError::Range`] for the first joint outside its range.
fn in_range(
    angles_rad: [f64; MAIN_AXES],
    ranges_rad: &[[f64; 2]; MAIN_AXES],
) -> Result<[f64; MAIN_AXES], KinematicsError> {
    for (joint, (angle_rad, [low_rad, high_rad])) in (0u8..).zip(angles_rad.into_iter().zip(*ranges_rad)) {
        if !(angle_rad >= low_rad && angle_rad <= high_rad) {
            return Err(KinematicsError::Range {
                joint,
                angle_rad,
                low_rad,
                high_rad,
            });
        }
    }
    Ok(angles_rad)
}

/// Checks that a joint reaches a position and its links are not in line.
///
/// # Errors
/// [`KinematicsError::Unreachable`] or [`KinematicsError::Singular`].
fn reached(joint: u8, ratio_squared: f64) -> Result<(), KinematicsError> {
    if ratio_squared.is_nan() || ratio_squared < 0.0 {
        return Err(KinematicsError::Unreachable { joint, ratio_squared });
    }
    if ratio_squared < RATIO_SINGULAR * RATIO_SINGULAR {
        let ratio = root(ratio_squared);
        return Err(KinematicsError::Singular { joint, ratio });
    }
    Ok(())
}

/// Root of a square that carries the sign of the number.
fn signed_root(square: f64) -> f64 {
    if square < 0.0 { -root(-square) } else { root(square) }
}

/// A position that joint angles give, if angles and position are finite.
///
/// # Errors
/// [`KinematicsError::NotFinite`].
fn finite(joints: &JointAngles, point: Vector) -> Result<Position, KinematicsError> {
    if joints.0.iter().chain(&point).all(|value| value.is_finite()) {
        Ok(point.into())
    } else {
        Err(KinematicsError::NotFinite)
    }
}
