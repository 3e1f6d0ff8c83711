//! Clock steering: the sample's timer follows the bus clock.
//!
//! Every millisecond the frame of the input telegram returns the system time at which it passed the reference clock. A
//! PI loop lengthens or shortens the next period of the timer so that this time keeps its phase: the phase that the bus
//! had when its clocks were set up, to which the slaves' SYNC0 was aligned. No sample ever jumps, neither at the start
//! nor after a repair.
//!
//! Invariants: a correction never exceeds [`CORRECTION_MAX_NS`]; a fault is reported once the clock has been missing
//! for [`MISSING_CYCLES_MAX`] cycles, or once its phase error exceeds the limit after it was locked.

use core::num::NonZeroU32;

/// Largest change of one period of the timer, ns: 1000 ppm, far more than quartz crystals differ.
pub const CORRECTION_MAX_NS: i32 = 1_000;
/// Consecutive cycles without a clock value after which the clock counts as lost.
pub const MISSING_CYCLES_MAX: u8 = 10;
/// Phase error below which the loop locks after [`LOCK_CYCLES`] cycles, ns.
pub const LOCK_ERROR_NS: i32 = 5_000;
/// Consecutive cycles within [`LOCK_ERROR_NS`] after which the loop is locked.
pub const LOCK_CYCLES: u16 = 100;

/// Proportional part: 1/2^n of the phase error a cycle. With the two cycles between measurement and effect the loop
/// stays far from its limit of 1/2.
const PROPORTIONAL_SHIFT: u32 = 4;
/// Integral part: 1/2^n of the sum of phase errors a cycle; a quarter of the square of the proportional part is the
/// aperiodic limit (2^-10).
const INTEGRAL_SHIFT: u32 = 11;
/// The integral part alone never exceeds the largest correction (anti-windup).
const INTEGRAL_MAX: i64 = (CORRECTION_MAX_NS as i64) << INTEGRAL_SHIFT;

const _: () = {
    assert!(INTEGRAL_SHIFT > 2 * PROPORTIONAL_SHIFT + 2, "the loop does not swing");
};

/// Fault of the bus clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockFault {
    /// No clock value arrived for too many cycles.
    Lost {
        /// Consecutive cycles without a value.
        missing_cycles: u8,
        /// Cycles allowed.
        limit_cycles: u8,
    },
    /// The phase left its limit after it was locked.
    Jump {
        /// Phase error, ns.
        error_ns: i32,
        /// Phase error allowed, ns.
        limit_ns: u32,
    },
}

/// Clock input of one millisecond.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClockReading {
    /// System time when the frame passed the reference clock, ns, low 32 bits; `None` when the frame did not come back.
    pub reference_ns: Option<u32>,
    /// Time from the nominal release to the beginning of the sample, ns: compensated, so a late sample does not move
    /// the timer.
    pub elapsed_ns: u32,
}

/// PI loop from the bus clock to the sample's timer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockSteering {
    period_ns: NonZeroU32,
    /// Time expected in this cycle, low 32 bits.
    expected_ns: Option<u32>,
    integral: i64,
    missing_cycles: u8,
    locked_cycles: u16,
    error_ns: i32,
}

impl ClockSteering {
    /// A loop for cycles of `period_ns`, at most 2^31 ns, that keeps the phase of the first time it receives. A period
    /// of 0 counts as 1 ns.
    pub const fn new(period_ns: u32) -> Self {
        Self {
            period_ns: match NonZeroU32::new(period_ns) {
                Some(period_ns) => period_ns,
                None => NonZeroU32::MIN,
            },
            expected_ns: None,
            integral: 0,
            missing_cycles: 0,
            locked_cycles: 0,
            error_ns: 0,
        }
    }

    /// Clears a fault and locks again. Meanwhile the sample returns to its phase by the shorter way, at most half a
    /// period: the slaves' SYNC0 keeps that phase, whatever happens to the time.
    pub fn restart(&mut self) {
        (self.missing_cycles, self.locked_cycles) = (0, 0);
    }

    /// Passes a cycle in which no clock is to be heard; returns the correction as [`Self::step`].
    pub fn coast(&mut self) -> i32 {
        let period_ns = self.period_ns.get();
        self.expected_ns = self.expected_ns.map(|expected| expected.wrapping_add(period_ns));
        self.integral_ns()
    }

    /// Phase error of the last reading, ns: positive when the sample was late.
    pub const fn error_ns(&self) -> i32 {
        self.error_ns
    }

    /// Whether the phase has been within [`LOCK_ERROR_NS`] for [`LOCK_CYCLES`] cycles.
    pub const fn is_locked(&self) -> bool {
        self.locked_cycles >= LOCK_CYCLES
    }

    /// Advances by one cycle; returns the correction of the timer's next period, ns, at most [`CORRECTION_MAX_NS`]
    /// either way.
    pub fn step(&mut self, reading: ClockReading) -> i32 {
        let expected_ns = self
            .expected_ns
            .map(|expected| expected.wrapping_add(self.period_ns.get()));
        let Some(reference_ns) = reading.reference_ns else {
            self.expected_ns = expected_ns;
            self.missing_cycles = self.missing_cycles.saturating_add(1);
            return self.integral_ns();
        };
        self.missing_cycles = 0;
        let released_ns = reference_ns.wrapping_sub(reading.elapsed_ns);
        let expected_ns = match expected_ns {
            None => released_ns,
            Some(expected_ns) if self.is_locked() => expected_ns,
            Some(expected_ns) => same_phase(expected_ns, released_ns, self.period_ns),
        };
        self.expected_ns = Some(expected_ns);
        let error_ns = released_ns.wrapping_sub(expected_ns) as i32;
        self.error_ns = error_ns;
        self.locked_cycles = match error_ns.unsigned_abs() <= LOCK_ERROR_NS.unsigned_abs() {
            true => self.locked_cycles.saturating_add(1),
            false if self.is_locked() => self.locked_cycles,
            false => 0,
        };
        let proportional_ns = i64::from(error_ns) >> PROPORTIONAL_SHIFT;
        let sum = (self.integral + i64::from(error_ns)).clamp(-INTEGRAL_MAX, INTEGRAL_MAX);
        let limit_ns = i64::from(CORRECTION_MAX_NS);
        let wanted_ns = -(proportional_ns + (sum >> INTEGRAL_SHIFT));
        // At the limit the sum is held, so there is no wind-up.
        if wanted_ns.abs() <= limit_ns {
            self.integral = sum;
        }
        wanted_ns.clamp(-limit_ns, limit_ns) as i32
    }

    /// The fault of the clock: lost, or out of phase by more than `limit_ns` after it was locked.
    pub fn fault(&self, limit_ns: u32) -> Option<ClockFault> {
        if self.missing_cycles >= MISSING_CYCLES_MAX {
            return Some(ClockFault::Lost {
                missing_cycles: self.missing_cycles,
                limit_cycles: MISSING_CYCLES_MAX,
            });
        }
        let jumped = self.is_locked() && self.error_ns.unsigned_abs() > limit_ns;
        jumped.then_some(ClockFault::Jump {
            error_ns: self.error_ns,
            limit_ns,
        })
    }

    /// The part of the correction that is kept while no time arrives.
    fn integral_ns(&self) -> i32 {
        -(self.integral >> INTEGRAL_SHIFT) as i32
    }
}

/// The time nearest to `near_ns` that is whole periods away from `time_ns`.
fn same_phase(time_ns: u32, near_ns: u32, period_ns: NonZeroU32) -> u32 {
    let half_ns = period_ns.get() / 2;
    let off_ns = near_ns.wrapping_sub(time_ns).wrapping_add(half_ns).cast_signed();
    let within_ns = off_ns.unsigned_abs() % period_ns;
    let phase_ns = match off_ns < 0 && within_ns > 0 {
        true => period_ns.get() - within_ns,
        false => within_ns,
    };
    near_ns.wrapping_sub(phase_ns).wrapping_add(half_ns)
}

/// Converts corrections in ns to whole timer counts; the remainder is kept for the next correction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CountCorrection {
    counts_per_us: u32,
    /// Remainder, ns times counts per microsecond.
    rest: i32,
}

/// Parts of [`CountCorrection::rest`] in a count.
const PARTS: i32 = 1_000;

impl CountCorrection {
    /// For a timer with this many counts a microsecond, at most 1000.
    pub const fn new(counts_per_us: u32) -> Self {
        Self { counts_per_us, rest: 0 }
    }

    /// Takes a correction; returns the whole counts by which the period has to be longer (negative: shorter).
    pub fn take(&mut self, correction_ns: i32) -> i32 {
        let correction_ns = correction_ns.clamp(-CORRECTION_MAX_NS, CORRECTION_MAX_NS);
        let owed = self.rest + correction_ns * self.counts_per_us.min(1_000) as i32;
        let counts = owed.div_euclid(PARTS);
        // Rounds to the nearest count: the rest is within half a count.
        let counts = counts + i32::from(owed.rem_euclid(PARTS) > PARTS / 2);
        self.rest = owed - counts * PARTS;
        counts
    }
}

#[cfg(test)]
mod tests;
