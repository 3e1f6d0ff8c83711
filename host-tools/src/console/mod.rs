//! The operator's console: shows and controls the machine in a browser on this computer.
//!
//! One thread takes the machine's news into the [`hub`]. In the [`server`] the thread `stop` reads all connections,
//! finds the stops and passes them to the machine; it puts everything else into an inbox, from which the thread
//! `viewers` serves it. Every `viewer` takes from the hub as much as its connection can carry; its pictures are
//! computed in a third thread. Orders go directly to the machine.
//!
//! Invariants: a stop waits for no request, lock or computation of any viewer. No request starts while a stop is on its
//! way to the port ([`gate`]), and no order requested before a stop is carried out after it. Requests take a bounded
//! amount of memory, whatever viewers send. Only the viewer that holds control commands; a slow viewer slows down
//! nobody else; nothing that is kept grows with time.

mod assets;
mod axes_check;
pub mod capture;
pub mod control;
mod event_pump;
pub mod gate;
pub mod history;
pub mod hub;
pub mod jobs;
pub mod layers;
mod line_errors;
mod measuring;
pub mod messages;
mod page_text;
pub mod preparation;
pub mod server;
pub mod sheet;
pub mod signals;
pub mod skeleton;
pub mod status;
mod variants;
mod viewer;
pub mod virtual_cell;

use crate::axes::axes;
use crate::link::port::{PortError, PortName};
use crate::machine::{Machine, MachineOptions, Order, Ticket};
use axum::body::Bytes;
use etherpen::config::Config;
use etherpen::robots::Position;
use event_pump::EventPump;
use gate::Gate;
use hub::{Hub, Level, Topic};
use jobs::PreparedDrawing;
use messages::Injection;
use preparation::{Made, PageOptions, PhotographView, PreparationView};
use serde::Serialize;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use tokio::sync::watch;
use virtual_cell::VirtualCell;

/// Constant data of a console session.
#[derive(Clone, Debug, Serialize)]
struct RobotView<'a> {
    version: &'static str,
    port: String,
    /// Kind of machine, as configuration files name it.
    kind: &'static str,
    /// Parts that stand still.
    parts: Vec<skeleton::Part>,
    /// Lowest and highest x, y and z of the drawing of the machine, mm.
    bounds_mm: [[f64; 2]; 3],
    axes: Vec<AxisLabel>,
    paper: &'a etherpen::config::Paper,
    work_area: &'a etherpen::config::WorkVolume,
    signals: Vec<signals::PlotSignal>,
    /// Styles available for photographs.
    styles: Vec<String>,
    /// What can be drawn of a photograph's background.
    backgrounds: Vec<String>,
}

/// An axis as shown on the page.
#[derive(Clone, Debug, Serialize)]
struct AxisLabel {
    name: String,
    /// Unit of its following error.
    error_unit: &'static str,
}

/// The virtual segment as shown on the page.
#[derive(Debug, Serialize)]
struct SegmentView {
    /// `simulated`, `emulated`, or nothing for real hardware.
    kind: Option<&'static str>,
    /// Unplugged slaves.
    removed: Vec<usize>,
    failure: Option<String>,
}

/// Most files prepared at once: the requested one, and an earlier one.
const PREPARATIONS_MAX: usize = 2;

/// A file dropped on a page.
struct Source {
    /// Number of its first preparation, and of its picture.
    number: u64,
    name: String,
    content: Vec<u8>,
}

/// A file with the options requested for it.
#[derive(Clone)]
struct Preparation {
    source: Arc<Source>,
    wishes: PageOptions,
}

/// The drawing being prepared.
#[derive(Default)]
struct Preview {
    /// Number of the last preparation requested; the results of older ones are dropped.
    number: u64,
    /// The last preparation requested, until it is queued.
    wanted: Option<Preparation>,
    /// Number of the newest preparation started.
    begun: u64,
    /// Number of threads that are preparing.
    running: usize,
    made: Option<Made>,
    /// The photograph, once it is known, and its picture.
    photograph: Option<(PhotographView, Bytes)>,
}

impl Preview {
    /// The preparation that is requested but not started, with its number.
    fn next(&mut self) -> Option<(u64, Preparation)> {
        let wanted = self.wanted.clone().filter(|_| self.begun < self.number)?;
        self.begun = self.number;
        Some((self.number, wanted))
    }

    /// A view of the last preparation requested.
    fn view(&self) -> PreparationView {
        let photograph = self.photograph.as_ref().map(|(view, _)| *view);
        self.wanted.as_ref().map_or_else(PreparationView::idle, |wanted| {
            PreparationView::working(self.number, &wanted.source.name, &wanted.wishes, photograph)
        })
    }

    /// Takes the result of the last preparation requested.
    fn take(&mut self, result: Result<Made, String>) -> PreparationView {
        if let (Ok(made), Some(wanted)) = (&result, &self.wanted) {
            let number = wanted.source.number;
            let shown = |(part, file): (_, Bytes)| (PhotographView::new(number, part), file);
            self.photograph = made.photograph.clone().map(shown);
        }
        let view = self.view().ended(result.as_ref().map(|made| &made.drawing));
        self.made = result.ok();
        view
    }
}

/// The parts of the console that all viewers share.
pub struct Console {
    config: Config,
    token: String,
    hub: Mutex<Hub>,
    machine: Machine,
    event_pump: EventPump,
    cell: Option<(VirtualCell, &'static str)>,
    removed: Mutex<Vec<usize>>,
    preview: Mutex<Preview>,
    variants: Mutex<variants::Variants>,
    sheet: Mutex<sheet::SheetTouches>,
    /// What was moved and seen of the axes.
    axes_check: Mutex<axes_check::AxesCheck>,
    /// Where the robot goes for a change of the pen; `None`: it stays over the last stroke.
    pen_change: Option<Position>,
    changed: watch::Sender<u64>,
    gate: Arc<Gate>,
    viewers: viewer::Viewers,
    /// Whether the firmware's measurements are being read.
    measuring: AtomicBool,
    begun: Instant,
}

impl Console {
    /// A console for a machine at a port; `cell` is the virtual cell behind the port, with its firmware. For a change of
    /// the pen the robot goes to `pen_change`, or stays over the last stroke.
    ///
    /// # Errors
    /// The machine's thread cannot be started.
    pub fn start(
        config: Config,
        token: String,
        port: PortName,
        cell: Option<(VirtualCell, &'static str)>,
        pen_change: Option<Position>,
    ) -> Result<Arc<Self>, PortError> {
        let shown = match &cell {
            Some((_, kind)) => format!("{kind} robot"),
            None => port.to_string(),
        };
        let options = MachineOptions {
            patient: true,
            acknowledge: false,
        };
        let machine = Machine::start(port, config.clone(), options)?;
        let news = machine.subscribe(event_pump::NEWS_MAX);
        let mut hub = Hub::new(&config, &shown);
        let view = RobotView {
            version: env!("CARGO_PKG_VERSION"),
            port: shown,
            kind: config.geometry.kind().name(),
            parts: skeleton::fixed(&config.geometry),
            bounds_mm: skeleton::bounds_mm(&config),
            axes: axes(&config)
                .into_iter()
                .map(|axis| AxisLabel {
                    name: axis.label,
                    error_unit: axis.motion.error_unit().0,
                })
                .collect(),
            paper: &config.paper,
            work_area: &config.work_area,
            signals: signals::catalogue(&config),
            styles: preparation::choices_of("style"),
            backgrounds: preparation::choices_of("background"),
        };
        hub.say(Topic::Robot, &view);
        // A machine that connected before the console was ready has already published its greeting.
        if let Some(welcome) = machine.snapshot().welcome {
            hub.connected(&welcome);
        }
        hub.say(Topic::Preparation, &PreparationView::idle());
        hub.say(Topic::Variants, &variants::Variants::default().view());
        hub.say(Topic::Sheet, &sheet::configured(&config));
        hub.say(Topic::Axes, &axes_check::untried(&config));
        let console = Arc::new(Self {
            config,
            token,
            hub: Mutex::new(hub),
            machine,
            event_pump: EventPump::default(),
            cell,
            removed: Mutex::new(Vec::new()),
            preview: Mutex::default(),
            variants: Mutex::default(),
            sheet: Mutex::default(),
            axes_check: Mutex::default(),
            pen_change,
            changed: watch::channel(0).0,
            gate: Arc::default(),
            viewers: viewer::Viewers::default(),
            measuring: AtomicBool::new(false),
            begun: Instant::now(),
        });
        console.say_segment();
        event_pump::pump(&console, news);
        line_errors::watch(&console);
        Ok(console)
    }

    /// Locks the state.
    pub fn hub(&self) -> MutexGuard<'_, Hub> {
        lock(&self.hub)
    }

    /// Changes the state and notifies all viewers.
    pub fn change<R>(&self, change: impl FnOnce(&mut Hub) -> R) -> R {
        let result = change(&mut self.hub());
        self.changed.send_modify(|count| *count = count.wrapping_add(1));
        result
    }

    /// The connected firmware, or why there is no connection; `None` before the first attempt has ended.
    pub fn connection(&self) -> Option<Result<String, String>> {
        let snapshot = self.machine.snapshot();
        match (snapshot.welcome, snapshot.lost) {
            (Some(welcome), _) => Some(Ok(format!("firmware {} on board {}", welcome.firmware, welcome.board))),
            (None, Some(lost)) => Some(Err(lost.text)),
            (None, None) => None,
        }
    }

    /// Milliseconds since the console started.
    pub fn now_ms(&self) -> u64 {
        self.begun.elapsed().as_millis() as u64
    }

    /// The virtual cell, if there is one.
    pub fn cell(&self) -> Option<&VirtualCell> {
        self.cell.as_ref().map(|(cell, _)| cell)
    }

    /// The gate at which requests wait for stops.
    pub fn gate(&self) -> &Gate {
        &self.gate
    }

    /// Stops the robot: the order goes to the machine at once; the event pump does everything else.
    pub fn stop(&self, who: &str) {
        self.gate.stop_arrived();
        let gate = self.gate.clone();
        let answer = self.machine.stop(move || gate.stop_written());
        self.event_pump.stop_asked(who, answer);
    }

    /// A ticket for a request made now.
    fn ticket(&self) -> Ticket {
        self.machine.ticket()
    }

    /// Whether a stop was requested after this ticket was taken.
    fn is_overtaken(&self, ticket: Ticket) -> bool {
        self.machine.is_overtaken(ticket)
    }

    /// Sends an order that was requested at `heard`; a refusal is logged.
    fn order(&self, heard: Ticket, what: &'static str, order: Order) {
        let answer = self.machine.order_for(heard, order);
        self.event_pump.expect(what, answer);
    }

    fn inject(&self, injection: Injection) -> Result<(), String> {
        let Some((cell, _)) = &self.cell else {
            return Err("the segment is real; nothing is injected".to_owned());
        };
        let text = cell.inject(injection)?;
        match injection {
            Injection::Remove { slave } => lock(&self.removed).push(slave),
            Injection::Insert { slave } => lock(&self.removed).retain(|removed| *removed != slave),
            _ => {}
        }
        self.change(|hub| hub.note(Level::Info, format!("injected: {text}")));
        self.say_segment();
        Ok(())
    }

    fn say_segment(&self) {
        let view = SegmentView {
            kind: self.cell.as_ref().map(|(_, kind)| *kind),
            removed: lock(&self.removed).clone(),
            failure: self.cell.as_ref().and_then(|(cell, _)| cell.failure()),
        };
        self.change(|hub| hub.say(Topic::Segment, &view));
    }

    /// Prepares a file, replacing any other.
    fn prepare(self: &Arc<Self>, name: &str, wishes: PageOptions, content: Vec<u8>) -> Result<(), String> {
        let name = preparation::shown_name(name);
        let preview = lock(&self.preview);
        let number = preview.number + 1;
        let source = Arc::new(Source { number, name, content });
        self.end_variants();
        self.want(preview, Preparation { source, wishes })
    }

    /// Prepares the present file with other options.
    fn replan(self: &Arc<Self>, wishes: PageOptions) -> Result<(), String> {
        let mut preview = lock(&self.preview);
        let Some(Preparation { source, .. }) = preview.wanted.clone() else {
            return Err("there is no file to plan; drop one".to_owned());
        };
        let preparation = Preparation { source, wishes };
        let Some(made) = self.variant_of(&preparation) else {
            return self.want(preview, preparation);
        };
        preview.number += 1;
        preview.begun = preview.number;
        preview.wanted = Some(preparation);
        let view = preview.take(Ok(made));
        self.change(|hub| hub.say(Topic::Preparation, &view));
        Ok(())
    }

    /// Starts a preparation in a separate thread at once. The last preparation requested wins; if too many outdated
    /// ones are running, it starts when one of them ends.
    fn want(self: &Arc<Self>, mut preview: MutexGuard<'_, Preview>, preparation: Preparation) -> Result<(), String> {
        preview.number += 1;
        preview.made = None;
        let is_same = |wanted: &Preparation| Arc::ptr_eq(&wanted.source, &preparation.source);
        if !preview.wanted.as_ref().is_some_and(is_same) {
            preview.photograph = None;
        }
        preview.wanted = Some(preparation);
        let view = preview.view();
        let begins = preview.running < PREPARATIONS_MAX;
        preview.running += usize::from(begins);
        self.change(|hub| hub.say(Topic::Preparation, &view));
        drop(preview);
        if !begins {
            return Ok(());
        }
        let console = self.clone();
        let spawned = std::thread::Builder::new()
            .name("preparation".to_owned())
            .spawn(move || while console.prepare_next() {});
        spawned.map(|_| ()).map_err(|cause| {
            lock(&self.preview).running -= 1;
            format!("no thread for it: {cause}")
        })
    }

    /// Runs the requested preparation; returns whether there was one.
    fn prepare_next(&self) -> bool {
        let next = {
            let mut preview = lock(&self.preview);
            let next = preview.next();
            preview.running -= usize::from(next.is_none());
            next
        };
        let Some((number, Preparation { source, wishes })) = next else {
            return false;
        };
        let result = preparation::compose(&self.config, &source.name, &wishes, &source.content);
        let mut preview = lock(&self.preview);
        if preview.number == number && preview.wanted.is_some() {
            let view = preview.take(result);
            self.change(|hub| hub.say(Topic::Preparation, &view));
        }
        true
    }

    /// Adds the prepared drawing to the queue; with `pauses` it pauses between its layers.
    fn enqueue(&self, preparation: u64, pauses: bool) -> Result<(), &'static str> {
        let Some((_, drawing)) = self.preview().filter(|(number, _)| *number == preparation) else {
            return Err("this preview no longer exists");
        };
        self.change(|hub| -> Result<(), &'static str> {
            hub.jobs.enqueue(drawing, pauses)?;
            hub.say_jobs();
            hub.say(Topic::Preparation, &PreparationView::idle());
            Ok(())
        })?;
        let mut preview = lock(&self.preview);
        if preview.number == preparation {
            (preview.made, preview.wanted, preview.photograph) = (None, None, None);
            self.end_variants();
        }
        Ok(())
    }

    /// The prepared drawing and its number, if there is one.
    fn preview(&self) -> Option<(u64, PreparedDrawing)> {
        let preview = lock(&self.preview);
        let drawing = preview.made.as_ref().map(|made| made.drawing.clone());
        drawing.map(|drawing| (preview.number, drawing))
    }

    /// The picture of the photograph that is prepared, and its number.
    fn photograph(&self) -> Option<(u64, Bytes)> {
        let preview = lock(&self.preview);
        let (view, file) = preview.photograph.as_ref()?;
        Some((view.number, file.clone()))
    }
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}
