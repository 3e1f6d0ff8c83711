//! A short tour through all strokes: their order, and the end from which each is drawn.
//!
//! The shortest links are taken first, as long as they form no ring (greedy matching); the remaining chains are put end
//! to end. Walking to the nearest stroke each time is a second start where it is clearly
//! shorter. Exchanging links (2-opt) and moving short runs (or-opt) among near ends then improve the tour. Small
//! disturbances, kept if they shorten the tour, improve it further (iterated local search; Johnson and McGeoch, *The
//! Traveling Salesman Problem: A Case Study in Local Optimization*, 1997).
//!
//! Invariant: a tour enters every stroke once, at an even place, and leaves it at its other end, at the next, odd
//! place. The work is bounded by the number of strokes.

use super::join::Near;
use super::line::{self, Point};
use super::travel::Travel;
use crate::random::Lcg;
use std::collections::VecDeque;

/// Number of nearest ends tried as partners of an end.
const NEIGHBOURS: usize = 8;
/// Longest run of strokes moved at once.
const RUN_MAX: usize = 3;
/// Average number of exchanges tried for each end before the search stops.
const ROUNDS_MAX: usize = 60;
/// Smallest improvement that counts, s.
const GAIN_MIN_S: f64 = 1e-9;
/// Number of disturbances: two for each stroke, within these limits. More of them would shorten a tour by less than
/// another per cent.
const KICKS_A_STROKE: usize = 2;
const KICKS_MIN: usize = 400;
const KICKS_MAX: usize = 200_000;
/// Largest distance between places that are changed together after a disturbance, so that its cost does not grow with
/// the drawing.
const KICK_SPAN: usize = 400;
/// Most strokes of a run that a disturbance moves; disturbances take turns with both.
const KICK_RUNS: [usize; 2] = [30, 10];
/// Largest ratio of a given order's length to the greedy one's for which the given order is also tried as a start.
const GIVEN_RATIO: f64 = 1.3;
/// Most ends of a drawing for which a walk to the nearest stroke is tried as a start too, and the largest ratio of its length to the
/// others' for which it is disturbed too. It finds the rows of a pattern, where the shortest links are many and equal.
const WALKED_MAX: usize = 40_000;
const WALKED_RATIO: f64 = 0.95;

/// The ends in the order of a short tour; end `2 k` is the start of stroke `k`, end `2 k + 1` is its last point.
/// `effort` multiplies the number of disturbances.
pub(super) fn shortest_tour(ends: &[Point], travel: &Travel, effort: usize) -> Vec<usize> {
    let as_given: Vec<usize> = (0..ends.len()).collect();
    if ends.len() < 4 {
        return as_given;
    }
    let neighbours = neighbours(ends);
    let start = |order: Vec<usize>| Tour::new(ends, travel, &neighbours, order);
    let (tour, given) = (start(greedy(ends, &neighbours)), start(as_given));
    let is_given_good = given.duration_s() <= GIVEN_RATIO * tour.duration_s();
    let (mut tour, mut best_s) = tour.improved();
    if is_given_good {
        let (given, given_s) = given.improved();
        if given_s < best_s {
            (tour, best_s) = (given, given_s);
        }
    }
    let mut tours = Vec::new();
    if ends.len() <= WALKED_MAX {
        let (walked, walked_s) = start(walked(ends)).improved();
        if walked_s < best_s && walked.length() < WALKED_RATIO * tour.length() {
            tours.push(walked);
        }
    }
    tours.push(tour);
    tours.iter_mut().for_each(|tour| tour.disturb(effort));
    let best = tours
        .into_iter()
        .min_by(|one, other| one.duration_s().total_cmp(&other.duration_s()));
    best.map_or_else(Vec::new, |tour| tour.tour)
}

/// Always to the nearest stroke that is left, from the top left.
fn walked(ends: &[Point]) -> Vec<usize> {
    let mut near = Near::of(ends);
    let mut tour = Vec::with_capacity(ends.len());
    let mut entry = (0..ends.len()).min_by(|&a, &b| (ends[a][0] + ends[a][1]).total_cmp(&(ends[b][0] + ends[b][1])));
    while let Some(at) = entry {
        tour.extend([at, at ^ 1]);
        near.remove(at, ends[at]);
        near.remove(at ^ 1, ends[at ^ 1]);
        entry = nearest(&near, ends, ends[at ^ 1], 1).first().copied();
    }
    tour
}

/// For each end the nearest ends of other strokes, sorted by distance.
fn neighbours(ends: &[Point]) -> Vec<Vec<usize>> {
    let near = Near::of(ends);
    let of = |k: usize| {
        let mut list = nearest(&near, ends, ends[k], NEIGHBOURS + 2);
        list.retain(|&other| other / 2 != k / 2);
        list
    };
    (0..ends.len()).map(of).collect()
}

/// The `count` ends nearest to a point.
fn nearest(near: &Near, ends: &[Point], point: Point, count: usize) -> Vec<usize> {
    let mut found: Vec<(f64, usize)> = Vec::new();
    for ring in 0..=near.rings() {
        near.visit_ring(point, ring, |k| found.push((line::distance(ends[k], point), k)));
        if found.iter().filter(|other| other.0 <= near.reach(ring)).count() >= count {
            break;
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    found.truncate(count);
    found.into_iter().map(|other| other.1).collect()
}

/// Chains of the shortest links, put end to end from the top left.
fn greedy(ends: &[Point], neighbours: &[Vec<usize>]) -> Vec<usize> {
    let mut links: Vec<(f64, usize, usize)> = Vec::new();
    for (a, list) in neighbours.iter().enumerate() {
        links.extend(
            list.iter()
                .map(|&b| (line::distance(ends[a], ends[b]), a.min(b), a.max(b))),
        );
    }
    links.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut partner: Vec<Option<usize>> = vec![None; ends.len()];
    // The other end of the chain that an open end belongs to.
    let mut far: Vec<usize> = (0..ends.len()).map(|end| end ^ 1).collect();
    for (_, a, b) in links {
        if partner[a].is_none() && partner[b].is_none() && far[a] != b {
            (partner[a], partner[b]) = (Some(b), Some(a));
            let (one, other) = (far[a], far[b]);
            (far[one], far[other]) = (other, one);
        }
    }
    let open: Vec<usize> = (0..ends.len()).filter(|&end| partner[end].is_none()).collect();
    let places: Vec<Point> = open.iter().map(|&end| ends[end]).collect();
    let mut index = vec![0; ends.len()];
    open.iter().enumerate().for_each(|(k, &end)| index[end] = k);
    let mut near = Near::of(&places);
    let mut tour = Vec::with_capacity(ends.len());
    let mut entry =
        (0..open.len()).min_by(|&a, &b| (places[a][0] + places[a][1]).total_cmp(&(places[b][0] + places[b][1])));
    while let Some(first) = entry {
        let start = open[first];
        let last = index[far[start]];
        near.remove(first, places[first]);
        near.remove(last, places[last]);
        let mut end = Some(start);
        while let Some(at) = end {
            tour.extend([at, at ^ 1]);
            end = partner[at ^ 1];
        }
        entry = nearest(&near, &places, places[last], 1).first().copied();
    }
    tour
}

/// A change of the tour that can be undone.
#[derive(Clone, Copy)]
enum Change {
    Reverse { from: usize, to: usize },
    RotateLeft { from: usize, to: usize, by: usize },
}

struct Tour<'a> {
    ends: &'a [Point],
    travel: &'a Travel,
    neighbours: &'a [Vec<usize>],
    tour: Vec<usize>,
    /// Place of every end in the tour.
    places: Vec<usize>,
    queue: VecDeque<usize>,
    waiting: Vec<bool>,
    /// Changes since the last disturbance.
    changes: Vec<Change>,
    /// Time gained since the last disturbance, s.
    gained_s: f64,
    /// Largest distance between places that are changed together.
    span_max: usize,
}

impl<'a> Tour<'a> {
    fn new(ends: &'a [Point], travel: &'a Travel, neighbours: &'a [Vec<usize>], tour: Vec<usize>) -> Self {
        let mut places = vec![0; ends.len()];
        tour.iter().enumerate().for_each(|(place, &end)| places[end] = place);
        Self {
            ends,
            travel,
            neighbours,
            tour,
            places,
            queue: VecDeque::new(),
            waiting: vec![false; ends.len()],
            changes: Vec::new(),
            gained_s: 0.0,
            span_max: usize::MAX,
        }
    }

    /// Time between the ends at two places; 0 beyond either end of the tour.
    fn link(&self, a: usize, b: usize) -> f64 {
        match (self.tour.get(a), self.tour.get(b)) {
            (Some(&a), Some(&b)) => self.way_s(a, b),
            _ => 0.0,
        }
    }

    /// Time between two ends.
    fn way_s(&self, a: usize, b: usize) -> f64 {
        self.travel.seconds(distance(self.ends[a], self.ends[b]))
    }

    /// This tour without improvements left among near ends, and how long it takes, s.
    fn improved(mut self) -> (Self, f64) {
        self.improve(0..self.ends.len());
        let duration_s = self.duration_s();
        (self, duration_s)
    }

    /// Length of all links.
    fn length(&self) -> f64 {
        let links = self.tour.iter().skip(1).zip(self.tour.iter().skip(2)).step_by(2);
        links.map(|(&a, &b)| distance(self.ends[a], self.ends[b])).sum()
    }

    fn duration_s(&self) -> f64 {
        (1..self.tour.len())
            .step_by(2)
            .map(|place| self.link(place, place + 1))
            .sum()
    }

    /// Disturbs the tour at many places, one after the other, and keeps improvements.
    fn disturb(&mut self, effort: usize) {
        let strokes = self.tour.len() / 2;
        if strokes < 3 {
            return;
        }
        self.span_max = KICK_SPAN;
        let mut random = Lcg::new(1);
        let mut below = |limit: usize| random.below(limit);
        let kicks = (KICKS_A_STROKE * strokes).clamp(KICKS_MIN, KICKS_MAX);
        for longest in KICK_RUNS.into_iter().cycle().take(effort.saturating_mul(kicks)) {
            let longest = longest.min(strokes / 3);
            let (first, second) = (1 + below(longest), 1 + below(longest));
            let start = below(strokes - first - second + 1);
            let (from, middle, after) = (2 * start, 2 * (start + first), 2 * (start + first + second));
            self.changes.clear();
            let before =
                self.link(from.wrapping_sub(1), from) + self.link(middle - 1, middle) + self.link(after - 1, after);
            let now =
                self.link(from.wrapping_sub(1), middle) + self.link(after - 1, from) + self.link(middle - 1, after);
            self.gained_s = before - now;
            self.change(Change::RotateLeft {
                from,
                to: after - 1,
                by: middle - from,
            });
            let seam = from + after - middle;
            let touched = [from.wrapping_sub(1), from, seam - 1, seam, after - 1, after];
            let ends: Vec<usize> = touched
                .iter()
                .filter_map(|&place| self.tour.get(place).copied())
                .collect();
            self.improve(ends.into_iter());
            if self.gained_s <= GAIN_MIN_S {
                while let Some(change) = self.changes.pop() {
                    self.take_back(change);
                }
            }
        }
    }

    fn change(&mut self, change: Change) {
        self.changes.push(change);
        match change {
            Change::Reverse { from, to } => self.tour[from..=to].reverse(),
            Change::RotateLeft { from, to, by } => self.tour[from..=to].rotate_left(by),
        }
        self.note(change);
    }

    fn take_back(&mut self, change: Change) {
        match change {
            Change::Reverse { from, to } => self.tour[from..=to].reverse(),
            Change::RotateLeft { from, to, by } => self.tour[from..=to].rotate_right(by),
        }
        self.note(change);
    }

    fn note(&mut self, change: Change) {
        let (Change::Reverse { from, to } | Change::RotateLeft { from, to, .. }) = change;
        for place in from..=to {
            self.places[self.tour[place]] = place;
        }
    }

    /// Improves the tour around these ends, and around changes, until no nearby change shortens it.
    fn improve(&mut self, ends: impl Iterator<Item = usize>) {
        ends.for_each(|end| self.wait(end));
        let mut budget = ROUNDS_MAX * self.ends.len();
        while let Some(end) = self.queue.pop_front() {
            self.waiting[end] = false;
            budget = budget.saturating_sub(1);
            if budget == 0 {
                continue;
            }
            if let Some(touched) = self.improve_at(end) {
                for place in touched {
                    if let Some(&end) = self.tour.get(place) {
                        self.wait(end);
                    }
                }
                self.wait(end);
            }
        }
    }

    fn wait(&mut self, end: usize) {
        if !self.waiting[end] {
            self.waiting[end] = true;
            self.queue.push_back(end);
        }
    }

    /// Applies the first improvement found at an end; returns the places whose links have changed.
    fn improve_at(&mut self, end: usize) -> Option<[usize; 6]> {
        let neighbours = self.neighbours;
        let place = self.places[end];
        let now = self.link(place, outward(place));
        for &other in &neighbours[end] {
            // An improving change has an end whose new link is shorter than its old one.
            if self.way_s(end, other) >= now {
                return None;
            }
            let goal = self.places[other];
            let touched = self.exchange(place, goal);
            let touched = touched.or_else(|| self.move_run(place, goal));
            let touched = touched.or_else(|| self.move_run(goal, place));
            if touched.is_some() {
                return touched;
            }
        }
        None
    }

    /// 2-opt: links the ends at two places of one parity, and also links their former partners.
    fn exchange(&mut self, a: usize, b: usize) -> Option<[usize; 6]> {
        if a % 2 != b % 2 {
            return None;
        }
        let (a, b) = (a.min(b), a.max(b));
        if b - a > self.span_max {
            return None;
        }
        let before = self.link(a, outward(a)) + self.link(b, outward(b));
        let near = self.link(a, b);
        // A link takes no less than no time.
        if before - near < GAIN_MIN_S {
            return None;
        }
        let after = near + self.link(outward(a), outward(b));
        if before - after < GAIN_MIN_S {
            return None;
        }
        self.gained_s += before - after;
        let (from, to) = if a % 2 == 1 { (a + 1, b) } else { (a, b - 1) };
        self.change(Change::Reverse { from, to });
        Some([from.wrapping_sub(1), from, to, to + 1, a, b])
    }

    /// Or-opt: moves a run of strokes that begins or ends at `place` to the end at `goal`.
    fn move_run(&mut self, place: usize, goal: usize) -> Option<[usize; 6]> {
        let stroke = place / 2;
        let strokes = self.tour.len() / 2;
        if place.abs_diff(goal) > self.span_max {
            return None;
        }
        let gap = outward(goal);
        let (opened, near) = (self.link(goal, gap), self.link(place, goal));
        for run in 1..=RUN_MAX.min(strokes - 1) {
            let first = if place.is_multiple_of(2) {
                stroke
            } else {
                (stroke + 1).checked_sub(run)?
            };
            let last = first + run - 1;
            if last >= strokes || (first..=last).contains(&(goal / 2)) {
                return None;
            }
            let (from, to) = (2 * first, 2 * last + 1);
            if (from..=to).contains(&gap) {
                return None;
            }
            let far = from + to - place;
            let before = self.link(from.wrapping_sub(1), from) + self.link(to, to + 1) + opened;
            // A link takes no less than no time.
            if before - near < GAIN_MIN_S {
                continue;
            }
            let after = self.link(from.wrapping_sub(1), to + 1) + near + self.link(far, gap);
            if before - after >= GAIN_MIN_S {
                self.gained_s += before - after;
                return Some(self.relocate(from, to, goal, place));
            }
        }
        None
    }

    /// Removes the run `from..=to` and reinserts it so that the end at `place` is next to the one at `goal`.
    fn relocate(&mut self, from: usize, to: usize, goal: usize, place: usize) -> [usize; 6] {
        let count = to - from + 1;
        if place % 2 == goal % 2 {
            self.change(Change::Reverse { from, to });
        }
        let (low, high, start) = if goal > to {
            let high = if goal % 2 == 1 { goal } else { goal - 1 };
            self.change(Change::RotateLeft {
                from,
                to: high,
                by: count,
            });
            (from, high, high + 1 - count)
        } else {
            let low = if goal % 2 == 1 { goal + 1 } else { goal };
            self.change(Change::RotateLeft {
                from: low,
                to,
                by: from - low,
            });
            (low, to, low)
        };
        [
            low.wrapping_sub(1),
            low,
            start.wrapping_sub(1),
            start + count - 1,
            high,
            high + 1,
        ]
    }
}

/// Distance between two points; coordinates on paper cannot overflow.
fn distance(a: Point, b: Point) -> f64 {
    let (dx, dy) = (a[0] - b[0], a[1] - b[1]);
    (dx * dx + dy * dy).sqrt()
}

/// The place to which a place is linked by a travel move: after an exit, before an entry.
fn outward(place: usize) -> usize {
    if place % 2 == 1 {
        place + 1
    } else {
        place.wrapping_sub(1)
    }
}
