//! The delta robot in the monitor's numbers.

use etherpen::config::Geometry;
use etherpen::robots::AXES;
use etherpen_monitor::Robot;
use etherpen_monitor::robot::Dimensions;

/// The robot.
pub(in crate::campaign) fn robot(geometry: &Geometry) -> Robot {
    Robot::new(&Dimensions {
        base_radius_mm: geometry.base_radius_mm,
        upper_arm_mm: geometry.upper_arm_mm,
        forearm_mm: geometry.forearm_mm,
        platform_radius_mm: geometry.platform_radius_mm,
        azimuths_deg: geometry.arm_azimuths_deg,
    })
}

/// The lowest and the highest angle of each axis, rad.
pub(in crate::campaign) fn ranges_rad(geometry: &Geometry) -> [[f64; 2]; AXES] {
    let arm = geometry.arm_range_rad;
    [arm, arm, arm, geometry.turn_range_rad]
}
