//! Matches positions with the line that they should follow, in order along both.
//!
//! A position near a stroke may be near several parts of it: parallel legs, a part that returns along itself, the next
//! turn of a spiral. Only the order shows to which part it belongs. Positions are matched with the line so that neither
//! goes back and the largest distance is the least possible: the Fréchet distance of two polylines, found by bisection
//! between distances that are enough and distances that are not (Alt and Godau, 1995). [`Search`] does that
//! incrementally and within limits: each position is compared with each leg it may belong to, and a line that comes
//! close to itself many times has many of them. [`thinned`] reduces their number.
//!
//! Invariant: places along the line never decrease from one position to the next, except across a break, by at most
//! `BACK_MM`.

mod search;

use etherpen::robots::Position;
pub use search::{Search, SearchLimits, SearchProgress};

/// How far back along the line positions may continue after a break, mm: a pen that is lowered again touches slightly
/// before the place where it was lifted.
const BACK_MM: f64 = 0.5;
/// Precision of the distance, mm.
const PRECISION_MM: f64 = 1e-4;
/// Distance of two places, mm.
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

/// Points of a polyline without those near the point kept before them. Each kept leg is longer than `within_mm`, except
/// the last one and those of a polyline that lies entirely near its first point.
///
/// Both polylines can be followed at the same time, in order, no farther than `within_mm` apart; twice that for a
/// polyline that lies entirely near its first point, whose farthest point is kept as well.
#[must_use]
pub fn thinned(points: &[Position], within_mm: f64) -> Vec<Position> {
    let kept = kept(points, within_mm);
    kept.into_iter()
        .filter_map(|index| points.get(index).copied())
        .collect()
}

/// Indices of the points that [`thinned`] keeps, in order; a single point is kept twice.
#[must_use]
pub fn kept(points: &[Position], within_mm: f64) -> Vec<usize> {
    let (Some(first), Some(last)) = (points.first(), points.last()) else {
        return Vec::new();
    };
    let (mut kept, mut latest) = (vec![0], first);
    for (index, point) in points.iter().enumerate().skip(1) {
        if distance(latest, point) > within_mm {
            kept.push(index);
            latest = point;
        }
    }
    if kept.len() == 1 {
        let away_mm = |point: &Position| distance(first, point);
        let farthest = points
            .iter()
            .enumerate()
            .max_by(|(_, a), (_, b)| away_mm(a).total_cmp(&away_mm(b)));
        if let Some((index, point)) = farthest {
            kept.push(index);
            latest = point;
        }
    }
    if points.len() > 1 && latest != last {
        kept.push(points.len() - 1);
    }
    kept
}

/// The fraction of the segment from `a` to `b` at which it is nearest to a place, 0 to 1.
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
pub struct Polyline {
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

impl Polyline {
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

    /// Distance of each of its points along the line, mm.
    #[must_use]
    pub fn along_mm(&self) -> &[f64] {
        &self.along_mm
    }

    /// Number of its legs.
    #[must_use]
    pub fn legs(&self) -> usize {
        self.points.len().saturating_sub(1)
    }

    /// Distance from a place to the part of the line between two places along it, mm; infinite for a line without legs.
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
}

#[cfg(test)]
mod tests;
