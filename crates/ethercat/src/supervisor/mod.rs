//! The supervisor: brings the bus up, watches it, repairs it, and answers service requests.
//!
//! One endless `async` function is polled once a millisecond at low priority. It configures the slaves of the chain,
//! passes the critical side its plan, takes the members to OP while cyclic data are already exchanged, and then watches
//! for slaves that vanish, return, are plugged in or leave OP. A repair, started by [`BusCommand::Recover`], brings a
//! slave back while the others continue. A bring-up that failed is repeated by itself once the chain has changed, or after a
//! pause if its reason may pass. In between, the supervisor carries out service requests
//! ([`diagnostics`](super::diagnostics)), even on a bus that was not brought up. Every failed step is reported with
//! slave, step and reason.
//!
//! Invariants: a slave whose file is being transferred in BOOT is left there, whatever is commanded; a slave in use is
//! only repaired on command; a slave is only taken back if it is the product that was there before; every wait ends;
//! while work on one slave is in progress, a slave that stops answering, or a member that leaves OP, is detected within 100 ms, or 200 ms
//! in a chain of more than 32. One that leaves OP with its error flag set is detected after that work, if a slave that
//! waits for its own repair shows that flag already: the answers of all slaves come as one sum.

mod bring_up;
mod bus;
mod diagnosis;
mod files;
mod identity;
mod inbox;
mod objects;
mod repair;
mod requests;
mod rescan;
mod state_request;

use super::acyclic::AcyclicPort;
use super::cyclic::{CyclicPlan, Observation};
use super::diagnostics::{ServiceError, ServiceRequest, ServiceResult};
use super::driver::SlaveFactory;
use super::error::BusError;
pub use super::event::{BusCommand, BusEvent, BusSetup, Step};
use super::slave::Condition;
use super::slave_set::SlaveSet;
use crate::port_state::PortState;
pub use bring_up::DISCOVERY_TIMEOUT_MS;
use bus::{Bus, LOST_SLAVE};
use core::pin::pin;
use heapless::Vec;
use heapless::spsc::{Consumer, Producer};
use inbox::{Expectation, Inbox, Interruption, SUSPICION_MS, WORK_SUSPICION_MS, Work};

/// Pause between two inspections for one suspicion, ms.
const INSPECTION_PAUSE_MS: u32 = 50;
/// Period of the routine inspection of a few slaves in turn, ms.
const LOOK_PERIOD_MS: u32 = 20;
/// Shortest pause between two of them, ms.
const LOOK_PAUSE_MS: u32 = SUSPICION_MS + 2;
/// Longest wait for the Ethernet port's link before a bring-up, ms: switches and drives need some seconds to start.
pub const LINK_TIMEOUT_MS: u32 = 5_000;
/// How often a repair is restarted after another slave has interrupted it.
const REPAIR_TRIES_MAX: u8 = 3;
/// How long a chain that has changed after a failed bring-up has to be stable before the next one, ms.
const CHANGED_MS: u32 = 100;
/// Pause before the next bring-up after one whose reason may pass, ms. Each request that names a slave begins it anew.
const SLOW_MS: u32 = 5_000;
/// How often these times are doubled, so that a loose contact does not restart the drives again and again.
const DOUBLED_MAX: u8 = 8;
/// The longest of them, ms.
const PAUSE_MAX_MS: u32 = 30_000;
/// How often a step of the bring-up is begun again after slaves have disturbed it that no member needs.
const DISTURBANCES_MAX: u8 = 8;
/// Rescans that may fail one after the other before the chain is taken as it is.
const RESCANS_FAILED_MAX: u8 = 10;

const _: () = {
    assert!(
        SUSPICION_MS + INSPECTION_PAUSE_MS < 100 && WORK_SUSPICION_MS + INSPECTION_PAUSE_MS < 100,
        "changes are noticed within 100 ms"
    );
    assert!(
        LOOK_PERIOD_MS as usize * 32_usize.div_ceil(bus::LOOK_MAX) < 100,
        "each slave is looked at within 100 ms"
    );
    assert!(
        LOOK_PERIOD_MS as usize * SlaveSet::PLACES.div_ceil(bus::LOOK_MAX) < 200,
        "each slave of the longest chain is looked at within 200 ms"
    );
};

/// The supervisor's ends of the queues.
pub struct SupervisorEnd<'a, F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> {
    /// Plans to the critical side.
    pub plans: Producer<'a, CyclicPlan<F, SLAVES>>,
    /// Frames that the critical side may send in each direction of a cycle.
    pub frames: u8,
    /// Acyclic requests and their replies.
    pub port: AcyclicPort<'a, MESSAGE>,
    /// Bus states from the critical side.
    pub observations: Consumer<'a, Observation>,
    /// Commands of the application.
    pub commands: Consumer<'a, BusCommand<F>>,
    /// Events to the application.
    pub events: Producer<'a, BusEvent>,
    /// Service requests.
    pub services: Consumer<'a, ServiceRequest>,
    /// Answers to the service requests, one each, in order.
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

    /// Whether it says that a slave is not there.
    fn is_of_lost_slave(&self) -> bool {
        self.position.is_some() && self.error == LOST_SLAVE
    }
}

/// A guarded step of the bring-up after the slaves are found: their clocks, or one slave to one state.
#[derive(Clone, Copy, Debug)]
enum BringUpStep {
    Clocks,
    SafeOperational(usize),
    Operational(usize),
}

impl BringUpStep {
    /// The slave that is brought to a state.
    const fn slave(self) -> Option<usize> {
        match self {
            Self::Clocks => None,
            Self::SafeOperational(number) | Self::Operational(number) => Some(number),
        }
    }
}

/// State of the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// No bring-up was requested, or the bus was stopped.
    Stopped,
    /// The bring-up failed.
    Failed,
    /// All slaves in use were brought to OP.
    Running,
}

/// Brings the bus up, watches it and repairs it.
pub struct Supervisor<'a, F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> {
    bus: Bus<'a, F, SLAVES, MESSAGE>,
    inbox: Inbox<'a, F>,
    phase: Phase,
    /// Number of slaves at the last rescan, or at the failed bring-up.
    slaves_sorted: u16,
    /// When the pause before the next bring-up began: when that number changed, or when a bring-up failed that may succeed
    /// without a change; `None` if none will follow.
    changed_ms: Option<u32>,
    /// Whether the pause before the next bring-up is the long one.
    waits_long: bool,
    /// Whether slaves have to be taken out of OP once the port has a link.
    leaves_later: bool,
    /// Bring-ups since the last command that began without one.
    retries: u8,
    /// Rescans of this number that failed, one after the other.
    rescans_failed: u8,
    inspected_ms: u32,
    looked_ms: u32,
    look_next: u8,
    /// Whether the lost link of the running bus was reported.
    port_missed: bool,
    /// Slaves that answer during a bring-up without an address: one that was lost meanwhile is back.
    strangers: u16,
}

impl<'a, F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> Supervisor<'a, F, SLAVES, MESSAGE> {
    /// A supervisor that waits for [`BusCommand::Start`].
    pub fn new(end: SupervisorEnd<'a, F, SLAVES, MESSAGE>) -> Self {
        let SupervisorEnd {
            plans,
            frames,
            port,
            observations,
            commands,
            events,
            services,
            answers,
        } = end;
        Self {
            bus: Bus::new(port, plans, frames, events),
            inbox: Inbox {
                observations,
                commands,
                services,
                answers,
                seen: None,
                suspicion_ms: 0,
                port: PortState::Unknown,
            },
            port_missed: false,
            strangers: 0,
            phase: Phase::Stopped,
            slaves_sorted: 0,
            changed_ms: None,
            waits_long: false,
            leaves_later: false,
            retries: 0,
            rescans_failed: 0,
            inspected_ms: 0,
            looked_ms: 0,
            look_next: 0,
        }
    }

    /// Events that the application did not take in time.
    pub const fn events_dropped(&self) -> u32 {
        self.bus.events_dropped
    }

    /// Runs the supervisor and never returns. Poll the future once a millisecond.
    pub async fn run(&mut self) -> ! {
        loop {
            let command = self.inbox.commands.dequeue();
            if matches!(command, Some(BusCommand::Start(_) | BusCommand::Recover)) {
                self.retries = 0;
            }
            match (command, self.phase) {
                (Some(BusCommand::Start(setup)), _) => {
                    self.stop().await;
                    self.bus.setup = setup;
                    self.start().await;
                }
                (Some(BusCommand::Port(port)), _) => self.inbox.port = port,
                (Some(BusCommand::Recover), Phase::Running) if self.inbox.port.is_down() => {
                    self.report_missing_link().await
                }
                (Some(BusCommand::Recover), Phase::Running) => self.recover().await,
                (Some(BusCommand::Recover), Phase::Failed) => self.start().await,
                (Some(BusCommand::Recover), Phase::Stopped) => {}
                (Some(BusCommand::Stop), _) => {
                    self.stop().await;
                    self.bus.emit(BusEvent::Stopped).await;
                }
                (None, phase) => match self.inbox.services.dequeue() {
                    Some(request) => self.serve(request).await,
                    None if phase == Phase::Running => self.watch().await,
                    None if phase == Phase::Failed => self.await_change().await,
                    None => {
                        self.bus.port.wait_ms(1).await;
                        self.inbox.observe(&Expectation::ANYTHING);
                    }
                },
            }
        }
    }

    /// Waits a millisecond after a failed bring-up; brings the bus up once the chain has changed, or the failed one may
    /// succeed without a change, and there are slaves enough.
    async fn await_change(&mut self) {
        self.bus.port.wait_ms(1).await;
        self.inbox.observe(&Expectation::ANYTHING);
        if self.leaves_later {
            self.leave_operation().await;
        }
        let (there, now_ms) = (self.inbox.slaves(), self.bus.port.now_ms());
        if there != self.slaves_sorted {
            (self.slaves_sorted, self.changed_ms, self.waits_long) = (there, Some(now_ms), false);
        }
        let pause_ms = if self.waits_long { SLOW_MS } else { CHANGED_MS };
        let stable_ms = (pause_ms << self.retries.min(DOUBLED_MAX)).min(PAUSE_MAX_MS);
        let is_stable = self
            .changed_ms
            .is_some_and(|changed_ms| now_ms.wrapping_sub(changed_ms) >= stable_ms);
        if is_stable
            && there >= self.bus.fewest_slaves().max(1)
            && !self.inbox.port.is_down()
            && self.bus.transferring().await.is_none()
        {
            self.retries = self.retries.saturating_add(1);
            self.start().await;
        }
    }

    /// Brings the whole bus up, unless a slave's file is being transferred.
    async fn start(&mut self) {
        (self.phase, self.changed_ms, self.strangers) = (Phase::Failed, None, 0);
        (self.bus.has_lost, self.bus.is_running) = (false, false);
        self.slaves_sorted = self.inbox.slaves();
        if let Some(number) = self.bus.transferring().await {
            self.bus.refuse_for_file(number).await;
            return;
        }
        if self.link_missing_after_wait().await {
            (self.waits_long, self.changed_ms) = (false, Some(self.bus.port.now_ms()));
            // A command that arrived meanwhile is carried out instead.
            if !self.inbox.commands.ready() {
                self.report_missing_link().await;
            }
            return;
        }
        self.leave_operation().await;
        let result = self.bring_up().await;
        self.conclude(result).await;
        if self.phase != Phase::Running {
            self.leave_operation().await;
        }
    }

    /// Takes the slaves out of OP that a bring-up or a state request has asked to go there; later if the port has no link.
    async fn leave_operation(&mut self) {
        self.leaves_later = self.bus.asked_for_operation && self.inbox.port.is_down();
        if self.bus.asked_for_operation && !self.leaves_later {
            self.bus.shut_down().await;
        }
    }

    /// Reports how a bring-up has ended, and decides whether it is repeated without a command.
    async fn conclude(&mut self, result: Result<Result<(), Failure>, Interruption>) {
        let (failure, may_be_over) = match result {
            Ok(Ok(())) => {
                (self.phase, self.bus.is_running) = (Phase::Running, true);
                self.slaves_sorted = self.bus.slaves.len() as u16;
                self.bus.emit(BusEvent::Operational).await;
                return;
            }
            Ok(Err(failure)) => {
                self.slaves_sorted = match failure.error {
                    BusError::SlaveCount { actual, .. } => actual,
                    _ => self.inbox.slaves(),
                };
                let may_be_over = may_pass(&failure.error) || self.bus.has_lost;
                (failure, may_be_over)
            }
            Err(Interruption::Command) => return,
            Err(Interruption::Bus) if self.inbox.port.is_down() => {
                (self.waits_long, self.changed_ms) = (false, Some(self.bus.port.now_ms()));
                return self.report_missing_link().await;
            }
            Err(Interruption::Bus) => {
                self.slaves_sorted = self.inbox.slaves();
                self.bus.inspect(0..SLAVES).await;
                let error = BusError::SlaveCount {
                    expected: self.bus.slaves.len() as u16,
                    actual: self.inbox.slaves(),
                };
                let failure = self.bus.disturbed_member();
                (failure.unwrap_or(Failure::bus(Step::Watch)(error)), true)
            }
        };
        // A slave that was lost may be back already.
        let lost = failure.is_of_lost_slave();
        self.waits_long = !(lost || self.bus.has_lost) || may_pass(&failure.error) && !lost;
        self.changed_ms = may_be_over.then_some(self.bus.port.now_ms());
        self.bus.refuse(failure).await;
    }

    /// Waits for the port's link, which takes some seconds after a common power-up; returns early when another command
    /// arrives. Returns whether the link is still missing.
    async fn link_missing_after_wait(&mut self) -> bool {
        let began_ms = self.bus.port.now_ms();
        while self.inbox.port.is_down()
            && !self.inbox.commands.ready()
            && self.bus.port.now_ms().wrapping_sub(began_ms) < LINK_TIMEOUT_MS
        {
            self.bus.port.wait_ms(1).await;
            self.inbox.observe(&Expectation::ANYTHING);
        }
        self.inbox.port.is_down()
    }

    /// Reports that the port has no link.
    async fn report_missing_link(&mut self) {
        let error = BusError::NoLink { port: self.inbox.port };
        self.bus.refuse(Failure::bus(Step::Discover)(error)).await;
    }

    /// The steps of a bring-up, each of them guarded. The members are in OP before the terminals are configured.
    async fn bring_up(&mut self) -> Result<Result<(), Failure>, Interruption> {
        if let Err(failure) = self.find_all().await? {
            return Ok(Err(failure));
        }
        if let Err(failure) = self.step(BringUpStep::Clocks).await? {
            return Ok(Err(failure));
        }
        for of_terminals in [false, true] {
            for number in 0..self.bus.slaves.len() {
                if self.bus.is_terminal(number) != of_terminals {
                    continue;
                }
                if let Err(failure) = self.step(BringUpStep::SafeOperational(number)).await? {
                    return Ok(Err(failure));
                }
                // Some slaves need process data soon after they have reached SAFEOP.
                self.bus.send_plan().await;
                self.watch_members().await?;
            }
            for number in 0..self.bus.slaves.len() {
                if self.bus.is_terminal(number) != of_terminals {
                    continue;
                }
                if let Err(failure) = self.step(BringUpStep::Operational(number)).await? {
                    return Ok(Err(failure));
                }
                self.watch_members().await?;
            }
            self.bus.send_plan().await;
        }
        self.bus.inspect(0..SLAVES).await;
        if self.bus.present() == 0 || self.bus.disturbed_member().is_some() {
            return Err(Interruption::Bus);
        }
        self.bus.introduce_all().await;
        Ok(Ok(()))
    }

    /// Looks whether a member has left OP while another slave was brought to a state: the sum of all answers hides it if another
    /// slave shows its error flag already.
    async fn watch_members(&mut self) -> Result<(), Interruption> {
        if self.bus.asked_for_operation {
            self.bus.inspect(0..SLAVES).await;
        }
        match self.bus.disturbed_member() {
            Some(_) => Err(Interruption::Bus),
            None => Ok(()),
        }
    }

    /// A step of the bring-up; again after a disturbance by slaves that no member needs. A terminal that fails is refused alone.
    async fn step(&mut self, step: BringUpStep) -> Result<Result<(), Failure>, Interruption> {
        let mut tries = 0;
        loop {
            let result = match step {
                BringUpStep::Clocks => self.set_up_clocks().await,
                BringUpStep::SafeOperational(number) => self.reach_safe_operational(number).await,
                BringUpStep::Operational(number) if self.bus.is_on_the_way(number) => {
                    self.reach_operational(number).await
                }
                BringUpStep::Operational(_) => return Ok(Ok(())),
            };
            match (result, step.slave()) {
                (Err(Interruption::Bus), number) if !self.inbox.port.is_down() => {
                    tries += 1;
                    self.bus.inspect(0..SLAVES).await;
                    let is_empty = self.bus.present() == 0;
                    if self.bus.disturbed_member().is_some() || is_empty || self.inbox.port.is_down() {
                        return Err(Interruption::Bus);
                    }
                    self.strangers = self.inbox.slaves().saturating_sub(self.bus.present());
                    let is_over = tries >= DISTURBANCES_MAX;
                    match number.and_then(|number| self.bus.left_terminal(number, is_over)) {
                        Some((number, failure)) => {
                            self.bus.refuse_terminal(number, failure).await;
                            return Ok(Ok(()));
                        }
                        None if is_over => return Err(Interruption::Bus),
                        None => {}
                    }
                }
                (Ok(Err(failure)), Some(number)) if self.bus.is_terminal(number) => {
                    self.bus.refuse_terminal(number, failure).await;
                    return Ok(Ok(()));
                }
                (result, _) => return result,
            }
        }
    }

    // A step of the bring-up is a function of its own: what one step keeps while it waits then lies where that of the
    // next one will lie.

    async fn find_all(&mut self) -> Result<Result<(), Failure>, Interruption> {
        let Self { bus, inbox, .. } = self;
        let work = pin!(bus.find_all());
        inbox.guard(Expectation::ANYTHING, Work::Exclusive, work).await
    }

    async fn set_up_clocks(&mut self) -> Result<Result<(), Failure>, Interruption> {
        let expected = self.expected(SLAVES);
        let Self { bus, inbox, .. } = self;
        let work = pin!(bus.set_up_clocks());
        inbox.guard(expected, Work::Exclusive, work).await
    }

    async fn reach_safe_operational(&mut self, number: usize) -> Result<Result<(), Failure>, Interruption> {
        let expected = self.expected(number);
        let Self { bus, inbox, .. } = self;
        let work = pin!(bus.reach_safe_operational(number));
        inbox.guard(expected, Work::Exclusive, work).await
    }

    async fn reach_operational(&mut self, number: usize) -> Result<Result<(), Failure>, Interruption> {
        let expected = self.expected(number);
        let Self { bus, inbox, .. } = self;
        let work = pin!(bus.reach_operational(number));
        inbox.guard(expected, Work::Exclusive, work).await
    }

    /// What the critical side should see while a slave is brought to a state: inputs of the members alone.
    fn expected(&self, worked_on: usize) -> Expectation {
        let expected = self.bus.expectation(Some(worked_on));
        let terminals = (0..SLAVES).filter(|number| self.bus.is_terminal(*number));
        Expectation {
            slaves: expected.slaves.map(|slaves| slaves.saturating_add(self.strangers)),
            answering: expected.answering.without(terminals.collect()),
            ..expected
        }
    }

    /// Watches the bus for one millisecond.
    async fn watch(&mut self) {
        self.bus.port.wait_ms(1).await;
        let expected = self.bus.expectation(None);
        self.inbox.observe(&expected);
        let missed = self.inbox.port.is_down();
        if missed && !self.port_missed {
            self.report_missing_link().await;
        }
        self.port_missed = missed;
        let now_ms = self.bus.port.now_ms();
        let paused = now_ms.wrapping_sub(self.inspected_ms) < INSPECTION_PAUSE_MS;
        if self.inbox.suspicion_ms >= SUSPICION_MS && !paused {
            self.inspect_all().await;
        } else if now_ms.wrapping_sub(self.looked_ms) >= LOOK_PERIOD_MS {
            self.look().await;
            // Requests to slaves that do not answer take long: what looks wrong has to be counted between two looks.
            let took_ms = self.bus.port.now_ms().wrapping_sub(now_ms);
            let later_ms = (took_ms + LOOK_PAUSE_MS).saturating_sub(LOOK_PERIOD_MS);
            self.looked_ms = now_ms.wrapping_add(later_ms);
        }
    }

    /// Queries all slaves for their state, and rescans the chain if their number has changed.
    async fn inspect_all(&mut self) {
        self.bus.inspect(0..SLAVES).await;
        if core::mem::take(&mut self.bus.has_lost) {
            // As many slaves as before may be others, or ones without their addresses.
            (self.slaves_sorted, self.rescans_failed) = (self.bus.present(), 0);
        }
        let there = self.inbox.slaves();
        if there > self.bus.present() && there != self.slaves_sorted {
            let Self { bus, inbox, .. } = self;
            let expected = Expectation {
                slaves: Some(there),
                ..bus.expectation(None)
            };
            let expected = Expectation {
                required: 0,
                allowed: inbox::STATUS_MASK,
                ..expected
            };
            let result = {
                let work = pin!(bus.rescan());
                inbox.guard(expected, Work::Background, work).await
            };
            bus.clocks.hold(false);
            bus.send_plan().await;
            // A chain that has changed meanwhile is looked through again at the next suspicion; a slave that never
            // answers as it should does not keep the bus busy for ever.
            self.rescans_failed = match result {
                Ok(Ok(())) => 0,
                _ => self.rescans_failed + 1,
            };
            if self.rescans_failed == 0 || self.rescans_failed >= RESCANS_FAILED_MAX {
                (self.slaves_sorted, self.rescans_failed) = (there, 0);
            }
        } else if there <= self.bus.present() {
            self.slaves_sorted = there;
        }
        self.inspected_ms = self.bus.port.now_ms();
    }

    /// Inspects the states of a few slaves, and error counters, processor watchdog and mailbox of one of them.
    async fn look(&mut self) {
        let slaves = self.bus.slaves.len().max(1);
        let first = usize::from(self.look_next) % slaves;
        let last = (first + bus::LOOK_MAX).min(slaves);
        self.look_next = last as u8;
        self.bus.inspect(first..last).await;
        self.bus.check_cables().await;
        self.bus.follow_clock().await;
        self.bus.tell_delays().await;
        self.bus.look_at_processor().await;
        let expected = self.bus.expectation(None);
        let Self { bus, inbox, .. } = self;
        let work = pin!(bus.check_mailbox());
        // After an interruption the mailbox is read again in the next round.
        let _ = inbox.guard(expected, Work::Background, work).await;
    }

    /// Looks through the chain, and brings every slave in use that is not in OP back to OP.
    async fn recover(&mut self) {
        self.bus.has_lost = true;
        self.inspect_all().await;
        let transferring = self.bus.transferring().await;
        for number in 0..self.bus.slaves.len() {
            let Some(slave) = self.bus.slaves.get(number).copied() else {
                continue;
            };
            if !slave.is_used() || slave.condition == Condition::Operational {
                continue;
            }
            if transferring == Some(number) {
                self.bus.refuse_for_file(number).await;
                continue;
            }
            match self.repair_guarded(number).await {
                Ok(Ok(())) => {
                    self.bus.send_plan().await;
                    let position = slave.position as u8;
                    self.bus.emit(BusEvent::Repaired { position }).await;
                    self.bus.introduce(number).await;
                }
                Ok(Err(failure)) if slave.is_terminal => self.bus.refuse_terminal(number, failure).await,
                Ok(Err(failure)) => self.bus.refuse(failure).await,
                Err(_) => return,
            }
        }
        if self.bus.is_operational() {
            self.bus.emit(BusEvent::Operational).await;
        }
    }

    /// Repairs a slave; restarts when another slave needs attention.
    async fn repair_guarded(&mut self, number: usize) -> Result<Result<(), Failure>, Interruption> {
        for _ in 0..REPAIR_TRIES_MAX {
            let Self { bus, inbox, .. } = self;
            bus.work_on(Some(number)).await;
            let mut expected = bus.expectation(Some(number));
            let there = inbox.slaves();
            if there > bus.present() {
                // Slaves that wait for their own repair may be in any state.
                expected.allowed |= inbox::STATUS_MASK;
            }
            expected.slaves = Some(there);
            let result = {
                let work = pin!(bus.repair(number));
                inbox.guard(expected, Work::Exclusive, work).await
            };
            bus.work_on(None).await;
            match result {
                Err(Interruption::Bus) => self.inspect_all().await,
                done => return done,
            }
        }
        let error = BusError::SlaveCount {
            expected: self.bus.slaves.len() as u16,
            actual: self.inbox.slaves(),
        };
        Ok(Err(Failure::of(number as u16, Step::Watch)(error)))
    }

    /// Takes the slaves out of OP: safe outputs are sent first, then the states follow.
    async fn stop(&mut self) {
        if self.phase == Phase::Running || self.bus.asked_for_operation {
            self.bus.shut_down().await;
        }
        self.leaves_later = false;
        (self.phase, self.bus.is_running) = (Phase::Stopped, false);
    }

    /// Carries out a request and answers it.
    async fn serve(&mut self, request: ServiceRequest) {
        let running = self.phase == Phase::Running;
        let Self { bus, inbox, .. } = self;
        let slave = request.slave().map(usize::from);
        let expected = if running {
            bus.expectation(slave)
        } else {
            Expectation::ANYTHING
        };
        let seen = inbox.seen;
        let kind = match bus.transfers(&request) {
            true => Work::Transfer,
            false => Work::Background,
        };
        let result = {
            let work = pin!(bus.carry_out(&request, seen, running));
            inbox.guard(expected, kind, work).await
        };
        if matches!(
            request,
            ServiceRequest::OpenFile { .. } | ServiceRequest::ReadFile { .. } | ServiceRequest::WriteFile { .. }
        ) {
            // A slave that erases its memory may take longer over a packet than a file may lie idle.
            bus.use_file();
        }
        if request.slave().is_some() && !matches!(request, ServiceRequest::Errors { .. }) {
            // Error counters are read by programs, again and again. Whoever looks for the reason is not interrupted by the next bring-up.
            self.changed_ms = self.changed_ms.map(|_| bus.port.now_ms());
        }
        if bus.is_worked_on() {
            bus.work_on(None).await;
        }
        if result == Err(Interruption::Bus) {
            self.inspect_all().await;
        }
        let mut answer = result.unwrap_or(Err(ServiceError::Interrupted));
        while let Err(back) = self.inbox.answers.enqueue(answer) {
            answer = back;
            self.bus.port.wait_ms(1).await;
        }
    }
}

/// Whether an AL status code says that a slave cannot take what it is configured with: the next time is no better. All others may
/// pass, those of vendors too.
const fn is_of_configuration(code: u16) -> bool {
    matches!(
        code,
        0x0002
            | 0x0003
            | 0x0006
            | 0x0007
            | 0x000E
            | 0x0012..=0x0017
            | 0x001C..=0x0020
            | 0x0024..=0x0029
            | 0x002E
            | 0x0030
            | 0x0035
            | 0x0043..=0x004F
    )
}

/// Whether what went wrong may be over the next time although the chain does not change: a slave was too slow, left its state or
/// was lost for a moment. Other errors are of the chain, or of what is asked for.
fn may_pass(error: &BusError) -> bool {
    match error {
        BusError::State { code, .. } => !is_of_configuration(*code),
        // The last slaves came when the wait was over.
        BusError::SlaveCount { expected, actual } => actual >= expected,
        BusError::Lost { .. }
        | BusError::WorkingCounter { .. }
        | BusError::SiiBusy { .. }
        | BusError::RequestUnread { .. }
        | BusError::StateTimeout { .. }
        | BusError::MailboxTimeout { .. }
        | BusError::NoInputs { .. }
        | BusError::ClockDifference { .. } => true,
        _ => false,
    }
}

/// A list with a place for each slave of one inspection.
type LookList<T> = Vec<T, { bus::LOOK_MAX }>;

#[cfg(test)]
mod tests;
