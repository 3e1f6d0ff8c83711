//! Engraving: long lines side by side that bend with the form, thicker by company where the picture is dark.
//!
//! One family of lines crosses the picture. Each line is lifted by the light around it, like a line drawn on a relief,
//! so that the lines show the form. A line is drawn where the ink is above its own threshold: every fourth line begins
//! in light shades, the lines between them only in darker ones. Thresholds have a hysteresis, so that a line neither
//! breaks nor begins for a speck.

use super::line::{self, Point};
use super::raster::Plane;

/// Distance of the densest lines, in widths of the pen.
const PITCH_PENS: f64 = 1.35;
/// Direction of the lines, radians.
const ANGLE_RAD: f64 = -0.42;
/// Lift of a line from black to white, in widths of the pen.
const RELIEF_PENS: f64 = 22.0;
/// Width over which the relief is smoothed, in widths of the pen.
const RELIEF_SIGMA_PENS: f64 = 9.0;
/// Ink at which the lines of each rank begin; a line's rank is the number of times two divides its number.
const THRESHOLDS: [f32; 4] = [0.56, 0.30, 0.15, 0.075];
/// Share of the threshold down to which a line goes on.
const GOES_ON: f32 = 0.72;
/// Shortest line and longest gap that is drawn over, in widths of the pen.
const LENGTH_PENS: f64 = 7.0;
const GAP_PENS: f64 = 2.5;

/// Lines in pixels for the ink that the picture requires and its light; `density` is 1 for the darkest.
pub(super) fn engrave(ink: &Plane, light: &Plane, pen: f64, density: f64) -> Vec<Vec<Point>> {
    let relief = light.blurred((RELIEF_SIGMA_PENS * pen) as f32);
    let calm = ink.blurred(0.8 * pen as f32);
    let pitch = PITCH_PENS * pen / density.clamp(0.1, 1.0);
    let (sine, cosine) = ANGLE_RAD.sin_cos();
    let (width, height) = (ink.width() as f64, ink.height() as f64);
    let middle = [0.5 * width, 0.5 * height];
    let reach = 0.5 * width.hypot(height) + RELIEF_PENS * pen;
    let count = (reach / pitch) as i64;
    let mut lines = Vec::new();
    for row in -count..=count {
        let rank = (row.unsigned_abs().trailing_zeros() as usize).min(THRESHOLDS.len() - 1);
        let threshold = THRESHOLDS[rank];
        let across = row as f64 * pitch;
        let mut run: Vec<Point> = Vec::new();
        let mut missing = 0.0;
        for step in -(reach as i64)..=reach as i64 {
            let along = step as f64;
            let flat = [middle[0] + along * cosine - across * sine, middle[1] + along * sine + across * cosine];
            let lift = (f64::from(relief.sample(flat[0] as f32, flat[1] as f32)) - 0.5) * RELIEF_PENS * pen;
            let at = [flat[0] + lift * sine, flat[1] - lift * cosine];
            let inside = at[0] >= 0.0 && at[1] >= 0.0 && at[0] < width && at[1] < height;
            let dark = if inside { calm.sample(at[0] as f32, at[1] as f32) } else { 0.0 };
            let limit = if run.is_empty() { threshold } else { GOES_ON * threshold };
            if inside && dark >= limit {
                run.push(at);
                missing = 0.0;
            } else if !run.is_empty() {
                missing += 1.0;
                if missing > GAP_PENS * pen || !inside {
                    keep(&mut lines, &mut run, pen);
                    missing = 0.0;
                }
            }
        }
        keep(&mut lines, &mut run, pen);
    }
    lines
}

fn keep(lines: &mut Vec<Vec<Point>>, run: &mut Vec<Point>, pen: f64) {
    let run = std::mem::take(run);
    if line::length(&run) >= LENGTH_PENS * pen {
        lines.push(run);
    }
}
