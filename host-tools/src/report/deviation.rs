//! Distances of points from the strokes that they should draw, and missing ink.
//!
//! A point is compared with its own stroke, in order along it ([`matching`](crate::matching)); in a drawing with lines
//! close together, or on top of each other, every point would otherwise be near some neighbour.
//!
//! A stroke that comes close to itself very often, like the noise of a digitiser, would cost time and memory
//! proportional to the square of its vertices. If [`limits`] are exceeded, the stroke is compared without its noise:
//! vertices within `THINNED_MM` of the one before. If that is not enough, it is thinned further, and each distance is
//! increased by as much.
//!
//! Invariants: a point's distance is taken only to its own stroke; distances from strokes that were not thinned are
//! exact, and no other is too small by more than twice `THINNED_MM`; memory is bounded by the strokes and the points.

use crate::matching::{Match, Polyline, Search, SearchLimits, SearchProgress, Step, distance, thinned};
use etherpen::robots::Position;
use std::collections::HashMap;

/// Distance within which there has to be ink, mm; otherwise the intended ink counts as missing.
const INK_REACH_MM: f64 = 0.5;
/// Distance between the points at which intended ink is checked, mm.
const INK_STEP_MM: f64 = 0.1;
/// Largest distance between two points of a line of ink where ink is searched, mm.
const INK_DENSE_MM: f64 = 0.25;
/// Distance from the straight line between two points beyond which a part of a stroke counts as left out, mm: corners
/// are rounded by less.
const LEFT_OUT_MM: f64 = 0.3;
/// Distance from the beginning of their stroke within which points are assumed to begin there, mm; others continue
/// somewhere along the stroke after a hold.
const BEGIN_MM: f64 = 2.0;
/// Distance within which a line of ink first searches its stroke, mm, and the factor for each further search.
const INK_NEAR_MM: f64 = 1.0;
const INK_FARTHER: f64 = 4.0;
/// Largest search distance of a line of ink, mm.
const INK_FAR_MM: f64 = 1e4;
/// How far before the end of the previous line a line of ink may begin on its stroke, mm.
const INK_BACK_MM: f64 = 0.5;

/// Vertices of a stroke within this distance of the one before are its noise, mm; and the factor of that distance each
/// time the stroke is thinned further.
const THINNED_MM: f64 = 0.1;
const THINNED_FARTHER: f64 = 4.0;
/// A line with at most this many points needs no limits.
const POINTS_FEW: usize = 3;

/// Limits of matching points with a stroke: ordinary drawings take about a hundred looks and keep about three parts for
/// a point.
const fn limits(points: usize) -> SearchLimits {
    SearchLimits {
        looks: 20_000_000 + 1_000 * points,
        parts: 1_000_000 + 32 * points,
        parts_at_once: usize::MAX,
    }
}

/// A drawn polyline with its stroke's number.
pub type NumberedStroke = (u32, Vec<Position>);

/// Largest distance and root of the mean square, mm; NaN without any point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Deviation {
    pub(super) max_mm: f64,
    pub(super) rms_mm: f64,
}

/// Accumulates distances.
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

    /// Adds the points of a match; a part of the line that they left out counts as well.
    fn add_match(&mut self, way: &Way, points: &[Step], matched: &Match) {
        for (point, place_mm) in points.iter().zip(&matched.places_mm) {
            self.add(way.moved_mm + way.line.distance_between(&point.position, *place_mm, *place_mm));
        }
        if matched.distance_mm > LEFT_OUT_MM {
            self.largest_mm = self.largest_mm.max(way.moved_mm + matched.distance_mm);
        }
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

/// A stroke that points are compared with.
struct Way<'a> {
    points: &'a [Position],
    line: Polyline,
    /// Vertices are at least this far apart, mm; 0 while all of them are kept.
    thinned_mm: f64,
    /// How far thinning beyond its noise may have moved the stroke, mm.
    moved_mm: f64,
}

impl<'a> Way<'a> {
    fn new(points: &'a [Position]) -> Self {
        Self {
            points,
            line: Polyline::new(points.to_vec()),
            thinned_mm: 0.0,
            moved_mm: 0.0,
        }
    }

    /// Matches points with the stroke, the first one between two places along it, mm; thins the stroke while that costs
    /// too much.
    fn follow(&mut self, steps: &[Step], first_mm: [f64; 2]) -> Match {
        loop {
            let limits = if self.line.legs() < POINTS_FEW {
                SearchLimits::NONE
            } else {
                limits(steps.len())
            };
            let mut search = Search::new(steps.to_vec(), first_mm, limits);
            if let SearchProgress::Found(found) = search.go_on(&self.line, usize::MAX) {
                return found;
            }
            self.thin();
        }
    }

    fn thin(&mut self) {
        self.thinned_mm = (self.thinned_mm * THINNED_FARTHER).max(THINNED_MM);
        let points = thinned(self.points, self.thinned_mm);
        if self.thinned_mm > THINNED_MM {
            // A stroke that lies entirely near its first point moves twice as far.
            self.moved_mm = 2.0 * self.thinned_mm;
        }
        self.line = Polyline::new(points);
    }
}

/// One millisecond of a stroke: where the platform was commanded to be, and where it was.
#[derive(Clone, Copy)]
pub(super) struct Moment {
    /// Milliseconds since the firmware started.
    pub(super) t_ms: u32,
    pub(super) stroke: u32,
    pub(super) reference: Position,
    pub(super) measured: Position,
}

/// Distances of references and of measured positions from their strokes. `speed_mm_s` is the largest speed along a
/// stroke: it bounds the distance covered where moments are missing.
pub(super) fn deviation(moments: &[Moment], strokes: &[NumberedStroke], speed_mm_s: f64) -> (Deviation, Deviation) {
    let (mut references, mut measured) = (Distances::default(), Distances::default());
    let lines: HashMap<u32, &Vec<Position>> = strokes.iter().rev().map(|(stroke, points)| (*stroke, points)).collect();
    for part in moments.chunk_by(|a, b| a.stroke == b.stroke) {
        let Some(points) = part.first().and_then(|first| lines.get(&first.stroke)) else {
            continue;
        };
        let compare = |distances: &mut Distances, place: fn(&Moment) -> Position| {
            let mut way = Way::new(points);
            let steps = steps(part, place, speed_mm_s);
            let matched = way.follow(&steps, beginning(&way.line, &steps));
            distances.add_match(&way, &steps, &matched);
        };
        compare(&mut references, |moment| moment.reference);
        compare(&mut measured, |moment| moment.measured);
    }
    (references.result(), measured.result())
}

fn steps(moments: &[Moment], place: fn(&Moment) -> Position, speed_mm_s: f64) -> Vec<Step> {
    let mut last_ms = None;
    let mut step = |moment: &Moment| {
        let passed_ms = last_ms
            .replace(moment.t_ms)
            .map_or(1, |last_ms: u32| moment.t_ms.wrapping_sub(last_ms));
        Step {
            position: place(moment),
            unseen_mm: (passed_ms > 1).then(|| BEGIN_MM + 2.0 * speed_mm_s * f64::from(passed_ms) / 1_000.0),
        }
    };
    moments.iter().map(&mut step).collect()
}

/// Where along a line positions may begin: at its beginning, or anywhere if they do not begin near that.
fn beginning(line: &Polyline, steps: &[Step]) -> [f64; 2] {
    let is_at_begin = |step: &Step| line.distance_between(&step.position, 0.0, 0.0) <= BEGIN_MM;
    match steps.first().is_some_and(is_at_begin) {
        true => [0.0, BEGIN_MM],
        false => [0.0, f64::INFINITY],
    }
}

/// A stroke to which a line of ink may belong.
struct Candidate {
    stroke: usize,
    matched: Match,
    /// Sum of the squares of this line's and all earlier lines' distances, mm2; infinite where their order forbids it.
    sum_mm2: f64,
    /// Candidate of the previous line that goes with this one.
    before: usize,
}

/// Distance of every point of ink from its stroke, on the paper.
///
/// Lines of ink are in the order of the strokes. A stroke that was held is drawn in several lines, and a stroke whose
/// pen did not reach the paper leaves none, so the strokes are assigned such that all lines together fit best.
pub(super) fn ink_deviation(ink_mm: &[Vec<[f64; 2]>], strokes: &[NumberedStroke]) -> Deviation {
    let ink: Vec<&Vec<[f64; 2]>> = ink_mm.iter().filter(|line| !line.is_empty()).collect();
    let mut ways: Vec<Way> = strokes.iter().map(|(_, points)| Way::new(points)).collect();
    let heights: Vec<f64> = (strokes
        .iter()
        .map(|(_, points)| points.first().map_or(0.0, |point| point.z_mm)))
    .collect();
    let mut distances = Distances::default();
    if ink.is_empty() || ways.is_empty() {
        return distances.result();
    }
    let mut near_mm = INK_NEAR_MM;
    let chosen = loop {
        let is_last = near_mm > INK_FAR_MM;
        let thinned_mm = |ways: &[Way]| ways.iter().map(|way| way.thinned_mm).sum::<f64>();
        let before_mm = thinned_mm(&ways);
        let candidates: Vec<Vec<Candidate>> = ink
            .iter()
            .map(|points| candidates(points, strokes, &mut ways, near_mm))
            .collect();
        if thinned_mm(&ways) > before_mm {
            // Places along a stroke are compared with each other: all of them have to be on the same one.
            continue;
        }
        if let Some(chosen) = in_order(candidates, is_last) {
            break chosen;
        }
        if is_last {
            return distances.result();
        }
        near_mm *= INK_FARTHER;
    };
    for (points, candidate) in ink.iter().zip(chosen) {
        let steps = on_paper(points, heights[candidate.stroke]);
        distances.add_match(&ways[candidate.stroke], &steps, &candidate.matched);
    }
    distances.result()
}

/// The strokes that a line of ink fits to within a distance.
fn candidates(points: &[[f64; 2]], strokes: &[NumberedStroke], ways: &mut [Way], near_mm: f64) -> Vec<Candidate> {
    let bounds = |places: &mut dyn Iterator<Item = [f64; 2]>| {
        places.fold(
            [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY],
            |b, [x, y]| [b[0].min(x), b[1].min(y), b[2].max(x), b[3].max(y)],
        )
    };
    let ink = bounds(&mut points.iter().copied());
    let mut result = Vec::new();
    for (stroke, ((_, places), way)) in strokes.iter().zip(ways).enumerate() {
        let around = bounds(&mut places.iter().map(|place| [place.x_mm, place.y_mm]));
        let is_inside = (0..2).all(|k| ink[k] >= around[k] - near_mm && ink[k + 2] <= around[k + 2] + near_mm);
        if !is_inside {
            continue;
        }
        let height_mm = places.first().map_or(0.0, |place| place.z_mm);
        let matched = way.follow(&on_paper(points, height_mm), [0.0, f64::INFINITY]);
        if matched.distance_mm <= near_mm {
            result.push(Candidate {
                stroke,
                matched,
                sum_mm2: f64::INFINITY,
                before: 0,
            });
        }
    }
    result
}

/// One candidate for each line of ink, with the strokes in order and the least sum of squared distances; `None` if no
/// choice keeps the order. `anyhow` lets lines on one stroke overlap.
fn in_order(mut candidates: Vec<Vec<Candidate>>, anyhow: bool) -> Option<Vec<Candidate>> {
    let mut last: &mut [Candidate] = &mut [];
    for (index, line) in candidates.iter_mut().enumerate() {
        let (mut passed, mut least) = (0, (f64::INFINITY, 0));
        for candidate in line.iter_mut() {
            while let Some(before) = last.get(passed).filter(|before| before.stroke < candidate.stroke) {
                if before.sum_mm2 < least.0 {
                    least = (before.sum_mm2, passed);
                }
                passed += 1;
            }
            let (mut sum_mm2, mut before) = if index == 0 { (0.0, 0) } else { least };
            if let Some(same) = last.get(passed).filter(|same| same.stroke == candidate.stroke)
                && (anyhow || goes_on(&same.matched, &candidate.matched))
                && same.sum_mm2 < sum_mm2
            {
                (sum_mm2, before) = (same.sum_mm2, passed);
            }
            candidate.sum_mm2 = sum_mm2 + candidate.matched.distance_mm.powi(2);
            candidate.before = before;
        }
        last = line;
    }
    let ends = candidates.last()?;
    let best = ends
        .iter()
        .enumerate()
        .min_by(|a, b| a.1.sum_mm2.total_cmp(&b.1.sum_mm2))?;
    let mut at = best.1.sum_mm2.is_finite().then_some(best.0)?;
    let mut chosen = Vec::with_capacity(candidates.len());
    while let Some(mut line) = candidates.pop() {
        let candidate = line.swap_remove(at);
        at = candidate.before;
        chosen.push(candidate);
    }
    chosen.reverse();
    Some(chosen)
}

/// Whether a line of ink begins on its stroke where another one ends.
fn goes_on(before: &Match, after: &Match) -> bool {
    match (before.places_mm.last(), after.places_mm.first()) {
        (Some(end_mm), Some(begin_mm)) => *begin_mm >= end_mm - INK_BACK_MM,
        _ => false,
    }
}

/// Points of ink at a height.
fn on_paper(points: &[[f64; 2]], z_mm: f64) -> Vec<Step> {
    let step = |&[x_mm, y_mm]: &[f64; 2]| Step {
        position: Position { x_mm, y_mm, z_mm },
        unseen_mm: None,
    };
    points.iter().map(step).collect()
}

/// Intended length without ink nearby, mm.
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
mod tests;
