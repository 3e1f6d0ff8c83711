//! A prebuilt frame, and the check that a reply answers its last transmission.
//!
//! A frame is built for a plan. Each transmission stamps an index into the first datagram and, if the slow side has
//! requests, appends datagrams for one cycle. Outputs are written directly into the frame. A reply counts only if each
//! of its datagrams still has the header that was sent.
//!
//! Invariant: a reply is read at the places given by the frame that was sent; no content of the reply influences these.

use super::acyclic::IN_FLIGHT_MAX;
use super::encapsulation::Encapsulation;
use super::observation::{AlStatus, Ignored};
use super::plan::{AL_STATUS_LEN, PROCESS_BYTES_MAX, ReferenceClock, SPAN_BYTES_MAX, Window};
use super::wire::{
    Address, Command, DATAGRAM_HEADER_LEN, DATAGRAM_OVERHEAD, DatagramRepr, FRAME_LEN_MAX, FRAME_LEN_MIN, MacAddress,
    read_u8, read_u16, register, write_bytes,
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
    /// The slave's bit in [`Answers::answered`].
    fn bit(&self) -> u32 {
        1 << (self.slave & 31)
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
pub(super) struct Taken {
    /// The slaves that answered.
    pub(super) answers: Answers,
    /// The slaves' AL status.
    pub(super) al: AlStatus,
    /// Time of the reference clock, ns, if the frame distributes it and all slaves took it.
    pub(super) clock_ns: Option<u64>,
}

/// Which slaves have answered.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Answers {
    /// One bit for each slave whose datagram has the expected working counter.
    pub(super) answered: u32,
    /// Number of datagrams of watched slaves with an unexpected working counter.
    pub(super) errors: u32,
    /// Whether any working counter is not 0.
    pub(super) touched: bool,
}

/// Differences between a reply and what was expected: 0 if there are none.
#[derive(Clone, Copy, Debug)]
struct Differences {
    headers: u32,
    counters: u32,
}

/// A frame's bytes, aligned so that they can be copied in words.
#[derive(Debug)]
#[repr(align(4))]
struct Frame([u8; FRAME_LEN_MAX]);

/// A prebuilt frame and the state of its last transmission.
#[derive(Debug)]
pub(super) struct Telegram<const SLAVES: usize> {
    frame: Frame,
    /// Place of the first datagram in the frame.
    start: u8,
    /// Bytes of the frame as it is sent.
    length: u16,
    /// Bytes of all datagrams, as they are sent.
    payload_length: u16,
    shares: Vec<Share, SLAVES>,
    common: Common,
    /// Slaves with a share: one bit for each.
    all: u32,
    /// Slaves whose wrong working counter is an error: one bit for each.
    watched: u32,
    copying: Copying,
    cyclic: Chain,
    chain: Chain,
    pub(super) acyclic: Vec<Acyclic, ACYCLIC_MAX>,
    /// Index of the last transmission.
    pub(super) index: u8,
    pub(super) state: SlotState,
}

impl<const SLAVES: usize> Telegram<SLAVES> {
    pub(super) const fn new() -> Self {
        Self {
            frame: Frame([0; FRAME_LEN_MAX]),
            start: 0,
            length: 0,
            payload_length: 0,
            shares: Vec::new(),
            common: Common::NONE,
            all: 0,
            watched: 0,
            copying: Copying::FirstPieces,
            cyclic: Chain { last: 0, end: 0 },
            chain: Chain { last: 0, end: 0 },
            acyclic: Vec::new(),
            index: 0,
            state: SlotState::Idle,
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
        (self.all, self.watched) = (0, 0);
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

    /// Adds a slave's datagram to a frame that is being built. Returns its number among the slaves' datagrams of this
    /// frame, and the place of its data in the frame; `None` if there is no room.
    pub(super) fn push_share(&mut self, slave: u8, watched: bool, window: &Window) -> Option<(usize, usize)> {
        let number = self.shares.len();
        let end = self.chain.end + 2 * DATAGRAM_OVERHEAD + usize::from(window.length) + AL_STATUS_LEN;
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
        self.all |= share.bit();
        self.watched |= if watched { share.bit() } else { 0 };
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
        self.watched != 0
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

    /// Sets the time of the next transmission's clock datagram, ns; the reference clock replaces it by its own.
    #[inline(always)]
    pub(super) fn set_clock(&mut self, time_ns: u64) {
        match chunk_mut(&mut self.frame.0, self.common.wide_time.into()) {
            Some(bytes) => *bytes = time_ns.to_le_bytes(),
            None => self.set_narrow_clock(time_ns as u32),
        }
    }

    /// Sets the low half of the time for clocks of 32 bits.
    #[inline(never)]
    fn set_narrow_clock(&mut self, time_ns: u32) {
        let place = self.start() + usize::from(self.common.narrow_clock) + DATAGRAM_HEADER_LEN;
        if let Some(bytes) = chunk_mut(&mut self.frame.0, place) {
            *bytes = time_ns.to_le_bytes();
        }
    }

    /// Parses a reply with inputs: these go to `images`, in the order of the slaves' datagrams, everything else is
    /// returned.
    ///
    /// The content of `images` is valid only if this function succeeds, and only for slaves that answered.
    ///
    /// # Errors
    /// [`Ignored::Mismatch`] or [`Ignored::Circulating`].
    #[inline(always)]
    pub(super) fn take_inputs(&self, payload: &[u8], images: &mut [Image; SLAVES]) -> Result<Taken, Ignored> {
        let shares = match self.copying {
            Copying::FirstPieces => compare_inputs(&self.shares, payload, images),
            Copying::FirstPiecesAndOthers => {
                let shares = compare_inputs(&self.shares, payload, images);
                copy_exactly(&self.shares, payload, images, |share| !share.is_in_first_piece());
                shares
            }
            Copying::Exact => {
                copy_exactly(&self.shares, payload, images, |_| true);
                compare_outputs(&self.shares, payload)
            }
        };
        let (al, status) = self.take_status(payload);
        let (clock_ns, clock) = self.take_clock(payload);
        self.check(payload, shares.headers | status | clock)?;
        let answers = match shares.counters == 0 && al.slaves != 0 {
            true => self.all_answers(),
            false => self.examine(payload, al.slaves),
        };
        Ok(Taken { answers, al, clock_ns })
    }

    /// Checks a reply without inputs. Returns which slaves answered.
    ///
    /// # Errors
    /// [`Ignored::Mismatch`] or [`Ignored::Circulating`].
    #[inline(always)]
    pub(super) fn take_outputs(&self, payload: &[u8]) -> Result<Answers, Ignored> {
        let shares = compare_outputs(&self.shares, payload);
        self.check(payload, shares.headers)?;
        Ok(match shares.counters == 0 {
            true => self.all_answers(),
            false => self.examine(payload, 0),
        })
    }

    /// The answers of a reply in which all working counters are as expected.
    #[inline(always)]
    fn all_answers(&self) -> Answers {
        Answers {
            answered: self.all,
            errors: 0,
            touched: true,
        }
    }

    /// Refuses a reply of another length or with other headers.
    #[inline(always)]
    fn check(&self, payload: &[u8], differences: u32) -> Result<(), Ignored> {
        let is_same = payload.len() == usize::from(self.payload_length)
            && differences == 0
            && (self.acyclic.is_empty() || self.is_acyclic_same(payload));
        if is_same { Ok(()) } else { Err(self.blame(payload)) }
    }

    /// The AL status of all slaves, and the bits in which its header differs.
    #[inline(always)]
    fn take_status(&self, payload: &[u8]) -> (AlStatus, u32) {
        let place = self.common.status.into();
        let Some(status) = chunk::<{ DATAGRAM_OVERHEAD + AL_STATUS_LEN }>(payload, place) else {
            return (AlStatus::default(), u32::MAX);
        };
        let (low, high) = self.common.status_header.differences(first(status));
        let [.., status_low, status_high, slaves_low, slaves_high] = *status;
        let al = AlStatus {
            status: u16::from_le_bytes([status_low, status_high]),
            slaves: u16::from_le_bytes([slaves_low, slaves_high]),
        };
        (al, low & NO_POSITION | high)
    }

    /// The time of the reference clock, ns, if all slaves took it, and the bits in which its header differs.
    #[inline(always)]
    fn take_clock(&self, payload: &[u8]) -> (Option<u64>, u32) {
        let Some(clock) = chunk::<{ DATAGRAM_OVERHEAD + 8 }>(payload, self.common.wide_clock.into()) else {
            return match self.common.narrow_clock {
                NOWHERE => (None, 0),
                place => self.take_narrow_clock(payload, place),
            };
        };
        let (low, high) = self.common.clock_header.differences(first(clock));
        let [.., a, b, c, d, e, f, g, h, slaves_low, slaves_high] = *clock;
        let is_whole = u16::from_le_bytes([slaves_low, slaves_high]) == self.common.clock_slaves;
        let time_ns = u64::from_le_bytes([a, b, c, d, e, f, g, h]);
        (is_whole.then_some(time_ns), low | high)
    }

    /// The time of a reference clock of 32 bits, ns, if all slaves took it, and the bits in which its header differs.
    #[inline(never)]
    fn take_narrow_clock(&self, payload: &[u8], place: u16) -> (Option<u64>, u32) {
        let Some(clock) = chunk::<{ DATAGRAM_OVERHEAD + 4 }>(payload, place.into()) else {
            return (None, u32::MAX);
        };
        let (low, high) = self.common.clock_header.differences(first(clock));
        let [.., a, b, c, d, slaves_low, slaves_high] = *clock;
        let is_whole = u16::from_le_bytes([slaves_low, slaves_high]) == self.common.clock_slaves;
        let time_ns = u32::from_le_bytes([a, b, c, d]);
        (is_whole.then_some(time_ns.into()), low | high)
    }

    /// Finds out which slaves have answered, when not all have; `slaves` is the working counter of the AL status.
    #[cold]
    #[inline(never)]
    fn examine(&self, payload: &[u8], slaves: u16) -> Answers {
        let mut answered = 0;
        let mut rest = payload;
        for share in &self.shares {
            let counter = read_u16(rest, share.len() - 2);
            answered |= if counter == share.working_counter {
                share.bit()
            } else {
                0
            };
            rest = rest.get(share.len()..).unwrap_or(&[]);
        }
        Answers {
            answered,
            errors: (self.watched & !answered).count_ones(),
            touched: answered != 0 || slaves != 0 || self.is_touched(payload),
        }
    }

    /// Whether the acyclic datagrams of a reply have the headers that were sent.
    #[cold]
    fn is_acyclic_same(&self, payload: &[u8]) -> bool {
        let mut sent = self.frame.0.get(self.cyclic.end..self.chain.end).unwrap_or(&[]);
        let mut received = payload.get(self.cyclic.end - self.start()..).unwrap_or(&[]);
        self.acyclic.iter().all(|place| {
            let length = DATAGRAM_OVERHEAD + usize::from(place.length);
            let header = |bytes: &[u8]| Some(u64::from_le_bytes(*bytes.first_chunk()?));
            let (Some(ours), Some(theirs)) = (header(sent), header(received)) else {
                return false;
            };
            (sent, received) = (sent.get(length..).unwrap_or(&[]), received.get(length..).unwrap_or(&[]));
            let differences = ours ^ theirs;
            let counts_position = || Command::from_number(ours as u8).is_ok_and(Command::counts_position);
            differences == 0 || differences & !POSITION_HEADER == 0 && counts_position()
        })
    }

    /// Whether any working counter in a reply is not 0.
    #[cold]
    fn is_touched(&self, payload: &[u8]) -> bool {
        let mut walk = self.walk(payload, self.start());
        while walk.next_sent().is_some() {}
        walk.counters != 0
    }

    /// Why a reply whose headers differ from what was sent is rejected.
    #[cold]
    fn blame(&self, payload: &[u8]) -> Ignored {
        let mut walk = self.walk(payload, self.start());
        while walk.next_sent().is_some() {}
        let same_length = payload.len() == self.chain.end - self.start();
        if same_length && walk.differences == u64::from(CIRCULATING_BIT) << 48 {
            Ignored::Circulating
        } else {
            Ignored::Mismatch
        }
    }

    /// Passes on the acyclic datagrams of a reply that [`Self::take_inputs`] has accepted: data and working counter.
    pub(super) fn each_acyclic(&self, payload: &[u8], mut take: impl FnMut(&Acyclic, &[u8], u16)) {
        let mut rest = payload.get(self.cyclic.end - self.start()..).unwrap_or(&[]);
        for place in &self.acyclic {
            let length = usize::from(place.length);
            let data = rest
                .get(DATAGRAM_HEADER_LEN..DATAGRAM_HEADER_LEN + length)
                .unwrap_or(&[]);
            take(place, data, read_u16(rest, DATAGRAM_HEADER_LEN + length));
            rest = rest.get(DATAGRAM_OVERHEAD + length..).unwrap_or(&[]);
        }
    }

    /// Walks the sent frame and its reply in parallel, from a place in the frame on.
    fn walk<'a>(&'a self, payload: &'a [u8], from: usize) -> Walk<'a> {
        Walk {
            sent: self.frame.0.get(from..self.chain.end).unwrap_or(&[]),
            received: payload.get(from - self.start()..).unwrap_or(&[]),
            differences: 0,
            counters: 0,
        }
    }
}

/// Compares the slaves' datagrams at the beginning of a reply with what was sent, and copies the first piece of their
/// data.
///
/// A separate function so that all values of the loop fit into registers.
#[inline(never)]
fn compare_inputs(shares: &[Share], payload: &[u8], images: &mut [Image]) -> Differences {
    let (mut headers, mut counters) = (0, 0);
    let mut rest = payload;
    for (share, image) in shares.iter().zip(images) {
        let Some(beginning) = rest.first_chunk::<{ DATAGRAM_HEADER_LEN + PIECE_LEN }>() else {
            headers = u32::MAX;
            break;
        };
        if let Some(piece) = beginning.last_chunk() {
            image.0[0] = *piece;
        }
        let Some((datagram, behind)) = rest.split_at_checked(share.len()) else {
            headers = u32::MAX;
            break;
        };
        compare(share, datagram, &mut headers, &mut counters);
        rest = behind;
    }
    Differences { headers, counters }
}

/// Compares the slaves' datagrams at the beginning of a reply with what was sent.
#[inline(never)]
fn compare_outputs(shares: &[Share], payload: &[u8]) -> Differences {
    let (mut headers, mut counters) = (0, 0);
    let mut rest = payload;
    for share in shares {
        let Some((datagram, behind)) = rest.split_at_checked(share.len()) else {
            headers = u32::MAX;
            break;
        };
        compare(share, datagram, &mut headers, &mut counters);
        rest = behind;
    }
    Differences { headers, counters }
}

/// Adds the differences of one slave's datagram.
#[inline(always)]
fn compare(share: &Share, datagram: &[u8], headers: &mut u32, counters: &mut u32) {
    // A datagram has at least its overhead.
    let (Some(header), Some(counter)) = (datagram.first_chunk(), datagram.last_chunk()) else {
        *headers = u32::MAX;
        return;
    };
    let (low, high) = share.header.differences(header);
    *headers |= low | high;
    *counters |= u32::from(u16::from_le_bytes(*counter) ^ share.working_counter);
}

/// Copies the inputs of some slaves, whatever their lengths.
#[inline(never)]
fn copy_exactly(shares: &[Share], payload: &[u8], images: &mut [Image], is_copied: impl Fn(&Share) -> bool) {
    let mut rest = payload;
    for (share, image) in shares.iter().zip(images) {
        if is_copied(share) {
            let start = usize::from(share.inputs);
            let inputs = rest.get(start..start + usize::from(share.input_length));
            write_bytes(image.0.as_flattened_mut(), 0, inputs.unwrap_or(&[]));
        }
        rest = rest.get(share.len()..).unwrap_or(&[]);
    }
}

/// The `N` bytes from a place on; `None` if they are not all there.
#[inline(always)]
fn chunk<const N: usize>(bytes: &[u8], start: usize) -> Option<&[u8; N]> {
    bytes.get(start..start + N)?.first_chunk()
}

/// The `N` bytes from a place on, to be written; `None` if they are not all there.
#[inline(always)]
fn chunk_mut<const N: usize>(bytes: &mut [u8], start: usize) -> Option<&mut [u8; N]> {
    bytes.get_mut(start..start + N)?.first_chunk_mut()
}

/// The first eight bytes of a datagram.
#[inline(always)]
fn first<const N: usize>(datagram: &[u8; N]) -> &[u8; 8] {
    datagram.first_chunk().unwrap_or(&[0; 8])
}

/// Walks a sent frame and its reply in parallel, and collects the differences of their headers.
struct Walk<'a> {
    sent: &'a [u8],
    received: &'a [u8],
    differences: u64,
    counters: u16,
}

impl<'a> Walk<'a> {
    /// The next datagram's received bytes from its data on, and its working counter. If `counts_position`, slaves
    /// increment the device half of the address.
    #[inline(always)]
    fn next(&mut self, length: usize, counts_position: bool) -> Option<(&'a [u8], u16)> {
        let mask = if counts_position { !POSITION_HEADER } else { u64::MAX };
        let sent = u64::from_le_bytes(*self.sent.first_chunk::<8>()?);
        let received = u64::from_le_bytes(*self.received.first_chunk::<8>()?);
        self.differences |= (sent ^ received) & mask;
        let (_, data) = self.received.split_first_chunk::<DATAGRAM_HEADER_LEN>()?;
        let (_, end) = data.split_at_checked(length)?;
        let (counter, rest) = end.split_first_chunk::<2>()?;
        let counter = u16::from_le_bytes(*counter);
        self.counters |= counter;
        self.sent = self.sent.get(DATAGRAM_OVERHEAD + length..)?;
        self.received = rest;
        Some((data, counter))
    }

    /// The next datagram, of any command, `length` bytes long.
    fn next_any(&mut self, length: usize) -> Option<(&'a [u8], u16)> {
        let command = Command::from_number(read_u8(self.sent, 0));
        self.next(length, command.is_ok_and(Command::counts_position))
    }

    /// The next datagram, of any command and length.
    fn next_sent(&mut self) -> Option<(&'a [u8], u16)> {
        let length = read_u16(self.sent.get(..DATAGRAM_OVERHEAD)?, 6) & !(MORE_BIT | CIRCULATING_BIT);
        self.next_any(length.into())
    }
}
