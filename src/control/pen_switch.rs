//! When the output of a pen is on.
//!
//! The output follows the height of the setpoints: it is switched on when the path goes down below the corner between travel
//! and lowering, and off when it begins to go up. From that corner on, which the travel tolerance rounds, lowering takes the
//! time of the pen; above it the tool may still be beside its line. Where no setpoint is followed, and in a stop, the output is
//! off; a tool that stands low then keeps its pen up until the path goes down again.

use crate::config::{Config, IoRole};
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
    /// Value of the output with the pen up and down.
    pub(super) words: [u32; 2],
    /// Whether the output is on.
    is_on: bool,
}

impl PenSwitch {
    /// The heights of a configuration, for a machine whose third joint is the height.
    pub fn new(config: &Config) -> Self {
        let paper = &config.paper;
        let joint = |z_mm: f64| z_mm / LINEAR_MM_PER_RAD;
        let mut points = config.io.iter().filter(|point| point.role == IoRole::Pen);
        Self {
            up_rad: joint(paper.pen_down_z_mm + paper.pen_lift_mm),
            lowers_rad: joint(paper.pen_down_z_mm + config.pen.lift_mm(&config.motion, paper)),
            half_rad: joint(paper.pen_down_z_mm + 0.5 * paper.pen_lift_mm),
            has_output: config.pen.kind.is_output(),
            words: points
                .find_map(|point| config.pen.words(point.kind))
                .unwrap_or_default(),
            is_on: false,
        }
    }

    /// Advances to a setpoint; returns whether the output is on. `may_lower` is whether the setpoint is followed and no stop
    /// has begun.
    pub(super) fn step(&mut self, may_lower: bool, setpoint: &Setpoint) -> bool {
        self.is_on = may_lower && self.has_output && self.is_down(setpoint);
        self.is_on
    }

    fn is_down(&self, setpoint: &Setpoint) -> bool {
        let (height_rad, climb_rad_s) = (setpoint.position_rad[HEIGHT], setpoint.velocity_rad_s[HEIGHT]);
        let lowers = climb_rad_s <= -STILL_RAD_S && height_rad <= self.lowers_rad;
        let is_low = height_rad < self.half_rad;
        // A jog keeps the pen of the motion before it, wherever it leads.
        let draws = setpoint.pen == Pen::Down && is_low;
        let stands_low = self.is_on && climb_rad_s.abs() < STILL_RAD_S && is_low;
        draws || lowers || stands_low
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{PenLift, PenLiftKind};

    #[test]
    fn the_output_is_on_from_the_start_of_lowering_to_the_start_of_lifting_and_never_above() {
        let config = Config {
            pen: PenLift {
                kind: PenLiftKind::Output,
                ..PenLift::default()
            },
            ..Config::default()
        };
        let mut switch = PenSwitch::new(&config);
        let (up_mm, lift_mm) = (
            config.paper.pen_down_z_mm + config.paper.pen_lift_mm,
            config.paper.pen_lift_mm,
        );
        // Below it the travel tolerance is used up.
        let corner_mm = up_mm - config.motion.travel_tolerance_mm - 1e-6;
        let mut is_on = |z_mm: f64, climb_mm_s: f64, pen: Pen| {
            let mut setpoint = Setpoint {
                pen,
                ..Setpoint::default()
            };
            setpoint.position_rad[HEIGHT] = z_mm / LINEAR_MM_PER_RAD;
            setpoint.velocity_rad_s[HEIGHT] = climb_mm_s / LINEAR_MM_PER_RAD;
            switch.step(true, &setpoint)
        };
        for (z_mm, climb_mm_s, pen, expected) in [
            (up_mm, 0.0, Pen::Up, false),
            (up_mm, -1.0, Pen::Up, false),
            (corner_mm, -1.0, Pen::Up, true),
            (up_mm - 0.9 * lift_mm, 0.0, Pen::Up, true),
            (up_mm - lift_mm, 0.0, Pen::Down, true),
            // A jog with the pen down, up and away.
            (up_mm, 4.0, Pen::Down, false),
            (up_mm + 4.0, 0.0, Pen::Down, false),
            (up_mm - lift_mm, 0.0, Pen::Down, true),
            (up_mm - lift_mm, 1.0, Pen::Up, false),
            // Low, but not lowered since.
            (up_mm - 0.9 * lift_mm, 0.0, Pen::Up, false),
            // A slow way down over the sheet to where the pen is up.
            (up_mm + 26.0, -4.0, Pen::Up, false),
            (up_mm + 0.01, -4.0, Pen::Up, false),
        ] {
            assert_eq!(
                is_on(z_mm, climb_mm_s, pen),
                expected,
                "{z_mm} mm, {climb_mm_s} mm/s, {pen:?}"
            );
        }
    }
}
