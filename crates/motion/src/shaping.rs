//! From a polyline to a smooth path: two vertices of latency, and a deviation that is proven.
//!
//! A vertex is passed smoothly (as a control point of a uniform cubic B-spline), around a quintic blend, or with an
//! exact stop. A span of the spline leaves its leg by at most a sixth of the longer neighbouring leg's offset, and a
//! blend is cut to the distance that the tolerance allows. Runs of the spline begin and end on straight halves of
//! their first and last leg, so the pen's transitions are never rounded by their neighbours.
//!
//! Invariant: position, direction and curvature are continuous everywhere but at exact stops.

use super::Pen;
use super::curve::{self, BlendShape, Curve};
use super::ring::Ring;
use crate::robots::vector::{Vector, add, cross, dot, length, scale, subtract};
use crate::settings::averaging::{Tolerances, tolerances};
use crate::settings::input_shaper::pen_dwell_s;
use crate::settings::{InputShaper, Settings};
use heapless::Vec;

/// Vertices that wait to be shaped.
pub(crate) const QUEUE: usize = 128;
/// Pieces that one leg can give: a span, a line and a blend.
pub(crate) const PIECES_PER_LEG: usize = 3;
/// Cosine of the largest turn that the spline takes: 60 degrees.
const SPLINE_TURN_COSINE: f64 = 0.5;
/// Longest leg of a spline, in lengths of its neighbour: beyond it, the curvature has peaks and a blend takes less
/// time.
const SPLINE_RATIO_MAX: f64 = 3.0;
/// Cosine of the turn beyond which the path stops: 165 degrees.
const STOP_TURN_COSINE: f64 = -0.965_925_826_289_068_3;
/// Sine of the turn below which two legs are one straight line.
const STRAIGHT_SINE: f64 = 1.0e-7;
/// Part of a leg that each of its two blends may take.
const BLEND_LEG_PART: f64 = 0.5 * (1.0 - 1.0e-9);
/// Distance that rounding may put a knot before its control point, as a part of the chord between the neighbouring
/// points.
const KNOT_ROUNDING: f64 = 1.0e-9;
/// Lines shorter than this are left out, mm.
const LINE_MIN_MM: f64 = 1.0e-6;
/// Longest interval of the grid on a curve, mm.
const CURVE_STEP_MM: f64 = 2.0;
/// Least intervals of a blend; [`SPAN_INTERVALS`] is that of a span.
const BLEND_INTERVALS: u16 = 10;
/// Least intervals of a blend that is long enough for the joints' derivatives to change along it.
const LONG_BLEND_INTERVALS: u16 = 18;
/// Least intervals of a blend at a sharp turn, where the curvature has a narrow peak.
const SHARP_BLEND_INTERVALS: u16 = 20;
/// Cosine of the turn from which it is sharp: 95 degrees.
const SHARP_TURN_COSINE: f64 = -0.087_155_742_747_658_17;
/// Smallest trim of a long blend, mm.
const LONG_BLEND_MM: f64 = 0.2;
const SPAN_INTERVALS: u16 = 3;
/// Intervals of a span whose legs are uneven.
const UNEVEN_SPAN_INTERVALS: u16 = 5;
/// Largest deflection of the curve's direction over a span, as a part of its length, for which fewer intervals are
/// enough.
const SPAN_GENTLE: f64 = 0.1;
/// Longest way that both outer legs of a span's control polygon together lead aside of the middle one, as a part of its length,
/// for which one interval is enough.
const SPAN_ASIDE: f64 = 0.3;
/// Largest ratio of the longest to the shortest leg of a span's control polygon that counts as even.
const SPAN_EVEN: f64 = 1.5;
/// Least intervals of a line; even, so that a move from rest to rest can change from accelerating to decelerating in
/// the middle.
const LINE_INTERVALS: u16 = 4;
/// Factor on a curve's intervals where limits of one direction apply, such as the pen's vertical ones: they are often
/// small compared with the acceleration along the path, of which the part in that direction changes between two points.
const REFINEMENT: u16 = 2;
/// Length of an interval on a line, mm.
const LINE_STEP_MM: f64 = 2.0;

/// A vertex in the queue.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Node {
    pub(crate) point: Vector,
    /// Pen on the leg that leads here.
    pub(crate) pen: Pen,
    pub(crate) stroke: u32,
    /// Vertices executed when this one is reached.
    pub(crate) count: u32,
    /// Whether the leg that leads here replaces the legs of merged vertices.
    pub(crate) merged: bool,
}

impl Node {
    pub(crate) const NONE: Self = Self {
        point: [0.0; 3],
        pen: Pen::Up,
        stroke: 0,
        count: 0,
        merged: false,
    };
}

/// Attributes of a point of the path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Label {
    pub(crate) stroke: u32,
    pub(crate) pen: Pen,
    pub(crate) vertex: u32,
}

impl Label {
    pub(crate) const NONE: Self = Self {
        stroke: 0,
        pen: Pen::Up,
        vertex: 0,
    };
}

/// A change of attributes on a piece.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) enum Change {
    #[default]
    None,
    /// The fourth axis, if it follows the path, turns to this direction, rad, on a vertical line, which has none.
    Turn(f64),
    /// The labels change at this parameter, where a vertex is reached.
    Labels(f64),
}

/// A piece of the shaped path.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Piece {
    pub(crate) curve: Curve,
    /// Number of intervals of the grid on this piece, evenly spaced in the parameter.
    pub(crate) intervals: u16,
    /// Label at the beginning.
    pub(crate) entry: Label,
    /// Label at the end.
    pub(crate) exit: Label,
    /// Vertices executed at the end.
    pub(crate) vertex_after: u32,
    /// Whether the path is at rest at the end.
    pub(crate) stop_after: bool,
    /// Whether the pen dwells at the end.
    pub(crate) dwell_after: bool,
    pub(crate) change: Change,
}

impl Piece {
    pub(crate) const NONE: Self = Self {
        curve: Curve::NONE,
        intervals: 0,
        entry: Label::NONE,
        exit: Label::NONE,
        vertex_after: 0,
        stop_after: false,
        dwell_after: false,
        change: Change::None,
    };
}

impl Piece {
    /// Label at a parameter.
    pub(crate) fn label_at(&self, parameter: f64) -> Label {
        match self.change {
            Change::Labels(from) if parameter <= from => self.entry,
            _ => self.exit,
        }
    }

    /// Whether any part of this piece is drawn.
    pub(crate) fn drawn(&self) -> bool {
        self.entry.pen == Pen::Down || self.exit.pen == Pen::Down
    }

    /// Whether the pen may be lifted or lowered on this piece.
    pub(crate) fn lifts(&self) -> bool {
        !(self.entry.pen == Pen::Down && self.exit.pen == Pen::Down)
    }
}

/// How the path passes a vertex.
#[derive(Clone, Copy, Debug)]
enum Passage {
    Stop,
    /// With a blend that begins and ends `trim` mm from the vertex.
    Corner {
        trim: f64,
        shape: BlendShape,
    },
    /// As a control point of the spline.
    Smooth,
}

/// Start of the next leg to be shaped.
#[derive(Clone, Copy, Debug)]
enum Start {
    /// On the leg, this far from its first vertex, mm.
    Straight { trim: f64 },
    /// In a run of the spline: the control point before the vertex, and the vertices executed on the leg before it.
    Spline { before: Vector, passed: u32 },
}

/// Shapes one leg at a time.
#[derive(Clone, Debug)]
pub(crate) struct Shaper {
    tolerances: Tolerances,
    /// Whether the pen dwells where it meets the paper and where it leaves the paper.
    dwells: bool,
    /// Whether an input shaper sums copies of the setpoints.
    is_shaped: bool,
    /// Whether the pen has vertical limits of its own.
    pen_limited: bool,
    /// Whether all curves need more intervals.
    fine: bool,
    node: Node,
    start: Start,
}

impl Shaper {
    /// A shaper with a tolerance of 0.
    pub(crate) const fn new() -> Self {
        Self {
            tolerances: Tolerances {
                drawing_mm: 0.0,
                travel_mm: 0.0,
                merging_mm: 0.0,
            },
            dwells: false,
            is_shaped: false,
            pen_limited: false,
            fine: false,
            node: Node::NONE,
            start: Start::Straight { trim: 0.0 },
        }
    }

    pub(crate) fn configure(&mut self, settings: &Settings) {
        let motion = &settings.motion;
        self.tolerances = tolerances(settings);
        self.fine = settings.geometry.needs_fine_curves();
        self.dwells = pen_dwell_s(motion) > 0.0;
        self.is_shaped = motion.input_shaper != InputShaper::None;
        self.pen_limited = motion.pen_speed_mm_s > 0.0 || motion.pen_acceleration_mm_s2 > 0.0;
    }

    /// Restarts from a point at rest.
    pub(crate) fn place(&mut self, node: Node) {
        self.node = node;
        self.start = Start::Straight { trim: 0.0 };
    }

    /// The vertex at which the next leg begins.
    pub(crate) fn node(&self) -> &Node {
        &self.node
    }

    /// Counts vertices that were merged into the one at which the next leg begins because they coincide with it.
    pub(crate) fn merge(&mut self, count: u32) {
        self.node.count = count;
    }

    /// Shapes the next leg if enough of the path is known, and removes its end from the queue.
    pub(crate) fn next_leg(
        &mut self,
        queue: &mut Ring<Node, QUEUE>,
        finished: bool,
    ) -> Option<Vec<Piece, PIECES_PER_LEG>> {
        let first = queue.first();
        let end = *queue.get(first)?;
        let after = queue.get(first.wrapping_add(1)).copied();
        let passage = match after {
            Some(after) => self.passage(&self.node, &end, &after),
            None if finished => Passage::Stop,
            None => return None,
        };
        let control = match (passage, after) {
            (Passage::Smooth, Some(after)) => {
                let beyond = match queue.get(first.wrapping_add(2)) {
                    Some(beyond) => self.passage(&end, &after, beyond),
                    None if finished => Passage::Stop,
                    None => return None,
                };
                Some(match beyond {
                    Passage::Smooth => after.point,
                    _ => middle(&end.point, &after.point),
                })
            }
            _ => None,
        };
        let pieces = self.pieces(&end, after.as_ref(), passage, control);
        self.start = match (passage, self.start) {
            (Passage::Stop, _) => Start::Straight { trim: 0.0 },
            (Passage::Corner { trim, .. }, _) => Start::Straight { trim },
            (Passage::Smooth, start) => Start::Spline {
                before: match start {
                    Start::Straight { .. } => middle(&self.node.point, &end.point),
                    Start::Spline { .. } => self.node.point,
                },
                passed: self.node.count,
            },
        };
        self.node = end;
        queue.pop();
        Some(pieces)
    }

    fn passage(&self, before: &Node, node: &Node, after: &Node) -> Passage {
        let (incoming, outgoing) = (
            subtract(&node.point, &before.point),
            subtract(&after.point, &node.point),
        );
        let (length_in, length_out) = (length(&incoming), length(&outgoing));
        let (unit_in, unit_out) = (unit(&incoming, length_in), unit(&outgoing, length_out));
        let cosine = dot(&unit_in, &unit_out);
        if cosine.is_nan() || cosine < STOP_TURN_COSINE || self.dwells && node.pen != after.pen {
            return Passage::Stop;
        }
        let difference = length(&subtract(&unit_out, &unit_in));
        let sine = difference * crate::robots::vector::root(1.0 - 0.25 * difference * difference);
        let drawn = node.pen == Pen::Down || after.pen == Pen::Down;
        let tolerance = if drawn {
            self.tolerances.drawing_mm
        } else {
            self.tolerances.travel_mm
        } - if node.merged || after.merged {
            self.tolerances.merging_mm
        } else {
            0.0
        };
        let (short, long) = (length_in.min(length_out), length_in.max(length_out));
        // The spline passes the vertex at a sixth of the second difference: across the leg at most the longer leg's
        // sine of the turn; across the spline's own direction, which is that from vertex to vertex, twice the product
        // of both legs.
        let chord = length(&add(&incoming, &outgoing));
        if node.pen == after.pen
            && cosine > SPLINE_TURN_COSINE
            && long <= SPLINE_RATIO_MAX * short
            && long * sine <= 6.0 * tolerance
            && short * long * sine <= 3.0 * tolerance * chord
        {
            return Passage::Smooth;
        }
        let shape = BlendShape::for_turn(cosine);
        let trim = if sine < STRAIGHT_SINE {
            0.0
        } else {
            (tolerance / (shape.deviation() * difference)).min(short * BLEND_LEG_PART)
        };
        Passage::Corner { trim, shape }
    }

    fn pieces(
        &self,
        end: &Node,
        after: Option<&Node>,
        passage: Passage,
        control: Option<Vector>,
    ) -> Vec<Piece, PIECES_PER_LEG> {
        let mut pieces = Vec::<Piece, PIECES_PER_LEG>::new();
        let from = &self.node.point;
        let leg = subtract(&end.point, from);
        let leg_length = length(&leg);
        let direction = unit(&leg, leg_length);
        let half = middle(from, &end.point);
        let label = Label {
            stroke: end.stroke,
            pen: end.pen,
            vertex: self.node.count,
        };
        let begin = |trim: f64| add(from, &scale(&direction, trim));
        let close = |trim: f64| subtract(&end.point, &scale(&direction, trim));
        let trim_after = match passage {
            Passage::Corner { trim, .. } => trim,
            Passage::Stop | Passage::Smooth => 0.0,
        };
        let span = |control: [Vector; 4]| Some(self.span(&control, leg_length, label));
        let direction_after = after.map(|after| {
            let leg = subtract(&after.point, &end.point);
            unit(&leg, length(&leg))
        });
        let change = match curve::direction(&direction) {
            None => direction_after
                .as_ref()
                .and_then(curve::direction)
                .map_or(Change::None, Change::Turn),
            Some(_) => Change::None,
        };
        let line = |from: Vector, to: Vector| {
            let line_length = length(&subtract(&to, &from));
            (line_length > LINE_MIN_MM).then(|| Piece {
                change,
                ..piece(Curve::line(&from, &to), line_intervals(line_length), label)
            })
        };
        let (first, second) = match (self.start, control) {
            (Start::Straight { trim }, None) => (line(begin(trim), close(trim_after)), None),
            (Start::Straight { trim }, Some(next)) => (line(begin(trim), half), span([*from, half, end.point, next])),
            (Start::Spline { before, .. }, Some(next)) => (span([before, *from, end.point, next]), None),
            (Start::Spline { before, .. }, None) => {
                (span([before, *from, half, end.point]), line(half, close(trim_after)))
            }
        };
        let third = match (passage, after, direction_after) {
            (Passage::Corner { trim, shape }, Some(after), Some(direction_after)) if trim > 0.0 => {
                let curve = Curve::blend(&end.point, &direction, &direction_after, trim, shape);
                let at_least = blend_intervals(trim, dot(&direction, &direction_after));
                let mut blend = piece(curve, curve_intervals(2.0 * trim, at_least), label);
                blend.change = Change::Labels(0.5);
                blend.exit = Label {
                    stroke: after.stroke,
                    pen: after.pen,
                    vertex: end.count,
                };
                Some(blend)
            }
            _ => None,
        };
        for piece in [first, second, third].into_iter().flatten() {
            // The capacity covers all three.
            let _ = pieces.push(piece);
        }
        if self.pen_limited || self.fine {
            for piece in pieces
                .iter_mut()
                .filter(|piece| (self.fine || piece.lifts()) && !piece.curve.is_straight())
            {
                piece.intervals = piece.intervals.saturating_mul(REFINEMENT);
            }
        }
        if let Some(last) = pieces.last_mut() {
            let before = match self.start {
                Start::Straight { .. } => &half,
                Start::Spline { .. } => from,
            };
            let knot = control.and_then(|next| late(before, &end.point, &next));
            last.vertex_after = if knot.is_some() { label.vertex } else { end.count };
            last.stop_after = matches!(passage, Passage::Stop);
            // A dot may be no more than the way down and up again.
            let touches = self.is_shaped && direction_after.is_some_and(|after| direction[2] < 0.0 && after[2] > 0.0);
            let rests = |after: &Node| after.pen != end.pen || touches;
            last.dwell_after = last.stop_after && self.dwells && after.is_some_and(rests);
        }
        pieces
    }

    /// A spline through the second and third of four points, for a leg of this length.
    fn span(&self, control: &[Vector; 4], leg_length: f64, label: Label) -> Piece {
        let curve = Curve::spline(control);
        let mut span = piece(
            curve,
            curve_intervals(leg_length, span_intervals(control, leg_length)),
            label,
        );
        if let Start::Spline { passed, .. } = self.start
            && let Some(onward) = late(&control[0], &control[1], &control[2])
        {
            span.change = Change::Labels(curve.reaches(&control[1], &onward));
            span.entry = Label {
                stroke: self.node.stroke,
                pen: self.node.pen,
                vertex: passed,
            };
        }
        span
    }
}

/// Fewest intervals of a spline: more where it turns or its legs differ in length.
fn span_intervals(control: &[Vector; 4], leg_length: f64) -> u16 {
    let [c0, c1, c2, c3] = control;
    let (before, leg, after) = (subtract(c1, c0), subtract(c2, c1), subtract(c3, c2));
    let deflection = length(&subtract(&after, &before));
    // How far both outer legs lead aside; those of a span that turns there and back are parallel.
    let aside = (length(&cross(&before, &leg)) + length(&cross(&leg, &after))) / leg_length;
    let legs = [length(&before), leg_length, length(&after)];
    let (short, long) = legs.iter().fold((f64::MAX, 0.0_f64), |(short, long), leg| {
        (short.min(*leg), long.max(*leg))
    });
    match (deflection < SPAN_GENTLE * leg_length, long < SPAN_EVEN * short) {
        (true, true) if aside < SPAN_ASIDE * leg_length => 1,
        (true, _) => 2,
        (false, true) => SPAN_INTERVALS,
        (false, false) => UNEVEN_SPAN_INTERVALS,
    }
}

/// Fewest intervals of a blend, by its length and by the cosine of its turn.
fn blend_intervals(trim: f64, turn_cosine: f64) -> u16 {
    match (trim < LONG_BLEND_MM, turn_cosine < SHARP_TURN_COSINE) {
        (true, false) => BLEND_INTERVALS,
        (false, false) => LONG_BLEND_INTERVALS,
        (_, true) => SHARP_BLEND_INTERVALS,
    }
}

fn piece(curve: Curve, intervals: u16, label: Label) -> Piece {
    Piece {
        curve,
        intervals,
        entry: label,
        exit: label,
        vertex_after: label.vertex,
        stop_after: false,
        dwell_after: false,
        change: Change::None,
    }
}

/// The spline's chord past a control point, from the point before to the point after, if the knot between its spans
/// comes before the place at which the spline passes the point; `None` if it comes after.
fn late(before: &Vector, point: &Vector, after: &Vector) -> Option<Vector> {
    let onward = subtract(after, before);
    let second = subtract(&add(before, after), &scale(point, 2.0));
    (dot(&second, &onward) < -KNOT_ROUNDING * dot(&onward, &onward)).then_some(onward)
}

fn unit(vector: &Vector, length: f64) -> Vector {
    scale(vector, if length > 0.0 { 1.0 / length } else { 0.0 })
}

fn middle(a: &Vector, b: &Vector) -> Vector {
    scale(&add(a, b), 0.5)
}

fn curve_intervals(length_mm: f64, at_least: u16) -> u16 {
    at_least.max(libm::ceil(length_mm / CURVE_STEP_MM) as u16)
}

fn line_intervals(length_mm: f64) -> u16 {
    let pairs = libm::ceil(length_mm / (2.0 * LINE_STEP_MM)) as u16;
    pairs.saturating_mul(2).max(LINE_INTERVALS)
}
