//! Connects the machine with the hub: news become state, answers to orders become lines of the log.
//!
//! Invariant: only ordered motions are carried out. Without an order, a machine that has just started only gets its
//! configuration and brings up its bus.

use super::hub::{Hub, Level, Topic};
use super::jobs::{Continued, DrawnPart, Unfinished};
use super::page_text::for_page;
use super::status::shows_motion;
use super::{Console, lock};
use crate::error::code;
use crate::job::error::Phase;
use crate::job::is_resolved_by;
use crate::job::{JobEvent, JobReport, Motion, Ready};
use crate::link::text;
use crate::machine::{Answer, DrawOrder, Failure, News, NoNews, OVERTAKEN, Order, Subscription, Ticket};
use etherpen::application::Mode;
use etherpen::messages::Command;
use etherpen::robots::Position;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant};

/// Name of the stop order.
pub(super) const STOP: &str = "STOP";
/// Most news queued.
pub(super) const NEWS_MAX: usize = 4_096;
/// Longest wait for news.
const WAIT: Duration = Duration::from_millis(20);
/// Time within which all news of an ended drawing has arrived.
const SETTLED: Duration = Duration::from_millis(500);
/// Time before the bring-up of a bus is retried after a failure.
const PREPARED_AGAIN: Duration = Duration::from_secs(2);
/// Text for a drawing whose firmware was restarted.
const RESTARTED: &str = "the controller restarted during the drawing, and the robot stopped where it was; the \
                         controller has lost the drawing and the robot's pose";
/// Most orders with pending answers.
const EXPECTED_MAX: usize = 256;

/// Waits for answers to orders.
#[derive(Default)]
pub(super) struct EventPump {
    expected: Mutex<Vec<(&'static str, Receiver<Answer>)>>,
    /// Viewers that have requested stops not yet logged.
    stops: Mutex<Vec<String>>,
    /// Time at which the bring-up of the bus was ordered, and its answer.
    preparing: Mutex<Option<(Instant, Receiver<Answer>)>>,
    /// The drawing in progress, with its activation.
    drawing: Mutex<Option<(u64, Receiver<Answer>)>>,
    /// The activation whose order failed, with reason and time.
    refused: Mutex<Option<(u64, String, Instant)>>,
}

impl EventPump {
    /// Reports the failure of an order once its answer arrives; of too many orders the oldest are dropped.
    pub(super) fn expect(&self, what: &'static str, answer: Receiver<Answer>) {
        let mut expected = lock(&self.expected);
        if expected.len() >= EXPECTED_MAX {
            expected.remove(0);
        }
        expected.push((what, answer));
    }

    /// Logs a stop, from any thread; merges it with an earlier stop of the same viewer that is not logged yet.
    pub(super) fn stop_asked(&self, who: &str, answer: Receiver<Answer>) {
        let mut stops = lock(&self.stops);
        if !stops.iter().any(|other| other == who) {
            stops.push(who.to_owned());
        }
        drop(stops);
        self.expect("STOP", answer);
    }

    /// Whether the bus has to be brought up now: no bring-up is in progress or has just ended.
    fn has_to_prepare(&self) -> bool {
        let mut preparing = lock(&self.preparing);
        let Some((since, answer)) = preparing.as_mut() else {
            return true;
        };
        match answer.try_recv() {
            Err(TryRecvError::Empty) => return false,
            Ok(Err(failure)) => {
                // Reported like any other failed order.
                let (reply, refused) = std::sync::mpsc::channel();
                let _ = reply.send(Err(failure));
                self.expect("bringing up the bus", refused);
            }
            // An answer is taken once; then the channel is closed.
            Ok(Ok(_)) | Err(TryRecvError::Disconnected) => {}
        }
        since.elapsed() > PREPARED_AGAIN
    }

    /// A drawing whose order failed some time ago, with the reason; all its news has arrived by then.
    fn refused_drawing(&self) -> Option<(u64, String)> {
        let (mut drawing, mut refused) = (lock(&self.drawing), lock(&self.refused));
        if let Some((activation, answer)) = drawing.as_ref() {
            match answer.try_recv() {
                Err(TryRecvError::Empty) => {}
                Ok(Err(failure)) => {
                    *refused = Some((*activation, failure.to_string(), Instant::now()));
                    *drawing = None;
                }
                Ok(Ok(_)) | Err(TryRecvError::Disconnected) => *drawing = None,
            }
        }
        let due = refused.take_if(|(_, _, since)| since.elapsed() > SETTLED)?;
        Some((due.0, due.1))
    }

    /// Failures of orders since the last call.
    fn refusals(&self) -> Vec<String> {
        let mut refusals = Vec::new();
        lock(&self.expected).retain(|(what, answer)| match answer.try_recv() {
            Err(TryRecvError::Empty) => true,
            // A stop that was overtaken needs no line: the newer stop does the same.
            Ok(Err(failure)) if *what == STOP && failure.text.contains(OVERTAKEN) => false,
            Ok(Err(failure)) => {
                // A refusal by the firmware already names what was refused.
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

/// Handles the machine's news in a separate thread until the console or the machine has ended.
pub(super) fn pump(console: &Arc<Console>, news: Subscription) {
    let console = Arc::downgrade(console);
    // Without the thread the page shows that no news arrives.
    let _ = std::thread::Builder::new()
        .name("event pump".to_owned())
        .spawn(move || follow(&console, &news));
}

fn follow(console: &Weak<Console>, news: &Subscription) {
    loop {
        let next = news.next_within(WAIT);
        let Some(console) = console.upgrade() else { return };
        for who in std::mem::take(&mut *lock(&console.event_pump.stops)) {
            console.change(|hub| hub.stop_asked(&who));
        }
        match next {
            Ok(next) => take(&console, next),
            Err(NoNews::Timeout) => {}
            Err(NoNews::Closed) => return,
        }
        let lost = news.take_lost();
        if lost > 0 {
            console.change(|hub| hub.note(Level::Warning, format!("this console was too slow for {lost} news")));
        }
        for refusal in console.event_pump.refusals() {
            console.change(|hub| hub.note(Level::Warning, refusal));
        }
        if let Some((activation, why)) = console.event_pump.refused_drawing() {
            console.change(|hub| hub.refused_drawing(activation, &why));
        }
    }
}

fn take(console: &Console, news: News) {
    match news {
        News::Samples { missing, samples } => console.hub().take_samples(missing, &samples),
        News::Status(status) => {
            console.change(|hub| {
                if status.mode == Mode::Startup && !hub.jobs.is_restarted() && hub.jobs.restarted() {
                    hub.note(Level::Error, RESTARTED);
                }
                hub.take_status(&status);
            });
            console.keep_touches(&status);
            console.keep_axes(&status);
            let is_new = status.mode == Mode::Startup || is_resolved_by(&console.config, &status, false);
            if is_new && console.event_pump.has_to_prepare() {
                let answer = console.machine.order(Order::Prepare(Ready::Bus));
                *lock(&console.event_pump.preparing) = Some((Instant::now(), answer));
            }
        }
        News::Progress(progress) => console.change(|hub| {
            if let Some(view) = hub.jobs.progress(&progress) {
                hub.say(Topic::Progress, &view);
            }
        }),
        News::Connected(welcome) => {
            if console.change(|hub| hub.connected(&welcome)) {
                console.order(console.ticket(), STOP, Order::Stop);
            }
        }
        News::Lost(failure) => console.change(|hub| hub.lost(&failure.text)),
        News::Reconnecting { .. } | News::Begun { .. } => {}
        News::Job(event) => console.change(|hub| take_event(hub, event)),
        News::Ended { result, report } => {
            if let Some(report) = report {
                end_drawing(console, &result, &report);
            }
        }
    }
}

/// Takes the end of a drawing, or of its layer.
fn end_drawing(console: &Console, result: &Result<(), Failure>, report: &JobReport) {
    let pauses = console.change(|hub| {
        // In a pause nothing is drawn: the drawing that ended is another program's.
        if hub.jobs.is_paused() {
            return false;
        }
        if result.is_ok()
            && let Some(DrawnPart::Pause(pause)) = hub.jobs.drawn()
        {
            let (layer, number, layers) = (&pause.layer, pause.number, pause.layers);
            hub.note(
                Level::Info,
                format!("change the pen for layer {layer} ({number} of {layers})"),
            );
            hub.say_jobs();
            return true;
        }
        let is_incomplete = result.as_ref().is_err_and(|failure| failure.code == code::INCOMPLETE);
        if is_incomplete || report.progress.missing_from().is_some() {
            hub.jobs.found_missing(report.progress.complete);
        }
        let text = match result {
            Ok(()) => "drawn".to_owned(),
            Err(_) if hub.jobs.is_restarted() => RESTARTED.to_owned(),
            Err(failure) => failure.text.clone(),
        };
        match result {
            Ok(()) => hub.note(Level::Info, "the drawing is done"),
            Err(_) => hub.note(Level::Warning, format!("the drawing ended early: {text}")),
        }
        hub.jobs.end(result.is_ok(), for_page(&text));
        hub.say_jobs();
        false
    });
    if let Some(position) = console.pen_change.filter(|_| pauses) {
        let order = Order::Motion(Motion::Move(position));
        console.order(console.ticket(), "moving to the place for changing the pen", order);
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
        // The status reports modes and faults.
        _ => {}
    }
}

fn is_referenced(hub: &Hub) -> Result<(), &'static str> {
    match hub.status().is_some_and(|status| status.referenced) {
        true => Ok(()),
        false => Err("the controller does not know the robot's pose; home the robot, then continue"),
    }
}

impl Console {
    /// Starts a waiting drawing; returns whether that was possible.
    pub(super) fn draw(&self, heard: Ticket, number: u64) -> bool {
        let drawing = self.change(|hub| {
            let drawing = hub.jobs.start(number, &self.config).zip(hub.jobs.activation());
            hub.say_jobs();
            drawing
        });
        let Some(((name, path), activation)) = drawing else {
            return false;
        };
        self.order_drawing(heard, activation, name, crate::job::DrawTask::new(path));
        true
    }

    /// Continues an unfinished drawing; one that was left in a pause pauses again.
    ///
    /// # Errors
    /// Why it cannot continue now, as text for display.
    pub(super) fn go_on(&self, heard: Ticket, number: u64) -> Result<(), &'static str> {
        let continued = self.change(|hub| {
            is_referenced(hub)?;
            let continued = hub.jobs.go_on(number, &self.config);
            hub.say_jobs();
            continued.map(|continued| (continued, hub.jobs.activation().unwrap_or_default()))
        });
        match continued? {
            (Continued::Path(unfinished), activation) => self.order_rest(heard, activation, unfinished),
            (Continued::Pause, _) => {}
        }
        Ok(())
    }

    /// Draws the next layer of a drawing: its pen is in place.
    ///
    /// # Errors
    /// Why it cannot be drawn now, as text for display; the drawing still pauses.
    pub(super) fn pen_is_in(&self, heard: Ticket, number: u64) -> Result<(), &'static str> {
        let layer = self.change(|hub| {
            is_referenced(hub)?;
            let resting = [Mode::DrivesOff, Mode::Idle];
            if !hub.mode().is_some_and(|mode| resting.contains(&mode)) {
                return Err("the robot is not at rest; acknowledge a fault first, and wait until the robot is at rest");
            }
            let layer = hub.jobs.pen_is_in(number, &self.config);
            hub.say_jobs();
            layer.map(|layer| (layer, hub.jobs.activation().unwrap_or_default()))
        });
        let (layer, activation) = layer?;
        self.order_rest(heard, activation, layer);
        Ok(())
    }

    /// Ends the drawing that waits for a pen; returns whether there was one.
    pub(super) fn end_in_pause(&self) -> bool {
        self.change(|hub| {
            let pauses = hub.jobs.is_paused();
            if pauses {
                hub.note(Level::Info, "the drawing was ended while it waited for a pen");
                hub.jobs.end(false, "ended while it waited for a pen");
                hub.say_jobs();
            }
            pauses
        })
    }

    /// Whether the robot moves outside of a drawing.
    pub(super) fn is_moving(&self) -> bool {
        self.hub().mode() == Some(Mode::Moving)
    }

    fn order_rest(&self, heard: Ticket, activation: u64, rest: Unfinished) {
        let drawing = crate::job::DrawTask {
            may_reference: rest.is_whole,
            ..crate::job::DrawTask::new(rest.path)
        };
        self.order_drawing(heard, activation, rest.name, drawing);
    }

    fn order_drawing(&self, heard: Ticket, activation: u64, name: String, drawing: crate::job::DrawTask) {
        let order = DrawOrder {
            drawing,
            name,
            keep_samples: false,
        };
        let answer = self.machine.order_for(heard, Order::Draw(order));
        *lock(&self.event_pump.drawing) = Some((activation, answer));
    }

    /// The reference at the last pose in which the joints were referenced; the firmware checks it against its encoders
    /// and against the last position of the platform. `None` where an encoder knows nothing that it could be checked against.
    pub(super) fn reference_here(&self) -> Option<Command> {
        let hub = self.hub();
        let (known, status) = (hub.known().filter(|_| shows_motion(&self.config))?, hub.status()?);
        let increments = crate::job::reference::all(&status.increments)?;
        let [x_mm, y_mm, z_mm] = known.platform_mm.map(f64::from);
        let wanted = crate::job::reference::Wanted {
            pose: crate::job::reference::Pose::Seen(known.joints_rad.map(f64::from)),
            position: Some(Position { x_mm, y_mm, z_mm }),
            calibrate: false,
        };
        Some(wanted.command(&self.config, &increments))
    }

    /// Jogs; if the machine cannot, its mode shows why.
    pub(super) fn jog(&self, heard: Ticket, velocity_mm_s: [f32; 3]) {
        drop(self.machine.order_for(heard, Order::Jog(velocity_mm_s)));
    }
}
