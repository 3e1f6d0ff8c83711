//! How the machine lowers and lifts its pen.

use super::{IoType, MotionLimits};
use etherpen_motion::settings::{Bound, Paper, bound};
use serde::{Deserialize, Serialize};

/// What lowers and lifts the pen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PenLiftKind {
    /// The machine's own axes, which lift the whole tool.
    #[default]
    Axis,
    /// The output with the role `pen`: a solenoid or a valve.
    Output,
    /// The output with the role `pen`, a word: the position of a servo.
    Servo,
    /// Nothing: the tool always touches.
    None,
}

impl PenLiftKind {
    /// Whether a terminal's output lowers the pen.
    pub const fn is_output(self) -> bool {
        matches!(self, Self::Output | Self::Servo)
    }
}

/// How the machine lowers and lifts its pen.
///
/// A machine whose pen is not lifted by an axis may lack the axis of the height. The path has its height all the same, so
/// that lowering and lifting take the time that the pen needs: the speed of the missing axis is the lift within that time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PenLift {
    /// What lowers and lifts the pen.
    pub kind: PenLiftKind,
    /// Time from the output's change until the pen touches, ms; used with an output.
    pub down_ms: u16,
    /// Time from the output's change until the pen has left the paper, ms; used with an output.
    pub up_ms: u16,
    /// Value of the output with the pen down, in the terminal's units, -65535 to 65535; used with a servo. 0, which the output
    /// has without the controller, must be on the side of `up`: `down` is neither 0 nor between 0 and `up`.
    pub down: i32,
    /// Value of the output with the pen up, in the terminal's units, -65535 to 65535; used with a servo. The output also has it
    /// at every stop.
    pub up: i32,
}

impl Default for PenLift {
    fn default() -> Self {
        Self {
            kind: PenLiftKind::Axis,
            down_ms: 60,
            up_ms: 40,
            down: 0,
            up: 0,
        }
    }
}

/// Longest time of a pen lift, ms.
const LIFT_MAX_MS: f64 = 1_000.0;
/// Rows of the pen lift in the table of bounds.
pub(super) const PEN_BOUNDS: usize = 4;

impl PenLift {
    /// Hard bounds of its values. A pen that no axis lifts cannot follow a sheet that is not level.
    pub(super) fn bounds(&self, paper: &Paper) -> [Bound; PEN_BOUNDS] {
        let [along_x, along_y] = paper.slope;
        let steepest = if self.kind == PenLiftKind::Axis {
            Paper::SLOPE_MAX
        } else {
            0.0
        };
        [
            bound("paper.slope[0]", along_x, -steepest, steepest),
            bound("paper.slope[1]", along_y, -steepest, steepest),
            bound("pen.down_ms", f64::from(self.down_ms), 0.0, LIFT_MAX_MS),
            bound("pen.up_ms", f64::from(self.up_ms), 0.0, LIFT_MAX_MS),
        ]
    }

    /// The part of the lift, mm, that takes the time of the pen: the corner between lift and travel may be rounded by the travel
    /// tolerance, which is not counted.
    pub(crate) fn lift_mm(&self, motion: &MotionLimits, paper: &Paper) -> f64 {
        (paper.pen_lift_mm - motion.travel_tolerance_mm).max(0.1 * paper.pen_lift_mm)
    }

    /// Bits of the pen's output with the pen up and down, at a point of this type; `None` if the type does not hold them, or
    /// if they are equal, or if an output that nobody writes, which is 0, would press the pen down: at `down` or beyond it.
    pub(crate) fn words(&self, kind: IoType) -> Option<[u32; 2]> {
        // Longer values would not fit a configuration message that is full otherwise.
        let fits = |value: i32| value.unsigned_abs() <= u16::MAX.into();
        let raw = |value: i32| kind.raw(value.into()).filter(|_| fits(value));
        let [up, down] = match self.kind {
            // Zero and up are not on the same side of down.
            PenLiftKind::Servo if self.down.cmp(&0) != self.down.cmp(&self.up) => return None,
            PenLiftKind::Servo => [raw(self.up)?, raw(self.down)?],
            _ => [0, 1],
        };
        (up != down && (kind == IoType::Bool) != (self.kind == PenLiftKind::Servo)).then_some([up, down])
    }

    /// The limits of motion with the vertical speed at which lowering and lifting take as long as the pen does. The corner
    /// between lift and travel may be rounded by the travel tolerance, which is not counted as lift.
    pub(super) fn within(&self, motion: &MotionLimits, paper: &Paper) -> MotionLimits {
        let slowest_ms = self.down_ms.max(self.up_ms);
        if !self.kind.is_output() || slowest_ms == 0 {
            return *motion;
        }
        let speed_mm_s = self.lift_mm(motion, paper) * 1_000.0 / f64::from(slowest_ms);
        let configured = motion.pen_speed_mm_s;
        MotionLimits {
            pen_speed_mm_s: if configured > 0.0 {
                speed_mm_s.min(configured)
            } else {
                speed_mm_s
            },
            ..*motion
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lowering_takes_at_least_as_long_as_the_pen_needs() {
        let (motion, paper) = (MotionLimits::default(), Paper::default());
        let lift = PenLift {
            kind: PenLiftKind::Output,
            down_ms: 50,
            up_ms: 20,
            ..PenLift::default()
        };
        // 3 mm less 0.5 mm in 50 ms.
        assert!((lift.within(&motion, &paper).pen_speed_mm_s - 50.0).abs() < 1e-9);
        let slower = MotionLimits {
            pen_speed_mm_s: 10.0,
            ..motion
        };
        assert_eq!(lift.within(&slower, &paper).pen_speed_mm_s, 10.0);
        assert_eq!(PenLift::default().within(&motion, &paper), motion);
        // Nothing lifts the pen, so that nothing has to be waited for.
        let none = PenLift {
            kind: PenLiftKind::None,
            ..lift
        };
        assert_eq!(none.within(&motion, &paper), motion);
    }

    #[test]
    fn a_pen_lowers_over_a_tenth_of_its_lift_at_least_however_far_corners_are_rounded() {
        let paper = Paper::default();
        for (travel_tolerance_mm, lift_mm) in [(0.5, 2.5), (2.7, 0.3), (3.0, 0.3), (30.0, 0.3)] {
            let motion = MotionLimits {
                travel_tolerance_mm,
                ..MotionLimits::default()
            };
            let found_mm = PenLift::default().lift_mm(&motion, &paper);
            assert!(
                (found_mm - lift_mm).abs() < 1e-9,
                "{travel_tolerance_mm} mm: {found_mm}"
            );
        }
    }

    #[test]
    fn a_servo_has_two_positions_that_its_word_holds_and_takes_its_time_as_a_solenoid() {
        let servo = PenLift {
            kind: PenLiftKind::Servo,
            down: 2_000,
            up: -1_000,
            ..PenLift::default()
        };
        assert_eq!(servo.words(IoType::I16), Some([0xFC18, 2_000]));
        let unusable = [IoType::Bool, IoType::U16, IoType::I8];
        assert!(unusable.iter().all(|kind| servo.words(*kind).is_none()));
        // Without power its word is 0: at the lower position or beyond it, and at the upper one, beyond it and before it.
        for (down, up, is_usable) in [
            (0, -1_000, false),
            (0, 1_000, false),
            (100, 2_000, false),
            (-100, -2_000, false),
            (1_000, 0, true),
            (2_000, 1_000, true),
            (-2_000, -1_000, true),
            (-2_000, 1_000, true),
        ] {
            let servo = PenLift { down, up, ..servo };
            assert_eq!(servo.words(IoType::I16).is_some(), is_usable, "down {down}, up {up}");
        }
        let long = PenLift { down: 65_536, ..servo };
        assert_eq!(long.words(IoType::I32), None);
        let still = PenLift { up: 2_000, ..servo };
        assert_eq!(still.words(IoType::I16), None);
        let solenoid = PenLift {
            kind: PenLiftKind::Output,
            ..servo
        };
        assert_eq!(solenoid.words(IoType::Bool), Some([0, 1]));
        assert_eq!(solenoid.words(IoType::U16), None);
        let (motion, paper) = (MotionLimits::default(), Paper::default());
        assert_eq!(servo.within(&motion, &paper), solenoid.within(&motion, &paper));
    }
}
