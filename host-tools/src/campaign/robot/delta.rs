//! The delta robot in the monitor's numbers.

use etherpen::robots::DeltaGeometry;
use etherpen_monitor::robot::{Delta, DeltaDimensions};

/// The robot.
pub(super) fn robot(geometry: &DeltaGeometry) -> Delta {
    Delta::new(&DeltaDimensions {
        base_radius_mm: geometry.base_radius_mm,
        upper_arm_mm: geometry.upper_arm_mm,
        forearm_mm: geometry.forearm_mm,
        platform_radius_mm: geometry.platform_radius_mm,
        azimuths_deg: geometry.arm_azimuths_deg,
    })
}
