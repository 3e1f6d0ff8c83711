//! Verification of a drawing: compares the measured path with the intended one, stroke by stroke.
//!
//! The firmware reports the end of a path when its references have ended. Whether the pen followed them is checked in
//! the telemetry: each stroke's references are matched with the stroke in order, and the part between two of them
//! counts as followed if the positions measured for both are close to it. Parts whose samples were lost on the line are
//! neither followed nor missing: they are not verified.
//!
//! Invariants: a part counts as missing only if a sample shows it, or if samples without a gap show that it was never
//! reached; memory is bounded by the path and `SAMPLES_MAX`.

use super::error::JobError;
use crate::matching::{Line, Step};
use etherpen::application::Mode;
use etherpen::config::{AxisMode, Config};
use etherpen::link::protocol::{PathVertex, Sample};
use etherpen::motion::Pen;
use etherpen::robot::{Delta, JointAngles, Position};
use std::collections::{HashMap, VecDeque};

/// Largest distance of a measured position from its place on the stroke that counts as followed, mm. Drawings stay
/// within 0.1 mm; the pen's spring gives ink up to 0.3 mm above the paper.
const FOLLOWED_MM: f64 = 0.5;
/// Largest distance for an axis in torque mode, mm: gravity and friction are left to the feedback, which takes up to 1
/// mm.
const FOLLOWED_BY_TORQUE_MM: f64 = 1.5;
/// How far along the stroke from its reference a measured position may be, as a multiple of the largest distance.
const ALONG: f64 = 2.0;
/// Least total length of a stroke's missing parts that counts, mm: less is a dot at its ends.
const MISSING_MIN_MM: f64 = 0.5;
/// Length below which a difference counts as rounding, mm.
const ROUNDING_MM: f64 = 1e-6;
/// Distance from their stroke's ends within which references begin and end, mm.
const END_MM: f64 = 0.5;
/// Samples of a stroke that are matched at once.
const SAMPLES_MAX: usize = 4_096;
/// Distance within which a stroke's first reference searches the beginning of the stroke, mm.
const BEGIN_MM: f64 = 2.0;
/// Largest speed of references relative to the configured one: an override of 200 percent.
const SPEED_SHARE: f64 = 2.0;

/// Parts of a length: from and to, mm, ordered and disjoint.
#[derive(Clone, Debug, Default, PartialEq)]
struct Parts(Vec<[f64; 2]>);

impl Parts {
    fn add(&mut self, from_mm: f64, to_mm: f64) {
        if to_mm <= from_mm {
            return;
        }
        let first = self.0.partition_point(|part| part[1] < from_mm);
        let after = self.0.partition_point(|part| part[0] <= to_mm);
        let touched = self.0.get(first..after).unwrap_or_default();
        let low_mm = touched.first().map_or(from_mm, |part| part[0].min(from_mm));
        let high_mm = touched.last().map_or(to_mm, |part| part[1].max(to_mm));
        self.0.splice(first..after.max(first), [[low_mm, high_mm]]);
    }

    fn extend(&mut self, other: &Self) {
        other.0.iter().for_each(|part| self.add(part[0], part[1]));
    }

    /// Length of the parts between two places, mm.
    fn length_between(&self, from_mm: f64, to_mm: f64) -> f64 {
        let first = self.0.partition_point(|part| part[1] < from_mm);
        let within = self.0.iter().skip(first).take_while(|part| part[0] < to_mm);
        within
            .map(|part| (part[1].min(to_mm) - part[0].max(from_mm)).max(0.0))
            .sum()
    }
}

/// A stroke and its place among all strokes.
#[derive(Clone, Debug)]
struct Stroke {
    number: u32,
    /// The first of its vertices in the path.
    vertex: u32,
    /// Length of all strokes before it, mm.
    begin_mm: f64,
    length_mm: f64,
}

/// Result of verifying the telemetry of a drawing; results of several connections can be merged.
#[derive(Clone, Debug, Default)]
pub struct Verification {
    strokes: Vec<Stroke>,
    followed: Parts,
    /// Parts where the pen was elsewhere, or which it skipped.
    off: Parts,
}

/// Verdict on a drawing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Verdict {
    /// Length of all strokes, mm.
    pub total_mm: f64,
    /// Length that the pen followed, mm.
    pub followed_mm: f64,
    /// Length that the pen did not follow, mm.
    pub missing_mm: f64,
    /// Length without telemetry, mm.
    pub unverified_mm: f64,
    /// Strokes with a missing part, by their numbers in the path, from 0.
    pub strokes: Vec<u32>,
    /// Vertices of the path before the first of those strokes.
    pub complete_vertices: u32,
}

impl Verdict {
    /// Why the drawing is incomplete, if a part of it is missing.
    #[must_use]
    pub fn error(&self) -> Option<JobError> {
        Some(JobError::NotFollowed {
            missing_mm: self.missing_mm,
            total_mm: self.total_mm,
            first: *self.strokes.first()?,
            last: *self.strokes.last()?,
            strokes: self.strokes.len(),
        })
    }
}

impl Verification {
    /// Adds the result of another connection for this path.
    pub fn merge(&mut self, other: &Self) {
        if self.strokes.is_empty() {
            self.strokes.clone_from(&other.strokes);
        }
        self.followed.extend(&other.followed);
        self.off.extend(&other.off);
    }

    /// The verdict.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        let mut verdict = Verdict::default();
        let mut either = self.followed.clone();
        either.extend(&self.off);
        for stroke in &self.strokes {
            let (from_mm, to_mm) = (stroke.begin_mm, stroke.begin_mm + stroke.length_mm);
            let followed_mm = self.followed.length_between(from_mm, to_mm);
            let seen_mm = either.length_between(from_mm, to_mm);
            // Rounding may make the differences of sums slightly negative.
            let missing_mm = (seen_mm - followed_mm).max(0.0);
            verdict.total_mm += stroke.length_mm;
            verdict.followed_mm += followed_mm;
            verdict.unverified_mm += (stroke.length_mm - seen_mm).max(0.0);
            if missing_mm < MISSING_MIN_MM.min(0.5 * stroke.length_mm) || missing_mm == 0.0 {
                continue;
            }
            verdict.missing_mm += missing_mm;
            if verdict.strokes.is_empty() {
                verdict.complete_vertices = stroke.vertex;
            }
            if verdict.strokes.last() != Some(&stroke.number) {
                verdict.strokes.push(stroke.number);
            }
        }
        if verdict.unverified_mm < ROUNDING_MM {
            verdict.unverified_mm = 0.0;
        }
        verdict
    }
}

/// One millisecond of a stroke.
#[derive(Clone, Copy)]
struct Row {
    reference: Position,
    measured: Position,
    /// Milliseconds since the previous row.
    passed_ms: u32,
    /// Whether samples are missing before this row.
    is_after_gap: bool,
}

/// Verifies a drawing from its telemetry.
pub struct Verifier {
    result: Verification,
    lines: Vec<Line>,
    /// The first line of each stroke.
    numbers: HashMap<u32, usize>,
    delta: Option<Delta>,
    age_ms: u32,
    near_mm: f64,
    speed_mm_s: f64,
    /// The last samples, as many milliseconds as the age of a measurement.
    recent: VecDeque<Sample>,
    /// Whether samples were lost since the last row.
    has_gap: bool,
    /// The line being drawn, and its rows that are not matched yet.
    line: Option<usize>,
    rows: Vec<Row>,
    last_ms: Option<u32>,
    /// Position of the references along all strokes, mm.
    reached_mm: f64,
    /// Position of the references along the present line, mm; `None` before the first match.
    place_mm: Option<f64>,
}

impl Verifier {
    /// A verifier for a path from its beginning, or for one that is resumed at any place.
    #[must_use]
    pub fn new(path: &[PathVertex], config: &Config, from_begin: bool) -> Self {
        let is_torque = config.axes.iter().any(|axis| axis.mode == AxisMode::Torque);
        let mut result = Self {
            result: Verification::default(),
            lines: Vec::new(),
            numbers: HashMap::new(),
            delta: Delta::new(&config.geometry).ok(),
            age_ms: config.axes[0].measurement_age_ms.round().max(0.0) as u32,
            near_mm: if is_torque { FOLLOWED_BY_TORQUE_MM } else { FOLLOWED_MM },
            speed_mm_s: SPEED_SHARE * config.motion.speed_mm_s,
            recent: VecDeque::new(),
            has_gap: !from_begin,
            line: None,
            rows: Vec::new(),
            last_ms: None,
            reached_mm: 0.0,
            place_mm: None,
        };
        for (line, number, vertex) in lines(path) {
            let begin_mm = result
                .result
                .strokes
                .last()
                .map_or(0.0, |last| last.begin_mm + last.length_mm);
            result.result.strokes.push(Stroke {
                number,
                vertex,
                begin_mm,
                length_mm: line.length_mm(),
            });
            result.numbers.entry(number).or_insert(result.lines.len());
            result.lines.push(line);
        }
        result
    }

    /// Takes new samples, in order.
    pub fn observe(&mut self, samples: &[Sample]) {
        samples.iter().for_each(|sample| self.step(sample));
    }

    /// The result; `is_over` tells that the firmware reported the end of the path.
    #[must_use]
    pub fn finish(mut self, is_over: bool) -> Verification {
        self.end_line();
        // Samples from after the drawing show that none of it came after the last row.
        let is_past = |sample: &Sample| !matches!(sample.mode, Mode::Drawing | Mode::Holding);
        if is_over && !self.has_gap && self.recent.back().is_some_and(is_past) {
            let end_mm = self
                .result
                .strokes
                .last()
                .map_or(0.0, |last| last.begin_mm + last.length_mm);
            self.result.off.add(self.reached_mm, end_mm);
        }
        self.result
    }

    fn step(&mut self, sample: &Sample) {
        if self
            .recent
            .back()
            .is_some_and(|last| sample.t_ms.wrapping_sub(last.t_ms) != 1)
        {
            self.has_gap = true;
            self.recent.clear();
        }
        self.recent.push_back(*sample);
        if self.recent.len() <= self.age_ms as usize {
            return;
        }
        // Reference, stroke and pen to which the measurement belongs.
        let Some(cause) = self.recent.pop_front() else { return };
        if !matches!(cause.mode, Mode::Drawing | Mode::Holding) || cause.pen == Pen::Up {
            return;
        }
        let Some(delta) = &self.delta else { return };
        let place = |angles_rad: [f32; 4]| delta.forward(&JointAngles(angles_rad.map(f64::from))).ok();
        let (Some(reference), Some(measured)) = (place(cause.reference_rad), place(sample.measured_rad)) else {
            return;
        };
        let line = self.numbers.get(&cause.stroke).copied();
        if line != self.line || self.rows.len() >= SAMPLES_MAX {
            self.match_rows();
            if line != self.line {
                self.end_line();
                self.line = line;
            }
        }
        let passed_ms = self
            .last_ms
            .replace(sample.t_ms)
            .map_or(1, |last_ms| sample.t_ms.wrapping_sub(last_ms));
        self.rows.push(Row {
            reference,
            measured,
            passed_ms,
            is_after_gap: std::mem::take(&mut self.has_gap),
        });
    }

    /// Ends the present line: its parts that were not reached were skipped.
    fn end_line(&mut self) {
        self.match_rows();
        self.place_mm = None;
        self.line = None;
    }

    /// Matches the rows of the present line.
    fn match_rows(&mut self) {
        let rows = std::mem::take(&mut self.rows);
        let (Some(index), Some(first)) = (self.line, rows.first()) else {
            return;
        };
        let (Some(line), Some(stroke)) = (self.lines.get(index), self.result.strokes.get(index)) else {
            return;
        };
        let unseen_mm = |row: &Row| self.speed_mm_s * f64::from(row.passed_ms) / 1_000.0 + BEGIN_MM;
        let steps: Vec<Step> = (rows.iter())
            .map(|row| Step {
                position: row.reference,
                unseen_mm: (row.passed_ms > 1).then(|| unseen_mm(row)),
            })
            .collect();
        let is_at_begin = line.distance_between(&first.reference, 0.0, 0.0) <= BEGIN_MM;
        let first_mm = match self.place_mm {
            Some(place_mm) => [place_mm - END_MM, place_mm + unseen_mm(first)],
            None if is_at_begin => [0.0, BEGIN_MM],
            None => [0.0, f64::INFINITY],
        };
        let places_mm = line.follow(&steps, first_mm).places_mm;
        let reach_mm = ALONG * self.near_mm;
        let is_near = |(row, mm): (&Row, &f64)| {
            line.distance_between(&row.measured, mm - reach_mm, mm + reach_mm) <= self.near_mm
        };
        let near: Vec<bool> = rows.iter().zip(&places_mm).map(is_near).collect();
        let (Some(&begin_mm), Some(&end_mm)) = (places_mm.first(), places_mm.last()) else {
            return;
        };
        let mut note = |from_mm: f64, to_mm: f64, is_followed: bool| {
            let parts = if is_followed {
                &mut self.result.followed
            } else {
                &mut self.result.off
            };
            parts.add(stroke.begin_mm + from_mm, stroke.begin_mm + to_mm);
        };
        let last_near = near.last().copied().unwrap_or_default();
        // Corners at a stroke's ends are rounded.
        if begin_mm <= END_MM {
            note(0.0, begin_mm, near.first().copied().unwrap_or_default());
        }
        if stroke.length_mm - end_mm <= END_MM {
            note(end_mm, stroke.length_mm, last_near);
        }
        for (index, row) in rows.iter().enumerate().skip(1).filter(|(_, row)| !row.is_after_gap) {
            let is_followed = near[index - 1] && near[index];
            // A pen that was lifted and lowered again has drawn nothing in between.
            let is_drawn = row.passed_ms == 1 || places_mm[index] - places_mm[index - 1] <= END_MM;
            note(places_mm[index - 1], places_mm[index], is_followed && is_drawn);
        }
        if !first.is_after_gap {
            let reached_mm = self.reached_mm;
            let is_close = stroke.begin_mm + begin_mm - reached_mm <= END_MM;
            let parts = if is_close && near[0] {
                &mut self.result.followed
            } else {
                &mut self.result.off
            };
            parts.add(reached_mm, stroke.begin_mm + begin_mm);
        }
        let ended_mm = if stroke.length_mm - end_mm <= END_MM {
            stroke.length_mm
        } else {
            end_mm
        };
        self.reached_mm = self.reached_mm.max(stroke.begin_mm + ended_mm);
        self.place_mm = Some(end_mm);
    }
}

/// The drawn lines of a path, each with its stroke number and first vertex.
fn lines(path: &[PathVertex]) -> Vec<(Line, u32, u32)> {
    let at = |vertex: &PathVertex| {
        let [x_mm, y_mm, z_mm] = vertex.position_um.map(|um| f64::from(um) / 1_000.0);
        Position { x_mm, y_mm, z_mm }
    };
    let mut found: Vec<(Vec<Position>, u32, u32)> = Vec::new();
    let (mut first, mut is_drawing) = (0, false);
    for (index, pair) in (0_u32..).zip(path.windows(2)) {
        if pair[1].stroke != pair[0].stroke {
            first = index + 1;
        }
        if pair[1].pen == Pen::Up {
            is_drawing = false;
            continue;
        }
        match found.last_mut() {
            Some((points, number, _)) if is_drawing && *number == pair[1].stroke => points.push(at(&pair[1])),
            _ => found.push((vec![at(&pair[0]), at(&pair[1])], pair[1].stroke, first)),
        }
        is_drawing = true;
    }
    found
        .into_iter()
        .map(|(points, number, vertex)| (Line::new(points), number, vertex))
        .collect()
}

#[cfg(test)]
mod tests;
