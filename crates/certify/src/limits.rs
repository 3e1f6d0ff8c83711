//! Limits of a motion and the quantities that they bound.

use std::fmt;

/// Number of axes: the axes that place the tool, and the fourth.
pub const AXES: usize = 4;
/// Time over which a jump of the velocity counts as an acceleration, s: one setpoint.
pub(crate) const TICK_S: f64 = 1.0e-3;

/// Limits, as numbers of a configuration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Lowest and highest angle of each axis, rad.
    pub range_rad: [[f64; 2]; AXES],
    /// Speed of each axis, rad/s.
    pub joint_speed_rad_s: [f64; AXES],
    /// Acceleration of each axis, rad/s2.
    pub joint_acceleration_rad_s2: [f64; AXES],
    /// Speed of the tool with the pen down, mm/s.
    pub speed_mm_s: f64,
    /// Speed of the tool with the pen up, mm/s.
    pub travel_speed_mm_s: f64,
    /// Acceleration of the tool, mm/s2.
    pub acceleration_mm_s2: f64,
    /// Vertical speed while the pen is lifted or lowered, mm/s; 0 for none.
    pub pen_speed_mm_s: f64,
    /// Vertical acceleration while the pen is lifted or lowered, mm/s2; 0 for none.
    pub pen_acceleration_mm_s2: f64,
    /// Distance from the path with the pen down, mm.
    pub tolerance_mm: f64,
    /// Distance from the path with the pen up, mm.
    pub travel_tolerance_mm: f64,
    /// Number of joint angles, one a millisecond, in the moving average that follows; 0 and 1 for none.
    pub window_ms: u16,
    /// Part of a limit by which it may be exceeded: what the planner's own contract allows. Ranges allow no excess.
    pub excess: f64,
    /// Jump of the velocity between two stretches that is allowed, as a part of the acceleration limit over a
    /// millisecond.
    pub jump_part: f64,
}

/// A bounded quantity. Axes count from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Quantity {
    /// Angle of an axis, rad.
    Angle(u8),
    /// Speed of an axis, rad/s.
    JointSpeed(u8),
    /// Acceleration of an axis, rad/s2.
    JointAcceleration(u8),
    /// Speed of the tool, mm/s.
    Speed,
    /// Acceleration of the tool, mm/s2.
    Acceleration,
    /// Vertical speed while the pen is lifted or lowered, mm/s.
    PenSpeed,
    /// Vertical acceleration while the pen is lifted or lowered, mm/s2.
    PenAcceleration,
    /// Distance from the path before the average, mm.
    Tolerance,
    /// Distance from the path after the average, mm.
    AveragedTolerance,
    /// Jump of the velocity, mm/s2 over a millisecond.
    Jump,
    /// Jump of an axis's speed, rad/s2 over a millisecond.
    JointJump(u8),
    /// Jump of the position, mm.
    Gap,
    /// A stretch whose numbers are no motion, or that begins before the one before it has ended.
    Numbers,
}

impl Quantity {
    /// Name and unit.
    #[must_use]
    pub fn name_and_unit(&self) -> (&'static str, &'static str) {
        match self {
            Self::Angle(_) => ("angle", "rad"),
            Self::JointSpeed(_) => ("joint_speed", "rad/s"),
            Self::JointAcceleration(_) => ("joint_acceleration", "rad/s2"),
            Self::Speed => ("speed", "mm/s"),
            Self::Acceleration => ("acceleration", "mm/s2"),
            Self::PenSpeed => ("pen_speed", "mm/s"),
            Self::PenAcceleration => ("pen_acceleration", "mm/s2"),
            Self::Tolerance => ("tolerance", "mm"),
            Self::AveragedTolerance => ("averaged_tolerance", "mm"),
            Self::Jump => ("jump", "mm/s2"),
            Self::JointJump(_) => ("joint_jump", "rad/s2"),
            Self::Gap => ("gap", "mm"),
            Self::Numbers => ("numbers", ""),
        }
    }

    /// The axis, from 1.
    #[must_use]
    pub fn axis(&self) -> Option<u8> {
        match self {
            Self::Angle(axis) | Self::JointSpeed(axis) | Self::JointAcceleration(axis) | Self::JointJump(axis) => {
                Some(*axis)
            }
            _ => None,
        }
    }
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.axis() {
            Some(axis) => write!(f, "{} of axis {axis}", self.name_and_unit().0),
            None => f.write_str(self.name_and_unit().0),
        }
    }
}
