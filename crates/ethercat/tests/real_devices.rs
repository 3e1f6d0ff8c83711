//! The SII of a real Kollmorgen AKD, intact and damaged.
//!
//! The dumps are not part of the project: `ETHERPEN_REAL_DEVICES` names the folder with `akd.hex` and
//! `akd_null_strings.hex` of ethercrab's `dumps/eeprom`. Without it these tests print that they were skipped.

use etherpen_ethercat::wire::sii::*;
use std::io::Write as _;
use std::path::PathBuf;

/// A dump; prints a note and returns `None` if `ETHERPEN_REAL_DEVICES` is not set.
fn dump(name: &str) -> Option<Vec<u8>> {
    let Some(folder) = std::env::var_os("ETHERPEN_REAL_DEVICES").map(PathBuf::from) else {
        // Not `eprintln!`: the test harness shows its output only for failing tests.
        let _ = writeln!(
            std::io::stderr(),
            "ETHERPEN_REAL_DEVICES is not set: the test with {name} is left out"
        );
        return None;
    };
    let path = folder.join(name);
    Some(std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display())))
}

/// The intact image of the drive.
const AKD: &str = "akd.hex";
/// The image with NUL-padded names; its category chain runs past the end.
const DAMAGED: &str = "akd_null_strings.hex";

fn header(bytes: &[u8]) -> Header {
    let window = |start| MailboxWindow { start, length: 1024 };
    let sii = Sii::new_checked(bytes).unwrap();
    assert!(sii.checksum_is_right());
    let header = sii.header();
    assert_eq!(header.bootstrap_out, window(0x1800));
    assert_eq!(header.bootstrap_in, window(0x1C00));
    assert_eq!(header.fixed.mailbox_out, window(0x1800));
    assert_eq!(header.fixed.mailbox_in, window(0x1C00));
    header
}

#[test]
fn the_part_in_front_of_the_categories_of_a_real_drive_is_read() {
    for name in [AKD, DAMAGED] {
        let Some(bytes) = dump(name) else { return };
        let header = header(&bytes);
        let identity = Identity {
            vendor: 0x6A,
            product: 0x0041_4B44,
            revision: 2,
            serial: 0x9983_0093,
        };
        assert_eq!(header.fixed.identity, identity);
        assert_eq!(header.fixed.protocols, PROTOCOL_COE | PROTOCOL_EOE | PROTOCOL_FOE);
        assert_eq!((header.pdi_control, header.pdi_configuration), (0x0009, 0x0800));
        assert_eq!((header.alias, header.checksum), (0, 0x10));
        assert_eq!((header.memory_bytes(), header.version), (2048, 1));
        assert!(!header.is_blank());
    }
}

#[test]
fn every_category_of_a_real_drive_is_found_in_its_place() {
    let Some(bytes) = dump(AKD) else { return };
    let mut categories = Sii::new_checked(&bytes).unwrap().categories();
    let found: Vec<_> = categories
        .by_ref()
        .map(|(category, data)| {
            assert_eq!(data.len(), usize::from(category.words) * 2);
            (category.kind, category.word, category.words)
        })
        .collect();
    let expected = [
        (2048, 0x42, 10),
        (2049, 0x4E, 6),
        (CATEGORY_STRINGS, 0x56, 239),
        (CATEGORY_GENERAL, 0x147, 16),
        (CATEGORY_FMMU, 0x159, 2),
        (CATEGORY_SYNC_MANAGER, 0x15D, 16),
        (CATEGORY_SYNC_UNIT, 0x16F, 1),
        (CATEGORY_TX_PDO, 0x172, 260),
        (CATEGORY_RX_PDO, 0x278, 184),
        (CATEGORY_CLOCKS, 0x332, 24),
    ];
    assert_eq!(found, expected);
    assert_eq!(categories.walker().end(), Some(ChainEnd::Marked));
    assert_eq!(categories.walker().private_count(), 2);
}

#[test]
fn a_real_drives_names_and_abilities_are_read() {
    let Some(bytes) = dump(AKD) else { return };
    let sii = Sii::new_checked(&bytes).unwrap();
    let (strings, general) = (sii.strings(), sii.general().unwrap());
    assert_eq!(strings.count(), 33);
    assert_eq!(strings.text(general.name), "AKD EtherCAT Drive (CoE)");
    assert_eq!(strings.text(general.group), "Drive");
    assert_eq!(strings.text(general.order), "AKD");
    assert_eq!(strings.text(general.image), "DRIVE");
    assert_eq!(strings.text(33), "AOUT.VALUE write");
    assert_eq!((strings.get(0), strings.get(34)), (None, None));
    let expected = General {
        group: 2,
        image: 5,
        order: 1,
        name: 4,
        coe: COE_SDO | COE_PDO_ASSIGN | COE_PDO_CONFIGURE,
        foe: true,
        eoe: true,
        flags: FLAG_SAFE_OPERATIONAL | FLAG_MAILBOX_REPEAT,
        current_ma: 0,
        ports: [PortKind::Mii, PortKind::Mii, PortKind::Unused, PortKind::Unused],
        identification_address: 0,
    };
    assert_eq!(general, expected);
}

#[test]
fn a_real_drives_sync_managers_fmmus_and_clocks_are_read() {
    let Some(bytes) = dump(AKD) else { return };
    let sii = Sii::new_checked(&bytes).unwrap();
    let manager = |start, length, control, usage| SyncManagerRecord {
        start,
        length,
        control,
        status: 0,
        flags: SYNC_MANAGER_ENABLED,
        usage,
    };
    let expected = [
        manager(0x1800, 1024, 0x26, SyncManagerUse::MailboxOut),
        manager(0x1C00, 1024, 0x22, SyncManagerUse::MailboxIn),
        manager(0x1100, 0, 0x24, SyncManagerUse::Outputs),
        manager(0x1140, 0, 0x20, SyncManagerUse::Inputs),
    ];
    assert_eq!(sii.sync_managers().collect::<Vec<_>>(), expected);
    let uses = [
        FmmuUse::Outputs,
        FmmuUse::Inputs,
        FmmuUse::MailboxState,
        FmmuUse::Other(0xFF),
    ];
    assert_eq!(sii.fmmus().collect::<Vec<_>>(), uses);
    assert_eq!(sii.fmmus_extended().count(), 0);
    assert_eq!(sii.sync_units().collect::<Vec<_>>(), [SyncUnit(0xF0), SyncUnit(0xFF)]);
    let clocks: Vec<_> = sii
        .clocks()
        .map(|clock| {
            (
                sii.strings().text(clock.name),
                clock.assign_activate,
                clock.factor_sync0,
                clock.cycle_time_ns,
            )
        })
        .collect();
    assert_eq!(clocks, [("DcSync", 0x0300, 1, 0), ("DcOff", 0, 1, 0)]);
}

/// Index, sync manager, entries and bits of each PDO.
fn summary(pdos: Pdos<'_>) -> Vec<(u16, u8, u8, u32)> {
    pdos.map(|pdo| {
        let pdo = pdo.unwrap();
        assert_eq!(pdo.entries().count(), usize::from(pdo.record.entries));
        (
            pdo.record.index,
            pdo.record.sync_manager,
            pdo.record.entries,
            pdo.bits(),
        )
    })
    .collect()
}

#[test]
fn a_real_drives_process_data_objects_are_read() {
    let Some(bytes) = dump(AKD) else { return };
    let sii = Sii::new_checked(&bytes).unwrap();
    let none = SYNC_MANAGER_NONE;
    let sent = [
        (0x1A00, none, 1, 16),
        (0x1A01, none, 0, 0),
        (0x1A02, none, 0, 0),
        (0x1A03, none, 0, 0),
        (0x1B01, 3, 2, 48),
        (0x1B20, none, 10, 256),
        (0x1B21, none, 2, 48),
        (0x1B22, none, 10, 256),
        (0x1B23, none, 10, 256),
        (0x1B24, none, 2, 48),
        (0x1B25, none, 10, 256),
        (0x1B26, none, 6, 144),
    ];
    assert_eq!(summary(sii.tx_pdos()), sent);
    let received = [
        (0x1600, none, 1, 16),
        (0x1601, none, 0, 0),
        (0x1602, none, 0, 0),
        (0x1603, none, 0, 0),
        (0x1701, 2, 2, 48),
        (0x1702, none, 2, 48),
        (0x1720, none, 5, 112),
        (0x1721, none, 3, 64),
        (0x1722, none, 6, 128),
        (0x1723, none, 6, 128),
        (0x1724, none, 3, 64),
        (0x1725, none, 6, 128),
    ];
    assert_eq!(summary(sii.rx_pdos()), received);
    let inputs = sii.tx_pdos().flatten().find(|pdo| pdo.record.index == 0x1B01).unwrap();
    assert_eq!(inputs.record.flags, PDO_FIXED_CONTENT);
    assert_eq!(sii.strings().text(inputs.record.name), "Inputs");
    let entries: Vec<_> = inputs
        .entries()
        .map(|entry| {
            (
                entry.index,
                entry.sub,
                entry.bits,
                entry.data_type,
                sii.strings().text(entry.name),
            )
        })
        .collect();
    assert_eq!(
        entries,
        [
            (0x6063, 0, 32, 4, "Position actual internal value"),
            (0x6041, 0, 16, 6, "Statusword"),
        ]
    );
}

#[test]
fn a_damaged_sii_gives_what_stands_in_front_of_the_damage_and_says_where_it_is() {
    let Some(bytes) = dump(DAMAGED) else { return };
    let sii = Sii::new_checked(&bytes).unwrap();
    let mut categories = sii.categories();
    let kinds: Vec<_> = categories.by_ref().map(|(category, _)| category.kind).collect();
    assert_eq!(kinds, [2048, 2049, CATEGORY_STRINGS]);
    let category = CategoryHeader {
        kind: 256,
        word: 0x147,
        words: 1280,
    };
    assert_eq!(categories.walker().end(), Some(ChainEnd::Outside { category }));
    let strings = sii.strings();
    assert_eq!(strings.count(), 33);
    let names: [_; 5] = core::array::from_fn(|n| strings.text([4, 5, 6, 10, 33][n]));
    assert_eq!(names, ["AKD EtherCA", "", "DRIVE", "Statu", "Target position"]);
    assert_eq!(strings.get(5), Some(&b""[..]), "empty, but there");
    assert_eq!(sii.general(), None);
    assert_eq!(
        sii.sync_managers().count() + sii.fmmus().count() + sii.clocks().count(),
        0
    );
    assert_eq!(sii.tx_pdos().count() + sii.rx_pdos().count(), 0);
}

#[test]
fn an_image_cut_anywhere_ends_its_chain_and_never_reads_outside() {
    let Some(image) = dump(AKD) else { return };
    for length in 0..image.len() {
        let Ok(sii) = Sii::new_checked(&image[..length]) else {
            assert!(length < Header::LEN);
            continue;
        };
        let mut categories = sii.categories();
        let found = categories.by_ref().count();
        let end = categories.walker().end();
        let whole = length >= 2 * 0x34B;
        assert_eq!(end == Some(ChainEnd::Marked), whole, "{length}: {end:?}");
        assert_eq!(found == 10, length >= 2 * 0x34A, "{length}");
    }
}

#[test]
fn a_written_header_reads_back_with_the_right_checksum() {
    let Some(image) = dump(AKD) else { return };
    let header = header(&image);
    let mut bytes = [0xAA; Header::LEN + 1];
    let wrong = Header { checksum: 0, ..header };
    wrong.emit(&mut bytes).unwrap();
    assert_eq!(Header::parse(&bytes), Ok(header));
    assert_eq!(bytes[..Header::LEN], image[..Header::LEN]);
    assert_eq!(bytes[Header::LEN], 0xAA);
}
