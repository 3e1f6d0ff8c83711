//! The hub: the state shown to all viewers, written by the machine's news and read by the viewers.
//!
//! The hub never writes to viewers. Each viewer takes the changes since its last transmission, so a slow viewer only
//! loses its own pictures. Invariants: memory is bounded; a requested stop is repeated after every connection until the
//! firmware reports that it has stopped.

use super::capture::{Caught, SignalCapture, Trigger};
use super::control::{Change, ControlLock, ViewerId};
use super::history::{History, HistorySnapshot};
use super::jobs::Jobs;
use super::messages::section;
use super::page_text::for_page;
use super::signals::{Rows, SignalRow};
use super::skeleton::Part;
use super::status::{self, mode_name};
use crate::link::text;
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::messages::{Sample, Status, Welcome};
use etherpen::motion::Pen;
use etherpen::robots::AXES;
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Lines of the log kept.
const LOG_LINES: usize = 500;
/// Time within which equal warnings count as one event, ms.
const SAME_MS: u64 = 100;
/// Time within which requested stops count as one press, ms.
const PRESS_MS: u64 = 1_000;
/// Beginning of a log line about a stop.
const STOP: &str = "STOP";
/// Most viewers.
pub const VIEWERS_MAX: usize = 32;
/// Most viewers without the token; the rest is reserved for viewers with the token.
pub const GUESTS_MAX: usize = 24;
/// Most viewers with a frozen snapshot: each keeps two minutes of telemetry, 17 MB.
const KEPT_MAX: usize = 4;
/// Most viewers with an armed trigger.
const ARMED_MAX: usize = 4;

const _: () = assert!(GUESTS_MAX < VIEWERS_MAX);

/// A section of the state, sent completely when it has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Topic {
    /// Constant data: geometry, signals, limits.
    Robot,
    /// The connection to the firmware.
    Link,
    /// The firmware's status.
    Status,
    /// Viewers, and which of them holds control.
    Control,
    /// Drawings: active, waiting, past.
    Jobs,
    /// Progress of the active drawing.
    Progress,
    /// The drawing being prepared.
    Preparation,
    /// The photograph drawn in several ways.
    Variants,
    /// The firmware's measurements.
    Measured,
    /// Where the sheet lies, and the touches that find it.
    Sheet,
    /// The axes that move the tool, and what was seen of them.
    Axes,
    /// The virtual segment.
    Segment,
    /// Error counters of the slave controllers.
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
            Self::Preparation => "studio",
            Self::Variants => "variants",
            Self::Measured => "measured",
            Self::Sheet => "sheet",
            Self::Axes => "axes",
            Self::Segment => "segment",
            Self::LineErrors => "line_errors",
        }
    }
}

/// Present text of a topic.
#[derive(Clone, Debug)]
struct Said {
    version: u64,
    text: Arc<str>,
}

/// Severity of a log line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// An ordinary event.
    Info,
    /// A condition that needs attention.
    Warning,
    /// The robot has stopped, or is not reachable.
    Error,
}

/// A line of the log.
#[derive(Clone, Debug, Serialize)]
pub struct LogEntry {
    /// Number of the line.
    pub number: u64,
    /// Console time, ms: the time axis of the plots.
    pub time_ms: u64,
    /// Severity.
    pub level: Level,
    /// What happened.
    pub text: String,
}

/// State of the connection, for display.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LinkView {
    /// `connecting`, `connected` or `lost`.
    pub state: &'static str,
    /// Description, with what to try.
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

/// Data that change continuously.
#[derive(Clone, Debug, Serialize)]
struct PoseView {
    time_ms: u64,
    t_ms: u32,
    mode: &'static str,
    pen_down: bool,
    stroke: u32,
    commanded_mm: [f32; 3],
    measured_mm: [f32; 3],
    /// Following error of each axis, micro-radians or micrometres.
    errors: Vec<f32>,
    /// Moving parts of the machine where its joints are measured; none while the position is not known.
    parts: Vec<Part>,
}

/// Last position of a referenced robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known {
    /// Joint angles, rad.
    pub joints_rad: [f32; AXES],
    /// Position of the platform, mm.
    pub platform_mm: [f32; 3],
}

/// A viewer's trigger.
struct Armed {
    capture: SignalCapture,
    caught: Option<(Caught, HistorySnapshot)>,
}

/// The state.
pub struct Hub {
    said: BTreeMap<Topic, Said>,
    version: u64,
    link: LinkView,
    status: Option<Status>,
    /// Console time at which each slave stopped answering, ms.
    silent_ms: Vec<Option<u64>>,
    rows: Rows,
    config: Config,
    history: History,
    log: VecDeque<LogEntry>,
    log_next: u64,
    captures: BTreeMap<ViewerId, Armed>,
    /// Frozen snapshots of the viewers, the oldest first.
    kept: VecDeque<(ViewerId, HistorySnapshot)>,
    stop_wanted: bool,
    /// Last position of joints and platform while the joints were referenced.
    known: Option<Known>,
    /// Viewers, and whether each has shown the token.
    viewers: BTreeMap<ViewerId, bool>,
    viewer_next: ViewerId,
    /// Control.
    pub control: ControlLock,
    /// Drawings.
    pub jobs: Jobs,
}

impl Hub {
    /// A hub for a robot with this configuration at a port.
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
            config: config.clone(),
            history: History::default(),
            log: VecDeque::new(),
            log_next: 0,
            captures: BTreeMap::new(),
            kept: VecDeque::new(),
            stop_wanted: false,
            known: None,
            viewers: BTreeMap::new(),
            viewer_next: 1,
            control: ControlLock::default(),
            jobs: Jobs::new(),
        };
        hub.say(Topic::Link, &link);
        hub.say_control();
        hub.say_jobs();
        hub
    }

    /// Sets a topic; an unchanged text is not a change.
    pub fn say(&mut self, topic: Topic, data: &impl Serialize) {
        let text = section(topic.name(), data);
        if self.said.get(&topic).is_some_and(|said| said.text == text) {
            return;
        }
        self.version += 1;
        let version = self.version;
        self.said.insert(topic, Said { version, text });
    }

    /// Changes since a version, oldest first.
    pub fn news_since(&self, version: u64) -> Vec<(u64, Arc<str>)> {
        let newer = self.said.values().filter(|said| said.version > version);
        let mut newer: Vec<_> = newer.map(|said| (said.version, said.text.clone())).collect();
        newer.sort_by_key(|(version, _)| *version);
        newer
    }

    /// Adds a line to the log.
    pub fn note(&mut self, level: Level, text: impl Into<String>) {
        let text = for_page(&text.into());
        let said = |last: &LogEntry| match level {
            // The firmware's mode and the task's phase often have equal texts.
            Level::Info => last.text == text,
            // A refusal arrives as an event and as an order's answer.
            _ => self.now_ms() <= last.time_ms + SAME_MS && last.text == text,
        };
        if self.log.back().is_some_and(said) {
            return;
        }
        self.log.push_back(LogEntry {
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

    /// Lines of the log from a number on, and the number of the next line.
    pub fn log_since(&self, number: u64) -> (Vec<LogEntry>, u64) {
        let lines = self.log.iter().filter(|line| line.number >= number);
        (lines.cloned().collect(), self.log_next)
    }

    /// Console time, ms.
    pub fn now_ms(&self) -> u64 {
        self.history.last().map_or(0, |row| row.time_ms)
    }

    /// The history of rows.
    pub fn history(&self) -> &History {
        &self.history
    }

    /// The firmware's operating mode.
    pub fn mode(&self) -> Option<Mode> {
        self.status.as_ref().map(|status| status.mode)
    }

    /// The firmware's status.
    pub fn status(&self) -> Option<&Status> {
        self.status.as_ref()
    }

    /// The last position in which the joints were referenced.
    pub fn known(&self) -> Option<Known> {
        self.known
    }

    /// Number of slaves known to the firmware.
    pub fn slaves(&self) -> u8 {
        let slaves = self.status.as_ref().map_or(0, |status| status.slaves.len());
        u8::try_from(slaves).unwrap_or(u8::MAX)
    }

    /// The joints where they were measured last; `None` without a reference.
    pub fn joints_rad(&self) -> Option<[f32; AXES]> {
        let known = self.known.as_ref();
        let is_referenced = self.status.as_ref().is_some_and(|status| status.referenced);
        known.filter(|_| is_referenced).map(|known| known.joints_rad)
    }

    /// Whether there is any viewer.
    pub fn is_watched(&self) -> bool {
        !self.viewers.is_empty()
    }

    /// Position of the robot as text; `None` before the first sample.
    pub fn pose(&self) -> Option<Arc<str>> {
        let row = self.history.last()?;
        Some(section(
            "pose",
            &PoseView {
                time_ms: row.time_ms,
                t_ms: row.t_ms,
                mode: mode_name(row.mode),
                pen_down: row.pen == Pen::Down,
                stroke: row.stroke,
                commanded_mm: row.commanded_mm(),
                measured_mm: row.measured_mm(),
                errors: self.rows.errors(row),
                parts: self.rows.parts(row),
            },
        ))
    }

    /// Takes the firmware's greeting. Returns whether a stop has to be repeated.
    pub fn connected(&mut self, welcome: &Welcome) -> bool {
        self.link.state = "connected";
        self.link.text = "connected".to_owned();
        self.link.firmware = format!("{} {}", welcome.board, welcome.firmware);
        self.say_link();
        self.note(Level::Info, format!("connected to {}", self.link.firmware));
        self.stop_wanted
    }

    /// Handles the loss of the connection, or a failed attempt to connect; a reason that is already shown is not logged
    /// again.
    pub fn lost(&mut self, why: &str) {
        if self.link.state == "lost" && self.link.text == why {
            return;
        }
        self.link.state = "lost";
        self.link.text = for_page(why);
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
        let view = status::view(status, &silent_s)
            .seen_at(
                self.known
                    .filter(|_| status::shows_motion(&self.config))
                    .map(|known| known.platform_mm),
            )
            .with_machine(&self.config, status);
        self.say(Topic::Status, &view);
        self.status = Some(status.clone());
    }

    /// Takes samples, `missing` of which were lost directly before.
    pub fn take_samples(&mut self, missing: u32, samples: &[Sample]) {
        self.link.samples += samples.len() as u64;
        self.link.samples_missing += u64::from(missing);
        for sample in samples {
            let row = self.rows.take(sample);
            self.history.push(row);
            self.jobs.follow(&row);
            if self.status.as_ref().is_some_and(|status| status.referenced) {
                self.known = Some(Known {
                    joints_rad: sample.measured_rad,
                    platform_mm: row.measured_mm(),
                });
            }
            self.step_captures(&row);
        }
    }

    fn step_captures(&mut self, row: &SignalRow) {
        for armed in self.captures.values_mut().filter(|armed| armed.caught.is_none()) {
            if let Some(caught) = armed.capture.step(row) {
                let snapshot = self.history.snapshot().cut(caught.from_ms, caught.to_ms);
                armed.caught = Some((caught, snapshot));
            }
        }
    }

    /// Arms a viewer's trigger, replacing its previous one; returns whether there was room. A viewer with the token may
    /// displace one without.
    pub fn arm(&mut self, viewer: ViewerId, trigger: Trigger) -> bool {
        if self.captures.len() >= ARMED_MAX && !self.captures.contains_key(&viewer) {
            let guest = self.captures.keys().copied().find(|armed| !self.is_trusted(*armed));
            let Some(guest) = guest.filter(|_| self.is_trusted(viewer)) else {
                return false;
            };
            self.captures.remove(&guest);
        }
        let capture = SignalCapture::new(trigger);
        self.captures.insert(viewer, Armed { capture, caught: None });
        true
    }

    /// Keeps a frozen snapshot for a viewer, replacing its previous one; returns whether there was room. The oldest is
    /// displaced, one without the token first.
    pub fn keep(&mut self, viewer: ViewerId, snapshot: HistorySnapshot) -> bool {
        self.forget(viewer);
        if self.kept.len() >= KEPT_MAX {
            let guest = self.kept.iter().position(|(kept, _)| !self.is_trusted(*kept));
            if guest.is_none() && !self.is_trusted(viewer) {
                return false;
            }
            self.kept.remove(guest.unwrap_or(0));
        }
        self.kept.push_back((viewer, snapshot));
        true
    }

    /// A viewer's frozen snapshot, or else the present state.
    pub fn seen_by(&self, viewer: ViewerId) -> HistorySnapshot {
        let kept = self.kept.iter().find(|(kept, _)| *kept == viewer);
        kept.map_or_else(|| self.history.snapshot(), |(_, snapshot)| snapshot.clone())
    }

    /// Removes a viewer's frozen snapshot.
    pub fn forget(&mut self, viewer: ViewerId) {
        self.kept.retain(|(kept, _)| *kept != viewer);
    }

    fn is_trusted(&self, viewer: ViewerId) -> bool {
        self.viewers.get(&viewer).copied().unwrap_or(false)
    }

    /// Disarms a viewer's trigger.
    pub fn disarm(&mut self, viewer: ViewerId) {
        self.captures.remove(&viewer);
    }

    /// The span caught by a viewer's trigger; returned once.
    pub fn take_caught(&mut self, viewer: ViewerId) -> Option<(Caught, HistorySnapshot)> {
        let caught = self.captures.get_mut(&viewer)?.caught.take()?;
        self.captures.remove(&viewer);
        Some(caught)
    }

    /// Whether a viewer's trigger is armed, and whether it has fired.
    pub fn capture_state(&self, viewer: ViewerId) -> Option<bool> {
        self.captures.get(&viewer).map(|armed| armed.capture.has_fired())
    }

    /// Handles a drawing that was activated by `activation` but not started; if that drawing has ended, its end is
    /// known already.
    pub fn refused_drawing(&mut self, activation: u64, why: &str) {
        if self.jobs.activation() == Some(activation) {
            self.note(Level::Warning, format!("the drawing was not begun: {why}"));
            self.jobs.end(false, for_page(why));
            self.say_jobs();
        }
    }

    /// Handles a request for a stop.
    pub fn stop_asked(&mut self, who: &str) {
        // A robot that is stopped by a fault needs no repetition.
        self.stop_wanted = self.mode() != Some(Mode::Fault);
        // One press arrives over two connections.
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

    /// Adds a viewer, if there is room; returns its number, and the viewer that has to leave for it: the oldest one
    /// without the token.
    pub fn enter(&mut self) -> Option<(ViewerId, Option<ViewerId>)> {
        let mut guests = self
            .viewers
            .iter()
            .filter(|(_, trusted)| !**trusted)
            .map(|(viewer, _)| *viewer);
        let oldest = guests.next();
        let guests = guests.count() + usize::from(oldest.is_some());
        let full = self.viewers.len() >= VIEWERS_MAX;
        let leaving = oldest.filter(|_| full || guests >= GUESTS_MAX);
        if full && leaving.is_none() {
            return None;
        }
        if let Some(leaving) = leaving {
            self.viewers.remove(&leaving);
        }
        let viewer = self.viewer_next;
        self.viewer_next += 1;
        self.viewers.insert(viewer, false);
        self.say_control();
        Some((viewer, leaving))
    }

    /// Marks that a viewer has shown the token.
    pub fn trust(&mut self, viewer: ViewerId) {
        if let Some(trusted) = self.viewers.get_mut(&viewer) {
            *trusted = true;
        }
    }

    /// Removes a viewer; returns whether its jog has to stop.
    pub fn leave(&mut self, viewer: ViewerId, now_ms: u64) -> bool {
        self.viewers.remove(&viewer);
        self.captures.remove(&viewer);
        self.forget(viewer);
        let change = self.control.gone(viewer, now_ms);
        self.say_control();
        change == Some(Change::Vanished)
    }

    /// Publishes viewers and control.
    pub fn say_control(&mut self) {
        #[derive(Serialize)]
        struct Control {
            holder: Option<ViewerId>,
            viewers: usize,
        }
        let control = Control {
            holder: self.control.holder(),
            viewers: self.viewers.len(),
        };
        self.say(Topic::Control, &control);
    }

    /// Publishes the connection with its counters.
    pub fn say_link(&mut self) {
        let link = self.link.clone();
        self.say(Topic::Link, &link);
    }

    /// Publishes the drawings.
    pub fn say_jobs(&mut self) {
        let jobs = self.jobs.view();
        self.say(Topic::Jobs, &jobs);
    }
}

#[cfg(test)]
mod tests;
