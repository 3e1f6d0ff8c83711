//! A part of the history as columns, in messages of bounded size.
//!
//! Invariants: a message is at most [`PART_BYTES`] and one column long, whatever is requested; an invalid request is
//! refused with the reason before anything is computed.

use crate::console::capture::CAPTURE_MAX_MS;
use crate::console::history::{Bucket, Decimator, HistorySnapshot};
use crate::console::messages::{self, COLUMNS_MAX, WINDOW_MAX_MS};

/// Bytes after which a message is sent and another one is started.
const PART_BYTES: usize = 128 * 1024;
/// Longest span, ms; allows for a page that rounds its ends.
const SPAN_MAX_MS: u64 = if WINDOW_MAX_MS > CAPTURE_MAX_MS {
    WINDOW_MAX_MS
} else {
    CAPTURE_MAX_MS
} + 1_000;

/// The requested range.
#[derive(Debug)]
pub(super) struct Wanted {
    id: u32,
    signals: Vec<usize>,
    from_ms: u64,
    to_ms: u64,
    bucket_ms: u64,
}

/// Checks that a plot with this window and number of columns can be drawn.
pub(super) fn check_window(window_ms: u64, columns: u64) -> Result<(), String> {
    if window_ms == 0 || window_ms > WINDOW_MAX_MS {
        return Err(format!("a plot shows 1 to {WINDOW_MAX_MS} ms, not {window_ms}"));
    }
    if columns == 0 || columns > COLUMNS_MAX {
        return Err(format!("a plot has 1 to {COLUMNS_MAX} columns, not {columns}"));
    }
    Ok(())
}

impl Wanted {
    /// Columns of a span; 0 for one column every millisecond.
    pub(super) fn new(id: u32, signals: Vec<usize>, from_ms: u64, to_ms: u64, columns: u64) -> Result<Self, String> {
        let Some(length_ms) = to_ms.checked_sub(from_ms) else {
            return Err(format!("the span ends at {to_ms} ms, before it begins at {from_ms} ms"));
        };
        if length_ms > SPAN_MAX_MS {
            return Err(format!("a span has at most {SPAN_MAX_MS} ms, not {length_ms}"));
        }
        if columns > COLUMNS_MAX {
            return Err(format!("a plot has at most {COLUMNS_MAX} columns, not {columns}"));
        }
        let bucket_ms = match columns {
            0 => 1,
            columns => length_ms.div_ceil(columns.max(10)).max(1),
        };
        Ok(Self {
            id,
            signals,
            from_ms,
            to_ms,
            bucket_ms,
        })
    }
}

/// An answer sent in parts.
pub(super) struct Parts {
    wanted: Wanted,
    snapshot: HistorySnapshot,
    decimator: Decimator,
    /// Start of the next part, ms.
    next_ms: u64,
    is_first: bool,
}

impl Parts {
    pub(super) fn new(wanted: Wanted, snapshot: &HistorySnapshot) -> Self {
        Self {
            // The rest can be freed.
            snapshot: snapshot.cut(wanted.from_ms, wanted.to_ms),
            decimator: Decimator::new(wanted.signals.clone(), wanted.bucket_ms),
            next_ms: wanted.from_ms,
            is_first: true,
            wanted,
        }
    }

    /// The next message, and whether it is the last one.
    pub(super) fn next(&mut self) -> (Vec<u8>, bool) {
        let signals = self.wanted.signals.len();
        let most = (PART_BYTES / (4 + 8 * signals)).max(1);
        let mut buckets: Vec<Bucket> = Vec::new();
        let mut is_last = true;
        for row in self.snapshot.rows(self.next_ms, self.wanted.to_ms) {
            if buckets.len() >= most {
                is_last = false;
                break;
            }
            self.next_ms = row.time_ms.saturating_add(1);
            buckets.extend(self.decimator.push(row));
        }
        if is_last {
            buckets.extend(self.decimator.take());
        }
        let flags = u8::from(self.is_first) | u8::from(is_last) << 1;
        self.is_first = false;
        let bytes = messages::columns(self.wanted.id, flags, signals, self.wanted.bucket_ms, &buckets);
        (bytes, is_last)
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::history::History;
    use super::super::super::signals::{Rows, SIGNALS, tests::sample};
    use super::*;
    use crate::random::Lcg;
    use etherpen::config::Config;

    #[test]
    fn whatever_is_wanted_comes_once_in_order_and_in_small_messages_or_is_refused() {
        let (mut history, mut rows) = (History::default(), Rows::new(&Config::default()));
        (0..70_000_u32).for_each(|t_ms| history.push(rows.take(&sample(t_ms, t_ms as f32))));
        let snapshot = history.snapshot();
        let mut random = Lcg::new(1);
        let mut next = |below: usize| random.below(below) as u64;
        for case in 0..60 {
            let (from_ms, length_ms) = (next(80_000), [0, 1, 777, 20_000, 60_000][next(5) as usize]);
            let columns = [0, 1, 10, 800, COLUMNS_MAX][next(5) as usize];
            let signals: Vec<_> = (0..1 + next(SIGNALS) as usize).collect();
            let count = signals.len();
            let wanted = Wanted::new(7, signals, from_ms, from_ms + length_ms, columns).unwrap();
            let (bucket_ms, mut parts) = (wanted.bucket_ms, Parts::new(wanted, &snapshot));
            let (mut numbers, mut is_last, mut is_first) = (Vec::new(), false, true);
            while !is_last {
                let (bytes, last) = parts.next();
                is_last = last;
                assert!(
                    bytes.len() <= PART_BYTES + 16 + 2 * (4 + 8 * count),
                    "case {case}: {}",
                    bytes.len()
                );
                assert_eq!(bytes[1], u8::from(is_first) | u8::from(last) << 1, "case {case}");
                is_first = false;
                let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
                numbers.extend((0..word(12) as usize).map(|column| u64::from(word(16 + 4 * column))));
            }
            let end_ms = (from_ms + length_ms).min(69_999);
            let expected: Vec<_> = match from_ms <= end_ms {
                true => (from_ms / bucket_ms..=end_ms / bucket_ms).collect(),
                false => Vec::new(),
            };
            assert_eq!(numbers, expected, "case {case}");
        }
    }

    #[test]
    fn what_makes_no_sense_is_refused_with_the_reason() {
        let wanted = |from_ms, to_ms, columns| Wanted::new(1, vec![0], from_ms, to_ms, columns).unwrap_err();
        assert!(wanted(10, 9, 100).contains("before it begins"));
        assert!(wanted(0, u64::MAX, 0).contains("at most"));
        assert!(wanted(0, 10, u64::MAX).contains("columns"));
        assert!(check_window(1_000, 0).unwrap_err().contains("columns"));
        assert!(check_window(0, 100).unwrap_err().contains("ms"));
        assert!(check_window(u64::MAX, 100).is_err() && check_window(1_000, u64::MAX).is_err());
        assert!(check_window(1_000, 1_000).is_ok());
    }
}
