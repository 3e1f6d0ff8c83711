//! What the checks found: what is proved, how much of each limit is used, and a witness of everything else.

use crate::interval::Interval;
use crate::limits::Quantity;
use std::collections::BTreeMap;

/// Why a limit is not proved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// At the witness's time the exact value is over the limit.
    Violated,
    /// The bounds are not tight enough to decide.
    NotProved,
}

/// A finding on a stretch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Found {
    pub(crate) kind: Kind,
    pub(crate) quantity: Quantity,
    pub(crate) parameter: f64,
    pub(crate) value: Interval,
    pub(crate) limit: f64,
}

/// A limit that is not proved, with its witness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refusal {
    /// Why.
    pub kind: Kind,
    /// The limited quantity.
    pub quantity: Quantity,
    /// Number of the stretch, from 0.
    pub stretch: usize,
    /// Vertices of the path executed where its piece of the path begins.
    pub vertex: u32,
    /// Time from the beginning of the path, s.
    pub time_s: f64,
    /// Parameter of the stretch's curve.
    pub parameter: f64,
    /// Lower and upper bound of the value: at this parameter for a violation, around it otherwise.
    pub value: [f64; 2],
    /// The configured limit, without the excess.
    pub limit: f64,
}

/// Largest part of a limit that a motion uses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Use {
    /// The motion reaches this part.
    pub least: f64,
    /// The motion stays below this part.
    pub most: f64,
}

/// Result for a whole motion.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Certificate {
    /// Stretches of the motion.
    pub stretches: usize,
    /// Boxes into which they were divided.
    pub boxes: usize,
    /// Duration of the motion, s.
    pub duration_s: f64,
    /// Largest part of each limit that is used, among the proved boxes.
    pub uses: BTreeMap<Quantity, Use>,
    /// Largest bound of what the moving average adds to the distance from the path, mm.
    pub average_mm: f64,
    /// Limits that are not proved, the first ones.
    pub refusals: Vec<Refusal>,
    /// Number of all violations.
    pub violations: usize,
    /// Number of all limits that could not be decided.
    pub undecided: usize,
}

/// Most refusals that are listed.
const LISTED_MAX: usize = 200;

impl Certificate {
    /// Whether every limit is proved.
    #[must_use]
    pub fn is_proved(&self) -> bool {
        self.violations == 0 && self.undecided == 0
    }

    pub(crate) fn note(&mut self, quantity: Quantity, [least, most]: [f64; 2]) {
        let used = self.uses.entry(quantity).or_default();
        used.least = used.least.max(least);
        used.most = used.most.max(most);
    }

    pub(crate) fn refuse(&mut self, refusal: Refusal) {
        match refusal.kind {
            Kind::Violated => self.violations += 1,
            Kind::NotProved => self.undecided += 1,
        }
        if self.refusals.len() < LISTED_MAX {
            self.refusals.push(refusal);
        }
    }
}
