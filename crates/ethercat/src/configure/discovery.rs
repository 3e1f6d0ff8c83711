//! Slave discovery: counts the slaves, assigns addresses, and resets them to INIT without any configuration.
//!
//! Positions count from 0 along the chain; a station address is given to a position and stays with the slave until it
//! is switched off. Datagrams for several slaves share frames.
//!
//! Invariant: no function here takes a slave out of INIT, and only [`reset_all`] takes a slave to INIT.

use crate::acyclic::{AcyclicPort, IN_FLIGHT_MAX, Request};
use crate::error::BusError;
use crate::state::{AlState, INIT_TIMEOUT_MS};
use crate::wire::register::{self, FMMU_LEN, FmmuRepr, SYNC_MANAGER_LEN, SyncManagerRepr};
use crate::wire::sii::{FixedPart, MailboxWindow};
use crate::wire::{Address, Command, read_u8, read_u16};
use core::ops::Range;
use heapless::Vec;

/// Station address of the first slave; the others follow in chain order.
pub const STATION_BASE: u16 = 0x1001;
/// Station address of a slave while it is being identified.
pub const STATION_TEMPORARY: u16 = 0x1000;
/// FMMUs, or sync managers, that are cleared together.
const CLEARED: u8 = 4;

/// Lets the ports of all slaves that frames reach open and close by themselves again, and lets no slave answer to its alias:
/// another master may have closed a port in the middle of the chain. Behind a port that opens then may be another one.
///
/// # Errors
/// [`BusError::Lost`].
pub async fn open_ports<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>) -> Result<(), BusError> {
    port.broadcast_write(register::DL_CONTROL_PORTS, &[0]).await?;
    port.broadcast_write(register::DL_CONTROL_ALIAS_BYTE, &[0]).await?;
    Ok(())
}

/// Brings all slaves to INIT without any configuration; resets the error counters.
///
/// A slave that does not reach INIT in time is left as it is; the next step that uses it fails.
///
/// # Errors
/// [`BusError::Lost`].
pub async fn reset_all<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>) -> Result<(), BusError> {
    let init = AlState::Init as u16;
    port.broadcast_write(register::AL_CONTROL, &(init | register::AL_ERROR_BIT).to_le_bytes())
        .await?;
    // A slave with device emulation shows the acknowledge bit until a request without it.
    port.broadcast_write(register::AL_CONTROL, &init.to_le_bytes()).await?;
    let started_ms = port.now_ms();
    loop {
        let (status, _) = port.broadcast_read_u16(register::AL_STATUS).await?;
        let seen = status & (register::AL_STATE_MASK | register::AL_ERROR_BIT);
        if seen == init || port.now_ms().wrapping_sub(started_ms) > INIT_TIMEOUT_MS {
            break;
        }
    }
    port.broadcast_write(register::STATION_ADDRESS, &[0; 2]).await?;
    for first in (0..register::UNITS_MAX).step_by(CLEARED.into()) {
        clear_units(port, first).await?;
    }
    port.broadcast_write(register::DC_CYCLIC_CONTROL, &[0; 2]).await?;
    port.broadcast_write(register::RECEIVE_ERRORS, &[0; register::ERROR_COUNTERS_LEN])
        .await?;
    Ok(())
}

/// Clears some FMMUs and sync managers of all slaves. One by one: a controller may take no write that reaches beyond the last
/// one that it has.
async fn clear_units<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>, first: u8) -> Result<(), BusError> {
    let write = |register, data: &[u8]| Request::write(Command::Bwr, Address::broadcast(register), data);
    let units = (first..first + CLEARED).flat_map(|unit| {
        [
            write(register::fmmu(unit), &[0; FMMU_LEN]),
            write(register::sync_manager(unit), &[0; SYNC_MANAGER_LEN]),
        ]
    });
    let requests: Vec<Request, { 2 * CLEARED as usize }> = units.collect();
    port.send_all_until_answered(&requests).await
}

/// Number of slaves that answer.
///
/// # Errors
/// As [`AcyclicPort::broadcast_read_u16`].
pub async fn count<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>) -> Result<u16, BusError> {
    let (_, slaves) = port.broadcast_read_u16(register::AL_STATUS).await?;
    Ok(slaves)
}

/// Reads the station addresses of the first `count` slaves of the chain; 0 where no slave answers.
///
/// # Errors
/// As [`AcyclicPort::send_all_until_counted`].
pub async fn stations<const MESSAGE: usize, const PLACES: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    count: u16,
    stations: &mut Vec<u16, PLACES>,
) -> Result<(), BusError> {
    stations.clear();
    for first in (0..count).step_by(IN_FLIGHT_MAX) {
        let places = first..count.min(first + IN_FLIGHT_MAX as u16);
        let requests = places.map(|position| {
            let address = Address::position(position, register::STATION_ADDRESS);
            Request::read(Command::Aprd, address, 2)
        });
        let requests: Vec<Request, IN_FLIGHT_MAX> = requests.collect();
        let before = stations.len();
        // Slaves that do not fit are not among the first.
        let _ = stations.resize(before + requests.len(), 0);
        port.send_all_until_counted(&requests, 1, |number, bytes| {
            if let Some(station) = stations.get_mut(before + number) {
                *station = read_u16(bytes, 0);
            }
        })
        .await?;
    }
    Ok(())
}

/// Assigns a station address to the slave at a place in the chain.
///
/// # Errors
/// As [`AcyclicPort::send_until_counted`].
pub async fn assign_station<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    position: u16,
    station: u16,
) -> Result<(), BusError> {
    port.send_until_counted(&assignment(position, station), 1)
        .await
        .map(|_| ())
}

/// Gives all slaves with a station address another one, 0 for none; there need not be any such slave.
///
/// # Errors
/// As [`AcyclicPort::answered`].
pub async fn rename<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    from: u16,
    to: u16,
) -> Result<(), BusError> {
    let address = Address::station(from, register::STATION_ADDRESS);
    let request = Request::write(Command::Fpwr, address, &to.to_le_bytes());
    port.answered(&request).await.map(|_| ())
}

/// Assigns station addresses to the first `count` slaves of the chain, from [`STATION_BASE`] on.
///
/// # Errors
/// As [`AcyclicPort::send_all_until_counted`].
pub async fn assign_stations<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    count: u16,
) -> Result<(), BusError> {
    for first in (0..count).step_by(IN_FLIGHT_MAX) {
        let places = first..count.min(first + IN_FLIGHT_MAX as u16);
        let requests = places.map(|position| assignment(position, STATION_BASE.wrapping_add(position)));
        let requests: Vec<Request, IN_FLIGHT_MAX> = requests.collect();
        port.send_all_until_counted(&requests, 1, |_, _| {}).await?;
    }
    Ok(())
}

fn assignment(position: u16, station: u16) -> Request {
    let address = Address::position(position, register::STATION_ADDRESS);
    Request::write(Command::Apwr, address, &station.to_le_bytes())
}

/// Sets up the mailbox's sync managers, in INIT.
///
/// # Errors
/// As [`AcyclicPort::send_until_counted`].
pub async fn mailbox_managers<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    fixed: &FixedPart,
) -> Result<(), BusError> {
    let managers = [
        mailbox_manager(fixed.mailbox_out, register::CONTROL_MAILBOX_OUT),
        mailbox_manager(fixed.mailbox_in, register::CONTROL_MAILBOX_IN),
    ];
    write_managers(port, station, [0, 1], &managers).await
}

/// Writes two sync managers, in one datagram where their numbers follow each other.
pub(crate) async fn write_managers<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    numbers: [u8; 2],
    managers: &[SyncManagerRepr; 2],
) -> Result<(), BusError> {
    let mut registers = [0; 2 * SYNC_MANAGER_LEN];
    for (manager, bytes) in managers.iter().zip(registers.chunks_exact_mut(SYNC_MANAGER_LEN)) {
        // Each part has the length of the structure.
        let _ = manager.emit(bytes);
    }
    let [first, second] = numbers.map(register::sync_manager);
    if second == first + SYNC_MANAGER_LEN as u16 {
        return port.write(station, first, &registers).await;
    }
    let (of_first, of_second) = registers.split_at(SYNC_MANAGER_LEN);
    port.write(station, first, of_first).await?;
    port.write(station, second, of_second).await
}

fn mailbox_manager(window: MailboxWindow, control: u8) -> SyncManagerRepr {
    SyncManagerRepr {
        start: window.start,
        length: window.length,
        control,
        activate: register::SYNC_MANAGER_ENABLE,
        ..SyncManagerRepr::default()
    }
}

/// Clears all sync managers and FMMUs that a slave's controller has, in INIT: some together, and one by one if it does not take
/// these.
///
/// # Errors
/// As [`AcyclicPort::send_until_counted`].
pub async fn clear<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>, station: u16) -> Result<(), BusError> {
    clear_fmmus(port, station).await?;
    let managers = port.read(station, register::SYNC_MANAGER_COUNT, 1).await?;
    clear_kind(
        port,
        station,
        register::SYNC_MANAGER,
        SYNC_MANAGER_LEN,
        read_u8(&managers, 0),
    )
    .await
}

/// Clears all FMMUs that a slave's controller has: it takes no part in the exchange any more.
///
/// # Errors
/// As [`AcyclicPort::send_until_counted`].
pub async fn clear_fmmus<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
) -> Result<(), BusError> {
    let fmmus = fmmus(port, station).await?;
    clear_kind(port, station, register::FMMU, FMMU_LEN, fmmus).await
}

/// Whether a slave maps its memory into the logical memory outside its share: another master has set its FMMUs. Units that
/// cannot be read count as free.
///
/// # Errors
/// As [`AcyclicPort::answered`].
pub async fn maps_outside<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    share: Range<u32>,
) -> Result<bool, BusError> {
    let is_outside = |block: &[u8]| {
        FmmuRepr::parse(block).is_ok_and(|mapping| {
            let end = mapping.logical_start.saturating_add(mapping.length.into());
            mapping.active && (mapping.logical_start < share.start || end > share.end)
        })
    };
    let request = |first: u8, units: u8| {
        let address = Address::station(station, register::fmmu(first));
        Request::read(Command::Fprd, address, usize::from(units) * FMMU_LEN)
    };
    let count = units(fmmus(port, station).await?);
    for first in (0..count).step_by(CLEARED.into()) {
        let together = CLEARED.min(count - first);
        let (blocks, counter) = port.answered(&request(first, together)).await?;
        if counter == 1 {
            if blocks.chunks_exact(FMMU_LEN).any(is_outside) {
                return Ok(true);
            }
            continue;
        }
        for unit in first..first + together {
            let (block, counter) = port.answered(&request(unit, 1)).await?;
            if counter == 1 && is_outside(&block) {
                return Ok(true);
            }
        }
    }
    Ok(false)
}

/// Number of FMMUs that a controller says that it has; 0 if it does not tell. Two slaves with one address answer too.
pub(crate) async fn fmmus<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
) -> Result<u8, BusError> {
    let address = Address::station(station, register::FMMU_COUNT);
    let (count, _) = port.answered(&Request::read(Command::Fprd, address, 1)).await?;
    Ok(read_u8(&count, 0))
}

/// Number of units that are looked at: a controller that says that it has none may have some.
const fn units(count: u8) -> u8 {
    match count {
        0 => CLEARED,
        1..=register::UNITS_MAX => count,
        _ => register::UNITS_MAX,
    }
}

/// Clears the units of one kind, from their first register on, each with a number of bytes.
async fn clear_kind<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    register: u16,
    length: usize,
    count: u8,
) -> Result<(), BusError> {
    const BLANK: [u8; CLEARED as usize * FMMU_LEN] = [0; CLEARED as usize * FMMU_LEN];
    let count = units(count);
    let request = |first: u8, units: u8| {
        let address = Address::station(station, register + u16::from(first) * length as u16);
        let data = BLANK.get(..usize::from(units) * length).unwrap_or_default();
        Request::write(Command::Fpwr, address, data)
    };
    for first in (0..count).step_by(CLEARED.into()) {
        let units = CLEARED.min(count - first);
        if port.answered(&request(first, units)).await?.1 == 1 {
            continue;
        }
        for unit in first..first + units {
            port.answered(&request(unit, 1)).await?;
        }
    }
    Ok(())
}
