//! Distributed clocks: one time for all slaves, and a sample that keeps its phase to that time.
//!
//! The first slave with a clock is the reference: its time since power-up is the system time of the bus. Every other
//! clock gets an offset and the delay of the cables before it, so that all clocks agree at once. From then on a
//! datagram (FRMW of the system time) carries the reference's time to all others in every cycle, and each slave's own
//! control loop follows it. [`delay`] computes the delays, [`steering`] keeps the sample's timer in phase. Registers
//! and their order: IEC 61158-4-12 (distributed clocks) and the slave controllers' public data sheets.
//!
//! SYNC0 starts a configured time after the present phase of the frames at the reference, so nothing has to jump when
//! it starts. A clock of 32 bits wraps after 4.29 s, which is no whole number of periods: phases are those of the
//! reference's time in 64 bits, which the master continues from the lower 32.
//!
//! Only a read of the system time tells who has a clock: some terminals latch the times of a frame, and say in their
//! features that they have clocks, but have none.
//!
//! Invariants: every step is bounded in frames; a slave without a clock is left alone; a slave that returns takes the
//! time of the others and does not change theirs; only a clock that has the time of the bus distributes it.

mod agreement;
pub mod delay;
mod measurement;
pub mod steering;
mod sync_signals;
mod time;

use super::acyclic::{AcyclicPort, Request};
use super::error::BusError;
use super::plan::ReferenceClock;
use super::slave_set::SlaveSet;
use super::wire::register;
use super::wire::{Address, Command, read_u16, read_u64};
pub use agreement::{DIFFERENCE_MAX_NS, DIFFERENCE_TIMEOUT_MS, Settling, await_agreement, difference_ns};
use delay::PortTimes;
use heapless::Vec;
pub use measurement::{Presence, measure};
pub use sync_signals::{SyncSignals, start_sync, stop_sync};
pub use time::{find_source, follow};

/// Frames that distribute the reference's time before the clocks are used (static drift compensation).
pub const SETTLING_FRAMES: u16 = 32;
/// Time from the activation of SYNC0 to its first pulse, ns: many cycles, so that lost frames do not matter.
const START_AHEAD_NS: u64 = 100_000_000;
/// Difference from the delay that a slave was told from which on it is told anew, ns: measurements differ by less.
const DELAY_CHANGE_MIN_NS: u32 = 20;
/// Delay of a slave that may be another one than was told.
const NOT_TOLD: u32 = u32::MAX;
/// Width of a slave's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Width {
    /// Wraps after 4.3 s.
    #[default]
    Bits32,
    /// Does not wrap.
    Bits64,
}

/// The clock of one slave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlaveClock {
    /// Width of its time; `None` if it has no clock.
    pub width: Option<Width>,
    /// Its place among the slaves whose order is known, as the frames pass them. Cables that were plugged in elsewhere change it.
    pub place: u8,
    /// Whether its clock has the time of the bus since it was last switched on.
    pub is_set: bool,
    /// Port times latched by the last measurement, and whether it latches any; every slave with a clock does.
    pub ports: PortTimes,
    /// The slave's own time when the frame of the measurement passed its processing unit, ns.
    pub local_ns: u64,
    /// System time minus the slave's own time, ns, wrapping.
    pub offset_ns: u64,
    /// Delay of a frame from the first slave of the last measurement to this slave, ns.
    pub delay_ns: u32,
    /// Delay that the slave was told: from the slave that distributes its time, ns.
    pub told_delay_ns: u32,
    /// Whether the slave took part in the last measurement, and the chain is still as it was then.
    pub measured: bool,
}

/// The clocks of a bus, in the order of the slaves' numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BusClocks<const SLAVES: usize> {
    /// One entry for each slave.
    pub slaves: Vec<SlaveClock, SLAVES>,
    /// Period of the cyclic exchange, ns.
    pub period_ns: u32,
    /// Phase of the frames at the reference, ns within the period.
    pub phase_ns: u32,
    /// Slaves whose clocks had the time of the bus and have run alone since, while that of others went on.
    astray: SlaveSet,
    /// Slaves that have not answered when they were asked for their clocks. They may have one, to which the time is written too.
    unknown: SlaveSet,
    /// Number of the slave that distributed its time when the delays were last told.
    told_by: Option<u8>,
    /// Whether clocks before the reference are being set: it only shows its time meanwhile.
    is_held: bool,
    /// Number of slaves whose place in the chain is known. Those behind them are extra ones, wherever they are: the time is
    /// written to their clocks too, which are counted for that, and nothing else.
    ordered: u8,
    /// Whether the delays could not be computed from the last measurement.
    are_due: bool,
    /// Whether slaves may stand elsewhere than the places say.
    are_moved: bool,
    /// Whether a clock of 32 bits was replaced: it may have told the others a time without an upper half.
    was_narrow: bool,
    /// Number of the time, see [`ReferenceClock::time_number`].
    time_number: u8,
    /// The reference's time in 64 bits when it was last read, ns; `None` before.
    time_ns: Option<u64>,
    /// The master's time then, ms.
    read_ms: u32,
}

impl<const SLAVES: usize> BusClocks<SLAVES> {
    /// Number of the first slave of the chain that has a clock.
    pub fn reference(&self) -> Option<usize> {
        self.first(|_, slave| slave.width.is_some())
    }

    /// Number of the slave that distributes its time: the first of the chain that answers and has the time of the bus.
    /// FRMW writes a time that was expected a cycle before to clocks before that slave, so it has to be the first.
    fn distributor(&self, answers: impl Fn(usize) -> bool) -> Option<usize> {
        self.first(|number, slave| slave.width.is_some() && slave.is_set && answers(number))
    }

    /// Whether frames pass one slave before the other.
    pub fn is_before(&self, one: usize, other: usize) -> bool {
        let place = |number: usize| self.slaves.get(number).map(|slave| slave.place);
        place(one) < place(other)
    }

    /// Number of the first slave of the chain that is wanted.
    fn first(&self, is_wanted: impl Fn(usize, &SlaveClock) -> bool) -> Option<usize> {
        let wanted = self
            .slaves
            .iter()
            .enumerate()
            .filter(|(number, slave)| is_wanted(*number, slave));
        wanted.min_by_key(|(_, slave)| slave.place).map(|(number, _)| number)
    }

    /// Delay of a frame from the slave at `source` to the one at `position`, ns; 0 if the frame passes that one first.
    fn delay_from_ns(&self, source: Option<usize>, position: usize) -> u32 {
        let delay_ns = |position| self.slaves.get(position).map_or(0, |slave: &SlaveClock| slave.delay_ns);
        delay_ns(position).saturating_sub(source.map_or(0, delay_ns))
    }

    /// Reference clock for the critical side, which distributes its time. `stations` are the station addresses;
    /// `answers` returns false for slaves that are lost. `None` if no clock has the time of the bus.
    pub fn reference_clock(&self, stations: &[u16], answers: impl Fn(usize) -> bool) -> Option<ReferenceClock> {
        let station = *stations.get(self.distributor(&answers)?)?;
        let present = self
            .slaves
            .iter()
            .enumerate()
            .filter(|(position, _)| answers(*position));
        let slaves = present.filter(|(_, slave)| slave.width.is_some()).count() as u16;
        // A clock of 32 bits that is lost may have told the others a time without an upper half.
        let is_narrow = |slave: &SlaveClock| slave.width == Some(Width::Bits32);
        let wide = !self.was_narrow && !self.slaves.iter().any(is_narrow);
        Some(ReferenceClock {
            station,
            slaves: if self.is_held { 1 } else { slaves },
            wide,
            is_spread: !self.is_held,
            time_number: self.time_number,
            period: ReferenceClock::period_of_ns(self.period_ns),
        })
    }

    /// Whether the reference's time is only read, and not written to the other clocks.
    pub fn hold(&mut self, is_held: bool) {
        self.is_held = is_held;
    }

    /// Whether a slave has no clock, or one with the time of the bus.
    pub fn is_set(&self, position: usize) -> bool {
        let clock = self.slaves.get(position).filter(|_| self.has_clock(position));
        clock.is_none_or(|slave| slave.is_set)
    }

    /// Notes that a slave was switched off: its clock no longer has the time of the bus.
    pub fn was_off(&mut self, position: usize) {
        if let Some(slave) = self.slaves.get_mut(position) {
            (slave.is_set, slave.told_delay_ns) = (false, NOT_TOLD);
        }
        self.astray = self.astray.without(SlaveSet::of(position));
    }

    /// Notes that the time of the others has gone on without a slave: if they lose it, that of this one may still be the time of
    /// the bus, see [`find_source`].
    pub fn was_alone(&mut self, position: usize) {
        if let Some(slave) = self.slaves.get_mut(position) {
            if slave.is_set {
                self.astray |= SlaveSet::of(position);
            }
            (slave.is_set, slave.told_delay_ns) = (false, NOT_TOLD);
        }
    }

    /// Notes that a slave has dropped out of the chain or returned: the cables of the others may have changed.
    pub fn chain_changed(&mut self) {
        self.are_moved = true;
        for slave in &mut self.slaves {
            slave.measured = false;
        }
    }

    /// Notes that a slave's clock has been seen to have the time of the bus.
    pub fn found_in_time(&mut self, position: usize) {
        if let Some(slave) = self.slaves.get_mut(position) {
            slave.is_set = true;
        }
        self.astray = self.astray.without(SlaveSet::of(position));
    }

    /// Whether the slave at this place has a clock that is used: no extra slave has.
    pub fn has_clock(&self, position: usize) -> bool {
        let is_ordered = position < usize::from(self.ordered);
        is_ordered && self.slaves.get(position).is_some_and(|slave| slave.width.is_some())
    }

    /// Notes what was found at a slave's place: another slave with another clock, or with none, may have taken it.
    pub fn replace(&mut self, position: usize, found: &SlaveClock) {
        let slave = self.slaves.get_mut(position);
        self.unknown = self.unknown.without(SlaveSet::of(position));
        let kind = |slave: &SlaveClock| (slave.width, slave.ports.has_clock);
        if let Some(slave) = slave.filter(|slave| kind(slave) != kind(found)) {
            self.was_narrow |= slave.width == Some(Width::Bits32);
            self.astray = self.astray.without(SlaveSet::of(position));
            *slave = SlaveClock {
                place: slave.place,
                told_delay_ns: NOT_TOLD,
                ..*found
            };
        }
    }

    /// Number of the next slave behind `last`, round and round, that has not answered when it was asked for its clock, and is asked
    /// again.
    pub fn unknown(&self, last: usize, is_asked: impl Fn(usize) -> bool) -> Option<usize> {
        let unknown = |number: &usize| self.is_unknown(*number) && is_asked(*number);
        let behind = (last + 1..self.slaves.len()).find(unknown);
        behind.or_else(|| (0..=last).find(unknown))
    }

    /// Whether a slave has not answered when it was asked for its clock.
    pub fn is_unknown(&self, position: usize) -> bool {
        position < self.slaves.len() && self.unknown.contains(position)
    }

    /// Notes that a slave has to be asked for its clock again, unless it has the time of the bus.
    pub fn forget(&mut self, position: usize) {
        if self.slaves.get(position).is_some_and(|slave| !slave.is_set) {
            self.unknown |= SlaveSet::of(position);
        }
    }

    /// Adds an extra slave behind all others; `None` if it did not answer. Does nothing unless `position` is the next place.
    pub fn add_extra(&mut self, position: usize, found: Option<SlaveClock>) {
        if self.slaves.len() == position {
            if found.is_none() {
                self.unknown |= SlaveSet::of(position);
            }
            let place = position as u8;
            let found = found.unwrap_or_default();
            // There is an entry for each slave of the bus.
            let _ = self.slaves.push(SlaveClock { place, ..found });
        }
    }

    /// The slave whose time one that is set takes over: the first of the chain that has the time of the bus.
    fn source_for(&self, position: usize) -> Option<usize> {
        let can_be = |other: usize, slave: &SlaveClock| other != position && slave.width.is_some() && slave.measured;
        self.first(|other, slave| can_be(other, slave) && slave.is_set)
    }

    /// The offset that makes the slave at `position` agree with `source`, both measured by one frame.
    fn offset_ns(&self, position: usize, source: usize) -> Option<u64> {
        let (slave, source) = (self.slaves.get(position)?, self.slaves.get(source)?);
        let system_ns = source.local_ns.wrapping_add(source.offset_ns);
        let later_ns = u64::from(slave.delay_ns).wrapping_sub(u64::from(source.delay_ns));
        Some(system_ns.wrapping_add(later_ns).wrapping_sub(slave.local_ns))
    }

    /// Start time of SYNC0: the first moment at least `START_AHEAD_NS` after `now_ns` that is `shift_ns` after the
    /// phase of the frames.
    pub fn start_time_ns(&self, now_ns: u64, shift_ns: u32) -> u64 {
        let earliest_ns = now_ns.wrapping_add(START_AHEAD_NS);
        let period_ns = u64::from(self.period_ns.max(1));
        let wanted_ns = (u64::from(self.phase_ns) + u64::from(shift_ns)) % period_ns;
        let wait_ns = (wanted_ns + period_ns - earliest_ns % period_ns) % period_ns;
        earliest_ns.wrapping_add(wait_ns)
    }
}

/// Determines which slaves have a clock. `stations` are the station addresses in chain order. A slave that does not answer
/// counts as one without a clock, and so does one for which `is_used` returns false if its answers are wrong.
///
/// # Errors
/// As [`AcyclicPort::answered_by_one`].
pub async fn discover<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: &[u16],
    is_used: impl Fn(usize) -> bool,
) -> Result<BusClocks<SLAVES>, BusError> {
    let mut clocks = BusClocks::<SLAVES>::default();
    for (place, station) in (0..).zip(stations.iter().take(SLAVES)) {
        let found = match read_clock(port, *station).await {
            Err(BusError::WorkingCounter { .. }) if !is_used(place.into()) => None,
            found => found?,
        };
        if found.is_none() {
            clocks.unknown |= SlaveSet::of(place.into());
        }
        let found = found.unwrap_or_default();
        // The loop ends at the capacity.
        let _ = clocks.slaves.push(SlaveClock { place, ..found });
    }
    clocks.ordered = clocks.slaves.len() as u8;
    Ok(clocks)
}

/// What clock a slave has; `None` if it does not answer.
///
/// # Errors
/// As [`AcyclicPort::answered_by_one`]: a member that was taken for one without a clock would run beside the others' time.
pub async fn read_clock<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
) -> Result<Option<SlaveClock>, BusError> {
    let read = |register, length| Request::read(Command::Fprd, Address::station(station, register), length);
    let Some(bytes) = port.answered_by_one(&read(register::FEATURES, 2)).await? else {
        return Ok(None);
    };
    let features = read_u16(&bytes, 0);
    let latches = features & register::FEATURE_CLOCKS != 0;
    let has_time = latches
        && port
            .answered_by_one(&read(register::DC_SYSTEM_TIME, 4))
            .await?
            .is_some();
    let width = match features & register::FEATURE_CLOCKS_64 {
        _ if !has_time => None,
        0 => Some(Width::Bits32),
        _ => Some(Width::Bits64),
    };
    let ports = PortTimes {
        has_clock: latches,
        ..PortTimes::default()
    };
    Ok(Some(SlaveClock {
        width,
        ports,
        ..SlaveClock::default()
    }))
}

/// Makes all clocks agree: measures, writes offsets and delays, and distributes the reference's time until the control
/// loops start to follow. Does nothing on a bus without clocks. `time_number` is that of the time which begins. If `is_used`
/// returns false for a slave, its clock counts as none if it cannot be set, and is left alone if it cannot be measured.
///
/// # Errors
/// As [`AcyclicPort::send_until_counted`].
pub async fn set_up<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: &[u16],
    period_ns: u32,
    time_number: u8,
    is_used: impl Fn(usize) -> bool,
) -> Result<BusClocks<SLAVES>, BusError> {
    let mut clocks: BusClocks<SLAVES> = discover(port, stations, &is_used).await?;
    (clocks.period_ns, clocks.time_number) = (period_ns, time_number);
    while let Some(first) = clocks.reference() {
        let presence = |position: usize| match is_used(position) {
            true => Presence::Used,
            false => Presence::Unused,
        };
        measure(port, stations, &mut clocks, presence).await?;
        let measured = clocks.first(|_, slave| slave.width.is_some() && slave.measured);
        let reference = measured.unwrap_or(first);
        clocks.told_by = Some(reference as u8);
        if set_all(port, stations, &mut clocks, reference, &is_used).await? {
            settle(port, stations, &mut clocks).await?;
            break;
        }
    }
    Ok(clocks)
}

/// Sets all clocks to the time of the reference. If `is_used` returns false for a slave, its clock is left alone if it was not
/// measured, and counts as none if it cannot be set; returns false if that is the reference.
async fn set_all<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: &[u16],
    clocks: &mut BusClocks<SLAVES>,
    reference: usize,
    is_used: impl Fn(usize) -> bool,
) -> Result<bool, BusError> {
    for (position, station) in stations.iter().enumerate() {
        let is_measured = clocks.slaves.get(position).is_some_and(|slave| slave.measured);
        if !clocks.has_clock(position) || !is_measured && !is_used(position) {
            continue;
        }
        let offset_ns = match position == reference {
            true => Some(0),
            false => clocks.offset_ns(position, reference),
        };
        let written = write_offset(port, *station, position, clocks, offset_ns.unwrap_or(0)).await;
        match (written, clocks.slaves.get_mut(position)) {
            (Err(_), Some(slave)) if !is_used(position) => {
                slave.width = None;
                if position == reference {
                    return Ok(false);
                }
            }
            (written, _) => written?,
        }
    }
    Ok(true)
}

/// Sets the clock of a slave that was switched off or cut off to the time of the bus. The other slaves keep their time,
/// even if this slave is the reference. If no other clock has the time of the bus, this one continues it: to some milliseconds, with
/// the phase of the frames. What slaves that are lost say on their return is not the time of the bus; the slave itself must not be
/// one of them. If nobody uses it and it cannot be measured, it is left as it is.
///
/// # Errors
/// As [`AcyclicPort::send_until_counted`].
pub async fn restore<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: &[u16],
    clocks: &mut BusClocks<SLAVES>,
    position: usize,
    presence: impl Fn(usize) -> Presence,
) -> Result<(), BusError> {
    let Some(station) = stations.get(position).filter(|_| clocks.has_clock(position)) else {
        return Ok(());
    };
    // Frames that told it a far time have made it up to 10 % faster or slower: the offset would be wrong once it is written.
    restart_loop(port, *station).await?;
    clocks.are_moved = true;
    measure(port, stations, clocks, &presence).await?;
    let is_measured = clocks.slaves.get(position).is_some_and(|slave| slave.measured);
    if !is_measured && presence(position) == Presence::Unused {
        return Ok(());
    }
    let source = clocks.source_for(position);
    if source.is_none() && clocks.is_set(position) {
        return Ok(());
    }
    let slave = clocks.slaves.get(position).copied().unwrap_or_default();
    let continued_ns = || clocks.continued_ns(port.now_ms()).wrapping_add(slave.delay_ns.into());
    let offset_ns = source
        .and_then(|source| clocks.offset_ns(position, source))
        .unwrap_or_else(|| continued_ns().wrapping_sub(slave.local_ns));
    // A SYNC0 that still runs would follow the new time; a controller may have none.
    let _ = stop_sync(port, *station).await;
    write_offset(port, *station, position, clocks, offset_ns).await?;
    let measured: Vec<bool, SLAVES> = clocks.slaves.iter().map(|slave| slave.measured).collect();
    let are_there = |position| match measured.get(position) {
        Some(true) => presence(position),
        _ => Presence::Lost,
    };
    tell_delays(port, stations, clocks, are_there).await
}

/// Tells the clocks their delays from the slave that distributes its time, where they were told others: another slave
/// distributes its time than before, or a cable has changed. A slave that has begun to distribute its time runs freely from
/// then on.
///
/// # Errors
/// As [`AcyclicPort::send_until_counted`]; the delays that were not told are told next time.
pub async fn tell_delays<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: &[u16],
    clocks: &mut BusClocks<SLAVES>,
    presence: impl Fn(usize) -> Presence,
) -> Result<(), BusError> {
    let answers = |position: usize| presence(position) != Presence::Lost;
    let is_there = |position: usize, slave: &SlaveClock| slave.width.is_some() && slave.is_set && answers(position);
    let before = clocks.distributor(answers);
    run_freely(port, stations, clocks, before).await?;
    // Delays of different measurements have different beginnings.
    let mut there = clocks.slaves.iter().enumerate();
    if clocks.are_due || there.any(|(position, slave)| is_there(position, slave) && !slave.measured) {
        measure(port, stations, clocks, &presence).await?;
    }
    let source = clocks.distributor(answers);
    if source != before {
        // The slaves stand in another order. The time of the one before is written to the new one until the plan changes: it
        // begins to run freely behind that.
        clocks.told_by = None;
    }
    for (position, station) in stations.iter().enumerate() {
        let delay_ns = clocks.delay_from_ns(source, position);
        let Some(slave) = clocks.slaves.get_mut(position) else {
            break;
        };
        let is_told = slave.told_delay_ns.abs_diff(delay_ns) < DELAY_CHANGE_MIN_NS;
        // One that has not been set since its return follows the time already.
        let follows = slave.width.is_some() && slave.measured && answers(position);
        if is_told || !follows {
            continue;
        }
        port.write(*station, register::DC_DELAY, &delay_ns.to_le_bytes())
            .await?;
        slave.told_delay_ns = delay_ns;
    }
    Ok(())
}

/// Restarts the control loop of the slave that has begun to distribute its time: it has no reference any more, and would keep
/// its last correction for ever, 10 % if the one before fell silent.
async fn run_freely<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: &[u16],
    clocks: &mut BusClocks<SLAVES>,
    source: Option<usize>,
) -> Result<(), BusError> {
    let teller = source.map(|source| source as u8);
    if let Some(station) = source.and_then(|source| stations.get(source))
        && teller != clocks.told_by
    {
        restart_loop(port, *station).await?;
        clocks.told_by = teller;
    }
    Ok(())
}

/// Writes offset and delay of one slave and clears the filters of its control loop. The delay is that from the slave
/// which distributes its time once this one is set.
async fn write_offset<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    position: usize,
    clocks: &mut BusClocks<SLAVES>,
    offset_ns: u64,
) -> Result<(), BusError> {
    let source = clocks.first(|other, slave| {
        let is_set = slave.is_set && slave.measured;
        slave.width.is_some() && (is_set || other == position)
    });
    let delay_ns = clocks.delay_from_ns(source, position);
    let Some(slave) = clocks.slaves.get_mut(position) else {
        return Ok(());
    };
    slave.offset_ns = offset_ns;
    let length = match slave.width {
        Some(Width::Bits64) => 8,
        _ => 4,
    };
    let offset = offset_ns.to_le_bytes();
    port.write(station, register::DC_OFFSET, offset.get(..length).unwrap_or(&offset))
        .await?;
    port.write(station, register::DC_DELAY, &delay_ns.to_le_bytes()).await?;
    restart_loop(port, station).await?;
    if let Some(slave) = clocks.slaves.get_mut(position) {
        (slave.is_set, slave.told_delay_ns) = (true, delay_ns);
    }
    clocks.astray = clocks.astray.without(SlaveSet::of(position));
    Ok(())
}

/// Clears the filters and the correction of a clock's control loop.
async fn restart_loop<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>, station: u16) -> Result<(), BusError> {
    let start = register::SPEED_START_DEFAULT.to_le_bytes();
    port.write(station, register::DC_SPEED_START, &start).await.map(drop)
}

/// Distributes the reference's time [`SETTLING_FRAMES`] times and takes the mean phase of the frames.
async fn settle<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: &[u16],
    clocks: &mut BusClocks<SLAVES>,
) -> Result<(), BusError> {
    let Some(station) = reference_of(stations, clocks, |_| true) else {
        return Ok(());
    };
    let expected = clocks.slaves.iter().filter(|slave| slave.width.is_some()).count() as u16;
    let address = Address::station(station, register::DC_SYSTEM_TIME);
    let request = Request::read(Command::Frmw, address, 8);
    clocks.time_ns = None;
    let (mut first_ns, mut sum_ns, mut readings) = (None, 0_i64, 0_i64);
    let period_ns = i64::from(clocks.period_ns.max(1));
    for _ in 0..SETTLING_FRAMES {
        let read_ns = read_u64(&port.send_until_counted(&request, expected).await?, 0);
        let time_ns = clocks.extended_ns(read_ns, port.now_ms());
        let phase_ns = (time_ns % period_ns.unsigned_abs()) as i64;
        let first_ns = *first_ns.get_or_insert(phase_ns);
        // Takes the difference by the shorter way round the period.
        sum_ns += (phase_ns - first_ns + period_ns / 2).rem_euclid(period_ns) - period_ns / 2;
        readings += 1;
        let mean_ns = first_ns + sum_ns / readings;
        clocks.phase_ns = mean_ns.rem_euclid(period_ns) as u32;
    }
    Ok(())
}

/// Station address of the clock that distributes its time.
fn reference_of<const SLAVES: usize>(
    stations: &[u16],
    clocks: &BusClocks<SLAVES>,
    answers: impl Fn(usize) -> bool,
) -> Option<u16> {
    stations.get(clocks.distributor(answers)?).copied()
}

#[cfg(test)]
mod tests;
