//! How a broken drawing goes on: with what the firmware holds, else from the log.

use super::{CommandError, code};
use crate::history::{self, Record, hash_text};
use crate::link::job::Drawing;
use crate::link::remainder::Remainder;
use crate::link::text;
use crate::machine::{Machine, Snapshot};
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::link::protocol::PathVertex;
use std::path::Path;
use std::time::{Duration, Instant};

/// Length of the broken stroke that is drawn again, um: more than a pen needs to touch down.
const OVERLAP_UM: f64 = 1_000.0;
/// Longest wait for the machine's state; the link itself gives up before.
const STATE_MAX: Duration = Duration::from_secs(10);
/// Longest wait for what a firmware that holds says of its path.
const PATH_MAX: Duration = Duration::from_millis(500);
/// Time between two looks.
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

/// The unfinished drawing of this path in the log.
///
/// # Errors
/// There is none.
pub(super) fn find(hash: &str, file: &Path) -> Result<Record, CommandError> {
    let records = history::folder()
        .and_then(|folder| history::list(&folder))
        .map_err(|cause| CommandError::failed("the log of jobs cannot be read", cause))?;
    let newest = |same: &dyn Fn(&Record) -> bool| records.iter().rev().find(|record| same(record)).cloned();
    match newest(&|record| record.entry.path_hash == hash) {
        Some(record) if !record.entry.completed => return Ok(record),
        Some(_) => {
            let text = format!(
                "{} was drawn to its end; there is nothing to go on with",
                file.display()
            );
            return Err(CommandError::new(code::INPUT, text));
        }
        None => {}
    }
    let same_file = std::fs::canonicalize(file).unwrap_or_else(|_| file.to_owned());
    let text = match newest(&|record| record.entry.file == same_file && !record.entry.completed) {
        Some(other) => format!(
            "{} was drawn with another path (hash {}, this one has {hash}): the file, the options or the paper and motion \
             in the configuration have changed; draw it with the same, or from the beginning without --resume",
            file.display(),
            other.entry.path_hash
        ),
        None => format!(
            "the log of jobs knows no unfinished drawing of {} (etherpen jobs lists them); draw it without --resume",
            file.display()
        ),
    };
    Err(CommandError::new(code::INPUT, text))
}

/// Looks what the machine still has of a drawing, and says how it goes on.
///
/// # Errors
/// There is no connection, or this is not the machine that drew.
pub(super) fn plan(
    mut record: Record,
    machine: &Machine,
    config: &Config,
    path: &[PathVertex],
) -> Result<Plan, CommandError> {
    let snapshot = state(machine)?;
    check(&record, &snapshot, config)?;
    let entry = &record.entry;
    let lift_um = (config.paper.pen_lift_mm * 1_000.0).round() as i32;
    let rest_after = |executed: u32| Remainder::new(path, executed as usize, OVERLAP_UM, lift_um);
    let given = (entry.given_from > 0).then(|| (rest_after(entry.given_from), entry.given_from as usize));
    let mode = snapshot.status.as_ref().map(|status| status.mode);
    let held = snapshot.path.filter(|ack| ack.job == entry.number);
    if let (Some(ack), Some(Mode::Holding | Mode::Drawing)) = (held, mode) {
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

/// Where the machine stands, and what it says of the path that it has.
///
/// # Errors
/// There is no connection, or the machine says nothing.
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

/// Whether this is the machine, with the configuration, that the drawing was begun on.
fn check(record: &Record, snapshot: &Snapshot, config: &Config) -> Result<(), CommandError> {
    let entry = &record.entry;
    let welcome = snapshot.welcome.as_ref();
    let board = welcome.map_or_else(String::new, |welcome| format!("{} {}", welcome.board, welcome.firmware));
    if !entry.board.is_empty() && entry.board != board {
        let text = format!(
            "this drawing was begun on {}, this machine is {board}; go on with it there, or draw it from the beginning",
            entry.board
        );
        return Err(CommandError::new(code::FAILED, text));
    }
    let ours = config.hash().map(hash_text).unwrap_or_default();
    if entry.config_hash != ours {
        let text = format!(
            "this drawing was begun with another configuration (hash {}, this one has {ours}); use the same one \
             (--config), or draw it from the beginning",
            entry.config_hash
        );
        return Err(CommandError::new(code::USAGE, text));
    }
    Ok(())
}
