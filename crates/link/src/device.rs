//! The firmware's end of the link.
//!
//! A serial line may lose, damage, repeat and delay bytes, and the host may restart at any time. The application must
//! not be affected. Invariants: a request is handed out once however often it arrives, and its answer is kept and
//! repeated; the path arrives complete and in order, and never exceeds the application's room; a frame that has been
//! started is finished, unless another port takes the link; the endpoint owns all its memory. Frames enter through
//! [`DeviceEndpoint::receive`], each from a port's decoder; bytes leave through [`DeviceEndpoint::transmit`]; the
//! caller passes the time in milliseconds.

use crate::frame::{FRAME_BYTES_MAX, decode, greeting_version};
use crate::message::{DeviceMessage, HostMessage, PathVertices, SAMPLES_PER_MESSAGE, Welcome};
use crate::outgoing::Outgoing;
use crate::ports::{LinkPort, PortDecision, PortHold};
use crate::receiver::PathReceiver;
use crate::requests::{Request, Single};
use crate::{CommandEffect, Protocol};
use heapless::{Deque, String};

/// Default length of the telemetry queue, samples: covers the time that the longest other frame takes on the line.
pub const SAMPLES_QUEUED: usize = 64;
/// Requests whose answers are kept for repetition.
pub const REQUESTS_KEPT: usize = 8;
/// Bytes a millisecond at 921 600 baud, 10 bits a byte.
pub const LINE_BYTES_PER_MS: usize = 92;

const _: () = assert!(SAMPLES_QUEUED > FRAME_BYTES_MAX / LINE_BYTES_PER_MS + SAMPLES_PER_MESSAGE);

/// Identity that the firmware reports in its [`Welcome`].
#[derive(Clone, Copy, Debug)]
pub struct Identity {
    /// Version of the firmware package, at most 16 bytes.
    pub firmware: &'static str,
    /// Name of the board, at most 16 bytes.
    pub board: &'static str,
    /// Vertices the firmware can hold when nothing is queued.
    pub capacity: u16,
}

/// A request of the host to the application.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // one is alive at a time
pub enum DeviceEvent<P: Protocol> {
    /// A host has connected; the state of an earlier path is kept. The host expects a status.
    Connected,
    /// Check and use this configuration, then call [`DeviceEndpoint::configured`].
    Configure {
        /// Number of the request.
        id: u16,
        /// The configuration, unchecked.
        config: P::Config,
    },
    /// Carry out or refuse this command, then call [`DeviceEndpoint::answer`].
    Command {
        /// Number of the request.
        id: u16,
        /// What to do.
        command: P::Command,
    },
    /// Carry out this stop. It comes from a program without a session, or at a port while another one holds the link, and it
    /// is not answered.
    Stop {
        /// The stop.
        command: P::Command,
    },
    /// The next vertices of the path; there is room for all of them.
    Path {
        /// The vertices; empty if the message only announces the end of the path.
        vertices: PathVertices<P>,
        /// Whether they end the path.
        last: bool,
    },
    /// The host wants a status now.
    Inquire,
    /// Pass this request to the bus, then call [`DeviceEndpoint::bus_answered`].
    Bus {
        /// Number of the request.
        id: u16,
        /// The request.
        request: P::BusRequest,
    },
    /// Pass this request to the measurements, then call [`DeviceEndpoint::measured`].
    Measure {
        /// Number of the request.
        id: u16,
        /// The request.
        request: P::MeasurementRequest,
    },
}

/// Counters of the endpoint since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounts {
    /// Frames with a correct CRC whose content was not a message.
    pub not_understood: u32,
    /// Messages received before a greeting of the right version.
    pub refused: u32,
    /// Frames with a correct CRC at a port while another one held the link.
    pub other_port: u32,
    /// Path messages that were out of order, repeated or without room.
    pub path_dropped: u32,
    /// Samples dropped in favour of newer ones.
    pub samples_dropped: u32,
}

/// The firmware's end of the link; `SAMPLES` is the length of the telemetry queue.
pub struct DeviceEndpoint<P: Protocol, const SAMPLES: usize = SAMPLES_QUEUED> {
    identity: Identity,
    previous: P::PreviousRun,
    hold: PortHold,
    counts: LinkCounts,
    session: Option<u32>,
    welcome_due: bool,
    heard_ms: u64,
    config: Option<u64>,
    configuring: Option<Single<Result<u64, P::ConfigRefusal>>>,
    bus: Option<Single<P::BusResult>>,
    measuring: Option<Single<P::MeasurementAnswer>>,
    requests: Deque<Request<P::Refusal>, REQUESTS_KEPT>,
    path: Option<PathReceiver<P>>,
    status: Option<P::Status>,
    samples: Deque<P::Sample, SAMPLES>,
    sequence_next: u32,
    outgoing: Outgoing,
}

impl<P: Protocol, const SAMPLES: usize> DeviceEndpoint<P, SAMPLES> {
    /// An endpoint that waits for a greeting.
    pub const fn new(identity: Identity) -> Self {
        Self {
            identity,
            previous: P::NO_PREVIOUS_RUN,
            hold: PortHold::new(),
            counts: LinkCounts {
                not_understood: 0,
                refused: 0,
                other_port: 0,
                path_dropped: 0,
                samples_dropped: 0,
            },
            session: None,
            welcome_due: false,
            heard_ms: 0,
            config: None,
            configuring: None,
            bus: None,
            measuring: None,
            requests: Deque::new(),
            path: None,
            status: None,
            samples: Deque::new(),
            sequence_next: 0,
            outgoing: Outgoing::new(),
        }
    }

    /// Sets the name of the board, at most 16 bytes, as reported in every [`Welcome`].
    pub fn set_board(&mut self, board: &'static str) {
        self.identity.board = board;
    }

    /// Sets how the previous run ended, as reported in every [`Welcome`].
    pub fn set_previous_run(&mut self, previous: P::PreviousRun) {
        self.previous = previous;
    }

    /// Counters since the endpoint was made.
    pub const fn counts(&self) -> LinkCounts {
        self.counts
    }

    /// The port for the bytes of [`Self::transmit`].
    pub const fn port(&self) -> LinkPort {
        self.hold.port()
    }

    /// Whether a host with the right version has greeted.
    pub fn connected(&self) -> bool {
        self.session.is_some()
    }

    /// Milliseconds since the host's last valid message, `None` before its greeting.
    pub fn silence_ms(&self, now_ms: u64) -> Option<u64> {
        self.session.map(|_| now_ms.saturating_sub(self.heard_ms))
    }

    /// Takes the payload of a frame with a correct CRC from a port. `free` is the number of vertices that the
    /// application can take now.
    #[inline(never)] // generic code is inlined at every call otherwise, which costs flash
    pub fn receive(&mut self, port: LinkPort, payload: &[u8], now_ms: u64, free: usize) -> Option<DeviceEvent<P>> {
        match self.hold.hear(port, now_ms) {
            PortDecision::Held => {}
            PortDecision::Taken => {
                // A host at a new port has to greet. A 0x00 ends any frame that was cut off on the line.
                self.session = None;
                self.welcome_due = false;
                self.outgoing.abandon();
            }
            PortDecision::Dropped => {
                self.counts.other_port = self.counts.other_port.wrapping_add(1);
                return decode(payload).ok().and_then(Self::stop_in);
            }
        }
        if greeting_version(payload).is_some_and(|version| version != P::VERSION) {
            self.session = None;
            self.welcome_due = true;
            return None;
        }
        let Ok(message) = decode::<HostMessage<P>>(payload) else {
            self.counts.not_understood = self.counts.not_understood.wrapping_add(1);
            return None;
        };
        if let HostMessage::Hello(hello) = message {
            self.heard_ms = now_ms;
            return self.greet(hello.session);
        }
        if self.session.is_none() {
            self.welcome_due = true;
            self.counts.refused = self.counts.refused.wrapping_add(1);
            return Self::stop_in(message);
        }
        self.heard_ms = now_ms;
        match message {
            HostMessage::Hello(_) | HostMessage::Heartbeat => None,
            HostMessage::Configure { id, config } => {
                Single::begin(&mut self.configuring, id).then_some(DeviceEvent::Configure { id, config })
            }
            HostMessage::Command { id, command } => self.take_command(id, command),
            HostMessage::Path {
                job,
                first,
                vertices,
                last,
            } => self.take_path(job, first, vertices, last, free),
            HostMessage::Inquire => Some(DeviceEvent::Inquire),
            HostMessage::Bus { id, request } => {
                Single::begin(&mut self.bus, id).then_some(DeviceEvent::Bus { id, request })
            }
            HostMessage::Measure { id, request } => {
                Single::begin(&mut self.measuring, id).then_some(DeviceEvent::Measure { id, request })
            }
        }
    }

    /// The stop in a message of a program that has no session: whoever orders it, it is carried out.
    fn stop_in(message: HostMessage<P>) -> Option<DeviceEvent<P>> {
        match message {
            HostMessage::Command { command, .. } if P::effect(&command) == CommandEffect::Stops => {
                Some(DeviceEvent::Stop { command })
            }
            _ => None,
        }
    }

    fn greet(&mut self, session: u32) -> Option<DeviceEvent<P>> {
        self.welcome_due = true;
        if self.session == Some(session) {
            return None;
        }
        self.session = Some(session);
        self.requests.clear();
        self.configuring = None;
        self.bus = None;
        self.measuring = None;
        self.samples.clear();
        if let Some(path) = &mut self.path {
            path.acknowledge_now();
        }
        Some(DeviceEvent::Connected)
    }

    fn take_command(&mut self, id: u16, command: P::Command) -> Option<DeviceEvent<P>> {
        let effect = P::effect(&command);
        let request = Request {
            id,
            effect,
            result: None,
            due: false,
        };
        if let Some(known) = self.requests.iter_mut().find(|known| known.id == id) {
            // A program that has begun anew behind the same port numbers its requests anew: no other request's number
            // makes a stop a repetition.
            if effect == CommandEffect::Stops && known.effect != effect {
                *known = request;
                return Some(DeviceEvent::Command { id, command });
            }
            known.due = known.result.is_some();
            return None;
        }
        if self.requests.is_full() {
            self.requests.pop_front();
        }
        // There is room: the oldest entry has just been removed.
        let _ = self.requests.push_back(request);
        Some(DeviceEvent::Command { id, command })
    }

    fn take_path(
        &mut self,
        job: u16,
        first: u32,
        vertices: PathVertices<P>,
        last: bool,
        free: usize,
    ) -> Option<DeviceEvent<P>> {
        let path = self.path.as_mut().filter(|path| path.job() == job);
        let (taken, dropped) = path.map_or((None, true), |path| path.take(first, vertices, last, free));
        self.counts.path_dropped = self.counts.path_dropped.wrapping_add(u32::from(dropped));
        taken.map(|(vertices, last)| DeviceEvent::Path { vertices, last })
    }

    /// Answers a command. Accepting it opens or closes the path as its [`CommandEffect`] says. An answer to a request
    /// that is not known is ignored.
    pub fn answer(&mut self, id: u16, result: Result<(), P::Refusal>) {
        let Some(request) = self.requests.iter_mut().find(|request| request.id == id) else {
            return;
        };
        let accepted = result.is_ok();
        request.result = Some(result);
        request.due = true;
        match request.effect {
            CommandEffect::OpensPath { job } if accepted => {
                self.path = Some(PathReceiver::new(job, self.identity.capacity));
            }
            CommandEffect::ClosesPath | CommandEffect::Stops if accepted => self.close_path(),
            _ => {}
        }
    }

    /// Answers a configuration: its hash, or why it was refused. A refused configuration leaves the previous one in
    /// force.
    pub fn configured(&mut self, id: u16, result: Result<u64, P::ConfigRefusal>) {
        if let Ok(hash) = &result {
            self.config = Some(*hash);
        }
        Single::answer(&mut self.configuring, id, result);
    }

    /// Answers a request to the bus; ignored unless `id` is the latest request.
    pub fn bus_answered(&mut self, id: u16, result: P::BusResult) {
        Single::answer(&mut self.bus, id, result);
    }

    /// Answers a request to the measurements.
    pub fn measured(&mut self, id: u16, answer: P::MeasurementAnswer) {
        Single::answer(&mut self.measuring, id, answer);
    }

    /// Reports the progress of the path: vertices fully executed, free places for vertices, whether the path was
    /// executed to its end. Call it every millisecond or on a change; the endpoint decides when to send.
    pub fn acknowledge(&mut self, executed: u32, free: usize, finished: bool) {
        if let Some(path) = &mut self.path {
            path.acknowledge(executed, free, finished);
        }
    }

    /// Refuses a vertex of the path; no more vertices of this path are taken.
    pub fn refuse_vertex(&mut self, refusal: P::VertexRefusal) {
        if let Some(path) = &mut self.path {
            path.refuse(refusal);
        }
    }

    /// Takes no more vertices of the path, for instance because a fault has ended the drawing.
    pub fn close_path(&mut self) {
        if let Some(path) = &mut self.path {
            path.close();
        }
    }

    /// Queues a status; a newer status replaces one that has not been sent.
    pub fn status(&mut self, status: P::Status) {
        self.status = Some(status);
    }

    /// Queues a sample; when the line is slow the oldest samples are dropped and counted.
    pub fn sample(&mut self, sample: P::Sample) {
        if self.session.is_none() {
            return;
        }
        if self.samples.is_full() {
            self.samples.pop_front();
            self.counts.samples_dropped = self.counts.samples_dropped.wrapping_add(1);
        }
        // There is room: the oldest entry has just been removed.
        let _ = self.samples.push_back(sample);
        self.sequence_next = self.sequence_next.wrapping_add(1);
    }

    /// Fills `out` with the bytes to send now; returns how many.
    #[inline(never)] // generic code is inlined at every call otherwise, which costs flash
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
            self.outgoing.put(&message);
        }
    }

    /// The next message in order of urgency: answers, acknowledgement, status, telemetry.
    fn next_message(&mut self, now_ms: u64) -> Option<DeviceMessage<P>> {
        if self.welcome_due {
            self.welcome_due = false;
            return Some(DeviceMessage::Welcome(self.welcome()));
        }
        self.session?;
        if let Some(request) = self.requests.iter_mut().find(|request| request.due)
            && let Some(result) = request.result.clone()
        {
            request.due = false;
            return Some(DeviceMessage::Answer { id: request.id, result });
        }
        if let Some((id, result)) = Single::take_due(&mut self.configuring) {
            return Some(DeviceMessage::Configured {
                id,
                result: result.clone(),
            });
        }
        if let Some(message) = self.path.as_mut().and_then(|path| path.next_message(now_ms)) {
            return Some(message);
        }
        if let Some(status) = self.status.take() {
            return Some(DeviceMessage::Status(status));
        }
        if let Some((id, result)) = Single::take_due(&mut self.bus) {
            let result = result.clone();
            return Some(DeviceMessage::Bus { id, result });
        }
        if let Some((id, answer)) = Single::take_due(&mut self.measuring) {
            let answer = answer.clone();
            return Some(DeviceMessage::Measured { id, answer });
        }
        self.next_batch()
    }

    fn welcome(&self) -> Welcome<P> {
        Welcome {
            protocol: P::VERSION,
            session: self.session.unwrap_or(0),
            firmware: shortened(self.identity.firmware),
            board: shortened(self.identity.board),
            config: self.config,
            capacity: self.identity.capacity,
            previous: self.previous.clone(),
        }
    }

    fn next_batch(&mut self) -> Option<DeviceMessage<P>> {
        if self.samples.len() < SAMPLES_PER_MESSAGE {
            return None;
        }
        let sequence = self.sequence_next.wrapping_sub(self.samples.len() as u32);
        let batch = core::iter::from_fn(|| self.samples.pop_front()).take(SAMPLES_PER_MESSAGE);
        Some(DeviceMessage::Telemetry {
            sequence,
            samples: batch.collect(),
        })
    }
}

fn shortened(text: &str) -> String<16> {
    let mut short = String::new();
    for letter in text.chars() {
        if short.push(letter).is_err() {
            break;
        }
    }
    short
}

#[cfg(test)]
mod tests;
