//! One connection to the firmware: requests, path and heartbeats out, events in.
//!
//! A pure state machine: the caller brings bytes and milliseconds (firmware milliseconds in lockstep) and takes bytes
//! and [`Event`]s. Invariants: requests are carried out in the order they were made, one at a time, except
//! [`Command::Stop`], which drops everything before it; the path never exceeds the firmware's credit and goes back to
//! the first vertex that is not acknowledged when one is lost; nothing is sent after a refused version.

use super::path::PathSender;
use etherpen::application::Refusal;
use etherpen::config::Config;
use etherpen::link::frame::{Decoder, FRAME_BYTES_MAX, FrameCounts, decode, encode, greeting_version};
use etherpen::link::protocol::{
    Command, ConfigRefusal, DeviceMessage, Hello, HostMessage, PROTOCOL_VERSION, PathAck, PathVertex, Sample, Status,
    Welcome,
};
use std::collections::VecDeque;
use std::sync::Arc;

/// Time after which a greeting or a request without an answer is repeated, ms.
pub const REQUEST_REPEAT_MS: u64 = 100;
/// Longest silence towards the firmware, ms.
pub const HEARTBEAT_MS: u64 = 100;

const _: () = assert!(
    HEARTBEAT_MS * 2 < 500,
    "two lost heartbeats must not hold a drawing by default"
);

/// What happened on the link.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // few are alive at a time
pub enum Event {
    /// The firmware has answered the greeting.
    Connected(Welcome),
    /// The firmware speaks another version; nothing more is sent.
    VersionRefused {
        /// This program's version.
        host: u16,
        /// The firmware's version.
        firmware: u16,
    },
    /// The firmware does not know this connection any more: it was reset, or another program has taken over.
    Restarted,
    /// Answer to [`Session::configure`].
    Configured(Result<u64, ConfigRefusal>),
    /// Answer to [`Session::command`].
    Answered {
        /// What [`Session::command`] returned.
        id: u16,
        /// The command.
        command: Command,
        /// Accepted, or why not.
        result: Result<(), Refusal>,
    },
    /// The path's acknowledgement and progress.
    Ack(PathAck),
    /// A vertex was refused; the path has ended.
    VertexRefused(etherpen::motion::Refusal),
    /// Where the controller stands.
    Status(Status),
    /// Samples in order, each once.
    Samples {
        /// Samples that were lost right before these.
        missing: u32,
        /// The samples.
        samples: Vec<Sample>,
    },
}

/// What the session has counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SessionCounts {
    /// Frames received, by their CRC.
    pub frames: FrameCounts,
    /// Frames with a right CRC that were no message.
    pub not_understood: u32,
    /// Requests and greetings that were repeated.
    pub requests_repeated: u32,
    /// Times the path went back to the first vertex not acknowledged.
    pub path_repeats: u32,
    /// Samples received.
    pub samples: u64,
    /// Samples lost on the way or dropped by the firmware.
    pub samples_missing: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Idle,
    Connecting,
    Connected,
    Refused,
}

enum Body {
    Configure(Box<Config>),
    Command(Command),
}

struct Request {
    id: u16,
    body: Body,
    sent_ms: Option<u64>,
}

/// The host's end of one connection.
pub struct Session {
    number: u32,
    state: State,
    hello_sent_ms: Option<u64>,
    decoder: Box<Decoder>,
    heard_ms: Option<u64>,
    spoke_ms: u64,
    request_next: u16,
    requests: VecDeque<Request>,
    inquire: bool,
    path: Option<PathSender>,
    /// Acknowledgement that came after the start was accepted and before the path was there.
    early: Option<PathAck>,
    sequence: Option<u32>,
    counts: SessionCounts,
    events: VecDeque<Event>,
    frame: Box<[u8; FRAME_BYTES_MAX]>,
    frame_length: usize,
    frame_sent: usize,
}

impl Session {
    /// A session that says nothing before [`connect`](Self::connect). `number` is not 0 and differs from the
    /// connection before, so that the firmware can tell a new program from a repeated greeting.
    pub fn new(number: u32) -> Self {
        Self {
            number: number.max(1),
            state: State::Idle,
            hello_sent_ms: None,
            decoder: Box::default(),
            heard_ms: None,
            spoke_ms: 0,
            request_next: 1,
            requests: VecDeque::new(),
            inquire: false,
            path: None,
            early: None,
            sequence: None,
            counts: SessionCounts::default(),
            events: VecDeque::new(),
            frame: Box::new([0; FRAME_BYTES_MAX]),
            frame_length: 0,
            frame_sent: 0,
        }
    }

    /// Greets the firmware until it answers; ends in [`Event::Connected`] or [`Event::VersionRefused`].
    pub fn connect(&mut self) {
        if self.state == State::Idle {
            self.state = State::Connecting;
            self.hello_sent_ms = None;
        }
    }

    /// Whether the firmware has answered the greeting.
    pub fn connected(&self) -> bool {
        self.state == State::Connected
    }

    /// Sends a configuration; the answer is [`Event::Configured`].
    pub fn configure(&mut self, config: Config) {
        self.request(Body::Configure(Box::new(config)));
    }

    /// Sends a command and returns its number; the answer is [`Event::Answered`]. [`Command::Stop`] is sent at once,
    /// requests before it that have no answer yet are forgotten.
    pub fn command(&mut self, command: Command) -> u16 {
        if command == Command::Stop {
            self.requests.clear();
        }
        self.request(Body::Command(command))
    }

    fn request(&mut self, body: Body) -> u16 {
        let id = self.request_next;
        self.request_next = self.request_next.wrapping_add(1);
        self.requests.push_back(Request {
            id,
            body,
            sent_ms: None,
        });
        id
    }

    /// Asks for a status now.
    pub fn inquire(&mut self) {
        self.inquire = true;
    }

    /// Streams a path as the firmware gives credit, once it has accepted [`Command::Draw`] of the same job.
    pub fn start_path(&mut self, job: u16, vertices: Arc<[PathVertex]>) {
        let mut path = PathSender::new(job, vertices);
        if let Some(ack) = self.early.take_if(|ack| ack.job == job) {
            path.acknowledge(&ack, 0);
        }
        self.path = Some(path);
    }

    /// Sends no more of the path.
    pub fn end_path(&mut self) {
        self.path = None;
    }

    /// Vertices sent and not acknowledged.
    pub fn in_flight(&self) -> usize {
        self.path.as_ref().map_or(0, PathSender::in_flight)
    }

    /// Milliseconds since the firmware's last valid frame, `None` before the first.
    pub fn silence_ms(&self, now_ms: u64) -> Option<u64> {
        self.heard_ms.map(|heard_ms| now_ms.saturating_sub(heard_ms))
    }

    /// What was counted.
    pub fn counts(&self) -> SessionCounts {
        SessionCounts {
            frames: self.decoder.counts(),
            ..self.counts
        }
    }

    /// The oldest event that was not taken yet.
    pub fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Takes bytes from the line.
    pub fn receive(&mut self, bytes: &[u8], now_ms: u64) {
        for byte in bytes {
            let Some(Ok(payload)) = self.decoder.push(*byte) else {
                continue;
            };
            self.heard_ms = Some(now_ms);
            let version = greeting_version(payload);
            match (version, decode::<DeviceMessage>(payload)) {
                (Some(firmware), _) if firmware != PROTOCOL_VERSION => self.refuse(firmware),
                (_, Ok(DeviceMessage::Welcome(welcome))) => self.take_welcome(welcome),
                (_, Ok(message)) if self.state == State::Connected => self.take(message, now_ms),
                (_, Ok(_)) => {}
                (_, Err(_)) => self.counts.not_understood += 1,
            }
        }
    }

    fn refuse(&mut self, firmware: u16) {
        if !matches!(self.state, State::Connecting | State::Connected) {
            return;
        }
        self.state = State::Refused;
        self.events.push_back(Event::VersionRefused {
            host: PROTOCOL_VERSION,
            firmware,
        });
    }

    fn take_welcome(&mut self, welcome: Welcome) {
        let ours = welcome.session == self.number;
        match self.state {
            State::Connecting if ours => {
                self.state = State::Connected;
                self.sequence = None;
                self.events.push_back(Event::Connected(welcome));
            }
            State::Connected if !ours => {
                self.state = State::Idle;
                self.path = None;
                self.requests.clear();
                self.events.push_back(Event::Restarted);
            }
            _ => {}
        }
    }

    fn take(&mut self, message: DeviceMessage, now_ms: u64) {
        match message {
            DeviceMessage::Welcome(_) => {}
            DeviceMessage::Configured { id, result } => {
                if self.answered(id).is_some() {
                    self.events.push_back(Event::Configured(result));
                }
            }
            DeviceMessage::Answer { id, result } => {
                if let Some(Body::Command(command)) = self.answered(id) {
                    // Acknowledgements so far belong to a drawing before.
                    self.early = None;
                    self.events.push_back(Event::Answered { id, command, result });
                }
            }
            DeviceMessage::Ack(ack) => self.take_ack(ack, now_ms),
            DeviceMessage::VertexRefused { job, refusal } => {
                if self.path.take_if(|path| path.job() == job).is_some() {
                    self.events.push_back(Event::VertexRefused(refusal));
                }
            }
            DeviceMessage::Status(status) => self.events.push_back(Event::Status(status)),
            DeviceMessage::Telemetry { sequence, samples } => self.take_samples(sequence, &samples),
        }
    }

    fn take_ack(&mut self, ack: PathAck, now_ms: u64) {
        match self.path.as_mut() {
            Some(path) if path.job() == ack.job => {
                self.counts.path_repeats += u32::from(path.acknowledge(&ack, now_ms));
                self.events.push_back(Event::Ack(ack));
            }
            Some(_) => {}
            None => self.early = Some(ack),
        }
    }

    fn answered(&mut self, id: u16) -> Option<Body> {
        let place = self.requests.iter().position(|request| request.id == id)?;
        self.requests.remove(place).map(|request| request.body)
    }

    fn take_samples(&mut self, sequence: u32, samples: &[Sample]) {
        let missing = sequence.wrapping_sub(self.sequence.unwrap_or(sequence));
        if missing > u32::MAX / 2 {
            return;
        }
        self.sequence = Some(sequence.wrapping_add(samples.len() as u32));
        self.counts.samples += samples.len() as u64;
        self.counts.samples_missing += u64::from(missing);
        self.events.push_back(Event::Samples {
            missing,
            samples: samples.to_vec(),
        });
    }

    /// Fills `out` with what is to be sent now and returns how many bytes that are. A frame once begun is finished.
    pub fn transmit(&mut self, now_ms: u64, out: &mut [u8]) -> usize {
        let mut filled = 0;
        loop {
            let waiting = self.frame.get(self.frame_sent..self.frame_length).unwrap_or(&[]);
            let room = out.iter_mut().skip(filled);
            let copied = room.zip(waiting).map(|(place, byte)| *place = *byte).count();
            filled += copied;
            self.frame_sent += copied;
            if self.frame_sent < self.frame_length || filled == out.len() {
                return filled;
            }
            let Some(message) = self.next_message(now_ms) else {
                return filled;
            };
            self.spoke_ms = now_ms;
            self.frame_sent = 0;
            self.frame_length = encode(&message, &mut self.frame[..]).unwrap_or(0);
        }
    }

    /// The message that is due first: greeting, requests, inquiry, path, heartbeat.
    fn next_message(&mut self, now_ms: u64) -> Option<HostMessage> {
        match self.state {
            State::Idle | State::Refused => return None,
            State::Connecting => return self.greeting(now_ms),
            State::Connected => {}
        }
        if let Some(request) = self.requests.front_mut()
            && is_due(request.sent_ms, now_ms)
        {
            self.counts.requests_repeated += u32::from(request.sent_ms.is_some());
            request.sent_ms = Some(now_ms);
            let id = request.id;
            return Some(match &request.body {
                Body::Configure(config) => HostMessage::Configure {
                    id,
                    config: (**config).clone(),
                },
                Body::Command(command) => HostMessage::Command { id, command: *command },
            });
        }
        if self.inquire {
            self.inquire = false;
            return Some(HostMessage::Inquire);
        }
        if let Some(path) = &mut self.path {
            self.counts.path_repeats += u32::from(path.repeat_if_silent(now_ms));
            if let Some(message) = path.next_message(now_ms) {
                return Some(message);
            }
        }
        (now_ms.saturating_sub(self.spoke_ms) >= HEARTBEAT_MS).then_some(HostMessage::Heartbeat)
    }

    fn greeting(&mut self, now_ms: u64) -> Option<HostMessage> {
        if !is_due(self.hello_sent_ms, now_ms) {
            return None;
        }
        self.counts.requests_repeated += u32::from(self.hello_sent_ms.is_some());
        self.hello_sent_ms = Some(now_ms);
        Some(HostMessage::Hello(Hello {
            protocol: PROTOCOL_VERSION,
            session: self.number,
        }))
    }
}

fn is_due(sent_ms: Option<u64>, now_ms: u64) -> bool {
    sent_ms.is_none_or(|sent_ms| now_ms.saturating_sub(sent_ms) >= REQUEST_REPEAT_MS)
}

#[cfg(test)]
mod tests {
    use super::super::bench::{Bench, CAPACITY, path};
    use super::*;
    use etherpen::application::Mode;

    const SEEDS: [u64; 4] = [1, 2, 0xfeed, 0x5eed_cafe];

    fn exchange(bench: &mut Bench, session: &mut Session, now_ms: u64) -> Vec<Event> {
        bench.step(now_ms, |arrived, room| {
            session.receive(arrived, now_ms);
            let mut out = vec![0; room];
            let length = session.transmit(now_ms, &mut out);
            out.truncate(length);
            out
        });
        std::iter::from_fn(|| session.next_event()).collect()
    }

    /// Connects, enables and draws `count` vertices; returns the time it took and the samples.
    fn draw(bench: &mut Bench, session: &mut Session, count: usize, limit_ms: u64) -> (u64, Vec<Sample>) {
        let mut all = Vec::new();
        bench.mode = Mode::Idle;
        session.connect();
        session.command(Command::Override { percent: 90 });
        session.command(Command::Draw { job: 5 });
        session.command(Command::Override { percent: 80 });
        for now_ms in 0..limit_ms {
            for event in exchange(bench, session, now_ms) {
                match event {
                    Event::Answered {
                        command: Command::Draw { job },
                        result: Ok(()),
                        ..
                    } => session.start_path(job, path(count).into()),
                    Event::Ack(ack) if ack.finished => return (now_ms, all),
                    Event::Samples { samples, .. } => all.extend(samples),
                    _ => {}
                }
            }
            assert!(session.in_flight() <= CAPACITY);
        }
        panic!("not drawn within {limit_ms} ms");
    }

    #[test]
    fn over_a_perfect_line_the_path_arrives_in_time_and_no_sample_is_lost() {
        let (mut bench, mut session) = (Bench::new(1, 0), Session::new(9));
        let (took_ms, _) = draw(&mut bench, &mut session, 5_000, 10_000);
        assert_eq!(bench.vertices, path(5_000));
        assert!(
            took_ms < 5_100,
            "one vertex a millisecond without a pause, took {took_ms} ms"
        );
        let counts = session.counts();
        assert_eq!(
            (counts.samples_missing, counts.path_repeats, counts.requests_repeated),
            (0, 0, 0)
        );
        assert_eq!((counts.frames.bad, bench.endpoint.counts().frames.bad), (0, 0));
        assert!(u64::from(bench.endpoint.counts().samples_dropped) == 0 && counts.samples > took_ms - 20);
    }

    #[test]
    fn over_a_line_that_spoils_bytes_the_path_is_complete_and_in_order_and_commands_are_carried_out_once() {
        for (seed, faults_per_million) in SEEDS
            .into_iter()
            .flat_map(|seed| [(seed, 100), (seed, 500), (seed, 2_500)])
        {
            let (mut bench, mut session) = (Bench::new(seed, faults_per_million), Session::new(9));
            let (took_ms, samples) = draw(&mut bench, &mut session, 3_000, 120_000);
            println!("seed {seed:#x}, {faults_per_million} faults of each kind per million bytes: {took_ms} ms");
            assert_eq!(bench.vertices, path(3_000), "seed {seed:#x}");
            let expected = [
                Command::Override { percent: 90 },
                Command::Draw { job: 5 },
                Command::Override { percent: 80 },
            ];
            assert_eq!(bench.commands, expected, "seed {seed:#x}");
            let counts = session.counts();
            assert!(
                counts.frames.bad > 10 && counts.path_repeats > 0,
                "seed {seed:#x}: {counts:?}"
            );
            let [first, last] = [0, samples.len() - 1].map(|place| u64::from(samples[place].t_ms));
            assert_eq!(
                counts.samples + counts.samples_missing,
                last - first + 1,
                "seed {seed:#x}"
            );
            assert!(samples.is_sorted_by(|a, b| a.t_ms < b.t_ms), "seed {seed:#x}");
            assert!(counts.samples_missing > 0);
        }
    }

    #[test]
    fn stop_overtakes_requests_that_have_no_answer() {
        let mut bench = Bench::new(1, 0);
        let mut session = Session::new(3);
        bench.mode = Mode::Idle;
        session.connect();
        (0..20).for_each(|now_ms| drop(exchange(&mut bench, &mut session, now_ms)));
        session.configure(Config::default());
        session.command(Command::Acknowledge);
        session.command(Command::Stop);
        let events = (20..40).flat_map(|now_ms| exchange(&mut bench, &mut session, now_ms));
        let answers = events.filter(|event| matches!(event, Event::Answered { .. })).count();
        assert_eq!((answers, bench.commands.as_slice()), (1, &[Command::Stop][..]));
    }

    #[test]
    fn a_firmware_of_another_version_is_refused_with_both_versions_and_hears_nothing_more() {
        let mut session = Session::new(3);
        session.connect();
        let mut out = [0; FRAME_BYTES_MAX];
        assert!(session.transmit(0, &mut out) > 0);
        // A welcome of version 7 whose other fields this program does not know.
        let length = encode(&(0u8, 7u16, 0xffu8, 0xffu8), &mut out).unwrap();
        session.receive(&out[..length], 1);
        let refused = Event::VersionRefused {
            host: PROTOCOL_VERSION,
            firmware: 7,
        };
        assert_eq!(session.next_event(), Some(refused));
        assert_eq!(session.transmit(1_000, &mut out), 0);
    }

    #[test]
    fn a_reset_of_the_firmware_is_noticed() {
        let mut session = Session::new(3);
        let mut bench = Bench::new(1, 0);
        session.connect();
        (0..50).for_each(|now_ms| drop(exchange(&mut bench, &mut session, now_ms)));
        assert!(session.connected());
        let mut bench = Bench::new(1, 0);
        let mut events = (50..300).flat_map(|now_ms| exchange(&mut bench, &mut session, now_ms));
        assert!(events.any(|event| event == Event::Restarted));
    }

    #[test]
    fn garbage_makes_no_panic_and_no_event() {
        for seed in SEEDS {
            let mut line = super::super::bench::Line::new(seed, 0);
            let mut session = Session::new(3);
            session.connect();
            let bytes: Vec<u8> = (0..100_000)
                .map(|_| {
                    if line.random().is_multiple_of(16) {
                        0
                    } else {
                        line.random() as u8
                    }
                })
                .collect();
            session.receive(&bytes, 5);
            assert_eq!(session.next_event(), None, "seed {seed:#x}");
            assert!(session.counts().frames.bad > 1_000);
        }
    }

    #[test]
    fn a_silent_session_sends_heartbeats_that_the_firmware_hears() {
        let (mut bench, mut session) = (Bench::new(1, 0), Session::new(3));
        session.connect();
        for now_ms in 0..2_000 {
            exchange(&mut bench, &mut session, now_ms);
            let silence_ms = bench.endpoint.silence_ms(now_ms).unwrap_or(0);
            assert!(silence_ms <= HEARTBEAT_MS + 2, "{silence_ms} ms");
        }
    }
}
