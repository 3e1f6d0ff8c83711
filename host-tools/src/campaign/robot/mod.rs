//! The robot in the monitor's numbers: a kind with many dimensions has a file of its own.

mod delta;
mod linear_delta;

use etherpen::config::Geometry;
use etherpen::robots::AXES;
use etherpen_monitor::Robot;
use etherpen_monitor::robot::{CoreXy, Gantry, Scara};

/// The robot of these dimensions.
#[must_use]
pub fn robot(geometry: &Geometry) -> Robot {
    match geometry {
        Geometry::Delta(geometry) => Robot::Delta(delta::robot(geometry)),
        Geometry::Gantry(geometry) => Robot::Gantry(Gantry::new([
            geometry.x_mm_per_turn,
            geometry.y_mm_per_turn,
            geometry.z_mm_per_turn,
        ])),
        Geometry::CoreXy(geometry) => Robot::CoreXy(CoreXy::new(geometry.belt_mm_per_turn, geometry.z_mm_per_turn)),
        Geometry::Scara(geometry) => Robot::Scara(Scara::new(
            geometry.inner_link_mm,
            geometry.outer_link_mm,
            geometry.z_mm_per_turn,
        )),
        Geometry::LinearDelta(geometry) => Robot::LinearDelta(linear_delta::robot(geometry)),
    }
}

/// The lowest and the highest angle of each axis, rad.
pub(super) fn ranges_rad(geometry: &Geometry) -> [[f64; 2]; AXES] {
    let [first, second, third] = geometry.ranges_rad();
    [first, second, third, geometry.turn_range_rad()]
}
