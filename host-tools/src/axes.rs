//! The axes of a machine as a user sees them: names, units, and which of them exist.
//!
//! The controller computes with an angle for every joint. The joint of a linear axis is a wheel that rolls along it, and
//! a radian of it is [`LINEAR_MM_PER_RAD`]. Everything that shows, stores or reads a value of a joint asks [`axes`].
//!
//! Invariant: the values of rotary axes are the controller's, bit by bit.

use etherpen::config::Config;
use etherpen::robots::{AXES, Geometry, Kind, Kinematics, LINEAR_MM_PER_RAD, MAIN_AXES};
use serde::Serialize;
use serde::ser::{SerializeMap, Serializer};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Metres for a radian of a linear axis.
const M_PER_RAD: f64 = LINEAR_MM_PER_RAD / 1_000.0;

/// A value that a linear axis has in another unit: its name in the file, that of the controller's value, and the factor.
#[derive(Clone, Copy, Debug)]
pub struct Unit(pub &'static str, pub &'static str, pub f64);

/// Values of a linear axis.
pub const LINEAR: [Unit; 8] = [
    Unit("sync_mm", "sync_angle_rad", 1.0 / LINEAR_MM_PER_RAD),
    Unit(
        "following_error_max_mm",
        "following_error_max_rad",
        1.0 / LINEAR_MM_PER_RAD,
    ),
    Unit(
        "feedback_deviation_max_mm",
        "feedback_deviation_max_rad",
        1.0 / LINEAR_MM_PER_RAD,
    ),
    Unit(
        "feedback_acceleration_max_mm_s2",
        "feedback_acceleration_max_rad_s2",
        1.0 / LINEAR_MM_PER_RAD,
    ),
    Unit("output_max_mm_s", "output_max_rad_s", 1.0 / LINEAR_MM_PER_RAD),
    Unit("quick_stop_mm_s2", "quick_stop_rad_s2", 1.0 / LINEAR_MM_PER_RAD),
    Unit("mass_kg", "inertia_kg_m2", M_PER_RAD * M_PER_RAD),
    Unit("force_max_n", "torque_max_nm", M_PER_RAD),
];

/// Values of `home` of a linear axis, with the table's name before them.
pub const HOME: [Unit; 4] = [
    Unit("home.speed_mm_s", "home.speed_rad_s", 1.0 / LINEAR_MM_PER_RAD),
    Unit("home.latch_mm_s", "home.latch_rad_s", 1.0 / LINEAR_MM_PER_RAD),
    Unit("home.pull_off_mm", "home.pull_off_rad", 1.0 / LINEAR_MM_PER_RAD),
    Unit("home.travel_max_mm", "home.travel_max_rad", 1.0 / LINEAR_MM_PER_RAD),
];

/// The name in a configuration file of a controller's value of an axis, and the factor from the controller's value to the
/// written one; `None` where both are the same.
#[must_use]
pub fn as_written(kind: Kind, axis: usize, name: &str) -> Option<(&'static str, f64)> {
    let is_linear = motion(kind, axis) == Motion::Linear;
    let unit = LINEAR
        .iter()
        .chain(&HOME)
        .find(|Unit(_, to, _)| is_linear && *to == name);
    unit.map(|Unit(from, _, factor)| (*from, 1.0 / factor))
}

/// Place of the kind of this process's machine in [`Kind::ALL`].
static MACHINE: AtomicUsize = AtomicUsize::new(0);

/// Tells texts about faults and refusals what kind of machine this process works with: those messages number an axis, and
/// their values are the controller's.
pub fn set_machine(kind: Kind) {
    let place = Kind::ALL.iter().position(|other| *other == kind);
    MACHINE.store(place.unwrap_or(0), Ordering::Relaxed);
}

/// The kind of machine this process works with, see [`set_machine`]; before, the built-in machine's.
#[must_use]
pub fn machine() -> Kind {
    Kind::ALL
        .get(MACHINE.load(Ordering::Relaxed))
        .copied()
        .unwrap_or_default()
}

/// How an axis moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// It turns: radians.
    Rotary,
    /// It travels: millimetres.
    Linear,
}

/// A quantity of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Position.
    Position,
    /// Speed.
    Speed,
    /// Acceleration.
    Acceleration,
    /// Jerk.
    Jerk,
}

impl Motion {
    /// The unit of a quantity, as text for people: `rad/s`, `mm`.
    #[must_use]
    pub fn unit(self, quantity: Quantity) -> &'static str {
        match (self, quantity) {
            (Self::Rotary, Quantity::Position) => "rad",
            (Self::Rotary, Quantity::Speed) => "rad/s",
            (Self::Rotary, Quantity::Acceleration) => "rad/s2",
            (Self::Rotary, Quantity::Jerk) => "rad/s3",
            (Self::Linear, Quantity::Position) => "mm",
            (Self::Linear, Quantity::Speed) => "mm/s",
            (Self::Linear, Quantity::Acceleration) => "mm/s2",
            (Self::Linear, Quantity::Jerk) => "mm/s3",
        }
    }

    /// The unit of a quantity at the end of a name: `rad_s`, `mm`.
    #[must_use]
    pub fn suffix(self, quantity: Quantity) -> &'static str {
        match (self, quantity) {
            (Self::Rotary, Quantity::Position) => "rad",
            (Self::Rotary, Quantity::Speed) => "rad_s",
            (Self::Rotary, Quantity::Acceleration) => "rad_s2",
            (Self::Rotary, Quantity::Jerk) => "rad_s3",
            (Self::Linear, Quantity::Position) => "mm",
            (Self::Linear, Quantity::Speed) => "mm_s",
            (Self::Linear, Quantity::Acceleration) => "mm_s2",
            (Self::Linear, Quantity::Jerk) => "mm_s3",
        }
    }

    /// The unit of small errors, and their factor from the controller's value.
    #[must_use]
    pub fn error_unit(self) -> (&'static str, f64) {
        match self {
            Self::Rotary => ("µrad", 1.0e6),
            Self::Linear => ("µm", 1.0e3 * LINEAR_MM_PER_RAD),
        }
    }

    /// Factor from the controller's value to the shown one: 1, or millimetres for a radian.
    #[must_use]
    pub fn factor(self) -> f64 {
        match self {
            Self::Rotary => 1.0,
            Self::Linear => LINEAR_MM_PER_RAD,
        }
    }

    /// Decimals of a position and of a speed in tables: steps of 1e-7 rad and 1e-5 rad/s.
    #[must_use]
    pub fn decimals(self, quantity: Quantity) -> usize {
        match (self, quantity) {
            (Self::Rotary, Quantity::Position) => 7,
            (Self::Linear, Quantity::Position) | (Self::Rotary, _) => 5,
            (Self::Linear, _) => 3,
        }
    }
}

/// An axis of a machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AxisView {
    /// Its place, from 0.
    pub index: usize,
    /// Its name in plots and texts.
    pub name: String,
    /// Its name where axes are listed: a number where the name is only a kind of part.
    pub label: String,
    /// How it moves.
    pub motion: Motion,
}

impl AxisView {
    /// The names of its four columns in tables: reference and measured position, reference and measured speed.
    #[must_use]
    pub fn columns(&self) -> [String; 4] {
        let number = self.index + 1;
        let (position, speed) = (
            self.motion.suffix(Quantity::Position),
            self.motion.suffix(Quantity::Speed),
        );
        [
            format!("q{number}_ref_{position}"),
            format!("q{number}_{position}"),
            format!("v{number}_ref_{speed}"),
            format!("v{number}_{speed}"),
        ]
    }

    /// Its value out of the controller's values of all axes, in its own unit.
    #[must_use]
    pub fn of<T: Copy + Into<f64>>(&self, values: &[T; AXES]) -> f64 {
        values
            .get(self.index)
            .map_or(f64::NAN, |value| (*value).into() * self.motion.factor())
    }
}

/// How the axes of a kind of machine move.
#[must_use]
pub fn motions(kind: Kind) -> [Motion; AXES] {
    use Motion::{Linear, Rotary};
    match kind {
        Kind::Gantry | Kind::CoreXy | Kind::LinearDelta => [Linear, Linear, Linear, Rotary],
        Kind::Scara => [Rotary, Rotary, Linear, Rotary],
        Kind::Delta => [Rotary; AXES],
    }
}

/// The motion of an axis, from 0.
#[must_use]
pub fn motion(kind: Kind, axis: usize) -> Motion {
    motions(kind).get(axis).copied().unwrap_or(Motion::Rotary)
}

/// The name of an axis, from 0, of a machine with these dimensions.
#[must_use]
pub fn name(geometry: &Geometry, axis: usize) -> String {
    let names: [&str; MAIN_AXES] = match geometry.kind() {
        Kind::Gantry => ["x", "y", "z"],
        Kind::CoreXy => ["a", "b", "z"],
        Kind::Scara => ["shoulder", "elbow", "height"],
        Kind::Delta | Kind::LinearDelta => {
            let noun = Kinematics::new(geometry).map_or("axis", |kinematics| kinematics.words().joint);
            return match axis < MAIN_AXES {
                true => format!("{noun} {}", axis + 1),
                false => format!("axis {}", axis + 1),
            };
        }
    };
    names
        .get(axis)
        .map_or_else(|| "turn".to_owned(), |name| (*name).to_owned())
}

/// The axes of a machine: those that have a drive.
#[must_use]
pub fn axes(config: &Config) -> Vec<AxisView> {
    first_axes(&config.geometry, config.bus.drives.into())
}

/// The first axes of a machine with these dimensions.
#[must_use]
pub fn first_axes(geometry: &Geometry, count: usize) -> Vec<AxisView> {
    let kind = geometry.kind();
    let axis = |index| AxisView {
        index,
        name: name(geometry, index),
        label: match kind {
            Kind::Delta | Kind::LinearDelta => format!("axis {}", index + 1),
            _ => name(geometry, index),
        },
        motion: motion(kind, index),
    };
    (0..count.min(AXES)).map(axis).collect()
}

/// A position for each axis of a machine, in the axis's own unit.
///
/// Written as one entry of an object, its unit behind its name: `NAME_rad` or `NAME_mm` with a list where all axes are
/// rotary or all are linear. Otherwise it is `NAME` with an object that has the axes' names, each with its unit. A value
/// that is not known is `null`.
#[derive(Clone, Debug, PartialEq)]
pub struct PerAxis {
    name: &'static str,
    axes: Vec<AxisView>,
    /// In the unit of each axis.
    values: Option<Vec<f64>>,
}

impl PerAxis {
    /// Positions out of the controller's values of all axes.
    #[must_use]
    pub fn new<T: Copy + Into<f64>>(name: &'static str, axes: Vec<AxisView>, values: Option<&[T; AXES]>) -> Self {
        let values = values.map(|values| axes.iter().map(|axis| axis.of(values)).collect());
        Self { name, axes, values }
    }

    /// The axes with their values; none if the values are not known.
    pub fn iter(&self) -> impl Iterator<Item = (&AxisView, f64)> {
        self.axes.iter().zip(self.values.iter().flatten().copied())
    }

    /// Replaces every value by this controller's value of its axis, from 0, if that is greater.
    pub fn raise(&mut self, value: impl Fn(usize) -> f64) {
        let values = self.values.iter_mut().flatten();
        for (axis, most) in self.axes.iter().zip(values) {
            *most = most.max(value(axis.index) * axis.motion.factor());
        }
    }

    /// The values with these decimals of a radian and of a millimetre, and their units behind each run of one unit:
    /// `0.1000, 0.2000 rad, 12.00 mm`.
    #[must_use]
    pub fn text(&self) -> String {
        let decimals = |motion| if motion == Motion::Linear { 2 } else { 4 };
        self.listed(|motion, value| {
            let decimals = decimals(motion);
            (format!("{value:.decimals$}"), motion.unit(Quantity::Position))
        })
    }

    /// The values as small errors: `12.3, 4.5 µrad, 8.0 µm`.
    #[must_use]
    pub fn error_text(&self) -> String {
        self.listed(|motion, value| {
            let (unit, factor) = motion.error_unit();
            (format!("{:.1}", value / motion.factor() * factor), unit)
        })
    }

    fn listed(&self, show: impl Fn(Motion, f64) -> (String, &'static str)) -> String {
        let shown: Vec<(String, &str)> = self.iter().map(|(axis, value)| show(axis.motion, value)).collect();
        let mut text = String::new();
        for (index, (value, unit)) in shown.iter().enumerate() {
            let next = shown.get(index + 1).map(|(_, unit)| unit);
            text.push_str(value);
            if next != Some(unit) {
                text.push_str(&format!(" {unit}"));
            }
            if next.is_some() {
                text.push_str(", ");
            }
        }
        text
    }
}

impl Serialize for PerAxis {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(1))?;
        let first = self.axes.first().map_or(Motion::Rotary, |axis| axis.motion);
        if self.axes.iter().all(|axis| axis.motion == first) {
            let key = format!("{}_{}", self.name, first.suffix(Quantity::Position));
            map.serialize_entry(&key, &self.values)?;
            return map.end();
        }
        let named: serde_json::Map<String, serde_json::Value> = self
            .iter()
            .map(|(axis, value)| {
                let suffix = axis.motion.suffix(Quantity::Position);
                (format!("{}_{suffix}", axis.name.replace(' ', "_")), value.into())
            })
            .collect();
        map.serialize_entry(self.name, &self.values.as_ref().map(|_| named))?;
        map.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn machine(kind: Kind, drives: u8) -> Config {
        let mut config = Config {
            geometry: kind.geometry(),
            ..Config::default()
        };
        config.bus.drives = drives;
        config
    }

    #[test]
    fn an_axis_has_its_own_unit_and_axes_without_a_drive_do_not_exist() {
        let scara = axes(&machine(Kind::Scara, 4));
        let names: Vec<_> = scara.iter().map(|axis| (axis.name.as_str(), axis.motion)).collect();
        use Motion::{Linear, Rotary};
        assert_eq!(
            names,
            [
                ("shoulder", Rotary),
                ("elbow", Rotary),
                ("height", Linear),
                ("turn", Rotary)
            ]
        );
        assert_eq!(scara[2].columns(), ["q3_ref_mm", "q3_mm", "v3_ref_mm_s", "v3_mm_s"]);
        assert_eq!(scara[0].columns()[3], "v1_rad_s");
        assert_eq!((scara[2].of(&[0.5_f64; 4]), scara[0].of(&[0.5_f64; 4])), (50.0, 0.5));
        let belts = axes(&machine(Kind::CoreXy, 2));
        assert_eq!(
            belts.iter().map(|axis| axis.name.as_str()).collect::<Vec<_>>(),
            ["a", "b"]
        );
        assert_eq!(axes(&machine(Kind::LinearDelta, 3))[2].name, "carriage 3");
        assert_eq!(axes(&Config::default())[3].name, "axis 4");
    }

    #[test]
    fn a_value_is_named_as_its_file_writes_it() {
        let written = |axis, name| as_written(Kind::Scara, axis, name);
        assert_eq!(written(0, "output_max_rad_s"), None);
        assert_eq!(written(2, "output_max_rad_s"), Some(("output_max_mm_s", 100.0)));
        assert_eq!(written(2, "gear"), None);
        let (name, factor) = written(2, "inertia_kg_m2").unwrap();
        assert!(name == "mass_kg" && (factor - 100.0).abs() < 1.0e-9);
    }

    #[test]
    fn values_of_one_unit_are_a_list_and_others_are_named() {
        let json = |config: &Config| {
            let values = PerAxis::new("joints", axes(config), Some(&[0.25_f64; AXES]));
            (serde_json::to_string(&values).unwrap(), values.text())
        };
        assert_eq!(
            json(&Config::default()),
            (
                r#"{"joints_rad":[0.25,0.25,0.25,0.25]}"#.into(),
                "0.2500, 0.2500, 0.2500, 0.2500 rad".into()
            )
        );
        assert_eq!(
            json(&machine(Kind::Gantry, 3)),
            (
                r#"{"joints_mm":[25.0,25.0,25.0]}"#.into(),
                "25.00, 25.00, 25.00 mm".into()
            )
        );
        assert_eq!(
            json(&machine(Kind::Scara, 3)),
            (
                r#"{"joints":{"elbow_rad":0.25,"height_mm":25.0,"shoulder_rad":0.25}}"#.into(),
                "0.2500, 0.2500 rad, 25.00 mm".into()
            )
        );
        let unknown = PerAxis::new::<f64>("joints", axes(&Config::default()), None);
        assert_eq!(serde_json::to_string(&unknown).unwrap(), r#"{"joints_rad":null}"#);
    }

    #[test]
    fn errors_are_millionths_of_a_radian_and_thousandths_of_a_millimetre() {
        let mut errors = PerAxis::new("e", axes(&machine(Kind::Scara, 3)), Some(&[0.0_f64; AXES]));
        errors.raise(|axis| [1.0e-6, 2.0e-6, 5.0e-5, 0.0][axis]);
        errors.raise(|_| 0.0);
        assert_eq!(errors.error_text(), "1.0, 2.0 µrad, 5.0 µm");
    }
}
