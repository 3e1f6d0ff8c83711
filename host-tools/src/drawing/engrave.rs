//! Engraving: long lines side by side that bend with the form, thicker by company where the picture is dark.
//!
//! One family of lines crosses the picture. Each line is lifted by the light around it, like a line drawn on a relief,
//! so that the lines show the form. A line is drawn where the ink is above its own threshold: every fourth line begins
//! in light shades, the lines between them only in darker ones. Thresholds have a hysteresis, so that a line neither
//! breaks nor begins for a speck.

use super::join::{self, Near};
use super::line::{self, Point};
use super::raster::Plane;

/// Distance of the densest lines, in widths of the pen.
const PITCH_PENS: f64 = 1.5;
/// Direction of the lines, radians.
const ANGLE_RAD: f64 = -0.42;
/// Lift of a line from black to white, in widths of the pen.
const RELIEF_PENS: f64 = 12.0;
/// Width over which the relief is smoothed, in widths of the pen.
const RELIEF_SIGMA_PENS: f64 = 9.0;
/// Ink at which the lines of each rank begin; a line's rank is the number of times two divides its number.
const THRESHOLDS: [f32; 4] = [0.62, 0.32, 0.16, 0.08];
/// Share of the threshold down to which a line goes on.
const GOES_ON: f32 = 0.72;
/// Shortest line and longest gap that is drawn over, in widths of the pen.
const LENGTH_PENS: f64 = 7.0;
const GAP_PENS: f64 = 2.5;

/// Longest bridge between the ends of neighbouring lines, in distances of the densest lines, and the least ink below it.
const BRIDGE_PITCHES: f64 = 3.0;
const BRIDGE_INK: f32 = 0.2;

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
            let flat = [
                middle[0] + along * cosine - across * sine,
                middle[1] + along * sine + across * cosine,
            ];
            let lift = (f64::from(relief.sample(flat[0] as f32, flat[1] as f32)) - 0.5) * RELIEF_PENS * pen;
            let at = [flat[0] + lift * sine, flat[1] - lift * cosine];
            let inside = at[0] >= 0.0 && at[1] >= 0.0 && at[0] < width && at[1] < height;
            let dark = if inside {
                calm.sample(at[0] as f32, at[1] as f32)
            } else {
                0.0
            };
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
    joined(lines, &calm, pitch)
}

/// Neighbouring lines joined at their ends where the picture is dark between them.
fn joined(lines: Vec<Vec<Point>>, ink: &Plane, pitch: f64) -> Vec<Vec<Point>> {
    let ends = join::ends(&lines);
    if ends.is_empty() {
        return lines;
    }
    let near = Near::of(&ends);
    let mut bridges = Vec::new();
    for (a, &from) in ends.iter().enumerate() {
        near.visit_within(a, from, BRIDGE_PITCHES * pitch, |b| {
            let Some(&to) = ends.get(b) else { return };
            let away = line::distance(from, to);
            let middle = line::between(from, to, 0.5);
            let is_dark = ink.sample(middle[0] as f32, middle[1] as f32) >= BRIDGE_INK;
            if a < b && a / 2 != b / 2 && away <= BRIDGE_PITCHES * pitch && is_dark {
                bridges.push((away, a, b));
            }
        });
    }
    join::join_ends(&lines, bridges)
}

fn keep(lines: &mut Vec<Vec<Point>>, run: &mut Vec<Point>, pen: f64) {
    let run = std::mem::take(run);
    if line::length(&run) >= LENGTH_PENS * pen {
        lines.push(run);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn darker_ink_has_more_lines_and_light_stays_white() {
        let light = Plane::filled(300, 300, 0.5);
        let length = |level: f32| {
            let ink = Plane::from_fn(300, 300, |x, _| if x < 150 { level } else { 0.0 });
            let lines = engrave(&ink, &light, 2.0, 1.0);
            assert!(lines.iter().flatten().all(|point| point[0] < 154.0));
            lines.iter().map(|points| line::length(points)).sum::<f64>()
        };
        let lengths = [0.02, 0.1, 0.2, 0.4, 0.8].map(length);
        assert_eq!(lengths[0], 0.0);
        assert!(lengths.windows(2).all(|pair| pair[1] > 1.5 * pair[0]), "{lengths:?}");
    }

    #[test]
    fn lines_bend_with_the_light() {
        let ink = Plane::filled(300, 300, 0.1);
        let bump = Plane::from_fn(300, 300, |x, y| {
            let away = (x as f32 - 150.0).hypot(y as f32 - 150.0) / 50.0;
            (-away * away).exp()
        });
        let bend = |light: &Plane| {
            let lines = engrave(&ink, light, 2.0, 1.0);
            let off = |points: &Vec<Point>| match (points.first(), points.last()) {
                (Some(&a), Some(&b)) => points
                    .iter()
                    .map(|&p| line::distance_to_segment(p, a, b))
                    .fold(0.0, f64::max),
                _ => 0.0,
            };
            lines
                .iter()
                .filter(|points| line::length(points) < 400.0)
                .map(off)
                .fold(0.0, f64::max)
        };
        assert!(bend(&bump) > bend(&Plane::filled(300, 300, 0.5)) + 4.0);
    }
}
