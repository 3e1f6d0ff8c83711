//! Tone as strokes along the picture's flow, with a spacing that depends on the darkness.
//!
//! Lines are grown from seeds beside existing lines, at the distance that the required ink gives, until they come too
//! close to another line or into light (after Jobard and Lefer, *Creating Evenly-Spaced Streamlines of Arbitrary
//! Density*, 1997). Neighbours are then joined at their ends into serpentines wherever the bridge stays in the dark,
//! because every pen lift takes as long as 40 mm of line.

use super::edges::Flow;
use super::join::{self, Near};
use super::line::{self, Point};
use super::raster::Plane;
use crate::random::Random;
use std::collections::VecDeque;

/// Length of a growing step, pixels.
const STEP: f64 = 1.5;
/// Least distance of a seed from every line, as a share of the spacing.
const SEED_CLEARANCE: f64 = 0.92;
/// Distance from another line at which a growing line stops, as a share of the spacing.
const GROWTH_CLEARANCE: f64 = 0.68;
/// Least coverage at which a growing line continues, as a share of the thinnest coverage.
const FADE: f32 = 0.65;
/// Longest bridge between two lines, in spacings and in pen widths.
const BRIDGE_SPACINGS: f64 = 2.6;
const BRIDGE_PENS: f64 = 4.8;
/// Longest bridge between two lines that continue each other, in pen widths; cosine of the largest angle between them.
const STRAIGHT_PENS: f64 = 9.0;
const STRAIGHT_COSINE_MIN: f64 = 0.8;
/// Length of the shortest line, in spacings: shorter lines look like specks.
const LENGTH_SPACINGS: f64 = 2.2;
/// Most steps that a line grows in either direction.
const STEPS_MAX: usize = 4000;
/// Side of a cell of the index of points, pixels.
const CELL: f64 = 4.0;

/// Requirements of the hatching.
pub(crate) struct ToneGoal<'a> {
    /// Share of the paper to cover with ink, 0 to 1.
    pub(crate) coverage: &'a Plane,
    /// Direction of the strokes.
    pub(crate) flow: &'a Flow,
    /// Width of the pen, pixels.
    pub(crate) pen: f64,
    /// Coverage below which the paper stays white.
    pub(crate) coverage_min: f32,
    /// Shortest stroke, pixels.
    pub(crate) length_min: &'a Plane,
    /// Seed for the places tried first.
    pub(crate) seed: u64,
}

/// Strokes, pixels, that give the wanted coverage.
pub(crate) fn hatch(goal: &ToneGoal) -> Vec<Vec<Point>> {
    let mut field = Field::new(goal);
    let mut queue = VecDeque::new();
    for seed in field.first_seeds() {
        if field.grow_from(seed) {
            queue.push_back(field.strokes.len() - 1);
        }
        while let Some(parent) = queue.pop_front() {
            for seed in field.seeds_beside(parent) {
                if field.grow_from(seed) {
                    queue.push_back(field.strokes.len() - 1);
                }
            }
        }
    }
    field.strokes
}

/// A point of an accepted or growing line in the index.
#[derive(Clone, Copy)]
struct Mark {
    at: Point,
    stroke: usize,
    step: i64,
}

struct Field<'a> {
    goal: &'a ToneGoal<'a>,
    columns: usize,
    rows: usize,
    cells: Vec<Vec<Mark>>,
    strokes: Vec<Vec<Point>>,
}

impl<'a> Field<'a> {
    fn new(goal: &'a ToneGoal<'a>) -> Self {
        let columns = (goal.coverage.width() as f64 / CELL).ceil() as usize + 1;
        let rows = (goal.coverage.height() as f64 / CELL).ceil() as usize + 1;
        Self {
            goal,
            columns,
            rows,
            cells: vec![Vec::new(); columns * rows],
            strokes: Vec::new(),
        }
    }

    fn coverage(&self, at: Point) -> f32 {
        self.goal.coverage.sample(at[0] as f32, at[1] as f32)
    }

    /// Distance of neighbouring lines that gives the wanted coverage, pixels.
    fn spacing(&self, at: Point) -> f64 {
        self.goal.pen / f64::from(self.coverage(at).max(self.goal.coverage_min))
    }

    fn is_inside(&self, at: Point) -> bool {
        let (width, height) = (self.goal.coverage.width() as f64, self.goal.coverage.height() as f64);
        at[0] >= 0.0 && at[1] >= 0.0 && at[0] <= width - 1.0 && at[1] <= height - 1.0
    }

    /// Places over the whole picture, the darkest first, each with a small random offset from the seed.
    fn first_seeds(&self) -> Vec<Point> {
        let mut random = Random::new(self.goal.seed);
        let mut seeds = Vec::new();
        for row in 0..self.rows {
            for column in 0..self.columns {
                let at = [column, row].map(|cell| (cell as f64 + random.unit()) * CELL);
                if self.is_inside(at) && self.coverage(at) >= self.goal.coverage_min {
                    seeds.push(((self.coverage(at) * 8.0) as i32, at));
                }
            }
        }
        seeds.sort_by_key(|seed| -seed.0);
        seeds.into_iter().map(|seed| seed.1).collect()
    }

    /// Places at the required distance on both sides of a line.
    fn seeds_beside(&self, stroke: usize) -> Vec<Point> {
        let points = &self.strokes[stroke];
        let mut seeds = Vec::new();
        for pair in points.windows(2).step_by(2) {
            let along = line::direction(pair[0], pair[1]);
            for side in [-1.0, 1.0] {
                let mut away = self.spacing(pair[0]);
                for _ in 0..2 {
                    let at = [pair[0][0] - side * along[1] * away, pair[0][1] + side * along[0] * away];
                    away = 0.5 * (self.spacing(pair[0]) + self.spacing(at));
                }
                seeds.push([pair[0][0] - side * along[1] * away, pair[0][1] + side * along[0] * away]);
            }
        }
        seeds
    }

    /// Whether no line is within `share` of the spacing; a line's own last points do not count.
    fn is_free(&self, at: Point, share: f64, stroke: usize, step: i64) -> bool {
        let radius = share * self.spacing(at);
        let own_steps = (2.0 * radius / STEP) as i64 + 2;
        let range = |centre: f64, count: usize| {
            let low = ((centre - radius) / CELL).floor().max(0.0) as usize;
            let high = ((centre + radius) / CELL).floor().max(0.0) as usize;
            low..=high.min(count - 1)
        };
        for row in range(at[1], self.rows) {
            for column in range(at[0], self.columns) {
                for mark in &self.cells[row * self.columns + column] {
                    let own = mark.stroke == stroke && (mark.step - step).abs() <= own_steps;
                    if !own && line::distance_squared(mark.at, at) < radius * radius {
                        return false;
                    }
                }
            }
        }
        true
    }

    fn cell(&self, at: Point) -> usize {
        let column = ((at[0] / CELL).max(0.0) as usize).min(self.columns - 1);
        let row = ((at[1] / CELL).max(0.0) as usize).min(self.rows - 1);
        row * self.columns + column
    }

    /// Grows a line in both directions from a seed; keeps it if it is long enough.
    fn grow_from(&mut self, seed: Point) -> bool {
        let stroke = self.strokes.len();
        if !self.is_inside(seed)
            || self.coverage(seed) < self.goal.coverage_min
            || !self.is_free(seed, SEED_CLEARANCE, usize::MAX, 0)
        {
            return false;
        }
        let mut placed = Vec::new();
        self.place(seed, stroke, 0, &mut placed);
        let along = self.goal.flow.tangent(seed, [1.0, 0.0]);
        let mut points = self.grow(seed, [-along[0], -along[1]], stroke, -1, &mut placed);
        points.reverse();
        points.push(seed);
        points.extend(self.grow(seed, along, stroke, 1, &mut placed));
        let length_min = f64::from(self.goal.length_min.sample(seed[0] as f32, seed[1] as f32));
        if line::length(&points) < length_min.max(LENGTH_SPACINGS * self.spacing(seed)) {
            for cell in placed {
                self.cells[cell].retain(|mark| mark.stroke != stroke);
            }
            return false;
        }
        self.strokes.push(points);
        true
    }

    fn place(&mut self, at: Point, stroke: usize, step: i64, placed: &mut Vec<usize>) {
        let cell = self.cell(at);
        self.cells[cell].push(Mark { at, stroke, step });
        placed.push(cell);
    }

    fn grow(&mut self, from: Point, heading: Point, stroke: usize, sign: i64, placed: &mut Vec<usize>) -> Vec<Point> {
        let mut points = Vec::new();
        let (mut at, mut along) = (from, heading);
        for k in 1..STEPS_MAX as i64 {
            let here = self.goal.flow.tangent(at, along);
            let middle = [at[0] + 0.5 * STEP * here[0], at[1] + 0.5 * STEP * here[1]];
            let onward = self.goal.flow.tangent(middle, here);
            let next = [at[0] + STEP * onward[0], at[1] + STEP * onward[1]];
            let turn = onward[0] * along[0] + onward[1] * along[1];
            if turn < 0.5
                || !self.is_inside(next)
                || self.coverage(next) < FADE * self.goal.coverage_min
                || !self.is_free(next, GROWTH_CLEARANCE, stroke, sign * k)
            {
                break;
            }
            self.place(next, stroke, sign * k, placed);
            points.push(next);
            (at, along) = (next, onward);
        }
        points
    }
}

/// Joins lines end to end into serpentines where the bridge is short and stays in the dark.
///
/// At wide spacings, bridges are only used where a line continues straight: a turn would be visible as a separate line.
pub(crate) fn join_serpentines(strokes: &[Vec<Point>], goal: &ToneGoal) -> Vec<Vec<Point>> {
    let coverage = |at: Point| goal.coverage.sample(at[0] as f32, at[1] as f32);
    let ends = join::ends(strokes);
    let headings = headings(strokes);
    let near = Near::of(&ends);
    let mut bridges = Vec::new();
    for (a, &from) in ends.iter().enumerate() {
        near.visit_within(a, from, STRAIGHT_PENS * goal.pen, |b| {
            let to = ends[b];
            if b <= a || a / 2 == b / 2 {
                return;
            }
            let (away, onward) = (line::distance(from, to), line::direction(from, to));
            let leaving = headings[a][0] * onward[0] + headings[a][1] * onward[1];
            let arriving = -headings[b][0] * onward[0] - headings[b][1] * onward[1];
            let is_straight = leaving.min(arriving) > STRAIGHT_COSINE_MIN;
            let darkest = coverage(line::between(from, to, 0.5)).max(goal.coverage_min);
            let turn_max = goal.pen * BRIDGE_PENS.min(BRIDGE_SPACINGS / f64::from(darkest));
            if away
                > if is_straight {
                    STRAIGHT_PENS * goal.pen
                } else {
                    turn_max
                }
            {
                return;
            }
            let light_max = if is_straight { FADE } else { 1.0 } * goal.coverage_min;
            if (0..=4).all(|k| coverage(line::between(from, to, f64::from(k) / 4.0)) >= light_max) {
                bridges.push((if is_straight { 0.5 * away } else { away }, a, b));
            }
        });
    }
    join::join_ends(strokes, bridges)
}

/// Direction in which each line would continue beyond each of its ends.
fn headings(strokes: &[Vec<Point>]) -> Vec<Point> {
    let heading = |points: &mut dyn Iterator<Item = &Point>| match (points.next(), points.nth(2)) {
        (Some(&end), Some(&inside)) => line::direction(inside, end),
        _ => [0.0, 0.0],
    };
    strokes
        .iter()
        .flat_map(|points| [heading(&mut points.iter()), heading(&mut points.iter().rev())])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The strokes for a coverage with a pen of 2 pixels, and the serpentines made of them.
    fn hatched(coverage: &Plane) -> [Vec<Vec<Point>>; 2] {
        let (width, height) = (coverage.width(), coverage.height());
        let flow = Flow::of(&Plane::filled(width, height, 0.5), 2.0, 0.7, 0.01);
        let length_min = Plane::filled(width, height, 12.0);
        let (flow, length_min) = (&flow, &length_min);
        let goal = ToneGoal {
            coverage,
            flow,
            pen: 2.0,
            coverage_min: 0.08,
            length_min,
            seed: 7,
        };
        let strokes = hatch(&goal);
        let joined = join_serpentines(&strokes, &goal);
        [strokes, joined]
    }

    #[test]
    fn the_dark_is_drawn_in_serpentines_and_thin_tone_in_single_strokes() {
        let [strokes, joined] = hatched(&Plane::filled(300, 300, 0.5));
        assert!(
            joined.len() * 5 < strokes.len(),
            "{} of {}",
            joined.len(),
            strokes.len()
        );
        let [strokes, joined] = hatched(&Plane::filled(300, 300, 0.12));
        assert!(
            joined.len() * 2 > strokes.len(),
            "{} of {}",
            joined.len(),
            strokes.len()
        );
    }

    #[test]
    fn even_tone_gives_the_wanted_ink() {
        for wanted in [0.15_f32, 0.3, 0.5] {
            let [strokes, _] = hatched(&Plane::filled(300, 300, wanted));
            let ink: f64 = strokes.iter().map(|points| line::length(points) * 2.0).sum::<f64>() / 90_000.0;
            assert!(
                (ink / f64::from(wanted) - 1.0).abs() < 0.2,
                "wanted {wanted}, got {ink}"
            );
        }
    }

    #[test]
    fn light_stays_white_and_strokes_are_long_enough() {
        let half = Plane::from_fn(300, 300, |x, _| if x < 150 { 0.4 } else { 0.0 });
        let [strokes, _] = hatched(&half);
        for points in strokes {
            assert!(points.iter().all(|point| point[0] < 152.0));
            assert!(line::length(&points) >= 12.0);
        }
    }
}
