//! Joints with torque, dry friction and play, moved in steps of an eighth of a millisecond.
//!
//! Every step solves for the speeds at its end: dry friction takes as much speed away as it can and holds what it can
//! stop; a gear with play transmits what keeps its flanks apart by no more and no less than the gap. Both are impulses
//! with bounds, found together by projected Gauss-Seidel iteration (Moreau 1988, Jourdan 1998). So a joint at rest
//! stays at rest without chatter, and neither friction nor play can add energy.
//!
//! Joints that their drive moves by itself are imposed. Inertias are those of [`super::dynamics`].
//!
//! Invariant: the joints' speeds stay finite, whatever the torques.

use super::contact::{Contact, invert};
use super::dynamics::{ALONE_KG_M2, ROTOR_KG_M2};
use super::joint::Joint;
use super::mechanism::{Equation, MainAxes, Mechanism};
use super::physics::Friction;
use etherpen::robots::MAIN_AXES;
use etherpen_segment::{LOOP_STEP_S, LOOP_STEPS, STEP_S};

/// Links and platform behind gears with play.
#[derive(Clone, Debug)]
struct LoadSide {
    /// Half of the play at each joint, rad.
    half_gap_rad: f64,
    angles: MainAxes,
    speeds: MainAxes,
    /// Angles of the gears' outputs at the end of the last step.
    outputs: MainAxes,
}

/// Motion of all joints.
#[derive(Clone, Debug)]
pub(super) struct Coupled {
    mechanism: Mechanism,
    friction: Friction,
    load: Option<LoadSide>,
    speeds_before: MainAxes,
    /// Impulses of the last step, where the next iteration begins, N m s.
    contact: Contact,
}

/// What the drives do to the main axes in one step.
struct Drives {
    /// Torque at each joint, N m; `None` for one that its drive moves by itself.
    torques: [Option<f64>; MAIN_AXES],
    /// Inertia of each rotor at its joint, kg m2.
    rotors: MainAxes,
    angles: MainAxes,
    speeds: MainAxes,
    /// Accelerations of the joints that their drives move, rad/s2.
    imposed: MainAxes,
}

impl Coupled {
    /// Joints at rest; the gap is the whole play between gear and joint, rad.
    pub(super) fn new(mechanism: Mechanism, friction: Friction, gap_rad: f64, angles: MainAxes) -> Self {
        let load = (gap_rad > 0.0).then_some(LoadSide {
            half_gap_rad: gap_rad / 2.0,
            angles,
            speeds: [0.0; MAIN_AXES],
            outputs: angles,
        });
        Self {
            mechanism,
            friction,
            load,
            speeds_before: [0.0; MAIN_AXES],
            contact: Contact::default(),
        }
    }

    /// Angles and speeds of the main joints behind gears with play; `None` without play.
    pub(super) fn load_side(&self) -> Option<(MainAxes, MainAxes)> {
        self.load.as_ref().map(|load| (load.angles, load.speeds))
    }

    /// Moves the joints over one millisecond; joints are the axes in their order.
    pub(super) fn step(&mut self, joints: &mut [Joint<'_, '_>]) {
        let (main, others) = joints.split_at_mut_checked(MAIN_AXES).unwrap_or((&mut [], &mut []));
        let mut imposed = values(main, |joint| joint.speed_rad_s());
        for (speed, before) in imposed.iter_mut().zip(self.speeds_before) {
            *speed = (*speed - before) / STEP_S;
        }
        for left in (0..LOOP_STEPS).rev() {
            others.iter_mut().for_each(|joint| self.step_alone(joint));
            main.iter_mut().for_each(Joint::regulate);
            let drives = Drives {
                torques: torques(main),
                rotors: values(main, |joint| joint.inertia_kg_m2(ROTOR_KG_M2)),
                angles: values(main, |joint| joint.angle_rad()),
                speeds: values(main, |joint| joint.speed_rad_s()),
                imposed,
            };
            if main.len() == MAIN_AXES {
                let speeds = match self.load.take() {
                    Some(mut load) => {
                        let speeds = self.step_with_play(&drives, &mut load, left);
                        self.load = Some(load);
                        speeds
                    }
                    None => self.step_rigid(&drives),
                };
                for ((joint, torque), speed) in main.iter_mut().zip(drives.torques).zip(speeds) {
                    if torque.is_some() {
                        joint.turn(speed, LOOP_STEP_S);
                    }
                }
            }
        }
        self.speeds_before = values(main, |joint| joint.speed_rad_s());
    }

    /// Dry friction at this speed, N m.
    pub(super) fn dry_friction_nm(&self, speed_rad_s: f64) -> f64 {
        let Friction {
            coulomb_nm,
            stiction_factor,
            stribeck_rad_s,
            ..
        } = self.friction;
        let slowness = (-(speed_rad_s / stribeck_rad_s).powi(2)).exp();
        // The maximum takes the bound, not the operand that is not a number.
        (coulomb_nm * (1.0 + (stiction_factor - 1.0) * slowness)).max(0.0)
    }

    /// Moves a joint that no mechanism couples to others.
    fn step_alone(&self, joint: &mut Joint<'_, '_>) {
        joint.regulate();
        let Some(torque_nm) = joint.torque_nm() else { return };
        let viscous = self.friction.viscous_nm_s;
        let inertia = ALONE_KG_M2 + joint.inertia_kg_m2(ROTOR_KG_M2) + viscous * LOOP_STEP_S;
        let speed = joint.speed_rad_s();
        let free = speed + (torque_nm - viscous * speed) / inertia * LOOP_STEP_S;
        let held = self.dry_friction_nm(speed) / inertia * LOOP_STEP_S;
        joint.turn(free - free.clamp(-held, held), LOOP_STEP_S);
    }

    /// Speeds at the end of a step of gears without play.
    fn step_rigid(&mut self, drives: &Drives) -> MainAxes {
        let equation = self.mechanism.equation(drives.angles, drives.speeds, drives.rotors);
        let free = drives.torques.map(|torque| torque.is_some());
        let (inverse, mut speeds) = self.unbraked(&equation, drives, free);
        let bounds = self.friction_bounds(drives);
        self.contact.brake(&mut speeds, &inverse, bounds);
        speeds
    }

    /// Speeds without dry friction, and the speeds that an impulse on each joint gives.
    fn unbraked(
        &self,
        equation: &Equation,
        drives: &Drives,
        free: [bool; MAIN_AXES],
    ) -> ([MainAxes; MAIN_AXES], MainAxes) {
        let mut matrix = equation.inertia;
        let mut right = [0.0; MAIN_AXES];
        for i in 0..MAIN_AXES {
            let torque_nm = drives.torques[i].unwrap_or(0.0);
            let viscous = self.friction.viscous_nm_s;
            right[i] = torque_nm + equation.weight_nm[i] - equation.carried_nm[i] - viscous * drives.speeds[i];
            matrix[i][i] += viscous * LOOP_STEP_S;
        }
        for i in (0..MAIN_AXES).filter(|i| !free[*i]) {
            for j in 0..MAIN_AXES {
                right[j] -= matrix[j][i] * drives.imposed[i];
                matrix[j][i] = 0.0;
                matrix[i][j] = 0.0;
            }
            matrix[i][i] = 1.0;
        }
        let mut inverse = invert(matrix);
        let mut speeds = drives.speeds;
        for i in 0..MAIN_AXES {
            for j in 0..MAIN_AXES {
                if !free[i] || !free[j] {
                    inverse[i][j] = 0.0;
                }
                speeds[i] += inverse[i][j] * right[j] * LOOP_STEP_S;
            }
        }
        (inverse, speeds)
    }

    /// Largest impulse of dry friction in a step at each joint whose drive sets a torque, N m s.
    fn friction_bounds(&self, drives: &Drives) -> MainAxes {
        let mut bounds = [0.0; MAIN_AXES];
        for ((bound, speed), torque) in bounds.iter_mut().zip(drives.speeds).zip(drives.torques) {
            if torque.is_some() {
                *bound = self.dry_friction_nm(speed) * LOOP_STEP_S;
            }
        }
        bounds
    }

    /// Speeds of the gears' outputs at the end of a step with play; moves the load. `left` steps follow in this
    /// millisecond.
    fn step_with_play(&mut self, drives: &Drives, load: &mut LoadSide, left: u32) -> MainAxes {
        let none = [0.0; MAIN_AXES];
        let equation = self.mechanism.equation(load.angles, load.speeds, none);
        let (inverse, mut load_speeds) = self.unbraked(
            &equation,
            &Drives {
                torques: [None; MAIN_AXES],
                rotors: none,
                angles: load.angles,
                speeds: load.speeds,
                imposed: none,
            },
            [true; MAIN_AXES],
        );
        let (mut speeds, mut mobility, mut angles) = (none, none, drives.angles);
        for i in 0..MAIN_AXES {
            if let Some(torque_nm) = drives.torques[i] {
                let viscous = self.friction.viscous_nm_s;
                mobility[i] = 1.0 / (drives.rotors[i] + viscous * LOOP_STEP_S);
                let free_nm = torque_nm - viscous * drives.speeds[i];
                speeds[i] = drives.speeds[i] + free_nm * mobility[i] * LOOP_STEP_S;
            } else {
                // The drive has already moved the motor over the whole millisecond; it moves here step by step.
                speeds[i] = (drives.angles[i] - load.outputs[i]) / (f64::from(left + 1) * LOOP_STEP_S);
                angles[i] = load.outputs[i];
            }
        }
        let mut limits = [[0.0; 2]; MAIN_AXES];
        for (i, limit) in limits.iter_mut().enumerate() {
            let play = load.angles[i] - angles[i];
            *limit = [-load.half_gap_rad - play, load.half_gap_rad - play].map(|rad| rad / LOOP_STEP_S);
        }
        let bounds = self.friction_bounds(drives);
        self.contact
            .brake_and_touch(&mut speeds, &mobility, bounds, &mut load_speeds, &inverse, limits);
        for i in 0..MAIN_AXES {
            load.speeds[i] = load_speeds[i];
            load.angles[i] += load_speeds[i] * LOOP_STEP_S;
            load.outputs[i] = angles[i] + speeds[i] * LOOP_STEP_S;
        }
        speeds
    }
}

fn values(joints: &[Joint<'_, '_>], value: fn(&Joint<'_, '_>) -> f64) -> MainAxes {
    let mut values = [0.0; MAIN_AXES];
    values
        .iter_mut()
        .zip(joints)
        .for_each(|(target, joint)| *target = value(joint));
    values
}

fn torques(joints: &[Joint<'_, '_>]) -> [Option<f64>; MAIN_AXES] {
    let mut torques = [None; MAIN_AXES];
    torques
        .iter_mut()
        .zip(joints)
        .for_each(|(torque, joint)| *torque = joint.torque_nm());
    torques
}

#[cfg(test)]
mod tests;
