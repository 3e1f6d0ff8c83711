//! A slave's own process data: what it exchanges without a driver, and which sync managers carry it.
//!
//! The SII lists the sync managers (ETG.2010, category 41); terminals without a mailbox begin with sync manager 0. Where that
//! list is missing, a slave with CoE has sync managers 2 and 3, as ETG.1000.6 numbers them. What a sync manager carries is
//! listed by CoE (0x1C10 + its number names the process data objects assigned to it), or by the SII for slaves without CoE
//! and for lists that are missing there. The data of a direction lie in the order of its sync managers, those of each from a
//! whole byte on.
//!
//! Invariant: only what the application has chosen is written; every list and every wait ends.

use super::information::{self, read_words};
use super::objects::{ASSIGNMENT, Direction, Entry, MANAGERS_MAX};
use super::pre_operational::{ENTRIES_MAX, read_list, sii_entries};
use crate::acyclic::AcyclicPort;
use crate::coe::ObjectDictionary;
use crate::error::BusError;
use crate::mailbox::Mailbox;
use crate::wire::coe::Object;
use crate::wire::register;
use crate::wire::sii::{self, PdoRecord, Record, SyncManagerRecord, SyncManagerUse};

/// Most sync managers of a slave that carry process data: all but the mailbox's of a controller with 8, and one more.
pub const DATA_MANAGERS_MAX: usize = 7;
/// Lowest address of process data: digital outputs have their own register (IEC 61158-4-12, 0x0F00).
const OUTPUTS_START: u16 = 0x0F00;

/// The sync managers of a slave with CoE whose SII does not list them: behind those of the mailbox.
pub const UNLISTED: [SyncManagerRecord; 4] = {
    const fn manager(start: u16, control: u8, usage: SyncManagerUse) -> SyncManagerRecord {
        SyncManagerRecord {
            start,
            length: 0,
            control,
            status: 0,
            flags: 0,
            usage,
        }
    }
    [
        manager(0, 0, SyncManagerUse::MailboxOut),
        manager(0, 0, SyncManagerUse::MailboxIn),
        manager(0x1100, register::CONTROL_OUTPUTS, SyncManagerUse::Outputs),
        manager(0x1400, register::CONTROL_INPUTS, SyncManagerUse::Inputs),
    ]
};

/// A sync manager that carries process data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DataManager {
    /// Its number.
    pub number: u8,
    /// Control byte of its register; its direction is that of the process data.
    pub control: u8,
    /// Bytes.
    pub length: u8,
    /// First byte in the slave's memory, little-endian: no byte is lost to alignment.
    start: [u8; 2],
}

impl DataManager {
    /// Whether it carries inputs; otherwise outputs.
    pub const fn is_input(&self) -> bool {
        self.control & register::CONTROL_DIRECTION == 0
    }

    /// First byte in the slave's memory.
    pub const fn start(&self) -> u16 {
        u16::from_le_bytes(self.start)
    }
}

/// A slave's own process data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OwnData {
    /// The sync managers in the order of their numbers; the rest have a length of 0.
    pub managers: [DataManager; DATA_MANAGERS_MAX],
}

impl OwnData {
    /// The sync managers that are in use.
    pub fn managers(&self) -> impl Iterator<Item = &DataManager> {
        self.managers.iter().filter(|manager| manager.length > 0)
    }

    /// Bytes of all outputs, or of all inputs.
    pub fn length(&self, direction: Direction) -> u16 {
        let is_input = direction == Direction::Inputs;
        let lengths = self.managers().filter(|manager| manager.is_input() == is_input);
        lengths.map(|manager| u16::from(manager.length)).sum()
    }
}

/// An entry of a terminal's process data that the application chooses: the entries of one process data object stand
/// together, and those objects together that belong to one sync manager of one slave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChosenEntry {
    /// Place in the chain of the slave, from 0.
    pub slave: u8,
    /// Number of the sync manager to which the process data object is assigned.
    pub manager: u8,
    /// Index of the process data object: from 0x1600 for outputs, from 0x1A00 for inputs.
    pub pdo: u16,
    /// The entry to be mapped; `None` assigns the process data object with the entries that it has.
    pub entry: Option<Entry>,
}

/// Assigns a slave's chosen process data objects to its sync managers, and maps their entries, in PREOP. `slave` is its
/// place in the chain.
///
/// # Errors
/// [`BusError::SdoAbort`] for what the slave refuses, or errors of the mailbox.
pub async fn choose<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    mailbox: &mut Mailbox,
    slave: u8,
    chosen: &[ChosenEntry],
) -> Result<(), BusError> {
    let mut dictionary = ObjectDictionary::new(port, mailbox);
    let same_manager = |one: &ChosenEntry, next: &ChosenEntry| (one.slave, one.manager) == (next.slave, next.manager);
    for of_manager in chosen.chunk_by(same_manager) {
        let Some(first) = of_manager.first().filter(|first| first.slave == slave) else {
            continue;
        };
        let assignment = |sub| Object::new(ASSIGNMENT + u16::from(first.manager), sub);
        dictionary.write(assignment(0), 0, 1).await?;
        let mut assigned = 0;
        for of_pdo in of_manager.chunk_by(|one, next| one.pdo == next.pdo) {
            let Some(ChosenEntry { pdo, .. }) = of_pdo.first() else {
                continue;
            };
            let mut mapped = 0;
            for entry in of_pdo.iter().filter_map(|one| one.entry) {
                if mapped == 0 {
                    dictionary.write(Object::new(*pdo, 0), 0, 1).await?;
                }
                mapped += 1;
                dictionary.write(Object::new(*pdo, mapped), entry.mapping(), 4).await?;
            }
            if mapped > 0 {
                dictionary.write(Object::new(*pdo, 0), mapped.into(), 1).await?;
            }
            assigned += 1;
            dictionary.write(assignment(assigned), u32::from(*pdo), 2).await?;
        }
        dictionary.write(assignment(0), assigned.into(), 1).await?;
    }
    Ok(())
}

/// Finds the process data of a slave in PREOP; `mailbox` if it supports CoE. Passes each entry to `take` with the bit
/// at which it begins in all data of its direction.
///
/// # Errors
/// [`BusError::SyncManagers`] for data in too many sync managers, or errors of the SII and the mailbox.
pub async fn find<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    mut mailbox: Option<&mut Mailbox>,
    mut take: impl FnMut(Direction, u16, Entry),
) -> Result<OwnData, BusError> {
    let mut data = OwnData::default();
    let listed = information::find_category(port, station, sii::CATEGORY_SYNC_MANAGER).await?;
    let words = (SyncManagerRecord::LEN / 2) as u16;
    let managers = match listed {
        Some(category) => (category.words / words).min(MANAGERS_MAX),
        None if mailbox.is_some() => UNLISTED.len() as u16,
        None => 0,
    };
    let mut used = 0;
    for number in 0..managers {
        let record = match listed {
            Some(category) => {
                let mut bytes = [0; SyncManagerRecord::LEN];
                read_words(port, station, category.word.saturating_add(number * words), &mut bytes).await?;
                SyncManagerRecord::parse(&bytes).ok()
            }
            None => UNLISTED.get(usize::from(number)).copied(),
        };
        let Some(record) = record else {
            break;
        };
        let direction = match record.usage {
            SyncManagerUse::Outputs => Direction::Outputs,
            SyncManagerUse::Inputs => Direction::Inputs,
            _ => continue,
        };
        if record.flags & sii::SYNC_MANAGER_VIRTUAL != 0 || record.start < OUTPUTS_START {
            continue;
        }
        let first = 8 * data.length(direction);
        let mut bits = 0_u16;
        let mut count = |entry: Entry| {
            take(direction, first.saturating_add(bits), entry);
            bits = bits.saturating_add(entry.bits.into());
            Ok(())
        };
        let listed = match mailbox.as_deref_mut() {
            Some(mailbox) => by_coe(port, station, mailbox, number as u8, direction, &mut count).await?,
            None => false,
        };
        if !listed {
            let here = |pdo: &PdoRecord| u16::from(pdo.sync_manager) == number;
            sii_entries(port, station, direction, here, &mut count).await?;
        }
        let length = match bits {
            // Without lists, the length is that of the SII.
            0 if !listed => record.length,
            bits => bits.div_ceil(8),
        };
        if length == 0 {
            continue;
        }
        let place = data.managers.get_mut(used).ok_or(BusError::SyncManagers {
            expected: DATA_MANAGERS_MAX as u8,
            actual: used as u8 + 1,
        })?;
        used += 1;
        let others = record.control & !register::CONTROL_DIRECTION;
        *place = DataManager {
            number: number as u8,
            control: match direction {
                Direction::Outputs => others | register::CONTROL_MASTER_WRITES,
                Direction::Inputs => others,
            },
            // More than a byte counts is more than the plan takes.
            length: u8::try_from(length).unwrap_or(u8::MAX),
            start: record.start.to_le_bytes(),
        };
    }
    Ok(data)
}

/// Passes the entries that a sync manager carries according to CoE to `take`; false if the slave has no such lists.
async fn by_coe<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    mailbox: &mut Mailbox,
    number: u8,
    direction: Direction,
    take: &mut impl FnMut(Entry) -> Result<(), BusError>,
) -> Result<bool, BusError> {
    let mut dictionary = ObjectDictionary::new(port, mailbox);
    let assignment = |sub| Object::new(ASSIGNMENT + u16::from(number), sub);
    let assigned = match dictionary.read(assignment(0), 1).await {
        Err(BusError::SdoAbort { .. }) => return Ok(false),
        assigned => assigned? as u8,
    };
    for sub in 1..=assigned {
        let mut dictionary = ObjectDictionary::new(port, mailbox);
        let pdo = match dictionary.read(assignment(sub), 2).await {
            // No entry was passed on yet.
            Err(BusError::SdoAbort { .. }) if sub == 1 => return Ok(false),
            pdo => pdo? as u16,
        };
        let entries = read_list(&mut dictionary, pdo, ENTRIES_MAX, 4, |value| {
            take(Entry::from_mapping(value))
        });
        match entries.await {
            // An object with unreadable entries, none of which was passed on yet.
            Err(BusError::SdoAbort { object, .. }) if object.sub == 0 => {
                let here = |record: &PdoRecord| record.index == pdo;
                sii_entries(port, station, direction, here, take).await?;
            }
            other => other?,
        }
    }
    Ok(true)
}
