//! Result of verifying a drawing: what the pen followed, what is missing and what is not verified.

use super::parts::Parts;
use crate::job::error::JobError;

/// Least total length of a stroke's missing parts that counts, mm: less is a dot at its ends.
const MISSING_MIN_MM: f64 = 0.5;
/// What is drawn again before a part that is missing at the end, mm: lengths along a stroke are those without its noise.
const BEFORE_TAIL_MM: f64 = 1.0;
/// Length below which a difference counts as rounding, mm.
const ROUNDING_MM: f64 = 1e-6;

/// A stroke and where it lies among all strokes.
#[derive(Clone, Debug)]
pub(super) struct VerifiedStroke {
    pub(super) number: u32,
    /// The first of its vertices in the path.
    pub(super) vertex: u32,
    /// Length of all strokes before it without their noise, mm.
    pub(super) begin_mm: f64,
    /// Its length without its noise, mm.
    pub(super) length_mm: f64,
    /// Its length in the path divided by `length_mm`, for the lengths of a verdict. Noise is not spread evenly: it says nothing
    /// about places.
    pub(super) scale: f64,
    /// Where its first point is in the path.
    pub(super) first_point: u32,
    /// Where each of its points is along it without its noise, the first among them, mm.
    pub(super) points_mm: Vec<f32>,
}

impl VerifiedStroke {
    /// Vertices of the path before a place along it.
    fn vertices_before(&self, along_mm: f64) -> usize {
        let points = self
            .points_mm
            .partition_point(|mm| f64::from(*mm) <= along_mm - BEFORE_TAIL_MM);
        match points {
            0 | 1 => self.vertex as usize,
            points => self.first_point as usize + points,
        }
    }

    /// Whether so much of it is more than a dot at its ends.
    fn lacks(&self, missing_mm: f64) -> bool {
        missing_mm > 0.0 && missing_mm >= MISSING_MIN_MM.min(0.5 * self.length_mm)
    }
}

/// Result of verifying the telemetry of a drawing; results of several connections can be merged.
#[derive(Clone, Debug, Default)]
pub struct Verification {
    pub(super) strokes: Vec<VerifiedStroke>,
    pub(super) followed: Parts,
    /// Parts where the pen was elsewhere, or which it skipped.
    pub(super) off: Parts,
}

/// Verdict on a drawing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Verdict {
    /// Length of all strokes, mm.
    pub total_mm: f64,
    /// Length that the pen followed, mm.
    pub followed_mm: f64,
    /// Length that the pen did not follow, mm.
    pub missing_mm: f64,
    /// Length without telemetry, mm.
    pub unverified_mm: f64,
    /// Strokes with a missing part, by their numbers in the path, from 0.
    pub strokes: Vec<u32>,
    /// Vertices of the path before the first of those strokes.
    pub complete_vertices: u32,
}

impl Verdict {
    /// Why the drawing is incomplete, if a part of it is missing.
    #[must_use]
    pub fn error(&self) -> Option<JobError> {
        Some(JobError::NotFollowed {
            missing_mm: self.missing_mm,
            total_mm: self.total_mm,
            first: *self.strokes.first()?,
            last: *self.strokes.last()?,
            strokes: self.strokes.len(),
        })
    }
}

impl Verification {
    /// Adds the result of another connection for this path.
    pub fn merge(&mut self, other: &Self) {
        if self.strokes.is_empty() {
            self.strokes.clone_from(&other.strokes);
        }
        self.followed.extend(&other.followed);
        self.off.extend(&other.off);
    }

    /// Vertices before the first stroke of which a part is missing. If the pen was beside it up to the place where the telemetry
    /// ends, as in a stop that left the path, those before its first missing part. Looks at the parts where the pen was
    /// elsewhere only.
    #[must_use]
    pub fn complete_vertices(&self) -> Option<usize> {
        let reached_mm = self.followed.end_mm().max(self.off.end_mm());
        let (mut stroke_at, mut missing_mm, mut missing_from_mm) = (usize::MAX, 0.0, None);
        for [from_mm, to_mm] in self.off.iter() {
            let is_last = to_mm >= reached_mm;
            let first = self
                .strokes
                .partition_point(|stroke| stroke.begin_mm + stroke.length_mm <= from_mm);
            let touched = self.strokes.iter().enumerate().skip(first);
            for (at, stroke) in touched.take_while(|(_, stroke)| stroke.begin_mm < to_mm) {
                if at != stroke_at {
                    (stroke_at, missing_mm, missing_from_mm) = (at, 0.0, None);
                }
                let begin_mm = from_mm.max(stroke.begin_mm);
                let end_mm = to_mm.min(stroke.begin_mm + stroke.length_mm);
                let part_mm = end_mm - begin_mm - self.followed.length_between(begin_mm, end_mm);
                if part_mm <= ROUNDING_MM {
                    continue;
                }
                missing_mm += part_mm;
                let missing_from_mm = *missing_from_mm.get_or_insert(begin_mm);
                if stroke.lacks(missing_mm) {
                    return Some(match is_last {
                        true => stroke.vertices_before(missing_from_mm - stroke.begin_mm),
                        false => stroke.vertex as usize,
                    });
                }
            }
        }
        None
    }

    /// The verdict.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        let mut verdict = Verdict::default();
        let mut either = self.followed.clone();
        either.extend(&self.off);
        for stroke in &self.strokes {
            let (from_mm, to_mm) = (stroke.begin_mm, stroke.begin_mm + stroke.length_mm);
            let followed_mm = self.followed.length_between(from_mm, to_mm);
            let seen_mm = either.length_between(from_mm, to_mm);
            // Rounding may make the differences of sums slightly negative.
            let missing_mm = (seen_mm - followed_mm).max(0.0);
            verdict.total_mm += stroke.scale * stroke.length_mm;
            verdict.followed_mm += stroke.scale * followed_mm;
            verdict.unverified_mm += stroke.scale * (stroke.length_mm - seen_mm).max(0.0);
            if !stroke.lacks(missing_mm) {
                continue;
            }
            verdict.missing_mm += stroke.scale * missing_mm;
            if verdict.strokes.is_empty() {
                verdict.complete_vertices = stroke.vertex;
            }
            if verdict.strokes.last() != Some(&stroke.number) {
                verdict.strokes.push(stroke.number);
            }
        }
        if verdict.unverified_mm < ROUNDING_MM {
            verdict.unverified_mm = 0.0;
        }
        verdict
    }
}

#[cfg(test)]
impl Verification {
    /// What a connection saw of ten strokes of ten vertices and ten millimetres: the pen has followed those in `seen` but one.
    pub(crate) fn of_strokes(seen: std::ops::Range<u32>, missing: Option<u32>) -> Self {
        let mut verification = Self::default();
        for number in 0..10 {
            let begin_mm = 10.0 * f64::from(number);
            verification.strokes.push(VerifiedStroke {
                number,
                vertex: 10 * number,
                begin_mm,
                length_mm: 10.0,
                scale: 1.0,
                first_point: 10 * number,
                points_mm: (0..10_u8).map(|point| 10.0 / 9.0 * f32::from(point)).collect(),
            });
            if !seen.contains(&number) {
                continue;
            }
            let parts = match missing == Some(number) {
                true => &mut verification.off,
                false => &mut verification.followed,
            };
            parts.add(begin_mm, begin_mm + 10.0);
        }
        verification
    }
}
