//! Styles besides the sketch: crossed straight hatching, and one line through points whose density follows the
//! picture's darkness.
//!
//! Both take the ink that the picture requires, 0 to 1 for each pixel, and return lines in pixels.

use super::join::{self, Near};
use super::line::{self, Point};
use super::raster::Plane;
use super::tour::shortest_tour;
use super::travel::Travel;
use crate::random::Lcg;

/// Style in which a photograph is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Style {
    /// Edges and dark lines, and tone by strokes along the picture's flow.
    #[default]
    Sketch,
    /// Edges and dark lines, and tone by straight lines in up to four directions.
    Hatch,
    /// Tone by strokes along the picture's flow, without edges.
    Flow,
    /// One line without many crossings, through points whose density follows the picture's darkness.
    Tsp,
    /// Edges and dark lines, and tone by long lines side by side that bend with the form.
    Engrave,
}

impl Style {
    /// The names of all styles.
    pub const NAMES: [&'static str; 5] = ["sketch", "hatch", "flow", "tsp", "engrave"];

    /// The style with a name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        let styles = [Self::Sketch, Self::Hatch, Self::Flow, Self::Tsp, Self::Engrave];
        let known = Self::NAMES.iter().position(|known| *known == name)?;
        styles.get(known).copied()
    }
}

/// Angles of the hatching's levels, degrees, and the least ink at which each level is drawn.
const LEVELS: [(f64, f32); 4] = [(-45.0, 0.10), (45.0, 0.32), (0.0, 0.55), (90.0, 0.76)];
/// Distance between a level's lines at full density, in pen widths.
const SPACING_PENS: f64 = 4.0;
/// Largest gap of a hatching line that is drawn over, and shortest line drawn, in pen widths.
const GAP_PENS: f64 = 2.5;
const LENGTH_PENS: f64 = 6.0;
/// Distance between the points of the one line at its darkest, in pen widths.
const STIPPLE_PENS: f64 = 1.4;
/// Most points of the one line.
const STIPPLES_MAX: f64 = 12_000.0;

/// Straight hatching; `density` is 1 for the darkest.
pub(super) fn hatch(ink: &Plane, pen: f64, density: f64) -> Vec<Vec<Point>> {
    let spacing = SPACING_PENS * pen / density.clamp(0.05, 1.5);
    let calm = ink.blurred(pen as f32);
    let mut result = Vec::new();
    for (angle_deg, threshold) in LEVELS {
        let runs = level(&calm, pen, spacing, angle_deg, threshold);
        let ends = join::ends(&runs);
        if ends.is_empty() {
            continue;
        }
        let near = Near::of(&ends);
        let mut bridges = Vec::new();
        for (a, &from) in ends.iter().enumerate() {
            near.visit_within(a, from, 1.7 * spacing, |b| {
                let away = line::distance(from, ends[b]);
                let middle = line::between(from, ends[b], 0.5);
                let is_dark = calm.sample(middle[0] as f32, middle[1] as f32) >= threshold;
                if a < b && a / 2 != b / 2 && away <= 1.7 * spacing && is_dark {
                    bridges.push((away, a, b));
                }
            });
        }
        result.extend(join::join_ends(&runs, bridges));
    }
    result
}

/// The lines of one level: where the ink is above its threshold.
fn level(ink: &Plane, pen: f64, spacing: f64, angle_deg: f64, threshold: f32) -> Vec<Vec<Point>> {
    let (sine, cosine) = angle_deg.to_radians().sin_cos();
    let (width, height) = (ink.width() as f64, ink.height() as f64);
    let middle = [0.5 * width, 0.5 * height];
    let reach = 0.5 * width.hypot(height);
    let mut runs = Vec::new();
    let count = (reach / spacing) as i64;
    for row in -count..=count {
        let across = row as f64 * spacing;
        let at = |along: f64| {
            [
                middle[0] + along * cosine - across * sine,
                middle[1] + along * sine + across * cosine,
            ]
        };
        let is_dark = |[x, y]: Point| {
            x >= 0.0 && y >= 0.0 && x < width && y < height && ink.sample(x as f32, y as f32) >= threshold
        };
        let mut run: Option<[f64; 2]> = None;
        for step in -(reach as i64)..=reach as i64 {
            let along = step as f64;
            if !is_dark(at(along)) {
                continue;
            }
            match &mut run {
                Some([_, to]) if along - *to <= GAP_PENS * pen => *to = along,
                _ => {
                    runs.extend(run.replace([along, along]).map(|[from, to]| (from, to, row)));
                }
            }
        }
        runs.extend(run.map(|[from, to]| (from, to, row)));
    }
    let long_enough = |run: &&(f64, f64, i64)| run.1 - run.0 >= LENGTH_PENS * pen;
    let place = |along: f64, row: i64| {
        let across = row as f64 * spacing;
        [
            middle[0] + along * cosine - across * sine,
            middle[1] + along * sine + across * cosine,
        ]
    };
    (runs.iter().filter(long_enough))
        .map(|&(from, to, row)| vec![place(from, row), place(to, row)])
        .collect()
}

/// One line through points whose density follows the ink; `density` is 1 for the darkest.
pub(super) fn one_line(ink: &Plane, pen: f64, density: f64, seed: u64) -> Vec<Vec<Point>> {
    let points = stipples(ink, pen, density, seed);
    if points.len() < 2 {
        return Vec::new();
    }
    let ends: Vec<Point> = points.iter().flat_map(|&point| [point, point]).collect();
    let tour = shortest_tour(&ends, &Travel::Length, 1);
    vec![
        tour.iter()
            .step_by(2)
            .filter_map(|&end| points.get(end / 2).copied())
            .collect(),
    ]
}

/// Points by error diffusion (Floyd and Steinberg, 1976) over cells, each with a small random offset from the seed.
fn stipples(ink: &Plane, pen: f64, density: f64, seed: u64) -> Vec<Point> {
    let total: f64 = ink.values().iter().map(|&value| f64::from(value)).sum();
    let finest = (total / STIPPLES_MAX).sqrt();
    let cell = (STIPPLE_PENS * pen / density.clamp(0.01, 1.0).sqrt()).max(finest);
    let columns = (ink.width() as f64 / cell) as usize;
    let rows = (ink.height() as f64 / cell) as usize;
    let calm = ink.blurred(0.4 * cell as f32);
    let mut random = Lcg::new(seed);
    let mut shift = || (random.unit() - 0.5) * 0.7;
    let mut points = Vec::new();
    let mut below = vec![0.0_f64; columns + 2];
    for row in 0..rows {
        let mut here = std::mem::replace(&mut below, vec![0.0; columns + 2]);
        for k in 0..columns {
            let (column, onward) = if row % 2 == 0 {
                (k, 1_isize)
            } else {
                (columns - 1 - k, -1)
            };
            let at = [(column as f64 + 0.5) * cell, (row as f64 + 0.5) * cell];
            let slot = column + 1;
            let wanted = f64::from(calm.sample(at[0] as f32, at[1] as f32)) + here[slot];
            let is_set = wanted >= 0.5;
            if is_set {
                points.push([at[0] + shift() * cell, at[1] + shift() * cell]);
            }
            let error = wanted - if is_set { 1.0 } else { 0.0 };
            let (next, last) = (slot.saturating_add_signed(onward), slot.saturating_add_signed(-onward));
            let spread = |cells: &mut [f64], place: usize, share: f64| {
                if let Some(value) = cells.get_mut(place) {
                    *value += error * share / 16.0;
                }
            };
            spread(&mut here, next, 7.0);
            spread(&mut below, last, 3.0);
            spread(&mut below, slot, 5.0);
            spread(&mut below, next, 1.0);
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    fn half() -> Plane {
        Plane::from_fn(300, 300, |x, _| if x < 150 { 0.45 } else { 0.0 })
    }

    #[test]
    fn hatching_crosses_where_it_is_darker_and_leaves_light_white() {
        let ink = |level: f32| {
            let plane = Plane::from_fn(300, 300, |x, _| if x < 150 { level } else { 0.0 });
            let lines = hatch(&plane, 2.0, 1.0);
            assert!(lines.iter().flatten().all(|point| point[0] < 154.0));
            lines.iter().map(|points| line::length(points)).sum::<f64>()
        };
        let (light, middle, dark) = (ink(0.2), ink(0.45), ink(0.9));
        assert!(
            light > 0.0 && middle > 1.7 * light && dark > 1.7 * middle,
            "{light} {middle} {dark}"
        );
    }

    #[test]
    fn one_line_goes_through_points_that_follow_the_ink_and_the_seed() {
        let lines = one_line(&half(), 2.0, 1.0, 1);
        assert_eq!(lines.len(), 1);
        let dark = lines[0].iter().filter(|point| point[0] < 152.0).count();
        assert_eq!(dark, lines[0].len());
        let wanted = 0.45 * 150.0 * 300.0 / (2.0 * STIPPLE_PENS).powi(2);
        assert!(
            (dark as f64 / wanted - 1.0).abs() < 0.1,
            "{dark} points, wanted {wanted}"
        );
        assert_eq!(lines, one_line(&half(), 2.0, 1.0, 1));
        assert_ne!(lines, one_line(&half(), 2.0, 1.0, 2));
    }
}
