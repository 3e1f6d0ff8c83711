//! A drawing as a path in the robot's frame, including lifts.
//!
//! Sheet x is robot x and sheet y is minus robot y; the sheet is centred on the paper. Every stroke starts above its
//! first point and ends above its last one, so that the path can be cut between any two strokes.

use super::{Drawing, Stroke};
use etherpen::config::Paper;
use etherpen::motion::{Pen, Vertex};
use etherpen::robots::Position;

/// The drawing in the robot's frame: for each stroke a travel move to above its start, down, along the stroke, up.
#[must_use]
pub fn to_path(drawing: &Drawing, paper: &Paper) -> Vec<Vertex> {
    let plane = paper.plane();
    let mut path = Vec::new();
    for (stroke, points) in (0_u32..).zip(drawing.strokes.iter().map(|stroke| &stroke.points)) {
        let (Some(&first), Some(&last)) = (points.first(), points.last()) else {
            continue;
        };
        let at = |point: [f64; 2], lift_mm: f64, pen: Pen| {
            let x_mm = paper.centre_mm[0] + point[0] - 0.5 * drawing.sheet_mm[0];
            let y_mm = paper.centre_mm[1] - point[1] + 0.5 * drawing.sheet_mm[1];
            let z_mm = plane.z_at_mm(x_mm, y_mm) + lift_mm;
            Vertex {
                position: Position { x_mm, y_mm, z_mm },
                pen,
                stroke,
            }
        };
        path.push(at(first, paper.pen_lift_mm, Pen::Up));
        path.push(at(first, 0.0, Pen::Up));
        path.extend(points.iter().skip(1).map(|&point| at(point, 0.0, Pen::Down)));
        path.push(at(last, paper.pen_lift_mm, Pen::Up));
    }
    path
}

/// The drawn parts of a path in the robot's frame as strokes on the sheet.
#[must_use]
pub fn from_path(path: &[Vertex], paper: &Paper) -> Drawing {
    let place = |vertex: &Vertex| {
        [
            vertex.position.x_mm - paper.centre_mm[0] + 0.5 * paper.size_mm[0],
            paper.centre_mm[1] - vertex.position.y_mm + 0.5 * paper.size_mm[1],
        ]
    };
    let mut strokes: Vec<Stroke> = Vec::new();
    let mut was_down = false;
    for ends in path.windows(2) {
        let [from, to] = ends else { continue };
        let is_down = to.pen == Pen::Down;
        if is_down && !was_down {
            strokes.push(Stroke {
                points: vec![place(from)],
            });
        }
        if let (true, Some(stroke)) = (is_down, strokes.last_mut()) {
            stroke.points.push(place(to));
        }
        was_down = is_down;
    }
    Drawing {
        sheet_mm: paper.size_mm,
        strokes,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawing() -> Drawing {
        let strokes = vec![
            Stroke {
                points: vec![[0.0, 0.0], [200.0, 0.0], [200.0, 50.0]],
            },
            Stroke::default(),
            Stroke {
                points: vec![[100.0, 100.0], [100.0, 150.0]],
            },
        ];
        Drawing {
            sheet_mm: [200.0, 200.0],
            strokes,
        }
    }

    #[test]
    fn the_sheets_top_left_is_left_and_far_in_the_robots_frame() {
        let paper = Paper {
            centre_mm: [10.0, 20.0],
            ..Paper::default()
        };
        let path = to_path(&drawing(), &paper);
        let place = |k: usize| [path[k].position.x_mm, path[k].position.y_mm, path[k].position.z_mm];
        assert_eq!(place(0), [-90.0, 120.0, paper.pen_down_z_mm + paper.pen_lift_mm]);
        assert_eq!(place(2), [110.0, 120.0, paper.pen_down_z_mm]);
        assert_eq!(place(3), [110.0, 70.0, paper.pen_down_z_mm]);
    }

    #[test]
    fn every_vertex_follows_a_sheet_that_is_not_level() {
        let paper = Paper {
            centre_mm: [10.0, 20.0],
            slope: [0.01, -0.02],
            ..Paper::default()
        };
        let places: Vec<_> = to_path(&drawing(), &paper)
            .iter()
            .map(|vertex| {
                let Position { x_mm, y_mm, z_mm } = vertex.position;
                (z_mm - paper.pen_down_z_mm - 0.01 * (x_mm - 10.0) + 0.02 * (y_mm - 20.0)).abs()
            })
            .collect();
        for (place, lift_mm) in places.iter().zip([3.0, 0.0, 0.0, 0.0, 3.0, 3.0, 0.0, 0.0, 3.0]) {
            assert!((place - lift_mm).abs() < 1.0e-9, "{places:?}");
        }
    }

    #[test]
    fn strokes_start_and_end_lifted_and_only_their_legs_are_drawn() {
        let paper = Paper::default();
        let path = to_path(&drawing(), &paper);
        let flags: Vec<_> = path
            .iter()
            .map(|point| (point.stroke, point.pen == Pen::Down))
            .collect();
        let expected = [
            (0, false),
            (0, false),
            (0, true),
            (0, true),
            (0, false),
            (2, false),
            (2, false),
            (2, true),
        ];
        assert_eq!(flags[..8], expected);
        assert_eq!(flags[8..], [(2, false)]);
        assert!(
            path.iter()
                .filter(|point| point.pen == Pen::Down)
                .all(|point| point.position.z_mm == paper.pen_down_z_mm)
        );
    }
}
