//! Dry friction and play against what mechanics says.

use super::*;
use crate::cell::physics::Physics;
use etherpen::robots::{DeltaGeometry, Geometry};
use std::f64::consts::FRAC_PI_2;

const POSE: MainAxes = [0.3, 0.5, 0.4];
const ROTORS: MainAxes = [0.03; MAIN_AXES];
/// Steps in a second.
const SECOND: u32 = LOOP_STEPS * 1000;

fn friction() -> Friction {
    Friction {
        viscous_nm_s: 0.0,
        ..Physics::PESSIMISTIC.friction
    }
}

fn whole() -> Mechanism {
    Mechanism::new(&Geometry::default())
}

/// Three main axes that nothing couples; gravity vanishes where their links hang.
fn uncoupled() -> Mechanism {
    Mechanism::new(&Geometry::Delta(DeltaGeometry {
        forearm_mm: 1.0,
        ..DeltaGeometry::default()
    }))
}

/// A robot whose motors have these torques.
struct Rig {
    coupled: Coupled,
    angles: MainAxes,
    speeds: MainAxes,
}

impl Rig {
    fn new(mechanism: Mechanism, friction: Friction, gap_rad: f64, angles: MainAxes) -> Self {
        Self {
            coupled: Coupled::new(mechanism, friction, gap_rad, angles),
            angles,
            speeds: [0.0; MAIN_AXES],
        }
    }

    /// Torques that hold the links against gravity, N m.
    fn hold_nm(&self) -> MainAxes {
        let equation = self.coupled.mechanism.equation(self.angles, [0.0; MAIN_AXES], ROTORS);
        equation.weight_nm.map(|weight_nm| -weight_nm)
    }

    fn step(&mut self, torques: MainAxes) {
        let drives = Drives {
            torques: torques.map(Some),
            rotors: ROTORS,
            angles: self.angles,
            speeds: self.speeds,
            imposed: [0.0; MAIN_AXES],
        };
        self.speeds = match self.coupled.load.take() {
            Some(mut load) => {
                let speeds = self.coupled.step_with_play(&drives, &mut load, 0);
                self.coupled.load = Some(load);
                speeds
            }
            None => self.coupled.step_rigid(&drives),
        };
        for (angle, speed) in self.angles.iter_mut().zip(self.speeds) {
            *angle += speed * LOOP_STEP_S;
        }
    }

    /// Drives move the motors at these speeds for a step.
    fn impose(&mut self, speeds: MainAxes) {
        for (angle, speed) in self.angles.iter_mut().zip(speeds) {
            *angle += speed * LOOP_STEP_S;
        }
        let drives = Drives {
            torques: [None; MAIN_AXES],
            rotors: ROTORS,
            angles: self.angles,
            speeds,
            imposed: [0.0; MAIN_AXES],
        };
        let mut load = self.coupled.load.take().expect("play");
        self.coupled.step_with_play(&drives, &mut load, 0);
        self.coupled.load = Some(load);
    }

    /// Angle of the first joint against its motor, rad.
    fn play_rad(&self) -> f64 {
        self.coupled.load_side().expect("play").0[0] - self.angles[0]
    }
}

#[test]
fn a_joint_stays_at_rest_below_the_breakaway_torque_and_moves_above_it() {
    let breakaway_nm = 1.2 * 1.3;
    for (extra_nm, moves) in [(0.98 * breakaway_nm, false), (1.02 * breakaway_nm, true)] {
        for sign in [-1.0, 1.0] {
            let mut rig = Rig::new(whole(), friction(), 0.0, POSE);
            let mut torques = rig.hold_nm();
            torques[0] += sign * extra_nm;
            (0..SECOND / 4).for_each(|_| rig.step(torques));
            let way_rad = (rig.angles[0] - POSE[0]) * sign;
            match moves {
                true => assert!(way_rad > 1e-3, "{extra_nm} N m: {way_rad} rad"),
                false => assert!(way_rad.abs() < 1e-9, "{extra_nm} N m: {way_rad} rad"),
            }
        }
    }
}

#[test]
fn between_sliding_and_breakaway_torque_a_joint_keeps_moving_but_does_not_start() {
    let mut rig = Rig::new(uncoupled(), friction(), 0.0, [FRAC_PI_2; MAIN_AXES]);
    rig.speeds = [0.3, 0.0, 0.0];
    for _ in 0..SECOND / 50 {
        let mut torques = rig.hold_nm();
        torques.iter_mut().for_each(|torque_nm| *torque_nm += 1.3);
        rig.step(torques);
    }
    assert!(rig.speeds[0] > 0.3, "{:?}", rig.speeds);
    assert!(
        rig.speeds[1].abs() < 1e-11 && rig.speeds[2].abs() < 1e-11,
        "{:?}",
        rig.speeds
    );
}

#[test]
fn a_sliding_joint_slows_down_by_friction_over_inertia_and_stops_without_chatter() {
    let coulomb = Friction {
        stiction_factor: 1.0,
        ..friction()
    };
    let mut rig = Rig::new(uncoupled(), coulomb, 0.0, [FRAC_PI_2; MAIN_AXES]);
    let inertia_kg_m2 = rig.coupled.mechanism.equation(rig.angles, rig.speeds, ROTORS).inertia[0][0];
    rig.speeds[0] = 0.5;
    let (mut steps, mut signs) = (0, 0);
    while rig.speeds[0].abs() > 1e-11 && steps < SECOND {
        let hold_nm = rig.hold_nm();
        rig.step(hold_nm);
        steps += 1;
        signs += u32::from(rig.speeds[0] < -1e-11);
    }
    let expected_s = 0.5 * inertia_kg_m2 / 1.2;
    let needed_s = f64::from(steps) * LOOP_STEP_S;
    assert!(
        (needed_s - expected_s).abs() <= 2.0 * LOOP_STEP_S,
        "{needed_s} s, not {expected_s} s"
    );
    assert_eq!(signs, 0, "it reversed");
}

#[test]
fn without_torque_energy_never_grows() {
    for gap_rad in [0.0, 1e-3] {
        let mut rig = Rig::new(whole(), friction(), gap_rad, POSE);
        rig.speeds = [2.0, -1.5, 1.0];
        if let Some(load) = &mut rig.coupled.load {
            load.speeds = rig.speeds;
        }
        let (mut gained_j, mut least_j) = (0.0, f64::MAX);
        for step in 0..SECOND / 8 {
            rig.step([0.0; MAIN_AXES]);
            let (angles, speeds) = rig.coupled.load_side().unwrap_or((rig.angles, rig.speeds));
            let equation = rig.coupled.mechanism.equation(angles, speeds, [0.0; MAIN_AXES]);
            let mut kinetic_j: f64 = rig.speeds.iter().map(|speed| 0.015 * speed * speed).sum();
            for i in 0..MAIN_AXES {
                gained_j += equation.weight_nm[i] * speeds[i] * LOOP_STEP_S;
                for j in 0..MAIN_AXES {
                    kinetic_j += 0.5 * equation.inertia[i][j] * speeds[i] * speeds[j];
                }
            }
            let total_j = kinetic_j - gained_j;
            assert!(
                total_j <= least_j + 2e-4,
                "gap {gap_rad}, step {step}: {total_j} J after {least_j} J"
            );
            least_j = total_j.min(least_j);
        }
    }
}

#[test]
fn a_reversal_loses_exactly_the_gap() {
    let gap_rad = 1e-3;
    let mut rig = Rig::new(uncoupled(), friction(), gap_rad, [FRAC_PI_2; MAIN_AXES]);
    // Gravity vanishes where the links hang and pulls them back there from both sides, so it presses on the driving flank.
    (0..200).for_each(|_| rig.impose([1.0; MAIN_AXES]));
    let forwards_rad = rig.play_rad();
    (0..600).for_each(|_| rig.impose([-1.0; MAIN_AXES]));
    let backwards_rad = rig.play_rad();
    assert!((forwards_rad + gap_rad / 2.0).abs() < 1e-9, "{forwards_rad}");
    assert!((backwards_rad - forwards_rad - gap_rad).abs() < 1e-9, "{backwards_rad}");
}

#[test]
fn gravity_keeps_the_flank_through_a_slow_reversal_and_loses_it_above_its_acceleration() {
    let gap_rad = 3e-4;
    let lost = |acceleration_rad_s2: f64| {
        let mut rig = Rig::new(whole(), friction(), gap_rad, [0.4; MAIN_AXES]);
        (0..SECOND / 20).for_each(|_| rig.impose([0.0; MAIN_AXES]));
        let resting_rad = rig.play_rad();
        assert!(
            (resting_rad - gap_rad / 2.0).abs() < 1e-9,
            "the links hang on their gears"
        );
        // Downwards with this acceleration: a link whose gear runs away faster than it falls changes its flank.
        let mut speed = 0.0;
        let mut most: f64 = 0.0;
        for _ in 0..SECOND / 50 {
            speed += acceleration_rad_s2 * LOOP_STEP_S;
            rig.impose([speed; MAIN_AXES]);
            most = most.max(resting_rad - rig.play_rad());
        }
        most
    };
    // Free fall of this pose, from the equation of motion.
    let equation = whole().equation([0.4; MAIN_AXES], [0.0; MAIN_AXES], [0.0; MAIN_AXES]);
    let inverse = invert(equation.inertia);
    let fall_rad_s2: f64 = (0..MAIN_AXES).map(|j| inverse[0][j] * equation.weight_nm[j]).sum();
    assert!(lost(0.9 * fall_rad_s2) < 1e-9);
    assert!((lost(1.5 * fall_rad_s2) - gap_rad).abs() < 1e-8);
}

#[test]
fn torques_without_sense_leave_finite_speeds() {
    for gap_rad in [0.0, 1e-3] {
        let mut rig = Rig::new(whole(), friction(), gap_rad, POSE);
        for torque_nm in [1e6, -1e6, 0.0] {
            (0..100).for_each(|_| rig.step([torque_nm; MAIN_AXES]));
        }
        let mut undefined = Rig::new(whole(), friction(), gap_rad, [f64::NAN; MAIN_AXES]);
        (0..10).for_each(|_| undefined.step([1.0; MAIN_AXES]));
    }
}
