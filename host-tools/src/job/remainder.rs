//! The remainder of an interrupted path, as a path of its own.
//!
//! The remainder begins above the paper, comes down where the interrupted stroke ended or a little before, and
//! continues with the path's own vertices. The vertices of both paths are identified by their indices alone.
//!
//! Invariant: every drawn leg that was not executed is drawn, and nothing else except the overlap.

use etherpen::messages::PathVertex;
use etherpen::motion::Pen;

/// Length of the interrupted stroke that is drawn again, um: more than a pen needs to touch down.
pub const OVERLAP_UM: f64 = 1_000.0;

/// The remainder of a path.
#[derive(Clone, Debug, PartialEq)]
pub struct Remainder {
    /// The remaining path; empty if nothing is left to draw.
    pub vertices: Vec<PathVertex>,
    /// Index in the path of the first vertex that the remainder copies from it.
    pub from: usize,
    /// Vertices of the complete path.
    total: usize,
}

impl Remainder {
    /// The remainder of `path` when its ink ends on the leg to vertex `leg`: at `end_um`, or at the leg's beginning if
    /// `end_um` is `None`. The last `overlap_um` of the interrupted stroke are drawn again.
    pub fn after(path: &[PathVertex], leg: usize, end_um: Option<[i32; 3]>, overlap_um: f64, lift_um: i32) -> Self {
        let Some((next, position_um)) = path.get(leg).zip(end_um) else {
            return Self::new(path, leg, overlap_um, lift_um);
        };
        // The end of the ink becomes an executed vertex.
        let end = PathVertex { position_um, ..*next };
        let (done, undone) = path.split_at(leg);
        let split = [done, &[end], undone].concat();
        let remainder = Self::new(&split, leg + 1, overlap_um, lift_um);
        let own = split.len() - remainder.from;
        Self {
            from: path.len() - own,
            total: path.len(),
            ..remainder
        }
    }

    /// The remainder of `path` after `executed` vertices; the last `overlap_um` of an interrupted stroke are drawn
    /// again.
    pub fn new(path: &[PathVertex], executed: usize, overlap_um: f64, lift_um: i32) -> Self {
        let nothing = Self {
            vertices: Vec::new(),
            from: path.len(),
            total: path.len(),
        };
        // A vertex is the end of its leg, and a leg cannot be drawn without a beginning.
        let undone = path.iter().enumerate().skip(executed.max(1));
        let Some((from, next)) = undone.into_iter().find(|(_, vertex)| vertex.pen == Pen::Down) else {
            return nothing;
        };
        let Some((start, before)) = start_of(path, from, from == executed.max(1), overlap_um) else {
            return nothing;
        };
        let lowered = PathVertex {
            position_um: start,
            pen: Pen::Up,
            stroke: next.stroke,
        };
        let [x_um, y_um, z_um] = start;
        let lifted = PathVertex {
            position_um: [x_um, y_um, z_um.saturating_add(lift_um)],
            ..lowered
        };
        let mut vertices = vec![lifted, lowered];
        vertices.extend(before);
        // The end of the ink may be a vertex of the path: two in one place are one. The path's own vertices all stay.
        vertices.dedup_by_key(|vertex| vertex.position_um);
        let meets = |vertex: &PathVertex| vertex.position_um == next.position_um;
        vertices.pop_if(|vertex| vertex.pen == Pen::Down && meets(vertex));
        vertices.extend_from_slice(path.get(from..).unwrap_or_default());
        Self {
            vertices,
            from,
            total: path.len(),
        }
    }

    /// Executed vertices of the complete path, given `executed` vertices of the remainder and `before` executed
    /// earlier.
    pub fn executed(&self, executed: usize, before: usize) -> usize {
        let own = self.total.saturating_sub(self.from);
        let added = self.vertices.len().saturating_sub(own);
        match executed.checked_sub(added) {
            Some(own) if own > 0 => self.from.saturating_add(own).min(self.total),
            _ => before,
        }
    }
}

/// Where the pen comes down before the leg to vertex `from`, and the vertices from there to the beginning of that leg.
fn start_of(path: &[PathVertex], from: usize, broken: bool, overlap_um: f64) -> Option<([i32; 3], Vec<PathVertex>)> {
    let mut end = path.get(from.checked_sub(1)?)?;
    let mut left_um = if broken { overlap_um } else { 0.0 };
    let mut between = Vec::new();
    for (index, start) in path.iter().enumerate().take(from.saturating_sub(1)).rev() {
        let drawn = path
            .get(index.saturating_add(1))
            .is_some_and(|vertex| vertex.pen == Pen::Down);
        if !drawn || left_um <= 0.0 {
            break;
        }
        between.push(PathVertex { pen: Pen::Down, ..*end });
        let length_um = distance_um(&start.position_um, &end.position_um);
        if length_um > left_um {
            let share = left_um / length_um;
            let mix = |(a, b): (&i32, &i32)| (f64::from(*a) + (f64::from(*b) - f64::from(*a)) * share).round() as i32;
            let mut at = end.position_um;
            let ends = end.position_um.iter().zip(&start.position_um);
            at.iter_mut().zip(ends).for_each(|(at, ends)| *at = mix(ends));
            between.reverse();
            return Some((at, between));
        }
        left_um -= length_um;
        end = start;
    }
    between.reverse();
    Some((end.position_um, between))
}

fn distance_um(a: &[i32; 3], b: &[i32; 3]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| (f64::from(*b) - f64::from(*a)).powi(2));
    squares.sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Lcg;

    const LIFT_UM: i32 = 5_000;

    fn at(x_um: i32, z_um: i32, pen: Pen, stroke: u32) -> PathVertex {
        PathVertex {
            position_um: [x_um, 0, z_um],
            pen,
            stroke,
        }
    }

    /// Two strokes as in drawings: above, down, along, up.
    fn path() -> Vec<PathVertex> {
        let stroke = |x_um: i32, stroke: u32| {
            [
                at(x_um, LIFT_UM, Pen::Up, stroke),
                at(x_um, 0, Pen::Up, stroke),
                at(x_um + 10_000, 0, Pen::Down, stroke),
                at(x_um + 20_000, 0, Pen::Down, stroke),
                at(x_um + 20_000, LIFT_UM, Pen::Up, stroke),
            ]
        };
        [stroke(0, 0), stroke(100_000, 1)].concat()
    }

    fn places(remainder: &Remainder) -> Vec<(i32, i32, bool)> {
        let place = |vertex: &PathVertex| (vertex.position_um[0], vertex.position_um[2], vertex.pen == Pen::Down);
        remainder.vertices.iter().map(place).collect()
    }

    #[test]
    fn a_broken_stroke_goes_on_with_an_overlap() {
        let remainder = Remainder::new(&path(), 3, 2_000.0, LIFT_UM);
        let expected = [
            (8_000, LIFT_UM, false),
            (8_000, 0, false),
            (10_000, 0, true),
            (20_000, 0, true),
        ];
        assert_eq!(places(&remainder)[..4], expected);
        assert_eq!(remainder.vertices[4..], path()[4..]);
        let executed: Vec<usize> = (0..=10).map(|executed| remainder.executed(executed, 3)).collect();
        assert_eq!(executed, [3, 3, 3, 3, 4, 5, 6, 7, 8, 9, 10]);
    }

    #[test]
    fn the_overlap_ends_at_the_strokes_beginning() {
        let remainder = Remainder::new(&path(), 3, 50_000.0, LIFT_UM);
        assert_eq!(
            places(&remainder)[..3],
            [(0, LIFT_UM, false), (0, 0, false), (10_000, 0, true)]
        );
        assert_eq!(remainder.vertices.len(), 2 + 1 + 7);
    }

    #[test]
    fn between_strokes_the_next_one_begins_without_an_overlap() {
        for executed in [4, 5, 6] {
            let remainder = Remainder::new(&path(), executed, 2_000.0, LIFT_UM);
            assert_eq!(remainder.from, 7, "{executed}");
            assert_eq!(
                places(&remainder)[..2],
                [(100_000, LIFT_UM, false), (100_000, 0, false)]
            );
            assert_eq!(remainder.vertices[2..], path()[7..]);
        }
    }

    #[test]
    fn a_path_that_never_began_is_drawn_whole_and_of_one_that_is_done_nothing_is_left() {
        assert_eq!(Remainder::new(&path(), 0, 2_000.0, LIFT_UM).vertices, path());
        for executed in [9, 10, 99] {
            assert!(Remainder::new(&path(), executed, 2_000.0, LIFT_UM).vertices.is_empty());
        }
        assert!(Remainder::new(&[], 0, 1.0, 1).vertices.is_empty());
    }

    #[test]
    fn from_wherever_the_ink_ends_everything_else_is_drawn_and_the_overlap_twice() {
        let drawn_um = |path: &[PathVertex]| -> f64 {
            let pairs = path
                .iter()
                .zip(path.iter().skip(1))
                .filter(|(_, to)| to.pen == Pen::Down);
            pairs
                .map(|(from, to)| distance_um(&from.position_um, &to.position_um))
                .sum()
        };
        let mut random = Lcg::new(1);
        let mut next = |below: usize| random.below(below);
        for case in 0..2_000 {
            let mut path: Vec<PathVertex> = Vec::new();
            // In every second case a stroke goes over the same few places again and again.
            let (places, apart_um) = if case % 2 == 0 { (200_000, 1) } else { (2, 300) };
            for stroke in 0..1 + next(4) as u32 {
                let mut before = [i32::MIN; 3];
                let mut point = || {
                    let here = before;
                    while before == here {
                        before = [next(places) as i32 * apart_um, next(places) as i32 * apart_um, 0];
                    }
                    before
                };
                let start = point();
                let vertex = |position_um, pen| PathVertex {
                    position_um,
                    pen,
                    stroke,
                };
                path.push(vertex([start[0], start[1], LIFT_UM], Pen::Up));
                path.push(vertex(start, Pen::Up));
                path.extend((0..6).map(|_| vertex(point(), Pen::Down)));
            }
            let legs: Vec<usize> = (0..path.len()).filter(|leg| path[*leg].pen == Pen::Down).collect();
            let leg = legs[next(legs.len())];
            let (from, to) = (path[leg - 1].position_um, path[leg].position_um);
            let share = [0.0, next(1_000) as f64 / 1_000.0, 1.0][next(3)];
            let end: [i32; 3] =
                std::array::from_fn(|k| (f64::from(from[k]) + f64::from(to[k] - from[k]) * share).round() as i32);
            let before_um = drawn_um(&path[..leg]) + distance_um(&from, &end);
            let stroke = path[leg].stroke;
            let of_stroke = |vertices: &[PathVertex]| -> Vec<PathVertex> {
                vertices
                    .iter()
                    .filter(|vertex| vertex.stroke == stroke)
                    .copied()
                    .collect()
            };
            let of_stroke_um = drawn_um(&of_stroke(&path[..leg])) + distance_um(&from, &end);
            let rest = Remainder::after(&path, leg, Some(end), OVERLAP_UM, LIFT_UM);
            let twice_um = drawn_um(&rest.vertices) + before_um - drawn_um(&path);
            let expected_um = OVERLAP_UM.min(of_stroke_um);
            assert!(
                (twice_um - expected_um).abs() < 10.0,
                "case {case}: {twice_um} um twice of {expected_um}"
            );
            assert_eq!(
                rest.vertices[rest.vertices.len() - (path.len() - leg)..],
                path[leg..],
                "case {case}"
            );
            assert_eq!(rest.executed(rest.vertices.len(), 0), path.len(), "case {case}");
            let pairs = rest.vertices.iter().zip(rest.vertices.iter().skip(1));
            let repeated = pairs.filter(|(a, b)| a.position_um == b.position_um).count();
            assert_eq!(repeated, 0, "case {case}: {:?}", rest.vertices);
        }
    }
}
