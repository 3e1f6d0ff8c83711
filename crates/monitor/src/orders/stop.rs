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

/// Least share of its quick stop's deceleration with which the joint brakes that is fastest for its deceleration, in a stop
/// that keeps the path: the others brake in proportion, or less where the path bends.
const ON_PATH_SHARE: f64 = 0.6;
/// How much later a stop that keeps the path brakes, ms: 4 for commands already sent, and 4 until its supervision finds a
/// joint that does not brake, which is the quick stop.
const ON_PATH_LATER_MS: u64 = 8;
/// Words that begin the report of a fault for which the robot brakes on its path (`Fault::keeps_path`).
const KEEP_PATH: [&str; 3] = [BY_COMMAND, "CyclesLate", "MotionStalled"];
/// Words that begin the report of a stop that the operator has commanded.
const BY_COMMAND: &str = "EmergencyStop(Link";

/// Why everything has to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StopCause {
    Command,
    Input,
    Clock,
    /// A fault that is the quick stop at once.
    Fault,
    /// A fault for which the robot brakes on its path.
    FaultOnPath,
    Restart,
}

impl StopCause {
    pub(crate) const fn words(self) -> &'static str {
        match self {
            Self::Command => "the stop command",
            Self::Input => "the emergency-stop input opened",
            Self::Clock => "the board's clock source failed",
            Self::Fault | Self::FaultOnPath => "a fault was reported",
            Self::Restart => "the controller restarted",
        }
    }

    /// The cause of a stop for a fault reported in these words.
    pub(crate) fn of_fault(words: &str) -> Self {
        match KEEP_PATH.iter().any(|begin| words.starts_with(begin)) {
            true => Self::FaultOnPath,
            false => Self::Fault,
        }
    }

    /// Whether the robot may brake on its path.
    pub(crate) const fn keeps_path(self) -> bool {
        matches!(self, Self::Command | Self::FaultOnPath)
    }
}

/// Whether the words of a fault tell of a stop that the operator has commanded.
pub(crate) fn is_by_command(words: &str) -> bool {
    words.starts_with(BY_COMMAND)
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
        let reaction_ms = if self.waits_for_watchdog {
            bounds.watchdog_ms
        } else {
            bounds.reaction_ms
        };
        reaction_ms + if self.cause.keeps_path() { ON_PATH_LATER_MS } else { 0 }
    }

    /// Longest time that a quick stop of a joint would have taken at the beginning, s.
    fn quick_stop_s(&self, bounds: &Bounds) -> f64 {
        let joints = self.speeds_rad_s.iter().zip(&bounds.joints).take(bounds.axes);
        joints.fold(0.0, |longest, (speed, joint)| {
            f64::max(longest, speed / joint.stop_rad_s2)
        })
    }

    /// Largest speed of a joint at a time, rad/s; 0 once it has to stand.
    pub(crate) fn speed_max_rad_s(&self, axis: usize, now_ms: u64, bounds: &Bounds) -> f64 {
        let (Some(speed), Some(joint)) = (self.speeds_rad_s.get(axis), bounds.joints.get(axis)) else {
            return f64::INFINITY;
        };
        let passed_ms = now_ms.saturating_sub(self.since_ms);
        let braked_ms = passed_ms.saturating_sub(self.reaction_ms(bounds));
        let braked_s = braked_ms as f64 / 1_000.0;
        let left = match self.cause.keeps_path() {
            // On a path that bends a joint may gain speed while the others lose it.
            true => joint.stop_rad_s2 * (self.quick_stop_s(bounds) - ON_PATH_SHARE * braked_s),
            false => speed - joint.stop_rad_s2 * braked_s,
        };
        if left > 0.0 {
            left * SPEED_PART + SPEED_RAD_S
        } else {
            0.0
        }
    }

    /// Longest time until all joints stand, ms.
    pub(crate) fn duration_ms(&self, bounds: &Bounds) -> u64 {
        let ramps = self.speeds_rad_s.iter().take(bounds.axes).enumerate();
        let longest_ms = ramps
            .map(|(axis, speed)| bounds.ramp_ms(axis, *speed))
            .max()
            .unwrap_or(0);
        let longest_ms = match self.cause.keeps_path() {
            true => (longest_ms as f64 / ON_PATH_SHARE).ceil() as u64,
            false => longest_ms,
        };
        self.reaction_ms(bounds) + longest_ms
    }
}
