//! The log of drawings: one small file for each, updated during the drawing, so that an interrupted drawing can be
//! resumed.
//!
//! Under `$XDG_STATE_HOME/etherpen/jobs` (`~/.local/state/etherpen/jobs`). A file is replaced as a whole or not at all.
//! It is synced at its beginning, when the board begins to draw, and at its end; the progress in between is not, so a slow disk causes no
//! delay. Its last line has a
//! hash of the lines before it: a damaged number would let a drawing go on at another place.
//!
//! Invariants: `executed` never exceeds what the firmware has reported; a file with a damaged byte, or a part of one, is not read
//! as another drawing.

use super::progress::Progress;
use crate::error::ProgramError;
use crate::hash::fnv1a;
use crate::output_file::{OutputFile, make_folder, write_bytes};
use image::RgbImage;
use serde::{Deserialize, Serialize};
use std::fs;
use std::io::{self, Cursor, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// What stands between the lines of an entry and their hash, in the place of [`END`], and what follows the hash.
const CHECK: &str = ",\n  \"check\": \"";
const AFTER_CHECK: &str = "\"\n}";
/// The end of an entry's lines.
const END: &str = "\n}";

/// One drawing. An unknown field is refused: it may be one with a damaged name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HistoryEntry {
    /// Start time, s since 1970.
    pub begun_unix_s: u64,
    /// Time of the last update, s since 1970.
    pub changed_unix_s: u64,
    /// The file that was drawn.
    pub file: PathBuf,
    /// Options of the conversion into strokes; null in a log of a program that did not record them.
    #[serde(default)]
    pub options: serde_json::Value,
    /// The port.
    pub port: String,
    /// Board and firmware, once they have answered.
    pub board: String,
    /// Hash of the path, 16 hexadecimal digits.
    pub path_hash: String,
    /// Hash of the configuration, 16 hexadecimal digits.
    pub config_hash: String,
    /// Number under which the path, or its remainder, was sent to the firmware.
    pub number: u16,
    /// Vertices of the path executed before the remainder was sent to the firmware; 0 for a complete path.
    pub given_from: u32,
    /// Vertices executed.
    pub executed: u32,
    /// Vertices before what was not followed: before the first stroke with such a part, or after a stop beside the path before
    /// that part; absent if none is known. A resumed drawing goes on there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub missing_from: Option<u32>,
    /// Vertices of the path.
    pub vertices: u32,
    /// Strokes started; the first counts as started as soon as the board begins to draw.
    pub strokes: u32,
    /// Strokes of the path.
    pub strokes_total: u32,
    /// Length drawn, mm.
    pub pen_down_mm: f64,
    /// Time drawn, s.
    pub drawn_s: f64,
    /// Whether the complete path was executed.
    pub completed: bool,
    /// Result of the drawing; absent while it is being drawn, or if its program was killed.
    pub result: Option<String>,
}

impl HistoryEntry {
    /// Whether it may have drawn anything.
    #[must_use]
    pub fn may_have_ink(&self) -> bool {
        self.completed || self.strokes > 0
    }

    /// Takes the progress along the complete path.
    pub fn progress(&mut self, progress: &Progress) {
        let [executed, complete] =
            [progress.vertices, progress.complete].map(|count| u32::try_from(count).unwrap_or(u32::MAX));
        self.executed = executed;
        self.missing_from = progress.missing_from().map(|_| complete);
        self.strokes = progress.strokes;
        self.pen_down_mm = progress.pen_down_mm;
    }
}

/// A hash in its written form.
#[must_use]
pub fn hash_text(hash: u64) -> String {
    format!("{hash:016x}")
}

/// The file of one drawing.
#[derive(Clone, Debug)]
pub struct Record {
    path: PathBuf,
    /// Content of the file.
    pub entry: HistoryEntry,
}

impl Record {
    /// Creates a drawing's file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn begin(folder: &Path, mut entry: HistoryEntry) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        entry.begun_unix_s = since.as_secs();
        let named = |ms: u128| folder.join(format!("{ms:013}-{}-{}.json", entry.path_hash, std::process::id()));
        let mut ms = since.as_millis();
        // Of two in one millisecond the second counts as of the next one.
        while named(ms).exists() {
            ms += 1;
        }
        let path = named(ms);
        let mut record = Self { path, entry };
        record.save()?;
        Ok(record)
    }

    /// The name of this drawing in the log: what `etherpen jobs` shows and `etherpen draw --resume` takes.
    #[must_use]
    pub fn name(&self) -> String {
        self.path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// Writes the entry to the disk.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&mut self) -> io::Result<()> {
        self.written()?.commit()
    }

    /// Writes the entry without waiting for the disk.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save_unsynced(&mut self) -> io::Result<()> {
        self.written()?.commit_unsynced()
    }

    fn written(&mut self) -> io::Result<OutputFile> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        self.entry.changed_unix_s = now.as_secs();
        // Somebody may have removed it.
        if let Some(folder) = self.path.parent() {
            fs::create_dir_all(folder)?;
        }
        let mut out = OutputFile::create(&self.path)?;
        out.write_all(checked(&serde_json::to_string_pretty(&self.entry)?).as_bytes())?;
        Ok(out)
    }
}

/// The lines of an entry with their hash.
fn checked(lines: &str) -> String {
    let hash = hash_text(fnv1a(lines.bytes()));
    match lines.strip_suffix(END) {
        Some(body) => format!("{body}{CHECK}{hash}{AFTER_CHECK}"),
        None => lines.to_owned(),
    }
}

/// The entry of a file's bytes; `None` if they are damaged. A file of a program that wrote no hash is taken as it is.
fn entry_of(bytes: &[u8]) -> Option<HistoryEntry> {
    let text = std::str::from_utf8(bytes).ok()?;
    let Some((body, _)) = text.rsplit_once(CHECK) else {
        return serde_json::from_str(text).ok();
    };
    let lines = format!("{body}{END}");
    let is_whole = checked(&lines) == text;
    is_whole.then(|| serde_json::from_str(&lines).ok()).flatten()
}

/// The folder of the log.
///
/// # Errors
/// Neither `XDG_STATE_HOME` nor `HOME` is set.
pub fn folder() -> io::Result<PathBuf> {
    let from = |name: &str| {
        std::env::var_os(name)
            .map(PathBuf::from)
            .filter(|path| path.is_absolute())
    };
    let state = from("XDG_STATE_HOME").or_else(|| from("HOME").map(|home| home.join(".local/state")));
    match state {
        Some(state) => Ok(state.join("etherpen/jobs")),
        None => Err(io::Error::new(
            io::ErrorKind::NotFound,
            "neither XDG_STATE_HOME nor HOME is set",
        )),
    }
}

/// Keeps a picture beside the log, so that a drawing of it can be resumed; returns its file.
///
/// # Errors
/// The file cannot be written.
pub fn keep_picture(picture: &RgbImage) -> Result<PathBuf, ProgramError> {
    let unkept = |cause: &dyn std::fmt::Display| ProgramError::failed("the picture cannot be kept", cause);
    let folder = folder().map_err(|cause| unkept(&cause))?;
    make_folder(&folder)?;
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let file = folder.join(format!("camera-{}.png", since.as_millis()));
    let mut png = Cursor::new(Vec::new());
    picture
        .write_to(&mut png, image::ImageFormat::Png)
        .map_err(|cause| unkept(&cause))?;
    write_bytes(&file, png.get_ref())?;
    Ok(file)
}

/// All drawings, the oldest first. Files that cannot be read are left out.
///
/// # Errors
/// The folder cannot be read; a folder that does not exist is an empty log.
pub fn list(folder: &Path) -> io::Result<Vec<Record>> {
    let records = files(folder)?.into_iter().filter_map(|path| {
        let entry = entry_of(&fs::read(&path).ok()?)?;
        Some(Record { path, entry })
    });
    Ok(records.collect())
}

/// The names of the drawings whose files cannot be read or are damaged, the oldest first.
///
/// # Errors
/// The folder cannot be read; a folder that does not exist is an empty log.
pub fn damaged(folder: &Path) -> io::Result<Vec<String>> {
    let mut files = files(folder)?;
    files.retain(|path| fs::read(path).map_or(true, |bytes| entry_of(&bytes).is_none()));
    let name = |path: PathBuf| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    Ok(files.into_iter().map(name).collect())
}

/// The name of the newest damaged drawing of this path, if any.
///
/// # Errors
/// As for [`damaged`].
pub fn newest_damaged(folder: &Path, path_hash: &str) -> io::Result<Option<String>> {
    let of_path = format!("-{path_hash}-");
    Ok(damaged(folder)?.into_iter().rfind(|name| name.contains(&of_path)))
}

/// The files of all drawings, the oldest first; none in a folder that does not exist.
fn files(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let files = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        files => files?,
    };
    let mut paths: Vec<PathBuf> = files.flatten().map(|file| file.path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "json"));
    paths.sort();
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drawing_is_found_again_as_far_as_it_was_written() {
        let folder = std::env::temp_dir().join(format!("etherpen-history-{}", std::process::id()));
        assert!(list(&folder).unwrap().is_empty());
        let entry = HistoryEntry {
            file: "portrait.png".into(),
            path_hash: hash_text(0xab),
            vertices: 100,
            ..HistoryEntry::default()
        };
        let mut record = Record::begin(&folder, entry).unwrap();
        record.entry.progress(&Progress {
            vertices: 40,
            ..Progress::default()
        });
        record.save().unwrap();
        fs::write(folder.join("0-damaged.json"), "{").unwrap();
        let found = list(&folder).unwrap();
        fs::remove_dir_all(&folder).unwrap();
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].entry, record.entry);
        assert_eq!((found[0].entry.executed, found[0].entry.completed), (40, false));
        assert_eq!(found[0].entry.path_hash, "00000000000000ab");
    }
}
