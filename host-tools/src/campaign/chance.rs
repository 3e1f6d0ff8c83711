//! Chances of an episode, from its seed.

use etherpen_segment::random::Random;

/// Chances of an episode.
pub(super) struct Chance(Random);

impl Chance {
    pub(super) fn new(seed: u64) -> Self {
        Self(Random::new(seed))
    }

    /// A number below a bound.
    pub(super) fn below(&mut self, bound: u64) -> u64 {
        self.0.bits() % bound.max(1)
    }

    /// Whether something of one chance in `count` happens.
    pub(super) fn one_in(&mut self, count: u64) -> bool {
        self.below(count) == 0
    }

    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.unit()
    }

    /// A value spread evenly over the scales between two positive values.
    pub(super) fn scaled(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.0.unit())
    }

    /// Milliseconds, spread over the scales up to `most`.
    pub(super) fn milliseconds(&mut self, most: u32) -> u32 {
        self.scaled(1.0, f64::from(most)) as u32
    }

    pub(super) fn one_of<T: Clone>(&mut self, values: &[T]) -> T {
        values[self.below(values.len() as u64) as usize].clone()
    }
}
