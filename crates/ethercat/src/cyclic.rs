//! The exchange of the critical task: process data in both directions, once a cycle.
//!
//! Each cycle starts with the input telegram: a datagram for each slave (LRD; LRW when inputs and outputs are exchanged
//! together), the AL status of all slaves, the reference clock's time, and requests of the slow side in the free space.
//! When inputs and outputs are exchanged apart, the cycle ends with the output telegram: one LWR for each slave. Each
//! slave's data travel in separate datagrams, so a failed slave does not affect the data of the others. Frames are
//! built once for a plan; each cycle stamps an index, and outputs are written directly into the frame. Process data that
//! one frame does not hold take further ones, see [`Exchange::next_input_telegram`].
//!
//! Invariants: bounded time, no allocation, no waiting. A reply is used at most once, only in its own cycle, and only
//! if index, state, command, address and length of every datagram in it equal what was sent; every other frame is
//! dropped and counted by kind.

mod building;
mod further;
mod slow_side;

use super::acyclic::{Reply, Request};
use super::driver::{Role, SlaveFactory};
use super::encapsulation::{Encapsulation, Opened};
pub use super::observation::{AlStatus, Arrival, BusCounters, FrameCounters, IGNORED_KINDS, Ignored, Observation};
use super::plan::FIRST_FRAME_SLAVES_MAX;
pub use super::plan::{
    CyclicPlan, CyclicSlave, ExchangeKind, PROCESS_BYTES_MAX, PlanError, ReferenceClock, SPAN_BYTES_MAX, VALUES_MAX,
    ValueBit,
};
use super::queue;
use super::slave_set::SlaveSet;
use super::telegram::{Image, SlotState, Telegram};
use super::wire::{FRAME_LEN_MAX, MacAddress, read_u8};
use further::Further;
pub use further::Turn;
use heapless::spsc::{Consumer, Producer};

/// Consecutive cycles without a reply after which the bus counts as silent.
pub const SILENT_CYCLES: u8 = 10;

/// Most acyclic datagrams in a frame while drives are in operation, which keeps the cycle as short as possible.
const IN_OPERATION_MAX: usize = 1;

/// Most frames behind the first one in each direction.
pub const FURTHER_MAX: usize = 15;

/// Largest age of an index that counts as late, frames; an older index counts as foreign.
const LATE_FRAMES: u8 = 64;

/// Bits of [`OutputPlace::start`] that hold the place in the frame; those above hold the number of the frame.
const START_BITS: u32 = 11;
const _: () = assert!(FRAME_LEN_MAX < 1 << START_BITS, "a place in a frame fits its bits");

/// The critical side's ends of the queues to the supervisor. `FURTHER` is the number of frames behind the first one in
/// each direction.
pub struct ExchangeEnd<'a, F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize, const FURTHER: usize = 0> {
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
    /// Its first byte, and from bit [`START_BITS`] on the number of the frame, which is 0 unless there are several.
    start: u16,
    length: u16,
}

/// Place of a slave's inputs among the inputs of a cycle, valid for the present plan.
#[derive(Clone, Copy, Debug, Default)]
pub struct InputPlace {
    image: u8,
    /// Place of the slave if its inputs come in a further frame.
    further: Option<u8>,
    /// The slave's bit if they come in the first frame; else 0.
    bit: u32,
}

impl OutputPlace {
    fn new(frame: usize, start: usize, length: u16) -> Self {
        Self {
            start: (frame << START_BITS | start) as u16,
            length,
        }
    }

    /// Number of the frame among the further ones, from 0; `None` in the first. Place in the frame; length.
    #[inline(always)]
    fn parts<const FURTHER: usize>(self) -> (Option<usize>, usize, usize) {
        let (start, length) = (usize::from(self.start), usize::from(self.length));
        match FURTHER {
            0 => (None, start, length),
            _ => (
                (start >> START_BITS).checked_sub(1),
                start & ((1 << START_BITS) - 1),
                length,
            ),
        }
    }
}

/// The cyclic exchange; it lives in the critical task. `FURTHER` is the number of frames behind the first one that a cycle
/// may take in each direction, see [`Self::next_input_telegram`].
pub struct Exchange<'a, F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize, const FURTHER: usize = 0> {
    end: ExchangeEnd<'a, F, SLAVES, MESSAGE, FURTHER>,
    source: MacAddress,
    encapsulation: Encapsulation,
    plan: CyclicPlan<F, SLAVES>,
    plan_number: u32,
    first: Telegram<SLAVES>,
    second: Telegram<SLAVES>,
    further: Further<SLAVES, FURTHER>,
    outputs: [OutputPlace; SLAVES],
    inputs: [InputPlace; SLAVES],
    images: [Image; SLAVES],
    /// Slaves that answer only the second telegram, one bit each; others are among the further frames' slaves.
    second_only: u32,
    /// Slaves that have answered this cycle's first telegram, one bit each.
    input_valid: u32,
    /// Slaves that have answered this cycle's second telegram, one bit each.
    output_valid: u32,
    /// AL status in this cycle's first telegram, if that has been received.
    al: AlStatus,
    /// Watched members whose outputs come back in a telegram of their own, one bit each.
    output_members: u32,
    /// Those of them that have not confirmed the last output telegram.
    unconfirmed: u32,
    clock_ns: Option<u64>,
    next_index: u8,
    /// Whether the next turn belongs to a message: the last acyclic datagram was a register request.
    message_is_next: bool,
    /// [`SOURCE_BIT`](super::wire::SOURCE_BIT) once a slave controller has marked a reply.
    mark_seen: u8,
    silent_cycles: u8,
    reported: Observation,
    counters: BusCounters,
}

impl<'a, F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize, const FURTHER: usize>
    Exchange<'a, F, SLAVES, MESSAGE, FURTHER>
{
    /// An exchange without a plan that sends from `source`, in Ethernet frames with EtherCAT's own EtherType.
    pub fn new(end: ExchangeEnd<'a, F, SLAVES, MESSAGE, FURTHER>, source: MacAddress) -> Self {
        const {
            assert!(
                SLAVES <= SlaveSet::PLACES,
                "the slaves that answered are reported in a set"
            );
            assert!(
                SLAVES <= FIRST_FRAME_SLAVES_MAX || FURTHER > 0,
                "a frame's slaves are counted in 32 bits"
            );
            assert!(FURTHER <= FURTHER_MAX, "the number of a frame fits a place");
        };
        let mut exchange = Self {
            end,
            source,
            encapsulation: Encapsulation::Raw,
            plan: CyclicPlan::default(),
            plan_number: 0,
            first: Telegram::new(),
            second: Telegram::new(),
            further: Further::new(),
            outputs: [OutputPlace::default(); SLAVES],
            inputs: [InputPlace::default(); SLAVES],
            images: [Image::default(); SLAVES],
            second_only: 0,
            input_valid: 0,
            output_valid: 0,
            al: AlStatus::default(),
            output_members: 0,
            unconfirmed: 0,
            clock_ns: None,
            next_index: 0,
            message_is_next: false,
            mark_seen: 0,
            silent_cycles: 0,
            reported: Observation::IMPOSSIBLE,
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
            self.mark_seen = 0;
            self.adopt(self.plan.clone());
        }
    }

    /// Starts a cycle: settles the last one, takes a new plan, and returns the first input telegram to send.
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

    /// Returns the first output telegram with the present outputs; empty when no slave has outputs that are sent after
    /// control. If only slaves beyond the first frame have outputs, this is a further frame.
    pub fn output_telegram(&mut self) -> &[u8] {
        if self.second.is_empty() {
            return self.next_telegram(Turn::Second);
        }
        self.counters.frames_sent = self.counters.frames_sent.saturating_add(1);
        self.unconfirmed = self.output_members;
        let index = self.take_index();
        self.second.send(index)
    }

    /// Takes a received frame (without check sequence): uses it if it belongs to this cycle, otherwise drops it.
    pub fn receive(&mut self, frame: &[u8]) -> Arrival {
        match self.accept(frame) {
            Ok(arrival) => arrival,
            Err(kind) => {
                if kind == Ignored::Late {
                    self.count_late(frame);
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
        self.image_at(self.input_place(slave))?.get(..length)
    }

    /// Place of the inputs of a slave (position in the chain), valid until the next plan.
    pub fn input_place(&self, slave: usize) -> InputPlace {
        self.inputs.get(slave).copied().unwrap_or_default()
    }

    /// This cycle's inputs at a place in a buffer of the longest length; bytes behind the slave's inputs have no
    /// meaning. `None` as for [`Self::input`].
    #[inline]
    pub fn image_at(&self, place: InputPlace) -> Option<&[u8; PROCESS_BYTES_MAX]> {
        // The remainder tells the compiler that the place exists.
        let image = self.images.get(usize::from(place.image) % SLAVES)?;
        let is_further = || place.further.is_some_and(|slave| self.further.has_inputs(slave));
        (self.input_valid & place.bit != 0 || FURTHER > 0 && is_further()).then(|| image.bytes())
    }

    /// The outputs of a slave (position in the chain) that the next telegram will carry; empty if the slave has none.
    #[inline]
    pub fn output(&mut self, slave: usize) -> &mut [u8] {
        self.output_at(self.output_place(slave))
    }

    /// The outputs of a slave (position in the chain) that the next telegram will carry, to be read.
    #[inline]
    pub fn sent(&self, slave: usize) -> &[u8] {
        let (further, start, length) = self.output_place(slave).parts::<FURTHER>();
        let telegram = match (further, self.plan.exchange) {
            (Some(number), kind) => return self.further.bytes(number, kind, start, length).unwrap_or(&[]),
            (None, ExchangeKind::Split) => &self.second,
            (None, ExchangeKind::Combined) => &self.first,
        };
        telegram.bytes(start, length).unwrap_or(&[])
    }

    /// Place of the outputs of a slave (position in the chain), valid until the next plan.
    pub fn output_place(&self, slave: usize) -> OutputPlace {
        self.outputs.get(slave).copied().unwrap_or_default()
    }

    /// The outputs at a place, as in [`Self::output`].
    #[inline]
    pub fn output_at(&mut self, place: OutputPlace) -> &mut [u8] {
        let (further, start, length) = place.parts::<FURTHER>();
        let telegram = match (further, self.plan.exchange) {
            (Some(number), kind) => {
                return self.further.bytes_mut(number, kind, start, length).unwrap_or(&mut []);
            }
            (None, ExchangeKind::Split) => &mut self.second,
            (None, ExchangeKind::Combined) => &mut self.first,
        };
        telegram.bytes_mut(start, length).unwrap_or(&mut [])
    }

    /// Members and terminals in operation that have not confirmed the last output telegram that carries their outputs: its reply has
    /// not come, or not with the expected working counter. None when outputs travel with the inputs.
    #[inline]
    pub fn unconfirmed(&self) -> SlaveSet {
        SlaveSet::from(self.unconfirmed) | self.further.unconfirmed()
    }

    /// Whether a slave (position in the chain) has answered in this cycle with the expected working counter: its datagram
    /// of the cycle's start, or that after control if it has no other.
    #[inline]
    pub fn has_answered(&self, slave: usize) -> bool {
        self.seen().answered.contains(slave)
    }

    /// This cycle's AL status of the slaves in use, and the number of all slaves that answered.
    pub fn al_status(&self) -> Option<AlStatus> {
        (self.first.state == SlotState::Received).then_some(AlStatus {
            status: self.al.status & !self.plan.al_bits_ignored,
            slaves: self.al.slaves,
        })
    }

    /// This cycle's time of the reference clock, ns, if that has written it; only the low 32 bits if
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
    #[inline(always)]
    fn settle(&mut self) {
        let is_whole = self.first.state == SlotState::Received && self.second.state != SlotState::Sent;
        if !is_whole || !self.further.is_whole() || self.seen().differs(&self.reported, FURTHER > 0) {
            self.settle_changed();
        } else {
            self.silent_cycles = 0;
        }
        // The first telegram is sent next.
        self.second.state = SlotState::Idle;
        (self.input_valid, self.output_valid) = (0, 0);
        self.further.settle();
        self.clock_ns = None;
    }

    /// What this cycle's telegrams have shown, if the first one was received.
    #[inline(always)]
    fn seen(&self) -> Observation {
        Observation {
            al: self.al,
            answered: SlaveSet::from(self.input_valid | self.output_valid & self.second_only) | self.further.answered(),
            silent: false,
        }
    }

    /// Ends a cycle with lost replies, or one that differs from the last one.
    #[cold]
    #[inline(never)]
    fn settle_changed(&mut self) {
        let mut lost = self.further.count_lost();
        let is_received = self.first.state == SlotState::Received;
        if self.first.state == SlotState::Sent {
            lost += 1;
            self.first.counters.count_lost();
            self.silent_cycles = self.silent_cycles.saturating_add(1).min(SILENT_CYCLES);
            self.first.continue_clock();
            self.answer_lost();
        } else if is_received {
            self.silent_cycles = 0;
        }
        if self.second.state == SlotState::Sent {
            lost += 1;
            self.second.counters.count_lost();
        }
        self.counters.frames_lost = self.counters.frames_lost.saturating_add(lost);
        let silent = self.silent_cycles >= SILENT_CYCLES;
        let seen = match (is_received, silent) {
            (true, _) => self.seen(),
            (false, true) => Observation::SILENT,
            (false, false) => return,
        };
        if self.reported != seen && queue::put(&mut self.end.observations, seen).is_ok() {
            self.reported = seen;
        }
    }

    #[inline]
    fn accept(&mut self, frame: &[u8]) -> Result<Arrival, Ignored> {
        let opened = self.encapsulation.open(frame, &self.source)?;
        let index = read_u8(opened.payload, 1);
        if self.first.awaits(index) {
            self.take_inputs(opened)
        } else if self.second.awaits(index) {
            self.take_outputs(opened)
        } else {
            match self.further.awaits(index) {
                Some(frame) => self.take_further(&opened, frame),
                None => Err(self.unexpected(index)),
            }
        }
    }

    /// Counts a reply to a frame of an earlier cycle.
    #[cold]
    fn count_late(&mut self, frame: &[u8]) {
        self.counters.frames_late = self.counters.frames_late.saturating_add(1);
        let Ok(Opened { payload, .. }) = self.encapsulation.open(frame, &self.source) else {
            return;
        };
        if self.first.is_origin(payload) {
            self.first.counters.count_late();
        } else if self.second.is_origin(payload) {
            self.second.counters.count_late();
        } else {
            self.further.count_late(payload);
        }
    }

    /// Kind of a frame whose index is not awaited.
    #[cold]
    fn unexpected(&self, index: u8) -> Ignored {
        let has_arrived = |state, of: u8| state == SlotState::Received && of == index;
        let has_come = has_arrived(self.first.state, self.first.index)
            || has_arrived(self.second.state, self.second.index)
            || self.further.has_arrived(index);
        if has_come {
            return Ignored::Duplicate;
        }
        let age = self.next_index.wrapping_sub(index);
        let sent_before = u32::from(age) <= self.counters.frames_sent;
        if (1..=LATE_FRAMES).contains(&age) && sent_before {
            Ignored::Late
        } else {
            Ignored::ForeignIndex
        }
    }

    #[inline(always)]
    fn take_inputs(&mut self, opened: Opened<'_>) -> Result<Arrival, Ignored> {
        let taken = self.first.take_inputs(opened.payload, &mut self.images)?;
        if !taken.answers.touched && opened.mark == 0 {
            return Err(Ignored::Reflection);
        }
        self.first.state = SlotState::Received;
        self.count(taken.answers.errors, opened.mark);
        self.input_valid = taken.answers.answered;
        self.al = taken.al;
        self.clock_ns = taken.clock_ns;
        match taken.clock_ns {
            Some(time_ns) => self.first.set_clock(time_ns),
            None => self.first.continue_clock(),
        }
        if !self.first.acyclic.is_empty() {
            self.answer_acyclic(opened.payload);
        }
        Ok(Arrival::Input)
    }

    #[inline(always)]
    fn take_outputs(&mut self, opened: Opened<'_>) -> Result<Arrival, Ignored> {
        let answers = self.second.take_outputs(opened.payload)?;
        if !answers.touched && opened.mark == 0 && self.mark_seen != 0 {
            return Err(Ignored::Reflection);
        }
        self.second.state = SlotState::Received;
        self.count(answers.errors, opened.mark);
        self.output_valid = answers.answered;
        self.unconfirmed &= !answers.answered;
        Ok(Arrival::Output)
    }

    #[inline(always)]
    fn count(&mut self, errors: u32, mark: u8) {
        self.mark_seen |= mark;
        if errors != 0 {
            let counted = &mut self.counters.working_counter_errors;
            *counted = counted.saturating_add(errors);
        }
    }
}
