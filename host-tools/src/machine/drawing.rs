//! One drawing on a machine: its order, its progress along the complete path, and its entry in the job log.
//!
//! A drawing outlives a broken connection: the robot holds by itself, and the machine reconnects. Progress refers to
//! the complete path, even if only its remainder was sent to the firmware.

use super::{DrawOrder, Failure, Machine, News, NoNews, Order, Subscription};
use crate::error::ProgramError;
use crate::job::error::Phase;
use crate::job::logged::Logged;
use crate::job::progress::Progress;
use crate::job::resume::ResumePlan;
use crate::job::{JobEvent, JobReport};
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::messages::PathVertex;
use std::io;
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

/// Most news queued while files are written; telemetry makes several hundred a second.
const NEWS_MAX: usize = 10_000;

/// How a drawing ended.
pub struct DrawingEnd {
    /// The result.
    pub result: Result<(), Failure>,
    /// Report, shared with the machine's other subscribers; empty for a drawing that was refused.
    pub report: Arc<JobReport>,
}

/// An event of a drawing.
#[allow(clippy::large_enum_variant)] // one is alive at a time
pub enum DrawingNews {
    /// Something to show.
    Event(JobEvent),
    /// Progress along the complete path.
    Progress(Progress),
    /// The connection broke; the robot holds by itself.
    Lost(Failure),
    /// The machine has reconnected, and the drawing is held.
    Reconnected,
    /// The drawing has ended.
    Ended(DrawingEnd),
}

/// One drawing on a machine.
pub struct DrawingRun<'a> {
    machine: &'a Machine,
    news: Subscription,
    answer: Receiver<super::Answer>,
    logged: Logged,
    /// When it was ordered.
    since: Instant,
    begun: bool,
    lost: bool,
}

impl<'a> DrawingRun<'a> {
    /// Orders the drawing of `plan`, which is `path` or its remainder, and creates its log entry.
    pub fn begin(machine: &'a Machine, config: &Config, path: &[PathVertex], plan: ResumePlan, name: &str) -> Self {
        let news = machine.subscribe(NEWS_MAX);
        let order = Order::Draw(DrawOrder {
            drawing: plan.drawing.clone(),
            name: name.to_owned(),
            keep_samples: true,
        });
        let mut logged = Logged::begin(config, path, plan);
        if let Some(welcome) = &machine.snapshot().welcome {
            logged.connected(welcome);
        }
        Self {
            machine,
            news,
            answer: machine.order(order),
            logged,
            since: Instant::now(),
            begun: false,
            lost: false,
        }
    }

    /// The next event of the drawing; `None` if nothing happens within `longest`.
    ///
    /// # Errors
    /// The machine's thread has ended.
    pub fn next_within(&mut self, longest: Duration) -> Result<Option<DrawingNews>, ProgramError> {
        match self.news.next_within(longest) {
            Ok(news) => Ok(self.take(news)),
            // The end of a drawing is published before its order is answered; a refused order has no end.
            Err(NoNews::Timeout) => Ok(match self.answer.try_recv() {
                Ok(Err(failure)) => Some(DrawingNews::Ended(DrawingEnd {
                    result: Err(failure),
                    report: Arc::default(),
                })),
                _ => None,
            }),
            Err(NoNews::Closed) => Err(ProgramError::failed("drawing", "the machine's thread has ended")),
        }
    }

    fn take(&mut self, news: News) -> Option<DrawingNews> {
        match news {
            News::Job(event) => {
                if event == JobEvent::Phase(Phase::Drawing) {
                    self.begun = true;
                    self.logged.draws();
                }
                Some(DrawingNews::Event(event))
            }
            News::Connected(welcome) => {
                self.logged.connected(&welcome);
                Some(DrawingNews::Event(JobEvent::Connected(welcome)))
            }
            News::Progress(progress) => {
                let whole = self.logged.whole(&progress);
                self.logged.advance(&whole, self.since.elapsed());
                Some(DrawingNews::Progress(whole))
            }
            News::Status(status) if self.lost && status.mode == Mode::Holding => {
                self.lost = false;
                Some(DrawingNews::Reconnected)
            }
            News::Lost(failure) if !self.lost && self.machine.snapshot().interrupted => {
                self.lost = true;
                Some(DrawingNews::Lost(failure))
            }
            News::Ended { result, report } => Some(DrawingNews::Ended(DrawingEnd {
                result,
                report: report.unwrap_or_default(),
            })),
            News::Lost(_) | News::Reconnecting { .. } | News::Status(_) | News::Samples { .. } | News::Begun { .. } => {
                None
            }
        }
    }

    /// Whether the pen has started to draw.
    pub fn has_begun(&self) -> bool {
        self.begun
    }

    /// Whether the connection broke and no new connection holds the drawing yet.
    pub fn is_lost(&self) -> bool {
        self.lost
    }

    /// Holds the drawing.
    pub fn hold(&self) {
        self.ask(Order::Hold);
    }

    /// Ends the drawing.
    pub fn cancel(&self) {
        self.ask(Order::Cancel);
    }

    /// Resumes the drawing. Returns false, and does nothing, if it is not held.
    pub fn resume(&self) -> bool {
        let snapshot = self.machine.snapshot();
        let is_holding = snapshot.status.is_some_and(|status| status.mode == Mode::Holding);
        let may_resume = is_holding || snapshot.interrupted;
        if may_resume {
            self.ask(Order::Resume);
        }
        may_resume
    }

    /// Sends an order. Its effect or its refusal arrives as news.
    fn ask(&self, order: Order) {
        drop(self.machine.order(order));
    }

    /// Writes the end of the drawing to the job log.
    ///
    /// # Errors
    /// The log cannot be written.
    pub fn log_end(&mut self, end: &DrawingEnd) -> io::Result<()> {
        let result = end.result.as_ref().map(|_| ()).map_err(|failure| failure.text.as_str());
        self.logged.end(result, &end.report)
    }
}
