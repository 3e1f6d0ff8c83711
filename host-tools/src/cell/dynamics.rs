//! Dynamics of the robot at its joints, for drives in torque mode behind first-order velocity loops.
//!
//! The main axes are coupled by the mechanism, the others move alone; friction acts on every joint. A joint under a
//! velocity loop follows its loop, and only its acceleration acts on the others. Dry friction is smooth: it vanishes with
//! the speed. Inertias are plausible for an IRB 340, not measured.
//!
//! Invariant: joints that are not in torque mode are not moved here.

use super::joint::Joint;
use super::mechanism::{Equation, MainAxes, Mechanism, combine};
use super::physics::Friction;
use etherpen::robots::MAIN_AXES;
use etherpen_segment::STEP_S;

/// Inertia of a motor's rotor, kg m2.
pub(super) const ROTOR_KG_M2: f64 = 2.0e-4;
/// Inertia at the joint of the fourth axis and of drives without a load, kg m2.
pub(super) const ALONE_KG_M2: f64 = 0.05;
/// Speed scale of dry friction, rad/s: it grows with tanh(speed / scale).
const COULOMB_RAD_S: f64 = 0.02;
const SUBSTEPS: u32 = 4;

/// Loads on the joints.
#[derive(Clone, Debug)]
pub(super) struct Dynamics {
    mechanism: Mechanism,
    friction: Friction,
    speeds_before: MainAxes,
}

impl Dynamics {
    pub(super) fn new(mechanism: Mechanism, friction: Friction) -> Self {
        Self {
            mechanism,
            friction,
            speeds_before: [0.0; MAIN_AXES],
        }
    }

    /// Moves the joints that are in torque mode over one millisecond; joints are the axes in their order.
    pub(super) fn step(&mut self, joints: &mut [Joint<'_, '_>]) {
        let (main, others) = joints.split_at_mut_checked(MAIN_AXES).unwrap_or((&mut [], &mut []));
        for joint in others {
            if let Some(torque_nm) = joint.torque_nm() {
                let inertia = ALONE_KG_M2 + joint.inertia_kg_m2(ROTOR_KG_M2);
                let acceleration = (torque_nm - self.friction_nm(joint.speed_rad_s())) / inertia;
                joint.accelerate(acceleration, STEP_S);
            }
        }
        if main.iter().any(|joint| joint.torque_nm().is_some()) {
            self.step_main_axes(main);
        }
        for (before, joint) in self.speeds_before.iter_mut().zip(main.iter()) {
            *before = joint.speed_rad_s();
        }
    }

    fn step_main_axes(&mut self, joints: &mut [Joint<'_, '_>]) {
        let of = |joints: &[Joint<'_, '_>], value: fn(&Joint<'_, '_>) -> f64| -> MainAxes {
            let mut values = [0.0; MAIN_AXES];
            values
                .iter_mut()
                .zip(joints)
                .for_each(|(target, joint)| *target = value(joint));
            values
        };
        let mut torques = [None; MAIN_AXES];
        torques
            .iter_mut()
            .zip(joints.iter())
            .for_each(|(torque, joint)| *torque = joint.torque_nm());
        let mut imposed = of(joints, |joint| joint.speed_rad_s());
        for (speed, before) in imposed.iter_mut().zip(self.speeds_before) {
            *speed = (*speed - before) / STEP_S;
        }
        let rotor = of(joints, |joint| joint.inertia_kg_m2(ROTOR_KG_M2));
        let duration_s = STEP_S / f64::from(SUBSTEPS);
        for _ in 0..SUBSTEPS {
            let angles = of(joints, |joint| joint.angle_rad());
            let speeds = of(joints, |joint| joint.speed_rad_s());
            let accelerations = self.accelerations(angles, speeds, torques, imposed, rotor);
            for ((joint, torque), acceleration) in joints.iter_mut().zip(torques).zip(accelerations) {
                if torque.is_some() {
                    joint.accelerate(acceleration, duration_s);
                }
            }
        }
    }

    /// Accelerations of all main axes: solved for those with a torque, imposed for the others.
    pub(super) fn accelerations(
        &self,
        angles: MainAxes,
        speeds: MainAxes,
        torques: [Option<f64>; MAIN_AXES],
        imposed: MainAxes,
        rotor: MainAxes,
    ) -> MainAxes {
        let Equation {
            inertia,
            weight_nm,
            carried_nm,
        } = self.mechanism.equation(angles, speeds, rotor);
        let mut rows = [[0.0; MAIN_AXES + 1]; MAIN_AXES];
        for (i, (row, inertia)) in rows.iter_mut().zip(inertia).enumerate() {
            let pick = |values: &MainAxes| values.get(i).copied().unwrap_or(0.0);
            let Some(torque_nm) = torques.get(i).copied().flatten() else {
                row.iter_mut().skip(i).take(1).for_each(|diagonal| *diagonal = 1.0);
                row.iter_mut().skip(MAIN_AXES).for_each(|right| *right = pick(&imposed));
                continue;
            };
            row.iter_mut()
                .zip(inertia)
                .for_each(|(entry, inertia)| *entry = inertia);
            let right = torque_nm + pick(&weight_nm) - self.friction_nm(pick(&speeds)) - pick(&carried_nm);
            row.iter_mut().skip(MAIN_AXES).for_each(|entry| *entry = right);
        }
        solve(rows)
    }

    pub(super) fn friction_nm(&self, speed_rad_s: f64) -> f64 {
        self.friction.viscous_nm_s * speed_rad_s + self.friction.coulomb_nm * (speed_rad_s / COULOMB_RAD_S).tanh()
    }
}

/// Gauss-Jordan elimination without pivoting: the matrix is positive definite except for unit rows.
fn solve(mut rows: [[f64; MAIN_AXES + 1]; MAIN_AXES]) -> MainAxes {
    for pivot in 0..MAIN_AXES {
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
