//! A PHY on the management interface, driven without waiting: one transaction at a time.
//!
//! A register access takes some 30 us on the wire. Each step collects the result of the previous step's transaction and
//! starts the next one, so no step blocks, a missing PHY does no harm, and a PHY that returns is found again. The PHY
//! offers only 100 Mbit/s full duplex, which EtherCAT requires, so a MAC set to it always agrees. A partner that does not
//! negotiate is recognised by its signal (parallel detection): the link is up, although the negotiation never finishes.
//!
//! Registers: IEEE 802.3 clause 22; independent of the type of PHY.

use crate::board::PortState;

/// Addresses on the management bus.
pub const ADDRESSES: u8 = 32;
/// Steps between two checks of the link.
pub const POLL_PERIOD_STEPS: u8 = 10;
/// Steps after which a transaction counts as lost.
pub const TRANSACTION_STEPS_MAX: u8 = 5;

const BASIC_CONTROL: u8 = 0;
const BASIC_STATUS: u8 = 1;
const IDENTIFIER_1: u8 = 2;
const ADVERTISEMENT: u8 = 4;

/// Enable and restart auto-negotiation.
const NEGOTIATE: u16 = 1 << 12 | 1 << 9;
/// 100BASE-TX full duplex, selector IEEE 802.3.
const FULL_DUPLEX_100: u16 = 1 << 8 | 1;
const LINK_UP: u16 = 1 << 2;

/// The management interface of a MAC: clause 22 transactions that run in hardware.
pub trait Management {
    /// Starts to read `register` (0 to 31) of the PHY at `address` (0 to 31).
    fn start_read(&mut self, address: u8, register: u8);
    /// Starts to write `value` to `register` of the PHY at `address`.
    fn start_write(&mut self, address: u8, register: u8, value: u16);
    /// Value read by the last transaction, once it has ended; any value after a write.
    fn result(&mut self) -> Option<u16>;
}

/// Result of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A PHY answers at this address.
    Found(u8),
    /// The PHY no longer answers; the link is down.
    Lost,
    /// The link came up.
    LinkUp,
    /// The link went down.
    LinkDown,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    /// Reads the identifier at one address after the other.
    Searching,
    Advertising,
    Negotiating,
    /// Reading the status.
    Polling,
    /// Number of steps until the next check.
    Resting(u8),
}

/// The PHY's state machine.
pub struct Phy {
    state: State,
    address: u8,
    link_is_up: bool,
    /// Steps since the current transaction was started; `None` without a transaction.
    waited: Option<u8>,
}

impl Default for Phy {
    fn default() -> Self {
        Self::new()
    }
}

impl Phy {
    /// A state machine that knows no PHY yet: the first steps search for one from address 0 on.
    pub const fn new() -> Self {
        Self {
            state: State::Searching,
            address: 0,
            link_is_up: false,
            waited: None,
        }
    }

    /// Whether the link was up at the last check.
    pub const fn link_is_up(&self) -> bool {
        self.link_is_up
    }

    /// Known state of the port.
    pub fn port(&self) -> PortState {
        match (self.state, self.link_is_up) {
            (State::Searching, _) => PortState::NoPhy,
            (_, true) => PortState::Up,
            (_, false) => PortState::Down,
        }
    }

    /// One step, at most one register access; call it every millisecond.
    pub fn step(&mut self, bus: &mut impl Management) -> Option<Event> {
        let Some(waited) = self.waited else {
            self.start(bus);
            return None;
        };
        let Some(value) = bus.result() else {
            self.waited = Some(waited + 1);
            return if waited + 1 < TRANSACTION_STEPS_MAX {
                None
            } else {
                self.search_next()
            };
        };
        self.waited = None;
        self.finish(value)
    }

    /// Starts the transaction of the present state.
    fn start(&mut self, bus: &mut impl Management) {
        match self.state {
            State::Searching => bus.start_read(self.address, IDENTIFIER_1),
            State::Advertising => bus.start_write(self.address, ADVERTISEMENT, FULL_DUPLEX_100),
            State::Negotiating => bus.start_write(self.address, BASIC_CONTROL, NEGOTIATE),
            State::Polling | State::Resting(0) => bus.start_read(self.address, BASIC_STATUS),
            State::Resting(steps) => {
                self.state = State::Resting(steps - 1);
                return;
            }
        }
        self.waited = Some(0);
    }

    /// Takes the result of the present state's transaction.
    fn finish(&mut self, value: u16) -> Option<Event> {
        // The data line is pulled up: an address without a PHY reads as ones. No identifier is zero.
        let answers = value != u16::MAX;
        match self.state {
            State::Searching if !answers || value == 0 => self.search_next(),
            State::Searching => {
                self.state = State::Advertising;
                Some(Event::Found(self.address))
            }
            State::Advertising => {
                self.state = State::Negotiating;
                None
            }
            State::Negotiating => {
                self.state = State::Polling;
                None
            }
            State::Polling | State::Resting(_) if !answers => self.search_next(),
            State::Polling | State::Resting(_) => {
                self.state = State::Resting(POLL_PERIOD_STEPS);
                self.set_link(value & LINK_UP != 0)
            }
        }
    }

    fn set_link(&mut self, up: bool) -> Option<Event> {
        if self.link_is_up == up {
            return None;
        }
        self.link_is_up = up;
        Some(if up { Event::LinkUp } else { Event::LinkDown })
    }

    /// Leaves the present address and continues with the next.
    fn search_next(&mut self) -> Option<Event> {
        let was_known = self.state != State::Searching;
        *self = Self {
            address: (self.address + 1) % ADDRESSES,
            ..Self::new()
        };
        was_known.then_some(Event::Lost)
    }
}

#[cfg(test)]
mod tests;
