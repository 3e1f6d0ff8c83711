//! What a reply to a prebuilt frame holds, and whether it is one.
//!
//! Invariant: a reply is read at the places given by the frame that was sent; no content of the reply influences these.

use super::{
    Acyclic, Answers, CIRCULATING_BIT, Copying, Image, MORE_BIT, NO_POSITION, NOWHERE, PIECE_LEN, POSITION_HEADER,
    Share, Taken, Telegram,
};
use crate::observation::{AlStatus, Ignored};
use crate::plan::AL_STATUS_LEN;
use crate::slave_set::Places;
use crate::wire::{Command, DATAGRAM_HEADER_LEN, DATAGRAM_OVERHEAD, read_u8, read_u16, write_bytes};

/// Differences between a reply and what was expected: 0 if there are none.
#[derive(Clone, Copy, Debug)]
struct Differences {
    headers: u32,
    counters: u32,
}

impl<const SLAVES: usize, M: Places> Telegram<SLAVES, M> {
    /// Whether a frame of this index, whose reply comes late, was this one: its first datagram differs in the index only.
    #[cold]
    pub(in super::super) fn is_origin(&self, payload: &[u8]) -> bool {
        let first = self
            .shares
            .first()
            .map_or(&self.common.status_header, |share| &share.header);
        let Some((low, high)) = payload.first_chunk().map(|header| first.differences(header)) else {
            return false;
        };
        let counts_position = self.shares.is_empty();
        let of_slaves = if counts_position { NO_POSITION } else { u32::MAX };
        // The second byte is the index; the last bit tells whether acyclic datagrams follow.
        let more = u32::from(MORE_BIT) << 16;
        low & of_slaves & !0xFF00 == 0 && high & !more == 0
    }

    /// Parses a reply with inputs: these go to `images`, in the order of the slaves' datagrams, everything else is
    /// returned.
    ///
    /// The content of `images` is valid only if this function succeeds, and only for slaves that answered.
    ///
    /// # Errors
    /// [`Ignored::Mismatch`] or [`Ignored::Circulating`].
    #[inline(always)]
    pub(in super::super) fn take_inputs(&self, payload: &[u8], images: &mut [Image]) -> Result<Taken<M>, Ignored> {
        let shares = self.take_shares(payload, images);
        let (al, status) = self.take_status(payload);
        let (clock_ns, clock) = self.take_clock(payload);
        self.check(payload, shares.headers | status | clock)?;
        let answers = match shares.counters == 0 && al.slaves != 0 {
            true => self.all_answers(),
            false => self.examine(payload, al.slaves),
        };
        Ok(Taken { answers, al, clock_ns })
    }

    /// Parses a reply with inputs to a frame without datagrams that concern all slaves, as [`Self::take_inputs`].
    ///
    /// # Errors
    /// [`Ignored::Mismatch`] or [`Ignored::Circulating`].
    pub(in super::super) fn take_inputs_only(
        &self,
        payload: &[u8],
        images: &mut [Image],
    ) -> Result<Answers<M>, Ignored> {
        let shares = self.take_shares(payload, images);
        self.answers(payload, shares)
    }

    /// Copies the inputs of the slaves' datagrams at the beginning of a reply, and compares these with what was sent.
    #[inline(always)]
    fn take_shares(&self, payload: &[u8], images: &mut [Image]) -> Differences {
        match self.copying {
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
        }
    }

    /// Checks a reply without inputs. Returns which slaves answered.
    ///
    /// # Errors
    /// [`Ignored::Mismatch`] or [`Ignored::Circulating`].
    #[inline(always)]
    pub(in super::super) fn take_outputs(&self, payload: &[u8]) -> Result<Answers<M>, Ignored> {
        self.answers(payload, compare_outputs(&self.shares, payload))
    }

    /// The answers of a reply whose slaves' datagrams differ so from what was sent, and which has no other cyclic ones.
    #[inline(always)]
    fn answers(&self, payload: &[u8], shares: Differences) -> Result<Answers<M>, Ignored> {
        self.check(payload, shares.headers)?;
        Ok(match shares.counters == 0 {
            true => self.all_answers(),
            false => self.examine(payload, 0),
        })
    }

    /// The answers of a reply in which all working counters are as expected.
    #[inline(always)]
    fn all_answers(&self) -> Answers<M> {
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

    /// The time of the reference clock, ns, and the bits in which its header differs. The reference has written its time if
    /// as many slaves took part as have clocks, or if the time is not the one that was sent: a slave whose clock nobody
    /// counts on, or one that is away, does not hide it.
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
        let slaves = u16::from_le_bytes([slaves_low, slaves_high]);
        let time_ns = u64::from_le_bytes([a, b, c, d, e, f, g, h]);
        let sent = chunk::<8>(&self.frame.0, self.common.wide_time.into());
        let is_new = || slaves != 0 && sent.is_some_and(|sent| u64::from_le_bytes(*sent) != time_ns);
        let is_told = slaves == self.common.clock_slaves || is_new();
        (is_told.then_some(time_ns), low | high)
    }

    /// The time of a reference clock of 32 bits, ns, as [`Self::take_clock`] does.
    #[inline(never)]
    fn take_narrow_clock(&self, payload: &[u8], place: u16) -> (Option<u64>, u32) {
        let Some(clock) = chunk::<{ DATAGRAM_OVERHEAD + 4 }>(payload, place.into()) else {
            return (None, u32::MAX);
        };
        let (low, high) = self.common.clock_header.differences(first(clock));
        let [.., a, b, c, d, slaves_low, slaves_high] = *clock;
        let slaves = u16::from_le_bytes([slaves_low, slaves_high]);
        let time_ns = u32::from_le_bytes([a, b, c, d]);
        let data = self.start() + usize::from(place) + DATAGRAM_HEADER_LEN;
        let sent = chunk::<4>(&self.frame.0, data);
        let is_new = || slaves != 0 && sent.is_some_and(|sent| u32::from_le_bytes(*sent) != time_ns);
        let is_told = slaves == self.common.clock_slaves || is_new();
        (is_told.then_some(time_ns.into()), low | high)
    }

    /// Finds out which slaves have answered, when not all have; `slaves` is the working counter of the AL status.
    #[cold]
    #[inline(never)]
    fn examine(&self, payload: &[u8], slaves: u16) -> Answers<M> {
        let mut answered = M::NONE;
        let mut rest = payload;
        for share in &self.shares {
            let counter = read_u16(rest, share.len() - 2);
            answered |= if counter == share.working_counter {
                share.place()
            } else {
                M::NONE
            };
            rest = rest.get(share.len()..).unwrap_or(&[]);
        }
        Answers {
            answered,
            errors: self.watched.without(answered).count(),
            touched: answered != M::NONE || slaves != 0 || self.is_touched(payload),
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
    pub(in super::super) fn each_acyclic(&self, payload: &[u8], mut take: impl FnMut(&Acyclic, &[u8], u16)) {
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
