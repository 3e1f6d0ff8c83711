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
//! while work on one slave is in progress, a slave that stops answering, or a member that leaves OP, is detected within
//! 100 ms, or 200 ms in a chain of more than 32. One that leaves OP with its error flag set is detected after that work, if a
//! slave that waits for its own repair shows that flag already: the answers of all slaves come as one sum.

mod bring_up;
mod bus;
mod diagnosis;
mod files;
mod identity;
mod inbox;
mod mark;
mod objects;
mod repair;
mod requests;
mod rescan;
mod start;
mod state_request;

use super::acyclic::AcyclicPort;
use super::configure::discovery;
use super::cyclic::{CyclicPlan, Observation};
use super::diagnostics::{ServiceError, ServiceRequest, ServiceResult};
use super::driver::SlaveFactory;
use super::error::BusError;
pub use super::event::{BusCommand, BusEvent, BusSetup, Step};
use super::slave::Condition;
use super::slave_set::SlaveSet;
use crate::port_state::PortState;
use crate::state;
pub use bring_up::DISCOVERY_TIMEOUT_MS;
use bus::Bus;
use core::pin::pin;
use heapless::Vec;
use heapless::spsc::{Consumer, Producer};
use inbox::{Expectation, Inbox, Interruption, SUSPICION_MS, WORK_SUSPICION_MS, Work};
pub use start::LINK_TIMEOUT_MS;

/// Pause between two inspections for one suspicion, ms.
const INSPECTION_PAUSE_MS: u32 = 50;
/// Period of the routine inspection of a few slaves in turn, ms.
const LOOK_PERIOD_MS: u32 = 20;
/// Shortest pause between two of them, ms.
const LOOK_PAUSE_MS: u32 = SUSPICION_MS + 2;
/// Pause between two slaves that are asked again for their clocks, ms; it is doubled after each that fails.
const CLOCK_PAUSE_MS: u32 = 500;
const CLOCK_PAUSE_MAX_MS: u32 = 32_000;
/// Time in which a port that has been opened lets frames through, ms.
const OPENED_MS: u32 = 2;
const NS_PER_MS: u32 = 1_000_000;
/// How often a repair is restarted after another slave has interrupted it.
const REPAIR_TRIES_MAX: u8 = 3;
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
    /// Whether a slave may not have taken its process data or their sync managers: some refusals have other reasons too, as an
    /// object that cannot be written.
    const fn is_about_data(&self) -> bool {
        match self.error {
            BusError::State { code, .. } => state::is_about_process_data(code),
            BusError::Alignment { .. }
            | BusError::Mapping { .. }
            | BusError::ProcessLength { .. }
            | BusError::Range { .. }
            | BusError::SdoAbort { .. } => true,
            _ => false,
        }
    }

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
    /// Number of slaves when the cables were last measured because of it.
    slaves_measured: u16,
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
    /// When a slave was last asked for its clock again, how long the pause after it is, and which one it was.
    asked_ms: u32,
    asked_pause_ms: u32,
    asked_last: u8,
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
                #[cfg(feature = "clock")]
                clock: None,
                #[cfg(feature = "clock")]
                looked_ms: 0,
                port: PortState::Unknown,
            },
            port_missed: false,
            strangers: 0,
            phase: Phase::Stopped,
            slaves_sorted: 0,
            slaves_measured: 0,
            changed_ms: None,
            waits_long: false,
            leaves_later: false,
            retries: 0,
            rescans_failed: 0,
            inspected_ms: 0,
            looked_ms: 0,
            asked_ms: 0,
            asked_pause_ms: CLOCK_PAUSE_MS,
            asked_last: 0,
            look_next: 0,
        }
    }

    /// Takes the time of all waits, timeouts and pauses, and that of the bus between two readings of the reference clock, from a
    /// clock: milliseconds, wrapping. Without one, each poll of [`Self::run`] counts as a millisecond.
    #[cfg(feature = "clock")]
    #[must_use]
    pub fn with_clock(mut self, now_ms: fn() -> u32) -> Self {
        self.bus.port.set_clock(now_ms);
        self.inbox.clock = Some(now_ms);
        self
    }

    /// Events that the application did not take in time.
    pub const fn events_dropped(&self) -> u32 {
        self.bus.events_dropped
    }

    /// Runs the supervisor and never returns. Poll the future once a millisecond: unless it has a clock (`with_clock`, feature `clock`),
    /// each poll counts as one millisecond of every wait and timeout.
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
        } else if now_ms.wrapping_sub(self.looked_ms) >= LOOK_PERIOD_MS && (self.inbox.suspicion_ms == 0 || paused) {
            self.look().await;
            // Requests to slaves that do not answer take long: what looks wrong has to be counted between two looks.
            let took_ms = self.bus.port.now_ms().wrapping_sub(now_ms);
            let later_ms = (took_ms + LOOK_PAUSE_MS).saturating_sub(LOOK_PERIOD_MS);
            self.looked_ms = now_ms.wrapping_add(later_ms);
        }
    }

    /// Queries all slaves for their state, and rescans the chain if their number has changed.
    async fn inspect_all(&mut self) {
        if self.inbox.slaves() > self.bus.present() && self.inbox.slaves() != self.slaves_sorted {
            // A slave that was plugged in with power may answer in another's place, by its alias.
            self.open_ports().await;
        }
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
            // What a new slave maps into the logical memory disturbs the others until it is cleared.
            let disturbed = Expectation {
                answering: SlaveSet::NONE,
                ..expected
            };
            let mut result = {
                let work = pin!(bus.clear_strangers());
                inbox.guard(disturbed, Work::Background, work).await
            };
            if matches!(result, Ok(Ok(()))) {
                let work = pin!(bus.rescan());
                result = inbox.guard(expected, Work::Background, work).await;
            }
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

    /// Opens the ports that another master has closed in slaves that were plugged in with power, and switches off their aliases.
    /// Behind a port that opens may be another one.
    async fn open_ports(&mut self) {
        // The telegram of a later cycle has counted them.
        let counted_ms = OPENED_MS + 2 * self.bus.setup.cycle_ns.div_ceil(NS_PER_MS);
        for _ in 0..SLAVES {
            let before = self.inbox.slaves();
            // What fails is done again at the next repair.
            let _ = discovery::open_ports(&mut self.bus.port).await;
            self.bus.port.wait_ms(counted_ms).await;
            self.inbox.observe(&Expectation::ANYTHING);
            if self.inbox.slaves() <= before {
                return;
            }
        }
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
        self.ask_for_clock().await;
        self.tell_delays().await;
        self.bus.look_at_processor().await;
        let expected = self.bus.expectation(None);
        let Self { bus, inbox, .. } = self;
        let work = pin!(bus.check_mailbox());
        // After an interruption the mailbox is read again in the next round.
        let _ = inbox.guard(expected, Work::Background, work).await;
    }

    /// Measures the cables again if the chain has become longer or shorter, and tells the clocks their delays. Strangers, too, are
    /// in the way of the frames: at a junction before slaves whose neighbours stay.
    async fn tell_delays(&mut self) {
        let there = self.inbox.slaves();
        if there != self.slaves_measured && there >= self.bus.present() {
            self.slaves_measured = there;
            self.bus.clocks.chain_changed();
        }
        let expected = self.disturbed_expectation();
        let Self { bus, inbox, .. } = self;
        let work = pin!(bus.tell_delays());
        // What is not told yet is told in the next round.
        let _ = inbox.guard(expected, Work::Background, work).await;
    }

    /// Asks again for a clock that is not known; until then the time that is distributed is counted wrongly, and counts as lost.
    async fn ask_for_clock(&mut self) {
        let now_ms = self.bus.port.now_ms();
        if now_ms.wrapping_sub(self.asked_ms) < self.asked_pause_ms {
            return;
        }
        let Some(number) = self.bus.unknown_clock(self.asked_last.into()) else {
            return;
        };
        (self.asked_ms, self.asked_last) = (now_ms, number as u8);
        let expected = self.disturbed_expectation();
        let Self { bus, inbox, .. } = self;
        let result = {
            let work = pin!(bus.restore_clock(number));
            inbox.guard(expected, Work::Background, work).await
        };
        self.asked_pause_ms = match result {
            Ok(Ok(())) => CLOCK_PAUSE_MS,
            _ => {
                bus.clocks.forget(number);
                (2 * self.asked_pause_ms).min(CLOCK_PAUSE_MAX_MS)
            }
        };
        bus.clocks.hold(false);
        bus.send_plan().await;
    }

    /// What the critical side should see while something stays wrong that must not keep other work from being done.
    fn disturbed_expectation(&self) -> Expectation {
        let there = self.inbox.slaves();
        let mut expected = Expectation {
            slaves: Some(there),
            ..self.bus.expectation(None)
        };
        if there > self.bus.present() || self.inbox.suspicion_ms > 0 {
            // Slaves that wait for their repair may be in any state.
            (expected.required, expected.allowed) = (0, inbox::STATUS_MASK);
            expected.answering = SlaveSet::NONE;
        }
        expected
    }

    /// Looks through the chain, and brings every slave in use that is not in OP, or whose clock or data are not known, back to OP.
    async fn recover(&mut self) {
        self.bus.has_lost = true;
        self.open_ports().await;
        self.inspect_all().await;
        let transferring = self.bus.transferring().await;
        for number in 0..self.bus.slaves.len() {
            let Some(slave) = self.bus.slaves.get(number).copied() else {
                continue;
            };
            let is_operational = slave.condition == Condition::Operational;
            let is_well = is_operational && !self.bus.reads_again(number) && !self.bus.clocks.is_unknown(number);
            if !slave.is_used() || is_well {
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
        let mut silent: Option<SlaveSet> = None;
        for _ in 0..REPAIR_TRIES_MAX {
            let Self { bus, inbox, .. } = self;
            bus.work_on(Some(number)).await;
            let mut expected = bus.expectation(Some(number));
            let exchanging = expected.answering;
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
            // Without replies, or while slaves are away, nobody knows who is silent.
            let all_there = inbox.seen.filter(|seen| !seen.silent && seen.al.slaves == there);
            if let Some(seen) = all_there {
                let others = SlaveSet::ALL.without(exchanging.without(seen.answered));
                silent = Some(silent.unwrap_or(SlaveSet::ALL).without(others));
            }
            bus.work_on(None).await;
            match result {
                Err(Interruption::Bus) => self.inspect_all().await,
                done => return done,
            }
        }
        self.doubt(silent.unwrap_or(SlaveSet::NONE)).await;
        let error = BusError::SlaveCount {
            expected: self.bus.slaves.len() as u16,
            actual: self.inbox.slaves(),
        };
        Ok(Err(Failure::of(number as u16, Step::Watch)(error)))
    }

    /// Notes that other slaves may have the addresses of these: they are in OP, but their data came at no try of a repair, which
    /// that has interrupted each time. The next repair looks who they are.
    async fn doubt(&mut self, silent: SlaveSet) {
        for number in 0..self.bus.slaves.len() {
            if let Some(slave) = self.bus.slaves.get_mut(number)
                && silent.contains(number)
                && slave.condition == Condition::Operational
            {
                slave.condition = Condition::Returned;
                let position = slave.position as u8;
                self.bus.emit(BusEvent::Returned { position }).await;
            }
        }
        self.bus.send_plan().await;
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

/// A list with a place for each slave of one inspection.
type LookList<T> = Vec<T, { bus::LOOK_MAX }>;

#[cfg(test)]
mod tests;
