//! Robots: how the joints move when the tool moves along a curve.
//!
//! Every kind of robot is a file here. The arithmetic is this crate's own and works on series, which include all
//! derivatives.
//!
//! Lengths are millimetres, angles radians. The frame's origin is the centre of the base, and z points up.

mod delta;

pub use delta::{Delta, Dimensions};

use crate::interval::Interval;
use crate::series::{Series, Series3};

/// Number of axes that place the tool; they are the first of a robot's axes.
pub const MAIN_AXES: usize = 3;

/// A robot of known dimensions.
#[derive(Clone, Debug)]
pub enum Robot {
    /// A delta robot.
    Delta(Delta),
}

/// A main axis while the tool moves along a curve.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Joint {
    /// Cosine and sine of the angle.
    pub(crate) direction: [Interval; 2],
    /// Derivative of the angle with respect to the curve's parameter, rad.
    pub(crate) slope: Series,
    /// The link that holds the tool, mm, and its product with the derivative of its other end by the angle, mm2. The
    /// angle changes by `link . dp / lever` when the tool moves by dp.
    pub(crate) link: [Interval; 3],
    pub(crate) lever: Interval,
    /// Derivative of the link's other end by the angle, mm, and the link's product with its second derivative, mm2.
    pub(crate) tow: [Interval; 3],
    pub(crate) sway: Interval,
}

impl Robot {
    /// A robot of these dimensions.
    #[must_use]
    pub fn new(dimensions: &Dimensions) -> Self {
        Self::Delta(Delta::new(dimensions))
    }

    /// The main axes while the tool is at `point` and moves with the derivative `first`.
    pub(crate) fn joints(&self, point: &Series3, first: &Series3) -> [Joint; MAIN_AXES] {
        match self {
            Self::Delta(delta) => delta.joints(point, first),
        }
    }

    /// Length of the first and of the last link of a main axis, mm.
    pub(crate) fn links_mm(&self) -> [f64; 2] {
        match self {
            Self::Delta(delta) => delta.links_mm(),
        }
    }
}
