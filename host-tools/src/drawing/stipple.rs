//! One line through points whose density follows the picture's darkness.
//!
//! Points are set by error diffusion (Floyd and Steinberg, 1976) and moved to the centres of the ink nearest to each of
//! them (weighted Voronoi stippling, Secord, 2002). A short tour connects them. Where a link is much longer than the
//! distances of the points around it, the line is interrupted: it would cross white paper.

use super::line::{self, Point};
use super::raster::Plane;
use super::tour::shortest_tour;
use super::travel::Travel;
use crate::random::Lcg;

/// Distance between points where the ink is full, in widths of the pen.
const STIPPLE_PENS: f64 = 1.3;
/// Most points.
const STIPPLES_MAX: f64 = 20_000.0;
/// Ink below which the paper stays white.
const INK_MIN: f32 = 0.06;
/// Moves of all points to the centres of their ink.
const MOVES: usize = 14;
/// Longest link, in distances of points at both of its ends.
const LINK_MAX: f64 = 3.0;

/// One line through points whose density follows the ink, in pieces where white paper lies between; `density` is 1 for
/// the darkest.
pub(super) fn one_line(ink: &Plane, pen: f64, density: f64, seed: u64) -> Vec<Vec<Point>> {
    let ink = ink.map(|value| if value < INK_MIN { 0.0 } else { value });
    let spacing = spacing(&ink, pen, density);
    let mut points = stipples(&ink, spacing, seed);
    if points.len() < 2 {
        return Vec::new();
    }
    for _ in 0..MOVES {
        moved_to_centres(&mut points, &ink, spacing);
    }
    let ends: Vec<Point> = points.iter().flat_map(|&point| [point, point]).collect();
    let tour = shortest_tour(&ends, &Travel::Length, 1);
    let in_order = tour.iter().step_by(2).filter_map(|&end| points.get(end / 2).copied());
    let around = |at: Point| spacing / f64::from(ink.sample(at[0] as f32, at[1] as f32).max(INK_MIN)).sqrt();
    let mut lines: Vec<Vec<Point>> = Vec::new();
    let mut last: Option<Point> = None;
    for point in in_order {
        let is_near = |last: Point| line::distance(last, point) <= LINK_MAX * around(last).max(around(point));
        match (lines.last_mut(), last.is_some_and(is_near)) {
            (Some(line), true) => line.push(point),
            _ => lines.push(vec![point]),
        }
        last = Some(point);
    }
    lines.retain(|line| line.len() > 1);
    lines
}

/// Distance between points where the ink is full, pixels.
fn spacing(ink: &Plane, pen: f64, density: f64) -> f64 {
    let total: f64 = ink.values().iter().map(|&value| f64::from(value)).sum();
    (STIPPLE_PENS * pen / density.clamp(0.01, 1.0).sqrt()).max((total / STIPPLES_MAX).sqrt())
}

/// Points in cells of this size, each with a small random offset from the seed.
fn stipples(ink: &Plane, cell: f64, seed: u64) -> Vec<Point> {
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

/// Moves every point to the centre of the ink that is nearer to it than to any other point.
fn moved_to_centres(points: &mut [Point], ink: &Plane, spacing: f64) {
    let grid = Grid::of(points, [ink.width() as f64, ink.height() as f64], 2.0 * spacing);
    let mut sums = vec![[0.0_f64; 3]; points.len()];
    let mut guess = 0;
    for y in 0..ink.height() {
        for x in 0..ink.width() {
            let weight = f64::from(ink.at(x as isize, y as isize));
            if weight <= 0.0 {
                continue;
            }
            let at = [x as f64, y as f64];
            guess = grid.nearest(at, points, guess);
            if let Some(sum) = sums.get_mut(guess) {
                sum[0] += weight;
                sum[1] += weight * at[0];
                sum[2] += weight * at[1];
            }
        }
    }
    for (point, [weight, x, y]) in points.iter_mut().zip(sums) {
        if weight > 0.0 {
            *point = [x / weight, y / weight];
        }
    }
}

/// Points in square cells.
struct Grid {
    cell: f64,
    columns: usize,
    rows: usize,
    cells: Vec<Vec<u32>>,
}

impl Grid {
    fn of(points: &[Point], size: [f64; 2], cell: f64) -> Self {
        let cell = cell.max(1.0);
        let [columns, rows] = size.map(|side| (side / cell) as usize + 1);
        let mut result = Self {
            cell,
            columns,
            rows,
            cells: vec![Vec::new(); columns * rows],
        };
        for (k, &point) in points.iter().enumerate() {
            let (column, row) = result.place(point);
            if let Some(cell) = result.cells.get_mut(row * columns + column) {
                cell.push(k as u32);
            }
        }
        result
    }

    fn place(&self, at: Point) -> (usize, usize) {
        let index = |value: f64, count: usize| ((value / self.cell).max(0.0) as usize).min(count - 1);
        (index(at[0], self.columns), index(at[1], self.rows))
    }

    /// The point nearest to a place; `guess` is a point that may be near.
    fn nearest(&self, at: Point, points: &[Point], guess: usize) -> usize {
        let squared = |k: usize| {
            points.get(k).map_or(f64::INFINITY, |point| {
                (point[0] - at[0]).powi(2) + (point[1] - at[1]).powi(2)
            })
        };
        let (mut best, mut least) = (guess, squared(guess));
        let (column, row) = self.place(at);
        // Distance from the place to the nearest border of its cell.
        let inner = [at[0] - column as f64 * self.cell, at[1] - row as f64 * self.cell];
        let border = inner
            .iter()
            .map(|&from| from.min(self.cell - from))
            .fold(f64::INFINITY, f64::min)
            .max(0.0);
        for ring in 0..self.columns.max(self.rows) {
            if ring > 0 && least <= ((ring - 1) as f64 * self.cell + border).powi(2) {
                break;
            }
            let (left, right) = (column.saturating_sub(ring), (column + ring).min(self.columns - 1));
            let (top, bottom) = (row.saturating_sub(ring), (row + ring).min(self.rows - 1));
            for y in top..=bottom {
                for x in left..=right {
                    if x.abs_diff(column).max(y.abs_diff(row)) != ring {
                        continue;
                    }
                    for &k in self.cells.get(y * self.columns + x).into_iter().flatten() {
                        let away = squared(k as usize);
                        if away < least {
                            (best, least) = (k as usize, away);
                        }
                    }
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn half() -> Plane {
        Plane::from_fn(300, 300, |x, _| if x < 150 { 0.45 } else { 0.0 })
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

    #[test]
    fn no_link_crosses_white_paper() {
        let islands = Plane::from_fn(400, 200, |x, _| if !(100..300).contains(&x) { 0.5 } else { 0.0 });
        let lines = one_line(&islands, 2.0, 1.0, 1);
        assert_eq!(lines.len(), 2);
        let longest = lines
            .iter()
            .flat_map(|line| line.windows(2))
            .map(|pair| line::distance(pair[0], pair[1]));
        let longest = longest.fold(0.0, f64::max);
        assert!(longest < LINK_MAX * 2.0 * STIPPLE_PENS / 0.5_f64.sqrt(), "{longest}");
    }

    #[test]
    fn every_place_finds_the_point_nearest_to_it() {
        let mut random = Lcg::new(3);
        let points: Vec<Point> = (0..200)
            .map(|_| [100.0 * random.unit(), 60.0 * random.unit()])
            .collect();
        let grid = Grid::of(&points, [100.0, 60.0], 7.0);
        for _ in 0..500 {
            let at = [100.0 * random.unit(), 60.0 * random.unit()];
            let found = line::distance(points[grid.nearest(at, &points, 0)], at);
            let least = points
                .iter()
                .map(|&point| line::distance(point, at))
                .fold(f64::INFINITY, f64::min);
            assert_eq!(found, least);
        }
    }
}
