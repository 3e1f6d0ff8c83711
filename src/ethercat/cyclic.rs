//! The exchange of the critical task: process data out and in, once a millisecond.
//!
//! Each cycle starts with the input telegram (one LRD for each slave, the AL status of all, and requests of the slow
//! side in the spare room) and ends with the output telegram (one LWR for each slave). Each slave's data travel in a
//! datagram of their own, so one slave's failure costs the others nothing. Frames are built once for a plan; a cycle
//! copies one and stamps its index.
//!
//! Invariants: bounded time, no allocation, no waiting; a reply is used at most once, only in its own cycle, and only if
//! index, state, command, address and length of every datagram in it are those that were sent; everything else is
//! dropped and counted by kind.

use super::acyclic::{ACYCLIC_BYTES_MAX, Bytes, IN_FLIGHT_MAX, Outcome, Reply, Request, bytes};
pub use super::telegram::{IGNORED_KINDS, Ignored};
use super::telegram::{Owner, Place, SlotState, TEMPLATE_LEN, Telegram};
use super::wire::{
    self, Address, Command, DATAGRAM_HEADER_LEN, DATAGRAM_OVERHEAD, FRAME_LEN_MAX, FrameBuilder, FrameView, MacAddress,
    PAYLOAD_OFFSET, SOURCE_BIT, read_u8, read_u16, register,
};
use crate::drives::DriveKind;
use crate::robot::AXES;
use heapless::Vec;
use heapless::spsc::{Consumer, Producer};

/// Most slaves on the bus.
pub const SLAVES_MAX: usize = 16;
/// Most process data of one slave in one direction, bytes.
pub const PROCESS_BYTES_MAX: usize = 32;
/// Cycles in a row without a reply after which the bus counts as silent.
pub const SILENT_CYCLES: u8 = 10;

/// Most acyclic bytes in one frame, overhead included: one whole mailbox.
const ACYCLIC_ROOM: usize = ACYCLIC_BYTES_MAX + 2 * DATAGRAM_OVERHEAD;
/// How many frames back an index still counts as late rather than foreign.
const LATE_FRAMES: u8 = 64;

const _: () = {
    assert!(
        TEMPLATE_LEN + ACYCLIC_ROOM <= FRAME_LEN_MAX,
        "cyclic and acyclic data share one frame"
    );
    assert!(SLAVES_MAX <= 16, "the slaves that answered are reported in 16 bits");
};

/// Which axis a slave drives, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DriveRole {
    /// Axis, from 0.
    pub axis: u8,
    /// How its process data are laid out.
    pub kind: DriveKind,
}

/// One slave's share of the logical memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CyclicSlave {
    /// Logical address of its inputs.
    pub input_address: u32,
    /// Bytes of its inputs, at most [`PROCESS_BYTES_MAX`]; 0 for none.
    pub input_length: u16,
    /// Logical address of its outputs.
    pub output_address: u32,
    /// Bytes of its outputs, at most [`PROCESS_BYTES_MAX`]; 0 for none.
    pub output_length: u16,
    /// Whether a missing answer is an error; not while it is being configured or known to be lost.
    pub watched: bool,
    /// The axis it drives, if it is a drive that is used.
    pub role: Option<DriveRole>,
    /// Number of the slave's last configuration from INIT, wrapping: a new number means that it may have been switched
    /// off in between.
    pub generation: u8,
}

/// What is exchanged each cycle: the slaves in chain order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CyclicPlan {
    /// The slaves; those without process data have lengths of 0.
    pub slaves: Vec<CyclicSlave, SLAVES_MAX>,
    /// Bits of the AL status that come from slaves which are not used.
    pub al_bits_ignored: u16,
}

/// The AL status of all slaves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AlStatus {
    /// The slaves' AL status registers, OR-ed together.
    pub status: u16,
    /// How many slaves answered.
    pub slaves: u16,
}

/// What the critical side tells the supervisor whenever it changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Observation {
    /// The last AL status; zeros when silent.
    pub al: AlStatus,
    /// One bit for each slave whose inputs came with the right working counter.
    pub answered: u16,
    /// No reply at all for [`SILENT_CYCLES`] cycles.
    pub silent: bool,
}

/// What a received frame was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// This cycle's inputs.
    Input,
    /// The acknowledgement of this cycle's outputs.
    Output,
    /// Nothing to be used; counted.
    Ignored(Ignored),
}

/// What the exchange has counted since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusCounters {
    /// Telegrams built.
    pub frames_sent: u32,
    /// Telegrams whose reply had not come when the next cycle began.
    pub frames_lost: u32,
    /// Replies that came in a later cycle; each was counted as lost before.
    pub frames_late: u32,
    /// Datagrams of watched slaves that came back with another working counter than expected.
    pub working_counter_errors: u32,
    /// Dropped frames by kind; the index is [`Ignored`] as a number.
    pub ignored: [u32; IGNORED_KINDS],
}

impl BusCounters {
    /// Dropped frames of all kinds.
    pub fn frames_ignored(&self) -> u32 {
        self.ignored.iter().fold(0, |sum, count| sum.saturating_add(*count))
    }
}

/// The critical side's ends of the queues to the supervisor.
pub struct ExchangeEnd<'a> {
    /// New plans.
    pub plans: Consumer<'a, CyclicPlan>,
    /// Acyclic requests.
    pub requests: Consumer<'a, Request>,
    /// Their replies.
    pub replies: Producer<'a, Reply>,
    /// What was seen on the bus.
    pub observations: Producer<'a, Observation>,
}

/// The cyclic exchange; it lives in the critical task.
pub struct Exchange<'a> {
    end: ExchangeEnd<'a>,
    source: MacAddress,
    plan: CyclicPlan,
    axis_slaves: [Option<u8>; AXES],
    input: Telegram,
    output: Telegram,
    input_image: [[u8; PROCESS_BYTES_MAX]; SLAVES_MAX],
    output_image: [[u8; PROCESS_BYTES_MAX]; SLAVES_MAX],
    input_valid: u16,
    al: Option<AlStatus>,
    next_index: u8,
    source_bit_seen: bool,
    silent_cycles: u8,
    reported: Option<Observation>,
    counters: BusCounters,
}

impl<'a> Exchange<'a> {
    /// An exchange without a plan, sending from `source`.
    pub fn new(end: ExchangeEnd<'a>, source: MacAddress) -> Self {
        let mut exchange = Self {
            end,
            source,
            plan: CyclicPlan::default(),
            axis_slaves: [None; AXES],
            input: Telegram::new(),
            output: Telegram::new(),
            input_image: [[0; PROCESS_BYTES_MAX]; SLAVES_MAX],
            output_image: [[0; PROCESS_BYTES_MAX]; SLAVES_MAX],
            input_valid: 0,
            al: None,
            next_index: 0,
            source_bit_seen: false,
            silent_cycles: 0,
            reported: None,
            counters: BusCounters::default(),
        };
        exchange.adopt(CyclicPlan::default());
        exchange
    }

    /// Starts a cycle: settles the last one, takes a new plan, and writes the input telegram to `frame`, which should be
    /// [`FRAME_LEN_MAX`] long. Gives the telegram's length in bytes.
    pub fn input_telegram(&mut self, frame: &mut [u8]) -> usize {
        self.settle();
        while let Some(plan) = self.end.plans.dequeue() {
            self.adopt(plan);
        }
        let index = self.take_index();
        if !self.input.stamp(frame, index) {
            return 0;
        }
        let Ok(mut builder) = FrameBuilder::resume(frame, self.input.template_len, self.input.last) else {
            return 0;
        };
        let acyclic_end = builder.position() + ACYCLIC_ROOM;
        for _ in 0..IN_FLIGHT_MAX {
            // One reply is owed for each request that is taken.
            let owed = self.input.places.len() - self.input.prebuilt;
            let Some(request) = self.end.requests.peek() else { break };
            let fits = builder.position() + DATAGRAM_OVERHEAD + request.data.len() <= acyclic_end;
            if !fits || self.end.replies.len() + owed >= self.end.replies.capacity() {
                break;
            }
            let place = Place {
                offset: (builder.position() - PAYLOAD_OFFSET) as u16,
                length: request.data.len() as u16,
                command: request.command,
                address: request.address,
                owner: Owner::Acyclic,
            };
            let Ok(data) = builder.push(request.command, index, request.address, request.data.len()) else {
                break;
            };
            data.copy_from_slice(&request.data);
            // The list holds as many as may be in flight.
            let _ = self.input.places.push(place);
            let _ = self.end.requests.dequeue();
        }
        self.input.payload_len = builder.position() - PAYLOAD_OFFSET;
        self.input.state = SlotState::Sent;
        self.counters.frames_sent = self.counters.frames_sent.saturating_add(1);
        builder.finish()
    }

    /// Writes the output telegram with the present outputs to `frame`. Gives its length, 0 when no slave has outputs.
    pub fn output_telegram(&mut self, frame: &mut [u8]) -> usize {
        if self.output.prebuilt == 0 {
            return 0;
        }
        let index = self.take_index();
        if !self.output.stamp(frame, index) {
            return 0;
        }
        for place in &self.output.places {
            let start = PAYLOAD_OFFSET + usize::from(place.offset) + DATAGRAM_HEADER_LEN;
            let Owner::Slave(slave) = place.owner else { continue };
            let image = self.output_image.get(usize::from(slave)).map_or(&[][..], |image| image);
            if let Some(data) = image.get(..usize::from(place.length)) {
                wire::write_bytes(frame, start, data);
            }
        }
        let Ok(builder) = FrameBuilder::resume(frame, self.output.template_len, self.output.last) else {
            return 0;
        };
        self.output.payload_len = builder.position() - PAYLOAD_OFFSET;
        self.output.state = SlotState::Sent;
        self.counters.frames_sent = self.counters.frames_sent.saturating_add(1);
        builder.finish()
    }

    /// Takes a received Ethernet frame (without check sequence): uses it if it is this cycle's, drops it otherwise.
    pub fn receive(&mut self, frame: &[u8]) -> Arrival {
        match self.accept(frame) {
            Ok(arrival) => arrival,
            Err(kind) => {
                if kind == Ignored::Late {
                    self.counters.frames_late = self.counters.frames_late.saturating_add(1);
                }
                if let Some(count) = self.counters.ignored.get_mut(kind as usize) {
                    *count = count.saturating_add(1);
                }
                Arrival::Ignored(kind)
            }
        }
    }

    /// This cycle's inputs of a slave (position in the chain); `None` unless they came with the right working counter.
    pub fn input(&self, slave: usize) -> Option<&[u8]> {
        let length = usize::from(self.plan.slaves.get(slave)?.input_length);
        if length == 0 || self.input_valid & 1 << slave == 0 {
            return None;
        }
        self.input_image.get(slave)?.get(..length)
    }

    /// The outputs of a slave (position in the chain), to be changed before [`Self::output_telegram`]; empty where there
    /// are none.
    pub fn output(&mut self, slave: usize) -> &mut [u8] {
        let length = self
            .plan
            .slaves
            .get(slave)
            .map_or(0, |slave| usize::from(slave.output_length));
        self.output_image
            .get_mut(slave)
            .and_then(|image| image.get_mut(..length))
            .unwrap_or(&mut [])
    }

    /// This cycle's AL status of the slaves in use, and the number of all slaves.
    pub fn al_status(&self) -> Option<AlStatus> {
        self.al.map(|al| AlStatus {
            status: al.status & !self.plan.al_bits_ignored,
            slaves: al.slaves,
        })
    }

    /// What has been counted.
    pub fn counters(&self) -> BusCounters {
        self.counters
    }

    /// The plan in force.
    pub fn plan(&self) -> &CyclicPlan {
        &self.plan
    }

    /// The slave that drives an axis: its position in the chain and its kind.
    pub fn drive(&self, axis: usize) -> Option<(usize, DriveKind)> {
        let slave = usize::from((*self.axis_slaves.get(axis)?)?);
        let role = self.plan.slaves.get(slave)?.role?;
        Some((slave, role.kind))
    }

    fn take_index(&mut self) -> u8 {
        let index = self.next_index;
        self.next_index = index.wrapping_add(1);
        index
    }

    /// Ends a cycle: what has not come is lost, and the supervisor learns what changed.
    fn settle(&mut self) {
        let mut lost = 0;
        if self.input.state == SlotState::Sent {
            lost += 1;
            self.silent_cycles = self.silent_cycles.saturating_add(1).min(SILENT_CYCLES);
            self.answer_acyclic(None);
        } else if self.input.state == SlotState::Received {
            self.silent_cycles = 0;
        }
        if self.output.state == SlotState::Sent {
            lost += 1;
        }
        self.counters.frames_lost = self.counters.frames_lost.saturating_add(lost);
        let silent = self.silent_cycles >= SILENT_CYCLES;
        let seen = match self.al {
            Some(al) => Some(Observation {
                al,
                answered: self.input_valid,
                silent,
            }),
            None if silent => Some(Observation {
                al: AlStatus::default(),
                answered: 0,
                silent,
            }),
            None => None,
        };
        if seen.is_some() && seen != self.reported {
            let sent = seen.is_some_and(|seen| self.end.observations.enqueue(seen).is_ok());
            self.reported = if sent { seen } else { self.reported };
        }
        self.input.state = SlotState::Idle;
        self.output.state = SlotState::Idle;
        self.input_valid = 0;
        self.al = None;
    }

    fn adopt(&mut self, plan: CyclicPlan) {
        for (number, new) in plan.slaves.iter().enumerate() {
            let old = self.plan.slaves.get(number).copied().unwrap_or_default();
            let moved = (old.output_address, old.output_length) != (new.output_address, new.output_length);
            if let Some(image) = self.output_image.get_mut(number).filter(|_| moved) {
                image.fill(0);
            }
        }
        self.axis_slaves = [None; AXES];
        for (number, slave) in plan.slaves.iter().enumerate() {
            let axis = slave
                .role
                .and_then(|role| self.axis_slaves.get_mut(usize::from(role.axis)));
            if let Some(entry) = axis {
                *entry = Some(number as u8);
            }
        }
        let bounded = |length: u16| (1..=PROCESS_BYTES_MAX as u16).contains(&length);
        let inputs = plan
            .slaves
            .iter()
            .enumerate()
            .filter(|(_, slave)| bounded(slave.input_length));
        let al_status = (
            Owner::AlStatus,
            Command::Brd,
            Address::broadcast(register::AL_STATUS),
            2,
        );
        self.input.build(
            self.source,
            inputs
                .map(|(number, slave)| {
                    let address = Address::logical(slave.input_address);
                    (Owner::Slave(number as u8), Command::Lrd, address, slave.input_length)
                })
                .chain(core::iter::once(al_status)),
        );
        let outputs = plan
            .slaves
            .iter()
            .enumerate()
            .filter(|(_, slave)| bounded(slave.output_length));
        self.output.build(
            self.source,
            outputs.map(|(number, slave)| {
                let address = Address::logical(slave.output_address);
                (Owner::Slave(number as u8), Command::Lwr, address, slave.output_length)
            }),
        );
        self.plan = plan;
    }

    fn accept(&mut self, frame: &[u8]) -> Result<Arrival, Ignored> {
        let view = FrameView::new_checked(frame).map_err(|error| match error {
            wire::Error::EtherType { .. } => Ignored::EtherType,
            wire::Error::FrameType { .. } => Ignored::FrameType,
            _ => Ignored::Truncated,
        })?;
        let unmarked = |mac: MacAddress| [mac[0] | SOURCE_BIT, mac[1], mac[2], mac[3], mac[4], mac[5]];
        if unmarked(view.source()) != unmarked(self.source) {
            return Err(Ignored::ForeignSource);
        }
        let payload = view.payload();
        let index = read_u8(payload, 1);
        let is_input = self.input.state != SlotState::Idle && self.input.index == index;
        let is_output = self.output.state != SlotState::Idle && self.output.index == index;
        let telegram = match (is_input, is_output) {
            (true, _) => &mut self.input,
            (false, true) => &mut self.output,
            (false, false) => {
                let age = self.next_index.wrapping_sub(index);
                let sent_before = u32::from(age) <= self.counters.frames_sent;
                let late = (1..=LATE_FRAMES).contains(&age) && sent_before;
                return Err(if late { Ignored::Late } else { Ignored::ForeignIndex });
            }
        };
        let touched = telegram.check(payload)?;
        let marked = view.source()[0] != self.source[0];
        if !touched && !marked && (is_input || self.source_bit_seen) {
            return Err(Ignored::Reflection);
        }
        if telegram.state == SlotState::Received {
            return Err(Ignored::Duplicate);
        }
        telegram.state = SlotState::Received;
        self.source_bit_seen |= marked;
        if is_input {
            self.take_inputs(payload);
            self.answer_acyclic(Some(payload));
            Ok(Arrival::Input)
        } else {
            self.count_outputs(payload);
            Ok(Arrival::Output)
        }
    }

    fn is_watched(&self, slave: u8) -> bool {
        self.plan
            .slaves
            .get(usize::from(slave))
            .is_some_and(|slave| slave.watched)
    }

    fn take_inputs(&mut self, payload: &[u8]) {
        let mut errors = 0;
        for place in &self.input.places {
            let working_counter = place.working_counter(payload);
            match place.owner {
                Owner::Slave(slave) if working_counter == 1 => {
                    if let Some(image) = self.input_image.get_mut(usize::from(slave)) {
                        wire::write_bytes(image, 0, place.data(payload));
                        self.input_valid |= 1 << slave;
                    }
                }
                Owner::Slave(slave) => errors += u32::from(self.is_watched(slave)),
                Owner::AlStatus => {
                    let status = read_u16(place.data(payload), 0);
                    self.al = Some(AlStatus {
                        status,
                        slaves: working_counter,
                    });
                }
                Owner::Acyclic => {}
            }
        }
        self.counters.working_counter_errors = self.counters.working_counter_errors.saturating_add(errors);
    }

    fn count_outputs(&mut self, payload: &[u8]) {
        let errors = self.output.places.iter().filter(|place| match place.owner {
            Owner::Slave(slave) => place.working_counter(payload) != 1 && self.is_watched(slave),
            _ => false,
        });
        let errors = errors.count() as u32;
        self.counters.working_counter_errors = self.counters.working_counter_errors.saturating_add(errors);
    }

    /// Gives every acyclic request of the input telegram its reply: out of `payload`, or lost.
    fn answer_acyclic(&mut self, payload: Option<&[u8]>) {
        for place in &self.input.places {
            if place.owner != Owner::Acyclic {
                continue;
            }
            let reply = match payload {
                Some(payload) => Reply {
                    data: bytes(place.data(payload)),
                    outcome: Outcome::Processed {
                        working_counter: place.working_counter(payload),
                    },
                },
                None => Reply {
                    data: Bytes::new(),
                    outcome: Outcome::Lost,
                },
            };
            // Room was kept when the request was taken.
            let _ = self.end.replies.enqueue(reply);
        }
    }
}
