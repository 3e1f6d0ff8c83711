//! Duration of the travel moves between strokes, from the firmware's own planner.
//!
//! The planner is run for a few travel moves over the middle of the paper, from the end of one line to the beginning of
//! another; other lengths are interpolated, since the duration grows with the square root of a short distance and
//! linearly with a long one. Differences by direction and position, which are small, are ignored.
//!
//! Invariant: a longer travel move never takes less time.

use crate::planning;
use etherpen::config::{Config, Paper};
use etherpen::motion::{Pen, Vertex};
use etherpen::robots::Position;
use std::sync::OnceLock;

/// Entries of the table, at equal steps of the distance's square root.
const ENTRIES: usize = 48;
/// Step between two entries, in roots of millimetres: the last entry is for 552 mm.
const STEP: f64 = 0.5;
/// Entries computed by the planner; the last of them is for 196 mm.
const ASKED: [usize; 9] = [0, 1, 2, 4, 7, 11, 16, 22, 28];
/// Length of the lines before and after the travel move, mm.
const LINE_MM: f64 = 5.0;
/// Least share of the paper's shorter side that the travel moves leave free.
const BORDER: f64 = 0.1;
/// Least duration for each millimetre, s: makes the shorter one of two moves with equal planned durations cheaper.
const LEAST_S_MM: f64 = 1e-6;
/// Duration of a lift and speed, for a robot that cannot be planned.
const LIFT_S: f64 = 0.12;
const SPEED_MM_S: f64 = 800.0;

/// Cost of travel moves.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // one for a drawing
pub enum Travel {
    /// Length, a second for each millimetre: for comparisons with programs that do not compute times.
    Length,
    /// Duration, including lifting and lowering the pen.
    Planned(Times),
}

/// Durations at equal steps of the distance's square root, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Times([f64; ENTRIES]);

impl Default for Travel {
    /// Durations for the built-in configuration.
    fn default() -> Self {
        static BUILT_IN: OnceLock<Travel> = OnceLock::new();
        *BUILT_IN.get_or_init(|| Self::of(&Config::default()))
    }
}

impl Travel {
    /// Computes the durations with the planner for a configuration.
    #[must_use]
    pub fn of(config: &Config) -> Self {
        let [width, height] = config.paper.size_mm;
        let room_mm = (1.0 - BORDER) * width.min(height);
        let asked = ASKED.iter().filter(|&&entry| distance_mm(entry) <= room_mm);
        let known: Vec<(usize, f64)> = asked
            .map_while(|&entry| Some((entry, planned_s(config, distance_mm(entry))?)))
            .collect();
        let mut seconds = [0.0; ENTRIES];
        let mut least_s = 0.0;
        for (entry, value) in seconds.iter_mut().enumerate() {
            least_s = between(&known, entry).max(least_s);
            *value = least_s + LEAST_S_MM * distance_mm(entry);
        }
        Self::Planned(Times(seconds))
    }

    /// Duration of a travel move over a distance, s.
    #[must_use]
    pub fn seconds(&self, distance_mm: f64) -> f64 {
        let Self::Planned(Times(seconds)) = self else {
            return distance_mm;
        };
        let place = distance_mm.max(0.0).sqrt() / STEP;
        // An entry beyond the table uses the line through the last pair.
        let entry = (place as usize).min(ENTRIES - 2);
        let (Some(&from), Some(&to)) = (seconds.get(entry), seconds.get(entry + 1)) else {
            return 0.0;
        };
        from + (to - from) * (place - entry as f64)
    }
}

fn distance_mm(entry: usize) -> f64 {
    (STEP * entry as f64).powi(2)
}

/// An entry between known ones: linear in the distance's root; beyond the last one linear in the distance.
fn between(known: &[(usize, f64)], entry: usize) -> f64 {
    let plain = LIFT_S + distance_mm(entry) / SPEED_MM_S;
    let Some(after) = known.iter().position(|&(other, _)| other >= entry) else {
        let [.., (first, first_s), (last, last_s)] = known else {
            return plain;
        };
        let share = (distance_mm(entry) - distance_mm(*first)) / (distance_mm(*last) - distance_mm(*first));
        return first_s + share * (last_s - first_s);
    };
    let (Some(&(low, low_s)), Some(&(high, high_s))) = (known.get(after.saturating_sub(1)), known.get(after)) else {
        return plain;
    };
    if high == low {
        return high_s;
    }
    low_s + (high_s - low_s) * (entry as f64 - low as f64) / (high as f64 - low as f64)
}

/// Mean duration of travel moves along and across the sheet.
fn planned_s(config: &Config, distance_mm: f64) -> Option<f64> {
    let duration_s = |path: &[Vertex]| Some(planning::plan(config, path, |_, _| ()).ok()?.duration_ms as f64 / 1_000.0);
    let mut sum_s = 0.0;
    for along in [0, 1] {
        let path = way(&config.paper, along, distance_mm);
        let line_s = duration_s(path.get(..2)?)?;
        sum_s += duration_s(&path)? - 2.0 * line_s;
    }
    Some(0.5 * sum_s)
}

fn at(paper: &Paper, along: usize, [along_mm, across_mm]: [f64; 2], lifted_mm: f64, pen: Pen) -> Vertex {
    let [x, y] = if along == 0 {
        [along_mm, across_mm]
    } else {
        [across_mm, along_mm]
    };
    let [centre_x, centre_y] = paper.centre_mm;
    let (x_mm, y_mm) = (centre_x + x, centre_y + y);
    let z_mm = paper.plane().z_at_mm(x_mm, y_mm) + lifted_mm;
    Vertex {
        position: Position { x_mm, y_mm, z_mm },
        pen,
        stroke: 0,
    }
}

/// A line, the travel move, and another line.
fn way(paper: &Paper, along: usize, distance_mm: f64) -> Vec<Vertex> {
    let (from, to) = (-0.5 * distance_mm, 0.5 * distance_mm);
    let mut path = vec![
        at(paper, along, [from, -LINE_MM], 0.0, Pen::Up),
        at(paper, along, [from, 0.0], 0.0, Pen::Down),
        at(paper, along, [from, 0.0], paper.pen_lift_mm, Pen::Up),
        at(paper, along, [to, 0.0], paper.pen_lift_mm, Pen::Up),
        at(paper, along, [to, 0.0], 0.0, Pen::Up),
        at(paper, along, [to, LINE_MM], 0.0, Pen::Down),
    ];
    path.dedup_by(|next, last| next.position == last.position);
    path
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_longer_way_takes_longer_and_twice_the_way_less_than_twice_the_time() {
        let travel = Travel::default();
        let mut last_s = 0.0;
        for step in 0..3_000 {
            let mm = 0.25 * f64::from(step);
            let seconds = travel.seconds(mm);
            assert!(seconds > last_s, "{mm} mm: {seconds} s after {last_s} s");
            last_s = seconds;
        }
        for mm in [1.0, 10.0, 50.0, 100.0] {
            assert!(travel.seconds(2.0 * mm) < 2.0 * travel.seconds(mm), "{mm} mm");
        }
        assert!((0.05..0.3).contains(&travel.seconds(0.0)), "{}", travel.seconds(0.0));
        assert!((0.1..0.6).contains(&travel.seconds(100.0)), "{}", travel.seconds(100.0));
    }

    #[test]
    fn between_what_was_asked_the_planner_says_nearly_the_same() {
        let (config, travel) = (Config::default(), Travel::default());
        for mm in [0.6, 6.0, 37.0, 80.0, 150.0] {
            let planned = planned_s(&config, mm).expect("within the sheet");
            let difference = travel.seconds(mm) / planned - 1.0;
            assert!(difference.abs() < 0.05, "{mm} mm: {difference}");
        }
    }

    #[test]
    fn a_robot_whose_planner_does_not_answer_has_plain_times() {
        let mut config = Config::default();
        config.paper.pen_down_z_mm = 0.0;
        let travel = Travel::of(&config);
        assert!((travel.seconds(0.0) - LIFT_S).abs() < 1e-9);
        assert!((travel.seconds(400.0) - LIFT_S - 0.5).abs() < 0.01);
    }
}
