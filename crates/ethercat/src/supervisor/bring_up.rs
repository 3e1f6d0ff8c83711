//! Bring-up: from an unknown chain to slaves in OP, and shutdown.
//!
//! Each function is one guarded step. Bring-up and repair share these steps.
//!
//! Invariant: beside members and terminals, only slaves that have to be asked for their device type leave INIT here; a slave
//! goes up one state at a time.

use super::super::acyclic::Request;
use super::super::clock::{self, BusClocks, SyncSignals};
use super::super::configure::discovery::STATION_BASE;
use super::super::configure::own_data::{self, OwnData};
use super::super::configure::{PreOperational, Windows, discovery, information};
use super::super::cyclic::{ExchangeKind, ValueBit};
use super::super::driver::{Direction, ProcessData, SlaveFactory};
use super::super::error::BusError;
use super::super::event::{BusEvent, Step, WantedValue};
use super::super::mailbox::Mailbox;
use super::super::process_data;
use super::super::slave::{Condition, Slave, SlaveData};
use super::super::slave_set::SlaveSet;
use super::super::state::{self, AlReport, AlState};
use super::super::wire::sii::PROTOCOL_COE;
use super::super::wire::{Address, Command, register, sii};
use super::Failure;
use super::bus::{Bus, PLAN_MS};

/// Longest wait for the expected number of slaves, ms.
pub const DISCOVERY_TIMEOUT_MS: u32 = 3_000;
/// How long the number of slaves has to be stable, ms.
const STABLE_MS: u32 = 10;
/// Longest wait for the first inputs, ms.
const INPUTS_TIMEOUT_MS: u32 = 1_000;
/// How long outputs are sent before OP is requested for a member, ms.
const OUTPUTS_BEFORE_OPERATIONAL_MS: u32 = 10;
/// Watchdog of slaves that the application does not use, ms: the slave controllers' default, as they move nothing.
const UNUSED_WATCHDOG_MS: u16 = 100;
/// Longest wait for a slave's processor to read a request, ms: some drives take 10 s to start up.
const UNREAD_TIMEOUT_MS: u32 = 20_000;
/// How long safe outputs are sent before the slaves leave OP, ms.
const SAFE_OUTPUTS_MS: u32 = 3;

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> Bus<'_, F, SLAVES, MESSAGE> {
    /// Counts, resets and identifies the slaves, and chooses the members.
    pub(super) async fn find_all(&mut self) -> Result<(), Failure> {
        self.slaves.clear();
        self.values = Default::default();
        self.exchange = self.setup.exchange;
        self.clocks = BusClocks::default();
        self.send_plan().await;
        let found = self.discover().await.map_err(Failure::bus(Step::Discover))?;
        self.emit(BusEvent::Found { slaves: found }).await;
        discovery::reset_all(&mut self.port)
            .await
            .map_err(Failure::bus(Step::Reset))?;
        let unread = self.identify_all(found).await?;
        self.ask_device_types().await;
        if self.choose_members().is_err() {
            let silent = self.await_device_types().await;
            if let Err(error) = self.choose_members() {
                // A member may be missing because it could not be read, or does not answer.
                return Err(unread.or(silent).unwrap_or(Failure::bus(Step::Identify)(error)));
            }
        }
        self.choose_terminals();
        self.check_members().await?;
        self.choose_exchange().await?;
        self.read_reports().await;
        self.introduce_all().await;
        self.send_plan().await;
        Ok(())
    }

    /// Exchanges inputs and outputs apart if they are to travel together, but a slave in use does not support LRW.
    async fn choose_exchange(&mut self) -> Result<(), Failure> {
        if self.setup.exchange != ExchangeKind::Combined {
            return Ok(());
        }
        let Self { port, slaves, .. } = self;
        // Some controllers say it in their features, where any slave's bit is seen: an unused one's does no harm.
        let features = port.broadcast_read_u16(register::FEATURES).await;
        let (features, _) = features.map_err(Failure::bus(Step::Identify))?;
        if features & register::FEATURE_NO_LRW != 0 {
            self.exchange = ExchangeKind::Split;
            return Ok(());
        }
        for slave in slaves.iter().filter(|slave| slave.is_used()) {
            let flags = match information::general_flags(port, slave.station()).await {
                // A terminal that cannot be read yet may not support it.
                Err(_) if slave.is_terminal => sii::FLAG_NO_LRW,
                flags => flags.map_err(Failure::of(slave.position, Step::Identify))?,
            };
            if flags & sii::FLAG_NO_LRW != 0 {
                self.exchange = ExchangeKind::Split;
                return Ok(());
            }
        }
        Ok(())
    }

    /// Exchanges inputs and outputs apart from now on if they travel together, but a slave that is about to be configured does
    /// not support LRW.
    pub(super) async fn adapt_exchange(&mut self, number: usize) -> Result<(), BusError> {
        let Some(station) = self.slaves.get(number).map(Slave::station) else {
            return Ok(());
        };
        if self.exchange != ExchangeKind::Combined {
            return Ok(());
        }
        let features = self.port.read_u16(station, register::FEATURES).await?;
        // From SAFEOP on its processor has the memory.
        information::take(&mut self.port, station).await;
        let flags = information::general_flags(&mut self.port, station).await;
        // One whose memory cannot be read may not support it.
        let flags = flags.unwrap_or(sii::FLAG_NO_LRW);
        if features & register::FEATURE_NO_LRW != 0 || flags & sii::FLAG_NO_LRW != 0 {
            self.exchange = ExchangeKind::Split;
            // No telegram of before reaches its mapping.
            self.send_plan().await;
            self.port.wait_ms(PLAN_MS).await;
        }
        Ok(())
    }

    /// Makes the slaves' clocks agree and has the reference's time distributed from then on.
    pub(super) async fn set_up_clocks(&mut self) -> Result<(), Failure> {
        if !self.setup.clocks {
            return Ok(());
        }
        let stations = self.stations();
        self.time_number = self.time_number.wrapping_add(1);
        let Self { port, slaves, .. } = self;
        let is_used = |place: usize| slaves.get(place).is_some_and(|slave| slave.member.is_some());
        self.clocks = clock::set_up(port, &stations, self.setup.cycle_ns, self.time_number, is_used)
            .await
            .map_err(Failure::bus(Step::Clocks))?;
        self.send_plan().await;
        Ok(())
    }

    /// Fewest slaves of a chain that can be brought up: all up to the last terminal that is named, and the members for which
    /// there is no place among them; more if the setup asks for more.
    pub(super) fn fewest_slaves(&self) -> u16 {
        let members = u16::from(self.setup.members);
        let named = match self.setup.terminals {
            SlaveSet::ALL => members,
            places => {
                let up_to_last = places.last().map_or(0, |last| last as u16 + 1);
                let others = up_to_last.saturating_sub(places.count() as u16);
                up_to_last + members.saturating_sub(others)
            }
        };
        named.max(self.setup.slaves.into())
    }

    /// Waits until as many slaves as expected are there and their number is stable.
    async fn discover(&mut self) -> Result<u16, BusError> {
        let expected = self.fewest_slaves();
        let (started_ms, mut found, mut since_ms) = (self.port.now_ms(), 0, self.port.now_ms());
        loop {
            let answer = self.port.broadcast_read_u16(register::AL_STATUS).await;
            let count = answer.map_or(0, |(_, slaves)| slaves);
            let now_ms = self.port.now_ms();
            if count != found {
                (found, since_ms) = (count, now_ms);
                // Another master may have closed ports: behind one that opens there may be another. No answer is needed.
                let _ = discovery::open_ports(&mut self.port).await;
            }
            if found >= expected && found > 0 && now_ms.wrapping_sub(since_ms) >= STABLE_MS {
                break;
            }
            if now_ms.wrapping_sub(started_ms) > DISCOVERY_TIMEOUT_MS {
                return Err(BusError::SlaveCount {
                    expected,
                    actual: found,
                });
            }
        }
        if usize::from(found) > SLAVES {
            return Err(BusError::TooManySlaves {
                expected: SLAVES as u16,
                actual: found,
            });
        }
        Ok(found)
    }

    /// Assigns addresses to all slaves and reads their identities. A slave whose SII cannot be read stays unknown; the
    /// first such failure is returned.
    pub(super) async fn identify_all(&mut self, found: u16) -> Result<Option<Failure>, Failure> {
        self.slaves.clear();
        self.exchanged = SlaveSet::NONE;
        self.forget_file();
        self.ordered = usize::from(found);
        for position in 0..found {
            // There is room for as many slaves as were found.
            let _ = self.slaves.push(Slave::at(position));
        }
        discovery::assign_stations(&mut self.port, found)
            .await
            .map_err(Failure::bus(Step::Address))?;
        let mut unread = None;
        let Self { port, slaves, .. } = self;
        for chunk in slaves.chunks_mut(information::TOGETHER_MAX) {
            let first = chunk.first().map_or(0, |slave| slave.position);
            let stations = STATION_BASE.wrapping_add(first)..STATION_BASE.wrapping_add(first + chunk.len() as u16);
            let parts = information::fixed_parts(port, stations).await;
            for (slave, part) in chunk.iter_mut().zip(parts) {
                match part {
                    Ok(fixed) => {
                        slave.fixed = fixed;
                        slave.device = F::by_identity(&fixed.identity);
                    }
                    Err(error) => {
                        unread = unread.or(Some(Failure::of(slave.position, Step::Identify)(error)));
                    }
                }
            }
        }
        self.read_ports().await;
        Ok(unread)
    }

    /// Numbers the members: the slaves with a driver, in chain order.
    fn choose_members(&mut self) -> Result<(), BusError> {
        let expected = self.setup.members;
        let named = self.setup.terminals;
        // A slave that the application names as a terminal is none of its members, whatever it is; a set of all places
        // names nobody.
        let is_free = |slave: &Slave<F>| named == SlaveSet::ALL || !named.contains(slave.position.into());
        let known = self
            .slaves
            .iter_mut()
            .filter(|slave| slave.device.is_some() && is_free(slave));
        let actual = (0..expected)
            .zip(known)
            .map(|(member, slave)| slave.member = Some(member))
            .count() as u8;
        if actual < expected {
            Err(BusError::MemberCount { expected, actual })
        } else {
            Ok(())
        }
    }

    /// Whether a slave's information memory names no vendor: it is blank, or its processor does not show it yet.
    pub(super) fn has_blank_memory(&self) -> bool {
        let mut vendors = self.slaves.iter().map(|slave| slave.fixed.identity.vendor);
        vendors.any(|vendor| matches!(vendor, 0 | u32::MAX))
    }

    /// Marks the further slaves that take part.
    fn choose_terminals(&mut self) {
        let places = self.setup.terminals;
        for slave in &mut self.slaves {
            slave.is_terminal = slave.member.is_none() && places.contains(slave.position.into());
        }
    }

    /// Configures a slave in use from INIT to SAFEOP; leaves other slaves alone.
    pub(super) async fn reach_safe_operational(&mut self, number: usize) -> Result<(), Failure> {
        let Some(slave) = self.slaves.get_mut(number).filter(|slave| slave.is_used()) else {
            return Ok(());
        };
        slave.condition = Condition::Configuring;
        self.generation = self.generation.wrapping_add(1);
        slave.generation = self.generation;
        slave.emergency = None;
        let result = self.go_to_safe_operational(number).await;
        if result.is_err() {
            // Whatever the slave does now, it may need its memory.
            information::give_to_slave(&mut self.port, STATION_BASE.wrapping_add(number as u16)).await;
        }
        result
    }

    async fn go_to_safe_operational(&mut self, number: usize) -> Result<(), Failure> {
        if let Some(unread) = self.slaves.get(number).filter(|slave| slave.is_unread_terminal()) {
            let at = Failure::of(unread.position, Step::Identify);
            self.read_again(number).await.map_err(at)?;
        }
        self.check_terminal(number)?;
        let is_new = |slave: &Slave<F>| !slave.data.is_known() && !slave.has_own_data();
        let is_new = self.slaves.get(number).is_some_and(is_new);
        let mut windows = self.twin(number).filter(|_| is_new).map(|twin| twin.windows);
        loop {
            self.reach_pre_operational(number).await?;
            match self.configure(number, windows).await {
                // Those of the equal slave may not fit.
                Err(failure) if failure.is_about_data() && windows.take().is_some() => {}
                other => return other,
            }
        }
    }

    /// Takes a slave to a state, from the state before it or from a higher one. While the slave's processor does not read
    /// the request, the application is told what this waits for, and a controller without its configuration loads it.
    pub(super) async fn change_state(&mut self, number: usize, target: AlState, step: Step) -> Result<(), Failure> {
        let Some(slave) = self.slaves.get(number) else {
            return Ok(());
        };
        let (position, station, started_ms) = (slave.position, slave.station(), self.port.now_ms());
        loop {
            match state::change(&mut self.port, station, target).await {
                Ok(()) => return Ok(()),
                Err(error) => self.wait_on(position, station, step, started_ms, error).await?,
            }
        }
    }

    /// Goes on if an error says that the processor of a slave has not read a request yet: the application is told what this
    /// waits for, and a controller without its configuration loads it.
    ///
    /// # Errors
    /// The error, if it is another one, or after [`UNREAD_TIMEOUT_MS`].
    pub(super) async fn wait_on(
        &mut self,
        position: u16,
        station: u16,
        step: Step,
        started_ms: u32,
        error: BusError,
    ) -> Result<(), Failure> {
        let waited_ms = self.port.now_ms().wrapping_sub(started_ms);
        if !matches!(error, BusError::RequestUnread { .. }) || waited_ms > UNREAD_TIMEOUT_MS {
            return Err(Failure::of(position, step)(error));
        }
        let position = position as u8;
        self.emit(BusEvent::Waiting {
            position,
            step,
            waited_ms,
        })
        .await;
        information::load_again(&mut self.port, station).await;
        Ok(())
    }

    /// Takes a slave from any state through INIT to PREOP with its mailbox set up, if it has one.
    pub(super) async fn reach_pre_operational(&mut self, number: usize) -> Result<(), Failure> {
        if self.file.is_some_and(|file| file.number == number) {
            self.forget_file();
        }
        if self
            .slaves
            .get(number)
            .is_some_and(|slave| !slave.report.is(AlState::Init))
        {
            self.change_state(number, AlState::Init, Step::Init).await?;
        }
        let Some(slave) = self.slaves.get_mut(number) else {
            return Ok(());
        };
        let (port, station) = (&mut self.port, slave.station());
        let at = |step| Failure::of(slave.position, step);
        (slave.report, slave.mailbox) = (AlReport::default(), Mailbox::default());
        discovery::clear(port, station).await.map_err(at(Step::Init))?;
        if slave.fixed.mailbox_out.length > 0 {
            let (out, input) = (slave.fixed.mailbox_out, slave.fixed.mailbox_in);
            slave.mailbox = Mailbox::new::<MESSAGE>(station, out, input).map_err(at(Step::Mailbox))?;
            discovery::mailbox_managers(port, station, &slave.fixed)
                .await
                .map_err(at(Step::Mailbox))?;
        }
        information::give_to_slave(port, station).await;
        self.change_state(number, AlState::PreOperational, Step::PreOperational)
            .await?;
        information::take(&mut self.port, station).await;
        Ok(())
    }

    /// Process data of another slave with equal product and revision.
    fn twin(&self, number: usize) -> Option<ProcessData<F>> {
        let product = |slave: &Slave<F>| {
            let identity = slave.identity();
            (identity.vendor, identity.product, identity.revision)
        };
        let wanted = product(self.slaves.get(number)?);
        let mut others = self.slaves.iter().enumerate().filter(|(other, _)| *other != number);
        others.find_map(|(_, other)| other.data.of_driver().filter(|_| product(other) == wanted).copied())
    }

    /// Takes a slave from PREOP to SAFEOP with settings, process data and watchdogs. `windows`: sync managers of an equal slave,
    /// instead of its own.
    pub(super) async fn configure(&mut self, number: usize, windows: Option<Windows>) -> Result<(), Failure> {
        let twin = self.twin(number);
        let Some(slave) = self.slaves.get_mut(number) else {
            return Ok(());
        };
        let (port, station, position) = (&mut self.port, slave.station(), slave.position);
        let at = |step| Failure::of(position, step);
        let watchdog_ms = match slave.is_used() {
            true => self.setup.watchdog_ms,
            false => UNUSED_WATCHDOG_MS,
        };
        if slave.has_own_data() {
            self.find_own_data(number).await.map_err(at(Step::Objects))?;
        } else if let Some(device) = slave.device {
            let mut there = PreOperational::new(port, station, &mut slave.mailbox, self.setup.cycle_ns, windows);
            let configured = F::configure(&self.setup.settings, device, slave.member, &mut there, twin.as_ref());
            let data = configured.await.map_err(at(Step::Objects))?;
            slave.data = data.map_or(SlaveData::Unknown, SlaveData::OfDriver);
        }
        self.check_plan().map_err(Failure::of(position, Step::ProcessData))?;
        let Self { port, slaves, .. } = self;
        let Some(slave) = slaves.get_mut(number) else {
            return Ok(());
        };
        process_data::set_up(port, slave, watchdog_ms)
            .await
            .map_err(at(Step::ProcessData))?;
        let device = slave.device.filter(|_| !slave.is_terminal);
        let device = device.map(F::describe).unwrap_or_default();
        if device.assign_activate != 0 && self.clocks.has_clock(usize::from(position)) {
            let stations = self.stations();
            let signals = SyncSignals {
                assign_activate: device.assign_activate,
                sync1_ns: device.sync1_ns,
                shift_ns: u32::from(self.setup.sync_shift_us) * 1_000,
            };
            let there = self.answering();
            let answers = |place: usize| there.get(place).is_some_and(|there| *there);
            let Self { port, clocks, .. } = self;
            clock::start_sync(port, &stations, position.into(), clocks, signals, answers)
                .await
                .map_err(at(Step::Clocks))?;
        }
        information::give_to_slave(&mut self.port, station).await;
        self.change_state(number, AlState::SafeOperational, Step::SafeOperational)
            .await
    }

    /// Finds the process data of a slave that exchanges its own, and the values in them that the application wants.
    async fn find_own_data(&mut self, number: usize) -> Result<(), BusError> {
        let Self {
            port,
            slaves,
            setup,
            values,
            exchanged,
            ..
        } = self;
        let Some(slave) = slaves.get_mut(number) else {
            return Ok(());
        };
        let place = slave.position as u8;
        let here = |wanted: &WantedValue| wanted.slave == place;
        for (wanted, value) in setup.values.iter().zip(values.iter_mut()) {
            if here(wanted) {
                *value = wanted.first();
            }
        }
        let station = slave.station();
        let has_objects = slave.fixed.protocols & PROTOCOL_COE != 0 && slave.fixed.mailbox_out.length > 0;
        if has_objects {
            own_data::choose(port, &mut slave.mailbox, place, setup.chosen).await?;
        }
        let mailbox = has_objects.then_some(&mut slave.mailbox);
        let data = own_data::find(port, station, mailbox, |direction, bit, entry| {
            let is_wanted = |wanted: &WantedValue| {
                (wanted.slave, wanted.direction) == (place, direction)
                    && (wanted.object(), wanted.bits) == (entry.object, entry.bits)
            };
            for (wanted, value) in setup.values.iter().zip(values.iter_mut()) {
                if is_wanted(wanted) && *value == ValueBit::MISSING {
                    *value = ValueBit::at(bit);
                }
            }
        });
        let data = data.await?;
        if let Some((first, second)) = shared_output(&setup.values, values, place) {
            // Neither of them may set the output.
            slave.data = SlaveData::Unknown;
            return Err(BusError::SharedOutput { first, second });
        }
        if slave.is_terminal {
            let had_some = exchanged.contains(number);
            if let Some(error) = other_length(slave.data.own().copied().filter(|_| had_some), &data, had_some) {
                slave.data = SlaveData::Unknown;
                return Err(error);
            }
            if data != OwnData::default() {
                *exchanged |= SlaveSet::of(number);
            }
        }
        slave.data = SlaveData::Own(data);
        Ok(())
    }

    /// Whether values of a terminal are wanted in which no process data were found: its memory may have been damaged when it was
    /// read. Its data are forgotten then.
    pub(super) fn reads_again(&mut self, number: usize) -> bool {
        let is_wanted = self
            .setup
            .values
            .iter()
            .any(|wanted| usize::from(wanted.slave) == number);
        let slave = self.slaves.get_mut(number).filter(|slave| slave.is_terminal);
        let empty = slave.filter(|slave| is_wanted && slave.data == SlaveData::Own(OwnData::default()));
        empty.is_some_and(|slave| core::mem::take(&mut slave.data).is_known())
    }

    /// Takes a slave in use from SAFEOP to OP, once its inputs arrive and outputs have been sent for a while. The plan
    /// with its process data has to be in force.
    pub(super) async fn reach_operational(&mut self, number: usize) -> Result<(), Failure> {
        let Some(slave) = self.slaves.get(number).copied().filter(|slave| slave.is_used()) else {
            return Ok(());
        };
        let at = |step| Failure::of(slave.position, step);
        let result = self.await_inputs(&slave).await;
        result.map_err(at(Step::CyclicData))?;
        // The clock that is distributed is compared with none, and that of a terminal which could not be set follows no time.
        let is_set = slave.member.is_some() || self.clocks.is_set(usize::from(slave.position));
        if is_set && self.clocks.has_clock(usize::from(slave.position)) && self.distributor() != Some(number) {
            let result = clock::await_agreement(&mut self.port, slave.station(), self.setup.settling).await;
            result.map_err(at(Step::Clocks))?;
        }
        self.asked_for_operation = true;
        self.change_state(number, AlState::Operational, Step::Operational)
            .await?;
        self.confirm(number).await.map_err(at(Step::Objects))?;
        if let Some(slave) = self.slaves.get_mut(number) {
            slave.condition = Condition::Operational;
            slave.report = AlReport {
                status: AlState::Operational as u8,
                code: 0,
            };
        }
        Ok(())
    }

    /// Has the driver of a member in OP check what could not be checked before.
    async fn confirm(&mut self, number: usize) -> Result<(), BusError> {
        let Self {
            port, slaves, setup, ..
        } = self;
        let Some(slave) = slaves.get_mut(number) else {
            return Ok(());
        };
        let (Some(data), Some(device), Some(member)) = (slave.data.of_driver().copied(), slave.device, slave.member)
        else {
            return Ok(());
        };
        let station = slave.station();
        let mut there = PreOperational::new(port, station, &mut slave.mailbox, setup.cycle_ns, Some(data.windows));
        F::confirm(&setup.settings, device, member, &mut there, &data).await
    }

    /// Waits until a slave answers at its logical addresses and outputs have been sent for a while.
    pub(super) async fn await_inputs(&mut self, slave: &Slave<F>) -> Result<(), BusError> {
        let share = process_data::cyclic_slave(slave);
        if share.output_length == 0 && share.input_length == 0 {
            return Ok(());
        }
        let started_ms = self.port.now_ms();
        let request = Request::read(
            Command::Lrd,
            Address::logical(share.input_address),
            share.input_length.into(),
        );
        self.port.wait_ms(OUTPUTS_BEFORE_OPERATIONAL_MS).await;
        loop {
            let (_, answers) = self.port.answered(&request).await?;
            if answers > 0 || share.input_length == 0 {
                return Ok(());
            }
            let waited_ms = self.port.now_ms().wrapping_sub(started_ms);
            if waited_ms > INPUTS_TIMEOUT_MS {
                return Err(BusError::NoInputs { waited_ms });
            }
        }
    }

    /// Takes all slaves in use out of OP: safe outputs, then SAFEOP, PREOP and INIT. A slave that does not follow is
    /// left to its watchdog; one whose file is being transferred stays in BOOT.
    pub(super) async fn shut_down(&mut self) {
        let transferring = self.transferring().await;
        if transferring.is_none() {
            self.forget_file();
        }
        self.send_safe_plan().await;
        self.port.wait_ms(SAFE_OUTPUTS_MS).await;
        self.read_reports().await;
        for target in [AlState::SafeOperational, AlState::PreOperational, AlState::Init] {
            for number in 0..self.slaves.len() {
                let Some(slave) = self.slaves.get_mut(number) else {
                    continue;
                };
                let is_lost = slave.condition == Condition::Lost;
                // A slave that is there and whose state could not be read may be in any.
                let state = slave.report.state();
                let above = state.map_or(!is_lost, |state| state as u8 > target as u8);
                if !slave.is_used() || !above || transferring == Some(number) {
                    continue;
                }
                if state::change(&mut self.port, slave.station(), target).await.is_ok() {
                    slave.report = AlReport {
                        status: target as u8,
                        code: 0,
                    };
                }
            }
        }
        for slave in &mut self.slaves {
            (slave.member, slave.is_terminal) = (None, false);
            slave.data = SlaveData::Unknown;
            slave.condition = match slave.condition {
                Condition::Lost => Condition::Lost,
                _ => Condition::Unused,
            };
        }
        self.asked_for_operation = false;
        self.send_plan().await;
    }
}

/// Why what was found of a terminal's process data is not what the terminal had `before`, if that is known, or is nothing
/// though it had some: the memory that describes them was not read as it is.
fn other_length(before: Option<OwnData>, found: &OwnData, had_some: bool) -> Option<BusError> {
    let lengths = |direction| (before.map(|before| before.length(direction)), found.length(direction));
    let mut directions = [Direction::Outputs, Direction::Inputs].into_iter().map(lengths);
    let differs = |(before, found): &(Option<u16>, u16)| before.is_some_and(|before| before != *found);
    match directions.find(differs) {
        Some((before, actual)) => Some(BusError::ProcessLength {
            expected: before.unwrap_or(0),
            actual,
        }),
        None if had_some && *found == OwnData::default() => Some(BusError::ProcessLength { expected: 1, actual: 0 }),
        None => None,
    }
}

/// The first two wanted values that share a bit of the outputs of the slave at a place; `bits` tells where each begins.
fn shared_output(wanted: &[WantedValue], bits: &[ValueBit], place: u8) -> Option<(u8, u8)> {
    let outputs = || {
        (0_u8..)
            .zip(wanted.iter().zip(bits))
            .filter_map(|(number, (wanted, bit))| {
                let first = u32::from(bit.bit()?);
                let is_here = (wanted.slave, wanted.direction) == (place, Direction::Outputs);
                is_here.then_some((number, first..first + u32::from(wanted.bits)))
            })
    };
    outputs().find_map(|(second, bits)| {
        let mut before = outputs().take_while(|(first, _)| *first < second);
        let shares = before.find(|(_, other)| other.start < bits.end && bits.start < other.end);
        shares.map(|(first, _)| (first, second))
    })
}
