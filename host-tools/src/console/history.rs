//! The last two minutes of telemetry, and its reduction to plot columns.
//!
//! Rows are stored in shared pieces, so that freezing a plot costs no copy, and memory is bounded however long the
//! console runs. Invariants: rows are numbered without gaps from the first one ever received; a bucket contains the
//! smallest and largest of its values, so no peak is lost in a plot.

use super::signals::SignalRow;
use std::collections::VecDeque;
use std::sync::Arc;

/// Rows in one piece.
const PIECE_ROWS: usize = 500;
/// Number of rows kept: two minutes at 1 kHz.
pub const ROWS_KEPT: usize = 120_000;
/// Number of pieces kept.
const PIECES: usize = ROWS_KEPT / PIECE_ROWS;

const _: () = assert!(PIECES * PIECE_ROWS == ROWS_KEPT);

/// The rows so far.
#[derive(Default)]
pub struct History {
    pieces: VecDeque<Arc<[SignalRow]>>,
    open: Vec<SignalRow>,
    /// Number of the first row kept.
    first: u64,
}

/// An unchanging copy of a part of the history.
#[derive(Clone, Default)]
pub struct HistorySnapshot {
    pieces: Vec<Arc<[SignalRow]>>,
}

impl History {
    /// Takes the next row.
    pub fn push(&mut self, row: SignalRow) {
        self.open.push(row);
        if self.open.len() == PIECE_ROWS {
            self.pieces.push_back(self.open.drain(..).collect());
        }
        if self.pieces.len() > PIECES {
            self.pieces.pop_front();
            self.first += PIECE_ROWS as u64;
        }
    }

    /// Number of the next row.
    pub fn next(&self) -> u64 {
        self.first + (self.pieces.len() * PIECE_ROWS + self.open.len()) as u64
    }

    /// The last row.
    pub fn last(&self) -> Option<&SignalRow> {
        self.open.last().or_else(|| self.pieces.back()?.last())
    }

    /// Rows from this number on, or from the oldest kept; returned with the number of the first row.
    pub fn since(&self, number: u64) -> (u64, Vec<SignalRow>) {
        self.some_since(number, usize::MAX)
    }

    /// At most `most` rows from this number on, or from the oldest kept; returned with the number of the first row.
    pub fn some_since(&self, number: u64, most: usize) -> (u64, Vec<SignalRow>) {
        let from = number.clamp(self.first, self.next());
        let mut skip = (from - self.first) as usize;
        let mut left = most.min((self.next() - from) as usize);
        let mut rows = Vec::with_capacity(left);
        for piece in self.pieces.iter().map(|piece| &**piece).chain([self.open.as_slice()]) {
            match piece.get(skip..) {
                Some(part) => {
                    let part = part.get(..left).unwrap_or(part);
                    rows.extend_from_slice(part);
                    left -= part.len();
                    skip = 0;
                }
                None => skip -= piece.len(),
            }
        }
        (from, rows)
    }

    /// A snapshot of everything kept.
    pub fn snapshot(&self) -> HistorySnapshot {
        let open: Arc<[SignalRow]> = self.open.as_slice().into();
        HistorySnapshot {
            pieces: self.pieces.iter().cloned().chain([open]).collect(),
        }
    }
}

impl HistorySnapshot {
    /// The rows of a span of console time, including both ends, in order.
    pub fn rows(&self, from_ms: u64, to_ms: u64) -> impl Iterator<Item = &SignalRow> {
        let reaches = move |piece: &&Arc<[SignalRow]>| piece.last().is_some_and(|last| last.time_ms >= from_ms);
        self.pieces
            .iter()
            .filter(reaches)
            .take_while(move |piece| piece.first().is_some_and(|first| first.time_ms <= to_ms))
            .flat_map(|piece| piece.iter())
            .filter(move |row| (from_ms..=to_ms).contains(&row.time_ms))
    }

    /// Time of the last row, ms.
    pub fn last_ms(&self) -> u64 {
        let last = self.pieces.iter().rev().find_map(|piece| piece.last());
        last.map_or(0, |row| row.time_ms)
    }

    /// Reduces the snapshot to a span of console time, so that the rest can be freed.
    pub fn cut(&self, from_ms: u64, to_ms: u64) -> Self {
        let inside = |piece: &&Arc<[SignalRow]>| {
            piece.last().is_some_and(|last| last.time_ms >= from_ms)
                && piece.first().is_some_and(|first| first.time_ms <= to_ms)
        };
        Self {
            pieces: self.pieces.iter().filter(inside).cloned().collect(),
        }
    }
}

/// One column of a plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Bucket {
    /// Start time in bucket lengths.
    pub number: u64,
    /// Smallest and largest value of each signal; NaN if there was no value.
    pub spans: Vec<[f32; 2]>,
}

/// Reduces rows to columns, for some of the signals.
#[derive(Clone, Debug)]
pub struct Decimator {
    signals: Vec<usize>,
    bucket_ms: u64,
    open: Option<Bucket>,
}

impl Decimator {
    /// Makes columns of this length, at least a millisecond.
    pub fn new(signals: Vec<usize>, bucket_ms: u64) -> Self {
        Self {
            signals,
            bucket_ms: bucket_ms.max(1),
            open: None,
        }
    }

    /// Length of a column, ms.
    pub fn bucket_ms(&self) -> u64 {
        self.bucket_ms
    }

    /// Takes a row; returns the column that it completes.
    pub fn push(&mut self, row: &SignalRow) -> Option<Bucket> {
        let number = row.time_ms / self.bucket_ms;
        let ended = self.open.take_if(|open| open.number != number);
        let signals = self.signals.len();
        let open = self.open.get_or_insert_with(|| Bucket {
            number,
            spans: vec![[f32::NAN; 2]; signals],
        });
        for ([low, high], signal) in open.spans.iter_mut().zip(&self.signals) {
            let value = row.value(*signal);
            // The minimum and maximum of a number and a NaN is the number.
            *low = low.min(value);
            *high = high.max(value);
        }
        ended
    }

    /// The incomplete column.
    pub fn take(&mut self) -> Option<Bucket> {
        self.open.take()
    }
}

#[cfg(test)]
mod tests {
    use super::super::signals::{Rows, tests::sample};
    use super::*;
    use etherpen::config::Config;

    fn rows(count: u32) -> impl Iterator<Item = SignalRow> {
        let mut rows = Rows::new(&Config::default());
        (0..count).map(move |t_ms| rows.take(&sample(t_ms, (f64::from(t_ms) * 0.01).sin() as f32)))
    }

    #[test]
    fn a_day_of_samples_keeps_two_minutes() {
        let template = rows(1).next().unwrap();
        let mut history = History::default();
        let mut most = 0;
        for time_ms in 0..86_400_000 {
            history.push(SignalRow { time_ms, ..template });
            if time_ms % 1_000_000 == 0 {
                most = most.max(history.pieces.len() * PIECE_ROWS + history.open.capacity());
            }
        }
        assert_eq!(history.next(), 86_400_000);
        assert!(most <= ROWS_KEPT + 2 * PIECE_ROWS, "{most} rows");
        let (from, rest) = history.since(0);
        assert_eq!(rest.first().map(|row| row.time_ms), Some(from));
        assert_eq!(rest.last().map(|row| row.time_ms), Some(86_399_999));
        println!(
            "24 h of samples: at most {most} rows of {} bytes",
            size_of::<SignalRow>()
        );
    }

    #[test]
    fn what_came_since_a_row_is_given_once_and_in_order() {
        let (mut history, mut seen, mut next) = (History::default(), Vec::new(), 0);
        for (number, row) in rows(2_345).enumerate() {
            history.push(row);
            if number % 37 == 0 {
                let (from, rows) = history.since(next);
                assert_eq!(from, next);
                next += rows.len() as u64;
                seen.extend(rows.iter().map(|row| row.time_ms));
            }
        }
        assert!(
            seen.iter()
                .enumerate()
                .all(|(number, time_ms)| number as u64 == *time_ms)
        );
        assert_eq!(history.since(9_999).1, []);
        assert_eq!(history.last().map(|row| row.time_ms), Some(2_344));
    }

    #[test]
    fn a_snapshot_gives_the_rows_of_a_span() {
        let mut history = History::default();
        rows(1_800).for_each(|row| history.push(row));
        let snapshot = history.snapshot().cut(700, 1_600);
        let times: Vec<_> = snapshot.rows(700, 1_600).map(|row| row.time_ms).collect();
        assert_eq!(times, (700..=1_600).collect::<Vec<_>>());
        assert_eq!(snapshot.rows(5_000, 6_000).count(), 0);
    }

    #[test]
    fn no_peak_is_lost_in_a_column() {
        let mut decimator = Decimator::new(vec![1], 10);
        let mut buckets = Vec::new();
        for mut row in rows(95) {
            if row.time_ms == 42 {
                row.values[1] = 99.0;
            }
            buckets.extend(decimator.push(&row));
        }
        buckets.extend(decimator.take());
        assert_eq!(buckets.len(), 10);
        assert_eq!(buckets[4].spans[0][1], 99.0);
        assert!((buckets[4].spans[0][0] - 0.4_f32.sin()).abs() < 1e-6);
        assert!(buckets[3].spans[0][1] < 1.0);
    }
}
