//! The bring-up as a whole: its steps and their order, how it ends, and when it is repeated without a command.
//!
//! Invariants: members are in OP before the first terminal is configured; slaves that no member needs end no bring-up; one
//! that has failed leaves no slave in OP.

use super::super::driver::SlaveFactory;
use super::super::error::BusError;
use super::super::event::{BusEvent, Step};
use super::bus::LOST_SLAVE;
use super::inbox::{Expectation, Interruption, Work};
use super::{DISTURBANCES_MAX, Failure, Phase, Supervisor};
use core::pin::pin;

/// Longest wait for the Ethernet port's link before a bring-up, ms: switches and drives need some seconds to start.
pub const LINK_TIMEOUT_MS: u32 = 5_000;
/// How long a chain that has changed after a failed bring-up has to be stable before the next one, ms.
const CHANGED_MS: u32 = 100;
/// Pause before the next bring-up after one whose reason may pass, ms. Each request that names a slave begins it anew.
const SLOW_MS: u32 = 5_000;
/// How often these times are doubled, so that a loose contact does not restart the drives again and again.
const DOUBLED_MAX: u8 = 8;
/// The longest of them, ms.
const PAUSE_MAX_MS: u32 = 30_000;

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

impl Failure {
    /// Whether it says that a slave is not there.
    fn is_of_lost_slave(&self) -> bool {
        self.position.is_some() && self.error == LOST_SLAVE
    }
}

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> Supervisor<'_, F, SLAVES, MESSAGE> {
    /// Waits a millisecond after a failed bring-up; brings the bus up once the chain has changed, or the failed one may
    /// succeed without a change, and there are slaves enough.
    pub(super) async fn await_change(&mut self) {
        self.bus.port.wait_ms(1).await;
        self.inbox.observe(&Expectation::ANYTHING);
        if self.leaves_later {
            self.leave_operation().await;
        }
        let (there, now_ms) = (self.inbox.slaves(), self.bus.port.now_ms());
        if there != self.slaves_sorted {
            (self.slaves_sorted, self.changed_ms, self.waits_long) = (there, Some(now_ms), false);
            // Those that are missing may be behind a port that another master has closed.
            self.open_ports().await;
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
    pub(super) async fn start(&mut self) {
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
                self.slaves_measured = self.slaves_sorted;
                self.bus.emit(BusEvent::Operational).await;
                return;
            }
            Ok(Err(failure)) => {
                self.slaves_sorted = match failure.error {
                    BusError::SlaveCount { actual, .. } => actual,
                    _ => self.inbox.slaves(),
                };
                let is_unread = matches!(failure.error, BusError::MemberCount { .. }) && self.bus.has_blank_memory();
                let may_be_over = may_pass(&failure.error) || self.bus.has_lost || is_unread;
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
        // A slave that was seen to be lost may be back already.
        self.waits_long = !self.bus.has_lost || may_pass(&failure.error) && !failure.is_of_lost_slave();
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
    pub(super) async fn report_missing_link(&mut self) {
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
        if let Err(failure) = self.bring_up_all(false).await? {
            return Ok(Err(failure));
        }
        if let Err(failure) = self.bring_up_all(true).await? {
            return Ok(Err(failure));
        }
        self.bus.inspect(0..SLAVES).await;
        if self.bus.present() == 0 || self.bus.disturbed_member().is_some() {
            return Err(Interruption::Bus);
        }
        self.bus.introduce_all().await;
        Ok(Ok(()))
    }

    /// Brings all terminals, or all other slaves, to SAFEOP and then to OP.
    async fn bring_up_all(&mut self, terminals: bool) -> Result<Result<(), Failure>, Interruption> {
        for number in 0..self.bus.slaves.len() {
            if self.bus.is_terminal(number) != terminals {
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
            if self.bus.is_terminal(number) != terminals {
                continue;
            }
            if let Err(failure) = self.step(BringUpStep::Operational(number)).await? {
                return Ok(Err(failure));
            }
            self.watch_members().await?;
        }
        self.bus.send_plan().await;
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

/// Whether what went wrong may be over the next time although the chain does not change: a slave was too slow, its information
/// memory could not be read while its processor starts up, it left its state or was lost for a moment. Other errors are of the chain, or of what is asked for.
fn may_pass(error: &BusError) -> bool {
    match error {
        BusError::State { code, .. } => !is_of_configuration(*code),
        // The last slaves came when the wait was over.
        BusError::SlaveCount { expected, actual } => actual >= expected,
        BusError::Lost { .. }
        | BusError::WorkingCounter { .. }
        | BusError::SiiBusy { .. }
        | BusError::Sii { .. }
        | BusError::RequestUnread { .. }
        | BusError::StateTimeout { .. }
        | BusError::MailboxTimeout { .. }
        | BusError::NoInputs { .. }
        | BusError::ClockDifference { .. } => true,
        _ => false,
    }
}
