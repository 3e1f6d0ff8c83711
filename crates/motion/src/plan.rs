//! The look-ahead plan: pieces of the path, the grid over them, the speeds at its points, and the present position on
//! it.
//!
//! Pieces are divided into a grid as room permits; the last point of the grid is always a point of rest. After the grid
//! has grown, [`Plan::look_back`] raises the speeds from the new end towards the present position until nothing
//! changes. A raised speed stays reachable from the old ones, so the plan ends at rest after every single step; a path
//! that stops growing becomes a stop on the path within all limits.
//!
//! Between two points of the grid the path acceleration is constant. The plan chooses it when the first point is
//! reached, and again when a stretch has lasted [`STRETCH_MAX_S`], the pace changes, or another speed is requested. A
//! squared speed below [`REST_SQUARED`] counts as rest.

use super::committed::{Observer, Passage};
use super::delay_line::PathSample;
use super::grid::{ARRIVED_MM, GridPoint, Span};
use super::heading::{Course, NONE_RAD, Pause, Turning};
use super::limits::Limits;
use super::micro_interpolator::Stretch;
use super::ring::Ring;
use super::scan::{Middle, Row};
use super::shaping::{PIECES_PER_LEG, Piece};
use super::stretches::{STRETCH_MAX_S, braking, going, over_the_middle};
use crate::robots::Kinematics;
use crate::robots::vector::length;
use crate::settings::input_shaper::pen_dwell_s;
use crate::settings::{MotionLimits, Orientation};

/// Points of the grid: the look-ahead.
pub(crate) const POINTS: usize = 256;
/// Pieces on which the grid lies or which wait for it.
pub(crate) const PIECES: usize = 128;
/// Most intervals by which the grid grows in one period.
pub(crate) const GROWTH: usize = 64;
/// Most intervals by which the grid grows in one period while a change of speed is pending, because the look-back then
/// covers the whole grid.
const GROWTH_RESCALING: usize = 16;
/// Relative change of a squared speed that counts as none.
const UNCHANGED: f64 = 1.0e-12;
/// Squared speed that counts as rest, mm2/s2: a tenth of a picometre a second. Even where the fourth axis makes a half
/// turn within 10 nm of the path, that is a few thousandths of its slowest motion.
const REST_SQUARED: f64 = 1.0e-20;
/// Addition to the curvature in the middle of an interval, as a part of the bulge of its second difference: the
/// centripetal acceleration may be largest between the middle and an end.
const BULGE_PART: f64 = 0.25;
/// Further addition to the curvature, as a part of the change of the curvature over the interval and of its bulge
/// either way, where half of the interval takes longer than [`SMOOTHED_S`]: the speed grows while the curvature falls,
/// so the centripetal acceleration is largest between the middle and an end. On the paths of `checks/slow.rs` the 1 ms
/// setpoints exceed the limit by 2.9 % without this addition and stay 0.009 % under it with it.
const STEEP_PART: f64 = 0.25;
/// Duration of a peak of the acceleration that does not show in the differences of 1 ms setpoints, s.
const SMOOTHED_S: f64 = 0.5e-3;
/// Points needed to begin the grid or to continue it from a stop, besides the end of the next interval.
const STOP_POINTS: usize = 2;

const _: () = assert!(GROWTH < POINTS && PIECES_PER_LEG < PIECES);

/// How the motion continues at the next point of the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pace {
    /// As fast as allowed.
    Go,
    /// To rest as soon as the limits allow.
    Brake,
}

/// The plan and the present position on it.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    kinematics: Kinematics,
    limits: Limits,
    pieces: Ring<Piece, PIECES>,
    points: Ring<GridPoint, POINTS>,
    /// Next piece for the grid, and its next interval.
    next_piece: u32,
    next_interval: u16,
    course: Course,
    dwell_s: f64,
    /// Points from here on have been appended since the last look-back.
    settled: u32,
    /// Speed requested and speed planned for, as factors of the path's speed.
    wanted: f64,
    planned: f64,
    /// Last point of the grid at or before the present position, and the distance since that point.
    place: u32,
    offset_mm: f64,
    squared: f64,
    stretch: Option<Stretch>,
    /// Acceleration of the last stretch, if it ended within the present interval.
    under_way: Option<f64>,
    /// Pace for which the present stretch was chosen.
    pace: Pace,
    pause: Option<Pause>,
    rest: PathSample,
}

impl Plan {
    /// An empty plan; it allows no motion before [`Plan::reconfigure`].
    pub(crate) const fn new() -> Self {
        Self {
            kinematics: Kinematics::NONE,
            limits: Limits::NONE,
            pieces: Ring::new(Piece::NONE),
            points: Ring::new(GridPoint::NONE),
            next_piece: 0,
            next_interval: 0,
            course: Course::new(),
            dwell_s: 0.0,
            settled: 0,
            wanted: 0.0,
            planned: 0.0,
            place: 0,
            offset_mm: 0.0,
            squared: 0.0,
            stretch: None,
            under_way: None,
            pace: Pace::Go,
            pause: None,
            rest: PathSample::NONE,
        }
    }

    /// Sets robot and limits, resets the speed to that of the path, and discards what was pushed.
    pub(crate) fn reconfigure(&mut self, kinematics: Kinematics, limits: Limits, motion: &MotionLimits) {
        self.kinematics = kinematics;
        self.limits = limits;
        self.course.follows = motion.orientation == Orientation::Path;
        self.dwell_s = pen_dwell_s(motion);
        self.wanted = 1.0;
        self.rest_at(PathSample::NONE);
    }

    /// Discards everything and rests at a position.
    pub(crate) fn rest_at(&mut self, place: PathSample) {
        self.pieces.clear();
        self.points.clear();
        self.next_piece = self.pieces.end();
        self.next_interval = 0;
        self.place = self.points.end();
        self.settled = self.place;
        self.offset_mm = 0.0;
        self.squared = 0.0;
        self.stretch = None;
        self.under_way = None;
        self.pause = None;
        self.planned = self.wanted;
        self.course.angle = place.heading;
        self.rest = place;
    }

    /// Counts the executed vertices anew, for a path that begins where the plan rests.
    pub(crate) fn count_from_zero(&mut self) {
        self.rest.label.vertex = 0;
    }

    /// Whether another leg's pieces fit.
    pub(crate) fn has_room(&self) -> bool {
        self.pieces.room() >= PIECES_PER_LEG
    }

    pub(crate) fn push(&mut self, piece: Piece) -> bool {
        self.pieces.push(piece)
    }

    /// Scales the path speed from the present position on, as a factor of the configured speed.
    pub(crate) fn scale_speed(&mut self, factor: f64) {
        if factor != self.wanted {
            self.cut();
        }
        self.wanted = factor;
    }

    /// Ends the present stretch at the present position; the acceleration is chosen again.
    fn cut(&mut self) {
        if let Some(stretch) = self.stretch.take() {
            self.offset_mm = stretch.offset_mm();
            self.squared = moving(stretch.squared());
            self.under_way = Some(stretch.acceleration());
        }
    }

    /// Whether the motion is at rest.
    pub(crate) fn resting(&self) -> bool {
        self.stretch.is_none() && self.pause.is_none() && self.squared <= 0.0
    }

    /// Whether the motion is in a pause at a stop.
    pub(crate) fn pauses(&self) -> bool {
        self.pause.is_some()
    }

    /// Whether the motion is at rest at the end of everything that was pushed.
    pub(crate) fn exhausted(&self) -> bool {
        self.resting() && self.points.length() <= 1 && self.next_piece == self.pieces.end()
    }

    /// Whether motion can start from rest at the present position.
    pub(crate) fn can_go(&self) -> bool {
        // The points of arrival and departure coincide.
        let arrived = |point: &GridPoint| point.stop && point.span.length_mm <= 0.0;
        let from = self
            .place
            .wrapping_add(u32::from(self.points.get(self.place).is_some_and(arrived)));
        match self.points.end().wrapping_sub(from) {
            2 => self.points.get(from.wrapping_add(1)).is_some_and(|next| next.stop),
            ahead => (3..=POINTS as u32).contains(&ahead),
        }
    }

    /// Extends the grid over the pieces by at most [`GROWTH`] intervals; returns by how many.
    pub(crate) fn grow(&mut self) -> usize {
        let most = if self.wanted == self.planned {
            GROWTH
        } else {
            GROWTH_RESCALING
        };
        let mut grown = 0;
        while grown < most && self.points.room() > STOP_POINTS {
            let Some(piece) = self.pieces.get(self.next_piece).copied() else {
                break;
            };
            self.grow_by_interval(&piece);
            grown += 1;
        }
        grown
    }

    fn grow_by_interval(&mut self, piece: &Piece) {
        let nominal = self.limits.path_speed_squared(piece.drawn());
        if self.points.last_mut().is_none_or(|last| last.stop) {
            self.depart(piece, nominal);
        }
        let count = self.course.intervals(piece);
        let intervals = f64::from(count);
        let index = self.next_interval;
        let from = f64::from(index) / intervals;
        self.next_interval += 1;
        let complete = self.next_interval >= count;
        let to = if complete {
            1.0
        } else {
            f64::from(self.next_interval) / intervals
        };
        let mut end = self.point_at(piece, to, nominal, complete && piece.stop_after);
        end.dwell = end.stop && piece.dwell_after;
        let mut span = Span {
            length_mm: piece.curve.arc(from, to),
            piece: self.next_piece,
            parameter: [from, to],
            stretch: [piece.curve.stretch(from), piece.curve.stretch(to)],
            heading: self.course.angle,
            turn_change: 0.0,
            lifts: self.limits.pen_limited && piece.lifts(),
            curved: !piece.curve.is_straight(),
            middle: Middle::NONE,
        };
        if span.curved {
            let before = self.points.last_mut().map_or(0.0, |last| last.row.curvature);
            let curvatures = [before, end.row.curvature];
            span.middle = self.middle(piece, span.middle_parameter(), curvatures, span.length_mm, span.lifts);
        }
        let (limits, course) = (&self.limits, &mut self.course);
        if let Some(last) = self.points.last_mut() {
            if course.follows {
                let start_slope = last.row.turn;
                let Turning { end_slope, change } = course.advance(piece, index, start_slope);
                span.turn_change = change;
                end.row.turn = end_slope;
                last.cap = limits.cap_turning(last.cap, [start_slope, end_slope], change);
                end.cap = limits.cap_turning(end.cap, [start_slope, end_slope], change);
            }
            if span.lifts {
                last.cap = limits.cap_pen(last.cap, &last.row);
                end.cap = limits.cap_pen(end.cap, &end.row);
            }
            last.span = span;
            last.nominal = last.nominal.min(nominal);
        }
        self.points.push(end);
        if complete {
            self.next_piece = self.next_piece.wrapping_add(1);
            self.next_interval = 0;
        }
    }

    /// Begins the grid, or continues it from a stop, where a pause may be needed.
    fn depart(&mut self, piece: &Piece, nominal: f64) {
        let mut start = self.point_at(piece, 0.0, nominal, true);
        let arrival = self.course.angle;
        self.course.depart(piece);
        let turns = (self.course.angle - arrival).abs() > 0.0;
        match self.points.last_mut() {
            Some(last) => {
                last.span.piece = self.next_piece;
                last.span.heading = arrival;
            }
            None if turns => {
                let mut first = start;
                first.span.piece = self.next_piece;
                first.span.heading = arrival;
                self.points.push(first);
            }
            None => {}
        }
        start.span.heading = self.course.angle;
        self.points.push(start);
    }

    fn row_at(&self, piece: &Piece, parameter: f64) -> Row {
        let frame = piece.curve.frame(parameter);
        let joints = self.kinematics.rows(&frame.point, &frame.tangent, &frame.bend);
        Row {
            joints,
            curvature: length(&frame.bend),
            turn: 0.0,
            rise: frame.tangent[2],
            rise_change: frame.bend[2],
        }
    }

    /// Limits in the middle of a part of a curve, from its parameter there, the curvature at both ends, and its length.
    fn middle(&self, piece: &Piece, parameter: f64, ends: [f64; 2], length_mm: f64, lifts: bool) -> Middle {
        let mut row = self.row_at(piece, parameter);
        let [before, after] = ends;
        let bulge = 2.0 * row.curvature - before - after;
        row.curvature += BULGE_PART * bulge.max(0.0);
        let (steep, half_mm) = (after - before, 0.5 * length_mm);
        let slow = SMOOTHED_S * SMOOTHED_S * self.limits.acceleration;
        if half_mm * half_mm * row.curvature > slow {
            row.curvature += STEEP_PART * (steep * steep / row.curvature + bulge.abs());
        }
        let cap = self.limits.cap(&row);
        Middle {
            joints: row.joints,
            curvature: row.curvature,
            cap: if lifts { self.limits.cap_pen(cap, &row) } else { cap },
            rise: row.rise,
            rise_change: row.rise_change,
        }
    }

    fn point_at(&self, piece: &Piece, parameter: f64, nominal: f64, stop: bool) -> GridPoint {
        let row = self.row_at(piece, parameter);
        GridPoint {
            row,
            cap: self.limits.cap(&row),
            nominal,
            reach: 0.0,
            span: Span::NONE,
            stop,
            dwell: false,
        }
    }

    /// Raises the speeds from the end towards the present position. Returns how many points were computed.
    pub(crate) fn look_back(&mut self) -> usize {
        let all = self.take_over_speed();
        let end = self.points.end();
        let lowest = self.place.wrapping_add(1);
        let (mut computed, mut number) = (0, end.wrapping_sub(2));
        while number.wrapping_sub(lowest) < POINTS as u32 {
            let (Some(here), Some(next)) = (self.points.get(number), self.points.get(number.wrapping_add(1))) else {
                break;
            };
            let before = here.reach;
            let reach = if here.stop {
                0.0
            } else {
                let cap = here.cap.min(here.nominal * self.planned * self.planned);
                moving(here.interval(&self.limits, &here.row, next, 0.0).entry_max(cap))
            };
            computed += 1;
            let old = self.settled.wrapping_sub(1).wrapping_sub(number).wrapping_sub(1) < POINTS as u32;
            if old && !all && (reach - before).abs() <= UNCHANGED * before {
                break;
            }
            if let Some(here) = self.points.get_mut(number) {
                here.reach = reach;
            }
            number = number.wrapping_sub(1);
        }
        self.settled = end;
        computed
    }

    /// Changes to the requested speed if the motion is slow enough for it; returns whether the plan changes.
    fn take_over_speed(&mut self) -> bool {
        if self.wanted == self.planned {
            return false;
        }
        let ratio = self.wanted / self.planned;
        let next = self
            .points
            .get(self.place.wrapping_add(1))
            .map_or(0.0, |next| next.reach);
        let arriving = self.stretch.map_or(self.squared, |stretch| stretch.end_squared());
        if ratio < 1.0 && arriving > next * ratio * ratio {
            return false;
        }
        self.planned = self.wanted;
        true
    }

    /// Advances by `dt_s` and returns the new position.
    pub(crate) fn advance(&mut self, dt_s: f64, pace: Pace, observer: &mut impl Observer) -> PathSample {
        if pace != self.pace {
            self.cut();
            self.pace = pace;
        }
        let mut left_s = dt_s;
        for _ in 0..2 * POINTS {
            if let Some(pause) = self.pause.as_mut() {
                if pace == Pace::Brake {
                    pause.cut();
                }
                left_s = pause.run(left_s);
                self.rest.heading = pause.angle();
                if !pause.complete() {
                    break;
                }
                self.pause = None;
                self.place = self.place.wrapping_add(1);
                continue;
            }
            let Some(stretch) = self.stretch.as_mut() else {
                if !self.begin(pace) {
                    break;
                }
                continue;
            };
            let from_s = stretch.elapsed_s();
            left_s = stretch.run(left_s);
            self.offset_mm = stretch.offset_mm();
            let stretch = *stretch;
            if let Some(passage) = self.passage(&stretch, from_s, left_s) {
                observer.moved(&passage);
            }
            if !stretch.complete() {
                break;
            }
            self.squared = moving(stretch.end_squared());
            self.under_way = Some(stretch.acceleration());
            self.stretch = None;
            self.arrive();
            if left_s <= 0.0 {
                break;
            }
        }
        self.forget_passed();
        self.sample()
    }

    /// What a stretch has executed since it was at `from_s`, with `left_s` left of the millisecond.
    fn passage(&self, stretch: &Stretch, from_s: f64, left_s: f64) -> Option<Passage> {
        let point = self.points.get(self.place)?;
        let piece = self.pieces.get(point.span.piece)?;
        Some(Passage {
            coefficients: *piece.curve.coefficients(),
            parameter: point.span.parameter,
            length_mm: point.span.length_mm,
            start_mm: stretch.start_mm(),
            speed_mm_s: stretch.speed(),
            acceleration_mm_s2: stretch.acceleration(),
            time_s: [from_s, stretch.elapsed_s()],
            left_s,
            heading_rad: point.span.heading,
            turn_rad_mm: point.row.turn,
            turn_change_rad_mm2: point.span.turn_change,
            drawn: piece.drawn(),
            lifts: point.span.lifts,
            vertex: piece.entry.vertex,
        })
    }

    /// Moves to the next point where the end of the interval is reached.
    fn arrive(&mut self) {
        let Some(point) = self.points.get(self.place) else {
            return;
        };
        if point.span.length_mm - self.offset_mm > ARRIVED_MM {
            return;
        }
        if let Some(piece) = self.pieces.get(point.span.piece)
            && point.span.length_mm > 0.0
        {
            let [_, to] = point.span.parameter;
            let mut label = piece.label_at(to);
            if to >= 1.0 {
                label.vertex = piece.vertex_after;
            }
            self.rest = PathSample {
                point: piece.curve.at(to),
                heading: point.heading_at(point.span.length_mm),
                label,
            };
        }
        self.place = self.place.wrapping_add(1);
        self.offset_mm = 0.0;
        self.under_way = None;
    }

    /// Chooses the acceleration from the present position to the next point; returns `false` where the motion is at
    /// rest.
    fn begin(&mut self, pace: Pace) -> bool {
        let next_number = self.place.wrapping_add(1);
        let (Some(here), Some(next)) = (self.points.get(self.place), self.points.get(next_number)) else {
            self.squared = 0.0;
            return false;
        };
        let left_mm = here.span.length_mm - self.offset_mm;
        if left_mm <= ARRIVED_MM {
            if let Some(pause) = self.pause_between(here, next) {
                self.squared = 0.0;
                self.pause = (pace == Pace::Go).then_some(pause);
                return self.pause.is_some();
            }
            self.offset_mm = here.span.length_mm;
            self.arrive();
            return true;
        }
        let x = self.squared;
        let start = self.row_here(here);
        let mut interval = here.interval(&self.limits, &start, next, self.offset_mm);
        if here.span.curved && interval.middle.is_none() {
            interval.middle = self.middle_of_rest(here, &start, &next.row, left_mm);
        }
        let ends = next_number.wrapping_add(1) == self.points.end() && !next.stop;
        let stretch = match pace {
            Pace::Brake if x <= 0.0 => return false,
            Pace::Brake => braking(&interval, self.offset_mm, x, self.under_way),
            // The continuation of the path is not known yet.
            Pace::Go if x <= 0.0 && next.reach <= 0.0 && ends => return false,
            Pace::Go => {
                let cap = here.cap.min(next.cap).min(here.nominal * self.planned * self.planned);
                let ratio = (self.wanted / self.planned).min(1.0);
                over_the_middle(&interval, self.offset_mm, x, cap)
                    .unwrap_or_else(|| going(&interval, self.offset_mm, x, ratio * ratio, self.under_way))
            }
        };
        // A stretch that would last for ever begins at rest.
        if !stretch.valid() {
            return false;
        }
        self.stretch = Some(stretch.within(STRETCH_MAX_S));
        true
    }

    /// Limits at the present position, on the interval that begins at a point.
    fn row_here(&self, here: &GridPoint) -> Row {
        let row = match self.pieces.get(here.span.piece) {
            Some(piece) if self.offset_mm > 0.0 => self.row_at(piece, here.span.parameter_at(piece, self.offset_mm)),
            _ => here.row,
        };
        Row {
            turn: here.row.turn + here.span.turn_change * self.offset_mm,
            ..row
        }
    }

    /// Limits in the middle of the rest of an interval whose own middle has been passed.
    fn middle_of_rest(&self, here: &GridPoint, start: &Row, end: &Row, left_mm: f64) -> Option<(Middle, f64)> {
        let piece = self.pieces.get(here.span.piece)?;
        let ahead_mm = 0.5 * left_mm;
        let parameter = here.span.parameter_at(piece, self.offset_mm + ahead_mm);
        let curvatures = [start.curvature, end.curvature];
        let middle = self.middle(piece, parameter, curvatures, left_mm, here.span.lifts);
        Some((middle, ahead_mm))
    }

    /// The pause between arriving at a stop and departing from it, if any.
    fn pause_between(&self, arrival: &GridPoint, departure: &GridPoint) -> Option<Pause> {
        let (from, to) = (arrival.span.heading, departure.span.heading);
        let waits = arrival.stop && arrival.span.length_mm <= 0.0;
        if !waits || !arrival.dwell && (to - from).abs() <= NONE_RAD {
            return None;
        }
        let dwell_s = if arrival.dwell { self.dwell_s } else { 0.0 };
        Some(Pause::new(&self.limits, from, to, dwell_s)).filter(|pause| !pause.is_none())
    }

    fn forget_passed(&mut self) {
        self.points.forget_before(self.place);
        let piece = match self.points.get(self.place) {
            Some(point) if self.place.wrapping_add(1) != self.points.end() => point.span.piece,
            _ => self.next_piece,
        };
        self.pieces.forget_before(piece);
    }

    /// The present position.
    pub(crate) fn sample(&self) -> PathSample {
        let Some(point) = self.points.get(self.place) else {
            return self.rest;
        };
        let span = &point.span;
        let Some(piece) = self.pieces.get(span.piece) else {
            return self.rest;
        };
        if span.length_mm <= 0.0 || self.place.wrapping_add(1) == self.points.end() {
            return self.rest;
        }
        let parameter = span.parameter_at(piece, self.offset_mm);
        PathSample {
            point: piece.curve.at(parameter),
            heading: point.heading_at(self.offset_mm),
            label: piece.label_at(parameter),
        }
    }
}

/// A squared speed, or 0 where it counts as rest.
fn moving(squared: f64) -> f64 {
    if squared < REST_SQUARED { 0.0 } else { squared }
}

#[cfg(test)]
mod tests;
