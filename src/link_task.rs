//! The link task: moves the link's bytes and messages once a millisecond at low priority.
//!
//! It takes bytes from the ports, hands each request to the [`Coordinator`] and sends what the coordinator answers,
//! with the telemetry. It decides nothing by itself. The trajectory task may delay it by several milliseconds; the
//! queues hold what arrives meanwhile.

use crate::application::{Fault, Mode};
use crate::black_box::{Event, EventLog};
use crate::board::{BoardState, PreviousRun};
use crate::coordinator::{Coordinator, CoordinatorEnds, LinkLosses};
use crate::link::device::LINE_BYTES_PER_MS;
use crate::link::frame::Decoder;
use crate::link::ports::LinkPort;
use crate::messages::{DeviceEndpoint, DeviceEvent, RecordAnswer, RecordRequest};
use heapless::spsc::{Consumer, Producer};

/// Bytes queued ahead for the line; few, so that an answer does not queue behind telemetry.
pub const SENT_AHEAD_BYTES: usize = 2 * LINE_BYTES_PER_MS;

/// The link task's ends of a port's channels.
pub struct PortEnds<'a> {
    /// Bytes from the host.
    pub received: Consumer<'a, u8>,
    /// Finds the frames in the received bytes; large, therefore stored in the channels.
    pub decoder: &'a mut Decoder,
    /// Bytes to the host.
    pub sent: Producer<'a, u8>,
}

/// The ports on which a host may speak.
pub struct Ports<'a> {
    /// The serial line.
    pub serial: PortEnds<'a>,
    /// The board's own USB.
    pub usb: PortEnds<'a>,
}

impl<'a> Ports<'a> {
    fn get(&mut self, port: LinkPort) -> &mut PortEnds<'a> {
        match port {
            LinkPort::Serial => &mut self.serial,
            LinkPort::Usb => &mut self.usb,
        }
    }
}

/// The link task; owns the coordinator and records events in the black box.
pub struct LinkTask<'a> {
    ports: Ports<'a>,
    events: EventLog<'a>,
    endpoint: &'a mut DeviceEndpoint,
    coordinator: Coordinator<'a>,
}

impl<'a> LinkTask<'a> {
    /// A link task without a host, over the board's end of the link.
    pub fn new(
        endpoint: &'a mut DeviceEndpoint,
        ports: Ports<'a>,
        ends: CoordinatorEnds<'a>,
        events: EventLog<'a>,
    ) -> Self {
        Self {
            ports,
            events,
            endpoint,
            coordinator: Coordinator::new(ends),
        }
    }

    /// The operating mode.
    pub fn mode(&self) -> Mode {
        self.coordinator.mode()
    }

    /// The latched fault.
    pub fn fault(&self) -> Option<Fault> {
        self.coordinator.fault()
    }

    /// Sets how the previous run ended, as reported to the host.
    pub fn set_previous_run(&mut self, previous: PreviousRun) {
        self.endpoint.set_previous_run(previous);
    }

    /// Sets the state of the board; call it at every change before [`Self::tick`].
    pub fn set_board(&mut self, board: BoardState) {
        self.coordinator.set_board(board);
    }

    /// Advances by one millisecond.
    pub fn tick(&mut self) {
        self.take_reports();
        for port in LinkPort::ALL {
            self.take_bytes(port);
        }
        let silence_ms = self.endpoint.silence_ms(self.coordinator.now_ms());
        let silence_ms = silence_ms.and_then(|silence_ms| u32::try_from(silence_ms).ok());
        self.coordinator.step(silence_ms.unwrap_or(u32::MAX));
        self.close_abandoned_path();
        let coordinator = &self.coordinator;
        self.events
            .watch(coordinator.now_ms(), coordinator.mode(), coordinator.fault());
        self.send();
    }

    /// Passes the coordinator's reports to the endpoint.
    fn take_reports(&mut self) {
        self.coordinator.take_events();
        self.close_abandoned_path();
        while let Some((id, result)) = self.coordinator.take_bus_answer() {
            self.endpoint.bus_answered(id, result);
        }
        while let Some(sample) = self.coordinator.take_sample() {
            self.endpoint.sample(sample);
        }
        let counts = self.endpoint.counts();
        let damaged = [&self.ports.serial, &self.ports.usb].map(|port| port.decoder.counts().bad);
        self.coordinator.set_link_losses(LinkLosses {
            samples: counts.samples_dropped,
            frames: damaged.into_iter().fold(counts.not_understood, u32::wrapping_add),
        });
        self.coordinator.advance();
    }

    fn take_bytes(&mut self, port: LinkPort) {
        while let Some(byte) = self.ports.get(port).received.dequeue() {
            let (now_ms, free) = (self.coordinator.now_ms(), self.coordinator.free());
            let Some(Ok(payload)) = self.ports.get(port).decoder.push(byte) else {
                continue;
            };
            if let Some(event) = self.endpoint.receive(port, payload, now_ms, free) {
                self.pass_on(event);
            }
        }
    }

    /// Hands a request to the coordinator, and its answer to the endpoint.
    fn pass_on(&mut self, event: DeviceEvent) {
        let (coordinator, endpoint) = (&mut self.coordinator, &mut self.endpoint);
        let now_ms = coordinator.now_ms();
        match event {
            DeviceEvent::Connected => {
                self.events.put(now_ms, &Event::Connected);
                coordinator.forget_bus_request();
                endpoint.status(coordinator.status());
            }
            DeviceEvent::Inquire => endpoint.status(coordinator.status()),
            DeviceEvent::Configure { id, config } => {
                let result = coordinator.configure(&config);
                if let Ok(hash) = result {
                    self.events.put(now_ms, &Event::Configured { hash });
                }
                endpoint.configured(id, result);
            }
            DeviceEvent::Command { id, command } => {
                self.events.command(now_ms, command);
                let result = coordinator.command(command);
                if let Err(refusal) = result {
                    self.events.put(now_ms, &Event::Refused(refusal));
                }
                self.close_abandoned_path();
                self.endpoint.answer(id, result);
            }
            DeviceEvent::Stop { command } => {
                self.events.command(now_ms, command);
                if coordinator.command(command).is_ok() {
                    endpoint.close_path();
                }
            }
            DeviceEvent::Path { vertices, last } => {
                if let Err(refusal) = coordinator.path(&vertices, last) {
                    endpoint.refuse_vertex(refusal);
                }
            }
            DeviceEvent::Bus { id, request } => {
                if let Err(error) = coordinator.ask_bus(id, request) {
                    endpoint.bus_answered(id, Err(error));
                }
            }
            DeviceEvent::Measure { id, request } => {
                let answer = match request {
                    RecordRequest::Measurement(request) => RecordAnswer::Measurement(coordinator.measure(request)),
                    RecordRequest::BlackBox(request) => RecordAnswer::BlackBox(self.events.memory().answer(request)),
                };
                endpoint.measured(id, answer);
            }
        }
    }

    fn close_abandoned_path(&mut self) {
        if self.coordinator.take_abandoned() {
            self.endpoint.close_path();
        }
    }

    /// Sends progress, status and all that the endpoint has queued, as far as the line has room.
    fn send(&mut self) {
        let progress = self.coordinator.path_progress();
        self.endpoint
            .acknowledge(progress.executed, progress.free, progress.finished);
        if let Some(status) = self.coordinator.due_status() {
            self.endpoint.status(status);
        }
        let sent = &mut self.ports.get(self.endpoint.port()).sent;
        let room = SENT_AHEAD_BYTES.saturating_sub(sent.len());
        let mut bytes = [0; SENT_AHEAD_BYTES];
        let now_ms = self.coordinator.now_ms();
        let length = self
            .endpoint
            .transmit(now_ms, bytes.get_mut(..room).unwrap_or_default());
        for byte in bytes.iter().take(length) {
            // There is room: the queue is longer than SENT_AHEAD_BYTES.
            let _ = sent.enqueue(*byte);
        }
    }
}
