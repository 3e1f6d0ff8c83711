//! Execution times and delays, always recorded: histograms with fixed bins that the host reads.
//!
//! A board's tasks take time stamps at their beginning and end from a free-running counter and pass the differences to
//! [`Measurements`]; the link task reads them in pieces. Values are counts of that counter. The board declares its rate
//! once, so no critical task divides. A bin is found with a shift and a mask, and recording is a handful of loads and
//! stores: no lock, no loop, no read-modify-write instruction.
//!
//! Invariants: each histogram has one writing priority, and its reader runs at a lower one, so that a recording is
//! never interrupted by a reader; every value falls into exactly one bin; the largest and the smallest value are kept
//! exactly.

use crate::control::sampler::OUTPUT_LATE_NS;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};
use heapless::Vec;
use serde::{Deserialize, Serialize};

/// Each value below this has its own bin.
const EXACT: u32 = 16;
/// Bins in an octave above [`EXACT`]: a bin is at most an eighth of its lower bound wide.
const BINS_PER_OCTAVE: usize = 8;
const EXACT_BITS: u32 = EXACT.trailing_zeros();
const BIN_BITS: u32 = BINS_PER_OCTAVE.trailing_zeros();
/// Values from 2 to this power on share the last bin.
const VALUE_BITS: u32 = 24;
/// Bins of a histogram.
pub const BINS: usize = EXACT as usize + BINS_PER_OCTAVE * (VALUE_BITS - EXACT_BITS) as usize;
/// Bins in one piece of an answer.
pub const BINS_PER_PIECE: usize = 48;
/// Attempts to read a sum of two words that a writer may change in between.
const READS_MAX: usize = 8;

const NS_PER_S: u32 = 1_000_000_000;

const _: () = assert!(NS_PER_S.is_multiple_of(OUTPUT_LATE_NS));
const _: () = assert!(EXACT.is_power_of_two() && BINS_PER_OCTAVE.is_power_of_two());
const _: () = assert!(EXACT_BITS > BIN_BITS);
const _: () = assert!(BINS <= u8::MAX as usize);

/// Bin of a value.
pub const fn bin_of(value: u32) -> usize {
    if value < EXACT {
        return value as usize;
    }
    let octave = u32::BITS - 1 - value.leading_zeros();
    let within = (value >> (octave - BIN_BITS)) & (BINS_PER_OCTAVE as u32 - 1);
    let bin = EXACT as usize + (octave - EXACT_BITS) as usize * BINS_PER_OCTAVE + within as usize;
    if bin < BINS { bin } else { BINS - 1 }
}

/// Smallest value of a bin; for the index after the last bin, the end of the last bin.
pub const fn lower_bound(bin: usize) -> u32 {
    if bin < EXACT as usize {
        return bin as u32;
    }
    let above = bin - EXACT as usize;
    let octave = EXACT_BITS + (above / BINS_PER_OCTAVE) as u32;
    let within = (above % BINS_PER_OCTAVE) as u32;
    // Beyond the last bin's end there is nothing to shift.
    if octave >= u32::BITS {
        return u32::MAX;
    }
    (1 << octave) + (within << (octave - BIN_BITS))
}

/// A measured quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[repr(u8)]
pub enum Quantity {
    /// From the nominal release of `sample` to its first instruction.
    ReleaseDelay,
    /// From one run of `sample` to the next.
    Period,
    /// From the nominal release until the MAC has the input telegram.
    SendDelay,
    /// From the moment the MAC has the input telegram to the release of the task that takes its reply.
    RoundTrip,
    /// From the nominal release until the reply is served and the MAC has the output telegram.
    TotalDelay,
    /// Execution of `sample`.
    Sample,
    /// Execution of one run of `bus_frame`.
    BusFrame,
    /// Execution of `bus_deadline`.
    BusDeadline,
    /// Execution of all critical tasks between two releases.
    CriticalPath,
    /// Time between two releases in which the core did not sleep.
    Awake,
    /// Execution of the trajectory task without the tasks that preempted it.
    Trajectory,
    /// Delay of a late output telegram behind its deadline, until the MAC has it.
    Lateness,
}

impl Quantity {
    /// All quantities in the order of their numbers.
    pub const ALL: [Self; 12] = [
        Self::ReleaseDelay,
        Self::Period,
        Self::SendDelay,
        Self::RoundTrip,
        Self::TotalDelay,
        Self::Sample,
        Self::BusFrame,
        Self::BusDeadline,
        Self::CriticalPath,
        Self::Awake,
        Self::Trajectory,
        Self::Lateness,
    ];
}

const QUANTITIES: usize = Quantity::ALL.len();

/// Histogram of one quantity.
#[derive(Debug)]
pub struct Histogram {
    bins: [AtomicU32; BINS],
    largest: AtomicU32,
    /// Complement of the smallest value: an empty histogram is all zero, and a static one takes no flash memory.
    smallest_complement: AtomicU32,
    sum_low: AtomicU32,
    sum_high: AtomicU32,
}

impl Default for Histogram {
    fn default() -> Self {
        Self::new()
    }
}

impl Histogram {
    /// An empty histogram.
    pub const fn new() -> Self {
        Self {
            bins: [const { AtomicU32::new(0) }; BINS],
            largest: AtomicU32::new(0),
            smallest_complement: AtomicU32::new(0),
            sum_low: AtomicU32::new(0),
            sum_high: AtomicU32::new(0),
        }
    }

    /// Counts `value`. Only the histogram's writer may call this.
    pub fn record(&self, value: u32) {
        if let Some(bin) = self.bins.get(bin_of(value)) {
            bin.store(bin.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
        }
        if value > self.largest.load(Ordering::Relaxed) {
            self.largest.store(value, Ordering::Relaxed);
        }
        if !value > self.smallest_complement.load(Ordering::Relaxed) {
            self.smallest_complement.store(!value, Ordering::Relaxed);
        }
        let (low, carried) = self.sum_low.load(Ordering::Relaxed).overflowing_add(value);
        self.sum_low.store(low, Ordering::Relaxed);
        if carried {
            let high = self.sum_high.load(Ordering::Relaxed);
            self.sum_high.store(high.wrapping_add(1), Ordering::Relaxed);
        }
    }

    /// Largest value, 0 without any.
    pub fn largest(&self) -> u32 {
        self.largest.load(Ordering::Relaxed)
    }

    /// Smallest value, `u32::MAX` without any.
    pub fn smallest(&self) -> u32 {
        !self.smallest_complement.load(Ordering::Relaxed)
    }

    /// Sum of all values.
    pub fn sum(&self) -> u64 {
        let read = || {
            let high = self.sum_high.load(Ordering::Relaxed);
            let low = self.sum_low.load(Ordering::Relaxed);
            (u64::from(high) << 32 | u64::from(low), high)
        };
        let mut sum = 0;
        for _ in 0..READS_MAX {
            let (value, high) = read();
            sum = value;
            if high == self.sum_high.load(Ordering::Relaxed) {
                break;
            }
        }
        sum
    }

    /// Number of values counted.
    pub fn count(&self) -> u64 {
        self.bins.iter().map(|bin| u64::from(bin.load(Ordering::Relaxed))).sum()
    }

    /// Bins that are not empty from bin `first` on, as many as fit; and the bin with which to continue.
    fn piece(&self, first: u8) -> (Vec<(u8, u32), BINS_PER_PIECE>, Option<u8>) {
        let mut counts = Vec::new();
        for (number, bin) in (0..=u8::MAX).zip(&self.bins).skip(usize::from(first)) {
            let count = bin.load(Ordering::Relaxed);
            if count > 0 && counts.push((number, count)).is_err() {
                return (counts, Some(number));
            }
        }
        (counts, None)
    }

    /// Resets the histogram. A value recorded meanwhile may be kept in part.
    fn reset(&self) {
        for bin in &self.bins {
            bin.store(0, Ordering::Relaxed);
        }
        // The low word first: a carry of a recording meanwhile is reset with the high word.
        self.sum_low.store(0, Ordering::Relaxed);
        self.sum_high.store(0, Ordering::Relaxed);
        self.largest.store(0, Ordering::Relaxed);
        self.smallest_complement.store(0, Ordering::Relaxed);
    }
}

/// Request of the host to the measurements.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MeasurementRequest {
    /// A piece of a histogram.
    Read {
        /// The quantity.
        quantity: Quantity,
        /// First bin wanted.
        first: u8,
    },
    /// Reset all histograms.
    Reset,
    /// Apply these artificial loads, bits of [`disturbance`], for measurements on a board that offers it.
    Disturb {
        /// Sum of the bits; 0 ends all loads.
        bits: u8,
    },
}

/// Artificial loads that a board may offer, as bits of [`MeasurementRequest::Disturb`].
pub mod disturbance {
    /// Traffic on the serial link in both directions, at the full rate of the line.
    pub const SERIAL: u8 = 1 << 0;
    /// Log lines at the rate that the log's ring can take.
    pub const LOG: u8 = 1 << 1;
    /// Foreign frames on the cable, timed to meet the release of `sample`.
    pub const NETWORK: u8 = 1 << 2;
    /// The emergency-stop input reads as open.
    pub const EMERGENCY_STOP: u8 = 1 << 3;
    /// The clock source reads as failed: the board runs on its substitute.
    pub const CLOCK: u8 = 1 << 4;
    /// The sample hangs in the middle of a drawing, in the variant of the emulated board that ends there.
    pub const HANG_SAMPLE: u8 = 1 << 5;
    /// The trajectory task hangs in the middle of a drawing, in the same variant.
    pub const HANG_TRAJECTORY: u8 = 1 << 6;
}

/// A piece of a histogram.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HistogramPiece {
    /// The quantity.
    pub quantity: Quantity,
    /// Counts in a second.
    pub counts_per_s: u32,
    /// Largest value so far, counts.
    pub largest: u32,
    /// Smallest value so far, counts; `u32::MAX` without any.
    pub smallest: u32,
    /// Sum of all values, counts.
    pub sum: u64,
    /// Number of a bin and how many values are in it, for bins that are not empty.
    pub bins: Vec<(u8, u32), BINS_PER_PIECE>,
    /// First bin of the next piece; `None` when this was the last.
    pub next: Option<u8>,
}

/// Answer to a [`MeasurementRequest`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // one is alive at a time, in static memory
pub enum MeasurementAnswer {
    /// Answer to [`MeasurementRequest::Read`].
    Piece(HistogramPiece),
    /// The request was carried out.
    Done,
    /// This board does not offer the function.
    NotOffered,
}

/// Histograms of all quantities.
#[derive(Debug, Default)]
pub struct Measurements {
    histograms: [Histogram; QUANTITIES],
    counts_per_s: AtomicU32,
    /// Counts from a release to the deadline of its output telegram; 0 until the board has declared its counter's rate.
    deadline_counts: AtomicU32,
    /// Run time of the critical tasks, counts, wrapping.
    critical_counts: AtomicU32,
    offers_disturbance: AtomicBool,
    disturbance: AtomicU8,
}

impl Measurements {
    /// Empty measurements.
    pub const fn new() -> Self {
        Self {
            histograms: [const { Histogram::new() }; QUANTITIES],
            counts_per_s: AtomicU32::new(0),
            deadline_counts: AtomicU32::new(0),
            critical_counts: AtomicU32::new(0),
            offers_disturbance: AtomicBool::new(false),
            disturbance: AtomicU8::new(0),
        }
    }

    /// Declares the rate of the board's counter, Hz.
    pub fn set_counts_per_s(&self, counts_per_s: u32) {
        self.counts_per_s.store(counts_per_s, Ordering::Relaxed);
        let deadline_counts = counts_per_s / (NS_PER_S / OUTPUT_LATE_NS);
        self.deadline_counts.store(deadline_counts, Ordering::Relaxed);
    }

    /// Declares that the board acts on [`disturbance`](Self::disturbance).
    pub fn offer_disturbance(&self) {
        self.offers_disturbance.store(true, Ordering::Relaxed);
    }

    /// Artificial loads to apply now: a sum of [`disturbance`]'s bits.
    pub fn disturbance(&self) -> u8 {
        self.disturbance.load(Ordering::Relaxed)
    }

    /// The histogram of a quantity.
    pub fn histogram(&self, quantity: Quantity) -> &Histogram {
        let [first, ..] = &self.histograms;
        // There are as many histograms as quantities.
        self.histograms.get(quantity as usize).unwrap_or(first)
    }

    /// Records a value, counts of the board's counter. Only the quantity's writer may call this.
    pub fn record(&self, quantity: Quantity, counts: u32) {
        self.histogram(quantity).record(counts);
    }

    /// Run time of the critical tasks since start-up, counts, wrapping; a task below them subtracts it from its own
    /// time.
    pub fn critical_counts(&self) -> u32 {
        self.critical_counts.load(Ordering::Relaxed)
    }

    /// Carries out a request of the host.
    pub fn answer(&self, request: MeasurementRequest) -> MeasurementAnswer {
        match request {
            MeasurementRequest::Read { quantity, first } => {
                let histogram = self.histogram(quantity);
                let (bins, next) = histogram.piece(first);
                MeasurementAnswer::Piece(HistogramPiece {
                    quantity,
                    counts_per_s: self.counts_per_s.load(Ordering::Relaxed),
                    largest: histogram.largest(),
                    smallest: histogram.smallest(),
                    sum: histogram.sum(),
                    bins,
                    next,
                })
            }
            MeasurementRequest::Reset => {
                for histogram in &self.histograms {
                    histogram.reset();
                }
                MeasurementAnswer::Done
            }
            MeasurementRequest::Disturb { bits } => {
                if !self.offers_disturbance.load(Ordering::Relaxed) {
                    return MeasurementAnswer::NotOffered;
                }
                self.disturbance.store(bits, Ordering::Relaxed);
                MeasurementAnswer::Done
            }
        }
    }
}

/// One run of a critical task, counts of the board's counter.
#[derive(Clone, Copy, Debug)]
pub struct Run {
    /// Reading at the first instruction.
    pub began_at: u32,
    /// Reading at the end.
    pub ended_at: u32,
    /// Counts within the run that are not work of the firmware: an emulator's lockstep.
    pub excluded: u32,
}

impl Run {
    fn counts(&self) -> u32 {
        self.ended_at.wrapping_sub(self.began_at).saturating_sub(self.excluded)
    }
}

/// Time stamps of the critical tasks in the present period; shared by these tasks.
#[derive(Debug)]
pub struct CycleWatch<'a> {
    measurements: &'a Measurements,
    /// Nominal release of this period.
    released_at: u32,
    sample_began_at: Option<u32>,
    slept_counts: u32,
    critical: u32,
    /// Time at which the MAC had the input telegram; `None` after its reply or the deadline.
    sent_at: Option<u32>,
}

impl<'a> CycleWatch<'a> {
    /// A watch before the first period.
    pub const fn new(measurements: &'a Measurements) -> Self {
        Self {
            measurements,
            released_at: 0,
            sample_began_at: None,
            slept_counts: 0,
            critical: 0,
            sent_at: None,
        }
    }

    /// Records a run of `sample` that began `delay` counts after its nominal release; `slept_counts` is how long the
    /// core has slept since start-up, wrapping.
    pub fn sample(&mut self, run: Run, delay: u32, slept_counts: u32) {
        let measurements = self.measurements;
        let slept = slept_counts.wrapping_sub(self.slept_counts);
        self.slept_counts = slept_counts;
        if let Some(before) = self.sample_began_at.replace(run.began_at) {
            let period = run.began_at.wrapping_sub(before);
            measurements.record(Quantity::Period, period);
            measurements.record(Quantity::Awake, period.saturating_sub(slept));
            measurements.record(Quantity::CriticalPath, core::mem::take(&mut self.critical));
        }
        self.released_at = run.began_at.wrapping_sub(delay);
        self.sent_at = Some(run.ended_at);
        measurements.record(Quantity::ReleaseDelay, delay);
        measurements.record(Quantity::SendDelay, run.ended_at.wrapping_sub(self.released_at));
        self.ran(Quantity::Sample, run);
    }

    /// Records a run of `bus_frame`; `served` if it took the input reply and sent the output telegram.
    pub fn bus_frame(&mut self, run: Run, served: bool) {
        if served && let Some(sent_at) = self.sent_at.take() {
            let measurements = self.measurements;
            measurements.record(Quantity::RoundTrip, run.began_at.wrapping_sub(sent_at));
            self.sent_outputs(run);
        }
        self.ran(Quantity::BusFrame, run);
    }

    /// Records a run of `bus_deadline`; `served` if it sent the output telegram because the reply was missing.
    pub fn bus_deadline(&mut self, run: Run, served: bool) {
        if served && self.sent_at.take().is_some() {
            self.sent_outputs(run);
        }
        self.ran(Quantity::BusDeadline, run);
    }

    /// Records that the MAC has the output telegram.
    fn sent_outputs(&self, run: Run) {
        let measurements = self.measurements;
        let total = run.ended_at.wrapping_sub(self.released_at);
        measurements.record(Quantity::TotalDelay, total);
        let deadline = measurements.deadline_counts.load(Ordering::Relaxed);
        if deadline > 0
            && let Some(lateness @ 1..) = total.checked_sub(deadline)
        {
            measurements.record(Quantity::Lateness, lateness);
        }
    }

    /// Records a run at critical priority that does not belong to the control loop but delays all lower tasks.
    pub fn preempted(&mut self, run: Run) {
        let whole = run.ended_at.wrapping_sub(run.began_at);
        let total = self.measurements.critical_counts().wrapping_add(whole);
        self.measurements.critical_counts.store(total, Ordering::Relaxed);
    }

    fn ran(&mut self, quantity: Quantity, run: Run) {
        let counts = run.counts();
        self.measurements.record(quantity, counts);
        self.critical = self.critical.wrapping_add(counts);
        self.preempted(run);
    }
}

#[cfg(test)]
mod tests;
