//! A tapped delay line: sums the copies of the path's points that an input shaper asks for.

use super::Pen;
use super::shaping::Label;
use crate::robots::vector::Vector;
use crate::settings::MotionLimits;
use crate::settings::TICK_S;
use crate::settings::input_shaper::{COPIES, Copies};

/// A copy that does not fall on a millisecond is split between the two beside it.
const TAPS: usize = 2 * COPIES;
/// Milliseconds that are kept: four half periods of the lowest frequency at the highest damping, and one for the split.
const KEPT: usize = 104;

/// A point of the path with its attributes.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PathSample {
    pub(crate) point: Vector,
    /// Angle of the fourth axis, rad.
    pub(crate) heading: f64,
    pub(crate) label: Label,
}

impl PathSample {
    pub(crate) const NONE: Self = Self {
        point: [0.0; 3],
        heading: 0.0,
        label: Label::NONE,
    };
}

/// A part of a copy: how many milliseconds it is late, and its weights over the paper, and in height and for the fourth axis.
#[derive(Clone, Copy, Debug)]
struct Tap {
    late: usize,
    level: f64,
    plain: f64,
}

impl Tap {
    const NONE: Self = Self {
        late: 0,
        level: 0.0,
        plain: 0.0,
    };
}

/// Sums delayed copies. Without a shaper the newest point passes.
#[derive(Clone, Debug)]
pub(crate) struct DelayLine {
    taps: [Tap; TAPS],
    used: usize,
    /// Milliseconds from the first copy to the last one.
    length: usize,
    /// Mean delay of the copies, ms; vertices are reached so much later.
    lag: usize,
    /// Milliseconds until the last copy of the stroke has come, and the stroke's number.
    drawn_ms: usize,
    drawn: u32,
    kept: [PathSample; KEPT],
    newest: usize,
    /// Milliseconds until the sum is at rest once the points are.
    settling_ms: usize,
}

impl DelayLine {
    /// A line without an input shaper. All of its bits are zero.
    pub(crate) const fn new() -> Self {
        Self {
            taps: [Tap::NONE; TAPS],
            used: 0,
            length: 0,
            lag: 0,
            drawn_ms: 0,
            drawn: 0,
            kept: [PathSample::NONE; KEPT],
            newest: 0,
            settling_ms: 0,
        }
    }

    /// Takes the copies that the limits ask for. At rest until filled.
    pub(crate) fn configure(&mut self, motion: &MotionLimits) {
        (self.used, self.length, self.lag, self.settling_ms) = (0, 0, 0, 0);
        let Some(copies) = Copies::new(motion) else {
            return;
        };
        let apart_ms = copies.apart_s / TICK_S;
        let weights = copies.weights.into_iter().zip(copies.plain);
        let pairs = self.taps.chunks_exact_mut(2).zip(weights).zip(0_u8..);
        for ((pair, (level, plain)), at) in pairs {
            let late_ms = apart_ms * f64::from(at);
            let late = (late_ms as usize).min(KEPT - 2);
            let second = (late_ms - late as f64).clamp(0.0, 1.0);
            let shares = [(late, 1.0 - second), (late + 1, second)];
            for (tap, (late, share)) in pair.iter_mut().zip(shares) {
                *tap = Tap {
                    late,
                    level: level * share,
                    plain: plain * share,
                };
            }
            if level != 0.0 {
                (self.used, self.length) = (2 * (usize::from(at) + 1), late + 1);
            }
        }
        self.lag = libm::round(copies.mean_s() / TICK_S) as usize;
    }

    /// Every copy stands at this point.
    pub(crate) fn fill(&mut self, sample: &PathSample) {
        self.kept = [*sample; KEPT];
        self.stand();
    }

    /// The sum is at rest; the points are those of [`Self::fill`], which follows unless nothing may move.
    pub(crate) fn stand(&mut self) {
        (self.settling_ms, self.drawn_ms) = (0, 0);
    }

    /// Whether the sum is at rest.
    pub(crate) fn settled(&self) -> bool {
        self.settling_ms == 0
    }

    /// Takes the next point; returns the sum of the copies, with the label that has become valid.
    pub(crate) fn pass(&mut self, sample: &PathSample) -> PathSample {
        if self.used == 0 {
            return *sample;
        }
        let before = self.kept[self.newest];
        self.draws(sample);
        self.settling_ms = if sample.point == before.point && sample.heading == before.heading {
            self.settling_ms.saturating_sub(1)
        } else {
            self.length
        };
        self.newest = (self.newest + 1) % KEPT;
        self.kept[self.newest] = *sample;
        let late = self.back(self.lag).label;
        let label = match self.drawn_ms {
            0 => Label { pen: Pen::Up, ..late },
            _ => Label {
                stroke: self.drawn,
                pen: Pen::Down,
                ..late
            },
        };
        let mut sum = PathSample { label, ..*sample };
        for tap in self.taps.iter().take(self.used) {
            let copy = self.back(tap.late);
            // The differences are zero at rest, where the sum is exactly the point.
            let weights = [tap.level, tap.level, tap.plain];
            for (((sum, late), now), weight) in sum.point.iter_mut().zip(copy.point).zip(sample.point).zip(weights) {
                *sum += weight * (late - now);
            }
            sum.heading += tap.plain * (copy.heading - sample.heading);
        }
        sum
    }

    /// Keeps the pen down from the first copy of a stroke to the last one. Copies that stand together have ended it.
    fn draws(&mut self, sample: &PathSample) {
        if sample.label.pen == Pen::Down {
            (self.drawn_ms, self.drawn) = (self.length, sample.label.stroke);
        } else if self.settling_ms == 0 {
            self.drawn_ms = 0;
        } else {
            self.drawn_ms = self.drawn_ms.saturating_sub(1);
        }
    }

    fn back(&self, late: usize) -> &PathSample {
        &self.kept[(self.newest + KEPT - late.min(KEPT)) % KEPT]
    }
}
