//! Dimensions of the configured robot for the certificate's own kinematics.

use etherpen::config::Config;
use etherpen_certify::Robot;
use etherpen_certify::robot::Dimensions;

/// The configured robot.
pub(super) fn robot(config: &Config) -> Robot {
    let geometry = &config.geometry;
    Robot::new(&Dimensions {
        base_radius_mm: geometry.base_radius_mm,
        upper_arm_mm: geometry.upper_arm_mm,
        forearm_mm: geometry.forearm_mm,
        platform_radius_mm: geometry.platform_radius_mm,
        azimuths_deg: geometry.arm_azimuths_deg,
    })
}
