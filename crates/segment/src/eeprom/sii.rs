//! Builds a slave information image: fixed part, categories, checksum.
//!
//! Layout: slave information interface of IEC 61158-6-12 (words, little-endian; categories from word 0x40). The real
//! drive's image is not public: identity, mailbox and process data are the known ones, the rest is plausible.

use crate::eeprom::windows::{SyncManagerDefault, Windows};
use crate::mailbox::process_data::{Pdo, ProcessData};
use etherpen_ethercat::wire::sii::{
    CATEGORY_CLOCKS, CATEGORY_END, CATEGORY_FMMU, CATEGORY_GENERAL, CATEGORY_RX_PDO, CATEGORY_STRINGS,
    CATEGORY_SYNC_MANAGER, CATEGORY_SYNC_UNIT, CATEGORY_TX_PDO, Identity, PROTOCOL_EOE, PROTOCOL_FOE, WORD_ALIAS,
    WORD_BOOTSTRAP_IN, WORD_BOOTSTRAP_OUT, WORD_CATEGORIES, WORD_CHECKSUM, WORD_MAILBOX_IN, WORD_MAILBOX_OUT,
    WORD_PROTOCOLS, WORD_SERIAL, WORD_SIZE, WORD_VENDOR, WORD_VERSION, checksum,
};

/// Size of the memory chip, bytes.
const IMAGE_BYTES: usize = 2048;
/// Data types of CiA 301.
const TYPE_BOOLEAN: u8 = 0x01;
const TYPE_INTEGER8: u8 = 0x02;
const TYPE_INTEGER32: u8 = 0x04;
const TYPE_UNSIGNED16: u8 = 0x06;
/// CoE details of the general category: SDO access, SDO information, PDO assignment, complete access.
pub(crate) const DETAILS_FIXED_PDO: u8 = 0x27;
/// CoE details of the general category: SDO access, SDO information, PDO assignment and mapping, complete access.
pub(crate) const DETAILS_MAPPABLE_PDO: u8 = 0x2F;
/// Sync manager of a PDO that is not assigned.
pub(crate) const NOT_ASSIGNED: u8 = 0xFF;
/// Word 0 of a slave with a processor: parallel interface, clock units powered.
const CONFIGURATION_PROCESSOR: u16 = 0x0C08;
/// Flags of the general category, and the one of an identification in the AL status (ETG.2010).
const GENERAL_FLAGS: usize = 11;
const GENERAL_IDENTIFIES: u8 = 0x08;
/// Flags of a PDO: mandatory, and fixed content.
const PDO_MANDATORY: u16 = 0x0001;
const PDO_FIXED: u16 = 0x0010;

/// A PDO in the image.
#[derive(Clone, Debug)]
pub(crate) struct PdoDescription {
    pub(crate) pdo: Pdo,
    /// Its sync manager; [`NOT_ASSIGNED`] without one.
    pub(crate) manager: u8,
    /// Whether it cannot be removed from its sync manager.
    pub(crate) mandatory: bool,
}

/// Content of the image.
#[derive(Clone, Debug, Default)]
pub(crate) struct Description<'a> {
    pub(crate) identity: Identity,
    pub(crate) name: &'a str,
    pub(crate) order: &'a str,
    /// Word 0: type of the process interface, and in the high byte the controller's configuration (bit 8: device
    /// emulation).
    pub(crate) configuration: u16,
    pub(crate) windows: Windows,
    pub(crate) details: u8,
    /// Current drawn from the E-bus, mA; negative for a supply.
    pub(crate) current_ma: i16,
    /// Use of each FMMU.
    pub(crate) fmmus: &'a [u8],
    pub(crate) sync_managers: Vec<SyncManagerDefault>,
    /// Whether the image has the category of sync units.
    pub(crate) has_sync_units: bool,
    pub(crate) pdos: Vec<PdoDescription>,
    /// Type of each port, as in the controller's port descriptor.
    pub(crate) ports: u8,
    /// Settings of the distributed clock, by name.
    pub(crate) clocks: &'a [ClockMode],
}

/// A setting of the distributed clock.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct ClockMode {
    /// Name.
    pub(crate) name: String,
    /// Content of the activation registers 0x0980 and 0x0981.
    pub(crate) activate: u16,
    /// Cycle of SYNC0, ns; 0 for the cycle of the bus.
    pub(crate) cycle_ns: u32,
    /// Factor of the cycle of SYNC0.
    pub(crate) factor: i16,
    /// Shift of SYNC0, ns.
    pub(crate) shift_ns: u32,
    /// Factor of the cycle of SYNC1.
    pub(crate) factor_1: i16,
    /// Shift of SYNC1, ns.
    pub(crate) shift_1_ns: u32,
}

impl Description<'_> {
    /// Describes process data behind a mailbox.
    pub(crate) fn with_mailbox(self, windows: Windows, process_data: &ProcessData) -> Self {
        let managers = process_data.managers();
        let described = |pdo: &Pdo| PdoDescription {
            manager: match (process_data.is_assigned(pdo.index), pdo.is_output()) {
                (false, _) => NOT_ASSIGNED,
                (true, true) => managers.outputs,
                (true, false) => managers.inputs,
            },
            pdo: pdo.clone(),
            mandatory: false,
        };
        Self {
            configuration: CONFIGURATION_PROCESSOR,
            windows,
            fmmus: &[1, 2, 3, 0],
            sync_managers: windows.sync_managers(&managers.types(), process_data.bytes()),
            pdos: process_data.pdos().iter().map(described).collect(),
            ..self
        }
    }
}

/// What is set on one device and stored in its image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Label {
    pub(crate) alias: u16,
    /// `None` leaves the image's serial number.
    pub(crate) serial: Option<u32>,
    /// Whether the device tells the number of its switches in the AL status.
    pub(crate) identifies: bool,
}

impl Label {
    /// Writes the label into an image, with the checksum of the configuration area if that was correct.
    pub(crate) fn stick(self, image: &mut [u8]) {
        let place = 2 * usize::from(WORD_CHECKSUM);
        let valid = |image: &[u8]| image.get(place) == image.get(..place).map(checksum).as_ref();
        if self.alias != 0 {
            let was_valid = valid(image);
            put(image, 2 * WORD_ALIAS, &self.alias.to_le_bytes());
            if let (true, Some(sum)) = (was_valid, image.get(..place).map(checksum)) {
                put(image, 2 * WORD_CHECKSUM, &[sum]);
            }
        }
        if let Some(serial) = self.serial {
            put(image, 2 * WORD_SERIAL, &serial.to_le_bytes());
        }
        let flags = category_start(image, CATEGORY_GENERAL).filter(|_| self.identifies);
        if let Some(flags) = flags.and_then(|at| image.get_mut(at + GENERAL_FLAGS)) {
            *flags |= GENERAL_IDENTIFIES;
        }
    }
}

/// First byte of a category's body.
fn category_start(image: &[u8], wanted: u16) -> Option<usize> {
    let mut at = 2 * usize::from(WORD_CATEGORIES);
    loop {
        let [kind_low, kind_high, words_low, words_high] = *image.get(at..)?.first_chunk()?;
        let kind = u16::from_le_bytes([kind_low, kind_high]);
        if kind == wanted {
            return Some(at + 4);
        }
        if kind == CATEGORY_END {
            return None;
        }
        at += 4 + 2 * usize::from(u16::from_le_bytes([words_low, words_high]));
    }
}

/// The complete image.
pub(crate) fn image(description: &Description) -> Vec<u8> {
    let mut image = vec![0; 2 * usize::from(WORD_CATEGORIES)];
    let identity = description.identity;
    let windows = description.windows;
    put(&mut image, 0, &description.configuration.to_le_bytes());
    let sum = checksum(&image);
    put(&mut image, 2 * WORD_CHECKSUM, &[sum]);
    let numbers = [identity.vendor, identity.product, identity.revision, identity.serial];
    for (at, number) in (2 * WORD_VENDOR..).step_by(4).zip(numbers) {
        put(&mut image, at, &number.to_le_bytes());
    }
    for (word, window) in [
        (WORD_BOOTSTRAP_OUT, windows.bootstrap_out),
        (WORD_BOOTSTRAP_IN, windows.bootstrap_in),
        (WORD_MAILBOX_OUT, windows.mailbox_out),
        (WORD_MAILBOX_IN, windows.mailbox_in),
    ] {
        put(&mut image, 2 * word, &window.start.to_le_bytes());
        put(&mut image, 2 * word + 2, &window.length.to_le_bytes());
    }
    put(&mut image, 2 * WORD_PROTOCOLS, &windows.protocols.to_le_bytes());
    let kibibits = (IMAGE_BYTES * 8 / 1024 - 1) as u16;
    put(&mut image, 2 * WORD_SIZE, &kibibits.to_le_bytes());
    put(&mut image, 2 * WORD_VERSION, &1u16.to_le_bytes());
    categories(&mut image, description);
    image.extend_from_slice(&CATEGORY_END.to_le_bytes());
    image.resize(IMAGE_BYTES.max(image.len()), 0xFF);
    image
}

fn categories(image: &mut Vec<u8>, description: &Description) {
    let names = description.clocks.iter().map(|mode| mode.name.as_str());
    let texts: Vec<&str> = [description.name, description.order].into_iter().chain(names).collect();
    let texts = strings(&texts);
    category(image, CATEGORY_STRINGS, &texts);
    category(image, CATEGORY_GENERAL, &general(description));
    if description.sync_managers.is_empty() {
        return;
    }
    category(image, CATEGORY_FMMU, description.fmmus);
    category(image, CATEGORY_SYNC_MANAGER, &sync_managers(&description.sync_managers));
    if description.has_sync_units {
        category(image, CATEGORY_SYNC_UNIT, &[0xF0, 0xFF]);
    }
    for (kind, outputs) in [(CATEGORY_RX_PDO, true), (CATEGORY_TX_PDO, false)] {
        let pdos = description.pdos.iter().filter(|entry| entry.pdo.is_output() == outputs);
        let body: Vec<u8> = pdos.flat_map(pdo_body).collect();
        if !body.is_empty() {
            category(image, kind, &body);
        }
    }
    let clocks: Vec<u8> = (3..)
        .zip(description.clocks)
        .flat_map(|(name, mode)| clock_body(name, mode))
        .collect();
    if !clocks.is_empty() {
        category(image, CATEGORY_CLOCKS, &clocks);
    }
}

/// Layout: ETG.2010, distributed clock category.
fn clock_body(name: u8, mode: &ClockMode) -> [u8; 24] {
    let mut body = [0; 24];
    put(&mut body, 0, &mode.cycle_ns.to_le_bytes());
    put(&mut body, 4, &mode.shift_ns.to_le_bytes());
    put(&mut body, 8, &mode.shift_1_ns.to_le_bytes());
    put(&mut body, 12, &mode.factor_1.to_le_bytes());
    put(&mut body, 14, &mode.activate.to_le_bytes());
    put(&mut body, 16, &mode.factor.to_le_bytes());
    put(&mut body, 18, &[name]);
    body
}

fn put(image: &mut [u8], at: u16, bytes: &[u8]) {
    for (target, source) in image.iter_mut().skip(usize::from(at)).zip(bytes) {
        *target = *source;
    }
}

fn category(image: &mut Vec<u8>, kind: u16, body: &[u8]) {
    let words = body.len().div_ceil(2);
    image.extend_from_slice(&kind.to_le_bytes());
    image.extend_from_slice(&(words as u16).to_le_bytes());
    image.extend_from_slice(body);
    image.resize(image.len() + 2 * words - body.len(), 0);
}

fn strings(texts: &[&str]) -> Vec<u8> {
    let mut body = vec![texts.len() as u8];
    for text in texts {
        let bytes = text.as_bytes().get(..text.len().min(255)).unwrap_or_default();
        body.push(bytes.len() as u8);
        body.extend_from_slice(bytes);
    }
    body
}

/// Group, image, order and name are string numbers; four bits for the type of each port (1 MII, 3 EBUS).
fn general(description: &Description) -> [u8; 32] {
    let mut body = [0; 32];
    let details = if description.windows.has_mailbox() {
        description.details
    } else {
        0
    };
    let speaks = |protocol| u8::from(description.windows.protocols & protocol != 0);
    put(
        &mut body,
        0,
        &[2, 0, 2, 1, 0, details, speaks(PROTOCOL_FOE), speaks(PROTOCOL_EOE)],
    );
    let mut ports = 0u16;
    for port in 0..4 {
        let kind = match description.ports >> (2 * port) & 3 {
            3 => 1,
            2 => 3,
            _ => 0,
        };
        ports |= kind << (4 * port);
    }
    put(&mut body, 12, &description.current_ma.to_le_bytes());
    put(&mut body, 16, &ports.to_le_bytes());
    body
}

fn sync_managers(list: &[SyncManagerDefault]) -> Vec<u8> {
    let mut body = Vec::new();
    for manager in list {
        body.extend_from_slice(&manager.start.to_le_bytes());
        body.extend_from_slice(&manager.length.to_le_bytes());
        body.extend_from_slice(&[manager.control, 0, manager.activate, manager.kind]);
    }
    body
}

fn pdo_body(description: &PdoDescription) -> Vec<u8> {
    let pdo = &description.pdo;
    let mut body = Vec::from(pdo.index.to_le_bytes());
    let fixed = if pdo.fixed { PDO_FIXED } else { 0 };
    let flags = fixed | if description.mandatory { PDO_MANDATORY } else { 0 };
    body.extend_from_slice(&[pdo.mapped().len() as u8, description.manager, 0, 0]);
    body.extend_from_slice(&flags.to_le_bytes());
    for entry in pdo.mapped() {
        let data_type = match entry.bits {
            1 => TYPE_BOOLEAN,
            8 => TYPE_INTEGER8,
            32 => TYPE_INTEGER32,
            _ => TYPE_UNSIGNED16,
        };
        body.extend_from_slice(&entry.index.to_le_bytes());
        body.extend_from_slice(&[entry.sub, 0, data_type, entry.bits, 0, 0]);
    }
    body
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mailbox::process_data::PdoEntry;
    use etherpen_ethercat::wire::sii::{FixedPart, MailboxWindow, PROTOCOL_COE};

    fn example() -> Vec<u8> {
        let window = |start| MailboxWindow { start, length: 512 };
        let entries = [PdoEntry::new(0x6064, 32), PdoEntry::new(0x6041, 16)];
        let pdos = vec![
            Pdo::new(0x1702, "out", true, &entries),
            Pdo::new(0x1B01, "in", true, &entries),
        ];
        let windows = Windows {
            mailbox_out: window(0x1800),
            mailbox_in: window(0x1C00),
            outputs: 0x1100,
            inputs: 0x1140,
            protocols: PROTOCOL_COE,
            ..Windows::NONE
        };
        let description = Description {
            identity: Identity {
                vendor: 2,
                product: 3,
                revision: 4,
                serial: 5,
            },
            name: "a drive",
            order: "X1",
            details: DETAILS_FIXED_PDO,
            ports: 0x0F,
            ..Description::default()
        };
        image(&description.with_mailbox(windows, &ProcessData::new(pdos, &[0x1702], &[0x1B01], 1)))
    }

    #[test]
    fn the_fixed_part_tells_identity_and_mailboxes() {
        let image = example();
        let fixed = FixedPart::parse(&image).expect("long enough");
        assert_eq!(
            fixed.identity,
            Identity {
                vendor: 2,
                product: 3,
                revision: 4,
                serial: 5
            }
        );
        assert_eq!((fixed.mailbox_out.start, fixed.mailbox_in.length), (0x1800, 512));
        assert_eq!(fixed.protocols, PROTOCOL_COE);
        assert_eq!(image[14], checksum(&image));
        assert_eq!(image.len(), 2048);
    }

    #[test]
    fn the_categories_follow_each_other_to_the_end_mark() {
        let image = example();
        let mut at = 2 * usize::from(WORD_CATEGORIES);
        let mut found = Vec::new();
        loop {
            let kind = u16::from_le_bytes([image[at], image[at + 1]]);
            found.push(kind);
            if kind == CATEGORY_END {
                break;
            }
            at += 4 + 2 * usize::from(u16::from_le_bytes([image[at + 2], image[at + 3]]));
        }
        assert_eq!(found, [10, 30, 40, 41, 51, 50, 0xFFFF]);
    }
}
