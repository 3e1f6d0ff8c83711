//! A prebuilt frame, and the proof that a reply is the answer to its last sending.
//!
//! A template is built once for a plan; sending copies it and stamps an index into every datagram. A reply counts only
//! if each of its datagrams stands where it stood and still has its command, index, address and length.
//!
//! Invariant: nothing in a reply decides where it is read; the places are those of the frame that was sent.

use super::acyclic::IN_FLIGHT_MAX;
use super::cyclic::{PROCESS_BYTES_MAX, SLAVES_MAX};
use super::wire::{
    Address, Command, DATAGRAM_HEADER_LEN, DATAGRAM_OVERHEAD, FrameBuilder, MacAddress, PAYLOAD_OFFSET, read_u8,
    read_u16, read_u32,
};
use heapless::Vec;

/// Longest prebuilt frame.
pub(super) const TEMPLATE_LEN: usize =
    PAYLOAD_OFFSET + SLAVES_MAX * (DATAGRAM_OVERHEAD + PROCESS_BYTES_MAX) + DATAGRAM_OVERHEAD + 2;
/// Most datagrams in a frame: the slaves', the AL status, the slow side's.
pub(super) const DATAGRAMS_MAX: usize = SLAVES_MAX + 1 + IN_FLIGHT_MAX;
/// Why a received frame was dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Ignored {
    /// Another protocol than EtherCAT, VLAN tags included.
    EtherType,
    /// EtherCAT, but no datagrams.
    FrameType,
    /// Shorter than its own lengths say.
    Truncated,
    /// Another sender's frame.
    ForeignSource,
    /// An index that was not in use.
    ForeignIndex,
    /// The answer to a frame of an earlier cycle.
    Late,
    /// An answer that had come already.
    Duplicate,
    /// Command, address, length or chain differ from what was sent.
    Mismatch,
    /// It went round the segment twice.
    Circulating,
    /// An own frame that no slave has touched.
    Reflection,
}

/// Number of kinds of [`Ignored`].
pub const IGNORED_KINDS: usize = Ignored::Reflection as usize + 1;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Owner {
    Slave(u8),
    AlStatus,
    Acyclic,
}

/// Where a datagram stands in the payload and what it must still be when it returns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) offset: u16,
    pub(super) length: u16,
    pub(super) command: Command,
    pub(super) address: Address,
    pub(super) owner: Owner,
}

impl Place {
    pub(super) fn working_counter(&self, payload: &[u8]) -> u16 {
        read_u16(
            payload,
            usize::from(self.offset) + DATAGRAM_HEADER_LEN + usize::from(self.length),
        )
    }

    pub(super) fn data<'p>(&self, payload: &'p [u8]) -> &'p [u8] {
        let start = usize::from(self.offset) + DATAGRAM_HEADER_LEN;
        payload.get(start..start + usize::from(self.length)).unwrap_or(&[])
    }

    /// Checks the returned header against what was sent.
    pub(super) fn check(&self, payload: &[u8], index: u8, more: bool) -> Result<(), Ignored> {
        let offset = usize::from(self.offset);
        let flags = read_u16(payload, offset + 6);
        if flags & 1 << 14 != 0 {
            return Err(Ignored::Circulating);
        }
        let address = Address(read_u32(payload, offset + 2));
        let same_address = if self.command.counts_position() {
            address.register() == self.address.register()
        } else {
            address == self.address
        };
        let same = read_u8(payload, offset) == self.command as u8
            && read_u8(payload, offset + 1) == index
            && same_address
            && flags == self.length | u16::from(more) << 15;
        if same { Ok(()) } else { Err(Ignored::Mismatch) }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SlotState {
    Idle,
    Sent,
    Received,
}

/// A prebuilt frame and the state of its last sending.
#[derive(Debug)]
pub(super) struct Telegram {
    pub(super) template: [u8; TEMPLATE_LEN],
    pub(super) template_len: usize,
    pub(super) last: usize,
    pub(super) places: Vec<Place, DATAGRAMS_MAX>,
    pub(super) prebuilt: usize,
    pub(super) index: u8,
    pub(super) state: SlotState,
    pub(super) payload_len: usize,
}

impl Telegram {
    pub(super) const fn new() -> Self {
        Self {
            template: [0; TEMPLATE_LEN],
            template_len: 0,
            last: 0,
            places: Vec::new(),
            prebuilt: 0,
            index: 0,
            state: SlotState::Idle,
            payload_len: 0,
        }
    }

    /// Builds the template from datagrams: owner, command, address and length.
    pub(super) fn build(
        &mut self,
        source: MacAddress,
        datagrams: impl Iterator<Item = (Owner, Command, Address, u16)>,
    ) {
        self.state = SlotState::Idle;
        self.places.clear();
        self.template_len = 0;
        if let Ok(mut builder) = FrameBuilder::new(&mut self.template, source) {
            for (owner, command, address, length) in datagrams {
                let offset = (builder.position() - PAYLOAD_OFFSET) as u16;
                let place = Place {
                    offset,
                    length,
                    command,
                    address,
                    owner,
                };
                // Template and list are sized for the largest plan.
                if builder.push(command, 0, address, usize::from(length)).is_ok() {
                    let _ = self.places.push(place);
                }
            }
            if let Some(last) = builder.last() {
                self.last = last;
                self.template_len = builder.position();
            }
        }
        self.prebuilt = self.places.len();
    }

    /// Copies the template to `frame` and stamps `index`; false when there is nothing to send or no room.
    pub(super) fn stamp(&mut self, frame: &mut [u8], index: u8) -> bool {
        self.places.truncate(self.prebuilt);
        let Some(template) = self.template.get(..self.template_len) else {
            return false;
        };
        let Some(target) = frame.get_mut(..self.template_len) else {
            return false;
        };
        if template.is_empty() {
            return false;
        }
        target.copy_from_slice(template);
        for place in &self.places {
            if let Some(byte) = target.get_mut(PAYLOAD_OFFSET + usize::from(place.offset) + 1) {
                *byte = index;
            }
        }
        self.index = index;
        true
    }

    /// Checks every datagram of a reply, and whether any slave touched it.
    pub(super) fn check(&self, payload: &[u8]) -> Result<bool, Ignored> {
        if payload.len() != self.payload_len {
            return Err(Ignored::Mismatch);
        }
        let mut touched = false;
        for (number, place) in self.places.iter().enumerate() {
            place.check(payload, self.index, number + 1 < self.places.len())?;
            touched |= place.working_counter(payload) != 0;
        }
        Ok(touched)
    }
}
