//! Properties of everything that travels on the wire: `parse` inverts `emit`, and no bytes cause a panic or an endless
//! loop.
//!
//! The generator's seed is fixed: every run tries the same cases.

use etherpen_ethercat::wire::coe::{
    Emergency, EntryDescription, Information, InformationRepr, Object, ObjectDescription, Sdo, Service,
};
use etherpen_ethercat::wire::mailbox::{self, ErrorReply, MailboxRepr, Protocol};
use etherpen_ethercat::wire::register::{
    DlStatus, ErrorCounters, FmmuRepr, PortErrors, ReceiveTimes, SyncManagerRepr, port_descriptor, port_media,
};
use etherpen_ethercat::wire::sii::{
    ClockRecord, FixedPart, FmmuExtended, FmmuUse, General, Header, Identity, MailboxWindow, PdoEntryRecord, PdoRecord,
    PortKind, Record, Sii, SyncManagerRecord, SyncUnit,
};
use etherpen_ethercat::wire::{
    Address, Command, Datagram, DatagramRepr, FRAME_LEN_MAX, FrameBuilder, FrameView, UdpRepr,
};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use std::io::Write as _;

/// Cases of each property.
const CASES: u32 = 300;
/// Seed of the generator.
const SEED: [u8; 32] = *b"etherpen: wire properties, seed.";

/// Checks a property for values of a strategy, the same values in every run.
fn check<S: Strategy>(strategy: S, property: impl Fn(S::Value) -> Result<(), TestCaseError>) {
    let config = Config {
        cases: CASES,
        failure_persistence: None,
        ..Config::default()
    };
    let rng = TestRng::from_seed(RngAlgorithm::ChaCha, &SEED);
    if let Err(failure) = TestRunner::new_with_rng(config, rng).run(&strategy, property) {
        panic!("seed {:?}: {failure}", core::str::from_utf8(&SEED));
    }
}

fn bytes(longest: usize) -> impl Strategy<Value = Vec<u8>> {
    vec(any::<u8>(), 0..=longest)
}

fn objects() -> impl Strategy<Value = Object> {
    any::<(u16, u8)>().prop_map(|(index, sub)| Object::new(index, sub))
}

#[test]
fn a_frame_opens_to_the_datagrams_that_were_packed() {
    let datagrams = vec((0_u8..=14, any::<u8>(), any::<u32>(), bytes(120)), 1..12);
    check((datagrams, any::<[u8; 6]>()), |(datagrams, source)| {
        let mut frame = [0xAA; FRAME_LEN_MAX];
        let mut builder = FrameBuilder::new(&mut frame, source).unwrap();
        let mut packed = vec![];
        for (number, index, address, data) in &datagrams {
            let command = Command::from_number(*number).unwrap();
            if let Ok(room) = builder.push(command, *index, Address(*address), data.len()) {
                room.copy_from_slice(data);
                packed.push((command, *index, *address, data));
            }
        }
        let length = builder.finish();
        let view = FrameView::new_checked(&frame[..length]).unwrap();
        prop_assert_eq!(view.source(), source);
        let mut opened = 0;
        for (datagram, (command, index, address, data)) in view.datagrams().zip(&packed) {
            let datagram = datagram.unwrap();
            let repr = DatagramRepr::parse(&datagram).unwrap();
            prop_assert_eq!((repr.command, repr.index, repr.address.0), (*command, *index, *address));
            prop_assert_eq!(datagram.data(), data.as_slice());
            opened += 1;
        }
        prop_assert_eq!(opened, packed.len());
        prop_assert_eq!(view.datagrams().count(), packed.len());
        Ok(())
    });
}

#[test]
fn a_datagrams_header_survives() {
    let flags = any::<(u8, u32, bool, bool, u16)>();
    check((0_u8..=14, 0_u16..=1486, flags), |(number, length, rest)| {
        let (index, address, circulating, more, interrupt) = rest;
        let repr = DatagramRepr {
            command: Command::from_number(number).unwrap(),
            index,
            address: Address(address),
            length,
            circulating,
            more,
            interrupt,
        };
        let mut buffer = vec![0xAA; repr.len()];
        repr.emit(&mut buffer).unwrap();
        prop_assert_eq!(
            DatagramRepr::parse(&Datagram::new_checked(&buffer[..]).unwrap()),
            Ok(repr)
        );
        Ok(())
    });
}

#[test]
fn the_udp_envelope_survives() {
    check(
        (any::<([u8; 6], [u8; 6], u32, u32, u16)>(), 0_usize..1472),
        |(addresses, length)| {
            let (source_mac, destination_mac, source, destination, port) = addresses;
            let request = UdpRepr::request(source_mac, source.into(), destination.into());
            let repr = UdpRepr {
                destination_mac,
                source_port: port,
                ..request
            };
            let mut frame = [0xAA; FRAME_LEN_MAX];
            let total = repr.emit(&mut frame, length).unwrap();
            let (parsed, range) = UdpRepr::parse(&frame[..total]).unwrap();
            prop_assert_eq!((parsed, range), (repr, 42..42 + length));
            Ok(())
        },
    );
}

#[test]
fn mailbox_headers_survive() {
    let protocols = prop::sample::select(vec![
        Protocol::Error,
        Protocol::Aoe,
        Protocol::Eoe,
        Protocol::Coe,
        Protocol::Foe,
        Protocol::Soe,
        Protocol::Voe,
    ]);
    check((any::<(u16, u16, u16)>(), 0_u8..4, 0_u8..8, protocols), |case| {
        let ((length, address, detail), priority, counter, protocol) = case;
        let repr = MailboxRepr {
            length,
            address,
            priority,
            protocol,
            counter,
        };
        let mut buffer = [0xAA; 6];
        repr.emit(&mut buffer).unwrap();
        prop_assert_eq!(MailboxRepr::parse(&buffer), Ok(repr));
        let reply = ErrorReply { detail };
        reply.emit(&mut buffer).unwrap();
        prop_assert_eq!(ErrorReply::parse(&buffer), Ok(reply));
        Ok(())
    });
}

/// A message with arbitrary content; `kind` selects the variant.
fn sdo<'a>(kind: u8, object: Object, [toggle, last]: [bool; 2], number: u32, data: &'a [u8]) -> Sdo<'a> {
    let few = data
        .get(..data.len().min(4))
        .filter(|few| !few.is_empty())
        .unwrap_or(&[7]);
    match kind {
        0 => Sdo::DownloadExpedited {
            object,
            complete: toggle,
            data: few,
        },
        1 => Sdo::DownloadNormal {
            object,
            complete: toggle,
            size: number,
            data,
        },
        2 => Sdo::DownloadSegment { toggle, last, data },
        3 => Sdo::Upload {
            object,
            complete: toggle,
        },
        4 => Sdo::UploadSegment { toggle },
        5 => Sdo::Abort { object, code: number },
        6 => Sdo::DownloadDone { object },
        7 => Sdo::DownloadSegmentDone { toggle },
        8 => Sdo::UploadExpedited { object, data: few },
        9 => Sdo::UploadNormal {
            object,
            size: number,
            data,
        },
        _ => Sdo::UploadSegmentData { toggle, last, data },
    }
}

#[test]
fn sdo_messages_survive() {
    check(
        (0_u8..=10, objects(), any::<[bool; 2]>(), any::<u32>(), bytes(40)),
        |case| {
            let (kind, object, flags, number, data) = case;
            let message = sdo(kind, object, flags, number, &data);
            let mut buffer = [0xAA; 64];
            let length = message.emit(&mut buffer).unwrap();
            prop_assert_eq!(length, message.len());
            let parsed = if kind <= 5 {
                Sdo::parse_request(&buffer[..length])
            } else {
                Sdo::parse_response(&buffer[..length])
            };
            prop_assert_eq!(parsed, Ok(message));
            Ok(())
        },
    );
}

#[test]
fn information_messages_survive() {
    let fields = any::<(u16, u16, u16, u8, u8)>();
    check((0_u8..=6, objects(), any::<(bool, u16)>(), fields, bytes(40)), |case| {
        let (kind, object, (incomplete, fragments_left), (data_type, bits, access, sub_max, code), data) = case;
        let index = object.index;
        let body = match kind {
            0 => Information::GetList { list: index },
            1 => Information::List { data: &data },
            2 => Information::GetObject { index },
            3 => Information::Object(ObjectDescription {
                index,
                data_type,
                sub_max,
                code,
                name: &data,
            }),
            4 => Information::GetEntry {
                object,
                value_info: code,
            },
            5 => Information::Entry(EntryDescription {
                object,
                value_info: code,
                data_type,
                bits,
                access,
                data: &data,
            }),
            _ => Information::Error {
                code: u32::from(access),
            },
        };
        let repr = InformationRepr {
            incomplete,
            fragments_left,
            body,
        };
        let mut buffer = [0xAA; 64];
        let length = repr.emit(&mut buffer).unwrap();
        prop_assert_eq!(InformationRepr::parse(&buffer[..length]), Ok(repr));
        Ok(())
    });
}

#[test]
fn emergencies_survive() {
    check(any::<(u16, u8, [u8; 5])>(), |(code, register, data)| {
        let emergency = Emergency { code, register, data };
        let mut buffer = [0xAA; Emergency::LEN];
        emergency.emit(&mut buffer).unwrap();
        prop_assert_eq!(Emergency::parse(&buffer), Ok(emergency));
        Ok(())
    });
}

#[test]
fn registers_survive() {
    check(
        (any::<[u8; 23]>(), any::<[u32; 4]>(), any::<u16>()),
        |(raw, ports_ns, bits)| {
            let mut buffer = [0xAA; 32];
            let manager = SyncManagerRepr::parse(&raw).unwrap();
            manager.emit(&mut buffer).unwrap();
            prop_assert_eq!(&buffer[..8], &raw[..8]);
            prop_assert_eq!(SyncManagerRepr::parse(&buffer), Ok(manager));
            let mapping = FmmuRepr::parse(&raw).unwrap();
            mapping.emit(&mut buffer).unwrap();
            prop_assert_eq!(FmmuRepr::parse(&buffer), Ok(mapping));
            let [
                invalid_frames,
                receive_errors,
                forwarded_errors,
                lost_links,
                a,
                b,
                c,
                ..,
            ] = raw;
            let counters = ErrorCounters {
                ports: [PortErrors {
                    invalid_frames,
                    receive_errors,
                    forwarded_errors,
                    lost_links,
                }; 4],
                processing_errors: a,
                pdi_errors: b,
                pdi_error_code: c,
            };
            counters.emit(&mut buffer).unwrap();
            prop_assert_eq!(ErrorCounters::parse(&buffer), Ok(counters));
            let times = ReceiveTimes { ports_ns };
            times.emit(&mut buffer).unwrap();
            prop_assert_eq!(ReceiveTimes::parse(&buffer), Ok(times));
            let status = DlStatus::from_bits(bits);
            prop_assert_eq!(DlStatus::from_bits(status.bits()), status);
            prop_assert_eq!(port_descriptor(port_media(raw[0])), raw[0]);
            Ok(())
        },
    );
}

/// A record that is parsed, emitted and parsed again is unchanged.
fn survives<R: Record + PartialEq + core::fmt::Debug>(raw: &[u8]) -> Result<(), TestCaseError> {
    let record = R::parse(raw).unwrap();
    let mut buffer = [0xAA; 32];
    record.emit(&mut buffer).unwrap();
    prop_assert_eq!(R::parse(&buffer), Ok(record));
    Ok(())
}

#[test]
fn records_of_the_sii_survive() {
    check(
        (any::<[u8; 32]>(), any::<[u16; 8]>(), any::<[u32; 4]>()),
        |(raw, words, numbers)| {
            survives::<SyncManagerRecord>(&raw)?;
            survives::<FmmuUse>(&raw)?;
            survives::<FmmuExtended>(&raw)?;
            survives::<SyncUnit>(&raw)?;
            survives::<ClockRecord>(&raw)?;
            survives::<PdoRecord>(&raw)?;
            survives::<PdoEntryRecord>(&raw)?;
            let general = General::parse(&raw).unwrap();
            let mut buffer = [0xAA; Header::LEN];
            general.emit(&mut buffer).unwrap();
            prop_assert_eq!(General::parse(&buffer), Ok(general));
            prop_assert!(general.ports.iter().all(|port| *port != PortKind::Other(0)));
            let [start, length, alias, protocols, size, version, control, impulse] = words;
            let [vendor, product, revision, serial] = numbers;
            let window = MailboxWindow { start, length };
            let header = Header {
                pdi_control: control,
                sync_impulse_10_ns: impulse,
                alias,
                fixed: FixedPart {
                    identity: Identity {
                        vendor,
                        product,
                        revision,
                        serial,
                    },
                    mailbox_out: window,
                    mailbox_in: MailboxWindow::default(),
                    protocols,
                },
                bootstrap_in: window,
                size,
                version,
                ..Header::default()
            };
            header.emit(&mut buffer).unwrap();
            let sii = Sii::new_checked(&buffer).unwrap();
            prop_assert!(sii.checksum_is_right());
            let checksum = sii.header().checksum;
            prop_assert_eq!(sii.header(), Header { checksum, ..header });
            Ok(())
        },
    );
}

/// Walks everything that an SII holds.
fn walk(sii: Sii<'_>) -> Result<(), TestCaseError> {
    prop_assert!(sii.categories().count() <= 64);
    let pdos = sii.tx_pdos().chain(sii.rx_pdos()).flatten();
    prop_assert!(pdos.map(|pdo| pdo.entries().count()).sum::<usize>() <= 4096);
    let strings = sii.strings();
    prop_assert!((0..=255).all(|index| strings.text(index).len() <= 255));
    prop_assert!(sii.sync_managers().count() + sii.clocks().count() + sii.fmmus().count() <= 4096);
    Ok(())
}

#[test]
fn a_real_sii_with_damaged_bytes_is_walked_to_an_end() {
    let Some(folder) = std::env::var_os("ETHERPEN_REAL_DEVICES") else {
        // Not `eprintln!`: the test harness shows its output only for failing tests.
        let _ = writeln!(
            std::io::stderr(),
            "ETHERPEN_REAL_DEVICES is not set: the test with akd.hex is left out"
        );
        return;
    };
    let real = std::fs::read(std::path::Path::new(&folder).join("akd.hex")).unwrap();
    let damage = vec((0..real.len(), any::<u8>()), 1..40);
    check((damage, 0..=real.len()), |(damage, length)| {
        let mut image = real.clone();
        for (place, value) in damage {
            image[place] = value;
        }
        Sii::new_checked(&image[..length]).map_or(Ok(()), walk)
    });
}

#[test]
fn no_bytes_make_a_parser_panic_or_run_for_ever() {
    check(bytes(400), |raw| {
        if let Ok(view) = FrameView::new_checked(&raw) {
            prop_assert!(view.datagrams().count() <= raw.len());
        }
        if let Ok((_, range)) = UdpRepr::parse(&raw) {
            prop_assert!(raw.get(range).is_some());
        }
        let _ = MailboxRepr::parse(&raw);
        if let Ok(data) = mailbox::service_data(&raw) {
            prop_assert!(data.len() <= raw.len());
        }
        let _ = Service::parse(&raw);
        let _ = Sdo::parse_request(&raw);
        let _ = Sdo::parse_response(&raw);
        let _ = Emergency::parse(&raw);
        if let Ok(InformationRepr {
            body: Information::Entry(entry),
            ..
        }) = InformationRepr::parse(&raw)
        {
            prop_assert!(entry.name().len() <= raw.len());
        }
        if let Ok(sii) = Sii::new_checked(&raw) {
            walk(sii)?;
        }
        Ok(())
    });
}
