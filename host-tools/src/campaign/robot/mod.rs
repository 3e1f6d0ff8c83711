//! The robot in the monitor's numbers: a kind with many dimensions has a file of its own.

mod delta;
mod linear_delta;

use etherpen::config::Geometry;
use etherpen::robots::{AXES, LINEAR_MM_PER_RAD};
use etherpen_monitor::Robot;
use etherpen_monitor::robot::{CoreXy, Gantry, Scara};
use std::f64::consts::TAU;

/// Travel for a turn of the wheel that stands for a linear axis, mm.
const TURN_MM: f64 = TAU * LINEAR_MM_PER_RAD;

/// The robot of these dimensions.
#[must_use]
pub fn robot(geometry: &Geometry) -> Robot {
    match geometry {
        Geometry::Delta(geometry) => Robot::Delta(delta::robot(geometry)),
        Geometry::Gantry(_) => Robot::Gantry(Gantry::new([TURN_MM; 3])),
        Geometry::CoreXy(_) => Robot::CoreXy(CoreXy::new(TURN_MM, TURN_MM)),
        Geometry::Scara(geometry) => Robot::Scara(Scara::new(geometry.inner_link_mm, geometry.outer_link_mm, TURN_MM)),
        Geometry::LinearDelta(geometry) => Robot::LinearDelta(linear_delta::robot(geometry)),
    }
}

/// The lowest and the highest angle of each axis, rad.
pub(super) fn ranges_rad(geometry: &Geometry) -> [[f64; 2]; AXES] {
    let [first, second, third] = geometry.ranges_rad();
    [first, second, third, geometry.turn_range_rad()]
}
