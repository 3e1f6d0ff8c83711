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
use etherpen::config::{Config, HomeSwitch};
use etherpen::robots::{AXES, Kind, LINEAR_MM_PER_RAD};
use serde::Deserialize;
use std::f64::consts::TAU;
use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue, Deserializer};

/// Table of the values that the axes share.
pub(super) const SHARED: &str = "axis_defaults";
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
    let table = DeTable::parse(text)?;
    let file = File { text };
    file.check_numbers("", table.get_ref())?;
    let kind = file.kind(table.get_ref())?;
    let unnamed = file.unnamed_kind(table.get_ref());
    file.read(table, kind).map_err(|cause| match unnamed {
        None => cause,
        // What fails may well be right for the kind that is meant.
        Some(line) => ReadingError::Machine {
            line,
            text: format!(
                "[geometry] has no kind, so it is read as a {}: kind is one of {}\n{cause}",
                Kind::default().name(),
                kinds()
            ),
        },
    })
}

/// The names of all kinds of machines.
fn kinds() -> String {
    Kind::ALL.map(|kind| format!("\"{}\"", kind.name())).join(", ")
}

/// The axes as they are written.
fn written_axes<'a, 'i>(table: &'a DeTable<'i>) -> Option<&'a DeArray<'i>> {
    table.get("axes")?.get_ref().as_array()
}

/// The drives that `[bus]` names, and where.
fn written_drives(table: &DeTable<'_>) -> Option<(usize, usize)> {
    let drives = table.get("bus")?.get_ref().as_table()?.get("drives")?;
    let number = drives.get_ref().as_integer()?.as_str().parse().ok()?;
    Some((number, drives.span().start))
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
        ReadingError::Machine {
            line: self.line(place),
            text,
        }
    }

    fn line(&self, place: usize) -> usize {
        let before = self.text.get(..place).unwrap_or(self.text);
        before.matches('\n').count() + 1
    }

    /// The configuration of a table of this kind of machine.
    fn read(&self, mut table: Spanned<DeTable<'_>>, kind: Option<Kind>) -> Result<Config, ReadingError> {
        let linear = kind.map_or([false; AXES], Kind::linear_axes);
        let idle = self.homes_without_switch(table.get_ref());
        self.share(table.get_mut(), &linear)?;
        self.check_counts(table.get_ref())?;
        let converted = self.converted(table.get_ref(), &linear)?;
        // The converted values are texts of their own, which live shorter than the file's.
        let mut table: Spanned<DeTable<'_>> = table;
        apply(table.get_mut(), &converted);
        complete(table.get_mut());
        let config = Config::deserialize(Deserializer::from(table)).map_err(|mut cause| {
            cause.set_input(Some(self.text));
            ReadingError::from(cause)
        })?;
        // Values of a home switch that nobody changed say nothing.
        let is_meant = |axis: usize| {
            let axis = config.axes.get(axis);
            axis.is_some_and(|axis| axis.home != HomeSwitch::default())
        };
        match idle.into_iter().find(|(axis, _)| is_meant(*axis)) {
            None => Ok(config),
            Some((axis, place)) => {
                let text = format!(
                    "axis {}: home has no switch: write switch = \"NAME\", the name of an [[io]] with role = \"home\"",
                    axis + 1
                );
                Err(self.error(place, text))
            }
        }
    }

    /// The kind of machine, if the file names one.
    fn kind(&self, table: &DeTable<'_>) -> Result<Option<Kind>, ReadingError> {
        let geometry = table.get("geometry").and_then(|geometry| geometry.get_ref().as_table());
        let Some(written) = geometry.and_then(|geometry| geometry.get("kind")) else {
            return Ok(None);
        };
        let kind = written.get_ref().as_str().and_then(Kind::named);
        kind.map(Some).ok_or_else(|| {
            let name = written.get_ref().as_str().unwrap_or_default();
            let text = format!("there is no kind \"{name}\" of machine; kind is one of {}", kinds());
            self.error(written.span().start, text)
        })
    }

    /// The line of `[geometry]` if that names no kind.
    fn unnamed_kind(&self, table: &DeTable<'_>) -> Option<usize> {
        let (name, geometry) = table.get_key_value("geometry")?;
        let has_kind = geometry.get_ref().as_table()?.contains_key("kind");
        (!has_kind).then(|| self.line(name.span().start))
    }

    /// The axes, from 0, whose `home` names no input, with the place of `home`.
    fn homes_without_switch(&self, table: &DeTable<'_>) -> Vec<(usize, usize)> {
        let axes = written_axes(table).into_iter().flat_map(|axes| axes.iter()).enumerate();
        let home = |(axis, values): (usize, &Spanned<DeValue<'_>>)| {
            let home = values.get_ref().as_table()?.get("home")?;
            let named = home.get_ref().as_table()?;
            let is_idle = !["switch", "io"].iter().any(|key| named.contains_key(*key));
            is_idle.then(|| (axis, home.span().start))
        };
        axes.filter_map(home).collect()
    }

    /// Refuses numbers that are not finite, by their names.
    fn check_numbers(&self, within: &str, table: &DeTable<'_>) -> Result<(), ReadingError> {
        for (key, value) in table {
            self.check_number(&format!("{within}{}", key.get_ref()), value)?;
        }
        Ok(())
    }

    fn check_number(&self, name: &str, value: &Spanned<DeValue<'_>>) -> Result<(), ReadingError> {
        match value.get_ref() {
            DeValue::Float(float) if ["nan", "inf"].iter().any(|word| float.as_str().contains(word)) => {
                let text = format!("{name} is {}; write a finite number", float.as_str());
                Err(self.error(value.span().start, text))
            }
            DeValue::Array(values) => values.iter().try_for_each(|value| self.check_number(name, value)),
            DeValue::Table(values) => self.check_numbers(&format!("{name}."), values),
            _ => Ok(()),
        }
    }

    /// Refuses more drives than axes, and lists with a value for each axis that have another number of values.
    fn check_counts(&self, table: &DeTable<'_>) -> Result<(), ReadingError> {
        let Some(axes) = written_axes(table).map(|axes| axes.iter().len()) else {
            return Ok(());
        };
        let drives = written_drives(table);
        if let Some((drives, place)) = drives.filter(|(drives, _)| *drives > axes) {
            let text = format!("bus.drives is {drives}, and there are {axes} [[axes]]; write one for each drive");
            return Err(self.error(place, text));
        }
        let motion = table.get("motion").and_then(|motion| motion.get_ref().as_table());
        let Some(motion) = motion else { return Ok(()) };
        for [own, other] in OWN_UNITS {
            let Some(list) = motion.get(own) else { continue };
            if motion.contains_key(other) {
                let text = format!("motion.{own} and motion.{other} are one limit; write one of them");
                return Err(self.error(list.span().start, text));
            }
            let values = list.get_ref().as_array().map_or(axes, |values| values.iter().len());
            let is_of_drives = drives.is_some_and(|(drives, _)| drives == values);
            if values != axes && values <= AXES && !is_of_drives {
                let text = format!(
                    "motion.{own} has a value for each axis: {axes} are needed, and there are {values}; write one for each \
                     of [[axes]]"
                );
                return Err(self.error(list.span().start, text));
            }
        }
        Ok(())
    }

    /// Gives each axis the shared values that it does not set itself, and that suit it: those in radians are not for linear
    /// axes, those in millimetres only for them.
    fn share(&self, table: &mut DeTable<'_>, linear: &[bool; AXES]) -> Result<(), ReadingError> {
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
        let suits = |number: usize, key: &str| {
            let is_linear = linear.get(number).copied().unwrap_or(false);
            let of_other = |Unit(mm, rad, _): &Unit| key == if is_linear { *rad } else { *mm };
            let is_foreign = LINEAR.iter().any(of_other) || key == PITCH && !is_linear;
            !(is_mixed && is_foreign)
        };
        let mut count = 0;
        for (number, axis) in tables_mut(axes).enumerate() {
            count += 1;
            for (key, value) in shared.iter().filter(|(key, _)| suits(number, key.get_ref())) {
                axis.entry(key.clone()).or_insert_with(|| value.clone());
            }
        }
        let is_unused = |key: &str| count > 0 && !(0..count).any(|number| suits(number, key));
        if let Some((key, _)) = shared.iter().find(|(key, _)| is_unused(key.get_ref())) {
            let name = key.get_ref();
            let in_mm = LINEAR.iter().find(|Unit(_, rad, _)| *rad == &**name);
            let remedy = in_mm.map_or("delete it".to_owned(), |Unit(mm, ..)| format!("write {mm} instead"));
            let text = format!("no axis of this machine takes {SHARED}.{name}; {remedy}");
            return Err(self.error(key.span().start, text));
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
        let Some((key, switch)) = home.get_key_value("switch") else {
            return Ok(());
        };
        if home.contains_key("io") {
            let text = format!(
                "axis {}: switch and io are the same input; write switch alone",
                number + 1
            );
            return Err(self.error(key.span().start, text));
        }
        let speed = if is_linear { "speed_mm_s" } else { "speed_rad_s" };
        if !home.contains_key(speed) {
            let text = format!(
                "axis {}: {speed} of home is missing: the speed towards the switch, whose sign is the direction",
                number + 1
            );
            return Err(self.error(key.span().start, text));
        }
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
mod tests;
