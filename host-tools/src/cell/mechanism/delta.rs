//! The delta robot's mechanism: three arms that hold a platform with their forearms.
//!
//! Half of each forearm's mass moves with the elbow, half with the platform, so the mechanism is three arms and a point
//! mass coupled by the platform's Jacobian: `M = diag(J) + m Jx^T Jx` (Codourey 1998). Gravity acts on arms and
//! platform. Masses are plausible for an IRB 340, not measured.

use super::{Equation, MainAxes, combine};
use crate::cell::calibration::TrueDelta;
use etherpen::robots::{AXES, DeltaGeometry, Geometry, JointAngles, Kinematics, MAIN_AXES, Position};

/// Number of arms, which are the main axes.
const ARMS: usize = MAIN_AXES;
const GRAVITY_M_S2: f64 = 9.81;
const ARM_KG: f64 = 1.2;
const FOREARM_KG: f64 = 0.4;
const PLATFORM_KG: f64 = 0.6;
/// Distance of the mechanical end stops beyond the ends of the arm range, radians.
const END_STOP_RAD: f64 = 0.05;
/// Steps of the numeric derivatives: radians, seconds.
const JACOBIAN_STEP_RAD: f64 = 1e-5;
const CURVATURE_STEP_S: f64 = 1e-4;

/// A delta robot; without a valid geometry it has no platform.
#[derive(Clone, Debug)]
pub(in crate::cell) struct Delta {
    kinematics: Option<Kinematics>,
    /// The true dimensions, where they differ from the configured ones.
    differing: Option<TrueDelta>,
    upper_arm_m: f64,
    payload_kg: f64,
    ranges_rad: [[f64; 2]; ARMS],
}

impl Delta {
    pub(super) fn new(dimensions: &DeltaGeometry) -> Self {
        let geometry = Geometry::Delta(*dimensions);
        Self {
            kinematics: Kinematics::new(&geometry).ok(),
            differing: None,
            payload_kg: 0.0,
            upper_arm_m: dimensions.upper_arm_mm / 1000.0,
            ranges_rad: geometry.ranges_rad(),
        }
    }

    /// This robot with a load at its platform, and with other dimensions than the configured ones.
    pub(super) fn with(self, payload_kg: f64, differing: Option<TrueDelta>) -> Self {
        Self {
            payload_kg,
            differing,
            ..self
        }
    }

    pub(super) fn platform(&self, joints: &JointAngles) -> Option<Position> {
        match &self.differing {
            Some(differing) => differing.forward(joints),
            None => self.kinematics.as_ref()?.forward(joints).ok(),
        }
    }

    pub(super) fn end_stops_rad(&self) -> [[f64; 2]; ARMS] {
        self.ranges_rad
            .map(|[low, high]| [low - END_STOP_RAD, high + END_STOP_RAD])
    }

    pub(super) fn equation(&self, angles: MainAxes, speeds: MainAxes, rotor: MainAxes) -> Equation {
        let arm_m = self.upper_arm_m;
        let own = (ARM_KG / 3.0 + FOREARM_KG / 2.0) * arm_m * arm_m;
        let moment = (ARM_KG / 2.0 + FOREARM_KG / 2.0) * arm_m * GRAVITY_M_S2;
        let mass_kg = PLATFORM_KG + 3.0 * FOREARM_KG / 2.0 + self.payload_kg;
        let (jacobian, [cx, cy, cz]) = self.jacobian(angles, speeds).unwrap_or_default();
        let mut equation = Equation {
            inertia: [[0.0; ARMS]; ARMS],
            weight_nm: [0.0; ARMS],
            carried_nm: [0.0; ARMS],
        };
        let results = equation.weight_nm.iter_mut().zip(&mut equation.carried_nm);
        let rows = equation.inertia.iter_mut().zip(results);
        for (i, ((row, (weight_nm, carried_nm)), [x, y, z])) in rows.zip(jacobian).enumerate() {
            let pick = |values: &MainAxes| values.get(i).copied().unwrap_or(0.0);
            for (j, (entry, [u, v, w])) in row.iter_mut().zip(jacobian).enumerate() {
                let diagonal = if i == j { own + pick(&rotor) } else { 0.0 };
                *entry = diagonal + mass_kg * (x * u + y * v + z * w);
            }
            *weight_nm = moment * pick(&angles).cos() - mass_kg * GRAVITY_M_S2 * z;
            *carried_nm = mass_kg * (x * cx + y * cy + z * cz);
        }
        equation
    }

    /// Columns of the platform's Jacobian, m/rad, and its acceleration at constant joint speeds, m/s2.
    fn jacobian(&self, angles: MainAxes, speeds: MainAxes) -> Option<([[f64; 3]; MAIN_AXES], [f64; 3])> {
        let here = self.position(angles)?;
        let mut columns = [[0.0; 3]; MAIN_AXES];
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

    fn position(&self, [a, b, c]: MainAxes) -> Option<[f64; 3]> {
        let mut joints = [0.0; AXES];
        joints
            .iter_mut()
            .zip([a, b, c])
            .for_each(|(joint, angle)| *joint = angle);
        let position = self.platform(&JointAngles(joints))?;
        Some([position.x_mm, position.y_mm, position.z_mm].map(|mm| mm / 1000.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::dynamics::Dynamics;
    use crate::cell::mechanism::Mechanism;
    use crate::cell::physics::Friction;

    const ANGLES: MainAxes = [0.3, 0.5, 0.4];

    fn weights_nm(dynamics: &Dynamics) -> MainAxes {
        let accelerations = |torques| dynamics.accelerations(ANGLES, [0.0; 3], torques, [0.0; 3], [0.03; 3]);
        let mut torques = [0.0; MAIN_AXES];
        for arm in 0..MAIN_AXES {
            let with = |torque_nm| {
                let mut of = [None; MAIN_AXES];
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
        let dynamics = Dynamics::new(Mechanism::new(&Geometry::default()), Friction::default());
        let rotor = [0.03; MAIN_AXES];
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
    fn a_payload_loads_the_arms_as_virtual_work_says() {
        // Torques that hold the arms, without and with 1 kg, from the gradient of the potential energy of uniform rods.
        let poses = [
            ([0.0, 0.0, -850.0], [3.975, 3.975, 3.975], [5.358, 5.358, 5.358]),
            ([200.0, 0.0, -850.0], [5.410, 2.904, 2.904], [7.733, 3.721, 3.721]),
            ([0.0, 200.0, -850.0], [3.829, 5.221, 2.174], [5.185, 7.421, 2.561]),
            ([-250.0, -350.0, -800.0], [0.982, 1.765, 6.564], [0.925, 2.168, 9.744]),
        ];
        let dimensions = DeltaGeometry::default();
        let geometry = Geometry::Delta(dimensions);
        let kinematics = Kinematics::new(&geometry).expect("valid");
        for ([x_mm, y_mm, z_mm], empty, loaded) in poses {
            let angles = kinematics.inverse(&Position { x_mm, y_mm, z_mm }).expect("reachable");
            for (payload_kg, expected) in [(0.0, empty), (1.0, loaded)] {
                let delta = Delta::new(&dimensions).with(payload_kg, None);
                let weight_nm = delta.equation(angles, [0.0; ARMS], [0.0; ARMS]).weight_nm;
                for (weight_nm, expected) in weight_nm.iter().zip(expected) {
                    assert!(
                        (weight_nm - expected).abs() < 2e-3,
                        "{x_mm} {y_mm} {z_mm}: {weight_nm} N m"
                    );
                }
            }
        }
    }

    #[test]
    fn work_of_torque_and_weight_becomes_kinetic_energy_and_friction() {
        let dynamics = Dynamics::new(Mechanism::new(&Geometry::default()), Friction::default());
        let delta = Delta::new(&DeltaGeometry::default());
        let rotor = [0.03; MAIN_AXES];
        let (mut angles, mut speeds) = (ANGLES, [0.0; MAIN_AXES]);
        let torques = [4.0, -3.0, 2.0];
        let height = |angles: MainAxes| {
            let mass = PLATFORM_KG + 1.5 * FOREARM_KG;
            let arms: f64 = angles.iter().map(|angle| -angle.sin() * delta.upper_arm_m).sum();
            let platform = delta.position(angles).expect("reachable")[2];
            GRAVITY_M_S2 * (mass * platform + (ARM_KG + FOREARM_KG) / 2.0 * arms)
        };
        let start = height(angles);
        let (mut work, step_s) = (0.0, 2e-5);
        for _ in 0..5_000 {
            let acceleration = dynamics.accelerations(angles, speeds, torques.map(Some), [0.0; 3], rotor);
            for arm in 0..MAIN_AXES {
                let before = speeds[arm];
                speeds[arm] += acceleration[arm] * step_s;
                let mean = (before + speeds[arm]) / 2.0;
                angles[arm] += mean * step_s;
                work += (torques[arm] - dynamics.friction_nm(mean)) * mean * step_s;
            }
        }
        let (jacobian, _) = delta.jacobian(angles, speeds).expect("reachable");
        let own = (ARM_KG / 3.0 + FOREARM_KG / 2.0) * delta.upper_arm_m.powi(2) + 0.03;
        let arms: f64 = speeds.iter().map(|speed| own * speed * speed / 2.0).sum();
        let velocity: [f64; 3] =
            std::array::from_fn(|axis| (0..MAIN_AXES).map(|arm| jacobian[arm][axis] * speeds[arm]).sum());
        let mass = PLATFORM_KG + 1.5 * FOREARM_KG;
        let kinetic = arms + mass * velocity.map(|speed| speed * speed).iter().sum::<f64>() / 2.0;
        let balance = work + start - height(angles) - kinetic;
        assert!(kinetic > 0.5, "{kinetic} J");
        assert!(balance.abs() < 0.01 * kinetic, "{balance} J of {kinetic} J");
    }
}
