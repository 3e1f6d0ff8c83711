//! Matches positions with the line that they should follow, in order along both.
//!
//! A position near a stroke may be near several parts of it: parallel legs, a line back over itself, the next turn of a
//! spiral. Only the order tells which part belongs to it. Positions are matched with the line so that neither goes back
//! and the largest distance is as small as possible: the Fréchet distance of two polylines, found by bisection between
//! distances that are sufficient and distances that are not (Alt and Godau, 1995).
//!
//! Invariant: places along the line never decrease from one position to the next, except across a break, by at most
//! `BACK_MM`.

use etherpen::robot::Position;

/// How far back along the line positions may go on after a break, mm: a pen that is set down again touches a little
/// before the place where it was lifted.
const BACK_MM: f64 = 0.5;
/// Precision of the distance, mm.
const PRECISION_MM: f64 = 1e-4;
/// Smallest distance tried first, mm.
const FIRST_MM: f64 = 0.02;
/// Largest distance tried, mm.
const LARGEST_MM: f64 = 1e5;

/// Distance between two positions, mm.
#[must_use]
pub fn distance(a: &Position, b: &Position) -> f64 {
    ((a.x_mm - b.x_mm).powi(2) + (a.y_mm - b.y_mm).powi(2) + (a.z_mm - b.z_mm).powi(2)).sqrt()
}

/// The point at a fraction of the segment from `a` to `b`.
#[must_use]
pub fn between(a: &Position, b: &Position, part: f64) -> Position {
    Position {
        x_mm: a.x_mm + part * (b.x_mm - a.x_mm),
        y_mm: a.y_mm + part * (b.y_mm - a.y_mm),
        z_mm: a.z_mm + part * (b.z_mm - a.z_mm),
    }
}

/// The fraction of the segment from `a` to `b` that is nearest to a position, 0 to 1.
fn nearest_part(place: &Position, a: &Position, b: &Position) -> f64 {
    let (dx, dy, dz) = (b.x_mm - a.x_mm, b.y_mm - a.y_mm, b.z_mm - a.z_mm);
    let squared = dx * dx + dy * dy + dz * dz;
    if squared == 0.0 {
        return 0.0;
    }
    let along = (place.x_mm - a.x_mm) * dx + (place.y_mm - a.y_mm) * dy + (place.z_mm - a.z_mm) * dz;
    (along / squared).clamp(0.0, 1.0)
}

/// The part of the segment from `a` to `b` that is within a distance of a position: from and to, 0 to 1.
fn within(place: &Position, a: &Position, b: &Position, reach_mm: f64) -> Option<[f64; 2]> {
    let foot = nearest_part(place, a, b);
    let away_mm = distance(place, &between(a, b, foot));
    if away_mm > reach_mm {
        return None;
    }
    let length_mm = distance(a, b);
    if length_mm == 0.0 {
        return Some([0.0, 1.0]);
    }
    // The foot on the infinite straight line is where both roots are symmetrical.
    let along = ((place.x_mm - a.x_mm) * (b.x_mm - a.x_mm)
        + (place.y_mm - a.y_mm) * (b.y_mm - a.y_mm)
        + (place.z_mm - a.z_mm) * (b.z_mm - a.z_mm))
        / (length_mm * length_mm);
    let across_mm = distance(place, &between(a, b, along));
    let half = (reach_mm * reach_mm - across_mm * across_mm).max(0.0).sqrt() / length_mm;
    Some([(along - half).clamp(0.0, foot), (along + half).clamp(foot, 1.0)])
}

/// A polyline to be followed.
#[derive(Clone, Debug, Default)]
pub struct Line {
    points: Vec<Position>,
    /// Distance of each point along the line, mm.
    along_mm: Vec<f64>,
}

/// A position, and its relation to the previous one.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// The position.
    pub position: Position,
    /// Distance along the line that the motion may have covered unseen since the previous position, mm; `None` if
    /// nothing is missing in between.
    pub unseen_mm: Option<f64>,
}

/// Match of positions with a line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Match {
    /// Smallest possible largest distance, in both directions, mm: of the positions from the line, and of the line
    /// between the places of the first and the last position from the positions.
    pub distance_mm: f64,
    /// The place of each position along the line, mm.
    pub places_mm: Vec<f64>,
}

/// Parts of the line that one position can reach: leg, and from and to as fractions of the leg.
type Reach = Vec<(usize, [f64; 2])>;

impl Line {
    /// A line through these points.
    #[must_use]
    pub fn new(points: Vec<Position>) -> Self {
        let mut length_mm = 0.0;
        let legs = points.windows(2).map(|pair| {
            length_mm += distance(&pair[0], &pair[1]);
            length_mm
        });
        let along_mm = std::iter::once(0.0).chain(legs).collect();
        Self { points, along_mm }
    }

    /// Length of the line, mm.
    #[must_use]
    pub fn length_mm(&self) -> f64 {
        self.along_mm.last().copied().unwrap_or(0.0)
    }

    /// Distance from a position to the part of the line between two places along it, mm; infinite for a line without a
    /// leg.
    #[must_use]
    pub fn distance_between(&self, place: &Position, low_mm: f64, high_mm: f64) -> f64 {
        let (low_mm, high_mm) = (
            low_mm.clamp(0.0, self.length_mm()),
            high_mm.clamp(0.0, self.length_mm()),
        );
        let first = self.leg_at(low_mm);
        let mut nearest_mm = f64::INFINITY;
        for (leg, ends_mm) in self.along_mm.windows(2).enumerate().skip(first) {
            if ends_mm[0] > high_mm {
                break;
            }
            let share = |mm: f64| self.share(leg, mm.clamp(ends_mm[0], ends_mm[1]));
            let (low, high) = (share(low_mm), share(high_mm));
            let part = nearest_part(place, &self.points[leg], &self.points[leg + 1]).clamp(low, high.max(low));
            nearest_mm = nearest_mm.min(distance(place, &self.at(leg, part)));
        }
        nearest_mm
    }

    /// The leg at a place along the line.
    fn leg_at(&self, mm: f64) -> usize {
        let after = self.along_mm.partition_point(|along_mm| *along_mm <= mm);
        after.saturating_sub(1).min(self.points.len().saturating_sub(2))
    }

    /// A place along the line as a fraction of a leg.
    fn share(&self, leg: usize, mm: f64) -> f64 {
        let length_mm = self.along_mm[leg + 1] - self.along_mm[leg];
        if length_mm > 0.0 {
            (mm - self.along_mm[leg]) / length_mm
        } else {
            0.0
        }
    }

    fn at(&self, leg: usize, share: f64) -> Position {
        between(&self.points[leg], &self.points[leg + 1], share)
    }

    /// A fraction of a leg as a place along the line, mm.
    fn along(&self, leg: usize, share: f64) -> f64 {
        self.along_mm[leg] + share * (self.along_mm[leg + 1] - self.along_mm[leg])
    }

    /// Matches positions with the line in order; the first one may be anywhere between two places along the line, mm.
    ///
    /// A line without a leg, or no position, gives an empty match at an infinite distance.
    #[must_use]
    pub fn follow(&self, steps: &[Step], first_mm: [f64; 2]) -> Match {
        let nothing = Match {
            distance_mm: f64::INFINITY,
            places_mm: Vec::new(),
        };
        if self.points.len() < 2 || steps.is_empty() {
            return nothing;
        }
        let mut enough_mm = FIRST_MM;
        let mut reached = loop {
            match self.reach(steps, first_mm, enough_mm) {
                Some(reached) => break reached,
                None if enough_mm > LARGEST_MM => return nothing,
                None => enough_mm *= 4.0,
            }
        };
        let mut few_mm = if enough_mm > FIRST_MM { 0.25 * enough_mm } else { 0.0 };
        while enough_mm - few_mm > PRECISION_MM {
            let middle_mm = 0.5 * (few_mm + enough_mm);
            match self.reach(steps, first_mm, middle_mm) {
                Some(closer) => (enough_mm, reached) = (middle_mm, closer),
                None => few_mm = middle_mm,
            }
        }
        Match {
            distance_mm: enough_mm,
            places_mm: self.places(steps, &reached),
        }
    }

    /// The parts of the line that each position can reach within a distance; `None` if one position reaches nothing.
    fn reach(&self, steps: &[Step], first_mm: [f64; 2], reach_mm: f64) -> Option<Vec<Reach>> {
        let mut reached: Vec<Reach> = Vec::with_capacity(steps.len());
        for (index, step) in steps.iter().enumerate() {
            let next = match (reached.last(), step.unseen_mm) {
                (None, _) => self.free(&step.position, first_mm, reach_mm),
                (Some(last), Some(unseen_mm)) => {
                    let low_mm = last.first().map_or(0.0, |(leg, ends)| self.along(*leg, ends[0]));
                    let high_mm = last.last().map_or(0.0, |(leg, ends)| self.along(*leg, ends[1]));
                    self.free(&step.position, [low_mm - BACK_MM, high_mm + unseen_mm], reach_mm)
                }
                (Some(last), None) => self.advance(last, &steps[index - 1].position, &step.position, reach_mm),
            };
            if next.is_empty() {
                return None;
            }
            reached.push(next);
        }
        Some(reached)
    }

    /// All parts of the line between two places along it that are within a distance of a position.
    fn free(&self, position: &Position, [low_mm, high_mm]: [f64; 2], reach_mm: f64) -> Reach {
        let low_mm = low_mm.clamp(0.0, self.length_mm());
        let high_mm = high_mm.clamp(low_mm, self.length_mm());
        let mut result = Reach::new();
        for leg in self.leg_at(low_mm)..self.points.len() - 1 {
            if self.along_mm[leg] > high_mm {
                break;
            }
            let Some([from, to]) = within(position, &self.points[leg], &self.points[leg + 1], reach_mm) else {
                continue;
            };
            let share = |mm: f64| self.share(leg, mm.clamp(self.along_mm[leg], self.along_mm[leg + 1]));
            let from = from.max(share(low_mm));
            let to = if high_mm < self.along_mm[leg + 1] {
                to.min(share(high_mm))
            } else {
                to
            };
            if from <= to {
                result.push((leg, [from, to]));
            }
        }
        result
    }

    /// The parts that the next position can reach, through the cells between two positions and the line's legs.
    fn advance(&self, last: &Reach, from: &Position, to: &Position, reach_mm: f64) -> Reach {
        let mut result = Reach::new();
        let mut starts = last.iter().peekable();
        // The earliest part of the motion from which the leg's first point can be reached from the previous leg.
        let mut below: Option<f64> = None;
        let mut leg = starts.peek().map_or(0, |(leg, _)| *leg);
        while leg + 1 < self.points.len() {
            let left = starts.next_if(|(start, _)| *start == leg).map(|(_, ends)| ends[0]);
            let (a, b) = (&self.points[leg], &self.points[leg + 1]);
            if left.is_some() || below.is_some() {
                if let Some([low, high]) = within(to, a, b, reach_mm) {
                    let low = match (below, left) {
                        (None, Some(left)) => low.max(left),
                        _ => low,
                    };
                    if low <= high {
                        result.push((leg, [low, high]));
                    }
                }
                below = within(b, from, to, reach_mm).and_then(|[low, high]| match (left, below) {
                    (None, Some(below)) => (low.max(below) <= high).then_some(low.max(below)),
                    _ => Some(low),
                });
            }
            leg = match (below, starts.peek()) {
                (Some(_), _) => leg + 1,
                (None, Some((start, _))) => *start,
                (None, None) => break,
            };
        }
        result
    }

    /// Backwards from the last position: for each the nearest reachable place that is not after the next position's
    /// place.
    fn places(&self, steps: &[Step], reached: &[Reach]) -> Vec<f64> {
        let mut places_mm = vec![0.0; steps.len()];
        let mut limit_mm = f64::INFINITY;
        for (index, (step, reach)) in steps.iter().zip(reached).enumerate().rev() {
            let mut best = (f64::INFINITY, limit_mm.min(self.length_mm()));
            for &(leg, [low, high]) in reach {
                let low_mm = self.along(leg, low);
                if low_mm > limit_mm + PRECISION_MM {
                    break;
                }
                let high = high.min(self.share(leg, limit_mm.min(self.along_mm[leg + 1]))).max(low);
                let part = nearest_part(&step.position, &self.points[leg], &self.points[leg + 1]).clamp(low, high);
                let away_mm = distance(&step.position, &self.at(leg, part));
                // The later one of two equal places leaves more room for the earlier positions.
                if away_mm <= best.0 + PRECISION_MM * 0.01 {
                    best = (away_mm, self.along(leg, part));
                }
            }
            places_mm[index] = best.1;
            limit_mm = best.1 + if step.unseen_mm.is_some() { BACK_MM } else { 0.0 };
        }
        places_mm
    }
}

#[cfg(test)]
mod tests;
