//! A slave made from an information memory image: the registers and lists of a real device, without function.
//!
//! Identity, mailboxes, sync managers and process-data objects follow the image. Identity objects and process-data
//! lists are served, inputs are zero, outputs are ignored. Missing or damaged parts of the image are missing here too;
//! no image can cause a panic or an endless loop.

use crate::devices::Device;
use crate::eeprom::windows::Windows;
use crate::mailbox::dictionary::{DataType, Dictionary, ObjectRow, Value, access, record, variable};
use crate::mailbox::live_objects::LiveObjects;
use crate::mailbox::process_data::{Pdo, PdoEntry, ProcessData};
use etherpen_ethercat::wire::sii::{
    CATEGORY_END, CATEGORY_GENERAL, CATEGORY_RX_PDO, CATEGORY_STRINGS, CATEGORY_SYNC_MANAGER, CATEGORY_TX_PDO,
    FixedPart, WORD_CATEGORIES,
};

/// Most categories before a chain counts as endless.
const CATEGORIES_MAX: usize = 64;
/// Addresses of process data if the image has no sync managers for them.
const OUTPUTS_DEFAULT: u16 = 0x1100;
const INPUTS_DEFAULT: u16 = 0x1400;

const OBJECTS: &[ObjectRow] = &[
    variable(
        0x1000,
        "Device type",
        &[(
            0,
            "Device type",
            DataType::Unsigned32,
            access::READ,
            Value::Number(0x0002_0192),
        )],
    ),
    record(
        0x1C00,
        "Sync manager types",
        &[
            (1, "Sync manager 0", DataType::Unsigned8, access::READ, Value::Number(1)),
            (2, "Sync manager 1", DataType::Unsigned8, access::READ, Value::Number(2)),
            (3, "Sync manager 2", DataType::Unsigned8, access::READ, Value::Number(3)),
            (4, "Sync manager 3", DataType::Unsigned8, access::READ, Value::Number(4)),
        ],
    ),
];

/// The device behind one slave controller.
#[derive(Clone, Debug)]
pub(crate) struct ImageDevice {
    image: Vec<u8>,
    name: String,
    windows: Windows,
    process_data: ProcessData,
}

impl ImageDevice {
    /// A slave with this information memory.
    pub(crate) fn new(image: Vec<u8>) -> Self {
        let fixed = FixedPart::parse(&image).unwrap_or_default();
        let mut windows = Windows {
            mailbox_out: fixed.mailbox_out,
            mailbox_in: fixed.mailbox_in,
            outputs: OUTPUTS_DEFAULT,
            inputs: INPUTS_DEFAULT,
        };
        let (mut pdos, mut assigned) = (Vec::new(), [Vec::new(), Vec::new()]);
        let (mut strings, mut name_number) = (Vec::new(), 0);
        for (kind, body) in categories(&image) {
            match kind {
                CATEGORY_STRINGS => strings = texts(body),
                CATEGORY_GENERAL => name_number = body.get(3).copied().unwrap_or(0),
                CATEGORY_SYNC_MANAGER => take_windows(body, &mut windows),
                CATEGORY_RX_PDO | CATEGORY_TX_PDO => {
                    let [outputs, inputs] = &mut assigned;
                    let assigned = if kind == CATEGORY_RX_PDO { outputs } else { inputs };
                    take_pdos(body, &mut pdos, assigned);
                }
                _ => {}
            }
        }
        let name = usize::from(name_number)
            .checked_sub(1)
            .and_then(|at| strings.get(at).cloned())
            .unwrap_or_default();
        let [outputs, inputs] = assigned;
        let process_data = ProcessData::new(pdos, &outputs, &inputs, usize::from(ProcessData::ASSIGNED_MAX));
        Self {
            image,
            name,
            windows,
            process_data,
        }
    }
}

impl LiveObjects for ImageDevice {}

impl Device for ImageDevice {
    fn image(&self) -> Vec<u8> {
        self.image.clone()
    }

    fn windows(&self) -> Windows {
        self.windows
    }

    fn process_data(&self) -> ProcessData {
        self.process_data.clone()
    }

    fn dictionary(&self) -> Dictionary {
        let mut dictionary = Dictionary::default();
        dictionary.add_table(OBJECTS);
        dictionary.add_text(0x1008, "Device name", &self.name);
        dictionary.add_identity(&FixedPart::parse(&self.image).unwrap_or_default().identity);
        self.process_data.describe(&mut dictionary);
        dictionary
    }

    fn boxed_clone(&self) -> Box<dyn Device> {
        Box::new(self.clone())
    }
}

/// Category numbers and bodies; a body that exceeds the image is cut, and the chain ends there.
fn categories(image: &[u8]) -> Vec<(u16, &[u8])> {
    let mut found = Vec::new();
    let mut rest = image.get(2 * usize::from(WORD_CATEGORIES)..).unwrap_or_default();
    while let Some((&[kind_low, kind_high, words_low, words_high], body)) = rest.split_first_chunk() {
        let kind = u16::from_le_bytes([kind_low, kind_high]);
        let bytes = 2 * usize::from(u16::from_le_bytes([words_low, words_high]));
        if kind == CATEGORY_END || found.len() >= CATEGORIES_MAX {
            break;
        }
        let (body, behind) = body.split_at_checked(bytes).unwrap_or((body, &[]));
        found.push((kind, body));
        rest = behind;
    }
    found
}

fn texts(body: &[u8]) -> Vec<String> {
    let mut found = Vec::new();
    let Some((&count, mut rest)) = body.split_first() else {
        return found;
    };
    for _ in 0..count {
        let Some((&length, behind)) = rest.split_first() else {
            break;
        };
        let (text, behind) = behind.split_at_checked(usize::from(length)).unwrap_or((behind, &[]));
        let text: Vec<u8> = text.iter().copied().take_while(|byte| *byte != 0).collect();
        found.push(String::from_utf8_lossy(&text).into_owned());
        rest = behind;
    }
    found
}

fn take_windows(body: &[u8], windows: &mut Windows) {
    let (managers, _) = body.as_chunks::<8>();
    for &[start_low, start_high, length_low, length_high, _, _, _, kind] in managers {
        let start = u16::from_le_bytes([start_low, start_high]);
        let length = u16::from_le_bytes([length_low, length_high]);
        match kind {
            1 => (windows.mailbox_out.start, windows.mailbox_out.length) = (start, length),
            2 => (windows.mailbox_in.start, windows.mailbox_in.length) = (start, length),
            3 => windows.outputs = start,
            4 => windows.inputs = start,
            _ => {}
        }
    }
}

fn take_pdos(body: &[u8], pdos: &mut Vec<Pdo>, assigned: &mut Vec<u16>) {
    let mut rest = body;
    while let Some((&[low, high, count, manager, _, _, _, _], behind)) = rest.split_first_chunk() {
        let index = u16::from_le_bytes([low, high]);
        let bytes = 8 * usize::from(count);
        let (list, behind) = behind.split_at_checked(bytes).unwrap_or((behind, &[]));
        let (entries, _) = list.as_chunks::<8>();
        let entry = |&[low, high, sub, _, _, bits, _, _]: &[u8; 8]| PdoEntry {
            index: u16::from_le_bytes([low, high]),
            sub,
            bits,
        };
        let entries: Vec<PdoEntry> = entries.iter().map(entry).collect();
        let known = pdos.iter().any(|pdo: &Pdo| pdo.index == index);
        if (0x1600..0x1C00).contains(&index) && !known {
            pdos.push(Pdo::new(index, "Process data", true, &entries));
            if manager != 0xFF && assigned.len() < usize::from(ProcessData::ASSIGNED_MAX) {
                assigned.push(index);
            }
        }
        rest = behind;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_image_breaks_it() {
        let mut random = crate::random::Random::new(5);
        for round in 0..2_000u64 {
            let mut image: Vec<u8> = (0..random.bits() % 600).map(|_| random.bits() as u8).collect();
            if let Some(kind) = image.get_mut(128..130).filter(|_| round % 2 == 0) {
                let kinds = [10u8, 30, 41, 50, 51];
                kind.copy_from_slice(&[kinds[(round / 2 % 5) as usize], 0]);
            }
            let device = ImageDevice::new(image);
            device.dictionary();
            device.process_data().bytes();
        }
    }
}
