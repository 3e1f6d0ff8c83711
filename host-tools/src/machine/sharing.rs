//! A machine shared with other processes of this user: JSON lines over a Unix socket beside the port.
//!
//! The owner greets with a [`Greeting`]. A line from a client is a [`Question`] with a number; its [`Response`] carries the
//! same number, responses come in any order; a client that follows gets a [`Response`] for everything that is recorded.
//! Drawings are not given over the socket: their owner is the one whose end holds them.
//!
//! Invariants: a client can neither block the machine nor another client; a motion ends with the client that ordered it,
//! and a jog goes on only while the client says, over and over, that it is alive.

use super::lanes::Lanes;
use super::{Account, Answer, Failure, NoNews, Order, Shared, Snapshot, Source, Subscription};
use crate::commands::code;
use crate::link::ownership::{Owner, socket_path};
use crate::link::port::PortName;
use crate::link::terms::Life;
use serde::{Deserialize, Serialize};
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError};
use std::sync::{Arc, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Version of what is said over the socket.
const VERSION: u16 = 2;
/// Clients at a time.
const CLIENTS_MAX: usize = 32;
/// Longest line, bytes.
const LINE_BYTES_MAX: usize = 64 * 1024;
/// Orders of one client that may wait for their answers.
const PENDING_MAX: usize = 64;
/// Time between two looks at orders that have no answer yet.
const LOOK: Duration = Duration::from_millis(10);
/// Time between two signs of life of a client that waits for the end of a motion; a jog is repeated every 40 ms, and the
/// firmware's dead-man time is 100 ms.
const SIGN: Duration = Duration::from_millis(20);
/// Longest wait for the greeting of an owner, and for a client that does not read.
const PATIENCE: Duration = Duration::from_secs(2);
/// Longest wait for a follower that does not read: a disk may stall.
const FOLLOWER_PATIENCE: Duration = Duration::from_secs(60);
/// News that may wait for a follower: a minute of samples, and more.
const FOLLOWED_MAX: usize = 16_384;

/// First line of an owner.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Greeting {
    etherpen: u16,
    #[serde(flatten)]
    owner: Owner,
    port: String,
}

/// What a client asks.
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
    /// The motion that this client has ordered goes on; nothing is answered.
    Alive,
}

/// What the owner answers.
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
    /// An [`Account`] in digits.
    Account(String),
}

/// The owner's end, until it is dropped.
#[derive(Debug)]
pub(super) struct Server {
    path: PathBuf,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Listens beside a port that this process owns; a socket left behind is replaced.
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
        // Wakes the listener; where nobody listens any more there is nobody to wake.
        let _ = UnixStream::connect(&self.path);
        let _ = std::fs::remove_file(&self.path);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn listen(listener: &UnixListener, greeting: &Greeting, orders: &Lanes, shared: &Arc<Shared>) {
    let clients = Arc::new(AtomicUsize::new(0));
    for stream in listener.incoming() {
        if shared.ended.load(Ordering::Relaxed) {
            return;
        }
        let Ok(stream) = stream else { continue };
        if clients.fetch_add(1, Ordering::Relaxed) >= CLIENTS_MAX {
            clients.fetch_sub(1, Ordering::Relaxed);
            continue;
        }
        let (greeting, orders, shared, clients) = (greeting.clone(), orders.clone(), shared.clone(), clients.clone());
        std::thread::spawn(move || {
            // A client that has gone is no error of the owner's.
            let _ = serve(stream, &greeting, &orders, &shared);
            clients.fetch_sub(1, Ordering::Relaxed);
        });
    }
}

/// An order without an answer yet.
struct Pending {
    id: u64,
    answer: Receiver<Answer>,
    /// Whether it ends with its client.
    is_motion: bool,
}

fn serve(mut stream: UnixStream, greeting: &Greeting, orders: &Lanes, shared: &Shared) -> io::Result<()> {
    stream.set_read_timeout(Some(LOOK))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    send(&mut stream, greeting)?;
    let mut lines = Lines::default();
    let mut pending: Vec<Pending> = Vec::new();
    let mut followed: Option<Followed> = None;
    let life = Life::default();
    let result = loop {
        if shared.ended.load(Ordering::Relaxed) {
            break Ok(());
        }
        match lines.read(&mut stream) {
            Ok(true) => {}
            Ok(false) => break Ok(()),
            Err(error) => break Err(error),
        }
        while let Some(line) = lines.take() {
            let question: Question = serde_json::from_slice(&line)?;
            match question.ask {
                Ask::Snapshot => {
                    let snapshot = shared.snapshot.lock().unwrap_or_else(PoisonError::into_inner);
                    let said = Said::Snapshot(snapshot.clone());
                    drop(snapshot);
                    send(&mut stream, &Response { id: question.id, said })?;
                }
                Ask::Order(_) if pending.len() >= PENDING_MAX => {
                    let many = Failure::new(code::FAILED, "too many orders without an answer at once");
                    let said = Said::Answer(Err(many));
                    send(&mut stream, &Response { id: question.id, said })?;
                }
                Ask::Order(order) => pending.push(give(question.id, order, &life, orders)),
                Ask::Alive => life.sign(),
                Ask::Follow => followed = Some(Followed::begin(question.id, &mut stream, shared)?),
            }
        }
        if let Some(followed) = &followed {
            followed.send(&mut stream)?;
        }
        let mut waiting = Vec::new();
        for entry in pending.drain(..) {
            let answer = match entry.answer.try_recv() {
                Ok(answer) => answer,
                Err(TryRecvError::Empty) => {
                    waiting.push(entry);
                    continue;
                }
                Err(TryRecvError::Disconnected) => Err(Failure::new(code::CONNECTION, "the owner of the port ends")),
            };
            let said = Said::Answer(answer);
            send(&mut stream, &Response { id: entry.id, said })?;
        }
        pending = waiting;
    };
    if pending.iter().any(|entry| entry.is_motion) {
        drop(orders.give(Order::Cancel, None, None));
    }
    result
}

/// A client that is told everything.
struct Followed {
    id: u64,
    news: Subscription,
}

impl Followed {
    /// Tells what was before, so that the client knows what it follows.
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

fn give(id: u64, order: Order, life: &Life, orders: &Lanes) -> Pending {
    let is_motion = matches!(order, Order::Motion(_));
    let answer = orders.give(order, is_motion.then(|| life.clone()), None);
    Pending { id, answer, is_motion }
}

fn send(stream: &mut UnixStream, message: &impl Serialize) -> io::Result<()> {
    let mut line = serde_json::to_vec(message)?;
    line.push(b'\n');
    stream.write_all(&line)
}

/// Bytes that arrive, line by line.
#[derive(Default)]
struct Lines(Vec<u8>);

impl Lines {
    /// Takes what has arrived, waiting a little; false at the end of the stream.
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

/// Another process' machine.
#[derive(Debug)]
pub struct Client {
    owner: Owner,
    reader: BufReader<UnixStream>,
    next: u64,
    /// A line that has not come to its end.
    begun: Vec<u8>,
}

impl Client {
    /// Finds the owner of a port, if it has one that shares its machine.
    pub fn find(port: &PortName) -> Option<Self> {
        Self::connect(&socket_path(port).ok()?)
    }

    fn connect(path: &Path) -> Option<Self> {
        let stream = UnixStream::connect(path).ok()?;
        stream.set_read_timeout(Some(PATIENCE)).ok()?;
        stream.set_write_timeout(Some(PATIENCE)).ok()?;
        let mut reader = BufReader::new(stream);
        let mut line = String::new();
        reader.read_line(&mut line).ok()?;
        let greeting: Greeting = serde_json::from_str(&line).ok()?;
        (greeting.etherpen == VERSION).then_some(Self {
            owner: greeting.owner,
            reader,
            next: 1,
            begun: Vec::new(),
        })
    }

    /// Who owns the port.
    pub fn owner(&self) -> &Owner {
        &self.owner
    }

    /// Gives an order and waits for its answer.
    ///
    /// # Errors
    /// Why it was not carried out, or that the owner has gone.
    pub fn carry_out(&mut self, order: Order) -> Answer {
        let said = match order {
            Order::Motion(_) => self.ask_alive(Ask::Order(order))?,
            order => self.ask(Ask::Order(order), None)?,
        };
        match said {
            Said::Answer(answer) => answer,
            Said::Snapshot(_) | Said::Account(_) => Err(self.gone(&"an answer to another question came")),
        }
    }

    /// The last that is known of the machine.
    ///
    /// # Errors
    /// The owner has gone.
    pub fn snapshot(&mut self) -> Result<Snapshot, Failure> {
        match self.ask(Ask::Snapshot, Some(PATIENCE))? {
            Said::Snapshot(snapshot) => Ok(snapshot),
            Said::Answer(_) | Said::Account(_) => Err(self.gone(&"an answer to another question came")),
        }
    }

    /// Follows the machine: everything that is recorded comes from now on.
    ///
    /// # Errors
    /// The owner has gone.
    pub fn follow(mut self) -> Result<Source, Failure> {
        let question = Question {
            id: self.next,
            ask: Ask::Follow,
        };
        match send(self.reader.get_mut(), &question) {
            Ok(()) => Ok(Source::Shared(self)),
            Err(cause) => Err(self.gone(&cause)),
        }
    }

    /// The next that is told to a follower, waited for at most this long between two pieces of it.
    pub(super) fn next_account(&mut self, longest: Duration) -> Result<Account, NoNews> {
        let stream = self.reader.get_mut();
        stream.set_read_timeout(Some(longest)).map_err(|_| NoNews::Closed)?;
        match self.reader.read_until(b'\n', &mut self.begun) {
            Ok(_) if self.begun.last() == Some(&b'\n') => {}
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                return Err(NoNews::Timeout);
            }
            Ok(_) | Err(_) => return Err(NoNews::Closed),
        }
        let response: Option<Response> = serde_json::from_slice(&self.begun).ok();
        self.begun.clear();
        match response.map(|response| response.said) {
            Some(Said::Account(digits)) => Account::from_digits(&digits).ok_or(NoNews::Closed),
            _ => Err(NoNews::Closed),
        }
    }

    fn gone(&self, cause: &dyn std::fmt::Display) -> Failure {
        Failure::new(
            code::CONNECTION,
            format!(
                "{} owns the port and does not answer ({cause}); look at it, or end it",
                self.owner
            ),
        )
    }

    fn ask(&mut self, ask: Ask, longest: Option<Duration>) -> Result<Said, Failure> {
        let id = self.next;
        self.next = id.wrapping_add(1);
        self.exchange(&Question { id, ask }, longest)
            .map_err(|cause| self.gone(&cause))
    }

    /// Asks, and says until the answer comes that this client is alive.
    fn ask_alive(&mut self, ask: Ask) -> Result<Said, Failure> {
        let id = self.next;
        self.next = id.wrapping_add(1);
        self.exchange_alive(&Question { id, ask })
            .map_err(|cause| self.gone(&cause))
    }

    fn exchange_alive(&mut self, question: &Question) -> io::Result<Said> {
        let id = question.id;
        let stream = self.reader.get_mut();
        stream.set_read_timeout(Some(SIGN))?;
        send(stream, question)?;
        loop {
            send(self.reader.get_mut(), &Question { id, ask: Ask::Alive })?;
            match self.reader.read_until(b'\n', &mut self.begun) {
                Ok(_) if self.begun.last() == Some(&b'\n') => break,
                Ok(_) => return Err(ErrorKind::UnexpectedEof.into()),
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                Err(error) => return Err(error),
            }
        }
        let line = std::mem::take(&mut self.begun);
        answer_to(id, &line)
    }

    fn exchange(&mut self, question: &Question, longest: Option<Duration>) -> io::Result<Said> {
        let stream = self.reader.get_mut();
        stream.set_read_timeout(longest)?;
        send(stream, question)?;
        let mut line = String::new();
        if self.reader.read_line(&mut line)? == 0 {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        answer_to(question.id, line.as_bytes())
    }
}

fn answer_to(id: u64, line: &[u8]) -> io::Result<Said> {
    let response: Response = serde_json::from_slice(line)?;
    match response.id == id {
        true => Ok(response.said),
        false => Err(io::Error::new(ErrorKind::InvalidData, "another question's answer")),
    }
}
