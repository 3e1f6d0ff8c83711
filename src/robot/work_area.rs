//! The space a robot may use, and the reasons why a position is outside it.
//!
//! A position is inside when it lies in the cylinder, every arm keeps its margin from the ends of its range, and the
//! robot is far enough from both kinds of singularity. The checks need one inverse kinematics each.

use super::kinematics::{Delta, GeometryError, KinematicsError};
use super::{ARMS, Position};
use crate::config::{Config, WorkArea as Cylinder};
use serde::{Deserialize, Serialize};

/// Smallest D/A: sine of the angle between an arm's plane projection of the forearm and the upper arm, in effect.
pub const RATIO_MIN: f64 = 0.35;
/// Smallest absolute determinant of the forearms' unit vectors.
pub const DETERMINANT_MIN: f64 = 0.2;

const _: () = assert!(RATIO_MIN > super::kinematics::RATIO_SINGULAR);

/// Why a position is outside the work area.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Outside {
    /// Too far from the robot's axis.
    Radius {
        /// Distance from the axis, mm.
        radius_mm: f64,
        /// The limit, mm.
        limit_mm: f64,
    },
    /// Too low or too high.
    Height {
        /// The height, mm.
        z_mm: f64,
        /// Lowest, mm.
        low_mm: f64,
        /// Highest, mm.
        high_mm: f64,
    },
    /// No pose, or one outside the arm range.
    Kinematics(KinematicsError),
    /// An arm is nearer to the end of its range than the margin.
    Margin {
        /// Arm, from 0.
        arm: u8,
        /// Its angle, rad.
        angle_rad: f64,
        /// Lowest angle with margin, rad.
        low_rad: f64,
        /// Highest angle with margin, rad.
        high_rad: f64,
    },
    /// An arm is too near to being in line with its forearm.
    Stretched {
        /// Arm, from 0.
        arm: u8,
        /// D/A.
        ratio: f64,
        /// The limit.
        limit: f64,
    },
    /// The forearms are too near to lying in a plane.
    Flat {
        /// Absolute determinant of their unit vectors.
        determinant: f64,
        /// The limit.
        limit: f64,
    },
}

/// The space the platform may use, with the robot it belongs to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorkArea {
    delta: Delta,
    cylinder: Cylinder,
    range_rad: [f64; 2],
}

impl WorkArea {
    /// No space at all: fills the place of a work area that is not configured yet.
    pub(crate) const NONE: Self = Self {
        delta: Delta::NONE,
        cylinder: Cylinder {
            radius_mm: 0.0,
            z_low_mm: 0.0,
            z_high_mm: 0.0,
        },
        range_rad: [0.0; 2],
    };

    /// The work area of a configuration.
    ///
    /// # Errors
    /// A geometry that is no delta robot, or a range that its margins use up.
    pub fn new(config: &Config) -> Result<Self, GeometryError> {
        let [low, high] = config.geometry.arm_range_rad;
        let margin = config.geometry.arm_margin_rad;
        let (low_rad, high_rad) = (low + margin, high - margin);
        let delta = Delta::new(&config.geometry)?;
        if (low_rad..high_rad).is_empty() {
            return Err(GeometryError::Range { low_rad, high_rad });
        }
        Ok(Self {
            delta,
            cylinder: config.work_area,
            range_rad: [low_rad, high_rad],
        })
    }

    /// The robot.
    pub fn delta(&self) -> &Delta {
        &self.delta
    }

    /// Checks a position and gives its arm angles, rad.
    ///
    /// # Errors
    /// The first reason why the position is outside.
    pub fn check(&self, position: &Position) -> Result<[f64; ARMS], Outside> {
        let Cylinder {
            radius_mm: limit_mm,
            z_low_mm: low_mm,
            z_high_mm: high_mm,
        } = self.cylinder;
        let Position { x_mm, y_mm, z_mm } = *position;
        if !(x_mm.is_finite() && y_mm.is_finite() && z_mm.is_finite()) {
            return Err(Outside::Kinematics(KinematicsError::NotFinite));
        }
        let radius_mm = super::vector::root(x_mm * x_mm + y_mm * y_mm);
        if radius_mm > limit_mm {
            return Err(Outside::Radius { radius_mm, limit_mm });
        }
        if !(z_mm >= low_mm && z_mm <= high_mm) {
            return Err(Outside::Height { z_mm, low_mm, high_mm });
        }
        let angles = self.delta.inverse(position).map_err(Outside::Kinematics)?;
        let [low_rad, high_rad] = self.range_rad;
        for (arm, angle_rad) in (0u8..).zip(angles) {
            if !(angle_rad >= low_rad && angle_rad <= high_rad) {
                return Err(Outside::Margin {
                    arm,
                    angle_rad,
                    low_rad,
                    high_rad,
                });
            }
        }
        let conditioning = self.delta.conditioning(position);
        let (arm, ratio) = conditioning.ratio;
        if ratio < RATIO_MIN {
            return Err(Outside::Stretched {
                arm,
                ratio,
                limit: RATIO_MIN,
            });
        }
        if conditioning.determinant < DETERMINANT_MIN {
            return Err(Outside::Flat {
                determinant: conditioning.determinant,
                limit: DETERMINANT_MIN,
            });
        }
        Ok(angles)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(x_mm: f64, y_mm: f64, z_mm: f64) -> Result<[f64; ARMS], Outside> {
        WorkArea::new(&Config::default())
            .unwrap()
            .check(&Position { x_mm, y_mm, z_mm })
    }

    #[test]
    fn the_sheet_is_inside_and_the_borders_are_named() {
        for x in [-100.0, 100.0] {
            for y in [-100.0, 100.0] {
                assert!(check(x, y, -850.0).is_ok());
                assert!(check(x, y, -750.0).is_ok());
            }
        }
        assert!(matches!(check(566.0, 0.0, -850.0), Err(Outside::Radius { .. })));
        assert!(matches!(check(0.0, 0.0, -699.0), Err(Outside::Height { .. })));
        assert!(matches!(check(0.0, 0.0, -961.0), Err(Outside::Height { .. })));
        assert!(matches!(
            check(f64::NAN, 0.0, -850.0),
            Err(Outside::Kinematics(KinematicsError::NotFinite))
        ));
    }

    #[test]
    fn a_margin_that_uses_up_the_range_is_refused() {
        let mut config = Config::default();
        config.geometry.arm_range_rad = [0.0, 0.1];
        config.geometry.arm_margin_rad = 0.1;
        assert!(matches!(WorkArea::new(&config), Err(GeometryError::Range { .. })));
    }
}
