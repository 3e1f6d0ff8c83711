//! The curves of a plot, collected in one pass: extremes of short intervals, few enough for a picture.
//!
//! Invariants: no extreme is lost however long the recording is; memory is bounded; a curve is interrupted where
//! samples are missing.

use crate::recording::mcap::Source;
use crate::recording::signals::{Evaluator, Signal};
use crate::recording::{Playback, RecordingEntry};
use std::io;

/// Most intervals of a recording; beyond that every two are merged.
const BINS_MAX: usize = 2_048;
/// Initial length of an interval, s: a sample.
const BIN_S: f64 = 0.001;

/// Smallest and largest value in an interval, each with its time, s.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Extremes {
    min: [f64; 2],
    max: [f64; 2],
}

impl Extremes {
    fn join(self, other: Self) -> Self {
        Self {
            min: if other.min[1] < self.min[1] {
                other.min
            } else {
                self.min
            },
            max: if other.max[1] > self.max[1] {
                other.max
            } else {
                self.max
            },
        }
    }
}

/// The collected curves.
pub(super) struct Curves {
    /// First and last time, s.
    pub(super) span_s: [f64; 2],
    /// Times without samples, s.
    pub(super) gaps_s: Vec<[f64; 2]>,
    bin_s: f64,
    /// Extremes of each signal in each interval.
    bins: Vec<Vec<Option<Extremes>>>,
}

impl Curves {
    /// Reads the rest of a recording; `None` if there is no sample.
    ///
    /// # Errors
    /// The rest of the recording cannot be read.
    pub(super) fn collect<R: Source>(playback: &mut Playback<R>, signals: &[Signal]) -> io::Result<Option<Self>> {
        let mut evaluator = Evaluator::new(playback.config().as_ref());
        let mut curves: Option<Self> = None;
        while let Some((time_s, entry)) = playback.next_entry()? {
            match entry {
                RecordingEntry::Moment(moment) => {
                    evaluator.take(&moment);
                    let curves = curves.get_or_insert_with(|| Self::new(time_s, signals.len()));
                    let values = signals.iter().map(|signal| evaluator.value(signal, &moment).number());
                    curves.add(time_s, values);
                }
                RecordingEntry::Gap(_) => {
                    evaluator.interrupt();
                    if let Some(curves) = &mut curves {
                        curves.interrupt(time_s);
                    }
                }
                RecordingEntry::State(_) | RecordingEntry::Event(_) => {}
            }
        }
        Ok(curves)
    }

    fn new(time_s: f64, signals: usize) -> Self {
        Self {
            span_s: [time_s; 2],
            gaps_s: Vec::new(),
            bin_s: BIN_S,
            bins: vec![Vec::new(); signals],
        }
    }

    fn add(&mut self, time_s: f64, values: impl Iterator<Item = Option<f64>>) {
        self.span_s[1] = time_s;
        while self.place(time_s) >= BINS_MAX {
            self.bin_s *= 2.0;
            self.bins.iter_mut().for_each(halve);
        }
        let place = self.place(time_s);
        for (bins, value) in self.bins.iter_mut().zip(values) {
            bins.resize(bins.len().max(place + 1), None);
            let Some(value) = value.filter(|value| value.is_finite()) else {
                continue;
            };
            let new = Extremes {
                min: [time_s, value],
                max: [time_s, value],
            };
            if let Some(bin) = bins.get_mut(place) {
                *bin = Some(bin.map_or(new, |old| old.join(new)));
            }
        }
    }

    fn place(&self, time_s: f64) -> usize {
        ((time_s - self.span_s[0]) / self.bin_s) as usize
    }

    /// Starts a gap up to a time.
    fn interrupt(&mut self, until_s: f64) {
        let from_s = self.span_s[1];
        match self.gaps_s.last_mut() {
            Some(last) if from_s - last[1] < self.bin_s && self.bin_s > BIN_S => last[1] = until_s,
            _ => self.gaps_s.push([from_s, until_s]),
        }
    }

    /// Smallest and largest value of a signal.
    pub(super) fn range(&self, signal: usize) -> Option<[f64; 2]> {
        let bins = self.bins.get(signal)?.iter().flatten();
        bins.copied().reduce(Extremes::join).map(|all| [all.min[1], all.max[1]])
    }

    /// The curve of a signal, in pieces between gaps: times, s, and values. The curve of a state keeps its value until
    /// the next one.
    pub(super) fn pieces(&self, signal: usize, state: bool) -> Vec<Vec<[f64; 2]>> {
        let mut pieces: Vec<Vec<[f64; 2]>> = vec![Vec::new()];
        let mut gaps = self.gaps_s.iter().peekable();
        for bin in self.bins.get(signal).into_iter().flatten().flatten() {
            let mut points = [bin.min, bin.max];
            points.sort_by(|a, b| a[0].total_cmp(&b[0]));
            while gaps.next_if(|gap| points[0][0] >= gap[1]).is_some() {
                pieces.push(Vec::new());
            }
            let Some(piece) = pieces.last_mut() else {
                continue;
            };
            for point in points {
                match piece.last().copied() {
                    Some(last) if last == point => continue,
                    Some([_, value]) if state && value != point[1] => piece.push([point[0], value]),
                    _ => {}
                }
                piece.push(point);
            }
        }
        pieces.retain(|piece| !piece.is_empty());
        pieces
    }
}

/// Merges every two neighbours.
fn halve(bins: &mut Vec<Option<Extremes>>) {
    let joined = bins
        .chunks(2)
        .map(|pair| pair.iter().flatten().copied().reduce(Extremes::join));
    *bins = joined.collect();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peak_of_one_millisecond_in_an_hour_stays_and_a_gap_interrupts() {
        let mut curves = Curves::new(0.0, 1);
        for ms in 0..3_600_000_u32 {
            if (1_000_000..1_100_000).contains(&ms) {
                continue;
            }
            if ms == 1_100_000 {
                curves.interrupt(1_100.0);
            }
            let value = if ms == 2_345_678 {
                7.0
            } else {
                (f64::from(ms) / 1e4).sin()
            };
            curves.add(f64::from(ms) / 1_000.0, [Some(value)].into_iter());
        }
        assert!(curves.bins[0].len() <= BINS_MAX);
        assert_eq!(curves.range(0).unwrap()[1], 7.0);
        let pieces = curves.pieces(0, false);
        assert_eq!(pieces.len(), 2);
        assert!(pieces[0].iter().all(|point| point[0] < 1_000.0));
        assert!(pieces[1].contains(&[2_345.678, 7.0]));
        assert_eq!(curves.gaps_s, [[999.999, 1_100.0]]);
    }

    #[test]
    fn the_curve_of_a_state_has_steps() {
        let mut curves = Curves::new(0.0, 1);
        for (ms, value) in [(0, 1.0), (1, 1.0), (2, 4.0)] {
            curves.add(f64::from(ms) / 1_000.0, [Some(value)].into_iter());
        }
        assert_eq!(
            curves.pieces(0, true)[0],
            [[0.0, 1.0], [0.001, 1.0], [0.002, 1.0], [0.002, 4.0]]
        );
    }
}
