//! Builds a slave information image: fixed part, categories, checksum.
//!
//! Layout: slave information interface of IEC 61158-6-12 (words, little-endian; categories from word 0x40). The real
//! drive's image is not public: identity, mailbox and process data are the known ones, the rest is plausible.

use etherpen::ethercat::wire::sii::{
    CATEGORY_END, CATEGORY_FMMU, CATEGORY_GENERAL, CATEGORY_RX_PDO, CATEGORY_STRINGS, CATEGORY_SYNC_MANAGER,
    CATEGORY_TX_PDO, Identity, MailboxWindow, PROTOCOL_COE, WORD_CATEGORIES, WORD_CHECKSUM, WORD_MAILBOX_IN,
    WORD_MAILBOX_OUT, WORD_PROTOCOLS, WORD_SIZE, WORD_VENDOR, WORD_VERSION, checksum,
};

/// Size of the memory chip, bytes.
const IMAGE_BYTES: usize = 2048;
/// General category: SDO access and PDO assignment.
const COE_DETAILS: u8 = 0x05;
/// Data types of CiA 301.
const TYPE_INTEGER32: u8 = 0x04;
const TYPE_UNSIGNED16: u8 = 0x06;

/// One sync manager as the image describes it.
#[derive(Clone, Copy, Debug)]
pub(super) struct SyncManagerDefault {
    pub(super) start: u16,
    pub(super) length: u16,
    pub(super) control: u8,
    pub(super) activate: u8,
    /// 1 and 2 mailbox out and in, 3 and 4 process data out and in.
    pub(super) kind: u8,
}

/// One entry of a process-data object.
#[derive(Clone, Copy, Debug)]
pub(super) struct PdoEntry {
    pub(super) index: u16,
    pub(super) bits: u8,
}

/// What the image says.
#[derive(Clone, Copy, Debug)]
pub(super) struct Description<'a> {
    pub(super) identity: Identity,
    pub(super) name: &'a str,
    pub(super) order: &'a str,
    pub(super) mailbox_out: MailboxWindow,
    pub(super) mailbox_in: MailboxWindow,
    pub(super) sync_managers: &'a [SyncManagerDefault],
    pub(super) rx_pdo: (u16, &'a [PdoEntry]),
    pub(super) tx_pdo: (u16, &'a [PdoEntry]),
}

/// The whole image.
pub(super) fn image(description: &Description) -> Vec<u8> {
    let mut image = vec![0; 2 * usize::from(WORD_CATEGORIES)];
    let identity = description.identity;
    put(&mut image, 0, &[0x08, 0x0C]);
    let sum = checksum(&image);
    put(&mut image, 2 * WORD_CHECKSUM, &[sum]);
    let numbers = [identity.vendor, identity.product, identity.revision, identity.serial];
    for (at, number) in (2 * WORD_VENDOR..).step_by(4).zip(numbers) {
        put(&mut image, at, &number.to_le_bytes());
    }
    let windows = [
        (WORD_MAILBOX_OUT, description.mailbox_out),
        (WORD_MAILBOX_IN, description.mailbox_in),
    ];
    for (word, window) in windows {
        put(&mut image, 2 * word, &window.start.to_le_bytes());
        put(&mut image, 2 * word + 2, &window.length.to_le_bytes());
    }
    put(&mut image, 2 * WORD_PROTOCOLS, &PROTOCOL_COE.to_le_bytes());
    let kibibits = (IMAGE_BYTES * 8 / 1024 - 1) as u16;
    put(&mut image, 2 * WORD_SIZE, &kibibits.to_le_bytes());
    put(&mut image, 2 * WORD_VERSION, &1u16.to_le_bytes());

    category(
        &mut image,
        CATEGORY_STRINGS,
        &strings(&[description.name, description.order]),
    );
    category(&mut image, CATEGORY_GENERAL, &general());
    category(&mut image, CATEGORY_FMMU, &[1, 2, 3, 0]);
    category(
        &mut image,
        CATEGORY_SYNC_MANAGER,
        &sync_managers(description.sync_managers),
    );
    category(&mut image, CATEGORY_RX_PDO, &pdo(description.rx_pdo, 2));
    category(&mut image, CATEGORY_TX_PDO, &pdo(description.tx_pdo, 3));
    image.extend_from_slice(&CATEGORY_END.to_le_bytes());
    image.resize(IMAGE_BYTES, 0xFF);
    image
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

/// Group, image, order and name are string numbers; two ports with copper links.
fn general() -> [u8; 32] {
    let mut body = [0; 32];
    put(&mut body, 0, &[2, 0, 2, 1, 0, COE_DETAILS]);
    put(&mut body, 16, &[0x11, 0x00]);
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

fn pdo((index, entries): (u16, &[PdoEntry]), sync_manager: u8) -> Vec<u8> {
    let mut body = Vec::from(index.to_le_bytes());
    body.extend_from_slice(&[entries.len() as u8, sync_manager, 0, 0, 0, 0]);
    for entry in entries {
        let data_type = if entry.bits == 32 {
            TYPE_INTEGER32
        } else {
            TYPE_UNSIGNED16
        };
        body.extend_from_slice(&entry.index.to_le_bytes());
        body.extend_from_slice(&[0, 0, data_type, entry.bits, 0, 0]);
    }
    body
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::ethercat::wire::sii::FixedPart;

    const ENTRIES: [PdoEntry; 2] = [
        PdoEntry {
            index: 0x6064,
            bits: 32,
        },
        PdoEntry {
            index: 0x6041,
            bits: 16,
        },
    ];

    fn example() -> Vec<u8> {
        let window = |start| MailboxWindow { start, length: 512 };
        image(&Description {
            identity: Identity {
                vendor: 2,
                product: 3,
                revision: 4,
                serial: 5,
            },
            name: "a drive",
            order: "X1",
            mailbox_out: window(0x1800),
            mailbox_in: window(0x1C00),
            sync_managers: &[SyncManagerDefault {
                start: 0x1100,
                length: 6,
                control: 0x64,
                activate: 1,
                kind: 3,
            }],
            rx_pdo: (0x1702, &ENTRIES),
            tx_pdo: (0x1B01, &ENTRIES),
        })
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
