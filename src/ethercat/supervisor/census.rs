//! Who has come: slaves that return and slaves that were not there before.
//!
//! A slave without an address that is where a missing one has to be, and is the same product, has returned. One that is
//! in use waits for [`BusCommand::Recover`](super::BusCommand::Recover), and so does whoever stands in its place, because it
//! cannot be read or is another product: given a number, it would be found by no repair. One that is not in use is known
//! again at once. Every other one is an extra slave: it is identified, gets a number behind all others, wherever it was
//! plugged in, and is never used.
//!
//! Invariant: nothing here changes a slave's state or gives it process data.

use super::super::configure::discovery;
use super::super::error::BusError;
use super::super::event::BusEvent;
use super::super::factory;
use super::super::slave::{Condition, STATION_BASE, Slave};
use super::super::wire::sii::FixedPart;
use super::bus::Bus;

impl<const SLAVES: usize, const MESSAGE: usize> Bus<'_, SLAVES, MESSAGE> {
    /// Looks through the chain for slaves without an address of this bus.
    pub(super) async fn take_census(&mut self) -> Result<(), BusError> {
        let places = self.places().await?;
        let mut extra = false;
        for (place, station) in (0_u16..).zip(&places) {
            if self.number_of(*station).is_some() {
                continue;
            }
            // Who cannot be read is an unknown device.
            let fixed = self.fixed_at(place).await.unwrap_or_default();
            let belongs_here = |slave: &Slave| {
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
                .any(|slave| slave.axis.is_some() && belongs_here(slave));
            match returned {
                Some(number) => self.greet(number, place).await?,
                None if is_awaited => {}
                None => extra |= self.admit(place, fixed).await?,
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

    /// Knows a slave again that is not in use; one in use keeps waiting for its repair.
    async fn greet(&mut self, number: usize, place: u16) -> Result<(), BusError> {
        let unused = self.slaves.get(number).filter(|slave| slave.axis.is_none());
        if let Some(station) = unused.map(Slave::station) {
            discovery::assign_station(&mut self.port, place, station).await?;
            self.inspect(number..number + 1).await;
        }
        Ok(())
    }

    /// Gives an extra slave a number behind all others; whether there was room for it.
    async fn admit(&mut self, place: u16, fixed: FixedPart) -> Result<bool, BusError> {
        let number = self.slaves.len();
        let slave = Slave {
            position: number as u16,
            fixed,
            kind: factory::drive_kind(&fixed.identity),
            ..Slave::default()
        };
        if self.slaves.push(slave).is_err() {
            return Ok(false);
        }
        let station = STATION_BASE.wrapping_add(number as u16);
        discovery::assign_station(&mut self.port, place, station).await?;
        self.inspect(number..number + 1).await;
        Ok(true)
    }
}
