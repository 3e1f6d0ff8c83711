//! What an information memory image says: identity, names, mapping units, sync managers and process data.
//!
//! Missing or damaged parts of the image are missing here too; no image can cause a panic or an endless loop.

use crate::eeprom::sii::PdoDescription;
use crate::eeprom::windows::SyncManagerDefault;
use crate::mailbox::process_data::{Pdo, PdoEntry};
use etherpen_ethercat::wire::sii::{
    CATEGORY_CLOCKS, CATEGORY_END, CATEGORY_FMMU, CATEGORY_GENERAL, CATEGORY_RX_PDO, CATEGORY_STRINGS,
    CATEGORY_SYNC_MANAGER, CATEGORY_TX_PDO, FLAG_NO_LRW, FixedPart, General, MailboxWindow, PDO_MANDATORY,
    WORD_BOOTSTRAP_IN, WORD_BOOTSTRAP_OUT, WORD_CATEGORIES, WORD_CHECKSUM, checksum,
};

/// Most categories before a chain counts as endless.
const CATEGORIES_MAX: usize = 64;
/// Indices of PDOs.
const PDO_FIRST: u16 = 0x1600;
const PDO_END: u16 = 0x1C00;
/// High byte of word 0: device emulation; SYNC unit and latch unit powered.
const DEVICE_EMULATION: u8 = 0x01;
const CLOCK_UNITS: u8 = 0x0C;

/// Content of an image.
#[derive(Clone, Debug, Default)]
pub(crate) struct Content {
    pub(crate) fixed: FixedPart,
    pub(crate) bootstrap_out: MailboxWindow,
    pub(crate) bootstrap_in: MailboxWindow,
    /// Whether the slave controller emulates the device: it has no processor.
    pub(crate) is_emulated: bool,
    /// Whether the controller does not support LRW.
    pub(crate) ignores_lrw: bool,
    /// Whether the units of a distributed clock are powered, or settings of a clock are listed.
    pub(crate) has_clock: bool,
    pub(crate) name: String,
    /// Number of FMMUs that the device uses or could use.
    pub(crate) fmmus: usize,
    pub(crate) sync_managers: Vec<SyncManagerDefault>,
    pub(crate) pdos: Vec<PdoDescription>,
}

impl Content {
    /// Reads an image.
    pub(crate) fn parse(image: &[u8]) -> Self {
        let mut content = Self {
            fixed: FixedPart::parse(image).unwrap_or_default(),
            is_emulated: configured(image, DEVICE_EMULATION),
            has_clock: configured(image, CLOCK_UNITS),
            bootstrap_out: window(image, WORD_BOOTSTRAP_OUT),
            bootstrap_in: window(image, WORD_BOOTSTRAP_IN),
            ..Self::default()
        };
        let (mut strings, mut name_number) = (Vec::new(), 0);
        for (kind, body) in categories(image) {
            match kind {
                CATEGORY_STRINGS => strings = texts(body),
                CATEGORY_GENERAL => {
                    name_number = body.get(3).copied().unwrap_or(0);
                    content.ignores_lrw = body
                        .get(General::FLAGS_AT)
                        .is_some_and(|flags| flags & FLAG_NO_LRW != 0);
                }
                CATEGORY_CLOCKS => content.has_clock = true,
                CATEGORY_FMMU => content.fmmus = body.iter().filter(|usage| !matches!(usage, 0 | 0xFF)).count(),
                CATEGORY_SYNC_MANAGER => content.sync_managers = sync_managers(body),
                CATEGORY_RX_PDO | CATEGORY_TX_PDO => take_pdos(body, &mut content.pdos),
                _ => {}
            }
        }
        content.name = usize::from(name_number)
            .checked_sub(1)
            .and_then(|at| strings.get(at).cloned())
            .unwrap_or_default();
        content
    }

    /// Length of the PDOs of one sync manager, bytes.
    pub(crate) fn pdo_bytes(&self, manager: usize) -> usize {
        let pdos = self.pdos.iter().filter(|entry| usize::from(entry.manager) == manager);
        let entries = pdos.flat_map(|entry| entry.pdo.mapped());
        let bits: usize = entries.map(|entry| usize::from(entry.bits)).sum();
        bits.div_ceil(8)
    }
}

/// A mailbox in the fixed part; one of a memory that was never written is none.
fn window(image: &[u8], word: u16) -> MailboxWindow {
    match image
        .get(2 * usize::from(word)..)
        .and_then(|rest| rest.first_chunk::<4>())
    {
        None | Some([0xFF, 0xFF, ..]) => MailboxWindow::default(),
        Some(&[start_low, start_high, length_low, length_high]) => MailboxWindow {
            start: u16::from_le_bytes([start_low, start_high]),
            length: u16::from_le_bytes([length_low, length_high]),
        },
    }
}

/// Whether word 0 has one of these bits in its high byte, under a correct checksum.
fn configured(image: &[u8], bits: u8) -> bool {
    let place = 2 * usize::from(WORD_CHECKSUM);
    let valid = image.get(place) == image.get(..place).map(checksum).as_ref();
    valid && image.get(1).is_some_and(|byte| byte & bits != 0)
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

fn sync_managers(body: &[u8]) -> Vec<SyncManagerDefault> {
    let (managers, _) = body.as_chunks::<8>();
    let manager = |&[
        start_low,
        start_high,
        length_low,
        length_high,
        control,
        _,
        activate,
        kind,
    ]: &[u8; 8]| SyncManagerDefault {
        start: u16::from_le_bytes([start_low, start_high]),
        length: u16::from_le_bytes([length_low, length_high]),
        control,
        activate,
        kind,
    };
    managers.iter().map(manager).collect()
}

fn take_pdos(body: &[u8], pdos: &mut Vec<PdoDescription>) {
    let mut rest = body;
    while let Some((&[low, high, count, manager, _, _, flags_low, flags_high], behind)) = rest.split_first_chunk() {
        let index = u16::from_le_bytes([low, high]);
        let flags = u16::from_le_bytes([flags_low, flags_high]);
        let bytes = 8 * usize::from(count);
        let (list, behind) = behind.split_at_checked(bytes).unwrap_or((behind, &[]));
        let (entries, _) = list.as_chunks::<8>();
        let entry = |&[low, high, sub, _, _, bits, _, _]: &[u8; 8]| PdoEntry {
            index: u16::from_le_bytes([low, high]),
            sub,
            bits,
        };
        let entries: Vec<PdoEntry> = entries.iter().map(entry).collect();
        let known = pdos.iter().any(|entry| entry.pdo.index == index);
        if (PDO_FIRST..PDO_END).contains(&index) && !known {
            pdos.push(PdoDescription {
                pdo: Pdo::new(index, "Process data", true, &entries),
                manager,
                mandatory: flags & PDO_MANDATORY != 0,
            });
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
                let kinds = [10u8, 30, 40, 41, 50, 51];
                kind.copy_from_slice(&[kinds[(round / 2 % 6) as usize], 0]);
            }
            let content = Content::parse(&image);
            (0..8).for_each(|manager| drop(content.pdo_bytes(manager).to_string()));
        }
    }
}
