//! The delta robot: three arms, three forearms, one platform.
//!
//! The centre of the platform is one forearm away from each of three points: the elbows, moved inwards by the
//! platform's radius. It is therefore where three equal spheres meet, below the plane through their centres.

use super::spheres::below;
use crate::vector::Vector;

/// Number of arms.
const ARMS: usize = super::MAIN_AXES;
/// Part of the upper arm's length by which the platform moves at least when an arm turns by a radian and the other two
/// follow. In a work area the angle between an arm and its forearm has a sine of at least 0.35, and the forearm leans
/// sideways by less than 44 degrees, cosine 0.72.
const LEVER_PART_MIN: f64 = 0.25;

/// Dimensions of a delta robot with equal arms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeltaDimensions {
    /// Centre of the base to the shoulder axes, mm.
    pub base_radius_mm: f64,
    /// Length of an upper arm, mm.
    pub upper_arm_mm: f64,
    /// Length of a forearm, mm.
    pub forearm_mm: f64,
    /// Centre of the platform to the forearms' joints, mm.
    pub platform_radius_mm: f64,
    /// Azimuths of the arms, degrees.
    pub azimuths_deg: [f64; ARMS],
}

impl Default for DeltaDimensions {
    /// The IRB 340, as the default configuration describes it.
    fn default() -> Self {
        Self {
            base_radius_mm: 200.0,
            upper_arm_mm: 350.0,
            forearm_mm: 800.0,
            platform_radius_mm: 45.0,
            azimuths_deg: [0.0, 120.0, 240.0],
        }
    }
}

/// A delta robot. At angle 0 an arm points outwards and level; a positive angle lowers its elbow.
#[derive(Clone, Debug, PartialEq)]
pub struct Delta {
    outwards: [[f64; 2]; ARMS],
    shoulder_mm: f64,
    upper_arm_mm: f64,
    forearm_squared: f64,
}

impl Delta {
    /// A delta robot of these dimensions. Dimensions that are no robot have no tool position.
    #[must_use]
    pub fn new(dimensions: &DeltaDimensions) -> Self {
        Self {
            outwards: dimensions.azimuths_deg.map(|azimuth_deg| {
                let (sine, cosine) = azimuth_deg.to_radians().sin_cos();
                [cosine, sine]
            }),
            shoulder_mm: dimensions.base_radius_mm - dimensions.platform_radius_mm,
            upper_arm_mm: dimensions.upper_arm_mm,
            forearm_squared: dimensions.forearm_mm * dimensions.forearm_mm,
        }
    }

    /// The elbows, moved inwards by the platform's radius, mm.
    #[inline]
    fn centres(&self, arms_rad: [f64; ARMS]) -> [Vector; ARMS] {
        let mut centres = [[0.0; 3]; ARMS];
        for (centre, (angle_rad, [x, y])) in centres.iter_mut().zip(arms_rad.iter().zip(self.outwards)) {
            let (sine, cosine) = angle_rad.sin_cos();
            let radius_mm = self.shoulder_mm + self.upper_arm_mm * cosine;
            *centre = [radius_mm * x, radius_mm * y, -self.upper_arm_mm * sine];
        }
        centres
    }

    /// Position of the platform's centre, mm; `None` if the forearms do not meet.
    #[must_use]
    #[inline]
    pub fn tool(&self, arms_rad: [f64; ARMS]) -> Option<Vector> {
        below(self.centres(arms_rad), self.forearm_squared)
    }

    /// Largest change of an arm's angle for a millimetre of the platform, rad/mm.
    #[must_use]
    pub fn slope_max_rad_mm(&self) -> f64 {
        1.0 / (LEVER_PART_MIN * self.upper_arm_mm.max(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vector::{add, is_finite, length, scale, subtract};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_platform_is_one_forearm_away_from_each_elbow(
            arms in proptest::array::uniform3(-0.7_f64..1.7),
            azimuths in proptest::array::uniform3(-10.0_f64..10.0),
        ) {
            let turned = [azimuths[0], 120.0 + azimuths[1], 240.0 + azimuths[2]];
            let dimensions = DeltaDimensions { azimuths_deg: turned, ..DeltaDimensions::default() };
            let delta = Delta::new(&dimensions);
            if let Some(tool) = delta.tool(arms) {
                for (angle, azimuth_deg) in arms.iter().zip(turned) {
                    // The elbow, and the forearm's lower end beside the platform's centre.
                    let azimuth = azimuth_deg.to_radians();
                    let outwards = [azimuth.cos(), azimuth.sin(), 0.0];
                    let radius = 200.0 + 350.0 * angle.cos();
                    let elbow = add(scale(outwards, radius), [0.0, 0.0, -350.0 * angle.sin()]);
                    let joint = add(tool, scale(outwards, 45.0));
                    let forearm = length(subtract(joint, elbow));
                    prop_assert!((forearm - 800.0).abs() < 1e-9, "{forearm}");
                }
            }
        }

        #[test]
        fn no_angles_panic(arms in proptest::array::uniform3(proptest::num::f64::ANY)) {
            let tool = Delta::new(&DeltaDimensions::default()).tool(arms);
            prop_assert!(tool.is_none_or(|tool| is_finite(&tool)));
        }
    }

    #[test]
    fn equal_angles_hold_the_platform_on_the_axis_at_the_height_that_pythagoras_gives() {
        let delta = Delta::new(&DeltaDimensions::default());
        // Level arms: the forearm spans 505 mm sideways, and 620.46... mm downwards.
        let [x, y, z] = delta.tool([0.0; 3]).unwrap();
        assert!(x.abs() < 1e-9 && y.abs() < 1e-9, "{x} {y}");
        assert!((z + (800.0_f64 * 800.0 - 505.0 * 505.0).sqrt()).abs() < 1e-9, "{z}");
        // Arms straight down: 155 mm sideways, and the elbows are 350 mm below the base.
        let [_, _, z] = delta.tool([std::f64::consts::FRAC_PI_2; 3]).unwrap();
        let expected = -350.0 - (800.0_f64 * 800.0 - 155.0 * 155.0).sqrt();
        assert!((z - expected).abs() < 1e-9, "{z}");
    }

    #[test]
    fn an_arm_that_sinks_pushes_the_platform_away_from_it() {
        let delta = Delta::new(&DeltaDimensions::default());
        let before = delta.tool([0.4; 3]).unwrap();
        let after = delta.tool([0.5, 0.4, 0.4]).unwrap();
        assert!(after[0] < before[0] && after[2] < before[2], "{before:?} {after:?}");
        assert!((after[1] - before[1]).abs() < 1e-9);
    }

    #[test]
    fn forearms_that_are_too_short_hold_nothing() {
        let short = DeltaDimensions {
            forearm_mm: 300.0,
            ..DeltaDimensions::default()
        };
        assert_eq!(Delta::new(&short).tool([0.0; 3]), None);
        let flat = DeltaDimensions {
            azimuths_deg: [0.0; 3],
            ..DeltaDimensions::default()
        };
        assert_eq!(Delta::new(&flat).tool([0.0; 3]), None);
    }
}
