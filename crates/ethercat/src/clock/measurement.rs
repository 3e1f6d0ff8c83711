//! The measurement of a chain: the times at which one frame passed every slave, and the delays that follow from them.

use super::super::acyclic::{AcyclicPort, Request};
use super::super::configure::discovery;
use super::super::error::BusError;
use super::super::slave_set::SlaveSet;
use super::super::wire::register::{self, DlStatus};
use super::super::wire::{Address, Command, read_u16, read_u32, read_u64};
use super::delay::{PortTimes, propagation_delays_ns};
use super::{BusClocks, SlaveClock, Width};
use heapless::Vec;

/// Bytes of the ports' receive times.
const PORT_TIMES_LEN: usize = 16;
/// Bytes from the first port's receive time to the end of the processing unit's.
const TIMES_LEN: usize = (register::DC_RECEIVE_TIME_UNIT - register::DC_RECEIVE_TIME) as usize + 8;

/// What a measurement may expect of a slave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presence {
    /// It is lost: nobody waits for it.
    Lost,
    /// It answers, and nobody needs its clock.
    Unused,
    /// It answers, and its clock is needed.
    Used,
}

/// How often a measurement is tried in which not all slaves have latched the same frame: cables are being plugged.
const TRIES_MAX: u8 = 3;

/// Makes all slaves latch the times of one frame, and computes the delays. Slaves that do not answer keep theirs, and so do
/// those that nobody uses and that have latched another frame each time.
///
/// # Errors
/// [`BusError::WorkingCounter`] if slaves that are used have latched different frames each time, or the chain has changed; as [`AcyclicPort::send_until_counted`].
pub async fn measure<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: &[u16],
    clocks: &mut BusClocks<SLAVES>,
    presence: impl Fn(usize) -> Presence,
) -> Result<(), BusError> {
    // Until the delays are taken, whatever ends this before.
    clocks.are_due = true;
    for attempt in 1..=TRIES_MAX {
        match latch(port, stations, clocks, &presence, attempt == TRIES_MAX).await {
            Err(BusError::WorkingCounter { .. }) if attempt < TRIES_MAX => {}
            latched => {
                latched?;
                break;
            }
        }
    }
    let is_junction = |slave: &SlaveClock| slave.ports.has_clock && slave.ports.open.count_ones() > 2;
    let has_junction = clocks.slaves.iter().any(|slave| slave.measured && is_junction(slave));
    // What was not measured may be a junction.
    let mut ordered = clocks.slaves.iter().enumerate().take(clocks.ordered.into());
    let has_unknown = ordered.any(|(position, slave)| presence(position) == Presence::Unused && !slave.measured);
    let has_junction = has_junction || has_unknown;
    let chain = match has_junction || clocks.are_moved {
        true => look_through(port, stations, clocks).await,
        false => Ok(Some(expected_chain(clocks))),
    };
    match chain {
        Ok(Some(chain)) => {
            put_in_order(clocks, &chain);
            take_delays(clocks, &chain);
            // One that was not among them may stand anywhere when it is back.
            let mut ordered = clocks.slaves.iter().enumerate().take(clocks.ordered.into());
            clocks.are_moved = ordered.any(|(position, slave)| presence(position) != Presence::Lost && !slave.measured);
        }
        Ok(None) if has_junction || clocks.are_moved => {} // The delays stay as they were measured before.
        Ok(None) => take_delays(clocks, &expected_chain(clocks)),
        // A slave has gone meanwhile, or returned.
        Err(BusError::WorkingCounter { .. }) => return Ok(()),
        Err(error) => return Err(error),
    }
    clocks.are_due = false;
    Ok(())
}

/// Makes all slaves latch the times of one frame, and reads them. If only slaves without a clock have not latched them at the
/// last try, they count as parts of their cables from then on: their features promise more than they do. One with a clock that
/// nobody uses is not measured, and no longer counts as one with the time of the bus.
async fn latch<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: &[u16],
    clocks: &mut BusClocks<SLAVES>,
    presence: impl Fn(usize) -> Presence,
    is_last: bool,
) -> Result<(), BusError> {
    // A reply comes within its cycle, so times that are further apart are those of different frames.
    let apart_max_ns = clocks.period_ns;
    let there = discovery::count(port).await?;
    let latched = port.broadcast_write(register::DC_RECEIVE_TIME, &[0; 4]).await?;
    let (mut expected, mut is_whole, mut idle) = (0, true, SlaveSet::NONE);
    // Nobody knows where in the chain an extra slave is.
    let ordered = clocks.slaves.iter_mut().take(clocks.ordered.into());
    for (position, (station, slave)) in stations.iter().zip(ordered).enumerate() {
        if presence(position) == Presence::Lost {
            slave.measured = false;
            continue;
        }
        let before = slave.ports;
        slave.measured = match read_times(port, *station, slave).await {
            // Another slave is lost; the frames bypass it.
            Err(BusError::WorkingCounter { actual: 0, .. }) => false,
            read => read.map(|()| true)?,
        };
        if !slave.measured || !slave.ports.has_clock {
            continue;
        }
        let is_short = apart_max_ns == 0 || slave.ports.span_ns() < apart_max_ns;
        match slave.ports.is_later_than(&before) && is_short {
            false if slave.width.is_none() && is_last => idle |= SlaveSet::of(position),
            // Another slave distributes its time then.
            false if presence(position) == Presence::Unused && is_last => {
                (slave.measured, slave.is_set) = (false, false);
            }
            has_latched => {
                is_whole &= has_latched;
                expected += 1;
            }
        }
    }
    // A port that was open as the frame passed may be closed now, and behind it are fewer slaves. A contact that opens and closes
    // meanwhile is not seen.
    is_whole &= discovery::count(port).await? == there;
    match is_whole && latched >= expected {
        true => {
            let slaves = clocks.slaves.iter_mut().enumerate();
            let idle = slaves.filter(|(position, _)| idle.contains(*position));
            idle.for_each(|(_, slave)| slave.ports.has_clock = false);
            Ok(())
        }
        false => Err(BusError::WorkingCounter {
            expected,
            actual: latched,
        }),
    }
}

/// What is at one place of the chain.
#[derive(Clone, Copy)]
enum Place {
    /// A slave that was measured, by its number.
    Measured(u8),
    /// A slave that has no place in the bus's order, or was not measured: its open ports.
    Stranger(u8),
}

/// The slaves in the order in which the frames pass them.
type Chain<const SLAVES: usize> = Vec<Place, SLAVES>;

/// The slaves that were measured, in the order in which they were last seen.
fn expected_chain<const SLAVES: usize>(clocks: &BusClocks<SLAVES>) -> Chain<SLAVES> {
    let at = |place: u8| {
        (0..)
            .zip(&clocks.slaves)
            .find(|(_, slave)| slave.measured && slave.place == place)
    };
    let measured = (0..SLAVES as u8).filter_map(at);
    measured.map(|(number, _)| Place::Measured(number)).collect()
}

/// Notes in which order the slaves of a chain stand. Those that are not there keep their places.
fn put_in_order<const SLAVES: usize>(clocks: &mut BusClocks<SLAVES>, chain: &Chain<SLAVES>) {
    let numbers = || {
        let places = chain.iter();
        places.filter_map(|place| match place {
            Place::Measured(number) => Some(usize::from(*number)),
            Place::Stranger(_) => None,
        })
    };
    let has = |number: usize, place: u8| clocks.slaves.get(number).is_some_and(|slave| slave.place == place);
    // In order, without a sorting function: those call themselves, and the stack has to be bounded.
    let places: Vec<u8, SLAVES> = (0..SLAVES as u8)
        .filter(|place| numbers().any(|number| has(number, *place)))
        .collect();
    for (number, place) in numbers().zip(places) {
        if let Some(slave) = clocks.slaves.get_mut(number) {
            slave.place = place;
        }
    }
}

/// Computes the delays of the slaves that were measured. Strangers are parts of their cables: at a junction they decide in which
/// branch the others are.
fn take_delays<const SLAVES: usize>(clocks: &mut BusClocks<SLAVES>, chain: &Chain<SLAVES>) {
    let ports: Vec<PortTimes, SLAVES> = chain
        .iter()
        .map(|place| match place {
            Place::Measured(number) => clocks.slaves.get(usize::from(*number)).map(|slave| slave.ports),
            Place::Stranger(open) => Some(PortTimes {
                open: *open,
                ..PortTimes::default()
            }),
        })
        .map(Option::unwrap_or_default)
        .collect();
    for (place, delay_ns) in chain.iter().zip(propagation_delays_ns::<SLAVES>(&ports)) {
        if let Place::Measured(number) = place
            && let Some(slave) = clocks.slaves.get_mut(usize::from(*number))
        {
            slave.delay_ns = delay_ns;
        }
    }
}

/// Looks which slaves the frames pass, and in which order. One that was measured and is not among them counts as not measured.
/// `None` if there are more than there is room for.
///
/// # Errors
/// As [`AcyclicPort::send_until_counted`].
async fn look_through<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: &[u16],
    clocks: &mut BusClocks<SLAVES>,
) -> Result<Option<Chain<SLAVES>>, BusError> {
    let found = discovery::count(port).await?;
    if usize::from(found) > SLAVES {
        return Ok(None);
    }
    let mut places = Vec::<u16, SLAVES>::new();
    discovery::stations(port, found, &mut places).await?;
    let measured = || {
        let slaves = (0_u8..).zip(clocks.slaves.iter().zip(stations));
        slaves.filter(|(_, (slave, _))| slave.measured)
    };
    let mut chain = Chain::new();
    for (place, station) in (0..).zip(&places) {
        let number = measured().find(|(_, (_, known))| *known == station);
        let there = match number {
            Some((number, _)) => Place::Measured(number),
            None => {
                let address = Address::position(place, register::DL_STATUS);
                let request = Request::read(Command::Aprd, address, 2);
                let status = port.send_until_counted(&request, 1).await?;
                Place::Stranger(open_ports(read_u16(&status, 0)))
            }
        };
        // There are at most as many as slaves.
        let _ = chain.push(there);
    }
    let still_there = discovery::count(port).await?;
    let is_twice = |number: u8| {
        let is_it = |place: &&Place| matches!(place, Place::Measured(there) if *there == number);
        chain.iter().filter(is_it).count() > 1
    };
    if still_there != found || (0..clocks.slaves.len() as u8).any(is_twice) {
        // The chain has changed meanwhile: slaves may stand elsewhere than they were seen.
        return Err(BusError::WorkingCounter {
            expected: found,
            actual: still_there,
        });
    }
    for (number, slave) in (0_u8..).zip(&mut clocks.slaves) {
        let is_it = |place: &Place| matches!(place, Place::Measured(there) if *there == number);
        slave.measured &= chain.iter().any(is_it);
    }
    Ok(Some(chain))
}

/// Reads a slave's open ports and the times that it has latched.
async fn read_times<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    slave: &mut SlaveClock,
) -> Result<(), BusError> {
    let status = port.read_u16(station, register::DL_STATUS).await?;
    slave.ports = PortTimes {
        has_clock: slave.ports.has_clock,
        open: open_ports(status),
        ..PortTimes::default()
    };
    if !slave.ports.has_clock {
        return Ok(());
    }
    let length = if slave.width.is_some() {
        TIMES_LEN
    } else {
        PORT_TIMES_LEN
    };
    let times = port.read(station, register::DC_RECEIVE_TIME, length).await?;
    slave.ports.received_ns = core::array::from_fn(|number| read_u32(&times, 4 * number));
    let local_ns = read_u64(&times, TIMES_LEN - 8);
    slave.local_ns = match slave.width {
        Some(Width::Bits64) => local_ns,
        _ => local_ns & u64::from(u32::MAX),
    };
    Ok(())
}

/// The open ports as bits, from the data-link status.
fn open_ports(status: u16) -> u8 {
    let ports = DlStatus::from_bits(status).ports;
    (0..)
        .zip(ports)
        .fold(0, |open, (number, port)| open | u8::from(port.is_open()) << number)
}
