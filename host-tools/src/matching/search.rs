//! Incremental search for the least distance at which positions follow a line.
//!
//! A distance is tried position by position: which parts of the line can each position reach within the distance,
//! without going back? The number of those parts can be as large as the number of legs near the position, so a search
//! counts each look at a leg and each part kept, and gives up beyond its limits.
//!
//! Invariants: one call takes no more looks than allowed, plus at most those of the parts of one position. The result
//! does not depend on how the looks are divided among calls. No more than twice the limit of parts are kept.

use super::{BACK_MM, Match, PRECISION_MM, Polyline, Step, distance, nearest_part, within};
use etherpen::robots::Position;

/// Smallest distance tried first, mm.
const FIRST_MM: f64 = 0.02;
/// Largest distance tried, mm.
const LARGEST_MM: f64 = 1e5;
/// If too many parts would be kept at a distance, smaller ones are tried until it is this close to one that is too
/// small, mm.
const CLOSER_MM: f64 = 0.02;

/// Limits on the cost of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchLimits {
    /// Looks at a leg from a position.
    pub looks: usize,
    /// Parts of the line kept for all positions together, at one distance.
    pub parts: usize,
    /// Parts of the line kept for one position.
    pub parts_at_once: usize,
}

impl SearchLimits {
    /// No limit.
    pub const NONE: Self = Self {
        looks: usize::MAX,
        parts: usize::MAX,
        parts_at_once: usize::MAX,
    };
}

/// Progress of a search.
#[derive(Clone, Debug, PartialEq)]
pub enum SearchProgress {
    /// More looks are needed.
    Unfinished,
    /// The match. It is empty, at an infinite distance, for a line without legs and for no positions.
    Found(Match),
    /// The search would exceed its limits.
    TooMuch,
}

/// A part of the line that a position can reach: a leg, and start and end as fractions of it.
type Part = (u32, [f64; 2]);

/// The parts of the line that the positions can reach.
#[derive(Debug, Default)]
struct Reached {
    parts: Vec<Part>,
    /// Where the parts of each position end.
    ends: Vec<usize>,
}

impl Reached {
    /// Where the parts of a position begin.
    fn begin(&self, index: usize) -> usize {
        index.checked_sub(1).map_or(0, |before| self.ends[before])
    }

    fn of(&self, index: usize) -> &[Part] {
        &self.parts[self.begin(index)..self.ends[index]]
    }

    fn clear(&mut self) {
        self.parts.clear();
        self.ends.clear();
    }
}

/// Where a pass along the legs continues.
#[derive(Clone, Copy, Debug)]
struct Scan {
    leg: usize,
    /// The first part of the previous position that has not been passed.
    start: usize,
    /// The earliest part of the motion from which the leg's first point can be reached, from the previous leg.
    below: Option<f64>,
}

/// Matches positions with a line, in order.
#[derive(Debug)]
pub struct Search {
    steps: Vec<Step>,
    first_mm: [f64; 2],
    limits: SearchLimits,
    looks: usize,
    /// The largest distance known to be too small, mm.
    too_small_mm: f64,
    /// The smallest distance known to be enough, mm.
    sufficient_mm: Option<f64>,
    /// The smallest distance at which too many parts would be kept, mm.
    too_costly_mm: f64,
    /// The distance being tried, mm.
    reach_mm: f64,
    trial: Reached,
    /// What can be reached within the smallest distance known to be enough.
    found: Reached,
    scan: Option<Scan>,
    is_too_much: bool,
    /// Whether the distance is known and places are being assigned, from the last position back.
    is_placing: bool,
    places_mm: Vec<f64>,
    /// Positions without a place.
    unplaced: usize,
    /// The place that the next position must not exceed, mm.
    limit_mm: f64,
}

impl Search {
    /// A search for positions whose first one is anywhere between two places along the line, mm.
    #[must_use]
    pub fn new(steps: Vec<Step>, first_mm: [f64; 2], limits: SearchLimits) -> Self {
        Self {
            unplaced: steps.len(),
            places_mm: vec![0.0; steps.len()],
            steps,
            first_mm,
            limits,
            looks: 0,
            too_small_mm: 0.0,
            sufficient_mm: None,
            too_costly_mm: f64::INFINITY,
            reach_mm: FIRST_MM,
            trial: Reached::default(),
            found: Reached::default(),
            scan: None,
            is_too_much: false,
            is_placing: false,
            limit_mm: f64::INFINITY,
        }
    }

    /// Looks at a leg so far.
    #[must_use]
    pub fn looks(&self) -> usize {
        self.looks
    }

    /// Parts for which memory is reserved.
    #[cfg(test)]
    pub(crate) fn parts_reserved(&self) -> usize {
        self.trial.parts.capacity() + self.found.parts.capacity()
    }

    /// Continues with at most `looks` looks, always on the same line.
    pub fn go_on(&mut self, line: &Polyline, looks: usize) -> SearchProgress {
        let nothing = Match {
            distance_mm: f64::INFINITY,
            places_mm: Vec::new(),
        };
        if line.points.len() < 2 || self.steps.is_empty() {
            return SearchProgress::Found(nothing);
        }
        let until = self.looks.saturating_add(looks).min(self.limits.looks);
        while !self.is_placing {
            let Some(is_enough) = self.try_distance(line, until) else {
                if self.is_too_much && self.try_closer() {
                    continue;
                }
                return self.interrupted();
            };
            if !self.conclude(is_enough) {
                return SearchProgress::Found(nothing);
            }
        }
        while self.unplaced > 0 {
            if self.looks >= until {
                return self.interrupted();
            }
            self.place_last(line);
        }
        SearchProgress::Found(Match {
            distance_mm: self.sufficient_mm.unwrap_or(f64::INFINITY),
            places_mm: std::mem::take(&mut self.places_mm),
        })
    }

    fn interrupted(&self) -> SearchProgress {
        if self.is_too_much || self.looks >= self.limits.looks {
            SearchProgress::TooMuch
        } else {
            SearchProgress::Unfinished
        }
    }

    /// Chooses the next distance; returns false if no distance is enough.
    fn conclude(&mut self, is_enough: bool) -> bool {
        if is_enough {
            self.sufficient_mm = Some(self.reach_mm);
            std::mem::swap(&mut self.found, &mut self.trial);
        } else {
            self.too_small_mm = self.reach_mm;
        }
        self.trial.clear();
        self.scan = None;
        match self.sufficient_mm {
            Some(sufficient_mm) if sufficient_mm - self.too_small_mm > PRECISION_MM => {
                self.reach_mm = 0.5 * (self.too_small_mm + sufficient_mm);
            }
            Some(_) => self.is_placing = true,
            None if self.reach_mm > LARGEST_MM => return false,
            None if self.too_costly_mm.is_finite() => self.is_too_much = !self.halve(),
            None => self.reach_mm *= 4.0,
        }
        true
    }

    /// Continues with a smaller distance than one at which too many parts would be kept; returns whether there is one.
    fn try_closer(&mut self) -> bool {
        self.too_costly_mm = self.too_costly_mm.min(self.reach_mm);
        let may = self.sufficient_mm.is_none() && self.halve();
        if may {
            self.is_too_much = false;
            self.scan = None;
            self.trial.clear();
        }
        may
    }

    /// Chooses a distance between one that is too small and one at which too many parts would be kept; returns whether
    /// they are far enough apart.
    fn halve(&mut self) -> bool {
        self.reach_mm = 0.5 * (self.too_small_mm + self.too_costly_mm);
        self.too_costly_mm - self.too_small_mm > CLOSER_MM
    }

    /// Whether each position reaches a part of the line; `None` if the looks are used up first.
    fn try_distance(&mut self, line: &Polyline, until: usize) -> Option<bool> {
        while self.trial.ends.len() < self.steps.len() {
            let index = self.trial.ends.len();
            let is_whole = match self.span(line, index) {
                Some(span_mm) => self.look_between(line, index, span_mm, until),
                None => self.look_on(line, index, until),
            };
            if !is_whole {
                return None;
            }
            self.scan = None;
            if self.trial.begin(index) == self.trial.parts.len() {
                return Some(false);
            }
            self.trial.ends.push(self.trial.parts.len());
        }
        Some(true)
    }

    /// The range along the line for a position that does not follow another one continuously, mm.
    fn span(&self, line: &Polyline, index: usize) -> Option<[f64; 2]> {
        let Some(before) = index.checked_sub(1) else {
            return Some(self.first_mm);
        };
        let unseen_mm = self.steps[index].unseen_mm?;
        let last = self.trial.of(before);
        let low_mm = last
            .first()
            .map_or(0.0, |(leg, ends)| line.along(*leg as usize, ends[0]));
        let high_mm = last
            .last()
            .map_or(0.0, |(leg, ends)| line.along(*leg as usize, ends[1]));
        Some([low_mm - BACK_MM, high_mm + unseen_mm])
    }

    /// Counts a look at a leg; returns false if none is left.
    fn may_look(&mut self, until: usize) -> bool {
        let may = self.looks < until && !self.is_too_much;
        self.looks += usize::from(may);
        may
    }

    fn keep(&mut self, begin: usize, leg: usize, ends: [f64; 2]) {
        let kept = self.trial.parts.len();
        if kept >= self.limits.parts || kept - begin >= self.limits.parts_at_once {
            self.is_too_much = true;
        } else {
            self.trial.parts.push((leg as u32, ends));
        }
    }

    /// Keeps all parts between two places along the line that are near enough to a position; returns false if the looks
    /// are used up first.
    fn look_between(&mut self, line: &Polyline, index: usize, [low_mm, high_mm]: [f64; 2], until: usize) -> bool {
        let low_mm = low_mm.clamp(0.0, line.length_mm());
        let high_mm = high_mm.clamp(low_mm, line.length_mm());
        let (position, begin) = (self.steps[index].position, self.trial.begin(index));
        let mut leg = self.scan.map_or_else(|| line.leg_at(low_mm), |scan| scan.leg);
        while leg + 1 < line.points.len() && line.along_mm[leg] <= high_mm {
            if !self.may_look(until) {
                let (start, below) = (begin, None);
                self.scan = Some(Scan { leg, start, below });
                return false;
            }
            if let Some([from, to]) = within(&position, &line.points[leg], &line.points[leg + 1], self.reach_mm) {
                let share = |mm: f64| line.share(leg, mm.clamp(line.along_mm[leg], line.along_mm[leg + 1]));
                let from = from.max(share(low_mm));
                let to = if high_mm < line.along_mm[leg + 1] {
                    to.min(share(high_mm))
                } else {
                    to
                };
                if from <= to {
                    self.keep(begin, leg, [from, to]);
                }
            }
            leg += 1;
        }
        !self.is_too_much
    }

    /// Keeps what a position can reach from the previous one, through the cells between the two and the line's legs;
    /// returns false if the looks are used up first.
    fn look_on(&mut self, line: &Polyline, index: usize, until: usize) -> bool {
        let (first, begin) = (self.trial.begin(index - 1), self.trial.begin(index));
        let (from, to): (Position, Position) = (self.steps[index - 1].position, self.steps[index].position);
        let reach_mm = self.reach_mm;
        let mut scan = self.scan.unwrap_or(Scan {
            leg: self.trial.parts[first].0 as usize,
            start: first,
            below: None,
        });
        while scan.leg + 1 < line.points.len() {
            if !self.may_look(until) {
                self.scan = Some(scan);
                return false;
            }
            let next = self.trial.parts.get(scan.start).filter(|_| scan.start < begin);
            let left = next
                .filter(|(leg, _)| *leg as usize == scan.leg)
                .map(|(_, ends)| ends[0]);
            scan.start += usize::from(left.is_some());
            let (a, b) = (&line.points[scan.leg], &line.points[scan.leg + 1]);
            if let Some([low, high]) = within(&to, a, b, reach_mm) {
                let low = match (scan.below, left) {
                    (None, Some(left)) => low.max(left),
                    _ => low,
                };
                if low <= high {
                    self.keep(begin, scan.leg, [low, high]);
                }
            }
            scan.below = within(b, &from, &to, reach_mm).and_then(|[low, high]| match (left, scan.below) {
                (None, Some(below)) => (low.max(below) <= high).then_some(low.max(below)),
                _ => Some(low),
            });
            let next = self.trial.parts.get(scan.start).filter(|_| scan.start < begin);
            scan.leg = match (scan.below, next) {
                (Some(_), _) => scan.leg + 1,
                (None, Some((leg, _))) => *leg as usize,
                (None, None) => break,
            };
        }
        !self.is_too_much
    }

    /// Places the last position without a place: at the nearest reachable place that is not after the next position's.
    fn place_last(&mut self, line: &Polyline) {
        let index = self.unplaced - 1;
        let step = &self.steps[index];
        let limit_mm = self.limit_mm;
        let mut best = (f64::INFINITY, limit_mm.min(line.length_mm()));
        for &(leg, [low, high]) in self.found.of(index) {
            self.looks += 1;
            let leg = leg as usize;
            if line.along(leg, low) > limit_mm + PRECISION_MM {
                break;
            }
            let high = high.min(line.share(leg, limit_mm.min(line.along_mm[leg + 1]))).max(low);
            let part = nearest_part(&step.position, &line.points[leg], &line.points[leg + 1]).clamp(low, high);
            let away_mm = distance(&step.position, &line.at(leg, part));
            // The later one of two equal places leaves more room for those before.
            if away_mm <= best.0 + PRECISION_MM * 0.01 {
                best = (away_mm, line.along(leg, part));
            }
        }
        self.places_mm[index] = best.1;
        self.limit_mm = best.1 + if step.unseen_mm.is_some() { BACK_MM } else { 0.0 };
        self.unplaced = index;
    }
}
