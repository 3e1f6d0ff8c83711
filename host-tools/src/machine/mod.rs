//! One machine, several users: a thread owns the port and all communication over it.
//!
//! ```text
//! Machine::start(port, config, options)     the thread: Port -> Line -> Job; reconnects every second
//!     .order(Order)      -> Receiver<Answer>   one answer to every order: Ok(Reply) or Err(Failure)
//!     .ticket()          -> Ticket             for .order_for(Ticket, Order): requested now, ordered later
//!     .subscribe(length) -> Subscription       bounded; a slow reader loses the oldest news and is told how many
//!     .snapshot()        -> Snapshot           last known state, for users that start late
//! Client::find(port)                         another process's machine: the same orders and snapshots over a socket
//! Source::follow(client)                     the data that a recording is made of
//! ```
//!
//! A task ([`Order::Settle`], [`Order::Prepare`], [`Order::Motion`], [`Order::Draw`]) takes a while, and only one runs
//! at a time; every other order is sent at once beside it. [`Order::Stop`] overtakes everything: earlier orders that
//! are not answered yet fail, and earlier stops get the newest stop's answer. A stop has a queue of its own, and the
//! thread does nothing else that takes longer than a millisecond. [`Order::Draw`] is answered when the drawing has
//! ended; [`News::Ended`] carries its report.
//!
//! Invariants: only motions ordered over this connection are carried out. A broken connection is reported and restored;
//! a drawing that was in progress is held until [`Order::Resume`] or [`Order::Cancel`], as long as the firmware still
//! has it. No reader and no user can block the thread.

pub(crate) mod access;
mod account;
pub mod drawing;
pub(crate) mod ending;
mod following;
mod lanes;
mod reference;
mod sharing;
mod subscription;
mod work;

use crate::error::{ProgramError, code};
use crate::job::error::JobError;
use crate::job::progress::Progress;
use crate::job::resume::MachineState;
use crate::job::{DrawTask, JobEvent, JobReport, Motion, Ready};
use crate::link::ownership::Ownership;
use crate::link::port::{self, Line, Port, PortError, PortName};
use crate::link::session::session_number;
pub use account::Account;
use etherpen::config::Config;
use etherpen::ethercat::diagnostics::{ServiceRequest, ServiceResult};
use etherpen::link::message::PathAck;
use etherpen::messages::{Command, RecordAnswer, RecordRequest, Sample, Status, Welcome};
pub use following::Source;
use lanes::{Lanes, Taken};
pub use lanes::{OVERTAKEN, Ticket};
pub use reference::{reference_through, refuse_other_configuration};
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

/// Time between two attempts to reconnect.
const RECONNECT: Duration = Duration::from_secs(1);
/// Longest wait for a machine's state; the link's own time limit is shorter.
const STATE_MAX: Duration = Duration::from_secs(10);
/// Longest wait for the path state of a firmware that holds a drawing.
const PATH_MAX: Duration = Duration::from_millis(500);
/// Time between two checks.
const LOOK: Duration = Duration::from_millis(10);

/// An order to a machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // few are alive at a time
pub enum Order {
    /// Send a single command at once.
    Tell(Command),
    /// Decelerate on the path, lift the pen and wait.
    Hold,
    /// Hold as soon as the pen is up.
    HoldAtPenUp,
    /// Resume a held drawing, including one that was in progress when the connection broke.
    Resume,
    /// End the task, or the abandoned drawing of another connection.
    Cancel,
    /// Stop at once, on the path if there is one; latched as a fault.
    Stop,
    /// Scale the path speed, percent from 10 to 200.
    Override(u8),
    /// Move while this order is repeated within the firmware's dead-man time (100 ms); mm/s. Does not prepare the
    /// machine.
    Jog([f32; 3]),
    /// A single command, answered when its effect is reported; a task.
    Settle(Command),
    /// Prepare the machine; a task.
    Prepare(Ready),
    /// Prepare, move, then restore the power state; a task.
    Motion(Motion),
    /// Prepare, draw, then switch the power off; a task.
    #[serde(skip)]
    Draw(DrawOrder),
    /// Request to the bus; answered by [`Reply::Bus`].
    Bus(ServiceRequest),
    /// Request to what the firmware records of itself; answered by [`Reply::Measured`].
    Measure(RecordRequest),
}

/// A drawing to be made.
#[derive(Clone, Debug, PartialEq)]
pub struct DrawOrder {
    /// The path with its options.
    pub drawing: DrawTask,
    /// Name for display.
    pub name: String,
    /// Whether all samples are kept for the report.
    pub keep_samples: bool,
}

/// Reply to an order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // few are alive at a time
pub enum Reply {
    /// The order was carried out.
    Done,
    /// Answer to [`Order::Bus`].
    Bus(ServiceResult),
    /// Answer to [`Order::Measure`].
    Measured(RecordAnswer),
}

/// Why an order was not carried out, or why there is no connection.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// Exit code, as `etherpen --help` lists them.
    pub code: u8,
    /// What happened, and what to try.
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
        ProgramError::from(error).into()
    }
}

impl From<&PortError> for Failure {
    fn from(error: &PortError) -> Self {
        ProgramError::from(error).into()
    }
}

impl From<ProgramError> for Failure {
    fn from(error: ProgramError) -> Self {
        Self {
            code: error.code,
            text: error.message,
        }
    }
}

impl From<Failure> for ProgramError {
    fn from(failure: Failure) -> Self {
        Self::new(failure.code, failure.text)
    }
}

/// The one answer to an order.
pub type Answer = Result<Reply, Failure>;

/// An event on a machine.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant)] // the frequent ones are shared
pub enum News {
    /// The firmware has answered the greeting.
    Connected(Welcome),
    /// The connection has broken, or could not be made.
    Lost(Failure),
    /// The next attempt to connect is starting.
    Reconnecting {
        /// Number of the attempt, from 1 since the connection broke.
        attempt: u32,
    },
    /// State of the firmware; sent on every change and at least twice a second.
    Status(Arc<Status>),
    /// Telemetry.
    Samples {
        /// Samples lost directly before these.
        missing: u32,
        /// One a millisecond, in order.
        samples: Arc<[Sample]>,
    },
    /// Any other event of a task.
    Job(JobEvent),
    /// Progress of the drawing, ten times a second.
    Progress(Progress),
    /// A drawing has started, or continues after the connection broke.
    Begun {
        /// Name of the drawing.
        name: String,
        /// Path of the drawing.
        drawing: DrawTask,
    },
    /// A task has ended.
    Ended {
        /// The result.
        result: Result<(), Failure>,
        /// Report of a drawing.
        report: Option<Arc<JobReport>>,
    },
}

/// The last known state of a machine.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Snapshot {
    /// The firmware, while there is a connection.
    pub welcome: Option<Welcome>,
    /// Why there is no connection.
    pub lost: Option<Failure>,
    /// The last status.
    pub status: Option<Status>,
    /// The last sample.
    pub sample: Option<Sample>,
    /// State of the firmware's path, if another connection sent it.
    pub path: Option<PathAck>,
    /// Phase of the task, in words.
    pub phase: Option<String>,
    /// Name of the drawing in progress.
    pub drawing: Option<String>,
    /// Progress of the drawing.
    pub progress: Option<Progress>,
    /// Whether the drawing waits for [`Order::Resume`] after the connection broke.
    pub interrupted: bool,
}

/// Options of a machine.
#[derive(Clone, Copy, Debug, Default)]
pub struct MachineOptions {
    /// Whether a task acknowledges an earlier fault, and cancels an abandoned drawing.
    pub acknowledge: bool,
    /// Whether to keep retrying, instead of failing, if the port cannot be opened at the start.
    pub patient: bool,
}

/// Data shared by the thread and the users.
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

/// A machine at a port. Dropping it closes the port; a firmware that is drawing then holds by itself.
#[derive(Debug)]
pub struct Machine {
    port: PortName,
    lanes: Lanes,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    server: Option<Server>,
}

impl Machine {
    /// Opens the port, connects, and shares the machine with other processes of this user. Tasks send `config` when
    /// they prepare the machine.
    ///
    /// # Errors
    /// The port is in use by another program, or cannot be opened.
    pub fn start(port: PortName, config: Config, options: MachineOptions) -> Result<Self, PortError> {
        Self::start_sharing(port, config, options, Arc::default())
    }

    /// Like [`start`](Self::start), with all the news since then; at most `capacity` of them wait.
    ///
    /// # Errors
    /// The port is in use by another program, or cannot be opened.
    pub fn start_with_news(
        port: PortName,
        config: Config,
        options: MachineOptions,
        capacity: usize,
    ) -> Result<(Self, Subscription), PortError> {
        let shared = Arc::<Shared>::default();
        let news = shared.subscribers.subscribe(capacity);
        Ok((Self::start_sharing(port, config, options, shared)?, news))
    }

    fn start_sharing(
        port: PortName,
        config: Config,
        options: MachineOptions,
        shared: Arc<Shared>,
    ) -> Result<Self, PortError> {
        let ownership = port::own(&port)?;
        let opened = match Port::open_owned(&port, ownership.clone()) {
            Err(error) if !options.patient => return Err(error),
            opened => opened,
        };
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
        // Without a socket other processes cannot find the machine; everything else works.
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

    /// Sends an order. Exactly one answer arrives, or the channel closes when the machine is dropped.
    pub fn order(&self, order: Order) -> Receiver<Answer> {
        self.lanes.give(order, None, None)
    }

    /// A ticket for a request made now, to be ordered with [`order_for`](Self::order_for).
    pub fn ticket(&self) -> Ticket {
        self.lanes.ticket()
    }

    /// Whether a stop was ordered after this ticket was taken; orders with such a ticket are refused.
    pub fn is_overtaken(&self, ticket: Ticket) -> bool {
        self.lanes.is_overtaken(ticket)
    }

    /// Sends an order that was requested when the ticket was taken; refused if a stop was ordered since.
    pub fn order_for(&self, ticket: Ticket, order: Order) -> Receiver<Answer> {
        self.lanes.give_for(ticket, order, None, None)
    }

    /// Orders a stop. `written` is called in the machine's thread once the telegram has been written to the port, or
    /// cannot be written.
    pub fn stop(&self, written: impl FnOnce() + Send + 'static) -> Receiver<Answer> {
        self.lanes.give(Order::Stop, None, Some(Box::new(written)))
    }

    /// Sends an order and waits for its answer.
    ///
    /// # Errors
    /// Why the order was not carried out.
    pub fn carry_out(&self, order: Order) -> Answer {
        let ended = || Failure::new(code::FAILED, "the machine's thread has ended");
        self.order(order).recv().map_err(|_| ended())?
    }

    /// News from now on; at most `capacity` of them wait.
    pub fn subscribe(&self, capacity: usize) -> Subscription {
        self.shared.subscribers.subscribe(capacity)
    }

    /// The last known state.
    pub fn snapshot(&self) -> Snapshot {
        self.shared
            .snapshot
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// State of the machine, including the path that the firmware has; waits until both are known.
    ///
    /// # Errors
    /// There is no connection, or the machine does not answer.
    pub fn known_state(&self) -> Result<Snapshot, Failure> {
        let until = Instant::now() + STATE_MAX;
        let mut known_since = None;
        loop {
            let snapshot = self.snapshot();
            if let Some(lost) = snapshot.lost {
                return Err(lost);
            }
            if snapshot.status.is_some() && snapshot.phase.is_none() {
                let since = *known_since.get_or_insert_with(Instant::now);
                if snapshot.path.is_some() || since.elapsed() > PATH_MAX {
                    return Ok(snapshot);
                }
            }
            if Instant::now() > until {
                return Err(Failure::new(code::CONNECTION, "the machine does not report its state"));
            }
            std::thread::sleep(LOOK);
        }
    }
}

impl From<Snapshot> for MachineState {
    fn from(known: Snapshot) -> Self {
        Self {
            welcome: known.welcome,
            status: known.status,
            path: known.path,
        }
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        self.server = None;
        self.shared.ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has reported that on stderr.
            let _ = thread.join();
        }
        self.shared.subscribers.close();
    }
}

/// The thread's main loop: keeps a connection until the machine is dropped.
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

/// Runs one connection until it breaks (returns the reason) or the machine is dropped.
fn converse(port: Port, work: &mut Work, orders: &mut Taken, shared: &Shared, attempt: &mut u32) -> Option<Failure> {
    work.connect(session_number());
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
