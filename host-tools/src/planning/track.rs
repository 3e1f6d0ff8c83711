//! Distances of references from their path, and of the path's corners from the references.
//!
//! A reference names the vertex that the motion has reached. Only legs near that vertex, measured along the path, are
//! considered: a position near another part of the path does not count as being on it. Between two references the
//! motion is taken as straight, which is wrong by at most a t^2 / 8.

use etherpen::motion::{Pen, Vertex};
use etherpen::robots::vector::{Vector, add_scaled, dot, length, subtract};

/// Least length of path considered on both sides of a reference, mm.
const REACH_MIN_MM: f64 = 3.0;
/// Length of path considered on both sides of a reference, as a multiple of the distance that the references cover in a
/// millisecond: longer than any moving average.
const REACH_STEPS: f64 = 36.0;

/// A path, and the distances found so far.
pub(super) struct Track {
    points: Vec<Vector>,
    /// Length of the path up to each vertex, mm.
    along: Vec<f64>,
    /// Smallest distance of each vertex from the references' line so far, mm.
    nearest: Vec<f64>,
    /// Pen on the leg that leads to each vertex.
    down: Vec<bool>,
    before: Option<Vector>,
    step_max_mm: f64,
}

/// Distances from corners to the line of the references, mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Corners {
    /// For drawn vertices: the largest distance, and its vertex.
    pub(super) drawn: (f64, usize),
    /// For vertices passed with the pen up: the largest distance, and its vertex.
    pub(super) travel: (f64, usize),
}

impl Track {
    pub(super) fn new(path: &[Vertex]) -> Self {
        let points: Vec<Vector> = path.iter().map(|vertex| vertex.position.into()).collect();
        let mut along = Vec::with_capacity(points.len());
        let mut sum = 0.0;
        let mut before = None;
        for point in &points {
            sum += before.map_or(0.0, |before| length(&subtract(point, before)));
            along.push(sum);
            before = Some(point);
        }
        Self {
            nearest: vec![f64::INFINITY; points.len()],
            down: path.iter().map(|vertex| vertex.pen == Pen::Down).collect(),
            points,
            along,
            before: None,
            step_max_mm: 0.0,
        }
    }

    /// Length of the path, mm.
    pub(super) fn length_mm(&self) -> f64 {
        self.along.last().copied().unwrap_or(0.0)
    }

    /// Distance of a reference from the path near the vertex that it names, mm.
    pub(super) fn step(&mut self, point: &Vector, vertex: usize) -> f64 {
        let before = self.before.replace(*point).unwrap_or(*point);
        self.step_max_mm = self.step_max_mm.max(length(&subtract(point, &before)));
        let reach_mm = REACH_MIN_MM.max(REACH_STEPS * self.step_max_mm);
        let last = self.points.len().saturating_sub(1);
        // Number of vertices executed: the current leg leads to this vertex.
        let here = vertex.min(last);
        let from_mm = self.along.get(here.saturating_sub(1)).copied().unwrap_or(0.0) - reach_mm;
        let to_mm = self.along.get(here).copied().unwrap_or(0.0) + reach_mm;
        let first = self.along.partition_point(|along| *along < from_mm);
        let end = self.along.partition_point(|along| *along <= to_mm);
        let legs = first.saturating_sub(1)..(end + 1).min(self.points.len());
        let ends = self.points.get(legs.clone()).unwrap_or(&[]);
        let along = self.along.get(legs).unwrap_or(&[]);
        let distance = ends
            .windows(2)
            .zip(along.windows(2))
            .map(|(ends, along)| match (ends, along) {
                ([from, to], [start_mm, end_mm]) => {
                    let per_mm = 1.0 / (end_mm - start_mm).max(f64::MIN_POSITIVE);
                    let part = |mm: f64| ((mm - start_mm) * per_mm).clamp(0.0, 1.0);
                    to_segment(point, from, to, [part(from_mm), part(to_mm)])
                }
                _ => f64::INFINITY,
            })
            .fold(f64::INFINITY, f64::min);
        let corners = self.points.iter().zip(&mut self.nearest);
        for (corner, nearest) in corners.take(end).skip(first) {
            *nearest = nearest.min(to_segment(corner, &before, point, [0.0, 1.0]));
        }
        distance
    }

    /// The largest distances of corners from the references.
    pub(super) fn corners(&self) -> Corners {
        let mut corners = Corners::default();
        for (index, nearest) in self.nearest.iter().enumerate() {
            let is_down = |index: usize| self.down.get(index).copied().unwrap_or(false);
            let worst = if is_down(index) || is_down(index + 1) {
                &mut corners.drawn
            } else {
                &mut corners.travel
            };
            if *nearest > worst.0 {
                *worst = (*nearest, index);
            }
        }
        corners
    }
}

/// Distance of a point from a part of a segment, mm; the part is given in lengths of the segment.
fn to_segment(point: &Vector, from: &Vector, to: &Vector, [low, high]: [f64; 2]) -> f64 {
    let leg = subtract(to, from);
    let along = dot(&subtract(point, from), &leg) / dot(&leg, &leg).max(f64::MIN_POSITIVE);
    length(&subtract(point, &add_scaled(from, &leg, along.max(low).min(high))))
}

#[cfg(test)]
mod tests {
    use super::super::tests::vertices;
    use super::*;

    #[test]
    fn a_cut_corner_is_seen_from_both_sides() {
        let path = vertices(&[[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 10.0, 0.0]]);
        let mut track = Track::new(&path);
        assert_eq!(track.length_mm(), 20.0);
        let deviations = [
            track.step(&[0.0, 0.0, 0.0], 0),
            track.step(&[9.0, 0.0, 0.0], 1),
            track.step(&[9.75, 0.25, 0.0], 1),
            track.step(&[10.0, 1.0, 0.0], 2),
            track.step(&[10.0, 10.0, 0.0], 3),
        ];
        assert_eq!(deviations, [0.0, 0.0, 0.25, 0.0, 0.0]);
        let (distance, vertex) = track.corners().drawn;
        assert!(
            (distance - 0.125_f64.sqrt()).abs() < 1.0e-12 && vertex == 1,
            "{distance}"
        );
    }

    #[test]
    fn a_place_on_another_part_of_the_path_is_not_on_it() {
        let path = vertices(&[[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [100.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
        let mut track = Track::new(&path);
        track.step(&[0.0, 0.0, 0.0], 0);
        assert!(track.step(&[0.5, 1.0, 0.0], 1) > 0.99);
    }
}
