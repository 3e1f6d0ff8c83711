//! Prints a slave's object dictionary: sdo read, sdo write, sdo list.

use super::table;
use crate::bus::access::BusAccess;
use crate::bus::objects::{self, ValueView};
use crate::bus::value::Type;
use crate::commands::print_json;
use crate::error::ProgramError;
use crate::link::text;
use etherpen::ethercat::wire::coe::Object;
use serde_json::Value;

/// `bus sdo read N INDEX:SUB`.
pub(super) fn read(
    access: &mut dyn BusAccess,
    slave: u8,
    object: Object,
    kind: Option<Type>,
    complete: bool,
    json: bool,
) -> Result<(), ProgramError> {
    show(&objects::read(access, slave, object, kind, complete)?, json)
}

/// `bus sdo write N INDEX:SUB VALUE --type T`.
pub(super) fn write(
    access: &mut dyn BusAccess,
    slave: u8,
    object: Object,
    written: (Type, &[u8]),
    complete: bool,
    json: bool,
) -> Result<(), ProgramError> {
    show(&objects::write(access, slave, object, written, complete)?, json)
}

/// `bus sdo list N`.
pub(super) fn list(access: &mut dyn BusAccess, slave: u8, entries: bool, json: bool) -> Result<(), ProgramError> {
    let dictionary = objects::dictionary(access, slave, entries)?;
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

fn show(read: &ValueView, json: bool) -> Result<(), ProgramError> {
    if json {
        return print_json(read);
    }
    let object = text::bus::object(Object::new(read.index, read.sub));
    let shown = match &read.value {
        Value::String(text) if read.kind == Type::Bytes.name() => text.clone(),
        Value::Number(number) if number.is_i64() || number.is_u64() => {
            let digits: String = read
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
    table::say(&format!("slave {} {object} {}: {shown}", read.slave, read.kind))
}
