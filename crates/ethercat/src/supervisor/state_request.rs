//! State requests: brings one slave to a requested state.
//!
//! Invariant: up one state at a time, with all prerequisites of the state set up first; a slave in use that was brought
//! below OP stays there until it is requested to go up again, or the bus is repaired or restarted.

use super::super::coe::ObjectDictionary;
use super::super::configure::information;
use super::super::diagnostics::ServiceError;
use super::super::driver::SlaveFactory;
use super::super::error::BusError;
use super::super::event::BusEvent;
use super::super::mailbox::Mailbox;
use super::super::slave::{Condition, SlaveData};
use super::super::state::{self, AlReport, AlState};
use super::super::wire::sii::PROTOCOL_COE;
use super::Failure;
use super::bus::{Bus, LOST_SLAVE};
use super::repair::Returned;

impl From<Failure> for ServiceError {
    fn from(failure: Failure) -> Self {
        Self::Bus(failure.error)
    }
}

impl From<BusError> for ServiceError {
    fn from(error: BusError) -> Self {
        Self::Bus(error)
    }
}

/// Whether process data are exchanged in a state.
const fn is_exchanging(state: AlState) -> bool {
    matches!(state, AlState::SafeOperational | AlState::Operational)
}

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> Bus<'_, F, SLAVES, MESSAGE> {
    /// Brings a slave to a state; returns the actual state.
    pub(super) async fn set_state(&mut self, number: usize, target: AlState) -> Result<AlReport, ServiceError> {
        self.work_on(Some(number)).await;
        let Some(slave) = self.slaves.get(number).copied() else {
            return Err(ServiceError::Interrupted);
        };
        let station = slave.station();
        if slave.condition == Condition::Returned {
            match self.identify_returned(number).await? {
                Returned::Same => {}
                // It may have been set up for another machine.
                Returned::Equal => state::change(&mut self.port, station, AlState::Init).await?,
                Returned::Other => return Err(LOST_SLAVE.into()),
            }
        }
        let before = match state::acknowledge(&mut self.port, station).await {
            Ok(report) => report,
            // Only INIT clears a flag that stays set.
            Err(BusError::State { .. }) => AlReport::default(),
            Err(error) => return Err(error.into()),
        };
        if slave.is_used() && target != AlState::Operational {
            self.set_condition(number, Condition::Parked);
        }
        if !slave.is_used() && !is_exchanging(target) {
            self.forget_process_data(number);
        }
        let present = before.state().unwrap_or(AlState::Init);
        if target as u8 > present as u8 && target != AlState::Bootstrap {
            let result = self.climb(number, before.state(), target).await;
            if !slave.is_used() && result.is_err() {
                self.forget_process_data(number);
            }
            result?;
        } else if !before.is(target) {
            state::change(&mut self.port, station, target).await?;
        }
        let report = state::report(&mut self.port, station).await?;
        if let Some(slave) = self.slaves.get_mut(number) {
            slave.report = report;
        }
        self.introduce(number).await;
        if target == AlState::Operational && slave.is_used() && report.is(target) {
            self.set_condition(number, Condition::Operational);
            if self.is_running && self.is_operational() {
                self.emit(BusEvent::Operational).await;
            }
        }
        Ok(report)
    }

    fn set_condition(&mut self, number: usize, condition: Condition) {
        if let Some(slave) = self.slaves.get_mut(number) {
            slave.condition = condition;
        }
    }

    fn forget_process_data(&mut self, number: usize) {
        if let Some(slave) = self.slaves.get_mut(number) {
            slave.data = SlaveData::Unknown;
        }
    }

    /// Goes up from a state, one state at a time.
    async fn climb(&mut self, number: usize, from: Option<AlState>, target: AlState) -> Result<(), ServiceError> {
        let Some(slave) = self.slaves.get_mut(number) else {
            return Err(ServiceError::Interrupted);
        };
        let station = slave.station();
        // What takes a member's place is asked for its driver in INIT.
        let from = match slave.member.is_some() && slave.device.is_none() {
            true => {
                state::change(&mut self.port, station, AlState::Init).await?;
                Some(AlState::Init)
            }
            false => from,
        };
        // The process data of another master are not known.
        let from = match from {
            Some(AlState::SafeOperational) if !slave.data.is_known() => {
                state::change(&mut self.port, station, AlState::PreOperational).await?;
                Some(AlState::PreOperational)
            }
            from => from,
        };
        // What was read of a refused terminal may have been damaged: it is read again, and goes through INIT.
        let is_refused = slave.is_refused_terminal();
        let from = from.filter(|_| !is_refused);
        if !matches!(from, Some(AlState::PreOperational | AlState::SafeOperational)) {
            self.generation = self.generation.wrapping_add(1);
            slave.generation = self.generation;
            slave.report = AlReport::default();
            if is_refused {
                self.read_again(number).await?;
            }
            self.recognise(number).await?;
            self.reach_pre_operational(number).await?;
        }
        if target == AlState::PreOperational {
            return Ok(());
        }
        if from != Some(AlState::SafeOperational) {
            self.ready_mailbox(number).await?;
            self.adapt_exchange(number).await?;
            information::take(&mut self.port, station).await;
            self.configure(number, None).await?;
        }
        if target == AlState::SafeOperational {
            return Ok(());
        }
        self.send_plan().await;
        match self.slaves.get(number).copied() {
            Some(slave) if !slave.is_used() => {
                self.await_inputs(&slave).await?;
                state::change(&mut self.port, station, AlState::Operational).await?;
            }
            _ => self.reach_operational(number).await?,
        }
        Ok(())
    }

    /// Makes a mailbox usable that is already set up, perhaps by another master.
    async fn ready_mailbox(&mut self, number: usize) -> Result<(), BusError> {
        let Some(slave) = self.slaves.get_mut(number) else {
            return Ok(());
        };
        let (out, input) = (slave.fixed.mailbox_out, slave.fixed.mailbox_in);
        if slave.mailbox == Mailbox::default() && out.length > 0 {
            let mut mailbox = Mailbox::new::<MESSAGE>(slave.station(), out, input)?;
            if slave.fixed.protocols & PROTOCOL_COE != 0 {
                ObjectDictionary::new(&mut self.port, &mut mailbox).join().await?;
            }
            slave.mailbox = mailbox;
        }
        Ok(())
    }

    /// Makes sure that a slave's CoE mailbox can be used: a slave in INIT is brought to PREOP.
    pub(super) async fn open_mailbox(&mut self, number: usize) -> Result<(), ServiceError> {
        let Some(slave) = self.slaves.get(number).copied() else {
            return Err(ServiceError::Interrupted);
        };
        if slave.fixed.protocols & PROTOCOL_COE == 0 || slave.fixed.mailbox_out.length == 0 {
            return Err(ServiceError::NoCoe);
        }
        self.ready_or_reach_pre_operational(number).await
    }

    /// Makes a slave's mailbox usable: a slave in INIT is brought to PREOP.
    pub(super) async fn ready_or_reach_pre_operational(&mut self, number: usize) -> Result<(), ServiceError> {
        let Some(slave) = self.slaves.get(number).copied() else {
            return Err(ServiceError::Interrupted);
        };
        let report = state::report(&mut self.port, slave.station()).await?;
        if report.state() == Some(AlState::Init) {
            self.work_on(Some(number)).await;
            if let Some(slave) = self.slaves.get_mut(number) {
                slave.report = AlReport::default();
            }
            self.reach_pre_operational(number).await?;
        } else {
            self.ready_mailbox(number).await?;
        }
        Ok(())
    }
}
