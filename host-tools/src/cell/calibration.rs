//! The difference between a robot and its configuration, and the paper on which it draws.
//!
//! Every dimension of the true robot differs from the configured one by the size that [`Calibration`] gives, with a
//! random sign. The paper lies where the robot believes it to be, as an operator would place it: position, rotation,
//! height and tilt fit best. What remains is the error of shape.

use super::physics::Calibration;
use crate::random::Random;
use etherpen::config::{Geometry, Paper};
use etherpen::robots::{AXES, DeltaGeometry, JointAngles, Kinematics, MAIN_AXES, Position};

/// Gives the signs of the errors random numbers of their own.
const SIGN_SEED: u64 = 0xCA11_B8A7;
/// Points a side of the grid on which the paper is placed; odd.
const GRID: i32 = 5;

/// Errors of the robot by its calibration.
#[derive(Clone, Copy, Debug)]
pub(super) struct Residues {
    /// True less believed joint angle, rad.
    pub(super) sync_rad: [f64; AXES],
    /// The true mechanism; `None` if its dimensions are the configured ones, as those of any kind but the delta are.
    pub(super) mechanism: Option<TrueDelta>,
}

impl Residues {
    /// The errors of one robot; the seed gives their signs.
    pub(super) fn new(geometry: &Geometry, calibration: &Calibration, seed: u64) -> Self {
        let mut random = Random::new(seed ^ SIGN_SEED);
        let mut signed = |size: f64| if random.unit() < 0.5 { -size } else { size };
        let sync_rad = [(); AXES].map(|()| signed(calibration.sync_mrad / 1000.0));
        let differs = calibration.length_mm > 0.0 || calibration.azimuth_mrad > 0.0;
        let mechanism = match geometry {
            Geometry::Delta(dimensions) if differs => {
                let mut arms = TrueDelta::new(dimensions).arms;
                for arm in &mut arms {
                    arm.offset_mm += signed(calibration.length_mm);
                    arm.upper_arm_mm += signed(calibration.length_mm);
                    arm.forearm_mm += signed(calibration.length_mm);
                    arm.azimuth_rad += signed(calibration.azimuth_mrad / 1000.0);
                }
                Some(TrueDelta { arms })
            }
            _ => None,
        };
        Self { sync_rad, mechanism }
    }
}

/// One arm of a delta robot.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Arm {
    azimuth_rad: f64,
    /// Base radius less platform radius, mm.
    offset_mm: f64,
    upper_arm_mm: f64,
    forearm_mm: f64,
}

/// A delta robot whose arms differ from each other. Shares no code with the controller's kinematics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TrueDelta {
    arms: [Arm; MAIN_AXES],
}

impl TrueDelta {
    /// A robot with exactly these dimensions.
    pub(super) fn new(geometry: &DeltaGeometry) -> Self {
        Self {
            arms: geometry.arm_azimuths_deg.map(|azimuth_deg| Arm {
                azimuth_rad: azimuth_deg.to_radians(),
                offset_mm: geometry.base_radius_mm - geometry.platform_radius_mm,
                upper_arm_mm: geometry.upper_arm_mm,
                forearm_mm: geometry.forearm_mm,
            }),
        }
    }

    /// Position of the platform; `None` if the forearms do not meet.
    ///
    /// Trilateration: the platform's centre is at the forearm's length from each elbow, which is moved inwards by the
    /// platform's radius.
    pub(super) fn forward(&self, joints: &JointAngles) -> Option<Position> {
        let [one, two, three] = self.arms;
        let [q1, q2, q3, ..] = joints.0;
        let [first, second, third] = [(one, q1), (two, q2), (three, q3)].map(|(arm, angle_rad)| {
            let radius_mm = arm.offset_mm + arm.upper_arm_mm * angle_rad.cos();
            [
                radius_mm * arm.azimuth_rad.cos(),
                radius_mm * arm.azimuth_rad.sin(),
                -arm.upper_arm_mm * angle_rad.sin(),
            ]
        });
        let (to_second, to_third) = (minus(second, first), minus(third, first));
        let d = dot(to_second, to_second).sqrt();
        let ex = to_second.map(|value| value / d);
        let i = dot(ex, to_third);
        let across = minus(to_third, ex.map(|value| value * i));
        let j = dot(across, across).sqrt();
        let ey = across.map(|value| value / j);
        let ez = cross(ex, ey);
        let [r1, r2, r3] = [one, two, three].map(|arm| arm.forearm_mm * arm.forearm_mm);
        let x = (r1 - r2 + d * d) / (2.0 * d);
        let y = (r1 - r3 + i * i + j * j - 2.0 * i * x) / (2.0 * j);
        let square = r1 - x * x - y * y;
        // The platform hangs below the elbows.
        let z = if ez[2] > 0.0 { -square.sqrt() } else { square.sqrt() };
        let along = |axis: usize| Some(first.get(axis)? + x * ex.get(axis)? + y * ey.get(axis)? + z * ez.get(axis)?);
        let position = Position {
            x_mm: along(0)?,
            y_mm: along(1)?,
            z_mm: along(2)?,
        };
        (position.x_mm + position.y_mm + position.z_mm)
            .is_finite()
            .then_some(position)
    }
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Where the paper lies under a robot that differs from its configuration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Placing {
    centre_mm: [f64; 2],
    /// True less intended position of the centre, mm.
    shift_mm: [f64; 3],
    cosine: f64,
    sine: f64,
    /// Rise of the paper in x and y, mm for 1 mm.
    tilt: [f64; 2],
}

impl Placing {
    /// The paper under a robot with these errors; `None` if the robot does not reach all of the sheet.
    pub(super) fn new(geometry: &Geometry, paper: &Paper, residues: &Residues) -> Option<Self> {
        let believed = Kinematics::new(geometry).ok()?;
        let mut pairs = Vec::new();
        for (row, column) in (0..GRID * GRID).map(|point| (point / GRID - GRID / 2, point % GRID - GRID / 2)) {
            let offset_mm = [column, row].map(|place| f64::from(place) / f64::from(GRID - 1));
            let offset_mm = [offset_mm[0] * paper.size_mm[0], offset_mm[1] * paper.size_mm[1]];
            let intended = Position {
                x_mm: paper.centre_mm[0] + offset_mm[0],
                y_mm: paper.centre_mm[1] + offset_mm[1],
                z_mm: paper.pen_down_z_mm,
            };
            let mut joints = [0.0; AXES];
            let angles = believed.inverse(&intended).ok()?;
            for ((joint, angle_rad), sync_rad) in joints.iter_mut().zip(angles).zip(residues.sync_rad) {
                *joint = angle_rad + sync_rad;
            }
            let joints = JointAngles(joints);
            let actual = match &residues.mechanism {
                Some(truth) => truth.forward(&joints),
                None => believed.forward(&joints).ok(),
            }?;
            let error_mm = [
                actual.x_mm - intended.x_mm,
                actual.y_mm - intended.y_mm,
                actual.z_mm - intended.z_mm,
            ];
            pairs.push((offset_mm, error_mm));
        }
        Some(Self::fit(paper.centre_mm, &pairs))
    }

    /// The best fit by least squares: pairs of an offset from the centre and the error there, on a symmetric grid.
    fn fit(centre_mm: [f64; 2], pairs: &[([f64; 2], [f64; 3])]) -> Self {
        let sum = |of: fn(&[f64; 2], &[f64; 3]) -> f64| -> f64 { pairs.iter().map(|(at, error)| of(at, error)).sum() };
        let count = sum(|_, _| 1.0);
        let shift_mm = [
            sum(|_, error| error[0]),
            sum(|_, error| error[1]),
            sum(|_, error| error[2]),
        ];
        let sine = sum(|at, error| at[0] * error[1] - at[1] * error[0]);
        let cosine = sum(|at, error| at[0] * (at[0] + error[0]) + at[1] * (at[1] + error[1]));
        let tilt = [
            sum(|at, error| at[0] * error[2]) / sum(|at, _| at[0] * at[0]),
            sum(|at, error| at[1] * error[2]) / sum(|at, _| at[1] * at[1]),
        ];
        let length = sine.hypot(cosine);
        Self {
            centre_mm,
            shift_mm: shift_mm.map(|value| value / count),
            cosine: cosine / length,
            sine: sine / length,
            tilt,
        }
    }

    /// A true position in the frame of the paper, where the robot believes it to be.
    pub(super) fn on_paper(&self, position: Position) -> Position {
        let x_mm = position.x_mm - self.centre_mm[0] - self.shift_mm[0];
        let y_mm = position.y_mm - self.centre_mm[1] - self.shift_mm[1];
        let (x_mm, y_mm) = (
            self.cosine * x_mm + self.sine * y_mm,
            self.cosine * y_mm - self.sine * x_mm,
        );
        Position {
            x_mm: self.centre_mm[0] + x_mm,
            y_mm: self.centre_mm[1] + y_mm,
            z_mm: position.z_mm - self.shift_mm[2] - self.tilt[0] * x_mm - self.tilt[1] * y_mm,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::physics::Physics;

    #[test]
    fn a_robot_without_errors_stands_where_the_controller_computes() {
        let geometry = Geometry::default();
        let (truth, believed) = (
            TrueDelta::new(&DeltaGeometry::default()),
            Kinematics::new(&geometry).expect("valid"),
        );
        for (a, b, c) in [(0.3, 0.3, 0.3), (0.9, 0.1, -0.2), (0.0, 1.2, 0.5)] {
            let joints = JointAngles([a, b, c, 0.0]);
            let expected = believed.forward(&joints).expect("a pose");
            let position = truth.forward(&joints).expect("a pose");
            let error = (position.x_mm - expected.x_mm)
                .hypot(position.y_mm - expected.y_mm)
                .hypot(position.z_mm - expected.z_mm);
            assert!(error < 1e-9, "{error} mm");
        }
    }

    #[test]
    fn forearms_that_do_not_meet_hold_no_platform() {
        let short = DeltaGeometry {
            forearm_mm: 100.0,
            ..DeltaGeometry::default()
        };
        assert_eq!(TrueDelta::new(&short).forward(&JointAngles([0.3; AXES])), None);
    }

    #[test]
    fn the_errors_have_their_sizes_and_the_seed_gives_their_signs() {
        let calibration = Physics::PESSIMISTIC.calibration;
        let geometry = Geometry::default();
        let residues = Residues::new(&geometry, &calibration, 1);
        assert!(residues.sync_rad.iter().all(|rad| rad.abs() == 0.002));
        let truth = residues.mechanism.expect("errors");
        for (arm, ideal) in truth.arms.iter().zip(TrueDelta::new(&DeltaGeometry::default()).arms) {
            for error_mm in [
                arm.offset_mm - ideal.offset_mm,
                arm.upper_arm_mm - ideal.upper_arm_mm,
                arm.forearm_mm - ideal.forearm_mm,
            ] {
                assert!((error_mm.abs() - 0.5).abs() < 1e-9);
            }
            assert!(((arm.azimuth_rad - ideal.azimuth_rad).abs() - 0.001).abs() < 1e-12);
        }
        let signs = |seed| Residues::new(&geometry, &calibration, seed).sync_rad;
        assert_eq!(signs(1), residues.sync_rad);
        assert!((2..10).any(|seed| signs(seed) != signs(1)));
    }

    #[test]
    fn the_paper_takes_up_position_rotation_height_and_tilt_and_leaves_the_shape() {
        // A rigid motion of the sheet vanishes.
        let (angle, tilt) = (0.01_f64, [0.002, -0.003]);
        let moved = |[x, y]: [f64; 2]| {
            [
                angle.cos() * x - angle.sin() * y + 1.0,
                angle.sin() * x + angle.cos() * y - 2.0,
                tilt[0] * x + tilt[1] * y + 0.5,
            ]
        };
        let grid = (0..25).map(|point| [f64::from(point % 5 - 2) * 50.0, f64::from(point / 5 - 2) * 50.0]);
        let pairs: Vec<_> = grid.map(|at| (at, minus(moved(at), [at[0], at[1], 0.0]))).collect();
        let placing = Placing::fit([10.0, 20.0], &pairs);
        let [x_mm, y_mm, z_mm] = moved([30.0, -70.0]);
        let position = placing.on_paper(Position {
            x_mm: 10.0 + x_mm,
            y_mm: 20.0 + y_mm,
            z_mm: z_mm - 850.0,
        });
        let error = (position.x_mm - 40.0)
            .hypot(position.y_mm + 50.0)
            .hypot(position.z_mm + 850.0);
        assert!(error < 1e-9, "{error} mm");
    }

    #[test]
    fn pessimistic_residues_leave_an_error_of_shape_of_tenths_of_a_millimetre() {
        let (geometry, paper) = (Geometry::default(), Paper::default());
        for seed in 1..=20 {
            let residues = Residues::new(&geometry, &Physics::PESSIMISTIC.calibration, seed);
            let placing = Placing::new(&geometry, &paper, &residues).expect("reachable");
            let believed = Kinematics::new(&geometry).expect("valid");
            let mut worst: f64 = 0.0;
            for [x_mm, y_mm] in [[-90.0, -90.0], [0.0, 0.0], [90.0, -90.0], [-90.0, 90.0], [90.0, 90.0]] {
                let position = Position {
                    x_mm,
                    y_mm,
                    z_mm: paper.pen_down_z_mm,
                };
                let [a, b, c] = believed.inverse(&position).expect("reachable");
                let [ea, eb, ec, _] = residues.sync_rad;
                let truth = residues.mechanism.expect("errors");
                let actual = truth
                    .forward(&JointAngles([a + ea, b + eb, c + ec, 0.0]))
                    .expect("a pose");
                let drawn = placing.on_paper(actual);
                worst = worst.max((drawn.x_mm - x_mm).hypot(drawn.y_mm - y_mm));
                assert!(
                    (drawn.z_mm - paper.pen_down_z_mm).abs() < 0.3,
                    "seed {seed}: the pen lifts off"
                );
            }
            assert!((0.01..2.0).contains(&worst), "seed {seed}: {worst} mm");
        }
    }
}
