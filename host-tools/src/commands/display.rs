//! Shows progress and events of a job: a bar with the remaining time on a terminal, plain lines elsewhere.

use crate::job::over_port::Show;
use crate::job::progress::Progress;
use crate::job::{Job, JobEvent};
use crate::link::text;
use etherpen::application::Mode;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use std::io::IsTerminal;

/// Shows the progress of a job.
pub(super) struct Display {
    bar: Option<ProgressBar>,
    said_percent: u64,
    /// Whether progress is printed as lines of JSON.
    json: bool,
}

/// Progress of a drawing as a line of JSON.
#[derive(Serialize)]
struct ProgressLine<'a> {
    event: &'static str,
    #[serde(flatten)]
    progress: &'a Progress,
}

/// Parts into which the bar is divided.
const PARTS: u64 = 1_000;
/// Percent between two plain lines.
const LINE_PERCENT: u64 = 10;

impl Default for Display {
    fn default() -> Self {
        Self::new()
    }
}

impl Display {
    /// A display on stderr.
    pub(super) fn new() -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let template = "{bar:32} {percent:>3} %  {msg}";
            let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
            ProgressBar::new(PARTS).with_style(style)
        });
        Self {
            bar,
            said_percent: 0,
            json: false,
        }
    }

    /// A display on stderr for programs: progress as lines of JSON.
    pub(super) fn lines_of_json() -> Self {
        Self {
            bar: None,
            said_percent: 0,
            json: true,
        }
    }

    /// Prints a line above the bar.
    pub(super) fn say(&self, line: &str) {
        match &self.bar {
            Some(bar) => bar.suspend(|| eprintln!("{line}")),
            None => eprintln!("{line}"),
        }
    }

    /// Shows the events since the last call, and the progress of the drawing.
    pub(super) fn update(&mut self, job: &mut Job) {
        while let Some(event) = job.next_event() {
            self.show(&Show::Event(&event));
        }
        self.show(&Show::Progress(&job.progress()));
    }

    /// Shows one event.
    pub(super) fn show(&mut self, show: &Show) {
        match show {
            Show::Event(event) => {
                if let Some(line) = event_text(event) {
                    self.say(&line);
                }
            }
            Show::Progress(progress) if progress.executed_mm > 0.0 => self.advance(progress),
            Show::Progress(_) => {}
        }
    }

    fn advance(&mut self, progress: &Progress) {
        if self.json {
            let event = "progress";
            if let Ok(line) = serde_json::to_string(&ProgressLine { event, progress }) {
                eprintln!("{line}");
            }
            return;
        }
        let share = progress.executed_mm / progress.total_mm.max(f64::MIN_POSITIVE);
        let message = format!(
            "stroke {}/{}, {:.0} s drawn, {:.0} s left",
            progress.strokes, progress.strokes_total, progress.elapsed_s, progress.left_s
        );
        let percent = (share * 100.0) as u64;
        match &self.bar {
            Some(bar) => {
                bar.set_position((share * PARTS as f64) as u64);
                bar.set_message(message);
            }
            None if percent >= self.said_percent + LINE_PERCENT => {
                self.said_percent = percent - percent % LINE_PERCENT;
                eprintln!("{percent:>3} %  {message}");
            }
            None => {}
        }
    }

    /// Removes the bar.
    pub(super) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

fn event_text(event: &JobEvent) -> Option<String> {
    match event {
        JobEvent::Connected(welcome) => {
            let mut line = format!("connected: firmware {} on board {}", welcome.firmware, welcome.board);
            if let Some(previous) = text::previous_run(&welcome.previous) {
                line.push('\n');
                line.push_str(&previous);
            }
            Some(line)
        }
        JobEvent::Port(port) => Some(text::bus::port_state(*port).to_owned()),
        JobEvent::Phase(phase) => Some(format!("{phase}")),
        JobEvent::Fault(fault) => Some(format!("FAULT: {}", text::fault(fault))),
        JobEvent::Refused(command, refusal) => Some(format!(
            "{} was refused: {}",
            text::command(command),
            text::refusal(refusal)
        )),
        JobEvent::SamplesMissing { missing, t_ms } => {
            Some(format!("{missing} telemetry samples were lost before t = {t_ms} ms"))
        }
        JobEvent::Mode(Mode::Holding) => Some("the robot holds; Enter resumes, Ctrl-C cancels".to_owned()),
        JobEvent::Mode(_)
        | JobEvent::Status(_)
        | JobEvent::Samples { .. }
        | JobEvent::Told { .. }
        | JobEvent::Bus(_)
        | JobEvent::Measured(_) => None,
    }
}
