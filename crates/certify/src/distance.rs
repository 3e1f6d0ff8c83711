//! Distance of a curve from the polyline that it rounds.
//!
//! A box of the curve is near the polyline if all of it is near one leg. Only legs around the vertex that the motion
//! passes count: a place on another part of the path is not on the path.

use crate::certificate::Kind;
use crate::interval::Interval;
use crate::motion::{Stretch, curve};
use crate::series::{Series, Series3, dot, range, squared_length};

/// Legs considered before and behind the vertex, at least.
const LEGS: usize = 4;
/// Length of path considered before and behind the vertex, mm: the planner replaces dense legs over at most 2 mm of the
/// path by one, which begins at the vertex, and rounds both ends of it.
const REACH_MM: f64 = 4.5;
/// Legs shorter than this are not counted, but considered, mm.
const LEG_MIN_MM: f64 = 0.0005;
/// Part of the limit that is small enough for no further bounds.
const SMALL: f64 = 0.25;
/// Looseness of a bound, as a part of the limit, above which a box is halved.
const LOOSE: f64 = 0.02;
const DEPTH_MAX: u32 = 20;
const BOXES_MAX: usize = 4_000;

/// A leg of the polyline.
struct Leg {
    from: [Interval; 3],
    direction: [Interval; 3],
    length: Interval,
}

impl Leg {
    fn new(from: &[f64; 3], to: &[f64; 3]) -> Self {
        let start = from.map(Interval::point);
        if from == to {
            return Self {
                from: start,
                direction: [Interval::ZERO; 3],
                length: Interval::ZERO,
            };
        }
        let way = [0, 1, 2].map(|axis| Interval::point(to[axis]) - start[axis]);
        let length = (way[0].square() + way[1].square() + way[2].square()).root();
        Self {
            from: start,
            direction: way.map(|way| way / length),
            length,
        }
    }

    /// Along the leg, and the squared distance from its line.
    fn split(&self, point: &Series3) -> (Series, Series) {
        let direction = self.direction.map(Series::constant);
        let way = [0, 1, 2].map(|axis| point[axis] - Series::constant(self.from[axis]));
        let along = dot(&way, &direction);
        let aside = [0, 1, 2].map(|axis| way[axis] - along * direction[axis]);
        (along, squared_length(&aside))
    }

    /// Squared distance from the leg for a place along it and a squared distance from its line.
    fn squared(&self, along: Interval, aside: Interval) -> Interval {
        let before = positive(-along);
        let behind = positive(along - self.length);
        aside + before.square() + behind.square()
    }
}

/// The larger one of 0 and each number.
fn positive(value: Interval) -> Interval {
    Interval::between(value.low().max(0.0), value.high().max(0.0))
}

/// The legs around a vertex, the nearest first.
fn legs(path: &[[f64; 3]], vertex: u32) -> Vec<Leg> {
    let length = |ends: &[[f64; 3]]| {
        let way = [0, 1, 2].map(|axis| ends[1][axis] - ends[0][axis]);
        way.iter().map(|way| way * way).sum::<f64>().sqrt()
    };
    let here = (vertex as usize).clamp(1, path.len().saturating_sub(1).max(1)) - 1;
    let reach = |legs: &mut dyn Iterator<Item = usize>| {
        let (mut left, mut way_mm) = (LEGS, 0.0);
        let mut taken = Vec::new();
        for leg in legs {
            taken.push(leg);
            let length_mm = path.get(leg..leg + 2).map_or(0.0, length);
            left = left.saturating_sub(usize::from(length_mm >= LEG_MIN_MM));
            way_mm += length_mm;
            if left == 0 && way_mm >= REACH_MM {
                break;
            }
        }
        taken
    };
    let ahead = reach(&mut (here..path.len().saturating_sub(1)));
    let back = reach(&mut (0..here).rev());
    let all = ahead.iter().chain(&back);
    all.filter_map(|leg| Some(Leg::new(path.get(*leg)?, path.get(leg + 1)?)))
        .collect()
}

/// Result for an interval of a curve.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Distance {
    /// Lower and upper bound of the largest distance, mm.
    pub(crate) bounds: [f64; 2],
    /// Parameter, kind and bounds of the distance where the limit is not proved.
    pub(crate) refused: Option<(f64, Kind, Interval)>,
    pub(crate) boxes: usize,
}

/// Bounds the distance of a stretch's whole interval from the path.
pub(crate) fn distance(stretch: &Stretch, path: &[[f64; 3]], limit: f64) -> Distance {
    let legs = legs(path, stretch.vertex);
    let [from, to] = stretch.parameter;
    let mut boxes = vec![(from, to, 0)];
    let mut result = Distance {
        bounds: [0.0; 2],
        refused: None,
        boxes: 0,
    };
    while let Some((from, to, depth)) = boxes.pop() {
        result.boxes += 1;
        let at = 0.5 * from + 0.5 * to;
        let half = (to - at).max(at - from).next_up();
        let (middle, _) = curve(&stretch.coefficients, Interval::point(at));
        let (whole, _) = curve(&stretch.coefficients, Interval::between(from, to));
        let mut most = f64::INFINITY;
        let mut point = [f64::INFINITY; 2];
        for leg in &legs {
            let (along, aside) = leg.split(&middle);
            let (along_whole, aside_whole) = leg.split(&whole);
            let bound = leg.squared(range(&along, &along_whole, half), range(&aside, &aside_whole, half));
            let here = leg.squared(along.value(), aside.value());
            most = most.min(bound.root_high());
            point = [point[0].min(here.root_low()), point[1].min(here.root_high())];
            if most <= SMALL * limit {
                break;
            }
        }
        let tight = most - point[0] <= LOOSE * limit || most <= SMALL * limit;
        let last = !point[1].is_finite() || depth >= DEPTH_MAX || result.boxes + boxes.len() >= BOXES_MAX;
        let keeps = most <= limit;
        if point[0] > limit {
            result
                .refused
                .get_or_insert((at, Kind::Violated, Interval::between(point[0], point[1])));
        } else if !(last || keeps && tight) {
            boxes.push((from, at, depth + 1));
            boxes.push((at, to, depth + 1));
            continue;
        } else if !keeps {
            result
                .refused
                .get_or_insert((at, Kind::NotProved, Interval::between(point[0], most)));
        }
        result.bounds = [result.bounds[0].max(point[0]), result.bounds[1].max(most)];
    }
    result
}
