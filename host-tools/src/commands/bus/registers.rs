//! Prints registers and error counters of slave controllers.

use super::table;
use crate::bus::access::{self, BusAccess};
use crate::bus::counters;
use crate::bus::registers::{SlaveRegisters, read_named};
use crate::bus::value::hex;
use crate::commands::print_json;
use crate::error::ProgramError;
use serde::Serialize;

/// Bytes of a line of a dump.
const LINE_BYTES: usize = 16;

/// What `bus registers N ADDR LEN` prints as JSON.
#[derive(Debug, Serialize)]
struct Memory {
    slave: u8,
    address: u16,
    bytes: String,
}

/// `bus registers [N]`: the registers with a name.
pub(super) fn named(access: &mut dyn BusAccess, only: Option<u8>, json: bool) -> Result<(), ProgramError> {
    let found = read_named(access, only)?;
    if json {
        return print_json(&found);
    }
    for SlaveRegisters { slave, registers } in &found {
        table::say(&format!("slave {slave}"))?;
        let rows: Vec<_> = registers
            .iter()
            .map(|register| {
                let digits = register.bytes.len();
                [
                    format!("{:04x}", register.address),
                    format!("{:0digits$x}", register.value),
                    register.name.to_owned(),
                ]
            })
            .collect();
        table::print(["address", "value", "name"], &rows)?;
    }
    Ok(())
}

/// `bus registers N ADDR LEN`: raw content.
pub(super) fn dump(
    access: &mut dyn BusAccess,
    slave: u8,
    address: u16,
    length: u16,
    json: bool,
) -> Result<(), ProgramError> {
    let memory = access::registers(access, slave, address, length)?;
    if json {
        return print_json(&Memory {
            slave,
            address,
            bytes: hex(&memory),
        });
    }
    for (line, bytes) in memory.chunks(LINE_BYTES).enumerate() {
        let shown: Vec<String> = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        let at = usize::from(address) + line * LINE_BYTES;
        table::say(&format!("{at:04x}  {}", shown.join(" ")))?;
    }
    Ok(())
}

/// `bus errors`.
pub(super) fn errors(access: &mut dyn BusAccess, clear: bool, json: bool) -> Result<(), ProgramError> {
    let mut found = counters::read(access)?;
    counters::read_messages(access, &mut found)?;
    if clear {
        access::clear_errors(access)?;
    }
    if json {
        return print_json(&found.slaves);
    }
    let mut rows = Vec::new();
    for slave in &found.slaves {
        for port in slave
            .ports
            .iter()
            .filter(|port| !port.cable.is_empty() || port.has_errors())
        {
            rows.push([
                slave.slave.to_string(),
                port.port.to_string(),
                port.invalid_frames.to_string(),
                port.receive_errors.to_string(),
                port.forwarded.to_string(),
                port.lost_links.to_string(),
                port.cable.clone(),
            ]);
        }
    }
    let heading = [
        "slave",
        "port",
        "invalid",
        "receive",
        "forwarded",
        "lost links",
        "cable",
    ];
    table::print(heading, &rows)?;
    found.findings.iter().try_for_each(|line| table::say(line))
}
