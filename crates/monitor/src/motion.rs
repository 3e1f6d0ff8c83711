//! The true motion: joints, tool, speeds, and since when something moves.

use crate::bounds::{Bounds, STILL_RAD_S};
use crate::cell::{AXES_MAX, Cell};
use crate::moment::Moment;
use crate::robot::MAIN_AXES;
use crate::vector::{Vector, length, subtract};

/// Milliseconds in a second.
const MS_PER_S: f64 = 1_000.0;

/// The true motion in one millisecond, with what is needed of the one before.
#[derive(Clone, Debug, Default)]
pub(crate) struct Motion {
    pub(crate) now_ms: u64,
    /// Number of axes that are judged and present.
    pub(crate) axes: usize,
    pub(crate) angles_rad: [f64; AXES_MAX],
    pub(crate) speeds_rad_s: [f64; AXES_MAX],
    pub(crate) speeds_before_rad_s: [f64; AXES_MAX],
    pub(crate) has_power: [bool; AXES_MAX],
    pub(crate) is_switched_off: [bool; AXES_MAX],
    /// Whether the millisecond before was seen, so that differences mean something.
    pub(crate) is_steady: bool,
    /// Whether all angles and speeds are finite numbers.
    pub(crate) is_finite: bool,
    /// Position of the tool, mm.
    pub(crate) tool: Option<Vector>,
    /// Velocity of the tool, mm/s, as a difference; zero where it is not known.
    pub(crate) velocity_mm_s: Vector,
    pub(crate) tool_speed_mm_s: f64,
    /// Whether any joint moves.
    pub(crate) moves: bool,
    /// When the power of a drive last changed, ms.
    pub(crate) power_changed_ms: Option<u64>,
    /// Whether a drive has got power in this millisecond.
    pub(crate) got_power: bool,
}

impl Motion {
    /// Takes the next millisecond.
    pub(crate) fn step(&mut self, cell: &Cell, bounds: &Bounds, moment: &Moment<'_>) {
        let before = self.tool;
        let is_first = self.axes == 0;
        self.is_steady = !is_first && moment.time_ms == self.now_ms.wrapping_add(1);
        self.now_ms = moment.time_ms;
        self.axes = bounds.axes.min(moment.joints.len());
        self.speeds_before_rad_s = self.speeds_rad_s;
        let mut turned = !self.is_steady;
        self.is_finite = true;
        (self.moves, self.got_power) = (false, false);
        for (axis, joint) in moment.joints.iter().take(self.axes).enumerate() {
            self.is_finite &= joint.angle_rad.is_finite() && joint.speed_rad_s.is_finite();
            self.moves |= joint.speed_rad_s.abs() > STILL_RAD_S;
            turned |= axis < MAIN_AXES && joint.angle_rad != self.angles_rad[axis];
            self.angles_rad[axis] = joint.angle_rad;
            self.speeds_rad_s[axis] = joint.speed_rad_s;
            self.is_switched_off[axis] = joint.is_switched_off;
            if self.has_power[axis] != joint.has_power {
                self.has_power[axis] = joint.has_power;
                self.got_power |= joint.has_power;
                self.power_changed_ms = Some(moment.time_ms);
            }
        }
        if turned {
            let [first, second, third, ..] = self.angles_rad;
            let is_whole = self.axes >= MAIN_AXES;
            self.tool = is_whole.then(|| cell.robot.tool([first, second, third])).flatten();
        }
        self.velocity_mm_s = match (self.tool, before) {
            (Some(now), Some(before)) if self.is_steady => subtract(now, before).map(|mm| mm * MS_PER_S),
            _ => [0.0; 3],
        };
        self.tool_speed_mm_s = length(self.velocity_mm_s);
    }

    /// Numbers of the axes that are judged.
    pub(crate) fn each_axis(&self) -> std::ops::Range<usize> {
        0..self.axes
    }
}
