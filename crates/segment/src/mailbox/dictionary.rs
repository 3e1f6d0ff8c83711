//! Object dictionaries as tables: one row for each entry, used for both access and SDO information.
//!
//! A row contains index, sub-index, name, data type, access rights and the source of the value: a constant, a value
//! stored in the dictionary, the device, or the process-data lists. Data types and object codes: CiA 301; access bits:
//! IEC 61158-6-12, SDO information.
//!
//! Invariant: access to an entry follows its description.

use crate::mailbox::abort::Abort;
use etherpen_ethercat::wire::sii::Identity;

/// Data type of an entry, by its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub(crate) enum DataType {
    /// A bit.
    Boolean = 0x01,
    /// 8 bits, signed.
    Integer8 = 0x02,
    /// 16 bits, signed.
    Integer16 = 0x03,
    /// 32 bits, signed.
    Integer32 = 0x04,
    /// 8 bits.
    Unsigned8 = 0x05,
    /// 16 bits.
    Unsigned16 = 0x06,
    /// 32 bits.
    Unsigned32 = 0x07,
    /// Floating point, 32 bits.
    Real32 = 0x08,
    /// Characters.
    VisibleString = 0x09,
    /// Bytes.
    OctetString = 0x0A,
    /// Floating point, 64 bits.
    Real64 = 0x11,
    /// 64 bits, signed.
    Integer64 = 0x15,
    /// 64 bits.
    Unsigned64 = 0x1B,
}

impl DataType {
    /// Length of a value, bytes; `None` if it varies.
    pub(crate) fn bytes(self) -> Option<usize> {
        match self {
            Self::Boolean | Self::Integer8 | Self::Unsigned8 => Some(1),
            Self::Integer16 | Self::Unsigned16 => Some(2),
            Self::Integer32 | Self::Unsigned32 | Self::Real32 => Some(4),
            Self::Integer64 | Self::Unsigned64 | Self::Real64 => Some(8),
            Self::VisibleString | Self::OctetString => None,
        }
    }

    fn is_signed(self) -> bool {
        matches!(self, Self::Integer8 | Self::Integer16 | Self::Integer32)
    }

    /// The little-endian bytes of a number, cut to the type's length.
    pub(crate) fn encode(self, number: i64) -> Vec<u8> {
        let mut bytes = number.to_le_bytes().to_vec();
        bytes.truncate(self.bytes().unwrap_or(0));
        bytes
    }

    /// Decodes a number of exactly the type's length.
    pub(crate) fn decode(self, value: &[u8]) -> Result<i64, Abort> {
        let bytes = self.bytes().ok_or(Abort::LENGTH)?;
        check_length(value.len(), bytes)?;
        let negative = self.is_signed() && value.last().is_some_and(|last| last & 0x80 != 0);
        let mut number = [if negative { 0xFF } else { 0 }; 8];
        for (target, source) in number.iter_mut().zip(value) {
            *target = *source;
        }
        Ok(i64::from_le_bytes(number))
    }
}

/// Kind of an object, by its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum ObjectCode {
    /// One value at sub-index 0.
    Variable = 7,
    /// Equal entries after their count.
    Array = 8,
    /// Different entries after their count.
    Record = 9,
}

/// Read and write rights in the states PREOP, SAFEOP and OP, and whether process data may carry the entry.
pub(crate) mod access {
    /// Readable in every state.
    pub(crate) const READ: u16 = 0x0007;
    /// Writable in every state.
    pub(crate) const WRITE: u16 = 0x0038;
    /// Writable in PREOP only.
    pub(crate) const WRITE_PREOP: u16 = 0x0008;
    /// Readable and writable in every state.
    pub(crate) const READ_WRITE: u16 = READ | WRITE;
    /// May be mapped to outputs.
    pub(crate) const RX: u16 = 0x0040;
    /// May be mapped to inputs.
    pub(crate) const TX: u16 = 0x0080;
}

/// Source of a value.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Value {
    /// A constant.
    Number(i64),
    /// A constant text.
    Text(&'static str),
    /// A number stored in the dictionary, with its initial value and its range.
    Stored { first: i64, low: i64, high: i64 },
    /// Bytes stored in the dictionary, up to a length.
    Bytes { longest: usize },
    /// The device provides the value.
    Live,
}

/// One row: sub-index, name, data type, access, value.
pub(crate) type EntryRow = (u8, &'static str, DataType, u16, Value);

/// One object of a table.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ObjectRow {
    /// Index.
    pub(crate) index: u16,
    /// Name of the object.
    pub(crate) name: &'static str,
    /// Kind of the object.
    pub(crate) code: ObjectCode,
    /// Its entries; sub-index 0 of arrays and records is added.
    pub(crate) entries: &'static [EntryRow],
}

/// A row of an object with one value.
pub(crate) const fn variable(index: u16, name: &'static str, entries: &'static [EntryRow; 1]) -> ObjectRow {
    let code = ObjectCode::Variable;
    ObjectRow {
        index,
        name,
        code,
        entries,
    }
}

/// A row of an object with several values.
pub(crate) const fn record(index: u16, name: &'static str, entries: &'static [EntryRow]) -> ObjectRow {
    let code = ObjectCode::Record;
    ObjectRow {
        index,
        name,
        code,
        entries,
    }
}

/// Where the value of an entry is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Content {
    /// A constant.
    Fixed(Vec<u8>),
    /// A number that the dictionary keeps.
    Number {
        /// The value.
        value: i64,
        /// Lowest value.
        low: i64,
        /// Highest value.
        high: i64,
    },
    /// Bytes that the dictionary keeps.
    Bytes {
        /// The value.
        value: Vec<u8>,
        /// Most bytes.
        longest: usize,
    },
    /// In the device.
    Live,
    /// In the lists of the process data.
    ProcessData,
}

/// One entry of a dictionary.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ObjectEntry {
    /// Sub-index.
    pub(crate) sub: u8,
    /// Name.
    pub(crate) name: String,
    /// Data type.
    pub(crate) kind: DataType,
    /// Access bits.
    pub(crate) access: u16,
    /// Where the value is.
    pub(crate) content: Content,
}

/// One object of a dictionary.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Object {
    /// Index.
    pub(crate) index: u16,
    /// Name.
    pub(crate) name: String,
    /// Kind of the object.
    pub(crate) code: ObjectCode,
    /// Entries in the order of their sub-indices.
    pub(crate) entries: Vec<ObjectEntry>,
}

impl ObjectEntry {
    /// Length of the value, bits; the most that it may have if that varies, and 0 if only the device knows.
    pub(crate) fn bits(&self) -> u16 {
        let bytes = match (self.kind, self.kind.bytes(), &self.content) {
            (DataType::Boolean, ..) => return 1,
            (_, Some(bytes), _) => bytes,
            (_, None, Content::Fixed(value)) => value.len(),
            (_, None, Content::Bytes { longest, .. }) => *longest,
            (_, None, _) => 0,
        };
        u16::try_from(8 * bytes).unwrap_or(u16::MAX)
    }
}

impl Object {
    /// The entry at a sub-index.
    pub(crate) fn entry(&self, sub: u8) -> Option<&ObjectEntry> {
        self.entries.iter().find(|entry| entry.sub == sub)
    }
}

/// A list of the process data as an object.
#[derive(Clone, Copy, Debug)]
pub(crate) struct List<'a> {
    /// Index.
    pub(crate) index: u16,
    /// Name.
    pub(crate) name: &'a str,
    /// Kind of the object.
    pub(crate) code: ObjectCode,
    /// Access bits.
    pub(crate) access: u16,
    /// Name of sub-index 0.
    pub(crate) count_name: &'a str,
    /// Name of every other entry.
    pub(crate) entry_name: &'a str,
    /// Data type of every other entry.
    pub(crate) kind: DataType,
    /// Most entries.
    pub(crate) length: u8,
}

/// The objects of one slave, in the order of their indices.
#[derive(Clone, Debug, Default)]
pub(crate) struct Dictionary {
    objects: Vec<Object>,
}

impl Dictionary {
    /// Adds the objects of a table.
    pub(crate) fn add_table(&mut self, rows: &[ObjectRow]) {
        for row in rows {
            let entry = |&(sub, name, kind, access, value): &EntryRow| ObjectEntry {
                sub,
                name: name.to_owned(),
                kind,
                access,
                content: match value {
                    Value::Number(number) => Content::Fixed(kind.encode(number)),
                    Value::Text(text) => Content::Fixed(text.into()),
                    Value::Stored { first, low, high } => Content::Number {
                        value: first,
                        low,
                        high,
                    },
                    Value::Bytes { longest } => Content::Bytes {
                        value: Vec::new(),
                        longest,
                    },
                    Value::Live => Content::Live,
                },
            };
            let entries: Vec<ObjectEntry> = row.entries.iter().map(entry).collect();
            self.add(row.index, row.name, row.code, entries);
        }
    }

    /// Adds a constant text at sub-index 0.
    pub(crate) fn add_text(&mut self, index: u16, name: &str, text: &str) {
        let entry = ObjectEntry {
            sub: 0,
            name: name.to_owned(),
            kind: DataType::VisibleString,
            access: access::READ,
            content: Content::Fixed(text.into()),
        };
        self.add(index, name, ObjectCode::Variable, vec![entry]);
    }

    /// Adds an object of constant numbers.
    pub(crate) fn add_numbers(&mut self, index: u16, name: &str, numbers: &[(&str, DataType, i64)]) {
        let entry = |(sub, (name, kind, number)): (u8, &(&str, DataType, i64))| ObjectEntry {
            sub,
            name: (*name).to_owned(),
            kind: *kind,
            access: access::READ,
            content: Content::Fixed(kind.encode(*number)),
        };
        let entries = (1..).zip(numbers).map(entry).collect();
        self.add(index, name, ObjectCode::Record, entries);
    }

    /// Adds the identity object.
    pub(crate) fn add_identity(&mut self, identity: &Identity) {
        let numbers = [
            ("Vendor number", identity.vendor),
            ("Product code", identity.product),
            ("Revision", identity.revision),
            ("Serial number", identity.serial),
        ];
        let numbers = numbers.map(|(name, number)| (name, DataType::Unsigned32, i64::from(number)));
        self.add_numbers(0x1018, "Identity", &numbers);
    }

    /// Adds the object that tells what each sync manager carries (CiA 301: 0x1C00).
    pub(crate) fn add_sync_manager_types(&mut self, types: &[u8]) {
        let names: Vec<String> = (0..types.len())
            .map(|number| format!("Sync manager {number}"))
            .collect();
        let numbers = names.iter().zip(types);
        let numbers: Vec<(&str, DataType, i64)> = numbers
            .map(|(name, kind)| (name.as_str(), DataType::Unsigned8, i64::from(*kind)))
            .collect();
        self.add_numbers(0x1C00, "Sync manager types", &numbers);
    }

    /// Adds an object whose values are a list of the process data.
    pub(crate) fn add_list(&mut self, list: &List) {
        let entry = |sub, name: &str, kind| ObjectEntry {
            sub,
            name: name.to_owned(),
            kind,
            access: list.access,
            content: Content::ProcessData,
        };
        let mut entries = vec![entry(0, list.count_name, DataType::Unsigned8)];
        entries.extend((1..=list.length).map(|sub| entry(sub, list.entry_name, list.kind)));
        self.add(list.index, list.name, list.code, entries);
    }

    fn add(&mut self, index: u16, name: &str, code: ObjectCode, mut entries: Vec<ObjectEntry>) {
        if code != ObjectCode::Variable && entries.first().is_none_or(|entry| entry.sub != 0) {
            let last = entries.last().map_or(0, |entry| entry.sub);
            let number = ObjectEntry {
                sub: 0,
                name: "Number of entries".to_owned(),
                kind: DataType::Unsigned8,
                access: access::READ,
                content: Content::Fixed(vec![last]),
            };
            entries.insert(0, number);
        }
        let object = Object {
            index,
            name: name.to_owned(),
            code,
            entries,
        };
        let at = self.objects.partition_point(|other| other.index < index);
        self.objects.insert(at, object);
    }

    /// Adds an object, or replaces the one with its index.
    pub(crate) fn put(&mut self, object: Object) {
        match self.objects.binary_search_by_key(&object.index, |other| other.index) {
            Ok(at) => self
                .objects
                .iter_mut()
                .skip(at)
                .take(1)
                .for_each(|old| *old = object.clone()),
            Err(at) => self.objects.insert(at, object),
        }
    }

    /// The objects, in order.
    pub(crate) fn into_objects(self) -> impl Iterator<Item = Object> {
        self.objects.into_iter()
    }

    /// All objects, in order.
    pub(crate) fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// The object with an index.
    pub(crate) fn object(&self, index: u16) -> Result<&Object, Abort> {
        let at = self.objects.binary_search_by_key(&index, |object| object.index);
        at.ok().and_then(|at| self.objects.get(at)).ok_or(Abort::NO_OBJECT)
    }

    /// The entry at an index and a sub-index.
    pub(crate) fn entry(&self, index: u16, sub: u8) -> Result<&ObjectEntry, Abort> {
        self.object(index)?.entry(sub).ok_or(Abort::NO_SUB_INDEX)
    }

    /// Stores the value of an entry that keeps it.
    pub(crate) fn store(&mut self, index: u16, sub: u8, bytes: &[u8]) -> Result<(), Abort> {
        let object = self
            .objects
            .iter_mut()
            .find(|object| object.index == index)
            .ok_or(Abort::NO_OBJECT)?;
        let entry = object
            .entries
            .iter_mut()
            .find(|entry| entry.sub == sub)
            .ok_or(Abort::NO_SUB_INDEX)?;
        match &mut entry.content {
            Content::Number { value, low, high } => {
                let number = entry.kind.decode(bytes)?;
                if !(*low..=*high).contains(&number) {
                    return Err(Abort::VALUE);
                }
                *value = number;
            }
            Content::Bytes { longest, .. } if bytes.len() > *longest => return Err(Abort::TOO_LONG),
            Content::Bytes { value, .. } => *value = bytes.to_vec(),
            _ => return Err(Abort::READ_ONLY),
        }
        Ok(())
    }
}

fn check_length(actual: usize, expected: usize) -> Result<(), Abort> {
    match actual {
        _ if actual > expected => Err(Abort::TOO_LONG),
        _ if actual < expected => Err(Abort::TOO_SHORT),
        _ => Ok(()),
    }
}
