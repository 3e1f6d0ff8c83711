//! A drawing and its entry in the job log, which is kept up while it is drawn.
//!
//! Progress refers to the complete path, even if only its remainder was sent to the firmware.
//!
//! Invariant: a drawing does not need its entry. Where the log cannot be written, it is drawn all the same.

use super::JobReport;
use super::progress::{PathMeasure, Progress};
use super::resume::ResumePlan;
use etherpen::config::Config;
use etherpen::messages::{PathVertex, Welcome};
use std::io;
use std::time::Duration;

/// Time between two updates of the entry.
const UPDATE: Duration = Duration::from_millis(200);

/// What an update has written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Written {
    /// It survives the end of the program; a power cut may lose it.
    Unsynced,
    /// It is on the disk.
    Synced,
}

/// A drawing and its entry.
pub struct Logged {
    measure: PathMeasure,
    plan: ResumePlan,
    updated: Duration,
    /// Whether the disk is to know, and does not, that the board draws.
    is_owed: bool,
    /// Whether there may have been ink before.
    had_ink: bool,
}

impl Logged {
    /// Begins to draw what `plan` says of `path`, or goes on with it.
    pub fn begin(config: &Config, path: &[PathVertex], mut plan: ResumePlan) -> Self {
        let had_ink = plan.record.as_ref().is_some_and(|record| record.entry.may_have_ink());
        if let Some(record) = &mut plan.record {
            record.entry.number = plan.drawing.number;
            record.entry.result = None;
            let _ = record.save();
        }
        Self {
            measure: PathMeasure::new(path, config),
            plan,
            updated: Duration::ZERO,
            is_owed: false,
            had_ink,
        }
    }

    /// What is drawn, and from where.
    pub fn plan(&self) -> &ResumePlan {
        &self.plan
    }

    /// Notes which board draws.
    pub fn connected(&mut self, welcome: &Welcome) {
        if let Some(record) = &mut self.plan.record {
            record.entry.board = format!("{} {}", welcome.board, welcome.firmware);
        }
    }

    /// Notes that the board begins to draw, before there is ink; returns what was written.
    pub fn draws(&mut self) -> Option<Written> {
        self.is_owed = true;
        self.write()
    }

    /// Progress along the complete path, from the progress of the part that was sent to the firmware.
    pub fn whole(&self, progress: &Progress) -> Progress {
        let executed = self.plan.executed(progress.vertices);
        let before = self.plan.executed(0);
        let number = |vertices: usize| u32::try_from(vertices).unwrap_or(u32::MAX);
        let whole = Progress {
            left_s: progress.left_s,
            ..self
                .measure
                .progress(number(before), number(executed), progress.elapsed_s)
        };
        let missing_from = progress
            .missing_from()
            .map(|missing_from| self.plan.executed(missing_from));
        whole.complete_to(missing_from)
    }

    /// Takes progress along the complete path at a time since the beginning; returns what was written.
    pub fn advance(&mut self, progress: &Progress, now: Duration) -> Option<Written> {
        let record = self.plan.record.as_mut()?;
        record.entry.progress(progress);
        record.entry.drawn_s = self.plan.drawn_before_s + progress.elapsed_s;
        if now < self.updated + UPDATE {
            return None;
        }
        self.updated = now;
        self.write()
    }

    /// Writes the entry; on the disk if it owes that.
    fn write(&mut self) -> Option<Written> {
        let record = self.plan.record.as_mut()?;
        if !self.is_owed {
            return record.save_unsynced().ok().map(|()| Written::Unsynced);
        }
        record.save().ok()?;
        self.is_owed = false;
        Some(Written::Synced)
    }

    /// Takes the end of the drawing: its result, in words if it is a failure.
    ///
    /// # Errors
    /// The log cannot be written.
    pub fn end(&mut self, result: Result<(), &str>, report: &JobReport) -> io::Result<()> {
        let whole = self.whole(&report.progress);
        let Some(record) = &mut self.plan.record else {
            return Ok(());
        };
        record.entry.completed = result.is_ok();
        record.entry.result = Some(result.err().unwrap_or("drawn").to_owned());
        if report.progress.vertices_total > 0 {
            record.entry.progress(&whole);
        }
        record.entry.drawn_s = self.plan.drawn_before_s + report.drawn_s;
        if self.had_ink && !record.entry.may_have_ink() {
            // This attempt has drawn nothing; the one before was cut off.
            record.entry.result = None;
        }
        record.save()
    }
}
