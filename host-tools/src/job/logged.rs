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
    /// Whether there may be ink: the first stroke counts as started.
    may_have_ink: bool,
}

impl Logged {
    /// Opens the entry of what `plan` says of `path`.
    pub fn begin(config: &Config, path: &[PathVertex], mut plan: ResumePlan) -> Self {
        let may_have_ink = plan.record.as_ref().is_some_and(|record| record.entry.may_have_ink());
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
            may_have_ink,
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

    /// Notes that the board begins to draw; returns what was written.
    pub fn draws(&mut self) -> Option<Written> {
        (self.is_owed, self.may_have_ink) = (true, true);
        let record = self.plan.record.as_mut()?;
        record.entry.strokes = record.entry.strokes.max(1);
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
        record.entry.strokes = record.entry.strokes.max(self.may_have_ink.into());
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
        record.entry.strokes = record.entry.strokes.max(self.may_have_ink.into());
        record.save()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::history::hash_text;
    use crate::job::path_hash;
    use crate::job::resume::{MachineState, begin_record_in, last_in, plan};
    use crate::link::port::PortName;
    use crate::link::rig::path;
    use etherpen::link::Protocol;
    use etherpen::messages::RobotProtocol;
    use std::fs;
    use std::path::{Path, PathBuf};

    const FILE: &str = "portrait.png";

    /// A log's folder; removed with the value.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let folder = std::env::temp_dir().join(format!("etherpen-logged-{name}-{}", std::process::id()));
            let _ = fs::remove_dir_all(&folder);
            Self(folder)
        }

        /// A drawing from its beginning.
        fn begin(&self, path: &[PathVertex]) -> Logged {
            let (config, port) = (Config::default(), PortName::Serial("/dev/ttyACM0".into()));
            let record = begin_record_in(&self.0, Path::new(FILE), &(), &port, &config, path).expect("a log");
            Logged::begin(&config, path, ResumePlan::whole(path, Some(record)))
        }

        /// What is resumed on a machine that holds nothing.
        fn resumed(&self, path: &[PathVertex]) -> Result<ResumePlan, String> {
            let found = last_in(&self.0, &hash_text(path_hash(path)), Path::new(FILE));
            let machine = MachineState {
                welcome: Some(welcome()),
                ..MachineState::default()
            };
            let plan = found.and_then(|found| plan(found, &machine, &Config::default(), path));
            plan.map_err(|error| error.message)
        }

        fn newest(&self) -> (PathBuf, Vec<u8>) {
            let files = fs::read_dir(&self.0).expect("a log").flatten().map(|file| file.path());
            let newest = files.max().expect("an entry");
            let bytes = fs::read(&newest).expect("the entry");
            (newest, bytes)
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    /// Progress of a path that has executed so many vertices.
    fn progress(path: &[PathVertex], executed: u32) -> Progress {
        PathMeasure::new(path, &Config::default()).progress(0, executed, 1.0)
    }

    fn welcome() -> Welcome {
        Welcome {
            protocol: 1,
            session: 1,
            firmware: "1.0".try_into().expect("a short text"),
            board: "example".try_into().expect("a short text"),
            config: None,
            capacity: 100,
            previous: <RobotProtocol as Protocol>::NO_PREVIOUS_RUN,
        }
    }

    #[test]
    fn after_a_power_cut_the_copy_that_was_being_drawn_goes_on_and_not_one_before_it() {
        let (folder, path) = (Folder::new("cut"), path(40));
        for executed in [40, 20] {
            let mut before = folder.begin(&path);
            before.connected(&welcome());
            let report = JobReport {
                progress: progress(&path, executed),
                ..JobReport::default()
            };
            before
                .end(if executed == 40 { Ok(()) } else { Err("cancelled") }, &report)
                .expect("a log");
            let mut copy = folder.begin(&path);
            copy.connected(&welcome());
            assert_eq!(copy.draws(), Some(Written::Synced));
            let (file, on_disk) = folder.newest();
            let written = copy.advance(&progress(&path, 30), Duration::from_secs(1));
            assert_eq!(written, Some(Written::Unsynced));
            assert!(folder.resumed(&path).expect("it goes on").drawing.vertices.len() < 40);
            // Another program goes on, and ends before it has drawn anything.
            for attempt in 0..3 {
                fs::write(&file, &on_disk).expect("the entry");
                let plan = folder.resumed(&path).expect("it goes on");
                assert_eq!(plan.drawing.vertices[..], path[..], "attempt {attempt}");
                let mut again = Logged::begin(&Config::default(), &path, plan);
                again.end(Err("a fault"), &JobReport::default()).expect("a log");
                assert_eq!(
                    folder.resumed(&path).expect("it goes on").drawing.vertices[..],
                    path[..]
                );
            }
            // A copy that began to draw and ended before it reported progress is one too.
            fs::remove_file(&file).expect("the entry");
            let mut begun = folder.begin(&path);
            begun.connected(&welcome());
            begun.draws();
            begun.end(Err("lost"), &JobReport::default()).expect("a log");
            assert_eq!(
                folder.resumed(&path).expect("it goes on").drawing.vertices[..],
                path[..]
            );
            fs::remove_file(folder.newest().0).expect("the entry");
            // What was ordered and ended before it drew is none.
            let mut refused = folder.begin(&path);
            refused.connected(&welcome());
            refused.end(Err("refused"), &JobReport::default()).expect("a log");
            match folder.resumed(&path) {
                Ok(plan) => assert!(executed == 20 && plan.drawing.vertices.len() < 40),
                Err(text) => assert!(executed == 40 && text.contains("drawn to its end"), "{text}"),
            }
        }
    }

    #[test]
    fn a_disk_that_was_away_gets_what_it_is_owed_as_soon_as_it_is_back() {
        let (folder, path) = (Folder::new("away"), path(40));
        let mut copy = folder.begin(&path);
        copy.connected(&welcome());
        fs::remove_dir_all(&folder.0).expect("the log");
        fs::write(&folder.0, b"").expect("a file in its place");
        assert_eq!(copy.draws(), None);
        assert_eq!(copy.advance(&progress(&path, 5), Duration::from_secs(1)), None);
        fs::remove_file(&folder.0).expect("the file");
        let written = copy.advance(&progress(&path, 6), Duration::from_secs(2));
        assert_eq!(written, Some(Written::Synced));
        let written = copy.advance(&progress(&path, 7), Duration::from_secs(3));
        assert_eq!(written, Some(Written::Unsynced));
    }
}
