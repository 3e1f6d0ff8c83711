//! The slaves of a bus as a new configuration needs them.

use crate::bus::access::{self, AccessError, BusAccess};
use crate::bus::slaves::{self, SlaveView};
use crate::error::{ProgramError, code};
use crate::link::text::bus::al_state;
use crate::settings::starting::Found;
use etherpen::drives::drive_kind_by_type;
use etherpen::ethercat::diagnostics::ServiceError;
use etherpen::ethercat::error::BusError;
use etherpen::ethercat::state::AlState;
use etherpen::ethercat::wire::coe::Object;

/// The object in which a slave tells its device type.
const DEVICE_TYPE: Object = Object { index: 0x1000, sub: 0 };

/// Abort codes of a slave without the object: it does not exist, or its sub-index does not (ETG.1000.6).
const NO_OBJECT: [u32; 2] = [0x0602_0000, 0x0609_0011];

/// Reads all slaves. One of an unknown product in INIT is asked for its device type, for which it is brought to PREOP, and back; one in a higher
/// state where it is.
///
/// # Errors
/// The bus refused a request or was lost; a slave could not be asked.
pub(super) fn chain(access: &mut dyn BusAccess) -> Result<Vec<Found>, ProgramError> {
    let view = slaves::read(access, None)?;
    let found = |slave: SlaveView| {
        Ok(Found {
            is_drive: is_drive(access, &slave)?,
            vendor: slave.vendor,
            product: slave.product,
            serial: slave.serial,
            alias: slave.alias,
            switch: slave.switch.unwrap_or(0),
            name: slave.name,
        })
    };
    view.slaves.into_iter().map(found).collect()
}

fn is_drive(access: &mut dyn BusAccess, slave: &SlaveView) -> Result<bool, ProgramError> {
    if !slave.driver.is_empty() || slave.drive.is_some() {
        return Ok(true);
    }
    if !slave.protocols.contains(&"CoE") {
        return Ok(false);
    }
    let number = slave.slave;
    let unknown = |cause: ProgramError| {
        let text = format!(
            "slave {number} ({}) does not tell whether it is a drive: {}; nothing was written",
            slave.name, cause.message
        );
        ProgramError::new(cause.code, text)
    };
    if slave.has_objects() {
        return asked(access, number).map_err(unknown);
    }
    if slave.state.al_status & 0x0F != AlState::Init as u8 {
        let state = al_state(slave.state.al_status);
        return Err(unknown(ProgramError::new(code::FAILED, format!("it is in {state}"))));
    }
    let reached = reach(access, number, AlState::PreOperational);
    let told = reached.and_then(|()| asked(access, number));
    // Also where it has not told.
    let back = reach(access, number, AlState::Init);
    match (told, back) {
        (told, Ok(())) => told.map_err(unknown),
        (told, Err(back)) => {
            let cause = told
                .err()
                .map_or_else(String::new, |cause| format!("{}; ", cause.message));
            let text = format!("{cause}it does not go back to INIT: {}", back.message);
            Err(unknown(ProgramError::new(back.code, text)))
        }
    }
}

/// Whether a slave with objects says that it is a drive. One without the object is none.
fn asked(access: &mut dyn BusAccess, slave: u8) -> Result<bool, ProgramError> {
    match access::upload(access, slave, DEVICE_TYPE, false) {
        Ok(bytes) => {
            let told = bytes.first_chunk().copied().map(u32::from_le_bytes);
            let told = told.ok_or_else(|| ProgramError::new(code::FAILED, "its device type is too short"))?;
            Ok(drive_kind_by_type(told).is_some())
        }
        Err(AccessError::Refused(ServiceError::Bus(BusError::SdoAbort { code, .. }))) if NO_OBJECT.contains(&code) => {
            Ok(false)
        }
        Err(error) => Err(error.into()),
    }
}

fn reach(access: &mut dyn BusAccess, slave: u8, state: AlState) -> Result<(), ProgramError> {
    let report = access::set_state(access, slave, state)?;
    slaves::require_state(slave, state, report)
}
