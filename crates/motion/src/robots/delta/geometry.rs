//! Dimensions of a delta robot, their bounds, and why they may not form a robot.

use crate::bounds::{Bound, bound};
use crate::robots::MAIN_AXES;
use core::f64::consts::PI;
use core::fmt;
use serde::{Deserialize, Serialize};

/// cos 30 degrees.
const HALF_ROOT_OF_THREE: f64 = 0.866_025_403_784_438_6;

/// Geometry of a delta robot with three equal arms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DeltaGeometry {
    /// Centre of the base to the shoulder axes, mm.
    pub base_radius_mm: f64,
    /// Length of an upper arm, mm.
    pub upper_arm_mm: f64,
    /// Length of a forearm, mm.
    pub forearm_mm: f64,
    /// Centre of the platform to the forearms' joints, mm.
    pub platform_radius_mm: f64,
    /// Azimuths of the arms, degrees.
    pub arm_azimuths_deg: [f64; 3],
    /// Lowest and highest angle of an arm, radians.
    pub arm_range_rad: [f64; 2],
    /// Margin kept from both ends of the arm range, radians.
    pub arm_margin_rad: f64,
    /// Lowest and highest angle of the fourth axis, radians. The axis has no end stop; its cables and its turn counter
    /// limit it.
    pub turn_range_rad: [f64; 2],
}

impl Default for DeltaGeometry {
    /// The IRB 340, from public descriptions of the robot. They differ from each other by 2 %: measure your own robot.
    fn default() -> Self {
        Self {
            base_radius_mm: 200.0,
            upper_arm_mm: 350.0,
            forearm_mm: 800.0,
            platform_radius_mm: 45.0,
            arm_azimuths_deg: [0.0, 120.0, 240.0],
            arm_range_rad: [-0.7034, 1.7453],
            arm_margin_rad: 0.01745,
            turn_range_rad: [-6_283.0, 6_283.0],
        }
    }
}

impl DeltaGeometry {
    /// Hard bounds of the dimensions, named as configuration files write them.
    pub(in crate::robots) fn bounds(&self) -> [Bound; 12] {
        let [first_deg, second_deg, third_deg] = self.arm_azimuths_deg;
        let [low_rad, high_rad] = self.arm_range_rad;
        let [turn_low_rad, turn_high_rad] = self.turn_range_rad;
        [
            bound("geometry.base_radius_mm", self.base_radius_mm, 10.0, 2000.0),
            bound("geometry.upper_arm_mm", self.upper_arm_mm, 10.0, 2000.0),
            bound("geometry.forearm_mm", self.forearm_mm, self.upper_arm_mm, 4000.0),
            bound(
                "geometry.platform_radius_mm",
                self.platform_radius_mm,
                0.0,
                self.base_radius_mm,
            ),
            bound("geometry.arm_azimuths_deg[0]", first_deg, -360.0, 360.0),
            bound("geometry.arm_azimuths_deg[1]", second_deg, -360.0, 360.0),
            bound("geometry.arm_azimuths_deg[2]", third_deg, -360.0, 360.0),
            bound("geometry.arm_range_rad[0]", low_rad, -1.6, 0.0),
            bound("geometry.arm_range_rad[1]", high_rad, 0.1, 1.8),
            bound("geometry.arm_margin_rad", self.arm_margin_rad, 0.0, 0.2),
            bound("geometry.turn_range_rad[0]", turn_low_rad, -6300.0, 0.0),
            bound("geometry.turn_range_rad[1]", turn_high_rad, 0.0, 6300.0),
        ]
    }

    /// Largest distance of the tool from the base that the links' lengths allow, mm.
    pub(in crate::robots) fn reach_mm(&self) -> f64 {
        self.upper_arm_mm + self.forearm_mm
    }

    /// Lowest and highest angle of each main axis, rad.
    pub(in crate::robots) fn ranges_rad(&self) -> [[f64; 2]; MAIN_AXES] {
        [self.arm_range_rad; MAIN_AXES]
    }

    /// Usual highest speed and acceleration of each main axis, rad/s and rad/s2.
    pub(in crate::robots) fn usual_limits() -> [[f64; 2]; MAIN_AXES] {
        [[25.0, 250.0]; MAIN_AXES]
    }

    /// Angles of the margin, rad.
    pub(in crate::robots) fn margins_rad(&self) -> [f64; MAIN_AXES] {
        [self.arm_margin_rad; MAIN_AXES]
    }

    /// This geometry with arms that turn all the way round.
    pub(in crate::robots) fn without_ranges(self) -> Self {
        Self {
            arm_range_rad: [-PI, PI],
            ..self
        }
    }
}

/// Dimensions as a file of measurements gives them: radii, or sides of the equilateral triangles of base and platform.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measured {
    base_radius_mm: Option<f64>,
    base_side_mm: Option<f64>,
    upper_arm_mm: f64,
    forearm_mm: f64,
    platform_radius_mm: Option<f64>,
    platform_side_mm: Option<f64>,
    arm_azimuths_deg: Option<[f64; 3]>,
    arm_range_rad: Option<[f64; 2]>,
}

/// Why measurements do not give a geometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeasuredError {
    /// The file gives both the radius and the side of this part.
    Twice(&'static str),
    /// The file gives neither the radius nor the side of this part.
    Missing(&'static str),
    /// This part has a negative size.
    Negative(&'static str),
}

impl fmt::Display for MeasuredError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Twice(part) => write!(
                f,
                "{part}_radius_mm and {part}_side_mm say the same; leave one of them out"
            ),
            Self::Missing(part) => write!(f, "{part}_radius_mm or {part}_side_mm is missing"),
            Self::Negative(part) => write!(f, "the {part} has a negative size"),
        }
    }
}

impl core::error::Error for MeasuredError {}

impl Measured {
    /// Help text: the keys of the file.
    pub const KEYS: &str = "base_radius_mm, upper_arm_mm, forearm_mm, platform_radius_mm and arm_azimuths_deg, or with \
        base_side_mm and platform_side_mm of equilateral triangles instead of the radii; arm_range_rad = [low, high] \
        if the arms' range is to be checked";

    /// Lowest and highest angle of all main axes, rad, if the file gives them.
    #[must_use]
    pub fn range_rad(&self) -> Option<[f64; 2]> {
        self.arm_range_rad
    }

    /// The geometry; values that the file does not give are the default's. Without a range of the arms every angle is in
    /// range.
    ///
    /// # Errors
    /// A size is missing, given twice or negative.
    pub fn geometry(&self) -> Result<DeltaGeometry, MeasuredError> {
        // From the centre of the base's triangle to a side, of the platform's to a corner.
        let (to_side, to_corner) = (HALF_ROOT_OF_THREE / 3.0, 2.0 * HALF_ROOT_OF_THREE / 3.0);
        let base_radius_mm = radius("base", self.base_radius_mm, self.base_side_mm, to_side)?;
        let platform_radius_mm = radius("platform", self.platform_radius_mm, self.platform_side_mm, to_corner)?;
        for (part, radius_mm) in [("base", base_radius_mm), ("platform", platform_radius_mm)] {
            if radius_mm < 0.0 {
                return Err(MeasuredError::Negative(part));
            }
        }
        let defaults = DeltaGeometry::default();
        let geometry = DeltaGeometry {
            base_radius_mm,
            platform_radius_mm,
            upper_arm_mm: self.upper_arm_mm,
            forearm_mm: self.forearm_mm,
            arm_azimuths_deg: self.arm_azimuths_deg.unwrap_or(defaults.arm_azimuths_deg),
            ..defaults
        };
        Ok(match self.arm_range_rad {
            Some(arm_range_rad) => DeltaGeometry {
                arm_range_rad,
                ..geometry
            },
            None => geometry.without_ranges(),
        })
    }
}

fn radius(
    part: &'static str,
    radius_mm: Option<f64>,
    side_mm: Option<f64>,
    radius_of_side: f64,
) -> Result<f64, MeasuredError> {
    match (radius_mm, side_mm) {
        (Some(_), Some(_)) => Err(MeasuredError::Twice(part)),
        (None, None) => Err(MeasuredError::Missing(part)),
        (Some(radius_mm), None) => Ok(radius_mm),
        (None, Some(side_mm)) => Ok(side_mm * radius_of_side),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLES: Measured = Measured {
        base_radius_mm: None,
        base_side_mm: Some(692.820_323_027_550_9),
        upper_arm_mm: 350.0,
        forearm_mm: 800.0,
        platform_radius_mm: None,
        platform_side_mm: Some(77.942_286_340_599_48),
        arm_azimuths_deg: None,
        arm_range_rad: None,
    };

    #[test]
    fn a_negative_size_is_refused_by_its_part() {
        let mut base = TRIANGLES;
        base.base_side_mm = Some(-1.0);
        let mut platform = TRIANGLES;
        platform.platform_side_mm = Some(-0.001);
        for (part, measured) in [("base", base), ("platform", platform)] {
            let refused = measured.geometry().err();
            assert!(matches!(refused, Some(MeasuredError::Negative(named)) if named == part));
        }
    }

    #[test]
    fn triangles_give_the_radii() {
        let geometry = TRIANGLES.geometry().unwrap();
        assert!((geometry.base_radius_mm - 200.0).abs() < 1.0e-9);
        assert!((geometry.platform_radius_mm - 45.0).abs() < 1.0e-9);
        assert_eq!(geometry.arm_azimuths_deg, [0.0, 120.0, 240.0]);
    }
}
