//! Any bytes as a slave's configuration memory, as a mailbox, and as a CoE message of either side.

use crate::segment::{image_of, visit};
use etherpen::ethercat::wire::coe::{Emergency, Information, InformationRepr, Object, Sdo, Service};
use etherpen::ethercat::wire::mailbox::{ErrorReply, MailboxRepr, Protocol, service_data};
use etherpen::ethercat::wire::sii::{CategoryWalker, Sii};
use etherpen_segment::SlaveKind;

/// Most bytes of a seed: what follows in a virtual slave's memory is empty.
const IMAGE_SEED_BYTES: usize = 640;

/// Reads a configuration memory over the slice, word by word, and as the memory of a virtual slave.
pub(crate) fn sii(image: &[u8]) {
    let word = |address: u16| {
        let at = usize::from(address) * 2;
        image
            .get(at..at + 2)
            .map_or(0, |word| u16::from_le_bytes([word[0], word[1]]))
    };
    let mut walker = CategoryWalker::new(u16::try_from(image.len() / 2).unwrap_or(u16::MAX));
    let mut found = vec![];
    while let Some(address) = walker.next_word() {
        found.extend(walker.feed(word(address), word(address.saturating_add(1))));
    }
    visit(SlaveKind::Sii(image.into()));
    let Ok(sii) = Sii::new_checked(image) else { return };
    let mut categories = sii.categories();
    let same: Vec<_> = categories.by_ref().map(|(category, _)| category).collect();
    assert_eq!((same, categories.walker().end()), (found, walker.end()));
    let _ = (sii.header(), sii.checksum_is_right(), sii.general());
    for index in 0..=255 {
        assert!(sii.strings().text(index).len() <= 255);
    }
    for pdo in sii.tx_pdos().chain(sii.rx_pdos()).flatten() {
        assert!(pdo.bits() as usize <= 255 * pdo.entries().count());
        assert_eq!(pdo.entries().count(), usize::from(pdo.record.entries));
    }
    let records = sii.sync_managers().count() + sii.fmmus().count() + sii.fmmus_extended().count();
    assert!(records + sii.sync_units().count() + sii.clocks().count() <= 5 * image.len());
}

/// The memories of the virtual slaves.
pub(crate) fn sii_seeds() -> Vec<Vec<u8>> {
    let kinds = [SlaveKind::Ax2000, SlaveKind::Cia402, SlaveKind::Ek1100];
    let images = kinds.into_iter().map(|kind| {
        let mut image = image_of(kind);
        image.truncate(IMAGE_SEED_BYTES);
        image
    });
    images.collect()
}

/// Reads a mailbox.
pub(crate) fn mailbox(bytes: &[u8]) {
    if let Ok(header) = MailboxRepr::parse(bytes) {
        let mut again = [0; 6];
        header.emit(&mut again).expect("a header fits");
        assert_eq!(MailboxRepr::parse(&again), Ok(header));
    }
    let Ok(data) = service_data(bytes) else { return };
    assert!(data.len() + 6 <= bytes.len());
    let _ = (Service::parse(data), ErrorReply::parse(data), Sdo::parse_response(data));
    if let Ok(emergency) = Emergency::parse(data) {
        let mut again = [0; Emergency::LEN];
        emergency.emit(&mut again).expect("an emergency fits");
        assert_eq!(Emergency::parse(&again), Ok(emergency));
    }
}

/// CoE messages in mailboxes, and an error reply.
pub(crate) fn mailbox_seeds() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for data in coe_seeds() {
        let header = MailboxRepr {
            length: data.len() as u16,
            address: 0,
            priority: 0,
            protocol: Protocol::Coe,
            counter: 1 + (seeds.len() % 7) as u8,
        };
        let mut bytes = vec![0; 6];
        header.emit(&mut bytes).expect("a header fits");
        bytes.extend(data);
        seeds.push(bytes);
    }
    seeds.push(vec![4, 0, 0, 0, 0, 0x10, 1, 0, 2, 0]);
    seeds.push(
        [
            [10, 0, 0, 0, 0, 0x23, 0, 0x10].as_slice(),
            [0x10, 0x81, 0x20, 1, 2, 3, 4, 5].as_slice(),
        ]
        .concat(),
    );
    seeds
}

/// Reads a CoE message; what parses survives emit and parse.
pub(crate) fn coe(bytes: &[u8]) {
    let mut room = vec![0; bytes.len() + 16];
    if let Ok(request) = Sdo::parse_request(bytes) {
        let length = request.emit(&mut room).expect("a request fits");
        assert_eq!(Sdo::parse_request(&room[..length]), Ok(request));
    }
    if let Ok(response) = Sdo::parse_response(bytes) {
        let length = response.emit(&mut room).expect("a response fits");
        assert_eq!(Sdo::parse_response(&room[..length]), Ok(response));
    }
    if let Ok(message) = InformationRepr::parse(bytes) {
        let length = message.emit(&mut room).expect("a message fits");
        assert_eq!(InformationRepr::parse(&room[..length]), Ok(message));
        if let Information::Entry(entry) = message.body {
            assert!(entry.name().len() <= entry.data.len());
        }
    }
}

/// One message of each kind.
pub(crate) fn coe_seeds() -> Vec<Vec<u8>> {
    let object = Object::new(0x6060, 0);
    let data = &[1, 2, 3, 4, 5, 6, 7, 8, 9, 10];
    let sdos = [
        Sdo::Upload {
            object,
            complete: false,
        },
        Sdo::Upload { object, complete: true },
        Sdo::UploadExpedited {
            object,
            data: &data[..2],
        },
        Sdo::UploadNormal { object, size: 10, data },
        Sdo::UploadSegment { toggle: true },
        Sdo::UploadSegmentData {
            toggle: false,
            last: true,
            data,
        },
        Sdo::DownloadNormal {
            object,
            complete: false,
            size: 10,
            data,
        },
        Sdo::DownloadDone { object },
        Sdo::DownloadSegment {
            toggle: true,
            last: false,
            data,
        },
        Sdo::DownloadSegmentDone { toggle: true },
        Sdo::Abort {
            object,
            code: 0x0602_0000,
        },
    ];
    let mut seeds = Vec::new();
    let mut room = [0; 64];
    for sdo in sdos {
        let length = sdo.emit(&mut room).expect("a message fits");
        seeds.push(room[..length].to_vec());
    }
    let information = [
        Information::GetList { list: 1 },
        Information::GetObject { index: 0x6060 },
    ];
    for body in information {
        let length = InformationRepr::request(body).emit(&mut room).expect("a message fits");
        seeds.push(room[..length].to_vec());
    }
    // Answers: a list, an object and an entry with their names, an error.
    seeds.push(b"\0\x80\x02\0\0\0\x01\0\x00\x10\x18\x10\x60\x60".to_vec());
    seeds.push(b"\0\x80\x04\0\0\0\x60\x60\x02\0\0\x07mode".to_vec());
    seeds.push(b"\0\x80\x06\0\0\0\x60\x60\0\x07\x02\0\x08\0\x3f\0mode".to_vec());
    seeds.push(b"\0\x80\x07\0\0\0\0\0\x02\x06".to_vec());
    seeds
}
