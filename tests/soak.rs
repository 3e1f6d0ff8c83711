//! A soak in virtual time: the whole controller draws while every kind of frame fault hits one frame in a hundred.
//!
//! Each of the fourteen kinds has its own 1 %, so that 13 % of the frames are hit, some by several kinds at once. What
//! the cell did to each frame gives the counts that the exchange must have, kind by kind; they are compared exactly.
//!
//! Eleven of the kinds cost a cycle its positions: a cycle is blind with p = 1 - 0.99^11 = 0.105. Six blind cycles in a
//! row, beyond the default limit of 5 ms, are then likely: 10^6 p^6 (1 - p) = 1.2 such runs are expected in a million
//! cycles. The limit is set to the highest allowed, 8 ms: nine in a row come with 10^6 p^9 (1 - p) = 0.0014.

use etherpen::application::{Mode, Refusal};
use etherpen::config::Config;
use etherpen::ethercat::cyclic::{BusCounters, ExchangeKind, IGNORED_KINDS, Ignored};
use etherpen::ethercat::diagnostics::{ServiceReply, ServiceRequest};
use etherpen::ethercat::wire::coe::Object;
use etherpen::messages::{Command, PathVertex, Status};
use etherpen::motion::Pen;
use etherpen::robots::AXES;
use host_tools::cell::{AlState, Cell, CellOptions, DriveState};
use host_tools::emulator::Segment;
use host_tools::link::session::{Event, Session};
use host_tools::simulation::{self, Host};
use std::collections::{BTreeMap, VecDeque};
use std::rc::Rc;

/// Every fault of frames, each with 1 %.
const SCRIPT: &str = "1% of frames: drop\n1% of frames: lose\n1% of frames: delay 2\n1% of frames: duplicate\n\
    1% of frames: truncate 20\n1% of frames: overlong 10\n1% of frames: index 7\n1% of frames: counter 1\n\
    1% of frames: type 4\n1% of frames: more\n1% of frames: circulate\n1% of frames: vlan\n1% of frames: foreign\n\
    1% of frames: reflect";
/// Frames by which the script's `delay` is late.
const DELAY_FRAMES: u64 = 2;
/// Highest blind limit that a configuration may have, ms.
const BLIND_MAX_MS: u16 = 8;
/// Longest time from the start to the first drawing, ms.
const PREPARATION_MAX_MS: u32 = 60_000;
/// Time between two bus requests, ms.
const QUESTION_PERIOD_MS: u32 = 250;
/// Device name, longer than an expedited transfer takes.
const DEVICE_NAME: Object = Object::new(0x1008, 0);

/// What the exchange must have counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Expected {
    ignored: [u64; IGNORED_KINDS],
    frames_lost: u64,
    working_counter_errors: u64,
}

/// The cell, and what each of its faults must cost.
struct WatchedCell {
    cell: Cell,
    before: BTreeMap<&'static str, u64>,
    /// Delayed replies: the frame with which they arrive, and the kind as which they are dropped.
    delayed: VecDeque<(u64, Ignored)>,
    /// Telegrams of this cycle without an acceptable reply.
    unanswered: u64,
    expected: Expected,
    /// Whether all slaves are in use.
    drawing: Rc<std::cell::Cell<bool>>,
}

impl WatchedCell {
    fn ignore(&mut self, kind: Ignored) {
        self.expected.ignored[kind as usize] += 1;
    }

    /// Accounts for what was done to one frame.
    fn account(&mut self) {
        let frame = self.cell.frames();
        while self.delayed.front().is_some_and(|(due, _)| *due <= frame) {
            let (_, kind) = self.delayed.pop_front().expect("there is one");
            self.ignore(kind);
        }
        let after = self.cell.injected().clone();
        let before = std::mem::replace(&mut self.before, after);
        let after = self.before.clone();
        let hit = |name: &str| after.get(name) != before.get(name);
        if hit("drop") || hit("lose") {
            self.unanswered += 1;
            return;
        }
        if hit("foreign") {
            self.ignore(Ignored::EtherType);
        }
        if hit("reflect") {
            self.ignore(Ignored::Reflection);
        }
        // The envelope is looked at first, then the index, then the chain.
        let damage = if hit("vlan") {
            Some(Ignored::EtherType)
        } else if hit("type") {
            Some(Ignored::FrameType)
        } else if hit("truncate") {
            Some(Ignored::Truncated)
        } else if hit("index") {
            Some(Ignored::ForeignIndex)
        } else if hit("delay") {
            Some(Ignored::Late)
        } else if hit("overlong") || hit("more") {
            Some(Ignored::Mismatch)
        } else {
            hit("circulate").then_some(Ignored::Circulating)
        };
        let copies = if hit("duplicate") { 2 } else { 1 };
        match damage {
            Some(kind) if hit("delay") => {
                self.delayed
                    .extend(std::iter::repeat_n((frame + DELAY_FRAMES, kind), copies));
            }
            Some(kind) => (0..copies).for_each(|_| self.ignore(kind)),
            None => {
                if hit("duplicate") {
                    self.ignore(Ignored::Duplicate);
                }
                if hit("counter") && self.drawing.get() {
                    self.expected.working_counter_errors += AXES as u64;
                }
            }
        }
        self.unanswered += u64::from(damage.is_some());
    }
}

impl Segment for WatchedCell {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        let replies = self.cell.frame(time_us, frame);
        self.account();
        replies
    }

    fn advance_to(&mut self, time_us: u64) {
        self.expected.frames_lost += std::mem::take(&mut self.unanswered);
        self.cell.advance_to(time_us);
    }
}

/// An operator who repeats a drawing and periodically sends a mailbox request.
struct Operator {
    session: Session,
    config: Option<Config>,
    /// Whether the soak has begun: the drives have power.
    drawing: Rc<std::cell::Cell<bool>>,
    next: Command,
    next_ms: u32,
    asked: bool,
    jobs: u16,
    finished: u16,
    cycles: u32,
    soaked: u32,
    questions: u32,
    answers: u32,
    status: Option<Status>,
    counters: BusCounters,
    /// Wrong working counters before the soak.
    errors_before: u32,
}

impl Operator {
    fn new(config: Config, cycles: u32, drawing: Rc<std::cell::Cell<bool>>) -> Self {
        let mut session = Session::new(7);
        session.connect();
        Self {
            session,
            config: Some(config),
            drawing,
            next: Command::Home,
            next_ms: 0,
            asked: false,
            jobs: 0,
            finished: 0,
            cycles,
            soaked: 0,
            questions: 0,
            answers: 0,
            status: None,
            counters: BusCounters::default(),
            errors_before: 0,
        }
    }

    fn take(&mut self, event: Event, ms: u32) {
        match event {
            Event::Connected(_) => {
                let config = self.config.take().expect("the firmware does not restart");
                self.session.configure(config);
            }
            Event::Configured(result) => assert!(result.is_ok(), "{result:?}"),
            Event::Answered { command, result, .. } => {
                self.asked = false;
                match (command, result) {
                    (Command::Home, Ok(())) => (self.next, self.next_ms) = (Command::Enable, ms + 100),
                    (Command::Enable, Ok(())) => self.next = Command::Draw { job: 1 },
                    (Command::Draw { job }, Ok(())) => {
                        self.jobs = job;
                        self.session.start_path(job, path().into());
                    }
                    // Moving still, or this millisecond's inputs were lost: asked again.
                    (_, Err(Refusal::Moving | Refusal::NoPosition { .. })) => {}
                    (_, result) => panic!("{command:?} at {ms} ms: {result:?}"),
                }
            }
            Event::Ack(ack) if ack.finished && ack.job == self.jobs => {
                self.finished = ack.job;
                self.next = Command::Draw { job: ack.job + 1 };
            }
            Event::Status(status) => {
                assert_eq!(status.fault, None, "at {ms} ms, {} ms in the soak", self.soaked);
                self.status = Some(status);
            }
            Event::Bus(answer) => {
                let Ok(ServiceReply::Piece { total, piece }) = &answer else {
                    panic!("{answer:?} at {ms} ms");
                };
                assert_eq!((usize::from(*total), &piece[..6]), (piece.len(), b"AX2000".as_slice()));
                self.answers += 1;
            }
            Event::Ack(_) | Event::Samples { .. } | Event::Measured(_) => {}
            Event::VersionRefused { .. } | Event::Restarted | Event::VertexRefused(_) => panic!("{event:?} at {ms} ms"),
        }
    }

    /// Gives the next command in the mode that it belongs to.
    fn act(&mut self, ms: u32) {
        let mode = self.status.as_ref().map(|status| status.mode);
        let wanted = match self.next {
            Command::Home => Mode::DrivesOff,
            Command::Enable => Mode::DrivesOff,
            _ => Mode::Idle,
        };
        let begun = matches!(self.next, Command::Draw { job } if job == self.jobs);
        if mode == Some(wanted) && !self.asked && !begun && ms >= self.next_ms {
            self.asked = true;
            self.next_ms = ms + 50;
            self.status = None;
            self.session.command(self.next);
        }
        if ms.is_multiple_of(50) {
            self.session.inquire();
        }
        if mode == Some(Mode::Idle) && !self.drawing.get() {
            self.drawing.set(true);
            self.errors_before = self.counters.working_counter_errors;
        }
        if self.drawing.get() {
            self.soaked += 1;
            if ms.is_multiple_of(QUESTION_PERIOD_MS) && self.questions == self.answers {
                let slave = (self.questions % AXES as u32) as u8;
                self.questions += 1;
                self.session.bus(ServiceRequest::Upload {
                    slave,
                    object: DEVICE_NAME,
                    complete: false,
                    offset: 0,
                });
            }
        } else {
            assert!(ms < PREPARATION_MAX_MS, "not drawing after {ms} ms: {:?}", self.status);
        }
    }
}

impl Host for Operator {
    fn exchange(&mut self, ms: u32, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
        self.session.receive(from_firmware, ms.into());
        while let Some(event) = self.session.next_event() {
            self.take(event, ms);
        }
        self.act(ms);
        let mut line = vec![0; room];
        let length = self.session.transmit(ms.into(), &mut line);
        to_firmware.extend_from_slice(&line[..length]);
    }

    fn counted(&mut self, counters: &BusCounters) {
        self.counters = *counters;
    }

    fn is_over(&self) -> bool {
        self.soaked >= self.cycles
    }
}

/// A stroke: a zigzag of 60 mm.
fn path() -> Vec<PathVertex> {
    let go = |x_um: i32, y_um: i32, z_um: i32, pen: Pen| PathVertex {
        position_um: [x_um, y_um, z_um],
        pen,
        stroke: 0,
    };
    let mut path = vec![go(-30_000, 0, -847_000, Pen::Up), go(-30_000, 0, -850_000, Pen::Up)];
    path.extend((1..=8).map(|leg| {
        let x_um = if leg % 2 == 0 { -30_000 } else { 30_000 };
        go(x_um, 2_500 * leg, -850_000, Pen::Down)
    }));
    path.push(go(-30_000, 20_000, -847_000, Pen::Up));
    path
}

fn soak(exchange: ExchangeKind, clocks: bool, cycles: u32, seed: u64) {
    let mut config = Config::default();
    config.bus.blind_max_ms = BLIND_MAX_MS;
    (config.bus.exchange, config.bus.clocks) = (exchange, clocks);
    let options = CellOptions {
        seed,
        faults: SCRIPT.parse().expect("the script"),
        ..CellOptions::default()
    };
    let drawing = Rc::new(std::cell::Cell::new(false));
    let mut watched = WatchedCell {
        cell: Cell::new(&config, options),
        before: BTreeMap::new(),
        delayed: VecDeque::new(),
        unanswered: 0,
        expected: Expected::default(),
        drawing: drawing.clone(),
    };
    let mut operator = Operator::new(config, cycles, drawing);
    println!("seed {seed}, {exchange:?}");
    let passed_ms = simulation::run(&mut watched, &mut operator, cycles + PREPARATION_MAX_MS);

    let (counters, expected) = (operator.counters, watched.expected);
    println!(
        "{passed_ms} ms, {cycles} of them since the drives have power, {} frames",
        watched.cell.frames()
    );
    println!("injected: {:?}", watched.cell.injected());
    println!("counted:  {counters:?}");
    println!(
        "{} drawings, {} answers by mailbox",
        operator.finished, operator.answers
    );
    assert_eq!(operator.soaked, cycles);
    assert_eq!(counters.ignored.map(u64::from), expected.ignored);
    assert_eq!(
        u64::from(counters.frames_late),
        expected.ignored[Ignored::Late as usize]
    );
    assert_eq!(u64::from(counters.frames_lost), expected.frames_lost);
    assert_eq!(
        u64::from(counters.working_counter_errors - operator.errors_before),
        expected.working_counter_errors
    );
    assert_eq!(u64::from(counters.frames_sent), watched.cell.frames());
    for slave in watched.cell.state().slaves {
        assert_eq!((slave.al_state, slave.al_status_code), (AlState::Operational, 0));
        assert_eq!((slave.drive, slave.drive_error), (DriveState::OperationEnabled, 0));
    }
    assert!(u32::from(operator.finished) > cycles / 10_000 && operator.answers > cycles / 1_000);
}

#[test]
fn a_million_cycles_with_one_percent_of_every_fault_latch_nothing_and_every_event_is_counted() {
    soak(ExchangeKind::Split, false, 1_000_000, 1);
}

#[test]
fn inputs_and_outputs_in_one_telegram_stand_the_same() {
    soak(ExchangeKind::Combined, false, 100_000, 2);
}

#[test]
fn distributed_clocks_stand_the_same() {
    soak(ExchangeKind::Split, true, 200_000, 3);
}
