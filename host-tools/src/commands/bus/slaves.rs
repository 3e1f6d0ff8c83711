//! Prints the slaves and their states: scan, info, state, watch.

use super::table;
use crate::bus::access::{self, BusAccess};
use crate::bus::process_data::PdoView;
use crate::bus::slaves::{AlStatusView, SlaveState, SlaveView, Watch, read, require_state};
use crate::commands::print_json;
use crate::error::ProgramError;
use crate::link::text::bus::{al_code, al_state};
use etherpen::ethercat::state::AlState;
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Time between two checks of `watch`.
const LOOK: Duration = Duration::from_millis(100);

/// `bus scan`.
pub(super) fn scan(access: &mut dyn BusAccess, json: bool) -> Result<(), ProgramError> {
    let view = read(access, None)?;
    if json {
        return print_json(&view);
    }
    let rows: Vec<_> = view
        .slaves
        .iter()
        .map(|slave| {
            [
                slave.slave.to_string(),
                slave.name.clone(),
                format!("{:08x}", slave.vendor),
                format!("{:08x}", slave.product),
                format!("{:x}", slave.revision),
                slave.serial.to_string(),
                slave.alias.to_string(),
                slave.switch.map_or(String::new(), |switch| switch.to_string()),
                al_state(slave.state.al_status),
                slave
                    .drive
                    .as_ref()
                    .map_or(String::new(), |drive| drive.state.to_owned()),
            ]
        })
        .collect();
    let heading = [
        "slave", "name", "vendor", "product", "revision", "serial", "alias", "switch", "state", "drive",
    ];
    table::print(heading, &rows)?;
    for slave in &view.slaves {
        if slave.state.al_error {
            let code = al_code(slave.state.al_status_code);
            table::say(&format!("slave {}: AL status code {code}", slave.slave))?;
        }
    }
    if view.answering != u16::try_from(view.slaves.len()).unwrap_or(u16::MAX) {
        table::say(&format!(
            "slaves that answer: {}; known are {}",
            view.answering,
            view.slaves.len()
        ))?;
    }
    Ok(())
}

/// `bus info [N]`.
pub(super) fn info(access: &mut dyn BusAccess, only: Option<u8>, json: bool) -> Result<(), ProgramError> {
    let mut view = read(access, only)?;
    for slave in &mut view.slaves {
        slave.read_process_data(access)?;
    }
    if json {
        return print_json(&view);
    }
    for slave in &view.slaves {
        describe(slave)?;
    }
    Ok(())
}

/// Prints one slave as text.
fn describe(slave: &SlaveView) -> Result<(), ProgramError> {
    table::say(&format!("slave {}: {}", slave.slave, slave.name))?;
    let line = |what: &str, value: String| table::say(&format!("  {what:<16} {value}"));
    let identity = format!(
        "vendor {:08x}, product {:08x}, revision {:x}, serial {}",
        slave.vendor, slave.product, slave.revision, slave.serial
    );
    line("identity", identity)?;
    line(
        "driver",
        if slave.driver.is_empty() {
            "none".into()
        } else {
            slave.driver.clone()
        },
    )?;
    line("address", format!("{:#06x}, alias {}", slave.station, slave.alias))?;
    if let Some(switch) = slave.switch {
        line("switches", switch.to_string())?;
    }
    if let Some(axis) = slave.axis {
        line("axis", axis.to_string())?;
    }
    line("state", al_state(slave.state.al_status))?;
    if slave.state.al_status_code != 0 {
        line("AL status code", al_code(slave.state.al_status_code))?;
    }
    if let Some(drive) = &slave.drive {
        let hint = if drive.hint.is_empty() {
            String::new()
        } else {
            format!("; {}", drive.hint)
        };
        line(
            "drive",
            format!("{} (status word {:#06x}){hint}", drive.state, drive.status_word),
        )?;
    }
    let window = |[start, length]: [u16; 2]| format!("{start:#06x}, {length} bytes");
    if slave.mailbox_out[1] == 0 {
        line("mailbox", "none".into())?;
    } else {
        line("mailbox out", window(slave.mailbox_out))?;
        line("mailbox in", window(slave.mailbox_in))?;
        line("protocols", slave.protocols.join(", "))?;
    }
    line(
        "process data",
        format!("{} bytes out, {} in", slave.output_bytes, slave.input_bytes),
    )?;
    slave.pdos.iter().try_for_each(describe_pdo)?;
    if let Some(clock) = &slave.clock {
        line(
            "clock",
            format!(
                "{} bits, delay {} ns, difference {} ns",
                clock.bits, clock.delay_ns, clock.difference_ns
            ),
        )?;
    }
    for port in slave.ports.iter().filter(|port| port.link || port.communicates) {
        let partner = match port.partner {
            Some(partner) => format!("slave {partner}"),
            None if port.port == 0 => "the master's side".into(),
            None => "unknown".into(),
        };
        line(&format!("port {}", port.port), format!("linked to {partner}"))?;
    }
    Ok(())
}

/// Prints a process data object and its entries.
fn describe_pdo(pdo: &PdoView) -> Result<(), ProgramError> {
    let bits: u32 = pdo.entries.iter().map(|entry| u32::from(entry.bits)).sum();
    let named = |what: String, name: &str| format!("{what} {name}").trim_end().to_owned();
    let head = format!(
        "  PDO {:04x}         {}, sync manager {}, {bits} bits, by {}",
        pdo.index, pdo.direction, pdo.sync_manager, pdo.source
    );
    table::say(&named(head, &pdo.name))?;
    for entry in &pdo.entries {
        let object = match entry.index {
            0 => "gap".to_owned(),
            index => format!("{index:04x}:{}", entry.sub),
        };
        table::say(&named(format!("    {object:<14} {:>3} bits", entry.bits), &entry.name))?;
    }
    Ok(())
}

/// What `bus state` prints as JSON.
#[derive(Debug, Serialize)]
struct Reached {
    slave: u8,
    #[serde(flatten)]
    state: AlStatusView,
}

/// `bus state N STATE`.
pub(super) fn state(access: &mut dyn BusAccess, slave: u8, target: AlState, json: bool) -> Result<(), ProgramError> {
    let report = access::set_state(access, slave, target)?;
    if json {
        print_json(&Reached {
            slave,
            state: AlStatusView::new(report),
        })?;
    } else {
        table::say(&format!("slave {slave}: {}", al_state(report.status)))?;
    }
    require_state(slave, target, report)
}

/// What `bus watch` prints as JSON for a change.
#[derive(Debug, Serialize)]
struct Change<'a> {
    t_ms: u64,
    slave: u8,
    /// `None` if the slave does not answer.
    seen: Option<&'a SlaveState>,
}

/// `bus watch`: prints the state of every slave, then every change, until interrupted or until nobody reads them.
pub(super) fn watch(access: &mut dyn BusAccess, json: bool, ended: &AtomicBool) -> Result<(), ProgramError> {
    let begun = Instant::now();
    let mut watch = Watch::default();
    let mut has_reader = true;
    while has_reader && !ended.load(Ordering::Relaxed) {
        watch.poll(access, &mut |slave, seen| {
            has_reader &= tell(begun, slave, seen, json)?;
            Ok(())
        })?;
        std::thread::sleep(LOOK);
    }
    Ok(())
}

/// Prints a change; returns whether stdout still has a reader.
fn tell(begun: Instant, slave: u8, seen: Option<&SlaveState>, json: bool) -> Result<bool, ProgramError> {
    let t_ms = u64::try_from(begun.elapsed().as_millis()).unwrap_or(u64::MAX);
    if json {
        let line = serde_json::to_string(&Change { t_ms, slave, seen });
        return table::heard(&line.map_err(|cause| ProgramError::failed("the change", cause))?);
    }
    let what = match seen {
        None => "does not answer; check its cable and supply".to_owned(),
        Some(SlaveState { state, drive }) => {
            let code = match state.al_status_code {
                0 => String::new(),
                number => format!(", AL status code {}", al_code(number)),
            };
            let drive = drive
                .as_ref()
                .map_or(String::new(), |drive| format!(", drive: {}", drive.state));
            format!("{}{drive}{code}", al_state(state.al_status))
        }
    };
    table::heard(&format!("{:>9.3} s  slave {slave}  {what}", t_ms as f64 / 1000.0))
}
