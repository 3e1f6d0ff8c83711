//! Random drawings: strokes of unlike kinds, each at a scale of its own.
//!
//! A planner has to draw what a digitiser, a hatching filter or a vectoriser sends: steps of single micrometres that
//! turn back, short legs of nearly one length, dense parallels, spirals.

use super::chance::Chance;
use super::episode::Figure;
use super::machine::Machine;
use std::f64::consts::{PI, TAU};

/// Step of the link's coordinates, mm.
const QUANTUM_MM: f64 = 1.0e-3;

type Point = [f64; 2];

/// One to four strokes on the machine's sheet.
pub(super) fn figure(chance: &mut Chance, machine: &Machine) -> Figure {
    let half_mm = machine.figure_mm();
    let strokes = (0..1 + chance.below(4)).map(|_| {
        let from = half_mm.map(|half_mm| chance.between(-0.8 * half_mm, 0.8 * half_mm));
        let points = match chance.below(8) {
            0 | 1 => walk(chance, from, half_mm),
            2 | 3 => noise(chance, from),
            4 => winding(chance, from),
            5 => hatch(chance, from),
            6 => spiral(chance, from),
            _ => reversals(chance, from),
        };
        whole(&points, half_mm, machine.config.paper.centre_mm)
    });
    Figure(strokes.collect())
}

/// The points in micrometres, within their part of the sheet; a stroke has two different ones at least.
fn whole(points: &[Point], half_mm: Point, centre_mm: Point) -> Vec<[i32; 2]> {
    let um = |point: &Point| {
        [0, 1].map(|axis| ((centre_mm[axis] + point[axis].clamp(-half_mm[axis], half_mm[axis])) * 1e3).round() as i32)
    };
    let mut points: Vec<[i32; 2]> = points.iter().map(um).collect();
    points.dedup();
    if let [[x_um, y_um]] = points[..] {
        points.push([x_um, y_um + 10]);
    }
    points
}

fn ahead([x, y]: Point, direction_rad: f64, mm: f64) -> Point {
    [x + mm * direction_rad.cos(), y + mm * direction_rad.sin()]
}

/// Steps of one scale in every direction.
fn walk(chance: &mut Chance, from: Point, half_mm: Point) -> Vec<Point> {
    let step_mm = chance.scaled(0.002, 80.0);
    let (mut at, mut points) = (from, vec![from]);
    for _ in 0..2 + chance.below(40) {
        at = [0, 1].map(|axis| (at[axis] + chance.between(-step_mm, step_mm)).clamp(-half_mm[axis], half_mm[axis]));
        points.push(at);
    }
    points
}

/// What a digitiser at rest sends: each coordinate stays or goes by a step to either side.
fn noise(chance: &mut Chance, from: Point) -> Vec<Point> {
    let step_mm = chance.scaled(QUANTUM_MM, 1.0);
    let (mut at, mut points) = (from, vec![from]);
    for _ in 0..20 + chance.below(200) {
        at = at.map(|mm| mm + step_mm * chance.one_of(&[-1.0, 0.0, 1.0]));
        points.push(at);
    }
    points
}

/// Legs of similar lengths that turn a little at every point.
fn winding(chance: &mut Chance, from: Point) -> Vec<Point> {
    let (leg_mm, turn_rad) = (chance.scaled(0.01, 10.0), chance.between(0.05, PI / 2.0));
    let mut direction_rad = chance.between(0.0, TAU);
    let (mut at, mut points) = (from, vec![from]);
    for _ in 0..10 + chance.below(120) {
        direction_rad += chance.between(-turn_rad, turn_rad);
        at = ahead(at, direction_rad, leg_mm * chance.scaled(0.5, 2.0));
        points.push(at);
    }
    points
}

/// Parallels, drawn to and fro.
fn hatch(chance: &mut Chance, from: Point) -> Vec<Point> {
    let (length_mm, distance_mm) = (chance.scaled(0.1, 60.0), chance.scaled(0.005, 5.0));
    let direction_rad = chance.between(0.0, TAU);
    let line = |number: u64| {
        let start = ahead(from, direction_rad + PI / 2.0, distance_mm * number as f64);
        let end = ahead(start, direction_rad, length_mm);
        if number.is_multiple_of(2) {
            [start, end]
        } else {
            [end, start]
        }
    };
    (0..2 + chance.below(20)).flat_map(line).collect()
}

/// A spiral of straight legs.
fn spiral(chance: &mut Chance, from: Point) -> Vec<Point> {
    let (turn_rad, widening) = (chance.scaled(0.05, 2.0), chance.between(1.0, 1.15));
    let radius_mm = chance.scaled(0.005, 20.0);
    let at = |number: u64| ahead(from, turn_rad * number as f64, radius_mm * widening.powf(number as f64));
    (0..5 + chance.below(60)).map(at).collect()
}

/// To and fro on nearly one line, by unlike lengths.
fn reversals(chance: &mut Chance, from: Point) -> Vec<Point> {
    let (length_mm, off_rad) = (chance.scaled(QUANTUM_MM, 40.0), chance.scaled(1.0e-6, 0.3));
    let mut direction_rad = chance.between(0.0, TAU);
    let (mut at, mut points) = (from, vec![from]);
    for _ in 0..4 + chance.below(40) {
        at = ahead(at, direction_rad, length_mm * chance.scaled(0.01, 1.0));
        direction_rad += PI + chance.between(-off_rad, off_rad);
        points.push(at);
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::machine::DEFAULT_MACHINE;

    #[test]
    fn figures_have_short_steps_reversals_and_long_lines() {
        let mut chance = Chance::new(1);
        let machine = Machine::load(DEFAULT_MACHINE).expect("a bundled machine");
        let (mut finest, mut short, mut long, mut reversals) = (0, 0, 0, 0);
        for _ in 0..300 {
            for points in figure(&mut chance, &machine).0 {
                assert!(points.len() >= 2);
                assert!(points.iter().flatten().all(|um| um.abs() <= 90_010));
                let legs: Vec<[i64; 2]> = points
                    .windows(2)
                    .map(|pair| [0, 1].map(|axis| i64::from(pair[1][axis]) - i64::from(pair[0][axis])))
                    .collect();
                for [x, y] in &legs {
                    let squared = x * x + y * y;
                    assert!(squared > 0, "a point repeats the one before it");
                    finest += u32::from(squared <= 2);
                    short += u32::from((200 * 200..400 * 400).contains(&squared));
                    long += u32::from(squared > 20_000 * 20_000);
                }
                reversals += legs
                    .windows(2)
                    .filter(|pair| pair[0][0] == -pair[1][0] && pair[0][1] == -pair[1][1])
                    .count();
            }
        }
        for (what, count) in [("finest", finest), ("short", short), ("long", long)] {
            assert!(count > 50, "{count} {what} steps");
        }
        assert!(reversals > 50, "{reversals} reversals");
    }
}
