//! The exchange of the critical task: process data in both directions, once a millisecond.
//!
//! Each cycle starts with the input telegram: a datagram for each slave (LRD; LRW when inputs and outputs are exchanged
//! together), the AL status of all slaves, the reference clock's time, and requests of the slow side in the free space.
//! When inputs and outputs are exchanged apart, the cycle ends with the output telegram: one LWR for each slave. Each
//! slave's data travel in separate datagrams, so a failed slave does not affect the data of the others. Frames are
//! built once for a plan; each cycle stamps an index, and outputs are written directly into the frame.
//!
//! Invariants: bounded time, no allocation, no waiting. A reply is used at most once, only in its own cycle, and only
//! if index, state, command, address and length of every datagram in it equal what was sent; every other frame is
//! dropped and counted by kind.

use super::acyclic::{IN_FLIGHT_MAX, Outcome, Reply, Request, bytes};
use super::driver::{Role, SlaveFactory};
use super::encapsulation::Encapsulation;
pub use super::observation::{AlStatus, Arrival, BusCounters, IGNORED_KINDS, Ignored, Observation};
pub use super::plan::{
    CyclicPlan, CyclicSlave, ExchangeKind, PROCESS_BYTES_MAX, PlanError, ReferenceClock, SPAN_BYTES_MAX, VALUES_MAX,
    ValueBit,
};
use super::queue;
use super::telegram::{Image, SlotState, Taken, Telegram};
use super::wire::{MacAddress, read_u8};
use heapless::spsc::{Consumer, Producer};

/// Consecutive cycles without a reply after which the bus counts as silent.
pub const SILENT_CYCLES: u8 = 10;

/// Most acyclic datagrams in a frame while drives are in operation, which keeps the cycle as short as possible.
const IN_OPERATION_MAX: usize = 1;

/// Largest age of an index that counts as late, frames; an older index counts as foreign.
const LATE_FRAMES: u8 = 64;

/// The critical side's ends of the queues to the supervisor.
pub struct ExchangeEnd<'a, F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> {
    /// Plans, each used from the next cycle on.
    pub plans: Consumer<'a, CyclicPlan<F, SLAVES>>,
    /// Requests for registers.
    pub requests: Consumer<'a, Request>,
    /// Replies to the register requests.
    pub replies: Producer<'a, Reply>,
    /// Messages to and from mailboxes.
    pub messages: Consumer<'a, Request<MESSAGE>>,
    /// Replies to the mailbox messages.
    pub message_replies: Producer<'a, Reply<MESSAGE>>,
    /// Bus states for the supervisor.
    pub observations: Producer<'a, Observation>,
}

/// Place of a slave's outputs in the frame that carries them, valid for the present plan.
#[derive(Clone, Copy, Debug, Default)]
pub struct OutputPlace {
    start: u16,
    length: u16,
}

/// The cyclic exchange; it lives in the critical task.
pub struct Exchange<'a, F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> {
    end: ExchangeEnd<'a, F, SLAVES, MESSAGE>,
    source: MacAddress,
    encapsulation: Encapsulation,
    plan: CyclicPlan<F, SLAVES>,
    plan_number: u32,
    first: Telegram<SLAVES>,
    second: Telegram<SLAVES>,
    outputs: [OutputPlace; SLAVES],
    images: [Image; SLAVES],
    input_valid: u32,
    /// Slaves that answer only the second telegram, one bit each.
    second_only: u32,
    answered: u32,
    al: Option<AlStatus>,
    clock_ns: Option<u64>,
    next_index: u8,
    /// Whether the next turn belongs to a message: the last acyclic datagram was a register request.
    message_is_next: bool,
    source_bit_seen: bool,
    silent_cycles: u8,
    reported: Option<Observation>,
    counters: BusCounters,
}

impl<'a, F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> Exchange<'a, F, SLAVES, MESSAGE> {
    /// An exchange without a plan that sends from `source`, in Ethernet frames with EtherCAT's own EtherType.
    pub fn new(end: ExchangeEnd<'a, F, SLAVES, MESSAGE>, source: MacAddress) -> Self {
        const { assert!(SLAVES <= 32, "the slaves that answered are reported in 32 bits") };
        let mut exchange = Self {
            end,
            source,
            encapsulation: Encapsulation::Raw,
            plan: CyclicPlan::default(),
            plan_number: 0,
            first: Telegram::new(),
            second: Telegram::new(),
            outputs: [OutputPlace::default(); SLAVES],
            images: [Image::default(); SLAVES],
            input_valid: 0,
            second_only: 0,
            answered: 0,
            al: None,
            clock_ns: None,
            next_index: 0,
            message_is_next: false,
            source_bit_seen: false,
            silent_cycles: 0,
            reported: None,
            counters: BusCounters::default(),
        };
        exchange.adopt(CyclicPlan::default());
        exchange
    }

    /// Sends the following telegrams in another encapsulation; frames in flight are lost.
    pub fn set_encapsulation(&mut self, encapsulation: Encapsulation) {
        if encapsulation != self.encapsulation {
            self.settle();
            self.encapsulation = encapsulation;
            self.source_bit_seen = false;
            self.adopt(self.plan.clone());
        }
    }

    /// Starts a cycle: settles the last one, takes a new plan, and returns the input telegram to send.
    pub fn input_telegram(&mut self) -> &[u8] {
        self.settle();
        while self.end.plans.ready() {
            self.take_plan();
        }
        if !self.first.acyclic.is_empty() {
            self.first.drop_acyclic(&self.encapsulation);
        }
        if self.end.requests.ready() || self.end.messages.ready() {
            self.append_acyclic();
        }
        self.counters.frames_sent = self.counters.frames_sent.saturating_add(1);
        let index = self.take_index();
        self.first.send(index)
    }

    /// Returns the output telegram with the present outputs; empty when no slave has outputs that are sent after
    /// control.
    pub fn output_telegram(&mut self) -> &[u8] {
        if self.second.is_empty() {
            return &[];
        }
        self.counters.frames_sent = self.counters.frames_sent.saturating_add(1);
        let index = self.take_index();
        self.second.send(index)
    }

    /// Takes a received frame (without check sequence): uses it if it belongs to this cycle, otherwise drops it.
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

    /// This cycle's inputs of a slave (position in the chain); `None` unless they came with the expected working
    /// counter.
    #[inline]
    pub fn input(&self, slave: usize) -> Option<&[u8]> {
        let length = usize::from(self.plan.slaves.get(slave)?.input_length);
        if length == 0 || self.input_valid >> slave & 1 == 0 {
            return None;
        }
        self.images.get(slave)?.as_flattened().get(..length)
    }

    /// This cycle's inputs of a slave in a buffer of the longest length; bytes behind the slave's inputs have no
    /// meaning. `None` as for [`Self::input`].
    #[inline]
    pub fn image(&self, slave: usize) -> Option<&[u8; PROCESS_BYTES_MAX]> {
        let image = self.images.get(slave)?;
        let valid = self.input_valid >> (slave & 31) & 1 != 0;
        image.as_flattened().first_chunk().filter(|_| valid)
    }

    /// The outputs of a slave (position in the chain) that the next telegram will carry; empty if the slave has none.
    #[inline]
    pub fn output(&mut self, slave: usize) -> &mut [u8] {
        self.output_at(self.output_place(slave))
    }

    /// The outputs of a slave (position in the chain) that the next telegram will carry, to be read.
    #[inline]
    pub fn sent(&self, slave: usize) -> &[u8] {
        let place = self.output_place(slave);
        let telegram = match self.plan.exchange {
            ExchangeKind::Split => &self.second,
            ExchangeKind::Combined => &self.first,
        };
        telegram.bytes(place.start.into(), place.length.into()).unwrap_or(&[])
    }

    /// Place of the outputs of a slave (position in the chain), valid until the next plan.
    pub fn output_place(&self, slave: usize) -> OutputPlace {
        self.outputs.get(slave).copied().unwrap_or_default()
    }

    /// The outputs at a place, as in [`Self::output`].
    #[inline]
    pub fn output_at(&mut self, place: OutputPlace) -> &mut [u8] {
        let telegram = match self.plan.exchange {
            ExchangeKind::Split => &mut self.second,
            ExchangeKind::Combined => &mut self.first,
        };
        telegram
            .bytes_mut(place.start.into(), place.length.into())
            .unwrap_or(&mut [])
    }

    /// This cycle's AL status of the slaves in use, and the number of all slaves that answered.
    pub fn al_status(&self) -> Option<AlStatus> {
        self.al.map(|al| AlStatus {
            status: al.status & !self.plan.al_bits_ignored,
            slaves: al.slaves,
        })
    }

    /// This cycle's time of the reference clock, ns, if all participating slaves received it; only the low 32 bits if
    /// the clocks are 32 bits wide.
    pub fn clock_ns(&self) -> Option<u64> {
        self.clock_ns
    }

    /// The counters.
    pub fn counters(&self) -> BusCounters {
        self.counters
    }

    /// The plan in force.
    pub fn plan(&self) -> &CyclicPlan<F, SLAVES> {
        &self.plan
    }

    /// Number of the plan in force, wrapping; changes with every plan.
    #[inline]
    pub fn plan_number(&self) -> u32 {
        self.plan_number
    }

    /// Position in the chain of the slave that is the application's member of this number.
    pub fn member(&self, number: usize) -> Option<usize> {
        let has = |role: &Role<F>| usize::from(role.member) == number;
        self.plan
            .slaves
            .iter()
            .position(|slave| slave.role.as_ref().is_some_and(has))
    }

    fn take_index(&mut self) -> u8 {
        let index = self.next_index;
        self.next_index = index.wrapping_add(1);
        index
    }

    /// Ends a cycle: missing replies count as lost, and the supervisor is informed of changes.
    fn settle(&mut self) {
        let mut lost = 0;
        if self.first.state == SlotState::Sent {
            lost += 1;
            self.silent_cycles = self.silent_cycles.saturating_add(1).min(SILENT_CYCLES);
            self.answer_lost();
        } else if self.first.state == SlotState::Received {
            self.silent_cycles = 0;
        }
        if self.second.state == SlotState::Sent {
            lost += 1;
        }
        self.counters.frames_lost = self.counters.frames_lost.saturating_add(lost);
        let silent = self.silent_cycles >= SILENT_CYCLES;
        if self.al.is_some() || silent {
            let seen = Observation {
                al: self.al.unwrap_or_default(),
                answered: if self.al.is_some() { self.answered } else { 0 },
                silent,
            };
            if self.reported != Some(seen) && queue::put(&mut self.end.observations, seen).is_ok() {
                self.reported = Some(seen);
            }
        }
        self.first.state = SlotState::Idle;
        self.second.state = SlotState::Idle;
        self.input_valid = 0;
        self.answered = 0;
        self.al = None;
        self.clock_ns = None;
    }

    #[cold]
    fn take_plan(&mut self) {
        if let Some(plan) = queue::take(&mut self.end.plans) {
            self.adopt(plan);
        }
    }

    /// Builds the telegrams of a plan; outputs are kept for slaves whose share and role are unchanged.
    fn adopt(&mut self, plan: CyclicPlan<F, SLAVES>) {
        let mut kept = [[0; PROCESS_BYTES_MAX]; SLAVES];
        for (number, (new, kept)) in plan.slaves.iter().zip(&mut kept).enumerate() {
            let old = self.plan.slaves.get(number).copied().unwrap_or_default();
            let same = (old.output_address, old.output_length) == (new.output_address, new.output_length);
            // Outputs that are no longer written return to zero.
            let used = (old.role, self.plan.terminals.contains(number));
            if same && used == (new.role, plan.terminals.contains(number)) {
                super::wire::write_bytes(kept, 0, self.output(number));
            }
        }
        self.first.clear(&self.encapsulation, self.source);
        self.second.clear(&self.encapsulation, self.source);
        self.outputs = [OutputPlace::default(); SLAVES];
        self.second_only = 0;
        let kind = plan.exchange;
        for ((number, slave), place) in (0..).zip(&plan.slaves).zip(&mut self.outputs) {
            let (first, second) = (slave.first_window(kind), slave.second_window(kind));
            self.second_only |= u32::from(first.is_none() && second.is_some()) << (number & 31);
            let windows = [(first, &mut self.first), (second, &mut self.second)];
            for (window, telegram) in windows {
                let Some(window) = window else { continue };
                let data = telegram.push_share(number, slave.watched, &window);
                if let Some(data) = data.filter(|_| window.output_length > 0) {
                    *place = OutputPlace {
                        start: data as u16 + window.output_offset,
                        length: window.output_length,
                    };
                }
            }
        }
        self.first.push_common(plan.clock);
        self.first.finish(&self.encapsulation);
        self.second.finish(&self.encapsulation);
        self.plan = plan;
        self.plan_number = self.plan_number.wrapping_add(1);
        for (number, kept) in kept.iter().enumerate() {
            let output = self.output(number);
            let length = output.len();
            super::wire::write_bytes(output, 0, kept.get(..length).unwrap_or(&[]));
        }
    }

    /// Appends the slow side's datagrams behind the cyclic ones: register requests, and one message. In operation the
    /// two lanes alternate, so that neither waits for more than one datagram of the other.
    #[cold]
    fn append_acyclic(&mut self) {
        let room = self.first.room();
        let in_operation = self.first.is_watched();
        let message_goes_first = in_operation && self.message_is_next && self.append_message(room);
        let sent = match (message_goes_first, in_operation) {
            (true, _) => 0,
            (false, true) => self.append_requests(room, IN_OPERATION_MAX),
            (false, false) => self.append_requests(room, IN_FLIGHT_MAX),
        };
        if !in_operation || (!message_goes_first && sent == 0) {
            self.append_message(room);
        }
        self.message_is_next = sent > 0;
        self.first.finish_acyclic(&self.encapsulation);
    }

    /// Appends at most `most` register requests as room permits; returns how many.
    fn append_requests(&mut self, room: usize, most: usize) -> usize {
        let mut owed = 0;
        for _ in 0..most {
            let Some(request) = queue::front(&self.end.requests) else {
                break;
            };
            // One reply is owed for each request that is taken.
            if !queue::has_room_for(&self.end.replies, owed + 1) {
                break;
            }
            if request.data.len() > room {
                if owed > 0 {
                    // Replies come in order: this reply waits for those of the requests before it.
                    break;
                }
                // There is room; it was checked above.
                let no_room = Outcome::NoRoom { room: room as u16 };
                let _ = queue::put(&mut self.end.replies, Reply::without_data(no_room));
            } else if self
                .first
                .push_acyclic(request.command, request.address, &request.data, false)
            {
                owed += 1;
            } else {
                break;
            }
            let _ = queue::take(&mut self.end.requests);
        }
        owed
    }

    /// Appends the waiting message, if there is one and it fits.
    fn append_message(&mut self, room: usize) -> bool {
        let Some(message) = queue::front(&self.end.messages) else {
            return false;
        };
        if !queue::has_room_for(&self.end.message_replies, 1) {
            return false;
        }
        let fits_never = message.data.len() > room;
        let taken = if fits_never {
            let no_room = Outcome::NoRoom { room: room as u16 };
            queue::put(&mut self.end.message_replies, Reply::without_data(no_room)).is_ok()
        } else {
            self.first
                .push_acyclic(message.command, message.address, &message.data, true)
        };
        if taken {
            let _ = queue::take(&mut self.end.messages);
        }
        taken && !fits_never
    }

    fn accept(&mut self, frame: &[u8]) -> Result<Arrival, Ignored> {
        let opened = self.encapsulation.open(frame, &self.source)?;
        let index = read_u8(opened.payload, 1);
        let is_input = self.first.state != SlotState::Idle && self.first.index == index;
        let is_output = self.second.state != SlotState::Idle && self.second.index == index;
        let telegram = match (is_input, is_output) {
            (true, _) => &mut self.first,
            (false, true) => &mut self.second,
            (false, false) => return Err(self.foreign_index(index)),
        };
        if telegram.state == SlotState::Received {
            return Err(Ignored::Duplicate);
        }
        let taken = telegram.take(opened.payload, &mut self.images)?;
        if !taken.touched && !opened.marked && (is_input || self.source_bit_seen) {
            return Err(Ignored::Reflection);
        }
        telegram.state = SlotState::Received;
        self.source_bit_seen |= opened.marked;
        self.counters.working_counter_errors = self.counters.working_counter_errors.saturating_add(taken.errors);
        if is_input {
            self.take_inputs(&taken);
            if !self.first.acyclic.is_empty() {
                self.answer_acyclic(opened.payload);
            }
            Ok(Arrival::Input)
        } else {
            self.answered |= taken.answered & self.second_only;
            Ok(Arrival::Output)
        }
    }

    /// Kind of a frame whose index is not in use.
    #[cold]
    fn foreign_index(&self, index: u8) -> Ignored {
        let age = self.next_index.wrapping_sub(index);
        let sent_before = u32::from(age) <= self.counters.frames_sent;
        if (1..=LATE_FRAMES).contains(&age) && sent_before {
            Ignored::Late
        } else {
            Ignored::ForeignIndex
        }
    }

    fn take_inputs(&mut self, taken: &Taken) {
        self.input_valid = taken.answered;
        self.answered |= taken.answered;
        self.al = taken.al;
        self.clock_ns = taken.clock_ns;
        if let Some(time_ns) = taken.clock_ns {
            self.first.set_clock(time_ns);
        }
    }

    /// Replies to every acyclic request of the input telegram.
    #[cold]
    fn answer_acyclic(&mut self, payload: &[u8]) {
        let (replies, message_replies) = (&mut self.end.replies, &mut self.end.message_replies);
        self.first.each_acyclic(payload, |place, data, working_counter| {
            let outcome = Outcome::Processed { working_counter };
            // Room was reserved when the request was taken.
            if place.is_message {
                let _ = queue::put(
                    message_replies,
                    Reply {
                        data: bytes(data),
                        outcome,
                    },
                );
            } else {
                let _ = queue::put(
                    replies,
                    Reply {
                        data: bytes(data),
                        outcome,
                    },
                );
            }
        });
    }

    /// Reports the acyclic requests of the input telegram to the slow side as lost.
    fn answer_lost(&mut self) {
        for place in &self.first.acyclic {
            // Room was reserved when the request was taken.
            if place.is_message {
                let _ = queue::put(&mut self.end.message_replies, Reply::without_data(Outcome::Lost));
            } else {
                let _ = queue::put(&mut self.end.replies, Reply::without_data(Outcome::Lost));
            }
        }
    }
}
