//! Requirements on the tolerance, both ways: no setpoint far from its leg, no vertex far from the setpoints.
//!
//! The distances are minima over all candidates near a place. The arithmetic is independent of how the path is shaped.

use super::*;

/// Environment variable for the number of drawings.
const DRAWINGS: &str = "ETHERPEN_TOLERANCE_DRAWINGS";
const DRAWINGS_OF_THE_SUITE: u64 = 150;
/// A setpoint's leg is searched this many places around the vertex that it reports, and a vertex's setpoints likewise.
/// Vertices that repeat one another are one place.
const NEAR: usize = 3;

/// Distance of a point from the line between two others.
fn apart(p: [f64; 3], a: [f64; 3], b: [f64; 3]) -> f64 {
    let (ux, uy, uz) = (b[0] - a[0], b[1] - a[1], b[2] - a[2]);
    let (vx, vy, vz) = (p[0] - a[0], p[1] - a[1], p[2] - a[2]);
    let squared = ux * ux + uy * uy + uz * uz;
    let part = if squared > 0.0 {
        ((ux * vx + uy * vy + uz * vz) / squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let (dx, dy, dz) = (vx - part * ux, vy - part * uy, vz - part * uz);
    libm::sqrt(dx * dx + dy * dy + dz * dz)
}

/// Number of each vertex's place, then that of the place behind the last vertex.
fn places(vertices: &[[f64; 3]]) -> Vec<usize> {
    let (mut number, mut place) = (0, vertices[0]);
    let mut numbers: Vec<usize> = vertices
        .iter()
        .map(|vertex| {
            if apart(*vertex, place, place) >= LEG_MIN_MM {
                (number, place) = (number + 1, *vertex);
            }
            number
        })
        .collect();
    numbers.push(number + 1);
    numbers
}

/// Largest distances with the pen down: of a setpoint from its legs, and of a vertex from the setpoints around it.
fn distances(run: &Run) -> (f64, f64) {
    let kinematics = Kinematics::new(&run.settings.geometry).unwrap();
    let vertices: Vec<[f64; 3]> = run.path.iter().map(|vertex| vertex.position.into()).collect();
    let places = places(&vertices);
    let mut off_legs = 0.0_f64;
    let mut nearest = std::vec![f64::INFINITY; vertices.len()];
    let mut before: Option<[f64; 3]> = None;
    let reported = run.reported();
    for (number, setpoint) in run.setpoints.iter().enumerate() {
        let at: [f64; 3] = kinematics.forward(&JointAngles(setpoint.position_rad)).unwrap().into();
        // A millisecond may pass many vertices, and an average lies between those of its neighbours.
        let executed = |number: usize| run.setpoints[number.min(run.setpoints.len() - 1)].vertex as usize;
        let (first, last) = (executed(number.saturating_sub(1)), executed(number + 1));
        let [earlier, later] = reported[number];
        let (low, high) = (
            places[first.min(last)].saturating_sub(NEAR),
            places[first.max(last)] + NEAR,
        );
        let from = places.partition_point(|place| *place < low).min(earlier);
        let to = places
            .partition_point(|place| *place < high)
            .max(later + 1)
            .min(vertices.len());
        let off = vertices[from..to]
            .windows(2)
            .map(|leg| apart(at, leg[0], leg[1]))
            .fold(f64::INFINITY, f64::min);
        if setpoint.pen == Pen::Down && to - from > 1 {
            off_legs = off_legs.max(off);
        }
        for index in from..to {
            nearest[index] = nearest[index].min(apart(vertices[index], before.unwrap_or(at), at));
        }
        before = Some(at);
    }
    let drawn = |index: usize| {
        let after = run.path.get(index + 1).map_or(Pen::Up, |next| next.pen);
        run.path[index].pen == Pen::Down || after == Pen::Down
    };
    let missed = (0..vertices.len())
        .filter(|index| drawn(*index))
        .map(|index| nearest[index])
        .fold(0.0, f64::max);
    (off_legs, missed)
}

/// Checks both distances; returns them as parts of the tolerance.
pub(super) fn check_distances(run: &Run, name: &str) -> (f64, f64) {
    let motion = &run.settings.motion;
    let (off_legs, missed) = distances(run);
    // Where nothing is averaged, setpoints a millisecond apart cut a corner.
    let cut = if run.trajectory.jerk_window_ms() > 1 {
        0.0
    } else {
        motion.acceleration_mm_s2 * TICK_S * TICK_S / 8.0
    };
    let limit = motion.tolerance_mm;
    let most = limit * (1.0 + EXCESS);
    assert!(
        off_legs <= most,
        "{name}: a setpoint is {off_legs} mm off, tolerance {limit} mm"
    );
    // A vertex that repeats another one is merged with it.
    assert!(
        missed <= most + cut + LEG_MIN_MM,
        "{name}: a vertex is missed by {missed} mm, tolerance {limit} mm"
    );
    (off_legs / limit, (missed - cut) / limit)
}

fn check(settings: &Settings, path: &[Vertex], name: &str) -> (f64, f64) {
    let run = Run::new(settings, path).whole();
    run.check_limits(name);
    check_distances(&run, name)
}

/// A drawing whose legs are about as long as the tolerance allows a spline, or far from it.
pub(super) fn drawing(random: &mut Random, tolerance_mm: f64) -> Vec<Vertex> {
    let scale_mm = tolerance_mm * libm::pow(10.0, random.between(-1.5, 2.0));
    let (turn_max, uneven, kind) = (random.between(0.05, PI), random.between(0.0, 1.5), random.below(4));
    let turn_even = random.between(0.02, turn_max);
    let mut at = [random.between(-30.0, 30.0), random.between(-30.0, 30.0), -850.0];
    let mut heading = random.between(0.0, TAU);
    let mut path = std::vec![vertex(at, Pen::Down, 0)];
    for _ in 0..10 + random.below(50) {
        heading += match kind {
            0 => turn_even,
            1 => [turn_even, -turn_even][random.below(2)],
            2 => random.between(-turn_max, turn_max),
            _ => [0.0, random.between(-1.1, 1.1)][random.below(2)],
        };
        let leg = scale_mm * libm::exp(uneven * random.between(-1.0, 1.0));
        at[0] = (at[0] + leg * libm::cos(heading)).clamp(-120.0, 120.0);
        at[1] = (at[1] + leg * libm::sin(heading)).clamp(-120.0, 120.0);
        path.push(vertex(at, Pen::Down, 0));
    }
    path
}

#[test]
fn drawings_of_every_scale_stay_within_the_tolerance_of_their_lines_and_reach_every_vertex() {
    let asked = std::env::var(DRAWINGS).ok().and_then(|text| text.parse().ok());
    let mut worst = (0.0_f64, 0.0_f64);
    for seed in 1..=asked.unwrap_or(DRAWINGS_OF_THE_SUITE) {
        let mut random = Random::new(seed);
        let mut settings = Settings::default();
        if random.below(2) == 0 {
            settings.motion.tolerance_mm = libm::pow(10.0, random.between(-2.3, 0.5));
            settings.motion.travel_tolerance_mm = settings.motion.tolerance_mm;
            settings.motion.acceleration_mm_s2 = libm::pow(10.0, random.between(1.5, 4.3));
            settings.motion.jerk_window_ms = [0, 4, 4, 8][random.below(4)];
        }
        assert_eq!(settings.check(), Ok(()));
        let path = drawing(&mut random, settings.motion.tolerance_mm);
        let one = check(&settings, &path, &format!("drawing {seed}"));
        worst = (worst.0.max(one.0), worst.1.max(one.1));
    }
    println!(
        "worst parts of the tolerance: setpoint to line {:.4}, vertex to setpoint {:.4}",
        worst.0, worst.1
    );
}

#[test]
fn a_recorded_walk_of_short_legs_keeps_its_tolerance() {
    let path = paths::sample_path(include_str!("../../../../samples/motion/tolerance.csv"));
    let (off_legs, missed) = check(&Settings::default(), &path, "tolerance.csv");
    println!("parts of the tolerance: setpoint to line {off_legs:.4}, vertex to setpoint {missed:.4}");
}
