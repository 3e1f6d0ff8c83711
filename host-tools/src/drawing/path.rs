//! A drawing as a path in the robot's frame, pen and lifts included.
//!
//! Sheet x is robot x and sheet y is minus robot y, the sheet centred on the paper. Every stroke starts above its first
//! point and ends above its last one, so that the path can be cut between any two strokes.

use super::Drawing;
use etherpen::config::Paper;

/// A point of the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPoint {
    /// Position of the pen in the robot's frame, mm.
    pub position_mm: [f64; 3],
    /// Whether the leg leading to this point is drawn.
    pub pen_down: bool,
    /// Number of the stroke that the leg belongs to or leads to.
    pub stroke: u32,
}

/// The drawing in the robot's frame: for each stroke travel to above its start, down, along it, up.
#[must_use]
pub fn to_path(drawing: &Drawing, paper: &Paper) -> Vec<PathPoint> {
    let lifted_z_mm = paper.pen_down_z_mm + paper.pen_lift_mm;
    let mut path = Vec::new();
    for (stroke, points) in (0_u32..).zip(drawing.strokes.iter().map(|stroke| &stroke.points)) {
        let (Some(&first), Some(&last)) = (points.first(), points.last()) else {
            continue;
        };
        let at = |point: [f64; 2], z_mm: f64, pen_down: bool| PathPoint {
            position_mm: [
                paper.centre_mm[0] + point[0] - 0.5 * drawing.sheet_mm[0],
                paper.centre_mm[1] - point[1] + 0.5 * drawing.sheet_mm[1],
                z_mm,
            ],
            pen_down,
            stroke,
        };
        path.push(at(first, lifted_z_mm, false));
        path.push(at(first, paper.pen_down_z_mm, false));
        path.extend(
            points
                .iter()
                .skip(1)
                .map(|&point| at(point, paper.pen_down_z_mm, true)),
        );
        path.push(at(last, lifted_z_mm, false));
    }
    path
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::Stroke;

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
        assert_eq!(
            path[0].position_mm,
            [-90.0, 120.0, paper.pen_down_z_mm + paper.pen_lift_mm]
        );
        assert_eq!(path[2].position_mm, [110.0, 120.0, paper.pen_down_z_mm]);
        assert_eq!(path[3].position_mm, [110.0, 70.0, paper.pen_down_z_mm]);
    }

    #[test]
    fn strokes_start_and_end_lifted_and_only_their_legs_are_drawn() {
        let paper = Paper::default();
        let path = to_path(&drawing(), &paper);
        let flags: Vec<_> = path
            .iter()
            .map(|point| (point.stroke, point.pen_down))
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
                .filter(|point| point.pen_down)
                .all(|point| point.position_mm[2] == paper.pen_down_z_mm)
        );
    }
}
