//! Information memories of real devices, as descriptions that can be read.
//!
//! Facts of eight dumps (identities, units, process data) of ethercrab's folder `dumps/eeprom`; names are shortened. Where
//! the dumps themselves are at hand, a test compares each description with its dump.

use etherpen::ethercat::configure::Direction;
use etherpen::ethercat::wire::sii::{CATEGORY_END, checksum};

/// A device's information memory.
pub(crate) struct Description {
    /// File name of its dump.
    pub(crate) file: &'static str,
    /// Size of the memory, bytes.
    pub(crate) bytes: usize,
    /// Words 0 to 3: what the controller loads at power-up.
    pub(crate) configuration: [u16; 4],
    /// Word 7; `None` for the checksum of the words before it.
    pub(crate) checksum: Option<u16>,
    /// Vendor, product, revision, serial number.
    pub(crate) identity: [u32; 4],
    /// Words 0x14 to 0x1C: bootstrap and standard mailboxes, protocols.
    pub(crate) mailboxes: [u16; 9],
    /// Words 0x3E and 0x3F: size of the memory in KiBit less 1, version.
    pub(crate) size: [u16; 2],
    pub(crate) categories: Vec<(u16, Vec<u8>)>,
    /// Words that the last category claims to have, if they are more than there are.
    pub(crate) claimed_words: Option<u16>,
    /// What is behind the categories: [`CATEGORY_END`], or zeros that are categories of type 0 and length 0.
    pub(crate) end: u16,
}

/// Entry of a PDO: object and length in bits.
type Entry = (u16, u8, u8);

/// PDO index, sync manager, flags, entries.
struct Pdo(u16, u8, u16, &'static [Entry]);

const STRINGS: u16 = 10;
const GENERAL: u16 = 30;
const FMMUS: u16 = 40;
const SYNC_MANAGERS: u16 = 41;
const TX_PDOS: u16 = 50;
const RX_PDOS: u16 = 51;
const CLOCKS: u16 = 60;
/// Mandatory, with fixed content.
const FIXED: u16 = 0x0011;
/// Fixed content.
const CONTENT: u16 = 0x0010;
/// Of no sync manager.
const UNASSIGNED: u8 = 0xFF;

impl Description {
    /// The memory, byte for byte.
    pub(crate) fn image(&self) -> Vec<u8> {
        let mut image = vec![0; 0x80];
        let mut put = |word: usize, values: &[u16]| {
            for (target, value) in image[2 * word..].chunks_exact_mut(2).zip(values) {
                target.copy_from_slice(&value.to_le_bytes());
            }
        };
        put(0, &self.configuration);
        let halves = self.identity.map(|number| [number as u16, (number >> 16) as u16]);
        put(0x08, halves.as_flattened());
        put(0x14, &self.mailboxes);
        put(0x3E, &self.size);
        let sum = self.checksum.unwrap_or_else(|| checksum(&image[..14]).into());
        image[14..16].copy_from_slice(&sum.to_le_bytes());
        for (number, (kind, content)) in self.categories.iter().enumerate() {
            let words = (content.len() / 2) as u16;
            let is_last = number + 1 == self.categories.len();
            let words = self.claimed_words.filter(|_| is_last).unwrap_or(words);
            image.extend_from_slice(&kind.to_le_bytes());
            image.extend_from_slice(&words.to_le_bytes());
            image.extend_from_slice(content);
        }
        if self.claimed_words.is_none() {
            image.extend_from_slice(&self.end.to_le_bytes());
            image.resize(self.bytes, self.end as u8);
        }
        image
    }
}

/// Texts with their lengths, padded to whole words.
fn strings(texts: &[&str]) -> (u16, Vec<u8>) {
    let mut content = vec![texts.len() as u8];
    for text in texts {
        content.push(text.len() as u8);
        content.extend_from_slice(text.as_bytes());
    }
    content.resize(content.len().next_multiple_of(2), 0);
    (STRINGS, content)
}

/// Numbers of strings (group, image, order, name), CoE details with FoE and EoE, flags, current of the E-bus in mA, kinds
/// of ports.
fn general(strings: [u8; 4], protocols: [u8; 3], flags: u8, current_ma: i16, ports: u16) -> (u16, Vec<u8>) {
    let mut content = vec![0; 32];
    content[..4].copy_from_slice(&strings);
    content[5..8].copy_from_slice(&protocols);
    content[11] = flags;
    content[12..14].copy_from_slice(&current_ma.to_le_bytes());
    content[16..18].copy_from_slice(&ports.to_le_bytes());
    (GENERAL, content)
}

/// Start, length, control, activation, use of each sync manager.
fn managers(list: &[(u16, u16, u8, u8, u8)]) -> (u16, Vec<u8>) {
    let block = |&(start, length, control, activation, usage): &(u16, u16, u8, u8, u8)| {
        let ([a, b], [c, d]) = (start.to_le_bytes(), length.to_le_bytes());
        [a, b, c, d, control, 0, activation, usage]
    };
    (SYNC_MANAGERS, list.iter().flat_map(block).collect())
}

fn pdos(kind: u16, list: &[Pdo]) -> (u16, Vec<u8>) {
    let mut content = Vec::new();
    for Pdo(index, manager, flags, entries) in list {
        content.extend_from_slice(&index.to_le_bytes());
        content.extend_from_slice(&[entries.len() as u8, *manager, 0, 0]);
        content.extend_from_slice(&flags.to_le_bytes());
        for (index, sub, bits) in *entries {
            content.extend_from_slice(&index.to_le_bytes());
            content.extend_from_slice(&[*sub, 0, 0, *bits, 0, 0]);
        }
    }
    (kind, content)
}

/// A Beckhoff device without mailbox.
fn beckhoff(file: &'static str, configuration: [u16; 4], product: u32, revision: u32) -> Description {
    Description {
        file,
        bytes: 2048,
        configuration,
        checksum: None,
        identity: [2, product, revision, 0],
        mailboxes: [0; 9],
        size: [15, 1],
        categories: Vec::new(),
        claimed_words: None,
        end: CATEGORY_END,
    }
}

/// A terminal with so many bytes of outputs and inputs, each in a sync manager of its own; with distributed clocks or
/// without.
pub(crate) fn terminal_of_bytes(outputs: u16, inputs: u16, clock: bool) -> Vec<u8> {
    terminal_of_managers(&[(Direction::Outputs, outputs), (Direction::Inputs, inputs)], 2, clock)
}

/// A terminal with sync managers of so many bytes in this order, without those of 0 bytes, and at most so many FMMUs; with
/// distributed clocks or without. The control bytes of some are for the other direction.
pub(crate) fn terminal_of_managers(list: &[(Direction, u16)], fmmus: usize, clock: bool) -> Vec<u8> {
    // Three buffers of up to 42 bytes each.
    let all = (0x1000..).step_by(0x80).zip(list);
    let all = all.map(|(start, (direction, bytes))| match direction {
        Direction::Outputs => (start, *bytes, if start == 0x1100 { 0x60 } else { 0x64 }, 0x09, 3),
        Direction::Inputs => (start, *bytes, if start == 0x1100 { 0x64 } else { 0x20 }, 0x09, 4),
    });
    let used: Vec<_> = all.filter(|(_, bytes, ..)| *bytes > 0).collect();
    let mut units: Vec<u8> = used.iter().map(|(.., usage)| usage - 2).take(fmmus).collect();
    units.resize(units.len().next_multiple_of(2), 0xFF);
    let configuration = if clock { 0x0D04 } else { 0x0104 };
    let description = Description {
        categories: vec![
            strings(&["BYTES", "", "", "terminal of bytes"]),
            general([2, 0, 1, 4], [0; 3], 0, 10, 0x0033),
            (FMMUS, units),
            managers(&used),
        ],
        ..beckhoff("", [configuration, 0, 0, 0], 0x0B17_E500, 1)
    };
    description.image()
}

/// A memory whose general category says that LRW is not supported.
pub(crate) fn without_lrw(mut image: Vec<u8>) -> Vec<u8> {
    let mut at = 0x80;
    let word = |image: &[u8], at: usize| u16::from_le_bytes([image[at], image[at + 1]]);
    while word(&image, at) != GENERAL {
        at += 4 + 2 * usize::from(word(&image, at + 2));
    }
    image[at + 4 + 11] |= 1 << 1;
    image
}

/// A coupler: no FMMU, no sync manager; it supplies the E-bus.
fn ek1100() -> Description {
    Description {
        categories: vec![
            strings(&["EK1100", "", "", "EK1100 EtherCAT coupler"]),
            general([2, 0, 1, 4], [0; 3], 0, -2000, 0x0131),
        ],
        ..beckhoff("ek1100.hex", [0x0D00, 0, 0, 0], 0x044C_2C52, 0x0012_0000)
    }
}

/// One channel of one bit for each PDO.
const CHANNELS: [Pdo; 8] = [
    Pdo(0x1600, 0, FIXED, &[(0x7000, 1, 1)]),
    Pdo(0x1601, 0, FIXED, &[(0x7010, 1, 1)]),
    Pdo(0x1602, 0, FIXED, &[(0x7020, 1, 1)]),
    Pdo(0x1603, 0, FIXED, &[(0x7030, 1, 1)]),
    Pdo(0x1604, 0, FIXED, &[(0x7040, 1, 1)]),
    Pdo(0x1605, 0, FIXED, &[(0x7050, 1, 1)]),
    Pdo(0x1606, 0, FIXED, &[(0x7060, 1, 1)]),
    Pdo(0x1607, 0, FIXED, &[(0x7070, 1, 1)]),
];

/// Four outputs, whose sync manager's length is left to the PDOs.
fn el2004() -> Description {
    Description {
        categories: vec![
            strings(&["EL2004", "", "", "EL2004 4 outputs"]),
            general([2, 0, 1, 4], [0; 3], 0, 100, 0x0033),
            (FMMUS, vec![1, 0xFF]),
            managers(&[(0x0F00, 0, 0x44, 0x09, 3)]),
            (43, vec![0xF0, 0xFF]),
            pdos(RX_PDOS, &CHANNELS[..4]),
        ],
        ..beckhoff(
            "el2004-eeprom-dump.bin",
            [0x0104, 0, 0, 0x000F],
            0x07D4_3052,
            0x0010_0000,
        )
    }
}

/// Eight outputs; a category of the maker is in front of the others.
fn el2828() -> Description {
    Description {
        categories: vec![
            (3, vec![0x20; 72]),
            strings(&["EL2828", "", "", "EL2828 8 outputs"]),
            general([2, 0, 1, 4], [0; 3], 0, 110, 0x0033),
            (FMMUS, vec![1, 0xFF]),
            managers(&[(0x0F00, 1, 0x44, 0x09, 3)]),
            (43, vec![0xF0, 0xFF]),
            pdos(RX_PDOS, &CHANNELS),
        ],
        ..beckhoff("el2828.hex", [0x0104, 0, 0, 0x00FF], 0x0B0C_3052, 0x0011_0000)
    }
}

/// Two outputs with oversampling: counters, samples and gaps as PDOs, a sync manager that is none.
fn el2262() -> Description {
    const fn gap(index: u16, manager: u8, bits: &'static [Entry]) -> Pdo {
        Pdo(index, manager, CONTENT, bits)
    }
    let outputs = [
        Pdo(0x1700, 0, CONTENT, &[(0x7800, 1, 16)]),
        Pdo(0x1600, 0, CONTENT, &[(0x7000, 1, 1)]),
        Pdo(0x1800, 0, CONTENT, &[(0x7200, 1, 8)]),
        gap(0x1710, 0, &[(0, 0, 1)]),
        gap(0x1711, 0, &[(0, 0, 2)]),
        gap(0x1712, 0, &[(0, 0, 3)]),
        gap(0x1713, 0, &[(0, 0, 4)]),
        gap(0x1714, 0, &[(0, 0, 5)]),
        gap(0x1715, 0, &[(0, 0, 6)]),
        gap(0x1716, 0, &[(0, 0, 7)]),
        Pdo(0x1701, 1, CONTENT, &[(0x7800, 2, 16)]),
        Pdo(0x1680, 1, CONTENT, &[(0x7000, 2, 1)]),
        Pdo(0x1880, 1, CONTENT, &[(0x7200, 2, 8)]),
        gap(0x1718, 1, &[(0, 0, 1)]),
        gap(0x1719, 1, &[(0, 0, 2)]),
        gap(0x171A, 1, &[(0, 0, 3)]),
        gap(0x171B, 1, &[(0, 0, 4)]),
        gap(0x171C, 1, &[(0, 0, 5)]),
        gap(0x171D, 1, &[(0, 0, 6)]),
        gap(0x171E, 1, &[(0, 0, 7)]),
    ];
    let mut clock = vec![0; 96];
    for mode in clock.chunks_exact_mut(24) {
        mode[14..16].copy_from_slice(&0x0730_u16.to_le_bytes());
    }
    Description {
        categories: vec![
            (1, vec![0; 6]),
            strings(&["EL2262", "", "", "EL2262 2 outputs, oversampling"]),
            general([2, 0, 1, 4], [0; 3], 0, 70, 0x0033),
            (FMMUS, vec![1, 1, 2, 0xFF]),
            managers(&[
                (0x1000, 0, 0x64, 0x09, 3),
                (0x1200, 0, 0x64, 0x09, 3),
                (0x0998, 0, 0x00, 0x04, 4),
            ]),
            (42, vec![0xFE, 0xFF, 0, 0, 0xFE, 0xFF, 1, 0, 0xFE, 0xFF, 2, 0]),
            (43, vec![0xF0, 0xFF, 0xF0, 0xFF]),
            pdos(TX_PDOS, &[Pdo(0x1702, 2, 0x0030, &[(0x1D09, 0x98, 32)])]),
            pdos(RX_PDOS, &outputs),
            (CLOCKS, clock),
        ],
        ..beckhoff("el2262.bin", [0x0506, 0, 0x0010, 0x0001], 0x08D6_3052, 0x0003_0000)
    }
}

/// A memory of 128 KiB that is blank but for a few words: its categories of type 0 and length 0 never end.
fn blank() -> Description {
    Description {
        bytes: 131_070,
        checksum: Some(0),
        identity: [1, 0, 0, 0],
        size: [0; 2],
        end: 0,
        ..beckhoff("issue-286-empty-eeprom-example.bin", [0x004F, 0, 0xDCCF, 0], 0, 0)
    }
}

/// A servo drive with mailboxes of 1,024 bytes, categories of its maker, and sync managers of length 0.
fn akd() -> Description {
    let outputs = [
        Pdo(0x1600, UNASSIGNED, 0, &[(0x6040, 0, 16)]),
        Pdo(0x1601, UNASSIGNED, 0, &[]),
        Pdo(0x1701, 2, CONTENT, &[(0x60C1, 1, 32), (0x6040, 0, 16)]),
        Pdo(0x1702, UNASSIGNED, CONTENT, &[(0x60FF, 0, 32), (0x6040, 0, 16)]),
    ];
    let inputs = [
        Pdo(0x1A00, UNASSIGNED, 0, &[(0x6041, 0, 16)]),
        Pdo(0x1A01, UNASSIGNED, 0, &[]),
        Pdo(0x1B01, 3, CONTENT, &[(0x6063, 0, 32), (0x6041, 0, 16)]),
    ];
    let mut clock = vec![0; 48];
    clock[14..16].copy_from_slice(&0x0300_u16.to_le_bytes());
    Description {
        identity: [0x6A, 0x0041_4B44, 2, 0x9983_0093],
        mailboxes: [0x1800, 1024, 0x1C00, 1024, 0x1800, 1024, 0x1C00, 1024, 0x000E],
        categories: vec![
            (2048, vec![0; 20]),
            (2049, vec![0; 12]),
            strings(&["AKD", "Drive", "Drives", "AKD EtherCAT Drive (CoE)", "DRIVE"]),
            general([2, 5, 1, 4], [0x0D, 1, 3], 0x05, 0, 0x0011),
            (FMMUS, vec![1, 2, 3, 0xFF]),
            managers(&[
                (0x1800, 1024, 0x26, 0x01, 1),
                (0x1C00, 1024, 0x22, 0x01, 2),
                (0x1100, 0, 0x24, 0x01, 3),
                (0x1140, 0, 0x20, 0x01, 4),
            ]),
            (43, vec![0xF0, 0xFF]),
            pdos(TX_PDOS, &inputs),
            pdos(RX_PDOS, &outputs),
            (CLOCKS, clock),
        ],
        ..beckhoff("akd.hex", [0x0009, 0x0800, 0, 0], 0, 0)
    }
}

/// A drive with a memory whose categories run past its end: a sound one and two of the maker are in front.
fn damaged_akd() -> Description {
    let mut categories = akd().categories;
    categories.truncate(2);
    categories.push(strings(&["AKD", "Drive", "Drives", "AKD EtherCA", "", "DRIVE"]));
    categories.push((256, vec![0; 100]));
    Description {
        file: "akd_null_strings.hex",
        categories,
        claimed_words: Some(1280),
        ..akd()
    }
}

/// Eight slaves: the blank memory, the coupler twice, and one of each other kind.
pub(crate) fn eight() -> [Description; 8] {
    [
        ek1100(),
        el2004(),
        el2262(),
        el2828(),
        blank(),
        akd(),
        damaged_akd(),
        ek1100(),
    ]
}
