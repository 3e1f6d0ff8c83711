//! Seeded generators of random numbers, so that every run can be repeated.
//!
//! [`Random`] is the generator of the virtual segment and cell, and of photographs' lines. The others are kept for
//! tests and where a sequence determines a drawing or a measured path.

pub use etherpen_segment::random::Random;

/// A linear congruential generator with 64 bits of state (Knuth, MMIX).
#[derive(Clone, Debug)]
pub struct Lcg {
    state: u64,
}

impl Lcg {
    /// A generator with this seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { state: seed }
    }

    /// The next 31 bits.
    pub fn bits(&mut self) -> u64 {
        self.state = self
            .state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        self.state >> 33
    }

    /// A number from 0 (included) to 1 (excluded).
    pub fn unit(&mut self) -> f64 {
        self.bits() as f64 / (1_u64 << 31) as f64
    }

    /// A number from `low` (included) to `high` (excluded).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// A whole number below `bound`, which is not 0.
    pub fn below(&mut self, bound: usize) -> usize {
        self.bits() as usize % bound
    }
}

/// Xorshift with 64 bits of state (Marsaglia, 2003).
#[derive(Clone, Debug)]
pub struct Xorshift {
    state: u64,
}

impl Xorshift {
    /// A generator with this seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            state: seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1,
        }
    }

    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.state ^= self.state << 13;
        self.state ^= self.state >> 7;
        self.state ^= self.state << 17;
        self.state
    }

    /// The next 53 bits, each of which depends on all bits of the state.
    pub fn scrambled(&mut self) -> u64 {
        self.bits().wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11
    }

    /// A number from 0 (included) to 1 (excluded).
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Xorshift64* (Vigna, 2016).
#[derive(Clone, Debug)]
pub struct XorshiftStar {
    state: u64,
}

impl XorshiftStar {
    /// A generator that starts with this state, which is not 0.
    #[must_use]
    pub fn new(state: u64) -> Self {
        Self { state }
    }

    /// A whole number below `bound`, which is not 0.
    pub fn below(&mut self, bound: u64) -> u64 {
        self.state ^= self.state >> 12;
        self.state ^= self.state << 25;
        self.state ^= self.state >> 27;
        (self.state.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 33) % bound
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sequences_are_those_of_the_definitions() {
        let mut lcg = Lcg::new(0);
        assert_eq!(lcg.bits(), 1_442_695_040_888_963_407 >> 33);
        let mut star = XorshiftStar::new(1);
        assert_eq!(star.below(u64::MAX), 5_180_492_295_206_395_165 >> 33);
    }

    #[test]
    fn numbers_are_within_their_bounds() {
        let (mut lcg, mut xorshift) = (Lcg::new(1), Xorshift::new(1));
        for _ in 0..10_000 {
            assert!((0.0..1.0).contains(&xorshift.unit()));
            assert!((-2.0..3.0).contains(&lcg.between(-2.0, 3.0)));
            assert!(lcg.below(7) < 7);
        }
    }
}
