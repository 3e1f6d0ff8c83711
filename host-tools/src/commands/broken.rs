//! Resumes an interrupted drawing: from what the firmware holds, or else from the log.

use super::source::SourceArguments;
use super::{CommandError, code};
use crate::history::{self, Record, hash_text};
use crate::link::job::Drawing;
use crate::link::remainder::{OVERLAP_UM, Remainder};
use crate::link::text;
use crate::machine::{Machine, Snapshot};
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::link::protocol::{PathAck, PathVertex};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Longest wait for the machine's state; the link's own time limit is shorter.
const STATE_MAX: Duration = Duration::from_secs(10);
/// Longest wait for the path state of a firmware that holds a drawing.
const PATH_MAX: Duration = Duration::from_millis(500);
/// Time between two checks.
const LOOK: Duration = Duration::from_millis(10);

/// What is given to the machine, and what it means for the whole path.
pub(super) struct Plan {
    pub(super) drawing: Drawing,
    pub(super) record: Option<Record>,
    /// Time that was drawn before, s.
    pub(super) drawn_before_s: f64,
    /// What the drawing is a part of; absent for the whole.
    part: Option<(Remainder, usize)>,
}

impl Plan {
    /// The whole path.
    pub(super) fn whole(path: &[PathVertex], record: Option<Record>) -> Self {
        Self {
            drawing: Drawing::new(path),
            record,
            drawn_before_s: 0.0,
            part: None,
        }
    }

    /// Vertices of the whole path that are executed when so many of this drawing are.
    pub(super) fn executed(&self, executed: usize) -> usize {
        match &self.part {
            Some((remainder, before)) => remainder.executed(executed, *before),
            None => executed,
        }
    }
}

/// What is to go on.
pub(super) enum Resumption {
    /// The last drawing of this file.
    Last(PathBuf),
    /// This job of the log.
    Job(Box<Record>),
}

impl Resumption {
    /// The file that was drawn.
    pub(super) fn file(&self) -> &Path {
        match self {
            Self::Last(file) => file,
            Self::Job(record) => &record.entry.file,
        }
    }

    /// How that file became strokes, where a job was named that noted it.
    ///
    /// # Errors
    /// A file that it names, a font for instance, is not there any more.
    pub(super) fn source(&self) -> Result<Option<SourceArguments>, CommandError> {
        let Self::Job(record) = self else { return Ok(None) };
        serde_json::from_value(record.entry.options.clone()).map_err(|cause| {
            let text = format!(
                "the options of job {} cannot be used again: {cause}; name file and options beside --resume",
                record.name()
            );
            CommandError::new(code::INPUT, text)
        })
    }

    /// The jobs of this path that may go on. The first is the one to take up, unless the firmware holds another one.
    ///
    /// # Errors
    /// There is none.
    pub(super) fn candidates(&self, hash: &str, file: &Path) -> Result<Vec<Record>, CommandError> {
        match self {
            Self::Last(_) => candidates(&records()?, hash, file),
            Self::Job(record) if record.entry.path_hash != hash => Err(other_path(file, record, hash)),
            Self::Job(record) if record.entry.completed => Err(complete(&record.name())),
            Self::Job(record) => Ok(vec![Record::clone(record)]),
        }
    }
}

fn records() -> Result<Vec<Record>, CommandError> {
    history::folder()
        .and_then(|folder| history::list(&folder))
        .map_err(|cause| CommandError::failed("the log of jobs cannot be read", cause))
}

/// The job of the log with this name, or the only one whose name begins so.
///
/// # Errors
/// There is none, or several.
pub(super) fn named(name: &str) -> Result<Record, CommandError> {
    let mut found = records()?;
    found.retain(|record| record.name().starts_with(name));
    if let Some(exact) = found.iter().position(|record| record.name() == name) {
        return Ok(found.swap_remove(exact));
    }
    match found.as_slice() {
        [record] => Ok(record.clone()),
        found => {
            let known = match found.len() {
                0 => "no job".to_owned(),
                several => format!("{several} jobs"),
            };
            let text = format!("the log has {known} of the name {name}; etherpen jobs lists them");
            Err(CommandError::new(code::INPUT, text))
        }
    }
}

fn complete(what: &str) -> CommandError {
    let text = format!("{what} was drawn to its end; there is nothing to go on with");
    CommandError::new(code::INPUT, text)
}

/// Jobs of this path: the newest that drew something, then newer ones without a stroke, of which the firmware may hold
/// more than the log knows. If nothing was drawn yet, a job without a stroke comes first.
fn candidates(records: &[Record], hash: &str, file: &Path) -> Result<Vec<Record>, CommandError> {
    let of_path: Vec<&Record> = records
        .iter()
        .rev()
        .filter(|record| record.entry.path_hash == hash)
        .collect();
    let drawn = of_path
        .iter()
        .position(|record| record.entry.completed || record.entry.strokes > 0);
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
            CommandError::new(code::INPUT, text)
        }
    })
}

fn other_path(file: &Path, record: &Record, hash: &str) -> CommandError {
    let text = format!(
        "{} was drawn with another path in job {} (hash {}, this one has {hash}): the file, the options or the paper and \
         motion in the configuration have changed; draw it with the same, or from the beginning without --resume",
        file.display(),
        record.name(),
        record.entry.path_hash
    );
    CommandError::new(code::INPUT, text)
}
/// Looks what the machine still has of a drawing, and says how it goes on.
///
/// # Errors
/// There is no connection, or this is not the machine that drew.
pub(super) fn plan(
    candidates: Vec<Record>,
    machine: &Machine,
    config: &Config,
    path: &[PathVertex],
) -> Result<Plan, CommandError> {
    let snapshot = state(machine)?;
    let mut record = chosen(candidates, &snapshot)?;
    check_board(&record, &snapshot)?;
    let entry = &record.entry;
    let lift_um = (config.paper.pen_lift_mm * 1_000.0).round() as i32;
    let rest_after = |executed: u32| Remainder::new(path, executed as usize, OVERLAP_UM, lift_um);
    let given = (entry.given_from > 0).then(|| (rest_after(entry.given_from), entry.given_from as usize));
    let mode = snapshot.status.as_ref().map(|status| status.mode);
    let held = snapshot.path.filter(|ack| ack.job == entry.number);
    if let (Some(ack), Some(Mode::Holding | Mode::Drawing)) = (held, mode) {
        check_config(&record, config)?;
        let vertices = given
            .as_ref()
            .map_or(path, |(remainder, _)| remainder.vertices.as_slice());
        eprintln!(
            "the firmware still holds this drawing, {} of {} vertices executed: going on exactly there",
            ack.executed,
            vertices.len()
        );
        let drawing = Drawing {
            held: true,
            number: entry.number,
            ..Drawing::new(vertices)
        };
        return Ok(Plan {
            drawing,
            drawn_before_s: entry.drawn_s,
            part: given,
            record: Some(record),
        });
    }
    if let Some(mode @ (Mode::Holding | Mode::Drawing | Mode::Moving)) = mode {
        let text = format!(
            "the machine is busy with something else: {}; end that first (etherpen cancel)",
            text::mode(mode)
        );
        return Err(CommandError::new(code::FAILED, text));
    }
    let executed = entry.executed;
    let remainder = rest_after(executed);
    let Some(next) = remainder.vertices.first() else {
        record.entry.completed = true;
        // A log that cannot be written says the same the next time.
        let _ = record.save();
        let text = "all strokes of this drawing were drawn; there is nothing to go on with";
        return Err(CommandError::new(code::INPUT, text));
    };
    eprintln!(
        "the firmware does not hold this drawing any more: going on from the log at stroke {} of {}, from the last \
         corner that the log knows; what was drawn beyond it, and {:.0} mm before it, are drawn again",
        next.stroke.saturating_add(1),
        entry.strokes_total,
        OVERLAP_UM / 1_000.0
    );
    if let Err(changed) = check_config(&record, config) {
        eprintln!("{changed}: the rest may not meet the ink exactly");
        record.entry.config_hash = config_hash(config);
    }
    record.entry.given_from = executed;
    let drawn_before_s = record.entry.drawn_s;
    if executed == 0 {
        return Ok(Plan {
            drawn_before_s,
            ..Plan::whole(path, Some(record))
        });
    }
    Ok(Plan {
        drawing: Drawing {
            may_reference: false,
            ..Drawing::new(remainder.vertices.clone())
        },
        drawn_before_s,
        part: Some((remainder, executed as usize)),
        record: Some(record),
    })
}

/// The job that the firmware holds; else the first.
///
/// # Errors
/// That job was drawn to its end.
fn chosen(mut candidates: Vec<Record>, snapshot: &Snapshot) -> Result<Record, CommandError> {
    let mode = snapshot.status.as_ref().map(|status| status.mode);
    let held = matches!(mode, Some(Mode::Holding | Mode::Drawing))
        .then_some(snapshot.path)
        .flatten();
    // Jobs of one path have one number: the firmware has the newest of them.
    let of_job = |ack: PathAck| {
        let same = |record: &Record| !record.entry.completed && record.entry.number == ack.job;
        let held = (0..candidates.len()).filter(|&index| same(&candidates[index]));
        held.max_by_key(|&index| candidates[index].name())
    };
    let held = held.and_then(of_job);
    if candidates.is_empty() {
        return Err(CommandError::new(code::INPUT, "there is nothing to go on with"));
    }
    let chosen = candidates.swap_remove(held.unwrap_or(0));
    match chosen.entry.completed {
        true => Err(complete(&chosen.entry.file.display().to_string())),
        false => Ok(chosen),
    }
}

/// Where the machine stands, and what it says of the path that it has.
///
/// # Errors
/// There is no connection, or the machine does not answer.
pub(super) fn state(machine: &Machine) -> Result<Snapshot, CommandError> {
    let until = Instant::now() + STATE_MAX;
    let mut known_since = None;
    loop {
        let snapshot = machine.snapshot();
        if let Some(lost) = snapshot.lost {
            return Err(lost.into());
        }
        if snapshot.status.is_some() && snapshot.phase.is_none() {
            let since = *known_since.get_or_insert_with(Instant::now);
            if snapshot.path.is_some() || since.elapsed() > PATH_MAX {
                return Ok(snapshot);
            }
        }
        if Instant::now() > until {
            return Err(CommandError::new(
                code::CONNECTION,
                "the machine does not say where it stands",
            ));
        }
        std::thread::sleep(LOOK);
    }
}

/// Checks that this is the machine on which the drawing was started.
fn check_board(record: &Record, snapshot: &Snapshot) -> Result<(), CommandError> {
    let begun_on = &record.entry.board;
    let welcome = snapshot.welcome.as_ref();
    let board = welcome.map_or_else(String::new, |welcome| format!("{} {}", welcome.board, welcome.firmware));
    if begun_on.is_empty() || *begun_on == board {
        return Ok(());
    }
    let text = format!(
        "this drawing was begun on {begun_on}, this machine is {board}; go on with it there, or draw it from the beginning"
    );
    Err(CommandError::new(code::FAILED, text))
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
pub(super) fn config_hash(config: &Config) -> String {
    config.hash().map(hash_text).unwrap_or_default()
}

/// Hashes of two configurations that are not the same.
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

impl From<ConfigChanged> for CommandError {
    fn from(changed: ConfigChanged) -> Self {
        let text =
            format!("{changed}; go on with that one (--config), or end the drawing that is held: etherpen cancel");
        Self::new(code::USAGE, text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::Entry;
    use std::sync::atomic::{AtomicU32, Ordering};

    /// The log's jobs of one path, the oldest first: strokes begun, and whether it was drawn to its end.
    fn log(jobs: &[(u32, bool)]) -> Vec<Record> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("etherpen-broken-{}-{number}", std::process::id()));
        let of = |(number, (strokes, completed)): (u16, &(u32, bool))| {
            let entry = Entry {
                path_hash: "ab".into(),
                number,
                strokes: *strokes,
                executed: 10 * strokes,
                completed: *completed,
                ..Entry::default()
            };
            Record::begin(&folder, entry).expect("a log")
        };
        let records = (1..).zip(jobs).map(of).collect();
        // An empty log has no folder.
        let _ = std::fs::remove_dir_all(&folder);
        records
    }

    fn numbers(jobs: &[(u32, bool)]) -> Result<Vec<u16>, CommandError> {
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
        let refused = chosen(again, &Snapshot::default()).unwrap_err();
        assert!(refused.message.contains("drawn to its end"), "{}", refused.message);
        assert!(numbers(&[]).unwrap_err().message.contains("no unfinished drawing"));
    }

    #[test]
    fn what_the_firmware_holds_goes_on_before_everything_else() {
        let of_log = candidates(&log(&[(57, false), (0, false)]), "ab", Path::new("portrait.png")).unwrap();
        let mut status = crate::console::status::tests::status(Mode::Holding, None);
        let path = |job| PathAck {
            job,
            ..Default::default()
        };
        let mut snapshot = Snapshot {
            status: Some(status.clone()),
            path: Some(path(2)),
            ..Snapshot::default()
        };
        assert_eq!(chosen(of_log.clone(), &snapshot).unwrap().entry.number, 2);
        snapshot.path = Some(path(9));
        assert_eq!(chosen(of_log.clone(), &snapshot).unwrap().entry.number, 1);
        snapshot.path = Some(path(2));
        let again = candidates(&log(&[(163, true), (0, false)]), "ab", Path::new("portrait.png")).unwrap();
        assert_eq!(chosen(again, &snapshot).unwrap().entry.number, 2, "begun a second time");
        status.mode = Mode::DrivesOff;
        (snapshot.status, snapshot.path) = (Some(status), Some(path(2)));
        assert_eq!(chosen(of_log, &snapshot).unwrap().entry.number, 1);
    }
}
