//! Slave controllers: registers and error counters.

use super::access::{self, BusAccess};
use super::table;
use super::value::hex;
use crate::commands::print_json;
use crate::error::ProgramError;
use etherpen::ethercat::diagnostics::SlaveErrors;
use etherpen::ethercat::wire::register;
use etherpen::ethercat::wire::register::PortErrors;
use serde::Serialize;

/// Bytes of a line of a dump.
const LINE_BYTES: usize = 16;

/// A register with a name: address, bytes, name.
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

/// A register for a program.
#[derive(Debug, Serialize)]
struct RegisterView {
    address: u16,
    name: &'static str,
    bytes: String,
    value: u32,
}

/// Registers of one slave for a program.
#[derive(Debug, Serialize)]
struct SlaveRegisters {
    slave: u8,
    registers: Vec<RegisterView>,
}

/// Memory of one slave for a program.
#[derive(Debug, Serialize)]
struct Memory {
    slave: u8,
    address: u16,
    bytes: String,
}

/// `bus registers [N]`: the registers that have a name here.
pub(super) fn named(access: &mut dyn BusAccess, only: Option<u8>, json: bool) -> Result<(), ProgramError> {
    let slaves = match only {
        Some(slave) => slave..=slave,
        None => 1..=access::bus(access)?.slaves,
    };
    let mut found = Vec::new();
    for slave in slaves {
        let mut registers = Vec::new();
        for (address, length, name) in NAMED {
            let bytes = access::registers(access, slave, address, length)?;
            registers.push(RegisterView {
                address,
                name,
                value: bytes.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte)),
                bytes: hex(&bytes),
            });
        }
        found.push(SlaveRegisters { slave, registers });
    }
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

/// The counters of one port for a program.
#[derive(Debug, Serialize)]
struct PortCounters {
    port: usize,
    cable: String,
    invalid_frames: u8,
    receive_errors: u8,
    forwarded: u8,
    lost_links: u8,
}

/// The counters of one slave for a program.
#[derive(Debug, Serialize)]
struct SlaveCounters {
    slave: u8,
    ports: Vec<PortCounters>,
    processing_unit: u8,
    processor_interface: u8,
    watchdog: u8,
}

/// The cable at a port, in words.
fn cable(slave: u8, port: usize, partner: Option<u8>) -> String {
    match partner.map(|partner| u16::from(partner) + 1) {
        Some(partner) => {
            let slave = u16::from(slave);
            format!("between slave {} and {}", slave.min(partner), slave.max(partner))
        }
        None if slave == 1 && port == 0 => "between the master and slave 1".into(),
        None => String::new(),
    }
}

impl SlaveCounters {
    fn new(slave: u8, errors: &SlaveErrors) -> Self {
        let ports = errors.ports.iter().zip(errors.partners).enumerate();
        Self {
            slave,
            ports: ports
                .map(|(port, (counted, partner))| PortCounters {
                    port,
                    cable: cable(slave, port, partner),
                    invalid_frames: counted.invalid_frames,
                    receive_errors: counted.receive_errors,
                    forwarded: counted.forwarded_errors,
                    lost_links: counted.lost_links,
                })
                .collect(),
            processing_unit: errors.processing_unit,
            processor_interface: errors.processor_interface,
            watchdog: errors.watchdog,
        }
    }
}

/// Verdict on a port's cable from the counters: only errors first detected at this port indicate the cable.
fn verdict(counted: &PortErrors, cable: &str) -> Option<String> {
    if counted.lost_links == 0 && counted.receive_errors == 0 && counted.invalid_frames == 0 {
        return None;
    }
    let place = if cable.is_empty() { "at this port" } else { cable };
    Some(format!("check the cable {place} and its plugs"))
}

/// `bus errors`.
pub(super) fn errors(access: &mut dyn BusAccess, clear: bool, json: bool) -> Result<(), ProgramError> {
    let mut views = Vec::new();
    let mut verdicts = Vec::new();
    for slave in 1..=access::bus(access)?.slaves {
        let errors = access::errors(access, slave)?;
        let view = SlaveCounters::new(slave, &errors);
        let told = errors.ports.iter().zip(&view.ports);
        verdicts.extend(told.filter_map(|(counted, port)| {
            let verdict = verdict(counted, &port.cable)?;
            Some(format!("slave {slave} port {}: {verdict}", port.port))
        }));
        views.push(view);
    }
    if clear {
        access::clear_errors(access)?;
    }
    if json {
        return print_json(&views);
    }
    let mut rows = Vec::new();
    for slave in &views {
        for port in slave
            .ports
            .iter()
            .filter(|port| !port.cable.is_empty() || port.is_told())
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
    for slave in views
        .iter()
        .filter(|slave| slave.processing_unit > 0 || slave.watchdog > 0)
    {
        verdicts.push(format!(
            "slave {}: {} frames were no EtherCAT, the process data watchdog expired {} times",
            slave.slave, slave.processing_unit, slave.watchdog
        ));
    }
    verdicts.iter().try_for_each(|line| table::say(line))
}

impl PortCounters {
    fn is_told(&self) -> bool {
        [
            self.invalid_frames,
            self.receive_errors,
            self.forwarded,
            self.lost_links,
        ]
        .iter()
        .any(|count| *count > 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bad_cable_is_named_by_the_slaves_at_its_ends() {
        assert_eq!(cable(3, 0, Some(1)), "between slave 2 and 3");
        assert_eq!(cable(2, 1, Some(2)), "between slave 2 and 3");
        assert_eq!(cable(1, 0, None), "between the master and slave 1");
        let counted = PortErrors {
            lost_links: 2,
            ..PortErrors::default()
        };
        assert!(verdict(&counted, "between slave 2 and 3").is_some_and(|text| text.contains("between slave 2 and 3")));
        assert_eq!(
            verdict(
                &PortErrors {
                    forwarded_errors: 9,
                    ..PortErrors::default()
                },
                ""
            ),
            None
        );
    }
}
