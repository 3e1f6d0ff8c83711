//! The border of a drawing, traced with the pen up to check that it is on the paper.

use super::wire::as_sent;
use super::wire::to_wire;
use etherpen::config::Config;
use etherpen::messages::PathVertex;
use etherpen::motion::{Admission, Pen, Vertex};
use etherpen::robots::Position;

/// A path around everything that `path` draws, pen up, at the height of travel, back to its beginning. It follows the
/// axis-aligned rectangle, or the convex hull if the robot cannot reach a corner of the rectangle. Also returns the
/// rectangle's width and height, mm. `None` for a path that draws nothing.
pub fn around(path: &[Vertex], config: &Config) -> Option<(Vec<PathVertex>, [f64; 2])> {
    let drawn: Vec<[f64; 2]> = (path.windows(2).filter(|pair| pair[1].pen == Pen::Down))
        .flat_map(|pair| [pair[0].position, pair[1].position])
        .map(|position| [position.x_mm, position.y_mm])
        .collect();
    let first = *drawn.first()?;
    let [low, high] = drawn.iter().fold([first; 2], |[low, high], point| {
        [
            [0, 1].map(|k| low[k].min(point[k])),
            [0, 1].map(|k| high[k].max(point[k])),
        ]
    });
    let rectangle = vec![[low[0], high[1]], high, [high[0], low[1]], low];
    let lifted = config.paper.plane().raised(config.paper.pen_lift_mm);
    let closed = |mut corners: Vec<[f64; 2]>| {
        corners.extend(corners.first().copied());
        let vertex = |&[x_mm, y_mm]: &[f64; 2]| Vertex {
            position: Position {
                x_mm,
                y_mm,
                z_mm: lifted.z_at_mm(x_mm, y_mm),
            },
            pen: Pen::Up,
            stroke: 0,
        };
        corners.iter().map(vertex).collect::<Vec<Vertex>>()
    };
    let mut border = closed(rectangle);
    if !is_admitted(&border, config) {
        border = closed(hull(drawn));
    }
    Some((
        as_sent(&border).iter().map(to_wire).collect(),
        [high[0] - low[0], high[1] - low[1]],
    ))
}

fn is_admitted(path: &[Vertex], config: &Config) -> bool {
    let Ok(mut admission) = Admission::new(&config.motion_settings()) else {
        return false;
    };
    (0..)
        .zip(path)
        .all(|(index, vertex)| admission.check(index, vertex).is_ok())
}

/// The convex hull of points, counter-clockwise (Andrew's monotone chain, 1979).
fn hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let turns_left =
        |a: &[f64; 2], b: &[f64; 2], c: &[f64; 2]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0;
    let chain = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for point in points {
            while let [.., a, b] = chain.as_slice()
                && !turns_left(a, b, &point)
            {
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut result = chain(&mut points.iter().copied());
    result.extend(chain(&mut points.iter().rev().copied()));
    result
}

#[cfg(test)]
mod tests;
