//! Dark lines and edges of a picture as open lines along their centres.
//!
//! A difference of Gaussians across the picture's flow responds once to a dark line, in its middle, and once to a step,
//! on its dark side (Kang, Lee, Chui, *Coherent Line Drawing*, 2007); it never produces an outline around a line. The
//! response is thinned to one pixel by non-maximum suppression (Canny), filtered with two thresholds, and traced into
//! lines that continue straight where several meet.

use super::line::{self, Point};
use super::raster::Plane;

/// How far the flow is followed on either side to make lines coherent, pixels.
const FLOW_REACH: usize = 6;
/// Width of the surround of the difference of Gaussians, times that of its centre.
const SURROUND_RATIO: f32 = 1.6;
/// Cosine of the largest turn of a continuation.
const TURN_COSINE_MIN: f64 = 0.3;

/// Orientation of the picture's lines at each pixel: the structure tensor's direction of least change.
pub(crate) struct Flow {
    /// Cosine of the doubled angle, weighted by coherence.
    cosine: Plane,
    /// Sine of the doubled angle, weighted by coherence.
    sine: Plane,
}

impl Flow {
    /// Flow of `light`, smoothed over `sigma` pixels.
    ///
    /// `rest_angle_rad` is the direction where the picture has none; `rest_weight` is the gradient (per pixel) at which
    /// the picture and that direction have equal weight.
    pub(crate) fn of(light: &Plane, sigma: f32, rest_angle_rad: f32, rest_weight: f32) -> Self {
        let gradient = |x: usize, y: usize| {
            let (x, y) = (x as isize, y as isize);
            let dx = 0.5 * (light.at(x + 1, y) - light.at(x - 1, y));
            let dy = 0.5 * (light.at(x, y + 1) - light.at(x, y - 1));
            // As exact as `hypot`, which is a call of a function.
            let square = f64::from(dx) * f64::from(dx) + f64::from(dy) * f64::from(dy);
            let size = (square.sqrt() as f32).max(1e-9);
            (dx, dy, size)
        };
        let (width, height) = (light.width(), light.height());
        let cosine = Plane::from_fn(width, height, |x, y| {
            let (dx, dy, size) = gradient(x, y);
            (dy * dy - dx * dx) / size
        });
        let sine = Plane::from_fn(width, height, |x, y| {
            let (dx, dy, size) = gradient(x, y);
            -2.0 * dx * dy / size
        });
        let (rest_sine, rest_cosine) = (2.0 * rest_angle_rad).sin_cos();
        Self {
            cosine: cosine.blurred(sigma).map(|v| v + rest_weight * rest_cosine),
            sine: sine.blurred(sigma).map(|v| v + rest_weight * rest_sine),
        }
    }

    /// This flow where `share` is 0, `other` where it is 1.
    pub(crate) fn mixed(&self, other: &Self, share: &Plane) -> Self {
        Self {
            cosine: self.cosine.mixed(&other.cosine, share),
            sine: self.sine.mixed(&other.sine, share),
        }
    }

    /// This flow turned to one direction where `share` is 1; `weight` is that direction's weight against the picture's.
    pub(crate) fn turned_to(&self, angle_rad: f32, weight: f32, share: &Plane) -> Self {
        let (sine, cosine) = (2.0 * angle_rad).sin_cos();
        Self {
            cosine: self
                .cosine
                .zip(share, |own, share| own * (1.0 - share) + share * weight * cosine),
            sine: self
                .sine
                .zip(share, |own, share| own * (1.0 - share) + share * weight * sine),
        }
    }

    /// This flow turned everywhere by the same angle.
    pub(crate) fn turned(&self, angle_rad: f32) -> Self {
        let (sine, cosine) = (2.0 * angle_rad).sin_cos();
        Self {
            cosine: self.cosine.zip(&self.sine, |c, s| c * cosine - s * sine),
            sine: self.cosine.zip(&self.sine, |c, s| c * sine + s * cosine),
        }
    }

    /// Unit vector along the flow at every pixel, row by row.
    fn tangents(&self) -> Vec<[f32; 2]> {
        let tangent = |(&cosine, &sine): (&f32, &f32)| {
            let (sine, cosine) = (0.5 * sine.atan2(cosine)).sin_cos();
            [cosine, sine]
        };
        self.cosine
            .values()
            .iter()
            .zip(self.sine.values())
            .map(tangent)
            .collect()
    }

    /// Unit vector along the flow at a place; of the two opposite ones, the one towards `along`.
    pub(crate) fn tangent(&self, at: Point, along: Point) -> Point {
        let (x, y) = (at[0] as f32, at[1] as f32);
        let angle = 0.5 * f64::from(self.sine.sample(x, y).atan2(self.cosine.sample(x, y)));
        let (sine, cosine) = angle.sin_cos();
        if cosine * along[0] + sine * along[1] < 0.0 {
            [-cosine, -sine]
        } else {
            [cosine, sine]
        }
    }
}

/// Strength of dark lines whose half width is about `sigma` pixels: 0 where there is none.
pub(crate) fn line_strength(light: &Plane, flow: &Flow, sigma: f32) -> Plane {
    let reach = (2.0 * SURROUND_RATIO * sigma).ceil() as i32;
    let weights: Vec<(f32, f32)> = {
        let bell = |t: i32, sigma: f32| (-0.5 * (t as f32 / sigma).powi(2)).exp();
        let sums = (-reach..=reach).fold((0.0, 0.0), |sum, t| {
            (sum.0 + bell(t, sigma), sum.1 + bell(t, SURROUND_RATIO * sigma))
        });
        (-reach..=reach)
            .map(|t| {
                (
                    t as f32,
                    bell(t, SURROUND_RATIO * sigma) / sums.1 - bell(t, sigma) / sums.0,
                )
            })
            .collect()
    };
    let tangents = flow.tangents();
    let (width, height) = (light.width(), light.height());
    let across = Plane::from_fn(width, height, |x, y| {
        let [tx, ty] = tangents[y * width + x];
        let (nx, ny) = (-ty, tx);
        let place = |t: f32| (x as f32 + nx * t, y as f32 + ny * t);
        match light.is_inside(x, y, reach as usize + 1) {
            true => (weights.iter().map(|&(t, weight)| (place(t), weight)))
                .map(|((x, y), weight)| weight * light.sample_inside(x, y))
                .sum(),
            false => (weights.iter().map(|&(t, weight)| (place(t), weight)))
                .map(|((x, y), weight)| weight * light.sample(x, y))
                .sum(),
        }
    });
    Plane::from_fn(width, height, |x, y| {
        let is_inside = across.is_inside(x, y, FLOW_REACH + 1);
        let [tx, ty] = tangents[y * width + x];
        // Both ways at once, and their sum in order: one does not wait for the other.
        let mut found = [[0.0; FLOW_REACH]; 2];
        let mut ways = [[tx, ty], [-tx, -ty]].map(|along| ([x as f32, y as f32], along));
        for step in 0..FLOW_REACH {
            for ((at, along), found) in ways.iter_mut().zip(&mut found) {
                *at = [at[0] + along[0], at[1] + along[1]];
                found[step] = match is_inside {
                    true => across.sample_inside(at[0], at[1]),
                    false => across.sample(at[0], at[1]),
                };
                let nearest = |value: f32| (value + 0.5).max(0.0) as i32 as usize;
                let (column, row) = (nearest(at[0]).min(width - 1), nearest(at[1]).min(height - 1));
                let [tx, ty] = tangents[row * width + column];
                // No branch: which of the two is as good as random. A sum of -0 counts as positive.
                let sign = 1.0_f32.copysign(tx * along[0] + ty * along[1] + 0.0);
                *along = [sign * tx, sign * ty];
            }
        }
        let sum = found
            .iter()
            .flatten()
            .fold(across.at(x as isize, y as isize), |sum, value| sum + value);
        (sum / (2 * FLOW_REACH + 1) as f32).max(0.0)
    })
}

/// A traced line and its importance.
#[derive(Clone, Debug)]
pub(crate) struct Edge {
    /// Points about a pixel apart, pixels.
    pub(crate) points: Vec<Point>,
    /// Sum of the line's strength over its pixels, in units of the upper threshold.
    pub(crate) weight: f64,
}

/// Lines along the maxima of `strength`, from `high` (a plane of upper thresholds) down to `low_ratio` of it.
pub(crate) fn trace_lines(strength: &Plane, flow: &Flow, high: &Plane, low_ratio: f32) -> Vec<Edge> {
    let relative = strength.zip(high, |value, limit| value / limit);
    let mut skeleton = Skeleton::new(&relative, flow, low_ratio);
    skeleton.keep_connected_to_strong();
    skeleton.thin();
    skeleton.trace(&relative)
}

/// The one-pixel lines while they are being traced.
struct Skeleton {
    width: isize,
    height: isize,
    pixels: Vec<bool>,
    strong: Vec<bool>,
    /// Place of the maximum near each pixel.
    centres: Vec<Point>,
}

const NEIGHBOURS: [(isize, isize); 8] = [(0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1)];

impl Skeleton {
    fn new(relative: &Plane, flow: &Flow, low_ratio: f32) -> Self {
        let (width, height) = (relative.width() as isize, relative.height() as isize);
        let size = relative.values().len();
        let mut result = Self {
            width,
            height,
            pixels: vec![false; size],
            strong: vec![false; size],
            centres: vec![[0.0; 2]; size],
        };
        for y in 1..height - 1 {
            for x in 1..width - 1 {
                let value = relative.at(x, y);
                if value < low_ratio {
                    continue;
                }
                let at = [x as f64, y as f64];
                let tangent = flow.tangent(at, [1.0, 0.0]);
                let (nx, ny) = (-tangent[1], tangent[0]);
                let before = relative.sample((at[0] - nx) as f32, (at[1] - ny) as f32);
                let after = relative.sample((at[0] + nx) as f32, (at[1] + ny) as f32);
                if value < before || value < after {
                    continue;
                }
                let bend = f64::from(before - 2.0 * value + after);
                let offset = if bend < -1e-9 {
                    0.5 * f64::from(before - after) / bend
                } else {
                    0.0
                };
                let offset = offset.clamp(-0.5, 0.5);
                let k = (y * width + x) as usize;
                result.pixels[k] = true;
                result.strong[k] = value >= 1.0;
                result.centres[k] = [at[0] + nx * offset, at[1] + ny * offset];
            }
        }
        result
    }

    fn is_set(&self, x: isize, y: isize) -> bool {
        x >= 0 && y >= 0 && x < self.width && y < self.height && self.pixels[(y * self.width + x) as usize]
    }

    fn keep_connected_to_strong(&mut self) {
        let mut kept = vec![false; self.pixels.len()];
        let mut open: Vec<usize> = (0..self.pixels.len()).filter(|&k| self.strong[k]).collect();
        open.iter().for_each(|&k| kept[k] = true);
        while let Some(k) = open.pop() {
            let (x, y) = (k as isize % self.width, k as isize / self.width);
            for (dx, dy) in NEIGHBOURS {
                let next = ((y + dy) * self.width + x + dx) as usize;
                if self.is_set(x + dx, y + dy) && !kept[next] {
                    kept[next] = true;
                    open.push(next);
                }
            }
        }
        self.pixels = kept;
    }

    /// Thins to one pixel (Zhang and Suen, 1984).
    fn thin(&mut self) {
        loop {
            let before = self.pixels.iter().filter(|&&set| set).count();
            for pass in 0..2 {
                let removed: Vec<usize> = (0..self.pixels.len())
                    .filter(|&k| self.pixels[k] && self.is_superfluous(k as isize, pass))
                    .collect();
                removed.iter().for_each(|&k| self.pixels[k] = false);
            }
            if self.pixels.iter().filter(|&&set| set).count() == before {
                return;
            }
        }
    }

    fn is_superfluous(&self, k: isize, pass: usize) -> bool {
        let (x, y) = (k % self.width, k / self.width);
        let around = NEIGHBOURS.map(|(dx, dy)| self.is_set(x + dx, y + dy));
        let count = around.iter().filter(|&&set| set).count();
        let changes = (0..8).filter(|&n| !around[n] && around[(n + 1) % 8]).count();
        let [north, _, east, _, south, _, west, _] = around;
        let sides = if pass == 0 {
            !(east && south && (north || west))
        } else {
            !(north && west && (east || south))
        };
        (2..=6).contains(&count) && changes == 1 && sides
    }

    fn trace(&mut self, relative: &Plane) -> Vec<Edge> {
        let mut edges = Vec::new();
        let degree = |this: &Self, k: usize| {
            let (x, y) = (k as isize % this.width, k as isize / this.width);
            NEIGHBOURS
                .iter()
                .filter(|&&(dx, dy)| this.is_set(x + dx, y + dy))
                .count()
        };
        let ends: Vec<usize> = (0..self.pixels.len())
            .filter(|&k| self.pixels[k] && degree(self, k) == 1)
            .collect();
        for k in ends.into_iter().chain(0..self.pixels.len()) {
            if !self.pixels[k] {
                continue;
            }
            let mut pixels = vec![k];
            self.pixels[k] = false;
            self.follow(&mut pixels);
            pixels.reverse();
            self.follow(&mut pixels);
            let weight = pixels.iter().map(|&k| f64::from(relative.values()[k])).sum();
            edges.push(Edge {
                points: pixels.iter().map(|&k| self.centres[k]).collect(),
                weight,
            });
        }
        edges
    }

    /// Continues from the last pixel, straight where there is a choice, and clears the pixels that it passes.
    fn follow(&mut self, pixels: &mut Vec<usize>) {
        while let Some(&k) = pixels.last() {
            let at = self.centres[k];
            let back = self.centres[pixels[pixels.len().saturating_sub(6)]];
            let heading = line::direction(back, at);
            let (x, y) = (k as isize % self.width, k as isize / self.width);
            let next = NEIGHBOURS
                .iter()
                .filter(|&&(dx, dy)| self.is_set(x + dx, y + dy))
                .map(|&(dx, dy)| {
                    let onward = line::direction([0.0, 0.0], [dx as f64, dy as f64]);
                    let cosine = onward[0] * heading[0] + onward[1] * heading[1];
                    (((y + dy) * self.width + x + dx) as usize, cosine)
                })
                .max_by(|a, b| a.1.total_cmp(&b.1));
            match next {
                Some((next, cosine)) if pixels.len() < 4 || cosine > -0.2 => {
                    self.pixels[next] = false;
                    pixels.push(next);
                }
                _ => return,
            }
        }
    }
}

/// Joins lines whose ends are within `gap` pixels and continue in nearly equal directions.
pub(crate) fn join_by_direction(mut edges: Vec<Edge>, gap: f64) -> Vec<Edge> {
    edges.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    let mut joined: Vec<Edge> = Vec::new();
    let mut used = vec![false; edges.len()];
    for first in 0..edges.len() {
        if used[first] {
            continue;
        }
        used[first] = true;
        let mut whole = edges[first].clone();
        for _ in 0..2 {
            while let Some((next, reversed)) = best_continuation(&whole.points, &edges, &used, gap) {
                used[next] = true;
                whole.weight += edges[next].weight;
                let points = edges[next].points.iter().copied();
                if reversed {
                    whole.points.extend(points.rev());
                } else {
                    whole.points.extend(points);
                }
            }
            whole.points.reverse();
        }
        joined.push(whole);
    }
    joined
}

/// The unused line that best continues the end of `points`, and whether it has to be reversed.
fn best_continuation(points: &[Point], edges: &[Edge], used: &[bool], gap: f64) -> Option<(usize, bool)> {
    let end = *points.last()?;
    let heading = line::direction(*points.get(points.len().saturating_sub(7))?, end);
    let mut best = None;
    let mut best_score = 0.0;
    for (k, edge) in edges.iter().enumerate() {
        let (Some(&first), Some(&last)) = (edge.points.first(), edge.points.last()) else {
            continue;
        };
        if used[k] || edge.points.len() < 2 {
            continue;
        }
        let inside = (edge.points.len() - 1).min(6);
        for (reversed, near, far) in [
            (false, first, edge.points[inside]),
            (true, last, edge.points[edge.points.len() - 1 - inside]),
        ] {
            let away = line::distance(end, near);
            if away > gap {
                continue;
            }
            let onward = line::direction(near, far);
            let turn = heading[0] * onward[0] + heading[1] * onward[1];
            let bridge = line::direction(end, near);
            let aim = if away < 1.5 {
                1.0
            } else {
                heading[0] * bridge[0] + heading[1] * bridge[1]
            };
            let score = (turn.min(aim) - TURN_COSINE_MIN) * (1.0 - 0.5 * away / gap);
            if score > best_score {
                best_score = score;
                best = Some((k, reversed));
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Light paper with one dark line of `half_width` pixels at x = 40.
    fn dark_line(half_width: f32) -> Plane {
        Plane::from_fn(80, 80, |x, _| {
            if (x as f32 - 40.0).abs() <= half_width {
                0.1
            } else {
                0.9
            }
        })
        .blurred(0.7)
    }

    fn traced(light: &Plane) -> Vec<Edge> {
        let flow = Flow::of(light, 2.0, 0.0, 1e-4);
        let strength = line_strength(light, &flow, 1.5);
        trace_lines(&strength, &flow, &Plane::filled(80, 80, 0.05), 0.5)
    }

    #[test]
    fn a_dark_line_is_drawn_once_along_its_centre() {
        let edges = traced(&dark_line(1.0));
        assert_eq!(edges.len(), 1);
        assert!(line::length(&edges[0].points) > 70.0);
        for point in &edges[0].points {
            assert!((point[0] - 40.0).abs() < 0.3, "{point:?}");
        }
    }

    #[test]
    fn a_step_is_drawn_once_on_its_dark_side() {
        let step = Plane::from_fn(80, 80, |_, y| if y < 40 { 0.9 } else { 0.2 }).blurred(0.7);
        let edges = traced(&step);
        assert_eq!(edges.len(), 1);
        for point in &edges[0].points[5..edges[0].points.len() - 5] {
            assert!((39.0..43.0).contains(&point[1]), "{point:?}");
        }
    }

    #[test]
    fn lines_in_line_are_joined_and_crossing_ones_are_not() {
        let straight = |from: f64| Edge {
            points: (0..10).map(|k| [from + f64::from(k), 0.0]).collect(),
            weight: 1.0,
        };
        let crossing = Edge {
            points: (0..10).map(|k| [10.0, 1.0 + f64::from(k)]).collect(),
            weight: 0.5,
        };
        let joined = join_by_direction(vec![straight(0.0), crossing, straight(12.0)], 5.0);
        assert_eq!(joined.len(), 2);
        assert!(joined.iter().any(|edge| edge.points.len() == 20));
    }
}
