//! Register addresses of the slave controller as offsets into its memory, and write access for each byte.

use etherpen_ethercat::wire::register as wire;

/// Type, revision, build, numbers of units, RAM size, port descriptor.
pub(crate) const TYPE: usize = wire::TYPE as usize;
/// Features of the silicon.
pub(crate) const FEATURES: usize = wire::FEATURES as usize;
/// Station address given by the master.
pub(crate) const STATION_ADDRESS: usize = wire::STATION_ADDRESS as usize;
/// Station alias.
pub(crate) const STATION_ALIAS: usize = wire::STATION_ALIAS as usize;
/// Data-link control.
pub(crate) const DL_CONTROL: usize = wire::DL_CONTROL as usize;
/// Data-link status.
pub(crate) const DL_STATUS: usize = wire::DL_STATUS as usize;
/// Requested application-layer state.
pub(crate) const AL_CONTROL: usize = wire::AL_CONTROL as usize;
/// Actual application-layer state.
pub(crate) const AL_STATUS: usize = wire::AL_STATUS as usize;
/// Why a state was refused or left.
pub(crate) const AL_STATUS_CODE: usize = wire::AL_STATUS_CODE as usize;
/// Events that the datagrams' interrupt field reports.
pub(crate) const EVENT_MASK: usize = wire::EVENT_MASK as usize;
/// Events that the bus may ask for.
pub(crate) const EVENT_REQUEST: usize = EVENT_MASK + 0x10;
/// Reset of the controller by three bytes in three frames.
pub(crate) const RESET: usize = 0x0040;
/// Watchdog clock divider.
pub(crate) const WATCHDOG_DIVIDER: usize = wire::WATCHDOG_DIVIDER as usize;
/// Process-data watchdog time in periods of the divided clock.
pub(crate) const WATCHDOG_PROCESS_DATA: usize = wire::WATCHDOG_SYNC_MANAGER as usize;
/// Process-data watchdog status: bit 0 is set while it has not expired.
pub(crate) const WATCHDOG_STATUS: usize = wire::WATCHDOG_STATUS as usize;
/// Expiries of the process-data watchdog.
pub(crate) const WATCHDOG_COUNTER: usize = wire::WATCHDOG_COUNTER as usize;
/// Control of the slave's processor interface, loaded from the information memory.
pub(crate) const PDI_CONTROL: usize = wire::PDI_CONTROL as usize;
/// Invalid frames and receive errors, two counters for each port.
pub(crate) const RECEIVE_ERRORS: usize = wire::RECEIVE_ERRORS as usize;
/// Errors forwarded with the frame, one counter for each port.
pub(crate) const FORWARDED_ERRORS: usize = wire::FORWARDED_ERRORS as usize;
/// Watchdog time of the slave's processor in periods of the divided clock.
pub(crate) const WATCHDOG_PDI: usize = wire::WATCHDOG_PDI as usize;
/// Expiries of the processor's watchdog.
pub(crate) const WATCHDOG_PDI_COUNTER: usize = WATCHDOG_COUNTER + 1;
/// Lost links, one counter for each port.
pub(crate) const LOST_LINKS: usize = wire::LOST_LINKS as usize;
/// First register of the information memory's interface.
pub(crate) const SII_CONFIG: usize = wire::SII_CONFIG as usize;
/// Control and status of the information memory.
pub(crate) const SII_CONTROL: usize = wire::SII_CONTROL as usize;
/// First fieldbus memory management unit.
pub(crate) const FMMU: usize = wire::FMMU as usize;
/// First sync manager.
pub(crate) const SYNC_MANAGER: usize = wire::SYNC_MANAGER as usize;

const ERROR_COUNTERS: usize = RECEIVE_ERRORS;
const SII_PDI_ACCESS: usize = wire::SII_PDI_ACCESS as usize;
const TIME_DIFFERENCE: usize = wire::DC_TIME_DIFFERENCE as usize;
const ERROR_COUNTERS_END: usize = ERROR_COUNTERS + wire::ERROR_COUNTERS_LEN;
const SYNC_MANAGER_END: usize = SYNC_MANAGER + 8 * wire::SYNC_MANAGER_LEN;
const STATUS_OFFSET: usize = wire::SYNC_MANAGER_STATUS_OFFSET as usize;
const PDI_OFFSET: usize = wire::SYNC_MANAGER_PDI_OFFSET as usize;

/// Whether the bus cannot change this byte.
pub(crate) fn is_read_only(at: usize) -> bool {
    let in_manager = at % wire::SYNC_MANAGER_LEN;
    let manager_flag =
        (SYNC_MANAGER..SYNC_MANAGER_END).contains(&at) && (in_manager == STATUS_OFFSET || in_manager == PDI_OFFSET);
    at < STATION_ADDRESS
        || (STATION_ALIAS..STATION_ALIAS + 2).contains(&at)
        || (PDI_CONTROL..PDI_CONTROL + 2).contains(&at)
        || at == SII_PDI_ACCESS
        || (TIME_DIFFERENCE..TIME_DIFFERENCE + 4).contains(&at)
        || (DL_STATUS..DL_STATUS + 2).contains(&at)
        || (AL_STATUS..AL_STATUS_CODE + 2).contains(&at)
        || (WATCHDOG_STATUS..WATCHDOG_STATUS + 2).contains(&at)
        || (EVENT_REQUEST..EVENT_REQUEST + 4).contains(&at)
        || manager_flag
}

/// Whether writing any value clears this byte.
pub(crate) fn is_counter(at: usize) -> bool {
    (ERROR_COUNTERS..ERROR_COUNTERS_END).contains(&at) || (WATCHDOG_COUNTER..WATCHDOG_COUNTER + 2).contains(&at)
}
