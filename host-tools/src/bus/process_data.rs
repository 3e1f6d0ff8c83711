//! What a slave without a driver exchanges: its process data objects and their entries.
//!
//! A slave with CoE in PREOP or above lists them itself (0x1C10 and above, 0x1600 and above, 0x1A00 and above); what it does
//! not list, and all of a slave without CoE, is in its information memory (ETG.2010, categories 50 and 51). Nothing is
//! written, and no state is changed.

use super::access::{self, AccessError, BusAccess};
use etherpen::ethercat::configure::Entry;
use etherpen::ethercat::configure::own_data::UNLISTED;
use etherpen::ethercat::diagnostics::ServiceError;
use etherpen::ethercat::wire::coe::Object;
use etherpen::ethercat::wire::sii::{Header, Pdo, SYNC_MANAGER_VIRTUAL, Sii, SyncManagerRecord, SyncManagerUse};
use serde::Serialize;

/// Object that lists the process data objects of sync manager 0; those of the others follow.
const ASSIGNMENT: u16 = 0x1C10;
/// Lowest address of process data: digital outputs have their own register.
const DATA_START: u16 = 0x0F00;
/// Most sync managers of a slave controller.
const MANAGERS_MAX: u8 = 16;
/// Bytes of the information memory in one reading.
const PIECE: u16 = 256;

/// An entry of a process data object.
#[derive(Debug, PartialEq, Eq, Serialize)]
pub(crate) struct EntryView {
    /// 0 for a gap.
    pub(crate) index: u16,
    pub(crate) sub: u8,
    pub(crate) bits: u8,
    /// Name in the information memory; empty if there is none.
    pub(crate) name: String,
}

/// A process data object that the slave exchanges.
#[derive(Debug, PartialEq, Eq, Serialize)]
pub(crate) struct PdoView {
    pub(crate) index: u16,
    /// `out` from the master to the slave, or `in`.
    pub(crate) direction: &'static str,
    pub(crate) sync_manager: u8,
    /// Who lists the entries: `CoE` or `SII`.
    pub(crate) source: &'static str,
    /// Name in the information memory; empty if there is none.
    pub(crate) name: String,
    pub(crate) entries: Vec<EntryView>,
}

/// Reads the process data objects of a slave, from 1, in the order of the exchange; `lists` if it has CoE and is in a state
/// with a mailbox.
///
/// # Errors
/// The bus was lost, or the information memory cannot be read.
pub(crate) fn read(access: &mut dyn BusAccess, slave: u8, lists: bool) -> Result<Vec<PdoView>, AccessError> {
    let memory = information(access, slave)?;
    let Ok(sii) = Sii::new_checked(&memory) else {
        return Ok(Vec::new());
    };
    let mut managers: Vec<SyncManagerRecord> = sii.sync_managers().collect();
    if managers.is_empty() && lists {
        // As the master does.
        managers.extend(UNLISTED);
    }
    let mut found = Vec::new();
    for (number, record) in (0..MANAGERS_MAX).zip(managers) {
        let direction = match record.usage {
            SyncManagerUse::Outputs => "out",
            SyncManagerUse::Inputs => "in",
            _ => continue,
        };
        if record.flags & SYNC_MANAGER_VIRTUAL != 0 || record.start < DATA_START {
            continue;
        }
        let described = described(&sii, direction);
        let listed = match lists {
            true => list(access, slave, ASSIGNMENT + u16::from(number))?,
            false => None,
        };
        let Some(listed) = listed else {
            let here = described.iter().filter(|pdo| pdo.record.sync_manager == number);
            found.extend(here.map(|pdo| by_memory(&sii, pdo, direction, number)));
            continue;
        };
        for index in listed {
            let index = index as u16;
            let memory = described.iter().find(|pdo| pdo.record.index == index);
            let memory = memory.map(|pdo| by_memory(&sii, pdo, direction, number));
            found.extend(match list(access, slave, index)? {
                Some(mapped) => Some(by_coe(index, &mapped, memory.as_ref(), direction, number)),
                None => memory,
            });
        }
    }
    Ok(found)
}

/// The process data objects of a direction in the information memory.
fn described<'s>(sii: &Sii<'s>, direction: &str) -> Vec<Pdo<'s>> {
    match direction {
        "out" => sii.rx_pdos().map_while(Result::ok).collect(),
        _ => sii.tx_pdos().map_while(Result::ok).collect(),
    }
}

/// A process data object as the information memory describes it.
fn by_memory(sii: &Sii<'_>, pdo: &Pdo<'_>, direction: &'static str, sync_manager: u8) -> PdoView {
    let text = |name: u8| sii.strings().text(name).to_owned();
    PdoView {
        index: pdo.record.index,
        direction,
        sync_manager,
        source: "SII",
        name: text(pdo.record.name),
        entries: pdo
            .entries()
            .map(|entry| EntryView {
                index: entry.index,
                sub: entry.sub,
                bits: entry.bits,
                name: text(entry.name),
            })
            .collect(),
    }
}

/// A process data object as the slave itself lists it, with the names of the information memory.
fn by_coe(index: u16, mapped: &[u32], memory: Option<&PdoView>, direction: &'static str, sync_manager: u8) -> PdoView {
    let name = |object: Object| {
        let entries = memory.map_or(&[][..], |memory| &memory.entries);
        let same = entries
            .iter()
            .find(|entry| (entry.index, entry.sub) == (object.index, object.sub));
        same.map_or_else(String::new, |entry| entry.name.clone())
    };
    let entries = mapped.iter().map(|value| {
        let Entry { object, bits } = Entry::from_mapping(*value);
        EntryView {
            index: object.index,
            sub: object.sub,
            bits,
            name: name(object),
        }
    });
    PdoView {
        index,
        direction,
        sync_manager,
        source: "CoE",
        name: memory.map_or_else(String::new, |memory| memory.name.clone()),
        entries: entries.collect(),
    }
}

/// The numbers in a list object: its sub-index 0 counts them. `None` if the slave refuses to tell.
fn list(access: &mut dyn BusAccess, slave: u8, index: u16) -> Result<Option<Vec<u32>>, AccessError> {
    let Some(count) = number(access, slave, Object::new(index, 0))? else {
        return Ok(None);
    };
    let mut numbers = Vec::new();
    for sub in 1..=u8::try_from(count).unwrap_or(u8::MAX) {
        match number(access, slave, Object::new(index, sub))? {
            Some(number) => numbers.push(number),
            None => return Ok(None),
        }
    }
    Ok(Some(numbers))
}

/// A number of up to 32 bits; `None` if the slave refuses to tell.
fn number(access: &mut dyn BusAccess, slave: u8, object: Object) -> Result<Option<u32>, AccessError> {
    match access::upload(access, slave, object, false) {
        Ok(bytes) => {
            let mut number = [0; 4];
            number.iter_mut().zip(bytes).for_each(|(target, byte)| *target = byte);
            Ok(Some(u32::from_le_bytes(number)))
        }
        Err(AccessError::Refused(ServiceError::Bus(_))) => Ok(None),
        Err(error) => Err(error),
    }
}

/// The information memory up to the end of its categories, or what there is of it.
fn information(access: &mut dyn BusAccess, slave: u8) -> Result<Vec<u8>, AccessError> {
    let mut memory = Vec::new();
    loop {
        let word = u16::try_from(memory.len() / 2).unwrap_or(u16::MAX);
        let piece = access::information(access, slave, word, PIECE)?;
        memory.extend_from_slice(&piece);
        let Ok(sii) = Sii::new_checked(&memory) else {
            return Ok(memory);
        };
        let mut categories = sii.categories();
        categories.by_ref().for_each(drop);
        let is_cut = categories.walker().end().is_some_and(|end| {
            use etherpen::ethercat::wire::sii::ChainEnd::{Missing, Outside};
            matches!(end, Missing | Outside { .. })
        });
        // The header tells the size in KiBit, less one.
        let bytes = 128 * (usize::from(sii.header().size) + 1);
        if !is_cut || memory.len() >= bytes.max(Header::LEN) || piece.len() < usize::from(PIECE) {
            return Ok(memory);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::ethercat::diagnostics::{ServiceReply, ServiceRequest};
    use etherpen::ethercat::error::BusError;

    /// A slave with CoE whose information memory ends behind its fixed part; its objects: index, sub-index, value.
    struct Unlisted(Vec<(u16, u8, u32)>);

    impl BusAccess for Unlisted {
        fn request(&mut self, request: ServiceRequest) -> Result<ServiceReply, AccessError> {
            let value = match request {
                ServiceRequest::Information { word, length, .. } => {
                    let mut memory = vec![0; Header::LEN];
                    memory.extend([0xFF; 2]);
                    let rest = memory.get(2 * usize::from(word)..).unwrap_or_default();
                    rest[..rest.len().min(length.into())].to_vec()
                }
                ServiceRequest::Upload { object, .. } => {
                    let is_it = |(index, sub, _): &&(u16, u8, u32)| (*index, *sub) == (object.index, object.sub);
                    let code = 0x0602_0000;
                    let refused = AccessError::Refused(ServiceError::Bus(BusError::SdoAbort { object, code }));
                    self.0.iter().find(is_it).ok_or(refused)?.2.to_le_bytes().to_vec()
                }
                other => panic!("{other:?}"),
            };
            Ok(ServiceReply::Piece {
                total: value.len() as u16,
                piece: value.as_slice().try_into().expect("a piece"),
            })
        }
    }

    #[test]
    fn a_slave_that_lists_no_sync_managers_shows_the_objects_that_the_master_exchanges_with_it() {
        let objects = || {
            Unlisted(vec![
                (0x1C12, 0, 1),
                (0x1C12, 1, 0x1601),
                (0x1601, 0, 1),
                (0x1601, 1, 0x6040_0010),
                (0x1C13, 0, 1),
                (0x1C13, 1, 0x1A01),
                (0x1A01, 0, 2),
                (0x1A01, 1, 0x6041_0010),
                (0x1A01, 2, 0x6064_0020),
            ])
        };
        let found = read(&mut objects(), 1, true).expect("the bus is there");
        let told: Vec<_> = found
            .iter()
            .map(|pdo| {
                let entries = pdo.entries.iter().map(|entry| (entry.index, entry.bits)).collect();
                (pdo.index, pdo.direction, pdo.sync_manager, entries)
            })
            .collect::<Vec<(u16, &str, u8, Vec<(u16, u8)>)>>();
        assert_eq!(
            told,
            [
                (0x1601, "out", 2, vec![(0x6040, 16)]),
                (0x1A01, "in", 3, vec![(0x6041, 16), (0x6064, 32)])
            ]
        );
        assert_eq!(read(&mut objects(), 1, false).expect("the bus is there"), []);
    }
}
