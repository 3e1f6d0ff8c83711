//! A slave's object dictionary: sdo read, sdo write, sdo list.

use super::access::{self, AccessError, BusAccess};
use super::value::{Type, hex};
use super::{table, text};
use crate::commands::print_json;
use crate::error::{ProgramError, code};
use etherpen::ethercat::diagnostics::{EntryInfo, ObjectInfo, ServiceError};
use etherpen::ethercat::wire::coe::Object;
use serde::Serialize;
use serde_json::Value;

/// Reads `INDEX:SUB`: the index hexadecimal, the sub-index decimal or `0x` hexadecimal, 0 when it is left out.
///
/// # Errors
/// Text that describes the format.
pub(super) fn object(written: &str) -> Result<Object, String> {
    let wrong = || format!("'{written}' is no object; write INDEX:SUB, the index hexadecimal: 6041:0, 0x1018:1");
    let (index, sub) = written.split_once(':').unwrap_or((written, "0"));
    let index = index.strip_prefix("0x").or(index.strip_prefix("0X")).unwrap_or(index);
    let index = u16::from_str_radix(index, 16).map_err(|_| wrong())?;
    let sub = match sub.strip_prefix("0x").or(sub.strip_prefix("0X")) {
        Some(digits) => u8::from_str_radix(digits, 16),
        None => sub.parse(),
    };
    Ok(Object::new(index, sub.map_err(|_| wrong())?))
}

/// A value for a program.
#[derive(Debug, Serialize)]
struct ValueView {
    slave: u8,
    index: u16,
    sub: u8,
    #[serde(rename = "type")]
    kind: &'static str,
    bytes: String,
    value: Value,
}

impl ValueView {
    fn new(slave: u8, object: Object, kind: Type, bytes: &[u8]) -> Result<Self, ProgramError> {
        let value = kind.decode(bytes).ok_or_else(|| {
            ProgramError::new(
                code::USAGE,
                format!(
                    "{} has {} bytes ({}), which is no {}; choose another --type",
                    text::object(object),
                    bytes.len(),
                    hex(bytes),
                    kind.name()
                ),
            )
        })?;
        Ok(Self {
            slave,
            index: object.index,
            sub: object.sub,
            kind: kind.name(),
            bytes: hex(bytes),
            value,
        })
    }

    fn show(&self, json: bool) -> Result<(), ProgramError> {
        if json {
            return print_json(self);
        }
        let object = text::object(Object::new(self.index, self.sub));
        let shown = match &self.value {
            Value::String(text) if self.kind == Type::Bytes.name() => text.clone(),
            Value::Number(number) if number.is_i64() || number.is_u64() => {
                let digits: String = self
                    .bytes
                    .as_bytes()
                    .chunks(2)
                    .rev()
                    .flatten()
                    .map(|digit| *digit as char)
                    .collect();
                format!("{number} (0x{digits})")
            }
            value => value.to_string(),
        };
        table::say(&format!("slave {} {object} {}: {shown}", self.slave, self.kind))
    }
}

/// The type that the slave reports for an object; bytes if it reports none or another length.
fn told_type(access: &mut dyn BusAccess, slave: u8, object: Object, bytes: &[u8]) -> Type {
    let described = access::describe_entry(access, slave, object).ok();
    described
        .and_then(|entry| Type::from_number(entry.data_type))
        .filter(|kind| kind.decode(bytes).is_some())
        .unwrap_or(Type::Bytes)
}

/// `bus sdo read N INDEX:SUB`.
pub(super) fn read(
    access: &mut dyn BusAccess,
    slave: u8,
    object: Object,
    kind: Option<Type>,
    complete: bool,
    json: bool,
) -> Result<(), ProgramError> {
    let bytes = access::upload(access, slave, object, complete)?;
    let kind = match kind {
        Some(kind) => kind,
        None if complete => Type::Bytes,
        None => told_type(access, slave, object, &bytes),
    };
    ValueView::new(slave, object, kind, &bytes)?.show(json)
}

/// `bus sdo write N INDEX:SUB VALUE --type T`.
pub(super) fn write(
    access: &mut dyn BusAccess,
    slave: u8,
    object: Object,
    (kind, bytes): (Type, &[u8]),
    complete: bool,
    json: bool,
) -> Result<(), ProgramError> {
    access::download(access, slave, object, complete, bytes)?;
    ValueView::new(slave, object, kind, bytes)?.show(json)
}

/// An object for a program.
#[derive(Debug, Serialize)]
struct ObjectView {
    index: u16,
    name: String,
    kind: &'static str,
    data_type: u16,
    sub_max: u8,
    #[serde(skip_serializing_if = "Option::is_none")]
    entries: Option<Vec<EntryView>>,
}

impl ObjectView {
    fn new(info: &ObjectInfo) -> Self {
        Self {
            index: info.index,
            name: info.name.as_str().to_owned(),
            kind: match info.code {
                7 => "variable",
                8 => "array",
                9 => "record",
                _ => "other",
            },
            data_type: info.data_type,
            sub_max: info.sub_max,
            entries: None,
        }
    }
}

/// An entry for a program.
#[derive(Debug, Serialize)]
struct EntryView {
    sub: u8,
    name: String,
    #[serde(rename = "type")]
    kind: &'static str,
    data_type: u16,
    bits: u16,
    access: String,
}

impl EntryView {
    fn new(info: &EntryInfo) -> Self {
        Self {
            sub: info.object.sub,
            name: info.name.as_str().to_owned(),
            kind: Type::from_number(info.data_type).map_or("bytes", Type::name),
            data_type: info.data_type,
            bits: info.bits,
            access: rights(info.access),
        }
    }
}

/// Access rights of an entry: read and write in PREOP, SAFEOP and OP, mapping to outputs and inputs.
fn rights(access: u16) -> String {
    let in_states = |shift: u16, letter: char| {
        let names = ["P", "S", "O"].iter().enumerate();
        let states: String = names
            .filter(|(bit, _)| access >> shift & 1 << bit != 0)
            .map(|(_, name)| *name)
            .collect();
        match states.as_str() {
            "" => String::new(),
            "PSO" => letter.to_string(),
            some => format!("{letter}({some})"),
        }
    };
    let mapped = [(6, " out"), (7, " in")];
    let mapped = mapped
        .iter()
        .filter(|(bit, _)| access & 1 << bit != 0)
        .map(|(_, name)| *name);
    let text = in_states(0, 'r') + &in_states(3, 'w') + &mapped.collect::<String>();
    text.trim().to_owned()
}

/// A dictionary for a program.
#[derive(Debug, Serialize)]
struct Dictionary {
    slave: u8,
    objects: Vec<ObjectView>,
}

/// `bus sdo list N`.
pub(super) fn list(access: &mut dyn BusAccess, slave: u8, entries: bool, json: bool) -> Result<(), ProgramError> {
    let mut objects = Vec::new();
    for index in access::indices(access, slave)? {
        let mut object = ObjectView::new(&access::describe_object(access, slave, index)?);
        if entries {
            let found = (0..=object.sub_max).map(|sub| access::describe_entry(access, slave, Object::new(index, sub)));
            object.entries = Some(found.filter_map(present).collect::<Result<_, _>>()?);
        }
        objects.push(object);
    }
    let dictionary = Dictionary { slave, objects };
    if json {
        return print_json(&dictionary);
    }
    let mut rows = Vec::new();
    for object in &dictionary.objects {
        rows.push([
            format!("{:04X}", object.index),
            object.kind.to_owned(),
            String::new(),
            String::new(),
            object.name.clone(),
        ]);
        for entry in object.entries.iter().flatten() {
            rows.push([
                format!("  :{:02}", entry.sub),
                entry.kind.to_owned(),
                entry.bits.to_string(),
                entry.access.clone(),
                entry.name.clone(),
            ]);
        }
    }
    table::print(["object", "type", "bits", "access", "name"], &rows)
}

/// Sub-indices may be missing in between: the slave aborts requests for them.
fn present(entry: Result<EntryInfo, AccessError>) -> Option<Result<EntryView, ProgramError>> {
    match entry {
        Ok(info) => Some(Ok(EntryView::new(&info))),
        Err(AccessError::Refused(ServiceError::Bus(_))) => None,
        Err(error) => Some(Err(error.into())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_are_written_with_a_hexadecimal_index() {
        assert_eq!(object("6041:0"), Ok(Object::new(0x6041, 0)));
        assert_eq!(object("0x1018:4"), Ok(Object::new(0x1018, 4)));
        assert_eq!(object("1a00:0x0B"), Ok(Object::new(0x1A00, 11)));
        assert_eq!(object("1008"), Ok(Object::new(0x1008, 0)));
        for wrong in ["", ":", "10000:0", "6041:256", "6041:x", "status"] {
            assert!(object(wrong).is_err_and(|why| why.contains("INDEX:SUB")), "{wrong}");
        }
    }

    #[test]
    fn rights_name_the_states_only_where_they_differ() {
        assert_eq!(rights(0x3F), "rw");
        assert_eq!(rights(0x0F), "rw(P)");
        assert_eq!(rights(0x87), "r in");
        assert_eq!(rights(0), "");
    }
}
