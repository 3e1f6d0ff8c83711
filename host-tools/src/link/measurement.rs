//! Reads the firmware's histograms piece by piece and evaluates them.
//!
//! Invariant: a quantile is never too low: it is the end of its bin, or the largest value if that is less.

use etherpen::measurement::{BINS, MeasurementAnswer, MeasurementRequest, Quantity, lower_bound};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// Readings from a file that contradict themselves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReadingsError {
    /// The number of distributions is not the number of quantities.
    Quantities {
        /// Quantities that the firmware measures.
        expected: usize,
        /// Distributions in the file.
        actual: usize,
    },
    /// The counter's rate is 0, or differs between distributions.
    CountsPerS {
        /// The quantity.
        quantity: Quantity,
        /// Counts per second of the first distribution.
        expected: u32,
        /// Counts per second of this distribution.
        actual: u32,
    },
    /// A bin is empty, not above the bin before it, or beyond the last bin.
    Bin {
        /// The quantity.
        quantity: Quantity,
        /// Number of the bin.
        bin: u8,
        /// Values in it.
        count: u32,
    },
    /// The smallest value is above the largest.
    Range {
        /// The quantity.
        quantity: Quantity,
        /// Smallest value, counts.
        smallest: u32,
        /// Largest value, counts.
        largest: u32,
    },
}

impl fmt::Display for ReadingsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Quantities { expected, actual } => {
                write!(f, "{actual} distributions instead of {expected}")
            }
            Self::CountsPerS {
                quantity,
                expected,
                actual,
            } => write!(
                f,
                "{quantity:?}: the counter has {actual} counts per second, the first distribution's {expected}; both \
                 must be equal and above 0"
            ),
            Self::Bin { quantity, bin, count } => write!(
                f,
                "{quantity:?}: bin {bin} with {count} values is empty, out of order or beyond the last bin, {}",
                BINS - 1
            ),
            Self::Range {
                quantity,
                smallest,
                largest,
            } => write!(
                f,
                "{quantity:?}: the smallest value, {smallest} counts, is above the largest, {largest} counts"
            ),
        }
    }
}

impl std::error::Error for ReadingsError {}

/// A histogram read from the firmware; values are counts of the board's counter.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Distribution {
    /// Counts in a second.
    pub counts_per_s: u32,
    /// Numbers of the non-empty bins with their counts, in order.
    pub bins: Vec<(u8, u32)>,
    /// Largest value.
    pub largest: u32,
    /// Smallest value.
    pub smallest: u32,
    /// Sum of all values.
    pub sum: u64,
}

impl Distribution {
    /// The values of two distributions that were taken with the same counter.
    fn merged(one: &Self, other: &Self) -> Self {
        if other.bins.is_empty() {
            return one.clone();
        }
        if one.bins.is_empty() {
            return other.clone();
        }
        let mut bins: BTreeMap<u8, u32> = one.bins.iter().copied().collect();
        for (bin, count) in &other.bins {
            let sum = bins.entry(*bin).or_default();
            *sum = sum.saturating_add(*count);
        }
        Self {
            counts_per_s: one.counts_per_s,
            bins: bins.into_iter().collect(),
            largest: one.largest.max(other.largest),
            smallest: one.smallest.min(other.smallest),
            sum: one.sum.saturating_add(other.sum),
        }
    }

    /// Checks what the evaluation relies on: bins in order and in range, and the smallest value not above the largest.
    fn check(&self, quantity: Quantity) -> Result<(), ReadingsError> {
        let mut lowest = 0;
        for &(bin, count) in &self.bins {
            let number = usize::from(bin);
            if count == 0 || !(lowest..BINS).contains(&number) {
                return Err(ReadingsError::Bin { quantity, bin, count });
            }
            lowest = number + 1;
        }
        let (smallest, largest) = (self.smallest, self.largest);
        if !self.bins.is_empty() && smallest > largest {
            return Err(ReadingsError::Range {
                quantity,
                smallest,
                largest,
            });
        }
        Ok(())
    }

    /// Number of values.
    pub fn count(&self) -> u64 {
        self.bins.iter().map(|(_, count)| u64::from(*count)).sum()
    }

    /// Mean of the values; NaN without any value.
    pub fn mean(&self) -> f64 {
        self.sum as f64 / self.count() as f64
    }

    /// Largest value of a bin that can have occurred.
    fn end_of(&self, bin: u8) -> u32 {
        (lower_bound(usize::from(bin) + 1) - 1).clamp(self.smallest, self.largest)
    }

    /// The value that the given share of all values does not exceed.
    pub fn quantile(&self, share: f64) -> u32 {
        let wanted = (share * self.count() as f64).ceil().max(1.0) as u64;
        let mut passed = 0;
        for (bin, count) in &self.bins {
            passed += u64::from(*count);
            if passed >= wanted {
                return self.end_of(*bin);
            }
        }
        self.largest
    }

    /// For each bin its largest possible value and the share of all values that are larger, in order: the fraction not
    /// serviced within that time.
    pub fn exceeded(&self) -> Vec<(u32, f64)> {
        let count = self.count();
        let mut rest = count;
        let mut step = |(bin, values): &(u8, u32)| {
            rest -= u64::from(*values);
            (self.end_of(*bin), rest as f64 / count as f64)
        };
        self.bins.iter().map(&mut step).collect()
    }

    /// Number of values that are certainly or possibly above a limit; exact if none is.
    pub fn above(&self, limit: u32) -> u64 {
        if self.largest <= limit {
            return 0;
        }
        let above = self.bins.iter().filter(|(bin, _)| self.end_of(*bin) > limit);
        above.map(|(_, count)| u64::from(*count)).sum()
    }
}

/// Histograms of all quantities of a board.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Readings {
    distributions: Vec<Distribution>,
}

impl Readings {
    /// The values of two readings that were taken with the same counter.
    pub fn merged(one: &Self, other: &Self) -> Self {
        let empty = Distribution::default();
        let count = one.distributions.len().max(other.distributions.len());
        let of = |readings: &Self, index: usize| readings.distributions.get(index).unwrap_or(&empty).clone();
        Self {
            distributions: (0..count)
                .map(|index| Distribution::merged(&of(one, index), &of(other, index)))
                .collect(),
        }
    }

    /// Checks that the firmware can have recorded these readings: call it on readings from a file before they are
    /// evaluated or merged.
    ///
    /// # Errors
    /// The first contradiction.
    pub fn check(&self) -> Result<(), ReadingsError> {
        if self.distributions.len() != Quantity::ALL.len() {
            return Err(ReadingsError::Quantities {
                expected: Quantity::ALL.len(),
                actual: self.distributions.len(),
            });
        }
        let expected = self.counts_per_s().unwrap_or(0);
        for (quantity, distribution) in Quantity::ALL.into_iter().zip(&self.distributions) {
            let actual = distribution.counts_per_s;
            if actual == 0 || actual != expected {
                return Err(ReadingsError::CountsPerS {
                    quantity,
                    expected,
                    actual,
                });
            }
            distribution.check(quantity)?;
        }
        Ok(())
    }

    /// Counts per second of the board's counter; `None` without any distribution.
    pub fn counts_per_s(&self) -> Option<u32> {
        self.distributions.first().map(|distribution| distribution.counts_per_s)
    }

    /// The histogram of a quantity; `None` if the quantity never occurred.
    pub fn of(&self, quantity: Quantity) -> Option<&Distribution> {
        self.distributions
            .get(quantity as usize)
            .filter(|distribution| !distribution.bins.is_empty() && distribution.counts_per_s > 0)
    }

    /// Share of the time in which the core did not sleep, 0 to 1.
    pub fn cpu_load(&self) -> Option<f64> {
        let (awake, period) = (self.of(Quantity::Awake)?, self.of(Quantity::Period)?);
        Some(awake.mean() / period.mean())
    }
}

/// Requests one piece after the other.
#[derive(Clone, Debug, Default)]
pub struct Reader {
    first: u8,
    present: Distribution,
    readings: Readings,
}

impl Reader {
    /// A reader before its first request.
    pub fn new() -> Self {
        Self::default()
    }

    fn quantity(&self) -> Option<Quantity> {
        Quantity::ALL.get(self.readings.distributions.len()).copied()
    }

    /// The next request; `None` when everything was read.
    pub fn request(&self) -> Option<MeasurementRequest> {
        let first = self.first;
        self.quantity()
            .map(|quantity| MeasurementRequest::Read { quantity, first })
    }

    /// Takes an answer; ignores an answer to another request.
    pub fn take(&mut self, answer: &MeasurementAnswer) {
        let MeasurementAnswer::Piece(piece) = answer else {
            return;
        };
        if self.quantity() != Some(piece.quantity) {
            return;
        }
        let present = &mut self.present;
        present.bins.extend(piece.bins.iter().copied());
        present.counts_per_s = piece.counts_per_s;
        (present.largest, present.smallest) = (piece.largest, piece.smallest);
        present.sum = piece.sum;
        match piece.next {
            Some(next) => self.first = next,
            None => {
                self.first = 0;
                self.readings.distributions.push(std::mem::take(&mut self.present));
            }
        }
    }

    /// The readings; `None` if they are incomplete.
    pub fn into_readings(self) -> Option<Readings> {
        self.request().is_none().then_some(self.readings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::measurement::{Histogram, Measurements};

    fn read(measurements: &Measurements) -> Readings {
        let mut reader = Reader::new();
        while let Some(request) = reader.request() {
            reader.take(&measurements.answer(request));
        }
        reader.into_readings().expect("everything was read")
    }

    #[test]
    fn merged_readings_are_those_of_all_values_together() {
        let of = |values: &[u32]| {
            let measurements = Measurements::new();
            measurements.set_counts_per_s(25_000_000);
            values
                .iter()
                .for_each(|value| measurements.record(Quantity::TotalDelay, *value));
            read(&measurements)
        };
        let (one, other) = ([3, 700, 70_000], [1, 700, 12, 900_000]);
        let whole = of(&[one.as_slice(), other.as_slice()].concat());
        assert_eq!(Readings::merged(&of(&one), &of(&other)), whole);
        assert_eq!(Readings::merged(&of(&[]), &whole), whole);
        assert_eq!(Readings::merged(&whole, &Readings::default()), whole);
    }

    #[test]
    fn every_histogram_is_read_whole() {
        let measurements = Measurements::new();
        measurements.set_counts_per_s(25_000_000);
        for k in 0..5_000 {
            measurements.record(Quantity::TotalDelay, k * k);
            measurements.record(Quantity::Trajectory, 7);
        }
        let readings = read(&measurements);
        let total = readings.of(Quantity::TotalDelay).expect("it was measured");
        let histogram: &Histogram = measurements.histogram(Quantity::TotalDelay);
        assert_eq!((total.count(), total.sum), (histogram.count(), histogram.sum()));
        assert_eq!((total.smallest, total.largest), (0, 4_999 * 4_999));
        assert_eq!(readings.of(Quantity::Trajectory).map(Distribution::count), Some(5_000));
        assert_eq!(readings.of(Quantity::Sample), None);
    }

    #[test]
    fn quantiles_and_the_shares_beyond_a_value_enclose_the_truth() {
        let measurements = Measurements::new();
        measurements.set_counts_per_s(1);
        (1..=1_000).for_each(|value| measurements.record(Quantity::Sample, value));
        let readings = read(&measurements);
        let sample = readings.of(Quantity::Sample).expect("it was measured");
        for (share, truth) in [(0.5, 500), (0.999, 999), (1.0, 1_000)] {
            let value = sample.quantile(share);
            assert!((truth..=truth + truth / 8).contains(&value), "{share}: {value}");
        }
        assert_eq!(sample.exceeded().last(), Some(&(1_000, 0.0)));
        for (value, share) in sample.exceeded() {
            assert!(
                (share - f64::from(1_000 - value) / 1_000.0).abs() < 1e-9,
                "{value}: {share}"
            );
        }
        assert_eq!(sample.above(1_000), 0);
        assert!(sample.above(900) >= 100);
    }

    #[test]
    fn readings_that_the_firmware_cannot_have_recorded_are_refused() {
        let measurements = Measurements::new();
        measurements.set_counts_per_s(25_000_000);
        (1..100).for_each(|value| measurements.record(Quantity::TotalDelay, value));
        let good = read(&measurements);
        assert_eq!(good.check(), Ok(()));
        assert_eq!(good.counts_per_s(), Some(25_000_000));
        let quantity = Quantity::TotalDelay;
        let after = |change: &dyn Fn(&mut Distribution)| {
            let mut bad = good.clone();
            change(&mut bad.distributions[quantity as usize]);
            bad.check()
        };
        assert_eq!(
            after(&|distribution| distribution.smallest = 100),
            Err(ReadingsError::Range {
                quantity,
                smallest: 100,
                largest: 99
            })
        );
        assert_eq!(
            after(&|distribution| distribution.bins.swap(0, 1)),
            Err(ReadingsError::Bin {
                quantity,
                bin: 1,
                count: 1
            })
        );
        let last = BINS as u8;
        for (bin, count) in [(last, 1), (last - 1, 0), (u8::MAX, 1)] {
            assert_eq!(
                after(&|distribution| distribution.bins.push((bin, count))),
                Err(ReadingsError::Bin { quantity, bin, count })
            );
        }
        assert_eq!(after(&|distribution| distribution.bins.push((last - 1, 1))), Ok(()));
        for actual in [0, 1] {
            assert_eq!(
                after(&|distribution| distribution.counts_per_s = actual),
                Err(ReadingsError::CountsPerS {
                    quantity,
                    expected: 25_000_000,
                    actual
                })
            );
        }
        assert!(read(&Measurements::new()).check().is_err(), "without a counter");
        assert!(Readings::default().check().is_err(), "without any distribution");
    }

    #[test]
    fn the_load_is_the_share_of_time_awake() {
        let measurements = Measurements::new();
        measurements.set_counts_per_s(1);
        for _ in 0..10 {
            measurements.record(Quantity::Period, 1_000);
            measurements.record(Quantity::Awake, 250);
        }
        assert_eq!(read(&measurements).cpu_load(), Some(0.25));
    }
}
