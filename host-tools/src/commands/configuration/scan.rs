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

/// Reads all slaves. One of an unknown product in INIT is asked for its device type, for which it is brought to PREOP, and back.
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
    let told = told.map_err(unknown)?;
    back.map(|()| told)
}

/// Whether a slave with objects says that it is a drive. One without the object is none.
fn asked(access: &mut dyn BusAccess, slave: u8) -> Result<bool, ProgramError> {
    match access::upload(access, slave, DEVICE_TYPE, false) {
        Ok(bytes) => {
            let told = bytes.first_chunk().copied().map(u32::from_le_bytes);
            Ok(told.and_then(drive_kind_by_type).is_some())
        }
        Err(AccessError::Refused(ServiceError::Bus(BusError::SdoAbort { .. }))) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

fn reach(access: &mut dyn BusAccess, slave: u8, state: AlState) -> Result<(), ProgramError> {
    let report = access::set_state(access, slave, state)?;
    slaves::require_state(slave, state, report)
}
