//! Between the machine and the hub: news become state, answers to orders become lines of the log.
//!
//! Invariant: nothing moves that nobody ordered; unasked, a machine that has just started is given its configuration and
//! brings up its bus.

use super::hub::{Hub, Level, Topic};
use super::words::on_page;
use super::{Console, lock};
use crate::link::error::Phase;
use crate::link::job::{JobEvent, Ready};
use crate::link::text;
use crate::machine::{Answer, DrawOrder, News, NoNews, Order, Subscription};
use etherpen::application::Mode;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant};

/// What the order of a stop is called.
pub(super) const STOP: &str = "STOP";
/// News that may wait.
pub(super) const NEWS_MAX: usize = 4_096;
/// Longest wait for news.
const WAIT: Duration = Duration::from_millis(20);
/// Time in which all news of a drawing that has ended have come.
const SETTLED: Duration = Duration::from_millis(500);
/// Orders whose answers are waited for.
const EXPECTED_MAX: usize = 256;

/// Answers that are waited for.
#[derive(Default)]
pub(super) struct Attendant {
    expected: Mutex<Vec<(&'static str, Receiver<Answer>)>>,
    /// The drawing that was ordered, with its number.
    drawing: Mutex<Option<(u64, Receiver<Answer>)>>,
    /// The drawing whose order failed, why and when.
    refused: Mutex<Option<(u64, String, Instant)>>,
}

impl Attendant {
    /// Tells how an order ended if it failed; of too many the oldest are forgotten.
    pub(super) fn expect(&self, what: &'static str, answer: Receiver<Answer>) {
        let mut expected = lock(&self.expected);
        if expected.len() >= EXPECTED_MAX {
            expected.remove(0);
        }
        expected.push((what, answer));
    }

    /// A drawing whose order failed a while ago, and why: news of one that began and ended have come by then.
    fn refused_drawing(&self) -> Option<(u64, String)> {
        let (mut drawing, mut refused) = (lock(&self.drawing), lock(&self.refused));
        if let Some((number, answer)) = drawing.as_ref() {
            match answer.try_recv() {
                Err(TryRecvError::Empty) => {}
                Ok(Err(failure)) => {
                    *refused = Some((*number, failure.to_string(), Instant::now()));
                    *drawing = None;
                }
                Ok(Ok(_)) | Err(TryRecvError::Disconnected) => *drawing = None,
            }
        }
        let due = refused.take_if(|(_, _, since)| since.elapsed() > SETTLED)?;
        Some((due.0, due.1))
    }

    /// What was not carried out since the last call.
    fn refusals(&self) -> Vec<String> {
        let mut refusals = Vec::new();
        lock(&self.expected).retain(|(what, answer)| match answer.try_recv() {
            Err(TryRecvError::Empty) => true,
            // One press comes by two ways; the other stop does the same.
            Ok(Err(failure)) if *what == STOP && failure.text.contains("a stop has overtaken it") => false,
            Ok(Err(failure)) => {
                // What the firmware has refused says what it was.
                let says_what = failure.text.contains("was refused");
                refusals.push(if says_what {
                    failure.text
                } else {
                    format!("{what}: {failure}")
                });
                false
            }
            Ok(Ok(_)) | Err(TryRecvError::Disconnected) => false,
        });
        refusals
    }
}

/// Takes the machine's news in a thread of its own until the console or the machine is gone.
pub(super) fn attend(console: &Arc<Console>, news: Subscription) {
    let console = Arc::downgrade(console);
    // Without the thread the page shows that there is no news.
    let _ = std::thread::Builder::new()
        .name("attendant".to_owned())
        .spawn(move || follow(&console, &news));
}

fn follow(console: &Weak<Console>, news: &Subscription) {
    loop {
        let next = news.next_within(WAIT);
        let Some(console) = console.upgrade() else { return };
        match next {
            Ok(next) => take(&console, next),
            Err(NoNews::Timeout) => {}
            Err(NoNews::Closed) => return,
        }
        let lost = news.take_lost();
        if lost > 0 {
            console.change(|hub| hub.note(Level::Warning, format!("this console was too slow for {lost} news")));
        }
        for refusal in console.attendant.refusals() {
            console.change(|hub| hub.note(Level::Warning, refusal));
        }
        if let Some((number, why)) = console.attendant.refused_drawing() {
            console.change(|hub| hub.refused_drawing(number, &why));
        }
    }
}

fn take(console: &Console, news: News) {
    match news {
        News::Samples { missing, samples } => console.hub().take_samples(missing, &samples),
        News::Status(status) => {
            let begins = status.mode == Mode::Startup && console.hub().mode() != Some(Mode::Startup);
            console.change(|hub| hub.take_status(&status));
            if begins {
                console.order("bringing up the bus", Order::Prepare(Ready::Bus));
            }
        }
        News::Progress(progress) => console.change(|hub| {
            if let Some(view) = hub.jobs.progress(&progress) {
                hub.say(Topic::Progress, &view);
            }
        }),
        News::Connected(welcome) => {
            if console.change(|hub| hub.connected(&welcome)) {
                console.order(STOP, Order::Stop);
            }
        }
        News::Lost(failure) => console.change(|hub| hub.lost(&failure.text)),
        News::Reconnecting { .. } | News::Begun { .. } => {}
        News::Job(event) => console.change(|hub| take_event(hub, event)),
        News::Ended { result, report } => {
            if report.is_some() {
                console.change(|hub| {
                    match &result {
                        Ok(()) => hub.note(Level::Info, "the drawing is done"),
                        Err(failure) => hub.note(Level::Warning, format!("the drawing ended early: {failure}")),
                    }
                    let text = result
                        .as_ref()
                        .map_or_else(ToString::to_string, |()| "drawn".to_owned());
                    hub.jobs.end(result.is_ok(), on_page(&text));
                    hub.say_jobs();
                });
            }
        }
    }
}

fn take_event(hub: &mut Hub, event: JobEvent) {
    match event {
        JobEvent::Phase(phase) => {
            if !matches!(phase, Phase::Connecting | Phase::Inspecting) {
                hub.note(Level::Info, phase.to_string());
            }
            hub.jobs.phase(phase.to_string());
            hub.say_jobs();
        }
        JobEvent::Refused(command, refusal) => {
            let line = format!("{} was refused: {}", text::command(&command), text::refusal(&refusal));
            hub.note(Level::Warning, line);
        }
        JobEvent::SamplesMissing { missing, t_ms } => {
            let line = format!("{missing} samples of the telemetry were lost before t = {t_ms} ms");
            hub.note(Level::Warning, line);
        }
        // Modes and faults are told by the status.
        _ => {}
    }
}

impl Console {
    /// Begins with a waiting drawing; gives whether it could.
    pub(super) fn draw(&self, number: u64) -> bool {
        let drawing = self.change(|hub| {
            let drawing = hub.jobs.start(number);
            hub.say_jobs();
            drawing
        });
        let Some((name, path)) = drawing else { return false };
        let order = DrawOrder {
            drawing: crate::link::job::Drawing::new(path),
            name,
            keep_samples: false,
        };
        *lock(&self.attendant.drawing) = Some((number, self.machine.order(Order::Draw(order))));
        true
    }

    /// Jogs; a machine that does not want to says so by its mode.
    pub(super) fn jog(&self, velocity_mm_s: [f32; 3]) {
        drop(self.machine.order(Order::Jog(velocity_mm_s)));
    }
}
