//! Slaves and their states.

use super::access::{self, AccessError, BusAccess};
use super::process_data::{self, PdoView};
use crate::error::{ProgramError, code};
use crate::link::text;
use etherpen::ethercat::diagnostics::{ServiceError, SlaveInfo};
use etherpen::ethercat::state::{AlReport, AlState, al_code_hint, al_code_text};
use serde::Serialize;

/// The mailbox protocols by their bits in the SII.
const PROTOCOLS: [(u16, &str); 6] = [
    (1 << 0, "AoE"),
    (1 << 1, "EoE"),
    (1 << 2, "CoE"),
    (1 << 3, "FoE"),
    (1 << 4, "SoE"),
    (1 << 5, "VoE"),
];

/// AL status of a slave, with its texts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct AlStatusView {
    pub(crate) al_status: u8,
    pub(crate) al_state: String,
    pub(crate) al_error: bool,
    pub(crate) al_status_code: u16,
    pub(crate) al_status_text: &'static str,
    pub(crate) al_status_hint: &'static str,
}

impl AlStatusView {
    /// Texts are empty for a state without an error.
    pub(crate) fn new(report: AlReport) -> Self {
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

/// One port of a slave.
#[derive(Debug, Serialize)]
pub(crate) struct PortView {
    pub(crate) port: usize,
    pub(crate) link: bool,
    pub(crate) loop_closed: bool,
    pub(crate) communicates: bool,
    /// Slave at the other end of the cable, from 1.
    pub(crate) partner: Option<u16>,
}

/// CiA 402 state of a drive, with what to try.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct DriveView {
    pub(crate) status_word: u16,
    pub(crate) state: &'static str,
    pub(crate) hint: &'static str,
}

impl DriveView {
    fn new(status_word: u16) -> Self {
        Self {
            status_word,
            state: text::bus::drive_state(status_word),
            hint: text::bus::drive_hint(status_word),
        }
    }
}

/// Identity, state and wiring of a slave.
#[derive(Debug, Serialize)]
pub(crate) struct SlaveView {
    /// Place in the chain, from 1.
    pub(crate) slave: u8,
    pub(crate) name: String,
    pub(crate) driver: String,
    pub(crate) vendor: u32,
    pub(crate) product: u32,
    pub(crate) revision: u32,
    pub(crate) serial: u32,
    pub(crate) station: u16,
    pub(crate) alias: u16,
    /// Number of its identification switches, if it has such.
    pub(crate) switch: Option<u16>,
    /// Axis of the robot that the slave drives, from 1.
    pub(crate) axis: Option<u16>,
    #[serde(flatten)]
    pub(crate) state: AlStatusView,
    pub(crate) drive: Option<DriveView>,
    /// Address and length of the mailbox, bytes.
    pub(crate) mailbox_out: [u16; 2],
    /// Address and length of the mailbox, bytes.
    pub(crate) mailbox_in: [u16; 2],
    pub(crate) protocols: Vec<&'static str>,
    pub(crate) output_bytes: u16,
    pub(crate) input_bytes: u16,
    /// Process data objects of a slave without a driver, where they were asked for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) pdos: Vec<PdoView>,
    pub(crate) ports: Vec<PortView>,
    pub(crate) clock: Option<ClockView>,
}

/// Distributed clock of a slave.
#[derive(Debug, Serialize)]
pub(crate) struct ClockView {
    pub(crate) bits: u8,
    pub(crate) delay_ns: u32,
    pub(crate) difference_ns: i32,
}

impl SlaveView {
    fn new(slave: u8, info: &SlaveInfo) -> Self {
        let known = PROTOCOLS.iter().filter(|(bit, _)| info.protocols & bit != 0);
        let ports = info.ports.iter().enumerate().map(|(port, state)| PortView {
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
            switch: info.switch,
            axis: info.member.map(|axis| u16::from(axis) + 1),
            state: AlStatusView::new(info.report),
            drive: info.status_word.map(DriveView::new),
            mailbox_out: [info.mailbox_out.start, info.mailbox_out.length],
            mailbox_in: [info.mailbox_in.start, info.mailbox_in.length],
            protocols: known.map(|(_, name)| *name).collect(),
            output_bytes: info.output_bytes,
            input_bytes: info.input_bytes,
            pdos: Vec::new(),
            ports: ports.collect(),
            clock: info.clock.map(|clock| ClockView {
                bits: if clock.is_64_bit { 64 } else { 32 },
                delay_ns: clock.delay_ns,
                difference_ns: clock.difference_ns,
            }),
        }
    }
}

impl SlaveView {
    /// Whether the slave answers SDOs in its present state.
    pub(crate) fn has_objects(&self) -> bool {
        let states = [AlState::PreOperational, AlState::SafeOperational, AlState::Operational];
        let is_in = |state: AlState| self.state.al_status & 0x0F == state as u8;
        self.protocols.contains(&"CoE") && states.into_iter().any(is_in)
    }

    /// Reads the process data objects of a slave without a driver.
    ///
    /// # Errors
    /// As [`process_data::read`].
    pub(crate) fn read_process_data(&mut self, access: &mut dyn BusAccess) -> Result<(), ProgramError> {
        if self.driver.is_empty() {
            self.pdos = process_data::read(access, self.slave, self.has_objects())?;
        }
        Ok(())
    }
}

/// A bus with its slaves.
#[derive(Debug, Serialize)]
pub(crate) struct BusView {
    /// Slaves that answer.
    pub(crate) answering: u16,
    pub(crate) operational: bool,
    /// Slave whose clock is the reference, from 1.
    pub(crate) reference_clock: Option<u16>,
    pub(crate) slaves: Vec<SlaveView>,
}

/// Reads one slave, or all.
///
/// # Errors
/// The bus refused a request or was lost.
pub(crate) fn read(access: &mut dyn BusAccess, only: Option<u8>) -> Result<BusView, ProgramError> {
    let bus = access::bus(access)?;
    let mut slaves = Vec::new();
    for slave in only.map_or(1..=bus.slaves, |slave| slave..=slave) {
        slaves.push(SlaveView::new(slave, &access::slave(access, slave)?));
    }
    Ok(BusView {
        answering: bus.answering,
        operational: bus.operational,
        reference_clock: bus.reference_clock.map(|slave| u16::from(slave) + 1),
        slaves,
    })
}

/// Checks that a slave reached the requested state.
///
/// # Errors
/// The slave is in another state; the message has its AL status code and what to try.
pub(crate) fn require_state(slave: u8, target: AlState, report: AlReport) -> Result<(), ProgramError> {
    if report.is(target) {
        return Ok(());
    }
    Err(ProgramError::new(
        code::FAILED,
        format!(
            "slave {slave} is in {}, not in {}: {}",
            text::bus::al_state(report.status),
            target.name(),
            text::bus::al_code(report.code)
        ),
    ))
}

/// State of a slave that answers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct SlaveState {
    #[serde(flatten)]
    pub(crate) state: AlStatusView,
    pub(crate) drive: Option<DriveView>,
}

/// Takes a change: the slave from 1, and its state unless it does not answer.
pub(crate) type TellChange<'a> = dyn FnMut(u8, Option<&SlaveState>) -> Result<(), ProgramError> + 'a;

/// Detects changes of the slaves' states.
#[derive(Debug, Default)]
pub(crate) struct Watch {
    /// Last known state of every slave; `None` for a slave that does not answer.
    known: Vec<Option<SlaveState>>,
}

impl Watch {
    /// Reads all slaves and passes each change to `tell`.
    ///
    /// # Errors
    /// The bus refused a request or was lost; errors of `tell`.
    pub(crate) fn poll(&mut self, access: &mut dyn BusAccess, tell: &mut TellChange<'_>) -> Result<(), ProgramError> {
        let slaves = access::bus(access)?.slaves;
        for slave in 1..=slaves.max(u8::try_from(self.known.len()).unwrap_or(u8::MAX)) {
            let state = match access::slave(access, slave) {
                Ok(info) => Some(SlaveState {
                    state: AlStatusView::new(info.report),
                    drive: info.status_word.map(DriveView::new),
                }),
                Err(AccessError::Refused(ServiceError::Bus(_) | ServiceError::NoSlave { .. })) => None,
                Err(error) => return Err(error.into()),
            };
            let place = usize::from(slave - 1);
            if self.known.get(place) != Some(&state) {
                tell(slave, state.as_ref())?;
            }
            match self.known.get_mut(place) {
                Some(before) => *before = state,
                None => self.known.push(state),
            }
        }
        Ok(())
    }
}
