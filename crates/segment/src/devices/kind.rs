//! Slaves of the segment, as a list for the command line.
//!
//! `ax2000,ax2000,cia402,ek1100,el1008,el2004,sii:FILE,ax2000*4`: kinds in the order of the chain, `*N` repeats one.

use crate::devices::Device;
use crate::devices::ax2000;
use crate::devices::coupler::Coupler;
use crate::devices::generic_drive;
use crate::devices::image_device::ImageDevice;
use crate::devices::servo_device::ServoDevice;
use crate::devices::terminal;
use crate::drive::servo::Servo;
use std::fmt;
use std::sync::Arc;

/// Most slaves in a list.
pub const SLAVES_MAX: usize = 256;
/// Most bytes of an information memory read from a file.
const IMAGE_BYTES_MAX: u64 = 1 << 20;

/// One kind of slave.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SlaveKind {
    /// `ax2000`: servo drive AX2000-B110.
    Ax2000,
    /// `cia402`: generic CiA 402 servo drive.
    Cia402,
    /// `ek1100`: bus coupler.
    Ek1100,
    /// `el1004`: terminal with four digital inputs.
    El1004,
    /// `el1008`: terminal with eight digital inputs.
    El1008,
    /// `el2004`: terminal with four digital outputs.
    El2004,
    /// `el2008`: terminal with eight digital outputs.
    El2008,
    /// `blank`: a board whose information memory was never written; nothing answers its state requests.
    Blank,
    /// `sii:FILE`: a slave with this information memory.
    Sii(Arc<[u8]>),
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
            Self::TooMany { limit } => write!(formatter, "more than {limit} slaves"),
            Self::File { path, reason } => write!(formatter, "cannot read the slave information '{path}': {reason}"),
        }
    }
}

impl std::error::Error for SlaveListError {}

impl SlaveKind {
    /// Words of a list, but for images from files.
    const NAMES: [(&'static str, Self); 8] = [
        ("ax2000", Self::Ax2000),
        ("cia402", Self::Cia402),
        ("ek1100", Self::Ek1100),
        ("el1004", Self::El1004),
        ("el1008", Self::El1008),
        ("el2004", Self::El2004),
        ("el2008", Self::El2008),
        ("blank", Self::Blank),
    ];

    /// Parses one kind; `sii:FILE` reads the file.
    ///
    /// # Errors
    /// [`SlaveListError`] for an unknown word or a file that cannot be read.
    pub fn parse(word: &str) -> Result<Self, SlaveListError> {
        let known = Self::NAMES.into_iter().find(|(name, _)| *name == word);
        match (known, word.strip_prefix("sii:")) {
            (Some((_, kind)), _) => Ok(kind),
            (None, Some(path)) => read(path),
            (None, None) => Err(SlaveListError::Kind { word: word.to_owned() }),
        }
    }

    /// Its word in a list; `sii` for an image from a file.
    #[must_use]
    pub fn name(&self) -> &'static str {
        let known = Self::NAMES.iter().find(|(_, kind)| kind == self);
        known.map_or("sii", |(name, _)| name)
    }

    /// Whether the slave has a motor.
    #[must_use]
    pub fn is_drive(&self) -> bool {
        matches!(self, Self::Ax2000 | Self::Cia402)
    }

    /// Makes the device; a drive kind takes the servo.
    pub(crate) fn device(&self, servo: Option<Servo>, serial: u32) -> Box<dyn Device> {
        match (self, servo) {
            (Self::Ax2000, Some(servo)) => Box::new(ServoDevice::new(&ax2000::MODEL, servo, serial)),
            (Self::Cia402, Some(servo)) => Box::new(ServoDevice::new(&generic_drive::MODEL, servo, serial)),
            (Self::Sii(image), _) => Box::new(ImageDevice::new(image.to_vec())),
            (Self::El1004, _) => Box::new(terminal::EL1004.device()),
            (Self::El1008, _) => Box::new(terminal::EL1008.device()),
            (Self::El2004, _) => Box::new(terminal::EL2004.device()),
            (Self::El2008, _) => Box::new(terminal::EL2008.device()),
            (Self::Blank, _) => Box::new(ImageDevice::blank()),
            (_, servo) => Box::new(Coupler::new(servo)),
        }
    }
}

fn read(path: &str) -> Result<SlaveKind, SlaveListError> {
    let failure = |reason: String| SlaveListError::File {
        path: path.to_owned(),
        reason,
    };
    let length = std::fs::metadata(path)
        .map_err(|error| failure(error.to_string()))?
        .len();
    if length > IMAGE_BYTES_MAX {
        return Err(failure(format!("{length} bytes are more than {IMAGE_BYTES_MAX}")));
    }
    let image = std::fs::read(path).map_err(|error| failure(error.to_string()))?;
    Ok(SlaveKind::Sii(image.into()))
}

/// Parses a list of slaves in the order of the chain.
///
/// # Errors
/// [`SlaveListError`] with the word that was rejected.
pub fn parse_slaves(list: &str) -> Result<Vec<SlaveKind>, SlaveListError> {
    let mut slaves = Vec::new();
    for word in list.split(',').map(str::trim) {
        let (name, count) = match word.rsplit_once('*') {
            Some((name, count)) => {
                let parsed = count
                    .trim()
                    .parse()
                    .ok()
                    .filter(|count| (1..=SLAVES_MAX).contains(count));
                (
                    name.trim(),
                    parsed.ok_or_else(|| SlaveListError::Count { word: word.to_owned() })?,
                )
            }
            None => (word, 1),
        };
        let kind = SlaveKind::parse(name)?;
        if slaves.len() + count > SLAVES_MAX {
            return Err(SlaveListError::TooMany { limit: SLAVES_MAX });
        }
        slaves.extend(std::iter::repeat_n(kind, count));
    }
    Ok(slaves)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_names_kinds_and_repetitions() {
        let slaves = parse_slaves("ax2000, cia402,ek1100,ax2000*3").expect("a list");
        assert_eq!(slaves.len(), 6);
        for (name, kind) in SlaveKind::NAMES {
            assert_eq!((SlaveKind::parse(name), kind.name()), (Ok(kind), name));
        }
        assert_eq!(slaves[1..3], [SlaveKind::Cia402, SlaveKind::Ek1100]);
        assert!(slaves[3..].iter().all(SlaveKind::is_drive));
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
        let many = parse_slaves("ax2000*200,ax2000*100");
        assert_eq!(many, Err(SlaveListError::TooMany { limit: SLAVES_MAX }));
        assert!(matches!(parse_slaves("sii:/nowhere"), Err(SlaveListError::File { .. })));
    }
}
