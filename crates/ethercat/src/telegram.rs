//! A prebuilt frame, and the check that a reply answers its last transmission.
//!
//! A frame is built for a plan. Each transmission stamps an index into the first datagram and, if the slow side has
//! requests, appends datagrams for one cycle. Outputs are written directly into the frame. A reply counts only if each
//! of its datagrams still has the header that was sent.
//!
//! Invariant: a reply is read at the places given by the frame that was sent; no content of the reply influences these.

mod reply;

use super::acyclic::IN_FLIGHT_MAX;
use super::encapsulation::Encapsulation;
use super::observation::{AlStatus, FrameCounters};
use super::plan::{AL_STATUS_LEN, PROCESS_BYTES_MAX, ReferenceClock, SPAN_BYTES_MAX, Window};
use super::slave_set::Places;
use super::wire::{
    Address, Command, DATAGRAM_HEADER_LEN, DATAGRAM_OVERHEAD, DatagramRepr, FRAME_LEN_MAX, FRAME_LEN_MIN, MacAddress,
    read_u16, read_u32, read_u64, register, write_bytes,
};
use heapless::Vec;

/// Most acyclic datagrams in a frame: requests for registers and one message.
const ACYCLIC_MAX: usize = IN_FLIGHT_MAX + 1;
/// Bit of the length field that announces another datagram.
const MORE_BIT: u16 = 1 << 15;
/// Bit of the length field that a slave sets in a frame that passes a second time.
const CIRCULATING_BIT: u16 = 1 << 14;

/// Last byte of a [`Header`]; its highest bit is the More bit.
const MORE_BYTE: usize = 7;
const MORE_IN_BYTE: u8 = 1 << 7;
/// Byte of a [`Header`] with the index.
const INDEX_BYTE: usize = 1;
/// Device half of the address in the first eight bytes of a header: slaves increment it in broadcasts.
const POSITION_HEADER: u64 = 0xFFFF_0000;
/// The half of the first word of a header that is not the device half of the address.
const NO_POSITION: u32 = 0xFFFF;

/// Inputs of one slave. The first piece is copied whole; more only if there are more inputs.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(4))]
pub(super) struct Image([[u8; PIECE_LEN]; PIECES]);

impl Image {
    /// The inputs; bytes behind the slave's own have no meaning.
    #[inline(always)]
    pub(super) fn bytes(&self) -> &[u8; PROCESS_BYTES_MAX] {
        // The pieces are as long as the whole.
        self.0.as_flattened().first_chunk().unwrap_or(&[0; PROCESS_BYTES_MAX])
    }
}

/// Bytes of an [`Image`] that are copied for each slave.
const PIECE_LEN: usize = 16;
const PIECES: usize = PROCESS_BYTES_MAX / PIECE_LEN;

const _: () = {
    assert!(PIECES * PIECE_LEN == PROCESS_BYTES_MAX, "an image is whole pieces");
    assert!(
        DATAGRAM_HEADER_LEN + SPAN_BYTES_MAX <= u8::MAX as usize,
        "places in a slave's datagram fit a byte"
    );
};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SlotState {
    Idle,
    Sent,
    Received,
}

/// The first eight bytes of a datagram's header, which come back unchanged.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(4))]
struct Header([u8; 8]);

impl Header {
    /// Bits in which the beginning of a received datagram differs, as two words that are not both 0.
    #[inline(always)]
    fn differences(&self, received: &[u8; 8]) -> (u32, u32) {
        let words = |bytes: &[u8; 8]| {
            let word = u64::from_le_bytes(*bytes);
            (word as u32, (word >> 32) as u32)
        };
        let (ours, theirs) = (words(&self.0), words(received));
        (ours.0 ^ theirs.0, ours.1 ^ theirs.1)
    }

    fn set_more(&mut self, more: bool) {
        self.0[MORE_BYTE] = self.0[MORE_BYTE] & !MORE_IN_BYTE | if more { MORE_IN_BYTE } else { 0 };
    }
}

/// One slave's datagram.
#[derive(Clone, Copy, Debug)]
#[repr(align(4))]
struct Share {
    /// What comes back before its data.
    header: Header,
    working_counter: u16,
    /// Bytes of its data.
    length: u8,
    /// Where the slave's inputs begin, from the datagram's beginning.
    inputs: u8,
    /// Bytes of the slave's inputs.
    input_length: u8,
    slave: u8,
}

impl Share {
    /// The slave's place in [`Answers::answered`].
    #[inline(always)]
    fn place<M: Places>(&self) -> M {
        M::of(self.slave.into())
    }

    /// Whether the first [`PIECE_LEN`] bytes of the data hold all inputs.
    fn is_in_first_piece(&self) -> bool {
        let is_first = usize::from(self.inputs) == DATAGRAM_HEADER_LEN;
        self.input_length == 0 || is_first && usize::from(self.input_length) <= PIECE_LEN
    }

    /// Bytes of the datagram.
    #[inline(always)]
    fn len(&self) -> usize {
        DATAGRAM_OVERHEAD + usize::from(self.length)
    }
}

/// How the slaves' inputs are copied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Copying {
    /// The first [`PIECE_LEN`] bytes of each slave's data, which hold its inputs.
    FirstPieces,
    /// The first [`PIECE_LEN`] bytes of each slave's data, then those inputs that lie elsewhere or are longer.
    FirstPiecesAndOthers,
    /// As many bytes as each slave has: a datagram ends too close to the frame's end for a whole piece.
    Exact,
}

/// The datagrams of a frame that concern all slaves.
#[derive(Clone, Copy, Debug)]
struct Common {
    status_header: Header,
    /// Place of the datagram that reads the AL status in the payload; [`NOWHERE`] without it.
    status: u16,
    clock_header: Header,
    /// Place of the datagram that carries a clock of 64 bits in the payload; [`NOWHERE`] without it.
    wide_clock: u16,
    /// Place of the datagram that carries a clock of 32 bits in the payload; [`NOWHERE`] without it.
    narrow_clock: u16,
    /// Place of the clock's time in the frame, if it has 64 bits; else [`NOWHERE`].
    wide_time: u16,
    /// Expected working counter of the clock's datagram.
    clock_slaves: u16,
    /// Period of the exchange, see [`ReferenceClock::period`]; 0 without a clock.
    period: u16,
}

impl Common {
    const NONE: Self = Self {
        status_header: Header([0; 8]),
        status: NOWHERE,
        clock_header: Header([0; 8]),
        wide_clock: NOWHERE,
        narrow_clock: NOWHERE,
        wide_time: NOWHERE,
        clock_slaves: 0,
        period: 0,
    };
}

/// A place beyond every frame.
const NOWHERE: u16 = u16::MAX;

/// One acyclic datagram of the present transmission.
#[derive(Clone, Copy, Debug)]
pub(super) struct Acyclic {
    pub(super) length: u16,
    pub(super) is_message: bool,
}

/// Places of the last datagram of a chain and of its end.
#[derive(Clone, Copy, Debug)]
struct Chain {
    last: usize,
    end: usize,
}

/// Content of a reply.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Taken<M> {
    /// The slaves that answered.
    pub(super) answers: Answers<M>,
    /// The slaves' AL status.
    pub(super) al: AlStatus,
    /// Time of the reference clock, ns, if the frame distributes it and the reference wrote it.
    pub(super) clock_ns: Option<u64>,
}

/// Which slaves have answered.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Answers<M> {
    /// The slaves whose datagram has the expected working counter.
    pub(super) answered: M,
    /// Number of datagrams of watched slaves with an unexpected working counter.
    pub(super) errors: u32,
    /// Whether any working counter is not 0.
    pub(super) touched: bool,
}

/// A frame's bytes, aligned so that they can be copied in words.
#[derive(Debug)]
#[repr(align(4))]
struct Frame([u8; FRAME_LEN_MAX]);

/// A prebuilt frame and the state of its last transmission. `M` are sets of the slaves that it may carry.
#[derive(Debug)]
pub(super) struct Telegram<const SLAVES: usize, M = u32> {
    frame: Frame,
    /// Place of the first datagram in the frame.
    start: u8,
    /// Bytes of the frame as it is sent.
    length: u16,
    /// Bytes of all datagrams, as they are sent.
    payload_length: u16,
    shares: Vec<Share, SLAVES>,
    common: Common,
    /// Slaves with a share.
    all: M,
    /// Slaves whose wrong working counter is an error.
    watched: M,
    copying: Copying,
    cyclic: Chain,
    chain: Chain,
    pub(super) acyclic: Vec<Acyclic, ACYCLIC_MAX>,
    /// Index of the last transmission.
    pub(super) index: u8,
    pub(super) state: SlotState,
    pub(super) counters: FrameCounters,
}

impl<const SLAVES: usize, M: Places> Telegram<SLAVES, M> {
    pub(super) const fn new() -> Self {
        Self {
            frame: Frame([0; FRAME_LEN_MAX]),
            start: 0,
            length: 0,
            payload_length: 0,
            shares: Vec::new(),
            common: Common::NONE,
            all: M::NONE,
            watched: M::NONE,
            copying: Copying::FirstPieces,
            cyclic: Chain { last: 0, end: 0 },
            chain: Chain { last: 0, end: 0 },
            acyclic: Vec::new(),
            index: 0,
            state: SlotState::Idle,
            counters: FrameCounters { lost: 0, late: 0 },
        }
    }

    /// Place of the first datagram in the frame.
    #[inline(always)]
    fn start(&self) -> usize {
        self.start.into()
    }

    /// Resets the frame: no datagrams behind the encapsulation's headers.
    pub(super) fn clear(&mut self, encapsulation: &Encapsulation, source: MacAddress) {
        self.frame.0 = [0; FRAME_LEN_MAX];
        encapsulation.emit(&mut self.frame.0, source);
        self.start = encapsulation.header_len() as u8;
        self.shares.clear();
        self.common = Common::NONE;
        (self.all, self.watched) = (M::NONE, M::NONE);
        self.copying = Copying::FirstPieces;
        self.cyclic = Chain {
            last: self.start(),
            end: self.start(),
        };
        self.chain = self.cyclic;
        (self.length, self.payload_length) = (0, 0);
        self.acyclic.clear();
        self.state = SlotState::Idle;
    }

    /// Adds a slave's datagram to a frame that is being built, and leaves room for further bytes. Returns its number among
    /// the slaves' datagrams of this frame, and the place of its data in the frame; `None` if there is no room.
    pub(super) fn push_share(
        &mut self,
        slave: u8,
        watched: bool,
        window: &Window,
        room: usize,
    ) -> Option<(usize, usize)> {
        let number = self.shares.len();
        let end = self.chain.end + DATAGRAM_OVERHEAD + usize::from(window.length) + room;
        if self.shares.is_full() || usize::from(window.length) > SPAN_BYTES_MAX || end > FRAME_LEN_MAX {
            return None;
        }
        let data = self.push(window.command, window.address, usize::from(window.length))?;
        let share = Share {
            header: self.header(data),
            working_counter: window.working_counter,
            length: window.length as u8,
            inputs: (DATAGRAM_HEADER_LEN as u16 + window.input_offset) as u8,
            input_length: window.input_length as u8,
            slave,
        };
        if let Some(before) = self.shares.last_mut() {
            before.header.set_more(true);
        }
        self.all |= share.place();
        self.watched |= if watched { share.place() } else { M::NONE };
        // There is room; it was checked above.
        let _ = self.shares.push(share);
        Some((number, data))
    }

    /// Adds the datagrams that concern all slaves: AL status and clock.
    pub(super) fn push_common(&mut self, clock: Option<ReferenceClock>) {
        let place = |data: usize, start: usize| (data - DATAGRAM_HEADER_LEN - start) as u16;
        let status = Address::broadcast(register::AL_STATUS);
        if let Some(data) = self.push(Command::Brd, status, AL_STATUS_LEN) {
            self.common.status = place(data, self.start());
            self.common.status_header = self.header(data);
            if let Some(before) = self.shares.last_mut() {
                before.header.set_more(true);
            }
        }
        let Some(clock) = clock else { return };
        let address = Address::station(clock.station, register::DC_SYSTEM_TIME);
        let command = if clock.is_spread { Command::Frmw } else { Command::Fprd };
        if let Some(data) = self.push(command, address, clock.length()) {
            let place = place(data, self.start());
            if clock.wide {
                self.common.wide_clock = place;
                self.common.wide_time = data as u16;
            } else {
                self.common.narrow_clock = place;
            }
            self.common.clock_slaves = clock.slaves;
            self.common.period = clock.period;
            self.common.clock_header = self.header(data);
            self.common.status_header.set_more(true);
        }
    }

    /// First eight bytes of the header before `data`.
    fn header(&self, data: usize) -> Header {
        let mut header = Header::default();
        let start = data - DATAGRAM_HEADER_LEN;
        write_bytes(&mut header.0, 0, self.frame.0.get(start..start + 8).unwrap_or(&[]));
        header
    }

    /// The header of the last cyclic datagram, as it is expected.
    fn last_header(&mut self) -> Option<&mut Header> {
        if self.common.wide_clock.min(self.common.narrow_clock) != NOWHERE {
            Some(&mut self.common.clock_header)
        } else if self.common.status != NOWHERE {
            Some(&mut self.common.status_header)
        } else {
            self.shares.last_mut().map(|share| &mut share.header)
        }
    }

    /// Ends building: the added datagrams are sent from now on.
    pub(super) fn finish(&mut self, encapsulation: &Encapsulation) {
        self.cyclic = self.chain;
        self.close(encapsulation);
        let mut start = self.start();
        for share in &self.shares {
            if start + DATAGRAM_HEADER_LEN + PIECE_LEN > self.cyclic.end {
                self.copying = Copying::Exact;
            } else if !share.is_in_first_piece() && self.copying == Copying::FirstPieces {
                self.copying = Copying::FirstPiecesAndOthers;
            }
            start += share.len();
        }
    }

    /// Adds a datagram with zeroed data at the end of the chain. Returns the place of its data in the frame.
    fn push(&mut self, command: Command, address: Address, length: usize) -> Option<usize> {
        self.push_datagram(command, address, None, length)
    }

    /// Adds a datagram at the end of the chain with `length` bytes of zeroed or given data. Returns the place of its
    /// data in the frame.
    fn push_datagram(
        &mut self,
        command: Command,
        address: Address,
        data: Option<&[u8]>,
        length: usize,
    ) -> Option<usize> {
        let end = self.chain.end;
        let room = self.frame.0.get_mut(end..end + DATAGRAM_OVERHEAD + length)?;
        match data {
            Some(data) => {
                write_bytes(room, DATAGRAM_HEADER_LEN, data);
                write_bytes(room, DATAGRAM_HEADER_LEN + length, &[0; 2]);
            }
            None => room.fill(0),
        }
        DatagramRepr::request(command, 0, address, length as u16)
            .emit(room)
            .ok()?;
        if end > self.start() {
            self.set_more(self.chain.last, true);
        }
        self.chain = Chain {
            last: end,
            end: end + DATAGRAM_OVERHEAD + length,
        };
        Some(end + DATAGRAM_HEADER_LEN)
    }

    fn set_more(&mut self, datagram: usize, more: bool) {
        let length = read_u16(&self.frame.0, datagram + 6) & !MORE_BIT | if more { MORE_BIT } else { 0 };
        write_bytes(&mut self.frame.0, datagram + 6, &length.to_le_bytes());
    }

    fn close(&mut self, encapsulation: &Encapsulation) {
        self.length = encapsulation.close(&mut self.frame.0, self.chain.end) as u16;
        self.payload_length = (self.chain.end - self.start()) as u16;
    }

    /// Longest data of an acyclic datagram besides the cyclic ones, bytes.
    pub(super) fn room(&self) -> usize {
        FRAME_LEN_MAX.saturating_sub(self.cyclic.end + DATAGRAM_OVERHEAD)
    }

    /// Removes the acyclic datagrams.
    pub(super) fn drop_acyclic(&mut self, encapsulation: &Encapsulation) {
        self.acyclic.clear();
        self.set_more(self.cyclic.last, false);
        if let Some(header) = self.last_header() {
            header.set_more(false);
        }
        let padding = self.cyclic.end..FRAME_LEN_MIN.max(self.cyclic.end);
        if let Some(padding) = self.frame.0.get_mut(padding) {
            padding.fill(0);
        }
        self.chain = self.cyclic;
        self.close(encapsulation);
    }

    /// Appends an acyclic datagram for this transmission; false if there is no room.
    pub(super) fn push_acyclic(&mut self, command: Command, address: Address, data: &[u8], is_message: bool) -> bool {
        let place = Acyclic {
            length: data.len() as u16,
            is_message,
        };
        if self.acyclic.is_full() {
            return false;
        }
        if self.push_datagram(command, address, Some(data), data.len()).is_none() {
            return false;
        }
        // There is room; it was checked above.
        let _ = self.acyclic.push(place);
        if let Some(header) = self.last_header() {
            header.set_more(true);
        }
        true
    }

    /// Closes a frame to which acyclic datagrams were appended.
    pub(super) fn finish_acyclic(&mut self, encapsulation: &Encapsulation) {
        self.close(encapsulation);
    }

    /// Whether the frame serves a slave that is in operation.
    pub(super) fn is_watched(&self) -> bool {
        self.watched != M::NONE
    }

    /// Whether there is anything to send.
    pub(super) fn is_empty(&self) -> bool {
        self.cyclic.end == self.start()
    }

    /// Stamps the index and returns the frame to send.
    #[inline]
    pub(super) fn send(&mut self, index: u8) -> &[u8] {
        let start = self.start();
        if let Some(byte) = self.frame.0.get_mut(start + INDEX_BYTE) {
            *byte = index;
        }
        let first = match self.shares.first_mut() {
            Some(share) => &mut share.header,
            None => &mut self.common.status_header,
        };
        first.0[INDEX_BYTE] = index;
        self.index = index;
        self.state = SlotState::Sent;
        self.frame.0.get(..self.length.into()).unwrap_or(&[])
    }

    /// Whether a reply with this index is awaited.
    #[inline(always)]
    pub(super) fn awaits(&self, index: u8) -> bool {
        self.state == SlotState::Sent && self.index == index
    }

    /// Bytes of the frame, as they will be sent.
    pub(super) fn bytes(&self, start: usize, length: usize) -> Option<&[u8]> {
        self.frame.0.get(start..start + length)
    }

    /// Bytes of the frame that will be sent, to be written.
    pub(super) fn bytes_mut(&mut self, start: usize, length: usize) -> Option<&mut [u8]> {
        self.frame.0.get_mut(start..start + length)
    }

    /// Takes the reference's time, ns. The next transmission's clock datagram carries the time that the reference will have then:
    /// the reference replaces it by its own, unless it is gone.
    #[inline(always)]
    pub(super) fn set_clock(&mut self, time_ns: u64) {
        let next_ns = time_ns.wrapping_add(self.period_ns().into());
        match chunk_mut(&mut self.frame.0, self.common.wide_time.into()) {
            Some(bytes) => *bytes = next_ns.to_le_bytes(),
            None => self.set_narrow_clock(next_ns as u32),
        }
    }

    /// Lets the time go on that the clock's datagram carries, where the reference has not answered: it is written to the other
    /// slaves until another reference is named. A time of 0 is not known yet.
    #[inline(always)]
    pub(super) fn continue_clock(&mut self) {
        if self.common.period != 0 {
            self.advance_clock();
        }
    }

    #[cold]
    #[inline(never)]
    fn advance_clock(&mut self) {
        if let Some(time_ns) = self.carried_ns().filter(|time_ns| *time_ns != 0) {
            self.set_clock(time_ns);
        }
    }

    /// The time that the clock's datagram carries, ns: 64 or 32 bits of it. `None` without the datagram.
    pub(super) fn carried_ns(&self) -> Option<u64> {
        let bytes = |start: usize, length: usize| self.frame.0.get(start..start + length);
        if let Some(bytes) = bytes(self.common.wide_time.into(), 8) {
            return Some(read_u64(bytes, 0));
        }
        bytes(self.narrow_time(), 4).map(|bytes| read_u32(bytes, 0).into())
    }

    /// Has the clock's datagram carry a time, ns.
    pub(super) fn carry(&mut self, time_ns: u64) {
        self.set_clock(time_ns.wrapping_sub(self.period_ns().into()));
    }

    /// Period of the exchange, ns.
    #[inline(always)]
    const fn period_ns(&self) -> u32 {
        self.common.period as u32 * ReferenceClock::PERIOD_UNIT_NS
    }

    /// Place of the time of a clock of 32 bits in the frame.
    fn narrow_time(&self) -> usize {
        self.start() + usize::from(self.common.narrow_clock) + DATAGRAM_HEADER_LEN
    }

    /// Sets the low half of the time for clocks of 32 bits.
    #[inline(never)]
    fn set_narrow_clock(&mut self, time_ns: u32) {
        let place = self.narrow_time();
        if let Some(bytes) = chunk_mut(&mut self.frame.0, place) {
            *bytes = time_ns.to_le_bytes();
        }
    }
}

/// The `N` bytes from a place on, to be written; `None` if they are not all there.
#[inline(always)]
fn chunk_mut<const N: usize>(bytes: &mut [u8], start: usize) -> Option<&mut [u8; N]> {
    bytes.get_mut(start..start + N)?.first_chunk_mut()
}
