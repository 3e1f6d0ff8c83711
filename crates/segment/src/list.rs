//! Slaves and their cables as text for the command line.
//!
//! `ek1100,el1008,ax2000*4,cia402@alias=3@serial=7,sii:FILE`: kinds in the order of the chain. Behind a kind come its
//! settings, each with `@`, and `*N` for N of them. Branches follow a slave in parentheses:
//! `ek1100,ek1122(ax2000,ax2000)(3:cia402),el1008` has two drives at port 2 of the junction, one at port 3, and the
//! terminal at port 1. The slaves of the list are those of the segment in the order in which frames pass them: a frame
//! leaves through the ports 3, 1 and 2.

use crate::controller::silicon::{ClockWidth, ControllerType};
use crate::devices::kind::SlaveKind;
use crate::drive::OneTurn;
use crate::eeprom::esi::EsiDevice;
use crate::mailbox::process_data::DataManagers;
use crate::slave::options::PlaceOptions;
use crate::wiring::Branch;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Most slaves in a list.
pub const SLAVES_MAX: usize = 256;
/// Most bytes of an information memory read from a file.
const IMAGE_BYTES_MAX: u64 = 1 << 20;
/// Longest time of a processor in a setting, ms.
const TIME_MAX_MS: u64 = 3_600_000;
/// Most bytes of a slave information file (ESI).
const ESI_BYTES_MAX: u64 = 64 << 20;
/// The settings of a slave, for messages.
const SETTINGS: &str = "name=NAME, alias=N, serial=N, id=N, password=N, clock=32|64, controller=et1100|lan9252|akd, managers=OUT/IN, range=turn|untold, lock=MS, \
                        boot=MS, transition=MS, mailbox=MS, lrw=no, units=pairs or sii=needed";
/// Ports that parentheses without a port take, in turn.
const BRANCH_PORTS: [u8; 2] = [2, 3];

/// A chain of slaves.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SlaveList {
    /// The kinds in the order of the chain.
    pub slaves: Vec<SlaveKind>,
    /// What is set on each.
    pub places: Vec<PlaceOptions>,
    /// Name of each; empty without one.
    pub names: Vec<String>,
    /// The cables that do not lead from one slave to the next.
    pub branches: Vec<Branch>,
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
    /// Parentheses are not closed, or a branch is at a port that the slave does not have or that is taken.
    Branch {
        /// The slave with its branches.
        word: String,
    },
    /// Two slaves have the same name.
    Name {
        /// The name.
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
                write!(formatter, "sii:FILE or esi:FILE)")
            }
            Self::Count { word } => write!(formatter, "not a number of slaves from 1 to {SLAVES_MAX}: '{word}'"),
            Self::Setting { word } => write!(formatter, "no such setting of a slave: '@{word}' ({SETTINGS})"),
            Self::Branch { word } => write!(
                formatter,
                "no such branch: '{word}' (a slave with parentheses: ek1122(el1008)(3:el2004); a port that it has)"
            ),
            Self::Name { word } => write!(formatter, "two slaves are called '{word}'"),
            Self::TooMany { limit } => write!(formatter, "more than {limit} slaves"),
            Self::File { path, reason } => write!(formatter, "cannot read the slave information '{path}': {reason}"),
        }
    }
}

impl std::error::Error for SlaveListError {}

impl std::str::FromStr for SlaveList {
    type Err = SlaveListError;

    /// Reads slaves; `sii:FILE` and `esi:FILE` read the file.
    fn from_str(text: &str) -> Result<Self, SlaveListError> {
        let mut list = Self::default();
        let items = list.read(text, 0)?;
        list.place(&items, None)?;
        for (at, name) in list.names.iter().enumerate().filter(|(_, name)| !name.is_empty()) {
            if list.names.iter().take(at).any(|other| other == name) {
                return Err(SlaveListError::Name { word: name.clone() });
            }
        }
        Ok(list)
    }
}

/// One slave with what is behind its ports.
#[derive(Clone, Debug)]
struct Item {
    kind: SlaveKind,
    place: PlaceOptions,
    name: String,
    word: String,
    branches: Vec<(u8, Vec<Item>)>,
}

impl SlaveList {
    /// Reads the slaves of one line, `depth` branches deep.
    fn read(&mut self, text: &str, depth: usize) -> Result<Vec<Item>, SlaveListError> {
        let too_many = SlaveListError::TooMany { limit: SLAVES_MAX };
        if depth > SLAVES_MAX {
            return Err(too_many);
        }
        let mut items = Vec::new();
        for word in split_items(text) {
            let (head, branches) = split_branches(word)?;
            let (head, count) = repeated(head)?;
            let mut item = self.item(head, word)?;
            for (port, branch) in branches {
                let line = self.read(branch, depth + 1)?;
                item.branches.push((port, line));
            }
            let is_many = count > 1 && !(item.branches.is_empty() && item.name.is_empty());
            if is_many {
                return Err(SlaveListError::Count { word: word.to_owned() });
            }
            if items.len() + count > SLAVES_MAX {
                return Err(too_many);
            }
            items.extend(std::iter::repeat_n(item, count));
        }
        Ok(items)
    }

    fn item(&mut self, head: &str, word: &str) -> Result<Item, SlaveListError> {
        let (kind, settings) = split_settings(head);
        let mut item = Item {
            kind: self.kind(kind)?,
            place: PlaceOptions::default(),
            name: String::new(),
            word: word.to_owned(),
            branches: Vec::new(),
        };
        for setting in settings {
            let taken = match setting.split_once('=') {
                Some(("name", name)) if is_name(name) => {
                    item.name = name.to_owned();
                    Some(())
                }
                _ => set(&mut item.place, setting),
            };
            taken.ok_or_else(|| SlaveListError::Setting {
                word: setting.to_owned(),
            })?;
        }
        Ok(item)
    }

    fn kind(&mut self, word: &str) -> Result<SlaveKind, SlaveListError> {
        if let Some(kind) = SlaveKind::named(word) {
            return Ok(kind);
        }
        if let Some(path) = word.strip_prefix("sii:") {
            self.files.push(path.into());
            return SlaveKind::from_file(Path::new(path));
        }
        let Some(description) = word.strip_prefix("esi:") else {
            return Err(SlaveListError::Kind { word: word.to_owned() });
        };
        let (path, device) = match description.split_once('#') {
            Some((path, device)) => (path, Some(device)),
            None => (description, None),
        };
        self.files.push(path.into());
        SlaveKind::from_description(Path::new(path), device)
    }

    /// Adds the slaves of a line, whose first one is behind this port of this slave, from 1, in the order in which
    /// frames pass them.
    fn place(&mut self, items: &[Item], behind: Option<(usize, u8)>) -> Result<(), SlaveListError> {
        let Some((item, rest)) = items.split_first() else {
            return Ok(());
        };
        if self.slaves.len() >= SLAVES_MAX {
            return Err(SlaveListError::TooMany { limit: SLAVES_MAX });
        }
        self.slaves.push(item.kind.clone());
        self.places.push(item.place);
        self.names.push(item.name.clone());
        let slave = self.slaves.len();
        if let Some((behind, port)) = behind.filter(|place| *place != (slave - 1, 1)) {
            self.branches.push(Branch { slave, behind, port });
        }
        let at = |port: u8| {
            let mut lines = item.branches.iter().filter(move |(other, _)| *other == port);
            let line = lines.next().map(|(_, line)| line.as_slice());
            let twice = lines.next().is_some() || port == 1 && line.is_some() && !rest.is_empty();
            let line = line.or(Some(rest).filter(|rest| port == 1 && !rest.is_empty()));
            match line {
                Some(_) if twice || !item.kind.has_port(port) => Err(SlaveListError::Branch {
                    word: item.word.clone(),
                }),
                line => Ok(line.unwrap_or_default()),
            }
        };
        for port in [3, 1, 2] {
            self.place(at(port)?, Some((slave, port)))?;
        }
        Ok(())
    }
}

/// The items of a line: parentheses keep the commas inside them.
fn split_items(text: &str) -> impl Iterator<Item = &str> {
    let mut depth = 0usize;
    let parts = text.split(move |character| {
        match character {
            '(' => depth += 1,
            ')' => depth = depth.saturating_sub(1),
            _ => {}
        }
        character == ',' && depth == 0
    });
    parts.map(str::trim)
}

/// A branch as text, with its port.
type BranchText<'a> = (u8, &'a str);

/// An item without its branches, and each branch with its port.
fn split_branches(word: &str) -> Result<(&str, Vec<BranchText<'_>>), SlaveListError> {
    let wrong = || SlaveListError::Branch { word: word.to_owned() };
    let (mut head, mut texts) = (word, Vec::new());
    while let Some(inside) = head.strip_suffix(')') {
        let mut depth = 1usize;
        let opened = inside.char_indices().rev().find(|(_, character)| {
            match character {
                ')' => depth += 1,
                '(' => depth -= 1,
                _ => {}
            }
            depth == 0
        });
        let (at, _) = opened.ok_or_else(wrong)?;
        texts.push(inside.get(at + 1..).unwrap_or_default());
        head = inside.get(..at).unwrap_or_default().trim_end();
    }
    let mut free = BRANCH_PORTS.into_iter();
    let mut branches = Vec::new();
    for text in texts.into_iter().rev() {
        let (port, line) = match text.split_once(':').filter(|(port, _)| port.parse::<u8>().is_ok()) {
            Some((port, line)) => (port.parse().ok().filter(|port| (1..=3).contains(port)), line),
            None => (free.next(), text),
        };
        branches.push((port.ok_or_else(wrong)?, line));
    }
    Ok((head, branches))
}

/// Whether a word can be a slave's name: letters, digits, `_` and `-`, the first a letter; no word of a kind.
fn is_name(word: &str) -> bool {
    let fits = |letter: char| letter.is_ascii_alphanumeric() || letter == '_' || letter == '-';
    word.starts_with(|letter: char| letter.is_ascii_alphabetic())
        && word.chars().all(fits)
        && SlaveKind::named(word).is_none()
}

/// Parses a list of slaves without settings and branches, in the order of the chain.
///
/// # Errors
/// [`SlaveListError`] with the word that was rejected.
pub fn parse_slaves(list: &str) -> Result<Vec<SlaveKind>, SlaveListError> {
    let list: SlaveList = list.parse()?;
    let named = list.names.iter().any(|name| !name.is_empty());
    let plain = list.branches.is_empty() && !named;
    match plain && list.places.iter().all(|place| *place == PlaceOptions::default()) {
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
        "controller" => {
            let known = ControllerType::NAMES.iter().find(|(name, _)| *name == value);
            place.controller = Some(known?.1);
        }
        "managers" => {
            let (outputs, inputs) = value.split_once('/')?;
            let [outputs, inputs] = [outputs, inputs].map(|word| number(word)?.try_into().ok());
            place.managers = Some(DataManagers::new(outputs?, inputs?)?);
        }
        "range" => {
            place.one_turn = Some(match value {
                "turn" => OneTurn::Told,
                "untold" => OneTurn::Untold,
                _ => return None,
            });
        }
        "password" => place.password = number(value)?.try_into().ok()?,
        "lock" => place.lock_ms = Some(milliseconds()?.try_into().ok()?),
        "boot" => place.processor.boot_ms = milliseconds()?,
        "transition" => place.processor.transition_ms = milliseconds()?,
        "mailbox" => place.processor.mailbox_ms = milliseconds()?,
        "lrw" if value == "no" => place.ignores_lrw = true,
        "units" if value == "pairs" => place.takes_pairs = true,
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
        Ok(Self::Sii(read_file(path, IMAGE_BYTES_MAX)?.into()))
    }

    /// A slave as a slave information file (ESI) describes it; see [`EsiDevice::parse`] for `device`.
    ///
    /// # Errors
    /// The file cannot be read, is longer than 64 MiB, or has no such device.
    pub fn from_description(path: &Path, device: Option<&str>) -> Result<Self, SlaveListError> {
        let bytes = read_file(path, ESI_BYTES_MAX)?;
        let text = String::from_utf8_lossy(&bytes);
        match EsiDevice::parse(text.trim_start_matches('\u{FEFF}'), device) {
            Ok(device) => Ok(Self::Esi(Arc::new(device))),
            Err(error) => Err(failure(path, error.to_string())),
        }
    }
}

fn failure(path: &Path, reason: String) -> SlaveListError {
    SlaveListError::File {
        path: path.display().to_string(),
        reason,
    }
}

fn read_file(path: &Path, bytes_max: u64) -> Result<Vec<u8>, SlaveListError> {
    let length = std::fs::metadata(path)
        .map_err(|error| failure(path, error.to_string()))?
        .len();
    if length > bytes_max {
        return Err(failure(path, format!("{length} bytes are more than {bytes_max}")));
    }
    std::fs::read(path).map_err(|error| failure(path, error.to_string()))
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
        let list: SlaveList =
            "ek1100, cia402@alias=0x12@serial=7@id=5@managers=4/3*2,ax2000 @clock=32@controller=lan9252@boot=500@sii=needed@lrw=no@units=pairs"
                .parse()
                .expect("a list");
        let drive = PlaceOptions {
            alias: 0x12,
            serial: Some(7),
            identification: Some(5),
            managers: DataManagers::new(4, 3),
            ..PlaceOptions::default()
        };
        let mut last = PlaceOptions {
            clock: Some(ClockWidth::Bits32),
            controller: Some(ControllerType::Lan9252),
            ignores_lrw: true,
            takes_pairs: true,
            ..PlaceOptions::default()
        };
        (last.processor.boot_ms, last.processor.reads_sii) = (500, true);
        assert_eq!(list.places, [PlaceOptions::default(), drive, drive, last]);
    }

    #[test]
    fn branches_are_numbered_in_the_order_in_which_frames_pass() {
        let list: SlaveList = "ek1100(2:ax2000),ek1122@name=star(el1004,el1008)(3:el2004),cia402"
            .parse()
            .expect("a tree");
        let kinds: Vec<&str> = list.slaves.iter().map(SlaveKind::name).collect();
        assert_eq!(
            kinds,
            ["ek1100", "ek1122", "el2004", "cia402", "el1004", "el1008", "ax2000"]
        );
        let branch = |slave, behind, port| Branch { slave, behind, port };
        assert_eq!(
            list.branches,
            [branch(3, 2, 3), branch(4, 2, 1), branch(5, 2, 2), branch(7, 1, 2)]
        );
        assert_eq!(list.names[1], "star");
        let line: SlaveList = "ek1100,ek1122(1:el1004)".parse().expect("a line");
        assert_eq!(line.branches, []);
    }

    #[test]
    fn a_branch_needs_a_port_that_is_there_and_free() {
        for word in [
            "el1008(el1004)",
            "ek1122(2:el1004)(2:el1004)",
            "ek1122(4:el1004)",
            "ek1122(el1004",
            "ek1122)",
            "ek1100(3:el1004)",
            "ek1122(ax2000)(ax2000)(ax2000)",
        ] {
            let result = word.parse::<SlaveList>();
            let expected = matches!(result, Err(SlaveListError::Branch { .. } | SlaveListError::Kind { .. }));
            assert!(expected, "{word}: {result:?}");
        }
        let taken = "ek1122(1:el1004),el1008".parse::<SlaveList>();
        assert!(matches!(taken, Err(SlaveListError::Branch { .. })), "{taken:?}");
        let deep = format!("{}ek1122{}", "ek1122(".repeat(300), ")".repeat(300));
        assert_eq!(
            deep.parse::<SlaveList>(),
            Err(SlaveListError::TooMany { limit: SLAVES_MAX })
        );
    }

    #[test]
    fn names_are_words_of_their_own() {
        let names = |list: &str| list.parse::<SlaveList>().map(|list| list.names);
        assert_eq!(
            names("el1008@name=door,el2004"),
            Ok(vec!["door".to_owned(), String::new()])
        );
        let twice = SlaveListError::Name { word: "a".to_owned() };
        assert_eq!(names("el1008@name=a,el2004@name=a"), Err(twice));
        for word in ["name=1", "name=", "name=el1008", "name=a.b"] {
            let setting = SlaveListError::Setting { word: word.to_owned() };
            assert_eq!(names(&format!("el1008@{word}")), Err(setting));
        }
        assert!(matches!(names("el1008@name=a*2"), Err(SlaveListError::Count { .. })));
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
            "controller=et1101",
            "managers=2",
            "managers=2/2",
            "managers=1/3",
            "managers=2/8",
            "range=2",
            "boot=3600001",
            "sii=yes",
            "lrw=yes",
            "units=all",
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
