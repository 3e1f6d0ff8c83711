//! Process-data objects of a slave: assignment, mapping and content.
//!
//! Object 0x1C10 + the number of a sync manager lists the process-data objects (PDOs) assigned to it; 0x16xx and 0x1Axx map entries of the object
//! dictionary into them, the first entry at the lowest bits. A list is written by setting its count to 0, writing the
//! entries and setting the count again. Layout: CiA 301, PDO mapping; IEC 61158-6-12, sync manager PDO assignment.

use crate::bits::{bit, set_bit};
use crate::mailbox::abort::Abort;
use crate::mailbox::dictionary::{DataType, Dictionary, List, ObjectCode, access};
use crate::mailbox::live_objects::LiveObjects;
use std::ops::RangeInclusive;

/// One mapped entry; index 0 is a gap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PdoEntry {
    /// Index of the object.
    pub(crate) index: u16,
    /// Sub-index.
    pub(crate) sub: u8,
    /// Length in the process data, bits.
    pub(crate) bits: u8,
}

impl PdoEntry {
    /// An entry at sub-index 0.
    pub(crate) const fn new(index: u16, bits: u8) -> Self {
        Self { index, sub: 0, bits }
    }

    fn number(self) -> i64 {
        i64::from(self.index) << 16 | i64::from(self.sub) << 8 | i64::from(self.bits)
    }

    fn from_number(number: i64) -> Self {
        let [bits, sub, low, high, ..] = number.to_le_bytes();
        Self {
            index: u16::from_le_bytes([low, high]),
            sub,
            bits,
        }
    }
}

/// One process-data object.
#[derive(Clone, Debug)]
pub(crate) struct Pdo {
    /// Index, 0x16xx or 0x17xx for outputs, 0x1Axx or 0x1Bxx for inputs.
    pub(crate) index: u16,
    /// Name.
    pub(crate) name: String,
    /// Whether the mapping is fixed.
    pub(crate) fixed: bool,
    /// Mapped entries.
    pub(crate) entries: Vec<PdoEntry>,
    count: usize,
}

impl Pdo {
    /// A PDO with this mapping.
    pub(crate) fn new(index: u16, name: &str, fixed: bool, entries: &[PdoEntry]) -> Self {
        Self {
            index,
            name: name.to_owned(),
            fixed,
            entries: entries.to_vec(),
            count: entries.len(),
        }
    }

    /// The mapped entries.
    pub(crate) fn mapped(&self) -> &[PdoEntry] {
        self.entries.get(..self.count).unwrap_or(&self.entries)
    }

    /// Whether the master writes the PDO.
    pub(crate) fn is_output(&self) -> bool {
        self.index < 0x1A00
    }
}

#[derive(Clone, Debug, Default)]
struct Assignment {
    count: usize,
    pdos: Vec<u16>,
}

/// Numbers of the sync managers that carry the process data, one for each direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DataManagers {
    /// That of the outputs.
    pub outputs: u8,
    /// That of the inputs.
    pub inputs: u8,
}

impl Default for DataManagers {
    /// Those behind the two of a mailbox, as IEC 61158-6-12 numbers them.
    fn default() -> Self {
        Self { outputs: 2, inputs: 3 }
    }
}

impl DataManagers {
    /// Numbers that may be chosen: those behind a mailbox that controllers with 8 sync managers have.
    const CHOICE: RangeInclusive<u8> = 2..=7;

    /// The sync managers with these numbers: `None` for one number for both directions, or one that is not from 2 to 7.
    pub fn new(outputs: u8, inputs: u8) -> Option<Self> {
        let is_possible = outputs != inputs && Self::CHOICE.contains(&outputs) && Self::CHOICE.contains(&inputs);
        is_possible.then_some(Self { outputs, inputs })
    }

    /// Number of sync managers up to the last one.
    pub(crate) fn count(self) -> u8 {
        self.outputs.max(self.inputs) + 1
    }

    /// What each sync manager of a slave with a mailbox carries, as object 0x1C00 tells it: 1 and 2 the mailbox, 3 outputs, 4
    /// inputs, 0 nothing.
    pub(crate) fn types(self) -> Vec<u8> {
        let kind = |number| match number {
            0 => 1,
            1 => 2,
            number if number == self.outputs => 3,
            number if number == self.inputs => 4,
            _ => 0,
        };
        (0..self.count()).map(kind).collect()
    }
}

/// Assignment and mapping of one slave.
#[derive(Clone, Debug, Default)]
pub(crate) struct ProcessData {
    pdos: Vec<Pdo>,
    outputs: Assignment,
    inputs: Assignment,
    managers: DataManagers,
    assigned_max: usize,
    /// Most bytes of a PDO whose mapping is written.
    mapped_bytes_max: usize,
}

impl ProcessData {
    /// Object that assigns process data to sync manager 0; those of the others follow.
    const ASSIGNMENT: u16 = 0x1C10;
    /// Most entries of an assignment object.
    pub(crate) const ASSIGNED_MAX: u8 = 4;
    /// Most entries of a mapping object.
    pub(crate) const MAPPED_MAX: u8 = 8;
    /// Most bytes of process data in one direction.
    pub(crate) const BYTES_MAX: usize = 64;

    /// PDOs with their default assignment; at most `assigned_max` can be assigned in each direction.
    pub(crate) fn new(pdos: Vec<Pdo>, outputs: &[u16], inputs: &[u16], assigned_max: usize) -> Self {
        let assignment = |pdos: &[u16]| Assignment {
            count: pdos.len(),
            pdos: pdos.to_vec(),
        };
        Self {
            pdos,
            outputs: assignment(outputs),
            inputs: assignment(inputs),
            managers: DataManagers::default(),
            assigned_max,
            mapped_bytes_max: Self::BYTES_MAX,
        }
    }

    /// These process data in a device that maps at most this many bytes into one PDO.
    pub(crate) fn with_mapped_bytes_max(self, mapped_bytes_max: usize) -> Self {
        Self {
            mapped_bytes_max,
            ..self
        }
    }

    /// These process data in other sync managers.
    pub(crate) fn carried_by(self, managers: DataManagers) -> Self {
        Self { managers, ..self }
    }

    /// The sync managers that carry them.
    pub(crate) fn managers(&self) -> DataManagers {
        self.managers
    }

    /// All PDOs.
    pub(crate) fn pdos(&self) -> &[Pdo] {
        &self.pdos
    }

    /// Whether a PDO is assigned.
    pub(crate) fn is_assigned(&self, index: u16) -> bool {
        let listed = |list: &Assignment| list.pdos.iter().take(list.count).any(|pdo| *pdo == index);
        listed(&self.outputs) || listed(&self.inputs)
    }

    /// Whether the assigned outputs have one object more than once.
    pub(crate) fn maps_output_twice(&self) -> bool {
        let entries: Vec<PdoEntry> = self.entries(&self.outputs).filter(|entry| entry.index != 0).collect();
        let same = |one: &PdoEntry, other: &PdoEntry| (one.index, one.sub) == (other.index, other.sub);
        (1..entries.len()).any(|at| {
            let (before, rest) = entries.split_at(at);
            rest.first()
                .is_some_and(|entry| before.iter().any(|other| same(entry, other)))
        })
    }

    /// Length of outputs and inputs, bytes.
    pub(crate) fn bytes(&self) -> (usize, usize) {
        (self.direction_bytes(&self.outputs), self.direction_bytes(&self.inputs))
    }

    /// An entry of an assignment or mapping object; `None` if it does not exist.
    pub(crate) fn get(&self, index: u16, sub: u8) -> Option<i64> {
        let at = usize::from(sub).checked_sub(1);
        if let Some(list) = self.assignment(index) {
            return match at {
                None => i64::try_from(list.count).ok(),
                Some(at) => Some(list.pdos.get(at).copied().map_or(0, i64::from)),
            };
        }
        let pdo = self.pdo(index)?;
        match at {
            None => i64::try_from(pdo.count).ok(),
            Some(at) => Some(pdo.entries.get(at).map_or(0, |entry| entry.number())),
        }
    }

    /// Writes an entry of an assignment or mapping object.
    pub(crate) fn set(&mut self, index: u16, sub: u8, number: i64, dictionary: &Dictionary) -> Result<(), Abort> {
        let at = usize::from(sub).checked_sub(1);
        match (self.assignment(index).is_some(), at) {
            (true, None) => self.set_assigned_count(index, number),
            (true, Some(at)) => self.assign(index, at, number),
            (false, None) => self.set_mapped_count(index, number),
            (false, Some(at)) => self.map(index, at, number, dictionary),
        }
    }

    /// Adds the assignment and mapping objects to a dictionary.
    pub(crate) fn describe(&self, dictionary: &mut Dictionary) {
        let [outputs, inputs] = self.assignment_objects();
        for (index, name) in [(outputs, "RxPDO assign"), (inputs, "TxPDO assign")] {
            dictionary.add_list(&List {
                index,
                name,
                code: ObjectCode::Array,
                access: access::READ | access::WRITE_PREOP,
                count_name: "Number of assigned PDOs",
                entry_name: "Assigned PDO",
                kind: DataType::Unsigned16,
                length: Self::ASSIGNED_MAX,
            });
        }
        for pdo in self.pdos() {
            let (access, length) = match pdo.fixed {
                true => (access::READ, pdo.entries.len() as u8),
                false => (access::READ | access::WRITE_PREOP, Self::MAPPED_MAX),
            };
            dictionary.add_list(&List {
                index: pdo.index,
                name: &pdo.name,
                code: ObjectCode::Record,
                access,
                count_name: "Number of mapped objects",
                entry_name: "Mapped object",
                kind: DataType::Unsigned32,
                length,
            });
        }
    }

    /// Passes the outputs to the device.
    pub(crate) fn unpack(&self, outputs: &[u8], device: &mut dyn LiveObjects) {
        let mut at = 0;
        for entry in self.entries(&self.outputs) {
            let bits = usize::from(entry.bits);
            let mut number = 0u64;
            if at % 8 == 0 && bits.is_multiple_of(8) {
                let bytes = outputs.iter().skip(at / 8).take(bits / 8).rev();
                number = bytes.fold(0, |number, byte| number << 8 | u64::from(*byte));
            } else {
                for index in 0..bits.min(64) {
                    number |= u64::from(bit(outputs, at + index)) << index;
                }
            }
            at += bits;
            if entry.index != 0 {
                let unused = 64 - bits.clamp(1, 64) as u32;
                let signed = (number << unused) as i64 >> unused;
                device.set_output(entry.index, entry.sub, signed);
            }
        }
    }

    /// Collects the inputs from the device.
    pub(crate) fn pack(&self, device: &dyn LiveObjects) -> Vec<u8> {
        let mut inputs = vec![0; self.bytes().1];
        let mut at = 0;
        for entry in self.entries(&self.inputs) {
            let bits = usize::from(entry.bits);
            let number = device.get(entry.index, entry.sub).unwrap_or(0);
            if at % 8 == 0 && bits.is_multiple_of(8) {
                let bytes = inputs.iter_mut().skip(at / 8).take(bits / 8);
                bytes
                    .zip(number.to_le_bytes())
                    .for_each(|(target, byte)| *target = byte);
            } else {
                for index in 0..bits.min(64) {
                    set_bit(&mut inputs, at + index, number >> index & 1 != 0);
                }
            }
            at += bits;
        }
        inputs
    }

    fn assignment(&self, index: u16) -> Option<&Assignment> {
        let [outputs, inputs] = self.assignment_objects();
        match index {
            index if index == outputs => Some(&self.outputs),
            index if index == inputs => Some(&self.inputs),
            _ => None,
        }
    }

    /// Objects that assign outputs and inputs.
    fn assignment_objects(&self) -> [u16; 2] {
        let DataManagers { outputs, inputs } = self.managers;
        [outputs, inputs].map(|number| Self::ASSIGNMENT + u16::from(number))
    }

    fn pdo(&self, index: u16) -> Option<&Pdo> {
        self.pdos.iter().find(|pdo| pdo.index == index)
    }

    fn entries<'a>(&'a self, list: &'a Assignment) -> impl Iterator<Item = PdoEntry> + 'a {
        let assigned = list.pdos.iter().take(list.count);
        assigned
            .filter_map(|index| self.pdo(*index))
            .flat_map(|pdo| pdo.mapped().iter().copied())
    }

    fn direction_bytes(&self, list: &Assignment) -> usize {
        let bits: usize = self.entries(list).map(|entry| usize::from(entry.bits)).sum();
        bits.div_ceil(8)
    }

    fn set_assigned_count(&mut self, index: u16, number: i64) -> Result<(), Abort> {
        let count = usize::try_from(number).map_err(|_| Abort::VALUE)?;
        let assigned_max = self.assigned_max;
        let list = self.assignment(index).ok_or(Abort::NO_OBJECT)?;
        let known = list.pdos.iter().take(count).filter(|pdo| self.pdo(**pdo).is_some());
        if count > assigned_max || known.count() != count {
            return Err(Abort::VALUE);
        }
        let candidate = Assignment {
            count,
            pdos: list.pdos.clone(),
        };
        if self.direction_bytes(&candidate) > Self::BYTES_MAX {
            return Err(Abort::MAPPING_LENGTH);
        }
        self.list_mut(index).count = count;
        Ok(())
    }

    fn assign(&mut self, index: u16, at: usize, number: i64) -> Result<(), Abort> {
        let pdo = u16::try_from(number).map_err(|_| Abort::VALUE)?;
        let [outputs, _] = self.assignment_objects();
        let is_output = index == outputs;
        if at >= self.assigned_max {
            return Err(Abort::NO_SUB_INDEX);
        }
        if self.assignment(index).is_some_and(|list| list.count != 0) {
            return Err(Abort::SUB_INDEX_ZERO_FIRST);
        }
        if self.pdo(pdo).is_none_or(|pdo| pdo.is_output() != is_output) {
            return Err(Abort::NOT_MAPPABLE);
        }
        let list = self.list_mut(index);
        list.pdos.resize(list.pdos.len().max(at + 1), 0);
        list.pdos.iter_mut().skip(at).take(1).for_each(|entry| *entry = pdo);
        Ok(())
    }

    fn set_mapped_count(&mut self, index: u16, number: i64) -> Result<(), Abort> {
        let count = usize::try_from(number).map_err(|_| Abort::VALUE)?;
        let bytes_max = self.mapped_bytes_max;
        let pdo = self
            .pdos
            .iter_mut()
            .find(|pdo| pdo.index == index)
            .ok_or(Abort::NO_OBJECT)?;
        if count > pdo.entries.len() {
            return Err(Abort::VALUE);
        }
        let bits: usize = pdo
            .entries
            .iter()
            .take(count)
            .map(|entry| usize::from(entry.bits))
            .sum();
        if bits > 8 * bytes_max {
            return Err(Abort::MAPPING_LENGTH);
        }
        pdo.count = count;
        Ok(())
    }

    fn map(&mut self, index: u16, at: usize, number: i64, dictionary: &Dictionary) -> Result<(), Abort> {
        let pdo = self
            .pdos
            .iter_mut()
            .find(|pdo| pdo.index == index)
            .ok_or(Abort::NO_OBJECT)?;
        if pdo.fixed {
            return Err(Abort::READ_ONLY);
        }
        if pdo.count != 0 {
            return Err(Abort::SUB_INDEX_ZERO_FIRST);
        }
        let entry = PdoEntry::from_number(number);
        let right = if pdo.is_output() { access::RX } else { access::TX };
        if entry.index != 0 {
            let object = dictionary.object(entry.index)?;
            let mapped = object.entry(entry.sub).ok_or(Abort::NO_SUB_INDEX)?;
            if mapped.access & right == 0 || mapped.kind.bytes() != Some(usize::from(entry.bits) / 8) {
                return Err(Abort::NOT_MAPPABLE);
            }
        }
        pdo.entries.resize(pdo.entries.len().max(at + 1), PdoEntry::new(0, 0));
        pdo.entries.iter_mut().skip(at).take(1).for_each(|old| *old = entry);
        Ok(())
    }

    fn list_mut(&mut self, index: u16) -> &mut Assignment {
        let [outputs, _] = self.assignment_objects();
        if index == outputs {
            &mut self.outputs
        } else {
            &mut self.inputs
        }
    }
}
