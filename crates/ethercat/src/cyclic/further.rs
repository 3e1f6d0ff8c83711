//! The frames of a cycle behind the first one in each direction, for process data that need more than one.
//!
//! They carry slaves' datagrams only; the AL status, the clock and the requests of the slow side travel in the first frame.
//! With none of them, as on a robot, nothing here costs an instruction of the cycle.
//!
//! Invariant: each frame is lost, late or wrong for itself: what its slaves have answered comes from its own reply in its
//! own cycle.

use super::{Arrival, Exchange, ExchangeKind, Ignored, Image, Opened, SlotState, Telegram};
use crate::driver::SlaveFactory;
use crate::encapsulation::Encapsulation;
use crate::observation::FrameCounters;
use crate::plan::Window;
use crate::slave_set::SlaveSet;
use crate::wire::MacAddress;

/// A frame with inputs, or with both directions, and one with outputs after control.
#[derive(Debug)]
struct Pair<const SLAVES: usize> {
    first: Telegram<SLAVES, SlaveSet>,
    second: Telegram<SLAVES, SlaveSet>,
    /// Number of the image of the first datagram.
    image: u8,
    /// Watched members whose outputs the second frame carries.
    members: SlaveSet,
    /// Slaves that answer nothing but the second frame.
    second_only: SlaveSet,
    /// Slaves whose inputs have come in this cycle.
    input_valid: SlaveSet,
    /// Slaves that have answered the second frame in this cycle.
    output_valid: SlaveSet,
    /// Members that have not confirmed the last outputs.
    unconfirmed: SlaveSet,
}

/// The further frames, and what their slaves have answered in this cycle: without any, nothing at all.
#[derive(Debug)]
pub(super) struct Further<const SLAVES: usize, const FURTHER: usize> {
    pairs: [Pair<SLAVES>; FURTHER],
}

/// Which of the two times of a cycle at which frames are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// At the start of the cycle.
    First,
    /// After control.
    Second,
}

impl<const SLAVES: usize> Pair<SLAVES> {
    fn of(&self, turn: Turn) -> &Telegram<SLAVES, SlaveSet> {
        match turn {
            Turn::First => &self.first,
            Turn::Second => &self.second,
        }
    }

    fn of_mut(&mut self, turn: Turn) -> &mut Telegram<SLAVES, SlaveSet> {
        match turn {
            Turn::First => &mut self.first,
            Turn::Second => &mut self.second,
        }
    }
}

/// The frame in which the outputs of a kind of exchange travel.
fn outputs_turn(kind: ExchangeKind) -> Turn {
    match kind {
        ExchangeKind::Split => Turn::Second,
        ExchangeKind::Combined => Turn::First,
    }
}

impl<const SLAVES: usize, const FURTHER: usize> Further<SLAVES, FURTHER> {
    pub(super) fn new() -> Self {
        Self {
            pairs: core::array::from_fn(|_| Pair {
                first: Telegram::new(),
                second: Telegram::new(),
                image: 0,
                members: SlaveSet::NONE,
                second_only: SlaveSet::NONE,
                input_valid: SlaveSet::NONE,
                output_valid: SlaveSet::NONE,
                unconfirmed: SlaveSet::NONE,
            }),
        }
    }

    /// The slaves that belong to a set of any pair.
    #[inline(always)]
    fn union(&self, set: impl Fn(&Pair<SLAVES>) -> SlaveSet) -> SlaveSet {
        let pairs = self.pairs.iter();
        pairs.fold(SlaveSet::NONE, |all, pair| all | set(pair))
    }

    fn telegrams(&self) -> impl Iterator<Item = &Telegram<SLAVES, SlaveSet>> {
        self.pairs.iter().flat_map(|pair| [&pair.first, &pair.second])
    }

    fn telegrams_mut(&mut self) -> impl Iterator<Item = &mut Telegram<SLAVES, SlaveSet>> {
        self.pairs
            .iter_mut()
            .flat_map(|pair| [&mut pair.first, &mut pair.second])
    }

    /// Removes all datagrams.
    pub(super) fn clear(&mut self, encapsulation: &Encapsulation, source: MacAddress) {
        for pair in &mut self.pairs {
            (pair.members, pair.second_only) = (SlaveSet::NONE, SlaveSet::NONE);
        }
        self.telegrams_mut()
            .for_each(|telegram| telegram.clear(encapsulation, source));
    }

    /// Adds a slave's datagram to a further frame, counted from 0. `image` is the number of its inputs among all. Returns
    /// the place of its data in the frame; `None` if there is no room.
    pub(super) fn push(
        &mut self,
        (number, turn): (usize, Turn),
        (slave, watched): (u8, bool),
        window: &Window,
        image: u8,
    ) -> Option<usize> {
        let pair = self.pairs.get_mut(number)?;
        let (share, data) = pair.of_mut(turn).push_share(slave, watched, window, 0)?;
        if turn == Turn::First && share == 0 {
            pair.image = image;
        }
        Some(data)
    }

    /// Notes of a slave in a second frame, counted from 0, whether it is a watched member, and whether this is its only
    /// datagram.
    pub(super) fn note(&mut self, number: usize, slave: u8, (is_member, is_only): (bool, bool)) {
        let Some(pair) = self.pairs.get_mut(number) else {
            return;
        };
        let set = |is_in: bool| {
            if is_in {
                SlaveSet::of(slave.into())
            } else {
                SlaveSet::NONE
            }
        };
        pair.members |= set(is_member);
        pair.second_only |= set(is_only);
    }

    /// Ends building.
    pub(super) fn finish(&mut self, encapsulation: &Encapsulation) {
        self.telegrams_mut().for_each(|telegram| telegram.finish(encapsulation));
    }

    /// Takes over which members have not confirmed their outputs.
    pub(super) fn set_unconfirmed(&mut self, unconfirmed: SlaveSet) {
        for pair in &mut self.pairs {
            pair.unconfirmed = unconfirmed.and(pair.members);
        }
    }

    /// Watched members that have not confirmed the last outputs.
    #[inline(always)]
    pub(super) fn unconfirmed(&self) -> SlaveSet {
        self.union(|pair| pair.unconfirmed)
    }

    /// Whether a slave's inputs have come in this cycle.
    #[inline(always)]
    pub(super) fn has_inputs(&self, slave: u8) -> bool {
        self.pairs.iter().any(|pair| pair.input_valid.contains(slave.into()))
    }

    /// Whether a frame serves a slave that is in operation.
    pub(super) fn is_watched(&self) -> bool {
        self.telegrams().any(Telegram::is_watched)
    }

    /// Whether each frame that was sent in this cycle has come back.
    #[inline(always)]
    pub(super) fn is_whole(&self) -> bool {
        FURTHER == 0 || self.telegrams().all(|telegram| telegram.state != SlotState::Sent)
    }

    /// The slaves that have answered in this cycle.
    #[inline(always)]
    pub(super) fn answered(&self) -> SlaveSet {
        self.union(|pair| pair.input_valid | pair.output_valid.and(pair.second_only))
    }

    /// Counts the frames that have not come back; returns their number.
    pub(super) fn count_lost(&mut self) -> u32 {
        let missing = self
            .telegrams_mut()
            .filter(|telegram| telegram.state == SlotState::Sent);
        missing.map(|telegram| telegram.counters.count_lost()).count() as u32
    }

    /// Ends a cycle.
    #[inline(always)]
    pub(super) fn settle(&mut self) {
        for pair in &mut self.pairs {
            (pair.first.state, pair.second.state) = (SlotState::Idle, SlotState::Idle);
            (pair.input_valid, pair.output_valid) = (SlaveSet::NONE, SlaveSet::NONE);
        }
    }

    /// The frame whose reply has this index.
    #[inline(always)]
    pub(super) fn awaits(&self, index: u8) -> Option<(usize, Turn)> {
        for (number, pair) in self.pairs.iter().enumerate() {
            if pair.first.awaits(index) {
                return Some((number, Turn::First));
            }
            if pair.second.awaits(index) {
                return Some((number, Turn::Second));
            }
        }
        None
    }

    /// Whether the reply of this index has come.
    pub(super) fn has_arrived(&self, index: u8) -> bool {
        self.telegrams()
            .any(|telegram| telegram.state == SlotState::Received && telegram.index == index)
    }

    /// Counts a reply of an earlier cycle for the frame that it answers; returns whether there is one.
    pub(super) fn count_late(&mut self, payload: &[u8]) -> bool {
        let mut telegrams = self.telegrams_mut();
        let origin = telegrams.find(|telegram| telegram.is_origin(payload));
        origin.map(|telegram| telegram.counters.count_late()).is_some()
    }

    /// Outputs in a further frame, counted from 0.
    #[inline]
    pub(super) fn bytes(&self, number: usize, kind: ExchangeKind, start: usize, length: usize) -> Option<&[u8]> {
        self.pairs.get(number)?.of(outputs_turn(kind)).bytes(start, length)
    }

    /// Outputs in a further frame, counted from 0, to be written.
    #[inline]
    pub(super) fn bytes_mut(
        &mut self,
        number: usize,
        kind: ExchangeKind,
        start: usize,
        length: usize,
    ) -> Option<&mut [u8]> {
        let pair = self.pairs.get_mut(number)?;
        pair.of_mut(outputs_turn(kind)).bytes_mut(start, length)
    }
}

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize, const FURTHER: usize>
    Exchange<'_, F, SLAVES, MESSAGE, FURTHER>
{
    /// The next telegram of the cycle's start behind [`Self::input_telegram`]; empty when there is no other. Send all of
    /// them before waiting for replies, which may come in any order.
    pub fn next_input_telegram(&mut self) -> &[u8] {
        self.next_telegram(Turn::First)
    }

    /// The next telegram behind [`Self::output_telegram`], as [`Self::next_input_telegram`].
    pub fn next_output_telegram(&mut self) -> &[u8] {
        self.next_telegram(Turn::Second)
    }

    /// Whether the reply to a telegram of this cycle is missing, among those sent at its start or after control.
    pub fn awaits_replies(&self, turn: Turn) -> bool {
        let own = match turn {
            Turn::First => self.first.state,
            Turn::Second => self.second.state,
        };
        let mut pairs = self.further.pairs.iter();
        own == SlotState::Sent || pairs.any(|pair| pair.of(turn).state == SlotState::Sent)
    }

    /// Lost and late replies to a cycle's telegrams, by the number of the frame in its direction: those of the cycle's
    /// start, and those after control. 0 is the first frame, which carries no slave beyond the 32nd. `None` beyond the last.
    pub fn frame_counters(&self, number: usize) -> Option<[FrameCounters; 2]> {
        match number.checked_sub(1) {
            None => Some([self.first.counters, self.second.counters]),
            Some(further) => self
                .further
                .pairs
                .get(further)
                .map(|pair| [pair.first.counters, pair.second.counters]),
        }
    }

    #[inline(always)]
    pub(super) fn next_telegram(&mut self, turn: Turn) -> &[u8] {
        let mut pairs = self.further.pairs.iter_mut();
        let is_next = |pair: &&mut Pair<SLAVES>| pair.of(turn).state == SlotState::Idle;
        let Some(pair) = pairs.find(is_next).filter(|pair| !pair.of(turn).is_empty()) else {
            return &[];
        };
        self.counters.frames_sent = self.counters.frames_sent.saturating_add(1);
        if turn == Turn::Second {
            pair.unconfirmed = pair.members;
        }
        let index = self.next_index;
        self.next_index = index.wrapping_add(1);
        pair.of_mut(turn).send(index)
    }

    /// Takes the reply to a further frame.
    pub(super) fn take_further(
        &mut self,
        opened: &Opened<'_>,
        (number, turn): (usize, Turn),
    ) -> Result<Arrival, Ignored> {
        let Some(pair) = self.further.pairs.get_mut(number) else {
            return Err(Ignored::ForeignIndex);
        };
        let answers = match turn {
            Turn::First => {
                let images: &mut [Image] = self.images.get_mut(usize::from(pair.image)..).unwrap_or(&mut []);
                pair.first.take_inputs_only(opened.payload, images)?
            }
            Turn::Second => pair.second.take_outputs(opened.payload)?,
        };
        if !answers.touched && opened.mark == 0 && self.mark_seen != 0 {
            return Err(Ignored::Reflection);
        }
        pair.of_mut(turn).state = SlotState::Received;
        match turn {
            Turn::First => pair.input_valid = answers.answered,
            Turn::Second => {
                pair.output_valid = answers.answered;
                pair.unconfirmed = pair.unconfirmed.without(answers.answered);
            }
        }
        self.count(answers.errors, opened.mark);
        Ok(match turn {
            Turn::First => Arrival::Input,
            Turn::Second => Arrival::Output,
        })
    }
}
