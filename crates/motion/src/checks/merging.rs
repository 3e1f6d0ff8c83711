//! Requirements on dense input: it takes the time of its line, and no vertex is farther from the path than allowed.
//!
//! The distance between the vertices and the legs that replace them is decided here without the rule's own places: each
//! vertex allows an interval of every leg, and the places have to be in order.

use super::super::merging::Merger;
use super::super::shaping::Node;
use super::*;

/// Vertices of the longest path.
const MILLION: usize = 1_000_000;

/// The vertices that are kept, as their indices, and the settings' share of the tolerance, mm.
fn kept(settings: &Settings, path: &[Vertex]) -> (Vec<usize>, f64) {
    let mut merger = Merger::new();
    merger.configure(settings);
    let (mut kept, mut last) = (std::vec![0], Vector::from(path[0].position));
    let mut queue = |node: Node| {
        kept.push(node.count as usize);
        Vector::from(node.point)
    };
    for (count, vertex) in path.iter().enumerate().skip(1) {
        let node = Node {
            point: vertex.position.into(),
            pen: vertex.pen,
            stroke: vertex.stroke,
            count: count as u32,
            merged: false,
        };
        for node in merger.take(node, &last).into_iter().flatten() {
            last = queue(node);
        }
    }
    if let Some(node) = merger.release() {
        queue(node);
    }
    (kept, 0.2 * settings.motion.tolerance_mm)
}

/// Whether places in order on the leg from the first to the last of some points are within a distance of all points.
fn in_order_within(points: &[Vector], distance_mm: f64) -> bool {
    let (first, last) = (points[0], points[points.len() - 1]);
    let way = subtract(&last, &first);
    let whole = length(&way);
    let mut place = 0.0_f64;
    points[1..points.len() - 1].iter().all(|point| {
        let from = subtract(point, &first);
        let along = dot(&from, &way) / whole;
        let across_squared = dot(&from, &from) - along * along;
        let half_squared = distance_mm * distance_mm - across_squared;
        let half = libm::sqrt(half_squared.max(0.0));
        place = place.max(along - half);
        half_squared >= 0.0 && place <= whole.min(along + half)
    })
}

/// Vertices on a circle from its first point to its last, without noise or with some, mm.
fn circle(vertices: usize, radius_mm: f64, mut noise: impl FnMut() -> f64) -> Vec<Vertex> {
    let place = |number: usize| {
        let angle = TAU * number as f64 / (vertices - 1) as f64;
        let [x, y] = [libm::cos(angle), libm::sin(angle)].map(|part| radius_mm * part + noise());
        vertex([x, y, -850.0], Pen::Down, 0)
    };
    (0..vertices).map(place).collect()
}

fn without_noise(vertices: usize, radius_mm: f64) -> Vec<Vertex> {
    circle(vertices, radius_mm, || 0.0)
}

/// Checks that what is dropped stays within the share of the legs that replace it, and what has to be kept is kept.
fn check_kept(settings: &Settings, path: &[Vertex], name: &str) -> usize {
    let (kept, share_mm) = kept(settings, path);
    assert!(kept.is_sorted_by(|one, next| one < next), "{name}: out of order");
    assert_eq!((kept[0], kept[kept.len() - 1]), (0, path.len() - 1), "{name}: the ends");
    for leg in kept.windows(2) {
        let replaced = &path[leg[0]..=leg[1]];
        let points: Vec<Vector> = replaced.iter().map(|vertex| vertex.position.into()).collect();
        assert!(in_order_within(&points, share_mm), "{name}: legs {leg:?}");
        let of = |vertex: &Vertex| (vertex.pen, vertex.stroke);
        let end = of(&path[leg[1]]);
        assert!(
            replaced[1..].iter().all(|vertex| of(vertex) == end),
            "{name}: pen or stroke of {leg:?}"
        );
    }
    kept.len()
}

#[test]
fn merged_vertices_stay_within_their_share_of_the_legs_that_replace_them() {
    let (mut left, mut all) = (0, 0);
    for seed in 1..=600 {
        let mut random = Random::new(seed);
        let settings = Settings::default();
        let path = match seed % 4 {
            0 => noise::walk(&mut random),
            1 => random_path(&mut random, 3),
            2 => {
                let (noise_mm, radius_mm) = (random.between(0.0, 0.004), random.between(0.05, 40.0));
                circle(2_000, radius_mm, || noise_mm * random.between(-1.0, 1.0))
            }
            _ => {
                // Small steps in all three directions.
                let step_mm = libm::pow(10.0, random.between(-4.0, -1.0));
                let (mut at, mut drift) = ([0.0, 0.0, -850.0], [0.0; 3]);
                let step = |number: u32| {
                    for (at, drift) in at.iter_mut().zip(&mut drift) {
                        *drift = 0.95 * *drift + random.between(-1.0, 1.0);
                        *at += step_mm * (0.3 * *drift + random.between(-0.5, 0.5));
                    }
                    let pen = if (number / 300).is_multiple_of(2) {
                        Pen::Down
                    } else {
                        Pen::Up
                    };
                    vertex(at, pen, number / 500)
                };
                (0..2_000).map(step).collect()
            }
        };
        all += path.len();
        left += check_kept(&settings, &path, &format!("seed {seed}"));
    }
    println!("{left} of {all} vertices left");
    assert!(left < all / 2, "{left} of {all}");
}

#[test]
fn two_hundred_thousand_points_on_a_circle_take_the_time_of_the_circle() {
    let radius_mm = 200.0 / TAU;
    for speed_mm_s in [5.0, 400.0, 1_000.0] {
        let mut settings = Settings::default();
        settings.motion.speed_mm_s = speed_mm_s;
        settings.motion.travel_speed_mm_s = settings.motion.travel_speed_mm_s.max(speed_mm_s);
        let few = Run::new(&settings, &without_noise(201, radius_mm)).whole();
        let path = without_noise(200_001, radius_mm);
        let left = check_kept(&settings, &path, "circle");
        let dense = Run::new(&settings, &path).whole();
        dense.check_limits("dense");
        dense.check_deviation("dense");
        assert_eq!(dense.trajectory.executed() as usize, path.len());
        let ratio = dense.duration_s() / few.duration_s();
        println!(
            "{speed_mm_s} mm/s: {:.3} s of {:.3} s, {left} vertices left",
            dense.duration_s(),
            few.duration_s()
        );
        assert!(ratio < 1.1, "{ratio} at {speed_mm_s} mm/s");
    }
}

#[test]
fn rounding_and_noise_of_a_dense_circle_cost_little_time() {
    let radius_mm = 200.0 / TAU;
    let settings = Settings::default();
    let few = Run::new(&settings, &without_noise(201, radius_mm)).whole().duration_s();
    let rounded = |vertex: &Vertex| {
        let at = Vector::from(vertex.position).map(|value| libm::round(value * 1_000.0) / 1_000.0);
        super::vertex(at, vertex.pen, vertex.stroke)
    };
    let exact = without_noise(200_001, radius_mm);
    let mut random = Random::new(1);
    let noisy = circle(200_001, radius_mm, || 0.001 * random.between(-1.0, 1.0));
    for (name, path) in [("rounded", exact.iter().map(rounded).collect()), ("noisy", noisy)] {
        let left = check_kept(&settings, &path, name);
        let run = Run::new(&settings, &path).whole();
        run.check_limits(name);
        run.check_deviation(name);
        println!("{name}: {:.3} s of {few:.3} s, {left} vertices left", run.duration_s());
        assert!(run.duration_s() < 1.2 * few, "{name}: {} s", run.duration_s());
    }
}

#[test]
fn a_million_vertices_run_at_the_speed_of_their_path() {
    let mut settings = Settings::default();
    settings.motion.speed_mm_s = 400.0;
    // A spiral of 5 m with a vertex every 5 um.
    let place = |number: usize| {
        let part = number as f64 / (MILLION - 1) as f64;
        let (radius_mm, angle) = (20.0 + 60.0 * part, 16.0 * TAU * part);
        vertex(
            [radius_mm * libm::cos(angle), radius_mm * libm::sin(angle), -850.0],
            Pen::Down,
            0,
        )
    };
    let path: Vec<Vertex> = (0..MILLION).map(place).collect();
    let length_mm: f64 = path
        .windows(2)
        .map(|leg| length(&subtract(&leg[1].position.into(), &leg[0].position.into())))
        .sum();
    let run = Run::new(&settings, &path).whole();
    let own_s = length_mm / settings.motion.speed_mm_s;
    println!("{:.3} s of {own_s:.3} s", run.duration_s());
    assert_eq!(run.trajectory.executed() as usize, MILLION);
    assert!(run.duration_s() < 1.02 * own_s + 0.1, "{} s", run.duration_s());
}

#[test]
fn two_thousand_corners_a_second_pass_at_full_speed() {
    let settings = Settings::default();
    // Legs of 0.2 mm: too long to be merged.
    let place = |number: usize| {
        let x = 0.2 * number as f64;
        vertex([x - 60.0, 5.0 * libm::sin(0.05 * x), -850.0], Pen::Down, 0)
    };
    let path: Vec<Vertex> = (0..600).map(place).collect();
    let length_mm: f64 = path
        .windows(2)
        .map(|leg| length(&subtract(&leg[1].position.into(), &leg[0].position.into())))
        .sum();
    let run = Run::new(&settings, &path).whole();
    run.check_limits("corners");
    run.check_deviation("corners");
    let own_s = length_mm / settings.motion.speed_mm_s + 0.05;
    println!("{:.3} s of {own_s:.3} s", run.duration_s());
    assert!(run.duration_s() < 1.05 * own_s, "{} s", run.duration_s());
}

#[test]
fn ordinary_legs_and_a_fourth_axis_that_follows_the_path_are_never_merged() {
    let mut settings = Settings::default();
    let ordinary: Vec<Vertex> = (0..50)
        .map(|k| vertex([0.25 * f64::from(k), 0.0, -850.0], Pen::Down, 0))
        .collect();
    assert_eq!(kept(&settings, &ordinary).0.len(), ordinary.len());
    let dense = without_noise(2_000, 1.0);
    assert!(kept(&settings, &dense).0.len() < 200);
    settings.motion.orientation = crate::settings::Orientation::Path;
    assert_eq!(kept(&settings, &dense).0.len(), dense.len());
}
