//! Clips lines at the outlines of regions.
//!
//! A line is cut where it crosses an outline, and each piece is kept or dropped depending on its middle. This is exact
//! for any shape, with holes and islands, but checks every edge. The work is counted and limited, so that no file can
//! cause too much of it.

use super::line::{self, Point};

/// Most pairs of a line's piece and an outline's edge checked for one file.
const STEPS_MAX: usize = 400_000_000;

/// An area inside closed lines.
#[derive(Clone, Debug)]
pub(crate) struct Region {
    edges: Vec<[Point; 2]>,
    is_even_odd: bool,
}

impl Region {
    /// The area inside `lines`, each of which is closed; by winding number, or by counting crossings.
    pub(crate) fn new(lines: Vec<Vec<Point>>, is_even_odd: bool) -> Self {
        let mut edges = Vec::new();
        for points in &lines {
            edges.extend(points.windows(2).map(|pair| [pair[0], pair[1]]));
            if let (Some(&first), Some(&last)) = (points.first(), points.last())
                && first != last
            {
                edges.push([last, first]);
            }
        }
        Self { edges, is_even_odd }
    }

    fn contains(&self, point: Point) -> bool {
        let mut winding = 0_i64;
        for [a, b] in &self.edges {
            if (a[1] <= point[1]) != (b[1] <= point[1]) {
                let x = a[0] + (b[0] - a[0]) * (point[1] - a[1]) / (b[1] - a[1]);
                if x > point[0] {
                    winding += if b[1] > a[1] { 1 } else { -1 };
                }
            }
        }
        if self.is_even_odd {
            winding % 2 != 0
        } else {
            winding != 0
        }
    }
}

/// The parts of a line inside one of the regions; `None` if that is too much work.
pub(crate) fn clip(points: &[Point], regions: &[Region], steps: &mut usize) -> Option<Vec<Vec<Point>>> {
    if *steps > STEPS_MAX {
        return None;
    }
    let edges: usize = regions.iter().map(|region| region.edges.len()).sum();
    let mut parts: Vec<Vec<Point>> = Vec::new();
    let mut part: Vec<Point> = Vec::new();
    for pair in points.windows(2) {
        let mut cuts = vec![0.0, 1.0];
        cuts.extend(
            regions
                .iter()
                .flat_map(|region| &region.edges)
                .filter_map(|edge| crossing(pair, edge)),
        );
        cuts.sort_by(f64::total_cmp);
        *steps += edges.checked_mul(cuts.len())?;
        if *steps > STEPS_MAX {
            return None;
        }
        for ends in cuts.windows(2).filter(|ends| ends[1] > ends[0]) {
            let middle = line::between(pair[0], pair[1], 0.5 * (ends[0] + ends[1]));
            if regions.iter().any(|region| region.contains(middle)) {
                if part.is_empty() {
                    part.push(line::between(pair[0], pair[1], ends[0]));
                }
                part.push(line::between(pair[0], pair[1], ends[1]));
            } else if !part.is_empty() {
                parts.push(std::mem::take(&mut part));
            }
        }
    }
    parts.push(part);
    parts.retain(|part| part.len() > 1);
    Some(parts)
}

/// Position along a line's piece at which an edge crosses it, 0 to 1.
fn crossing(pair: &[Point], edge: &[Point; 2]) -> Option<f64> {
    let (a, b) = (pair[0], pair[1]);
    let (along, across) = (
        [b[0] - a[0], b[1] - a[1]],
        [edge[1][0] - edge[0][0], edge[1][1] - edge[0][1]],
    );
    let area = along[0] * across[1] - along[1] * across[0];
    if area == 0.0 {
        return None;
    }
    let from = [edge[0][0] - a[0], edge[0][1] - a[1]];
    let t = (from[0] * across[1] - from[1] * across[0]) / area;
    let u = (from[0] * along[1] - from[1] * along[0]) / area;
    ((0.0..=1.0).contains(&t) && (0.0..=1.0).contains(&u)).then_some(t)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(low: f64, high: f64) -> Vec<Point> {
        vec![[low, low], [high, low], [high, high], [low, high]]
    }

    #[test]
    fn a_line_through_a_frame_is_cut_four_times() {
        let frame = [Region::new(vec![square(0.0, 10.0), square(4.0, 6.0)], true)];
        let parts = clip(&[[-5.0, 5.0], [15.0, 5.0]], &frame, &mut 0).expect("little work");
        assert_eq!(parts, [[[0.0, 5.0], [4.0, 5.0]], [[6.0, 5.0], [10.0, 5.0]]]);
    }

    #[test]
    fn what_is_inside_stays_whole_and_what_is_outside_goes() {
        let box_ = [Region::new(vec![square(0.0, 10.0)], false)];
        let inside = vec![[1.0, 1.0], [9.0, 2.0], [3.0, 8.0]];
        assert_eq!(clip(&inside, &box_, &mut 0), Some(vec![inside.clone()]));
        assert_eq!(clip(&[[11.0, 1.0], [12.0, 2.0]], &box_, &mut 0), Some(vec![]));
        assert_eq!(clip(&inside, &box_, &mut (STEPS_MAX - 1)), None);
    }
}
