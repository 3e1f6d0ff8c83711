//! The slaves and their states: scan, info, state, watch.

use super::access::{self, BusAccess};
use super::{table, text};
use crate::commands::print_json;
use crate::error::{ProgramError, code};
use crate::link::text::al_state;
use etherpen::ethercat::diagnostics::{ServiceError, SlaveInfo};
use etherpen::ethercat::state::{AlReport, AlState, al_code_hint, al_code_text};
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Time between two checks of `watch`.
const LOOK: Duration = Duration::from_millis(100);

/// The mailbox protocols by their bits in the SII.
const PROTOCOLS: [(u16, &str); 6] = [
    (1 << 0, "AoE"),
    (1 << 1, "EoE"),
    (1 << 2, "CoE"),
    (1 << 3, "FoE"),
    (1 << 4, "SoE"),
    (1 << 5, "VoE"),
];

/// AL status for a program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct StateView {
    al_status: u8,
    al_state: String,
    al_error: bool,
    al_status_code: u16,
    al_status_text: &'static str,
    al_status_hint: &'static str,
}

impl StateView {
    /// A report with its texts; an error-free state has none.
    pub(super) fn new(report: AlReport) -> Self {
        let told = report.code != 0 || report.is_error();
        Self {
            al_status: report.status,
            al_state: report.state().map_or("unknown", AlState::name).to_owned(),
            al_error: report.is_error(),
            al_status_code: report.code,
            al_status_text: if told { al_code_text(report.code) } else { "" },
            al_status_hint: if told { al_code_hint(report.code) } else { "" },
        }
    }
}

/// One port for a program.
#[derive(Debug, Serialize)]
struct PortAnswer {
    port: usize,
    link: bool,
    loop_closed: bool,
    communicates: bool,
    partner: Option<u16>,
}

/// A drive for a program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
struct DriveView {
    status_word: u16,
    state: &'static str,
    hint: &'static str,
}

impl DriveView {
    fn new(status_word: u16) -> Self {
        Self {
            status_word,
            state: text::drive_state(status_word),
            hint: text::drive_hint(status_word),
        }
    }
}

/// A slave for a program.
#[derive(Debug, Serialize)]
struct SlaveAnswer {
    slave: u8,
    name: String,
    driver: String,
    vendor: u32,
    product: u32,
    revision: u32,
    serial: u32,
    station: u16,
    alias: u16,
    axis: Option<u16>,
    #[serde(flatten)]
    state: StateView,
    drive: Option<DriveView>,
    mailbox_out: [u16; 2],
    mailbox_in: [u16; 2],
    protocols: Vec<&'static str>,
    output_bytes: u16,
    input_bytes: u16,
    ports: Vec<PortAnswer>,
    clock: Option<ClockView>,
}

/// A clock for a program.
#[derive(Debug, Serialize)]
struct ClockView {
    bits: u8,
    delay_ns: u32,
    difference_ns: i32,
}

impl SlaveAnswer {
    fn new(slave: u8, info: &SlaveInfo) -> Self {
        let known = PROTOCOLS.iter().filter(|(bit, _)| info.protocols & bit != 0);
        let ports = info.ports.iter().enumerate().map(|(port, state)| PortAnswer {
            port,
            link: state.link,
            loop_closed: state.loop_closed,
            communicates: state.communicates,
            partner: state.partner.map(|partner| u16::from(partner) + 1),
        });
        Self {
            slave,
            name: info.name.as_str().to_owned(),
            driver: info.driver.as_str().to_owned(),
            vendor: info.identity.vendor,
            product: info.identity.product,
            revision: info.identity.revision,
            serial: info.identity.serial,
            station: info.station,
            alias: info.alias,
            axis: info.member.map(|axis| u16::from(axis) + 1),
            state: StateView::new(info.report),
            drive: info.status_word.map(DriveView::new),
            mailbox_out: [info.mailbox_out.start, info.mailbox_out.length],
            mailbox_in: [info.mailbox_in.start, info.mailbox_in.length],
            protocols: known.map(|(_, name)| *name).collect(),
            output_bytes: info.output_bytes,
            input_bytes: info.input_bytes,
            ports: ports.collect(),
            clock: info.clock.map(|clock| ClockView {
                bits: if clock.is_64_bit { 64 } else { 32 },
                delay_ns: clock.delay_ns,
                difference_ns: clock.difference_ns,
            }),
        }
    }
}

/// The bus for a program.
#[derive(Debug, Serialize)]
struct BusAnswer {
    answering: u16,
    operational: bool,
    reference_clock: Option<u16>,
    slaves: Vec<SlaveAnswer>,
}

/// All slaves, or one.
fn read(access: &mut dyn BusAccess, only: Option<u8>) -> Result<(BusAnswer, Vec<SlaveInfo>), ProgramError> {
    let bus = access::bus(access)?;
    let mut infos = Vec::new();
    let wanted = only.map_or(1..=bus.slaves, |slave| slave..=slave);
    for slave in wanted.clone() {
        infos.push(access::slave(access, slave)?);
    }
    let view = BusAnswer {
        answering: bus.answering,
        operational: bus.operational,
        reference_clock: bus.reference_clock.map(|slave| u16::from(slave) + 1),
        slaves: wanted
            .zip(&infos)
            .map(|(slave, info)| SlaveAnswer::new(slave, info))
            .collect(),
    };
    Ok((view, infos))
}

/// `bus scan`.
pub(super) fn scan(access: &mut dyn BusAccess, json: bool) -> Result<(), ProgramError> {
    let (view, _) = read(access, None)?;
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
                al_state(slave.state.al_status),
                slave
                    .drive
                    .as_ref()
                    .map_or(String::new(), |drive| drive.state.to_owned()),
            ]
        })
        .collect();
    let heading = [
        "slave", "name", "vendor", "product", "revision", "serial", "state", "drive",
    ];
    table::print(heading, &rows)?;
    for slave in &view.slaves {
        if slave.state.al_error {
            let code = text::al_code(slave.state.al_status_code);
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
    let (view, _) = read(access, only)?;
    if json {
        return print_json(&view);
    }
    for slave in &view.slaves {
        describe(slave)?;
    }
    Ok(())
}

/// Prints one slave as text.
fn describe(slave: &SlaveAnswer) -> Result<(), ProgramError> {
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
    if let Some(axis) = slave.axis {
        line("axis", axis.to_string())?;
    }
    line("state", al_state(slave.state.al_status))?;
    if slave.state.al_status_code != 0 {
        line("AL status code", text::al_code(slave.state.al_status_code))?;
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

/// Where `bus state` ended.
#[derive(Debug, Serialize)]
struct Reached {
    slave: u8,
    #[serde(flatten)]
    state: StateView,
}

/// `bus state N STATE`.
pub(super) fn state(access: &mut dyn BusAccess, slave: u8, target: AlState, json: bool) -> Result<(), ProgramError> {
    let report = access::set_state(access, slave, target)?;
    if json {
        print_json(&Reached {
            slave,
            state: StateView::new(report),
        })?;
    } else {
        table::say(&format!("slave {slave}: {}", al_state(report.status)))?;
    }
    if report.is(target) {
        return Ok(());
    }
    Err(ProgramError::new(
        code::FAILED,
        format!(
            "slave {slave} is in {}, not in {}: {}",
            al_state(report.status),
            target.name(),
            text::al_code(report.code)
        ),
    ))
}

/// A slave as `watch` sees it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
struct Seen {
    #[serde(flatten)]
    state: StateView,
    drive: Option<DriveView>,
}

/// A change that `watch` tells.
#[derive(Debug, Serialize)]
struct Change<'a> {
    t_ms: u64,
    slave: u8,
    /// Nothing when the slave does not answer.
    seen: Option<&'a Seen>,
}

/// `bus watch`: prints the state of every slave, then every change, until interrupted.
pub(super) fn watch(access: &mut dyn BusAccess, json: bool, ended: &AtomicBool) -> Result<(), ProgramError> {
    let begun = Instant::now();
    let mut known: Vec<Option<Seen>> = Vec::new();
    while !ended.load(Ordering::Relaxed) {
        let slaves = access::bus(access)?.slaves;
        for slave in 1..=slaves.max(u8::try_from(known.len()).unwrap_or(u8::MAX)) {
            let seen = match access::slave(access, slave) {
                Ok(info) => Some(Seen {
                    state: StateView::new(info.report),
                    drive: info.status_word.map(DriveView::new),
                }),
                Err(access::AccessError::Refused(ServiceError::Bus(_) | ServiceError::NoSlave { .. })) => None,
                Err(error) => return Err(error.into()),
            };
            let place = usize::from(slave - 1);
            if known.get(place) != Some(&seen) {
                tell(begun, slave, seen.as_ref(), json)?;
            }
            match known.get_mut(place) {
                Some(before) => *before = seen,
                None => known.push(seen),
            }
        }
        std::thread::sleep(LOOK);
    }
    Ok(())
}

fn tell(begun: Instant, slave: u8, seen: Option<&Seen>, json: bool) -> Result<(), ProgramError> {
    let t_ms = u64::try_from(begun.elapsed().as_millis()).unwrap_or(u64::MAX);
    if json {
        let line = serde_json::to_string(&Change { t_ms, slave, seen });
        return table::say(&line.map_err(|cause| ProgramError::failed("the change", cause))?);
    }
    let what = match seen {
        None => "does not answer; check its cable and supply".to_owned(),
        Some(Seen { state, drive }) => {
            let code = match state.al_status_code {
                0 => String::new(),
                number => format!(", AL status code {}", text::al_code(number)),
            };
            let drive = drive
                .as_ref()
                .map_or(String::new(), |drive| format!(", drive: {}", drive.state));
            format!("{}{drive}{code}", al_state(state.al_status))
        }
    };
    table::say(&format!("{:>9.3} s  slave {slave}  {what}", t_ms as f64 / 1000.0))
}
