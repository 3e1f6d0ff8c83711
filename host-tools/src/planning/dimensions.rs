//! Dimensions of the configured robot for the certificate's own kinematics.

use etherpen::config::{Config, Geometry};
use etherpen_certify::Robot;
use etherpen_certify::robot::{
    CoreXy, Delta, DeltaDimensions, Gantry, LinearDelta, LinearDeltaDimensions, Scara, ScaraDimensions,
};

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
        Geometry::Gantry(geometry) => Robot::Gantry(Gantry::new([
            geometry.x_mm_per_turn,
            geometry.y_mm_per_turn,
            geometry.z_mm_per_turn,
        ])),
        Geometry::CoreXy(geometry) => Robot::CoreXy(CoreXy::new(geometry.belt_mm_per_turn, geometry.z_mm_per_turn)),
        Geometry::Scara(geometry) => {
            let [low_rad, high_rad] = geometry.shoulder_range_rad;
            Robot::Scara(Scara::new(&ScaraDimensions {
                inner_mm: geometry.inner_link_mm,
                outer_mm: geometry.outer_link_mm,
                positive: geometry.elbow > 0,
                shoulder_middle_rad: 0.5 * (low_rad + high_rad),
                z_mm_per_turn: geometry.z_mm_per_turn,
            }))
        }
        Geometry::LinearDelta(geometry) => Robot::LinearDelta(LinearDelta::new(&LinearDeltaDimensions {
            radius_mm: geometry.radius_mm,
            rod_mm: geometry.rod_mm,
            azimuths_deg: geometry.tower_azimuths_deg,
            carriage_mm_per_turn: geometry.carriage_mm_per_turn,
        })),
    }
}
