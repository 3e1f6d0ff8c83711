//! Statistics of a recording: duration, gaps, extremes of every signal, following errors, time in each mode.
//!
//! Invariants: one pass, with memory independent of the length; a jump of a measured position, as when a reference is
//! taken, does not count as a speed.

use super::mcap::Source;
use super::moment::Moment;
use super::signals::{Evaluator, Signal, columns, errors};
use super::{Playback, RecordingEntry};
use crate::axes::{PerAxis, axes};
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::robots::AXES;
use serde::Serialize;
use std::io;

/// Statistics of one signal.
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

/// Time spent in one mode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ModeDuration {
    /// The mode.
    pub mode: Mode,
    /// Time, s: a millisecond for each sample.
    pub seconds: f64,
}

/// Statistics of a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Statistics {
    /// Source of the samples.
    pub source: String,
    /// Duration from the first to the last sample, s.
    pub duration_s: f64,
    /// Number of samples.
    pub samples: u64,
    /// Number of missing samples.
    pub missing: u64,
    /// Number of gaps.
    pub gaps: u64,
    /// Number of status messages.
    pub statuses: u64,
    /// Number of events.
    pub events: u64,
    /// Whether the file has its regular end.
    pub complete: bool,
    /// Largest following error of each axis while the robot follows a path or a move.
    #[serde(flatten)]
    pub following_error_max: PerAxis,
    /// Time in each mode that occurred.
    pub modes: Vec<ModeDuration>,
    /// Statistics of each measured and reference signal.
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

/// Acceleration of a jump, as a multiple of the axis's planned acceleration.
const JUMP: f64 = 8.0;
/// Time between two samples, s.
const SAMPLE_S: f64 = 0.001;

/// Finds samples in which a measured position jumps: its speed differs from those before and after, in one direction,
/// by more than any motor can accelerate. Each sample is returned when the next one is known.
struct Jumps {
    limits_rad_s: [f64; AXES],
    before_rad_s: Option<[f32; AXES]>,
    held: Option<(f64, Moment)>,
}

/// A sample with its time, s, and the axes that jump in it.
type Settled = (f64, Moment, [bool; AXES]);

impl Jumps {
    fn new(config: &Config) -> Self {
        let limits = config.motion.joint_acceleration_rad_s2;
        Self {
            limits_rad_s: limits.map(|limit| JUMP * limit * SAMPLE_S),
            before_rad_s: None,
            held: None,
        }
    }

    /// Takes the next sample; returns the previous one.
    fn take(&mut self, time_s: f64, moment: Moment) -> Option<Settled> {
        let settled = self.settle(Some(moment.sample.measured_rad_s));
        self.held = Some((time_s, moment));
        settled
    }

    /// Handles a gap after the last sample; returns that sample.
    fn interrupt(&mut self) -> Option<Settled> {
        let settled = self.settle(None);
        self.before_rad_s = None;
        settled
    }

    fn settle(&mut self, after_rad_s: Option<[f32; AXES]>) -> Option<Settled> {
        let (time_s, moment) = self.held.take()?;
        let own = moment.sample.measured_rad_s;
        let neighbours = [self.before_rad_s, after_rad_s];
        let mut jumped = [false; AXES];
        for (axis, (jumped, limit)) in jumped.iter_mut().zip(self.limits_rad_s).enumerate() {
            let speed = |speeds: &[f32; AXES]| speeds.get(axis).copied().map_or(0.0, f64::from);
            let away = neighbours.iter().flatten().map(|speeds| speed(&own) - speed(speeds));
            let alone = neighbours.iter().flatten().count() == 0;
            *jumped = !alone && (away.clone().all(|by| by > limit) || away.clone().all(|by| by < -limit));
        }
        self.before_rad_s = Some(own);
        Some((time_s, moment, jumped))
    }
}

/// Accumulators of the statistics.
struct Counting {
    evaluator: Evaluator,
    signals: Vec<Signal>,
    sums: Vec<Sums>,
    modes: [u64; Mode::ALL.len()],
    span_s: Option<(f64, f64)>,
}

impl Counting {
    fn count(&mut self, (time_s, moment, jumped): Settled, figures: &mut Statistics) {
        figures.samples += 1;
        self.span_s = Some((self.span_s.map_or(time_s, |(first, _)| first), time_s));
        if jumped.contains(&true) {
            // Earlier references belong to other angles.
            self.evaluator.interrupt();
        }
        self.evaluator.take(&moment);
        let mode = moment.sample.mode;
        if let Some(count) = self.modes.get_mut(usize::from(mode.number())) {
            *count += 1;
        }
        for (sums, signal) in self.sums.iter_mut().zip(&self.signals) {
            let jumps = |axis: usize| jumped.get(axis).copied().unwrap_or(false);
            let value = self.evaluator.value(signal, &moment).number();
            if let Some(value) = value.filter(|_| !signal.measured_speed().is_some_and(jumps)) {
                sums.add(value);
            }
        }
        if matches!(mode, Mode::Moving | Mode::Drawing | Mode::Holding) {
            let error = |axis| self.evaluator.error(axis, &moment).unwrap_or(0.0).abs();
            figures.following_error_max.raise(error);
        }
    }
}

/// Computes the statistics of the rest of a recording.
///
/// # Errors
/// The rest of the recording cannot be read.
pub fn statistics<R: Source>(playback: &mut Playback<R>) -> io::Result<Statistics> {
    let config = playback.config();
    let machine = config.clone().unwrap_or_default();
    let signals = columns(&machine).into_iter().filter(|signal| !signal.is_whole());
    let signals: Vec<Signal> = signals.chain(errors(&machine)).collect();
    let mut counting = Counting {
        evaluator: Evaluator::new(config.as_ref()),
        sums: vec![Sums::default(); signals.len()],
        signals,
        modes: [0; Mode::ALL.len()],
        span_s: None,
    };
    let mut jumps = Jumps::new(&machine);
    let mut figures = Statistics {
        source: playback.fact("source").unwrap_or_default().to_owned(),
        duration_s: 0.0,
        samples: 0,
        missing: 0,
        gaps: 0,
        statuses: 0,
        events: 0,
        complete: false,
        following_error_max: PerAxis::new("following_error_max", axes(&machine), Some(&[0.0_f64; AXES])),
        modes: Vec::new(),
        signals: Vec::new(),
    };
    while let Some((time_s, entry)) = playback.next_entry()? {
        match entry {
            RecordingEntry::Moment(moment) => {
                if let Some(settled) = jumps.take(time_s, moment) {
                    counting.count(settled, &mut figures);
                }
            }
            RecordingEntry::Gap(gap) => {
                if let Some(settled) = jumps.interrupt() {
                    counting.count(settled, &mut figures);
                }
                figures.gaps += 1;
                figures.missing += u64::from(gap.missing);
                counting.evaluator.interrupt();
            }
            RecordingEntry::State(_) => figures.statuses += 1,
            RecordingEntry::Event(_) => figures.events += 1,
        }
    }
    if let Some(settled) = jumps.interrupt() {
        counting.count(settled, &mut figures);
    }
    figures.duration_s = counting.span_s.map_or(0.0, |(first, last)| last - first);
    figures.complete = playback.is_complete();
    figures.modes = Mode::ALL
        .into_iter()
        .zip(counting.modes)
        .filter(|(_, count)| *count > 0)
        .map(|(mode, count)| ModeDuration {
            mode,
            seconds: count as f64 / 1_000.0,
        })
        .collect();
    figures.signals = counting
        .sums
        .into_iter()
        .zip(&counting.signals)
        .map(|(sums, signal)| sums.of(signal))
        .collect();
    Ok(figures)
}
