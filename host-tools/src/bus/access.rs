//! Requests to a bus, independent of the master that carries them out.
//!
//! Callers count slaves from 1; the requests count them from 0.

use crate::error::{ProgramError, code};
use crate::link::text;
use etherpen::ethercat::diagnostics::{
    BusInfo, EntryInfo, INDICES_MAX, ObjectInfo, PIECE_BYTES_MAX, Piece, ServiceError, ServiceReply, ServiceRequest,
    SlaveErrors, SlaveInfo,
};
use etherpen::ethercat::state::{AlReport, AlState};
use etherpen::ethercat::wire::coe::Object;

/// Most pieces of a value: one more than the protocol's lengths allow.
const PIECES_MAX: usize = u16::MAX as usize / PIECE_BYTES_MAX + 1;

/// Carries out requests to a bus.
pub(crate) trait BusAccess {
    /// Sends a request and waits for its answer.
    ///
    /// # Errors
    /// The bus refused the request, or was lost.
    fn request(&mut self, request: ServiceRequest) -> Result<ServiceReply, AccessError>;
}

/// Why there is no answer.
#[derive(Debug)]
pub(crate) enum AccessError {
    /// The bus or a slave refused the request.
    Refused(ServiceError),
    /// The request did not reach the bus.
    Lost(ProgramError),
    /// The answer belongs to another request.
    Foreign,
}

impl From<AccessError> for ProgramError {
    fn from(error: AccessError) -> Self {
        match error {
            AccessError::Refused(error) => Self::new(code::FAILED, text::bus::service_error(&error)),
            AccessError::Lost(error) => error,
            AccessError::Foreign => Self::new(
                code::FAILED,
                "the answer belongs to another question; program and firmware differ: use those of one version",
            ),
        }
    }
}

/// The number of a slave in requests.
fn zero(slave: u8) -> u8 {
    slave.saturating_sub(1)
}

/// Information about the complete bus.
pub(crate) fn bus(access: &mut dyn BusAccess) -> Result<BusInfo, AccessError> {
    match access.request(ServiceRequest::Bus)? {
        ServiceReply::Bus(info) => Ok(info),
        _ => Err(AccessError::Foreign),
    }
}

/// Information about one slave.
pub(crate) fn slave(access: &mut dyn BusAccess, slave: u8) -> Result<SlaveInfo, AccessError> {
    match access.request(ServiceRequest::Slave { slave: zero(slave) })? {
        ServiceReply::Slave(info) => Ok(info),
        _ => Err(AccessError::Foreign),
    }
}

/// Brings a slave to a state; returns the actual state.
pub(crate) fn set_state(access: &mut dyn BusAccess, slave: u8, state: AlState) -> Result<AlReport, AccessError> {
    let request = ServiceRequest::SetState {
        slave: zero(slave),
        state,
    };
    match access.request(request)? {
        ServiceReply::State(report) => Ok(report),
        _ => Err(AccessError::Foreign),
    }
}

/// Collects a value from its pieces.
fn collect(access: &mut dyn BusAccess, request: impl Fn(u16) -> ServiceRequest) -> Result<Vec<u8>, AccessError> {
    let mut value = Vec::new();
    for _ in 0..PIECES_MAX {
        let offset = u16::try_from(value.len()).map_err(|_| AccessError::Foreign)?;
        let ServiceReply::Piece { total, piece } = access.request(request(offset))? else {
            return Err(AccessError::Foreign);
        };
        value.extend_from_slice(&piece);
        if value.len() >= usize::from(total) || piece.is_empty() {
            break;
        }
    }
    Ok(value)
}

/// Reads an object.
pub(crate) fn upload(
    access: &mut dyn BusAccess,
    slave: u8,
    object: Object,
    complete: bool,
) -> Result<Vec<u8>, AccessError> {
    collect(access, |offset| ServiceRequest::Upload {
        slave: zero(slave),
        object,
        complete,
        offset,
    })
}

/// Writes an object.
pub(crate) fn download(
    access: &mut dyn BusAccess,
    slave: u8,
    object: Object,
    complete: bool,
    value: &[u8],
) -> Result<(), AccessError> {
    let total = u16::try_from(value.len()).map_err(|_| AccessError::Refused(ServiceError::Piece { room: u16::MAX }))?;
    let mut offset = 0;
    let empty: &[u8] = &[];
    let pieces = value.chunks(PIECE_BYTES_MAX).chain(value.is_empty().then_some(empty));
    for part in pieces {
        let request = ServiceRequest::Download {
            slave: zero(slave),
            object,
            complete,
            total,
            offset,
            piece: Piece::from_slice(part).unwrap_or_default(),
        };
        match access.request(request)? {
            ServiceReply::Done => {}
            _ => return Err(AccessError::Foreign),
        }
        offset = offset.saturating_add(part.len() as u16);
    }
    Ok(())
}

/// The indices of a slave's dictionary.
pub(crate) fn indices(access: &mut dyn BusAccess, slave: u8) -> Result<Vec<u16>, AccessError> {
    let mut found = Vec::new();
    for _ in 0..usize::from(u16::MAX) / INDICES_MAX + 1 {
        let first = u16::try_from(found.len()).map_err(|_| AccessError::Foreign)?;
        let request = ServiceRequest::Objects {
            slave: zero(slave),
            first,
        };
        let ServiceReply::Objects { total, indices } = access.request(request)? else {
            return Err(AccessError::Foreign);
        };
        found.extend_from_slice(&indices);
        if found.len() >= usize::from(total) || indices.is_empty() {
            break;
        }
    }
    Ok(found)
}

/// The description of an object.
pub(crate) fn describe_object(access: &mut dyn BusAccess, slave: u8, index: u16) -> Result<ObjectInfo, AccessError> {
    let request = ServiceRequest::DescribeObject {
        slave: zero(slave),
        index,
    };
    match access.request(request)? {
        ServiceReply::Object(info) => Ok(info),
        _ => Err(AccessError::Foreign),
    }
}

/// The description of an entry of an object.
pub(crate) fn describe_entry(access: &mut dyn BusAccess, slave: u8, object: Object) -> Result<EntryInfo, AccessError> {
    let request = ServiceRequest::DescribeEntry {
        slave: zero(slave),
        object,
    };
    match access.request(request)? {
        ServiceReply::Entry(info) => Ok(info),
        _ => Err(AccessError::Foreign),
    }
}

/// Registers or memory of a slave controller.
pub(crate) fn registers(
    access: &mut dyn BusAccess,
    slave: u8,
    address: u16,
    length: u16,
) -> Result<Vec<u8>, AccessError> {
    let mut memory = Vec::new();
    let mut left = length;
    while left > 0 {
        let request = ServiceRequest::Registers {
            slave: zero(slave),
            address: address.saturating_add(length - left),
            length: left.min(PIECE_BYTES_MAX as u16),
        };
        let ServiceReply::Piece { piece, .. } = access.request(request)? else {
            return Err(AccessError::Foreign);
        };
        let read = u16::try_from(piece.len()).unwrap_or(left).min(left);
        if read == 0 {
            break;
        }
        memory.extend_from_slice(&piece);
        left -= read;
    }
    Ok(memory)
}

/// A part of a slave's information memory (SII): up to `length` bytes from this word.
pub(crate) fn information(access: &mut dyn BusAccess, slave: u8, word: u16, length: u16) -> Result<Piece, AccessError> {
    let request = ServiceRequest::Information {
        slave: zero(slave),
        word,
        length,
    };
    match access.request(request)? {
        ServiceReply::Piece { piece, .. } => Ok(piece),
        _ => Err(AccessError::Foreign),
    }
}

/// The error counters of a slave.
pub(crate) fn errors(access: &mut dyn BusAccess, slave: u8) -> Result<SlaveErrors, AccessError> {
    match access.request(ServiceRequest::Errors { slave: zero(slave) })? {
        ServiceReply::Errors(errors) => Ok(errors),
        _ => Err(AccessError::Foreign),
    }
}

/// Resets the error counters of all slaves to 0.
pub(crate) fn clear_errors(access: &mut dyn BusAccess) -> Result<(), AccessError> {
    match access.request(ServiceRequest::ClearErrors)? {
        ServiceReply::Done => Ok(()),
        _ => Err(AccessError::Foreign),
    }
}
