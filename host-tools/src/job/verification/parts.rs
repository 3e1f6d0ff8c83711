//! Parts of a length, such as the verified parts of a drawing.
//!
//! Invariant: parts are in order and do not touch.

/// Parts of a length: from and to, mm, in order and apart.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Parts(Vec<[f64; 2]>);

impl Parts {
    /// The parts, in order.
    pub(super) fn iter(&self) -> impl Iterator<Item = [f64; 2]> {
        self.0.iter().copied()
    }

    /// Where the last part ends, mm; 0 without parts.
    pub(super) fn end_mm(&self) -> f64 {
        self.0.last().map_or(0.0, |part| part[1])
    }

    pub(super) fn add(&mut self, from_mm: f64, to_mm: f64) {
        if to_mm <= from_mm {
            return;
        }
        let first = self.0.partition_point(|part| part[1] < from_mm);
        let after = self.0.partition_point(|part| part[0] <= to_mm);
        let touched = self.0.get(first..after).unwrap_or_default();
        let low_mm = touched.first().map_or(from_mm, |part| part[0].min(from_mm));
        let high_mm = touched.last().map_or(to_mm, |part| part[1].max(to_mm));
        self.0.splice(first..after.max(first), [[low_mm, high_mm]]);
    }

    pub(super) fn extend(&mut self, other: &Self) {
        let mut parts = std::mem::take(&mut self.0);
        parts.extend_from_slice(&other.0);
        // In order, each one is added at the end.
        parts.sort_by(|a, b| a[0].total_cmp(&b[0]));
        parts.iter().for_each(|part| self.add(part[0], part[1]));
    }

    /// Length of the parts between two places, mm.
    pub(super) fn length_between(&self, from_mm: f64, to_mm: f64) -> f64 {
        let first = self.0.partition_point(|part| part[1] < from_mm);
        let within = self.0.iter().skip(first).take_while(|part| part[0] < to_mm);
        within
            .map(|part| (part[1].min(to_mm) - part[0].max(from_mm)).max(0.0))
            .sum()
    }
}
