//! The linear delta in the monitor's numbers.

use etherpen::robots::LinearDeltaGeometry;
use etherpen_monitor::robot::{LinearDelta, LinearDeltaDimensions};

/// The robot.
pub(super) fn robot(geometry: &LinearDeltaGeometry) -> LinearDelta {
    LinearDelta::new(&LinearDeltaDimensions {
        radius_mm: geometry.radius_mm,
        rod_mm: geometry.rod_mm,
        azimuths_deg: geometry.tower_azimuths_deg,
        carriage_mm_per_turn: super::TURN_MM,
    })
}
