//! Robots: where the tool is for given joint angles.
//!
//! Every kind of robot is a file here. The arithmetic is the monitor's own: the firmware's kinematics are among the
//! things that it judges.
//!
//! Lengths are millimetres, angles radians; the joint of a linear axis is its pulley or screw. z points up.

mod corexy;
mod delta;
mod gantry;
mod linear_delta;
mod scara;
mod spheres;

pub use corexy::CoreXy;
pub use delta::{Delta, DeltaDimensions};
pub use gantry::Gantry;
pub use linear_delta::{LinearDelta, LinearDeltaDimensions};
pub use scara::Scara;

use crate::vector::{Vector, is_finite};

/// Number of axes that place the tool; they are the first of a robot's axes.
pub const MAIN_AXES: usize = 3;

/// A robot of known dimensions.
#[derive(Clone, Debug, PartialEq)]
pub enum Robot {
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

impl Robot {
    /// Position of the tool, mm, for the angles of the main axes, rad. `None` where no tool connects the joints, or
    /// where an angle is not a finite number.
    #[must_use]
    #[inline]
    pub fn tool(&self, main_axes_rad: [f64; MAIN_AXES]) -> Option<Vector> {
        match self {
            Self::Delta(delta) => delta.tool(main_axes_rad),
            Self::Gantry(gantry) => Some(gantry.tool(main_axes_rad)).filter(is_finite),
            Self::CoreXy(corexy) => Some(corexy.tool(main_axes_rad)).filter(is_finite),
            Self::Scara(scara) => Some(scara.tool(main_axes_rad)).filter(is_finite),
            Self::LinearDelta(delta) => delta.tool(main_axes_rad),
        }
    }

    /// Largest change of a main axis's angle for a millimetre of the tool inside a work area, rad/mm.
    #[must_use]
    pub fn slope_max_rad_mm(&self) -> f64 {
        match self {
            Self::Delta(delta) => delta.slope_max_rad_mm(),
            Self::Gantry(gantry) => gantry.slope_max_rad_mm(),
            Self::CoreXy(corexy) => corexy.slope_max_rad_mm(),
            Self::Scara(scara) => scara.slope_max_rad_mm(),
            Self::LinearDelta(delta) => delta.slope_max_rad_mm(),
        }
    }
}

impl Default for Robot {
    /// The robot of the default configuration.
    fn default() -> Self {
        Self::Delta(Delta::new(&DeltaDimensions::default()))
    }
}
