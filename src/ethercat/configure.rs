//! Finding slaves and preparing them: addresses, SII, sync managers, FMMUs, watchdog, objects.
//!
//! Each function is one step of the way from an unknown chain to a slave in SAFEOP. Most slaves need a step only once,
//! but every step may be repeated, so that a repair uses the same code as the first bring-up.
//!
//! Invariant: steps for one slave touch no other slave, except [`reset_all`].

mod process_data;

pub use process_data::{LOGICAL_START, ask_device_type, cyclic_slave, objects, process_data};

use super::acyclic::{AcyclicPort, Bytes, Request};
use super::error::BusError;
use super::slave::Slave;
use super::state::{AlState, STATE_TIMEOUT_MS};
use super::wire::register::{self, FMMU_LEN, SYNC_MANAGER_LEN, SyncManagerRepr};
use super::wire::sii::{self, FixedPart};
use super::wire::{Address, Command, read_u16};

/// Longest wait for the SII to become free, ms.
pub const SII_TIMEOUT_MS: u32 = 100;
/// How often an unacknowledged SII command is repeated.
const SII_TRIES_MAX: u8 = 3;
/// Sync managers and FMMUs that are cleared at the start.
const CLEARED: usize = 4;

/// Counts the slaves and brings all of them to INIT with nothing configured; error counters start at 0.
///
/// # Errors
/// [`BusError::StateTimeout`] when a slave does not go to INIT, or [`BusError::Lost`].
pub async fn reset_all<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>) -> Result<(), BusError> {
    let init = AlState::Init as u16 | register::AL_ERROR_BIT;
    port.broadcast_write(register::AL_CONTROL, &init.to_le_bytes()).await?;
    let started_ms = port.now_ms();
    loop {
        let (status, _) = port.broadcast_read_u16(register::AL_STATUS).await?;
        let seen = status & (register::AL_STATE_MASK | register::AL_ERROR_BIT);
        if seen == AlState::Init as u16 {
            break;
        }
        let waited_ms = port.now_ms().wrapping_sub(started_ms);
        if waited_ms > STATE_TIMEOUT_MS {
            return Err(BusError::StateTimeout {
                expected: AlState::Init as u8,
                actual: seen as u8,
                waited_ms,
            });
        }
    }
    port.broadcast_write(register::STATION_ADDRESS, &[0; 2]).await?;
    port.broadcast_write(register::FMMU, &[0; CLEARED * FMMU_LEN]).await?;
    port.broadcast_write(register::SYNC_MANAGER, &[0; CLEARED * SYNC_MANAGER_LEN])
        .await?;
    port.broadcast_write(register::RECEIVE_ERRORS, &[0; register::ERROR_COUNTERS_LEN])
        .await?;
    Ok(())
}

/// Reads the station address of the slave at a place in the chain.
///
/// # Errors
/// As [`AcyclicPort::insist`].
pub async fn station_at<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    position: u16,
) -> Result<u16, BusError> {
    let address = Address::position(position, register::STATION_ADDRESS);
    let request = Request::read(Command::Aprd, address, 2);
    Ok(read_u16(&port.insist(&request, 1).await?, 0))
}

/// Gives the slave at a place in the chain its station address.
///
/// # Errors
/// As [`AcyclicPort::insist`].
pub async fn assign_station<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    position: u16,
    station: u16,
) -> Result<(), BusError> {
    let address = Address::position(position, register::STATION_ADDRESS);
    let request = Request::write(Command::Apwr, address, &station.to_le_bytes());
    port.insist(&request, 1).await.map(|_| ())
}

/// Waits until the SII is free and gives its status.
async fn sii_free<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>, station: u16) -> Result<u16, BusError> {
    let started_ms = port.now_ms();
    loop {
        let status = port.read_u16(station, register::SII_CONTROL).await?;
        if status & register::SII_BUSY == 0 {
            return Ok(status);
        }
        let waited_ms = port.now_ms().wrapping_sub(started_ms);
        if waited_ms > SII_TIMEOUT_MS {
            return Err(BusError::SiiBusy { waited_ms });
        }
    }
}

/// Takes the SII for the master, by force if the slave's own side holds it.
///
/// # Errors
/// As [`AcyclicPort::insist`].
pub async fn take_sii<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>, station: u16) -> Result<(), BusError> {
    let config = port.read_u16(station, register::SII_CONFIG).await?;
    if config != 0 {
        port.write(station, register::SII_CONFIG, &[register::SII_FORCE])
            .await?;
        port.write(station, register::SII_CONFIG, &[0]).await?;
    }
    Ok(())
}

/// Reads 4 or 8 bytes of the SII, as many as the slave gives at a time, from a word address on.
async fn read_sii<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    word: u16,
) -> Result<Bytes, BusError> {
    let mut status = sii_free(port, station).await?;
    for _ in 0..SII_TRIES_MAX {
        let [control_low, control_high] = register::SII_READ.to_le_bytes();
        let [low, high] = word.to_le_bytes();
        let command = [control_low, control_high, low, high, 0, 0];
        port.write(station, register::SII_CONTROL, &command).await?;
        status = sii_free(port, station).await?;
        if status & register::SII_ACKNOWLEDGE_ERROR == 0 {
            let length = if status & register::SII_READS_8_BYTES != 0 {
                8
            } else {
                4
            };
            return port.read(station, register::SII_DATA, length).await;
        }
    }
    Err(BusError::Sii { status })
}

/// Reads the fixed part of a slave's SII: identity and mailboxes.
///
/// # Errors
/// [`BusError::SiiBusy`], [`BusError::Sii`], or as [`AcyclicPort::insist`].
pub async fn fixed_part<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
) -> Result<FixedPart, BusError> {
    const BYTES: usize = 2 * sii::FIXED_PART_WORDS;
    take_sii(port, station).await?;
    let mut image = [0; BYTES + 8];
    for (from, to) in [
        (sii::WORD_VENDOR, sii::WORD_SERIAL + 2),
        (sii::WORD_MAILBOX_OUT, sii::WORD_PROTOCOLS + 1),
    ] {
        let mut word = from;
        while word < to {
            let part = read_sii(port, station, word).await?;
            super::wire::write_bytes(&mut image, usize::from(word) * 2, &part);
            word += (part.len() as u16 / 2).max(1);
        }
    }
    FixedPart::parse(&image).map_err(|_| BusError::Sii { status: 0 })
}

/// Sets up the mailbox's sync managers, in INIT.
///
/// # Errors
/// As [`AcyclicPort::insist`].
pub async fn mailbox_managers<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    slave: &Slave,
) -> Result<(), BusError> {
    let window = |window: sii::MailboxWindow, control: u8| SyncManagerRepr {
        start: window.start,
        length: window.length,
        control,
        activate: register::SYNC_MANAGER_ENABLE,
        ..SyncManagerRepr::default()
    };
    let managers = [
        window(slave.fixed.mailbox_out, register::CONTROL_MAILBOX_OUT),
        window(slave.fixed.mailbox_in, register::CONTROL_MAILBOX_IN),
    ];
    write_managers(port, slave.station(), 0, &managers).await
}

async fn write_managers<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    first: u8,
    managers: &[SyncManagerRepr; 2],
) -> Result<(), BusError> {
    for (number, manager) in (first..).zip(managers) {
        let mut registers = [0; SYNC_MANAGER_LEN];
        // The array is as long as the structure.
        let _ = manager.emit(&mut registers);
        port.write(station, register::sync_manager(number), &registers).await?;
    }
    Ok(())
}

/// Clears all of a slave's sync managers and FMMUs, in INIT.
///
/// # Errors
/// As [`AcyclicPort::insist`].
pub async fn clear<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>, station: u16) -> Result<(), BusError> {
    port.write(station, register::FMMU, &[0; CLEARED * FMMU_LEN]).await?;
    port.write(station, register::SYNC_MANAGER, &[0; CLEARED * SYNC_MANAGER_LEN])
        .await
}
