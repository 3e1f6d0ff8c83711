//! One machine, several users: a thread owns the port and everything that is said over it.
//!
//! ```text
//! Machine::start(port, config, options)     the thread: Port -> Line -> Job, again every second when it breaks
//!     .order(Order)      -> Receiver<Answer>   one answer to every order: Ok(Reply) or Err(Failure)
//!     .subscribe(length) -> Subscription       bounded; a slow reader loses the oldest news and is told how many
//!     .snapshot()        -> Snapshot           the last that is known, for who comes late
//! Client::find(port)                         another process' machine: the same orders and snapshots over a socket
//!     .follow()                              and what a recording is made of
//! ```
//!
//! A task ([`Order::Settle`], [`Order::Prepare`], [`Order::Motion`], [`Order::Draw`]) takes a while and there is one at a time; every other
//! order goes out at once beside it. [`Order::Stop`] overtakes everything: what was ordered before it and is not answered
//! yet is answered with a failure; it has a way of its own to the thread, and the thread nothing else to do that takes
//! longer than a millisecond. A drawing's receiver is answered when the drawing has ended, [`News::Ended`] carries its
//! report.
//!
//! Invariants: nothing moves that was not ordered over this connection; when the connection breaks, it is made again and
//! says so, and a drawing that was under way waits, held, for [`Order::Resume`] or [`Order::Cancel`], as long as the
//! firmware has it still; no reader and no user can block the thread.

mod following;
mod lanes;
mod sharing;
mod subscription;
mod work;

use crate::link::error::JobError;
use crate::link::job::{Drawing, JobEvent, JobReport, Motion, Ready};
use crate::link::ownership::Ownership;
use crate::link::port::{self, Line, Port, PortError, PortName};
use crate::link::progress::Progress;
use etherpen::config::Config;
use etherpen::ethercat::service::{ServiceRequest, ServiceResult};
use etherpen::link::protocol::{Command, PathAck, Sample, Status, Welcome};
use etherpen::measurement::{MeasurementAnswer, MeasurementRequest};
pub use following::{Account, Source};
use lanes::{Lanes, Taken};
use serde::{Deserialize, Serialize};
pub use sharing::Client;
use sharing::Server;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use subscription::Subscribers;
pub use subscription::{NoNews, Subscription};
use work::Work;

/// Time between two attempts to connect again.
const RECONNECT: Duration = Duration::from_secs(1);

/// What a machine is asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // few are alive at a time
pub enum Order {
    /// A single command as it is, at once.
    Tell(Command),
    /// Decelerate on the path, lift the pen, wait.
    Hold,
    /// Hold as soon as the pen is up.
    HoldAtPenUp,
    /// Go on with a held drawing, also with one that was under way when the connection broke.
    Resume,
    /// End the task, or the drawing that another connection has left behind.
    Cancel,
    /// Quick stop, latched as a fault.
    Stop,
    /// Scale the path speed, percent from 10 to 200.
    Override(u8),
    /// Move while this order is repeated within the firmware's dead-man time (100 ms); mm/s. Nothing is made ready for it.
    Jog([f32; 3]),
    /// A single command, answered when its effect is reported; a task.
    Settle(Command),
    /// Make the machine ready; a task.
    Prepare(Ready),
    /// Make ready, move, leave the power as it was found; a task.
    Motion(Motion),
    /// Make ready, draw, give up the power; a task.
    #[serde(skip)]
    Draw(DrawOrder),
    /// Ask something of the bus; answered by [`Reply::Bus`].
    Bus(ServiceRequest),
    /// Ask something of the measurements; answered by [`Reply::Measured`].
    Measure(MeasurementRequest),
}

/// A drawing to be made.
#[derive(Clone, Debug, PartialEq)]
pub struct DrawOrder {
    /// The path and what is known of it.
    pub drawing: Drawing,
    /// What it is called, for people.
    pub name: String,
    /// Whether all samples are kept for the report.
    pub keep_samples: bool,
}

/// What an order has come to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // few are alive at a time
pub enum Reply {
    /// It was done.
    Done,
    /// Answer to [`Order::Bus`].
    Bus(ServiceResult),
    /// Answer to [`Order::Measure`].
    Measured(MeasurementAnswer),
}

/// Why an order was not carried out, or why there is no connection.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// Exit code, as `etherpen --help` lists them.
    pub code: u8,
    /// What happened and what to try.
    pub text: String,
}

impl Failure {
    fn new(code: u8, text: impl std::fmt::Display) -> Self {
        Self {
            code,
            text: text.to_string(),
        }
    }
}

impl std::fmt::Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.text)
    }
}

impl std::error::Error for Failure {}

impl From<&JobError> for Failure {
    fn from(error: &JobError) -> Self {
        let error = crate::commands::job_error(error);
        Self {
            code: error.code,
            text: error.message,
        }
    }
}

impl From<&PortError> for Failure {
    fn from(error: &PortError) -> Self {
        Self::new(crate::commands::code::CONNECTION, error)
    }
}

/// An order's one answer.
pub type Answer = Result<Reply, Failure>;

/// What happens on a machine.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant)] // the frequent ones are shared
pub enum News {
    /// The firmware has answered the greeting.
    Connected(Welcome),
    /// The connection has broken, or could not be made.
    Lost(Failure),
    /// It is tried again.
    Reconnecting {
        /// Counted from 1 since the connection broke.
        attempt: u32,
    },
    /// Where the firmware stands; at every change and at least twice a second.
    Status(Arc<Status>),
    /// Telemetry.
    Samples {
        /// Samples that were lost right before these.
        missing: u32,
        /// One a millisecond, in order.
        samples: Arc<[Sample]>,
    },
    /// Everything else that a task has to say.
    Job(JobEvent),
    /// How far the drawing is, ten times a second.
    Progress(Progress),
    /// A drawing has begun, or goes on after the connection broke.
    Begun {
        /// What it is called.
        name: String,
        /// Its path.
        drawing: Drawing,
    },
    /// A task has ended.
    Ended {
        /// How.
        result: Result<(), Failure>,
        /// What a drawing has left behind.
        report: Option<Arc<JobReport>>,
    },
}

/// The last that is known of a machine.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Snapshot {
    /// The firmware, while there is a connection.
    pub welcome: Option<Welcome>,
    /// Why there is none.
    pub lost: Option<Failure>,
    /// The last status.
    pub status: Option<Status>,
    /// The last sample.
    pub sample: Option<Sample>,
    /// What the firmware says of the path that it has, where it is another connection's.
    pub path: Option<PathAck>,
    /// What the task is doing, in words.
    pub phase: Option<String>,
    /// Name of the drawing that is under way.
    pub drawing: Option<String>,
    /// How far it is.
    pub progress: Option<Progress>,
    /// Whether it waits for [`Order::Resume`] after the connection broke.
    pub interrupted: bool,
}

/// How a machine is used.
#[derive(Clone, Copy, Debug, Default)]
pub struct MachineOptions {
    /// Whether a task acknowledges a fault that was latched before, and cancels a drawing left behind.
    pub acknowledge: bool,
    /// Whether a port that cannot be opened is tried again from the beginning, instead of being an error.
    pub patient: bool,
}

/// What the thread shares with the users.
#[derive(Debug, Default)]
struct Shared {
    subscribers: Subscribers,
    snapshot: Mutex<Snapshot>,
    ended: AtomicBool,
}

impl Shared {
    fn publish(&self, news: News) {
        self.subscribers.publish(&news);
    }

    fn change(&self, change: impl FnOnce(&mut Snapshot)) {
        change(&mut self.snapshot.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

/// A machine at the end of a port; dropping it closes the port. A firmware that was drawing then holds by itself.
#[derive(Debug)]
pub struct Machine {
    port: PortName,
    lanes: Lanes,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    server: Option<Server>,
}

impl Machine {
    /// Opens the port, connects, and shares the machine with other processes of this user; the configuration is what
    /// tasks send when they make the machine ready.
    ///
    /// # Errors
    /// The port is another program's, or cannot be opened.
    pub fn start(port: PortName, config: Config, options: MachineOptions) -> Result<Self, PortError> {
        let ownership = port::own(&port)?;
        let opened = match Port::open_owned(&port, ownership.clone()) {
            Err(error) if !options.patient => return Err(error),
            opened => opened,
        };
        let shared = Arc::new(Shared::default());
        let (lanes, taken) = lanes::lanes();
        let work = Work::new(config, options, shared.clone());
        let thread = std::thread::Builder::new().name("machine".into()).spawn({
            let (shared, port, ownership) = (shared.clone(), port.clone(), ownership.clone());
            move || attend(&port, ownership, opened, work, taken, &shared)
        });
        let thread = thread.map_err(|source| PortError::Open {
            port: port.clone(),
            source,
        })?;
        // Where there is no place for a socket, nobody else can find the machine; it works all the same.
        let server = ownership.and_then(|_| Server::start(&port, lanes.clone(), shared.clone()).ok());
        Ok(Self {
            port,
            lanes,
            shared,
            thread: Some(thread),
            server,
        })
    }

    /// The port.
    pub fn port(&self) -> &PortName {
        &self.port
    }

    /// Gives an order; exactly one answer comes, or the channel closes when the machine is dropped.
    pub fn order(&self, order: Order) -> Receiver<Answer> {
        self.lanes.give(order, None, None)
    }

    /// Orders a stop; `written` is called, in the machine's thread, once its telegram has been written to the port, or
    /// cannot be.
    pub fn stop(&self, written: impl FnOnce() + Send + 'static) -> Receiver<Answer> {
        self.lanes.give(Order::Stop, None, Some(Box::new(written)))
    }

    /// Gives an order and waits for its answer.
    ///
    /// # Errors
    /// Why it was not carried out.
    pub fn carry_out(&self, order: Order) -> Answer {
        let ended = || Failure::new(crate::commands::code::FAILED, "the machine's thread has ended");
        self.order(order).recv().map_err(|_| ended())?
    }

    /// News from now on, at most this many waiting.
    pub fn subscribe(&self, capacity: usize) -> Subscription {
        self.shared.subscribers.subscribe(capacity)
    }

    /// The last that is known.
    pub fn snapshot(&self) -> Snapshot {
        self.shared
            .snapshot
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        self.server = None;
        self.shared.ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has said so on stderr.
            let _ = thread.join();
        }
        self.shared.subscribers.close();
    }
}

/// The thread: keeps a connection until the machine is dropped.
fn attend(
    name: &PortName,
    ownership: Option<Arc<Ownership>>,
    mut opened: Result<Port, PortError>,
    mut work: Work,
    mut orders: Taken,
    shared: &Shared,
) {
    let mut attempt = 0;
    while !shared.ended.load(Ordering::Relaxed) {
        let lost = match opened {
            Ok(port) => converse(port, &mut work, &mut orders, shared, &mut attempt),
            Err(error) => Some(Failure::from(&error)),
        };
        let Some(lost) = lost else { return };
        work.lose(&lost);
        let again = Instant::now() + RECONNECT;
        while Instant::now() < again && !shared.ended.load(Ordering::Relaxed) {
            orders.take_within(Duration::from_millis(20), |envelope| work.refuse(&envelope, &lost));
        }
        attempt += 1;
        shared.publish(News::Reconnecting { attempt });
        opened = Port::open_owned(name, ownership.clone());
    }
}

/// One connection, until it breaks (with the reason) or the machine is dropped.
fn converse(port: Port, work: &mut Work, orders: &mut Taken, shared: &Shared, attempt: &mut u32) -> Option<Failure> {
    work.connect(crate::commands::session_number());
    let mut line = Line::start(port);
    while !shared.ended.load(Ordering::Relaxed) {
        let exchanged = line.exchange(|now_ms, incoming, outgoing, room| {
            orders.take(|envelope| work.order(envelope));
            work.step(now_ms, incoming, outgoing, room);
        });
        work.tell_written();
        if let Err(error) = exchanged {
            return Some(Failure::from(&error));
        }
        if let Some(error) = work.broken() {
            return Some(Failure::from(error));
        }
        if work.is_connected() {
            *attempt = 0;
        }
    }
    None
}

#[cfg(test)]
mod tests;
