//! A delta robot whose arms differ from each other.

use crate::calibration::JointPose;
use crate::random::Random;
use etherpen::config::Config;
use etherpen::robots::Geometry;

/// A delta robot with a length of its own for each arm. Its kinematics are three spheres, solved by Newton's method: no code of the
/// controller's.
pub(super) struct TrueDelta {
    azimuth_rad: [f64; 3],
    offset_mm: [f64; 3],
    upper_mm: [f64; 3],
    forearm_mm: [f64; 3],
    sync_rad: [f64; 3],
}

impl TrueDelta {
    pub(super) fn new(config: &Config, random: &mut Random) -> Self {
        let Geometry::Delta(delta) = config.geometry else {
            panic!("a delta robot");
        };
        let mut signed = |size: f64| if random.unit() < 0.5 { -size } else { size };
        let mut three = |value: f64, size: f64| [(); 3].map(|()| value + signed(size));
        Self {
            offset_mm: three(delta.base_radius_mm - delta.platform_radius_mm, 0.5),
            upper_mm: three(delta.upper_arm_mm, 0.5),
            forearm_mm: three(delta.forearm_mm, 0.5),
            azimuth_rad: {
                let off = three(0.0, 0.001);
                [0, 1, 2].map(|arm| delta.arm_azimuths_deg[arm].to_radians() + off[arm])
            },
            sync_rad: three(0.0, 0.002),
        }
    }

    /// Where the pen is when the controller believes the arms at these angles.
    pub(super) fn place(&self, believed: JointPose) -> [f64; 3] {
        let centre = |arm: usize| {
            let angle = believed[arm] + self.sync_rad[arm];
            let radius = self.offset_mm[arm] + self.upper_mm[arm] * angle.cos();
            let (sine, cosine) = self.azimuth_rad[arm].sin_cos();
            [radius * cosine, radius * sine, -self.upper_mm[arm] * angle.sin()]
        };
        let centres = [0, 1, 2].map(centre);
        let mut place = [0.0, 0.0, -850.0];
        for _ in 0..30 {
            let mut rows = [[0.0; 4]; 3];
            for (arm, row) in rows.iter_mut().enumerate() {
                let apart = [0, 1, 2].map(|axis| place[axis] - centres[arm][axis]);
                let square: f64 = apart.iter().map(|mm| mm * mm).sum();
                *row = [
                    2.0 * apart[0],
                    2.0 * apart[1],
                    2.0 * apart[2],
                    self.forearm_mm[arm].powi(2) - square,
                ];
            }
            let minor = |a: [f64; 3], b: [f64; 3]| {
                [
                    a[1] * b[2] - a[2] * b[1],
                    a[2] * b[0] - a[0] * b[2],
                    a[0] * b[1] - a[1] * b[0],
                ]
            };
            let [a, b, c] = rows.map(|row| [row[0], row[1], row[2]]);
            let (bc, ca, ab) = (minor(b, c), minor(c, a), minor(a, b));
            let determinant: f64 = (0..3).map(|axis| a[axis] * bc[axis]).sum();
            for (axis, value) in place.iter_mut().enumerate() {
                *value += (rows[0][3] * bc[axis] + rows[1][3] * ca[axis] + rows[2][3] * ab[axis]) / determinant;
            }
        }
        place
    }
}
