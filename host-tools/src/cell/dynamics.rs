//! Dynamics of the delta robot as the three arm joints feel it, for drives in torque mode.
//!
//! Half of each forearm's mass moves with the elbow, half with the platform, so the mechanism is three arms and a point
//! mass coupled by the platform's Jacobian: `M = diag(J) + m Jx^T Jx` (Codourey 1998). Gravity acts on arms and
//! platform, friction on the joints. A joint under a velocity loop moves as its loop says and only carries its
//! acceleration over to the others. Masses and inertias are plausible for an IRB 340, not measured.
//!
//! Invariant: joints that are not in torque mode are not moved here.

use super::drive::Drive;
use super::motor::STEP_S;
use etherpen::config::Geometry;
use etherpen::robot::{ARMS, AXES, Delta, JointAngles};

const GRAVITY_M_S2: f64 = 9.81;
const ARM_KG: f64 = 1.2;
const FOREARM_KG: f64 = 0.4;
const PLATFORM_KG: f64 = 0.6;
/// Inertia of a motor's rotor, kg m2.
const ROTOR_KG_M2: f64 = 2.0e-4;
/// Inertia of the fourth axis and of drives that move nothing, kg m2 at the joint.
const ALONE_KG_M2: f64 = 0.05;
const VISCOUS_NM_S: f64 = 0.05;
/// Speed at which dry friction is mostly there, rad/s.
const COULOMB_RAD_S: f64 = 0.02;
const SUBSTEPS: u32 = 4;
/// Steps of the numeric derivatives: radians, seconds.
const JACOBIAN_STEP_RAD: f64 = 1e-5;
const CURVATURE_STEP_S: f64 = 1e-4;

/// Angles or speeds of the three arms.
type Arms = [f64; ARMS];

/// What the joints feel.
#[derive(Clone, Debug)]
pub(super) struct Dynamics {
    delta: Option<Delta>,
    upper_arm_m: f64,
    dry_friction_nm: f64,
    speeds_before: Arms,
}

impl Dynamics {
    pub(super) fn new(geometry: &Geometry, dry_friction_nm: f64) -> Self {
        Self {
            delta: Delta::new(geometry).ok(),
            upper_arm_m: geometry.upper_arm_mm / 1000.0,
            dry_friction_nm,
            speeds_before: [0.0; ARMS],
        }
    }

    /// Moves the joints that are in torque mode over one millisecond; drives are the axes in their order.
    pub(super) fn step<'a>(&mut self, drives: impl Iterator<Item = &'a mut Drive>) {
        let mut drives: Vec<&mut Drive> = drives.collect();
        let (arms, others) = drives.split_at_mut_checked(ARMS).unwrap_or((&mut [], &mut []));
        for drive in others {
            if let Some(torque_nm) = drive.joint_torque_nm() {
                let inertia = ALONE_KG_M2 + drive.gear().powi(2) * ROTOR_KG_M2;
                let acceleration = (torque_nm - self.friction_nm(drive.joint_rad_s())) / inertia;
                drive.accelerate(acceleration, STEP_S);
            }
        }
        if arms.iter().any(|drive| drive.joint_torque_nm().is_some()) {
            self.step_arms(arms);
        }
        for (before, drive) in self.speeds_before.iter_mut().zip(arms.iter()) {
            *before = drive.joint_rad_s();
        }
    }

    fn step_arms(&mut self, drives: &mut [&mut Drive]) {
        let of = |drives: &[&mut Drive], value: fn(&Drive) -> f64| -> Arms {
            let mut values = [0.0; ARMS];
            values
                .iter_mut()
                .zip(drives)
                .for_each(|(target, drive)| *target = value(drive));
            values
        };
        let mut torques = [None; ARMS];
        torques
            .iter_mut()
            .zip(drives.iter())
            .for_each(|(torque, drive)| *torque = drive.joint_torque_nm());
        let mut imposed = of(drives, Drive::joint_rad_s);
        for (speed, before) in imposed.iter_mut().zip(self.speeds_before) {
            *speed = (*speed - before) / STEP_S;
        }
        let rotor = of(drives, |drive| drive.gear().powi(2) * ROTOR_KG_M2);
        let duration_s = STEP_S / f64::from(SUBSTEPS);
        for _ in 0..SUBSTEPS {
            let angles = of(drives, Drive::joint_rad);
            let speeds = of(drives, Drive::joint_rad_s);
            let accelerations = self.accelerations(angles, speeds, torques, imposed, rotor);
            for ((drive, torque), acceleration) in drives.iter_mut().zip(torques).zip(accelerations) {
                if torque.is_some() {
                    drive.accelerate(acceleration, duration_s);
                }
            }
        }
    }

    /// Accelerations of all arms: solved for those with a torque, imposed for the others.
    fn accelerations(
        &self,
        angles: Arms,
        speeds: Arms,
        torques: [Option<f64>; ARMS],
        imposed: Arms,
        rotor: Arms,
    ) -> Arms {
        let arm_m = self.upper_arm_m;
        let own = (ARM_KG / 3.0 + FOREARM_KG / 2.0) * arm_m * arm_m;
        let moment = (ARM_KG / 2.0 + FOREARM_KG / 2.0) * arm_m * GRAVITY_M_S2;
        let mass_kg = PLATFORM_KG + 3.0 * FOREARM_KG / 2.0;
        let (jacobian, curvature) = self.platform(angles, speeds).unwrap_or_default();
        let [cx, cy, cz] = curvature;
        let mut rows = [[0.0; ARMS + 1]; ARMS];
        for (i, row) in rows.iter_mut().enumerate() {
            let pick = |values: &Arms| values.get(i).copied().unwrap_or(0.0);
            let [x, y, z] = jacobian.get(i).copied().unwrap_or_default();
            let Some(torque_nm) = torques.get(i).copied().flatten() else {
                row.iter_mut().skip(i).take(1).for_each(|diagonal| *diagonal = 1.0);
                row.iter_mut().skip(ARMS).for_each(|right| *right = pick(&imposed));
                continue;
            };
            for (j, (entry, [u, v, w])) in row.iter_mut().zip(jacobian).enumerate() {
                let diagonal = if i == j { own + pick(&rotor) } else { 0.0 };
                *entry = diagonal + mass_kg * (x * u + y * v + z * w);
            }
            let weight_nm = moment * pick(&angles).cos() - mass_kg * GRAVITY_M_S2 * z;
            let carried_nm = mass_kg * (x * cx + y * cy + z * cz);
            let right = torque_nm + weight_nm - self.friction_nm(pick(&speeds)) - carried_nm;
            row.iter_mut().skip(ARMS).for_each(|entry| *entry = right);
        }
        solve(rows)
    }

    /// Columns of the platform's Jacobian, m/rad, and its acceleration at constant joint speeds, m/s2.
    fn platform(&self, angles: Arms, speeds: Arms) -> Option<([[f64; 3]; ARMS], [f64; 3])> {
        let here = self.position(angles)?;
        let mut columns = [[0.0; 3]; ARMS];
        for (arm, column) in columns.iter_mut().enumerate() {
            let mut moved = angles;
            moved
                .iter_mut()
                .skip(arm)
                .take(1)
                .for_each(|angle| *angle += JACOBIAN_STEP_RAD);
            let there = self.position(moved)?;
            *column = combine(there, here, |there, here| (there - here) / JACOBIAN_STEP_RAD);
        }
        let at = |time_s: f64| self.position(combine(angles, speeds, |angle, speed| angle + speed * time_s));
        let ends = combine(at(CURVATURE_STEP_S)?, at(-CURVATURE_STEP_S)?, |after, before| {
            after + before
        });
        let curvature = combine(ends, here, |ends, here| (ends - 2.0 * here) / CURVATURE_STEP_S.powi(2));
        Some((columns, curvature))
    }

    fn friction_nm(&self, speed_rad_s: f64) -> f64 {
        VISCOUS_NM_S * speed_rad_s + self.dry_friction_nm * (speed_rad_s / COULOMB_RAD_S).tanh()
    }

    fn position(&self, [a, b, c]: Arms) -> Option<[f64; 3]> {
        let mut joints = [0.0; AXES];
        joints
            .iter_mut()
            .zip([a, b, c])
            .for_each(|(joint, angle)| *joint = angle);
        let position = self.delta.as_ref()?.forward(&JointAngles(joints)).ok()?;
        Some([position.x_mm, position.y_mm, position.z_mm].map(|mm| mm / 1000.0))
    }
}

fn combine<const N: usize>(a: [f64; N], b: [f64; N], with: impl Fn(f64, f64) -> f64) -> [f64; N] {
    let mut result = a;
    result
        .iter_mut()
        .zip(b)
        .for_each(|(left, right)| *left = with(*left, right));
    result
}

/// Gauss-Jordan elimination without pivoting: the matrix is positive definite but for rows that are unit rows.
fn solve(mut rows: [[f64; ARMS + 1]; ARMS]) -> Arms {
    for pivot in 0..ARMS {
        let row = rows.get(pivot).copied().unwrap_or_default();
        let divisor = row.get(pivot).copied().unwrap_or(1.0);
        let row = row.map(|entry| entry / if divisor.abs() > 1e-12 { divisor } else { 1.0 });
        for (index, other) in rows.iter_mut().enumerate() {
            let factor = other.get(pivot).copied().unwrap_or(0.0);
            *other = if index == pivot {
                row
            } else {
                combine(*other, row, |entry, pivot| entry - factor * pivot)
            };
        }
    }
    rows.map(|[.., right]| right)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ANGLES: Arms = [0.3, 0.5, 0.4];

    fn weights_nm(dynamics: &Dynamics) -> Arms {
        let accelerations = |torques| dynamics.accelerations(ANGLES, [0.0; 3], torques, [0.0; 3], [0.03; 3]);
        let mut torques = [0.0; ARMS];
        for arm in 0..ARMS {
            let with = |torque_nm| {
                let mut of = [None; ARMS];
                of[arm] = Some(torque_nm);
                accelerations(of)[arm]
            };
            let (none, one) = (with(0.0), with(1.0));
            torques[arm] = -none / (one - none);
        }
        torques
    }

    #[test]
    fn arms_without_torque_fall_and_their_weight_holds_them() {
        let dynamics = Dynamics::new(&Geometry::default(), 0.3);
        let rotor = [0.03; ARMS];
        let falling = dynamics.accelerations(ANGLES, [0.0; 3], [Some(0.0); 3], [0.0; 3], rotor);
        assert!(
            falling.iter().all(|rad_s2| (5.0..120.0).contains(rad_s2)),
            "{falling:?}"
        );
        let torques = weights_nm(&dynamics).map(Some);
        let held = dynamics.accelerations(ANGLES, [0.0; 3], torques, [0.0; 3], rotor);
        assert!(held.iter().all(|rad_s2| rad_s2.abs() < 1e-6), "{held:?}");
    }

    #[test]
    fn work_of_torque_and_weight_becomes_kinetic_energy_and_friction() {
        let dynamics = Dynamics::new(&Geometry::default(), 0.3);
        let rotor = [0.03; ARMS];
        let (mut angles, mut speeds) = (ANGLES, [0.0; ARMS]);
        let torques = [4.0, -3.0, 2.0];
        let height = |angles: Arms| {
            let mass = PLATFORM_KG + 1.5 * FOREARM_KG;
            let arms: f64 = angles.iter().map(|angle| -angle.sin() * dynamics.upper_arm_m).sum();
            let platform = dynamics.position(angles).expect("reachable")[2];
            GRAVITY_M_S2 * (mass * platform + (ARM_KG + FOREARM_KG) / 2.0 * arms)
        };
        let start = height(angles);
        let (mut work, step_s) = (0.0, 2e-5);
        for _ in 0..5_000 {
            let acceleration = dynamics.accelerations(angles, speeds, torques.map(Some), [0.0; 3], rotor);
            for arm in 0..ARMS {
                let before = speeds[arm];
                speeds[arm] += acceleration[arm] * step_s;
                let mean = (before + speeds[arm]) / 2.0;
                angles[arm] += mean * step_s;
                work += (torques[arm] - dynamics.friction_nm(mean)) * mean * step_s;
            }
        }
        let (jacobian, _) = dynamics.platform(angles, speeds).expect("reachable");
        let own = (ARM_KG / 3.0 + FOREARM_KG / 2.0) * dynamics.upper_arm_m.powi(2) + 0.03;
        let arms: f64 = speeds.iter().map(|speed| own * speed * speed / 2.0).sum();
        let velocity: [f64; 3] =
            std::array::from_fn(|axis| (0..ARMS).map(|arm| jacobian[arm][axis] * speeds[arm]).sum());
        let mass = PLATFORM_KG + 1.5 * FOREARM_KG;
        let kinetic = arms + mass * velocity.map(|speed| speed * speed).iter().sum::<f64>() / 2.0;
        let balance = work + start - height(angles) - kinetic;
        assert!(kinetic > 0.5, "{kinetic} J");
        assert!(balance.abs() < 0.01 * kinetic, "{balance} J of {kinetic} J");
    }
}
