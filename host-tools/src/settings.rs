//! Reads configuration files, and changes single values in them without changing anything else.
//!
//! Comments, order and all other values are kept. A file that does not exist is created from the sample that lists all
//! values; a file without axes gets them when a value of an axis is stored.
//!
//! Invariant: the written file is a valid configuration within its bounds, and reads as before but for the stored values;
//! the file is replaced as a whole or not at all.

pub mod checking;
pub mod dimensions;
pub mod machines;
pub mod reading;
pub mod sheet;
pub mod starting;

use crate::axes::as_written;
use crate::error::{ProgramError, code};
use crate::link::text;
use etherpen::config::{Axis, Config, ConfigError, IoError};
use etherpen::control::robot_axes::encoder_angle_rad;
use etherpen::robots::{AXES, Kind};
use reading::ReadingError;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use toml_edit::{ArrayOfTables, DocumentMut, Item, Table, TomlError, Value};

/// Largest difference between the angles of a reference at stored marks and the stored angles, rad: more than an
/// increment of a resolver.
const STORED_DIFFERENCE_MAX_RAD: f64 = 1.0e-6;
/// Largest configuration file, bytes: ten times the sample, and few enough for a parser that needs a hundred times
/// their memory.
pub const FILE_BYTES_MAX: u64 = 256 << 10;
/// Longest line in a message, characters.
const LINE_CHARS_MAX: usize = 160;
/// All values with their defaults and comments.
const SAMPLE: &str = include_str!("../../samples/etherpen.toml");

/// Why a file was not changed.
#[derive(Debug)]
pub enum SettingsError {
    /// The file cannot be read or written.
    File(io::Error),
    /// The file is not valid TOML.
    Syntax(TomlError),
    /// The file has no place for the value.
    Place {
        /// Axis, from 0.
        axis: usize,
        /// Name of the value.
        field: &'static str,
    },
    /// The result would not be a valid configuration.
    Configuration(ReadingError),
    /// A value would be outside its bounds.
    Bounds(ConfigError),
    /// A named input or output could not be used.
    Io(IoError),
    /// The file describes another kind of machine.
    Kind {
        /// Kind of the file.
        file: Kind,
        /// Kind of the machine whose values are stored.
        machine: Kind,
    },
    /// Values that nobody asked to store would change.
    Others,
}

impl std::fmt::Display for SettingsError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::File(cause) => cause.fmt(f),
            Self::Syntax(cause) => f.write_str(&shortened(cause)),
            Self::Place { axis, field } => write!(f, "there is no place for axes[{axis}].{field} in it"),
            Self::Configuration(cause) => f.write_str(&shortened(cause)),
            // The message around it names the file.
            Self::Bounds(cause) => f.write_str(&text::config_error(cause).replace(" in etherpen.toml", "")),
            Self::Io(cause) => f.write_str(&text::io_error(cause)),
            Self::Kind { file, machine } => write!(
                f,
                "the file describes a {}, and the machine is a {}: name the machine's own file (etherpen config new --kind \
                 {} writes one)",
                file.name(),
                machine.name(),
                machine.name()
            ),
            Self::Others => f.write_str("other values than the stored ones would change; write [[axes]] for each axis"),
        }
    }
}

impl std::error::Error for SettingsError {}

/// A message that quotes a line, without the rest of a very long one.
fn shortened(cause: &impl std::fmt::Display) -> String {
    let text = cause.to_string();
    let cut = |line: &str| match line.char_indices().nth(LINE_CHARS_MAX) {
        Some((end, _)) => format!("{}...", line.get(..end).unwrap_or_default()),
        None => line.to_owned(),
    };
    text.lines().map(cut).collect::<Vec<_>>().join("\n")
}

/// Reads a file of limited size.
///
/// # Errors
/// The file cannot be read, is too large, or is not text.
pub fn read(path: &Path) -> io::Result<String> {
    let mut bytes = Vec::new();
    File::open(path)?.take(FILE_BYTES_MAX + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > FILE_BYTES_MAX {
        let message = format!("a configuration has at most {} KiB", FILE_BYTES_MAX >> 10);
        return Err(io::Error::new(io::ErrorKind::InvalidData, message));
    }
    String::from_utf8(bytes).map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "it is not text in UTF-8"))
}

/// Reads and checks a configuration file; `None` gives the built-in configuration.
///
/// # Errors
/// The file cannot be read, or a value cannot be used. The message names the file and the value.
pub fn load(path: Option<&Path>) -> Result<Config, ProgramError> {
    let Some(path) = path else {
        return Ok(Config::default());
    };
    let shown = path.display();
    let text = read(path).map_err(|cause| {
        ProgramError::new(
            code::USAGE,
            format!("the configuration {shown} cannot be read: {cause}"),
        )
    })?;
    checked(&text, &shown)
}

/// The configuration of a text, checked; `shown` names the text in messages.
fn checked(text: &str, shown: &dyn std::fmt::Display) -> Result<Config, ProgramError> {
    let config = reading::configuration(text).map_err(|cause| {
        ProgramError::new(
            code::USAGE,
            format!("the configuration {shown} is wrong:\n{}", shortened(&cause)),
        )
    })?;
    if let Some(finding) = checking::first_error(text) {
        let message = format!("the configuration {shown} is wrong: {finding}");
        return Err(ProgramError::new(code::USAGE, message));
    }
    Ok(config)
}

/// A configuration file being changed.
pub struct Settings {
    document: DocumentMut,
    /// What the file said before; `None` if it was no configuration.
    before: Option<Config>,
}

/// The values of an axis that [`Settings::store_axes`] stores.
const STORED: [&str; 7] = [
    "feedback_gain_per_s",
    "feed_forward_gain",
    "feed_forward_lead_ms",
    "position_lead_ms",
    "serial",
    "sync_angle_rad",
    "sync_increments",
];

/// The values of [`STORED`], in their order.
fn stored(axis: &Axis) -> [f64; STORED.len()] {
    [
        axis.feedback_gain_per_s,
        axis.feed_forward_gain,
        axis.feed_forward_lead_ms,
        axis.position_lead_ms,
        axis.serial.into(),
        axis.sync_angle_rad,
        axis.sync_increments.into(),
    ]
}

/// A configuration without the values that can be stored, to compare the others.
fn others(config: &Config) -> Config {
    let mut others = config.clone();
    (others.paper.pen_down_z_mm, others.paper.slope) = (0.0, [0.0; 2]);
    for axis in &mut others.axes {
        *axis = Axis {
            feedback_gain_per_s: 0.0,
            feed_forward_gain: 0.0,
            feed_forward_lead_ms: 0.0,
            position_lead_ms: 0.0,
            serial: 0,
            sync_angle_rad: 0.0,
            sync_increments: 0,
            ..*axis
        };
    }
    others
}

impl Settings {
    /// Reads a file; a file that does not exist starts as the sample.
    ///
    /// # Errors
    /// [`SettingsError::File`] and [`SettingsError::Syntax`].
    pub fn open(path: &Path) -> Result<Self, SettingsError> {
        let text = match read(path) {
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => SAMPLE.to_owned(),
            read => read.map_err(SettingsError::File)?,
        };
        Self::parse(&text)
    }

    /// Reads the text of a file.
    ///
    /// # Errors
    /// [`SettingsError::Syntax`].
    pub fn parse(text: &str) -> Result<Self, SettingsError> {
        let document: DocumentMut = text.parse().map_err(SettingsError::Syntax)?;
        let before = reading::configuration(text).ok();
        Ok(Self { document, before })
    }

    /// Writes the axes into a file that has none.
    fn add_axes(&mut self) -> Result<(), SettingsError> {
        let is_of_sample = self
            .before
            .as_ref()
            .is_none_or(|config| config.geometry.kind() == Kind::default());
        match self.document.get("axes") {
            Some(_) => {}
            // What the axes share stays where it is.
            None if self.document.contains_key(reading::SHARED) => {
                let axes: ArrayOfTables = (0..AXES).map(|_| Table::new()).collect();
                self.document.insert("axes", Item::ArrayOfTables(axes));
            }
            None if is_of_sample => {
                let mut sample: DocumentMut = SAMPLE.parse().map_err(SettingsError::Syntax)?;
                if let Some(axes) = sample.remove("axes") {
                    self.document.insert("axes", axes);
                }
            }
            None => {}
        }
        Ok(())
    }

    /// Sets one value of an axis, from 0.
    ///
    /// # Errors
    /// [`SettingsError::Place`] and [`SettingsError::Syntax`].
    pub fn set_axis(&mut self, axis: usize, field: &'static str, value: impl Into<Value>) -> Result<(), SettingsError> {
        let place = SettingsError::Place { axis, field };
        self.add_axes()?;
        let item = match self.document.get_mut("axes") {
            Some(Item::ArrayOfTables(tables)) => tables
                .get_mut(axis)
                .map(|table| table.entry(field).or_insert(Item::None)),
            Some(Item::Value(Value::Array(array))) => {
                let table = array.get_mut(axis).and_then(Value::as_inline_table_mut).ok_or(place)?;
                table.insert(field, value.into());
                return Ok(());
            }
            _ => None,
        };
        let item = item.ok_or(place)?;
        let mut value = value.into();
        if let Some(before) = item.as_value() {
            *value.decor_mut() = before.decor().clone();
        }
        *item = Item::Value(value);
        Ok(())
    }

    /// Stores the axes' values that differ from the file, each in the unit of its axis; returns their number. Axes without a
    /// drive are left alone.
    ///
    /// # Errors
    /// [`SettingsError`]; nothing is written.
    pub fn store_axes(&mut self, wanted: &Config) -> Result<usize, SettingsError> {
        let now = self.config()?;
        self.check_kind(wanted.geometry.kind())?;
        let kind = now.geometry.kind();
        let mut changed = 0;
        let axes = wanted.axes.iter().zip(&now.axes).take(wanted.bus.drives.into());
        for (number, (axis, before)) in axes.enumerate() {
            let values = STORED.into_iter().zip(stored(axis).into_iter().zip(stored(before)));
            for (field, (value, _)) in values.filter(|(_, (value, before))| value != before) {
                match as_written(kind, number, field) {
                    _ if field == "serial" => self.set_axis(number, field, i64::from(axis.serial))?,
                    _ if field == "sync_increments" => {
                        self.set_axis(number, field, i64::from(axis.sync_increments))?;
                    }
                    // In steps that are far below what acts.
                    Some((field, factor)) => self.set_axis(number, field, (value * factor * 1e9).round() / 1e9)?,
                    None => self.set_axis(number, field, value)?,
                }
                changed += 1;
            }
        }
        Ok(changed)
    }

    /// Refuses a machine of another kind than the file's.
    ///
    /// # Errors
    /// [`SettingsError::Kind`].
    pub fn check_kind(&self, machine: Kind) -> Result<(), SettingsError> {
        let file = self.before.as_ref().map_or(machine, |config| config.geometry.kind());
        match file == machine {
            true => Ok(()),
            false => Err(SettingsError::Kind { file, machine }),
        }
    }

    /// The configuration that reading the changed file would give.
    ///
    /// # Errors
    /// [`SettingsError::Configuration`] and [`SettingsError::Bounds`].
    pub fn config(&self) -> Result<Config, SettingsError> {
        let config = reading::configuration(&self.document.to_string()).map_err(SettingsError::Configuration)?;
        config.check().map_err(SettingsError::Bounds)?;
        config.check_io().map_err(SettingsError::Io)?;
        Ok(config)
    }

    /// Writes the file.
    ///
    /// # Errors
    /// [`SettingsError`]; the file is unchanged.
    pub fn save(&self, path: &Path) -> Result<(), SettingsError> {
        self.write(path, others)
    }

    /// Writes the file, in which what `others` keeps has to be as it was.
    fn write(&self, path: &Path, others: fn(&Config) -> Config) -> Result<(), SettingsError> {
        let now = self.config()?;
        if self
            .before
            .as_ref()
            .is_some_and(|before| others(before) != others(&now))
        {
            return Err(SettingsError::Others);
        }
        crate::output_file::write(path, self.document.to_string().as_bytes()).map_err(SettingsError::File)
    }
}

/// Refuses a file in which a machine's values cannot be stored, before the machine is asked for them.
///
/// # Errors
/// The file cannot be read, or describes another kind of machine.
pub fn check_target(path: &Path, kind: Kind) -> Result<(), ProgramError> {
    let checked = Settings::open(path).and_then(|settings| settings.check_kind(kind));
    let refused = |cause: SettingsError| {
        let what = match path.exists() {
            true => "cannot be changed",
            false => "does not exist, and would become an IRB 340",
        };
        ProgramError::new(code::USAGE, format!("{} {what}: {cause}", path.display()))
    };
    checked.map_err(refused)
}

/// Stores a pose as the marks in a configuration file, and reads it back; returns the number of changed values. Axes with a
/// home switch have no marks.
///
/// # Errors
/// The file cannot be changed, or contains other values than the ones stored.
pub fn store_reference(
    path: &Path,
    marked: &Config,
    increments: [i32; AXES],
    pose_rad: [f64; AXES],
) -> Result<usize, ProgramError> {
    let failed = |cause| ProgramError::failed(format!("{} cannot be changed", path.display()), cause);
    let mut settings = Settings::open(path).map_err(failed)?;
    let changed = settings.store_axes(marked).map_err(failed)?;
    settings.save(path).map_err(failed)?;
    let stored = Settings::open(path)
        .and_then(|settings| settings.config())
        .map_err(failed)?;
    let shown = stored.axes.iter().zip(increments).zip(pose_rad);
    let driven = (1..).zip(shown).take(marked.bus.drives.into());
    for (number, ((axis, increments), angle_rad)) in driven.filter(|(_, ((axis, _), _))| axis.home.io.is_none()) {
        let again_rad = encoder_angle_rad(axis, i64::from(increments), None);
        let difference_rad = (again_rad - angle_rad).abs();
        if difference_rad.is_nan() || difference_rad > STORED_DIFFERENCE_MAX_RAD {
            let message = format!(
                "{}: axis {number} would be {difference_rad} rad away from its place after a reference at the stored \
                 marks; look whether another program writes the file",
                path.display()
            );
            return Err(ProgramError::new(code::FAILED, message));
        }
    }
    Ok(changed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_nobody_asked_to_change_stays_as_it_was_written() {
        let mut settings = Settings::parse(SAMPLE).unwrap();
        let mut config = Config::default();
        config.axes[1].feed_forward_lead_ms = 3.25;
        config.axes[3].sync_increments = 4_711;
        assert_eq!(settings.store_axes(&config).unwrap(), 2);
        let text = settings.document.to_string();
        let changed: Vec<_> = SAMPLE
            .lines()
            .zip(text.lines())
            .filter(|(before, after)| before != after)
            .collect();
        assert_eq!(text.lines().count(), SAMPLE.lines().count());
        assert_eq!(changed.len(), 2, "{changed:?}");
        assert!(changed[0].1.starts_with("feed_forward_lead_ms = 3.25") && changed[0].1.contains('#'));
        assert_eq!(settings.config().unwrap(), config);
    }

    #[test]
    fn a_file_without_axes_gets_all_of_them_when_one_of_their_values_is_stored() {
        let text = "# mine\n[motion]\nspeed_mm_s = 150.0\n";
        let mut settings = Settings::parse(text).unwrap();
        let mut config = Config::default();
        config.motion.speed_mm_s = 150.0;
        assert_eq!(settings.store_axes(&config).unwrap(), 0);
        assert_eq!(settings.document.to_string(), text);
        config.axes[0].feed_forward_gain = 1.01;
        assert_eq!(settings.store_axes(&config).unwrap(), 1);
        assert_eq!(settings.config().unwrap(), config);
        assert!(settings.document.to_string().starts_with("# mine\n[motion]"));
    }

    #[test]
    fn what_the_axes_share_stays_theirs_when_a_file_without_axes_gets_them() {
        let mut settings = Settings::parse("[axis_defaults]\ngear = 14.0\n").unwrap();
        let mut config = settings.config().unwrap();
        assert_eq!(config.axes.map(|axis| axis.gear), [14.0; AXES]);
        config.axes[2].sync_angle_rad = 0.25;
        assert_eq!(settings.store_axes(&config).unwrap(), 1);
        assert_eq!(settings.config().unwrap(), config);
        assert!(!settings.document.to_string().contains("12.0"), "{}", settings.document);
    }

    #[test]
    fn marks_are_stored_in_the_unit_of_each_axis_on_every_machine() {
        for machine in machines::MACHINES {
            let mut settings = Settings::parse(machine.text).unwrap();
            let mut config = machine.load().unwrap();
            let drives = usize::from(config.bus.drives);
            for (number, axis) in config.axes.iter_mut().enumerate() {
                axis.sync_angle_rad += 0.0125;
                axis.sync_increments = 1_000 + number as i32;
            }
            assert_eq!(settings.store_axes(&config).unwrap(), 2 * drives, "{}", machine.name);
            let read = settings.config().unwrap();
            for (axis, wanted) in read.axes.iter().zip(&config.axes).take(drives) {
                assert!(
                    (axis.sync_angle_rad - wanted.sync_angle_rad).abs() < 1.0e-9,
                    "{}",
                    machine.name
                );
                assert_eq!(axis.sync_increments, wanted.sync_increments);
            }
            let path =
                std::env::temp_dir().join(format!("etherpen-marks-{}-{}.toml", machine.name, std::process::id()));
            settings.save(&path).unwrap();
            std::fs::remove_file(&path).unwrap();
        }
    }

    #[test]
    fn another_kind_of_machine_is_not_stored() {
        let mut settings = Settings::parse(SAMPLE).unwrap();
        let gantry = machines::MACHINES[1].load().unwrap();
        let refused = settings.store_axes(&gantry).unwrap_err();
        assert!(
            matches!(
                refused,
                SettingsError::Kind {
                    file: Kind::Delta,
                    machine: Kind::Gantry
                }
            ),
            "{refused:?}"
        );
        assert!(refused.to_string().contains("config new --kind gantry"), "{refused}");
    }

    #[test]
    fn a_change_of_another_value_is_not_written() {
        let path = std::env::temp_dir().join(format!("etherpen-others-{}.toml", std::process::id()));
        let mut settings = Settings::parse(SAMPLE).unwrap();
        settings.set_axis(0, "gear", 14.0).unwrap();
        assert!(matches!(settings.save(&path), Err(SettingsError::Others)));
        assert!(!path.exists());
    }

    #[test]
    fn axes_in_one_line_can_be_changed_too() {
        let mut settings = Settings::parse("axes = [{}, {}, {gear = 12.0}, {}]\n").unwrap();
        settings.set_axis(2, "feed_forward_gain", 0.99).unwrap();
        assert_eq!(settings.config().unwrap().axes[2].feed_forward_gain, 0.99);
        assert!(matches!(
            settings.set_axis(4, "gear", 1.0),
            Err(SettingsError::Place { axis: 4, .. })
        ));
    }

    #[test]
    fn a_value_out_of_bounds_is_not_written() {
        let path = std::env::temp_dir().join(format!("etherpen-settings-{}.toml", std::process::id()));
        let mut settings = Settings::open(&path).unwrap();
        settings.set_axis(0, "feed_forward_lead_ms", 11.0).unwrap();
        assert!(matches!(settings.save(&path), Err(SettingsError::Bounds(_))));
        assert!(!path.exists());
        settings.set_axis(0, "feed_forward_lead_ms", 4.0).unwrap();
        settings.save(&path).unwrap();
        let stored = Settings::open(&path).unwrap().config().unwrap();
        std::fs::remove_file(&path).unwrap();
        assert_eq!(stored.axes[0].feed_forward_lead_ms, 4.0);
    }
}
