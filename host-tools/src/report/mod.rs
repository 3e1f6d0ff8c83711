//! Result of a drawing: the figures of `report.json`, and the tables beside it.
//!
//! Everything is computed from the firmware's measurements in every millisecond, the intended path, and the ink on the
//! virtual paper; figures reported by the planner itself are not used.

mod deviation;
pub mod identified;
pub mod output;
mod platform;
#[cfg(test)]
mod styles;
pub mod summary;
mod tables;
mod timing;
mod tracking_plot;

pub use deviation::NumberedStroke;
pub use tables::{write_intended, write_telemetry};
pub use timing::{Jitter, Spread, Timing};
pub use tracking_plot::write_tracking;

use crate::axes::{AxisView, Motion, PerAxis, Quantity, axes};
use crate::job::verification::Verdict;
use crate::matching::distance;
use deviation::{Distances, Moment, deviation, ink_deviation, ink_missing};
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::messages::{Counters, Sample};
use etherpen::motion::{Pen, Vertex, effective_jerk_window_ms, shaper_deviation_mm};
use etherpen::robots::{AXES, JointAngles, Kinematics, Position};
use platform::platform_limits;
use serde::Serialize;
use serde::ser::{SerializeMap, Serializer};

/// Peak speed, acceleration and jerk of one axis, and their limits, from the 1 ms references, in the axis's unit.
///
/// In `report.json` the names end in the unit: `speed_rad_s`, or `speed_mm_s` of a linear axis. An axis of a machine
/// with linear axes has its name, too.
#[derive(Clone, Debug)]
pub struct AxisLimits {
    /// The axis.
    pub axis: AxisView,
    /// Whether the axis is told by its name.
    pub is_named: bool,
    /// Highest speed and its limit.
    pub speed: [f64; 2],
    /// Highest acceleration and its limit.
    pub acceleration: [f64; 2],
    /// Highest jerk.
    pub jerk: f64,
    /// Limit of the jerk: 2 A / T with the jerk window T; `null` without a window.
    pub jerk_limit: Option<f64>,
}

impl Serialize for AxisLimits {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        if self.is_named {
            map.serialize_entry("axis", &self.axis.name)?;
        }
        let motion = self.axis.motion;
        let mut entry = |name: &str, quantity, value: Option<f64>| {
            map.serialize_entry(&format!("{name}_{}", motion.suffix(quantity)), &value)
        };
        let ([speed, speed_limit], [acceleration, acceleration_limit]) = (self.speed, self.acceleration);
        entry("speed", Quantity::Speed, Some(speed))?;
        entry("speed_limit", Quantity::Speed, Some(speed_limit))?;
        entry("acceleration", Quantity::Acceleration, Some(acceleration))?;
        entry("acceleration_limit", Quantity::Acceleration, Some(acceleration_limit))?;
        entry("jerk", Quantity::Jerk, Some(self.jerk))?;
        entry("jerk_limit", Quantity::Jerk, self.jerk_limit)?;
        map.end()
    }
}

/// Peak speed and acceleration of the platform from the 1 ms references, and their limits.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct PlatformLimits {
    /// Highest speed, mm/s.
    pub speed_mm_s: f64,
    /// Limit of the speed with the pen down, mm/s.
    pub speed_limit_mm_s: f64,
    /// Limit of the speed with the pen up, mm/s.
    pub travel_speed_limit_mm_s: f64,
    /// Highest acceleration, mm/s2.
    pub acceleration_mm_s2: f64,
    /// Limit of the acceleration, mm/s2.
    pub acceleration_limit_mm_s2: f64,
}

/// The virtual drives.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Drives {
    /// Bandwidth of the velocity loop, Hz.
    pub bandwidth_hz: f64,
    /// Age of a position when it is put on the bus, cycles of 1 ms.
    pub input_delay_cycles: usize,
    /// Age of a command when the drive acts on it, cycles of 1 ms.
    pub output_delay_cycles: usize,
}

/// The figures of a drawing, as in `report.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Whether the whole path was executed.
    pub completed: bool,
    /// Strokes drawn.
    pub strokes: usize,
    /// Strokes of the path.
    pub strokes_intended: usize,
    /// Length of the strokes that the measured positions followed with the pen down, mm.
    pub followed_mm: f64,
    /// Length that the measured positions did not follow, mm; a drawing with any is not completed.
    pub not_followed_mm: f64,
    /// Length without telemetry, mm.
    pub not_verified_mm: f64,
    /// Strokes with a part that was not followed, in the order of drawing, from 1.
    pub strokes_not_followed: Vec<u32>,
    /// Length of the intended strokes, mm; if the drawing was not completed, of the drawn part.
    pub pen_down_mm: f64,
    /// Length of the travel moves between them, including lifts, mm.
    pub pen_up_mm: f64,
    /// Duration that the planner computes for the path alone, s; `null` if it cannot be planned.
    pub planned_s: f64,
    /// Duration of the drawing on the machine, s, without the time on hold.
    pub drawn_s: f64,
    /// Time on hold, s.
    pub held_s: f64,
    /// Largest distance of a measured position from its stroke in space, mm, while its reference has the pen down;
    /// `null` without any.
    pub path_deviation_max_mm: f64,
    /// Root of the mean square of that distance, mm.
    pub path_deviation_rms_mm: f64,
    /// Largest distance of ink from its stroke on the paper, mm, wherever the pen touched, including on its way up and
    /// down; `null` if the paper cannot be read.
    pub ink_deviation_max_mm: f64,
    /// Root of the mean square of that distance, mm.
    pub ink_deviation_rms_mm: f64,
    /// Share of the shaping: largest distance of the pen-down references from their strokes, mm.
    pub shaping_deviation_max_mm: f64,
    /// Largest deviation allowed for the shaping, mm: the tolerance, and what an input shaper adds to it.
    pub shaping_tolerance_mm: f64,
    /// Share of the tracking: largest distance in space between a measured position and its pen-down reference, mm,
    /// along the path and across it.
    pub tracking_error_max_mm: f64,
    /// Root of the mean square of that distance, mm.
    pub tracking_error_rms_mm: f64,
    /// Intended length without ink nearby, mm; `null` if the paper cannot be read.
    pub ink_missing_mm: f64,
    /// Largest following error per axis.
    #[serde(flatten)]
    pub following_error_max: PerAxis,
    /// Peaks and limits per axis.
    pub limits: Vec<AxisLimits>,
    /// Peaks and limits of the platform.
    pub platform: PlatformLimits,
    /// Milliseconds the firmware ran.
    pub cycles: u32,
    /// Output telegrams that were late.
    pub cycles_late: u32,
    /// Telegrams without a reply.
    pub frames_lost: u32,
    /// Replies with an unexpected working counter.
    pub working_counter_errors: u32,
    /// Milliseconds without a reference.
    pub reference_underruns: u32,
    /// Times the path ran out of data.
    pub path_starvations: u32,
    /// Telemetry samples lost on the line.
    pub telemetry_lost: u32,
    /// Hash of the firmware image, or `simulation`.
    pub image: String,
    /// The virtual drives; absent on a real machine.
    pub drives: Option<Drives>,
    /// Processor time of this process while virtual time ran, s; absent if the time was not virtual.
    pub processor_s: Option<f64>,
    /// Virtual seconds for each second of processor time, including the host's part and the capture; absent if the time
    /// was not virtual.
    pub virtual_to_processor_ratio: Option<f64>,
    /// Correlation of the drawn picture with the photograph, both blurred; absent if either is missing.
    pub tone_correlation: Option<f64>,
    /// The firmware's own measurements.
    #[serde(flatten)]
    pub timing: Timing,
}

/// Data for a report.
pub struct Evidence<'a> {
    /// The configuration that was in effect.
    pub config: &'a Config,
    /// The intended path.
    pub path: &'a [Vertex],
    /// The firmware's samples.
    pub samples: &'a [Sample],
    /// Lines of ink in the robot's frame, mm, in the order they were drawn; absent if the paper cannot be read.
    pub ink_mm: Option<&'a [Vec<[f64; 2]>]>,
    /// The job's verdict on the path being followed.
    pub verdict: &'a Verdict,
    /// The firmware's counters.
    pub counters: Counters,
    /// Whether the whole path was executed.
    pub completed: bool,
    /// Planner's duration, s.
    pub planned_s: f64,
    /// Hash of the firmware image, or `simulation`.
    pub image: String,
    /// The virtual drives.
    pub drives: Option<Drives>,
}

/// One millisecond in the robot's frame.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// The sample as received.
    pub sample: Sample,
    /// Measured position of the platform, mm.
    pub position: Position,
    /// Commanded position of the platform for the measured one, mm.
    pub reference: Position,
    /// Stroke the measured position belongs to.
    pub stroke: u32,
    /// Pen state on the path for the measured position.
    pub pen: Pen,
}

/// Converts the measured positions into the robot's frame. The controller compares a measurement with the reference of
/// its age, and reads the feed-forward ahead so that the two agree; stroke and pen are those of that reference.
pub fn rows(config: &Config, samples: &[Sample]) -> Vec<Row> {
    let Ok(kinematics) = Kinematics::new(&config.geometry) else {
        return Vec::new();
    };
    let platform = |angles_rad: [f32; AXES]| {
        kinematics
            .forward(&JointAngles(angles_rad.map(f64::from)))
            .unwrap_or_default()
    };
    let age = config.axes[0].measurement_age_ms.round() as usize;
    let at_age = |index: usize| samples.get(index.saturating_sub(age)).unwrap_or(&samples[0]);
    let row = |(index, sample): (usize, &Sample)| {
        let cause = at_age(index);
        Row {
            sample: *sample,
            position: platform(sample.measured_rad),
            reference: platform(cause.setpoint_rad),
            stroke: cause.stroke,
            pen: cause.pen,
        }
    };
    samples.iter().enumerate().map(row).collect()
}

/// Largest distance in space between the measured platform and its reference while a path is executed, pen up or down,
/// and its root mean square, mm; NaN without samples.
pub fn tracking(config: &Config, samples: &[Sample]) -> (f64, f64) {
    let drawing: Vec<Sample> = drawn_part(samples).copied().collect();
    let mut distances = Distances::default();
    let rows = rows(config, &drawing);
    rows.iter()
        .for_each(|row| distances.add(distance(&row.position, &row.reference)));
    let result = distances.result();
    (result.max_mm, result.rms_mm)
}

impl Report {
    /// Computes the figures.
    pub fn new(evidence: &Evidence) -> Self {
        let drawing: Vec<Sample> = drawn_part(evidence.samples).copied().collect();
        let rows = rows(evidence.config, &drawing);
        let strokes = strokes(evidence.path);
        let drawn_rows = || rows.iter().filter(|row| row.pen == Pen::Down);
        let moment = |row: &Row| Moment {
            t_ms: row.sample.t_ms,
            stroke: row.stroke,
            reference: row.reference,
            measured: row.position,
        };
        let moments: Vec<Moment> = drawn_rows().map(moment).collect();
        let (shaping, path) = deviation(&moments, &strokes, evidence.config.motion.speed_mm_s);
        let mut tracking = Distances::default();
        drawn_rows().for_each(|row| tracking.add(distance(&row.position, &row.reference)));
        let tracking = tracking.result();
        let ink = ink_deviation(evidence.ink_mm.unwrap_or_default(), &strokes);
        let (pen_down_mm, pen_up_mm) = lengths(evidence.path);
        let ink_missing_mm = evidence.ink_mm.map_or(f64::NAN, |ink| ink_missing(&strokes, ink));
        let mut drawn: Vec<u32> = drawn_rows().map(|row| row.stroke).collect();
        drawn.dedup();
        let (counters, verdict) = (&evidence.counters, evidence.verdict);
        let held = drawing.iter().filter(|sample| sample.mode == Mode::Holding);
        let held_ms = u32::try_from(held.count()).unwrap_or(u32::MAX);
        Self {
            completed: evidence.completed,
            strokes: drawn.len(),
            strokes_intended: strokes.len(),
            followed_mm: verdict.followed_mm,
            not_followed_mm: verdict.missing_mm,
            not_verified_mm: verdict.unverified_mm,
            strokes_not_followed: verdict.strokes.iter().map(|number| number + 1).collect(),
            pen_down_mm,
            pen_up_mm,
            planned_s: evidence.planned_s,
            drawn_s: f64::from(span_ms(&drawing).saturating_sub(held_ms)) / 1_000.0,
            held_s: f64::from(held_ms) / 1_000.0,
            path_deviation_max_mm: path.max_mm,
            path_deviation_rms_mm: path.rms_mm,
            ink_deviation_max_mm: ink.max_mm,
            ink_deviation_rms_mm: ink.rms_mm,
            shaping_deviation_max_mm: shaping.max_mm,
            shaping_tolerance_mm: {
                let motion = &evidence.config.motion;
                motion.tolerance_mm + shaper_deviation_mm(motion)
            },
            tracking_error_max_mm: tracking.max_mm,
            tracking_error_rms_mm: tracking.rms_mm,
            ink_missing_mm,
            following_error_max: PerAxis::new(
                "following_error_max",
                axes(evidence.config),
                Some(&following_error(evidence.config, &drawing)),
            ),
            limits: limits(evidence.config, &drawing),
            platform: platform_limits(evidence.config, &drawing),
            cycles: counters.cycles,
            cycles_late: counters.cycles_late,
            frames_lost: counters.frames_lost,
            working_counter_errors: counters.working_counter_errors,
            reference_underruns: counters.setpoint_underruns,
            path_starvations: counters.path_starvations,
            telemetry_lost: span_ms(evidence.samples).saturating_sub(evidence.samples.len() as u32),
            image: evidence.image.clone(),
            drives: evidence.drives,
            processor_s: None,
            virtual_to_processor_ratio: None,
            tone_correlation: None,
            timing: Timing::default(),
        }
    }
}

/// Milliseconds from the first to the last sample, both included.
fn span_ms(samples: &[Sample]) -> u32 {
    match (samples.first(), samples.last()) {
        (Some(first), Some(last)) => last.t_ms.wrapping_sub(first.t_ms).wrapping_add(1),
        _ => 0,
    }
}

/// The samples from the first to the last one in which the path was executed.
fn drawn_part(samples: &[Sample]) -> impl Iterator<Item = &Sample> {
    let active = |sample: &Sample| matches!(sample.mode, Mode::Drawing | Mode::Holding);
    let first = samples.iter().position(active).unwrap_or(samples.len());
    let last = samples.iter().rposition(active).map_or(first, |last| last + 1);
    samples[first..last].iter()
}

/// The drawn polylines of a path with their stroke numbers, each from the vertex where the pen came down.
pub fn strokes(path: &[Vertex]) -> Vec<NumberedStroke> {
    let mut strokes: Vec<NumberedStroke> = Vec::new();
    for pair in path.windows(2) {
        if pair[1].pen == Pen::Up {
            continue;
        }
        match strokes.last_mut() {
            Some((number, points)) if *number == pair[1].stroke && points.last() == Some(&pair[0].position) => {
                points.push(pair[1].position);
            }
            _ => strokes.push((pair[1].stroke, vec![pair[0].position, pair[1].position])),
        }
    }
    strokes
}

fn lengths(path: &[Vertex]) -> (f64, f64) {
    let mut sums = (0.0, 0.0);
    for pair in path.windows(2) {
        let length_mm = distance(&pair[0].position, &pair[1].position);
        match pair[1].pen {
            Pen::Down => sums.0 += length_mm,
            Pen::Up => sums.1 += length_mm,
        }
    }
    sums
}

fn following_error(config: &Config, samples: &[Sample]) -> [f64; AXES] {
    std::array::from_fn(|axis| {
        let age = config.axes[axis].measurement_age_ms.round() as usize;
        let errors = samples.iter().skip(age).zip(samples);
        let error = errors.map(|(now, then)| f64::from(then.setpoint_rad[axis] - now.measured_rad[axis]).abs());
        error.fold(0.0, f64::max)
    })
}

fn limits(config: &Config, samples: &[Sample]) -> Vec<AxisLimits> {
    let motion = &config.motion;
    let window_s = f64::from(effective_jerk_window_ms(&config.motion_settings())) / 1_000.0;
    let axes = axes(config);
    let is_named = axes.iter().any(|axis| axis.motion == Motion::Linear);
    let of_axis = |axis: AxisView| {
        let speed: Vec<f64> = samples.iter().map(|sample| axis.of(&sample.setpoint_rad_s)).collect();
        let per_second = |values: &[f64]| -> Vec<f64> { values.windows(2).map(|w| (w[1] - w[0]) * 1_000.0).collect() };
        let peak = |values: &[f64]| values.iter().fold(0.0_f64, |peak, value| peak.max(value.abs()));
        let acceleration = per_second(&speed);
        let acceleration_limit = axis.of(&motion.joint_acceleration_rad_s2);
        AxisLimits {
            is_named,
            speed: [peak(&speed), axis.of(&motion.joint_speed_rad_s)],
            acceleration: [peak(&acceleration), acceleration_limit],
            jerk: peak(&per_second(&acceleration)),
            jerk_limit: (window_s > 0.0).then(|| 2.0 * acceleration_limit / window_s),
            axis,
        }
    };
    axes.into_iter().map(of_axis).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x_mm: f64, y_mm: f64) -> Position {
        Position {
            x_mm,
            y_mm,
            z_mm: -850.0,
        }
    }

    #[test]
    fn strokes_begin_where_the_pen_came_down() {
        let vertex = |x_mm, pen, stroke| Vertex {
            position: at(x_mm, 0.0),
            pen,
            stroke,
        };
        let path = [
            vertex(0.0, Pen::Up, 0),
            vertex(1.0, Pen::Down, 0),
            vertex(2.0, Pen::Down, 0),
            vertex(3.0, Pen::Up, 1),
            vertex(4.0, Pen::Down, 1),
        ];
        let strokes = strokes(&path);
        assert_eq!(
            strokes,
            [
                (0, vec![at(0.0, 0.0), at(1.0, 0.0), at(2.0, 0.0)]),
                (1, vec![at(3.0, 0.0), at(4.0, 0.0)])
            ]
        );
        assert_eq!(lengths(&path), (3.0, 1.0));
    }

    #[test]
    fn limits_are_told_in_the_unit_of_their_axis() {
        let limits = |config: &Config| serde_json::to_value(limits(config, &[])).unwrap();
        let built_in = limits(&Config::default());
        assert_eq!(
            (built_in.as_array().unwrap().len(), &built_in[0]["speed_limit_rad_s"]),
            (4, &25.0.into())
        );
        assert_eq!(built_in[0].as_object().unwrap().len(), 6);
        let mut config = Config {
            geometry: etherpen::robots::Kind::CoreXy.geometry(),
            ..Config::default()
        };
        config.bus.drives = 2;
        let belts = limits(&config);
        assert_eq!(belts.as_array().unwrap().len(), 2);
        assert_eq!(
            (&belts[1]["axis"], &belts[1]["speed_limit_mm_s"]),
            (&"b".into(), &2_500.0.into())
        );
        assert!(belts[0].get("jerk_mm_s3").is_some() && belts[0].get("speed_rad_s").is_none());
    }
}
