//! Process data of a slave: its share of the logical memory, and the sync managers and FMMUs that move it.
//!
//! Invariant: the shares of two slaves never overlap.

use crate::acyclic::{AcyclicPort, Request};
use crate::configure::SYNC_MANAGER_OUTPUTS;
use crate::configure::discovery::write_managers;
use crate::cyclic::{CyclicSlave, SPAN_BYTES_MAX};
use crate::driver::{ProcessData, Role, SlaveFactory};
use crate::error::BusError;
use crate::slave::Slave;
use crate::wire::register::{self, FMMU_LEN, FmmuRepr, SyncManagerRepr};
use crate::wire::{Address, Command};

/// Start of the slaves' process data in the logical memory. Each slave has [`SPAN_BYTES_MAX`] bytes: its inputs, and
/// directly behind them its outputs, so that one datagram may carry both. Inputs at the beginning of a datagram are taken
/// fastest.
pub const LOGICAL_START: u32 = 0x0001_0000;

/// Watchdog units (100 us) in a millisecond.
const WATCHDOG_UNITS_PER_MS: u16 = 10;
/// Watchdog of the slave's own processor: 100 ms, the slave controllers' default.
const WATCHDOG_PDI_UNITS: u16 = 1_000;

/// A slave's share of the logical memory: empty for slaves that are not configured yet, without a role for slaves that
/// the application does not use. Outputs without a role stay 0.
pub fn cyclic_slave<F: SlaveFactory>(slave: &Slave<F>) -> CyclicSlave<F> {
    let (Some(device), Some(data)) = (slave.device, slave.process_data) else {
        return CyclicSlave::default();
    };
    let layout = data.layout;
    let start = LOGICAL_START + u32::from(slave.position) * SPAN_BYTES_MAX as u32;
    CyclicSlave {
        input_address: start,
        input_length: data.input_length,
        output_address: start + u32::from(data.input_length),
        output_length: data.output_length,
        watched: false,
        role: slave.member.map(|member| Role { member, device, layout }),
        generation: slave.generation,
    }
}

/// Sets up process-data sync managers, FMMUs and watchdogs, in PREOP.
///
/// `watchdog_ms` is the sync managers' watchdog; 0 switches it off.
///
/// # Errors
/// As [`AcyclicPort::send_until_counted`].
pub async fn set_up<F: SlaveFactory, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    slave: &Slave<F>,
    watchdog_ms: u16,
) -> Result<(), BusError> {
    let Some(data) = slave.process_data else {
        return Ok(());
    };
    let ProcessData { windows, .. } = data;
    let station = slave.station();
    watchdogs(port, station, watchdog_ms).await?;
    let (outputs, inputs) = (data.output_length, data.input_length);
    let manager = |start, length, control| SyncManagerRepr {
        start,
        length,
        control,
        activate: register::SYNC_MANAGER_ENABLE,
        ..SyncManagerRepr::default()
    };
    let managers = [
        manager(windows.outputs, outputs, register::CONTROL_OUTPUTS),
        manager(windows.inputs, inputs, register::CONTROL_INPUTS),
    ];
    write_managers(port, station, SYNC_MANAGER_OUTPUTS, &managers).await?;
    let share = cyclic_slave(slave);
    let mappings = [
        FmmuRepr::bytes(share.output_address, outputs, windows.outputs, false),
        FmmuRepr::bytes(share.input_address, inputs, windows.inputs, true),
    ];
    let mut registers = [0; 2 * FMMU_LEN];
    for (mapping, bytes) in mappings.iter().zip(registers.chunks_exact_mut(FMMU_LEN)) {
        // Each part has the length of the structure.
        let _ = mapping.emit(bytes);
    }
    port.write(station, register::FMMU, &registers).await
}

async fn watchdogs<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    watchdog_ms: u16,
) -> Result<(), BusError> {
    let units = watchdog_ms.saturating_mul(WATCHDOG_UNITS_PER_MS);
    let requests = [
        (register::WATCHDOG_DIVIDER, register::WATCHDOG_DIVIDER_100_US),
        (register::WATCHDOG_PDI, WATCHDOG_PDI_UNITS),
        (register::WATCHDOG_SYNC_MANAGER, units),
    ]
    .map(|(at, value)| Request::write(Command::Fpwr, Address::station(station, at), &value.to_le_bytes()));
    port.send_all_until_counted(&requests, 1, |_, _| {}).await
}
