//! The cyclic plan: what is exchanged each cycle, and whether it fits into the frames.
//!
//! The supervisor makes a plan, checks with [`CyclicPlan::check`] whether it can be exchanged, and passes it to the
//! critical side, which builds its frames from it.
//!
//! Invariant: each slave's data travel in separate datagrams, in every kind of exchange; a [`Dealer`] deals them out to the
//! frames for the check as for the exchange.

use super::acyclic::REGISTER_BYTES_MAX;
use super::driver::{Role, SlaveFactory};
use super::slave_set::SlaveSet;
use super::wire::{Address, Command, DATAGRAM_OVERHEAD, FRAME_LEN_MAX};
use heapless::Vec;

/// Most process data of one slave in one direction, bytes: 32, or 112 with the feature `long-process-data`.
pub const PROCESS_BYTES_MAX: usize = if cfg!(feature = "long-process-data") { 112 } else { 32 };
/// Longest stretch of logical memory that inputs and outputs of one slave may take together, bytes.
pub const SPAN_BYTES_MAX: usize = 2 * PROCESS_BYTES_MAX;
/// Bytes of the longest encapsulation: Ethernet, IPv4, UDP and EtherCAT headers.
pub(super) const HEADERS_LEN_MAX: usize = 14 + 20 + 8 + 2;
/// Bytes of the AL status register that are read each cycle.
pub(super) const AL_STATUS_LEN: usize = 2;

/// Bytes of the datagram that reads it.
pub(super) const STATUS_BYTES: usize = DATAGRAM_OVERHEAD + AL_STATUS_LEN;
/// Bytes of datagrams that a frame carries in any encapsulation.
const FRAME_BYTES: usize = FRAME_LEN_MAX - HEADERS_LEN_MAX;
/// Most slaves whose data the first frame carries: the first ones of the chain.
pub(super) const FIRST_FRAME_SLAVES_MAX: usize = 32;

/// Most values that the application wants of slaves without a driver.
pub const VALUES_MAX: usize = 16;

/// First bit of a wanted value in its slave's inputs or outputs, if the slave exchanges it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ValueBit(u16);

impl ValueBit {
    /// A value that no slave exchanges.
    pub const MISSING: Self = Self(u16::MAX);

    /// A value that begins at a bit.
    pub(super) const fn at(bit: u16) -> Self {
        Self(bit)
    }

    /// The bit; `None` for a value that no slave exchanges.
    pub const fn bit(self) -> Option<u16> {
        match self {
            Self::MISSING => None,
            Self(bit) => Some(bit),
        }
    }
}

impl Default for ValueBit {
    fn default() -> Self {
        Self::MISSING
    }
}

/// When inputs are read and outputs are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "lowercase"))]
pub enum ExchangeKind {
    /// Inputs at the start of the cycle, outputs after control in the same cycle.
    #[default]
    Split,
    /// Both at the start of the cycle; the outputs are those of the previous cycle.
    Combined,
}

/// One slave's share of the logical memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CyclicSlave<F: SlaveFactory> {
    /// Logical address of its inputs.
    pub input_address: u32,
    /// Bytes of its inputs, at most [`PROCESS_BYTES_MAX`]; 0 for none.
    pub input_length: u16,
    /// Logical address of its outputs.
    pub output_address: u32,
    /// Bytes of its outputs, at most [`PROCESS_BYTES_MAX`]; 0 for none.
    pub output_length: u16,
    /// Whether a missing answer is an error; false while the slave is being configured or known to be lost.
    pub watched: bool,
    /// What the application uses the slave for, if it is a member.
    pub role: Option<Role<F>>,
    /// Number of the slave's last configuration from INIT, wrapping: a new number means that it may have been switched
    /// off in between.
    pub generation: u8,
}

/// The reference clock: its time is read in each cycle, and written to the slaves behind it unless clocks before it are
/// being set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReferenceClock {
    /// Its station address.
    pub station: u16,
    /// Number of slaves that take part, including the reference: the expected working counter.
    pub slaves: u16,
    /// Whether all participating clocks have 64 bits; otherwise the low 32 bits are sent.
    pub wide: bool,
    /// Whether its time is written to the others; otherwise only the reference takes part.
    pub is_spread: bool,
    /// Number of the time, wrapping: with a new one the clocks have been set anew, without regard to the time before.
    pub time_number: u8,
    /// Period of the exchange, in units of [`Self::PERIOD_UNIT_NS`]: by as much the time goes on in a cycle in which the
    /// reference does not answer.
    pub period: u16,
}

impl ReferenceClock {
    /// Unit of the period, ns.
    pub const PERIOD_UNIT_NS: u32 = 200;

    /// A period in its unit, the nearest one.
    pub const fn period_of_ns(period_ns: u32) -> u16 {
        let periods = (period_ns + Self::PERIOD_UNIT_NS / 2) / Self::PERIOD_UNIT_NS;
        if periods > u16::MAX as u32 {
            u16::MAX
        } else {
            periods as u16
        }
    }

    pub(super) const fn length(&self) -> usize {
        if self.wide { 8 } else { 4 }
    }
}

/// Plan of the cyclic exchange; slaves in chain order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CyclicPlan<F: SlaveFactory, const SLAVES: usize> {
    /// The slaves; those without process data have lengths of 0.
    pub slaves: Vec<CyclicSlave<F>, SLAVES>,
    /// When inputs are read and outputs are written.
    pub exchange: ExchangeKind,
    /// The reference clock, if there is one.
    pub clock: Option<ReferenceClock>,
    /// AL status bits that come from slaves that are not in use.
    pub al_bits_ignored: u16,
    /// Places of the slaves that take part with their own process data, see
    /// [`BusSetup::terminals`](super::event::BusSetup::terminals).
    pub terminals: SlaveSet,
    /// Longest data of an acyclic datagram for which the first frame has to have room, bytes.
    pub message: u16,
    /// Where the values are that the application wants ([`BusSetup::values`](super::event::BusSetup::values)).
    pub values: [ValueBit; VALUES_MAX],
}

/// Why a plan cannot be exchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlanError {
    /// A slave has too much process data in one direction.
    ProcessData {
        /// Place in the chain, from 0.
        slave: u8,
        /// Most bytes allowed.
        expected: u16,
        /// Bytes planned.
        actual: u16,
    },
    /// Inputs and outputs of a slave lie too far apart for one datagram.
    Span {
        /// Place in the chain, from 0.
        slave: u8,
        /// Longest stretch allowed, bytes.
        expected: u32,
        /// Planned length, bytes.
        actual: u32,
    },
    /// The cyclic datagrams and an acyclic datagram of [`CyclicPlan::message`] bytes do not fit into the frames.
    Room {
        /// Bytes that a frame carries.
        expected: usize,
        /// Bytes that the datagrams of the last frame would take.
        actual: usize,
    },
}

impl<F: SlaveFactory, const SLAVES: usize> CyclicPlan<F, SLAVES> {
    /// Checks that the plan can be exchanged in any encapsulation, in at most `frames` frames in each direction.
    ///
    /// # Errors
    /// The first [`PlanError`] found. Slaves without a valid share, and those beyond the end of the last frame, are not
    /// exchanged; acyclic datagrams that do not fit are answered by
    /// [`Outcome::NoRoom`](super::acyclic::Outcome::NoRoom).
    pub fn check(&self, frames: usize) -> Result<(), PlanError> {
        for (number, slave) in (0..).zip(&self.slaves) {
            slave.check(number, self.exchange)?;
        }
        let (mut firsts, mut seconds) = self.dealers(frames);
        for (number, slave) in (0..).zip(&self.slaves) {
            if let Some(window) = slave.first_window(self.exchange) {
                firsts.frame(number, &window);
            }
            if let Some(window) = slave.second_window(self.exchange) {
                seconds.frame(number, &window);
            }
        }
        let actual = firsts.used.max(seconds.used);
        if actual > FRAME_BYTES {
            return Err(PlanError::Room {
                expected: FRAME_BYTES,
                actual,
            });
        }
        Ok(())
    }

    /// Deals out the datagrams of the cycle's start, and those after control.
    pub(super) fn dealers(&self, frames: usize) -> (Dealer, Dealer) {
        let clock = self.clock.map_or(0, |clock| DATAGRAM_OVERHEAD + clock.length());
        let message = match frames {
            0 | 1 => usize::from(self.message),
            // The first frame is not filled so far that nothing is left for the slow side.
            _ => usize::from(self.message).max(REGISTER_BYTES_MAX),
        };
        let used = STATUS_BYTES + clock + DATAGRAM_OVERHEAD + message;
        let dealer = |used| Dealer { frames, frame: 0, used };
        (dealer(used), dealer(0))
    }
}

/// Deals the slaves' datagrams of one direction out to frames, in chain order. What no frame has room for goes to the last.
#[derive(Debug)]
pub(super) struct Dealer {
    frames: usize,
    frame: usize,
    /// Bytes of datagrams in the present frame.
    used: usize,
}

impl Dealer {
    /// Number of the frame, from 0, that carries the datagram of the slave at a place in the chain.
    pub(super) fn frame(&mut self, place: u8, window: &Window) -> usize {
        let length = DATAGRAM_OVERHEAD + usize::from(window.length);
        let is_beyond = self.frame == 0 && usize::from(place) >= FIRST_FRAME_SLAVES_MAX;
        if (is_beyond || self.used + length > FRAME_BYTES) && self.frame + 1 < self.frames {
            (self.frame, self.used) = (self.frame + 1, 0);
        }
        self.used += length;
        self.frame
    }
}

/// One slave's datagram, and the places of its inputs and outputs in the data.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    pub(super) command: Command,
    pub(super) address: Address,
    pub(super) length: u16,
    pub(super) working_counter: u16,
    pub(super) input_offset: u16,
    pub(super) input_length: u16,
    pub(super) output_offset: u16,
    pub(super) output_length: u16,
}

impl<F: SlaveFactory> CyclicSlave<F> {
    /// Lowest logical address and length of inputs and outputs together.
    const fn span(&self) -> (u32, u32) {
        let (low, high) = if self.input_address < self.output_address {
            (self.input_address, self.output_address)
        } else {
            (self.output_address, self.input_address)
        };
        let (low_length, high_length) = if self.input_address < self.output_address {
            (self.input_length as u32, self.output_length as u32)
        } else {
            (self.output_length as u32, self.input_length as u32)
        };
        let end = (high - low).saturating_add(high_length);
        (low, if end > low_length { end } else { low_length })
    }

    fn check(&self, slave: u8, kind: ExchangeKind) -> Result<(), PlanError> {
        let longest = self.input_length.max(self.output_length);
        if usize::from(longest) > PROCESS_BYTES_MAX {
            return Err(PlanError::ProcessData {
                slave,
                expected: PROCESS_BYTES_MAX as u16,
                actual: longest,
            });
        }
        let (_, actual) = self.span();
        let both = kind == ExchangeKind::Combined && self.input_length > 0 && self.output_length > 0;
        if both && actual > SPAN_BYTES_MAX as u32 {
            return Err(PlanError::Span {
                slave,
                expected: SPAN_BYTES_MAX as u32,
                actual,
            });
        }
        Ok(())
    }

    fn inputs(&self) -> Option<Window> {
        (self.input_length > 0).then_some(Window {
            command: Command::Lrd,
            address: Address::logical(self.input_address),
            length: self.input_length,
            working_counter: 1,
            input_offset: 0,
            input_length: self.input_length,
            output_offset: 0,
            output_length: 0,
        })
    }

    fn outputs(&self) -> Option<Window> {
        (self.output_length > 0).then_some(Window {
            command: Command::Lwr,
            address: Address::logical(self.output_address),
            length: self.output_length,
            working_counter: 1,
            input_offset: 0,
            input_length: 0,
            output_offset: 0,
            output_length: self.output_length,
        })
    }

    fn both(&self) -> Window {
        let (start, length) = self.span();
        Window {
            command: Command::Lrw,
            address: Address::logical(start),
            length: length as u16,
            working_counter: 3,
            input_offset: (self.input_address - start) as u16,
            input_length: self.input_length,
            output_offset: (self.output_address - start) as u16,
            output_length: self.output_length,
        }
    }

    /// The slave's datagram at the start of a cycle; `None` if it has none or its share is invalid.
    pub(super) fn first_window(&self, kind: ExchangeKind) -> Option<Window> {
        self.check(0, kind).ok()?;
        match kind {
            ExchangeKind::Split => self.inputs(),
            ExchangeKind::Combined if self.input_length == 0 => self.outputs(),
            ExchangeKind::Combined if self.output_length == 0 => self.inputs(),
            ExchangeKind::Combined => Some(self.both()),
        }
    }

    /// The slave's datagram after control; `None` if it has none or its share is invalid.
    pub(super) fn second_window(&self, kind: ExchangeKind) -> Option<Window> {
        self.check(0, kind).ok()?;
        match kind {
            ExchangeKind::Split => self.outputs(),
            ExchangeKind::Combined => None,
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use crate::no_drivers::NoDrivers;

    fn plan(slaves: usize, length: u16, exchange: ExchangeKind, message: u16) -> CyclicPlan<NoDrivers, 64> {
        let slaves = (0..slaves as u32).map(|number| CyclicSlave {
            input_address: 0x1000 + 64 * number,
            input_length: length,
            output_address: 0x1000 + 64 * number + u32::from(length),
            output_length: length,
            ..CyclicSlave::default()
        });
        CyclicPlan {
            slaves: slaves.collect(),
            exchange,
            message,
            clock: Some(ReferenceClock {
                station: 0x1001,
                slaves: 4,
                wide: true,
                is_spread: true,
                time_number: 0,
                period: ReferenceClock::period_of_ns(1_000_000),
            }),
            ..CyclicPlan::default()
        }
    }

    #[test]
    fn four_drives_leave_room_for_a_mailbox_of_1024_bytes_and_too_many_do_not() {
        for kind in [ExchangeKind::Split, ExchangeKind::Combined] {
            assert_eq!(plan(4, 32, kind, 1024).check(1), Ok(()));
        }
        // 16 datagrams of 44 bytes, AL status, clock and the message.
        assert_eq!(
            plan(16, 32, ExchangeKind::Split, 1024).check(1),
            Err(PlanError::Room {
                expected: 1470,
                actual: 16 * 44 + 14 + 20 + 1036
            })
        );
        assert_eq!(plan(32, 32, ExchangeKind::Split, 4).check(1), Ok(()));
        assert!(plan(32, 32, ExchangeKind::Combined, 4).check(1).is_err());
    }

    /// The frame of each slave's datagram of the cycle's start.
    fn dealt(plan: &CyclicPlan<NoDrivers, 64>, frames: usize) -> std::vec::Vec<usize> {
        let (mut firsts, _) = plan.dealers(frames);
        let windows = (0..).zip(&plan.slaves);
        windows
            .filter_map(|(number, slave)| Some(firsts.frame(number, &slave.first_window(plan.exchange)?)))
            .collect()
    }

    #[test]
    fn what_one_frame_does_not_hold_is_dealt_out_to_several_in_chain_order() {
        // 76 bytes a slave. The first frame keeps 14 + 20 + 12 + 1,024 bytes for others, and so has room for five slaves;
        // each other one holds 19.
        let full = plan(64, 32, ExchangeKind::Combined, 1024);
        let numbers = [5, 19, 19, 19, 2];
        let expected = numbers.iter().enumerate();
        let expected: std::vec::Vec<usize> = expected
            .flat_map(|(frame, slaves)| core::iter::repeat_n(frame, *slaves))
            .collect();
        assert_eq!((full.check(5), dealt(&full, 5)), (Ok(()), expected));
        let error = PlanError::Room {
            expected: 1470,
            actual: 21 * 76,
        };
        assert_eq!(full.check(4), Err(error));
        // Small data stay in one frame up to 32 slaves.
        let small = plan(64, 1, ExchangeKind::Split, 0);
        let frames = dealt(&small, 2);
        assert_eq!(small.check(2), Ok(()));
        assert!((0..64).all(|slave| frames[slave] == slave / 32), "{frames:?}");
        // One frame that is enough is used alone.
        assert!(
            dealt(&plan(19, 16, ExchangeKind::Combined, 128), 5)
                .iter()
                .all(|frame| *frame == 0)
        );
    }

    #[test]
    fn shares_that_are_too_long_or_too_far_apart_are_refused() {
        let error = PlanError::ProcessData {
            slave: 0,
            expected: PROCESS_BYTES_MAX as u16,
            actual: PROCESS_BYTES_MAX as u16 + 1,
        };
        assert_eq!(
            plan(1, PROCESS_BYTES_MAX as u16 + 1, ExchangeKind::Split, 0).check(1),
            Err(error)
        );
        let mut apart = plan(2, 8, ExchangeKind::Split, 0);
        apart.slaves[1].input_address = 0;
        assert_eq!(apart.check(1), Ok(()));
        apart.exchange = ExchangeKind::Combined;
        let error = PlanError::Span {
            slave: 1,
            expected: SPAN_BYTES_MAX as u32,
            actual: 0x1000 + 64 + 16,
        };
        assert_eq!(apart.check(1), Err(error));
        let mut outputs_only = apart.clone();
        outputs_only.slaves[1].input_length = 0;
        assert_eq!(outputs_only.check(1), Ok(()), "nothing is apart");
        apart.slaves[1].output_address = u32::MAX;
        assert!(apart.check(1).is_err());
        assert!(apart.slaves[1].first_window(ExchangeKind::Combined).is_none());
    }

    #[test]
    fn a_combined_datagram_covers_both_directions_in_any_order() {
        let slave = CyclicSlave::<NoDrivers> {
            input_address: 0x100,
            input_length: 8,
            output_address: 0x108,
            output_length: 6,
            ..CyclicSlave::default()
        };
        let window = slave.first_window(ExchangeKind::Combined).unwrap();
        assert_eq!(
            (window.address.0, window.length, window.working_counter),
            (0x100, 14, 3)
        );
        assert_eq!((window.input_offset, window.output_offset), (0, 8));
        let same = CyclicSlave {
            output_address: 0x100,
            ..slave
        };
        let window = same.first_window(ExchangeKind::Combined).unwrap();
        assert_eq!((window.length, window.input_offset, window.output_offset), (8, 0, 0));
        let only = CyclicSlave {
            input_length: 0,
            ..slave
        };
        let window = only.first_window(ExchangeKind::Combined).unwrap();
        assert_eq!((window.command, window.working_counter), (Command::Lwr, 1));
    }
}
