//! A stop that every joint has to obey.

use crate::bounds::Bounds;
use crate::cell::AXES_MAX;
use crate::motion::Motion;

/// How long the emergency-stop input may be open without a stop, ms: it counts as open after 3 (`STOP_OPEN_MS` in
/// `src/board.rs`), and one more for the alignment of milliseconds.
pub(crate) const STOP_OPEN_MS: u64 = 4;
/// Relative and absolute margin of the speed in a stop.
const SPEED_PART: f64 = 1.05;
const SPEED_RAD_S: f64 = 0.1;

/// Why everything has to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StopCause {
    Command,
    Input,
    Fault,
    Restart,
}

impl StopCause {
    pub(crate) const fn words(self) -> &'static str {
        match self {
            Self::Command => "the stop command",
            Self::Input => "the emergency-stop input opened",
            Self::Fault => "a fault was reported",
            Self::Restart => "the controller restarted",
        }
    }
}

/// A stop that every joint has to obey.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stop {
    pub(crate) cause: StopCause,
    pub(crate) since_ms: u64,
    speeds_rad_s: [f64; AXES_MAX],
    /// Whether the stop may have to wait for the drives' watchdog.
    waits_for_watchdog: bool,
}

impl Stop {
    /// A stop that begins now. In a disturbance the joints may be faster by the time the drives brake.
    pub(crate) fn new(cause: StopCause, motion: &Motion, bounds: &Bounds, is_disturbed: bool) -> Self {
        let mut speeds_rad_s = motion.speeds_rad_s;
        for (speed, joint) in speeds_rad_s.iter_mut().zip(&bounds.joints) {
            let reaction_s = bounds.reaction_ms as f64 / 1_000.0;
            let reached = speed.abs() + joint.acceleration_rad_s2 * reaction_s;
            *speed = if is_disturbed { joint.speed_rad_s } else { reached };
        }
        Self {
            cause,
            since_ms: motion.now_ms,
            speeds_rad_s,
            waits_for_watchdog: cause == StopCause::Restart,
        }
    }

    /// Lets the stop wait for the drives' watchdog: the telegrams may not reach them.
    pub(crate) fn wait_for_watchdog(&mut self) {
        self.waits_for_watchdog = true;
    }

    fn reaction_ms(&self, bounds: &Bounds) -> u64 {
        if self.waits_for_watchdog {
            bounds.watchdog_ms
        } else {
            bounds.reaction_ms
        }
    }

    /// Largest speed of a joint at a time, rad/s; 0 once it has to stand.
    pub(crate) fn speed_max_rad_s(&self, axis: usize, now_ms: u64, bounds: &Bounds) -> f64 {
        let (Some(speed), Some(joint)) = (self.speeds_rad_s.get(axis), bounds.joints.get(axis)) else {
            return f64::INFINITY;
        };
        let passed_ms = now_ms.saturating_sub(self.since_ms);
        let braked_ms = passed_ms.saturating_sub(self.reaction_ms(bounds));
        let left = speed - joint.stop_rad_s2 * braked_ms as f64 / 1_000.0;
        if left > 0.0 {
            left * SPEED_PART + SPEED_RAD_S
        } else {
            0.0
        }
    }

    /// Longest time until all joints stand, ms.
    pub(crate) fn duration_ms(&self, bounds: &Bounds) -> u64 {
        let ramps = self.speeds_rad_s.iter().take(bounds.axes).enumerate();
        let longest = ramps.map(|(axis, speed)| bounds.ramp_ms(axis, *speed)).max();
        self.reaction_ms(bounds) + longest.unwrap_or(0)
    }
}
