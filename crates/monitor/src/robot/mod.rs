//! Robots: where the tool is for given joint angles.
//!
//! Every kind of robot is a file here. The arithmetic is the monitor's own: the firmware's kinematics are among the
//! things that it judges.
//!
//! Lengths are millimetres, angles radians. The frame's origin is the centre of the base, and z points up.

mod delta;

pub use delta::{Delta, Dimensions};

use crate::vector::Vector;

/// Number of axes that place the tool; they are the first of a robot's axes.
pub const MAIN_AXES: usize = 3;

/// A robot of known dimensions.
#[derive(Clone, Debug, PartialEq)]
pub enum Robot {
    /// A delta robot.
    Delta(Delta),
}

impl Robot {
    /// A robot of these dimensions.
    #[must_use]
    pub fn new(dimensions: &Dimensions) -> Self {
        Self::Delta(Delta::new(dimensions))
    }

    /// Position of the tool, mm, for the angles of the main axes, rad. `None` where no tool connects the joints, or
    /// where an angle is not a finite number.
    #[must_use]
    #[inline]
    pub fn tool(&self, main_axes_rad: [f64; MAIN_AXES]) -> Option<Vector> {
        match self {
            Self::Delta(delta) => delta.tool(main_axes_rad),
        }
    }

    /// Largest change of a main axis's angle for a millimetre of the tool inside a work area, rad/mm.
    #[must_use]
    pub fn slope_max_rad_mm(&self) -> f64 {
        match self {
            Self::Delta(delta) => delta.slope_max_rad_mm(),
        }
    }
}

impl Default for Robot {
    /// The robot of the default configuration.
    fn default() -> Self {
        Self::new(&Dimensions::default())
    }
}
