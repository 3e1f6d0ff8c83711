//! A group of drives on an EtherCAT bus.
//!
//! Invariant: a member's input is available only in the cycle in which it arrived.

use crate::factory::ServoDrives;
use crate::io::{BusState, GroupDrive, IoGroup, IoTrigger};
use crate::layout::ProcessLayout;
use crate::{DriveInput, DriveOutput, DriveSettings};
use etherpen_ethercat::configure::Direction;
use etherpen_ethercat::cyclic::{Arrival, BusCounters, Exchange, ExchangeKind, InputPlace, OutputPlace};
use etherpen_ethercat::encapsulation::Encapsulation;
use etherpen_ethercat::place::Place as ValuePlace;
use etherpen_ethercat::slave_set::SlaveSet;

/// Where a member's values are.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// Place of the drive in the chain, from 0.
    slave: u8,
    layout: ProcessLayout,
    inputs: InputPlace,
    outputs: OutputPlace,
}

/// The drives of a bus, over the cyclic exchange with it.
/// `FURTHER` as that of the exchange: frames behind the first one.
pub struct EtherCatGroup<'a, const MEMBERS: usize, const SLAVES: usize, const MESSAGE: usize, const FURTHER: usize = 0>
where
    [DriveSettings; MEMBERS]: Default,
{
    exchange: Exchange<'a, ServoDrives<MEMBERS>, SLAVES, MESSAGE, FURTHER>,
    places: [Option<Place>; MEMBERS],
    /// Number of the plan to which the places belong.
    plan: Option<u32>,
}

impl<'a, const MEMBERS: usize, const SLAVES: usize, const MESSAGE: usize, const FURTHER: usize>
    EtherCatGroup<'a, MEMBERS, SLAVES, MESSAGE, FURTHER>
where
    [DriveSettings; MEMBERS]: Default,
{
    /// The drives that `exchange` reaches.
    pub fn new(exchange: Exchange<'a, ServoDrives<MEMBERS>, SLAVES, MESSAGE, FURTHER>) -> Self {
        Self {
            exchange,
            places: [None; MEMBERS],
            plan: None,
        }
    }

    /// The exchange with the bus.
    pub fn exchange(&self) -> &Exchange<'a, ServoDrives<MEMBERS>, SLAVES, MESSAGE, FURTHER> {
        &self.exchange
    }

    /// The exchange with the bus, to set values of terminals.
    pub fn exchange_mut(&mut self) -> &mut Exchange<'a, ServoDrives<MEMBERS>, SLAVES, MESSAGE, FURTHER> {
        &mut self.exchange
    }

    /// The members at some places of the chain, one bit each.
    #[cold]
    fn members_at(&self, slaves: SlaveSet) -> u32 {
        let places = self.places.iter().enumerate();
        places.fold(0, |members, (number, place)| {
            let is_there = place.is_some_and(|place| slaves.contains(place.slave.into()));
            members | u32::from(is_there) << (number & 31)
        })
    }

    #[cold]
    fn adopt(&mut self) {
        self.plan = Some(self.exchange.plan_number());
        for (number, place) in self.places.iter_mut().enumerate() {
            let slave = self.exchange.member(number);
            let share = slave.and_then(|slave| self.exchange.plan().slaves.get(slave));
            let length = share.map_or(0, |share| share.input_length);
            let role = share.and_then(|share| share.role);
            let whole = role.filter(|role| u16::from(role.layout.input_length) <= length);
            *place = slave.zip(whole).map(|(slave, role)| Place {
                slave: slave as u8,
                layout: role.layout,
                inputs: self.exchange.input_place(slave),
                outputs: self.exchange.output_place(slave),
            });
        }
    }
}

impl<const MEMBERS: usize, const SLAVES: usize, const MESSAGE: usize, const FURTHER: usize> IoGroup
    for EtherCatGroup<'_, MEMBERS, SLAVES, MESSAGE, FURTHER>
where
    [DriveSettings; MEMBERS]: Default,
{
    #[inline]
    fn renew(&mut self) -> bool {
        let changed = self.plan != Some(self.exchange.plan_number());
        if changed {
            self.adopt();
        }
        changed
    }

    fn drive(&self, member: usize) -> Option<GroupDrive> {
        let share = self.exchange.plan().slaves.get(self.exchange.member(member)?)?;
        let role = share.role?;
        Some(GroupDrive {
            kind: role.device,
            mode: role.layout.mode,
            range: role.layout.range(),
            // The slave is watched from OP on, until it is seen in another state.
            operational: share.watched,
            generation: share.generation,
        })
    }

    #[inline(always)]
    fn read(&self, member: usize) -> Option<DriveInput> {
        let place = self.places.get(member)?.as_ref()?;
        place.layout.decode(self.exchange.image_at(place.inputs)?)
    }

    #[inline]
    fn unconfirmed(&self) -> u32 {
        let slaves = self.exchange.unconfirmed();
        match slaves.is_empty() {
            true => 0,
            false => self.members_at(slaves),
        }
    }

    #[inline(always)]
    fn write(&mut self, member: usize, output: &DriveOutput) {
        if let Some(Some(place)) = self.places.get(member) {
            place.layout.encode(output, self.exchange.output_at(place.outputs));
        }
    }

    #[inline]
    fn terminal_plan(&self) -> u32 {
        self.exchange.plan_number()
    }

    fn terminal_bits(&self, slave: usize, direction: Direction, bit: u16, bits: u8) -> Option<ValuePlace<u32>> {
        let plan = self.exchange.plan();
        // The slave is watched from OP on, until it is seen in another state.
        let is_in_operation = plan.slaves.get(slave)?.watched && plan.terminals.contains(slave);
        self.exchange
            .bits(slave, direction, bit, bits)
            .filter(|_| is_in_operation)
    }

    fn terminal_object(&self, slave: usize, direction: Direction, number: usize, bits: u8) -> Option<ValuePlace<u32>> {
        let bit = self.exchange.plan().values.get(number)?.bit()?;
        self.terminal_bits(slave, direction, bit, bits)
    }

    #[inline]
    fn terminal_value(&self, place: &ValuePlace<u32>) -> Option<u32> {
        self.exchange.get(place)
    }

    #[inline]
    fn terminal_confirms(&self, slave: usize) -> bool {
        match self.exchange.plan().exchange {
            ExchangeKind::Split => !self.exchange.unconfirmed().contains(slave),
            // The outputs of the last trigger travel with this cycle's inputs.
            ExchangeKind::Combined => self.exchange.has_answered(slave),
        }
    }

    #[inline]
    fn set_terminal_value(&mut self, place: &ValuePlace<u32>, value: u32) {
        // A place of another plan is found anew in the next millisecond.
        let _ = self.exchange.set(place, value);
    }
}

impl<const MEMBERS: usize, const SLAVES: usize, const MESSAGE: usize, const FURTHER: usize> IoTrigger
    for EtherCatGroup<'_, MEMBERS, SLAVES, MESSAGE, FURTHER>
where
    [DriveSettings; MEMBERS]: Default,
{
    #[inline]
    fn trigger_input(&mut self) -> &[u8] {
        self.exchange.input_telegram()
    }

    #[inline]
    fn trigger_output(&mut self) -> &[u8] {
        self.exchange.output_telegram()
    }

    #[inline]
    fn arrived(&mut self, frame: &[u8]) -> Arrival {
        self.exchange.receive(frame)
    }

    #[inline]
    fn exchange_kind(&self) -> ExchangeKind {
        self.exchange.plan().exchange
    }

    #[inline]
    fn bus_state(&self) -> BusState {
        BusState {
            al_status: self.exchange.al_status().map(|al| al.status as u8),
            reference_clock: self.exchange.plan().clock.map(|clock| clock.station),
            time_number: self.exchange.plan().clock.map_or(0, |clock| clock.time_number),
            // The low half is enough for a phase; 32-bit clocks have no other.
            clock_ns: self.exchange.clock_ns().map(|time_ns| time_ns as u32),
        }
    }

    #[inline]
    fn counters(&self) -> BusCounters {
        self.exchange.counters()
    }

    fn set_encapsulation(&mut self, encapsulation: Encapsulation) {
        self.exchange.set_encapsulation(encapsulation);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen_ethercat::BusQueues;
    use std::boxed::Box;

    #[test]
    fn the_places_of_a_plan_are_taken_over_once() {
        let mut queues = Box::new(BusQueues::<ServoDrives<2>, 4, 1_024>::new());
        let (exchange, ..) = queues.split();
        let mut group = EtherCatGroup::new(Exchange::new(exchange, [0x10, 0, 0, 0, 0, 1]));
        assert!(group.renew(), "the first plan is new");
        assert!(!group.renew() && !group.renew(), "and the same from then on");
    }
}
