use super::*;
use crate::random::Lcg;

/// Resolution of the reference implementation, mm.
const FINE_MM: f64 = 0.05;

fn place(x_mm: f64, y_mm: f64) -> Position {
    Position {
        x_mm,
        y_mm,
        z_mm: -850.0,
    }
}

fn steps(positions: &[Position]) -> Vec<Step> {
    let step = |position: &Position| Step {
        position: *position,
        unseen_mm: None,
    };
    positions.iter().map(step).collect()
}

impl Polyline {
    /// The match without limits.
    fn follow(&self, steps: &[Step], first_mm: [f64; 2]) -> Match {
        match Search::new(steps.to_vec(), first_mm, SearchLimits::NONE).go_on(self, usize::MAX) {
            SearchProgress::Found(found) => found,
            other => panic!("{other:?}"),
        }
    }
}

/// A line with points at most [`FINE_MM`] apart.
fn fine(points: &[Position]) -> Vec<Position> {
    let mut result = vec![points[0]];
    for pair in points.windows(2) {
        let count = (distance(&pair[0], &pair[1]) / FINE_MM).ceil().max(1.0) as usize;
        result.extend((1..=count).map(|k| between(&pair[0], &pair[1], k as f64 / count as f64)));
    }
    result
}

/// The discrete Fréchet distance by its definition (Eiter and Mannila, 1994), between points close together; positions
/// may begin and end anywhere on the line.
fn brute_force_mm(line: &[Position], positions: &[Position]) -> f64 {
    let (line, positions) = (fine(line), fine(positions));
    let mut row: Vec<f64> = Vec::new();
    for position in &positions {
        let mut next: Vec<f64> = Vec::with_capacity(line.len());
        for (index, point) in line.iter().enumerate() {
            let before = match (row.get(index), index.checked_sub(1)) {
                (None, _) => 0.0,
                (Some(above), None) => *above,
                (Some(above), Some(left)) => above.min(row[left]).min(next[left]),
            };
            next.push(before.max(distance(position, point)));
        }
        row = next;
    }
    row.iter().copied().fold(f64::INFINITY, f64::min)
}

/// Strokes that come close to themselves, each with its name.
fn strokes(random: &mut Lcg) -> Vec<(&'static str, Vec<Position>)> {
    let pitch = random.between(0.3, 1.2);
    let parallels = (0..12).map(|k| place(if (k + 1) / 2 % 2 == 0 { 0.0 } else { 6.0 }, f64::from(k / 2) * pitch));
    let mut reversals = vec![place(0.0, 0.0)];
    for _ in 0..8 {
        reversals.push(place(random.between(-6.0, 6.0), 0.0));
    }
    reversals.push(place(random.between(-3.0, 3.0), 4.0));
    let ring = |turns: i32| (0..=36 * turns).map(|k| f64::from(k) * std::f64::consts::TAU / 36.0);
    let on_top = ring(2).map(|angle| place(3.0 * angle.cos(), 3.0 * angle.sin()));
    let closed = ring(1).map(|angle| place(4.0 * angle.cos(), 2.0 * angle.sin()));
    let spiral = ring(4).map(|angle| {
        let radius = 1.0 + pitch * angle / std::f64::consts::TAU;
        place(radius * angle.cos(), radius * angle.sin())
    });
    let noise = (0..40).map(|_| place(random.between(0.0, 3.0), random.between(0.0, 3.0)));
    let noise = noise.collect();
    vec![
        ("parallels", parallels.collect()),
        ("reversals", reversals),
        ("rings on top of each other", on_top.collect()),
        ("closed ring", closed.collect()),
        ("spiral", spiral.collect()),
        ("noise", noise),
        ("one point", vec![place(1.0, 1.0), place(1.0, 1.0)]),
    ]
}

/// Positions along a line, each off it by a distance that varies up to `most_mm`.
fn off(points: &[Position], step_mm: f64, most_mm: f64, random: &mut Lcg) -> Vec<Position> {
    let line = Polyline::new(points.to_vec());
    let (period_mm, phase) = (random.between(3.0, 9.0), random.between(0.0, 6.0));
    let count = (line.length_mm() / step_mm).ceil() as usize;
    (0..=count)
        .map(|k| {
            let mm = (k as f64 * step_mm).min(line.length_mm());
            let leg = line.leg_at(mm);
            let on = line.at(leg, line.share(leg, mm));
            let off_mm = most_mm * (mm * std::f64::consts::TAU / period_mm + phase).sin();
            let angle = phase + mm / 7.0;
            place(on.x_mm + off_mm * angle.cos(), on.y_mm + off_mm * angle.sin())
        })
        .collect()
}

#[test]
fn the_distance_is_that_of_a_brute_force_search_on_lines_that_come_close_to_themselves() {
    for seed in 1..=4 {
        let mut random = Lcg::new(seed);
        for (name, points) in strokes(&mut random) {
            for most_mm in [0.0, 0.05, 0.4, 1.5] {
                let positions = off(&points, 0.3, most_mm, &mut random);
                let line = Polyline::new(points.clone());
                let found = line.follow(&steps(&positions), [0.0, f64::INFINITY]);
                let expected_mm = brute_force_mm(&points, &positions);
                let case = format!(
                    "seed {seed}, {name}, {most_mm} mm off: {} and {expected_mm} mm",
                    found.distance_mm
                );
                assert!((found.distance_mm - expected_mm).abs() <= FINE_MM, "{case}");
                // A tip may lie half a step beyond the last position.
                assert!(found.distance_mm <= most_mm + 0.2, "{case}");
                let farthest_mm = positions
                    .iter()
                    .zip(&found.places_mm)
                    .map(|(position, mm)| line.distance_between(position, *mm, *mm))
                    .fold(0.0, f64::max);
                assert!(
                    farthest_mm <= found.distance_mm + 1e-3,
                    "{case}: a place is {farthest_mm} mm away"
                );
                assert!(
                    found.places_mm.windows(2).all(|pair| pair[0] <= pair[1] + 1e-3),
                    "{case}"
                );
            }
        }
    }
}

#[test]
fn a_constant_distance_is_found_although_the_neighbour_is_closer() {
    // Back and forth, 0.5 mm apart, each leg 0.45 mm off: 0.05 mm from the next one.
    let points: Vec<Position> = (0..20)
        .map(|k| place(if (k + 1) / 2 % 2 == 0 { 0.0 } else { 40.0 }, f64::from(k / 2) * 0.5))
        .collect();
    let line = Polyline::new(points.clone());
    let count = (line.length_mm() / 0.05) as usize;
    let positions: Vec<Position> = (0..=count)
        .map(|k| {
            let mm = k as f64 * 0.05;
            let leg = line.leg_at(mm);
            let on = line.at(leg, line.share(leg, mm));
            place(on.x_mm, on.y_mm + 0.45)
        })
        .collect();
    let found = line.follow(&steps(&positions), [0.0, 1.0]);
    assert!((found.distance_mm - 0.45).abs() < 5e-3, "{}", found.distance_mm);
}

#[test]
fn after_a_break_positions_continue_at_their_own_place() {
    let line = Polyline::new(vec![
        place(0.0, 0.0),
        place(20.0, 0.0),
        place(20.0, 0.5),
        place(0.0, 0.5),
    ]);
    let mut positions: Vec<Step> = steps(&(0..=10).map(|k| place(f64::from(k), 0.0)).collect::<Vec<_>>());
    let mut after = steps(&(0..=10).map(|k| place(15.0 - f64::from(k), 0.5)).collect::<Vec<_>>());
    after[0].unseen_mm = Some(30.0);
    positions.extend(after);
    let found = line.follow(&positions, [0.0, 1.0]);
    assert!(found.distance_mm < 0.021, "{}", found.distance_mm);
    assert!((found.places_mm[11] - 25.5).abs() < 1e-2, "{:?}", found.places_mm);
}
