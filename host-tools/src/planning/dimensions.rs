//! Dimensions of the configured robot for the certificate's own kinematics.

use etherpen::config::{Config, Geometry};
use etherpen::robots::LINEAR_MM_PER_RAD;
use etherpen_certify::Robot;
use etherpen_certify::robot::{
    CoreXy, Delta, DeltaDimensions, Gantry, LinearDelta, LinearDeltaDimensions, Scara, ScaraDimensions,
};
use std::f64::consts::TAU;

/// Travel for a turn of the wheel that stands for a linear axis, mm.
const TURN_MM: f64 = TAU * LINEAR_MM_PER_RAD;

/// The configured robot.
pub(super) fn robot(config: &Config) -> Robot {
    match &config.geometry {
        Geometry::Delta(geometry) => Robot::Delta(Delta::new(&DeltaDimensions {
            base_radius_mm: geometry.base_radius_mm,
            upper_arm_mm: geometry.upper_arm_mm,
            forearm_mm: geometry.forearm_mm,
            platform_radius_mm: geometry.platform_radius_mm,
            azimuths_deg: geometry.arm_azimuths_deg,
        })),
        Geometry::Gantry(_) => Robot::Gantry(Gantry::new([TURN_MM; 3])),
        Geometry::CoreXy(_) => Robot::CoreXy(CoreXy::new(TURN_MM, TURN_MM)),
        Geometry::Scara(geometry) => {
            let [low_rad, high_rad] = geometry.shoulder_range_rad;
            Robot::Scara(Scara::new(&ScaraDimensions {
                inner_mm: geometry.inner_link_mm,
                outer_mm: geometry.outer_link_mm,
                positive: geometry.elbow > 0,
                shoulder_middle_rad: 0.5 * (low_rad + high_rad),
                z_mm_per_turn: TURN_MM,
            }))
        }
        Geometry::LinearDelta(geometry) => Robot::LinearDelta(LinearDelta::new(&LinearDeltaDimensions {
            radius_mm: geometry.radius_mm,
            rod_mm: geometry.rod_mm,
            azimuths_deg: geometry.tower_azimuths_deg,
            carriage_mm_per_turn: TURN_MM,
        })),
    }
}
