//! The supervisor's record of the slaves, and its access to them.
//!
//! Invariant: every change of a slave's condition sends the resulting plan; a slave on which work is in progress may
//! show any AL state without disturbing the critical side.

use super::super::acyclic::{AcyclicPort, IN_FLIGHT_MAX, Request};
use super::super::clock::{self, BusClocks, Presence};
use super::super::configure::discovery;
use super::super::cyclic::{CyclicPlan, CyclicSlave, ExchangeKind, PlanError, ReferenceClock, VALUES_MAX, ValueBit};
use super::super::driver::SlaveFactory;
use super::super::error::BusError;
use super::super::event::{BusEvent, BusSetup, Step};
use super::super::process_data;
use super::super::slave::{Condition, Slave, SlaveData};
use super::super::slave_set::SlaveSet;
use super::super::state::{AlReport, AlState};
use super::super::wire::{Address, Command, register};
use super::inbox::{Expectation, STATUS_MASK};
use super::{DISTURBANCES_MAX, Failure, LookList};
use core::ops::Range;
use heapless::Vec;
use heapless::spsc::Producer;

/// Longest wait for the application to take an event, ms.
const EVENT_TIMEOUT_MS: u32 = 50;
/// How long it takes at most until a plan is in force, ms.
pub(super) const PLAN_MS: u32 = 3;
/// Slaves inspected in one frame.
pub(super) const LOOK_MAX: usize = IN_FLIGHT_MAX;

/// What a request to a slave that is not there ends with.
pub(super) const LOST_SLAVE: BusError = BusError::WorkingCounter { expected: 1, actual: 0 };

/// A slave's file that is open, see `files`.
#[derive(Clone, Copy, Debug)]
pub(super) struct OpenFile {
    /// The slave.
    pub(super) number: usize,
    pub(super) writes: bool,
    /// Whether the slave was brought to BOOT.
    pub(super) bootstrap: bool,
    /// Number of the last packet.
    pub(super) packet: u32,
    /// First byte of the packet in the buffer that was not passed on.
    pub(super) passed: usize,
    /// Whether the last packet has come or gone.
    pub(super) ended: bool,
    /// When the last request for the file ended, carried out or not.
    pub(super) used_ms: u32,
}

/// The slaves, and the queues to reach them.
pub(super) struct Bus<'a, F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> {
    pub(super) port: AcyclicPort<'a, MESSAGE>,
    plans: Producer<'a, CyclicPlan<F, SLAVES>>,
    /// Frames of a cycle in each direction.
    frames: u8,
    events: Producer<'a, BusEvent>,
    pub(super) setup: BusSetup<F>,
    /// When inputs are read and outputs are written: as the setup says, unless a member cannot.
    pub(super) exchange: ExchangeKind,
    pub(super) slaves: Vec<Slave<F>, SLAVES>,
    /// Where the values are that the application wants.
    pub(super) values: [ValueBit; VALUES_MAX],
    pub(super) clocks: BusClocks<SLAVES>,
    /// Number of the clocks' present time.
    pub(super) time_number: u8,
    /// Number of slaves that were in the chain at bring-up; they come first, in chain order.
    pub(super) ordered: usize,
    /// Terminals that have had process data since the bring-up: one that shows none now was not read as it is.
    pub(super) exchanged: SlaveSet,
    pub(super) generation: u8,
    /// Station address of the clock whose time the last plan distributes; 0 for none.
    distributes: u16,
    worked_on: Option<usize>,
    pub(super) cable_next: usize,
    /// Whether a slave in use was asked to go to OP since the last time all were taken out of it.
    pub(super) asked_for_operation: bool,
    /// Whether the bus was brought up.
    pub(super) is_running: bool,
    /// Whether a slave has fallen silent since the chain was last looked through: it may return without its address.
    pub(super) has_lost: bool,
    pub(super) events_dropped: u32,
    /// A long value between two pieces of its transfer.
    pub(super) value: Vec<u8, MESSAGE>,
    /// The file that is open.
    pub(super) file: Option<OpenFile>,
}

impl<'a, F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> Bus<'a, F, SLAVES, MESSAGE> {
    pub(super) fn new(
        port: AcyclicPort<'a, MESSAGE>,
        plans: Producer<'a, CyclicPlan<F, SLAVES>>,
        frames: u8,
        events: Producer<'a, BusEvent>,
    ) -> Self {
        Self {
            port,
            plans,
            frames,
            events,
            setup: BusSetup::default(),
            exchange: ExchangeKind::default(),
            slaves: Vec::new(),
            values: [ValueBit::MISSING; VALUES_MAX],
            clocks: BusClocks::default(),
            time_number: 0,
            ordered: 0,
            exchanged: SlaveSet::NONE,
            generation: 0,
            distributes: 0,
            worked_on: None,
            cable_next: 0,
            asked_for_operation: false,
            is_running: false,
            has_lost: false,
            events_dropped: 0,
            value: Vec::new(),
            file: None,
        }
    }

    pub(super) async fn emit(&mut self, event: BusEvent) {
        for _ in 0..EVENT_TIMEOUT_MS {
            if self.events.enqueue(event).is_ok() {
                return;
            }
            self.port.wait_ms(1).await;
        }
        self.events_dropped = self.events_dropped.saturating_add(1);
    }

    pub(super) async fn refuse(&mut self, failure: Failure) {
        let Failure { position, step, error } = failure;
        let position = position.map(|position| position as u8);
        self.emit(BusEvent::Refused { position, step, error }).await;
    }

    /// Gives up bringing a terminal to OP, and reports why; all others go on without it.
    pub(super) async fn refuse_terminal(&mut self, number: usize, failure: Failure) {
        let Some(slave) = self.slaves.get_mut(number) else {
            return;
        };
        slave.data = SlaveData::Unknown;
        if !matches!(slave.condition, Condition::Lost | Condition::Returned) {
            slave.condition = Condition::LeftOperational;
        }
        let Failure { step, error, .. } = failure;
        let position = slave.position as u8;
        self.inspect(number..number + 1).await;
        self.send_plan().await;
        self.emit(BusEvent::TerminalRefused { position, step, error }).await;
    }

    /// Why a member does not operate as it should: the first that is lost, else the first that has left its state. One that was
    /// away for a moment counts as lost.
    pub(super) fn disturbed_member(&self) -> Option<Failure> {
        let members = || self.slaves.iter().filter(|slave| slave.member.is_some());
        let is_lost = |slave: &&Slave<F>| match slave.condition {
            Condition::Lost => true,
            Condition::LeftOperational | Condition::Returned => slave.report.is(AlState::Operational),
            _ => false,
        };
        let has_left = |slave: &&Slave<F>| matches!(slave.condition, Condition::LeftOperational | Condition::Returned);
        let lost = members().find(is_lost).map(|slave| (slave, LOST_SLAVE));
        let left = || {
            let left = members().find(has_left);
            left.map(|slave| (slave, slave.report.instead_of(AlState::Operational)))
        };
        lost.or_else(left)
            .map(|(slave, error)| Failure::of(slave.position, Step::Watch)(error))
    }

    /// The terminal with this number and why it is refused, if it has left its state, or is given up.
    pub(super) fn left_terminal(&self, number: usize, is_given_up: bool) -> Option<(usize, Failure)> {
        let slave = self.slaves.get(number).filter(|slave| slave.is_terminal)?;
        let has_left = matches!(slave.condition, Condition::LeftOperational | Condition::Returned);
        let error = match slave.condition {
            _ if has_left => slave.report.instead_of(AlState::Operational),
            Condition::Lost => LOST_SLAVE,
            _ => BusError::Lost {
                tries: DISTURBANCES_MAX,
            },
        };
        (has_left || is_given_up).then(|| (number, Failure::of(slave.position, Step::Watch)(error)))
    }

    /// Whether a slave is being brought up, and was not refused.
    pub(super) fn is_on_the_way(&self, number: usize) -> bool {
        self.slaves
            .get(number)
            .is_some_and(|slave| slave.condition == Condition::Configuring)
    }

    /// Whether a slave takes part with its own process data.
    pub(super) fn is_terminal(&self, number: usize) -> bool {
        self.slaves.get(number).is_some_and(|slave| slave.is_terminal)
    }

    /// Reports a slave with its last known state.
    pub(super) async fn introduce(&mut self, number: usize) {
        let Some(slave) = self.slaves.get(number) else { return };
        let identity = slave.identity();
        let event = BusEvent::Slave {
            position: slave.position as u8,
            identity,
            name: slave.name(),
            member: slave.member,
            report: slave.report,
        };
        self.emit(event).await;
    }

    /// Reports all slaves with their last known states.
    pub(super) async fn introduce_all(&mut self) {
        for number in 0..self.slaves.len() {
            self.introduce(number).await;
        }
    }

    /// Reads the states of all slaves that answer.
    pub(super) async fn read_reports(&mut self) {
        for first in (0..self.slaves.len()).step_by(LOOK_MAX) {
            let reports = self.reports(first..first + LOOK_MAX).await;
            for (slave, report) in self.slaves.iter_mut().skip(first).zip(reports) {
                slave.report = report.unwrap_or(slave.report);
            }
        }
    }

    /// AL status and code of at most [`LOOK_MAX`] slaves, read in one frame; `None` for those that do not answer.
    pub(super) async fn reports(&mut self, numbers: Range<usize>) -> LookList<Option<AlReport>> {
        let mut reports = LookList::new();
        let mut requests: LookList<Request> = LookList::new();
        for slave in self.slaves.iter().skip(numbers.start).take(numbers.len().min(LOOK_MAX)) {
            let address = Address::station(slave.station(), register::AL_STATUS);
            // Both lists have room for one frame's slaves.
            let _ = requests.push(Request::read(Command::Fprd, address, AlReport::LEN));
            let _ = reports.push(None);
        }
        // A slave that does not answer has no report, whatever the reason.
        let _ = self
            .port
            .send_all_until_counted(&requests, 1, |number, bytes| {
                if let Some(report) = reports.get_mut(number) {
                    *report = Some(AlReport::parse(bytes));
                }
            })
            .await;
        reports
    }

    /// The plan that results from the slaves' conditions.
    fn plan(&self) -> CyclicPlan<F, SLAVES> {
        let worked_on = self.worked_on;
        let slaves = (0..).zip(&self.slaves).map(|(number, slave)| CyclicSlave {
            watched: slave.condition == Condition::Operational && worked_on != Some(number),
            ..process_data::cyclic_slave(slave)
        });
        let ignored = (0..).zip(&self.slaves).map(|(number, slave)| {
            // A terminal that is not in OP keeps no member from operating.
            let idle = !slave.is_used()
                || slave.condition == Condition::Parked
                || slave.is_terminal && slave.condition != Condition::Operational;
            match (worked_on == Some(number), idle) {
                (true, _) => STATUS_MASK,
                // A slave that returns is in INIT: a terminal waits there for its repair, an unused one to be recognised.
                (false, true) if slave.condition == Condition::Lost && slave.member.is_none() => AlState::Init as u16,
                (false, true) => u16::from(slave.report.status),
                (false, false) => 0,
            }
        });
        CyclicPlan {
            // The OP bit is the one that concerns the slaves in use.
            al_bits_ignored: ignored.fold(register::AL_IDENTIFY_BIT, |bits, slave| bits | slave)
                & !(AlState::Operational as u16),
            slaves: slaves.collect(),
            exchange: self.exchange,
            clock: self.reference_clock(),
            values: self.values,
            message: self.longest_message(),
            terminals: (0..)
                .zip(&self.slaves)
                .filter(|(_, slave)| slave.is_terminal)
                .map(|(number, _)| number)
                .collect(),
        }
    }

    /// The longest mailbox of the slaves in use, bytes. A slave with a longer one than this master takes is refused alone.
    fn longest_message(&self) -> u16 {
        let used = self.slaves.iter().filter(|slave| slave.is_used());
        let windows = used.flat_map(|slave| [slave.fixed.mailbox_out.length, slave.fixed.mailbox_in.length]);
        windows
            .filter(|length| usize::from(*length) <= MESSAGE)
            .max()
            .unwrap_or(0)
    }

    /// Fails if the slaves' process data leave no room in the frames for the longest mailbox of those in use.
    pub(super) fn check_plan(&self) -> Result<(), BusError> {
        let longest = self.longest_message();
        self.plan().check(self.frames.into()).map_err(|error| match error {
            PlanError::ProcessData { expected, actual, .. } => BusError::ProcessLength { expected, actual },
            PlanError::Span { expected, actual, .. } => BusError::ProcessLength {
                expected: expected as u16,
                actual: u16::try_from(actual).unwrap_or(u16::MAX),
            },
            PlanError::Room { expected, actual } => BusError::NoRoom {
                expected: longest,
                actual: longest.saturating_sub(actual.saturating_sub(expected) as u16),
            },
        })
    }

    /// Sends the plan that results from the slaves' conditions.
    pub(super) async fn send_plan(&mut self) {
        let mut plan = self.plan();
        self.distributes = plan.clock.map_or(0, |clock| clock.station);
        while let Err(back) = self.plans.enqueue(plan) {
            plan = back;
            self.port.wait_ms(1).await;
        }
    }

    /// Sends a plan in which no slave is used: the outputs become 0.
    pub(super) async fn send_safe_plan(&mut self) {
        let slaves = self.slaves.iter().map(|slave| CyclicSlave {
            role: None,
            watched: false,
            ..process_data::cyclic_slave(slave)
        });
        let mut plan = CyclicPlan {
            slaves: slaves.collect(),
            exchange: self.exchange,
            al_bits_ignored: STATUS_MASK,
            clock: self.reference_clock(),
            values: [ValueBit::MISSING; VALUES_MAX],
            terminals: SlaveSet::NONE,
            message: self.longest_message(),
        };
        self.distributes = plan.clock.map_or(0, |clock| clock.station);
        while let Err(back) = self.plans.enqueue(plan) {
            plan = back;
            self.port.wait_ms(1).await;
        }
    }

    /// The reference clock whose time is distributed in each cycle, if the clocks were set up.
    fn reference_clock(&self) -> Option<ReferenceClock> {
        let there = self.answering();
        let answers = |position: usize| there.get(position).is_some_and(|there| *there);
        self.clocks.reference_clock(&self.stations(), answers)
    }

    /// Number of the slave whose clock's time is distributed.
    pub(super) fn distributor(&self) -> Option<usize> {
        let station = self.reference_clock()?.station;
        self.slaves.iter().position(|slave| slave.station() == station)
    }

    /// Which slaves are not lost.
    pub(super) fn answering(&self) -> Vec<bool, SLAVES> {
        let is_there = |slave: &Slave<F>| slave.condition != Condition::Lost;
        self.slaves.iter().map(is_there).collect()
    }

    /// What a measurement may expect of each slave: only members need their clocks.
    fn presences(&self) -> Vec<Presence, SLAVES> {
        let presence = |slave: &Slave<F>| match slave.condition {
            Condition::Lost => Presence::Lost,
            _ if slave.member.is_some() => Presence::Used,
            _ => Presence::Unused,
        };
        self.slaves.iter().map(presence).collect()
    }

    /// Continues the master's record of the bus time, see [`clock::follow`].
    pub(super) async fn follow_clock(&mut self) {
        let (stations, there) = (self.stations(), self.answering());
        let answers = |position: usize| there.get(position).is_some_and(|there| *there);
        clock::follow(&mut self.port, &stations, &mut self.clocks, answers).await;
    }

    /// Tells the clocks their delays after another slave has begun to distribute its time, see [`clock::tell_delays`]. What
    /// fails is tried again with the next look at the bus.
    pub(super) async fn tell_delays(&mut self) {
        let (stations, presences) = (self.stations(), self.presences());
        let presence = |position: usize| presences.get(position).copied().unwrap_or(Presence::Lost);
        let _ = clock::tell_delays(&mut self.port, &stations, &mut self.clocks, presence).await;
        if self.reference_clock().map_or(0, |clock| clock.station) != self.distributes {
            // The chain has another first slave, to which the time of the one before was written. Or this was interrupted here.
            self.send_plan().await;
            self.port.wait_ms(PLAN_MS).await;
            let _ = clock::tell_delays(&mut self.port, &stations, &mut self.clocks, presence).await;
        }
    }

    /// The station addresses of all slaves.
    pub(super) fn stations(&self) -> Vec<u16, SLAVES> {
        self.slaves.iter().map(Slave::station).collect()
    }

    /// Begins or ends work on a slave; its state changes meanwhile do not count as a disturbance.
    pub(super) async fn work_on(&mut self, number: Option<usize>) {
        if let (Some(before), None) = (self.worked_on, number) {
            self.inspect(before..before + 1).await;
        }
        self.worked_on = number;
        self.clocks.hold(false);
        self.send_plan().await;
    }

    /// Sets the clock of a slave that was switched off or cut off. Meanwhile the reference's time is only read: FRMW would
    /// write a time that was expected a cycle before to the clocks before the reference.
    pub(super) async fn restore_clock(&mut self, number: usize) -> Result<(), BusError> {
        let Some(slave) = self.slaves.get(number).filter(|_| self.setup.clocks) else {
            return Ok(());
        };
        // Another slave may have taken the place.
        if let Some(found) = clock::read_clock(&mut self.port, slave.station()).await? {
            self.clocks.replace(number, &found);
        }
        if !self.clocks.has_clock(number) {
            return Ok(());
        }
        self.clocks.hold(true);
        self.send_plan().await;
        self.port.wait_ms(PLAN_MS).await;
        let (stations, mut presences) = (self.stations(), self.presences());
        let is_member = self.slaves.get(number).is_some_and(|slave| slave.member.is_some());
        if let Some(presence) = presences.get_mut(number) {
            // It answers, even if it is still marked as lost.
            *presence = if is_member { Presence::Used } else { Presence::Unused };
        }
        let presence = |position: usize| presences.get(position).copied().unwrap_or(Presence::Lost);
        let restored = clock::restore(&mut self.port, &stations, &mut self.clocks, number, presence).await;
        if let Some(slave) = self
            .slaves
            .get_mut(number)
            .filter(|slave| slave.condition == Condition::Lost)
        {
            // It answers; from now on its clock may be the one that is distributed.
            slave.condition = match slave.is_used() {
                true => Condition::Configuring,
                false => Condition::Unused,
            };
        }
        self.clocks.hold(false);
        self.send_plan().await;
        restored
    }

    /// Finds out whether an extra slave has a clock, to which the time is written too.
    pub(super) async fn add_clock(&mut self, number: usize) {
        let Some(slave) = self.slaves.get(number).filter(|_| self.setup.clocks) else {
            return;
        };
        let found = clock::read_clock(&mut self.port, slave.station()).await;
        self.clocks.add_extra(number, found.ok().flatten());
    }

    /// Number of the next slave behind `last` that did not answer when it was asked for its clock, and may answer now. The time is
    /// written to such a clock too, and is counted. A slave in use is asked by its repair: its sync signals start with its clock.
    pub(super) fn unknown_clock(&self, last: usize) -> Option<usize> {
        let is_asked = |number: usize| {
            let slave = self.slaves.get(number);
            slave.is_some_and(|slave| !slave.is_used() && slave.condition != Condition::Lost)
        };
        self.clocks.unknown(last, is_asked).filter(|_| self.setup.clocks)
    }

    /// Whether work on a slave is in progress.
    pub(super) const fn is_worked_on(&self) -> bool {
        self.worked_on.is_some()
    }

    /// Number of slaves that should answer.
    pub(super) fn present(&self) -> u16 {
        let present = |slave: &&Slave<F>| slave.condition != Condition::Lost;
        self.slaves.iter().filter(present).count() as u16
    }

    /// Whether all members are in OP.
    pub(super) fn is_operational(&self) -> bool {
        let mut used = self.slaves.iter().filter(|slave| slave.member.is_some());
        used.all(|slave| slave.condition == Condition::Operational)
    }

    /// What the critical side should see; a slave on which work is in progress is excluded.
    pub(super) fn expectation(&self, worked_on: Option<usize>) -> Expectation {
        let (mut status, mut answering) = (0, SlaveSet::NONE);
        for (number, slave) in self.slaves.iter().enumerate() {
            if slave.condition == Condition::Lost {
                continue;
            }
            status |= u16::from(slave.report.status);
            let exchanges = slave.lengths() != (0, 0);
            if slave.condition == Condition::Operational && worked_on != Some(number) && exchanges {
                answering |= SlaveSet::of(number);
            }
        }
        let (required, allowed) = match worked_on {
            None => (status, status),
            Some(_) => (0, register::AL_STATE_MASK | status & register::AL_ERROR_BIT),
        };
        Expectation {
            slaves: Some(self.present()),
            required,
            allowed,
            answering,
        }
    }

    /// Queries slaves for their state, and reports changes.
    pub(super) async fn inspect(&mut self, numbers: Range<usize>) {
        let mut changed = false;
        let goes_on = self.distributor().is_some();
        let last = numbers.end.min(self.slaves.len());
        for first in (numbers.start..last).step_by(LOOK_MAX) {
            let reports = self.reports(first..last.min(first + LOOK_MAX)).await;
            for (number, report) in (first..).zip(reports) {
                let mut report = report;
                let is_back = self.is_lost(number) && report.is_some();
                if is_back && self.disown(number).await {
                    report = None;
                } else if is_back && goes_on {
                    self.clocks.was_alone(number);
                }
                if self.is_lost(number) != report.is_none() {
                    self.clocks.chain_changed();
                }
                changed |= self.judge(number, report).await;
            }
        }
        let is_new = self.find_distributor().await;
        if changed || is_new {
            self.send_plan().await;
            self.tell_delays().await;
        }
    }

    /// Gives the bus a distributor of its time if it has lost the last one, see [`clock::find_source`].
    async fn find_distributor(&mut self) -> bool {
        if self.distributor().is_some() {
            return false;
        }
        let (stations, there) = (self.stations(), self.answering());
        let answers = |position: usize| there.get(position).is_some_and(|there| *there);
        clock::find_source(&mut self.port, &stations, &mut self.clocks, answers).await
    }

    /// Takes the address from a slave that comes back with the mapping of another master, and the mapping: it disturbs the
    /// exchange, and may be any slave that has the address. It is a stranger from then on. Returns whether it was one; if it
    /// could not be made a stranger, the next inspection tries again.
    async fn disown(&mut self, number: usize) -> bool {
        let Some(slave) = self.slaves.get(number) else {
            return false;
        };
        let (station, share) = (slave.station(), process_data::share(slave));
        let is_foreign = discovery::maps_outside(&mut self.port, station, share).await == Ok(true);
        if is_foreign && self.make_stranger(station).await.is_err() {
            // The chain may be changing, or too long to be looked through.
            let _ = discovery::clear_fmmus(&mut self.port, station).await;
        }
        is_foreign
    }

    fn is_lost(&self, number: usize) -> bool {
        let slave = self.slaves.get(number);
        slave.is_some_and(|slave| slave.condition == Condition::Lost)
    }

    /// Takes a slave's report, or `None` if it does not answer; returns whether its condition changed.
    async fn judge(&mut self, number: usize, answer: Option<AlReport>) -> bool {
        let Some(slave) = self.slaves.get_mut(number) else {
            return false;
        };
        let (condition, report) = match answer {
            None => (Condition::Lost, AlReport::default()),
            Some(report) if !slave.is_used() => (Condition::Unused, report),
            Some(report) => match slave.condition {
                // Only a repair brings a slave back into use.
                Condition::Operational if report.is(AlState::Operational) => (Condition::Operational, report),
                left_alone @ (Condition::Parked | Condition::Unused) => (left_alone, report),
                Condition::Lost | Condition::Returned => (Condition::Returned, report),
                // A bring-up that another slave ended has left it where it was.
                Condition::Configuring if !report.is_flagged() => (Condition::Configuring, report),
                _ => (Condition::LeftOperational, report),
            },
        };
        if (condition, report) == (slave.condition, slave.report) {
            return false;
        }
        (slave.condition, slave.report) = (condition, report);
        let position = slave.position as u8;
        self.has_lost |= condition == Condition::Lost;
        match condition {
            Condition::Lost => self.emit(BusEvent::SlaveLost { position }).await,
            Condition::LeftOperational | Condition::Returned => {
                self.emit(BusEvent::SlaveLeft { position, report }).await;
            }
            _ => self.introduce(number).await,
        }
        true
    }
}
