//! Rescan: finds slaves that return and slaves that are new.
//!
//! A slave without an address at the place of a missing one, and of its product, has returned. If the missing slave is
//! in use, the returned one waits for [`BusCommand::Recover`](super::BusCommand::Recover). So does a slave at its place
//! that cannot be read or is another product: with a number of its own, no repair would find it. A slave that is not in
//! use is recognised at once. Every other slave is an extra one: it is identified, gets a number behind all others,
//! wherever it was plugged in, and is never used.
//!
//! Invariant: the rescan changes no slave's state and gives no slave process data.

use super::super::configure::discovery::STATION_BASE;
use super::super::driver::SlaveFactory;
use super::super::error::BusError;
use super::super::event::BusEvent;
use super::super::slave::{Condition, Slave};
use super::super::wire::sii::FixedPart;
use super::bus::Bus;

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> Bus<'_, F, SLAVES, MESSAGE> {
    /// Looks through the chain for slaves without an address of this bus.
    pub(super) async fn rescan(&mut self) -> Result<(), BusError> {
        let places = self.places().await?;
        let mut extra = false;
        for (place, station) in (0_u16..).zip(&places) {
            if self.number_of(*station).is_some() {
                continue;
            }
            self.mark(place, &places).await?;
            // A slave that cannot be read is an unknown device.
            let fixed = self.read_marked().await.unwrap_or_default();
            let belongs_here = |slave: &Slave<F>| {
                let between = self.strangers_between(usize::from(slave.position), &places);
                slave.condition == Condition::Lost && between.contains(&place)
            };
            let returned = self
                .slaves
                .iter()
                .position(|slave| belongs_here(slave) && self.is_same(slave, &fixed.identity).is_ok());
            let is_awaited = self
                .slaves
                .iter()
                .any(|slave| slave.member.is_some() && belongs_here(slave));
            match returned {
                Some(number) => self.readdress(number).await?,
                None if is_awaited => self.name(0).await?,
                None => extra |= self.admit(fixed).await?,
            }
        }
        if extra {
            let slaves = places.len() as u16;
            self.emit(BusEvent::Found { slaves }).await;
        }
        self.read_ports().await;
        self.send_plan().await;
        Ok(())
    }

    /// Recognises a returned slave that is not in use; a slave in use keeps waiting for its repair.
    async fn readdress(&mut self, number: usize) -> Result<(), BusError> {
        let unused = self.slaves.get(number).filter(|slave| slave.member.is_none());
        match unused.map(Slave::station) {
            Some(station) => {
                self.name(station).await?;
                self.inspect(number..number + 1).await;
            }
            None => self.name(0).await?,
        }
        Ok(())
    }

    /// Gives an extra slave a number behind all others; returns whether there was room.
    async fn admit(&mut self, fixed: FixedPart) -> Result<bool, BusError> {
        let number = self.slaves.len();
        let slave = Slave {
            fixed,
            device: F::by_identity(&fixed.identity),
            ..Slave::at(number as u16)
        };
        if self.slaves.push(slave).is_err() {
            self.name(0).await?;
            return Ok(false);
        }
        let station = STATION_BASE.wrapping_add(number as u16);
        self.name(station).await?;
        self.inspect(number..number + 1).await;
        Ok(true)
    }
}
