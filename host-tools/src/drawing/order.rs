//! The order in which strokes cost least drawing time.
//!
//! Lifts come before travel: ends that lie within the pen's width are joined first, then the strokes are sorted from
//! each end to the nearest one, turned round where that is shorter, and improved by exchanging links (2-opt) and moving
//! short runs (or-opt). Invariant: all ink of the given drawing is in the result, and the way with the pen up is never
//! longer than it was.

use super::join::{self, Near};
use super::line::{self, Point};
use super::{Drawing, Stroke};
use std::collections::VecDeque;

/// Nearest ends tried as partners of an end.
const NEIGHBOURS: usize = 10;
/// Longest run of strokes that is moved at once.
const RUN_MAX: usize = 3;
/// Exchanges tried for each end, on average, before the order is taken as it is.
const ROUNDS_MAX: usize = 60;
/// Smallest improvement that counts, mm.
const GAIN_MIN_MM: f64 = 1e-7;

/// What the order may do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrderOptions {
    /// Ends at most this far apart are joined without a lift, mm; 0 joins only ends at one point, below 0 none.
    pub join_gap_mm: f64,
    /// Leave order and direction as given, only join a stroke to the next one.
    pub keep_order: bool,
}

impl Default for OrderOptions {
    /// Gaps under the width of a 0.5 mm pen are joined.
    fn default() -> Self {
        Self {
            join_gap_mm: 0.5,
            keep_order: false,
        }
    }
}

/// What the order has changed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrderReport {
    /// Lifts of the pen as given, one for each stroke.
    pub lifts_before: usize,
    /// Lifts of the pen now.
    pub lifts_after: usize,
    /// Way with the pen up as given, from the first stroke's start to the last one's end, mm.
    pub pen_up_mm_before: f64,
    /// The same now.
    pub pen_up_mm_after: f64,
    /// Ink added where gaps were joined, mm.
    pub bridged_mm: f64,
}

/// Puts the strokes of a drawing into an order that costs little time. Strokes of less than two points are dropped.
pub fn order(drawing: &mut Drawing, options: &OrderOptions) -> OrderReport {
    drawing.strokes.retain(|stroke| stroke.points.len() > 1);
    let given = drawing.clone();
    let lines: Vec<Vec<Point>> = given.strokes.iter().map(|stroke| stroke.points.clone()).collect();
    let bridges = bridges(&lines, options);
    let joined = if bridges.is_empty() {
        lines
    } else {
        join::join_ends(&lines, bridges)
    };
    let sorted = if options.keep_order || joined.len() < 2 {
        joined
    } else {
        sorted(joined)
    };
    drawing.strokes = sorted.into_iter().map(|points| Stroke { points }).collect();
    if drawing.pen_up_mm() > given.pen_up_mm() {
        drawing.strokes.clone_from(&given.strokes);
    }
    OrderReport {
        lifts_before: given.strokes.len(),
        lifts_after: drawing.strokes.len(),
        pen_up_mm_before: given.pen_up_mm(),
        pen_up_mm_after: drawing.pen_up_mm(),
        bridged_mm: (drawing.pen_down_mm() - given.pen_down_mm()).max(0.0),
    }
}

/// Pairs of ends that are near enough to be joined.
fn bridges(lines: &[Vec<Point>], options: &OrderOptions) -> Vec<(f64, usize, usize)> {
    let ends = join::ends(lines);
    let mut bridges = Vec::new();
    if ends.is_empty() || options.join_gap_mm < 0.0 {
        return bridges;
    }
    if options.keep_order {
        let next = (1..ends.len() - 1)
            .step_by(2)
            .map(|k| (line::distance(ends[k], ends[k + 1]), k, k + 1));
        return next.filter(|bridge| bridge.0 <= options.join_gap_mm).collect();
    }
    let near = Near::of(&ends);
    for (a, &from) in ends.iter().enumerate() {
        near.visit_within(from, options.join_gap_mm, |b| {
            let away = line::distance(from, ends[b]);
            if a < b && a / 2 != b / 2 && away <= options.join_gap_mm {
                bridges.push((away, a, b));
            }
        });
    }
    bridges
}

fn sorted(lines: Vec<Vec<Point>>) -> Vec<Vec<Point>> {
    let ends = join::ends(&lines);
    let as_given: Vec<usize> = (0..ends.len()).collect();
    let candidates = [nearest_next(&ends), as_given];
    let best = candidates
        .into_iter()
        .map(|tour| {
            let mut tour = Tour::new(&ends, tour);
            tour.improve();
            (tour.length(), tour.tour)
        })
        .min_by(|a, b| a.0.total_cmp(&b.0));
    let Some((_, tour)) = best else { return lines };
    let turned = |entry: usize| {
        let mut points = lines[entry / 2].clone();
        if entry % 2 == 1 {
            points.reverse();
        }
        points
    };
    tour.iter().step_by(2).map(|&entry| turned(entry)).collect()
}

/// From each end to the nearest free one, beginning at the top left.
fn nearest_next(ends: &[Point]) -> Vec<usize> {
    let mut near = Near::of(ends);
    let mut tour = Vec::with_capacity(ends.len());
    let first = (0..ends.len()).min_by(|&a, &b| (ends[a][0] + ends[a][1]).total_cmp(&(ends[b][0] + ends[b][1])));
    let mut entry = first;
    while let Some(from) = entry {
        tour.extend([from, from ^ 1]);
        near.remove(from, ends[from]);
        near.remove(from ^ 1, ends[from ^ 1]);
        entry = nearest(&near, ends, ends[from ^ 1], 1).first().copied();
    }
    tour
}

/// The `count` ends that are nearest to a point.
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

/// A sequence of ends: a stroke is entered at an even place and left at the odd one after it.
struct Tour<'a> {
    ends: &'a [Point],
    tour: Vec<usize>,
    /// Place of every end in the tour.
    places: Vec<usize>,
    neighbours: Vec<Vec<usize>>,
}

impl<'a> Tour<'a> {
    fn new(ends: &'a [Point], tour: Vec<usize>) -> Self {
        let near = Near::of(ends);
        let neighbours = (0..ends.len())
            .map(|k| {
                let mut list = nearest(&near, ends, ends[k], NEIGHBOURS + 2);
                list.retain(|&other| other / 2 != k / 2);
                list
            })
            .collect();
        let mut places = vec![0; ends.len()];
        tour.iter().enumerate().for_each(|(place, &end)| places[end] = place);
        Self {
            ends,
            tour,
            places,
            neighbours,
        }
    }

    /// Distance of the ends at two places; beyond either end of the tour there is none.
    fn link(&self, a: usize, b: usize) -> f64 {
        match (self.tour.get(a), self.tour.get(b)) {
            (Some(&a), Some(&b)) => line::distance(self.ends[a], self.ends[b]),
            _ => 0.0,
        }
    }

    fn length(&self) -> f64 {
        (1..self.tour.len())
            .step_by(2)
            .map(|place| self.link(place, place + 1))
            .sum()
    }

    fn improve(&mut self) {
        let mut queue: VecDeque<usize> = self.tour.iter().copied().collect();
        let mut waiting = vec![true; self.ends.len()];
        let mut budget = ROUNDS_MAX * self.ends.len();
        while let Some(end) = queue.pop_front() {
            waiting[end] = false;
            budget = budget.saturating_sub(1);
            if budget == 0 {
                return;
            }
            if let Some(touched) = self.improve_at(end) {
                for place in touched {
                    if let Some(&end) = self.tour.get(place)
                        && !waiting[end]
                    {
                        waiting[end] = true;
                        queue.push_back(end);
                    }
                }
                if !waiting[end] {
                    waiting[end] = true;
                    queue.push_back(end);
                }
            }
        }
    }

    /// The first improvement found at an end; the places whose links have changed.
    fn improve_at(&mut self, end: usize) -> Option<[usize; 6]> {
        let neighbours = std::mem::take(&mut self.neighbours[end]);
        let place = self.places[end];
        let now = self.link(place, outward(place));
        let mut result = None;
        for &other in &neighbours {
            let away = line::distance(self.ends[end], self.ends[other]);
            result = if away < now {
                self.exchange(place, self.places[other])
            } else {
                None
            };
            if result.is_some() {
                break;
            }
            result = self.move_run(place, self.places[other]);
            if result.is_some() {
                break;
            }
        }
        self.neighbours[end] = neighbours;
        result
    }

    /// 2-opt: links the ends at two places of the same kind and, in exchange, the ends they were linked to.
    fn exchange(&mut self, a: usize, b: usize) -> Option<[usize; 6]> {
        if a % 2 != b % 2 {
            return None;
        }
        let (a, b) = (a.min(b), a.max(b));
        let before = self.link(a, outward(a)) + self.link(b, outward(b));
        let after = self.link(a, b) + self.link(outward(a), outward(b));
        if before - after < GAIN_MIN_MM {
            return None;
        }
        let (from, to) = if a % 2 == 1 { (a + 1, b) } else { (a, b - 1) };
        self.tour[from..=to].reverse();
        self.note_places(from, to);
        Some([from.wrapping_sub(1), from, to, to + 1, a, b])
    }

    /// Or-opt: moves a run of strokes that begins or ends at `place` to the end at `goal`.
    fn move_run(&mut self, place: usize, goal: usize) -> Option<[usize; 6]> {
        let stroke = place / 2;
        let strokes = self.tour.len() / 2;
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
            let gap = outward(goal);
            if (from..=to).contains(&gap) {
                return None;
            }
            let far = from + to - place;
            let before = self.link(from.wrapping_sub(1), from) + self.link(to, to + 1) + self.link(goal, gap);
            let after = self.link(from.wrapping_sub(1), to + 1) + self.link(place, goal) + self.link(far, gap);
            if before - after >= GAIN_MIN_MM {
                return Some(self.relocate(from, to, goal, place));
            }
        }
        None
    }

    /// Takes the run `from..=to` out and puts it back so that the end at `place` meets the one at `goal`.
    fn relocate(&mut self, from: usize, to: usize, goal: usize, place: usize) -> [usize; 6] {
        let count = to - from + 1;
        let turned = (place % 2) == (goal % 2);
        if turned {
            self.tour[from..=to].reverse();
        }
        let (low, high, start) = if goal > to {
            let high = if goal % 2 == 1 { goal } else { goal - 1 };
            self.tour[from..=high].rotate_left(count);
            (from, high, high + 1 - count)
        } else {
            let low = if goal % 2 == 1 { goal + 1 } else { goal };
            self.tour[low..=to].rotate_right(count);
            (low, to, low)
        };
        self.note_places(low, high);
        [
            low.wrapping_sub(1),
            low,
            start.wrapping_sub(1),
            start + count - 1,
            high,
            high + 1,
        ]
    }

    fn note_places(&mut self, from: usize, to: usize) {
        for place in from..=to {
            self.places[self.tour[place]] = place;
        }
    }
}

/// The place that a place is linked to by a way with the pen up: after an exit, before an entry.
fn outward(place: usize) -> usize {
    if place % 2 == 1 {
        place + 1
    } else {
        place.wrapping_sub(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Strokes of a few points all over a sheet.
    fn scattered(count: usize, mut state: u64) -> Drawing {
        let mut unit = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / (1u64 << 31) as f64
        };
        let strokes = (0..count).map(|_| {
            let (x, y) = (190.0 * unit(), 190.0 * unit());
            Stroke {
                points: (0..4).map(|_| [x + 10.0 * unit(), y + 10.0 * unit()]).collect(),
            }
        });
        Drawing {
            sheet_mm: [200.0, 200.0],
            strokes: strokes.collect(),
        }
    }

    /// Every segment of a drawing, its direction and order forgotten.
    fn ink(drawing: &Drawing) -> Vec<[u64; 4]> {
        let mut segments: Vec<[u64; 4]> = (drawing.strokes.iter())
            .flat_map(|stroke| stroke.points.windows(2))
            .map(|pair| {
                let [a, b] = [pair[0], pair[1]].map(|point| point.map(f64::to_bits));
                if a <= b {
                    [a[0], a[1], b[0], b[1]]
                } else {
                    [b[0], b[1], a[0], a[1]]
                }
            })
            .collect();
        segments.sort_unstable();
        segments
    }

    #[test]
    fn ink_is_the_same_segment_for_segment_and_the_way_never_longer() {
        for (seed, count) in [(1, 1), (2, 2), (3, 3), (4, 10), (5, 100), (6, 700)] {
            let given = scattered(count, seed);
            let mut ordered = given.clone();
            let options = OrderOptions {
                join_gap_mm: -1.0,
                keep_order: false,
            };
            let report = order(&mut ordered, &options);
            assert_eq!(ink(&ordered), ink(&given), "seed {seed}");
            assert!(
                report.pen_up_mm_after <= report.pen_up_mm_before,
                "seed {seed}: {report:?}"
            );
            assert_eq!(report.lifts_after, count);
            let mut again = ordered.clone();
            assert!(
                order(&mut again, &options).pen_up_mm_after <= report.pen_up_mm_after,
                "seed {seed}"
            );
        }
    }

    #[test]
    fn the_way_is_near_the_best_one() {
        let mut drawing = scattered(1000, 11);
        let report = order(
            &mut drawing,
            &OrderOptions {
                join_gap_mm: -1.0,
                keep_order: false,
            },
        );
        assert!(report.pen_up_mm_after < 0.043 * report.pen_up_mm_before, "{report:?}");
    }

    #[test]
    fn a_torn_line_becomes_one_stroke_and_gaps_alone_are_added() {
        let torn = |k: u32| Stroke {
            points: vec![[f64::from(k), 0.0], [f64::from(k) + 0.7, 0.0]],
        };
        let given = Drawing {
            sheet_mm: [200.0, 200.0],
            strokes: [3, 0, 2, 1].map(torn).to_vec(),
        };
        let mut drawing = given.clone();
        let report = order(&mut drawing, &OrderOptions::default());
        assert_eq!((report.lifts_after, drawing.strokes[0].points.len()), (1, 8));
        assert!((report.bridged_mm - 0.9).abs() < 1e-9);
        let mut apart = given.clone();
        let report = order(
            &mut apart,
            &OrderOptions {
                join_gap_mm: 0.2,
                keep_order: false,
            },
        );
        assert_eq!((report.lifts_after, report.bridged_mm), (4, 0.0));
        assert_eq!(ink(&apart), ink(&given));
    }

    #[test]
    fn a_kept_order_stays() {
        let given = scattered(50, 9);
        let mut kept = given.clone();
        order(
            &mut kept,
            &OrderOptions {
                join_gap_mm: 0.0,
                keep_order: true,
            },
        );
        assert_eq!(kept, given);
    }

    #[test]
    fn drawings_of_nothing_stay_nothing() {
        let mut drawing = Drawing {
            sheet_mm: [10.0, 10.0],
            strokes: vec![Stroke::default(); 3],
        };
        let report = order(&mut drawing, &OrderOptions::default());
        assert_eq!((report.lifts_after, report.pen_up_mm_after), (0, 0.0));
    }
}
