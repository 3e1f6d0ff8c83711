//! Orders strokes for the least drawing time.
//!
//! Lifts come before travel: ends within the pen's width are joined first, then the strokes are put into a short tour
//! ([`super::tour`]), each drawn from the better end, by the planner's duration of the travel moves ([`Travel`]).
//! Invariant: the result contains all ink of the given drawing, and neither its lifts nor its travel length exceed the
//! given ones.

use super::join::{self, Near};
use super::line::{self, Point};
use super::tour::shortest_tour;
use super::travel::Travel;
use super::{Drawing, Stroke};

/// Least length of a closed line that counts as a ring, in widths of the gaps that are joined.
const RING_GAPS: f64 = 4.0;

/// Most ends to which an end may be joined; where more meet, they meet each other too.
const BRIDGES_MAX: usize = 32;

/// Options of the ordering.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrderOptions {
    /// Largest distance of ends that are joined without a lift, mm; 0 joins only coincident ends, a negative value
    /// none.
    pub join_gap_mm: f64,
    /// Keep order and direction as given, only join a stroke to the next one.
    pub keep_order: bool,
    /// Cost of travel moves.
    pub travel: Travel,
}

impl Default for OrderOptions {
    /// Joins gaps below the width of a 0.5 mm pen.
    fn default() -> Self {
        Self {
            join_gap_mm: 0.5,
            keep_order: false,
            travel: Travel::default(),
        }
    }
}

/// Changes made by the ordering.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrderReport {
    /// Pen lifts as given, one for each stroke.
    pub lifts_before: usize,
    /// Pen lifts now.
    pub lifts_after: usize,
    /// Length of the travel moves as given, from the first stroke's start to the last one's end, mm.
    pub pen_up_mm_before: f64,
    /// Length of the travel moves now, from the first stroke's start to the last one's end, mm.
    pub pen_up_mm_after: f64,
    /// Ink added where gaps were joined, mm.
    pub bridged_mm: f64,
}

/// Puts the strokes of a drawing into an order with little drawing time. Strokes with fewer than two points are
/// dropped.
pub fn order(drawing: &mut Drawing, options: &OrderOptions) -> OrderReport {
    order_with_effort(drawing, options, 1)
}

/// Orders like [`order`], with `effort` times as many attempts to shorten the tour: for comparisons.
pub fn order_with_effort(drawing: &mut Drawing, options: &OrderOptions, effort: usize) -> OrderReport {
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
        sorted(joined, &options.travel, effort)
    };
    drawing.strokes = sorted.into_iter().map(|points| Stroke { points }).collect();
    let travel_s = |drawing: &Drawing| drawing.travels_mm().map(|mm| options.travel.seconds(mm)).sum::<f64>();
    if drawing.pen_up_mm() > given.pen_up_mm() || travel_s(drawing) > travel_s(&given) {
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

/// Pairs of ends that are close enough to be joined.
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
    // A line that hardly leaves its beginning is not a ring.
    let is_ring = |k: usize| line::length(&lines[k]) > RING_GAPS * options.join_gap_mm;
    for (a, &from) in ends.iter().enumerate() {
        let mut found = 0;
        near.visit_within(a, from, options.join_gap_mm, |b| {
            let away = line::distance(from, ends[b]);
            if a < b && (a / 2 != b / 2 || is_ring(a / 2)) && away <= options.join_gap_mm && found < BRIDGES_MAX {
                bridges.push((away, a, b));
                found += 1;
            }
        });
    }
    bridges
}

fn sorted(lines: Vec<Vec<Point>>, travel: &Travel, effort: usize) -> Vec<Vec<Point>> {
    let turned = |entry: usize| {
        let mut points = lines.get(entry / 2).cloned().unwrap_or_default();
        if entry % 2 == 1 {
            points.reverse();
        }
        points
    };
    let tour = shortest_tour(&join::ends(&lines), travel, effort);
    tour.iter().step_by(2).map(|&entry| turned(entry)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Lcg;

    /// Strokes of a few points all over a sheet.
    fn scattered(count: usize, seed: u64) -> Drawing {
        let mut random = Lcg::new(seed);
        let mut unit = || random.unit();
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

    /// Every segment of a drawing, without direction and order.
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
                ..OrderOptions::default()
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
                ..OrderOptions::default()
            },
        );
        assert!(report.pen_up_mm_after < 0.043 * report.pen_up_mm_before, "{report:?}");
    }

    #[test]
    fn rows_and_columns_of_dashes_are_found_in_any_order() {
        // Dashes of 3 mm; from one to the next in a row, and from one row to the next, mm. Once each for the shorter of both.
        for (columns, rows, across_mm, down_mm) in [(20_u32, 20_u32, 5.0, 8.0), (26, 80, 3.0, 2.0), (6, 60, 9.0, 2.0)] {
            let dash = |k: u32| {
                let place = (k * 977 + 13) % (columns * rows);
                let (x, y) = (f64::from(place % columns), f64::from(place / columns));
                let from = [10.0 + x * (3.0 + across_mm), 10.0 + y * down_mm];
                let mut points = vec![from, [from[0] + 3.0, from[1]]];
                if k.is_multiple_of(3) {
                    points.reverse();
                }
                Stroke { points }
            };
            let mut drawing = Drawing {
                sheet_mm: [250.0, 250.0],
                strokes: (0..columns * rows).map(dash).collect(),
            };
            let options = OrderOptions {
                join_gap_mm: -1.0,
                ..OrderOptions::default()
            };
            let report = order(&mut drawing, &options);
            let (c, r) = (f64::from(columns), f64::from(rows));
            let by_rows_mm = r * (c - 1.0) * across_mm + (r - 1.0) * down_mm;
            let by_columns_mm = c * (r - 1.0) * down_mm + (c - 1.0) * across_mm;
            let best_mm = by_rows_mm.min(by_columns_mm);
            assert!(report.pen_up_mm_after < 1.03 * best_mm, "{best_mm} mm: {report:?}");
        }
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
                ..OrderOptions::default()
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
                ..OrderOptions::default()
            },
        );
        assert_eq!(kept, given);
    }

    #[test]
    fn rays_from_one_point_are_joined_by_twos_however_many_they_are() {
        let ray = |k: u32| {
            let (sine, cosine) = f64::from(k).sin_cos();
            let end = [100.0 + (20.0 + 0.003 * f64::from(k)) * cosine, 100.0 + 80.0 * sine];
            Stroke {
                points: vec![[100.0, 100.0], end],
            }
        };
        let mut drawing = Drawing {
            sheet_mm: [200.0, 200.0],
            strokes: (0..9_000).map(ray).collect(),
        };
        let options = OrderOptions {
            join_gap_mm: 0.0,
            ..OrderOptions::default()
        };
        assert_eq!(order(&mut drawing, &options).lifts_after, 4_500);
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
