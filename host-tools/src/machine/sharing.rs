//! Shares a machine with other processes of this user: JSON lines over a Unix socket next to the port's lock file.
//!
//! The owner greets with a [`Greeting`]. A line from a client is a [`Question`] with a number, which its [`Response`]
//! repeats; responses come in any order. A client that follows gets a [`Response`] for everything that is recorded.
//! Drawings cannot be ordered over the socket: the program whose end holds a drawing has to own the port.
//!
//! Invariants: a client can block neither the machine nor another client, nor keep another one out by being idle. A
//! motion ends when the client that ordered it ends, for whatever reason, and with no other client. A jog continues
//! only while its client keeps sending signs of life.

mod client;

use super::account::Account;
use super::lanes::Lanes;
use super::{Answer, Failure, Order, Shared, Snapshot, Subscription};
use crate::error::code;
use crate::job::task::Life;
use crate::link::ownership::{Owner, socket_path};
use crate::link::port::PortName;
pub use client::Client;
use serde::{Deserialize, Serialize};
use std::io::{self, ErrorKind, Read, Write};
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Version of the socket protocol.
const VERSION: u16 = 3;
/// Most clients at a time. One more displaces the client that has been idle longest, if idle for `IDLE_MIN`.
const CLIENTS_MAX: usize = 32;
const IDLE_MIN: Duration = Duration::from_millis(250);
/// Longest line, bytes.
const LINE_BYTES_MAX: usize = 64 * 1024;
/// Most unanswered orders of one client.
const PENDING_MAX: usize = 64;
/// Time between two checks of unanswered orders.
const LOOK: Duration = Duration::from_millis(10);
/// Longest wait for an owner's greeting, and for a client that does not read.
const PATIENCE: Duration = Duration::from_secs(2);
/// Longest wait for a follower that does not read: its disk may stall.
const FOLLOWER_PATIENCE: Duration = Duration::from_secs(60);
/// Most news queued for a follower: more than a minute of samples.
const FOLLOWED_MAX: usize = 16_384;

/// First line from the owner.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Greeting {
    etherpen: u16,
    #[serde(flatten)]
    owner: Owner,
    port: String,
}

/// A client's question.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Question {
    id: u64,
    ask: Ask,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(clippy::large_enum_variant)] // one is alive at a time
enum Ask {
    Snapshot,
    Order(Order),
    Follow,
    /// Sign of life: the motion ordered by this client may continue. There is no answer.
    Alive,
}

/// The owner's response.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Response {
    id: u64,
    said: Said,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(clippy::large_enum_variant)] // one is alive at a time
enum Said {
    Snapshot(Snapshot),
    Answer(Answer),
    /// An [`Account`] in hexadecimal digits.
    Account(String),
}

/// The owner's server, until it is dropped.
#[derive(Debug)]
pub(super) struct Server {
    path: PathBuf,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Listens next to a port that this process owns; replaces a stale socket.
    pub(super) fn start(port: &PortName, orders: Lanes, shared: Arc<Shared>) -> io::Result<Self> {
        let path = socket_path(port)?;
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let listener = UnixListener::bind(&path)?;
        let greeting = Greeting {
            etherpen: VERSION,
            owner: Owner::this(),
            port: port.to_string(),
        };
        let thread = std::thread::Builder::new().name("sharing".into()).spawn({
            let shared = shared.clone();
            move || listen(&listener, &greeting, &orders, &shared)
        })?;
        Ok(Self {
            path,
            shared,
            thread: Some(thread),
        })
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::Relaxed);
        // Wakes the listener; without a listener the connection fails, which does no harm.
        let _ = UnixStream::connect(&self.path);
        let _ = std::fs::remove_file(&self.path);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn listen(listener: &UnixListener, greeting: &Greeting, orders: &Lanes, shared: &Arc<Shared>) {
    let mut seats = Seats::default();
    for stream in listener.incoming() {
        if shared.ended.load(Ordering::Relaxed) {
            return;
        }
        let Ok(stream) = stream else { continue };
        let Some(seat) = seats.take(&stream, shared) else {
            continue;
        };
        let (greeting, orders, shared) = (greeting.clone(), orders.clone(), shared.clone());
        std::thread::spawn(move || {
            // A client that has gone is not an error of the owner.
            let _ = serve(stream, seat, &greeting, &orders, &shared);
        });
    }
}

/// The place of one connected client.
struct Seat {
    stream: UnixStream,
    /// Time since which the client has sent nothing; `None` while it follows or waits for an answer.
    idle_since: Mutex<Option<Instant>>,
}

impl Seat {
    fn idle_since(&self) -> Option<Instant> {
        *self.idle_since.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn set_idle_since(&self, since: Option<Instant>) {
        *self.idle_since.lock().unwrap_or_else(PoisonError::into_inner) = since;
    }
}

/// The places of all clients.
#[derive(Default)]
struct Seats(Vec<Weak<Seat>>);

impl Seats {
    /// Finds a place for a client, displacing one that has been idle long enough if necessary; `None` if all are busy.
    fn take(&mut self, stream: &UnixStream, shared: &Shared) -> Option<Arc<Seat>> {
        let stream = stream.try_clone().ok()?;
        while !self.has_room()? {
            if shared.ended.load(Ordering::Relaxed) {
                return None;
            }
            std::thread::sleep(LOOK);
        }
        let idle_since = Mutex::new(Some(Instant::now()));
        let seat = Arc::new(Seat { stream, idle_since });
        self.0.push(Arc::downgrade(&seat));
        Some(seat)
    }

    /// Whether a place is free now; `None` if no client is idle.
    fn has_room(&mut self) -> Option<bool> {
        self.0.retain(|seat| seat.strong_count() > 0);
        if self.0.len() < CLIENTS_MAX {
            return Some(true);
        }
        let seats = self.0.iter().filter_map(Weak::upgrade);
        let idle = seats.filter_map(|seat| Some((seat.idle_since()?, seat)));
        let (since, longest) = idle.min_by_key(|(since, _)| *since)?;
        if since.elapsed() < IDLE_MIN {
            return Some(false);
        }
        // If the stream cannot be closed, its client has already gone.
        let _ = longest.stream.shutdown(Shutdown::Both);
        self.0
            .retain(|seat| !std::ptr::eq(seat.as_ptr(), Arc::as_ptr(&longest)));
        Some(true)
    }
}

/// An order without an answer yet.
struct Pending {
    id: u64,
    answer: Receiver<Answer>,
}

/// One client and its unanswered orders. Its motion ends with it.
struct Conversation {
    stream: UnixStream,
    seat: Arc<Seat>,
    lines: Lines,
    pending: Vec<Pending>,
    followed: Option<Followed>,
    life: Life,
}

impl Drop for Conversation {
    fn drop(&mut self) {
        self.life.end();
    }
}

fn serve(stream: UnixStream, seat: Arc<Seat>, greeting: &Greeting, orders: &Lanes, shared: &Shared) -> io::Result<()> {
    stream.set_read_timeout(Some(LOOK))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut client = Conversation {
        stream,
        seat,
        lines: Lines::default(),
        pending: Vec::new(),
        followed: None,
        life: Life::default(),
    };
    send(&mut client.stream, greeting)?;
    while !shared.ended.load(Ordering::Relaxed) && client.lines.read(&mut client.stream)? {
        while let Some(line) = client.lines.take() {
            client.seat.set_idle_since(None);
            client.hear(serde_json::from_slice(&line)?, orders, shared)?;
        }
        client.tell()?;
    }
    Ok(())
}

impl Conversation {
    fn hear(&mut self, Question { id, ask }: Question, orders: &Lanes, shared: &Shared) -> io::Result<()> {
        match ask {
            Ask::Snapshot => {
                let snapshot = shared.snapshot.lock().unwrap_or_else(PoisonError::into_inner).clone();
                let said = Said::Snapshot(snapshot);
                send(&mut self.stream, &Response { id, said })?;
            }
            Ask::Order(_) if self.pending.len() >= PENDING_MAX => {
                let many = Failure::new(code::FAILED, "too many orders without an answer at once");
                let said = Said::Answer(Err(many));
                send(&mut self.stream, &Response { id, said })?;
            }
            Ask::Order(order) => {
                let life = matches!(order, Order::Motion(_)).then(|| self.life.clone());
                let answer = orders.give(order, life, None);
                self.pending.push(Pending { id, answer });
            }
            Ask::Alive => self.life.sign(),
            Ask::Follow => self.followed = Some(Followed::begin(id, &mut self.stream, shared)?),
        }
        Ok(())
    }

    /// Sends pending news and answers.
    fn tell(&mut self) -> io::Result<()> {
        if let Some(followed) = &self.followed {
            followed.send(&mut self.stream)?;
        }
        let mut waiting = Vec::new();
        for entry in self.pending.drain(..) {
            let answer = match entry.answer.try_recv() {
                Ok(answer) => answer,
                Err(TryRecvError::Empty) => {
                    waiting.push(entry);
                    continue;
                }
                Err(TryRecvError::Disconnected) => Err(Failure::new(code::CONNECTION, "the owner of the port ends")),
            };
            let said = Said::Answer(answer);
            send(&mut self.stream, &Response { id: entry.id, said })?;
        }
        self.pending = waiting;
        let is_idle = self.pending.is_empty() && self.followed.is_none();
        if is_idle && self.seat.idle_since().is_none() {
            self.seat.set_idle_since(Some(Instant::now()));
        }
        Ok(())
    }
}

/// A client that follows the machine.
struct Followed {
    id: u64,
    news: Subscription,
}

impl Followed {
    /// Sends the present state, so that the client has a starting point.
    fn begin(id: u64, stream: &mut UnixStream, shared: &Shared) -> io::Result<Self> {
        let news = shared.subscribers.subscribe(FOLLOWED_MAX);
        let snapshot = shared.snapshot.lock().unwrap_or_else(PoisonError::into_inner).clone();
        stream.set_write_timeout(Some(FOLLOWER_PATIENCE))?;
        let followed = Self { id, news };
        let connected = snapshot.welcome.map(Account::Connected);
        for account in connected.into_iter().chain(snapshot.status.map(Account::Status)) {
            followed.tell(stream, &account)?;
        }
        Ok(followed)
    }

    fn send(&self, stream: &mut UnixStream) -> io::Result<()> {
        while let Some(news) = self.news.try_next() {
            if let Some(account) = Account::of(&news) {
                self.tell(stream, &account)?;
            }
            match self.news.take_lost() {
                0 => {}
                lost => self.tell(stream, &Account::Missed(lost))?,
            }
        }
        Ok(())
    }

    fn tell(&self, stream: &mut UnixStream, account: &Account) -> io::Result<()> {
        let unwritten = || io::Error::new(ErrorKind::InvalidData, "an account cannot be written");
        let said = Said::Account(account.to_digits().ok_or_else(unwritten)?);
        send(stream, &Response { id: self.id, said })
    }
}

fn send(stream: &mut UnixStream, message: &impl Serialize) -> io::Result<()> {
    let mut line = serde_json::to_vec(message)?;
    line.push(b'\n');
    stream.write_all(&line)
}

/// Splits received bytes into lines.
#[derive(Default)]
struct Lines(Vec<u8>);

impl Lines {
    /// Takes received bytes, waiting briefly; returns false at the end of the stream.
    fn read(&mut self, stream: &mut UnixStream) -> io::Result<bool> {
        let mut block = [0; 4096];
        match stream.read(&mut block) {
            Ok(0) => Ok(false),
            Ok(length) => {
                self.0.extend_from_slice(block.get(..length).unwrap_or_default());
                if self.0.len() > LINE_BYTES_MAX {
                    return Err(io::Error::new(ErrorKind::InvalidData, "a line without an end"));
                }
                Ok(true)
            }
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => Ok(true),
            Err(error) => Err(error),
        }
    }

    fn take(&mut self) -> Option<Vec<u8>> {
        let end = self.0.iter().position(|byte| *byte == b'\n')?;
        let rest = self.0.split_off(end.saturating_add(1));
        Some(std::mem::replace(&mut self.0, rest))
    }
}
