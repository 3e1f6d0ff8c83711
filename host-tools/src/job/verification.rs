//! Verification of a drawing: compares the measured path with the intended one, stroke by stroke.
//!
//! The firmware reports the end of a path when its references have ended. Whether the pen followed them is checked in
//! the telemetry: each stroke's references are matched with the stroke in order, and the part between two of them
//! counts as followed if the positions measured for both are close to it. Parts whose samples were lost on the line are
//! neither followed nor missing: they are not verified.
//!
//! A dot is so short that all of it may pass between two samples; it is looked for in those around it too.
//!
//! Strokes are compared without their noise: vertices within `THINNED_MM` of the one before do not matter. A stroke
//! that then still comes so close to itself that matching would cost more than `LOOKS_PER_ROW` is not verified.
//!
//! Invariants: no part counts as missing without a sample that shows it, or samples without a gap that show that it was
//! never reached. [`Verifier::observe`] matches nothing, and [`Verifier::work`] does a bounded part of the work, so
//! that the thread that writes STOP never waits for more. Memory is bounded by the path, `ROWS_MAX` and
//! `PARTS_PER_ROW`. The result does not depend on how the work is divided.

mod parts;
mod verdict;

use crate::matching::{Polyline, Search, SearchLimits, SearchProgress, Step, distance, kept};
use etherpen::application::Mode;
use etherpen::config::{AxisMode, Config};
use etherpen::messages::{PathVertex, Sample};
use etherpen::motion::{Pen, shaper_deviation_mm};
use etherpen::robots::{JointAngles, Kinematics, Position};
use std::collections::{HashMap, VecDeque};
use verdict::VerifiedStroke;
pub use verdict::{Verdict, Verification};

/// Largest distance of a measured position from its place on the stroke that counts as followed, mm. Drawings stay
/// within 0.1 mm; the pen's spring gives ink up to 0.3 mm above the paper.
const FOLLOWED_MM: f64 = 0.5;
/// Largest distance for an axis in torque mode, mm: gravity and friction are left to the feedback, which takes up to 1
/// mm.
const FOLLOWED_BY_TORQUE_MM: f64 = 1.5;
/// How far along the stroke from its reference a measured position may be, as a multiple of the largest distance.
const ALONG: f64 = 2.0;
/// Distance from their stroke's ends within which references begin and end, mm.
const END_MM: f64 = 0.5;
/// Distance of a reference from a dot within which the pen is on it, whatever the sample says of the pen, mm: a path that turns
/// round at the paper has samples there.
const TOUCHES_MM: f64 = 0.1;
/// Samples of a stroke that are matched at once.
const SAMPLES_MAX: usize = 4_096;
/// Vertices of a stroke within this distance of the one before count as noise, mm; well below [`FOLLOWED_MM`].
const THINNED_MM: f64 = 0.1;
/// Most samples waiting to be matched; further ones are not verified.
const ROWS_MAX: usize = 32_768;
/// Most looks at a leg of the stroke for each sample matched; ordinary drawings take about a hundred.
const LOOKS_PER_ROW: usize = 2_000;
/// Average number of parts of the stroke kept for each sample while its distance is searched.
const PARTS_PER_ROW: usize = 64;
/// Most parts of the stroke kept for one sample.
const PARTS_AT_ONCE: usize = 1_024;
/// Looks for each leg of a stroke on which samples may begin anywhere: each distance tried looks at all legs.
const LOOKS_PER_LEG: usize = 40;
/// Distance within which a stroke's first reference searches for the stroke's beginning, mm.
const BEGIN_MM: f64 = 2.0;
/// Largest speed of references relative to the configured one: an override of 200 percent.
const SPEED_SHARE: f64 = 2.0;

/// A line that is drawn without lifting the pen.
struct Line {
    points: Vec<Position>,
    /// Number of its stroke.
    number: u32,
    /// The first vertex of its stroke in the path.
    vertex: u32,
    /// Where its first point is in the path.
    first_point: u32,
}

/// One millisecond of a stroke.
#[derive(Clone, Copy)]
struct StrokeRow {
    reference: Position,
    measured: Position,
    /// Milliseconds since the previous row.
    passed_ms: u32,
    /// Whether samples are missing before this row.
    is_after_gap: bool,
}

/// Rows of a line that are matched at once.
struct Piece {
    line: usize,
    /// Empty if there were too many to be matched.
    rows: Vec<StrokeRow>,
    /// Whether the pen reached the line in this piece.
    begins: bool,
}

/// A piece that is being matched.
struct Matching {
    piece: Piece,
    search: Search,
    places_mm: Vec<f64>,
    /// Whether the measured position was near the row's place, for the first rows.
    near: Vec<bool>,
}

/// Watches a drawing's telemetry.
pub struct Verifier {
    result: Verification,
    lines: Vec<Polyline>,
    /// The first line of each stroke.
    numbers: HashMap<u32, usize>,
    kinematics: Option<Kinematics>,
    age_ms: u32,
    near_mm: f64,
    speed_mm_s: f64,
    /// The last sample.
    newest: Option<Sample>,
    /// The last samples, as many milliseconds as the age of a measurement: what was measured for them is not known yet.
    recent: VecDeque<Sample>,
    /// Whether samples were lost since the last row.
    has_gap: bool,
    /// The line being drawn, and its rows that are not queued for matching yet.
    line: Option<usize>,
    rows: Vec<StrokeRow>,
    /// Whether no row of the line has been queued or matched yet.
    begins: bool,
    last_ms: Option<u32>,
    /// Pieces waiting to be matched, in order.
    pieces: VecDeque<Piece>,
    matching: Option<Matching>,
    /// How far the matched references have come along all strokes, mm.
    reached_mm: f64,
    /// Position of the references along the present line, mm; `None` before the first match.
    place_mm: Option<f64>,
    /// Whether rows of the present line were left out since the last match.
    is_line_left_out: bool,
    /// Whether any rows were left out.
    is_left_out: bool,
    looks: usize,
}

impl Verifier {
    /// A verifier for a path from its beginning, or for one resumed anywhere.
    #[must_use]
    pub fn new(path: &[PathVertex], config: &Config, from_begin: bool) -> Self {
        let is_torque = config.axes.iter().any(|axis| axis.mode == AxisMode::Torque);
        let mut result = Self {
            result: Verification::default(),
            lines: Vec::new(),
            numbers: HashMap::new(),
            kinematics: Kinematics::new(&config.geometry).ok(),
            age_ms: config.axes[0].measurement_age_ms.round().max(0.0) as u32,
            near_mm: shaper_deviation_mm(&config.motion) + if is_torque { FOLLOWED_BY_TORQUE_MM } else { FOLLOWED_MM },
            speed_mm_s: SPEED_SHARE * config.motion.speed_mm_s,
            newest: None,
            recent: VecDeque::new(),
            has_gap: !from_begin,
            line: None,
            rows: Vec::new(),
            begins: true,
            last_ms: None,
            pieces: VecDeque::new(),
            matching: None,
            reached_mm: 0.0,
            place_mm: None,
            is_line_left_out: false,
            is_left_out: false,
            looks: 0,
        };
        let mut begin_mm = 0.0;
        for Line {
            points,
            number,
            vertex,
            first_point,
        } in lines(path)
        {
            let kept = kept(&points, THINNED_MM);
            let line = Polyline::new(kept.iter().filter_map(|index| points.get(*index).copied()).collect());
            let (drawn_mm, length_mm) = (length(&points), line.length_mm());
            let scale = if length_mm > 0.0 { drawn_mm / length_mm } else { 1.0 };
            let points_mm = places(&kept, line.along_mm(), points.len());
            result.result.strokes.push(VerifiedStroke {
                number,
                vertex,
                begin_mm,
                length_mm,
                scale,
                first_point,
                points_mm,
            });
            begin_mm += length_mm;
            result.numbers.entry(number).or_insert(result.lines.len());
            result.lines.push(line);
        }
        result
    }

    /// Takes new samples, in order.
    pub fn observe(&mut self, samples: &[Sample]) {
        samples.iter().for_each(|sample| self.step(sample));
    }

    /// The drawing has ended or was interrupted: its last rows need not wait for others of their stroke.
    pub fn close(&mut self) {
        self.end_line();
    }

    /// Whether rows are waiting to be matched.
    #[must_use]
    pub fn is_behind(&self) -> bool {
        self.matching.is_some() || !self.pieces.is_empty()
    }

    /// What has been verified so far.
    #[must_use]
    pub const fn so_far(&self) -> &Verification {
        &self.result
    }

    /// Looks at a leg so far: the measure of the work done.
    #[must_use]
    pub fn looks(&self) -> usize {
        self.looks
    }

    /// Matches waiting rows with about `looks` looks at a leg. Exceeds them by those of one row at most, plus one for
    /// each row of a piece that ends.
    pub fn work(&mut self, looks: usize) {
        let mut done = 0;
        while done < looks {
            let Some(mut matching) = self.matching.take().or_else(|| self.next_matching()) else {
                break;
            };
            let (used, state) = self.go_on(&mut matching, looks - done);
            done += used;
            match state {
                State::Unfinished => self.matching = Some(matching),
                State::Matched => {
                    done += matching.near.len();
                    self.note(&matching);
                }
                State::LeftOut => self.leave_out(),
            }
        }
        self.looks += done;
    }

    /// Result for a drawing that was ended early. Matches waiting rows with about `looks` looks; the rest counts as not verified.
    /// `is_over`: the firmware has reported the path's end all the same.
    #[must_use]
    pub fn finish_within(mut self, looks: usize, is_over: bool) -> Verification {
        self.close();
        self.work(looks);
        self.give_up();
        self.finish(is_over)
    }

    /// Leaves all waiting rows unverified.
    fn give_up(&mut self) {
        if self.is_behind() {
            (self.matching, self.pieces) = (None, VecDeque::new());
            self.leave_out();
        }
    }

    /// Result of the verification, after matching all waiting rows. `is_over`: the firmware reported the path's end.
    #[must_use]
    pub fn finish(mut self, is_over: bool) -> Verification {
        self.close();
        while self.is_behind() {
            self.work(usize::MAX);
        }
        // Samples after the drawing show that nothing was drawn after the last row, unless rows are not measured yet.
        let is_past = self.newest.is_some_and(|sample| !is_drawing(sample.mode));
        let is_measured = !self.recent.iter().any(draws);
        if is_over && is_past && is_measured && !self.has_gap && !self.is_left_out {
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
        let before = self.newest.replace(*sample);
        if before.is_some_and(|before| sample.t_ms.wrapping_sub(before.t_ms) != 1) {
            self.has_gap = true;
            self.recent.clear();
        }
        self.recent.push_back(*sample);
        if self.recent.len() <= self.age_ms as usize {
            return;
        }
        // Reference, stroke and pen to which the measurement belongs.
        let Some(cause) = self.recent.pop_front() else { return };
        if !is_drawing(cause.mode) {
            return self.end_line();
        }
        let line = self.numbers.get(&cause.stroke).copied();
        let dot = line
            .and_then(|line| self.lines.get(line))
            .filter(|line| self.is_dot(line));
        if cause.pen == Pen::Up && dot.is_none() {
            return;
        }
        let Some(kinematics) = &self.kinematics else { return };
        let place = |angles_rad: [f32; 4]| kinematics.forward(&JointAngles(angles_rad.map(f64::from))).ok();
        let (Some(reference), Some(measured)) = (place(cause.setpoint_rad), place(sample.measured_rad)) else {
            return;
        };
        let is_above = |dot: &Polyline| dot.distance_between(&reference, 0.0, dot.length_mm()) > TOUCHES_MM;
        if cause.pen == Pen::Up && dot.is_none_or(is_above) {
            return;
        }
        if line != self.line {
            self.end_line();
            self.line = line;
        } else if self.rows.len() >= SAMPLES_MAX {
            self.enqueue();
        }
        let passed_ms = self
            .last_ms
            .replace(sample.t_ms)
            .map_or(1, |last_ms| sample.t_ms.wrapping_sub(last_ms));
        self.rows.push(StrokeRow {
            reference,
            measured,
            passed_ms,
            is_after_gap: std::mem::take(&mut self.has_gap),
        });
    }

    /// Whether a line is so short that no sample with the pen down need be on it.
    fn is_dot(&self, line: &Polyline) -> bool {
        line.length_mm() <= self.speed_mm_s / 1_000.0
    }

    /// The stroke has ended.
    fn end_line(&mut self) {
        self.enqueue();
        self.line = None;
        self.begins = true;
    }

    /// Queues the rows of the present line for matching.
    fn enqueue(&mut self) {
        let mut rows = std::mem::take(&mut self.rows);
        let Some(line) = self.line.filter(|_| !rows.is_empty()) else {
            return;
        };
        let begins = std::mem::take(&mut self.begins);
        let waiting: usize = self.pieces.iter().map(|piece| piece.rows.len()).sum();
        if waiting + rows.len() > ROWS_MAX {
            rows = Vec::new();
            let is_left_out = |piece: &Piece| piece.rows.is_empty() && piece.line == line;
            if !begins && self.pieces.back().is_some_and(is_left_out) {
                return;
            }
        }
        self.pieces.push_back(Piece { line, rows, begins });
    }

    fn leave_out(&mut self) {
        (self.is_left_out, self.is_line_left_out) = (true, true);
    }

    /// Starts matching the next piece that has rows.
    fn next_matching(&mut self) -> Option<Matching> {
        loop {
            let mut piece = self.pieces.pop_front()?;
            if piece.begins {
                (self.place_mm, self.is_line_left_out) = (None, false);
            }
            let line = &self.lines[piece.line];
            let Some(first) = piece.rows.first_mut() else {
                self.leave_out();
                continue;
            };
            first.is_after_gap |= self.is_left_out;
            let first = &piece.rows[0];
            let unseen_mm = |row: &StrokeRow| self.speed_mm_s * f64::from(row.passed_ms) / 1_000.0 + BEGIN_MM;
            let steps: Vec<Step> = (piece.rows.iter())
                .map(|row| Step {
                    position: row.reference,
                    unseen_mm: (row.passed_ms > 1).then(|| unseen_mm(row)),
                })
                .collect();
            let is_at_begin = line.distance_between(&first.reference, 0.0, 0.0) <= BEGIN_MM;
            let first_mm = match self.place_mm {
                place_mm if self.is_line_left_out => [place_mm.unwrap_or(0.0) - END_MM, f64::INFINITY],
                Some(place_mm) => [place_mm - END_MM, place_mm + unseen_mm(first)],
                None if is_at_begin => [0.0, BEGIN_MM],
                None => [0.0, f64::INFINITY],
            };
            let limits = SearchLimits {
                looks: LOOKS_PER_ROW * steps.len() + LOOKS_PER_LEG * line.legs(),
                parts: PARTS_PER_ROW * steps.len(),
                parts_at_once: PARTS_AT_ONCE,
            };
            return Some(Matching {
                search: Search::new(steps, first_mm, limits),
                places_mm: Vec::new(),
                near: Vec::with_capacity(piece.rows.len()),
                piece,
            });
        }
    }

    /// Continues a piece with about `looks` looks; returns the looks taken and the state reached.
    fn go_on(&self, matching: &mut Matching, looks: usize) -> (usize, State) {
        let line = &self.lines[matching.piece.line];
        let mut used = 0;
        if matching.places_mm.is_empty() {
            let before = matching.search.looks();
            let progress = matching.search.go_on(line, looks);
            used = matching.search.looks() - before;
            match progress {
                SearchProgress::Unfinished => return (used, State::Unfinished),
                SearchProgress::TooMuch => return (used, State::LeftOut),
                SearchProgress::Found(found) if found.places_mm.is_empty() => return (used, State::LeftOut),
                SearchProgress::Found(found) => matching.places_mm = found.places_mm,
            }
        }
        let reach_mm = ALONG * self.near_mm;
        // All legs but the last ones are longer than the noise.
        let legs = (2.0 * reach_mm / THINNED_MM) as usize + 3;
        let next = matching.near.len();
        for (row, mm) in matching.piece.rows.iter().zip(&matching.places_mm).skip(next) {
            if used >= looks {
                return (used, State::Unfinished);
            }
            used += legs;
            let away_mm = line.distance_between(&row.measured, mm - reach_mm, mm + reach_mm);
            matching.near.push(away_mm <= self.near_mm);
        }
        (used, State::Matched)
    }

    /// Records the result of a matched piece.
    fn note(&mut self, matching: &Matching) {
        let Matching {
            piece, places_mm, near, ..
        } = matching;
        let stroke = &self.result.strokes[piece.line];
        let (Some(first), Some(&begin_mm), Some(&end_mm)) = (piece.rows.first(), places_mm.first(), places_mm.last())
        else {
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
        for (index, row) in piece.rows.iter().enumerate().skip(1) {
            if row.is_after_gap {
                continue;
            }
            let is_followed = near[index - 1] && near[index];
            // A pen that was lifted and lowered again has drawn nothing in between.
            let is_drawn = row.passed_ms == 1 || places_mm[index] - places_mm[index - 1] <= END_MM;
            note(places_mm[index - 1], places_mm[index], is_followed && is_drawn);
        }
        if !first.is_after_gap {
            let reached_mm = self.reached_mm;
            // Inside a line, the step of a millisecond from the last piece to this one.
            let is_next = !piece.begins && first.passed_ms == 1;
            let skipped_mm = if is_next {
                END_MM.max(self.speed_mm_s / 1_000.0)
            } else {
                END_MM
            };
            let is_close = stroke.begin_mm + begin_mm - reached_mm <= skipped_mm;
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
        (self.is_left_out, self.is_line_left_out) = (false, false);
    }
}

/// State of a piece's matching.
enum State {
    Unfinished,
    Matched,
    /// Matching it costs too much.
    LeftOut,
}

fn is_drawing(mode: Mode) -> bool {
    matches!(mode, Mode::Drawing | Mode::Holding)
}

/// Whether a stroke is being drawn.
fn draws(sample: &Sample) -> bool {
    is_drawing(sample.mode) && sample.pen == Pen::Down
}

fn length(points: &[Position]) -> f64 {
    points.windows(2).map(|pair| distance(&pair[0], &pair[1])).sum()
}

/// Where each of so many points is along a line without its noise, mm: a point that was kept at its own place, another
/// one at that of the point kept before it.
fn places(kept: &[usize], along_mm: &[f64], points: usize) -> Vec<f32> {
    let mut places = Vec::with_capacity(points);
    let mut place_mm = 0.0;
    for (index, mm) in kept.iter().zip(along_mm) {
        places.resize(*index, place_mm);
        place_mm = *mm as f32;
    }
    places.resize(points, place_mm);
    places
}

/// The drawn lines of a path, with the stroke's number and its first vertex. A line begins with the vertex at which the pen
/// is lowered, so that its points are successive vertices from there on.
fn lines(path: &[PathVertex]) -> Vec<Line> {
    let at = |vertex: &PathVertex| {
        let [x_mm, y_mm, z_mm] = vertex.position_um.map(|um| f64::from(um) / 1_000.0);
        Position { x_mm, y_mm, z_mm }
    };
    let mut found: Vec<Line> = Vec::new();
    let (mut vertex, mut is_drawing) = (0, false);
    for (index, pair) in (0_u32..).zip(path.windows(2)) {
        if pair[1].stroke != pair[0].stroke {
            vertex = index + 1;
        }
        if pair[1].pen == Pen::Up {
            is_drawing = false;
            continue;
        }
        match found.last_mut() {
            Some(line) if is_drawing && line.number == pair[1].stroke => line.points.push(at(&pair[1])),
            _ => found.push(Line {
                points: vec![at(&pair[0]), at(&pair[1])],
                number: pair[1].stroke,
                vertex,
                first_point: index,
            }),
        }
        is_drawing = true;
    }
    found
}

#[cfg(test)]
mod tests;
