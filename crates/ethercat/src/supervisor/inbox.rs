//! Inputs of the supervisor while it works: observations, commands, requests.
//!
//! Work on one slave may take seconds. [`Inbox::guard`] polls it and checks the bus between two polls. If another slave
//! looks wrong for [`WORK_SUSPICION_MS`], or a command arrives that makes the work pointless, the work is dropped. The
//! acyclic port skips the replies that the dropped work leaves behind.
//!
//! Invariant: no work delays a change of the bus or a command by more than a few milliseconds.

use super::super::cyclic::Observation;
use super::super::diagnostics::{ServiceError, ServiceRequest, ServiceResult};
use super::super::driver::SlaveFactory;
use super::super::event::BusCommand;
use super::super::slave_set::SlaveSet;
use super::super::wire::register;
use crate::port_state::PortState;
use crate::queue::front;
use core::future::{Future, poll_fn};
use core::pin::Pin;
use core::task::Poll;
use heapless::spsc::{Consumer, Producer};

/// How long the bus has to look wrong before the slaves are queried, ms.
pub(super) const SUSPICION_MS: u32 = 3;
/// How long the bus has to look wrong before the slaves are queried while work is in progress, ms. The work itself may
/// disturb the bus briefly.
pub(super) const WORK_SUSPICION_MS: u32 = 20;
/// Most milliseconds that one look counts for: two looks are needed at least.
#[cfg(feature = "clock")]
const LOOK_MAX_MS: u32 = SUSPICION_MS - 1;

/// State and error flag of an AL status register.
pub(super) const STATUS_MASK: u16 = register::AL_STATE_MASK | register::AL_ERROR_BIT;

/// Bus state that the critical side should see.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Expectation {
    /// Number of slaves that answer; `None` for any number.
    pub(super) slaves: Option<u16>,
    /// Bits of the AL status that have to be set.
    pub(super) required: u16,
    /// Bits that may be set.
    pub(super) allowed: u16,
    /// Slaves whose inputs have to arrive.
    pub(super) answering: SlaveSet,
}

impl Expectation {
    /// Any bus state.
    pub(super) const ANYTHING: Self = Self {
        slaves: None,
        required: 0,
        allowed: u16::MAX,
        answering: SlaveSet::NONE,
    };

    /// Whether the observed state differs from the expected one.
    fn differs(&self, seen: &Observation) -> bool {
        let Some(slaves) = self.slaves else { return false };
        let status = seen.al.status & STATUS_MASK;
        seen.silent && slaves > 0
            || seen.al.slaves != slaves
            || self.required & !status != 0
            || status & !self.allowed != 0
            || !self.answering.without(seen.answered).is_empty()
    }
}

/// Why work was dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Interruption {
    /// Another slave looks wrong.
    Bus,
    /// A command arrived.
    Command,
}

/// Kind of work: what may end it, and what has to wait for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Work {
    /// Bring-up or repair. Requests are answered by [`ServiceError::Busy`]; a start, a stop and a lost link of the port end
    /// it.
    Exclusive,
    /// A request, or a look at the bus. A start and a stop end it.
    Background,
    /// Opening a file in BOOT, or a packet of it. A start waits for its end: the slave could not tell how much of it has come.
    Transfer,
}

/// The incoming ends of the supervisor's queues.
pub(super) struct Inbox<'a, F: SlaveFactory> {
    pub(super) observations: Consumer<'a, Observation>,
    pub(super) commands: Consumer<'a, BusCommand<F>>,
    pub(super) services: Consumer<'a, ServiceRequest>,
    pub(super) answers: Producer<'a, ServiceResult>,
    pub(super) seen: Option<Observation>,
    pub(super) suspicion_ms: u32,
    /// The application's clock, ms, and its time at the last look; without one a look counts as a millisecond.
    #[cfg(feature = "clock")]
    pub(super) clock: Option<fn() -> u32>,
    #[cfg(feature = "clock")]
    pub(super) looked_ms: u32,
    /// State of the Ethernet port.
    pub(super) port: PortState,
}

impl<F: SlaveFactory> Inbox<'_, F> {
    /// Takes the critical side's new observations; call it once a millisecond.
    pub(super) fn observe(&mut self, expected: &Expectation) {
        while let Some(observation) = self.observations.dequeue() {
            self.seen = Some(observation);
        }
        self.clear_the_way();
        let passed_ms = self.passed_ms();
        self.suspicion_ms = if self.seen.is_some_and(|seen| expected.differs(&seen)) {
            self.suspicion_ms.saturating_add(passed_ms)
        } else {
            0
        };
    }

    /// Time since the last look, ms; one look alone is little proof, however long ago the one before was.
    #[cfg(feature = "clock")]
    fn passed_ms(&mut self) -> u32 {
        let Some(now_ms) = self.clock else { return 1 };
        let before_ms = core::mem::replace(&mut self.looked_ms, now_ms());
        self.looked_ms.wrapping_sub(before_ms).min(LOOK_MAX_MS)
    }

    /// A look counts as a millisecond.
    #[cfg(not(feature = "clock"))]
    #[allow(clippy::unused_self)] // as with a clock
    const fn passed_ms(&self) -> u32 {
        1
    }

    /// Takes changes of the port, so that no other command waits behind them, and lets a start overtake a repair.
    fn clear_the_way(&mut self) {
        while let Some(BusCommand::Port(port)) = front(&self.commands) {
            self.port = *port;
            // This is the command that was just checked.
            let _ = self.commands.dequeue();
        }
        if self.commands.len() > 1 && matches!(front(&self.commands), Some(BusCommand::Recover)) {
            // A command after the repair makes the repair pointless.
            let _ = self.commands.dequeue();
        }
    }

    /// Number of slaves that answered in the last cycle.
    pub(super) fn slaves(&self) -> u16 {
        self.seen.map_or(0, |seen| seen.al.slaves)
    }

    /// Runs `work` of a `kind` as long as the bus is as `expected` and no command makes the work pointless.
    pub(super) async fn guard<T>(
        &mut self,
        mut expected: Expectation,
        kind: Work,
        mut work: Pin<&mut impl Future<Output = T>>,
    ) -> Result<T, Interruption> {
        self.suspicion_ms = 0;
        poll_fn(|context| {
            if let Poll::Ready(value) = work.as_mut().poll(context) {
                return Poll::Ready(Ok(value));
            }
            self.observe(&expected);
            // An error flag that was set at the start may clear; a new one belongs to another slave.
            if self
                .seen
                .is_some_and(|seen| seen.al.status & register::AL_ERROR_BIT == 0)
                && expected.slaves.is_some()
            {
                expected.allowed &= !register::AL_ERROR_BIT;
            }
            let is_exclusive = kind == Work::Exclusive;
            if is_exclusive && self.answers.ready() && self.services.dequeue().is_some() {
                // There is room; it was just checked.
                let _ = self.answers.enqueue(Err(ServiceError::Busy));
            }
            if is_exclusive && self.port.is_down() {
                return Poll::Ready(Err(Interruption::Bus));
            }
            if self.suspicion_ms >= WORK_SUSPICION_MS {
                return Poll::Ready(Err(Interruption::Bus));
            }
            match front(&self.commands) {
                Some(BusCommand::Start(_)) if kind == Work::Transfer => Poll::Pending,
                Some(BusCommand::Start(_) | BusCommand::Stop) => Poll::Ready(Err(Interruption::Command)),
                _ => Poll::Pending,
            }
        })
        .await
    }
}
