//! The output of a laser or a dispenser: its value follows the path.
//!
//! The value belongs to the motion of the setpoints, so that it fits the line at corners and at every override. Outside strokes,
//! at rest and at every stop it is 0.

use super::{Config, IoError, IoRole, IoType};
use etherpen_motion::settings::{Bound, bound};
use serde::{Deserialize, Serialize};

/// What the value of the tool's output follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ToolFollows {
    /// Nothing: there is no such tool.
    #[default]
    Nothing,
    /// The speed along the stroke: from `minimum` at rest to `maximum` at `nominal_mm_s`.
    Speed,
    /// The way along the stroke: a pulse, or a count of pulses, for each `pitch_um`.
    Distance,
}

/// The output with the role `tool`: a laser or a dispenser.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Tool {
    /// What its value follows.
    pub follows: ToolFollows,
    /// Speed at which the value is `maximum`, mm/s, 1 to 10000; used with `speed`.
    pub nominal_mm_s: f32,
    /// Value that the speed adds to, in the terminal's units; used with `speed`. At rest the value is 0.
    pub minimum: u16,
    /// Value at the nominal speed and above, in the terminal's units, 1 to 65535; used with `speed`.
    pub maximum: u16,
    /// Way along the stroke for a pulse, um, 10 to 65535; used with `distance`.
    pub pitch_um: u16,
    /// Time by which the output is ahead of the tool, ms, 0 to 8: what the laser or the valve needs to react.
    pub lead_ms: u8,
    /// Whether the output is off from the first millisecond of a hold on. Otherwise it follows the path until the held drawing
    /// is at rest: the line has no gap.
    pub off_at_hold: bool,
}

impl Default for Tool {
    fn default() -> Self {
        Self {
            follows: ToolFollows::Nothing,
            nominal_mm_s: 0.0,
            minimum: 0,
            maximum: 0,
            pitch_um: 0,
            lead_ms: 0,
            off_at_hold: true,
        }
    }
}

/// Longest lead of the tool's output, ms: the setpoints that the critical task looks ahead, less the exchange's own.
const LEAD_MAX_MS: u8 = 8;
/// Rows of the tool in the table of bounds.
pub(super) const TOOL_BOUNDS: usize = 3;
/// Most pulses that a count advances by in a millisecond.
const PULSES_MAX_PER_MS: f64 = 100.0;
/// Milliseconds that a pulse of a bit takes: on, and off again.
const PULSE_MS: f64 = 2.0;

impl Tool {
    /// Hard bounds of its values; those that are not used may have any finite number.
    pub(super) fn bounds(&self) -> [Bound; TOOL_BOUNDS] {
        let used = |follows, name, value: f64, low, high| match self.follows == follows {
            true => bound(name, value, low, high),
            false => bound(name, value, f64::MIN, f64::MAX),
        };
        let nominal_mm_s = f64::from(self.nominal_mm_s);
        [
            used(ToolFollows::Speed, "tool.nominal_mm_s", nominal_mm_s, 1.0, 10_000.0),
            used(
                ToolFollows::Distance,
                "tool.pitch_um",
                self.pitch_um.into(),
                10.0,
                u16::MAX.into(),
            ),
            bound("tool.lead_ms", self.lead_ms.into(), 0.0, LEAD_MAX_MS.into()),
        ]
    }

    /// Whether an output of this type holds the values that follow the speed; a bit is on or off.
    fn fits(&self, kind: IoType) -> bool {
        let is_held = kind == IoType::Bool || self.maximum <= kind.most();
        is_held && self.maximum > 0 && self.minimum <= self.maximum
    }

    /// Shortest way for a pulse at this speed of the path, um, rounded up.
    fn least_um(kind: IoType, speed_mm_s: f64) -> u32 {
        let ms = match kind {
            IoType::Bool => PULSE_MS,
            _ => 1.0 / PULSES_MAX_PER_MS,
        };
        libm::ceil(speed_mm_s * ms) as u32
    }
}

impl Config {
    /// Checks the tool and its outputs against each other.
    pub(super) fn check_tool(&self) -> Result<(), IoError> {
        let follows = self.tool.follows;
        let mut outputs = (0_u8..).zip(&self.io).filter(|(_, point)| point.role == IoRole::Tool);
        if follows != ToolFollows::Nothing && outputs.clone().next().is_none() {
            return Err(IoError::ToolWithoutOutput);
        }
        outputs.try_for_each(|(io, point)| {
            let least_um = Tool::least_um(point.kind, self.motion.speed_mm_s);
            match follows {
                ToolFollows::Nothing => Err(IoError::ToolFollowsNothing { io }),
                ToolFollows::Speed if !self.tool.fits(point.kind) => Err(IoError::ToolRange {
                    io,
                    most: if point.kind == IoType::Bool {
                        u16::MAX
                    } else {
                        point.kind.most()
                    },
                }),
                ToolFollows::Distance if u32::from(self.tool.pitch_um) < least_um => {
                    Err(IoError::ToolPitch { io, least_um })
                }
                _ => Ok(()),
            }
        })
    }
}
