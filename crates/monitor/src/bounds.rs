//! Bounds that the rules use, derived from the configuration once.
//!
//! Every bound is a configured limit plus a stated margin. The margins are what a correct controller needs: its delays,
//! the correction that it may add, the tolerance of its path.

use crate::cell::{AXES_MAX, Cell, JointLimits};

/// Speed above which a joint moves, rad/s.
pub(crate) const STILL_RAD_S: f64 = 1.0e-3;
/// How far a joint that is to stand may be from where it stood, rad. The controller promises it for a robot that only
/// holds (`tests/reactions/unreferenced.rs`); motors that take over their load from the brakes sag by less.
pub(crate) const STAND_RAD: f64 = 0.02;
/// Longest time from an order to its effect on the motors without an input shaper, ms: 12 for the planner's period, 24 for its ring of
/// setpoints, 12 for the sampler's look-ahead, at most 32 for the moving average, and the drives.
pub(crate) const PIPELINE_MS: u64 = 100;
/// Longest time from a decision of the controller to its arrival at the operator, ms: a serial line with telemetry on
/// it.
pub(crate) const REPORT_MS: u64 = 150;
/// Time after which the effects of a disturbance that was not noticed are over, ms: the position controller recovers in
/// five of its time constants, which are at most 25 ms, and a fault that was noticed has been told.
pub(crate) const SETTLE_MS: u64 = 300;
/// Longest time from a stop to drives that brake, ms: 8 from an opened contact (`tests/reactions/board.rs`), and one
/// for the alignment of milliseconds at each end. The drives' own delays come on top.
const REACTION_MS: u64 = 10;
/// Longest wait for a standstill (`STANDSTILL_MAX_MS` in `src/application`) and for the brakes (`BRAKE_DELAY_MS`), ms.
const STANDSTILL_AND_BRAKE_MS: u64 = 1_000 + 100;
/// Time until the drives have obeyed a change of their power, ms.
const POWER_CHANGE_MS: u64 = 100;
/// Part of the acceleration limits that any braking motion uses at least: a jog uses a quarter, the path more.
const BRAKING_PART: f64 = 0.25;
/// Fastest jog, mm/s, and its largest deceleration, mm/s2 (`crates/motion/src/jog.rs`).
const JOG_SPEED_MAX_MM_S: f64 = 250.0;
const JOG_DECELERATION_MAX_MM_S2: f64 = 2_000.0;
/// Fastest override over the configured speed.
const OVERRIDE_MAX: f64 = 2.0;
/// Relative and absolute margin of joint speeds.
const JOINT_SPEED_PART: f64 = 1.05;
const JOINT_SPEED_RAD_S: f64 = 0.1;
/// Relative margin of joint accelerations, and what weight does to a joint without torque, rad/s2.
const ACCELERATION_PART: f64 = 1.25;
const FALL_RAD_S2: f64 = 150.0;
/// Time by which the tool lags behind a change of speed, s.
const FOLLOWING_LAG_S: f64 = 4.0e-3;
/// Distance from an end of a joint's range in sound motion, rad: the planner keeps a margin of its own.
const RANGE_RAD: f64 = 0.005;
/// Distance of the mechanical end stops from the ends of the range, rad, rounded up.
const END_STOP_RAD: f64 = 0.06;
/// Distance from a border of the work area in sound motion, mm, besides the following error.
const AREA_MM: f64 = 0.3;

/// Bounds of one joint.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct JointBounds {
    pub(crate) low_rad: f64,
    pub(crate) high_rad: f64,
    /// Widening of the range while something is disturbed.
    pub(crate) disturbed_rad: f64,
    pub(crate) speed_rad_s: f64,
    /// Greatest speed while the axes are led to their home switches.
    pub(crate) search_rad_s: f64,
    pub(crate) acceleration_rad_s2: f64,
    /// Rise of the speed in a second while something is disturbed, rad/s2.
    pub(crate) disturbed_rad_s2: f64,
    /// Weakest deceleration of a stop.
    pub(crate) stop_rad_s2: f64,
}

impl JointBounds {
    fn new(limits: &JointLimits) -> Self {
        let added = (limits.feedback_gain_per_s * limits.following_error_max_rad).abs();
        let fastest = (limits.speed_rad_s + added).min(limits.output_max_rad_s);
        let acceleration_rad_s2 = limits.acceleration_rad_s2 * ACCELERATION_PART + FALL_RAD_S2;
        Self {
            low_rad: limits.range_rad[0] - RANGE_RAD,
            high_rad: limits.range_rad[1] + RANGE_RAD,
            disturbed_rad: END_STOP_RAD - RANGE_RAD,
            speed_rad_s: fastest * JOINT_SPEED_PART + JOINT_SPEED_RAD_S,
            search_rad_s: limits.search_rad_s.abs() * JOINT_SPEED_PART + JOINT_SPEED_RAD_S,
            acceleration_rad_s2,
            // A correction can turn round within a millisecond; a larger one is a fault.
            disturbed_rad_s2: acceleration_rad_s2 + 2.0 * added * 1_000.0,
            stop_rad_s2: limits.quick_stop_rad_s2.min(limits.brake_rad_s2).max(1.0e-3) * 0.98,
        }
    }
}

/// All bounds.
#[derive(Clone, Debug)]
pub(crate) struct Bounds {
    pub(crate) joints: [JointBounds; AXES_MAX],
    /// Number of axes that are judged.
    pub(crate) axes: usize,
    /// Speed of the tool while it lifts or lowers the pen, mm/s, without margin.
    pub(crate) lift_mm_s: f64,
    /// Longest time for a change of the path's speed, ms.
    pub(crate) slowing_ms: u64,
    /// Longest time from an order to hold or to cancel to rest, ms.
    pub(crate) hold_ms: u64,
    /// Deceleration of a jog, mm/s2.
    pub(crate) jog_mm_s2: f64,
    /// Longest time from a stop to drives that brake, ms.
    pub(crate) reaction_ms: u64,
    /// Longest time from a stop to drives that brake if the telegrams do not reach them, ms.
    pub(crate) watchdog_ms: u64,
    /// Longest time from the end of an order to drives without power, ms.
    pub(crate) power_off_ms: u64,
    /// Distance of the tool from the path with the pen down and up, mm.
    pub(crate) drawn_mm: f64,
    pub(crate) travel_mm: f64,
    /// Distance of a pen that draws from its line in plan view while nothing is disturbed, mm.
    pub(crate) undisturbed_mm: f64,
    /// Distance of the tool from the work area, mm.
    pub(crate) area_mm: f64,
    /// Height up to which the pen may touch at the sheet's centre, mm.
    pub(crate) touch_z_mm: f64,
    /// Lowest z over the sheet's centre, mm.
    pub(crate) paper_low_mm: f64,
    /// The height that all legs count at, mm, where no axis moves the tool up and down.
    pub(crate) plan_z_mm: Option<f64>,
}

impl Bounds {
    pub(crate) fn new(cell: &Cell) -> Self {
        let mut joints = [JointBounds::default(); AXES_MAX];
        for (bounds, limits) in joints.iter_mut().zip(&cell.joints) {
            *bounds = JointBounds::new(limits);
        }
        let slowest = cell.joints.iter().map(|joint| joint.acceleration_rad_s2);
        let slowest = slowest.fold(f64::INFINITY, f64::min);
        let by_joints = slowest / cell.robot.slope_max_rad_mm();
        let along = at_least(BRAKING_PART * cell.tool_acceleration_mm_s2.min(by_joints));
        let pen_acceleration = or_none(cell.pen_acceleration_mm_s2).min(cell.tool_acceleration_mm_s2);
        let fastest = OVERRIDE_MAX * cell.tool_speed_mm_s.max(cell.travel_speed_mm_s);
        let braking_ms = milliseconds(fastest / along);
        let lift_speed = cell.travel_speed_mm_s.min(or_none(cell.pen_speed_mm_s));
        let lift_s = cell.paper.pen_lift_mm / at_least(lift_speed)
            + 2.0 * (cell.paper.pen_lift_mm / at_least(BRAKING_PART * pen_acceleration.min(by_joints))).sqrt();
        let pauses_ms = 2 * u64::from(cell.pen_dwell_ms);
        let pipeline_ms = PIPELINE_MS + u64::from(cell.shaper_ms);
        let lag = 0.5 * cell.tool_acceleration_mm_s2 * FOLLOWING_LAG_S * FOLLOWING_LAG_S;
        let following_mm = cell.following_mm + lag.max(0.0);
        Self {
            joints,
            axes: cell.joints.len().min(AXES_MAX),
            lift_mm_s: lift_speed.min((cell.tool_acceleration_mm_s2 * cell.paper.pen_lift_mm).max(0.0).sqrt()),
            slowing_ms: pipeline_ms + braking_ms,
            // A pen that is being lowered is lowered, and then lifted.
            hold_ms: pipeline_ms + braking_ms + 3 * milliseconds(lift_s) + pauses_ms + SETTLE_MS,
            jog_mm_s2: JOG_DECELERATION_MAX_MM_S2
                .min(BRAKING_PART * cell.tool_acceleration_mm_s2.min(by_joints))
                .min(or_none(cell.pen_acceleration_mm_s2)),
            reaction_ms: REACTION_MS + u64::from(cell.drive_delay_ms),
            watchdog_ms: 2 * REACTION_MS + u64::from(cell.drive_delay_ms) + u64::from(cell.watchdog_ms),
            power_off_ms: STANDSTILL_AND_BRAKE_MS + POWER_CHANGE_MS,
            drawn_mm: cell.tolerance_mm + following_mm,
            travel_mm: cell.travel_tolerance_mm.max(cell.tolerance_mm) + following_mm,
            undisturbed_mm: cell.tolerance_mm + cell.undisturbed_mm + lag.max(0.0),
            area_mm: AREA_MM + following_mm,
            touch_z_mm: cell.paper.pen_down_z_mm + cell.paper.pen_spring_mm,
            plan_z_mm: (!cell.has_height_axis).then_some(cell.paper.pen_down_z_mm),
            paper_low_mm: cell.paper.pen_down_z_mm - cell.paper.pressing_depth_mm,
        }
    }

    /// Longest time from the last message of a jog with this speed, mm/s, to rest, ms.
    pub(crate) fn jog_ms(&self, cell: &Cell, speed_mm_s: f64) -> u64 {
        let speed = speed_mm_s.min(JOG_SPEED_MAX_MM_S).min(cell.travel_speed_mm_s);
        let pipeline_ms = PIPELINE_MS + u64::from(cell.shaper_ms);
        u64::from(cell.dead_man_ms) + pipeline_ms + milliseconds(speed / at_least(self.jog_mm_s2))
    }

    /// A speed of the tool with its margin, mm/s.
    pub(crate) fn with_margin(cell: &Cell, speed_mm_s: f64) -> f64 {
        speed_mm_s * (1.0 + cell.overshoot_part) + cell.overshoot_mm_s
    }

    /// Longest time in which a joint comes to rest from a speed, ms, once its drive brakes.
    pub(crate) fn ramp_ms(&self, axis: usize, speed_rad_s: f64) -> u64 {
        let stop_rad_s2 = self.joints.get(axis).map_or(1.0, |joint| joint.stop_rad_s2);
        milliseconds(speed_rad_s.abs() / stop_rad_s2)
    }
}

/// A limit of 0 means none.
fn or_none(limit: f64) -> f64 {
    if limit > 0.0 { limit } else { f64::INFINITY }
}

/// A divisor above 0.
fn at_least(value: f64) -> f64 {
    if value > 1.0e-3 { value } else { 1.0e-3 }
}

/// Seconds as whole milliseconds, rounded up; at most an hour.
fn milliseconds(seconds: f64) -> u64 {
    (seconds * 1_000.0).ceil().clamp(0.0, 3.6e6) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_bounds_are_near_the_configured_limits() {
        let bounds = Bounds::new(&Cell::default());
        let joint = bounds.joints[0];
        // 25 rad/s and 4 rad/s of correction are more than the largest command, 27 rad/s.
        assert!((joint.speed_rad_s - 28.45).abs() < 1e-9, "{joint:?}");
        assert!((joint.acceleration_rad_s2 - 462.5).abs() < 1e-9);
        assert!((bounds.drawn_mm - 0.43).abs() < 1e-9, "{bounds:?}");
        assert!((bounds.travel_mm - 0.88).abs() < 1e-9);
        assert_eq!(
            (bounds.reaction_ms, bounds.watchdog_ms, bounds.power_off_ms),
            (12, 32, 1_200)
        );
        assert_eq!(bounds.jog_ms(&Cell::default(), 50.0), 100 + 100 + 25);
        assert!(bounds.hold_ms < 2_000, "{} ms", bounds.hold_ms);
    }

    #[test]
    fn limits_of_nothing_and_of_nonsense_give_finite_times() {
        for value in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300] {
            let cell = Cell {
                tool_acceleration_mm_s2: value,
                travel_speed_mm_s: value,
                pen_speed_mm_s: value,
                joints: Vec::new(),
                ..Cell::default()
            };
            let bounds = Bounds::new(&cell);
            assert!(bounds.hold_ms < 20_000_000 && bounds.ramp_ms(9, value) < 4_000_000);
        }
    }
}
