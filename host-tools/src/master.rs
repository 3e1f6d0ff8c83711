//! The project's EtherCAT master on this computer, in real time, over any transport.
//!
//! A separate thread exchanges frames once a millisecond and polls the supervisor. An ordinary computer is not a
//! real-time controller: a cycle waits up to [`REPLY_WAIT`] for its replies, so a late reply costs time but not the
//! request. The supervisor's milliseconds follow the wall clock, whatever the duration of a cycle. Outputs are zeros,
//! with which no drive moves.
//!
//! Invariant: the thread ends with its owner, with the transport, or after a failed bring-up.

use etherpen::ethercat::BusQueues;
use etherpen::ethercat::cyclic::{Arrival, BusCounters, Exchange, Turn};
use etherpen::ethercat::diagnostics::{ServiceRequest, ServiceResult};
use etherpen::ethercat::error::BusError;
use etherpen::ethercat::event::{BusCommand, BusEvent, Step};
use etherpen::ethercat::supervisor::Supervisor;
use etherpen::ethercat::wire::FRAME_LEN_MAX;
use etherpen::robot_bus::MASTER_ADDRESS;
use etherpen::robot_bus::{BUS_MESSAGE_BYTES, RobotBusSetup, RobotDrives};
use etherpen_segment::transport::Transport;
use std::io;
use std::pin::pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::sync::{Arc, LazyLock, Mutex, PoisonError};
use std::task::{Context, Waker};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Period of the exchange.
const PERIOD: Duration = Duration::from_millis(1);
/// Longest wait for a reply while replies arrive.
pub const REPLY_WAIT: Duration = Duration::from_millis(50);
/// Longest wait for a reply after some cycles without any.
const SILENT_WAIT: Duration = Duration::from_millis(1);
/// Cycles without a reply after which the bus counts as silent.
const SILENT_CYCLES: u32 = 10;

/// Most slaves on the bus.
const SLAVES_MAX: usize = 64;
/// Frames of a cycle behind the first one: four hold what 64 slaves with the longest process data have besides the first.
const FURTHER_FRAMES: usize = 4;

type HostExchange<'a> = Exchange<'a, RobotDrives, SLAVES_MAX, BUS_MESSAGE_BYTES, FURTHER_FRAMES>;
type HostQueues = BusQueues<RobotDrives, SLAVES_MAX, BUS_MESSAGE_BYTES, FURTHER_FRAMES>;

/// Why the master cannot run.
#[derive(Debug)]
pub enum MasterError {
    /// The bus was not brought up.
    Refused {
        /// The slave concerned, if any, from 0.
        position: Option<u8>,
        /// The step that failed.
        step: Step,
        /// Why it failed.
        error: BusError,
    },
    /// The transport to the segment was lost.
    Transport(io::Error),
    /// No answer arrived.
    Silent {
        /// Time waited.
        waited: Duration,
    },
}

/// Report of the thread.
enum MasterReport {
    Event(BusEvent),
    Answer(Box<ServiceResult>),
    Lost(io::Error),
}

/// A running master.
pub struct Master {
    requests: Sender<ServiceRequest>,
    reports: Receiver<MasterReport>,
    events: Vec<BusEvent>,
    counters: Arc<Mutex<BusCounters>>,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Master {
    /// Opens the bus for requests only: the slaves keep their state until a request changes it.
    ///
    /// # Errors
    /// No thread can be created.
    pub fn look(transport: Box<dyn Transport>) -> Result<Self, MasterError> {
        Self::new(transport, None)
    }

    /// Brings the bus up according to `setup`; `wait` is the time limit.
    ///
    /// # Errors
    /// The step that failed, or the loss of the transport.
    pub fn start(transport: Box<dyn Transport>, setup: RobotBusSetup, wait: Duration) -> Result<Self, MasterError> {
        let mut master = Self::new(transport, Some(setup))?;
        let until = Instant::now() + wait;
        loop {
            match master.report(until, wait)? {
                MasterReport::Event(BusEvent::Operational) => return Ok(master),
                MasterReport::Event(BusEvent::Refused { position, step, error }) => {
                    return Err(MasterError::Refused { position, step, error });
                }
                MasterReport::Event(event) => master.events.push(event),
                MasterReport::Answer(_) => {}
                MasterReport::Lost(error) => return Err(MasterError::Transport(error)),
            }
        }
    }

    fn new(transport: Box<dyn Transport>, setup: Option<RobotBusSetup>) -> Result<Self, MasterError> {
        let (requests, asked) = mpsc::channel();
        let (reporter, reports) = mpsc::channel();
        let ended = Arc::new(AtomicBool::new(false));
        let counters = Arc::new(Mutex::new(BusCounters::default()));
        let worker = Worker {
            transport,
            reporter,
            asked,
            ended: ended.clone(),
            counters: counters.clone(),
            silent_cycles: 0,
        };
        let thread = std::thread::Builder::new()
            .name("bus".into())
            .spawn(move || worker.run(setup))
            .map_err(MasterError::Transport)?;
        Ok(Self {
            requests,
            reports,
            events: Vec::new(),
            counters,
            ended,
            thread: Some(thread),
        })
    }

    /// Sends a request to the bus and waits for the answer, at most `wait`.
    ///
    /// # Errors
    /// The transport was lost, or no answer arrived.
    pub fn request(&mut self, request: ServiceRequest, wait: Duration) -> Result<ServiceResult, MasterError> {
        // A thread that has ended has reported why.
        let _ = self.requests.send(request);
        let until = Instant::now() + wait;
        loop {
            match self.report(until, wait)? {
                MasterReport::Answer(result) => return Ok(*result),
                MasterReport::Event(event) => self.events.push(event),
                MasterReport::Lost(error) => return Err(MasterError::Transport(error)),
            }
        }
    }

    /// Events of the supervisor since the last call.
    pub fn events(&mut self) -> Vec<BusEvent> {
        while let Ok(report) = self.reports.try_recv() {
            if let MasterReport::Event(event) = report {
                self.events.push(event);
            }
        }
        std::mem::take(&mut self.events)
    }

    /// Counters of the exchange.
    pub fn counters(&self) -> BusCounters {
        *self.counters.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn report(&self, until: Instant, wait: Duration) -> Result<MasterReport, MasterError> {
        let left = until.saturating_duration_since(Instant::now());
        self.reports.recv_timeout(left).map_err(|error| match error {
            RecvTimeoutError::Timeout => MasterError::Silent { waited: wait },
            RecvTimeoutError::Disconnected => MasterError::Transport(io::ErrorKind::BrokenPipe.into()),
        })
    }
}

impl Drop for Master {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // The reports contain the reason.
            let _ = thread.join();
        }
    }
}

/// The time of this program, ms, wrapping.
fn now_ms() -> u32 {
    static BEGUN: LazyLock<Instant> = LazyLock::new(Instant::now);
    BEGUN.elapsed().as_millis() as u32
}

/// The thread's side.
struct Worker {
    transport: Box<dyn Transport>,
    reporter: Sender<MasterReport>,
    asked: Receiver<ServiceRequest>,
    ended: Arc<AtomicBool>,
    counters: Arc<Mutex<BusCounters>>,
    silent_cycles: u32,
}

impl Worker {
    fn run(mut self, setup: Option<RobotBusSetup>) {
        let mut queues = Box::new(HostQueues::new());
        let (exchange_end, supervisor_end, mut application) = queues.split();
        let mut exchange = Exchange::new(exchange_end, MASTER_ADDRESS);
        let mut supervisor = Supervisor::new(supervisor_end).with_clock(now_ms);
        let mut supervision = pin!(supervisor.run());
        let mut context = Context::from_waker(Waker::noop());
        if let Some(setup) = setup {
            // The queue is empty.
            let _ = application.commands.enqueue(BusCommand::Start(setup));
        }
        let mut released = Instant::now();
        while !self.ended.load(Ordering::Relaxed) {
            if let Err(error) = self.cycle(&mut exchange, released + PERIOD) {
                let _ = self.reporter.send(MasterReport::Lost(error));
                return;
            }
            released = Instant::now();
            let _ = supervision.as_mut().poll(&mut context);
            *self.counters.lock().unwrap_or_else(PoisonError::into_inner) = exchange.counters();
            while let Some(event) = application.events.dequeue() {
                let _ = self.reporter.send(MasterReport::Event(event));
            }
            while let Some(answer) = application.answers.dequeue() {
                let _ = self.reporter.send(MasterReport::Answer(Box::new(answer)));
            }
            if application.services.ready()
                && let Ok(request) = self.asked.try_recv()
            {
                // There is room.
                let _ = application.services.enqueue(request);
            }
        }
    }

    /// Exchanges inputs, then outputs, and continues to receive until `until`.
    fn cycle(&mut self, exchange: &mut HostExchange, until: Instant) -> io::Result<()> {
        self.transact(exchange, Turn::First)?;
        self.transact(exchange, Turn::Second)?;
        let mut frame = [0; FRAME_LEN_MAX];
        loop {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(());
            }
            // A frame that arrives now is late, duplicated or foreign, and is counted.
            if let Some(length) = self.transport.receive(&mut frame, left)? {
                exchange.receive(frame.get(..length).unwrap_or(&[]));
            }
        }
    }

    /// Sends the telegrams of one direction and waits for their replies.
    fn transact(&mut self, exchange: &mut HostExchange<'_>, turn: Turn) -> io::Result<()> {
        let mut telegram = match turn {
            Turn::First => exchange.input_telegram(),
            Turn::Second => exchange.output_telegram(),
        };
        while !telegram.is_empty() {
            self.transport.send(telegram)?;
            telegram = match turn {
                Turn::First => exchange.next_input_telegram(),
                Turn::Second => exchange.next_output_telegram(),
            };
        }
        let wait = if self.silent_cycles < SILENT_CYCLES {
            REPLY_WAIT
        } else {
            SILENT_WAIT
        };
        let until = Instant::now() + wait;
        let mut frame = [0; FRAME_LEN_MAX];
        while exchange.awaits_replies(turn) {
            let left = until.saturating_duration_since(Instant::now());
            if let Some(length) = self.transport.receive(&mut frame, left)?
                && matches!(
                    exchange.receive(frame.get(..length).unwrap_or(&[])),
                    Arrival::Input | Arrival::Output
                )
            {
                self.silent_cycles = 0;
            } else if left.is_zero() {
                self.silent_cycles = self.silent_cycles.saturating_add(1);
                break;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::ethercat::slave_set::SlaveSet;
    use etherpen_segment::{AlState, Flywheel, Segment, SegmentOptions, SlaveKind};
    use std::collections::VecDeque;

    /// Time for a bring-up on a busy computer.
    const PATIENCE: Duration = Duration::from_mins(5);

    /// A virtual segment in this process.
    struct Wire {
        segment: Arc<Mutex<Segment<Flywheel>>>,
        replies: VecDeque<Vec<u8>>,
        begun: Instant,
    }

    impl Transport for Wire {
        fn send(&mut self, frame: &[u8]) -> io::Result<()> {
            let now_us = u64::try_from(self.begun.elapsed().as_micros()).unwrap_or(u64::MAX);
            let mut segment = self.segment.lock().expect("the segment");
            self.replies.extend(segment.frame(now_us, frame));
            Ok(())
        }

        fn receive(&mut self, frame: &mut [u8], wait: Duration) -> io::Result<Option<usize>> {
            let Some(reply) = self.replies.pop_front() else {
                std::thread::sleep(wait.min(Duration::from_millis(1)));
                return Ok(None);
            };
            frame[..reply.len()].copy_from_slice(&reply);
            Ok(Some(reply.len()))
        }
    }

    /// Starts a master on so many terminals, and what it controls.
    fn start(slaves: usize) -> (Result<Master, MasterError>, Arc<Mutex<Segment<Flywheel>>>) {
        let kinds = [SlaveKind::El1008, SlaveKind::El2008];
        let options = SegmentOptions {
            slaves: kinds.into_iter().cycle().take(slaves).collect(),
            ..SegmentOptions::default()
        };
        let segment = Arc::new(Mutex::new(Segment::new(&options, Flywheel::default())));
        let wire = Wire {
            segment: segment.clone(),
            replies: VecDeque::new(),
            begun: Instant::now(),
        };
        let setup = RobotBusSetup {
            terminals: SlaveSet::ALL,
            // A busy computer must not stop the outputs.
            watchdog_ms: 5_000,
            ..RobotBusSetup::default()
        };
        (Master::start(Box::new(wire), setup, PATIENCE), segment)
    }

    #[test]
    fn a_chain_of_64_slaves_comes_up_in_several_frames_and_one_more_is_refused_with_the_limit() {
        let (master, segment) = start(SLAVES_MAX);
        let mut master = master.expect("64 slaves");
        let states = segment.lock().expect("the segment").slaves();
        assert_eq!(states.len(), SLAVES_MAX);
        assert!(
            states.iter().all(|state| state.al_state == AlState::Operational),
            "{:#?}",
            master.events()
        );
        let (master, _segment) = start(SLAVES_MAX + 1);
        match master.map(|_| ()) {
            Err(MasterError::Refused {
                error: BusError::TooManySlaves { expected, actual },
                ..
            }) => assert_eq!((expected, actual), (64, 65)),
            other => panic!("{other:?}"),
        }
    }
}
