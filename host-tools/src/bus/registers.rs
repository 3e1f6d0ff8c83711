//! Registers of slave controllers.

use super::access::{self, BusAccess};
use super::value::hex;
use crate::error::ProgramError;
use etherpen::ethercat::wire::register;
use serde::Serialize;

/// Registers that are shown by name: address, bytes, name.
const NAMED: [(u16, u16, &str); 19] = [
    (register::TYPE, 1, "type"),
    (register::FMMU_COUNT, 1, "FMMUs"),
    (register::SYNC_MANAGER_COUNT, 1, "sync managers"),
    (register::MEMORY_KIB, 1, "process memory, KiB"),
    (register::PORT_DESCRIPTOR, 1, "port descriptor"),
    (register::FEATURES, 2, "features"),
    (register::STATION_ADDRESS, 2, "station address"),
    (register::STATION_ALIAS, 2, "station alias"),
    (register::DL_CONTROL, 4, "data link control"),
    (register::DL_STATUS, 2, "data link status"),
    (register::AL_CONTROL, 2, "AL control"),
    (register::AL_STATUS, 2, "AL status"),
    (register::AL_STATUS_CODE, 2, "AL status code"),
    (register::PDI_CONTROL, 1, "PDI control"),
    (register::WATCHDOG_DIVIDER, 2, "watchdog divider"),
    (register::WATCHDOG_PDI, 2, "PDI watchdog"),
    (register::WATCHDOG_SYNC_MANAGER, 2, "process data watchdog"),
    (register::WATCHDOG_STATUS, 2, "watchdog status"),
    (register::SII_CONTROL, 2, "SII control and status"),
];

/// Value of one register.
#[derive(Debug, Serialize)]
pub(crate) struct RegisterValue {
    pub(crate) address: u16,
    pub(crate) name: &'static str,
    /// Content in the order of the addresses, as hexadecimal digits.
    pub(crate) bytes: String,
    pub(crate) value: u32,
}

/// Named registers of one slave.
#[derive(Debug, Serialize)]
pub(crate) struct SlaveRegisters {
    /// Place in the chain, from 1.
    pub(crate) slave: u8,
    pub(crate) registers: Vec<RegisterValue>,
}

/// Reads the named registers of one slave, or of all.
///
/// # Errors
/// The bus refused a request or was lost.
pub(crate) fn read_named(access: &mut dyn BusAccess, only: Option<u8>) -> Result<Vec<SlaveRegisters>, ProgramError> {
    let slaves = match only {
        Some(slave) => slave..=slave,
        None => 1..=access::bus(access)?.slaves,
    };
    let mut found = Vec::new();
    for slave in slaves {
        let mut registers = Vec::new();
        for (address, length, name) in NAMED {
            let bytes = access::registers(access, slave, address, length)?;
            registers.push(RegisterValue {
                address,
                name,
                value: bytes.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte)),
                bytes: hex(&bytes),
            });
        }
        found.push(SlaveRegisters { slave, registers });
    }
    Ok(found)
}
