//! Why dimensions do not form a valid robot, for each kind.

use core::fmt;
use serde::{Deserialize, Serialize};

/// Why dimensions do not form a valid robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum GeometryError {
    /// A value is not a finite number.
    NotFinite,
    /// The range of a turning joint is empty.
    Range {
        /// Lower end, rad.
        low_rad: f64,
        /// Upper end, rad.
        high_rad: f64,
    },
    /// The range of a linear axis is empty.
    Stroke {
        /// Lower end, mm.
        low_mm: f64,
        /// Upper end, mm.
        high_mm: f64,
    },
    /// The dimensions do not form a delta robot.
    Delta(DeltaError),
    /// The dimensions do not form a SCARA.
    Scara(ScaraError),
    /// The dimensions do not form a linear delta.
    LinearDelta(LinearDeltaError),
}

impl fmt::Display for GeometryError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => f.write_str("a value is no finite number"),
            Self::Range { low_rad, high_rad } => {
                write!(f, "the range of a joint from {low_rad} to {high_rad} rad is empty")
            }
            Self::Stroke { low_mm, high_mm } => {
                write!(f, "the range of an axis from {low_mm} to {high_mm} mm is empty")
            }
            Self::Delta(error) => error.fmt(f),
            Self::Scara(error) => error.fmt(f),
            Self::LinearDelta(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for GeometryError {}

/// Why lengths and azimuths do not form a valid delta robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum DeltaError {
    /// An arm's length is not positive, or the forearm is not longer than the upper arm.
    Lengths {
        /// Upper arm, mm.
        upper_arm_mm: f64,
        /// Forearm, mm.
        forearm_mm: f64,
    },
    /// The azimuths of two arms are equal or opposite.
    Azimuths {
        /// The first of the two, degrees.
        first_deg: f64,
        /// The second, degrees.
        second_deg: f64,
    },
}

impl From<DeltaError> for GeometryError {
    fn from(error: DeltaError) -> Self {
        Self::Delta(error)
    }
}

impl fmt::Display for DeltaError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lengths {
                upper_arm_mm,
                forearm_mm,
            } => write!(
                f,
                "upper arms of {upper_arm_mm} mm and forearms of {forearm_mm} mm; both have to be longer than 0, and \
                 the forearm the longer one"
            ),
            Self::Azimuths { first_deg, second_deg } => {
                write!(f, "arms at {first_deg} and {second_deg} degrees move in the same plane")
            }
        }
    }
}

/// Why dimensions do not form a valid SCARA.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ScaraError {
    /// A link's length is not positive.
    Lengths {
        /// From shoulder to elbow, mm.
        inner_link_mm: f64,
        /// From elbow to tool, mm.
        outer_link_mm: f64,
    },
    /// The elbow's side is neither 1 nor -1.
    Elbow {
        /// The configured side.
        elbow: i8,
    },
}

impl From<ScaraError> for GeometryError {
    fn from(error: ScaraError) -> Self {
        Self::Scara(error)
    }
}

impl fmt::Display for ScaraError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lengths {
                inner_link_mm,
                outer_link_mm,
            } => write!(
                f,
                "links of {inner_link_mm} mm and {outer_link_mm} mm; both have to be longer than 0"
            ),
            Self::Elbow { elbow } => write!(f, "the elbow's side is {elbow}; it has to be 1 or -1"),
        }
    }
}

/// Why dimensions do not form a valid linear delta.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum LinearDeltaError {
    /// The radius is not positive, or the rods are not longer than the radius.
    Rods {
        /// Length of a rod, mm.
        rod_mm: f64,
        /// Distance that the rods bridge with the platform in the middle, mm.
        radius_mm: f64,
    },
    /// The azimuths of two towers are equal or opposite.
    Towers {
        /// The first of the two, degrees.
        first_deg: f64,
        /// The second, degrees.
        second_deg: f64,
    },
}

impl From<LinearDeltaError> for GeometryError {
    fn from(error: LinearDeltaError) -> Self {
        Self::LinearDelta(error)
    }
}

impl fmt::Display for LinearDeltaError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rods { rod_mm, radius_mm } => write!(
                f,
                "rods of {rod_mm} mm at a radius of {radius_mm} mm; the radius has to be larger than 0, and the rods \
                 longer than the radius"
            ),
            Self::Towers { first_deg, second_deg } => {
                write!(
                    f,
                    "towers at {first_deg} and {second_deg} degrees are in line with the axis"
                )
            }
        }
    }
}
