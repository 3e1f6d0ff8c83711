//! A chain of slaves as text for the command line.
//!
//! `ek1100,el1008,ax2000*4,cia402@alias=3@serial=7,sii:FILE`: kinds in the order of the chain. Behind a kind come its
//! settings, each with `@`, and `*N` for N of them.

use crate::controller::silicon::ClockWidth;
use crate::devices::kind::SlaveKind;
use crate::slave::options::PlaceOptions;
use std::fmt;
use std::path::{Path, PathBuf};

/// Most slaves in a list.
pub const SLAVES_MAX: usize = 256;
/// Most bytes of an information memory read from a file.
const IMAGE_BYTES_MAX: u64 = 1 << 20;
/// Longest time of a processor in a setting, ms.
const TIME_MAX_MS: u64 = 3_600_000;
/// The settings of a slave, for messages.
const SETTINGS: &str = "alias=N, serial=N, id=N, clock=32|64, boot=MS, transition=MS, mailbox=MS or sii=needed";

/// A chain of slaves.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SlaveList {
    /// The kinds in the order of the chain.
    pub slaves: Vec<SlaveKind>,
    /// What is set on each.
    pub places: Vec<PlaceOptions>,
    /// The files that were read.
    pub files: Vec<PathBuf>,
}

/// Why a list of slaves was rejected.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SlaveListError {
    /// Unknown kind.
    Kind {
        /// The word.
        word: String,
    },
    /// The number of repetitions is missing, malformed, 0 or too large.
    Count {
        /// The word.
        word: String,
    },
    /// A setting behind `@` is unknown, malformed or out of range.
    Setting {
        /// The setting.
        word: String,
    },
    /// The list has too many slaves.
    TooMany {
        /// Most slaves allowed.
        limit: usize,
    },
    /// A file of an information memory could not be read.
    File {
        /// Its path.
        path: String,
        /// Error message of the operating system.
        reason: String,
    },
}

impl fmt::Display for SlaveListError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kind { word } => {
                write!(formatter, "no such slave: '{word}' (")?;
                for (name, _) in SlaveKind::NAMES {
                    write!(formatter, "{name}, ")?;
                }
                write!(formatter, "or sii:FILE)")
            }
            Self::Count { word } => write!(formatter, "not a number of slaves from 1 to {SLAVES_MAX}: '{word}'"),
            Self::Setting { word } => write!(formatter, "no such setting of a slave: '@{word}' ({SETTINGS})"),
            Self::TooMany { limit } => write!(formatter, "more than {limit} slaves"),
            Self::File { path, reason } => write!(formatter, "cannot read the slave information '{path}': {reason}"),
        }
    }
}

impl std::error::Error for SlaveListError {}

impl std::str::FromStr for SlaveList {
    type Err = SlaveListError;

    /// Reads a chain; `sii:FILE` reads the file.
    fn from_str(text: &str) -> Result<Self, SlaveListError> {
        let mut list = Self::default();
        for item in text.split(',').map(str::trim) {
            list.add(item)?;
        }
        Ok(list)
    }
}

impl SlaveList {
    fn add(&mut self, item: &str) -> Result<(), SlaveListError> {
        let (item, count) = repeated(item)?;
        let (word, settings) = split_settings(item);
        let kind = match (SlaveKind::named(word), word.strip_prefix("sii:")) {
            (Some(kind), _) => kind,
            (None, Some(path)) => {
                self.files.push(path.into());
                SlaveKind::from_file(Path::new(path))?
            }
            (None, None) => return Err(SlaveListError::Kind { word: word.to_owned() }),
        };
        let mut place = PlaceOptions::default();
        for setting in settings {
            set(&mut place, setting).ok_or_else(|| SlaveListError::Setting {
                word: setting.to_owned(),
            })?;
        }
        if self.slaves.len() + count > SLAVES_MAX {
            return Err(SlaveListError::TooMany { limit: SLAVES_MAX });
        }
        self.slaves.extend(std::iter::repeat_n(kind, count));
        self.places.extend(std::iter::repeat_n(place, count));
        Ok(())
    }
}

/// Parses a list of slaves without settings, in the order of the chain.
///
/// # Errors
/// [`SlaveListError`] with the word that was rejected.
pub fn parse_slaves(list: &str) -> Result<Vec<SlaveKind>, SlaveListError> {
    let list: SlaveList = list.parse()?;
    match list.places.iter().all(|place| *place == PlaceOptions::default()) {
        true => Ok(list.slaves),
        false => Err(SlaveListError::Setting { word: String::new() }),
    }
}

/// An item without its number of repetitions, and that number.
fn repeated(item: &str) -> Result<(&str, usize), SlaveListError> {
    let Some((name, count)) = item.rsplit_once('*') else {
        return Ok((item, 1));
    };
    let parsed = count.trim().parse().ok();
    let count = parsed.filter(|count| (1..=SLAVES_MAX).contains(count));
    let count = count.ok_or_else(|| SlaveListError::Count { word: item.to_owned() })?;
    Ok((name.trim(), count))
}

/// The kind of an item and its settings. What follows an `@` without `=` belongs to the kind: a file may be called so.
fn split_settings(item: &str) -> (&str, Vec<&str>) {
    let (mut word, mut settings) = (item, Vec::new());
    while let Some((before, setting)) = word.rsplit_once('@').filter(|(_, setting)| setting.contains('=')) {
        settings.push(setting.trim());
        word = before.trim_end();
    }
    settings.reverse();
    (word, settings)
}

/// Takes one setting; `None` if it is unknown or out of range.
fn set(place: &mut PlaceOptions, setting: &str) -> Option<()> {
    let (key, value) = setting.split_once('=')?;
    let milliseconds = || number(value).filter(|ms| *ms <= TIME_MAX_MS);
    match key {
        "alias" => place.alias = number(value)?.try_into().ok()?,
        "serial" => place.serial = Some(number(value)?.try_into().ok()?),
        "id" => place.identification = Some(number(value)?.try_into().ok()?),
        "clock" => {
            place.clock = Some(match value {
                "32" => ClockWidth::Bits32,
                "64" => ClockWidth::Bits64,
                _ => return None,
            });
        }
        "boot" => place.processor.boot_ms = milliseconds()?,
        "transition" => place.processor.transition_ms = milliseconds()?,
        "mailbox" => place.processor.mailbox_ms = milliseconds()?,
        "sii" if value == "needed" => place.processor.reads_sii = true,
        _ => return None,
    }
    Some(())
}

fn number(word: &str) -> Option<u64> {
    match word.strip_prefix("0x") {
        Some(digits) => u64::from_str_radix(digits, 16).ok(),
        None => word.parse().ok(),
    }
}

impl SlaveKind {
    /// A slave with the information memory in this file.
    ///
    /// # Errors
    /// The file cannot be read, or is longer than 1 MiB.
    pub fn from_file(path: &Path) -> Result<Self, SlaveListError> {
        let failure = |reason: String| SlaveListError::File {
            path: path.display().to_string(),
            reason,
        };
        let length = std::fs::metadata(path)
            .map_err(|error| failure(error.to_string()))?
            .len();
        if length > IMAGE_BYTES_MAX {
            return Err(failure(format!("{length} bytes are more than {IMAGE_BYTES_MAX}")));
        }
        let image = std::fs::read(path).map_err(|error| failure(error.to_string()))?;
        Ok(Self::Sii(image.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_names_kinds_and_repetitions() {
        let slaves = parse_slaves("ax2000, cia402,ek1100,ax2000*3").expect("a list");
        assert_eq!(slaves.len(), 6);
        for (name, kind) in SlaveKind::NAMES {
            assert_eq!((SlaveKind::named(name), kind.name()), (Some(kind.clone()), name));
        }
        assert_eq!(slaves[1..3], [SlaveKind::Cia402, SlaveKind::Ek1100]);
        assert!(slaves[3..].iter().all(SlaveKind::is_drive));
    }

    #[test]
    fn settings_belong_to_their_item() {
        let list: SlaveList = "ek1100, cia402@alias=0x12@serial=7@id=5*2,ax2000 @clock=32@boot=500@sii=needed"
            .parse()
            .expect("a list");
        let drive = PlaceOptions {
            alias: 0x12,
            serial: Some(7),
            identification: Some(5),
            ..PlaceOptions::default()
        };
        let mut last = PlaceOptions {
            clock: Some(ClockWidth::Bits32),
            ..PlaceOptions::default()
        };
        (last.processor.boot_ms, last.processor.reads_sii) = (500, true);
        assert_eq!(list.places, [PlaceOptions::default(), drive, drive, last]);
    }

    #[test]
    fn what_is_wrong_with_a_list_is_named() {
        let kind = |word: &str| SlaveListError::Kind { word: word.to_owned() };
        assert_eq!(parse_slaves("ax2000,ax200"), Err(kind("ax200")));
        assert_eq!(parse_slaves(""), Err(kind("")));
        let count = |word: &str| SlaveListError::Count { word: word.to_owned() };
        for word in ["ax2000*0", "ax2000*", "ax2000*x", "cia402*257"] {
            assert_eq!(parse_slaves(word), Err(count(word)));
        }
        for word in [
            "alias=70000",
            "alias=x",
            "serial=0x100000000",
            "clock=16",
            "boot=3600001",
            "sii=yes",
            "speed=1",
        ] {
            let setting = SlaveListError::Setting { word: word.to_owned() };
            assert_eq!(format!("ax2000@{word}").parse::<SlaveList>(), Err(setting));
        }
        let many = parse_slaves("ax2000*200,ax2000*100");
        assert_eq!(many, Err(SlaveListError::TooMany { limit: SLAVES_MAX }));
        assert!(matches!(parse_slaves("sii:/nowhere"), Err(SlaveListError::File { .. })));
    }
}
