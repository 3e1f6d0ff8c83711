//! Linear delta: three carriages on upright towers hold a platform with rods of equal length.
//!
//! A carriage's height is q = z + H with H = sqrt(L^2 - d^2), where d is the horizontal distance of the platform from the
//! tower and L the rod's length. The frame's origin is on the axis between the towers, where a carriage at 0 mm would
//! be; z points up. Singular where a rod is horizontal. Forward kinematics intersects three spheres.
//!
//! Invariant: a result is finite or an error; no input panics.

use super::errors::{GeometryError, LinearDeltaError};
use super::linear::{BELT_LIMITS, Linear, WHEEL, angles_rad, check_stroke};
use super::spheres::lower_meeting;
use super::vector::{Vector, cross, dot, root, scale};
use super::{
    Change, Conditioning, ConditioningMin, JointAngles, JointRanges, JointRows, KinematicsError, MAIN_AXES, Position,
    RATIO_SINGULAR, Words,
};
use crate::bounds::{Bound, bound};
use crate::work_volume::WorkVolume;
use serde::{Deserialize, Serialize};

/// Number of towers, whose carriages are the main axes.
const TOWERS: usize = MAIN_AXES;
/// Nouns for messages.
pub(super) const WORDS: Words = Words {
    joint: "carriage",
    singular: "rod level with the platform",
    last_links: "rods",
};
/// Smallest distance from the singularities in the work area. The ratio H/L is the sine of a rod's angle above the
/// horizontal; the determinant is that of the rods' unit vectors.
pub(super) const CONDITIONING_MIN: ConditioningMin = ConditioningMin {
    ratio: 0.35,
    determinant: 0.1,
};
/// Radius of the usual work volume as a part of the towers' radius.
const VOLUME_PART: f64 = 0.7;
/// Smallest sine of the angle between the azimuths of two towers.
const AZIMUTH_SINE_MIN: f64 = 0.1;

const _: () = assert!(CONDITIONING_MIN.ratio > RATIO_SINGULAR);

/// Dimensions of a linear delta.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LinearDeltaGeometry {
    /// Horizontal distance of the rods' upper joints from the machine's axis, less that of the lower joints from the
    /// platform's centre, mm.
    pub radius_mm: f64,
    /// Length of a rod, mm.
    pub rod_mm: f64,
    /// Azimuths of the towers, degrees.
    pub tower_azimuths_deg: [f64; 3],
    /// Lowest and highest carriage, mm.
    pub carriage_range_mm: [f64; 2],
    /// Margin kept from both ends of the carriages' range, mm.
    pub margin_mm: f64,
    /// Lowest and highest angle of the fourth axis, radians.
    pub turn_range_rad: [f64; 2],
}

impl Default for LinearDeltaGeometry {
    /// A machine of the Kossel kind: rods of 265 mm, belts over pulleys of 20 teeth with a pitch of 2 mm.
    fn default() -> Self {
        Self {
            radius_mm: 134.0,
            rod_mm: 265.0,
            tower_azimuths_deg: [90.0, 210.0, 330.0],
            carriage_range_mm: [60.0, 560.0],
            margin_mm: 1.0,
            turn_range_rad: [-6_283.0, 6_283.0],
        }
    }
}

impl LinearDeltaGeometry {
    /// Hard bounds of the dimensions, named as configuration files write them.
    pub(super) fn bounds(&self) -> [Bound; 10] {
        let [first_deg, second_deg, third_deg] = self.tower_azimuths_deg;
        let ([low_mm, high_mm], [turn_low_rad, turn_high_rad]) = (self.carriage_range_mm, self.turn_range_rad);
        [
            bound("geometry.radius_mm", self.radius_mm, 10.0, self.rod_mm),
            bound("geometry.rod_mm", self.rod_mm, self.radius_mm, 4000.0),
            bound("geometry.tower_azimuths_deg[0]", first_deg, -360.0, 360.0),
            bound("geometry.tower_azimuths_deg[1]", second_deg, -360.0, 360.0),
            bound("geometry.tower_azimuths_deg[2]", third_deg, -360.0, 360.0),
            bound("geometry.carriage_range_mm[0]", low_mm, -5000.0, high_mm),
            bound("geometry.carriage_range_mm[1]", high_mm, low_mm, 5000.0),
            bound("geometry.margin_mm", self.margin_mm, 0.0, 100.0),
            bound("geometry.turn_range_rad[0]", turn_low_rad, -6300.0, 0.0),
            bound("geometry.turn_range_rad[1]", turn_high_rad, 0.0, 6300.0),
        ]
    }

    /// Largest distance of the platform from the axis that the rods' length allows, mm.
    pub(super) fn reach_mm(&self) -> f64 {
        self.rod_mm
    }

    /// Lowest and highest z that the carriages' range and the rods allow, mm.
    pub(super) fn heights_mm(&self) -> [f64; 2] {
        let [low_mm, high_mm] = self.carriage_range_mm;
        [low_mm - self.rod_mm, high_mm]
    }

    /// Lowest and highest angle of each main axis, rad.
    pub(super) fn ranges_rad(&self) -> [[f64; 2]; TOWERS] {
        [angles_rad(self.carriage_range_mm); TOWERS]
    }

    /// Angles of the margin, rad.
    pub(super) fn margins_rad(&self) -> [f64; TOWERS] {
        let [_, margin] = angles_rad([0.0, self.margin_mm]);
        [margin; TOWERS]
    }

    /// Usual highest speed and acceleration of each main axis, rad/s and rad/s2.
    pub(super) fn usual_limits(&self) -> [[f64; 2]; TOWERS] {
        [angles_rad(BELT_LIMITS); TOWERS]
    }

    /// A cylinder between the towers: as high as the carriages reach at its border, where the heights of the rods differ
    /// most.
    pub(super) fn work_volume(&self) -> WorkVolume {
        let [low_mm, high_mm] = self.carriage_range_mm;
        let rod_height = |across_mm: f64| root(self.rod_mm * self.rod_mm - across_mm * across_mm);
        let (far_mm, near_mm) = (
            (1.0 + VOLUME_PART) * self.radius_mm,
            (1.0 - VOLUME_PART) * self.radius_mm,
        );
        WorkVolume {
            radius_mm: VOLUME_PART * self.radius_mm,
            z_low_mm: low_mm + self.margin_mm - rod_height(far_mm),
            z_high_mm: high_mm - self.margin_mm - rod_height(near_mm),
            ..WorkVolume::ENDLESS
        }
    }

    /// This geometry with towers that end at no position that a machine has.
    pub(super) fn without_ranges(self) -> Self {
        Self {
            carriage_range_mm: super::linear::ENDLESS_MM,
            ..self
        }
    }
}

/// A linear delta of known dimensions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearDelta {
    /// Where the towers stand, mm.
    towers: [[f64; 2]; TOWERS],
    rod_mm: f64,
    carriage: Linear,
    range_rad: [f64; 2],
}

impl LinearDelta {
    /// Makes a robot from its dimensions.
    ///
    /// # Errors
    /// Why the dimensions do not form a valid linear delta, see [`GeometryError`].
    pub(super) fn new(geometry: &LinearDeltaGeometry) -> Result<Self, GeometryError> {
        let (radius_mm, rod_mm) = (geometry.radius_mm, geometry.rod_mm);
        let azimuths = geometry.tower_azimuths_deg;
        if ![radius_mm, rod_mm]
            .iter()
            .chain(&azimuths)
            .all(|value| value.is_finite())
        {
            return Err(GeometryError::NotFinite);
        }
        if !(radius_mm > 0.0 && rod_mm > radius_mm) {
            return Err(LinearDeltaError::Rods { rod_mm, radius_mm }.into());
        }
        let [first, second, third] = azimuths;
        for (first_deg, second_deg) in [(first, second), (second, third), (third, first)] {
            if libm::sin((second_deg - first_deg).to_radians()).abs() < AZIMUTH_SINE_MIN {
                return Err(LinearDeltaError::Towers { first_deg, second_deg }.into());
            }
        }
        check_stroke(geometry.carriage_range_mm)?;
        let carriage = WHEEL;
        Ok(Self {
            towers: azimuths.map(|azimuth_deg| {
                let azimuth = azimuth_deg.to_radians();
                [radius_mm * libm::cos(azimuth), radius_mm * libm::sin(azimuth)]
            }),
            rod_mm,
            carriage,
            range_rad: angles_rad(geometry.carriage_range_mm),
        })
    }

    /// Horizontal distance of the platform from a tower, mm, and the square of the rod's height, mm2: negative where
    /// the rod does not reach.
    fn rod(&self, [x, y]: [f64; 2], point: &Vector) -> ([f64; 2], f64) {
        let across = [point[0] - x, point[1] - y];
        let distance_squared = across[0] * across[0] + across[1] * across[1];
        (across, self.rod_mm * self.rod_mm - distance_squared)
    }

    /// Carriage angles for a position, rad.
    ///
    /// # Errors
    /// The position is not finite, or the first carriage that cannot reach it, with the reason.
    pub(super) fn inverse(&self, position: &Position) -> Result<[f64; TOWERS], KinematicsError> {
        let point = Vector::from(*position);
        if !point.iter().all(|value| value.is_finite()) {
            return Err(KinematicsError::NotFinite);
        }
        for (joint, tower) in (0u8..).zip(self.towers) {
            let (_, height_squared) = self.rod(tower, &point);
            super::reached(joint, height_squared / (self.rod_mm * self.rod_mm))?;
        }
        super::in_range(self.angles(&point), &[self.range_rad; TOWERS])
    }

    /// Carriage angles without checks, rad, for admitted points; the nearest real pose if there is no solution.
    #[inline(never)]
    pub(super) fn angles(&self, point: &Vector) -> [f64; TOWERS] {
        self.towers.map(|tower| {
            let (_, height_squared) = self.rod(tower, point);
            (point[2] + root(height_squared)) * self.carriage.rad_per_mm
        })
    }

    /// Derivatives of the carriage angles along a path through `point` with the unit tangent `tangent` and the
    /// curvature vector `bend` (1/mm). Finite wherever [`LinearDelta::inverse`] has a solution.
    ///
    /// q' = z' - d.p' / H and q'' = z'' - (d.p'' + |p'|^2) / H - (d.p')^2 / H^3, with p in the horizontal plane.
    #[inline(never)]
    pub(super) fn rows(&self, point: &Vector, tangent: &Vector, bend: &Vector) -> JointRows {
        let mut rows = JointRows::default();
        let level_squared = tangent[0] * tangent[0] + tangent[1] * tangent[1];
        for ((tower, slope), second) in self.towers.iter().zip(&mut rows.slope).zip(&mut rows.bend) {
            let (across, height_squared) = self.rod(*tower, point);
            let inverse = 1.0 / root(height_squared);
            let along = (across[0] * tangent[0] + across[1] * tangent[1]) * inverse;
            let change = across[0] * bend[0] + across[1] * bend[1] + level_squared + along * along;
            *slope = (tangent[2] - along) * self.carriage.rad_per_mm;
            *second = (bend[2] - change * inverse) * self.carriage.rad_per_mm;
        }
        rows
    }

    /// Distance from the singularities at a position; the ratio is negative where a rod does not reach the position.
    ///
    /// A carriage's height has the gradient L/H, the ratio d / (H L), and a rod's unit vector turns by at most 1/H.
    pub(super) fn conditioning(&self, position: &Position) -> Conditioning {
        let point = Vector::from(*position);
        let (mut ratio, mut change) = ((0, f64::INFINITY), Change::default());
        let mut units = [[0.0; 3]; TOWERS];
        let tower_changes = (0u8..).zip(self.towers.iter().zip(&mut units).zip(&mut change.angles));
        let mut determinant_change = 0.0;
        let mut ratio_change = 0.0_f64;
        for (joint, ((tower, unit), angle)) in tower_changes {
            let (across, height_squared) = self.rod(*tower, &point);
            let height = super::signed_root(height_squared);
            let of_rod = height / self.rod_mm;
            if of_rod < ratio.1 {
                ratio = (joint, of_rod);
            }
            *unit = scale(&[across[0], across[1], -height], 1.0 / self.rod_mm);
            let inverse = if of_rod < RATIO_SINGULAR {
                f64::INFINITY
            } else {
                1.0 / height
            };
            *angle = self.rod_mm * inverse * self.carriage.rad_per_mm;
            ratio_change = ratio_change.max(inverse);
            determinant_change += inverse;
        }
        change.ratio = ratio_change;
        change.determinant = determinant_change;
        Conditioning {
            ratio,
            determinant: dot(&units[0], &cross(&units[1], &units[2])).abs(),
            change,
        }
    }

    /// Whether every carriage is in its range and the singularities are at least [`CONDITIONING_MIN`] away.
    #[inline(never)]
    pub(super) fn clears(&self, point: &Vector, ranges: &JointRanges) -> bool {
        let ConditioningMin { ratio, determinant } = CONDITIONING_MIN;
        let low_squared = ratio * ratio * self.rod_mm * self.rod_mm;
        let mut rods = [[0.0; 3]; TOWERS];
        for ((tower, [low_rad, high_rad]), rod) in self.towers.iter().zip(&ranges.rad).zip(&mut rods) {
            let (across, height_squared) = self.rod(*tower, point);
            let height = root(height_squared);
            let angle = (point[2] + height) * self.carriage.rad_per_mm;
            let clear = height_squared >= low_squared && angle >= *low_rad && angle <= *high_rad;
            if !clear {
                return false;
            }
            *rod = [across[0], across[1], -height];
        }
        let [first, second, third] = &rods;
        let volume = self.rod_mm * self.rod_mm * self.rod_mm;
        dot(first, &cross(second, third)).abs() >= determinant * volume
    }

    /// Position of the platform for joint angles. Any angles are accepted; the fourth axis does not affect the
    /// position.
    ///
    /// # Errors
    /// [`KinematicsError::NotFinite`], or [`KinematicsError::Apart`] where the rods do not meet.
    pub(super) fn forward(&self, joints: &JointAngles) -> Result<Position, KinematicsError> {
        if !joints.0.iter().all(|angle| angle.is_finite()) {
            return Err(KinematicsError::NotFinite);
        }
        let ([one, two, three], [first, second, third, _]) = (self.towers, joints.0);
        let carriage = |[x, y]: [f64; 2], angle: f64| [x, y, angle * self.carriage.mm_per_rad];
        let centres = [carriage(one, first), carriage(two, second), carriage(three, third)];
        lower_meeting(&centres, self.rod_mm)
            .map(Position::from)
            .ok_or(KinematicsError::Apart)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robots::LINEAR_MM_PER_RAD;

    /// Values in mm of the carriages, 1e-9 of which an angle may differ.
    fn check(angles: [f64; TOWERS], expected_mm: [f64; TOWERS]) {
        for (angle, expected) in angles.iter().zip(expected_mm) {
            assert!(
                (angle * LINEAR_MM_PER_RAD - expected).abs() < 1.0e-9,
                "{angles:?}, {expected_mm:?}"
            );
        }
    }

    /// Calculated with numpy and checked against differences.
    #[test]
    fn carriages_and_derivatives_are_those_of_the_golden_points() {
        let robot = LinearDelta::new(&LinearDeltaGeometry::default()).unwrap();
        for (point, tangent, bend, q, slope, second) in [
            (
                [0.0, 0.0, 100.0],
                [1.0, 0.0, 0.0],
                [0.0, 0.01, 0.0],
                [328.624_145_706_441; 3],
                [0.0, -0.507_590_323_623, 0.507_590_323_623],
                [0.001_487_157_006, -0.008_431_515_100, -0.008_431_515_100],
            ),
            (
                [60.0, -45.0, 20.0],
                [0.6, 0.8, 0.0],
                [-0.008, 0.006, 0.0],
                [205.967_739_137_733, 216.845_908_027_437, 278.069_154_477_736],
                [0.576_444_067_649, -0.626_014_752_855, 0.062_109_098_225],
                [0.001_192_208_057, -0.000_586_830_781, -0.006_138_807_159],
            ),
            (
                [-80.0, 30.0, 0.0],
                [0.0, 0.6, 0.8],
                [0.0; 3],
                [230.236_834_585_607, 243.960_211_217_195, 149.604_195_605_811],
                [1.071_025_268_882, 0.561_436_507_578, 0.410_973_477_286],
                [-0.001_882_647_045, -0.001_708_936_625, -0.003_417_963_202],
            ),
        ] {
            check(robot.inverse(&point.into()).unwrap(), q);
            let rows = robot.rows(&point, &tangent, &bend);
            check(rows.slope, slope);
            check(rows.bend, second);
        }
    }

    #[test]
    fn what_cannot_be_reached_names_the_carriage_and_the_reason() {
        let robot = LinearDelta::new(&LinearDeltaGeometry::default()).unwrap();
        let at = |x_mm, y_mm, z_mm| robot.inverse(&Position { x_mm, y_mm, z_mm });
        // The first tower stands at y = 134 mm.
        assert!(matches!(
            at(0.0, -132.0, 50.0),
            Err(KinematicsError::Unreachable { joint: 0, .. })
        ));
        assert!(matches!(
            at(0.0, -131.0, 50.0),
            Err(KinematicsError::Singular { joint: 0, .. })
        ));
        assert!(matches!(
            at(0.0, 0.0, 340.0),
            Err(KinematicsError::Range { joint: 0, .. })
        ));
        assert!(matches!(
            at(0.0, 0.0, -170.0),
            Err(KinematicsError::Range { joint: 0, .. })
        ));
        assert_eq!(at(0.0, 0.0, f64::INFINITY), Err(KinematicsError::NotFinite));
        let apart = robot.forward(&JointAngles([0.0, 100.0, 0.0, 0.0]));
        assert_eq!(apart, Err(KinematicsError::Apart));
    }

    #[test]
    fn dimensions_that_do_not_form_a_robot_are_refused() {
        let refuse = |change: fn(&mut LinearDeltaGeometry)| {
            let mut geometry = LinearDeltaGeometry::default();
            change(&mut geometry);
            LinearDelta::new(&geometry).unwrap_err()
        };
        assert_eq!(refuse(|g| g.rod_mm = f64::NAN), GeometryError::NotFinite);
        let rods = refuse(|g| g.rod_mm = 134.0);
        assert!(matches!(
            rods,
            GeometryError::LinearDelta(LinearDeltaError::Rods { .. })
        ));
        let towers = refuse(|g| g.tower_azimuths_deg = [90.0, 270.0, 330.0]);
        assert!(matches!(
            towers,
            GeometryError::LinearDelta(LinearDeltaError::Towers { .. })
        ));
    }
}
