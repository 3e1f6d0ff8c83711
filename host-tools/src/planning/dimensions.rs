//! Dimensions of the configured robot for the certificate's own kinematics.

use super::PlanningError;
use etherpen::config::{Config, Geometry};
use etherpen_certify::Robot;
use etherpen_certify::robot::Dimensions;

/// The configured robot.
///
/// # Errors
/// [`PlanningError::NotCertified`] for a kind whose motion cannot be certified.
pub(super) fn robot(config: &Config) -> Result<Robot, PlanningError> {
    let Geometry::Delta(geometry) = &config.geometry else {
        return Err(PlanningError::NotCertified(config.geometry.kind()));
    };
    Ok(Robot::new(&Dimensions {
        base_radius_mm: geometry.base_radius_mm,
        upper_arm_mm: geometry.upper_arm_mm,
        forearm_mm: geometry.forearm_mm,
        platform_radius_mm: geometry.platform_radius_mm,
        azimuths_deg: geometry.arm_azimuths_deg,
    }))
}
