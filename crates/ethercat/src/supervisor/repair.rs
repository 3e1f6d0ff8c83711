//! Repair: brings one slave back into use while the others continue.
//!
//! A slave may have kept its address and only left OP; if it was away, it is identified again, as another one may have that
//! address. Or it was switched off and is in INIT without an address: at its
//! old place, or at another place if a slave was plugged in or is still missing before it. The order of the slaves that
//! kept their addresses shows between which of them it belongs. Or it returned at another's place, was taken for an extra
//! slave there, and was put back with power: its serial number shows that.
//!
//! Invariant: a slave is only taken back at its place in the order, with the expected product, and with a serial number
//! that does not belong to another slave of this bus.

use super::super::clock;
use super::super::configure::discovery::{STATION_BASE, STATION_TEMPORARY};
use super::super::configure::identification::KnownIdentity;
use super::super::configure::{discovery, information};
use super::super::driver::SlaveFactory;
use super::super::error::{BusError, IdentityProperty};
use super::super::event::Step;
use super::super::slave::{Condition, Slave, SlaveData};
use super::super::slave_set::SlaveSet;
use super::super::state::{self, AlReport, AlState};
use super::super::wire::sii::{FixedPart, Identity};
use super::Failure;
use super::bus::Bus;
use core::ops::Range;
use heapless::Vec;

/// Most places of a chain that are searched.
pub(super) const PLACES_MAX: usize = 64;

/// Difference of a clock from the distributed time that its control loop removes within a second, ns.
const NEAR_NS: u32 = 20_000;
/// How often a chain that changes meanwhile is read.
const SETTLED_TRIES_MAX: u32 = 5;

/// The station addresses along the chain; 0 where a slave has none.
pub(super) type Places = Vec<u16, PLACES_MAX>;

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> Bus<'_, F, SLAVES, MESSAGE> {
    /// Brings a slave in use back to OP.
    pub(super) async fn repair(&mut self, number: usize) -> Result<(), Failure> {
        let Some(slave) = self.slaves.get(number).copied() else {
            return Ok(());
        };
        let (station, at) = (slave.station(), |step| Failure::of(slave.position, step));
        let mut places = self.places().await.map_err(at(Step::Locate))?;
        let returned = match slave.condition == Condition::Returned && places.contains(&station) {
            true => self.identify_returned(number).await.map_err(at(Step::Identify))?,
            false => Returned::Same,
        };
        if returned == Returned::Other {
            places = self.places().await.map_err(at(Step::Locate))?;
        }
        match places.iter().position(|there| *there == station) {
            Some(place) => {
                self.is_in_order(&places, place, number).map_err(at(Step::Locate))?;
                if slave.is_refused_terminal() {
                    self.read_again(number).await.map_err(at(Step::Identify))?;
                } else if returned == Returned::Same
                    && !self.clocks.is_unknown(number)
                    && self.resume(number).await.is_ok()
                {
                    return Ok(());
                }
            }
            None => self.take_back(number, &places).await?,
        }
        let configured = self.configure_again(number).await;
        if let Some(slave) = self.slaves.get_mut(number)
            && configured.is_err()
            && !slave.is_terminal
        {
            // What was read of it may be wrong: the next repair identifies it again.
            slave.condition = Condition::Returned;
        }
        configured
    }

    /// Brings a slave to OP through INIT.
    async fn configure_again(&mut self, number: usize) -> Result<(), Failure> {
        let at = |step| Failure::of(number as u16, step);
        // Whatever ends this, the slave is not resumed with its clock set and its sync signals stopped.
        self.change_state(number, AlState::Init, Step::Init).await?;
        self.adapt_exchange(number).await.map_err(at(Step::Identify))?;
        if let Some(slave) = self.slaves.get_mut(number) {
            slave.report = Default::default();
        }
        self.recognise(number).await?;
        self.restore_clock(number).await.map_err(at(Step::Clocks))?;
        self.reach_safe_operational(number).await?;
        self.send_plan().await;
        self.reach_operational(number).await
    }

    /// Which slave answers at the address of a lost one: masters give the same addresses, so one that comes from another bus with
    /// power may have it. Another one loses the address.
    ///
    /// # Errors
    /// The slave cannot be read in INIT either.
    pub(super) async fn identify_returned(&mut self, number: usize) -> Result<Returned, BusError> {
        let Some(slave) = self.slaves.get(number).copied() else {
            return Ok(Returned::Same);
        };
        let station = slave.station();
        if self.compares_switches() {
            // Above PREOP it may not tell its number.
            self.go_to_init(number).await?;
        }
        let fixed = self.fixed_part_again(station).await?;
        let checked = match self.is_same(&slave, &fixed.identity) {
            Ok(()) => self.check_returned(number, station, fixed.identity).await,
            Err(error) => Err(error),
        };
        let known = match checked {
            Ok(known) => known,
            Err(BusError::Identity { .. } | BusError::WrongSlave { .. }) => {
                self.make_stranger(station).await?;
                return Ok(Returned::Other);
            }
            Err(error) => return Err(error),
        };
        information::give_to_slave(&mut self.port, station).await;
        // Another one, or what was read before was wrong.
        let is_new = fixed != slave.fixed;
        if is_new {
            // Whatever ends this repair, the slave is not resumed with the settings that it came with.
            self.go_to_init(number).await?;
            self.clocks.was_off(number);
            self.take_place(number, fixed, known);
        }
        if let Some(slave) = self.slaves.get_mut(number) {
            slave.condition = Condition::LeftOperational;
        }
        Ok(if is_new { Returned::Equal } else { Returned::Same })
    }

    /// Reads the information memory of a terminal that was refused or could not be read: what was read before may have been
    /// damaged. Compares its identity with what is expected.
    pub(super) async fn read_again(&mut self, number: usize) -> Result<(), BusError> {
        let Some(station) = self.slaves.get(number).map(Slave::station) else {
            return Ok(());
        };
        let fixed = information::fixed_part(&mut self.port, station).await?;
        let known = self.check_returned(number, station, fixed.identity).await?;
        if let Some(slave) = self.slaves.get_mut(number) {
            (slave.fixed, slave.known) = (fixed, known);
        }
        Ok(())
    }

    /// The station addresses along the chain. Removes temporary ones, which interrupted work has left, and those that two
    /// slaves have: frames with such an address are taken by both.
    pub(super) async fn places(&mut self) -> Result<Places, BusError> {
        let mut places = self.settled_places().await?;
        if places.contains(&STATION_TEMPORARY) {
            discovery::clear_fmmus(&mut self.port, STATION_TEMPORARY).await?;
            self.name(0).await?;
        }
        for station in places.iter_mut().filter(|station| **station == STATION_TEMPORARY) {
            *station = 0;
        }
        for _ in 0..PLACES_MAX {
            let Some(station) = twice(&places) else { break };
            self.make_stranger(station).await?;
            places = self.settled_places().await?;
        }
        Ok(places)
    }

    /// Takes mapping and address from the slave, or the slaves, that have a station address, each by its place.
    pub(super) async fn make_stranger(&mut self, station: u16) -> Result<(), BusError> {
        let mut places = self.settled_places().await?;
        for place in 0..places.len() {
            if places.get(place) == Some(&station) {
                self.mark(place as u16, &places).await?;
                self.name(0).await?;
                if let Some(there) = places.get_mut(place) {
                    *there = 0;
                }
            }
        }
        Ok(())
    }

    /// The station addresses along a chain that has not changed while they were read.
    pub(super) async fn settled_places(&mut self) -> Result<Places, BusError> {
        let mut places = Places::new();
        let mut found = discovery::count(&mut self.port).await?;
        for _ in 0..SETTLED_TRIES_MAX {
            if usize::from(found) > PLACES_MAX {
                return Err(BusError::TooManySlaves {
                    expected: PLACES_MAX as u16,
                    actual: found,
                });
            }
            discovery::stations(&mut self.port, found, &mut places).await?;
            let before = found;
            found = discovery::count(&mut self.port).await?;
            if found == before {
                return Ok(places);
            }
        }
        Err(BusError::SlaveCount {
            expected: places.len() as u16,
            actual: found,
        })
    }

    /// The number of the slave with a station address, if it belongs to this bus.
    pub(super) fn number_of(&self, station: u16) -> Option<usize> {
        let number = usize::from(station.checked_sub(STATION_BASE)?);
        (number < self.slaves.len()).then_some(number)
    }

    /// Finds a slave that lost its address, checks its identity, and assigns its address.
    async fn take_back(&mut self, number: usize, places: &Places) -> Result<(), Failure> {
        let Some(slave) = self.slaves.get(number).copied() else {
            return Ok(());
        };
        let at = |step| Failure::of(slave.position, step);
        // Extra slaves beside it may be any others, or one of them may be the lost one: then only its own serial number tells.
        let beside = match self.take_back_extra(number, places).await {
            Ok(true) => return Ok(()),
            Ok(false) => None,
            Err(error) => Some(error),
        };
        let strangers = self.strangers_between(number, places);
        let missing = self.missing_between(number, places);
        // With all of them there, each has to be at its place.
        let is_elsewhere = strangers.len() != missing.len();
        let by_order = self.rank_among(&strangers, &missing, number, places);
        let mut other = None;
        for (rank, place) in strangers.iter().enumerate() {
            let is_its_place = by_order.is_none_or(|wanted| wanted == rank);
            let fixed = self.identify(*place, places).await.map_err(at(Step::Identify))?;
            let is_told = match slave.is_refused_terminal() {
                // What was read of it may be wrong: only its place tells, unless the one there is a missing neighbour.
                true => by_order.is_some() && !(is_elsewhere && self.is_another(number, &missing, &fixed.identity)),
                // At the end of a cut chain, a slave with another serial number may be in the place of any that is missing.
                false => {
                    let is_new = is_elsewhere && has_other_serial(&slave, &fixed.identity);
                    (by_order.is_some() && !is_new) || self.is_only_one(&slave, &missing)
                }
            };
            let is_known = is_its_place && is_told && beside.is_none();
            let may_be_here = is_elsewhere || (is_its_place && beside.is_some());
            let mut same = self.is_same(&slave, &fixed.identity).map(|()| slave.known);
            if same.is_ok() && is_its_place {
                same = self.check_returned(number, STATION_TEMPORARY, fixed.identity).await;
            }
            match same {
                Ok(known) if is_known || (may_be_here && has_serial_of(&slave, &fixed.identity)) => {
                    self.confirm_mark(*place, places).await.map_err(at(Step::Identify))?;
                    self.clocks.was_off(number);
                    self.take_place(number, fixed, known);
                    return self.name(slave.station()).await.map_err(at(Step::Address));
                }
                Err(error) if is_its_place => other = Some(error),
                _ => {}
            }
            self.name(0).await.map_err(at(Step::Identify))?;
        }
        match other.or(beside) {
            Some(error) => Err(at(Step::Identify)(error)),
            None => Err(at(Step::Locate)(BusError::SlaveCount {
                expected: self.slaves.len() as u16,
                actual: places.len() as u16,
            })),
        }
    }

    /// Gives the lost one's address to the extra slave between its neighbours that has its serial number, if there is one: it
    /// returned at another place, where it got a number of its own, and was then put back with power. What is known of extra
    /// slaves may be old: the next one of a product gets the number of one that has gone.
    ///
    /// # Errors
    /// An extra slave there cannot be read, or another one is in the place of a member.
    async fn take_back_extra(&mut self, number: usize, places: &Places) -> Result<bool, BusError> {
        let is_told = |slave: &Slave<F>| slave.identity().serial != 0;
        let Some(lost) = self.slaves.get(number).copied().filter(is_told) else {
            return Ok(false);
        };
        let between = places.get(self.between(number, places)).unwrap_or_default();
        let mut other = None;
        for extra in self.ordered.max(number + 1)..self.slaves.len() {
            let may_be = |slave: &&Slave<F>| {
                !slave.is_used() && between.contains(&slave.station()) && slave.is_of_product(&lost.identity())
            };
            let Some(station) = self.slaves.get(extra).filter(may_be).map(Slave::station) else {
                continue;
            };
            let read = self.fixed_part_again(station).await;
            information::give_to_slave(&mut self.port, station).await;
            match read {
                Ok(fixed) if has_serial_of(&lost, &fixed.identity) && lost.is_of_product(&fixed.identity) => {
                    self.give_place(number, extra, fixed).await?;
                    return Ok(true);
                }
                Ok(fixed) => {
                    self.take_place(extra, fixed, KnownIdentity::default());
                    other = other.or(self.is_wrong_there(&lost, &fixed.identity, places));
                }
                Err(error) => other = other.or(Some(error)),
            }
        }
        other.map_or(Ok(false), Err)
    }

    /// The error of an extra slave that stands before the next known one, where a member is missing: it may have been put into
    /// the member's place with power. Behind the last one there may be any others.
    fn is_wrong_there(&self, lost: &Slave<F>, found: &Identity, places: &Places) -> Option<BusError> {
        let number = usize::from(lost.position);
        let mut ranks = places.iter().filter_map(|station| self.rank_of(*station));
        let is_certain = lost.member.is_some() && has_other_serial(lost, found) && ranks.any(|rank| rank > number);
        is_certain.then_some(BusError::WrongSlave {
            property: IdentityProperty::Serial,
            expected: lost.identity().serial,
            actual: found.serial,
            other: None,
        })
    }

    /// Gives an extra slave the place of the lost one that it is.
    async fn give_place(&mut self, number: usize, extra: usize, fixed: FixedPart) -> Result<(), BusError> {
        let stations = [number, extra].map(|number| STATION_BASE.wrapping_add(number as u16));
        let known = self.check_returned(number, stations[1], fixed.identity).await?;
        discovery::rename(&mut self.port, stations[1], stations[0]).await?;
        self.clocks.was_off(number);
        if let Some(extra) = self.slaves.get_mut(extra) {
            (extra.condition, extra.report) = (Condition::Lost, AlReport::default());
        }
        self.take_place(number, fixed, known);
        self.introduce(extra).await;
        Ok(())
    }

    /// Takes a slave to INIT, also one that was switched on with a memory that could not be read: its controller loads its
    /// configuration first. Waits for the processor of a member that still starts up.
    async fn go_to_init(&mut self, number: usize) -> Result<(), BusError> {
        let Some(slave) = self.slaves.get(number).copied() else {
            return Ok(());
        };
        if slave.member.is_some() {
            let reached = self.change_state(number, AlState::Init, Step::Identify).await;
            return reached.map_err(|failure| failure.error);
        }
        match state::change(&mut self.port, slave.station(), AlState::Init).await {
            Err(BusError::RequestUnread { .. }) => {
                information::load_again(&mut self.port, slave.station()).await;
                state::change(&mut self.port, slave.station(), AlState::Init).await
            }
            reached => reached,
        }
    }

    /// The fixed part of a slave in any state.
    async fn fixed_part_again(&mut self, station: u16) -> Result<FixedPart, BusError> {
        // From PREOP on its processor has the memory, and some read it for the master only in INIT.
        information::take(&mut self.port, station).await;
        match information::fixed_part(&mut self.port, station).await {
            Ok(fixed) => Ok(fixed),
            Err(_) => {
                state::change(&mut self.port, station, AlState::Init).await?;
                information::take(&mut self.port, station).await;
                information::fixed_part(&mut self.port, station).await
            }
        }
    }

    /// Notes the slave that has taken the place of one that was not wanted there. Where it was an extra slave before, it is
    /// no longer expected.
    pub(super) fn take_place(&mut self, number: usize, fixed: FixedPart, known: KnownIdentity) {
        if let Some(slave) = self.slaves.get_mut(number) {
            if slave.fixed.identity != fixed.identity {
                (slave.device, slave.data) = (F::by_identity(&fixed.identity), SlaveData::Unknown);
                self.exchanged = self.exchanged.without(SlaveSet::of(number));
            }
            (slave.fixed, slave.known) = (fixed, known);
        }
        let extras = (0..).zip(&mut self.slaves).skip(self.ordered);
        let gone = extras.filter(|(extra, slave)| *extra != number && slave.condition == Condition::Lost);
        for (_, extra) in gone.filter(|(_, slave)| slave.fixed.identity == fixed.identity) {
            extra.fixed.identity.serial = 0;
        }
    }

    /// Which of the strangers a missing slave is, if their order in the chain tells: as many strangers as missing slaves
    /// are found, or fewer at the end of the chain, which then is cut behind them.
    fn rank_among(&self, strangers: &[u16], missing: &[u8], number: usize, places: &Places) -> Option<usize> {
        let goes_on = places
            .iter()
            .any(|there| self.rank_of(*there).is_some_and(|there| there > number));
        let is_cut = strangers.len() < missing.len() && !goes_on;
        let rank = missing.iter().position(|missing| usize::from(*missing) == number);
        rank.filter(|_| strangers.len() == missing.len() || is_cut)
    }

    /// Whether no other missing slave is of a slave's product.
    fn is_only_one(&self, slave: &Slave<F>, missing: &[u8]) -> bool {
        let product = |slave: &Slave<F>| (slave.identity().vendor, slave.identity().product);
        let missing = missing
            .iter()
            .filter_map(|number| self.slaves.get(usize::from(*number)));
        missing.filter(|missing| product(missing) == product(slave)).count() <= 1
    }

    /// Whether another missing slave is of the product of an identity.
    fn is_another(&self, number: usize, missing: &[u8], identity: &Identity) -> bool {
        let others = missing.iter().filter(|missing| usize::from(**missing) != number);
        let mut others = others.filter_map(|number| self.slaves.get(usize::from(*number)));
        others.any(|other| other.is_of_product(identity))
    }

    /// Index of the slave at `station` among those whose order in the chain is known. Extra slaves may be anywhere in
    /// the chain.
    fn rank_of(&self, station: u16) -> Option<usize> {
        self.number_of(station).filter(|number| *number < self.ordered)
    }

    /// The places between a slave's neighbours, none if they have changed places; all for an extra slave.
    fn between(&self, number: usize, places: &Places) -> Range<usize> {
        let (mut first, mut last) = (0, places.len());
        if number < self.ordered {
            let rank = |station: &u16| self.rank_of(*station);
            let before = places
                .iter()
                .rposition(|there| rank(there).is_some_and(|there| there < number));
            let after = places
                .iter()
                .position(|there| rank(there).is_some_and(|there| there > number));
            first = before.map_or(first, |place| place + 1);
            last = after.unwrap_or(last);
        }
        first..last
    }

    /// Places of slaves without an address of this bus, between a slave's neighbours; anywhere for an extra slave.
    pub(super) fn strangers_between(&self, number: usize, places: &Places) -> Vec<u16, PLACES_MAX> {
        let between = self.between(number, places);
        let between = (0_u16..).zip(places).take(between.end).skip(between.start);
        between
            .filter(|(_, there)| self.number_of(**there).is_none())
            .map(|(place, _)| place)
            .collect()
    }

    /// Missing slaves that belong between the neighbours of this slave.
    fn missing_between(&self, number: usize, places: &Places) -> Vec<u8, PLACES_MAX> {
        let there = |number: &usize| places.contains(&STATION_BASE.wrapping_add(*number as u16));
        let first = (0..number).rev().find(there).map_or(0, |number| number + 1);
        let last = (number..self.ordered).find(there).unwrap_or(self.ordered);
        (first..last).map(|number| number as u8).collect()
    }

    /// Identifies the slave at a place without an address, which then has the temporary one; [`Self::name`] has to
    /// follow, unless this fails.
    async fn identify(&mut self, place: u16, places: &Places) -> Result<FixedPart, BusError> {
        self.mark(place, places).await?;
        let fixed = self.read_marked().await;
        if fixed.is_err() {
            self.name(0).await?;
        }
        fixed
    }

    /// Whether a slave with this identity may take a slave's place.
    pub(super) fn is_same(&self, slave: &Slave<F>, identity: &Identity) -> Result<(), BusError> {
        let (old, new) = (slave.identity(), identity);
        let may_differ = slave.is_refused_terminal() || self.is_unwanted(slave);
        if !slave.is_of_product(new) && !may_differ {
            return Err(BusError::Identity {
                expected: old.product,
                actual: new.product,
            });
        }
        let mut others = self.slaves.iter().filter(|other| other.position != slave.position);
        let elsewhere = others.find(|other| {
            let other = other.identity();
            (other.vendor, other.product, other.serial) == (new.vendor, new.product, new.serial)
        });
        match elsewhere {
            Some(other) if new.serial != 0 && new.serial != old.serial => Err(BusError::WrongSlave {
                property: IdentityProperty::Serial,
                expected: old.serial,
                actual: new.serial,
                other: Some(other.position as u8),
            }),
            _ => Ok(()),
        }
    }

    /// Brings back a slave that only left OP: acknowledges the error and requests OP again.
    async fn resume(&mut self, number: usize) -> Result<(), Failure> {
        let Some(slave) = self.slaves.get(number).copied() else {
            return Ok(());
        };
        let at = |step| Failure::of(slave.position, step);
        let report = state::acknowledge(&mut self.port, slave.station())
            .await
            .map_err(at(Step::Operational))?;
        self.is_near_the_time(number).await.map_err(at(Step::Clocks))?;
        if report.is(AlState::Operational) || report.is(AlState::SafeOperational) {
            return self.reach_operational(number).await;
        }
        let error = BusError::State {
            expected: AlState::SafeOperational as u8,
            actual: report.status,
            code: report.code,
        };
        Err(at(Step::Operational)(error))
    }

    /// Whether a slave's clock is so near the distributed time that its control loop gets there: one that has heard
    /// nothing for seconds is set anew instead, on its way through INIT.
    async fn is_near_the_time(&mut self, number: usize) -> Result<(), BusError> {
        let Some(slave) = self.slaves.get(number).copied() else {
            return Ok(());
        };
        if !self.clocks.has_clock(number) || self.distributor() == Some(number) {
            return Ok(());
        }
        let actual_ns = clock::difference_ns(&mut self.port, slave.station()).await?;
        // One in front of the others would distribute its time from then on, and is told theirs as it was expected only. Without a
        // time that is distributed there is no difference from it either.
        let is_behind = self
            .distributor()
            .is_some_and(|distributor| !self.clocks.is_before(number, distributor));
        match actual_ns.unsigned_abs() <= NEAR_NS && is_behind {
            true => {
                self.clocks.found_in_time(number);
                // Its cables may have been changed meanwhile.
                self.tell_delays().await;
                Ok(())
            }
            false => Err(BusError::ClockDifference {
                expected_ns: NEAR_NS,
                actual_ns,
                waited_ms: 0,
            }),
        }
    }

    /// Whether the slave at a place is between the neighbours that it had before.
    fn is_in_order(&self, places: &Places, place: usize, number: usize) -> Result<(), BusError> {
        let rank = |there: &u16| self.rank_of(*there);
        let mut before = places.iter().take(place).filter_map(rank);
        let mut after = places.iter().skip(place + 1).filter_map(rank);
        let wrong = before
            .find(|there| *there > number)
            .or_else(|| after.find(|there| *there < number));
        match wrong.filter(|_| number < self.ordered) {
            Some(other) => Err(BusError::Station {
                expected: STATION_BASE.wrapping_add(number as u16),
                actual: STATION_BASE.wrapping_add(other as u16),
            }),
            None => Ok(()),
        }
    }
}

/// Which slave answers at the address of one that was lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Returned {
    /// The one that was lost, as far as its identity tells.
    Same,
    /// One of the same product of which something else was read: it may have been set up for another machine.
    Equal,
    /// Another one; it is a stranger now.
    Other,
}

/// A station address that two places of a chain have.
fn twice(places: &Places) -> Option<u16> {
    let is_known = |station: &u16| *station != 0 && *station != STATION_TEMPORARY;
    let mut addressed = places.iter().enumerate().filter(|(_, station)| is_known(station));
    let again = addressed.find(|(place, station)| places.iter().skip(place + 1).any(|other| other == *station));
    again.map(|(_, station)| *station)
}

/// Whether an identity has another serial number than a slave.
fn has_other_serial<F: SlaveFactory>(slave: &Slave<F>, identity: &Identity) -> bool {
    let known = slave.identity().serial;
    known != 0 && identity.serial != 0 && identity.serial != known
}

/// Whether an identity has a slave's own serial number.
fn has_serial_of<F: SlaveFactory>(slave: &Slave<F>, identity: &Identity) -> bool {
    identity.serial != 0 && identity.serial == slave.identity().serial
}
