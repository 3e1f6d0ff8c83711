//! Kinematics of the delta robot: positions, joint angles and their derivatives.
//!
//! Each arm is solved in its own vertical plane with the shoulder as the origin: u outwards, w upwards, y across. The
//! elbow is where the upper arm's circle meets the forearm's sphere. The derivatives along a path need no trigonometry.
//! Forward kinematics intersects three spheres in a frame built from their centres, so equal heights are no special
//! case.
//!
//! Invariant: a result is finite or an error; no input panics.

mod geometry;

pub use geometry::{DeltaGeometry, Measured, MeasuredError};

use super::errors::{DeltaError, GeometryError};
use super::joint_ranges::JointRanges;
use super::spheres::lower_meeting;
use super::vector::{Vector, cross, dot, root, scale};
use super::{
    Change, Conditioning, ConditioningMin, JointAngles, JointRows, KinematicsError, Position, RATIO_SINGULAR, Words,
};

/// Number of parallel arms, which are the main axes.
const ARMS: usize = super::MAIN_AXES;
/// Nouns for messages.
pub(super) const WORDS: Words = Words {
    joint: "arm",
    singular: "upper arm and forearm in line",
    last_links: "forearms",
};
/// Smallest distance from the singularities in the work area. The ratio D/A is in effect the sine of the angle between
/// an upper arm and its forearm's projection into the arm's plane; the determinant is that of the forearms' unit
/// vectors.
pub(super) const CONDITIONING_MIN: ConditioningMin = ConditioningMin {
    ratio: 0.35,
    determinant: 0.2,
};
/// Smallest sine of the angle between the azimuths of two arms.
const AZIMUTH_SINE_MIN: f64 = 0.1;

const _: () = assert!(CONDITIONING_MIN.ratio > RATIO_SINGULAR);

/// A delta robot of known geometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Delta {
    azimuths: [(f64, f64); ARMS],
    offset_mm: f64,
    upper_arm_mm: f64,
    forearm_mm: f64,
    range_rad: [f64; 2],
}

/// Solution of one arm for a position, in the arm's plane.
#[derive(Clone, Copy)]
struct ArmPose {
    cosine: f64,
    sine: f64,
    forearm: Vector,
    /// A squared: from the shoulder to the forearm's lower end in the arm's plane, mm2.
    distance_squared: f64,
    ratio_squared: f64,
}

/// An arm's part of [`Change`].
struct ArmChange {
    angle: f64,
    ratio: f64,
    determinant: f64,
}

impl Delta {
    /// Placeholder for a robot that is not configured yet.
    pub(super) const NONE: Self = Self {
        azimuths: [(0.0, 0.0); ARMS],
        offset_mm: 0.0,
        upper_arm_mm: 0.0,
        forearm_mm: 0.0,
        range_rad: [0.0; 2],
    };

    /// Makes a robot from its dimensions.
    ///
    /// # Errors
    /// Why the dimensions do not form a valid delta robot, see [`GeometryError`].
    pub(super) fn new(geometry: &DeltaGeometry) -> Result<Self, GeometryError> {
        let lengths = [
            geometry.base_radius_mm,
            geometry.upper_arm_mm,
            geometry.forearm_mm,
            geometry.platform_radius_mm,
        ];
        let angles = geometry.arm_azimuths_deg.iter().chain(&geometry.arm_range_rad);
        if !lengths.iter().chain(angles).all(|value| value.is_finite()) {
            return Err(GeometryError::NotFinite);
        }
        let (upper_arm_mm, forearm_mm) = (geometry.upper_arm_mm, geometry.forearm_mm);
        if !(upper_arm_mm > 0.0 && forearm_mm > upper_arm_mm) {
            return Err(DeltaError::Lengths {
                upper_arm_mm,
                forearm_mm,
            }
            .into());
        }
        let [low_rad, high_rad] = geometry.arm_range_rad;
        if low_rad >= high_rad {
            return Err(GeometryError::Range { low_rad, high_rad });
        }
        let [first, second, third] = geometry.arm_azimuths_deg;
        for (first_deg, second_deg) in [(first, second), (second, third), (third, first)] {
            if libm::sin((second_deg - first_deg).to_radians()).abs() < AZIMUTH_SINE_MIN {
                return Err(DeltaError::Azimuths { first_deg, second_deg }.into());
            }
        }
        Ok(Self {
            azimuths: geometry.arm_azimuths_deg.map(|azimuth_deg| {
                let azimuth = azimuth_deg.to_radians();
                (libm::cos(azimuth), libm::sin(azimuth))
            }),
            offset_mm: geometry.platform_radius_mm - geometry.base_radius_mm,
            upper_arm_mm,
            forearm_mm,
            range_rad: geometry.arm_range_rad,
        })
    }

    fn arm_pose(&self, (cosine, sine): (f64, f64), point: &Vector) -> ArmPose {
        let upper = self.upper_arm_mm;
        let u = point[0] * cosine + point[1] * sine + self.offset_mm;
        let y = point[1] * cosine - point[0] * sine;
        let w = point[2];
        let distance_squared = u * u + w * w;
        let k = (distance_squared + y * y + upper * upper - self.forearm_mm * self.forearm_mm) / (2.0 * upper);
        let difference = distance_squared - k * k;
        let d = root(difference);
        let inverse = 1.0 / distance_squared;
        let cosine = (k * u - w * d) * inverse;
        let sine = -(k * w + u * d) * inverse;
        ArmPose {
            cosine,
            sine,
            forearm: [u - upper * cosine, y, w + upper * sine],
            distance_squared,
            ratio_squared: difference * inverse,
        }
    }

    /// Arm angles for a position, rad.
    ///
    /// # Errors
    /// The first arm that cannot reach the position, with the reason.
    pub(super) fn inverse(&self, position: &Position) -> Result<[f64; ARMS], KinematicsError> {
        let point = Vector::from(*position);
        if !point.iter().all(|value| value.is_finite()) {
            return Err(KinematicsError::NotFinite);
        }
        let [low_rad, high_rad] = self.range_rad;
        let mut angles = [0.0; ARMS];
        for (arm, (azimuth, angle)) in (0u8..).zip(self.azimuths.iter().zip(&mut angles)) {
            let pose = self.arm_pose(*azimuth, &point);
            let ratio_squared = pose.ratio_squared;
            if ratio_squared.is_nan() || ratio_squared < 0.0 {
                return Err(KinematicsError::Unreachable {
                    joint: arm,
                    ratio_squared,
                });
            }
            if ratio_squared < RATIO_SINGULAR * RATIO_SINGULAR {
                let ratio = root(ratio_squared);
                return Err(KinematicsError::Singular { joint: arm, ratio });
            }
            let angle_rad = libm::atan2(pose.sine, pose.cosine);
            if !(angle_rad >= low_rad && angle_rad <= high_rad) {
                return Err(KinematicsError::Range {
                    joint: arm,
                    angle_rad,
                    low_rad,
                    high_rad,
                });
            }
            *angle = angle_rad;
        }
        Ok(angles)
    }

    /// Arm angles without checks, for admitted points; the nearest real pose if there is no solution.
    pub(super) fn angles(&self, point: &Vector) -> [f64; ARMS] {
        self.azimuths.map(|azimuth| {
            let pose = self.arm_pose(azimuth, point);
            libm::atan2(pose.sine, pose.cosine)
        })
    }

    /// Derivatives of the arm angles along a path through `point` with the unit tangent `tangent` and the curvature
    /// vector `bend` (1/mm). Finite wherever [`Delta::inverse`] has a solution.
    pub(super) fn rows(&self, point: &Vector, tangent: &Vector, bend: &Vector) -> JointRows {
        let mut rows = JointRows::default();
        for ((azimuth, slope), second) in self.azimuths.iter().zip(&mut rows.slope).zip(&mut rows.bend) {
            let ArmPose {
                cosine, sine, forearm, ..
            } = self.arm_pose(*azimuth, point);
            let upper = self.upper_arm_mm;
            let elbow = [-upper * sine, -upper * cosine];
            let turned = [-upper * cosine, upper * sine];
            let inverse = 1.0 / (forearm[0] * elbow[0] + forearm[2] * elbow[1]);
            let first = into_plane(*azimuth, tangent);
            let change = into_plane(*azimuth, bend);
            *slope = dot(&forearm, &first) * inverse;
            let relative = [first[0] - elbow[0] * *slope, first[1], first[2] - elbow[1] * *slope];
            let turning = (forearm[0] * turned[0] + forearm[2] * turned[1]) * *slope * *slope;
            *second = (dot(&forearm, &change) + dot(&relative, &relative) - turning) * inverse;
        }
        rows
    }

    /// Distance from the singularities at a position; the ratio is negative where an arm does not reach the position.
    pub(super) fn conditioning(&self, position: &Position) -> Conditioning {
        let point = Vector::from(*position);
        let poses = self.azimuths.map(|azimuth| self.arm_pose(azimuth, &point));
        let mut ratio = (0, f64::INFINITY);
        let (mut change, mut angle_change) = (Change::default(), 0.0_f64);
        let mut units = [[0.0; 3]; ARMS];
        for (arm, ((pose, azimuth), unit)) in (0u8..).zip(poses.iter().zip(&self.azimuths).zip(&mut units)) {
            let signed = if pose.ratio_squared < 0.0 {
                -root(-pose.ratio_squared)
            } else {
                root(pose.ratio_squared)
            };
            if signed < ratio.1 {
                ratio = (arm, signed);
            }
            let of_arm = self.change(pose, signed);
            angle_change = angle_change.max(of_arm.angle);
            change.ratio = change.ratio.max(of_arm.ratio);
            change.determinant += of_arm.determinant;
            let (cosine, sine) = *azimuth;
            let [u, y, w] = pose.forearm;
            *unit = scale(
                &[u * cosine - y * sine, u * sine + y * cosine, w],
                1.0 / self.forearm_mm,
            );
        }
        change.angles = [angle_change; ARMS];
        Conditioning {
            ratio,
            determinant: dot(&units[0], &cross(&units[1], &units[2])).abs(),
            change,
        }
    }

    /// Whether every arm's angle is in its range and the singularities are at least [`CONDITIONING_MIN`] away. Costs a
    /// fifth of [`Delta::inverse`] and [`Delta::conditioning`], which also give the reason.
    pub(super) fn clears(&self, point: &Vector, ranges: &JointRanges) -> bool {
        let ConditioningMin { ratio, determinant } = CONDITIONING_MIN;
        let mut forearms = [[0.0; 3]; ARMS];
        for (((cosine, sine), range), forearm) in self.azimuths.iter().zip(&ranges.turned).zip(&mut forearms) {
            let pose = self.arm_pose((*cosine, *sine), point);
            let clear = pose.ratio_squared >= ratio * ratio && range.contains(pose.cosine, pose.sine);
            if !clear {
                return false;
            }
            let [u, y, w] = pose.forearm;
            *forearm = [u * cosine - y * sine, u * sine + y * cosine, w];
        }
        let [first, second, third] = &forearms;
        let volume = self.forearm_mm * self.forearm_mm * self.forearm_mm;
        dot(first, &cross(second, third)).abs() >= determinant * volume
    }

    /// An arm's bounds. The angle's gradient is f / g with |f| the forearm's length and g = La D; the ratio is the sine
    /// of the angle whose cosine is K/A, with the gradients (u, y, w) / La of K and 1 of A; and a forearm's unit vector
    /// turns no faster than its two ends move apart.
    fn change(&self, pose: &ArmPose, ratio: f64) -> ArmChange {
        if ratio < RATIO_SINGULAR {
            return ArmChange {
                angle: f64::INFINITY,
                ratio: f64::INFINITY,
                determinant: f64::INFINITY,
            };
        }
        let across = pose.forearm[1];
        let distance = root(pose.distance_squared);
        let height = ratio * distance;
        let whole = root(pose.distance_squared + across * across);
        let cosine = root(1.0 - ratio * ratio);
        ArmChange {
            angle: self.forearm_mm / (self.upper_arm_mm * height),
            ratio: cosine / ratio * (whole / self.upper_arm_mm + cosine) / distance,
            determinant: 1.0 / self.forearm_mm + 1.0 / height,
        }
    }

    /// Position of the platform for joint angles. Any angles are accepted; the fourth axis does not affect the
    /// position.
    ///
    /// # Errors
    /// [`KinematicsError::NotFinite`], or [`KinematicsError::Apart`] where the forearms do not meet.
    pub(super) fn forward(&self, joints: &JointAngles) -> Result<Position, KinematicsError> {
        let [first, second, third, fourth] = joints.0;
        if ![first, second, third, fourth].iter().all(|angle| angle.is_finite()) {
            return Err(KinematicsError::NotFinite);
        }
        let centre = |(cosine, sine): (f64, f64), angle: f64| -> Vector {
            let outwards = self.upper_arm_mm * libm::cos(angle) - self.offset_mm;
            [
                outwards * cosine,
                outwards * sine,
                -self.upper_arm_mm * libm::sin(angle),
            ]
        };
        let [one, two, three] = self.azimuths;
        let centres = [centre(one, first), centre(two, second), centre(three, third)];
        lower_meeting(&centres, self.forearm_mm)
            .map(Position::from)
            .ok_or(KinematicsError::Apart)
    }
}

fn into_plane((cosine, sine): (f64, f64), vector: &Vector) -> Vector {
    [
        vector[0] * cosine + vector[1] * sine,
        vector[1] * cosine - vector[0] * sine,
        vector[2],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robots::AXES;
    use crate::robots::vector::{add_scaled, length, subtract};

    fn robot() -> Delta {
        Delta::new(&DeltaGeometry::default()).unwrap()
    }

    fn positions() -> impl Iterator<Item = Position> {
        (0..24_000u32).map(|index| {
            let turn = f64::from(index % 60) * 0.1047;
            let radius = f64::from(index / 60 % 20) * 28.0;
            Position {
                x_mm: radius * libm::cos(turn),
                y_mm: radius * libm::sin(turn),
                z_mm: -960.0 + 13.0 * f64::from(index / 1200),
            }
        })
    }

    #[test]
    fn inverse_and_forward_agree_over_the_work_area() {
        let (robot, mut reached) = (robot(), 0);
        for position in positions() {
            let Ok([a, b, c]) = robot.inverse(&position) else {
                continue;
            };
            reached += 1;
            let back = robot.forward(&JointAngles([a, b, c, 1.7])).unwrap();
            let error = length(&subtract(&back.into(), &position.into()));
            assert!(error < 1.0e-9, "{position:?} comes back {error} mm away");
        }
        assert!(reached > 20_000, "only {reached} positions were reached");
    }

    #[test]
    fn equal_arm_angles_put_the_platform_on_the_axis() {
        let position = robot().forward(&JointAngles([0.5, 0.5, 0.5, 0.0])).unwrap();
        let expected = -350.0 * libm::sin(0.5) - libm::sqrt(640_000.0 - libm::pow(155.0 + 350.0 * libm::cos(0.5), 2.0));
        assert!(position.x_mm.abs() < 1.0e-9 && position.y_mm.abs() < 1.0e-9);
        assert!((position.z_mm - expected).abs() < 1.0e-9);
    }

    /// First and second derivative by differences of fourth order over values `step` apart.
    fn differences(values: [f64; 5], step: f64) -> [f64; 2] {
        let [far_before, before, here, after, far_after] = values;
        [
            (8.0 * (after - before) - (far_after - far_before)) / (12.0 * step),
            (16.0 * (after + before) - 30.0 * here - (far_after + far_before)) / (12.0 * step * step),
        ]
    }

    #[test]
    fn derivatives_along_a_path_agree_with_finite_differences() {
        let (robot, mut near_singular) = (robot(), 0);
        let bend = [0.004, -0.002, 0.003];
        let tangent = {
            let raw = cross(&bend, &[0.3, 1.0, 0.2]);
            scale(&raw, 1.0 / length(&raw))
        };
        for position in positions() {
            let point = Vector::from(position);
            let at = |s: f64| {
                let moved = add_scaled(&add_scaled(&point, &tangent, s), &bend, 0.5 * s * s);
                robot.inverse(&moved.into()).ok()
            };
            // Near a singularity, the angles bend more sharply the smaller the ratio D/A is.
            let ratio = robot.conditioning(&position).ratio.1;
            let step = 0.2 * ratio.min(1.0);
            let around = [-2.0, -1.0, 0.0, 1.0, 2.0].map(|n| at(n * step));
            let ([Some(a), Some(b), Some(c), Some(d), Some(e)], true) = (around, ratio > 0.02) else {
                continue;
            };
            near_singular += u32::from(ratio < 0.3);
            let rows = robot.rows(&point, &tangent, &bend);
            for arm in 0..ARMS {
                let [slope, second] = differences([a, b, c, d, e].map(|angles| angles[arm]), step);
                let [slope_error, bend_error] = [(slope, rows.slope[arm]), (second, rows.bend[arm])]
                    .map(|(difference, row)| (difference - row).abs() / (1.0e-3 + row.abs()));
                assert!(
                    slope_error < 1.0e-6 && bend_error < 1.0e-6,
                    "{position:?} arm {arm}, D/A {ratio}"
                );
            }
        }
        assert!(near_singular > 10, "only {near_singular} positions near a singularity");
    }

    #[test]
    fn what_cannot_be_reached_names_the_arm_and_the_reason() {
        let robot = robot();
        let at = |x_mm, y_mm, z_mm| robot.inverse(&Position { x_mm, y_mm, z_mm });
        assert_eq!(at(f64::NAN, 0.0, -800.0), Err(KinematicsError::NotFinite));
        assert!(matches!(
            at(-1500.0, 0.0, -800.0),
            Err(KinematicsError::Unreachable { joint: 0, .. })
        ));
        assert!(matches!(
            at(0.0, 0.0, -430.0),
            Err(KinematicsError::Range { joint: 0, .. })
        ));
        assert_eq!(
            robot.forward(&JointAngles([f64::INFINITY; AXES])),
            Err(KinematicsError::NotFinite)
        );
    }

    #[test]
    fn nothing_changes_faster_over_a_displacement_than_its_bound() {
        const STEP_MM: f64 = 0.05;
        // For the change of the bounds themselves over the step.
        const ROOM: f64 = 1.02;
        let (robot, mut checked) = (robot(), 0);
        for position in positions().step_by(7) {
            let (here, angles) = (robot.conditioning(&position), robot.inverse(&position));
            let (Ok(angles), true) = (angles, here.ratio.1 > 0.1) else {
                continue;
            };
            let directions = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.6, -0.64, 0.48]];
            for direction in directions {
                let moved = add_scaled(&position.into(), &direction, STEP_MM).into();
                let there = robot.conditioning(&moved);
                let Ok(angles_there) = robot.inverse(&moved) else {
                    continue;
                };
                let bound = |change: f64| ROOM * STEP_MM * change;
                for (angle, angle_there) in angles.iter().zip(angles_there) {
                    assert!(
                        (angle_there - angle).abs() <= bound(here.change.angles[0]),
                        "angle at {position:?}"
                    );
                }
                let ratio = (there.ratio.1 - here.ratio.1).abs();
                assert!(ratio <= bound(here.change.ratio), "ratio at {position:?}");
                let determinant = (there.determinant - here.determinant).abs();
                assert!(
                    determinant <= bound(here.change.determinant),
                    "determinant at {position:?}"
                );
                checked += 1;
            }
        }
        assert!(checked > 5_000, "only {checked} displacements");
    }

    #[test]
    fn dimensions_that_do_not_form_a_robot_are_refused() {
        let refuse = |change: fn(&mut DeltaGeometry)| {
            let mut geometry = DeltaGeometry::default();
            change(&mut geometry);
            Delta::new(&geometry).unwrap_err()
        };
        assert_eq!(refuse(|g| g.forearm_mm = f64::NAN), GeometryError::NotFinite);
        assert!(matches!(
            refuse(|g| g.forearm_mm = 300.0),
            GeometryError::Delta(DeltaError::Lengths { .. })
        ));
        assert!(matches!(
            refuse(|g| g.arm_azimuths_deg = [0.0, 120.0, 120.0]),
            GeometryError::Delta(DeltaError::Azimuths { .. })
        ));
        assert!(matches!(
            refuse(|g| g.arm_range_rad = [1.0, -1.0]),
            GeometryError::Range { .. }
        ));
    }
}
