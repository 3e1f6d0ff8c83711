use super::*;
use std::vec::Vec;

/// Basic status: the negotiation has finished.
const NEGOTIATED: u16 = 1 << 5;

/// A management bus with at most one PHY, whose transactions last a number of steps.
struct Bus {
    phy_at: Option<u8>,
    status: u16,
    steps: u8,
    hangs: bool,
    left: u8,
    value: u16,
    written: Vec<(u8, u16)>,
    started: usize,
}

impl Bus {
    fn with_phy_at(address: u8) -> Self {
        Self {
            phy_at: Some(address),
            status: 0,
            steps: 1,
            hangs: false,
            left: 0,
            value: 0,
            written: Vec::new(),
            started: 0,
        }
    }

    fn begin(&mut self, value: u16) {
        assert_eq!(self.left, 0, "a transaction was started on a busy bus");
        self.left = self.steps;
        self.value = value;
        self.started += 1;
    }
}

impl Management for Bus {
    fn start_read(&mut self, address: u8, register: u8) {
        assert!(address < ADDRESSES);
        let value = match register {
            _ if self.phy_at != Some(address) => u16::MAX,
            IDENTIFIER_1 => 0x0007,
            BASIC_STATUS => self.status,
            other => panic!("register {other} was read"),
        };
        self.begin(value);
    }

    fn start_write(&mut self, address: u8, register: u8, value: u16) {
        assert_eq!(self.phy_at, Some(address));
        self.written.push((register, value));
        self.begin(0);
    }

    fn result(&mut self) -> Option<u16> {
        if self.hangs {
            self.left = 0;
            return None;
        }
        self.left = self.left.saturating_sub(1);
        (self.left == 0).then_some(self.value)
    }
}

fn run(phy: &mut Phy, bus: &mut Bus, steps: usize) -> Vec<Event> {
    (0..steps).filter_map(|_| phy.step(bus)).collect()
}

/// More than a whole search takes.
const SEARCH_STEPS: usize = 5 * ADDRESSES as usize;

#[test]
fn a_phy_is_found_at_any_address_and_offers_full_duplex_alone() {
    for address in [0, 1, 17, ADDRESSES - 1] {
        let mut bus = Bus::with_phy_at(address);
        bus.status = LINK_UP | NEGOTIATED;
        let mut phy = Phy::new();
        let events = run(&mut phy, &mut bus, SEARCH_STEPS);
        assert_eq!(events, [Event::Found(address), Event::LinkUp]);
        assert_eq!(bus.written, [(4, 0x0101), (0, 0x1200)]);
        assert!(phy.link_is_up());
    }
}

#[test]
fn a_missing_phy_is_searched_for_ever_without_an_event() {
    let mut bus = Bus::with_phy_at(0);
    bus.phy_at = None;
    let mut phy = Phy::new();
    assert_eq!(run(&mut phy, &mut bus, 10 * SEARCH_STEPS), []);
    assert!(!phy.link_is_up());
    bus.phy_at = Some(3);
    assert_eq!(run(&mut phy, &mut bus, SEARCH_STEPS), [Event::Found(3)]);
}

#[test]
fn a_partner_that_does_not_negotiate_has_a_link_all_the_same() {
    let mut bus = Bus::with_phy_at(0);
    let mut phy = Phy::new();
    assert_eq!(run(&mut phy, &mut bus, SEARCH_STEPS), [Event::Found(0)]);
    // Parallel detection: the partner's signal is there, the negotiation never finishes.
    bus.status = LINK_UP;
    assert_eq!(run(&mut phy, &mut bus, SEARCH_STEPS), [Event::LinkUp]);
    // A negotiation that has finished is no link: the cable was pulled afterwards.
    bus.status = NEGOTIATED;
    assert_eq!(run(&mut phy, &mut bus, SEARCH_STEPS), [Event::LinkDown]);
}

#[test]
fn a_pulled_cable_is_seen_within_two_polls() {
    let mut bus = Bus::with_phy_at(0);
    bus.status = LINK_UP | NEGOTIATED;
    let mut phy = Phy::new();
    run(&mut phy, &mut bus, SEARCH_STEPS);
    bus.status = 0;
    let polls = 2 * (usize::from(POLL_PERIOD_STEPS) + 2);
    assert_eq!(run(&mut phy, &mut bus, polls), [Event::LinkDown]);
    bus.status = LINK_UP | NEGOTIATED;
    assert_eq!(run(&mut phy, &mut bus, polls), [Event::LinkUp]);
}

#[test]
fn a_phy_that_dies_takes_the_link_down_and_is_configured_again_when_it_returns() {
    let mut bus = Bus::with_phy_at(5);
    bus.status = LINK_UP | NEGOTIATED;
    let mut phy = Phy::new();
    run(&mut phy, &mut bus, SEARCH_STEPS);
    bus.phy_at = None;
    assert_eq!(run(&mut phy, &mut bus, SEARCH_STEPS), [Event::Lost]);
    assert!(!phy.link_is_up());
    bus.phy_at = Some(5);
    bus.written.clear();
    assert_eq!(
        run(&mut phy, &mut bus, 2 * SEARCH_STEPS),
        [Event::Found(5), Event::LinkUp]
    );
    assert_eq!(bus.written.len(), 2);
}

#[test]
fn an_interface_that_never_ends_a_transaction_is_given_up_and_recovers() {
    let mut bus = Bus::with_phy_at(0);
    bus.status = LINK_UP | NEGOTIATED;
    let mut phy = Phy::new();
    run(&mut phy, &mut bus, SEARCH_STEPS);
    bus.hangs = true;
    assert_eq!(run(&mut phy, &mut bus, SEARCH_STEPS), [Event::Lost]);
    bus.hangs = false;
    assert_eq!(
        run(&mut phy, &mut bus, 2 * SEARCH_STEPS),
        [Event::Found(0), Event::LinkUp]
    );
}

#[test]
fn a_slow_transaction_is_waited_for_and_the_bus_rests_between_polls() {
    let mut bus = Bus::with_phy_at(0);
    bus.steps = TRANSACTION_STEPS_MAX - 1;
    bus.status = LINK_UP | NEGOTIATED;
    let mut phy = Phy::new();
    assert_eq!(run(&mut phy, &mut bus, SEARCH_STEPS), [Event::Found(0), Event::LinkUp]);
    bus.started = 0;
    run(&mut phy, &mut bus, 100);
    assert!(
        bus.started <= 100 / usize::from(POLL_PERIOD_STEPS),
        "{} transactions",
        bus.started
    );
}
