//! The slaves and the passage of frames through them.
//!
//! A frame passes the slaves in the order of the cables and comes back; the first controller marks its source address.
//! Cables, power and closed loops determine how far it gets; the script can add further faults. A frame that is not
//! EtherCAT comes back unchanged where every slave lets such frames pass (register 0x0100, bit 0).

use crate::application::AlState;
use crate::controller::datagram::{Datagrams, is_ethercat, mark_processed};
use crate::drive::Drive;
use crate::faults::Schedule;
use crate::faults::damage;
use crate::faults::kinds::Fault;
use crate::load::Shaft;
use crate::slave::Slave;
use crate::wiring::{Branch, Route, TravelTimes, Wiring};
use etherpen_ethercat::wire::Command;
use std::collections::VecDeque;

/// Serial number of a slave that has replaced the one at a place, less the place.
const SWAPPED_SERIAL: u32 = 1_000;
/// How long the cables of two slaves that are exchanged lie open, ms: quick hands.
const RECABLING_MS: u64 = 500;
/// A frame with a local experimental EtherType, as another station might send it.
const FOREIGN_FRAME: [u8; 60] = {
    let mut frame = [0; 60];
    let header = [
        0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x02, 0x00, 0x00, 0x00, 0x00, 0x99, 0x88, 0xB5,
    ];
    let mut at = 0;
    while at < header.len() {
        frame[at] = header[at];
        at += 1;
    }
    frame
};

/// The present time: steps of the segment, and the true arrival time of a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Now {
    /// Milliseconds since the start.
    pub(crate) ms: u64,
    /// Nanoseconds on the caller's clock.
    pub(crate) ns: u64,
}

/// Slaves, cables and frames in flight.
#[derive(Clone, Debug)]
pub(crate) struct Chain {
    slaves: Vec<Slave>,
    wiring: Wiring,
    /// Number of the slave at each place: its place at the start, from 1.
    numbers: Vec<usize>,
    mains_off_ms: Vec<u64>,
    stalled_until_ms: u64,
    muted_until_ms: u64,
    /// Frames that each cable still destroys.
    damaging: Vec<u64>,
    frames: u64,
    delayed: VecDeque<(u64, Vec<u8>)>,
    /// Drives with exchanged resolvers, from 1, and the remaining time, ms.
    exchanges: Vec<(usize, usize, u64)>,
}

impl Chain {
    pub(crate) fn new(slaves: Vec<Slave>, branches: &[Branch], travel: TravelTimes) -> Self {
        let count = slaves.len();
        let mut segment = Self {
            slaves,
            wiring: Wiring::new(count, branches, travel),
            numbers: (1..=count).collect(),
            mains_off_ms: vec![0; count],
            stalled_until_ms: 0,
            muted_until_ms: 0,
            damaging: vec![0; count + 1],
            frames: 0,
            delayed: VecDeque::new(),
            exchanges: Vec::new(),
        };
        segment.show_links();
        segment
    }

    /// The slaves in the order of the chain.
    pub(crate) fn slaves(&self) -> &[Slave] {
        &self.slaves
    }

    /// Number of EtherCAT frames from the master.
    pub(crate) fn frames(&self) -> u64 {
        self.frames
    }

    /// Advances by one millisecond, to a true time.
    pub(crate) fn step(&mut self, now_ns: u64) {
        self.wiring.step();
        for (slave, off_ms) in self.slaves.iter_mut().zip(&mut self.mains_off_ms) {
            if *off_ms > 0 {
                *off_ms -= 1;
                let on = *off_ms == 0;
                slave.drive_mut().into_iter().for_each(|drive| drive.set_mains(on));
            }
            slave.step(now_ns);
        }
        self.show_links();
    }

    /// Time to the next SYNC0 pulse, ns: that of the middle one of the slaves that generate them at the same place of each
    /// millisecond, so that one wrong clock among three leads nobody; `None` without one.
    pub(crate) fn pulse_ahead_ns(&self) -> Option<u64> {
        let mut ahead_ns: Vec<u64> = self.slaves.iter().filter_map(Slave::pulse_ahead_ns).collect();
        ahead_ns.sort_unstable();
        ahead_ns.get(ahead_ns.len() / 2).copied()
    }

    /// Samples the inputs of this millisecond, after every motor has moved.
    pub(crate) fn sample(&mut self) {
        for (one, other, left_ms) in core::mem::take(&mut self.exchanges) {
            let shaft = |slave: usize| {
                let slave = slave.checked_sub(1).and_then(|index| self.slaves.get(index));
                slave.and_then(Slave::drive).map(|drive| drive.motor().angle_rad())
            };
            let shafts = if left_ms > 0 {
                [shaft(other), shaft(one)]
            } else {
                [None; 2]
            };
            for (slave, foreign_rad) in [one, other].into_iter().zip(shafts) {
                self.with_drive(slave, |drive| drive.show_foreign(foreign_rad));
            }
            if left_ms > 0 {
                self.exchanges.push((one, other, left_ms - 1));
            }
        }
        self.slaves.iter_mut().for_each(Slave::sample);
    }

    /// The shafts of the motors in the order that the chain had at the start.
    pub(crate) fn shafts(&mut self) -> Vec<Shaft<'_>> {
        let drives = self.slaves.iter_mut().zip(&self.numbers);
        let shafts = drives.filter_map(|(slave, number)| Some(Shaft::new(*number, slave.drive_mut()?)));
        let mut shafts: Vec<Shaft> = shafts.collect();
        shafts.sort_by_key(Shaft::slave);
        shafts
    }

    /// The drives in the order that the chain had at the start, with their slaves' numbers.
    pub(crate) fn drives(&self) -> Vec<(usize, &Drive)> {
        let slaves = self.numbers.iter().zip(&self.slaves);
        let mut drives: Vec<(usize, &Drive)> = slaves
            .filter_map(|(number, slave)| Some((*number, slave.drive()?)))
            .collect();
        drives.sort_by_key(|(number, _)| *number);
        drives
    }

    /// Applies a fault to the segment.
    pub(crate) fn apply(&mut self, fault: Fault, now_ms: u64) {
        match fault {
            Fault::Stall(milliseconds) => self.stalled_until_ms = now_ms.saturating_add(milliseconds),
            Fault::Cut(cable) => self.wiring.set_cut(cable, true),
            Fault::Plug(cable) => self.wiring.set_cut(cable, false),
            Fault::Join => self.wiring.join(),
            Fault::Remove(slave) => self.wiring.set_removed(slave, true),
            Fault::Insert(slave) => self.wiring.set_removed(slave, false),
            Fault::Mute(milliseconds) => self.muted_until_ms = now_ms.saturating_add(milliseconds),
            Fault::Deaf(slave, ms) => self.with(slave, |slave| slave.deafen(ms)),
            Fault::Recable(one, other) => self.recable(one, other),
            Fault::Power(slave, off_ms) => self.with(slave, |slave| slave.power_cycle(off_ms)),
            Fault::Retreat(slave, code) => self.with(slave, |slave| slave.fall(AlState::SafeOperational, code)),
            Fault::Fall(slave, state, code) => self.with(slave, |slave| slave.fall(state, code)),
            Fault::Silence(slave, ms) => self.with(slave, |slave| slave.silence(ms)),
            Fault::Drive(slave, code) => self.with_drive(slave, |drive| drive.fault(code)),
            Fault::Resolver(slave, fault, ms) => self.with_drive(slave, |drive| drive.set_resolver_fault(fault, ms)),
            Fault::Jump(slave, increments) => self.with_drive(slave, |drive| drive.slip(increments)),
            Fault::Exchange(one, other, ms) => {
                self.exchanges
                    .retain(|(first, second, _)| (*first, *second) != (one, other));
                self.exchanges.push((one, other, ms));
            }
            Fault::Mains(slave, ms) => {
                self.with_drive(slave, |drive| drive.set_mains(ms == 0));
                let at = slave.wrapping_sub(1);
                self.mains_off_ms
                    .iter_mut()
                    .skip(at)
                    .take(1)
                    .for_each(|off_ms| *off_ms = ms);
            }
            Fault::Crc(cable, frames) => {
                let cable = self.damaging.iter_mut().skip(cable).take(1);
                cable.for_each(|left| *left = left.saturating_add(frames));
            }
            Fault::Swap(slave, product) => {
                let serial = SWAPPED_SERIAL.saturating_add(u32::try_from(slave).unwrap_or_default());
                self.with(slave, |slave| slave.swap(product, serial));
            }
            Fault::Refuse(slave, state, code) => self.with(slave, |slave| slave.refuse(state, code)),
            Fault::Processor(slave, ms) => self.with(slave, |slave| slave.hang(ms)),
            Fault::Sii(slave, fault) => self.with(slave, |slave| slave.set_sii_fault(fault)),
            Fault::Mailbox(slave, step, fault) => self.with(slave, |slave| slave.spoil_mailbox(step, fault)),
            Fault::File(slave, fault) => self.with(slave, |slave| slave.spoil_files(fault)),
            Fault::Manner(slave, manner) => self.with(slave, |slave| slave.set_manner(manner)),
            Fault::Ethernet(slave) => self.with(slave, Slave::send_ethernet),
            _ => {}
        }
        self.show_links();
    }

    /// Passes a frame through the segment; returns the frames that come back, in order.
    pub(crate) fn frame(&mut self, frame: &[u8], now: Now, schedule: &mut Schedule) -> Vec<Vec<u8>> {
        let now_ms = now.ms;
        let mut passing = frame.to_vec();
        if Datagrams::of_frame(&mut passing).is_none() {
            return self.foreign(passing);
        }
        self.frames += 1;
        let mut faults = schedule.at_frame(self.frames, now_ms);
        for fault in faults.iter().filter(|fault| !fault.is_of_frame()) {
            self.apply(*fault, now_ms);
            schedule.count(*fault);
        }
        faults.retain(|fault| fault.is_of_frame());
        let mut replies = Vec::new();
        while self.delayed.front().is_some_and(|(due, _)| *due <= self.frames) {
            replies.extend(self.delayed.pop_front().map(|(_, reply)| reply));
        }
        let muted = now_ms < self.muted_until_ms && only_writes_process_data(&mut passing);
        if muted || now_ms < self.stalled_until_ms {
            return replies;
        }
        if faults.contains(&Fault::Drop) {
            schedule.count(Fault::Drop);
            return replies;
        }
        if !self.pass(&mut passing, now.ns) {
            return replies;
        }
        if faults.contains(&Fault::Lose) {
            schedule.count(Fault::Lose);
            return replies;
        }
        faults.iter().for_each(|fault| schedule.count(*fault));
        self.answer(frame, passing, &faults, &mut replies);
        replies
    }

    /// Passes a frame of another protocol on; the first slave that does not let it pass destroys it.
    fn foreign(&self, frame: Vec<u8>) -> Vec<Vec<u8>> {
        let Route { visits, back_ns } = self.wiring.route(&self.slaves);
        let mut passed = visits.iter().filter_map(|visit| self.slaves.get(visit.slave));
        match back_ns.is_some() && !is_ethercat(&frame) && passed.all(Slave::passes_foreign_frames) {
            true => vec![frame],
            false => Vec::new(),
        }
    }

    /// Passes a frame through the slaves that it can reach; returns false if it does not come back.
    fn pass(&mut self, frame: &mut [u8], now_ns: u64) -> bool {
        let route = self.wiring.route(&self.slaves);
        if route.visits.is_empty() {
            return false;
        }
        let at = |offset_ns: u64| now_ns.saturating_add(offset_ns);
        let mut damaged = false;
        for visit in route.visits {
            let index = visit.slave;
            if let Some(left) = self.damaging.get_mut(index).filter(|left| **left > 0 && !damaged) {
                *left -= 1;
                damaged = true;
                self.slaves
                    .iter_mut()
                    .skip(index)
                    .take(1)
                    .for_each(|slave| slave.count_damage(false));
                continue;
            }
            let (Some(slave), Some(mut datagrams)) = (self.slaves.get_mut(index), Datagrams::of_frame(frame)) else {
                continue;
            };
            if damaged {
                slave.count_damage(true);
                continue;
            }
            slave.begin_frame(at(visit.arrival_ns), visit.back_ns.map(|back_ns| back_ns.map(at)));
            while let Some(mut datagram) = datagrams.next() {
                slave.pass(&mut datagram);
            }
        }
        mark_processed(frame);
        !damaged && route.back_ns.is_some()
    }

    /// Returns the reply with the scripted faults.
    fn answer(&mut self, request: &[u8], mut reply: Vec<u8>, faults: &[Fault], replies: &mut Vec<Vec<u8>>) {
        let (mut delay, mut copies) = (0, 1);
        for fault in faults {
            match *fault {
                Fault::Delay(frames) => delay = frames,
                Fault::Duplicate => copies = 2,
                Fault::Foreign => replies.push(FOREIGN_FRAME.to_vec()),
                Fault::Reflect => replies.push(request.to_vec()),
                fault => damage::change(&mut reply, fault),
            }
        }
        damage::envelop(&mut reply, faults);
        for _ in 0..copies {
            if delay == 0 {
                replies.push(reply.clone());
            } else {
                self.delayed
                    .push_back((self.frames.saturating_add(delay), reply.clone()));
            }
        }
    }

    /// How long a frame of the master travels at present, ns; `None` if it does not come back.
    pub(crate) fn travel_ns(&self) -> Option<u64> {
        self.wiring.route(&self.slaves).back_ns
    }

    /// Whether frames of the master reach each slave.
    pub(crate) fn reached(&self) -> Vec<bool> {
        let mut reached = vec![false; self.slaves.len()];
        for visit in self.wiring.route(&self.slaves).visits {
            reached
                .iter_mut()
                .skip(visit.slave)
                .take(1)
                .for_each(|flag| *flag = true);
        }
        reached
    }

    fn show_links(&mut self) {
        let links = self.wiring.links(&self.slaves);
        for (slave, links) in self.slaves.iter_mut().zip(links) {
            slave.set_links(links);
        }
    }

    /// Exchanges the places of two slaves, from 1, whose cables lie open for a while.
    fn recable(&mut self, one: usize, other: usize) {
        let (Some(one), Some(other)) = (one.checked_sub(1), other.checked_sub(1)) else {
            return;
        };
        if one.max(other) >= self.slaves.len() {
            return;
        }
        for place in [one, other] {
            self.wiring.open(place, RECABLING_MS);
        }
        self.slaves.swap(one, other);
        self.numbers.swap(one, other);
        self.mains_off_ms.swap(one, other);
    }

    fn with_drive(&mut self, slave: usize, work: impl FnOnce(&mut Drive)) {
        self.with(slave, |slave| {
            if let Some(drive) = slave.drive_mut() {
                work(drive);
            }
        });
    }

    /// A slave, from 1.
    pub(crate) fn slave(&self, slave: usize) -> Option<&Slave> {
        self.slaves.get(slave.checked_sub(1)?)
    }

    /// Does something with a slave, from 1, if it exists.
    pub(crate) fn with(&mut self, slave: usize, work: impl FnOnce(&mut Slave)) {
        if let Some(slave) = slave.checked_sub(1).and_then(|index| self.slaves.get_mut(index)) {
            work(slave);
        }
    }
}

/// Whether a frame has nothing but datagrams that write process data.
fn only_writes_process_data(frame: &mut [u8]) -> bool {
    let Some(mut datagrams) = Datagrams::of_frame(frame) else {
        return false;
    };
    let mut only = true;
    while let Some(datagram) = datagrams.next() {
        only &= datagram.command() == Command::Lwr;
    }
    only
}
