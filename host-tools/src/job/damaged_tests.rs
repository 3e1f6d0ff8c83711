//! A job log on a bad disk: whatever a file has become, a resumed drawing lacks no ink.

use super::history::{HistoryEntry, Record, hash_text};
use super::resume::{LastPart, MachineState, last_in, last_part_in, named_in, plan};
use super::{path_hash, resume};
use crate::random::Random;
use etherpen::config::Config;
use etherpen::messages::PathVertex;
use etherpen::motion::Pen;
use std::fs;
use std::path::{Path, PathBuf};

/// Strokes of the path, and vertices of each: one above its beginning, one there, the drawn ones, one above its end.
const STROKES: u32 = 6;
const PER_STROKE: u32 = 12;
/// Vertices that were executed, in the middle of a stroke, and before that on another sheet.
const EXECUTED: u32 = 30;
const ON_ANOTHER_SHEET: u32 = 60;
/// Distance of a point from the nearest ink at which it lacks ink, um.
const LACKING_UM: f64 = 2.0;

fn path() -> Vec<PathVertex> {
    let vertex = |number: u32| {
        let (stroke, place) = (number / PER_STROKE, number % PER_STROKE);
        let is_raised = place == 0 || place == PER_STROKE - 1;
        let along = place.clamp(1, PER_STROKE - 2) as i32;
        PathVertex {
            position_um: [4_000 * along, 3_000 * stroke as i32, if is_raised { 5_000 } else { 0 }],
            pen: if place < 2 || is_raised { Pen::Up } else { Pen::Down },
            stroke,
        }
    };
    (0..STROKES * PER_STROKE).map(vertex).collect()
}

/// Lines that the pen draws, with the number of the vertex at the end of each.
fn lines(path: &[PathVertex]) -> Vec<(usize, [[f64; 2]; 2])> {
    let at = |vertex: &PathVertex| [0, 1].map(|axis| f64::from(vertex.position_um[axis]));
    let legs = path.windows(2).enumerate().filter(|(_, leg)| leg[1].pen == Pen::Down);
    legs.map(|(number, leg)| (number + 1, [at(&leg[0]), at(&leg[1])]))
        .collect()
}

/// Distance of a point from a line, um.
fn away_um([x, y]: [f64; 2], [[ax, ay], [bx, by]]: [[f64; 2]; 2]) -> f64 {
    let (dx, dy) = (bx - ax, by - ay);
    let share = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy).max(1.0e-9);
    let share = share.clamp(0.0, 1.0);
    (x - ax - share * dx).hypot(y - ay - share * dy)
}

/// Whether a drawing of which `executed` vertices were drawn and then `rest` has all ink of `whole`.
fn is_whole(whole: &[PathVertex], executed: u32, rest: &[PathVertex]) -> bool {
    let before = lines(whole)
        .into_iter()
        .filter(|(vertex, _)| *vertex < executed as usize);
    let ink: Vec<_> = before.chain(lines(rest)).map(|(_, line)| line).collect();
    let points = lines(whole).into_iter().flat_map(|(_, [[ax, ay], [bx, by]])| {
        (0..=8).map(move |part| {
            let share = f64::from(part) / 8.0;
            [ax + share * (bx - ax), ay + share * (by - ay)]
        })
    });
    points
        .into_iter()
        .all(|point| ink.iter().any(|line| away_um(point, *line) < LACKING_UM))
}

/// A log with a drawing that came far on another sheet, and a newer one that came less far; removed with the value.
struct Log {
    folder: PathBuf,
    newest: PathBuf,
    whole: Vec<u8>,
    hash: String,
}

impl Log {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("etherpen-damaged-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        let hash = hash_text(path_hash(&path()));
        let entry = |executed: u32| HistoryEntry {
            file: "portrait.png".into(),
            path_hash: hash.clone(),
            config_hash: resume::config_hash(&Config::default()),
            number: 7,
            executed,
            strokes: executed / PER_STROKE + 1,
            vertices: STROKES * PER_STROKE,
            strokes_total: STROKES,
            pen_down_mm: 123.456_789_012_345,
            drawn_s: 0.1 + 0.2,
            ..HistoryEntry::default()
        };
        let earlier = Record::begin(&folder, entry(ON_ANOTHER_SHEET)).expect("a log");
        // The name of an entry begins with its time.
        let old = folder.join(format!("{}.json", earlier.name()));
        fs::rename(&old, folder.join(format!("0000000000001-{hash}-1.json"))).expect("an older one");
        let record = Record::begin(&folder, entry(EXECUTED)).expect("a log");
        let newest = folder.join(format!("{}.json", record.name()));
        let whole = fs::read(&newest).expect("the entry");
        Self {
            folder,
            newest,
            whole,
            hash,
        }
    }

    /// What the newest entry with these bytes lets the robot draw; `None` if the drawing is not resumed.
    fn resumed(&self, bytes: &[u8]) -> Option<Vec<PathVertex>> {
        fs::write(&self.newest, bytes).expect("the entry");
        self.rest()
    }

    fn rest(&self) -> Option<Vec<PathVertex>> {
        let found = last_in(&self.folder, &self.hash, Path::new("portrait.png")).ok()?;
        let planned = plan(found, &MachineState::default(), &Config::default(), &path()).ok()?;
        Some(planned.drawing.vertices.to_vec())
    }
}

impl Drop for Log {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.folder);
    }
}

#[test]
fn an_entry_with_any_damaged_byte_or_cut_at_any_length_costs_no_ink() {
    let log = Log::new("bytes");
    let path = path();
    let rest = log.resumed(&log.whole).expect("a whole entry is resumed");
    assert!(is_whole(&path, EXECUTED, &rest) && rest.len() < path.len());
    assert!(!is_whole(&path, EXECUTED, &rest[6..]), "missing ink is seen");
    for length in 0..log.whole.len() {
        let rest = log.resumed(&log.whole[..length]);
        assert_eq!(rest, None, "the first {length} bytes");
    }
    let (mut random, mut resumed) = (Random::new(1), 0);
    for place in 0..log.whole.len() {
        // Another digit, another letter, any other byte.
        for change in [1, 4, 0x20, 1 + (random.bits() % 255) as u8] {
            let mut bytes = log.whole.clone();
            bytes[place] ^= change;
            let Some(rest) = log.resumed(&bytes) else { continue };
            resumed += 1;
            let shown = String::from_utf8_lossy(&bytes);
            assert!(
                is_whole(&path, EXECUTED, &rest),
                "byte {place} changed by {change:#x}: {shown}"
            );
        }
    }
    println!("{resumed} damaged entries were resumed");
}

#[test]
fn an_entry_with_a_damaged_number_and_any_damaged_byte_in_its_last_lines_costs_no_ink() {
    let log = Log::new("twice");
    let place = |text: &[u8]| log.whole.windows(text.len()).position(|bytes| bytes == text);
    let (number, check) = (place(b"\"executed\": 30"), place(b",\n  \"check\""));
    let (number, check) = (number.expect("a number") + 12, check.expect("a hash"));
    for place in check..log.whole.len() {
        for change in 1..=255 {
            let mut bytes = log.whole.clone();
            // 30 becomes 70: nothing after the fifth stroke would be drawn.
            bytes[number] ^= b'3' ^ b'7';
            bytes[place] ^= change;
            assert_eq!(log.resumed(&bytes), None, "byte {place} changed by {change:#x}");
        }
    }
}

#[test]
fn a_damaged_entry_is_told_by_its_name_and_by_the_beginning_of_it() {
    let log = Log::new("prefix");
    let name = log.newest.file_stem().expect("a name").to_string_lossy().into_owned();
    assert_eq!(named_in(&log.folder, &name[..13]).expect("found").name(), name);
    fs::write(&log.newest, &log.whole[1..]).expect("the entry");
    for asked in [name.as_str(), &name[..13]] {
        let refused = named_in(&log.folder, asked).unwrap_err().message;
        assert!(refused.contains(&name) && refused.contains("damaged"), "{refused}");
    }
    // Both jobs begin with nothing.
    assert!(named_in(&log.folder, "").unwrap_err().message.contains("2 jobs"));
    assert!(named_in(&log.folder, "9").unwrap_err().message.contains("no job"));
}

#[test]
fn an_entry_that_is_damaged_is_named_and_an_older_drawing_is_not_continued_in_its_place() {
    let log = Log::new("named");
    fs::write(&log.newest, &log.whole[..log.whole.len() / 2]).expect("the entry");
    let refused = last_in(&log.folder, &log.hash, Path::new("portrait.png")).unwrap_err();
    let name = log.newest.file_stem().expect("a name").to_string_lossy();
    assert!(
        refused.message.contains(&*name) && refused.message.contains("damaged"),
        "{}",
        refused.message
    );
    // A damaged entry that is older than a whole one hides nothing.
    fs::write(&log.newest, &log.whole).expect("the entry");
    fs::write(log.folder.join(format!("0000000000002-{}-1.json", log.hash)), b"{").expect("an entry");
    assert!(is_whole(&path(), EXECUTED, &log.rest().expect("resumed")));
}

#[test]
fn drawings_that_begin_in_one_millisecond_have_entries_of_their_own() {
    let log = Log::new("at-once");
    let begin = |number| {
        let entry = HistoryEntry {
            number,
            ..HistoryEntry::default()
        };
        Record::begin(&log.folder, entry).expect("a log").name()
    };
    let names: Vec<String> = (0..50).map(begin).collect();
    let different: std::collections::HashSet<&String> = names.iter().collect();
    assert_eq!(different.len(), names.len());
    assert!(names.is_sorted());
}

#[test]
fn a_newer_entry_without_ink_hides_no_damaged_one() {
    let log = Log::new("inkless");
    fs::write(&log.newest, &log.whole[..log.whole.len() / 2]).expect("the entry");
    let entry = HistoryEntry {
        path_hash: log.hash.clone(),
        ..HistoryEntry::default()
    };
    let newer = Record::begin(&log.folder, entry).expect("a log");
    let old = log.folder.join(format!("{}.json", newer.name()));
    let name = format!("9999999999999-{}-1.json", log.hash);
    fs::rename(&old, log.folder.join(name)).expect("the newest one");
    let refused = last_in(&log.folder, &log.hash, Path::new("portrait.png")).unwrap_err();
    assert!(refused.message.contains("damaged"), "{}", refused.message);
}

#[test]
fn a_drawing_of_layers_does_not_go_on_behind_a_damaged_layer() {
    let log = Log::new("layers");
    let hashes = ["0123456789abcdef".to_owned(), log.hash.clone()];
    let entry = HistoryEntry {
        path_hash: hashes[0].clone(),
        completed: true,
        strokes: 3,
        ..HistoryEntry::default()
    };
    let first = Record::begin(&log.folder, entry).expect("a log");
    let old = log.folder.join(format!("{}.json", first.name()));
    let name = format!("0000000000003-{}-1.json", hashes[0]);
    fs::rename(&old, log.folder.join(name)).expect("an older one");
    let left = || last_part_in(&log.folder, &hashes, Path::new("portrait.png"));
    let here = LastPart {
        index: 1,
        is_next: false,
    };
    assert_eq!(left().expect("the second layer"), here);
    fs::write(&log.newest, &log.whole[..log.whole.len() / 2]).expect("the entry");
    let refused = left().unwrap_err();
    assert!(refused.message.contains("damaged"), "{}", refused.message);
}

#[test]
fn an_entry_of_a_program_that_wrote_no_hash_is_resumed() {
    let log = Log::new("old");
    let text = String::from_utf8(log.whole.clone()).expect("text");
    let (lines, _) = text.rsplit_once(",\n  \"check\"").expect("a hash");
    let rest = log.resumed(format!("{lines}\n}}").as_bytes()).expect("resumed");
    assert!(is_whole(&path(), EXECUTED, &rest) && rest.len() < path().len());
}

#[test]
fn a_log_that_is_removed_while_a_drawing_runs_is_begun_again() {
    let log = Log::new("removed");
    let mut record = last_in(&log.folder, &log.hash, Path::new("portrait.png"))
        .expect("jobs")
        .remove(0);
    fs::remove_dir_all(&log.folder).expect("the log");
    record.entry.executed = EXECUTED + 4;
    record.save_unsynced().expect("written again");
    let rest = log.rest().expect("resumed");
    assert!(is_whole(&path(), EXECUTED + 4, &rest) && rest.len() < path().len());
    // A folder that cannot be made is an error, which a drawing ignores.
    fs::remove_dir_all(&log.folder).expect("the log");
    fs::write(&log.folder, b"").expect("a file in its place");
    assert!(record.save().is_err() && record.save_unsynced().is_err());
    assert!(last_in(&log.folder, &log.hash, Path::new("portrait.png")).is_err());
    fs::remove_file(&log.folder).expect("the file");
}
