//! Resumes an interrupted drawing: from what the firmware holds, or else from the log.

use super::history::{self, HistoryEntry, Record, hash_text};
use super::progress::PathMeasure;
use super::remainder::{OVERLAP_UM, Remainder};
use super::{DrawTask, path_hash};
use crate::error::{ProgramError, code};
use crate::link::port::PortName;
use crate::link::text;
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::link::message::PathAck;
use etherpen::messages::{PathVertex, Status, Welcome};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io;
use std::path::{Path, PathBuf};

/// What a machine reports before a drawing is resumed.
#[derive(Clone, Debug, Default)]
pub struct MachineState {
    /// The firmware.
    pub welcome: Option<Welcome>,
    /// Its last status.
    pub status: Option<Status>,
    /// State of the path that it holds, if any.
    pub path: Option<PathAck>,
}

/// The path to send to the machine, and its relation to the complete path.
pub struct ResumePlan {
    /// The path to send to the machine.
    pub drawing: DrawTask,
    /// The entry of the log, if any.
    pub record: Option<Record>,
    /// Time drawn earlier, s.
    pub drawn_before_s: f64,
    /// From where it goes on, in words; empty for the complete path.
    pub notice: String,
    /// The remainder that is drawn, and the vertices executed before; `None` for the complete path.
    part: Option<(Remainder, usize)>,
}

impl ResumePlan {
    /// The complete path.
    pub fn whole(path: &[PathVertex], record: Option<Record>) -> Self {
        Self {
            drawing: DrawTask::new(path),
            record,
            drawn_before_s: 0.0,
            notice: String::new(),
            part: None,
        }
    }

    /// Executed vertices of the complete path, given the executed vertices of this drawing.
    pub fn executed(&self, executed: usize) -> usize {
        match &self.part {
            Some((remainder, before)) => remainder.executed(executed, *before),
            None => executed,
        }
    }
}

/// Creates the entry of a drawing in the job log. `options` are those of the conversion of `file` into `path`.
///
/// # Errors
/// The log cannot be written.
pub fn begin_record(
    file: &Path,
    options: &impl Serialize,
    port: &PortName,
    config: &Config,
    path: &[PathVertex],
) -> io::Result<Record> {
    begin_record_in(&history::folder()?, file, options, port, config, path)
}

/// Creates the entry of a drawing in a log.
///
/// # Errors
/// As for [`begin_record`].
pub fn begin_record_in(
    folder: &Path,
    file: &Path,
    options: &impl Serialize,
    port: &PortName,
    config: &Config,
    path: &[PathVertex],
) -> io::Result<Record> {
    let total = PathMeasure::new(path, config).progress(0, 0, 0.0);
    let entry = HistoryEntry {
        file: std::fs::canonicalize(file).unwrap_or_else(|_| file.to_owned()),
        // Options that cannot be recorded have to be given again.
        options: serde_json::to_value(options).unwrap_or_default(),
        port: port.to_string(),
        path_hash: hash_text(path_hash(path)),
        config_hash: config_hash(config),
        vertices: u32::try_from(path.len()).unwrap_or(u32::MAX),
        strokes_total: total.strokes_total,
        ..HistoryEntry::default()
    };
    Record::begin(folder, entry)
}

/// What to resume.
pub enum Resumption {
    /// The last drawing of this file.
    Last(PathBuf),
    /// This job of the log.
    Job(Box<Record>),
}

impl Resumption {
    /// The file that was drawn.
    pub fn file(&self) -> &Path {
        match self {
            Self::Last(file) => file,
            Self::Job(record) => &record.entry.file,
        }
    }

    /// Recorded options of the conversion of that file into strokes; `None` unless a job was named.
    ///
    /// The options cannot be used, for instance because a font that they name no longer exists.
    pub fn source<Options: DeserializeOwned>(&self) -> Result<Option<Options>, ProgramError> {
        let Self::Job(record) = self else { return Ok(None) };
        serde_json::from_value(record.entry.options.clone()).map_err(|cause| {
            let text = format!(
                "the options of job {} cannot be used again: {cause}; name file and options beside --resume",
                record.name()
            );
            ProgramError::new(code::INPUT, text)
        })
    }

    /// The jobs of this path that can be resumed. The first is the one to resume, unless the firmware holds another
    /// one.
    ///
    /// # Errors
    /// There is none.
    pub fn candidates(&self, hash: &str, file: &Path) -> Result<Vec<Record>, ProgramError> {
        match self {
            Self::Last(_) => last_in(&history::folder().map_err(unreadable)?, hash, file),
            Self::Job(record) if record.entry.path_hash != hash => Err(other_path(file, record, hash)),
            Self::Job(record) if record.entry.completed => Err(complete(&record.name())),
            Self::Job(record) => Ok(vec![Record::clone(record)]),
        }
    }
}

fn unreadable(cause: io::Error) -> ProgramError {
    ProgramError::failed("the log of jobs cannot be read", cause)
}

/// The jobs of this path in a log, of which the first is the one to resume unless the firmware holds another one.
///
/// # Errors
/// There is none, or one behind it is damaged: nobody knows what that one has drawn, and on which sheet.
pub fn last_in(folder: &Path, hash: &str, file: &Path) -> Result<Vec<Record>, ProgramError> {
    let records = history::list(folder).map_err(unreadable)?;
    let damaged = history::newest_damaged(folder, hash).map_err(unreadable)?;
    let found = candidates(&records, hash, file);
    // An entry without ink says nothing about the sheet.
    let is_older = |name: &String| {
        let newest = found
            .as_ref()
            .ok()
            .and_then(|found| found.iter().find(|record| has_ink(record)));
        newest.is_some_and(|record| record.name() > *name)
    };
    match damaged.filter(|name| !is_older(name)) {
        None => found,
        Some(name) => Err(damaged_entry(&name)),
    }
}

fn damaged_entry(name: &str) -> ProgramError {
    let text = format!(
        "the entry {name} of this drawing in the log of jobs is damaged: it does not tell how far the drawing came; \
         draw it from the beginning without --resume, or name another job (etherpen jobs lists them)"
    );
    ProgramError::new(code::INPUT, text)
}

/// The logged job with this name, or the only one whose name starts with it.
///
/// # Errors
/// There is none, or several, or it is damaged.
pub fn named(name: &str) -> Result<Record, ProgramError> {
    named_in(&history::folder().map_err(unreadable)?, name)
}

/// The job of a log with this name.
pub(super) fn named_in(folder: &Path, name: &str) -> Result<Record, ProgramError> {
    let mut found = history::list(folder).map_err(unreadable)?;
    let mut damaged = history::damaged(folder).map_err(unreadable)?;
    found.retain(|record| record.name().starts_with(name));
    damaged.retain(|damaged| damaged.starts_with(name));
    if let Some(exact) = found.iter().position(|record| record.name() == name) {
        return Ok(found.swap_remove(exact));
    }
    if let Some(exact) = damaged.iter().find(|damaged| *damaged == name) {
        return Err(damaged_entry(exact));
    }
    match (found.as_slice(), damaged.as_slice()) {
        ([record], []) => Ok(record.clone()),
        ([], [damaged]) => Err(damaged_entry(damaged)),
        (found, damaged) => {
            let known = match found.len() + damaged.len() {
                0 => "no job".to_owned(),
                several => format!("{several} jobs"),
            };
            let text = format!("the log has {known} of the name {name}; etherpen jobs lists them");
            Err(ProgramError::new(code::INPUT, text))
        }
    }
}

/// Where a drawing of several parts goes on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LastPart {
    /// Index of the first part that is left to draw.
    pub index: usize,
    /// Whether that part was not begun: the part before was drawn to its end.
    pub is_next: bool,
}

/// Where a drawing goes on whose parts, in the order of drawing, have paths with these hashes.
///
/// # Errors
/// The log cannot be read, knows none of the parts, or knows the last part as drawn to its end.
pub fn last_part(hashes: &[String], file: &Path) -> Result<LastPart, ProgramError> {
    let folder = history::folder().map_err(unreadable)?;
    last_part_in(&folder, hashes, file)
}

/// Where a drawing of several parts goes on, by a log.
pub(super) fn last_part_in(folder: &Path, hashes: &[String], file: &Path) -> Result<LastPart, ProgramError> {
    let records = history::list(folder).map_err(unreadable)?;
    let is_part = |record: &&Record| hashes.contains(&record.entry.path_hash) && has_ink(record);
    let newest = records.iter().rev().find(is_part);
    for hash in hashes {
        let damaged = history::newest_damaged(folder, hash).map_err(unreadable)?;
        if let Some(name) = damaged.filter(|name| newest.is_none_or(|record| record.name() < *name)) {
            return Err(damaged_entry(&name));
        }
    }
    part_left(&records, hashes, file)
}

/// Whether a job may have drawn anything.
fn has_ink(record: &Record) -> bool {
    record.entry.may_have_ink()
}

fn part_left(records: &[Record], hashes: &[String], file: &Path) -> Result<LastPart, ProgramError> {
    let with_ink = records.iter().rev().filter(|record| has_ink(record));
    let mut parts = with_ink.filter_map(|record| {
        let index = hashes.iter().position(|hash| *hash == record.entry.path_hash)?;
        Some((index, record.entry.completed))
    });
    match parts.next() {
        Some((index, true)) if index + 1 == hashes.len() => Err(complete(&file.display().to_string())),
        Some((index, true)) => Ok(LastPart {
            index: index + 1,
            is_next: true,
        }),
        Some((index, false)) => Ok(LastPart { index, is_next: false }),
        None => {
            let text = format!(
                "the log of jobs knows no layer of {} with these options (etherpen jobs lists them); draw it without \
                 --resume",
                file.display()
            );
            Err(ProgramError::new(code::INPUT, text))
        }
    }
}

fn complete(what: &str) -> ProgramError {
    let text = format!("{what} was drawn to its end; nothing is left to draw");
    ProgramError::new(code::INPUT, text)
}

/// Jobs of this path: the newest that drew something, then newer ones without a stroke, of which the firmware may hold
/// more than the log shows. If nothing was drawn yet, a job without a stroke comes first.
fn candidates(records: &[Record], hash: &str, file: &Path) -> Result<Vec<Record>, ProgramError> {
    let of_path: Vec<&Record> = records
        .iter()
        .rev()
        .filter(|record| record.entry.path_hash == hash)
        .collect();
    let drawn = of_path.iter().position(|record| has_ink(record));
    let (without_ink, with_ink) = of_path.split_at(drawn.unwrap_or(of_path.len()));
    match with_ink.first() {
        Some(newest) if newest.entry.completed && without_ink.is_empty() => {
            return Err(complete(&file.display().to_string()));
        }
        None if without_ink.is_empty() => {}
        newest => {
            return Ok(newest
                .into_iter()
                .chain(without_ink)
                .map(|record| (*record).clone())
                .collect());
        }
    }
    let same_file = std::fs::canonicalize(file).unwrap_or_else(|_| file.to_owned());
    let unfinished = |record: &&Record| record.entry.file == same_file && !record.entry.completed;
    Err(match records.iter().rev().find(unfinished) {
        Some(other) => other_path(file, other, hash),
        None => {
            let text = format!(
                "the log of jobs knows no unfinished drawing of {} (etherpen jobs lists them); draw it without --resume",
                file.display()
            );
            ProgramError::new(code::INPUT, text)
        }
    })
}

fn other_path(file: &Path, record: &Record, hash: &str) -> ProgramError {
    let text = format!(
        "{} was drawn with another path in job {} (hash {}, this one has {hash}): the file, the options or the paper and \
         motion in the configuration have changed; draw it with the same, or from the beginning without --resume",
        file.display(),
        record.name(),
        record.entry.path_hash
    );
    ProgramError::new(code::INPUT, text)
}

/// Checks what the machine still holds of a drawing, and plans how to resume it.
///
/// # Errors
/// This is not the machine that drew, or it is busy with something else.
pub fn plan(
    candidates: Vec<Record>,
    machine: &MachineState,
    config: &Config,
    path: &[PathVertex],
) -> Result<ResumePlan, ProgramError> {
    let record = chosen(candidates, machine)?;
    check_board(&record, machine)?;
    let mode = machine.status.as_ref().map(|status| status.mode);
    let held = machine.path.filter(|ack| ack.job == record.entry.number);
    match (held, mode) {
        (Some(ack), Some(Mode::Holding | Mode::Drawing)) => from_firmware(record, &ack, config, path),
        (_, Some(mode @ (Mode::Holding | Mode::Drawing | Mode::Moving))) => {
            let text = format!(
                "the machine is busy with something else: {}; end that first (etherpen cancel)",
                text::mode(mode)
            );
            Err(ProgramError::new(code::FAILED, text))
        }
        _ => from_log(record, config, path),
    }
}

/// The remainder of a path after `executed` vertices.
fn rest_after(executed: u32, config: &Config, path: &[PathVertex]) -> Remainder {
    let lift_um = (config.paper.pen_lift_mm * 1_000.0).round() as i32;
    Remainder::new(path, executed as usize, OVERLAP_UM, lift_um)
}

/// Resumes from what the firmware holds.
fn from_firmware(
    record: Record,
    ack: &PathAck,
    config: &Config,
    path: &[PathVertex],
) -> Result<ResumePlan, ProgramError> {
    check_config(&record, config)?;
    let entry = &record.entry;
    if let Some(missing_from) = entry.missing_from {
        let stroke = path.get(missing_from as usize).map_or(0, |vertex| vertex.stroke);
        let text = format!(
            "stroke {} of this drawing was not followed all the way; end what the firmware still holds (etherpen cancel), \
             then --resume draws again what is missing",
            stroke.saturating_add(1)
        );
        return Err(ProgramError::new(code::FAILED, text));
    }
    let rest = || (rest_after(entry.given_from, config, path), entry.given_from as usize);
    let given = (entry.given_from > 0).then(rest);
    let vertices = given
        .as_ref()
        .map_or(path, |(remainder, _)| remainder.vertices.as_slice());
    let mut notice = format!(
        "the firmware still holds this drawing, {} of {} vertices executed: going on exactly there",
        ack.executed,
        vertices.len()
    );
    if !entry.may_have_ink() && ack.executed > 0 {
        // All drawings of a path have one number: this may be one before the one that the log has.
        notice += ". The log has not seen it begin: if the sheet is empty, it began on another one; then end it (etherpen \
                   cancel) and draw the file again";
    }
    let drawing = DrawTask {
        held: true,
        number: entry.number,
        ..DrawTask::new(vertices)
    };
    Ok(ResumePlan {
        drawing,
        drawn_before_s: entry.drawn_s,
        notice,
        part: given,
        record: Some(record),
    })
}

/// Resumes from the last corner recorded in the log.
fn from_log(mut record: Record, config: &Config, path: &[PathVertex]) -> Result<ResumePlan, ProgramError> {
    let missing_from = record.entry.missing_from.take();
    let executed = missing_from.map_or(record.entry.executed, |vertices| vertices.min(record.entry.executed));
    // An attempt that ends before it draws leaves the log so.
    record.entry.executed = executed;
    let remainder = rest_after(executed, config, path);
    let Some(next) = remainder.vertices.first() else {
        record.entry.completed = true;
        // If this cannot be written, the next attempt gives the same result.
        let _ = record.save();
        let text = "all strokes of this drawing were drawn; nothing is left to draw";
        return Err(ProgramError::new(code::INPUT, text));
    };
    let mut notice = format!(
        "the firmware no longer holds this drawing: continuing from the log at stroke {} of {}, from the last \
         corner that the log knows; what was drawn beyond it, and {:.0} mm before it, are drawn again",
        next.stroke.saturating_add(1),
        record.entry.strokes_total,
        OVERLAP_UM / 1_000.0
    );
    if let Err(changed) = check_config(&record, config) {
        notice = format!("{notice}\n{changed}: the rest may not meet the ink exactly");
        record.entry.config_hash = config_hash(config);
    }
    record.entry.given_from = executed;
    let drawn_before_s = record.entry.drawn_s;
    if executed == 0 {
        return Ok(ResumePlan {
            drawn_before_s,
            notice,
            ..ResumePlan::whole(path, Some(record))
        });
    }
    Ok(ResumePlan {
        drawing: DrawTask {
            may_reference: false,
            ..DrawTask::new(remainder.vertices.clone())
        },
        drawn_before_s,
        notice,
        part: Some((remainder, executed as usize)),
        record: Some(record),
    })
}

/// The job that the firmware holds, or else the first.
///
/// # Errors
/// That job was drawn to its end.
fn chosen(mut candidates: Vec<Record>, machine: &MachineState) -> Result<Record, ProgramError> {
    let mode = machine.status.as_ref().map(|status| status.mode);
    let held = matches!(mode, Some(Mode::Holding | Mode::Drawing))
        .then_some(machine.path)
        .flatten();
    // Jobs of one path have one number: the firmware has the newest of them.
    let of_job = |ack: PathAck| {
        let same = |record: &Record| !record.entry.completed && record.entry.number == ack.job;
        let held = (0..candidates.len()).filter(|&index| same(&candidates[index]));
        held.max_by_key(|&index| candidates[index].name())
    };
    let held = held.and_then(of_job);
    if candidates.is_empty() {
        return Err(ProgramError::new(code::INPUT, "nothing is left to draw"));
    }
    let chosen = candidates.swap_remove(held.unwrap_or(0));
    match chosen.entry.completed {
        true => Err(complete(&chosen.entry.file.display().to_string())),
        false => Ok(chosen),
    }
}

/// Checks that this is the machine on which the drawing was started.
fn check_board(record: &Record, machine: &MachineState) -> Result<(), ProgramError> {
    let begun_on = &record.entry.board;
    let welcome = machine.welcome.as_ref();
    let board = welcome.map_or_else(String::new, |welcome| format!("{} {}", welcome.board, welcome.firmware));
    if begun_on.is_empty() || *begun_on == board {
        return Ok(());
    }
    let text = format!(
        "this drawing was started on {begun_on}, and this machine is {board}; continue it there, or draw it from the beginning"
    );
    Err(ProgramError::new(code::FAILED, text))
}

/// Checks that this is the configuration with which the drawing was started.
fn check_config(record: &Record, config: &Config) -> Result<(), ConfigChanged> {
    let (then, now) = (record.entry.config_hash.clone(), config_hash(config));
    if then == now {
        Ok(())
    } else {
        Err(ConfigChanged { then, now })
    }
}

/// The hash of a configuration as written in the log.
pub fn config_hash(config: &Config) -> String {
    config.hash().map(hash_text).unwrap_or_default()
}

/// Hashes of two configurations that differ.
struct ConfigChanged {
    then: String,
    now: String,
}

impl std::fmt::Display for ConfigChanged {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { then, now } = self;
        write!(
            f,
            "this drawing was begun with another configuration (hash {then}, this one has {now})"
        )
    }
}

impl From<ConfigChanged> for ProgramError {
    fn from(changed: ConfigChanged) -> Self {
        let text =
            format!("{changed}; continue with that one (--config), or end the drawing that is held: etherpen cancel");
        Self::new(code::USAGE, text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU32, Ordering};

    /// The log's jobs of one path, the oldest first: strokes started, and whether the job was completed.
    fn log(jobs: &[(u32, bool)]) -> Vec<Record> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("etherpen-resume-{}-{number}", std::process::id()));
        let of = |(number, (strokes, completed)): (u16, &(u32, bool))| {
            let entry = HistoryEntry {
                path_hash: "ab".into(),
                number,
                strokes: *strokes,
                executed: 10 * strokes,
                completed: *completed,
                ..HistoryEntry::default()
            };
            Record::begin(&folder, entry).expect("a log")
        };
        let records = (1..).zip(jobs).map(of).collect();
        // An empty log has no folder.
        let _ = std::fs::remove_dir_all(&folder);
        records
    }

    fn numbers(jobs: &[(u32, bool)]) -> Result<Vec<u16>, ProgramError> {
        let found = candidates(&log(jobs), "ab", Path::new("portrait.png"))?;
        Ok(found.iter().map(|record| record.entry.number).collect())
    }

    #[test]
    fn a_job_without_a_stroke_never_shadows_one_with_strokes() {
        assert_eq!(numbers(&[(3, false), (57, false)]).unwrap(), [2]);
        assert_eq!(numbers(&[(57, false), (0, false), (0, false)]).unwrap(), [1, 3, 2]);
        assert_eq!(numbers(&[(0, false), (0, false)]).unwrap(), [2, 1]);
        let drawn = numbers(&[(57, false), (163, true)]).unwrap_err();
        assert!(drawn.message.contains("drawn to its end"), "{}", drawn.message);
        let again = candidates(&log(&[(163, true), (0, false)]), "ab", Path::new("portrait.png")).unwrap();
        let refused = chosen(again, &MachineState::default()).unwrap_err();
        assert!(refused.message.contains("drawn to its end"), "{}", refused.message);
        assert!(numbers(&[]).unwrap_err().message.contains("no unfinished drawing"));
    }

    #[test]
    fn a_drawing_of_several_parts_goes_on_with_the_first_that_is_left() {
        let of = |parts: &[(&str, u32, bool)]| {
            let jobs: Vec<_> = parts
                .iter()
                .map(|(_, strokes, completed)| (*strokes, *completed))
                .collect();
            let mut records = log(&jobs);
            for (record, (hash, ..)) in records.iter_mut().zip(parts) {
                record.entry.path_hash = (*hash).to_owned();
            }
            let hashes = ["red", "green", "blue"].map(str::to_owned);
            let left = part_left(&records, &hashes, Path::new("flag.svg"));
            left.map(|left| (left.index, left.is_next))
                .map_err(|error| error.message)
        };
        assert_eq!(of(&[("red", 9, true)]), Ok((1, true)));
        assert_eq!(of(&[("red", 9, true), ("green", 0, false)]), Ok((1, true)));
        assert_eq!(
            of(&[("red", 9, true), ("green", 3, false), ("other", 5, true)]),
            Ok((1, false))
        );
        assert_eq!(
            of(&[("blue", 4, true), ("red", 2, false)]),
            Ok((0, false)),
            "a second drawing"
        );
        assert!(of(&[("red", 9, true), ("blue", 4, true)]).is_err_and(|why| why.contains("to its end")));
        assert!(of(&[("other", 9, true)]).is_err_and(|why| why.contains("without --resume")));
    }

    #[test]
    fn a_stroke_that_was_not_followed_is_drawn_again_and_never_passed_by_with_what_the_firmware_holds() {
        let (path, config) = (crate::link::rig::path(100), Config::default());
        let mut record = log(&[(8, false)]).remove(0);
        (record.entry.executed, record.entry.vertices) = (80, 100);
        record.entry.config_hash = config_hash(&config);
        let machine = |mode| MachineState {
            status: Some(crate::console::status::tests::status(mode, None)),
            path: Some(PathAck {
                job: 1,
                executed: 85,
                ..PathAck::default()
            }),
            ..MachineState::default()
        };
        let held = plan(vec![record.clone()], &machine(Mode::Holding), &config, &path).unwrap();
        assert!(held.drawing.held);
        assert!(!held.notice.contains("sheet is empty"), "{}", held.notice);
        let mut unseen = record.clone();
        unseen.entry.strokes = 0;
        let other_sheet = plan(vec![unseen], &machine(Mode::Holding), &config, &path).unwrap();
        assert!(other_sheet.notice.contains("sheet is empty"), "{}", other_sheet.notice);
        record.entry.missing_from = Some(30);
        let refused = plan(vec![record.clone()], &machine(Mode::Holding), &config, &path);
        let refused = refused.err().expect("stroke is missing");
        assert!(refused.message.contains("etherpen cancel"), "{}", refused.message);
        let again = plan(vec![record.clone()], &machine(Mode::DrivesOff), &config, &path).unwrap();
        let entry = again.record.as_ref().map(|record| &record.entry).unwrap();
        assert_eq!((entry.given_from, entry.executed, entry.missing_from), (30, 30, None));
        record.entry.missing_from = None;
        let rest = plan(vec![record], &machine(Mode::DrivesOff), &config, &path).unwrap();
        assert!(again.drawing.vertices.len() > rest.drawing.vertices.len() + 45);
        assert_eq!((again.executed(0), rest.executed(0)), (30, 80));
    }

    #[test]
    fn what_the_firmware_holds_goes_on_before_everything_else() {
        let of_log = candidates(&log(&[(57, false), (0, false)]), "ab", Path::new("portrait.png")).unwrap();
        let mut status = crate::console::status::tests::status(Mode::Holding, None);
        let path = |job| PathAck {
            job,
            ..Default::default()
        };
        let mut machine = MachineState {
            status: Some(status.clone()),
            path: Some(path(2)),
            ..MachineState::default()
        };
        assert_eq!(chosen(of_log.clone(), &machine).unwrap().entry.number, 2);
        machine.path = Some(path(9));
        assert_eq!(chosen(of_log.clone(), &machine).unwrap().entry.number, 1);
        machine.path = Some(path(2));
        let again = candidates(&log(&[(163, true), (0, false)]), "ab", Path::new("portrait.png")).unwrap();
        assert_eq!(chosen(again, &machine).unwrap().entry.number, 2, "begun a second time");
        status.mode = Mode::DrivesOff;
        (machine.status, machine.path) = (Some(status), Some(path(2)));
        assert_eq!(chosen(of_log, &machine).unwrap().entry.number, 1);
    }
}
