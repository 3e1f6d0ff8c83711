//! One viewer: what it asks is done, what it can carry is sent.
//!
//! Reading and writing are independent: a stop is heard while a picture waits for a slow line. Invariants: what waits for
//! a viewer is bounded, the newest replaces what it could not take; a request of a viewer without the token or without
//! control is refused, a stop with the token is not.

mod pictures;

use super::capture::{CAPTURE_MAX_MS, Trigger};
use super::control::ViewerId;
use super::history::Snapshot;
use super::hub::Level;
use super::messages::{self, Action, COLUMNS_MAX, REQUEST_BYTES_MAX, Request, WINDOW_MAX_MS, section};
use super::signals::SIGNALS;
use super::{Console, lock};
use crate::machine::Order;
use axum::extract::ws::{CloseFrame, Message, WebSocket};
use etherpen::link::protocol::Command;
use etherpen::motion::Pen;
use etherpen::robot::Position;
use futures_util::StreamExt;
use futures_util::stream::SplitStream;
use pictures::{CaptureView, decimated, text};
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::Notify;

/// Answers that may wait for a viewer.
const ANSWERS_MAX: usize = 32;
/// Requests that are no requests after which a viewer is sent away.
const MALFORMED_MAX: u32 = 8;
/// Close code of the WebSocket protocol for a violated policy.
const CLOSE_POLICY: u16 = 1008;
/// Time after its last jog in which a viewer that vanishes is taken to be jogging, ms.
const JOGGING_MS: u64 = 500;
/// Longest name of a page.
const PAGE_CHARS_MAX: usize = 40;

/// What a viewer is plotting.
struct Watched {
    id: u32,
    signals: Vec<usize>,
    window_ms: u64,
    columns: u64,
}

/// What waits for a viewer besides the common state.
#[derive(Default)]
struct Mail {
    answers: VecDeque<Message>,
    watch: Option<Watched>,
    frozen: Option<Snapshot>,
    commanding: bool,
    closing: Option<&'static str>,
}

/// What a viewer's two halves have in common.
struct Viewer {
    console: Arc<Console>,
    id: ViewerId,
    mail: Mutex<Mail>,
    awake: Notify,
    jogged_ms: AtomicU64,
    page: Mutex<String>,
}

/// What a viewer is told of itself.
#[derive(Serialize)]
struct You {
    id: ViewerId,
    may_command: bool,
    /// Pictures that it could not take in time.
    skipped: u64,
}

/// Serves a viewer until it goes.
pub(super) async fn serve(socket: WebSocket, console: Arc<Console>) {
    let Some(id) = console.change(|hub| hub.enter()) else {
        let mut socket = socket;
        let full = CloseFrame {
            code: CLOSE_POLICY,
            reason: "too many viewers".into(),
        };
        // It is sent away either way.
        let _ = socket.send(Message::Close(Some(full))).await;
        return;
    };
    let viewer = Arc::new(Viewer {
        console,
        id,
        mail: Mutex::default(),
        awake: Notify::new(),
        jogged_ms: AtomicU64::new(0),
        page: Mutex::default(),
    });
    let (sink, stream) = socket.split();
    let mut writing = tokio::spawn(pictures::write(sink, viewer.clone()));
    tokio::select! {
        () = read(stream, &viewer) => {
            // Let the last word out, but do not wait for a line that is stuck.
            viewer.awake.notify_one();
            let _ = tokio::time::timeout(Duration::from_secs(1), &mut writing).await;
            writing.abort();
        }
        _ = &mut writing => {}
    }
    viewer.left();
}

async fn read(mut stream: SplitStream<WebSocket>, viewer: &Arc<Viewer>) {
    let mut malformed = 0;
    while let Some(Ok(message)) = stream.next().await {
        let text = match message {
            Message::Text(text) => text,
            Message::Close(_) => break,
            Message::Ping(_) | Message::Pong(_) => continue,
            Message::Binary(_) => "".into(),
        };
        match serde_json::from_str::<Request>(&text) {
            Ok(request) if text.len() <= REQUEST_BYTES_MAX => viewer.take(request),
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
    let mut mail = lock(&viewer.mail);
    mail.closing.get_or_insert("goodbye");
}

impl Viewer {
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

    /// Does what is asked.
    fn take(&self, request: Request) {
        let now_ms = self.console.now_ms();
        self.console.hub().control.heard(self.id, now_ms);
        let may_command = lock(&self.mail).commanding;
        match request {
            Request::Alive => {}
            Request::Hello { token, page } => self.hello(&token, &page, now_ms),
            Request::Stop if may_command => self.console.stop(&self.name()),
            Request::Take { force } if may_command => self.take_control(force, now_ms),
            Request::Stop | Request::Take { .. } => self.refuse(NO_TOKEN),
            Request::Release => self.release(now_ms),
            request @ (Request::Watch { .. }
            | Request::Freeze
            | Request::Thaw
            | Request::Range { .. }
            | Request::Arm { .. }
            | Request::Disarm) => self.look(request),
            request if self.console.hub().control.is_held_by(self.id) => self.operate(request, now_ms),
            _ => self.refuse("you do not have control; take it first"),
        }
    }

    /// What every viewer may ask for.
    fn look(&self, request: Request) {
        let console = &self.console;
        match request {
            Request::Watch {
                id,
                signals,
                window_ms,
                columns,
            } => {
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
                lock(&self.mail).frozen = Some(snapshot);
            }
            Request::Thaw => lock(&self.mail).frozen = None,
            Request::Range {
                id,
                signals,
                from_ms,
                to_ms,
                columns,
            } => self.range(id, &existing(signals), from_ms, to_ms, columns),
            Request::Arm { signal, .. } if signal >= SIGNALS => self.refuse("there is no such signal"),
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
                console.hub().arm(self.id, trigger);
                self.tell("capture", &CaptureView::armed());
            }
            _ => {
                console.hub().disarm(self.id);
                self.tell("capture", &CaptureView::idle());
            }
        }
    }

    /// What the viewer with control may ask for.
    fn operate(&self, request: Request, now_ms: u64) {
        let console = &self.console;
        match request {
            Request::Command { action } => self.command(action),
            Request::Jog { velocity_mm_s } => {
                self.jogged_ms.store(now_ms.max(1), Ordering::Relaxed);
                console.jog(velocity_mm_s.map(|speed| speed as f32));
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
            Request::Enqueue { preparation } => self.enqueue(preparation),
            Request::Start { job } => self.start(job),
            Request::Discard { job } => console.change(|hub| {
                hub.jobs.discard(job);
                hub.say_jobs();
            }),
            Request::Measure { reset } => console.measure(reset),
            // Everything else was done before.
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

    fn hello(&self, token: &str, page: &str, now_ms: u64) {
        let commanding = same(token.as_bytes(), self.console.token.as_bytes());
        let page: String = page.chars().take(PAGE_CHARS_MAX).collect();
        if commanding {
            self.console.change(|hub| {
                if hub.control.returned(self.id, &page, now_ms) {
                    hub.say_control();
                }
            });
        }
        *lock(&self.page) = page;
        lock(&self.mail).commanding = commanding;
        self.awake.notify_one();
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

    fn command(&self, action: Action) {
        let (what, order) = match action {
            Action::Reference => ("the reference", Order::Tell(Command::Reference)),
            Action::Enable => ("enabling the drives", Order::Tell(Command::Enable)),
            Action::Disable => ("disabling the drives", Order::Tell(Command::Disable)),
            Action::Hold => ("holding", Order::Hold),
            Action::Resume => ("resuming", Order::Resume),
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
        self.console.order(what, order);
    }

    fn start(&self, job: u64) {
        if !self.console.draw(job) {
            self.refuse("another drawing is active, or this one is not in the queue any more");
        }
    }

    fn enqueue(&self, preparation: u64) {
        if let Err(why) = self.console.enqueue(preparation) {
            self.refuse(why);
        }
    }

    fn range(&self, id: u32, signals: &[usize], from_ms: u64, to_ms: u64, columns: u64) {
        let to_ms = to_ms.min(from_ms.saturating_add(WINDOW_MAX_MS.max(CAPTURE_MAX_MS)));
        let frozen = lock(&self.mail).frozen.clone();
        let snapshot = frozen.unwrap_or_else(|| self.console.hub().history().snapshot());
        let length_ms = to_ms.saturating_sub(from_ms);
        let bucket_ms = length_ms.div_ceil(if columns == 0 {
            length_ms.max(1)
        } else {
            columns.clamp(10, COLUMNS_MAX)
        });
        let buckets = decimated(&snapshot, signals, bucket_ms.max(1), from_ms, to_ms);
        let bytes = messages::columns(id, 3, signals.len(), bucket_ms.max(1), &buckets);
        self.answer(Message::Binary(bytes.into()));
    }

    fn stop_jog(&self, now_ms: u64) {
        let jogged_ms = self.jogged_ms.swap(0, Ordering::Relaxed);
        if jogged_ms > 0 && now_ms.saturating_sub(jogged_ms) < JOGGING_MS {
            self.console.jog([0.0; 3]);
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

/// Compares in a time that does not tell where they differ.
pub(in crate::console) fn same(a: &[u8], b: &[u8]) -> bool {
    let difference = a.iter().zip(b).fold(0, |difference, (a, b)| difference | (a ^ b));
    a.len() == b.len() && difference == 0
}
