//! What every viewer sees: one state, written by the machine's news, read by as many viewers as there are.
//!
//! Viewers are never written to from here: each one takes what has changed since it could last send, so that a slow one
//! costs itself pictures and nobody else anything. Invariants: nothing here grows with time; a stop that was asked for is
//! repeated after every connection until the firmware itself says that it has stopped.

use super::capture::{Capture, Caught, Trigger};
use super::control::{Change, ControlLock, ViewerId};
use super::history::{History, Snapshot};
use super::jobs::Jobs;
use super::messages::section;
use super::signals::{Row, Rows};
use super::status::{self, mode_name};
use super::words::on_page;
use crate::link::text;
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::link::protocol::{Sample, Status, Welcome};
use etherpen::motion::Pen;
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Lines of the log that are kept.
const LOG_LINES: usize = 500;
/// Time in which the same warning is the same event, ms.
const SAME_MS: u64 = 100;
/// Time in which stops that are asked for are one press, ms.
const PRESS_MS: u64 = 1_000;
/// How a line of the log about a stop begins.
const STOP: &str = "STOP";
/// Viewers at the same time.
pub const VIEWERS_MAX: usize = 32;

/// A part of the state that is sent as a whole when it has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Topic {
    /// What does not change: geometry, signals, limits.
    Robot,
    /// The connection to the firmware.
    Link,
    /// The firmware's status.
    Status,
    /// Who commands, who looks.
    Control,
    /// Drawings: active, waiting, past.
    Jobs,
    /// How far the active drawing is.
    Progress,
    /// The drawing that is prepared.
    Studio,
    /// The firmware's measurements.
    Measured,
    /// The virtual segment.
    Segment,
    /// What the slaves' controllers count.
    LineErrors,
}

impl Topic {
    fn name(self) -> &'static str {
        match self {
            Self::Robot => "robot",
            Self::Link => "link",
            Self::Status => "status",
            Self::Control => "control",
            Self::Jobs => "jobs",
            Self::Progress => "progress",
            Self::Studio => "studio",
            Self::Measured => "measured",
            Self::Segment => "segment",
            Self::LineErrors => "line_errors",
        }
    }
}

/// A topic's present text.
#[derive(Clone, Debug)]
struct Said {
    version: u64,
    text: Arc<str>,
}

/// How bad a line of the log is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Something happened.
    Info,
    /// Somebody should look.
    Warning,
    /// The robot has stopped, or cannot be reached.
    Error,
}

/// A line of the log.
#[derive(Clone, Debug, Serialize)]
pub struct LogLine {
    /// Its number.
    pub number: u64,
    /// Console time, ms: the time axis of the plots.
    pub time_ms: u64,
    /// How bad it is.
    pub level: Level,
    /// What happened.
    pub text: String,
}

/// The connection as a person reads it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LinkView {
    /// `connecting`, `connected` or `lost`.
    pub state: &'static str,
    /// In words, with what to try.
    pub text: String,
    /// The port.
    pub port: String,
    /// Board and firmware version.
    pub firmware: String,
    /// Samples received.
    pub samples: u64,
    /// Samples lost.
    pub samples_missing: u64,
}

/// What moves all the time.
#[derive(Clone, Debug, Serialize)]
struct Pose {
    time_ms: u64,
    t_ms: u32,
    mode: &'static str,
    pen_down: bool,
    stroke: u32,
    joints_rad: [f32; 4],
    commanded_mm: [f32; 3],
    measured_mm: [f32; 3],
    errors_rad: [f32; 4],
}

/// A viewer's trigger.
struct Armed {
    capture: Capture,
    caught: Option<(Caught, Snapshot)>,
}

/// The state.
pub struct Hub {
    said: BTreeMap<Topic, Said>,
    version: u64,
    link: LinkView,
    status: Option<Status>,
    /// Console time at which each slave was found not to answer, ms.
    silent_ms: Vec<Option<u64>>,
    rows: Rows,
    history: History,
    log: VecDeque<LogLine>,
    log_next: u64,
    captures: BTreeMap<ViewerId, Armed>,
    stop_wanted: bool,
    viewers: usize,
    viewer_next: ViewerId,
    /// Who commands.
    pub control: ControlLock,
    /// Drawings.
    pub jobs: Jobs,
}

impl Hub {
    /// A hub for a robot of this configuration behind a port of this name.
    pub fn new(config: &Config, port: &str) -> Self {
        let link = LinkView {
            state: "connecting",
            text: "waiting for the firmware to answer".to_owned(),
            port: port.to_owned(),
            firmware: String::new(),
            samples: 0,
            samples_missing: 0,
        };
        let mut hub = Self {
            said: BTreeMap::new(),
            version: 0,
            link: link.clone(),
            status: None,
            silent_ms: Vec::new(),
            rows: Rows::new(config),
            history: History::default(),
            log: VecDeque::new(),
            log_next: 0,
            captures: BTreeMap::new(),
            stop_wanted: false,
            viewers: 0,
            viewer_next: 1,
            control: ControlLock::default(),
            jobs: Jobs::new(),
        };
        hub.say(Topic::Link, &link);
        hub.say_control();
        hub.say_jobs();
        hub
    }

    /// Changes a topic; the same text again is no change.
    pub fn say(&mut self, topic: Topic, data: &impl Serialize) {
        let text = section(topic.name(), data);
        if self.said.get(&topic).is_some_and(|said| said.text == text) {
            return;
        }
        self.version += 1;
        let version = self.version;
        self.said.insert(topic, Said { version, text });
    }

    /// What has changed since a version, oldest change first.
    pub fn news_since(&self, version: u64) -> Vec<(u64, Arc<str>)> {
        let newer = self.said.values().filter(|said| said.version > version);
        let mut newer: Vec<_> = newer.map(|said| (said.version, said.text.clone())).collect();
        newer.sort_by_key(|(version, _)| *version);
        newer
    }

    /// Writes a line into the log.
    pub fn note(&mut self, level: Level, text: impl Into<String>) {
        let text = on_page(&text.into());
        let said = |last: &LogLine| match level {
            // The firmware's mode and the task's phase often say the same.
            Level::Info => last.text == text,
            // A refusal comes as an event and as an order's answer.
            _ => self.now_ms() <= last.time_ms + SAME_MS && last.text == text,
        };
        if self.log.back().is_some_and(said) {
            return;
        }
        self.log.push_back(LogLine {
            number: self.log_next,
            time_ms: self.now_ms(),
            level,
            text,
        });
        self.log_next += 1;
        if self.log.len() > LOG_LINES {
            self.log.pop_front();
        }
    }

    /// Lines of the log from a number on, and the number after the last.
    pub fn log_since(&self, number: u64) -> (Vec<LogLine>, u64) {
        let lines = self.log.iter().filter(|line| line.number >= number);
        (lines.cloned().collect(), self.log_next)
    }

    /// Console time, ms.
    pub fn now_ms(&self) -> u64 {
        self.history.last().map_or(0, |row| row.time_ms)
    }

    /// The rows.
    pub fn history(&self) -> &History {
        &self.history
    }

    /// The firmware's operating mode.
    pub fn mode(&self) -> Option<Mode> {
        self.status.as_ref().map(|status| status.mode)
    }

    /// Slaves that the firmware knows.
    pub fn slaves(&self) -> u8 {
        let slaves = self.status.as_ref().map_or(0, |status| status.slaves.len());
        u8::try_from(slaves).unwrap_or(u8::MAX)
    }

    /// Whether anybody looks.
    pub fn is_watched(&self) -> bool {
        self.viewers > 0
    }

    /// Where the robot is, as text; `None` before the first sample.
    pub fn pose(&self) -> Option<Arc<str>> {
        let row = self.history.last()?;
        Some(section(
            "pose",
            &Pose {
                time_ms: row.time_ms,
                t_ms: row.t_ms,
                mode: mode_name(row.mode),
                pen_down: row.pen == Pen::Down,
                stroke: row.stroke,
                joints_rad: row.joints_rad(),
                commanded_mm: row.commanded_mm(),
                measured_mm: row.measured_mm(),
                errors_rad: row.errors_rad(),
            },
        ))
    }

    /// The firmware has answered. Gives whether a stop has to be repeated.
    pub fn connected(&mut self, welcome: &Welcome) -> bool {
        self.link.state = "connected";
        self.link.text = "connected".to_owned();
        self.link.firmware = format!("{} {}", welcome.board, welcome.firmware);
        self.say_link();
        self.note(Level::Info, format!("connected to {}", self.link.firmware));
        self.stop_wanted
    }

    /// The connection has gone, or could not be made; a reason that is shown already is not told again.
    pub fn lost(&mut self, why: &str) {
        if self.link.state == "lost" && self.link.text == why {
            return;
        }
        self.link.state = "lost";
        self.link.text = on_page(why);
        self.say_link();
        self.note(Level::Error, why);
        self.status = None;
        self.silent_ms.clear();
        self.say(Topic::Status, &Option::<()>::None);
    }

    /// Takes a status.
    pub fn take_status(&mut self, status: &Status) {
        let before = self.status.take();
        let before = before.as_ref();
        let mode_before = before.map(|before| before.mode);
        let fault_before = before.and_then(|before| before.fault);
        if mode_before != Some(status.mode) {
            self.note(Level::Info, text::mode(status.mode));
        }
        if let Some(fault) = status.fault.filter(|fault| fault_before != Some(*fault)) {
            self.note(Level::Error, text::fault(&fault));
        }
        let gone: Vec<(usize, u8)> = before
            .map(|before| before.slaves.iter().zip(&status.slaves))
            .into_iter()
            .flatten()
            .enumerate()
            .filter(|(_, (before, now))| before.al_state == 8 && now.al_state != 8)
            .map(|(index, (_, now))| (index + 1, now.al_state))
            .collect();
        for (slave, al_state) in gone {
            let what = if al_state == 0 { "does not answer" } else { "left OP" };
            self.note(Level::Warning, format!("slave {slave} {what}"));
        }
        if status.fault.is_some() {
            self.stop_wanted = false;
        }
        let now_ms = self.now_ms();
        self.silent_ms.resize(status.slaves.len(), None);
        for (index, since_ms) in self.silent_ms.iter_mut().enumerate() {
            *since_ms = status::is_silent(status, index).then(|| since_ms.unwrap_or(now_ms));
        }
        let silent_s = |since_ms: &Option<u64>| since_ms.map(|since_ms| now_ms.saturating_sub(since_ms) / 1_000);
        let silent_s: Vec<_> = self.silent_ms.iter().map(silent_s).collect();
        self.say(Topic::Status, &status::view(status, &silent_s));
        self.status = Some(status.clone());
    }

    /// Takes samples, `missing` of which were lost right before.
    pub fn take_samples(&mut self, missing: u32, samples: &[Sample]) {
        self.link.samples += samples.len() as u64;
        self.link.samples_missing += u64::from(missing);
        for sample in samples {
            let row = self.rows.take(sample);
            self.history.push(row);
            self.step_captures(&row);
        }
    }

    fn step_captures(&mut self, row: &Row) {
        for armed in self.captures.values_mut().filter(|armed| armed.caught.is_none()) {
            if let Some(caught) = armed.capture.step(row) {
                let snapshot = self.history.snapshot().cut(caught.from_ms, caught.to_ms);
                armed.caught = Some((caught, snapshot));
            }
        }
    }

    /// Arms a viewer's trigger, in place of the one before.
    pub fn arm(&mut self, viewer: ViewerId, trigger: Trigger) {
        let capture = Capture::new(trigger);
        self.captures.insert(viewer, Armed { capture, caught: None });
    }

    /// Takes a viewer's trigger away.
    pub fn disarm(&mut self, viewer: ViewerId) {
        self.captures.remove(&viewer);
    }

    /// What a viewer's trigger has caught, once.
    pub fn take_caught(&mut self, viewer: ViewerId) -> Option<(Caught, Snapshot)> {
        let caught = self.captures.get_mut(&viewer)?.caught.take()?;
        self.captures.remove(&viewer);
        Some(caught)
    }

    /// Whether a viewer's trigger is armed, and whether it has fired.
    pub fn capture_state(&self, viewer: ViewerId) -> Option<bool> {
        self.captures.get(&viewer).map(|armed| armed.capture.has_fired())
    }

    /// A drawing was not begun; of one that has ended the end is known already.
    pub fn refused_drawing(&mut self, number: u64, why: &str) {
        if self.jobs.active() == Some(number) {
            self.note(Level::Warning, format!("the drawing was not begun: {why}"));
            self.jobs.end(false, on_page(why));
            self.say_jobs();
        }
    }

    /// Somebody wants a stop.
    pub fn stop_asked(&mut self, who: &str) {
        // A robot that already stands by a fault needs no repetition.
        self.stop_wanted = self.mode() != Some(Mode::Fault);
        // One press comes by two ways.
        let now_ms = self.now_ms();
        let recent = self
            .log
            .iter()
            .rev()
            .take_while(|line| line.time_ms + PRESS_MS >= now_ms);
        if !recent.into_iter().any(|line| line.text.starts_with(STOP)) {
            self.note(Level::Warning, format!("{STOP} from {who}"));
        }
    }

    /// A viewer comes, if there is room; gives its number.
    pub fn enter(&mut self) -> Option<ViewerId> {
        if self.viewers >= VIEWERS_MAX {
            return None;
        }
        self.viewers += 1;
        self.viewer_next += 1;
        self.say_control();
        Some(self.viewer_next - 1)
    }

    /// A viewer goes; gives whether a jog of its has to stop.
    pub fn leave(&mut self, viewer: ViewerId, now_ms: u64) -> bool {
        self.viewers = self.viewers.saturating_sub(1);
        self.captures.remove(&viewer);
        let change = self.control.gone(viewer, now_ms);
        self.say_control();
        change == Some(Change::Vanished)
    }

    /// Tells who commands and who looks.
    pub fn say_control(&mut self) {
        #[derive(Serialize)]
        struct Control {
            holder: Option<ViewerId>,
            viewers: usize,
        }
        let control = Control {
            holder: self.control.holder(),
            viewers: self.viewers,
        };
        self.say(Topic::Control, &control);
    }

    /// Tells the connection, with its counts.
    pub fn say_link(&mut self) {
        let link = self.link.clone();
        self.say(Topic::Link, &link);
    }

    /// Tells the drawings.
    pub fn say_jobs(&mut self) {
        let jobs = self.jobs.view();
        self.say(Topic::Jobs, &jobs);
    }
}

#[cfg(test)]
mod tests {
    use super::super::capture::Condition;
    use super::super::signals::tests::sample;
    use super::*;

    fn hub() -> Hub {
        Hub::new(&Config::default(), "test")
    }

    #[test]
    fn only_what_has_changed_is_news_and_each_change_once() {
        let mut hub = hub();
        let mut version = 0;
        let mut news = |hub: &Hub| {
            let news = hub.news_since(version);
            version = news.last().map_or(version, |(last, _)| *last);
            news.len()
        };
        assert_eq!(news(&hub), 3);
        hub.say(Topic::Studio, &"a");
        hub.say(Topic::Studio, &"a");
        hub.say(Topic::Studio, &"b");
        assert_eq!(news(&hub), 1);
        assert_eq!(news(&hub), 0);
    }

    #[test]
    fn the_log_keeps_its_last_lines_and_their_numbers() {
        let mut hub = hub();
        (0..2 * LOG_LINES).for_each(|line| hub.note(Level::Info, line.to_string()));
        let (lines, next) = hub.log_since(0);
        assert_eq!((lines.len(), next), (LOG_LINES, 2 * LOG_LINES as u64));
        assert_eq!(lines.first().map(|line| line.number), Some(LOG_LINES as u64));
        assert!(hub.log_since(next).0.is_empty());
    }

    #[test]
    fn a_trigger_catches_for_its_viewer_only_and_once() {
        let mut hub = hub();
        let trigger = Trigger {
            signal: 1,
            condition: Condition::Rising,
            level: 0.5,
            before_ms: 10,
            after_ms: 10,
        };
        hub.arm(7, trigger);
        let samples: Vec<_> = (0..100).map(|t_ms| sample(t_ms, t_ms as f32 / 100.0)).collect();
        hub.take_samples(0, &samples);
        assert!(hub.take_caught(8).is_none());
        let (caught, snapshot) = hub.take_caught(7).unwrap();
        assert_eq!((caught.from_ms, caught.to_ms), (40, 60));
        assert_eq!(snapshot.rows(40, 60).count(), 21);
        assert!(hub.take_caught(7).is_none() && hub.capture_state(7).is_none());
    }

    #[test]
    fn no_more_viewers_than_there_is_room_for() {
        let mut hub = hub();
        let first = hub.enter().unwrap();
        assert!((1..VIEWERS_MAX).all(|_| hub.enter().is_some()));
        assert_eq!(hub.enter(), None);
        hub.leave(first, 0);
        assert!(hub.enter().is_some_and(|viewer| viewer != first));
    }
}
