//! Shares of the tolerance: the moving average and its longest length, the input shaper and its lowest frequency, merged
//! vertices, and what remains for shaping.

use super::input_shaper::Copies;
use super::{MotionLimits, Settings, TICK_S};

/// Largest part of the tolerance that the moving average may use.
const AVERAGE_PART_MAX: f64 = 0.5;

/// Part of the tolerance that merged vertices may use.
const MERGING_PART: f64 = 0.2;

/// Largest part of the tolerance that the moving average and the input shaper may use together.
const SMOOTHING_PART_MAX: f64 = 0.75;

const _: () = assert!(AVERAGE_PART_MAX < SMOOTHING_PART_MAX && SMOOTHING_PART_MAX + MERGING_PART < 1.0);

/// Tolerances for shaping, less the shares of the moving average and of the input shaper, mm.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tolerances {
    pub(crate) drawing_mm: f64,
    pub(crate) travel_mm: f64,
    /// Share of merged vertices, which a leg loses if it replaces others.
    pub(crate) merging_mm: f64,
}

/// Tolerances for shaping: the configured ones less the parts used by the moving average and the input shaper.
pub(crate) fn tolerances(settings: &Settings) -> Tolerances {
    let motion = &settings.motion;
    let (_, average_mm) = averaging(motion);
    let copies_mm = Copies::new(motion).map_or(0.0, |copies| copies.at_tool_mm(motion.acceleration_mm_s2));
    // Settings that were not checked may ask for more than there is.
    let used_mm = (average_mm + copies_mm).min(SMOOTHING_PART_MAX * motion.tolerance_mm);
    Tolerances {
        drawing_mm: settings.motion.tolerance_mm - used_mm,
        travel_mm: settings.motion.travel_tolerance_mm - used_mm,
        merging_mm: MERGING_PART * settings.motion.tolerance_mm,
    }
}

/// Length of the moving average that the planner uses, ms: the configured one, or the longest shorter one whose deviation
/// takes at most half of the tolerance.
#[must_use]
pub fn effective_jerk_window_ms(settings: &Settings) -> u16 {
    averaging(&settings.motion).0
}

/// Lowest frequency of a resonance that the input shaper may keep quiet within the tolerance, Hz.
#[must_use]
pub fn resonance_min_hz(motion: &MotionLimits) -> f64 {
    let (_, average_mm) = averaging(motion);
    Copies::lowest_hz(motion, SMOOTHING_PART_MAX * motion.tolerance_mm - average_mm)
}

/// How far the setpoints may lie from their line beside the tolerance, mm: a resonant tool swings outward where the input
/// shaper leads them inside. 0 without an input shaper.
#[must_use]
pub fn shaper_deviation_mm(motion: &MotionLimits) -> f64 {
    Copies::new(motion).map_or(0.0, |copies| copies.at_setpoints_mm(motion.acceleration_mm_s2))
}

/// Length of the moving average, ms, and the deviation that it adds, mm: A T^2 / 24, plus A t^2 / 12 for setpoints the
/// time t apart, which cut corners by A t^2 / 8 but average over t less.
pub(crate) fn averaging(motion: &MotionLimits) -> (u16, f64) {
    let deviation = |window_ms: u16| {
        let window_s = f64::from(window_ms) * TICK_S;
        motion.acceleration_mm_s2 * (window_s * window_s + 2.0 * TICK_S * TICK_S) / 24.0
    };
    let mut window_ms = motion.jerk_window_ms;
    while window_ms > 1 && deviation(window_ms) > AVERAGE_PART_MAX * motion.tolerance_mm {
        window_ms -= 1;
    }
    if window_ms > 1 {
        (window_ms, deviation(window_ms))
    } else {
        (window_ms, 0.0)
    }
}
