//! The log of jobs in a folder of its own, and what becomes of its newest entry.

use super::super::episode::Mishap;
use crate::job::history::{HistoryEntry, Record, list};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// Name of the folder while the disk is away.
const AWAY: &str = "away";
/// The drawing of somebody else, which nothing here may touch.
const OTHER: &str = "0123456789abcdef";

/// A log; removed with the value.
pub(super) struct Log {
    /// A folder with the log's.
    around: PathBuf,
    /// What the disk has of the newest entry, whatever happens to its computer.
    synced: Option<(PathBuf, Vec<u8>)>,
    other: HistoryEntry,
    /// Whether the whole log was removed.
    was_removed: bool,
}

impl Log {
    /// A log with somebody else's drawing.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub(super) fn new() -> io::Result<Self> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let around = std::env::temp_dir().join(format!("etherpen-campaign-{}-{number}", std::process::id()));
        match fs::remove_dir_all(&around) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let mut log = Self {
            around,
            synced: None,
            other: HistoryEntry::default(),
            was_removed: false,
        };
        let other = HistoryEntry {
            path_hash: OTHER.to_owned(),
            executed: 5,
            strokes: 1,
            ..HistoryEntry::default()
        };
        log.other = Record::begin(&log.folder(), other)?.entry;
        Ok(log)
    }

    pub(super) fn folder(&self) -> PathBuf {
        self.around.join("jobs")
    }

    /// The newest entry: of the drawing that is drawn here.
    fn newest(&self) -> Option<PathBuf> {
        let files = fs::read_dir(self.folder()).ok()?.flatten().map(|file| file.path());
        files
            .filter(|path| path.extension().is_some_and(|name| name == "json"))
            .max()
    }

    /// Notes that the newest entry has come to the disk.
    pub(super) fn note_synced(&mut self) {
        self.synced = self
            .newest()
            .and_then(|path| Some((path.clone(), fs::read(path).ok()?)));
    }

    /// Lets a mishap come over the files.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub(super) fn suffer(&mut self, mishap: &Mishap) -> io::Result<()> {
        match *mishap {
            Mishap::Removed => {
                (self.was_removed, self.synced) = (true, None);
                absent(fs::remove_dir_all(self.folder()))
            }
            Mishap::Away(_) => self.go_away(),
            Mishap::PowerCut(_) => match &self.synced {
                Some((path, bytes)) if path.exists() => fs::write(path, bytes),
                _ => Ok(()),
            },
            Mishap::KilledWriting(place, _) => {
                let Some((path, mut bytes)) = self.entry() else {
                    return Ok(());
                };
                bytes.truncate(at(place, bytes.len()));
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                fs::write(path.with_file_name(format!(".{name}.1-0.part")), bytes)
            }
            Mishap::Cut(place) => self.change(|bytes| bytes.truncate(at(place, bytes.len()))),
            Mishap::Zeroed(place) => self.change(|bytes| {
                let from = at(place, bytes.len());
                bytes.iter_mut().skip(from).for_each(|byte| *byte = 0);
            }),
            Mishap::Changed(place, bits) => self.change(|bytes| {
                let place = at(place, bytes.len());
                bytes.iter_mut().skip(place).take(1).for_each(|byte| *byte ^= bits);
            }),
            Mishap::Killed(_) | Mishap::Stands(_) => Ok(()),
        }
    }

    fn entry(&self) -> Option<(PathBuf, Vec<u8>)> {
        let path = self.newest()?;
        let is_other = fs::read_to_string(&path).is_ok_and(|text| text.contains(OTHER));
        let bytes = fs::read(&path).ok().filter(|_| !is_other)?;
        Some((path, bytes))
    }

    fn change(&self, damage: impl FnOnce(&mut Vec<u8>)) -> io::Result<()> {
        let Some((path, mut bytes)) = self.entry() else {
            return Ok(());
        };
        damage(&mut bytes);
        fs::write(path, bytes)
    }

    /// The folder cannot be read or written: a file is in its place.
    fn go_away(&self) -> io::Result<()> {
        let away = self.around.join(AWAY);
        if away.exists() {
            return Ok(());
        }
        fs::create_dir_all(self.folder())?;
        fs::rename(self.folder(), away)?;
        fs::write(self.folder(), b"")
    }

    /// The folder is as it was before it went away.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub(super) fn come_back(&self) -> io::Result<()> {
        let away = self.around.join(AWAY);
        if !away.exists() {
            return Ok(());
        }
        absent(fs::remove_file(self.folder()))?;
        fs::rename(away, self.folder())
    }

    /// Whether somebody else's drawing is as it was.
    pub(super) fn has_the_other(&self) -> bool {
        let of_other = |record: &Record| record.entry.path_hash == OTHER && record.entry == self.other;
        self.was_removed || list(&self.folder()).is_ok_and(|records| records.iter().any(of_other))
    }
}

impl Drop for Log {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(Path::new(&self.around));
    }
}

/// The place in an entry of some bytes.
fn at(place: u32, bytes: usize) -> usize {
    (bytes * place as usize / 1_000).min(bytes.saturating_sub(1))
}

/// What is not there need not be removed.
fn absent(result: io::Result<()>) -> io::Result<()> {
    match result {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        other => other,
    }
}
