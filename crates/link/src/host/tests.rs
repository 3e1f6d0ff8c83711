//! Requirements of both ends together, over a line that damages, drops and repeats bytes.

use super::*;
use crate::device::{DeviceEndpoint, DeviceEvent, Identity, LINE_BYTES_PER_MS};
use crate::example::{Command, Example, check};
use crate::frame::{FRAME_BYTES_MAX, encode};
use crate::ports::LinkPort;
use proptest::prelude::*;

/// Vertices that the firmware can hold.
const CAPACITY: usize = 64;
/// Longest time for a drawing, ms.
const LIMIT_MS: u64 = 120_000;

type Machine = DeviceEndpoint<Example>;

/// A fault of the line: bytes that pass before it, what happens to the next byte, and the bits that change.
type Fault = (u32, Kind, u8);

#[derive(Clone, Copy, Debug)]
enum Kind {
    Lost,
    Repeated,
    Damaged,
}

/// A line whose faults come in turn, over and over.
struct Line {
    faults: Vec<Fault>,
    next: usize,
    passed: u32,
}

impl Line {
    fn new(faults: Vec<Fault>) -> Self {
        Self {
            faults,
            next: 0,
            passed: 0,
        }
    }

    fn carry(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut carried = Vec::new();
        for byte in bytes {
            match self.faults.get(self.next).copied() {
                Some((before, kind, bits)) if self.passed >= before => {
                    self.passed = 0;
                    self.next = (self.next + 1) % self.faults.len();
                    match kind {
                        Kind::Lost => {}
                        Kind::Repeated => carried.extend([*byte, *byte]),
                        Kind::Damaged => carried.push(*byte ^ bits),
                    }
                }
                _ => {
                    self.passed += 1;
                    carried.push(*byte);
                }
            }
        }
        carried
    }
}

/// A firmware that carries out every command and one vertex a millisecond.
struct Rig {
    machine: Machine,
    decoder: Decoder,
    line: Line,
    commands: Vec<u16>,
    waiting: VecDeque<i32>,
    executed: Vec<i32>,
    ended: bool,
}

impl Rig {
    fn new(line: Line) -> Self {
        let identity = Identity {
            firmware: "1.2.3",
            board: "rig",
            capacity: CAPACITY as u16,
        };
        Self {
            machine: Machine::new(identity),
            decoder: Decoder::new(),
            line,
            commands: Vec::new(),
            waiting: VecDeque::new(),
            executed: Vec::new(),
            ended: false,
        }
    }

    /// One millisecond of both ends; returns the host's events.
    fn step(&mut self, session: &mut Session<Example>, now_ms: u64) -> Vec<Event<Example>> {
        let mut bytes = [0; LINE_BYTES_PER_MS];
        let length = session.transmit(now_ms, &mut bytes);
        for byte in self.line.carry(&bytes[..length]) {
            let Some(Ok(payload)) = self.decoder.push(byte) else {
                continue;
            };
            let free = CAPACITY - self.waiting.len();
            match self.machine.receive(LinkPort::Serial, payload, now_ms, free) {
                Some(DeviceEvent::Command { id, .. }) => {
                    self.commands.push(id);
                    self.machine.answer(id, Ok(()));
                }
                Some(DeviceEvent::Path { vertices, last }) => {
                    assert!(vertices.len() <= free);
                    self.waiting.extend(vertices);
                    self.ended |= last;
                }
                _ => {}
            }
        }
        self.executed.extend(self.waiting.pop_front());
        self.machine.sample([now_ms as f32; 4]);
        let free = CAPACITY - self.waiting.len();
        let finished = self.ended && self.waiting.is_empty();
        self.machine.acknowledge(self.executed.len() as u32, free, finished);
        let length = self.machine.transmit(now_ms, &mut bytes);
        session.receive(&self.line.carry(&bytes[..length]), now_ms);
        core::iter::from_fn(|| session.next_event()).collect()
    }
}

/// Connects, enables and draws; returns what the firmware has carried out, the host's counters and the time of the end.
fn draw(line: Line, count: usize) -> (Rig, SessionCounts, u64) {
    let (mut rig, mut session) = (Rig::new(line), Session::new(5));
    let path: Arc<[i32]> = (0..count as i32).collect();
    session.connect();
    for now_ms in 0..LIMIT_MS {
        for event in rig.step(&mut session, now_ms) {
            match event {
                Event::Connected(welcome) => {
                    assert_eq!(usize::from(welcome.capacity), CAPACITY);
                    session.command(Command::Enable);
                    session.command(Command::Draw { job: 4 });
                }
                Event::Answered {
                    command: Command::Draw { job },
                    result,
                    ..
                } => {
                    assert_eq!(result, Ok(()));
                    session.start_path(job, path.clone());
                }
                Event::Ack(ack) if ack.finished => return (rig, session.counts(), now_ms),
                _ => {}
            }
        }
    }
    panic!(
        "not finished after {LIMIT_MS} ms: {} of {count} vertices",
        rig.executed.len()
    );
}

#[test]
fn over_any_line_the_path_arrives_complete_and_in_order_and_each_command_once() {
    let kind = prop_oneof![Just(Kind::Lost), Just(Kind::Repeated), Just(Kind::Damaged)];
    let faults = prop::collection::vec((0..4_000u32, kind, 1..=u8::MAX), 12..60);
    let faults = prop_oneof![1 => Just(Vec::new()), 5 => faults];
    check(48, (faults, 0..800usize), |(faults, count)| {
        let is_perfect = faults.is_empty();
        let (rig, counts, _) = draw(Line::new(faults), count);
        prop_assert!(rig.executed.iter().copied().eq(0..count as i32));
        prop_assert_eq!(rig.commands.len(), 2, "{:?}", rig.commands);
        let repeats = u64::from(counts.path_repeats + counts.requests_repeated);
        prop_assert!(!is_perfect || (counts.frames.bad, repeats) == (0, 0), "{:?}", counts);
        Ok(())
    });
}

#[test]
fn garbage_makes_no_panic_and_no_event() {
    let bytes = prop::collection::vec(prop_oneof![4 => any::<u8>(), 1 => Just(0)], 2_000..4_000);
    check(200, bytes, |bytes| {
        let mut session = Session::<Example>::new(5);
        session.connect();
        session.receive(&bytes, 1);
        prop_assert_eq!(session.next_event(), None);
        prop_assert!(session.counts().frames.bad > 100, "{:?}", session.counts());
        Ok(())
    });
}

#[test]
fn a_perfect_line_delivers_a_vertex_every_millisecond_and_every_sample() {
    let (_, counts, finished_ms) = draw(Line::new(Vec::new()), 5_000);
    assert!((5_000..5_060).contains(&finished_ms), "{finished_ms} ms");
    assert_eq!(counts.samples_missing, 0);
    assert!(counts.samples + 40 > finished_ms, "{counts:?}");
}

#[test]
fn a_stop_drops_the_requests_before_it() {
    let (mut rig, mut session) = (Rig::new(Line::new(Vec::new())), Session::new(5));
    session.connect();
    for now_ms in 0..5 {
        rig.step(&mut session, now_ms);
    }
    session.command(Command::Enable);
    session.command(Command::Draw { job: 1 });
    let stop = session.command(Command::Stop);
    for now_ms in 5..10 {
        rig.step(&mut session, now_ms);
    }
    assert_eq!(rig.commands, [stop]);
}

#[test]
fn a_reset_of_the_firmware_is_noticed() {
    let mut session = Session::new(5);
    session.connect();
    for (start_ms, restarted) in [(0, false), (400, true)] {
        let mut rig = Rig::new(Line::new(Vec::new()));
        let events = (start_ms..start_ms + 400).flat_map(|now_ms| rig.step(&mut session, now_ms));
        let events: Vec<_> = events.collect();
        assert_eq!(events.contains(&Event::Restarted), restarted, "{events:?}");
    }
    assert!(!session.connected());
}

#[test]
fn a_firmware_of_another_version_is_refused_with_both_versions_and_hears_nothing_more() {
    let mut session = Session::<Example>::new(3);
    session.connect();
    let mut out = [0; FRAME_BYTES_MAX];
    assert!(session.transmit(0, &mut out) > 0);
    // A welcome of a later version whose other fields this program does not know.
    let later = Example::VERSION + 1;
    let length = encode(&(0u8, later, 0xffu8, 0xffu8), &mut out).unwrap();
    session.receive(&out[..length], 1);
    let refused = Event::VersionRefused {
        host: Example::VERSION,
        firmware: later,
    };
    assert_eq!(session.next_event(), Some(refused));
    assert_eq!(session.transmit(1_000, &mut out), 0);
}

#[test]
fn a_silent_session_sends_heartbeats_that_the_firmware_hears() {
    let (mut rig, mut session) = (Rig::new(Line::new(Vec::new())), Session::new(3));
    session.connect();
    for now_ms in 0..2_000 {
        rig.step(&mut session, now_ms);
        let silence_ms = rig.machine.silence_ms(now_ms).unwrap_or(0);
        assert!(silence_ms <= HEARTBEAT_MS + 2, "{silence_ms} ms");
    }
}
