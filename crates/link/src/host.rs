//! One connection to the firmware: requests, path and heartbeats out, events in.
//!
//! A pure state machine: the caller passes bytes and milliseconds (firmware milliseconds in lockstep) and takes bytes
//! and [`Event`]s. Invariants: requests are carried out in the order they were made, one at a time, except
//! [`CommandEffect::Stops`], which drops all earlier ones; the path never exceeds the firmware's credit and goes back
//! to the first unacknowledged vertex after a loss; nothing is sent after a refused version.

use crate::frame::{Decoder, FrameCounts, decode, greeting_version};
use crate::message::{DeviceMessage, Hello, HostMessage, PathAck, Welcome};
use crate::outgoing::Outgoing;
use crate::sender::PathSender;
use crate::{CommandEffect, Protocol};
use alloc::boxed::Box;
use alloc::collections::VecDeque;
use alloc::sync::Arc;
use alloc::vec::Vec;

/// Time after which an unanswered greeting or request is repeated, ms.
pub const REQUEST_REPEAT_MS: u64 = 100;
/// Longest time without a message to the firmware, ms.
pub const HEARTBEAT_MS: u64 = 100;

/// Event on the link.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // few are alive at a time
pub enum Event<P: Protocol> {
    /// The firmware has answered the greeting.
    Connected(Welcome<P>),
    /// The firmware uses another protocol version; nothing more is sent.
    VersionRefused {
        /// This program's version.
        host: u16,
        /// The firmware's version.
        firmware: u16,
    },
    /// The firmware no longer knows this connection: it was reset, or another program has taken over.
    Restarted,
    /// Answer to [`Session::configure`].
    Configured(Result<u64, P::ConfigRefusal>),
    /// Answer to [`Session::command`].
    Answered {
        /// Number that [`Session::command`] returned.
        id: u16,
        /// The command.
        command: P::Command,
        /// Accepted, or why not.
        result: Result<(), P::Refusal>,
    },
    /// Answer to [`Session::bus`].
    Bus(P::BusResult),
    /// Answer to [`Session::measure`].
    Measured(P::MeasurementAnswer),
    /// The path's acknowledgement and progress.
    Ack(PathAck),
    /// A vertex was refused; the path has ended.
    VertexRefused(P::VertexRefusal),
    /// State of the controller.
    Status(P::Status),
    /// Samples in order, each once.
    Samples {
        /// Samples lost directly before these.
        missing: u32,
        /// The samples.
        samples: Vec<P::Sample>,
    },
}

/// Counters of the session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SessionCounts {
    /// Frames received, by their CRC.
    pub frames: FrameCounts,
    /// Frames with a correct CRC whose content was not a message.
    pub not_understood: u32,
    /// Repeated requests and greetings.
    pub requests_repeated: u32,
    /// Times the path went back to the first unacknowledged vertex.
    pub path_repeats: u32,
    /// Samples received.
    pub samples: u64,
    /// Samples lost on the line or dropped by the firmware.
    pub samples_missing: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Idle,
    Connecting,
    Connected,
    Refused,
}

enum Body<P: Protocol> {
    Configure(Box<P::Config>),
    Command(P::Command),
}

struct Request<B> {
    id: u16,
    body: B,
    sent_ms: Option<u64>,
}

impl<B> Request<B> {
    /// Whether the request has to be sent now, for the first time or again.
    fn take_due(&mut self, now_ms: u64, counts: &mut SessionCounts) -> bool {
        let due = is_due(self.sent_ms, now_ms);
        if due {
            counts.requests_repeated += u32::from(self.sent_ms.is_some());
            self.sent_ms = Some(now_ms);
        }
        due
    }
}

/// Removes the request with this number from its queue.
fn take_answered<B>(requests: &mut VecDeque<Request<B>>, id: u16) -> Option<B> {
    let place = requests.iter().position(|request| request.id == id)?;
    requests.remove(place).map(|request| request.body)
}

/// The host's end of one connection.
pub struct Session<P: Protocol> {
    number: u32,
    state: State,
    hello_sent_ms: Option<u64>,
    decoder: Box<Decoder>,
    heard_ms: Option<u64>,
    spoke_ms: u64,
    request_next: u16,
    requests: VecDeque<Request<Body<P>>>,
    /// Separate queue for bus requests: an answer may take a second, and a command must not wait for it.
    questions: VecDeque<Request<P::BusRequest>>,
    measurements: VecDeque<Request<P::MeasurementRequest>>,
    inquire: bool,
    path: Option<PathSender<P>>,
    /// Acknowledgement that arrived after the start was accepted and before the path was set.
    early: Option<PathAck>,
    sequence: Option<u32>,
    counts: SessionCounts,
    events: VecDeque<Event<P>>,
    outgoing: Box<Outgoing>,
}

impl<P: Protocol> Session<P> {
    /// A session that sends nothing before [`connect`](Self::connect). `number` is not 0 and differs from the previous
    /// connection's, so that the firmware can tell a new program from a repeated greeting.
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
            questions: VecDeque::new(),
            measurements: VecDeque::new(),
            inquire: false,
            path: None,
            early: None,
            sequence: None,
            counts: SessionCounts::default(),
            events: VecDeque::new(),
            outgoing: Box::new(Outgoing::new()),
        }
    }

    /// Greets the firmware until it answers; results in [`Event::Connected`] or [`Event::VersionRefused`].
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
    pub fn configure(&mut self, config: P::Config) {
        self.request(Body::Configure(Box::new(config)));
    }

    /// Sends a command and returns its number; the answer is [`Event::Answered`]. [`CommandEffect::Stops`] is sent at
    /// once; earlier requests without an answer are dropped.
    pub fn command(&mut self, command: P::Command) -> u16 {
        if P::effect(&command) == CommandEffect::Stops {
            self.requests.clear();
        }
        self.request(Body::Command(command))
    }

    /// Sends a request to the bus; the answer is [`Event::Bus`].
    pub fn bus(&mut self, request: P::BusRequest) {
        let id = self.take_number();
        self.questions.push_back(Request {
            id,
            body: request,
            sent_ms: None,
        });
    }

    /// Sends a request to the measurements; the answer is [`Event::Measured`].
    pub fn measure(&mut self, request: P::MeasurementRequest) {
        let id = self.take_number();
        self.measurements.push_back(Request {
            id,
            body: request,
            sent_ms: None,
        });
    }

    /// Whether [`transmit`](Self::transmit) has returned a command completely, or it no longer has to be sent.
    pub fn has_sent(&self, id: u16) -> bool {
        let waits = self
            .requests
            .iter()
            .any(|request| request.id == id && request.sent_ms.is_none());
        !waits && self.outgoing.is_empty()
    }

    fn request(&mut self, body: Body<P>) -> u16 {
        let id = self.take_number();
        self.requests.push_back(Request {
            id,
            body,
            sent_ms: None,
        });
        id
    }

    fn take_number(&mut self) -> u16 {
        let number = self.request_next;
        self.request_next = number.wrapping_add(1);
        number
    }

    /// Requests a status now.
    pub fn inquire(&mut self) {
        self.inquire = true;
    }

    /// Streams a path within the firmware's credit, once the firmware has accepted a command that [opens the
    /// path](CommandEffect::OpensPath) of this job. If the firmware already has the path from another session,
    /// continues with the next vertex that it expects.
    pub fn start_path(&mut self, job: u16, vertices: Arc<[P::Vertex]>) {
        let mut path = PathSender::new(job, vertices);
        if let Some(ack) = self.early.take_if(|ack| ack.job == job) {
            path.acknowledge(&ack, 0);
        }
        self.path = Some(path);
    }

    /// State of the firmware's path, while this session sends none.
    pub fn held_path(&self) -> Option<&PathAck> {
        self.early.as_ref()
    }

    /// Stops sending the path.
    pub fn end_path(&mut self) {
        self.path = None;
    }

    /// Number of vertices sent and not acknowledged.
    pub fn in_flight(&self) -> usize {
        self.path.as_ref().map_or(0, PathSender::in_flight)
    }

    /// Milliseconds since the firmware's last valid frame, `None` before the first.
    pub fn silence_ms(&self, now_ms: u64) -> Option<u64> {
        self.heard_ms.map(|heard_ms| now_ms.saturating_sub(heard_ms))
    }

    /// The counters.
    pub fn counts(&self) -> SessionCounts {
        SessionCounts {
            frames: self.decoder.counts(),
            ..self.counts
        }
    }

    /// The oldest event that has not been taken yet.
    pub fn next_event(&mut self) -> Option<Event<P>> {
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
            match (version, decode::<DeviceMessage<P>>(payload)) {
                (Some(firmware), _) if firmware != P::VERSION => self.refuse(firmware),
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
            host: P::VERSION,
            firmware,
        });
    }

    fn take_welcome(&mut self, welcome: Welcome<P>) {
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
                self.questions.clear();
                self.measurements.clear();
                self.events.push_back(Event::Restarted);
            }
            _ => {}
        }
    }

    fn take(&mut self, message: DeviceMessage<P>, now_ms: u64) {
        match message {
            DeviceMessage::Welcome(_) => {}
            DeviceMessage::Configured { id, result } => {
                if take_answered(&mut self.requests, id).is_some() {
                    self.events.push_back(Event::Configured(result));
                }
            }
            DeviceMessage::Answer { id, result } => {
                if let Some(Body::Command(command)) = take_answered(&mut self.requests, id) {
                    // Acknowledgements so far belong to an earlier drawing.
                    if matches!(P::effect(&command), CommandEffect::OpensPath { .. }) {
                        self.early = None;
                    }
                    self.events.push_back(Event::Answered { id, command, result });
                }
            }
            DeviceMessage::Bus { id, result } => {
                if take_answered(&mut self.questions, id).is_some() {
                    self.events.push_back(Event::Bus(result));
                }
            }
            DeviceMessage::Measured { id, answer } => {
                if take_answered(&mut self.measurements, id).is_some() {
                    self.events.push_back(Event::Measured(answer));
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

    fn take_samples(&mut self, sequence: u32, samples: &[P::Sample]) {
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

    /// Fills `out` with the bytes to send now; returns how many. A frame that has been started is finished.
    pub fn transmit(&mut self, now_ms: u64, out: &mut [u8]) -> usize {
        let mut filled = 0;
        loop {
            filled += self.outgoing.fill(out.get_mut(filled..).unwrap_or(&mut []));
            if !self.outgoing.is_empty() || filled == out.len() {
                return filled;
            }
            let Some(message) = self.next_message(now_ms) else {
                return filled;
            };
            self.spoke_ms = now_ms;
            self.outgoing.put(&message);
        }
    }

    /// The next message in order of urgency: greeting, requests, inquiry, path, heartbeat.
    fn next_message(&mut self, now_ms: u64) -> Option<HostMessage<P>> {
        match self.state {
            State::Idle | State::Refused => return None,
            State::Connecting => return self.greeting(now_ms),
            State::Connected => {}
        }
        if let Some(request) = self.requests.front_mut()
            && request.take_due(now_ms, &mut self.counts)
        {
            let id = request.id;
            return Some(match &request.body {
                Body::Configure(config) => HostMessage::Configure {
                    id,
                    config: (**config).clone(),
                },
                Body::Command(command) => HostMessage::Command {
                    id,
                    command: command.clone(),
                },
            });
        }
        if let Some(question) = self.questions.front_mut()
            && question.take_due(now_ms, &mut self.counts)
        {
            return Some(HostMessage::Bus {
                id: question.id,
                request: question.body.clone(),
            });
        }
        if let Some(question) = self.measurements.front_mut()
            && question.take_due(now_ms, &mut self.counts)
        {
            return Some(HostMessage::Measure {
                id: question.id,
                request: question.body.clone(),
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

    fn greeting(&mut self, now_ms: u64) -> Option<HostMessage<P>> {
        if !is_due(self.hello_sent_ms, now_ms) {
            return None;
        }
        self.counts.requests_repeated += u32::from(self.hello_sent_ms.is_some());
        self.hello_sent_ms = Some(now_ms);
        Some(HostMessage::Hello(Hello {
            protocol: P::VERSION,
            session: self.number,
        }))
    }
}

fn is_due(sent_ms: Option<u64>, now_ms: u64) -> bool {
    sent_ms.is_none_or(|sent_ms| now_ms.saturating_sub(sent_ms) >= REQUEST_REPEAT_MS)
}

#[cfg(test)]
mod tests;
