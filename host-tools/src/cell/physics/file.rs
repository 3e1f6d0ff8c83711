//! Which cell: a name, or a TOML file with the values that differ from the nominal ones.

use super::{Physics, Value};
use crate::error::{ProgramError, code};
use std::convert::Infallible;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Bytes that are read of a file.
const FILE_BYTES_MAX: u64 = 1 << 20;

/// Which cell.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum CellChoice {
    /// [`Physics::NOMINAL`].
    #[default]
    Nominal,
    /// [`Physics::PESSIMISTIC`].
    Pessimistic,
    /// The values of a file.
    File(PathBuf),
}

impl FromStr for CellChoice {
    type Err = Infallible;

    /// `nominal`, `pessimistic`, or any other text as the name of a file.
    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(match text {
            "nominal" => Self::Nominal,
            "pessimistic" => Self::Pessimistic,
            file => Self::File(PathBuf::from(file)),
        })
    }
}

impl std::fmt::Display for CellChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Nominal => f.write_str("nominal"),
            Self::Pessimistic => f.write_str("pessimistic"),
            Self::File(path) => path.display().fmt(f),
        }
    }
}

/// Why the text of a cell cannot be used.
#[derive(Clone, Debug)]
pub enum CellFileError {
    /// Not TOML, or a key or a kind of value that a cell does not have.
    Syntax(toml::de::Error),
    /// A number outside its bounds.
    Bounds(Value),
}

impl std::fmt::Display for CellFileError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Syntax(cause) => cause.fmt(f),
            Self::Bounds(value) => write!(
                f,
                "{} = {} is outside its bounds of {} to {}",
                value.name, value.value, value.low, value.high
            ),
        }
    }
}

impl std::error::Error for CellFileError {}

impl FromStr for Physics {
    type Err = CellFileError;

    /// Reads and checks the text of a file; values that it leaves out are nominal.
    fn from_str(text: &str) -> Result<Self, CellFileError> {
        let physics: Self = toml::from_str(text).map_err(CellFileError::Syntax)?;
        physics.check().map_err(CellFileError::Bounds)?;
        Ok(physics)
    }
}

impl CellChoice {
    /// The file of the cell, if it has one.
    #[must_use]
    pub fn file(&self) -> Option<&Path> {
        match self {
            Self::File(path) => Some(path),
            Self::Nominal | Self::Pessimistic => None,
        }
    }

    /// The cell's values.
    ///
    /// # Errors
    /// The file cannot be read, or a value cannot be used. The message names the file and the value.
    pub fn load(&self) -> Result<Physics, ProgramError> {
        let path = match self {
            Self::Nominal => return Ok(Physics::NOMINAL),
            Self::Pessimistic => return Ok(Physics::PESSIMISTIC),
            Self::File(path) => path,
        };
        let shown = path.display();
        let wrong =
            |cause: &dyn std::fmt::Display| ProgramError::new(code::USAGE, format!("the cell {shown}: {cause}"));
        let unreadable = |cause: std::io::Error| {
            let text = format!("cannot be read: {cause}. --cell takes nominal, pessimistic or a file");
            wrong(&text)
        };
        let mut text = String::new();
        std::fs::File::open(path)
            .and_then(|file| file.take(FILE_BYTES_MAX).read_to_string(&mut text))
            .map_err(unreadable)?;
        text.parse().map_err(|cause: CellFileError| wrong(&cause))
    }
}
