//! SCARA: two links that turn in the horizontal plane, and a linear axis for z.
//!
//! The frame's origin is the shoulder, with x where the shoulder's angle is 0; z points up. The elbow's side is chosen
//! by its sign and never changes on a path. With c = (r2 - l1^2 - l2^2) / (2 l1 l2) the elbow's angle is
//! ±atan2(sqrt((1 - c)(1 + c)), c); the derivatives need no trigonometry. Singular where both links are in line.
//!
//! Invariant: a result is finite or an error; no input panics.

use super::errors::{GeometryError, ScaraError};
use super::linear::{Linear, WHEEL, angles_rad, check_stroke};
use super::vector::{Vector, root};
use super::{
    Change, Conditioning, ConditioningMin, JointAngles, JointRanges, JointRows, KinematicsError, MAIN_AXES, Position,
    RATIO_SINGULAR, Words,
};
use crate::bounds::{Bound, bound};
use crate::work_volume::WorkVolume;
use core::f64::consts::{PI, TAU};
use serde::{Deserialize, Serialize};

/// Joint of the elbow, from 0.
const ELBOW: u8 = 1;
/// Nouns for messages.
pub(super) const WORDS: Words = Words {
    joint: "joint",
    singular: "inner and outer link in line",
    last_links: "links",
};
/// Smallest distance from the singularities in the work area. The ratio is the absolute sine of the elbow's angle.
pub(super) const CONDITIONING_MIN: ConditioningMin = ConditioningMin {
    ratio: 0.3,
    determinant: 0.0,
};
/// Widest range of the shoulder, rad: less than a full turn, so that each position has one angle.
const TURN_WIDTH_MAX_RAD: f64 = 6.0;

const _: () = assert!(CONDITIONING_MIN.ratio > RATIO_SINGULAR && TURN_WIDTH_MAX_RAD < TAU);

/// Dimensions of a SCARA.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScaraGeometry {
    /// Length of the link from shoulder to elbow, mm.
    pub inner_link_mm: f64,
    /// Length of the link from elbow to tool, mm.
    pub outer_link_mm: f64,
    /// Side of the elbow: 1 for positive angles of the elbow, -1 for negative ones.
    pub elbow: i8,
    /// Lowest and highest angle of the shoulder, radians.
    pub shoulder_range_rad: [f64; 2],
    /// Lowest and highest angle of the elbow against the inner link, radians; 0 is stretched.
    pub elbow_range_rad: [f64; 2],
    /// Margin kept from both ends of the ranges of shoulder and elbow, radians.
    pub margin_rad: f64,
    /// Lowest and highest z, mm.
    pub z_range_mm: [f64; 2],
    /// Margin kept from both ends of the range of z, mm.
    pub z_margin_mm: f64,
    /// Lowest and highest angle of the fourth axis, radians.
    pub turn_range_rad: [f64; 2],
}

impl Default for ScaraGeometry {
    /// The usual 400 mm class: links of 225 and 175 mm, a screw with a pitch of 20 mm.
    fn default() -> Self {
        Self {
            inner_link_mm: 225.0,
            outer_link_mm: 175.0,
            elbow: 1,
            shoulder_range_rad: [-2.3, 2.3],
            elbow_range_rad: [-2.6, 2.6],
            margin_rad: 0.01745,
            z_range_mm: [-150.0, 0.0],
            z_margin_mm: 1.0,
            turn_range_rad: [-6.3, 6.3],
        }
    }
}

impl ScaraGeometry {
    /// Hard bounds of the dimensions, named as configuration files write them.
    pub(super) fn bounds(&self) -> [Bound; 13] {
        let ([shoulder_low, shoulder_high], [elbow_low, elbow_high]) = (self.shoulder_range_rad, self.elbow_range_rad);
        let ([z_low, z_high], [turn_low_rad, turn_high_rad]) = (self.z_range_mm, self.turn_range_rad);
        [
            bound("geometry.inner_link_mm", self.inner_link_mm, 10.0, 2000.0),
            bound("geometry.outer_link_mm", self.outer_link_mm, 10.0, 2000.0),
            bound("geometry.elbow", f64::from(self.elbow), -1.0, 1.0),
            bound("geometry.shoulder_range_rad[0]", shoulder_low, -6.3, shoulder_high),
            bound(
                "geometry.shoulder_range_rad[1]",
                shoulder_high,
                shoulder_low,
                shoulder_low + TURN_WIDTH_MAX_RAD,
            ),
            bound("geometry.elbow_range_rad[0]", elbow_low, -3.0, elbow_high),
            bound("geometry.elbow_range_rad[1]", elbow_high, elbow_low, 3.0),
            bound("geometry.margin_rad", self.margin_rad, 0.0, 0.2),
            bound("geometry.z_range_mm[0]", z_low, -2000.0, z_high),
            bound("geometry.z_range_mm[1]", z_high, z_low, 2000.0),
            bound("geometry.z_margin_mm", self.z_margin_mm, 0.0, 100.0),
            bound("geometry.turn_range_rad[0]", turn_low_rad, -6300.0, 0.0),
            bound("geometry.turn_range_rad[1]", turn_high_rad, 0.0, 6300.0),
        ]
    }

    /// Largest distance of the tool from the shoulder's axis that the links' lengths allow, mm.
    pub(super) fn reach_mm(&self) -> f64 {
        self.inner_link_mm + self.outer_link_mm
    }

    /// Lowest and highest angle of each main axis, rad.
    pub(super) fn ranges_rad(&self) -> [[f64; 2]; MAIN_AXES] {
        [
            self.shoulder_range_rad,
            self.elbow_range_rad,
            angles_rad(self.z_range_mm),
        ]
    }

    /// Angles of the margins, rad.
    pub(super) fn margins_rad(&self) -> [f64; MAIN_AXES] {
        let [_, of_z] = angles_rad([0.0, self.z_margin_mm]);
        [self.margin_rad, self.margin_rad, of_z]
    }

    /// Usual highest speed and acceleration of each main axis, rad/s and rad/s2: 450 degrees a second for the links.
    pub(super) fn usual_limits(&self) -> [[f64; 2]; MAIN_AXES] {
        let link = [7.85, 100.0];
        [link, link, angles_rad([500.0, 5000.0])]
    }

    /// The ring and heights that the links reach at all; the ranges of the joints cut a part out of them.
    pub(super) fn work_volume(&self) -> WorkVolume {
        let [low, high] = self.z_range_mm;
        WorkVolume {
            radius_mm: self.reach_mm(),
            inner_radius_mm: (self.inner_link_mm - self.outer_link_mm).abs(),
            z_low_mm: low + self.z_margin_mm,
            z_high_mm: high - self.z_margin_mm,
            ..WorkVolume::ENDLESS
        }
    }

    /// This geometry with joints that turn all the way round, and a z without end.
    pub(super) fn without_ranges(self) -> Self {
        Self {
            shoulder_range_rad: [-PI, PI],
            elbow_range_rad: [-PI, PI],
            z_range_mm: super::linear::ENDLESS_MM,
            ..self
        }
    }
}

/// A SCARA of known dimensions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scara {
    inner_mm: f64,
    outer_mm: f64,
    /// 1 or -1.
    elbow: f64,
    z: Linear,
    ranges_rad: [[f64; 2]; MAIN_AXES],
}

/// Both links for a position.
struct LinkPose {
    /// Cosine and sine of the shoulder's angle, not scaled: times the square of the distance.
    shoulder: [f64; 2],
    /// Cosine and sine of the elbow's angle.
    elbow: [f64; 2],
    distance_squared: f64,
    /// Square of the elbow's sine; negative where the links do not reach.
    ratio_squared: f64,
}

impl Scara {
    /// Makes a robot from its dimensions.
    ///
    /// # Errors
    /// Why the dimensions do not form a valid SCARA, see [`GeometryError`].
    pub(super) fn new(geometry: &ScaraGeometry) -> Result<Self, GeometryError> {
        let (inner_link_mm, outer_link_mm, elbow) = (geometry.inner_link_mm, geometry.outer_link_mm, geometry.elbow);
        let ranges = geometry.shoulder_range_rad.iter().chain(&geometry.elbow_range_rad);
        if ![inner_link_mm, outer_link_mm]
            .iter()
            .chain(ranges)
            .all(|value| value.is_finite())
        {
            return Err(GeometryError::NotFinite);
        }
        if !(inner_link_mm > 0.0 && outer_link_mm > 0.0) {
            return Err(ScaraError::Lengths {
                inner_link_mm,
                outer_link_mm,
            }
            .into());
        }
        if elbow.unsigned_abs() != 1 {
            return Err(ScaraError::Elbow { elbow }.into());
        }
        for [low_rad, high_rad] in [geometry.shoulder_range_rad, geometry.elbow_range_rad] {
            if low_rad >= high_rad {
                return Err(GeometryError::Range { low_rad, high_rad });
            }
        }
        check_stroke(geometry.z_range_mm)?;
        Ok(Self {
            inner_mm: inner_link_mm,
            outer_mm: outer_link_mm,
            elbow: f64::from(elbow),
            z: WHEEL,
            ranges_rad: geometry.ranges_rad(),
        })
    }

    fn link_pose(&self, [x, y, _]: &Vector) -> LinkPose {
        let (inner, outer) = (self.inner_mm, self.outer_mm);
        let distance_squared = x * x + y * y;
        let cosine = (distance_squared - inner * inner - outer * outer) / (2.0 * inner * outer);
        let ratio_squared = (1.0 - cosine) * (1.0 + cosine);
        let sine = self.elbow * root(ratio_squared);
        let (along, across) = (inner + outer * cosine, outer * sine);
        LinkPose {
            shoulder: [x * along + y * across, y * along - x * across],
            elbow: [cosine, sine],
            distance_squared,
            ratio_squared,
        }
    }

    /// Angles of shoulder and elbow, and z's, rad. The shoulder's angle is the one within half a turn of its range's
    /// middle.
    fn solve(&self, pose: &LinkPose, z_mm: f64) -> [f64; MAIN_AXES] {
        let ([shoulder_cosine, shoulder_sine], [elbow_cosine, elbow_sine]) = (pose.shoulder, pose.elbow);
        let [[low_rad, high_rad], ..] = self.ranges_rad;
        let middle_rad = 0.5 * (low_rad + high_rad);
        let angle_rad = libm::atan2(shoulder_sine, shoulder_cosine);
        [
            angle_rad + TAU * libm::round((middle_rad - angle_rad) / TAU),
            libm::atan2(elbow_sine, elbow_cosine),
            z_mm * self.z.rad_per_mm,
        ]
    }

    /// Joint angles for a position, rad.
    ///
    /// # Errors
    /// The position is not finite, beyond the links' reach, or a joint is outside its range.
    pub(super) fn inverse(&self, position: &Position) -> Result<[f64; MAIN_AXES], KinematicsError> {
        let point = Vector::from(*position);
        if !point.iter().all(|value| value.is_finite()) {
            return Err(KinematicsError::NotFinite);
        }
        let pose = self.link_pose(&point);
        super::reached(ELBOW, pose.ratio_squared)?;
        super::in_range(self.solve(&pose, position.z_mm), &self.ranges_rad)
    }

    /// Joint angles without checks, rad, for admitted points; the nearest real pose if there is no solution.
    #[inline(never)]
    pub(super) fn angles(&self, point: &Vector) -> [f64; MAIN_AXES] {
        let [_, _, z] = *point;
        self.solve(&self.link_pose(point), z)
    }

    /// Derivatives of the joint angles along a path through `point` with the unit tangent `tangent` and the curvature
    /// vector `bend` (1/mm). Finite wherever [`Scara::inverse`] has a solution.
    ///
    /// With the links' directions u1, u2, their angular velocities are w1 = u2.p' / (l1 S) and w2 = -u1.p' / (l2 S),
    /// S = sin of the elbow. For the second derivative, p'' + l1 u1 w1^2 + l2 u2 w2^2 stands in place of p'.
    #[inline(never)]
    pub(super) fn rows(&self, point: &Vector, tangent: &Vector, bend: &Vector) -> JointRows {
        let LinkPose {
            shoulder: [cosine, sine],
            elbow: [elbow_cosine, elbow_sine],
            distance_squared,
            ..
        } = self.link_pose(point);
        let inverse = 1.0 / distance_squared;
        let inner = [cosine * inverse, sine * inverse];
        let outer = [
            inner[0] * elbow_cosine - inner[1] * elbow_sine,
            inner[1] * elbow_cosine + inner[0] * elbow_sine,
        ];
        let inverse = 1.0 / (self.inner_mm * self.outer_mm * elbow_sine);
        let turning = |along: [f64; 2]| {
            [
                (outer[0] * along[0] + outer[1] * along[1]) * self.outer_mm * inverse,
                -(inner[0] * along[0] + inner[1] * along[1]) * self.inner_mm * inverse,
            ]
        };
        let [first, second] = turning([tangent[0], tangent[1]]);
        let (pull_first, pull_second) = (self.inner_mm * first * first, self.outer_mm * second * second);
        let [first_bend, second_bend] = turning([
            bend[0] + pull_first * inner[0] + pull_second * outer[0],
            bend[1] + pull_first * inner[1] + pull_second * outer[1],
        ]);
        JointRows {
            slope: [first, second - first, tangent[2] * self.z.rad_per_mm],
            bend: [first_bend, second_bend - first_bend, bend[2] * self.z.rad_per_mm],
        }
    }

    /// Distance from the singularities at a position; the ratio is negative where the links do not reach the position.
    ///
    /// The shoulder's angle has the gradient 1 / (l1 S), the elbow's r / (l1 l2 S). The ratio, which is its sine, changes
    /// no faster.
    pub(super) fn conditioning(&self, position: &Position) -> Conditioning {
        let pose = self.link_pose(&Vector::from(*position));
        let ratio = super::signed_root(pose.ratio_squared);
        let turning = root(pose.distance_squared) / (self.inner_mm * self.outer_mm * ratio);
        let (shoulder, elbow) = if ratio < RATIO_SINGULAR {
            (f64::INFINITY, f64::INFINITY)
        } else {
            (1.0 / (self.inner_mm * ratio), turning)
        };
        Conditioning {
            ratio: (ELBOW, ratio),
            determinant: 1.0,
            change: Change {
                // z changes in proportion to the displacement.
                angles: [shoulder, elbow, 0.0],
                ratio: elbow,
                determinant: 0.0,
            },
        }
    }

    /// Whether every joint is in its range and the elbow's sine is at least that of [`CONDITIONING_MIN`].
    #[inline(never)]
    pub(super) fn clears(&self, point: &Vector, ranges: &JointRanges) -> bool {
        let pose = self.link_pose(point);
        let [shoulder, elbow, _] = &ranges.turned;
        let ([cosine, sine], [elbow_cosine, elbow_sine]) = (pose.shoulder, pose.elbow);
        let ([.., [low_rad, high_rad]], inverse) = (ranges.rad, 1.0 / pose.distance_squared);
        let z_rad = point[2] * self.z.rad_per_mm;
        pose.ratio_squared >= CONDITIONING_MIN.ratio * CONDITIONING_MIN.ratio
            && shoulder.contains(cosine * inverse, sine * inverse)
            && elbow.contains(elbow_cosine, elbow_sine)
            && z_rad >= low_rad
            && z_rad <= high_rad
    }

    /// Position of the tool for joint angles. Any angles are accepted; the fourth axis does not affect the position.
    ///
    /// # Errors
    /// [`KinematicsError::NotFinite`].
    pub(super) fn forward(&self, joints: &JointAngles) -> Result<Position, KinematicsError> {
        let [shoulder, elbow, z, _] = joints.0;
        let outer = shoulder + elbow;
        super::finite(
            joints,
            [
                self.inner_mm * libm::cos(shoulder) + self.outer_mm * libm::cos(outer),
                self.inner_mm * libm::sin(shoulder) + self.outer_mm * libm::sin(outer),
                z * self.z.mm_per_rad,
            ],
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot(elbow: i8) -> Scara {
        let geometry = ScaraGeometry {
            elbow,
            ..ScaraGeometry::default()
        };
        Scara::new(&geometry.without_ranges()).unwrap()
    }

    /// Point, tangent and curvature, then shoulder and elbow: angles, first and second derivatives.
    type Golden = ([Vector; 3], [[f64; 2]; 3]);

    const POINTS: [[Vector; 3]; 3] = [
        [[250.0, 100.0, -50.0], [0.6, 0.8, 0.0], [-0.004, 0.003, 0.0]],
        [[0.0, -300.0, -10.0], [1.0, 0.0, 0.0], [0.0; 3]],
        [[-120.0, 180.0, 0.0], [0.0, -1.0, 0.5], [0.01, 0.0, 0.0]],
    ];

    /// Calculated with numpy and checked against differences.
    const POSITIVE: [[[f64; 2]; 3]; 3] = [
        [
            [-0.321_707_387_374, 1.682_137_341_136],
            [0.004_059_154_351, -0.005_877_664_398],
            [0.000_010_131_148, -0.000_003_804_054],
        ],
        [
            [-2.189_182_968_681, 1.459_455_312_454],
            [0.003_333_333_333, 0.0],
            [0.000_009_938_080, -0.000_025_555_063],
        ],
        [
            [1.344_233_652_640, 2.023_568_791_979],
            [0.001_108_521_593, 0.005_083_670_856],
            [-0.000_015_598_978, 0.000_018_220_947],
        ],
    ];
    const NEGATIVE: [[[f64; 2]; 3]; 3] = [
        [
            [1.082_720_141_599, -1.682_137_341_136],
            [-0.000_197_085_385, 0.005_877_664_398],
            [-0.000_002_911_172, 0.000_003_804_054],
        ],
        [
            [-0.952_409_684_909, -1.459_455_312_454],
            [0.003_333_333_333, 0.0],
            [-0.000_009_938_080, 0.000_025_555_063],
        ],
        [
            [2.973_364_208_045, -2.023_568_791_979],
            [0.004_019_683_536, -0.005_083_670_856],
            [-0.000_021_876_367, -0.000_018_220_947],
        ],
    ];

    #[test]
    fn angles_and_derivatives_are_those_of_the_golden_points() {
        let golden = |values: [[[f64; 2]; 3]; 3]| POINTS.into_iter().zip(values);
        let sides = golden(POSITIVE)
            .map(|golden| (1, golden))
            .chain(golden(NEGATIVE).map(|golden| (-1, golden)));
        for (elbow, golden) in sides {
            let ([point, tangent, bend], [q, slope, second]): Golden = golden;
            let (scara, rad_per_mm) = (robot(elbow), 1.0 / crate::robots::LINEAR_MM_PER_RAD);
            let rows = scara.rows(&point, &tangent, &bend);
            let inverse = scara.inverse(&point.into()).unwrap();
            for (values, expected, z) in [
                (inverse, q, point[2]),
                (rows.slope, slope, tangent[2]),
                (rows.bend, second, bend[2]),
            ] {
                let [shoulder, elbow, axis] = values;
                let near = |value: f64, expected: f64| (value - expected).abs() < 1.0e-9;
                assert!(
                    near(shoulder, expected[0]) && near(elbow, expected[1]) && near(axis, z * rad_per_mm),
                    "{point:?}: {values:?}, {expected:?}"
                );
            }
        }
    }

    #[test]
    fn the_shoulder_has_the_angle_that_its_range_contains() {
        let behind = Position {
            x_mm: -250.0,
            y_mm: -5.0,
            z_mm: -20.0,
        };
        let angle = |shoulder_range_rad| {
            let geometry = ScaraGeometry {
                shoulder_range_rad,
                ..ScaraGeometry::default()
            };
            Scara::new(&geometry)
                .unwrap()
                .inverse(&behind)
                .map(|[shoulder, ..]| shoulder)
        };
        let (first, second) = (angle([0.0, 5.5]).unwrap(), angle([-5.5, 0.0]).unwrap());
        assert!((first - second - TAU).abs() < 1.0e-12, "{first} {second}");
        assert!(matches!(
            angle([-1.0, 1.0]),
            Err(KinematicsError::Range { joint: 0, .. })
        ));
    }

    #[test]
    fn what_cannot_be_reached_names_the_elbow_and_the_reason() {
        let scara = Scara::new(&ScaraGeometry::default()).unwrap();
        let at = |x_mm, y_mm, z_mm| scara.inverse(&Position { x_mm, y_mm, z_mm });
        assert!(matches!(
            at(401.0, 0.0, 0.0),
            Err(KinematicsError::Unreachable { joint: 1, .. })
        ));
        assert!(matches!(
            at(49.0, 0.0, 0.0),
            Err(KinematicsError::Unreachable { joint: 1, .. })
        ));
        assert!(matches!(
            at(400.0, 0.0, 0.0),
            Err(KinematicsError::Singular { joint: 1, .. })
        ));
        assert!(matches!(
            at(0.0, 0.0, 0.0),
            Err(KinematicsError::Unreachable { joint: 1, .. })
        ));
        assert!(matches!(
            at(300.0, 0.0, 1.0),
            Err(KinematicsError::Range { joint: 2, .. })
        ));
        assert_eq!(at(300.0, f64::NAN, 0.0), Err(KinematicsError::NotFinite));
    }

    #[test]
    fn dimensions_that_do_not_form_a_robot_are_refused() {
        let refuse = |change: fn(&mut ScaraGeometry)| {
            let mut geometry = ScaraGeometry::default();
            change(&mut geometry);
            Scara::new(&geometry).unwrap_err()
        };
        assert_eq!(refuse(|g| g.outer_link_mm = f64::NAN), GeometryError::NotFinite);
        assert_eq!(
            refuse(|g| g.elbow = 0),
            GeometryError::Scara(ScaraError::Elbow { elbow: 0 })
        );
        let lengths = refuse(|g| g.inner_link_mm = 0.0);
        assert!(matches!(lengths, GeometryError::Scara(ScaraError::Lengths { .. })));
        let range = refuse(|g| g.elbow_range_rad = [1.0, -1.0]);
        assert!(matches!(range, GeometryError::Range { .. }));
        assert!(matches!(
            refuse(|g| g.z_range_mm = [0.0; 2]),
            GeometryError::Stroke { .. }
        ));
    }
}
