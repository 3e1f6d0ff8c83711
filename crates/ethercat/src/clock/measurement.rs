//! The measurement of a chain: the times at which one frame passed every slave, and the delays that follow from them.

use super::super::acyclic::{AcyclicPort, Request};
use super::super::configure::discovery;
use super::super::error::BusError;
use super::super::wire::register::{self, DlStatus};
use super::super::wire::{Address, Command, read_u16, read_u32, read_u64};
use super::delay::{PortTimes, propagation_delays_ns};
use super::{BusClocks, SlaveClock, Width};
use heapless::Vec;

/// Bytes of the ports' receive times.
const PORT_TIMES_LEN: usize = 16;
/// Bytes from the first port's receive time to the end of the processing unit's.
const TIMES_LEN: usize = (register::DC_RECEIVE_TIME_UNIT - register::DC_RECEIVE_TIME) as usize + 8;

/// Makes all slaves latch the times of one frame, and computes the delays. Slaves that do not answer keep theirs; `answers`
/// returns false for those that are known to be lost, which are not waited for.
///
/// # Errors
/// As [`AcyclicPort::send_until_counted`].
pub async fn measure<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: &[u16],
    clocks: &mut BusClocks<SLAVES>,
    answers: impl Fn(usize) -> bool,
) -> Result<(), BusError> {
    // Only one latching frame counts: a repeated one would leave slaves with times of different frames.
    port.broadcast_write(register::DC_RECEIVE_TIME, &[0; 4]).await?;
    // Nobody knows where in the chain an extra slave is.
    let ordered = clocks.slaves.iter_mut().take(clocks.ordered.into());
    for (position, (station, slave)) in stations.iter().zip(ordered).enumerate() {
        if !answers(position) {
            slave.measured = false;
            continue;
        }
        slave.measured = match read_times(port, *station, slave).await {
            // Another slave is lost; the frames bypass it.
            Err(BusError::WorkingCounter { actual: 0, .. }) => false,
            read => read.map(|()| true)?,
        };
    }
    let is_junction = |slave: &SlaveClock| slave.latches && slave.ports.open.count_ones() > 2;
    let strangers = match clocks.slaves.iter().any(|slave| slave.measured && is_junction(slave)) {
        true => find_strangers(port, stations, clocks).await,
        false => Ok(Some(Strangers::new())),
    };
    // A stranger has gone meanwhile.
    clocks.are_due = matches!(strangers, Err(BusError::WorkingCounter { .. }));
    let strangers = if clocks.are_due { None } else { strangers? };
    // Else the delays stay as they were measured before.
    if let Some(strangers) = strangers {
        take_delays(clocks, &strangers);
    }
    Ok(())
}

/// Places in the chain, in order, of slaves that have no place in the bus's order, and their open ports.
type Strangers<const SLAVES: usize> = Vec<(u8, u8), SLAVES>;

/// Computes the delays of the slaves that were measured. Strangers are parts of their cables: at a junction they decide in which
/// branch the others are.
fn take_delays<const SLAVES: usize>(clocks: &mut BusClocks<SLAVES>, strangers: &Strangers<SLAVES>) {
    let (mut there, mut ports) = (Vec::<usize, SLAVES>::new(), Vec::<PortTimes, SLAVES>::new());
    for (position, slave) in clocks.slaves.iter().enumerate().filter(|(_, slave)| slave.measured) {
        // There is room for all slaves.
        let _ = (there.push(position), ports.push(slave.ports));
    }
    for (place, open) in strangers {
        let stranger = PortTimes {
            open: *open,
            ..PortTimes::default()
        };
        let place = usize::from(*place);
        // All slaves that were found fit, and each place before this one has its slave.
        let _ = (there.insert(place, usize::MAX), ports.insert(place, stranger));
    }
    for (position, delay_ns) in there.iter().zip(propagation_delays_ns::<SLAVES>(&ports)) {
        if let Some(slave) = clocks.slaves.get_mut(*position) {
            slave.delay_ns = delay_ns;
        }
    }
}

/// Looks through the chain for slaves without a place in the bus's order. `None` if those that were measured are not in their
/// order, or there are more than there is room for.
async fn find_strangers<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: &[u16],
    clocks: &BusClocks<SLAVES>,
) -> Result<Option<Strangers<SLAVES>>, BusError> {
    let known = || {
        let slaves = clocks.slaves.iter().zip(stations);
        slaves.filter(|(slave, _)| slave.measured).map(|(_, station)| *station)
    };
    let (found, mut next) = (discovery::count(port).await?, 0);
    let mut strangers = Strangers::new();
    if usize::from(found) <= known().count() {
        return Ok(Some(strangers));
    }
    if usize::from(found) > SLAVES {
        return Ok(None);
    }
    let mut places = Vec::<u16, SLAVES>::new();
    discovery::stations(port, found, &mut places).await?;
    for (place, station) in (0_u8..).zip(&places) {
        if known().nth(next) == Some(*station) {
            next += 1;
            continue;
        }
        let address = Address::position(place.into(), register::DL_STATUS);
        let status = port
            .send_until_counted(&Request::read(Command::Aprd, address, 2), 1)
            .await?;
        // There are at most as many as slaves.
        let _ = strangers.push((place, open_ports(read_u16(&status, 0))));
    }
    Ok(Some(strangers).filter(|_| next == known().count()))
}

/// Reads a slave's open ports and the times that it has latched.
async fn read_times<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    slave: &mut SlaveClock,
) -> Result<(), BusError> {
    let status = port.read_u16(station, register::DL_STATUS).await?;
    slave.ports = PortTimes {
        has_clock: slave.latches,
        open: open_ports(status),
        ..PortTimes::default()
    };
    if !slave.latches {
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
