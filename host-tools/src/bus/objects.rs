//! A slave's object dictionary: values, objects and their entries.

use super::access::{self, AccessError, BusAccess};
use super::value::{Type, hex};
use crate::error::{ProgramError, code};
use crate::link::text;
use etherpen::ethercat::diagnostics::{EntryInfo, ObjectInfo, ServiceError};
use etherpen::ethercat::wire::coe::Object;
use serde::Serialize;
use serde_json::Value;

/// Parses `INDEX:SUB`: the index hexadecimal, the sub-index decimal or `0x` hexadecimal, 0 if omitted.
///
/// # Errors
/// A text that describes the format.
pub(crate) fn parse_object(written: &str) -> Result<Object, String> {
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

/// Value of an object.
#[derive(Debug, Serialize)]
pub(crate) struct ValueView {
    pub(crate) slave: u8,
    pub(crate) index: u16,
    pub(crate) sub: u8,
    #[serde(rename = "type")]
    pub(crate) kind: &'static str,
    pub(crate) bytes: String,
    pub(crate) value: Value,
}

impl ValueView {
    fn new(slave: u8, object: Object, kind: Type, bytes: &[u8]) -> Result<Self, ProgramError> {
        let value = kind.decode(bytes).ok_or_else(|| {
            ProgramError::new(
                code::USAGE,
                format!(
                    "{} has {} bytes ({}), which is no {}; choose another --type",
                    text::bus::object(object),
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
}

/// The type that the slave reports for an object; bytes if it reports none, or one of another length.
fn told_type(access: &mut dyn BusAccess, slave: u8, object: Object, bytes: &[u8]) -> Type {
    let described = access::describe_entry(access, slave, object).ok();
    described
        .and_then(|entry| Type::from_number(entry.data_type))
        .filter(|kind| kind.decode(bytes).is_some())
        .unwrap_or(Type::Bytes)
}

/// Reads an object and decodes its value. Without `kind` the slave's type is used; a complete access returns bytes.
///
/// # Errors
/// The bus refused the request or was lost, or the value does not fit the type.
pub(crate) fn read(
    access: &mut dyn BusAccess,
    slave: u8,
    object: Object,
    kind: Option<Type>,
    complete: bool,
) -> Result<ValueView, ProgramError> {
    let bytes = access::upload(access, slave, object, complete)?;
    let kind = match kind {
        Some(kind) => kind,
        None if complete => Type::Bytes,
        None => told_type(access, slave, object, &bytes),
    };
    ValueView::new(slave, object, kind, &bytes)
}

/// Writes an object; returns what was written.
///
/// # Errors
/// The bus refused the request or was lost, or the value does not fit the type.
pub(crate) fn write(
    access: &mut dyn BusAccess,
    slave: u8,
    object: Object,
    (kind, bytes): (Type, &[u8]),
    complete: bool,
) -> Result<ValueView, ProgramError> {
    access::download(access, slave, object, complete, bytes)?;
    ValueView::new(slave, object, kind, bytes)
}

/// Description of an object.
#[derive(Debug, Serialize)]
pub(crate) struct ObjectView {
    pub(crate) index: u16,
    pub(crate) name: String,
    pub(crate) kind: &'static str,
    pub(crate) data_type: u16,
    pub(crate) sub_max: u8,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) entries: Option<Vec<EntryView>>,
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

/// Description of an entry of an object.
#[derive(Debug, Serialize)]
pub(crate) struct EntryView {
    pub(crate) sub: u8,
    pub(crate) name: String,
    #[serde(rename = "type")]
    pub(crate) kind: &'static str,
    pub(crate) data_type: u16,
    pub(crate) bits: u16,
    pub(crate) access: String,
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

/// Object dictionary of a slave.
#[derive(Debug, Serialize)]
pub(crate) struct Dictionary {
    pub(crate) slave: u8,
    pub(crate) objects: Vec<ObjectView>,
}

/// Reads a slave's object dictionary, with the entries of every object if `entries` is set.
///
/// # Errors
/// The bus refused a request or was lost.
pub(crate) fn dictionary(access: &mut dyn BusAccess, slave: u8, entries: bool) -> Result<Dictionary, ProgramError> {
    let mut objects = Vec::new();
    for index in access::indices(access, slave)? {
        let mut object = ObjectView::new(&access::describe_object(access, slave, index)?);
        if entries {
            let found = (0..=object.sub_max).map(|sub| access::describe_entry(access, slave, Object::new(index, sub)));
            object.entries = Some(found.filter_map(present).collect::<Result<_, _>>()?);
        }
        objects.push(object);
    }
    Ok(Dictionary { slave, objects })
}

/// The entry, unless the slave aborted the request: sub-indices may be missing in between.
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
        assert_eq!(parse_object("6041:0"), Ok(Object::new(0x6041, 0)));
        assert_eq!(parse_object("0x1018:4"), Ok(Object::new(0x1018, 4)));
        assert_eq!(parse_object("1a00:0x0B"), Ok(Object::new(0x1A00, 11)));
        assert_eq!(parse_object("1008"), Ok(Object::new(0x1008, 0)));
        for wrong in ["", ":", "10000:0", "6041:256", "6041:x", "status"] {
            assert!(
                parse_object(wrong).is_err_and(|why| why.contains("INDEX:SUB")),
                "{wrong}"
            );
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
