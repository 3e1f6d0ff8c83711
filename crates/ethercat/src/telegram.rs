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
use super::plan::{AL_STATUS_LEN, PROCESS_BYTES_MAX, ReferenceClock, Window};
use super::wire::{
    Address, Command, DATAGRAM_HEADER_LEN, DATAGRAM_OVERHEAD, DatagramRepr, FRAME_LEN_MAX, FRAME_LEN_MIN, MacAddress,
    read_u8, read_u16, read_u32, register, write_bytes,
};
use heapless::Vec;

/// Most acyclic datagrams in a frame: requests for registers and one message.
const ACYCLIC_MAX: usize = IN_FLIGHT_MAX + 1;
/// Bit of the length field that announces another datagram.
const MORE_BIT: u16 = 1 << 15;
/// Bit of the length field that a slave sets in a frame that passes a second time.
const CIRCULATING_BIT: u16 = 1 << 14;

/// The More bit in the first eight bytes of a header.
const MORE_HEADER: u64 = (MORE_BIT as u64) << 48;
/// Device half of the address in the first eight bytes of a header: slaves increment it in broadcasts.
const POSITION_HEADER: u64 = 0xFFFF_0000;

/// Inputs of one slave, in two pieces, each copied at once.
pub(super) type Image = [[u8; PIECE_LEN]; 2];

const PIECE_LEN: usize = PROCESS_BYTES_MAX / 2;
const _: () = assert!(
    PIECE_LEN <= 1 + 2 + DATAGRAM_OVERHEAD + AL_STATUS_LEN,
    "the first piece of the last slave's only byte of input ends with the AL status behind it"
);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SlotState {
    Idle,
    Sent,
    Received,
}

/// One slave's datagram.
#[derive(Clone, Copy, Debug)]
struct Share {
    /// First eight bytes of the datagram's header, which come back unchanged; without the index in a frame's first
    /// datagram.
    header: u64,
    /// The slave's bit in [`Taken::answered`].
    bit: u32,
    length: u16,
    working_counter: u16,
    input_offset: u16,
    slave: u8,
    /// Pieces of an [`Image`] that hold inputs.
    pieces: u8,
}

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
    /// One bit for each slave whose datagram has the expected working counter.
    pub(super) answered: u32,
    /// Number of datagrams of watched slaves with an unexpected working counter.
    pub(super) errors: u32,
    /// The slaves' AL status, if the frame reads it.
    pub(super) al: Option<AlStatus>,
    /// Time of the reference clock, ns, if the frame distributes it and all slaves took it.
    pub(super) clock_ns: Option<u64>,
    /// Whether any working counter is not 0.
    pub(super) touched: bool,
}

/// A frame's bytes, aligned so that they can be copied in words.
#[derive(Debug)]
#[repr(align(4))]
struct Frame([u8; FRAME_LEN_MAX]);

/// A prebuilt frame and the state of its last transmission.
#[derive(Debug)]
pub(super) struct Telegram<const SLAVES: usize> {
    frame: Frame,
    start: usize,
    shares: Vec<Share, SLAVES>,
    /// First eight bytes of the header that reads the AL status, like [`Share::header`], if the frame reads it.
    status: Option<u64>,
    /// First eight bytes of the header that distributes the clock's time.
    clock_header: u64,
    /// Slaves whose wrong working counter is an error: one bit for each.
    watched: u32,
    clock: Option<ReferenceClock>,
    cyclic: Chain,
    chain: Chain,
    length: usize,
    pub(super) acyclic: Vec<Acyclic, ACYCLIC_MAX>,
    pub(super) index: u8,
    pub(super) state: SlotState,
}

impl<const SLAVES: usize> Telegram<SLAVES> {
    pub(super) const fn new() -> Self {
        Self {
            frame: Frame([0; FRAME_LEN_MAX]),
            start: 0,
            shares: Vec::new(),
            status: None,
            clock_header: 0,
            watched: 0,
            clock: None,
            cyclic: Chain { last: 0, end: 0 },
            chain: Chain { last: 0, end: 0 },
            length: 0,
            acyclic: Vec::new(),
            index: 0,
            state: SlotState::Idle,
        }
    }

    /// Resets the frame: no datagrams behind the encapsulation's headers.
    pub(super) fn clear(&mut self, encapsulation: &Encapsulation, source: MacAddress) {
        self.frame.0 = [0; FRAME_LEN_MAX];
        encapsulation.emit(&mut self.frame.0, source);
        self.start = encapsulation.header_len();
        self.shares.clear();
        self.status = None;
        self.watched = 0;
        self.clock = None;
        self.cyclic = Chain {
            last: self.start,
            end: self.start,
        };
        self.chain = self.cyclic;
        self.length = 0;
        self.acyclic.clear();
        self.state = SlotState::Idle;
    }

    /// Adds a slave's datagram to a frame that is being built. Returns the place of its data in the frame; `None` if
    /// there is no room.
    pub(super) fn push_share(&mut self, slave: u8, watched: bool, window: &Window) -> Option<usize> {
        let mut share = Share {
            header: 0,
            bit: 1 << (slave & 31),
            length: window.length,
            working_counter: window.working_counter,
            input_offset: window.input_offset,
            slave,
            pieces: usize::from(window.input_length).div_ceil(PIECE_LEN) as u8,
        };
        // Inputs are copied in pieces; the AL status behind the last ones guarantees enough bytes to copy.
        let end = self.chain.end + 2 * DATAGRAM_OVERHEAD + usize::from(window.length) + AL_STATUS_LEN;
        if self.shares.is_full() || end > FRAME_LEN_MAX {
            return None;
        }
        let data = self.push(window.command, window.address, usize::from(window.length))?;
        share.header = self.header(data);
        if let Some(before) = self.shares.last_mut() {
            before.header |= MORE_HEADER;
        }
        self.watched |= if watched { share.bit } else { 0 };
        // There is room; it was checked above.
        let _ = self.shares.push(share);
        Some(data)
    }

    /// Adds the datagrams that concern all slaves: AL status and clock.
    pub(super) fn push_common(&mut self, clock: Option<ReferenceClock>) {
        let status = Address::broadcast(register::AL_STATUS);
        let data = self.push(Command::Brd, status, AL_STATUS_LEN);
        self.status = data.map(|data| self.header(data));
        if let Some(before) = self.shares.last_mut().filter(|_| data.is_some()) {
            before.header |= MORE_HEADER;
        }
        let Some(clock) = clock else { return };
        let address = Address::station(clock.station, register::DC_SYSTEM_TIME);
        let command = if clock.is_spread { Command::Frmw } else { Command::Fprd };
        if let Some(data) = self.push(command, address, clock.length()) {
            self.clock_header = self.header(data);
            self.clock = Some(clock);
            self.status = self.status.map(|header| header | MORE_HEADER);
        }
    }

    /// First eight bytes of the header before `data`.
    fn header(&self, data: usize) -> u64 {
        let start = data - DATAGRAM_HEADER_LEN;
        u64::from(read_u32(&self.frame.0, start)) | u64::from(read_u32(&self.frame.0, start + 4)) << 32
    }

    /// Ends building: the added datagrams are sent from now on.
    pub(super) fn finish(&mut self, encapsulation: &Encapsulation) {
        self.cyclic = self.chain;
        self.close(encapsulation);
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
        if end > self.start {
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
        self.length = encapsulation.close(&mut self.frame.0, self.chain.end);
    }

    /// Longest data of an acyclic datagram besides the cyclic ones, bytes.
    pub(super) fn room(&self) -> usize {
        FRAME_LEN_MAX.saturating_sub(self.cyclic.end + DATAGRAM_OVERHEAD)
    }

    /// Removes the acyclic datagrams.
    pub(super) fn drop_acyclic(&mut self, encapsulation: &Encapsulation) {
        self.acyclic.clear();
        self.set_more(self.cyclic.last, false);
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
        self.cyclic.end == self.start
    }

    /// Stamps the index and returns the frame to send.
    pub(super) fn send(&mut self, index: u8) -> &[u8] {
        if let Some(byte) = self.frame.0.get_mut(self.start + 1) {
            *byte = index;
        }
        self.index = index;
        self.state = SlotState::Sent;
        self.frame.0.get(..self.length).unwrap_or(&[])
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
    pub(super) fn set_clock(&mut self, time_ns: u64) {
        let Some(clock) = self.clock else { return };
        let data = self.frame.0.get_mut(self.cyclic.last + DATAGRAM_HEADER_LEN..);
        if clock.wide {
            if let Some(bytes) = data.and_then(|data| data.first_chunk_mut()) {
                *bytes = time_ns.to_le_bytes();
            }
        } else if let Some(bytes) = data.and_then(|data| data.first_chunk_mut()) {
            *bytes = (time_ns as u32).to_le_bytes();
        }
    }

    /// Parses a reply: inputs go to `images`, everything else is returned.
    ///
    /// The content of `images` is valid only if this function succeeds.
    ///
    /// # Errors
    /// [`Ignored::Mismatch`] or [`Ignored::Circulating`].
    #[inline]
    pub(super) fn take(&self, payload: &[u8], images: &mut [Image; SLAVES]) -> Result<Taken, Ignored> {
        let mut taken = Taken::default();
        let same = payload.len() == self.chain.end - self.start
            && self.take_cyclic(payload, images, &mut taken) == Some(0)
            && (self.acyclic.is_empty() || self.is_acyclic_same(payload));
        if !same {
            return Err(self.blame(payload));
        }
        let missing = self.watched & !taken.answered;
        if missing != 0 {
            taken.errors = count(missing);
        }
        taken.touched = taken.answered != 0 || taken.al.is_some_and(|al| al.slaves != 0) || self.is_touched(payload);
        Ok(taken)
    }

    /// Parses the cyclic datagrams. Returns the bits in which headers differ from what was sent; `None` if the reply is
    /// too short.
    #[inline]
    fn take_cyclic(&self, payload: &[u8], images: &mut [Image; SLAVES], taken: &mut Taken) -> Option<u64> {
        let (mut answered, mut differences) = (0, 0);
        let mut index = u64::from(self.index) << 8;
        let mut rest = payload;
        for share in &self.shares {
            let (header, data, counter) = next(&mut rest, share.length.into())?;
            differences |= header ^ (share.header | index);
            index = 0;
            if counter == share.working_counter {
                answered |= share.bit;
                if share.pieces != 0 {
                    let [first, second] = images.get_mut(usize::from(share.slave))?;
                    let (low, high) = data.get(usize::from(share.input_offset)..)?.split_first_chunk()?;
                    *first = *low;
                    if share.pieces > 1 {
                        *second = *high.first_chunk()?;
                    }
                }
            }
        }
        taken.answered = answered;
        if let Some(status) = self.status {
            let more = if self.clock.is_none() { self.acyclic_more() } else { 0 };
            let (header, data, slaves) = next(&mut rest, AL_STATUS_LEN)?;
            differences |= (header ^ (status | index | more)) & !POSITION_HEADER;
            let status = u16::from_le_bytes(*data.first_chunk()?);
            taken.al = Some(AlStatus { status, slaves });
        }
        if let Some(clock) = self.clock {
            let (header, time_ns, counter) = if clock.wide {
                let (header, data, counter) = next(&mut rest, 8)?;
                (header, u64::from_le_bytes(*data.first_chunk()?), counter)
            } else {
                let (header, data, counter) = next(&mut rest, 4)?;
                (header, u32::from_le_bytes(*data.first_chunk()?).into(), counter)
            };
            differences |= header ^ (self.clock_header | self.acyclic_more());
            taken.clock_ns = (counter == clock.slaves).then_some(time_ns);
        }
        Some(differences)
    }

    /// The More bit of the last cyclic datagram's header.
    fn acyclic_more(&self) -> u64 {
        if self.acyclic.is_empty() { 0 } else { MORE_HEADER }
    }

    /// Whether the acyclic datagrams of a reply have the headers that were sent.
    #[cold]
    fn is_acyclic_same(&self, payload: &[u8]) -> bool {
        let mut sent = self.frame.0.get(self.cyclic.end..self.chain.end).unwrap_or(&[]);
        let mut received = payload.get(self.cyclic.end - self.start..).unwrap_or(&[]);
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
        let mut walk = self.walk(payload, self.start);
        while walk.next_sent().is_some() {}
        walk.counters != 0
    }

    /// Why a reply whose headers differ from what was sent is rejected.
    #[cold]
    fn blame(&self, payload: &[u8]) -> Ignored {
        let mut walk = self.walk(payload, self.start);
        while walk.next_sent().is_some() {}
        let same_length = payload.len() == self.chain.end - self.start;
        if same_length && walk.differences == u64::from(CIRCULATING_BIT) << 48 {
            Ignored::Circulating
        } else {
            Ignored::Mismatch
        }
    }

    /// Passes on the acyclic datagrams of a reply that [`Self::take`] has accepted: data and working counter.
    pub(super) fn each_acyclic(&self, payload: &[u8], mut take: impl FnMut(&Acyclic, &[u8], u16)) {
        let mut rest = payload.get(self.cyclic.end - self.start..).unwrap_or(&[]);
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
            received: payload.get(from - self.start..).unwrap_or(&[]),
            differences: 0,
            counters: 0,
        }
    }
}

/// Takes the next datagram off `rest`: the first eight bytes of its header, all bytes from its data on, and its working
/// counter.
#[inline(always)]
fn next<'a>(rest: &mut &'a [u8], length: usize) -> Option<(u64, &'a [u8], u16)> {
    let (header, data) = rest.split_first_chunk::<DATAGRAM_HEADER_LEN>()?;
    let (counter, behind) = data.split_at_checked(length)?.1.split_first_chunk()?;
    *rest = behind;
    Some((
        u64::from_le_bytes(*header.first_chunk()?),
        data,
        u16::from_le_bytes(*counter),
    ))
}

/// Number of set bits; a separate function because it is rarely called.
#[cold]
#[inline(never)]
fn count(bits: u32) -> u32 {
    bits.count_ones()
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
