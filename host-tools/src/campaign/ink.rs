//! Compares the ink with the drawing that was ordered.
//!
//! Only the sheet's coordinates are shared with the controller; both sides are lists of lines here.

use crate::cell::InkStroke;
use etherpen::config::Paper;
use etherpen::messages::PathVertex;
use etherpen::motion::Pen;

/// Distance of the points of a line that are looked for, mm.
const STEP_MM: f64 = 0.5;

type Point = [f64; 2];

/// Number of points of ink.
pub(super) fn points(ink: &[InkStroke]) -> usize {
    ink.iter().map(|stroke| stroke.points_mm.len()).sum()
}

/// Compares the ink behind the first `from` points with the lines of a path that are drawn: each within `limit_mm` of
/// the other. Ink where the pen stood when
/// the drawing began is not compared.
///
/// # Errors
/// A line without ink, or ink without a line.
pub(super) fn compare(
    ink: &[InkStroke],
    from: usize,
    path: &[PathVertex],
    paper: &Paper,
    limit_mm: f64,
) -> Result<(), String> {
    check_whole(ink, from, path, paper, limit_mm)?;
    let (lines, drawn) = (lines(path, paper), segments(ink, from));
    let stood = last_before(ink, from);
    let is_compared = |end: Point| stood.is_none_or(|stood| distance(stood, end) > limit_mm);
    for segment in drawn.iter().filter(|segment| is_compared(segment[1])) {
        let away_mm = nearest(segment[1], &lines);
        if away_mm > limit_mm {
            let point = segment[1];
            return Err(format!("ink at {point:.2?} mm is {away_mm:.2} mm away from every line"));
        }
    }
    Ok(())
}

/// Whether there is no ink behind the first `from` points but where the pen stood then.
pub(super) fn is_empty(ink: &[InkStroke], from: usize, limit_mm: f64) -> bool {
    let stood = last_before(ink, from);
    let is_there = |end: Point| stood.is_some_and(|stood| distance(stood, end) <= limit_mm);
    segments(ink, from).iter().all(|segment| is_there(segment[1]))
}

/// Looks for ink behind the first `from` points within `limit_mm` of the lines of a path that are drawn.
///
/// # Errors
/// A line without ink.
pub(super) fn check_whole(
    ink: &[InkStroke],
    from: usize,
    path: &[PathVertex],
    paper: &Paper,
    limit_mm: f64,
) -> Result<(), String> {
    let drawn = segments(ink, from);
    for line in &lines(path, paper) {
        let length_mm = distance(line[0], line[1]);
        let steps = (length_mm / STEP_MM).ceil().max(1.0) as u32;
        for step in 0..=steps {
            let point = between(line, f64::from(step) / f64::from(steps));
            let away_mm = nearest(point, &drawn);
            if away_mm > limit_mm {
                return Err(format!(
                    "no ink within {limit_mm:.2} mm of {point:.2?} mm; the nearest is {away_mm:.2} mm away"
                ));
            }
        }
    }
    Ok(())
}

/// The lines of a path that are drawn, on the sheet.
fn lines(path: &[PathVertex], paper: &Paper) -> Vec<[Point; 2]> {
    let on_sheet = |vertex: &PathVertex| {
        let [x_um, y_um, _] = vertex.position_um.map(f64::from);
        let ([centre_x, centre_y], [width, height]) = (paper.centre_mm, paper.size_mm);
        [
            x_um / 1e3 - centre_x + width / 2.0,
            height / 2.0 - (y_um / 1e3 - centre_y),
        ]
    };
    path.windows(2)
        .filter(|pair| pair[1].pen == Pen::Down)
        .map(|pair| [on_sheet(&pair[0]), on_sheet(&pair[1])])
        .collect()
}

/// The ink behind the first `from` points, as short lines.
fn segments(ink: &[InkStroke], from: usize) -> Vec<[Point; 2]> {
    let mut before = 0;
    let mut segments = Vec::new();
    for stroke in ink {
        let fresh = stroke.points_mm.get(from.saturating_sub(before)..).unwrap_or_default();
        before += stroke.points_mm.len();
        segments.extend(fresh.first().map(|first| [*first; 2]));
        segments.extend(fresh.windows(2).map(|pair| [pair[0], pair[1]]));
    }
    segments
}

/// The last of the first `count` points of ink.
fn last_before(ink: &[InkStroke], count: usize) -> Option<Point> {
    let all = ink.iter().flat_map(|stroke| &stroke.points_mm);
    all.take(count).last().copied()
}

fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn between([a, b]: &[Point; 2], share: f64) -> Point {
    [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])]
}

fn nearest(point: Point, lines: &[[Point; 2]]) -> f64 {
    let to = |line: &[Point; 2]| {
        let [a, b] = line;
        let along = [b[0] - a[0], b[1] - a[1]];
        let squared = along[0] * along[0] + along[1] * along[1];
        let share = match squared > 0.0 {
            true => ((point[0] - a[0]) * along[0] + (point[1] - a[1]) * along[1]) / squared,
            false => 0.0,
        };
        distance(point, between(line, share.clamp(0.0, 1.0)))
    };
    lines.iter().map(to).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::episode::Figure;
    use etherpen::config::Config;

    fn figure() -> Vec<PathVertex> {
        Figure(vec![vec![[0, 0], [10_000, 0], [10_000, 5_000]]]).path(&Config::default())
    }

    fn inked(points_mm: Vec<Point>) -> Vec<InkStroke> {
        vec![InkStroke {
            points_mm,
            ..InkStroke::default()
        }]
    }

    fn compared(ink: &[InkStroke], from: usize) -> Result<(), String> {
        compare(ink, from, &figure(), &Config::default().paper, 0.35)
    }

    #[test]
    fn ink_on_all_lines_is_the_drawing() {
        // The sheet's origin is its top left corner, and its y points down.
        let drawn = inked(vec![
            [50.0, 50.0],
            [50.0, 50.1],
            [100.0, 100.0],
            [110.0, 100.0],
            [110.0, 95.0],
        ]);
        assert_eq!(compared(&drawn, 2), Ok(()));
        assert_eq!(compared(&drawn, 1), Ok(()), "the pen stood there");
        assert!(
            compared(&drawn, 0).unwrap_err().contains("away from every line"),
            "ink of before"
        );
    }

    #[test]
    fn a_missing_line_and_a_wrong_one_are_found() {
        let short = inked(vec![[100.0, 100.0], [110.0, 100.0]]);
        assert!(compared(&short, 0).unwrap_err().starts_with("no ink"));
        let beside = inked(vec![[100.0, 100.0], [110.0, 100.0], [110.0, 95.0], [111.0, 95.0]]);
        assert!(compared(&beside, 0).unwrap_err().starts_with("ink at"));
        assert!(compared(&[], 0).unwrap_err().starts_with("no ink"));
    }
}
