//! Error counters of slave controllers, and the cables that they indicate.

use super::access::{self, BusAccess};
use super::diagnosis::{self, MessageView};
use super::slaves;
use crate::error::ProgramError;
use etherpen::ethercat::diagnostics::SlaveErrors;
use etherpen::ethercat::wire::register::PortErrors;
use serde::Serialize;

/// Error counters of one port.
#[derive(Debug, Serialize)]
pub(crate) struct PortCounters {
    /// Number of the port, from 0.
    pub(crate) port: usize,
    /// The cable at the port by its ends; empty if nothing is connected.
    pub(crate) cable: String,
    pub(crate) invalid_frames: u8,
    pub(crate) receive_errors: u8,
    /// Errors that another port detected first.
    pub(crate) forwarded: u8,
    pub(crate) lost_links: u8,
}

impl PortCounters {
    /// Whether any counter is above 0.
    pub(crate) fn has_errors(&self) -> bool {
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

/// Error counters of one slave.
#[derive(Debug, Serialize)]
pub(crate) struct SlaveCounters {
    /// Place in the chain, from 1.
    pub(crate) slave: u8,
    pub(crate) ports: Vec<PortCounters>,
    /// Frames that were not EtherCAT.
    processing_unit: u8,
    processor_interface: u8,
    /// Expiries of the process data watchdog.
    watchdog: u8,
    /// Newest messages of the slave's diagnosis history, newest first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) messages: Vec<MessageView>,
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
            messages: Vec::new(),
        }
    }
}

/// Error counters of a bus.
#[derive(Debug, Default)]
pub(crate) struct ErrorCounters {
    pub(crate) slaves: Vec<SlaveCounters>,
    /// What the counters indicate, one line per finding: cables first, then slaves.
    pub(crate) findings: Vec<String>,
}

/// Reads the error counters of all slaves.
///
/// # Errors
/// The bus refused a request or was lost.
pub(crate) fn read(access: &mut dyn BusAccess) -> Result<ErrorCounters, ProgramError> {
    let mut found = ErrorCounters::default();
    for slave in 1..=access::bus(access)?.slaves {
        let errors = access::errors(access, slave)?;
        let counters = SlaveCounters::new(slave, &errors);
        let ports = errors.ports.iter().zip(&counters.ports);
        found.findings.extend(ports.filter_map(|(counted, port)| {
            let verdict = verdict(counted, &port.cable)?;
            Some(format!("slave {slave} port {}: {verdict}", port.port))
        }));
        found.slaves.push(counters);
    }
    for slave in found
        .slaves
        .iter()
        .filter(|slave| slave.processing_unit > 0 || slave.watchdog > 0)
    {
        found.findings.push(format!(
            "slave {}: {} frames were no EtherCAT, the process data watchdog expired {} times",
            slave.slave, slave.processing_unit, slave.watchdog
        ));
    }
    Ok(found)
}

/// Reads the diagnosis histories of the slaves that answer SDOs in their present state.
///
/// # Errors
/// The bus refused a request or was lost.
pub(crate) fn read_messages(access: &mut dyn BusAccess, found: &mut ErrorCounters) -> Result<(), ProgramError> {
    for view in &slaves::read(access, None)?.slaves {
        let counters = found.slaves.iter_mut().find(|counters| counters.slave == view.slave);
        let Some(counters) = counters.filter(|_| view.has_objects()) else {
            continue;
        };
        counters.messages = diagnosis::read(access, view.slave)?;
        let lines = counters.messages.iter().map(MessageView::text);
        found
            .findings
            .extend(lines.map(|text| format!("slave {} tells: {text}", view.slave)));
    }
    Ok(())
}

/// The cable at a port by its ends; empty if nothing is connected.
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

/// What a port's counters indicate. Only errors that this port detected first point at its cable.
fn verdict(counted: &PortErrors, cable: &str) -> Option<String> {
    if counted.lost_links == 0 && counted.receive_errors == 0 && counted.invalid_frames == 0 {
        return None;
    }
    let place = if cable.is_empty() { "at this port" } else { cable };
    Some(format!("check the cable {place} and its plugs"))
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
