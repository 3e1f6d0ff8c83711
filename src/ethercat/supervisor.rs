//! Brings the bus up, watches it, and repairs it.
//!
//! One `async` function runs for ever, polled once a millisecond at low priority. It configures the slaves of the chain,
//! hands the critical side its plan, takes the drives to OP while cyclic data already run, and then looks for slaves
//! that vanish or leave OP. A repair, started by [`BusCommand::Recover`], brings such a slave back while the others go
//! on. Every step's failure is reported with slave, step and reason.
//!
//! Invariants: nothing is repaired without a command; a slave is only taken back if it is the product that was there
//! before; all waiting ends.

use super::acyclic::AcyclicPort;
use super::clock::{self, BusClocks};
use super::configure;
use super::cyclic::{CyclicPlan, Observation};
use super::error::BusError;
pub use super::event::{BusCommand, BusEvent, BusSetup, Step};
use super::factory;
use super::mailbox::Mailbox;
use super::service::{ServiceRequest, ServiceResult};
use super::slave::{Condition, ProcessData, STATION_BASE, Slave};
use super::state::{self, AlReport, AlState};
use super::wire::register;
use crate::robot::AXES;
use heapless::Vec;
use heapless::spsc::{Consumer, Producer};

/// Longest wait for the expected number of slaves, ms.
pub const DISCOVERY_TIMEOUT_MS: u32 = 3_000;
/// How long the number of slaves has to stay the same, ms.
const STABLE_MS: u32 = 10;
/// Longest wait for the first inputs, ms.
const INPUTS_TIMEOUT_MS: u32 = 1_000;
/// How long outputs are sent before a drive is asked for OP, ms.
const OUTPUTS_BEFORE_OPERATIONAL_MS: u32 = 10;
/// How long something has to look wrong before the slaves are asked, ms.
const SUSPICION_MS: u32 = 3;
/// Pause between two inspections of the same suspicion, ms.
const INSPECTION_PAUSE_MS: u32 = 50;
/// Period of the supervisor's own look at one slave after the other, ms.
const LOOK_PERIOD_MS: u32 = 20;
/// Longest wait for the application to take an event, ms.
const EVENT_TIMEOUT_MS: u32 = 50;
/// State and error flag of an AL status register.
const STATUS_MASK: u16 = register::AL_STATE_MASK | register::AL_ERROR_BIT;

const _: () = {
    assert!(
        SUSPICION_MS + INSPECTION_PAUSE_MS < 100,
        "changes are noticed within 100 ms"
    );
};

/// The supervisor's ends of the queues.
pub struct SupervisorEnd<'a, const SLAVES: usize, const MESSAGE: usize> {
    /// Plans for the critical side.
    pub plans: Producer<'a, CyclicPlan<SLAVES>>,
    /// Acyclic requests and their replies.
    pub port: AcyclicPort<'a, MESSAGE>,
    /// What the critical side sees.
    pub observations: Consumer<'a, Observation>,
    /// Orders of the application.
    pub commands: Consumer<'a, BusCommand>,
    /// Reports to the application.
    pub events: Producer<'a, BusEvent>,
    /// Requests beside the robot's work.
    pub services: Consumer<'a, ServiceRequest>,
    /// Their answers, one each, in order.
    pub answers: Producer<'a, ServiceResult>,
}

/// A failed step.
#[derive(Clone, Copy, Debug)]
struct Failure {
    position: Option<u16>,
    step: Step,
    error: BusError,
}

impl Failure {
    fn of(position: u16, step: Step) -> impl Fn(BusError) -> Self {
        move |error| Self {
            position: Some(position),
            step,
            error,
        }
    }

    fn bus(step: Step) -> impl Fn(BusError) -> Self {
        move |error| Self {
            position: None,
            step,
            error,
        }
    }
}

/// Brings the bus up, watches it and repairs it.
pub struct Supervisor<'a, const SLAVES: usize, const MESSAGE: usize> {
    end: SupervisorEnd<'a, SLAVES, MESSAGE>,
    setup: BusSetup,
    started: bool,
    running: bool,
    slaves: Vec<Slave, SLAVES>,
    clocks: BusClocks<SLAVES>,
    generation: u8,
    extra_reported: u16,
    seen: Option<Observation>,
    suspicion_ms: u32,
    inspected_ms: u32,
    looked_ms: u32,
    look_next: usize,
    events_dropped: u32,
}

impl<'a, const SLAVES: usize, const MESSAGE: usize> Supervisor<'a, SLAVES, MESSAGE> {
    /// A supervisor that waits for [`BusCommand::Start`].
    pub fn new(end: SupervisorEnd<'a, SLAVES, MESSAGE>) -> Self {
        Self {
            end,
            setup: BusSetup::default(),
            started: false,
            running: false,
            slaves: Vec::new(),
            clocks: BusClocks::default(),
            generation: 0,
            extra_reported: 0,
            seen: None,
            suspicion_ms: 0,
            inspected_ms: 0,
            looked_ms: 0,
            look_next: 0,
            events_dropped: 0,
        }
    }

    /// Events that the application did not take in time.
    pub const fn events_dropped(&self) -> u32 {
        self.events_dropped
    }

    /// The supervisor's whole life; to be polled once a millisecond.
    pub async fn run(&mut self) -> ! {
        loop {
            match self.end.commands.dequeue() {
                Some(BusCommand::Start(setup)) => {
                    self.setup = setup;
                    self.started = true;
                    self.start().await;
                }
                Some(BusCommand::Recover) if self.running => self.recover().await,
                Some(BusCommand::Recover) if self.started => self.start().await,
                Some(BusCommand::Recover) => {}
                None if self.running => self.watch().await,
                None => self.end.port.wait_ms(1).await,
            }
        }
    }

    async fn start(&mut self) {
        self.running = false;
        match self.bring_up().await {
            Ok(()) => {
                self.running = true;
                self.emit(BusEvent::Operational).await;
            }
            Err(failure) => self.refuse(failure).await,
        }
    }

    async fn emit(&mut self, event: BusEvent) {
        for _ in 0..EVENT_TIMEOUT_MS {
            if self.end.events.enqueue(event).is_ok() {
                return;
            }
            self.end.port.wait_ms(1).await;
        }
        self.events_dropped = self.events_dropped.saturating_add(1);
    }

    async fn refuse(&mut self, failure: Failure) {
        let Failure { position, step, error } = failure;
        self.emit(BusEvent::Refused {
            position: position.map(|position| position as u8),
            step,
            error,
        })
        .await;
    }

    /// Reports a slave with its present state.
    async fn introduce(&mut self, number: usize) {
        let Some(slave) = self.slaves.get(number).copied() else {
            return;
        };
        let report = state::report(&mut self.end.port, slave.station())
            .await
            .unwrap_or_default();
        if let Some(slave) = self.slaves.get_mut(number) {
            slave.report = report;
        }
        let identity = slave.identity();
        let event = BusEvent::Slave {
            position: slave.position as u8,
            identity,
            name: factory::name(slave.kind),
            axis: slave.axis,
            report,
        };
        self.emit(event).await;
    }

    /// Sends the plan that follows from the slaves' conditions.
    async fn send_plan(&mut self) {
        let slaves = self.slaves.iter().map(|slave| super::cyclic::CyclicSlave {
            watched: slave.condition == Condition::Operational,
            ..configure::cyclic_slave(slave)
        });
        let idle = self.slaves.iter().filter(|slave| slave.axis.is_none());
        let idle_bits = idle.fold(0, |bits, slave| bits | u16::from(slave.report.status));
        let mut plan = CyclicPlan {
            slaves: slaves.collect(),
            exchange: self.setup.bus.exchange,
            // The bit of OP is the one that tells of the slaves in use.
            al_bits_ignored: idle_bits & !(AlState::Operational as u16),
            clock: self.clocks.reference_clock(&self.stations(), |position| {
                let slave = self.slaves.get(position);
                slave.is_some_and(|slave| slave.condition != Condition::Lost)
            }),
            ..CyclicPlan::default()
        };
        while let Err(back) = self.end.plans.enqueue(plan) {
            plan = back;
            self.end.port.wait_ms(1).await;
        }
    }

    fn observe(&mut self) {
        while let Some(observation) = self.end.observations.dequeue() {
            self.seen = Some(observation);
        }
    }

    async fn bring_up(&mut self) -> Result<(), Failure> {
        self.slaves.clear();
        self.send_plan().await;
        let found = self.discover().await.map_err(Failure::bus(Step::Discover))?;
        self.emit(BusEvent::Found { slaves: found }).await;
        if usize::from(found) > SLAVES {
            let error = BusError::TooManySlaves {
                expected: SLAVES as u16,
                actual: found,
            };
            return Err(Failure::bus(Step::Discover)(error));
        }
        configure::reset_all(&mut self.end.port)
            .await
            .map_err(Failure::bus(Step::Reset))?;
        for position in 0..found {
            self.identify(position).await?;
        }
        self.give_axes().map_err(Failure::bus(Step::Identify))?;
        for number in 0..self.slaves.len() {
            self.introduce(number).await;
        }
        self.set_up_clocks().await?;
        for number in 0..self.slaves.len() {
            self.reach_safe_operational(number).await?;
        }
        self.send_plan().await;
        for number in 0..self.slaves.len() {
            self.reach_operational(number).await?;
        }
        self.send_plan().await;
        for number in 0..self.slaves.len() {
            self.introduce(number).await;
        }
        Ok(())
    }

    /// Lets the slaves' clocks agree and has the reference's time spread from now on.
    async fn set_up_clocks(&mut self) -> Result<(), Failure> {
        self.clocks = BusClocks::default();
        if !self.setup.bus.clocks {
            return Ok(());
        }
        let stations = self.stations();
        self.clocks = clock::set_up(&mut self.end.port, &stations)
            .await
            .map_err(Failure::bus(Step::Clocks))?;
        self.send_plan().await;
        Ok(())
    }

    fn stations(&self) -> Vec<u16, SLAVES> {
        self.slaves.iter().map(Slave::station).collect()
    }

    /// Waits until as many slaves as expected are there and their number stays the same.
    async fn discover(&mut self) -> Result<u16, BusError> {
        let expected = u16::from(self.setup.bus.drives);
        let (started_ms, mut found, mut since_ms) = (self.end.port.now_ms(), 0, self.end.port.now_ms());
        loop {
            let count = self
                .end
                .port
                .broadcast_read_u16(register::AL_STATUS)
                .await
                .map_or(0, |(_, slaves)| slaves);
            let now_ms = self.end.port.now_ms();
            if count != found {
                (found, since_ms) = (count, now_ms);
            }
            if found >= expected && found > 0 && now_ms.wrapping_sub(since_ms) >= STABLE_MS {
                return Ok(found);
            }
            if now_ms.wrapping_sub(started_ms) > DISCOVERY_TIMEOUT_MS {
                return Err(BusError::SlaveCount {
                    expected,
                    actual: found,
                });
            }
        }
    }

    async fn identify(&mut self, position: u16) -> Result<(), Failure> {
        let station = STATION_BASE.wrapping_add(position);
        let port = &mut self.end.port;
        configure::assign_station(port, position, station)
            .await
            .map_err(Failure::of(position, Step::Address))?;
        let fixed = configure::fixed_part(port, station)
            .await
            .map_err(Failure::of(position, Step::Identify))?;
        let mut slave = Slave {
            position,
            fixed,
            kind: factory::drive_kind(&fixed.identity),
            ..Slave::default()
        };
        if slave.kind.is_none() {
            slave.kind = configure::ask_device_type(port, &slave).await;
        }
        // There is room for as many slaves as were found.
        let _ = self.slaves.push(slave);
        Ok(())
    }

    /// Gives the drives their axes in chain order.
    fn give_axes(&mut self) -> Result<(), BusError> {
        let expected = self.setup.bus.drives.min(AXES as u8);
        let drives = self.slaves.iter_mut().filter(|slave| slave.kind.is_some());
        let actual = (0..expected)
            .zip(drives)
            .map(|(axis, slave)| slave.axis = Some(axis))
            .count() as u8;
        if actual < expected {
            Err(BusError::DriveCount { expected, actual })
        } else {
            Ok(())
        }
    }

    /// Process data of another slave of the same product and revision.
    fn twin(&self, number: usize) -> Option<ProcessData> {
        let product = |slave: &Slave| {
            let identity = slave.identity();
            (identity.vendor, identity.product, identity.revision)
        };
        let wanted = product(self.slaves.get(number)?);
        let mut others = self.slaves.iter().enumerate().filter(|(other, _)| *other != number);
        others.find_map(|(_, other)| other.process_data.filter(|_| product(other) == wanted))
    }

    /// Configures a used slave from INIT to SAFEOP; leaves others alone.
    async fn reach_safe_operational(&mut self, number: usize) -> Result<(), Failure> {
        let twin = self.twin(number);
        let Some(slave) = self.slaves.get_mut(number) else {
            return Ok(());
        };
        let Some(axis) = slave.axis.and_then(|axis| self.setup.axes.get(usize::from(axis))) else {
            return Ok(());
        };
        let (port, position, station) = (&mut self.end.port, slave.position, slave.station());
        slave.condition = Condition::Configuring;
        self.generation = self.generation.wrapping_add(1);
        slave.generation = self.generation;
        let at = |step| Failure::of(position, step);

        state::change(port, station, AlState::Init)
            .await
            .map_err(at(Step::Init))?;
        configure::clear(port, station).await.map_err(at(Step::Init))?;
        slave.mailbox = Mailbox::new::<MESSAGE>(station, slave.fixed.mailbox_out, slave.fixed.mailbox_in)
            .map_err(at(Step::Mailbox))?;
        configure::mailbox_managers(port, slave)
            .await
            .map_err(at(Step::Mailbox))?;
        state::change(port, station, AlState::PreOperational)
            .await
            .map_err(at(Step::PreOperational))?;
        configure::objects(port, slave, axis, twin)
            .await
            .map_err(at(Step::Objects))?;
        let watchdog_ms = self.setup.bus.watchdog_ms;
        configure::process_data(port, slave, watchdog_ms)
            .await
            .map_err(at(Step::ProcessData))?;
        state::change(port, station, AlState::SafeOperational)
            .await
            .map_err(at(Step::SafeOperational))
    }

    /// Takes a used slave from SAFEOP to OP, once its inputs come and outputs have been sent for a while.
    async fn reach_operational(&mut self, number: usize) -> Result<(), Failure> {
        let Some(slave) = self.slaves.get(number).copied().filter(|slave| slave.axis.is_some()) else {
            return Ok(());
        };
        let at = |step| Failure::of(slave.position, step);
        let started_ms = self.end.port.now_ms();
        loop {
            self.observe();
            let waited_ms = self.end.port.now_ms().wrapping_sub(started_ms);
            let answers = self.seen.is_some_and(|seen| seen.answered & 1 << slave.position != 0);
            if answers && waited_ms >= OUTPUTS_BEFORE_OPERATIONAL_MS {
                break;
            }
            if waited_ms > INPUTS_TIMEOUT_MS {
                return Err(at(Step::CyclicData)(BusError::NoInputs { waited_ms }));
            }
            self.end.port.wait_ms(1).await;
        }
        if self.clocks.has_clock(usize::from(slave.position)) {
            let result = clock::await_agreement(&mut self.end.port, slave.station()).await;
            result.map_err(at(Step::Clocks))?;
        }
        let result = state::change(&mut self.end.port, slave.station(), AlState::Operational).await;
        result.map_err(at(Step::Operational))?;
        if let Some(slave) = self.slaves.get_mut(number) {
            slave.condition = Condition::Operational;
            slave.report = AlReport {
                status: AlState::Operational as u8,
                code: 0,
            };
        }
        Ok(())
    }

    /// One millisecond of watching.
    async fn watch(&mut self) {
        self.end.port.wait_ms(1).await;
        self.observe();
        let now_ms = self.end.port.now_ms();
        self.suspicion_ms = if self.is_suspicious() {
            self.suspicion_ms.saturating_add(1)
        } else {
            0
        };
        let paused = now_ms.wrapping_sub(self.inspected_ms) < INSPECTION_PAUSE_MS;
        if self.suspicion_ms >= SUSPICION_MS && !paused {
            self.inspect(0..self.slaves.len()).await;
            self.report_extra().await;
            self.inspected_ms = self.end.port.now_ms();
        } else if now_ms.wrapping_sub(self.looked_ms) >= LOOK_PERIOD_MS {
            self.looked_ms = now_ms;
            let number = self.look_next % self.slaves.len().max(1);
            self.look_next = number + 1;
            self.inspect(number..number + 1).await;
        }
    }

    /// Reports slaves that were plugged in behind the configured ones, once.
    async fn report_extra(&mut self) {
        let slaves = self.seen.map_or(0, |seen| seen.al.slaves);
        let known = self.slaves.len() as u16;
        if slaves > known && slaves != self.extra_reported {
            self.emit(BusEvent::Found { slaves }).await;
        }
        self.extra_reported = slaves.max(known);
    }

    /// Whether the critical side sees anything else than what is known.
    fn is_suspicious(&self) -> bool {
        let Some(seen) = self.seen else { return false };
        let present = self.slaves.iter().filter(|slave| slave.condition != Condition::Lost);
        let (count, status, answering) = present.fold((0, 0, 0_u32), |(count, status, answering), slave| {
            let answers = u32::from(slave.condition == Condition::Operational) << slave.position;
            (count + 1, status | u16::from(slave.report.status), answering | answers)
        });
        seen.silent && count > 0
            || seen.al.slaves != count
            || seen.al.status & STATUS_MASK != status
            || seen.answered & answering != answering
    }

    /// Asks slaves for their state, and reports what has changed.
    async fn inspect(&mut self, numbers: core::ops::Range<usize>) {
        let mut changed = false;
        for number in numbers {
            let Some(slave) = self.slaves.get(number).copied() else {
                continue;
            };
            let answer = state::report(&mut self.end.port, slave.station()).await;
            let (condition, report) = match answer {
                Err(_) => (Condition::Lost, AlReport::default()),
                Ok(report) if slave.axis.is_none() => (Condition::Unused, report),
                // Only a repair brings a slave back into use.
                Ok(report) if report.is(AlState::Operational) && slave.condition == Condition::Operational => {
                    (Condition::Operational, report)
                }
                Ok(report) => (Condition::LeftOperational, report),
            };
            if (condition, report) == (slave.condition, slave.report) {
                continue;
            }
            changed = true;
            if let Some(slave) = self.slaves.get_mut(number) {
                (slave.condition, slave.report) = (condition, report);
            }
            let position = slave.position as u8;
            match condition {
                Condition::Lost => self.emit(BusEvent::SlaveLost { position }).await,
                Condition::LeftOperational => self.emit(BusEvent::SlaveLeft { position, report }).await,
                _ => self.introduce(number).await,
            }
        }
        if changed {
            self.send_plan().await;
        }
    }

    /// Brings every used slave that is not in OP back there.
    async fn recover(&mut self) {
        self.inspect(0..self.slaves.len()).await;
        for number in 0..self.slaves.len() {
            let Some(slave) = self.slaves.get(number).copied() else {
                continue;
            };
            if slave.axis.is_none() || slave.condition == Condition::Operational {
                continue;
            }
            match self.repair(number).await {
                Ok(()) => {
                    self.send_plan().await;
                    self.emit(BusEvent::Repaired {
                        position: slave.position as u8,
                    })
                    .await;
                    self.introduce(number).await;
                }
                Err(failure) => self.refuse(failure).await,
            }
        }
        let used = |slave: &&Slave| slave.axis.is_some();
        if self
            .slaves
            .iter()
            .filter(used)
            .all(|slave| slave.condition == Condition::Operational)
        {
            self.emit(BusEvent::Operational).await;
        }
    }

    async fn repair(&mut self, number: usize) -> Result<(), Failure> {
        let Some(slave) = self.slaves.get(number).copied() else {
            return Ok(());
        };
        let (position, station) = (slave.position, slave.station());
        let (port, at) = (&mut self.end.port, |step| Failure::of(position, step));
        let (_, found) = port
            .broadcast_read_u16(register::AL_STATUS)
            .await
            .map_err(at(Step::Locate))?;
        let expected = self.slaves.len() as u16;
        if found != expected {
            return Err(at(Step::Locate)(BusError::SlaveCount {
                expected,
                actual: found,
            }));
        }
        let there = configure::station_at(port, position).await.map_err(at(Step::Locate))?;
        match there {
            0 => {
                configure::assign_station(port, position, station)
                    .await
                    .map_err(at(Step::Address))?;
            }
            _ if there != station => {
                return Err(at(Step::Locate)(BusError::Station {
                    expected: station,
                    actual: there,
                }));
            }
            _ => {
                if self.resume(number).await.is_ok() {
                    return Ok(());
                }
            }
        }
        let port = &mut self.end.port;
        let fixed = configure::fixed_part(port, station).await.map_err(at(Step::Identify))?;
        let (old, new) = (slave.fixed.identity, fixed.identity);
        if (old.vendor, old.product) != (new.vendor, new.product) {
            // A stranger keeps no address of ours.
            let _ = port.write(station, register::STATION_ADDRESS, &[0; 2]).await;
            return Err(at(Step::Identify)(BusError::Identity {
                expected: old.product,
                actual: new.product,
            }));
        }
        let stations = self.stations();
        let (port, clocks) = (&mut self.end.port, &mut self.clocks);
        clock::restore(port, &stations, clocks, usize::from(position))
            .await
            .map_err(at(Step::Clocks))?;
        self.reach_safe_operational(number).await?;
        self.send_plan().await;
        self.reach_operational(number).await
    }

    /// The short way back of a slave that only left OP: acknowledge and ask again.
    async fn resume(&mut self, number: usize) -> Result<(), Failure> {
        let Some(slave) = self.slaves.get(number).copied() else {
            return Ok(());
        };
        let at = |step| Failure::of(slave.position, step);
        let report = state::acknowledge(&mut self.end.port, slave.station())
            .await
            .map_err(at(Step::Operational))?;
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
}
