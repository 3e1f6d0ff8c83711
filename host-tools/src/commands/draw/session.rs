//! One drawing on the machine: shown, controlled from the keyboard, and logged.

use crate::commands::display::Display;
use crate::commands::operator::{Key, Operator};
use crate::error::ProgramError;
use crate::job::error::Phase;
use crate::job::over_port::Show;
use crate::job::progress::{PathMeasure, Progress};
use crate::job::resume::ResumePlan;
use crate::job::{JobEvent, JobReport};
use crate::machine::{DrawOrder, Failure, Machine, News, NoNews, Order, Subscription};
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::messages::PathVertex;
use std::io::IsTerminal;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Most news queued while files are written; telemetry makes several hundred a second.
const NEWS_MAX: usize = 10_000;
/// Time between two checks of the keyboard.
const LOOK: Duration = Duration::from_millis(20);
/// Time between two updates of the log.
const LOG: Duration = Duration::from_millis(200);

/// How a drawing ended.
pub(super) struct Ended {
    /// The result.
    pub(super) result: Result<(), Failure>,
    /// Shared with whoever else listens to the machine; empty for a drawing that was refused.
    pub(super) report: Arc<JobReport>,
}

/// One drawing on the machine: what is shown, what is asked for and what is logged.
pub(super) struct DrawingSession<'a> {
    machine: &'a Machine,
    news: Subscription,
    measure: PathMeasure,
    plan: ResumePlan,
    display: Display,
    operator: &'a mut Operator,
    begun: bool,
    lost: bool,
    logged: Instant,
}

impl<'a> DrawingSession<'a> {
    /// A session that listens to the machine from now on.
    pub(super) fn new(
        machine: &'a Machine,
        config: &Config,
        path: &[PathVertex],
        plan: ResumePlan,
        operator: &'a mut Operator,
        json: bool,
    ) -> Self {
        Self {
            machine,
            news: machine.subscribe(NEWS_MAX),
            measure: PathMeasure::new(path, config),
            plan,
            display: if json { Display::lines_of_json() } else { Display::new() },
            operator,
            begun: false,
            lost: false,
            logged: Instant::now(),
        }
    }

    /// Draws, and returns when the drawing has ended.
    pub(super) fn draw(&mut self, name: &str) -> Result<Ended, ProgramError> {
        let order = Order::Draw(DrawOrder {
            drawing: self.plan.drawing.clone(),
            name: name.to_owned(),
            keep_samples: true,
        });
        if let Some(record) = &mut self.plan.record {
            record.entry.number = self.plan.drawing.number;
            record.entry.result = None;
            // A log that cannot be written any more does not keep the drawing from being drawn.
            let _ = record.save();
        }
        let answer = self.machine.order(order);
        let ended = loop {
            while let Some(key) = self.operator.next_key() {
                self.press(key);
            }
            match self.news.next_within(LOOK) {
                Ok(News::Ended { result, report }) => {
                    let report = report.unwrap_or_default();
                    break Ended { result, report };
                }
                Ok(news) => self.take(&news),
                // The drawing's end comes as news before it is the order's answer; an order that was refused has no end.
                Err(NoNews::Timeout) => {
                    if let Ok(Err(failure)) = answer.try_recv() {
                        let (result, report) = (Err(failure), Arc::default());
                        break Ended { result, report };
                    }
                }
                Err(NoNews::Closed) => return Err(ProgramError::failed("drawing", "the machine's thread has ended")),
            }
        };
        self.display.finish();
        self.log_end(&ended);
        Ok(ended)
    }

    fn take(&mut self, news: &News) {
        match news {
            News::Job(event) => {
                self.begun |= *event == JobEvent::Phase(Phase::Drawing);
                self.display.show(&Show::Event(event));
            }
            News::Connected(welcome) => {
                if let Some(record) = &mut self.plan.record {
                    record.entry.board = format!("{} {}", welcome.board, welcome.firmware);
                }
                self.display.show(&Show::Event(&JobEvent::Connected(welcome.clone())));
            }
            News::Progress(progress) => {
                let whole = self.whole(progress);
                self.display.show(&Show::Progress(&whole));
                self.log(&whole);
            }
            News::Status(status) if self.lost && status.mode == Mode::Holding => {
                self.lost = false;
                self.display
                    .say("connected again, the drawing is held: Enter goes on with it, Ctrl-C ends it");
            }
            News::Lost(failure) => self.lose(failure),
            News::Reconnecting { .. }
            | News::Status(_)
            | News::Samples { .. }
            | News::Begun { .. }
            | News::Ended { .. } => {}
        }
    }

    /// Progress of the whole path, from that of the part that the firmware was given.
    fn whole(&self, progress: &Progress) -> Progress {
        let executed = self.plan.executed(progress.vertices);
        let before = self.plan.executed(0);
        let number = |vertices: usize| u32::try_from(vertices).unwrap_or(u32::MAX);
        Progress {
            left_s: progress.left_s,
            ..self
                .measure
                .progress(number(before), number(executed), progress.elapsed_s)
        }
    }

    fn lose(&mut self, failure: &Failure) {
        if self.lost || !self.machine.snapshot().interrupted {
            return;
        }
        self.lost = true;
        self.display.say(&format!("CONNECTION LOST: {failure}"));
        if std::io::stdin().is_terminal() {
            self.display
                .say("the robot holds by itself; trying to connect every second, Ctrl-C gives up");
        } else {
            self.display
                .say("the robot holds by itself; `etherpen draw --resume` goes on with this drawing");
            self.ask(Order::Cancel);
        }
    }

    /// Gives an order whose refusal is shown as news, and whose effect is.
    fn ask(&self, order: Order) {
        drop(self.machine.order(order));
    }

    fn press(&mut self, key: Key) {
        match key {
            Key::Interrupt if self.begun && !self.lost && !self.operator.held => {
                self.operator.held = true;
                self.ask(Order::Hold);
            }
            Key::Interrupt | Key::Terminate => {
                let what = if self.begun {
                    "ending the drawing"
                } else {
                    "ended before anything was drawn"
                };
                self.display.say(what);
                self.ask(Order::Cancel);
            }
            Key::Enter => {
                let snapshot = self.machine.snapshot();
                let holding = snapshot.status.is_some_and(|status| status.mode == Mode::Holding);
                if holding || snapshot.interrupted {
                    self.operator.held = false;
                    self.ask(Order::Resume);
                } else {
                    self.operator.note_early_enter();
                }
            }
        }
    }

    fn log(&mut self, progress: &Progress) {
        let Some(record) = &mut self.plan.record else { return };
        record.entry.progress(progress);
        record.entry.drawn_s = self.plan.drawn_before_s + progress.elapsed_s;
        if self.logged.elapsed() >= LOG {
            self.logged = Instant::now();
            // A log that cannot be written any more does not end the drawing.
            let _ = record.save_unsynced();
        }
    }

    fn log_end(&mut self, ended: &Ended) {
        let whole = self.whole(&ended.report.progress);
        let Some(record) = &mut self.plan.record else { return };
        record.entry.completed = ended.result.is_ok();
        record.entry.result = Some(match &ended.result {
            Ok(()) => "drawn".to_owned(),
            Err(failure) => failure.text.clone(),
        });
        if ended.report.progress.vertices_total > 0 {
            record.entry.progress(&whole);
        }
        record.entry.drawn_s = self.plan.drawn_before_s + ended.report.drawn_s;
        if let Err(cause) = record.save() {
            eprintln!("the log of jobs cannot be written: {cause}");
        }
    }
}
