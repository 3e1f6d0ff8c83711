//! SDO information: a slave's description of its object dictionary.
//!
//! Lists of objects and descriptions of objects and entries, from the table that also serves the access. An answer that
//! does not fit the mailbox is split into fragments. Layout: IEC 61158-6-12, CoE, SDO information.

use crate::mailbox::abort::Abort;
use crate::mailbox::dictionary::{Dictionary, Object, ObjectCode, ObjectEntry, access};

const HEADER: usize = 4;
const MAILBOX_AND_COE: usize = 8;
const INCOMPLETE: u8 = 0x80;
const LIST_REQUEST: u8 = 1;
const OBJECT_REQUEST: u8 = 3;
const ENTRY_REQUEST: u8 = 5;
const ERROR: u8 = 7;
/// Kinds of lists: lengths, all objects, mappable to outputs, mappable to inputs, to be stored, for start-up.
const LIST_LENGTHS: u16 = 0;
const LIST_KINDS: [u16; 5] = [1, 2, 3, 4, 5];

/// The messages that answer a request, without their mailbox and CoE headers.
pub(crate) fn answer(request: &[u8], capacity: usize, dictionary: &Dictionary) -> Vec<Vec<u8>> {
    let Some((&[code, _, _, _], body)) = request.split_first_chunk::<HEADER>() else {
        return vec![error(Abort::COMMAND)];
    };
    let code = code & !INCOMPLETE;
    let result = match code {
        LIST_REQUEST => list(body, dictionary),
        OBJECT_REQUEST => object(body, dictionary),
        ENTRY_REQUEST => entry(body, dictionary),
        _ => Err(Abort::COMMAND),
    };
    match result {
        Ok(content) => fragments(code + 1, &content, capacity),
        Err(abort) => vec![error(abort)],
    }
}

fn error(Abort(code): Abort) -> Vec<u8> {
    let mut body = vec![ERROR, 0, 0, 0];
    body.extend_from_slice(&code.to_le_bytes());
    body
}

fn fragments(code: u8, content: &[u8], capacity: usize) -> Vec<Vec<u8>> {
    let room = capacity.saturating_sub(MAILBOX_AND_COE + HEADER).max(2) & !1;
    let parts = content.chunks(room);
    let count = parts.len();
    let fragment = |(index, part): (usize, &[u8])| {
        let left = count - 1 - index;
        let flag = if left > 0 { INCOMPLETE } else { 0 };
        let mut body = vec![code | flag, 0];
        body.extend_from_slice(&(left as u16).to_le_bytes());
        body.extend_from_slice(part);
        body
    };
    parts.enumerate().map(fragment).collect()
}

fn list(body: &[u8], dictionary: &Dictionary) -> Result<Vec<u8>, Abort> {
    let kind = word(body, 0).ok_or(Abort::COMMAND)?;
    let of_kind = |kind: u16| {
        dictionary
            .objects()
            .iter()
            .filter(move |object| is_listed(object, kind))
    };
    let mut content = Vec::from(kind.to_le_bytes());
    match kind {
        LIST_LENGTHS => {
            for kind in LIST_KINDS {
                content.extend_from_slice(&(of_kind(kind).count() as u16).to_le_bytes());
            }
        }
        _ if LIST_KINDS.contains(&kind) => {
            for object in of_kind(kind) {
                content.extend_from_slice(&object.index.to_le_bytes());
            }
        }
        _ => return Err(Abort::VALUE),
    }
    Ok(content)
}

fn is_listed(object: &Object, kind: u16) -> bool {
    let has = |bits: u16| object.entries.iter().any(|entry| entry.access & bits != 0);
    match kind {
        1 => true,
        2 => has(access::RX),
        3 => has(access::TX),
        _ => has(access::WRITE) && !has(access::RX),
    }
}

fn object(body: &[u8], dictionary: &Dictionary) -> Result<Vec<u8>, Abort> {
    let index = word(body, 0).ok_or(Abort::COMMAND)?;
    let object = dictionary.object(index)?;
    let last = object.entries.last();
    let kind = match object.code {
        ObjectCode::Variable | ObjectCode::Array => last.map_or(0, |entry| entry.kind as u16),
        ObjectCode::Record => 0,
    };
    let mut content = Vec::from(index.to_le_bytes());
    content.extend_from_slice(&kind.to_le_bytes());
    content.extend_from_slice(&[last.map_or(0, |entry| entry.sub), object.code as u8]);
    content.extend_from_slice(object.name.as_bytes());
    Ok(content)
}

fn entry(body: &[u8], dictionary: &Dictionary) -> Result<Vec<u8>, Abort> {
    let index = word(body, 0).ok_or(Abort::COMMAND)?;
    let sub = body.get(2).copied().ok_or(Abort::COMMAND)?;
    let object = dictionary.object(index)?;
    let described = object.entry(sub).ok_or(Abort::NO_SUB_INDEX)?;
    let ObjectEntry { kind, access, name, .. } = described;
    let bits = described.bits();
    let mut content = Vec::from(index.to_le_bytes());
    content.extend_from_slice(&[sub, 0]);
    for number in [*kind as u16, bits, *access] {
        content.extend_from_slice(&number.to_le_bytes());
    }
    content.extend_from_slice(name.as_bytes());
    Ok(content)
}

fn word(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..)?.first_chunk().map(|bytes| u16::from_le_bytes(*bytes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mailbox::dictionary::{DataType, Value, variable};

    fn dictionary(objects: u16) -> Dictionary {
        let mut dictionary = Dictionary::default();
        for index in 0..objects {
            dictionary.add_table(&[variable(
                0x2000 + index,
                "An object",
                &[(
                    0,
                    "An entry",
                    DataType::Integer16,
                    access::READ | access::TX,
                    Value::Live,
                )],
            )]);
        }
        dictionary
    }

    #[test]
    fn a_long_list_comes_in_fragments_that_count_down() {
        let answers = answer(&[1, 0, 0, 0, 1, 0], 64, &dictionary(100));
        let mut indices = Vec::new();
        let count = answers.len();
        for (at, body) in answers.iter().enumerate() {
            let left = count - 1 - at;
            assert_eq!(body[0], if left > 0 { 0x82 } else { 0x02 });
            assert_eq!(usize::from(body[2]), left);
            assert!(body.len() + 8 <= 64);
            indices.extend_from_slice(&body[4..]);
        }
        assert_eq!((count, indices.len()), (4, 2 + 200));
        assert_eq!(indices[..6], [1, 0, 0x00, 0x20, 0x01, 0x20]);
    }

    #[test]
    fn an_entry_tells_type_length_access_and_name() {
        let answers = answer(&[5, 0, 0, 0, 0x00, 0x20, 0, 0], 128, &dictionary(1));
        assert_eq!(answers[0][..14], [6, 0, 0, 0, 0x00, 0x20, 0, 0, 3, 0, 16, 0, 0x87, 0]);
        assert_eq!(&answers[0][14..], b"An entry");
        let absent = answer(&[5, 0, 0, 0, 0x00, 0x20, 1, 0], 128, &dictionary(1));
        assert_eq!(absent, [vec![7, 0, 0, 0, 0x11, 0, 0x09, 0x06]]);
    }
}
