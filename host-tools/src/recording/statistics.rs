//! What a recording amounts to: duration, gaps, extremes of every signal, following errors, time in each mode.
//!
//! Invariant: one pass, and memory that does not depend on the length.

use super::mcap::Source;
use super::messages::{MODES, mode_number};
use super::signals::{Evaluator, Signal, columns, errors};
use super::{Entry, Playback};
use etherpen::application::Mode;
use etherpen::robot::AXES;
use serde::Serialize;
use std::io;

/// Figures of one signal.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SignalStatistics {
    /// Its name.
    pub name: String,
    /// Its unit.
    pub unit: &'static str,
    /// Smallest value; `null` without any.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// Mean.
    pub mean: f64,
    /// Root of the mean square.
    pub rms: f64,
}

/// Time in one mode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ModeDuration {
    /// Which.
    pub mode: Mode,
    /// Time, s: a millisecond for each sample.
    pub seconds: f64,
}

/// Figures of a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Statistics {
    /// Where the samples came from.
    pub source: String,
    /// From the first to the last sample, s.
    pub duration_s: f64,
    /// Samples.
    pub samples: u64,
    /// Samples that are missing.
    pub missing: u64,
    /// Places where samples are missing.
    pub gaps: u64,
    /// Status messages.
    pub statuses: u64,
    /// Events.
    pub events: u64,
    /// Whether the file ends as it should.
    pub complete: bool,
    /// Largest following error of each axis while the robot follows a path or a move, rad.
    pub following_error_max_rad: [f64; AXES],
    /// Time in each mode that occurred.
    pub modes: Vec<ModeDuration>,
    /// Figures of each measured and referenced signal.
    pub signals: Vec<SignalStatistics>,
}

#[derive(Clone, Copy)]
struct Sums {
    count: f64,
    min: f64,
    max: f64,
    sum: f64,
    squares: f64,
}

impl Default for Sums {
    fn default() -> Self {
        Self {
            count: 0.0,
            min: f64::INFINITY,
            max: f64::NEG_INFINITY,
            sum: 0.0,
            squares: 0.0,
        }
    }
}

impl Sums {
    fn add(&mut self, value: f64) {
        self.count += 1.0;
        self.min = self.min.min(value);
        self.max = self.max.max(value);
        self.sum += value;
        self.squares += value * value;
    }

    fn of(self, signal: &Signal) -> SignalStatistics {
        SignalStatistics {
            name: signal.name.clone(),
            unit: signal.unit,
            min: self.min,
            max: self.max,
            mean: self.sum / self.count,
            rms: (self.squares / self.count).sqrt(),
        }
    }
}

/// Computes the figures of what is left of a recording.
///
/// # Errors
/// The recording cannot be read any further.
pub fn statistics<R: Source>(playback: &mut Playback<R>) -> io::Result<Statistics> {
    let mut evaluator = Evaluator::new(playback.config().as_ref());
    let signals: Vec<Signal> = columns()
        .into_iter()
        .filter(|signal| !signal.is_whole())
        .chain(errors())
        .collect();
    let mut sums = vec![Sums::default(); signals.len()];
    let mut modes = [0_u64; MODES.len()];
    let mut span_s: Option<(f64, f64)> = None;
    let mut figures = Statistics {
        source: playback.fact("source").unwrap_or_default().to_owned(),
        duration_s: 0.0,
        samples: 0,
        missing: 0,
        gaps: 0,
        statuses: 0,
        events: 0,
        complete: false,
        following_error_max_rad: [0.0; AXES],
        modes: Vec::new(),
        signals: Vec::new(),
    };
    while let Some((time_s, entry)) = playback.next_entry()? {
        match entry {
            Entry::Moment(moment) => {
                figures.samples += 1;
                span_s = Some((span_s.map_or(time_s, |(first, _)| first), time_s));
                evaluator.take(&moment);
                let mode = moment.sample.mode;
                if let Some(count) = modes.get_mut(usize::from(mode_number(mode))) {
                    *count += 1;
                }
                for (sums, signal) in sums.iter_mut().zip(&signals) {
                    if let Some(value) = evaluator.value(signal, &moment).number() {
                        sums.add(value);
                    }
                }
                if matches!(mode, Mode::Moving | Mode::Drawing | Mode::Holding) {
                    for (axis, most) in figures.following_error_max_rad.iter_mut().enumerate() {
                        let error = evaluator.error(axis, &moment).unwrap_or(0.0);
                        *most = most.max(error.abs());
                    }
                }
            }
            Entry::Gap(gap) => {
                figures.gaps += 1;
                figures.missing += u64::from(gap.missing);
                evaluator.interrupt();
            }
            Entry::State(_) => figures.statuses += 1,
            Entry::Event(_) => figures.events += 1,
        }
    }
    figures.duration_s = span_s.map_or(0.0, |(first, last)| last - first);
    figures.complete = playback.is_complete();
    figures.modes = MODES
        .into_iter()
        .zip(modes)
        .filter(|(_, count)| *count > 0)
        .map(|(mode, count)| ModeDuration {
            mode,
            seconds: count as f64 / 1_000.0,
        })
        .collect();
    figures.signals = sums
        .into_iter()
        .zip(&signals)
        .map(|(sums, signal)| sums.of(signal))
        .collect();
    Ok(figures)
}
