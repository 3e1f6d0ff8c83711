//! How far points lie from the strokes they were meant to draw, and where ink is missing.
//!
//! A point is compared with its own stroke, in order along it: a drawing whose lines lie close together would otherwise
//! find a neighbour near every point.
//!
//! Invariant: no distance is taken to a stroke other than the point's own.

use etherpen::robot::Position;
use std::collections::HashMap;

/// Intended ink counts as missing where no ink is within this distance, mm.
const INK_REACH_MM: f64 = 0.5;
/// Distance of the points at which intended ink is looked for, mm.
const INK_STEP_MM: f64 = 0.1;
/// Points of a line of ink are at most this far apart where ink is looked for, mm.
const INK_DENSE_MM: f64 = 0.25;
/// How far along its stroke the pen may have come for a millimetre of its own way, mm: it cuts corners. A stroke that
/// crosses itself would be left for its other part if more were allowed.
const AHEAD: f64 = 1.5;
/// How far it may have come besides, mm: the longest detour of a polyline around the tip of a rounded corner.
const AHEAD_MM: f64 = 0.2;
/// Distance at which a follower has lost its place, mm.
const LOST_MM: f64 = 1.0;
/// How far back along its stroke the nearest point may lie, mm: noise, not motion.
const BACK_MM: f64 = 0.5;
/// A line of ink whose first point is this much closer to another part of its stroke than to the stroke's begin did not
/// begin there, mm: it goes on where a hold had interrupted it.
const BEGIN_MM: f64 = 0.5;

/// A drawn polyline with its stroke's number.
pub type NumberedStroke = (u32, Vec<Position>);

/// Largest distance and root of the mean square, mm; not a number where there was no point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Deviation {
    pub(super) max_mm: f64,
    pub(super) rms_mm: f64,
}

/// Gathers distances.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Distances {
    largest_mm: f64,
    squares: f64,
    count: u64,
}

impl Distances {
    pub(super) fn add(&mut self, away_mm: f64) {
        self.largest_mm = self.largest_mm.max(away_mm);
        self.squares += away_mm * away_mm;
        self.count += 1;
    }

    pub(super) fn result(&self) -> Deviation {
        if self.count == 0 {
            return Deviation {
                max_mm: f64::NAN,
                rms_mm: f64::NAN,
            };
        }
        Deviation {
            max_mm: self.largest_mm,
            rms_mm: (self.squares / self.count as f64).sqrt(),
        }
    }
}

/// A moment of a stroke: where the platform was to be, and where it was.
pub(super) struct Moment {
    pub(super) stroke: u32,
    pub(super) reference: Position,
    pub(super) measured: Position,
}

/// Distances of references and of measured positions from their strokes. The references keep the place along the stroke:
/// they are never far from it.
pub(super) fn deviation(moments: impl Iterator<Item = Moment>, strokes: &[NumberedStroke]) -> (Deviation, Deviation) {
    let (mut references, mut measured) = (Distances::default(), Distances::default());
    let mut current: Option<(u32, Follower)> = None;
    for moment in moments {
        if current.as_ref().is_none_or(|(stroke, _)| *stroke != moment.stroke) {
            let points = strokes.iter().find(|(stroke, _)| *stroke == moment.stroke);
            current = points.map(|(stroke, points)| (*stroke, Follower::new(points)));
        }
        if let Some((_, follower)) = &mut current {
            references.add(follower.step(&moment.reference));
            measured.add(follower.beside(&moment.measured));
        }
    }
    (references.result(), measured.result())
}

/// Distance of every point of ink from the stroke it belongs to, on the paper. Lines of ink come in the strokes' order; a
/// stroke that was held is drawn in several lines.
pub(super) fn ink_deviation(ink_mm: &[Vec<[f64; 2]>], strokes: &[NumberedStroke]) -> Deviation {
    let mut distances = Distances::default();
    let mut stroke = 0;
    for line in ink_mm.iter().filter(|line| !line.is_empty()) {
        // The line goes on with the last stroke, or is the next one, which may begin on top of the last.
        let same = along(line, strokes.get(stroke));
        let next = along(line, strokes.get(stroke + 1));
        let is_next = matches!((&same, &next), (Some(same), Some(next)) if worst(next) < worst(same));
        stroke += usize::from(is_next);
        let Some(nearest) = (if is_next { next } else { same }) else {
            break;
        };
        nearest.into_iter().for_each(|distance| distances.add(distance));
    }
    distances.result()
}

/// Distance of every point of a line from a stroke, where the line begins anywhere along it, mm.
fn along(line: &[[f64; 2]], on: Option<&NumberedStroke>) -> Option<Vec<f64>> {
    let (begin, on) = (line.first()?, on?);
    let (mut follower, _) = Follower::beginning_near(&on.1, &on_paper(begin, on));
    Some(line.iter().map(|point| follower.step(&on_paper(point, on))).collect())
}

fn worst(distances: &[f64]) -> f64 {
    distances.iter().copied().fold(0.0, f64::max)
}

/// A point of ink at the height of a stroke's paper.
fn on_paper([x_mm, y_mm]: &[f64; 2], (_, points): &NumberedStroke) -> Position {
    Position {
        x_mm: *x_mm,
        y_mm: *y_mm,
        z_mm: points.first().map_or(0.0, |point| point.z_mm),
    }
}

pub(super) fn distance(a: &Position, b: &Position) -> f64 {
    ((a.x_mm - b.x_mm).powi(2) + (a.y_mm - b.y_mm).powi(2) + (a.z_mm - b.z_mm).powi(2)).sqrt()
}

/// The point at a part of the way from `a` to `b`.
fn at(a: &Position, b: &Position, part: f64) -> Position {
    Position {
        x_mm: a.x_mm + part * (b.x_mm - a.x_mm),
        y_mm: a.y_mm + part * (b.y_mm - a.y_mm),
        z_mm: a.z_mm + part * (b.z_mm - a.z_mm),
    }
}

/// Distance from `p` to the segment from `a` to `b`, and how far along it the nearest point lies, mm.
fn to_segment(p: &Position, a: &Position, b: &Position) -> (f64, f64) {
    let (dx, dy, dz) = (b.x_mm - a.x_mm, b.y_mm - a.y_mm, b.z_mm - a.z_mm);
    let length2 = dx * dx + dy * dy + dz * dz;
    let along = (p.x_mm - a.x_mm) * dx + (p.y_mm - a.y_mm) * dy + (p.z_mm - a.z_mm) * dz;
    let t = if length2 > 0.0 {
        (along / length2).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let foot = at(a, b, t);
    (distance(p, &foot), t * length2.sqrt())
}

/// Follows one stroke in order: the nearest point is looked for close to the last one only, never on a neighbour.
struct Follower<'a> {
    points: &'a [Position],
    /// How far along the stroke each of its points lies, mm.
    along_mm: Vec<f64>,
    /// How far along the stroke the last nearest point lies, mm.
    foot_mm: f64,
    /// The last position.
    last: Option<Position>,
}

impl<'a> Follower<'a> {
    fn new(points: &'a [Position]) -> Self {
        let mut length_mm = 0.0;
        let legs = points.windows(2).map(|pair| {
            length_mm += distance(&pair[0], &pair[1]);
            length_mm
        });
        Self {
            points,
            along_mm: std::iter::once(0.0).chain(legs).collect(),
            foot_mm: 0.0,
            last: None,
        }
    }

    /// A follower for a line that begins at `position`: at the stroke's begin, unless another part is clearly closer. Also
    /// gives the distance of the place where it begins.
    fn beginning_near(points: &'a [Position], position: &Position) -> (Self, f64) {
        let mut follower = Self::new(points);
        let begin_mm = points.first().map_or(f64::INFINITY, |first| distance(first, position));
        let (nearest_mm, foot_mm) = follower.nearest(position, 0.0, f64::INFINITY);
        if nearest_mm < begin_mm - BEGIN_MM {
            follower.foot_mm = foot_mm;
            return (follower, nearest_mm);
        }
        (follower, begin_mm)
    }

    /// Distance from `position` to the part of the stroke between two places along it, and where its nearest point lies, mm.
    fn nearest(&self, position: &Position, low_mm: f64, high_mm: f64) -> (f64, f64) {
        let first = self
            .along_mm
            .partition_point(|along_mm| *along_mm <= low_mm)
            .saturating_sub(1);
        let mut nearest = (f64::INFINITY, self.foot_mm);
        for (pair, ends) in self.points.windows(2).zip(self.along_mm.windows(2)).skip(first) {
            if ends[0] > high_mm {
                break;
            }
            let place = |mm: f64| at(&pair[0], &pair[1], (mm - ends[0]) / (ends[1] - ends[0]));
            let from_mm = low_mm.clamp(ends[0], ends[1]);
            let (away_mm, along_mm) = to_segment(position, &place(from_mm), &place(high_mm.min(ends[1])));
            if away_mm < nearest.0 {
                nearest = (away_mm, from_mm + along_mm);
            }
        }
        nearest
    }

    /// Distance of the next position, mm.
    fn step(&mut self, position: &Position) -> f64 {
        let way_mm = self
            .last
            .replace(*position)
            .map_or(0.0, |last| distance(&last, position));
        let ahead_mm = self.foot_mm + AHEAD * way_mm + AHEAD_MM;
        let (away_mm, foot_mm) = self.nearest(position, self.foot_mm - BACK_MM, ahead_mm);
        self.foot_mm = foot_mm;
        if away_mm < LOST_MM {
            return away_mm;
        }
        // Too far away for the nearest point to mean anything: it is looked for anew.
        let (away_mm, foot_mm) = self.nearest(position, 0.0, f64::INFINITY);
        self.foot_mm = foot_mm;
        away_mm
    }

    /// Distance of a position that was to be where the last one of [`Self::step`] is, mm.
    fn beside(&self, position: &Position) -> f64 {
        let error_mm = self.last.map_or(0.0, |last| distance(&last, position));
        let reach_mm = AHEAD * error_mm + BACK_MM;
        self.nearest(position, self.foot_mm - reach_mm, self.foot_mm + reach_mm)
            .0
    }
}

/// Intended length without ink near it, mm.
pub(super) fn ink_missing(strokes: &[NumberedStroke], ink_mm: &[Vec<[f64; 2]>]) -> f64 {
    let cell = |v: f64| (v / INK_REACH_MM).floor() as i64;
    let mut cells: HashMap<(i64, i64), Vec<[f64; 2]>> = HashMap::new();
    for point in ink_mm.iter().flat_map(|line| densified(line)) {
        cells.entry((cell(point[0]), cell(point[1]))).or_default().push(point);
    }
    let near = |x: f64, y: f64| {
        let around = (-1..=1).flat_map(|i| (-1..=1).map(move |j| (i, j)));
        let mut points = around
            .filter_map(|(i, j)| cells.get(&(cell(x) + i, cell(y) + j)))
            .flatten();
        points.any(|p| (p[0] - x).hypot(p[1] - y) <= INK_REACH_MM)
    };
    let mut missing_mm = 0.0;
    for pair in strokes.iter().flat_map(|(_, points)| points.windows(2)) {
        let length_mm = distance(&pair[0], &pair[1]);
        let steps = (length_mm / INK_STEP_MM).ceil().max(1.0) as usize;
        let lost = (0..steps).filter(|k| {
            let t = (*k as f64 + 0.5) / steps as f64;
            !near(
                pair[0].x_mm + t * (pair[1].x_mm - pair[0].x_mm),
                pair[0].y_mm + t * (pair[1].y_mm - pair[0].y_mm),
            )
        });
        missing_mm += lost.count() as f64 * length_mm / steps as f64;
    }
    missing_mm
}

/// Points of a line close together, so that fast ink counts as a line and not as its samples.
fn densified(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut dense: Vec<[f64; 2]> = points.first().copied().into_iter().collect();
    for pair in points.windows(2) {
        let ([x0, y0], [x1, y1]) = (pair[0], pair[1]);
        let steps = ((x1 - x0).hypot(y1 - y0) / INK_DENSE_MM).ceil().max(1.0);
        dense.extend((1..=steps as usize).map(|k| {
            let t = k as f64 / steps;
            [x0 + t * (x1 - x0), y0 + t * (y1 - y0)]
        }));
    }
    dense
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(x_mm: f64, y_mm: f64) -> Position {
        Position {
            x_mm,
            y_mm,
            z_mm: -850.0,
        }
    }

    /// Two legs of 20 mm, 1 mm apart, joined at the far end.
    fn hairpin() -> Vec<Position> {
        vec![place(0.0, 0.0), place(20.0, 0.0), place(20.0, 1.0), place(0.0, 1.0)]
    }

    #[test]
    fn a_position_is_compared_with_its_own_leg_and_not_with_the_neighbour() {
        let points = hairpin();
        let mut follower = Follower::new(&points);
        let largest = (0..20)
            .map(|x| follower.step(&place(f64::from(x), 0.8)))
            .fold(0.0, f64::max);
        assert!((largest - 0.8).abs() < 1e-9, "{largest}");
    }

    #[test]
    fn a_stroke_followed_to_its_end_has_no_deviation() {
        let points = hairpin();
        let mut follower = Follower::new(&points);
        let there = (0..=40).map(|k| place(f64::from(k) * 0.5, 0.0));
        let back = (0..=40).map(|k| place(20.0 - f64::from(k) * 0.5, 1.0));
        for position in there.chain([place(20.0, 0.5)]).chain(back) {
            assert!(follower.step(&position) < 1e-9, "{position:?}");
        }
    }

    #[test]
    fn a_stroke_that_crosses_itself_is_not_left_for_its_other_part() {
        // Around a small square and across its first side.
        let corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 1.0), (2.0, 1.0), (2.0, -3.0)];
        let points: Vec<Position> = corners.iter().map(|(x, y)| place(*x, *y)).collect();
        let mut follower = Follower::new(&points);
        let first = (0..=40).map(|k| follower.step(&place(f64::from(k) * 0.1, if k < 20 { 0.0 } else { -0.3 })));
        let largest = first.fold(0.0, f64::max);
        assert!((largest - 0.3).abs() < 1e-9, "{largest}");
        assert!((follower.foot_mm - 4.0).abs() < 1e-9, "{}", follower.foot_mm);
    }

    #[test]
    fn a_position_that_lags_around_a_tip_is_compared_with_both_sides_of_it() {
        let points = vec![place(0.0, 0.0), place(10.0, 0.0), place(0.0, 2.0)];
        let along = |s: f64| {
            if s < 10.0 {
                place(s, 0.0)
            } else {
                place(20.0 - s, (s - 10.0) * 0.2)
            }
        };
        let moments = (0..=180).map(|k| Moment {
            stroke: 0,
            reference: along(f64::from(k) * 0.1),
            measured: along((f64::from(k) * 0.1 - 0.4).max(0.0)),
        });
        let (reference, measured) = deviation(moments, &[(0, points)]);
        assert!(
            reference.max_mm < 1e-9 && measured.max_mm < 1e-9,
            "{reference:?} {measured:?}"
        );
    }

    #[test]
    fn ink_is_missing_where_none_is_near() {
        let strokes = vec![(0, vec![place(0.0, 0.0), place(10.0, 0.0)])];
        let ink: Vec<[f64; 2]> = (0..=50).map(|k| [f64::from(k) * 0.1, 0.2]).collect();
        let missing_mm = ink_missing(&strokes, &[ink]);
        assert!((missing_mm - 4.5).abs() < 0.15, "{missing_mm}");
    }

    #[test]
    fn ink_that_begins_on_top_of_the_last_stroke_belongs_to_its_own() {
        // The second stroke begins on the first one, and is drawn a little beside its own beginning.
        let strokes = vec![
            (0, vec![place(0.0, 0.0), place(20.0, 0.0)]),
            (1, vec![place(10.0, 0.05), place(10.0, 5.0)]),
            (2, vec![place(30.0, 0.0), place(40.0, 0.0)]),
        ];
        let ink = [
            vec![[0.0, 0.0], [20.0, 0.0]],
            vec![[10.0, 0.0], [10.0, 5.0]],
            vec![[30.0, 0.0], [40.0, 0.0]],
        ];
        let found = ink_deviation(&ink, &strokes);
        assert!(found.max_mm < 0.06, "{}", found.max_mm);
    }

    #[test]
    fn ink_is_compared_with_the_strokes_in_their_order() {
        let strokes = vec![(0, hairpin()), (1, vec![place(0.0, 1.5), place(20.0, 1.5)])];
        let line = |y: f64, from: i32, to: i32| (from..=to).map(|x| [f64::from(x), y]).collect::<Vec<_>>();
        let first = [
            line(0.1, 0, 19),
            vec![[20.0, 0.5]],
            line(1.0, 0, 20).into_iter().rev().collect(),
        ]
        .concat();
        let second = line(1.3, 0, 20);
        // 1.3 is nearer to the last leg of the first stroke than 0.2 mm only when the order is not kept.
        let found = ink_deviation(&[first.clone(), second.clone()], &strokes);
        assert!((found.max_mm - 0.2).abs() < 1e-9, "{found:?}");
        let (before, after) = first.split_at(10);
        let held = ink_deviation(&[before.to_vec(), after.to_vec(), second], &strokes);
        assert!((held.max_mm - 0.2).abs() < 1e-9, "a hold in the first stroke: {held:?}");
    }

    #[test]
    fn a_closed_stroke_is_followed_from_its_begin() {
        let square = vec![
            place(0.0, 0.0),
            place(10.0, 0.0),
            place(10.0, 10.0),
            place(0.0, 10.0),
            place(0.0, 0.0),
        ];
        let (follower, away_mm) = Follower::beginning_near(&square, &place(-0.1, 0.3));
        assert_eq!(follower.foot_mm, 0.0);
        assert!(away_mm < 0.4);
    }
}
