//! The drive of an axis, as a commissioning engineer would set it up.

use super::dynamics::{ALONE_KG_M2, ROTOR_KG_M2};
use super::mechanism::Mechanism;
use super::physics::{LoopKind, Physics};
use crate::random::Random;
use etherpen::config::{Axis, Config};
use etherpen::robots::{Kinematics, MAIN_AXES, Position};
use etherpen_segment::{DriveOptions, PiLoop, ResolverError, Switches, VelocityLoop};

/// Deceleration of a joint whose motor's brake is closed, rad/s2.
pub(crate) const BRAKE_RAD_S2: f64 = 400.0;
/// Gives the errors of the torque measurement random numbers of their own.
const TORQUE_SEED: u64 = 0x70_4913;
/// Points of the grid over the work area in each direction.
const GRID: u32 = 5;

/// Sets up the drives of one cell.
#[derive(Debug)]
pub(super) struct Commissioning {
    physics: Physics,
    /// Mean inertia of a main axis over the work area without rotor and payload, kg m2 at the joint.
    main_kg_m2: f64,
    random: Random,
}

impl Commissioning {
    /// Takes the measures of the configured robot.
    pub(super) fn new(config: &Config, physics: &Physics, seed: u64) -> Self {
        let main_kg_m2 = match physics.velocity_loop.kind {
            LoopKind::Lag => 0.0,
            LoopKind::Pi => mean_inertia(config).unwrap_or(0.0),
        };
        Self {
            physics: *physics,
            main_kg_m2,
            random: Random::new(seed ^ TORQUE_SEED),
        }
    }

    /// The drive of an axis, from 0, with its motor at this angle.
    pub(super) fn drive(&mut self, index: usize, axis: &Axis, angle_rad: f64) -> DriveOptions {
        let Physics {
            dead_time,
            resolver,
            torque,
            friction,
            ..
        } = self.physics;
        let gear = axis.gear.abs();
        let sign = if self.random.unit() < 0.5 { -1.0 } else { 1.0 };
        DriveOptions {
            increments_per_revolution: axis.increments_per_revolution,
            zero_increments: axis.sync_increments,
            digits_per_rpm: axis.digits_per_rpm,
            quick_stop_rad_s2: axis.quick_stop_rad_s2.abs() * gear,
            brake_rad_s2: BRAKE_RAD_S2 * gear,
            velocity_loop: self.velocity_loop(index, gear),
            bandwidth_hz: self.physics.velocity_loop.bandwidth_hz,
            position_gain_per_s: self.physics.position_loop.gain_per_s,
            friction_rad_s: friction.lag_rad_s * gear,
            torque_scale: 1.0 + sign * torque.scale_share,
            torque_offset_nm: sign * torque.offset_nm,
            noise_increments: resolver.noise_increments,
            resolver_error: ResolverError {
                once_rad: (resolver.once_arcmin / 60.0).to_radians(),
                twice_rad: (resolver.twice_arcmin / 60.0).to_radians(),
            },
            resolver_bits: resolver.bits,
            late_share: dead_time.late_share,
            input_delay_ms: dead_time.position_cycles as usize,
            output_delay_ms: dead_time.command_cycles as usize,
            switches: Switches::default(),
            angle_rad,
        }
    }

    fn velocity_loop(&self, index: usize, gear: f64) -> VelocityLoop {
        let options = self.physics.velocity_loop;
        let load_kg_m2 = if index < MAIN_AXES {
            self.main_kg_m2
        } else {
            ALONE_KG_M2
        };
        match options.kind {
            LoopKind::Lag => VelocityLoop::Lag,
            LoopKind::Pi => VelocityLoop::Pi(PiLoop {
                bandwidth_hz: options.bandwidth_hz,
                integral_ms: options.integral_ms,
                inertia_kg_m2: ROTOR_KG_M2 + load_kg_m2 / (gear * gear),
                current_hz: options.current_hz,
                speed_filter_hz: options.speed_filter_hz,
            }),
        }
    }
}

/// Mean eigenvalue of the inertia matrix without rotors and payload over the part of the work area that the robot
/// reaches, kg m2; `None` if it reaches nothing.
fn mean_inertia(config: &Config) -> Option<f64> {
    let kinematics = Kinematics::new(&config.geometry).ok()?;
    let mechanism = Mechanism::new(&config.geometry);
    let area = &config.work_area;
    let share = |step: u32| f64::from(step) / f64::from(GRID - 1);
    let (mut sum, mut count) = (0.0, 0.0);
    for point in 0..GRID * GRID * GRID {
        let [x, y, z] = [point % GRID, point / GRID % GRID, point / GRID / GRID].map(share);
        let position = Position {
            x_mm: (2.0 * x - 1.0) * area.radius_mm,
            y_mm: (2.0 * y - 1.0) * area.radius_mm,
            z_mm: area.z_low_mm + z * (area.z_high_mm - area.z_low_mm),
        };
        if position.x_mm.hypot(position.y_mm) > area.radius_mm {
            continue;
        }
        let Ok(angles) = kinematics.inverse(&position) else {
            continue;
        };
        let [[a, ..], [_, b, _], [.., c]] = mechanism.equation(angles, [0.0; MAIN_AXES], [0.0; MAIN_AXES]).inertia;
        (sum, count) = (sum + (a + b + c) / 3.0, count + 1.0);
    }
    (count > 0.0).then(|| sum / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_inertia_lies_within_the_range_over_the_work_area() {
        let mean_kg_m2 = mean_inertia(&Config::default()).expect("reachable");
        assert!((0.05..0.4).contains(&mean_kg_m2), "{mean_kg_m2} kg m2");
    }

    #[test]
    fn nominal_drives_are_the_segments_first_order_drives() {
        let axis = Axis::default();
        let mut commissioning = Commissioning::new(&Config::default(), &Physics::NOMINAL, 1);
        let drive = commissioning.drive(0, &axis, 0.0);
        let expected = DriveOptions {
            zero_increments: axis.sync_increments,
            resolver_bits: 20,
            ..DriveOptions::default()
        };
        assert_eq!(drive, expected);
    }
}
