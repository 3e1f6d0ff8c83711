//! Rescan: finds slaves that return and slaves that are new.
//!
//! A slave without an address at the place of a missing one, and of its product, has returned. If the missing slave is
//! in use, the returned one waits for [`BusCommand::Recover`](super::BusCommand::Recover). So does a slave at its place
//! that cannot be read or is another product: with a number of its own, no repair would find it. A slave that is not in
//! use is recognised at once. Every other slave is an extra one: it is identified, gets a number behind all others,
//! wherever it was plugged in, and is never used.
//!
//! Invariant: the rescan requests no state and gives no slave process data. What an unknown slave maps into the logical memory
//! is taken away before it is identified.

use super::super::configure::discovery::{self, STATION_BASE, STATION_TEMPORARY};
use super::super::driver::SlaveFactory;
use super::super::error::BusError;
use super::super::event::BusEvent;
use super::super::slave::{Condition, Slave};
use super::super::slave_set::SlaveSet;
use super::super::wire::sii::FixedPart;
use super::bus::Bus;
use super::repair::Places;

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> Bus<'_, F, SLAVES, MESSAGE> {
    /// Looks through the chain for slaves without an address of this bus. What was found before an error stays.
    pub(super) async fn rescan(&mut self) -> Result<(), BusError> {
        let mut places = self.places().await?;
        let (mut extra, mut returned) = (false, SlaveSet::NONE);
        let mut sorted = Ok(());
        for place in 0..places.len() {
            match self.sort(place, &mut places, &mut returned).await {
                Ok(is_extra) => extra |= is_extra,
                Err(error) => {
                    sorted = Err(error);
                    break;
                }
            }
        }
        if extra {
            let slaves = places.len() as u16;
            self.emit(BusEvent::Found { slaves }).await;
        }
        self.read_ports().await;
        self.send_plan().await;
        sorted
    }

    /// Takes the mappings of another master from slaves that were plugged in with power, and have an address of that master:
    /// they disturb the exchange.
    pub(super) async fn clear_strangers(&mut self) -> Result<(), BusError> {
        let places = self.places().await?;
        for station in places.into_iter().filter(|station| *station != 0) {
            if self.number_of(station).is_none() {
                discovery::clear_fmmus(&mut self.port, station).await?;
            }
        }
        Ok(())
    }

    /// Looks at one place, and notes there the address that its slave has got; returns whether it is an extra one. `seen` are
    /// the slaves that were found again at places before.
    async fn sort(&mut self, place: usize, places: &mut Places, seen: &mut SlaveSet) -> Result<bool, BusError> {
        let station = places.get(place).copied().unwrap_or(0);
        if self.number_of(station).is_some() {
            return Ok(false);
        }
        self.mark(place as u16, places).await?;
        let fixed = match self.read_marked().await {
            Ok(fixed) => fixed,
            // It is an unknown device, unless it has gone.
            Err(_) if self.settled_places().await?.contains(&STATION_TEMPORARY) => FixedPart::default(),
            Err(error) => return Err(error),
        };
        let belongs_here = |slave: &Slave<F>| {
            let between = self.strangers_between(usize::from(slave.position), places);
            // Another slave may have taken its place since the last inspection.
            let is_away = matches!(slave.condition, Condition::Lost | Condition::Returned);
            let is_missing = is_away || !places.contains(&slave.station());
            is_missing && between.contains(&(place as u16))
        };
        let may_be = |slave: &Slave<F>| belongs_here(slave) && self.is_same(slave, &fixed.identity).is_ok();
        let is_it = |slave: &Slave<F>| slave.is_of_product(&fixed.identity) && may_be(slave);
        // A refused terminal may be any product; a slave of the product that was found comes first.
        let not_seen = |number: &usize| !seen.contains(*number);
        let of = |wanted: &dyn Fn(&Slave<F>) -> bool| {
            let numbers = (0..).zip(&self.slaves).filter(|(_, slave)| wanted(slave));
            numbers.map(|(number, _)| number).find(not_seen)
        };
        let returned = of(&is_it).or_else(|| of(&may_be));
        let is_awaited = self.slaves.iter().any(|slave| slave.is_used() && belongs_here(slave));
        self.confirm_mark(place as u16, places).await?;
        let (named, is_extra) = match returned {
            Some(number) => {
                *seen |= SlaveSet::of(number);
                (self.readdress(number, fixed).await?, false)
            }
            None if is_awaited => {
                self.name(0).await?;
                (0, false)
            }
            None => {
                let station = self.admit(fixed).await?;
                (station, station != 0)
            }
        };
        if let Some(there) = places.get_mut(place) {
            *there = named;
        }
        Ok(is_extra)
    }

    /// Recognises a returned slave that is not in use; a slave in use keeps waiting for its repair. Returns its address,
    /// or 0 while it waits.
    async fn readdress(&mut self, number: usize, fixed: FixedPart) -> Result<u16, BusError> {
        let unused = self.slaves.get(number).filter(|slave| !slave.is_used());
        match unused.map(|slave| (slave.station(), slave.known)) {
            Some((station, known)) => {
                self.clocks.was_off(number);
                // Extra slaves of one product may follow each other.
                self.take_place(number, fixed, known);
                self.name(station).await?;
                // Until its clock is set, another one distributes its time.
                let _ = self.restore_clock(number).await;
                self.inspect(number..number + 1).await;
                Ok(station)
            }
            None => {
                self.name(0).await?;
                let position = number as u8;
                self.emit(BusEvent::Returned { position }).await;
                Ok(0)
            }
        }
    }

    /// Gives an extra slave a number behind all others; returns its address, or 0 if there was no room.
    async fn admit(&mut self, fixed: FixedPart) -> Result<u16, BusError> {
        let number = self.slaves.len();
        let slave = Slave {
            fixed,
            device: F::by_identity(&fixed.identity),
            ..Slave::at(number as u16)
        };
        if self.slaves.push(slave).is_err() {
            self.name(0).await?;
            return Ok(0);
        }
        let station = STATION_BASE.wrapping_add(number as u16);
        self.name(station).await?;
        self.add_clock(number).await;
        self.inspect(number..number + 1).await;
        Ok(station)
    }
}
