//! What the critical side sees of the bus: states, arrivals, counters.

use super::slave_set::SlaveSet;

/// Why a received frame was dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Ignored {
    /// A protocol other than EtherCAT, VLAN tags included.
    EtherType,
    /// EtherCAT, but without datagrams.
    FrameType,
    /// Shorter than its own lengths claim.
    Truncated,
    /// A frame of another sender.
    ForeignSource,
    /// An index that was not in use.
    ForeignIndex,
    /// The answer to a frame of an earlier cycle.
    Late,
    /// An answer that had arrived already.
    Duplicate,
    /// Command, address, length or chain differ from what was sent.
    Mismatch,
    /// The frame passed the segment twice.
    Circulating,
    /// An own frame that no slave has processed.
    Reflection,
}

/// Number of kinds of [`Ignored`].
pub const IGNORED_KINDS: usize = Ignored::Reflection as usize + 1;

/// The AL status of all slaves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AlStatus {
    /// The slaves' AL status registers, OR-ed together.
    pub status: u16,
    /// How many slaves answered.
    pub slaves: u16,
}

/// Bus state that the critical side reports to the supervisor whenever it changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Observation {
    /// The last AL status; zeros when the bus is silent.
    pub al: AlStatus,
    /// The slaves whose process data had the expected working counter.
    pub answered: SlaveSet,
    /// Whether [`SILENT_CYCLES`](super::cyclic::SILENT_CYCLES) cycles passed without any reply.
    pub silent: bool,
}

impl Observation {
    /// An observation that no bus makes.
    pub(super) const IMPOSSIBLE: Self = Self {
        al: AlStatus {
            status: u16::MAX,
            slaves: u16::MAX,
        },
        answered: SlaveSet::ALL,
        silent: true,
    };

    /// The observation of a bus without replies.
    pub(super) const SILENT: Self = Self {
        al: AlStatus { status: 0, slaves: 0 },
        answered: SlaveSet::NONE,
        silent: true,
    };

    /// Whether anything differs, compared in words; places beyond the first 32 only if there are such.
    #[inline(always)]
    pub(super) fn differs(&self, other: &Self, has_more_places: bool) -> bool {
        let packed = |al: &AlStatus| u32::from(al.status) | u32::from(al.slaves) << 16;
        let al = packed(&self.al) ^ packed(&other.al);
        let answered = self.answered.first() ^ other.answered.first();
        al | answered | u32::from(self.silent ^ other.silent) != 0 || has_more_places && self.answered != other.answered
    }
}

/// Kind of a received frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// This cycle's inputs.
    Input,
    /// The acknowledgement of this cycle's outputs.
    Output,
    /// A frame that is not used; counted.
    Ignored(Ignored),
}

/// Counters of one of the telegrams of a cycle since start-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCounters {
    /// Telegrams whose reply had not come when the next cycle began.
    pub lost: u32,
    /// Replies that arrived in a later cycle; each was also counted as lost.
    pub late: u32,
}

impl FrameCounters {
    pub(super) fn count_lost(&mut self) {
        self.lost = self.lost.saturating_add(1);
    }

    pub(super) fn count_late(&mut self) {
        self.late = self.late.saturating_add(1);
    }
}

/// Counters of the exchange since start-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusCounters {
    /// Telegrams built.
    pub frames_sent: u32,
    /// Telegrams whose reply had not come when the next cycle began.
    pub frames_lost: u32,
    /// Replies that arrived in a later cycle; each was also counted as lost.
    pub frames_late: u32,
    /// Datagrams of watched slaves that came back with an unexpected working counter.
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
