//! The paths for the comparison of planners: the samples, and generated ones.
//!
//! All are in the robot's frame, 750 mm below the shoulders. Random paths carry their seed in the name.

use super::super::BenchError;
use crate::drawing::{Input, load};
use crate::random::Xorshift;
use crate::setup;
use etherpen::config::Paper;
use etherpen::motion::{Pen, Vertex};
use etherpen::robots::Position;
use std::f64::consts::TAU;

/// Width of the sheet for which the samples' paths are made, mm.
const SHEET_MM: f64 = 200.0;
/// Height of the generated paths, mm.
const Z_MM: f64 = -750.0;
/// Seeds of the random paths.
const SEEDS: [u64; 3] = [1, 2, 3];

/// A path with its name.
pub(super) struct Named {
    /// Its name.
    pub(super) name: String,
    /// Its vertices.
    pub(super) vertices: Vec<Vertex>,
}

/// The samples' paths.
pub(super) fn samples() -> Result<Vec<Named>, BenchError> {
    let read = |name: &str| {
        let file = setup::workspace().join(format!("samples/motion/{name}.csv"));
        match load(&file) {
            Ok(Input::Path(path)) => Ok(Named {
                name: name.to_owned(),
                vertices: path.vertices,
            }),
            Ok(_) => Err(wrong(name, "it is no path in the robot's frame")),
            Err(cause) => Err(wrong(name, cause)),
        }
    };
    ["square", "circle", "text"].into_iter().map(read).collect()
}

/// A path on the sheet of another machine: as large as its sheet, and at the height of its pen.
pub(super) fn fitted(path: &[Vertex], paper: &Paper) -> Vec<Vertex> {
    let [width, height] = paper.size_mm;
    let scale = width.min(height) / SHEET_MM;
    let low_mm = path
        .iter()
        .fold(f64::INFINITY, |low, vertex| low.min(vertex.position.z_mm));
    let [x_mm, y_mm] = paper.centre_mm;
    let moved = |vertex: &Vertex| Vertex {
        position: Position {
            x_mm: x_mm + scale * vertex.position.x_mm,
            y_mm: y_mm + scale * vertex.position.y_mm,
            z_mm: paper.pen_down_z_mm + vertex.position.z_mm - low_mm,
        },
        ..*vertex
    };
    path.iter().map(moved).collect()
}

fn wrong(name: &str, cause: impl std::fmt::Display) -> BenchError {
    BenchError::Program {
        program: format!("samples/motion/{name}.csv"),
        cause: cause.to_string(),
    }
}

/// Generated paths.
pub(super) fn generated() -> Vec<Named> {
    let mut paths = vec![
        named("spiral", spiral()),
        named("zigzag", zigzag()),
        named("circles", circles()),
        named("star", star()),
    ];
    for seed in SEEDS {
        paths.push(named(&format!("random-{seed}"), random(seed)));
    }
    paths
}

fn named(name: &str, points: Vec<[f64; 2]>) -> Named {
    let vertex = |[x, y]: [f64; 2]| Vertex {
        position: [x, y, Z_MM].into(),
        pen: Pen::Down,
        stroke: 0,
    };
    Named {
        name: name.to_owned(),
        vertices: points.into_iter().map(vertex).collect(),
    }
}

/// Five turns outwards, in legs of about a millimetre.
fn spiral() -> Vec<[f64; 2]> {
    let mut angle = 0.0_f64;
    let mut points = Vec::new();
    while angle < 5.0 * TAU {
        let radius = 2.0 + 50.0 * angle / (5.0 * TAU);
        points.push([radius * angle.cos(), radius * angle.sin()]);
        angle += 1.0 / radius;
    }
    points
}

/// A hatching: to and fro over 30 mm, 1 mm apart.
fn zigzag() -> Vec<[f64; 2]> {
    let corner = |index: u32| {
        let side = f64::from((index / 2 + index % 2) % 2);
        [30.0 * side - 15.0, f64::from(index / 2) - 15.0]
    };
    (0..60).map(corner).collect()
}

/// Circles of 1.5 mm radius, one after the other without a lift.
fn circles() -> Vec<[f64; 2]> {
    let mut points = Vec::new();
    for circle in 0..12 {
        for step in 0..=32 {
            let angle = TAU * f64::from(step) / 32.0;
            let centre = 5.0 * f64::from(circle) - 27.5;
            points.push([centre + 1.5 * angle.sin(), 1.5 - 1.5 * angle.cos()]);
        }
    }
    points
}

/// A star of eleven points.
fn star() -> Vec<[f64; 2]> {
    (0..=11)
        .map(|index| {
            let angle = TAU * f64::from(5 * index) / 11.0;
            [60.0 * angle.cos(), 60.0 * angle.sin()]
        })
        .collect()
}

/// Sections of short, bending legs and of long, turning ones.
fn random(seed: u64) -> Vec<[f64; 2]> {
    let mut random = Xorshift::new(seed);
    let mut number = || random.unit();
    let (mut points, mut heading) = (vec![[0.0, 0.0]], 0.0_f64);
    for _ in 0..12 {
        let (turn, leg_mm, legs) = if number() < 0.6 { (0.4, 1.5, 30) } else { (3.0, 40.0, 4) };
        for _ in 0..legs {
            heading += turn * (2.0 * number() - 1.0);
            let way = leg_mm * (0.3 + 0.7 * number());
            let [x, y] = points.last().copied().unwrap_or_default();
            let point = [
                (x + way * heading.cos()).clamp(-100.0, 100.0),
                (y + way * heading.sin()).clamp(-100.0, 100.0),
            ];
            if (point[0] - x).hypot(point[1] - y) > 0.01 {
                points.push(point);
            }
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_path_has_different_vertices_inside_the_work_area() {
        let config = etherpen::config::Config::default();
        let mut admission = etherpen::motion::Admission::new(&config.motion_settings()).unwrap();
        for path in samples().unwrap().iter().chain(&generated()) {
            admission.restart();
            for (index, vertex) in (0u32..).zip(&path.vertices) {
                assert_eq!(admission.check(index, vertex), Ok(()), "{}", path.name);
            }
            assert!(path.vertices.len() > 3);
        }
    }
}
