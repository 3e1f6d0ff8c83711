//! When the output of a pen is on.
//!
//! The output follows the height of the setpoints: it is switched on when the path goes down below the corner between travel
//! and lowering, and off when it begins to go up. From that corner on, which the travel tolerance rounds, lowering takes the
//! time of the pen; above it the tool may still be beside its line. Where no setpoint is followed the output is off.

use crate::config::{Config, PenLiftKind};
use crate::motion::{Pen, Setpoint};
use crate::robots::LINEAR_MM_PER_RAD;

/// The axis of the height.
pub(super) const HEIGHT: usize = 2;
/// Vertical speed that counts as none, rad/s: rounding of the setpoints.
const STILL_RAD_S: f64 = 1.0e-6;

/// Heights of the axis of the height, and whether an output follows them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PenSwitch {
    /// Joint of the height with the pen up, rad.
    pub up_rad: f64,
    /// Height below which a path that goes down lowers the pen, rad.
    lowers_rad: f64,
    /// Half way between up and down, rad.
    half_rad: f64,
    /// Whether an output lowers the pen.
    has_output: bool,
}

impl PenSwitch {
    /// The heights of a configuration, for a machine whose third joint is the height.
    pub fn new(config: &Config) -> Self {
        let paper = &config.paper;
        let joint = |z_mm: f64| z_mm / LINEAR_MM_PER_RAD;
        Self {
            up_rad: joint(paper.pen_down_z_mm + paper.pen_lift_mm),
            lowers_rad: joint(paper.pen_down_z_mm + config.pen.lift_mm(&config.motion, paper)),
            half_rad: joint(paper.pen_down_z_mm + 0.5 * paper.pen_lift_mm),
            has_output: config.pen.kind == PenLiftKind::Output,
        }
    }

    /// Whether the output is on at a setpoint that is followed.
    pub(super) fn is_on(&self, setpoint: &Setpoint) -> bool {
        let (height_rad, climb_rad_s) = (setpoint.position_rad[HEIGHT], setpoint.velocity_rad_s[HEIGHT]);
        let lowers = climb_rad_s <= -STILL_RAD_S && height_rad <= self.lowers_rad;
        let stands_low = climb_rad_s.abs() < STILL_RAD_S && height_rad < self.half_rad;
        self.has_output && (setpoint.pen == Pen::Down || lowers || stands_low)
    }
}
