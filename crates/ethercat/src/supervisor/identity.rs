//! Identity of the slaves in use: whether the slave at a place is the one that the application expects there.
//!
//! Two equal drives whose cables are exchanged would move each other's axes, two equal terminals would exchange their
//! contacts. What tells them apart is read before a slave leaves INIT: at bring-up for all of them together, and in a repair
//! for the slave that has returned, even where it has kept its address and its state. A member that differs ends the bring-up;
//! a terminal that differs is refused alone.
//!
//! Invariant: a slave that differs from what is expected at its place is not used; the refusal names the place, and the
//! other one if the slave there is the expected one, or the slave here is expected there.

use super::super::coe::{DEVICE_TYPE, ObjectDictionary};
use super::super::configure::identification::{self, ExpectedIdentity, KnownIdentity};
use super::super::configure::{discovery, information};
use super::super::driver::{SlaveFactory, is_asked_for_device_type};
use super::super::error::BusError;
use super::super::event::Step;
use super::super::mailbox::Mailbox;
use super::super::slave::Slave;
use super::super::state::{self, AlState};
use super::super::wire::sii::Identity;
use super::Failure;
use super::bus::Bus;

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> Bus<'_, F, SLAVES, MESSAGE> {
    /// What is expected of a slave as a member or as a terminal.
    fn expected(&self, slave: &Slave<F>) -> ExpectedIdentity {
        if let Some(member) = slave.member {
            return F::expected_identity(&self.setup.settings, member);
        }
        let mut places = self.setup.identities.iter().filter(|_| slave.is_terminal);
        let here = places.find(|place| u16::from(place.slave) == slave.position);
        here.map_or(ExpectedIdentity::ANY, |place| place.identity)
    }

    /// Finds the driver of a member that has been exchanged for a slave with another identity; such a one may be known by
    /// its device type only.
    pub(super) async fn recognise(&mut self, number: usize) -> Result<(), Failure> {
        let is_unknown = |slave: &&Slave<F>| slave.member.is_some() && slave.device.is_none();
        let Some(slave) = self.slaves.get(number).filter(is_unknown) else {
            return Ok(());
        };
        let position = slave.position;
        let missing = BusError::MemberCount {
            expected: self.setup.members,
            actual: self.setup.members.saturating_sub(1),
        };
        let asked = self.ask_device_type(number, true).await;
        let device = asked
            .and_then(|device| device.ok_or(missing))
            .map_err(Failure::of(position, Step::Identify))?;
        if let Some(slave) = self.slaves.get_mut(number) {
            slave.device = Some(device);
        }
        Ok(())
    }

    /// Asks the slaves without a driver for their device types. One that does not answer has none until it is asked again.
    pub(super) async fn ask_device_types(&mut self) {
        for number in 0..self.slaves.len() {
            let device = self.ask_device_type(number, false).await.ok().flatten();
            if let Some(slave) = self.slaves.get_mut(number).filter(|slave| slave.device.is_none()) {
                slave.device = device;
            }
        }
    }

    /// Asks the slaves that still have no driver again, and waits for processors that start up. Returns the first that has
    /// not read its request; one that answers something else has no driver.
    pub(super) async fn await_device_types(&mut self) -> Option<Failure> {
        let mut silent = None;
        for number in 0..self.slaves.len() {
            let asked = self.ask_device_type(number, true).await;
            let Some(slave) = self.slaves.get_mut(number) else {
                continue;
            };
            match asked {
                Ok(None) => {}
                Ok(device) => slave.device = device,
                Err(error @ BusError::RequestUnread { .. }) => {
                    silent = silent.or(Some(Failure::of(slave.position, Step::Identify)(error)));
                }
                Err(_) => {}
            }
        }
        silent
    }

    /// Asks a slave without a driver for its device type, and leaves the slave in INIT; `None` if there is no driver for it.
    /// `is_patient` waits for a processor that still starts up.
    ///
    /// # Errors
    /// The slave does not go to PREOP, or does not answer.
    async fn ask_device_type(&mut self, number: usize, is_patient: bool) -> Result<Option<F::Device>, BusError> {
        let is_asked = |slave: &&Slave<F>| slave.device.is_none() && is_asked_for_device_type::<F>(&slave.fixed);
        let Some(slave) = self.slaves.get(number).filter(is_asked) else {
            return Ok(None);
        };
        let (station, fixed, target) = (slave.station(), slave.fixed, AlState::PreOperational);
        let mut mailbox = Mailbox::new::<MESSAGE>(station, fixed.mailbox_out, fixed.mailbox_in)?;
        discovery::mailbox_managers(&mut self.port, station, &fixed).await?;
        information::give_to_slave(&mut self.port, station).await;
        let reached = match is_patient {
            true => {
                let reached = self.change_state(number, target, Step::PreOperational).await;
                reached.map_err(|failure| failure.error)
            }
            false => state::change(&mut self.port, station, target).await,
        };
        let device_type = match reached {
            Ok(()) => {
                ObjectDictionary::new(&mut self.port, &mut mailbox)
                    .read(DEVICE_TYPE, 4)
                    .await
            }
            Err(error) => Err(error),
        };
        // There is no way back from where it did not go.
        if !matches!(device_type, Err(BusError::RequestUnread { .. })) {
            // A slave that does not return to INIT is detected when it is used.
            let _ = state::change(&mut self.port, station, AlState::Init).await;
        }
        information::take(&mut self.port, station).await;
        device_type.map(F::by_device_type)
    }

    /// Reads what tells the slaves in use apart, and compares all members with what is expected of them.
    pub(super) async fn check_members(&mut self) -> Result<(), Failure> {
        if self.slaves.iter().all(|slave| self.expected(slave).is_any()) {
            return Ok(());
        }
        for number in 0..self.slaves.len() {
            let may_be_compared = |slave: &&Slave<F>| slave.device.is_some() || slave.is_terminal;
            let Some(slave) = self.slaves.get(number).filter(may_be_compared) else {
                continue;
            };
            let (position, station, identity) = (slave.position, slave.station(), slave.identity());
            let known = match self.known(number, station, identity).await {
                Ok(known) => known,
                Err(error) if is_member(&self.slaves, number) => {
                    return Err(Failure::of(position, Step::Identify)(error));
                }
                Err(_) => continue,
            };
            let switches = self.compares_switches();
            if let Some(slave) = self.slaves.get_mut(number) {
                slave.known = known;
                slave.switch = switches.then_some(known.switch);
            }
        }
        for slave in self.slaves.iter().filter(|slave| slave.member.is_some()) {
            self.compare(slave, &slave.known)
                .map_err(Failure::of(slave.position, Step::Identify))?;
        }
        Ok(())
    }

    /// Compares the slave at a station address, which has returned to a slave's place, with what is expected there. Returns
    /// its identity as far as it was read.
    pub(super) async fn check_returned(
        &mut self,
        number: usize,
        station: u16,
        identity: Identity,
    ) -> Result<KnownIdentity, BusError> {
        let unread = KnownIdentity {
            identity,
            ..KnownIdentity::default()
        };
        let Some(slave) = self.slaves.get(number).copied() else {
            return Ok(unread);
        };
        if self.expected(&slave).is_any() {
            return Ok(unread);
        }
        let known = self.known(number, station, identity).await?;
        self.compare(&slave, &known)?;
        Ok(known)
    }

    /// Compares a terminal with what is expected of it, as last read.
    pub(super) fn check_terminal(&self, number: usize) -> Result<(), Failure> {
        match self.slaves.get(number).filter(|slave| slave.is_terminal) {
            Some(slave) => self
                .compare(slave, &slave.known)
                .map_err(Failure::of(slave.position, Step::Identify)),
            None => Ok(()),
        }
    }

    /// Whether the slave at a place was another one than is expected there: it is not waited for.
    pub(super) fn is_unwanted(&self, slave: &Slave<F>) -> bool {
        self.compare(slave, &slave.known).is_err()
    }

    /// Reads what the members' expectations compare.
    async fn known(&mut self, number: usize, station: u16, identity: Identity) -> Result<KnownIdentity, BusError> {
        let aliases = self.slaves.iter().any(|slave| self.expected(slave).alias != 0);
        let switches = self.compares_switches();
        let mut known = KnownIdentity {
            identity,
            ..KnownIdentity::default()
        };
        if aliases {
            known.alias = identification::alias(&mut self.port, station).await?;
        }
        let is_expected = self
            .slaves
            .get(number)
            .is_some_and(|slave| self.expected(slave).switch != 0);
        if switches {
            known.switch = self.switch(number, station, is_expected).await?;
        }
        Ok(known)
    }

    /// Asks for the number of the switches of the slave at a station address, at a slave's place. `is_patient` waits for a
    /// processor that still starts up.
    async fn switch(&mut self, number: usize, station: u16, is_patient: bool) -> Result<u16, BusError> {
        let (position, started_ms) = (number as u16, self.port.now_ms());
        loop {
            let asked = match state::acknowledge(&mut self.port, station).await {
                Ok(_) => state::switch(&mut self.port, station).await,
                Err(error) => Err(error),
            };
            let error = match asked {
                Err(error) if is_patient => error,
                asked => return asked,
            };
            let waited = self.wait_on(position, station, Step::Identify, started_ms, error).await;
            waited.map_err(|failure| failure.error)?;
        }
    }

    /// Whether the switches of any member are compared.
    pub(super) fn compares_switches(&self) -> bool {
        self.slaves.iter().any(|slave| self.expected(slave).switch != 0)
    }

    /// Asks a slave without a pending error for the number of its switches, for display, once. The slave has to be in INIT
    /// or PREOP.
    pub(super) async fn ask_for_switch(&mut self, number: usize) -> Result<Option<u16>, BusError> {
        let Some(slave) = self.slaves.get(number).filter(|slave| !slave.report.is_flagged()) else {
            return Ok(None);
        };
        let switch = Some(state::switch(&mut self.port, slave.station()).await?);
        if let Some(slave) = self.slaves.get_mut(number) {
            slave.switch = switch;
        }
        Ok(switch)
    }

    /// Whether a slave with this identity is the one that is expected at a slave's place.
    fn compare(&self, slave: &Slave<F>, known: &KnownIdentity) -> Result<(), BusError> {
        let expected = self.expected(slave);
        let Some(difference) = expected.difference(known) else {
            return Ok(());
        };
        let others = || self.slaves.iter().filter(|other| other.position != slave.position);
        let is_wanted = |other: &&Slave<F>| {
            (other.device.is_some() || other.is_terminal) && expected.difference(&other.known).is_none()
        };
        let is_owner = |other: &&Slave<F>| {
            let expected = self.expected(other);
            !expected.is_any() && expected.difference(known).is_none()
        };
        let other = others().find(is_owner).or_else(|| others().find(is_wanted));
        Err(BusError::WrongSlave {
            property: difference.property,
            expected: difference.expected,
            actual: difference.actual,
            other: other.map(|other| other.position as u8),
        })
    }
}

fn is_member<F: SlaveFactory>(slaves: &[Slave<F>], number: usize) -> bool {
    slaves.get(number).is_some_and(|slave| slave.member.is_some())
}
