//! Reads a configuration from the text of a file, in the words of the machine's owner.
//!
//! - `[axis_defaults]` holds what the axes share; each of `[[axes]]` overrides it.
//! - Fewer than four `[[axes]]` are a machine with fewer drives.
//! - Linear axes are written in millimetres, kilograms and newtons, and name the travel of a turn, `pitch_mm`.
//!
//! Inside the controller the joint of a linear axis is a wheel that rolls along it: a radian is [`LINEAR_MM_PER_RAD`]. What
//! is written in millimetres is converted here and nowhere else.
//!
//! Invariant: a message names the line and the value as they are written.

use crate::axes::{HOME, LINEAR, Unit};
use etherpen::config::Config;
use etherpen::robots::{AXES, Kind, LINEAR_MM_PER_RAD};
use serde::Deserialize;
use std::f64::consts::TAU;
use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue, Deserializer};

/// Table of the values that the axes share.
const SHARED: &str = "axis_defaults";
/// Travel of a linear axis for one turn of its screw or pulley.
const PITCH: &str = "pitch_mm";
/// Lists with a value for each axis, in the axis's own unit: the name in the file and that of the controller's value.
const OWN_UNITS: [[&str; 2]; 2] = [
    ["joint_speed", "joint_speed_rad_s"],
    ["joint_acceleration", "joint_acceleration_rad_s2"],
];

/// Why a text is no configuration.
#[derive(Clone, Debug, PartialEq)]
pub enum ReadingError {
    /// Not valid TOML, or a value of a wrong type, or a name that does not exist.
    Toml(toml::de::Error),
    /// A value that does not suit the machine.
    Machine {
        /// Line, from 1.
        line: usize,
        /// What is wrong, and what to write.
        text: String,
    },
}

impl std::fmt::Display for ReadingError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Toml(cause) => cause.fmt(f),
            Self::Machine { line, text } => write!(f, "line {line}: {text}"),
        }
    }
}

impl std::error::Error for ReadingError {}

impl From<toml::de::Error> for ReadingError {
    fn from(cause: toml::de::Error) -> Self {
        Self::Toml(cause)
    }
}

/// Reads a configuration; values are not checked against their bounds.
///
/// # Errors
/// [`ReadingError`].
pub fn configuration(text: &str) -> Result<Config, ReadingError> {
    let mut table = DeTable::parse(text)?;
    let mut file = File { text };
    let linear = kind(table.get_ref())
        .and_then(Kind::named)
        .map_or([false; AXES], Kind::linear_axes);
    file.share(table.get_mut(), &linear)?;
    let converted = file.converted(table.get_ref(), &linear)?;
    // The converted values are texts of their own, which live shorter than the file's.
    let mut table: Spanned<DeTable<'_>> = table;
    apply(table.get_mut(), &converted);
    complete(table.get_mut());
    Config::deserialize(Deserializer::from(table)).map_err(|mut cause| {
        cause.set_input(Some(text));
        cause.into()
    })
}

/// The kind of machine.
fn kind<'a>(table: &'a DeTable<'_>) -> Option<&'a str> {
    table
        .get("geometry")?
        .get_ref()
        .as_table()?
        .get("kind")?
        .get_ref()
        .as_str()
}

/// The table of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Within {
    /// `[motion]`.
    Motion,
    /// An axis, from 0.
    Axis(usize),
    /// `home` of an axis, from 0.
    Home(usize),
}

/// A value that replaces one or several others: where it stands, and its text.
struct Converted {
    place: Within,
    /// Name in the file.
    from: &'static str,
    /// Name of the controller's value.
    to: &'static str,
    text: String,
}

struct File<'a> {
    text: &'a str,
}

impl File<'_> {
    fn error(&self, place: usize, text: String) -> ReadingError {
        let before = self.text.get(..place).unwrap_or(self.text);
        ReadingError::Machine {
            line: before.matches('\n').count() + 1,
            text,
        }
    }

    /// Gives each axis the shared values that it does not set itself, and that suit it: those in radians are not for linear
    /// axes, those in millimetres only for them.
    fn share(&mut self, table: &mut DeTable<'_>, linear: &[bool; AXES]) -> Result<(), ReadingError> {
        let Some(shared) = table.remove(SHARED) else {
            return Ok(());
        };
        let place = shared.span().start;
        let DeValue::Table(shared) = shared.into_inner() else {
            return Err(self.error(place, format!("{SHARED} is a table: write [{SHARED}]")));
        };
        let key = Spanned::new(place..place, "axes".into());
        let axes = table.entry(key).or_insert_with(|| {
            let mut axes = DeArray::new();
            (0..AXES).for_each(|_| axes.push(Spanned::new(place..place, DeValue::Table(DeTable::new()))));
            Spanned::new(place..place, DeValue::Array(axes))
        });
        let is_mixed = linear.contains(&true);
        for (number, axis) in tables_mut(axes).enumerate() {
            let is_linear = linear.get(number).copied().unwrap_or(false);
            let suits = |key: &str| {
                let of_other = |Unit(mm, rad, _): &Unit| key == if is_linear { *rad } else { *mm };
                let is_foreign = LINEAR.iter().any(of_other) || key == PITCH && !is_linear;
                !(is_mixed && is_foreign)
            };
            for (key, value) in shared.iter().filter(|(key, _)| suits(key.get_ref())) {
                axis.entry(key.clone()).or_insert_with(|| value.clone());
            }
        }
        Ok(())
    }

    /// The values that stand in another unit than the controller's.
    fn converted(&self, table: &DeTable<'_>, linear: &[bool; AXES]) -> Result<Vec<Converted>, ReadingError> {
        let mut converted = Vec::new();
        let axes = table.get("axes").map(Spanned::get_ref).and_then(DeValue::as_array);
        for (number, axis) in axes.into_iter().flat_map(|axes| axes.iter()).enumerate() {
            if number >= AXES {
                return Err(self.error(axis.span().start, format!("a machine has at most {AXES} axes")));
            }
            let is_linear = linear.get(number).copied().unwrap_or(false);
            let Some(values) = axis.get_ref().as_table() else {
                continue;
            };
            if is_linear {
                self.convert_axis(number, values, axis.span().start, &mut converted)?;
            }
            if let Some(home) = values.get("home").and_then(|home| home.get_ref().as_table()) {
                self.convert_home(number, home, table, is_linear, &mut converted)?;
            }
        }
        let motion = table.get("motion").map(Spanned::get_ref).and_then(DeValue::as_table);
        for ([from, to], motion) in OWN_UNITS.into_iter().zip(motion.into_iter().cycle()) {
            self.convert_list(motion, from, to, linear, &mut converted)?;
        }
        Ok(converted)
    }

    fn convert_axis(
        &self,
        number: usize,
        values: &DeTable<'_>,
        place: usize,
        converted: &mut Vec<Converted>,
    ) -> Result<(), ReadingError> {
        let axis = number + 1;
        let mut add = |from, to, value: f64| {
            converted.push(Converted {
                place: Within::Axis(number),
                from,
                to,
                text: format!("{value:?}"),
            });
        };
        for Unit(from, to, factor) in &LINEAR {
            if let Some(written) = values.get_key_value(*to) {
                let text = format!("axis {axis} is linear: write {from} instead of {to}");
                return Err(self.error(written.0.span().start, text));
            }
            if let Some(value) = values.get(*from) {
                add(*from, *to, self.number(value, from)? * factor);
            }
        }
        let Some(pitch) = values.get(PITCH) else {
            let text =
                format!("axis {axis} is linear: {PITCH}, its travel for one turn of the screw or pulley, is missing");
            return Err(self.error(place, text));
        };
        let pitch_mm = self.number(pitch, PITCH)?;
        if !(pitch_mm > 0.0 && pitch_mm.is_finite()) {
            let text = format!("{PITCH} of axis {axis} is {pitch_mm}; it is the travel for one turn, more than 0");
            return Err(self.error(pitch.span().start, text));
        }
        let gear = values.get("gear").map_or(Ok(1.0), |gear| self.number(gear, "gear"))?;
        add(PITCH, "gear", gear * TAU * LINEAR_MM_PER_RAD / pitch_mm);
        Ok(())
    }

    /// Converts `home` of an axis: its values, and the name of its switch to the place in `io`.
    fn convert_home(
        &self,
        number: usize,
        home: &DeTable<'_>,
        table: &DeTable<'_>,
        is_linear: bool,
        converted: &mut Vec<Converted>,
    ) -> Result<(), ReadingError> {
        let place = Within::Home(number);
        for Unit(from, to, factor) in HOME.iter().filter(|_| is_linear) {
            let [from, to] = [*from, *to].map(|name| name.strip_prefix("home.").unwrap_or(name));
            if let Some((written, _)) = home.get_key_value(to) {
                let text = format!("axis {} is linear: write {from} instead of {to}", number + 1);
                return Err(self.error(written.span().start, text));
            }
            if let Some(value) = home.get(from) {
                let text = format!("{:?}", self.number(value, from)? * factor);
                converted.push(Converted { place, from, to, text });
            }
        }
        let Some(switch) = home.get("switch") else {
            return Ok(());
        };
        let points = table.get("io").and_then(|io| io.get_ref().as_array());
        let name_of = |point: &Spanned<DeValue<'_>>| {
            point
                .get_ref()
                .as_table()?
                .get("name")?
                .get_ref()
                .as_str()
                .map(str::to_owned)
        };
        let wanted = switch.get_ref().as_str();
        let found = points.and_then(|points| points.iter().position(|point| name_of(point).as_deref() == wanted));
        let Some(io) = found.filter(|_| wanted.is_some()) else {
            let text = format!(
                "axis {}: there is no [[io]] with the name of its switch: name = \"{}\", role = \"home\"",
                number + 1,
                wanted.unwrap_or("x_home")
            );
            return Err(self.error(switch.span().start, text));
        };
        converted.push(Converted {
            place,
            from: "switch",
            to: "io",
            text: io.to_string(),
        });
        Ok(())
    }

    /// Converts a list with a value for each axis.
    fn convert_list(
        &self,
        motion: &DeTable<'_>,
        from: &'static str,
        to: &'static str,
        linear: &[bool; AXES],
        converted: &mut Vec<Converted>,
    ) -> Result<(), ReadingError> {
        let is_mixed = linear.contains(&true);
        if let Some((written, _)) = motion.get_key_value(to).filter(|_| is_mixed) {
            let text =
                format!("the machine has linear axes: write motion.{from}, in each axis's unit, instead of {to}");
            return Err(self.error(written.span().start, text));
        }
        let Some(list) = motion.get(from) else {
            return Ok(());
        };
        let Some(values) = list.get_ref().as_array().filter(|values| values.len() <= AXES) else {
            let text = format!("motion.{from} is a list with a value for each axis, at most {AXES}");
            return Err(self.error(list.span().start, text));
        };
        let mut texts = Vec::new();
        for (value, is_linear) in values.iter().zip(linear) {
            let factor = if *is_linear { 1.0 / LINEAR_MM_PER_RAD } else { 1.0 };
            texts.push(self.number(value, from)? * factor);
        }
        // Axes that the machine lacks are not limited by them.
        let of_motion = etherpen::config::MotionLimits::default();
        let missing = match to {
            "joint_speed_rad_s" => of_motion.joint_speed_rad_s,
            _ => of_motion.joint_acceleration_rad_s2,
        };
        texts.extend(missing.into_iter().skip(texts.len()));
        let text = format!("{texts:?}");
        converted.push(Converted {
            place: Within::Motion,
            from,
            to,
            text,
        });
        Ok(())
    }

    fn number(&self, value: &Spanned<DeValue<'_>>, name: &str) -> Result<f64, ReadingError> {
        let written = value.get_ref();
        let text = written
            .as_float()
            .map(|float| float.as_str())
            .or(written.as_integer().map(|integer| integer.as_str()));
        let number = text.and_then(|text| text.replace('_', "").parse().ok());
        number.ok_or_else(|| self.error(value.span().start, format!("{name} is a number")))
    }
}

/// The tables of an array.
fn tables_mut<'a, 'i>(array: &'a mut Spanned<DeValue<'i>>) -> impl Iterator<Item = &'a mut DeTable<'i>> {
    let items = match array.get_mut() {
        DeValue::Array(items) => Some(items),
        _ => None,
    };
    let items = items.into_iter().flat_map(|items| items.iter_mut());
    items.filter_map(|item| match item.get_mut() {
        DeValue::Table(table) => Some(table),
        _ => None,
    })
}

/// A value that is a table.
fn table_mut<'a, 'i>(value: &'a mut Spanned<DeValue<'i>>) -> Option<&'a mut DeTable<'i>> {
    match value.get_mut() {
        DeValue::Table(table) => Some(table),
        _ => None,
    }
}

/// Puts the converted values in the place of those that were written.
fn apply<'a>(table: &mut DeTable<'a>, converted: &'a [Converted]) {
    for Converted { place, from, to, text } in converted {
        let Ok(value) = DeValue::parse(text) else { continue };
        let within = match *place {
            Within::Axis(axis) => table.get_mut("axes").and_then(|axes| tables_mut(axes).nth(axis)),
            Within::Home(axis) => table
                .get_mut("axes")
                .and_then(|axes| tables_mut(axes).nth(axis))
                .and_then(|values| values.get_mut("home"))
                .and_then(table_mut),
            Within::Motion => table.get_mut("motion").and_then(table_mut),
        };
        let Some(within) = within else { continue };
        let span = within.remove(*from).map_or(0..0, |written| written.span());
        within.insert(
            Spanned::new(span.clone(), (*to).into()),
            Spanned::new(span, value.into_inner()),
        );
    }
}

/// Adds the axes that the machine lacks, which have the default values, and tells the bus how many drives there are.
fn complete(table: &mut DeTable<'_>) {
    let Some(DeValue::Array(axes)) = table.get_mut("axes").map(Spanned::get_mut) else {
        return;
    };
    let written = axes.len();
    for _ in written..AXES {
        axes.push(Spanned::new(0..0, DeValue::Table(DeTable::new())));
    }
    const NUMBERS: [&str; AXES] = ["1", "2", "3", "4"];
    let number = written.checked_sub(1).and_then(|index| NUMBERS.get(index));
    let Some(drives) = number
        .filter(|_| written < AXES)
        .and_then(|text| DeValue::parse(text).ok())
    else {
        return;
    };
    let bus = table
        .entry(Spanned::new(0..0, "bus".into()))
        .or_insert_with(|| Spanned::new(0..0, DeValue::Table(DeTable::new())));
    if let DeValue::Table(bus) = bus.get_mut() {
        bus.entry(Spanned::new(0..0, "drives".into())).or_insert(drives);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::config::Axis;

    fn error(text: &str) -> String {
        configuration(text).unwrap_err().to_string()
    }

    #[test]
    fn axes_have_the_shared_values_that_they_do_not_set_themselves() {
        let text = "[axis_defaults]\ngear = 10.0\nfeed_forward_gain = 0.9\n[[axes]]\n[[axes]]\ngear = -5\n[[axes]]\n[[axes]]\n";
        let config = configuration(text).unwrap();
        assert_eq!(config.axes.map(|axis| axis.gear), [10.0, -5.0, 10.0, 10.0]);
        assert_eq!(config.axes.map(|axis| axis.feed_forward_gain), [0.9; AXES]);
        let config = configuration("[axis_defaults]\ngear = 10.0\n").unwrap();
        assert_eq!(config.axes.map(|axis| axis.gear), [10.0; AXES]);
        assert!(error("axis_defaults = 3\n").contains("line 1: axis_defaults is a table"));
        let unknown = error("[axis_defaults]\ngears = 10.0\n[[axes]]\n");
        assert!(unknown.contains("line 2") && unknown.contains("gears"), "{unknown}");
    }

    #[test]
    fn fewer_axes_are_a_machine_with_fewer_drives() {
        let config = configuration("[[axes]]\n[[axes]]\n[[axes]]\ngear = 7.0\n").unwrap();
        assert_eq!((config.bus.drives, config.axes[2].gear), (3, 7.0));
        assert_eq!(config.axes[3], Axis::default());
        assert_eq!(configuration("axes = [{}, {}, {}, {}]").unwrap().bus.drives, 4);
        assert_eq!(
            error("axes = [{}, {},\n {}, {}, {}]"),
            "line 2: a machine has at most 4 axes"
        );
    }

    #[test]
    fn a_file_without_any_of_it_is_read_as_toml_reads_it() {
        let sample = include_str!("../../../samples/etherpen.toml");
        assert_eq!(configuration(sample).unwrap(), toml::from_str(sample).unwrap());
        assert_eq!(configuration("").unwrap(), Config::default());
        for wrong in [
            "[motion]\nsped = 3\n",
            "axes = 3\n",
            "[motion\n",
            "[motion]\nspeed_mm_s = 'fast'\n",
        ] {
            let expected = toml::from_str::<Config>(wrong).unwrap_err().to_string();
            assert_eq!(error(wrong), expected);
        }
    }
}
