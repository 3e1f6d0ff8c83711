//! One viewer: carries out its requests, and sends it as much as its connection can carry.
//!
//! Three tasks: one reads, and finds stops in the thread `stop`; one carries out requests; one sends. Invariants: a
//! stop is received whatever the other two tasks do, and no motion requested before it, by any viewer, is carried out
//! after it. Data waiting for a viewer are bounded; the newest replace what it could not take. Requests of a viewer
//! without the token or without control are refused; a stop with the token is not.

mod inbox;
mod pictures;
mod ranges;

use super::axes_check::Press;
use super::capture::Trigger;
use super::control::ViewerId;
use super::hub::Level;
use super::messages::{Action, COLUMNS_MAX, REQUEST_BYTES_MAX, Request, WINDOW_MAX_MS, section};
use super::signals::SIGNALS;
use super::{Console, lock};
use crate::machine::{OVERTAKEN, Order, Ticket};
use axum::extract::ws::{CloseFrame, Message, WebSocket};
use etherpen::messages::Command;
use etherpen::motion::Pen;
use etherpen::robots::Position;
use futures_util::StreamExt;
use futures_util::stream::SplitStream;
use inbox::Inbox;
use pictures::{CaptureView, text};
use ranges::Wanted;
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant};
use tokio::runtime::Handle;
use tokio::sync::Notify;

/// Most answers queued for a viewer.
const ANSWERS_MAX: usize = 32;
/// Malformed requests after which a viewer is disconnected.
const MALFORMED_MAX: u32 = 8;
/// Close code of the WebSocket protocol for a violated policy.
const CLOSE_POLICY: u16 = 1008;
/// Time after its last jog in which a vanished viewer counts as jogging, ms.
const JOGGING_MS: u64 = 500;
/// Longest name of a page, characters.
const PAGE_CHARS_MAX: usize = 40;
/// Messages that a viewer without the token may send in a burst, and the time after which it may send another one.
const GUEST_BURST: u32 = 100;
const GUEST_EARNS: Duration = Duration::from_millis(20);
/// Time in which a viewer that is disconnected can receive the last message.
const FAREWELL: Duration = Duration::from_secs(1);

/// The plot of a viewer.
struct Watched {
    id: u32,
    signals: Vec<usize>,
    window_ms: u64,
    columns: u64,
}

/// Data queued for a viewer besides the common state.
#[derive(Default)]
struct Mail {
    answers: VecDeque<Message>,
    watch: Option<Watched>,
    range: Option<Wanted>,
    closing: Option<&'static str>,
}

/// State shared by a viewer's tasks.
pub(super) struct Viewer {
    console: Arc<Console>,
    id: ViewerId,
    /// Whether the viewer has shown the token.
    commanding: AtomicBool,
    inbox: Mutex<Inbox>,
    asked: Notify,
    mail: Mutex<Mail>,
    awake: Notify,
    /// Notified when the viewer has to be disconnected.
    leave: Notify,
    jogged_ms: AtomicU64,
    page: Mutex<String>,
}

/// All viewers, so that one can be disconnected.
pub(super) type Viewers = Mutex<Vec<Weak<Viewer>>>;

/// A viewer's information about itself.
#[derive(Serialize)]
struct You {
    id: ViewerId,
    may_command: bool,
    /// Pictures that the viewer could not take in time.
    skipped: u64,
}

/// Reads a viewer's messages until it leaves; `elsewhere` serves everything but its stops.
pub(super) async fn serve(socket: WebSocket, console: Arc<Console>, elsewhere: Handle) {
    let entering = elsewhere.spawn(async move { enter(console) });
    let Ok(Some(viewer)) = entering.await else {
        let mut socket = socket;
        let full = CloseFrame {
            code: CLOSE_POLICY,
            reason: "too many viewers".into(),
        };
        // The viewer is disconnected in any case.
        let _ = tokio::time::timeout(FAREWELL, socket.send(Message::Close(Some(full)))).await;
        return;
    };
    let (sink, stream) = socket.split();
    let mut writing = elsewhere.spawn(pictures::write(sink, viewer.clone()));
    let serving = elsewhere.spawn(serve_requests(viewer.clone()));
    let goodbye = tokio::select! {
        () = read(stream, &viewer) => Some("goodbye"),
        () = viewer.leave.notified() => Some("there are too many viewers without the token"),
        _ = &mut writing => None,
    };
    if let Some(goodbye) = goodbye {
        lock(&viewer.mail).closing.get_or_insert(goodbye);
        // Lets the last message be sent, but does not wait for a blocked connection.
        viewer.awake.notify_one();
        let _ = tokio::time::timeout(FAREWELL, &mut writing).await;
        writing.abort();
    }
    serving.abort();
    elsewhere.spawn(async move { viewer.left() });
}

/// Adds a viewer if there is room, and disconnects the one that has to leave for it.
fn enter(console: Arc<Console>) -> Option<Arc<Viewer>> {
    let (id, leaving) = console.change(|hub| hub.enter())?;
    let viewer = Arc::new(Viewer {
        console: console.clone(),
        id,
        commanding: AtomicBool::new(false),
        inbox: Mutex::default(),
        asked: Notify::new(),
        mail: Mutex::default(),
        awake: Notify::new(),
        leave: Notify::new(),
        jogged_ms: AtomicU64::new(0),
        page: Mutex::default(),
    });
    let mut viewers = lock(&console.viewers);
    viewers.retain(|viewer| viewer.strong_count() > 0);
    let leaving = viewers
        .iter()
        .filter_map(Weak::upgrade)
        .find(|viewer| Some(viewer.id) == leaving);
    if let Some(leaving) = leaving {
        leaving.leave.notify_one();
    }
    viewers.push(Arc::downgrade(&viewer));
    Some(viewer)
}

/// Carries out a viewer's requests one after the other; none while a stop is pending.
async fn serve_requests(viewer: Arc<Viewer>) {
    loop {
        viewer.asked.notified().await;
        while let Some((heard, request)) = viewer.next_request() {
            viewer.console.gate.begin(viewer.id).await;
            viewer.take(heard, request);
            tokio::task::yield_now().await;
        }
    }
}

/// Rate limit for a viewer without the token.
struct Patience {
    since: Instant,
    heard: u32,
}

impl Patience {
    fn new() -> Self {
        Self {
            since: Instant::now(),
            heard: 0,
        }
    }

    /// Time to wait before the next message is read.
    fn pause(&mut self) -> Duration {
        let earned = (self.since.elapsed().as_millis() / GUEST_EARNS.as_millis()) as u32;
        if earned >= self.heard {
            *self = Self::new();
        }
        self.heard = self.heard.saturating_add(1);
        match self.heard > earned.saturating_add(GUEST_BURST) {
            true => GUEST_EARNS,
            false => Duration::ZERO,
        }
    }
}

async fn read(mut stream: SplitStream<WebSocket>, viewer: &Arc<Viewer>) {
    let (mut malformed, mut patience) = (0, Patience::new());
    while let Some(Ok(message)) = stream.next().await {
        let heard = viewer.console.ticket();
        // One message a turn, so that no viewer's flood keeps others from being heard.
        tokio::task::yield_now().await;
        let pause = patience.pause();
        if !pause.is_zero() && !viewer.may_command() {
            tokio::time::sleep(pause).await;
        }
        let text = match message {
            Message::Text(text) => text,
            Message::Close(_) => break,
            Message::Ping(_) | Message::Pong(_) => continue,
            Message::Binary(_) => "".into(),
        };
        match serde_json::from_str::<Request>(&text) {
            Ok(request) if text.len() <= REQUEST_BYTES_MAX => viewer.hear(heard, request),
            Ok(_) => break,
            Err(cause) => {
                malformed += 1;
                viewer.refuse(&format!("this is no request: {cause}"));
            }
        }
        if malformed > MALFORMED_MAX {
            lock(&viewer.mail).closing = Some("too many messages that are no requests");
            break;
        }
    }
}

impl Viewer {
    fn may_command(&self) -> bool {
        self.commanding.load(Ordering::Relaxed)
    }

    /// Carries out a stop at once; passes everything else to the task that serves it.
    fn hear(&self, heard: Ticket, request: Request) {
        if let Request::Hello { token, .. } = &request {
            let right = same(token.as_bytes(), self.console.token.as_bytes());
            self.commanding.store(right, Ordering::Relaxed);
        }
        if request == Request::Stop && self.may_command() {
            return self.console.stop(&self.name());
        }
        if lock(&self.inbox).push(heard, request) {
            self.asked.notify_one();
        } else {
            self.refuse("too many requests at once");
        }
    }

    fn next_request(&self) -> Option<(Ticket, Request)> {
        lock(&self.inbox).pop()
    }

    fn answer(&self, message: Message) {
        let mut mail = lock(&self.mail);
        mail.answers.push_back(message);
        if mail.answers.len() > ANSWERS_MAX {
            mail.answers.pop_front();
        }
        drop(mail);
        self.awake.notify_one();
    }

    fn tell(&self, name: &str, data: &impl Serialize) {
        self.answer(text(&section(name, data)));
    }

    fn refuse(&self, why: &str) {
        self.tell("refused", &why);
    }

    fn name(&self) -> String {
        format!("viewer {}", self.id)
    }

    /// Carries out a request that was received at `heard`.
    fn take(&self, heard: Ticket, request: Request) {
        let now_ms = self.console.now_ms();
        self.console.hub().control.heard(self.id, now_ms);
        match request {
            Request::Alive => {}
            Request::Hello { page, .. } => self.hello(&page, now_ms),
            Request::Take { force } if self.may_command() => self.take_control(force, now_ms),
            Request::Stop | Request::Take { .. } => self.refuse(NO_TOKEN),
            Request::Release => self.release(now_ms),
            request @ (Request::Watch { .. }
            | Request::Freeze
            | Request::Thaw
            | Request::Range { .. }
            | Request::Arm { .. }
            | Request::Disarm) => self.look(request),
            request if self.console.hub().control.is_held_by(self.id) => self.operate(heard, request, now_ms),
            _ => self.refuse("you do not have control; take it first"),
        }
    }

    /// Carries out a request that every viewer may make.
    fn look(&self, request: Request) {
        let console = &self.console;
        match request {
            Request::Watch {
                id,
                signals,
                window_ms,
                columns,
            } => {
                if let Err(why) = ranges::check_window(window_ms, columns) {
                    return self.refuse(&why);
                }
                lock(&self.mail).watch = Some(Watched {
                    id,
                    signals: existing(signals),
                    window_ms: window_ms.clamp(100, WINDOW_MAX_MS),
                    columns: columns.clamp(10, COLUMNS_MAX),
                });
                self.awake.notify_one();
            }
            Request::Freeze => {
                let snapshot = console.hub().history().snapshot();
                if !console.hub().keep(self.id, snapshot) {
                    self.refuse("too many viewers keep a captured plot; this one stays live");
                }
            }
            Request::Thaw => console.hub().forget(self.id),
            Request::Range {
                id,
                signals,
                from_ms,
                to_ms,
                columns,
            } => match Wanted::new(id, existing(signals), from_ms, to_ms, columns) {
                Ok(wanted) => {
                    lock(&self.mail).range = Some(wanted);
                    self.awake.notify_one();
                }
                Err(why) => self.refuse(&why),
            },
            Request::Arm { signal, .. } if signal >= SIGNALS => self.refuse("there is no such signal"),
            Request::Arm { level, .. } if !(level as f32).is_finite() => self.refuse("the level is too large"),
            Request::Arm {
                signal,
                condition,
                level,
                before_ms,
                after_ms,
            } => {
                let trigger = Trigger {
                    signal,
                    condition,
                    level: level as f32,
                    before_ms,
                    after_ms,
                };
                if !console.hub().arm(self.id, trigger) {
                    return self.refuse("too many viewers wait for an event; try again later");
                }
                self.tell("capture", &CaptureView::armed());
            }
            _ => {
                console.hub().disarm(self.id);
                self.tell("capture", &CaptureView::idle());
            }
        }
    }

    /// Carries out a request of the viewer with control.
    fn operate(&self, heard: Ticket, request: Request, now_ms: u64) {
        let console = &self.console;
        match request {
            Request::Command { .. }
            | Request::Jog { .. }
            | Request::JogAxis { .. }
            | Request::Start { .. }
            | Request::Continue { .. }
            | Request::PenIsIn { .. }
                if console.is_overtaken(heard) =>
            {
                self.refuse(OVERTAKEN);
            }
            Request::Command { action } => self.command(heard, action),
            Request::Jog { velocity_mm_s } if velocity_mm_s.iter().any(|speed| !(*speed as f32).is_finite()) => {
                self.refuse("this velocity is too large");
            }
            Request::Jog { velocity_mm_s } => {
                self.jogged_ms.store(now_ms.max(1), Ordering::Relaxed);
                console.jog(heard, velocity_mm_s.map(|speed| speed as f32));
            }
            Request::JogAxis { axis, forward, press } => {
                let press = Press {
                    viewer: self.id,
                    number: press,
                    axis,
                    forward,
                };
                match console.press_axis(press, now_ms) {
                    Ok(velocity_mm_s) => {
                        self.jogged_ms.store(now_ms.max(1), Ordering::Relaxed);
                        console.jog(heard, velocity_mm_s);
                    }
                    Err(why) => {
                        self.stop_jog(now_ms);
                        self.refuse(why);
                    }
                }
            }
            Request::Saw { axis, seen } => {
                if let Err(why) = console.saw(axis, seen) {
                    self.refuse(why);
                }
            }
            Request::Inject { fault } => {
                if let Err(why) = console.inject(fault) {
                    self.refuse(&why);
                }
            }
            Request::Replan { wishes } => {
                if let Err(why) = console.replan(wishes) {
                    self.refuse(&why);
                }
            }
            Request::Vary => {
                if let Err(why) = console.vary() {
                    self.refuse(&why);
                }
            }
            Request::Enqueue { preparation, pauses } => {
                if let Err(why) = console.enqueue(preparation, pauses) {
                    self.refuse(why);
                }
            }
            Request::Start { job } => self.start(heard, job),
            Request::Continue { job } => {
                if let Err(why) = console.go_on(heard, job) {
                    self.refuse(why);
                }
            }
            Request::PenIsIn { job } => {
                if let Err(why) = console.pen_is_in(heard, job) {
                    self.refuse(why);
                }
            }
            Request::Discard { job } => console.change(|hub| {
                hub.jobs.discard(job);
                hub.say_jobs();
            }),
            Request::Touch { action } => {
                if let Err(why) = console.touch(action) {
                    self.refuse(&why);
                }
            }
            Request::Measure { reset } => console.measure(reset),
            // All other requests were carried out before.
            _ => {}
        }
    }

    fn release(&self, now_ms: u64) {
        self.stop_jog(now_ms);
        self.console.change(|hub| {
            if hub.control.release(self.id) {
                hub.note(Level::Info, format!("{} gave control back", self.name()));
            }
            hub.say_control();
        });
    }

    fn hello(&self, page: &str, now_ms: u64) {
        let commanding = self.may_command();
        let page: String = page.chars().take(PAGE_CHARS_MAX).collect();
        if commanding {
            self.console.change(|hub| {
                hub.trust(self.id);
                if hub.control.returned(self.id, &page, now_ms) {
                    hub.say_control();
                }
            });
        }
        *lock(&self.page) = page;
        let you = You {
            id: self.id,
            may_command: commanding,
            skipped: 0,
        };
        self.tell("you", &you);
    }

    fn take_control(&self, force: bool, now_ms: u64) {
        let page = lock(&self.page).clone();
        let taken = self.console.change(|hub| {
            let before = hub.control.holder();
            let taken = hub.control.take(self.id, &page, force, now_ms);
            if taken && before != Some(self.id) {
                hub.note(Level::Info, format!("{} took control", self.name()));
            }
            hub.say_control();
            taken
        });
        if !taken {
            self.refuse("another viewer has control");
        }
    }

    fn command(&self, heard: Ticket, action: Action) {
        let (what, order) =
            match action {
                Action::Reference => ("homing", Order::Tell(Command::Home)),
                Action::ReferenceHere => match self.console.reference_here() {
                    Some(command) => ("the reference", Order::Tell(command)),
                    None => return self.refuse(
                        "the robot's last pose is unknown, or its encoders would not show that it was moved; home it",
                    ),
                },
                Action::Enable => ("enabling the drives", Order::Tell(Command::Enable)),
                Action::Disable => ("disabling the drives", Order::Tell(Command::Disable)),
                Action::Hold => ("holding", Order::Hold),
                Action::Resume => ("resuming", Order::Resume),
                // A robot on its way to the place for changing the pen stops, too.
                Action::Cancel if self.console.end_in_pause() && !self.console.is_moving() => return,
                Action::Cancel => ("cancelling", Order::Cancel),
                Action::Acknowledge => ("acknowledging the fault", Order::Tell(Command::Acknowledge)),
                Action::Pen { down } => {
                    let pen = if down { Pen::Down } else { Pen::Up };
                    ("moving the pen", Order::Tell(Command::Pen { pen }))
                }
                Action::Override { percent } => ("the speed override", Order::Override(percent)),
                Action::Move {
                    position_mm: [x_mm, y_mm, z_mm],
                } => {
                    let position = Position { x_mm, y_mm, z_mm };
                    ("moving", Order::Tell(Command::Move { position }))
                }
            };
        self.console.order(heard, what, order);
    }

    fn start(&self, heard: Ticket, job: u64) {
        if !self.console.draw(heard, job) {
            self.refuse("another drawing is active, or this one is no longer in the queue");
        }
    }

    fn stop_jog(&self, now_ms: u64) {
        let jogged_ms = self.jogged_ms.swap(0, Ordering::Relaxed);
        if jogged_ms > 0 && now_ms.saturating_sub(jogged_ms) < JOGGING_MS {
            self.console.jog(self.console.ticket(), [0.0; 3]);
        }
    }

    fn left(&self) {
        let now_ms = self.console.now_ms();
        if self.console.change(|hub| hub.leave(self.id, now_ms)) {
            self.stop_jog(now_ms);
            let text = format!("{} has gone with control", self.name());
            self.console.change(|hub| hub.note(Level::Warning, text));
        }
    }
}

const NO_TOKEN: &str = "this page has no token; open the address that the console has printed";

fn existing(mut signals: Vec<usize>) -> Vec<usize> {
    signals.retain(|signal| *signal < SIGNALS);
    signals.truncate(SIGNALS);
    signals
}

/// Compares in a time that does not depend on where the two differ.
pub(in crate::console) fn same(a: &[u8], b: &[u8]) -> bool {
    let difference = a.iter().zip(b).fold(0, |difference, (a, b)| difference | (a ^ b));
    a.len() == b.len() && difference == 0
}
