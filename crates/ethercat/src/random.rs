//! Random numbers for the tests: xorshift with 32 bits of state (Marsaglia, 2003).

use std::println;

/// The generator; it prints its first state, so that a failing test can be repeated.
pub(crate) struct Random(u32);

impl Random {
    /// A generator that starts with `state`, which must not be 0.
    pub(crate) fn new(state: u32) -> Self {
        println!("seed {state:#x}");
        Self(state)
    }

    /// The next 32 bits.
    pub(crate) fn next(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        self.0
    }
}
