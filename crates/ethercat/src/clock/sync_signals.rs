//! The sync signals of a slave: SYNC0 with the period of the exchange, and SYNC1 behind it.

use super::super::acyclic::AcyclicPort;
use super::super::error::BusError;
use super::super::wire::{read_u64, register};
use super::BusClocks;

/// What a slave's sync signals are to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SyncSignals {
    /// The word of the device's description: low byte for register 0x0980, high byte for 0x0981.
    pub assign_activate: u16,
    /// Time from SYNC0 to SYNC1, ns.
    pub sync1_ns: u32,
    /// Time from the frames' pass of the reference to SYNC0, ns.
    pub shift_ns: u32,
}

/// Starts SYNC0 of the slave at `position` with the period of the exchange, and SYNC1 if its signals say so, in PREOP, once its
/// clock has the time of the bus. The start is right for clocks of either width. `answers` returns false for slaves that are lost.
/// Returns the start time in the slave's own system time.
///
/// # Errors
/// As [`AcyclicPort::send_all_until_counted`].
pub async fn start_sync<const SLAVES: usize, const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: &[u16],
    position: usize,
    clocks: &mut BusClocks<SLAVES>,
    signals: SyncSignals,
    answers: impl Fn(usize) -> bool,
) -> Result<u64, BusError> {
    let station = stations.get(position).copied().unwrap_or(0);
    let source = clocks.distributor(answers);
    let delay_ns = clocks.delay_from_ns(source, position);
    stop_sync(port, station).await?;
    // The time to SYNC1 lies behind the period; another master may have left one.
    let times = u64::from(signals.sync1_ns) << 32 | u64::from(clocks.period_ns);
    port.write(station, register::DC_SYNC0_CYCLE, &times.to_le_bytes())
        .await?;
    // Its clock has the time of the bus; reads of both clocks may travel in frames of different cycles.
    let local_ns = read_u64(&port.read(station, register::DC_SYSTEM_TIME, 8).await?, 0);
    let passed_ns = local_ns.wrapping_sub(delay_ns.into());
    let now_ns = clocks.extended_ns(passed_ns, port.now_ms());
    let ahead_ns = clocks.start_time_ns(now_ns, signals.shift_ns).wrapping_sub(now_ns);
    let start_ns = passed_ns.wrapping_add(ahead_ns);
    port.write(station, register::DC_START_TIME, &start_ns.to_le_bytes())
        .await?;
    port.write(
        station,
        register::DC_CYCLIC_CONTROL,
        &signals.assign_activate.to_le_bytes(),
    )
    .await?;
    Ok(start_ns)
}

/// Stops SYNC0 and SYNC1 of a slave.
///
/// # Errors
/// As [`AcyclicPort::send_until_counted`].
pub async fn stop_sync<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
) -> Result<(), BusError> {
    port.write(station, register::DC_CYCLIC_CONTROL, &[0; 2]).await
}
