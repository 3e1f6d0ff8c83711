//! Marks: the slave at a place gets the temporary address, so that frames reach it until it has one of its own.
//!
//! Invariant: what is written to the marked slave reaches the one that was meant, whichever slaves return or drop out meanwhile.

use super::super::configure::discovery::{self, STATION_TEMPORARY};
use super::super::configure::information;
use super::super::driver::SlaveFactory;
use super::super::error::BusError;
use super::super::wire::sii::FixedPart;
use super::bus::Bus;
use super::repair::Places;

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> Bus<'_, F, SLAVES, MESSAGE> {
    /// The fixed part of the slave with the temporary address.
    pub(super) async fn read_marked(&mut self) -> Result<FixedPart, BusError> {
        information::fixed_part(&mut self.port, STATION_TEMPORARY).await
    }

    /// Gives the slave at a place, which has no address of its own here, the temporary one, and looks whether it was that slave:
    /// one that has returned since the places were read shifts them. Then another slave has got the address, and gets back the
    /// one that it had. What the marked slave maps into the logical memory is cleared: another master may have set it.
    pub(super) async fn mark(&mut self, place: u16, places: &Places) -> Result<(), BusError> {
        let assigned = discovery::assign_station(&mut self.port, place, STATION_TEMPORARY).await;
        self.look_for_mark(place, places, assigned).await?;
        discovery::clear_fmmus(&mut self.port, STATION_TEMPORARY).await
    }

    /// Looks whether the slave with the temporary address is still where it was marked, before it gets another one: with
    /// power, it keeps the mark when its cables are put elsewhere. Takes the mark back if not.
    pub(super) async fn confirm_mark(&mut self, place: u16, places: &Places) -> Result<(), BusError> {
        self.look_for_mark(place, places, Ok(())).await
    }

    async fn look_for_mark(
        &mut self,
        place: u16,
        places: &Places,
        assigned: Result<(), BusError>,
    ) -> Result<(), BusError> {
        let there = match assigned {
            Ok(()) => self.settled_places().await,
            Err(error) => Err(error),
        };
        let station = match &there {
            Ok(there) if is_marked(place, places, there) => return Ok(()),
            Ok(there) => self.renamed(places, there),
            Err(_) => 0,
        };
        self.name(station).await?;
        let there = there?;
        Err(other_chain(place, places, &there))
    }

    /// The address that the slave with the temporary one had before slaves returned in front of it, or dropped out; 0 if it had
    /// none, or if nobody can know.
    fn renamed(&self, places: &Places, there: &Places) -> u16 {
        let mut marked = there
            .iter()
            .enumerate()
            .filter(|(_, there)| **there == STATION_TEMPORARY);
        let (Some((place, _)), None) = (marked.next(), marked.next()) else {
            return 0;
        };
        let before = (place + places.len()).checked_sub(there.len());
        let station = before.and_then(|place| places.get(place)).copied().unwrap_or(0);
        // Where all before the place are as they were, one behind it has dropped out.
        let has_shifted = match there.len() < places.len() {
            true => there.get(..place) != places.get(..place),
            false => there.len() > places.len(),
        };
        let is_gone = has_shifted && self.number_of(station).is_some() && !there.contains(&station);
        if is_gone { station } else { 0 }
    }

    /// Gives the slave with the temporary address its own, or none with 0. Not by its place: a slave that returns
    /// meanwhile shifts the places.
    pub(super) async fn name(&mut self, station: u16) -> Result<(), BusError> {
        discovery::rename(&mut self.port, STATION_TEMPORARY, station).await
    }
}

/// Whether the slave at a place, and no other, has got the temporary address, and all others are where they were. Where
/// one has lost its address meanwhile, slaves may have changed places, and the order tells nothing.
fn is_marked(place: u16, places: &Places, there: &Places) -> bool {
    let is_as_before = |(number, (before, now)): (usize, (&u16, &u16))| match number == usize::from(place) {
        true => *now == STATION_TEMPORARY,
        false => now == before,
    };
    places.len() == there.len() && places.iter().zip(there).enumerate().all(is_as_before)
}

/// How a chain in which a mark was not found as it was set differs from the one before.
fn other_chain(place: u16, places: &Places, there: &Places) -> BusError {
    if there.len() != places.len() {
        return BusError::SlaveCount {
            expected: places.len() as u16,
            actual: there.len() as u16,
        };
    }
    let actual = there.get(usize::from(place)).copied().unwrap_or(0);
    let mut others = places.iter().zip(there).enumerate();
    let other = others.find(|(number, (before, now))| *number != usize::from(place) && before != now);
    match other.filter(|_| actual == STATION_TEMPORARY) {
        Some((_, (expected, actual))) => BusError::Station {
            expected: *expected,
            actual: *actual,
        },
        None => BusError::Station {
            expected: STATION_TEMPORARY,
            actual,
        },
    }
}
