//! The signals of a recording by name: the columns of `telemetry.csv`, and values derived from them.
//!
//! Beside the columns there are `q1_error_rad` and so on: the reference to which a measured position belongs minus the
//! position, which is the input of the controller. Linear axes have millimetres. Invariant: a value that needs samples from before a gap is missing, not
//! wrong.

use super::moment::{Moment, axes};
use crate::axes::{Motion, Quantity as JointQuantity};
use etherpen::application::Mode;
use etherpen::config::{Config, IoPoint, IoType};
use etherpen::messages::IoValues;
use etherpen::motion::Pen;
use etherpen::robots::AXES;
use std::collections::VecDeque;

/// Difference between the firmware's speed and that of the positions above which the position counts as jumped, rad/s.
const JUMP_RAD_S: f32 = 2.0;
/// Place of the measured speed among the columns of an axis.
const MEASURED_SPEED: usize = 3;

/// Quantity of a signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Quantity {
    Time,
    Mode,
    Stroke,
    Pen,
    /// Coordinate of the platform.
    Position(usize),
    /// Column of an axis: reference position, position, reference speed, speed.
    Axis(usize, usize, Motion),
    /// Following error of an axis.
    Error(usize, Motion),
    /// A named input or output.
    Io(IoColumn),
}

/// The column of a named input or output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IoColumn {
    /// Its place in the configuration.
    place: usize,
    kind: IoType,
    /// Its place among the words of a sample; `None` for a bit, and for a word that is not in the samples.
    word: Option<usize>,
}

impl IoColumn {
    /// The columns of a machine's named inputs and outputs.
    pub fn all(config: &Config) -> impl Iterator<Item = Self> {
        let words = config.sampled_words();
        let column = move |(place, point): (usize, &IoPoint)| Self {
            place,
            kind: point.kind,
            word: words.iter().position(|word| usize::from(*word) == place),
        };
        config.io.iter().enumerate().map(column)
    }

    /// The value in a sample: of a bit 0 or 1; `None` while the point is missing, and for a word that is not 0 and not in
    /// the sample.
    pub fn value(&self, io: &IoValues) -> Option<i64> {
        let is_set = io.get(self.place)?;
        if self.kind == IoType::Bool || !is_set {
            return Some(is_set.into());
        }
        let raw = self.word.and_then(|word| io.words.values().nth(word))?;
        Some(self.kind.value(raw))
    }
}

/// One signal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signal {
    /// Name, with the unit at the end.
    pub name: String,
    /// Unit; empty for a number or a state.
    pub unit: &'static str,
    quantity: Quantity,
}

/// A value of a signal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// A count.
    Whole(u32),
    /// An operating mode.
    Mode(Mode),
    /// A measurement, with its number of decimals.
    Real(f64, usize),
    /// The value needs samples that are missing.
    Missing,
}

impl Value {
    /// The value as a number: a mode's is its place in the list of modes.
    pub fn number(self) -> Option<f64> {
        match self {
            Self::Whole(value) => Some(value.into()),
            Self::Mode(mode) => Some(mode.number().into()),
            Self::Real(value, _) => Some(value),
            Self::Missing => None,
        }
    }
}

impl Signal {
    fn new(name: impl Into<String>, unit: &'static str, quantity: Quantity) -> Self {
        Self {
            name: name.into(),
            unit,
            quantity,
        }
    }

    /// Whether the signal is a state or a word of a terminal, whose values cannot be interpolated.
    pub fn is_state(&self) -> bool {
        matches!(
            self.quantity,
            Quantity::Mode | Quantity::Stroke | Quantity::Pen | Quantity::Io(_)
        )
    }

    /// Whether the signal is the operating mode.
    pub fn is_mode(&self) -> bool {
        self.quantity == Quantity::Mode
    }

    /// Whether the signal is the device's time.
    pub fn is_time(&self) -> bool {
        self.quantity == Quantity::Time
    }

    /// The axis of a measured speed.
    pub fn measured_speed(&self) -> Option<usize> {
        match self.quantity {
            Quantity::Axis(axis, MEASURED_SPEED, _) => Some(axis),
            _ => None,
        }
    }

    /// Whether the signal is a count or a state, without a fraction and never missing.
    pub fn is_whole(&self) -> bool {
        (self.is_time() || self.is_state()) && !matches!(self.quantity, Quantity::Io(_))
    }

    /// Whether its values are measured or reference values in single precision.
    pub fn is_single(&self) -> bool {
        matches!(self.quantity, Quantity::Axis(..))
    }
}

/// The columns of `telemetry.csv` of a machine, in order.
pub fn columns(config: &Config) -> Vec<Signal> {
    let mut signals = vec![
        Signal::new("t_ms", "ms", Quantity::Time),
        Signal::new("mode", "", Quantity::Mode),
        Signal::new("stroke", "", Quantity::Stroke),
        Signal::new("pen", "", Quantity::Pen),
    ];
    for (k, name) in ["x_mm", "y_mm", "z_mm"].into_iter().enumerate() {
        signals.push(Signal::new(name, "mm", Quantity::Position(k)));
    }
    for axis in crate::axes::axes(config) {
        let motion = axis.motion;
        for (k, name) in axis.columns().into_iter().enumerate() {
            signals.push(Signal::new(
                name,
                motion.unit(of_column(k)),
                Quantity::Axis(axis.index, k, motion),
            ));
        }
    }
    for (point, column) in config.io.iter().zip(IoColumn::all(config)) {
        signals.push(Signal::new(io_column(point), "", Quantity::Io(column)));
    }
    signals
}

/// Name of the column of a named input or output.
pub fn io_column(point: &IoPoint) -> String {
    format!("io_{}", point.name)
}

/// The quantity of a column of an axis.
fn of_column(column: usize) -> JointQuantity {
    match column {
        0 | 1 => JointQuantity::Position,
        _ => JointQuantity::Speed,
    }
}

/// The following errors of a machine's axes.
pub fn errors(config: &Config) -> Vec<Signal> {
    let error = |axis: crate::axes::AxisView| {
        let suffix = axis.motion.suffix(JointQuantity::Position);
        let name = format!("q{}_error_{suffix}", axis.index + 1);
        let quantity = Quantity::Error(axis.index, axis.motion);
        Signal::new(name, axis.motion.unit(JointQuantity::Position), quantity)
    };
    crate::axes::axes(config).into_iter().map(error).collect()
}

/// The signals with these names, separated by commas; `*` stands for any characters.
///
/// # Errors
/// An unknown name, with all known names.
pub fn named(list: &str, config: &Config) -> Result<Vec<Signal>, String> {
    let all: Vec<Signal> = columns(config).into_iter().chain(errors(config)).collect();
    let mut chosen: Vec<Signal> = Vec::new();
    for pattern in list.split(',').map(str::trim).filter(|name| !name.is_empty()) {
        let matching: Vec<&Signal> = all.iter().filter(|signal| matches(pattern, &signal.name)).collect();
        if matching.is_empty() {
            let names: Vec<&str> = all.iter().map(|signal| signal.name.as_str()).collect();
            return Err(format!("there is no signal {pattern}; there are {}", names.join(", ")));
        }
        for signal in matching {
            if !chosen.contains(signal) {
                chosen.push(signal.clone());
            }
        }
    }
    if chosen.is_empty() {
        return Err("no signal was named; for example q1_*, or q*_error_*".into());
    }
    Ok(chosen)
}

/// Whether a name matches the pattern, in which `*` stands for any characters.
fn matches(pattern: &str, name: &str) -> bool {
    let Some((before, after)) = pattern.split_once('*') else {
        return pattern == name;
    };
    let Some(rest) = name.strip_prefix(before) else {
        return false;
    };
    (0..=rest.len()).any(|skipped| rest.get(skipped..).is_some_and(|tail| matches(after, tail)))
}

/// Computes the values of signals, sample by sample.
pub struct Evaluator {
    /// Age of each axis' measurement when it is compared with its reference, samples.
    ages: [usize; AXES],
    /// The last references, the latest first.
    references_rad: VecDeque<[f32; AXES]>,
    /// The last measurement.
    measured_rad: Option<[f32; AXES]>,
}

impl Evaluator {
    /// An evaluator for this configuration; the built-in one if the file has none.
    pub fn new(config: Option<&Config>) -> Self {
        let default = Config::default();
        let axes = &config.unwrap_or(&default).axes;
        let age = |axis: usize| {
            axes.get(axis)
                .map_or(0, |axis| axis.measurement_age_ms.round() as usize)
        };
        Self {
            ages: std::array::from_fn(age),
            references_rad: VecDeque::new(),
            measured_rad: None,
        }
    }

    /// Handles a gap: samples are missing here.
    pub fn interrupt(&mut self) {
        self.references_rad.clear();
        self.measured_rad = None;
    }

    /// Takes the next sample. Where a position jumps without a speed, a reference was taken: earlier references belong
    /// to other angles.
    pub fn take(&mut self, moment: &Moment) {
        let sample = &moment.sample;
        let has_jumped = |before_rad: &[f32; AXES]| {
            let axes = before_rad.iter().zip(&sample.measured_rad).zip(&sample.measured_rad_s);
            axes.map(|((before, now), speed)| (now - before) * 1_000.0 - speed)
                .any(|difference| difference.abs() > JUMP_RAD_S)
        };
        if self.measured_rad.as_ref().is_some_and(has_jumped) {
            self.interrupt();
        }
        self.measured_rad = Some(sample.measured_rad);
        self.references_rad.push_front(moment.sample.setpoint_rad);
        let oldest = self.ages.iter().copied().max().unwrap_or(0);
        self.references_rad.truncate(oldest + 1);
    }

    /// The value of a signal in the last sample.
    pub fn value(&self, signal: &Signal, moment: &Moment) -> Value {
        let sample = &moment.sample;
        match signal.quantity {
            Quantity::Time => Value::Whole(sample.t_ms),
            Quantity::Mode => Value::Mode(sample.mode),
            Quantity::Stroke => Value::Whole(sample.stroke),
            Quantity::Pen => Value::Whole((sample.pen == Pen::Down).into()),
            Quantity::Position(k) => {
                let position = [moment.position.x_mm, moment.position.y_mm, moment.position.z_mm];
                position.get(k).map_or(Value::Missing, |value| Value::Real(*value, 4))
            }
            Quantity::Axis(axis, k, motion) => {
                let columns = axes(sample).nth(axis).unwrap_or_default();
                let decimals = motion.decimals(of_column(k));
                columns.get(k).map_or(Value::Missing, |value| {
                    Value::Real(f64::from(*value) * motion.factor(), decimals)
                })
            }
            // Every word is exact in double precision.
            Quantity::Io(column) => column
                .value(&sample.io)
                .map_or(Value::Missing, |value| Value::Real(value as f64, 0)),
            Quantity::Error(axis, motion) => self.error(axis, moment).map_or(Value::Missing, |error| {
                Value::Real(error * motion.factor(), motion.decimals(JointQuantity::Position))
            }),
        }
    }

    /// Following error of an axis, rad; `None` where its reference is missing.
    pub fn error(&self, axis: usize, moment: &Moment) -> Option<f64> {
        let age = *self.ages.get(axis)?;
        let reference = self.references_rad.get(age)?.get(axis)?;
        Some(f64::from(reference - moment.sample.measured_rad.get(axis)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_the_columns_of_the_telemetry_and_a_star_stands_for_any() {
        let config = Config::default();
        let names = |list: &str| -> Vec<String> {
            let signals = named(list, &config).unwrap();
            signals.into_iter().map(|signal| signal.name).collect()
        };
        assert_eq!(names("q1_rad, x_mm"), ["q1_rad", "x_mm"]);
        assert_eq!(names("q*_error_rad").len(), AXES);
        assert_eq!(names("v2*,v2_rad_s"), ["v2_ref_rad_s", "v2_rad_s"]);
        let error = named("q9_rad", &config).unwrap_err();
        assert!(error.contains("q9_rad") && error.contains("q4_error_rad"), "{error}");
        assert!(named(" ,", &config).is_err());
        assert_eq!(columns(&config).len(), 7 + 4 * AXES);
    }

    #[test]
    fn linear_axes_are_in_millimetres_and_missing_axes_have_no_columns() {
        let mut config = Config {
            geometry: etherpen::robots::Kind::CoreXy.geometry(),
            ..Config::default()
        };
        config.bus.drives = 2;
        let names: Vec<_> = columns(&config).into_iter().map(|signal| signal.name).collect();
        assert_eq!(names.len(), 7 + 4 * 2);
        assert_eq!(names[7..11], ["q1_ref_mm", "q1_mm", "v1_ref_mm_s", "v1_mm_s"]);
        let error = named("q2_error_mm", &config).unwrap();
        assert_eq!((error.len(), error[0].unit), (1, "mm"));
        assert!(named("q3*", &config).is_err());
    }
}
