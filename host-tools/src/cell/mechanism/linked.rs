//! Mechanisms of axes and links whose bodies move with the tool: gantry, CoreXY, SCARA and linear delta.
//!
//! Each direction of the tool carries a mass of its own: a gantry's beam moves in y only, its carriage in x and y, its tool in
//! all three. Links and carriages that do not move with the tool are inertias of the joints. With the tool's Jacobian J and the
//! masses m this is `M = diag(own) + Jx^T mx Jx + Jy^T my Jy + Jz^T mz Jz`. Masses are plausible for machines of their size, not
//! measured.

use super::{Equation, MainAxes, combine};
use etherpen::config::Geometry;
use etherpen::robots::{AXES, JointAngles, Kinematics, MAIN_AXES, Position};

const GRAVITY_M_S2: f64 = 9.81;
/// Distance of the mechanical end stops beyond the ends of the ranges, radians: 5 mm of a linear axis.
const END_STOP_RAD: f64 = 0.05;
/// Steps of the numeric derivatives: radians, seconds.
const JACOBIAN_STEP_RAD: f64 = 1e-4;
const CURVATURE_STEP_S: f64 = 1e-4;

/// Bodies of a machine.
#[derive(Clone, Copy, Debug)]
struct Bodies {
    /// Mass that moves in each direction of the tool, kg.
    directions_kg: [f64; 3],
    /// Inertia of each joint's own bodies, kg m2.
    own_kg_m2: MainAxes,
    /// Mass that gravity pulls down at the tool, kg; the rest hangs on counterweights or lies on rails.
    hanging_kg: f64,
    /// Weight of each joint's own bodies, N m.
    own_nm: MainAxes,
}

/// A beam of 4 kg, a carriage of 2 kg and a tool of 0.8 kg; the tool hangs on its screw.
const GANTRY: Bodies = Bodies {
    directions_kg: [2.8, 6.8, 0.8],
    own_kg_m2: [0.005; MAIN_AXES],
    hanging_kg: 0.8,
    own_nm: [0.0; MAIN_AXES],
};
/// A beam of 1 kg, a carriage of 0.5 kg and a tool of 0.4 kg: both motors stand.
const CORE_XY: Bodies = Bodies {
    directions_kg: [0.9, 1.9, 0.4],
    own_kg_m2: [0.003; MAIN_AXES],
    hanging_kg: 0.4,
    own_nm: [0.0; MAIN_AXES],
};
/// Links of 4 and 2 kg, and 2 kg of tool and spline shaft at their end.
const SCARA: Bodies = Bodies {
    directions_kg: [2.5, 2.5, 1.0],
    own_kg_m2: [0.12, 0.03, 0.005],
    hanging_kg: 1.0,
    own_nm: [0.0; MAIN_AXES],
};
/// Carriages of 0.4 kg with half of their rods, and a platform of 0.3 kg with the other halves.
const LINEAR_DELTA: Bodies = Bodies {
    directions_kg: [0.4; 3],
    own_kg_m2: [0.4 * 0.01; MAIN_AXES],
    hanging_kg: 0.4,
    // A carriage is 100 mm from the axis of the wheel that its joint is.
    own_nm: [-0.4 * GRAVITY_M_S2 * 0.1; MAIN_AXES],
};

/// A machine of these bodies; without valid dimensions it has no tool.
#[derive(Clone, Debug)]
pub(in crate::cell) struct Linked {
    kinematics: Option<Kinematics>,
    bodies: Bodies,
    payload_kg: f64,
    ranges_rad: [[f64; 2]; MAIN_AXES],
}

impl Linked {
    /// The mechanism of these dimensions, of any kind but the delta.
    pub(super) fn new(geometry: &Geometry) -> Self {
        Self {
            kinematics: Kinematics::new(geometry).ok(),
            bodies: match geometry {
                Geometry::Delta(_) | Geometry::Gantry(_) => GANTRY,
                Geometry::CoreXy(_) => CORE_XY,
                Geometry::Scara(_) => SCARA,
                Geometry::LinearDelta(_) => LINEAR_DELTA,
            },
            payload_kg: 0.0,
            ranges_rad: geometry.ranges_rad(),
        }
    }

    /// This machine with a load at its tool.
    pub(super) fn with(self, payload_kg: f64) -> Self {
        Self { payload_kg, ..self }
    }

    pub(super) fn tool(&self, joints: &JointAngles) -> Option<Position> {
        self.kinematics.as_ref()?.forward(joints).ok()
    }

    pub(super) fn end_stops_rad(&self) -> [[f64; 2]; MAIN_AXES] {
        self.ranges_rad
            .map(|[low, high]| [low - END_STOP_RAD, high + END_STOP_RAD])
    }

    pub(super) fn equation(&self, angles: MainAxes, speeds: MainAxes, rotor: MainAxes) -> Equation {
        let masses_kg = self.bodies.directions_kg.map(|mass_kg| mass_kg + self.payload_kg);
        let hanging_n = (self.bodies.hanging_kg + self.payload_kg) * GRAVITY_M_S2;
        let (jacobian, curvature) = self.jacobian(angles, speeds).unwrap_or_default();
        let along = |a: [f64; 3], b: [f64; 3]| -> f64 { (0..3).map(|d| masses_kg[d] * a[d] * b[d]).sum() };
        Equation {
            inertia: core::array::from_fn(|i| {
                core::array::from_fn(|j| {
                    let own = if i == j {
                        self.bodies.own_kg_m2[i] + rotor[i]
                    } else {
                        0.0
                    };
                    own + along(jacobian[i], jacobian[j])
                })
            }),
            weight_nm: core::array::from_fn(|i| self.bodies.own_nm[i] - hanging_n * jacobian[i][2]),
            carried_nm: jacobian.map(|column| along(column, curvature)),
        }
    }

    /// Columns of the tool's Jacobian, m/rad, and its acceleration at constant joint speeds, m/s2.
    fn jacobian(&self, angles: MainAxes, speeds: MainAxes) -> Option<([[f64; 3]; MAIN_AXES], [f64; 3])> {
        let here = self.position(angles)?;
        let mut columns = [[0.0; 3]; MAIN_AXES];
        for (axis, column) in columns.iter_mut().enumerate() {
            let mut moved = angles;
            moved[axis] += JACOBIAN_STEP_RAD;
            *column = combine(self.position(moved)?, here, |there, here| {
                (there - here) / JACOBIAN_STEP_RAD
            });
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
        joints[..MAIN_AXES].copy_from_slice(&[a, b, c]);
        let position = self.tool(&JointAngles(joints))?;
        Some([position.x_mm, position.y_mm, position.z_mm].map(|mm| mm / 1000.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::robots::Kind;

    #[test]
    fn power_of_joints_is_the_change_of_kinetic_energy_and_of_height() {
        for (kind, angles) in [
            (Kind::Gantry, [1.0, 2.0, -0.2]),
            (Kind::CoreXy, [2.0, 0.5, -0.2]),
            (Kind::Scara, [0.3, 1.4, -0.5]),
            (Kind::LinearDelta, [3.0, 3.2, 2.9]),
        ] {
            let linked = Linked::new(&kind.geometry());
            let (speeds, rotor) = ([0.4, -0.7, 0.3], [0.01; MAIN_AXES]);
            let here = linked.equation(angles, speeds, rotor);
            for i in 0..MAIN_AXES {
                for j in 0..MAIN_AXES {
                    let (a, b) = (here.inertia[i][j], here.inertia[j][i]);
                    assert!((a - b).abs() < 1e-9 && here.inertia[i][i] > 0.0, "{kind:?}");
                }
            }
            // Weight: the work of gravity over a small displacement is the loss of the tool's height and of the carriages'.
            let step = 1e-4;
            let height = |angles| linked.position(angles).expect("a pose")[2];
            for axis in 0..MAIN_AXES {
                let mut moved = angles;
                moved[axis] += step;
                let fallen_m = height(angles) - height(moved);
                let expected = linked.bodies.hanging_kg * GRAVITY_M_S2 * fallen_m / step + linked.bodies.own_nm[axis];
                assert!((here.weight_nm[axis] - expected).abs() < 1e-6, "{kind:?} axis {axis}");
            }
        }
    }
}
