//! The slaves of a bus as a new configuration needs them.

use crate::bus::access::{self, AccessError, BusAccess};
use crate::bus::slaves::{self, SlaveView};
use crate::error::ProgramError;
use crate::settings::starting::Found;
use etherpen::drives::drive_kind_by_type;
use etherpen::ethercat::state::AlState;
use etherpen::ethercat::wire::coe::Object;

/// The object in which a slave tells its device type.
const DEVICE_TYPE: Object = Object { index: 0x1000, sub: 0 };

/// Reads all slaves. One of an unknown product is asked for its device type, for which it has to be in PREOP at least; it is brought
/// back to INIT if it was there.
///
/// # Errors
/// The bus refused a request or was lost.
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
    if !slave.has_objects() && !accepted(access::set_state(access, number, AlState::PreOperational))? {
        return Ok(false);
    }
    let told = match access::upload(access, number, DEVICE_TYPE, false) {
        Ok(bytes) => bytes.first_chunk().copied().map(u32::from_le_bytes),
        Err(AccessError::Lost(error)) => return Err(error),
        Err(_) => None,
    };
    if !slave.has_objects() {
        accepted(access::set_state(access, number, AlState::Init))?;
    }
    Ok(told.and_then(drive_kind_by_type).is_some())
}

/// Whether the slave did what was asked; a bus that is lost is an error.
fn accepted<T>(answer: Result<T, AccessError>) -> Result<bool, ProgramError> {
    match answer {
        Err(AccessError::Lost(error)) => Err(error),
        answer => Ok(answer.is_ok()),
    }
}
