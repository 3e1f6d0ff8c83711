//! Reads configuration files, and changes single values in them without changing anything else.
//!
//! Comments, order and all other values are kept. A file that does not exist is created from the sample that lists all
//! values; a file without axes gets the sample's axes.
//!
//! Invariant: the written file is a valid configuration within its bounds; the file is replaced as a whole or not at
//! all.

pub mod checking;
pub mod machines;
pub mod reading;
pub mod starting;

use crate::error::{ProgramError, code};
use crate::link::text;
use etherpen::config::{Config, ConfigError, IoError};
use etherpen::control::robot_axes::resolver_angle_rad;
use etherpen::robots::AXES;
use reading::ReadingError;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use toml_edit::{DocumentMut, Item, TomlError, Value};

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
}

impl std::fmt::Display for SettingsError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::File(cause) => cause.fmt(f),
            Self::Syntax(cause) => f.write_str(&shortened(cause)),
            Self::Place { axis, field } => write!(f, "there is no place for axes[{axis}].{field} in it"),
            Self::Configuration(cause) => f.write_str(&shortened(cause)),
            Self::Bounds(cause) => f.write_str(&text::config_error(cause)),
            Self::Io(cause) => f.write_str(&text::io_error(cause)),
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
        let mut document: DocumentMut = text.parse().map_err(SettingsError::Syntax)?;
        if document.get("axes").is_none() {
            let mut sample: DocumentMut = SAMPLE.parse().map_err(SettingsError::Syntax)?;
            if let Some(axes) = sample.remove("axes") {
                document.insert("axes", axes);
            }
        }
        Ok(Self { document })
    }

    /// Sets one value of an axis, from 0.
    ///
    /// # Errors
    /// [`SettingsError::Place`].
    pub fn set_axis(&mut self, axis: usize, field: &'static str, value: impl Into<Value>) -> Result<(), SettingsError> {
        let place = SettingsError::Place { axis, field };
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

    /// Stores the axes' values that differ from the file; returns their number.
    ///
    /// # Errors
    /// [`SettingsError`]; nothing is written.
    pub fn store_axes(&mut self, wanted: &Config) -> Result<usize, SettingsError> {
        let now = self.config()?;
        let mut changed = 0;
        for (number, (axis, before)) in wanted.axes.iter().zip(&now.axes).enumerate() {
            let values = [
                (
                    "feedback_gain_per_s",
                    axis.feedback_gain_per_s,
                    before.feedback_gain_per_s,
                ),
                ("feed_forward_gain", axis.feed_forward_gain, before.feed_forward_gain),
                (
                    "feed_forward_lead_ms",
                    axis.feed_forward_lead_ms,
                    before.feed_forward_lead_ms,
                ),
                ("position_lead_ms", axis.position_lead_ms, before.position_lead_ms),
                ("sync_angle_rad", axis.sync_angle_rad, before.sync_angle_rad),
            ];
            for (field, value, before) in values {
                if value != before {
                    self.set_axis(number, field, value)?;
                    changed += 1;
                }
            }
            if axis.sync_increments != before.sync_increments {
                self.set_axis(number, "sync_increments", i64::from(axis.sync_increments))?;
                changed += 1;
            }
        }
        Ok(changed)
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
        self.config()?;
        crate::output_file::write(path, self.document.to_string().as_bytes()).map_err(SettingsError::File)
    }
}

/// Stores a pose as the marks in a configuration file, and reads it back; returns the number of changed values.
///
/// # Errors
/// The file cannot be changed, or contains other values than the ones stored.
pub fn store_reference(
    path: &Path,
    marked: &Config,
    increments: [u32; AXES],
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
    for (number, ((axis, increments), angle_rad)) in (1..).zip(shown) {
        let again_rad = resolver_angle_rad(axis, i64::from(increments), None);
        let difference_rad = (again_rad - angle_rad).abs();
        if difference_rad.is_nan() || difference_rad > STORED_DIFFERENCE_MAX_RAD {
            let message = format!(
                "{}: axis {number} would be at {again_rad} rad after a reference at the stored marks, and is at \
                 {angle_rad} rad; look whether another program writes the file",
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
    fn a_file_without_axes_gets_all_of_them() {
        let mut settings = Settings::parse("# mine\n[motion]\nspeed_mm_s = 150.0\n").unwrap();
        let mut config = Config::default();
        config.motion.speed_mm_s = 150.0;
        config.axes[0].feed_forward_gain = 1.01;
        assert_eq!(settings.store_axes(&config).unwrap(), 1);
        assert_eq!(settings.config().unwrap(), config);
        assert!(settings.document.to_string().starts_with("# mine\n[motion]"));
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
