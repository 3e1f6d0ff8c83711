//! Signals for plots: the telemetry of every axis, and the resulting motion of the pen.
//!
//! A sample of the firmware becomes a row of numbers on the console's own time axis, which continues after a restart of
//! the firmware. Invariant: a row has a value for every signal of the catalogue; a value that cannot be computed is a
//! NaN.

use super::skeleton::{Part, moving};
use crate::axes::{AxisView, Quantity, axes};
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::messages::Sample;
use etherpen::motion::Pen;
use etherpen::robots::{AXES, Geometry, JointAngles, Kinematics, Position};

/// Signals of one axis.
const PER_AXIS: usize = 5;
/// Signals of the platform.
const OF_PLATFORM: usize = 8;
/// Most signals of a machine.
pub const SIGNALS: usize = AXES * PER_AXIS + OF_PLATFORM;
/// Largest gap of the telemetry across which a speed is computed from differences, ms.
const GAP_MS: u32 = 1;
/// Difference between the firmware's speed and that of the positions above which the position counts as jumped, rad/s.
const JUMP_RAD_S: f32 = 2.0;
/// Jump of the console's time axis after a restart of the firmware, ms.
const RESTART_MS: u64 = 1_000;

/// A signal that can be plotted.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct PlotSignal {
    /// Name in files and messages, with the unit.
    pub name: String,
    /// Label for display.
    pub label: String,
    /// Unit.
    pub unit: &'static str,
    /// The axis, from 1; 0 for the platform.
    pub axis: usize,
}

/// All signals of a machine, in the order of the values of a [`SignalRow`].
pub fn catalogue(config: &Config) -> Vec<PlotSignal> {
    let of_axis = |axis: AxisView| {
        let (number, motion) = (axis.index + 1, axis.motion);
        let [q_ref, q, v_ref, v] = axis.columns();
        let error = format!("e{number}_{}", motion.suffix(Quantity::Position));
        [
            (q_ref, "setpoint", Quantity::Position),
            (q, "actual", Quantity::Position),
            (error, "following error", Quantity::Position),
            (v_ref, "velocity setpoint", Quantity::Speed),
            (v, "velocity", Quantity::Speed),
        ]
        .map(|(name, text, quantity)| PlotSignal {
            name,
            label: format!("{} {text}", axis.label),
            unit: motion.unit(quantity),
            axis: number,
        })
    };
    let of_platform = [
        ("x_ref_mm", "x reference", "mm"),
        ("y_ref_mm", "y reference", "mm"),
        ("z_ref_mm", "z reference", "mm"),
        ("x_mm", "x actual", "mm"),
        ("y_mm", "y actual", "mm"),
        ("z_mm", "z actual", "mm"),
        ("speed_ref_mm_s", "speed reference", "mm/s"),
        ("speed_mm_s", "speed", "mm/s"),
    ]
    .map(|(name, label, unit)| PlotSignal {
        name: name.to_owned(),
        label: label.to_owned(),
        unit,
        axis: 0,
    });
    axes(config).into_iter().flat_map(of_axis).chain(of_platform).collect()
}

/// One millisecond of all signals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalRow {
    /// Console time, ms.
    pub time_ms: u64,
    /// Firmware time, ms.
    pub t_ms: u32,
    /// Operating mode.
    pub mode: Mode,
    /// Pen state in the reference.
    pub pen: Pen,
    /// Stroke being drawn or approached.
    pub stroke: u32,
    /// Number of axes.
    pub axes: u8,
    /// Values of the catalogue, NaN behind its last.
    pub values: [f32; SIGNALS],
}

impl SignalRow {
    /// Commanded position of the platform, mm.
    pub fn commanded_mm(&self) -> [f32; 3] {
        std::array::from_fn(|axis| self.value(usize::from(self.axes) * PER_AXIS + axis))
    }

    /// Measured position of the platform, mm.
    pub fn measured_mm(&self) -> [f32; 3] {
        std::array::from_fn(|axis| self.value(usize::from(self.axes) * PER_AXIS + 3 + axis))
    }

    /// A value by its number in the catalogue.
    pub fn value(&self, signal: usize) -> f32 {
        self.values.get(signal).copied().unwrap_or(f32::NAN)
    }
}

/// Converts samples into rows.
pub struct Rows {
    kinematics: Option<Kinematics>,
    geometry: Geometry,
    axes: Vec<AxisView>,
    /// Offset of the console's time to the firmware's time.
    offset_ms: u64,
    last: Option<Last>,
}

/// Data needed for the speeds of the next row.
struct Last {
    t_ms: u32,
    joints_rad: [f32; AXES],
    commanded_mm: [f32; 3],
    measured_mm: [f32; 3],
}

impl Last {
    /// Commanded and measured speed of the platform up to a sample, mm/s; NaN where samples are missing, and where the
    /// position jumps because a reference was taken.
    fn speeds_mm_s(&self, sample: &Sample, commanded_mm: &[f32; 3], measured_mm: &[f32; 3]) -> [f32; 2] {
        let axes = self
            .joints_rad
            .iter()
            .zip(&sample.measured_rad)
            .zip(&sample.measured_rad_s);
        let jumped = axes
            .map(|((before, now), speed)| (now - before) * 1_000.0 - speed)
            .any(|difference| difference.abs() > JUMP_RAD_S);
        if sample.t_ms - self.t_ms > GAP_MS || jumped {
            return [f32::NAN; 2];
        }
        [(&self.commanded_mm, commanded_mm), (&self.measured_mm, measured_mm)]
            .map(|(before, now)| distance(before, now) * 1_000.0)
    }
}

impl Rows {
    /// A converter for a robot with this configuration.
    pub fn new(config: &Config) -> Self {
        Self {
            kinematics: Kinematics::new(&config.geometry).ok(),
            geometry: config.geometry,
            axes: axes(config),
            offset_ms: 0,
            last: None,
        }
    }

    /// Takes the next sample; `None` for a sample older than the last, which occurs when the firmware was restarted or
    /// telegrams overtook each other.
    pub fn take(&mut self, sample: &Sample) -> SignalRow {
        if let Some(last) = &self.last
            && sample.t_ms < last.t_ms
        {
            self.offset_ms += u64::from(last.t_ms) + RESTART_MS;
            self.last = None;
        }
        let commanded = self.platform_mm(&sample.setpoint_rad);
        let measured = self.platform_mm(&sample.measured_rad);
        let speeds_mm_s = |last: &Last| last.speeds_mm_s(sample, &commanded, &measured);
        let [speed_ref, speed] = self.last.as_ref().map_or([f32::NAN; 2], speeds_mm_s);
        self.last = Some(Last {
            t_ms: sample.t_ms,
            joints_rad: sample.measured_rad,
            commanded_mm: commanded,
            measured_mm: measured,
        });
        let mut values = [f32::NAN; SIGNALS];
        let axes = self.axes.iter().flat_map(|axis| {
            let of = |values: &[f32; AXES]| axis.of(values) as f32;
            let (reference, measured) = (of(&sample.setpoint_rad), of(&sample.measured_rad));
            [
                reference,
                measured,
                reference - measured,
                of(&sample.setpoint_rad_s),
                of(&sample.measured_rad_s),
            ]
        });
        let platform = commanded.into_iter().chain(measured).chain([speed_ref, speed]);
        for (place, value) in values.iter_mut().zip(axes.chain(platform)) {
            *place = value;
        }
        SignalRow {
            time_ms: self.offset_ms + u64::from(sample.t_ms),
            t_ms: sample.t_ms,
            mode: sample.mode,
            pen: sample.pen,
            stroke: sample.stroke,
            axes: u8::try_from(self.axes.len()).unwrap_or(0),
            values,
        }
    }

    /// Following errors of a row, micro-radians or micrometres.
    pub fn errors(&self, row: &SignalRow) -> Vec<f32> {
        let error = |axis: &AxisView| {
            let (_, factor) = axis.motion.error_unit();
            row.value(axis.index * PER_AXIS + 2) * (factor / axis.motion.factor()) as f32
        };
        self.axes.iter().map(error).collect()
    }

    /// The machine's moving parts at the measured joints of a row; none while the position is not known.
    pub fn parts(&self, row: &SignalRow) -> Vec<Part> {
        let mut joints_rad = [0.0; AXES];
        for (place, axis) in joints_rad.iter_mut().zip(&self.axes) {
            *place = f64::from(row.value(axis.index * PER_AXIS + 1)) / axis.motion.factor();
        }
        moving(&self.geometry, &joints_rad, row.measured_mm().map(f64::from))
    }

    fn platform_mm(&self, joints_rad: &[f32; AXES]) -> [f32; 3] {
        let forward = |kinematics: &Kinematics| kinematics.forward(&JointAngles(joints_rad.map(f64::from))).ok();
        match self.kinematics.as_ref().and_then(forward) {
            Some(Position { x_mm, y_mm, z_mm }) => [x_mm, y_mm, z_mm].map(|mm| mm as f32),
            None => [f32::NAN; 3],
        }
    }
}

fn distance(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use etherpen::messages::IoValues;

    /// A sample in which every axis is at this angle.
    pub(crate) fn sample(t_ms: u32, angle_rad: f32) -> Sample {
        Sample {
            t_ms,
            mode: Mode::Idle,
            stroke: 0,
            pen: Pen::Up,
            setpoint_rad: [angle_rad; AXES],
            measured_rad: [angle_rad; AXES],
            setpoint_rad_s: [0.0; AXES],
            measured_rad_s: [0.0; AXES],
            io: IoValues::default(),
        }
    }

    #[test]
    fn every_signal_has_a_name_of_its_own_that_ends_in_its_unit() {
        let signals = catalogue(&Config::default());
        assert_eq!(signals.len(), SIGNALS);
        for (number, signal) in signals.iter().enumerate() {
            let unit = signal.unit.replace('/', "_");
            assert!(signal.name.ends_with(&unit), "{}", signal.name);
            assert!(signals.iter().skip(number + 1).all(|other| other.name != signal.name));
        }
    }

    #[test]
    fn a_row_holds_the_sample_and_where_it_puts_the_platform() {
        let config = Config::default();
        let mut rows = Rows::new(&config);
        rows.take(&sample(6, 0.3));
        let moved = Sample {
            setpoint_rad: [0.31, 0.3, 0.3, 0.0],
            ..sample(7, 0.3)
        };
        let row = rows.take(&moved);
        let names = catalogue(&Config::default());
        let value = |name: &str| row.value(names.iter().position(|signal| signal.name == name).unwrap());
        assert_eq!((value("q1_ref_rad"), value("q1_rad")), (0.31, 0.3));
        assert!((value("e1_rad") - 0.01).abs() < 1e-6);
        assert!(value("z_mm") < -600.0 && value("x_mm").abs() < 1e-3);
        assert!(value("speed_ref_mm_s") > 1_000.0 && value("speed_mm_s") == 0.0);
        assert_eq!(row.measured_mm()[2], value("z_mm"));
    }

    #[test]
    fn a_machine_with_two_linear_axes_has_their_signals_in_millimetres_and_no_others() {
        let config = crate::settings::machines::MACHINES[2].load().unwrap();
        let names = catalogue(&config);
        assert_eq!(names.len(), 2 * PER_AXIS + OF_PLATFORM);
        let mut rows = Rows::new(&config);
        let row = rows.take(&sample(6, 0.3));
        let value = |name: &str| row.value(names.iter().position(|signal| signal.name == name).unwrap());
        assert!((value("q2_mm") - 30.0).abs() < 1.0e-4 && value("v1_mm_s") == 0.0);
        assert!((value("x_mm") - 30.0).abs() < 1.0e-4, "{}", value("x_mm"));
        assert_eq!(row.measured_mm()[0], value("x_mm"));
        assert_eq!((names[0].label.as_str(), names[0].unit), ("a setpoint", "mm"));
        assert_eq!((rows.errors(&row), rows.parts(&row).is_empty()), (vec![0.0; 2], false));
    }

    #[test]
    fn the_platform_has_no_speed_where_its_position_jumps() {
        let names = catalogue(&Config::default());
        let speed = names.iter().position(|signal| signal.name == "speed_mm_s").unwrap();
        let mut rows = Rows::new(&Config::default());
        rows.take(&sample(6, 0.3));
        assert!(
            rows.take(&sample(7, 0.35)).value(speed).is_nan(),
            "a reference was taken"
        );
        assert_eq!(rows.take(&sample(8, 0.35)).value(speed), 0.0);
        let moving = Sample {
            measured_rad_s: [5.0; AXES],
            ..sample(9, 0.355)
        };
        assert!(rows.take(&moving).value(speed) > 500.0);
    }

    #[test]
    fn time_goes_on_when_the_firmware_was_restarted() {
        let mut rows = Rows::new(&Config::default());
        let times: Vec<_> = [10, 11, 1, 2]
            .map(|t_ms| rows.take(&sample(t_ms, 0.3)).time_ms)
            .into_iter()
            .collect();
        assert!(times.windows(2).all(|pair| pair[0] < pair[1]), "{times:?}");
    }
}
