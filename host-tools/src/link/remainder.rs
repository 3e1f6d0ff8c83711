//! What is left of a path that broke off, as a path of its own.
//!
//! It begins above the paper, comes down where the broken stroke left off or a little before, and goes on with the
//! path's own vertices; vertices of the two can be told from each other by their counts alone.
//!
//! Invariant: every drawn leg that was not executed is drawn, and nothing else but the overlap.

use etherpen::link::protocol::PathVertex;
use etherpen::motion::Pen;

/// What is left of a path.
#[derive(Clone, Debug, PartialEq)]
pub struct Remainder {
    /// The path that is left; empty if nothing is to be drawn any more.
    pub vertices: Vec<PathVertex>,
    /// First of the path's own vertices in it.
    pub from: usize,
    /// Vertices of the whole path.
    total: usize,
}

impl Remainder {
    /// What is left of `path` after `executed` vertices, with `overlap_um` of a broken stroke drawn again.
    pub fn new(path: &[PathVertex], executed: usize, overlap_um: f64, lift_um: i32) -> Self {
        let nothing = Self {
            vertices: Vec::new(),
            from: path.len(),
            total: path.len(),
        };
        // A vertex is the end of its leg, and a leg of its own cannot be drawn without a beginning.
        let undone = path.iter().enumerate().skip(executed.max(1));
        let Some((from, next)) = undone.into_iter().find(|(_, vertex)| vertex.pen == Pen::Down) else {
            return nothing;
        };
        let Some((start, mut before)) = start_of(path, from, from == executed.max(1), overlap_um) else {
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
        before.retain(|vertex| vertex.position_um != start);
        vertices.extend(before);
        vertices.extend_from_slice(path.get(from..).unwrap_or_default());
        Self {
            vertices,
            from,
            total: path.len(),
        }
    }

    /// Vertices of the whole path that are executed when so many of this one are; `before` were already.
    pub fn executed(&self, executed: usize, before: usize) -> usize {
        let own = self.total.saturating_sub(self.from);
        let added = self.vertices.len().saturating_sub(own);
        match executed.checked_sub(added) {
            Some(own) if own > 0 => self.from.saturating_add(own).min(self.total),
            _ => before,
        }
    }
}

/// Where the pen comes down before the leg to vertex `from`, and the vertices between there and that leg's beginning.
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

    const LIFT_UM: i32 = 5_000;

    fn at(x_um: i32, z_um: i32, pen: Pen, stroke: u32) -> PathVertex {
        PathVertex {
            position_um: [x_um, 0, z_um],
            pen,
            stroke,
        }
    }

    /// Two strokes as drawings have them: above, down, along, up.
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
}
