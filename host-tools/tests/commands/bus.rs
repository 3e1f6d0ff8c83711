//! `etherpen bus` over the link: a firmware that answers from a list; output for people and for programs.

use crate::program::{Folder, etherpen, run};
use etherpen::ethercat::diagnostics::{
    BusInfo, EntryInfo, ObjectInfo, Piece, ServiceError, ServiceReply, ServiceRequest, ServiceResult, SlaveErrors,
    SlaveInfo,
};
use etherpen::ethercat::error::BusError;
use etherpen::ethercat::state::{AlReport, AlState};
use etherpen::ethercat::wire::coe::Object;
use etherpen::ethercat::wire::register::PortErrors;
use etherpen::ethercat::wire::sii::Identity;
use etherpen::link::device::{self};
use etherpen::link::frame::Decoder;
use etherpen::link::ports::LinkPort;
use etherpen::messages::{DeviceEndpoint, DeviceEvent};
use host_tools::error::code;
use serde_json::Value;
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Slaves of the firmware in these tests.
const SLAVES: u8 = 3;
/// A value longer than one piece.
const LONG: [u8; 600] = {
    let mut bytes = [0x41; 600];
    bytes[599] = 0x5A;
    bytes
};

/// Answer of the firmware; slaves count from 0 here.
fn answer(request: &ServiceRequest) -> ServiceResult {
    Ok(match *request {
        ServiceRequest::Bus => ServiceReply::Bus(BusInfo {
            slaves: SLAVES,
            answering: SLAVES.into(),
            al_status: 0x18,
            operational: false,
            reference_clock: Some(0),
        }),
        ServiceRequest::Slave { slave } | ServiceRequest::SetState { slave, .. } if slave >= SLAVES => {
            return Err(ServiceError::NoSlave { slaves: SLAVES });
        }
        ServiceRequest::Slave { slave } => ServiceReply::Slave(slave_info(slave)),
        ServiceRequest::SetState { slave: 1, state } => {
            return Err(ServiceError::Bus(BusError::State {
                expected: state as u8,
                actual: 0x14,
                code: 0x001B,
            }));
        }
        ServiceRequest::SetState { state, .. } => ServiceReply::State(AlReport {
            status: state as u8,
            code: 0,
        }),
        ServiceRequest::Upload { object, offset, .. } => upload(object, offset)?,
        ServiceRequest::DescribeEntry { object, .. } => ServiceReply::Entry(EntryInfo {
            object,
            data_type: if object.index == 0x6064 { 4 } else { 9 },
            bits: 32,
            access: 0x3F,
            name: "an entry".try_into().expect("short"),
        }),
        ServiceRequest::Objects { first, .. } => ServiceReply::Objects {
            total: 3,
            indices: [0x1000, 0x1018, 0x6064]
                .into_iter()
                .skip(first.into())
                .take(2)
                .collect(),
        },
        ServiceRequest::DescribeObject { index, .. } => ServiceReply::Object(ObjectInfo {
            index,
            data_type: 7,
            sub_max: 0,
            code: 7,
            name: "an object".try_into().expect("short"),
        }),
        ServiceRequest::Registers { address, length, .. } => ServiceReply::Piece {
            total: length,
            piece: (0..length).map(|offset| (address + offset) as u8).collect(),
        },
        ServiceRequest::Errors { slave } => ServiceReply::Errors(errors(slave)),
        _ => ServiceReply::Done,
    })
}

fn slave_info(slave: u8) -> SlaveInfo {
    let left = slave == 1;
    SlaveInfo {
        station: 0x1001 + u16::from(slave),
        identity: Identity {
            vendor: 2,
            product: 0x07D0_6014,
            revision: 0x110A,
            serial: u32::from(slave) + 1,
        },
        name: "AX2000-B110".try_into().expect("short"),
        driver: "AX2000-B110".try_into().expect("short"),
        member: Some(slave),
        report: AlReport {
            status: if left { 0x14 } else { 8 },
            code: if left { 0x001B } else { 0 },
        },
        status_word: Some(if left { 0x0218 } else { 0x0237 }),
        output_bytes: 6,
        input_bytes: 6,
        ..SlaveInfo::default()
    }
}

fn upload(object: Object, offset: u16) -> ServiceResult {
    let whole: &[u8] = match object.index {
        0x6064 => &[0xFE, 0xFF, 0xFF, 0xFF],
        0x1008 => &LONG,
        _ => {
            return Err(ServiceError::Bus(BusError::SdoAbort {
                object,
                code: 0x0602_0000,
            }));
        }
    };
    let rest = &whole[usize::from(offset)..];
    let piece = Piece::from_slice(&rest[..rest.len().min(256)]).expect("a piece");
    Ok(ServiceReply::Piece {
        total: whole.len() as u16,
        piece,
    })
}

/// The cable between slaves 2 and 3 is damaged, as counted by slave 3.
fn errors(slave: u8) -> SlaveErrors {
    let mut errors = SlaveErrors {
        partners: [
            slave.checked_sub(1),
            (slave + 1 < SLAVES).then_some(slave + 1),
            None,
            None,
        ],
        ..SlaveErrors::default()
    };
    if slave == 2 {
        errors.ports[0] = PortErrors {
            invalid_frames: 7,
            receive_errors: 3,
            forwarded_errors: 0,
            lost_links: 1,
        };
    }
    errors
}

/// A firmware behind a TCP port, for one client.
struct Firmware {
    port: String,
    asked: Arc<Mutex<Vec<ServiceRequest>>>,
    thread: JoinHandle<()>,
}

impl Firmware {
    /// A firmware that reports that it is busy this many times before each answer.
    fn new(busy: usize) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let port = format!("tcp:{}", listener.local_addr().expect("an address"));
        let asked = Arc::new(Mutex::new(Vec::new()));
        let thread = std::thread::spawn({
            let asked = asked.clone();
            move || serve(&listener.accept().expect("the program connects").0, busy, &asked)
        });
        Self { port, asked, thread }
    }

    /// The requests received, once the program has ended.
    fn asked(self) -> Vec<ServiceRequest> {
        self.thread.join().expect("the firmware ends with the connection");
        self.asked.lock().expect("nobody panics with it").clone()
    }
}

fn serve(mut client: &TcpStream, busy: usize, asked: &Mutex<Vec<ServiceRequest>>) {
    client
        .set_read_timeout(Some(Duration::from_millis(1)))
        .expect("a socket");
    let mut decoder: Decoder = Decoder::new();
    let mut endpoint: DeviceEndpoint = DeviceEndpoint::new(device::Identity {
        firmware: "0.1.0",
        board: "test",
        capacity: 64,
    });
    let (begun, mut waiting) = (Instant::now(), busy);
    loop {
        let now_ms = begun.elapsed().as_millis() as u64;
        let mut bytes = [0; 512];
        let length = match client.read(&mut bytes) {
            Ok(0) => return,
            Ok(length) => length,
            Err(error) if error.kind() == ErrorKind::WouldBlock => 0,
            Err(_) => return,
        };
        for byte in &bytes[..length] {
            let Some(Ok(payload)) = decoder.push(*byte) else {
                continue;
            };
            match endpoint.receive(LinkPort::Serial, payload, now_ms, 0) {
                Some(DeviceEvent::Configure { id, config }) => {
                    endpoint.configured(id, Ok(config.hash().expect("it fits")))
                }
                Some(DeviceEvent::Bus { id, request }) => {
                    let result = if waiting > 0 {
                        Err(ServiceError::Busy)
                    } else {
                        answer(&request)
                    };
                    waiting = if waiting > 0 { waiting - 1 } else { busy };
                    asked.lock().expect("nobody panics with it").push(request);
                    endpoint.bus_answered(id, result);
                }
                _ => {}
            }
        }
        let mut out = [0; 512];
        let length = endpoint.transmit(now_ms, &mut out);
        if client.write_all(&out[..length]).is_err() {
            return;
        }
    }
}

/// Runs `etherpen bus` on such a firmware: exit code, stdout, stderr, requests received.
fn bus(words: &[&str]) -> (Option<i32>, String, String, Vec<ServiceRequest>) {
    let folder = Folder::new();
    let firmware = Firmware::new(0);
    let mut command = etherpen(&folder);
    command.arg("bus").args(words).args(["--port", &firmware.port]);
    let (status, stdout, stderr) = run(&mut command);
    (status, stdout, stderr, firmware.asked())
}

fn json(words: &[&str]) -> Value {
    let words: Vec<&str> = words.iter().copied().chain(["--json"]).collect();
    let (status, stdout, stderr, _) = bus(&words);
    assert_eq!(status, Some(0), "{stderr}");
    serde_json::from_str(&stdout).expect("JSON")
}

#[test]
fn a_scan_is_a_table_for_people_and_a_list_for_programs() {
    let (status, stdout, stderr, _) = bus(&["scan"]);
    assert_eq!(status, Some(0), "{stderr}");
    let lines: Vec<&str> = stdout.lines().collect();
    assert!(lines[0].starts_with("slave  name         vendor"), "{stdout}");
    assert!(lines[1].starts_with("1      AX2000-B110  00000002  07d06014") && lines[1].contains("operation enabled"));
    assert!(
        lines[2].contains("SAFEOP with error") && lines[2].contains("fault"),
        "{stdout}"
    );
    assert!(
        lines[4].contains("slave 2: AL status code 0x001b") && lines[4].contains("watchdog"),
        "{stdout}"
    );
    let scan = json(&["scan"]);
    assert_eq!(scan["slaves"].as_array().map(Vec::len), Some(3));
    assert_eq!(scan["reference_clock"], 1);
    let second = &scan["slaves"][1];
    assert_eq!(
        (&second["slave"], &second["axis"], &second["product"]),
        (&2.into(), &2.into(), &0x07D0_6014.into())
    );
    assert_eq!(
        (&second["al_state"], &second["al_status_code"]),
        (&"SAFEOP".into(), &0x1B.into())
    );
    for text in ["al_status_text", "al_status_hint"] {
        assert!(second[text].as_str().is_some_and(|text| !text.is_empty()), "{second}");
    }
    assert_eq!(second["drive"]["state"], "fault");
}

#[test]
fn one_slave_is_described_and_a_missing_one_is_refused_with_how_many_there_are() {
    let (status, stdout, stderr, asked) = bus(&["info", "2"]);
    assert_eq!(status, Some(0), "{stderr}");
    assert!(
        stdout.contains("slave 2: AX2000-B110") && stdout.contains("603F:00"),
        "{stdout}"
    );
    assert_eq!(asked, [ServiceRequest::Bus, ServiceRequest::Slave { slave: 1 }]);
    let (status, _, stderr, _) = bus(&["info", "4"]);
    assert_eq!(status, Some(i32::from(code::FAILED)));
    assert!(stderr.contains("there are 3"), "{stderr}");
    let (status, _, stderr) = run(etherpen(&Folder::new()).args(["bus", "info", "0", "--port", "x"]));
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(stderr.contains("count from 1"), "{stderr}");
}

#[test]
fn a_state_is_reached_or_refused_with_number_text_and_what_to_try() {
    let (status, stdout, stderr, asked) = bus(&["state", "1", "preop"]);
    assert_eq!((status, stdout.trim()), (Some(0), "slave 1: PREOP"), "{stderr}");
    let state = AlState::PreOperational;
    assert_eq!(asked, [ServiceRequest::SetState { slave: 0, state }]);
    assert_eq!(json(&["state", "3", "OP"])["al_state"], "OP");
    let (status, _, stderr, _) = bus(&["state", "2", "op"]);
    assert_eq!(status, Some(i32::from(code::FAILED)));
    for part in ["asked for OP", "SAFEOP with error", "0x001b", "cyclic data"] {
        assert!(stderr.contains(part), "{stderr}");
    }
}

#[test]
fn objects_are_read_in_the_type_that_is_asked_for_or_told_by_the_slave() {
    let (status, stdout, stderr, _) = bus(&["sdo", "read", "1", "6064:0"]);
    assert_eq!(
        (status, stdout.trim()),
        (Some(0), "slave 1 6064:00 i32: -2 (0xfffffffe)"),
        "{stderr}"
    );
    let read = json(&["sdo", "read", "1", "0x6064:0", "--type", "u32"]);
    assert_eq!(
        (&read["value"], &read["type"]),
        (&0xFFFF_FFFE_u32.into(), &"u32".into())
    );
    let long = json(&["sdo", "read", "1", "1008"]);
    let text = long["value"].as_str().expect("text");
    assert!(text.len() == 600 && text.ends_with("AZ"), "in pieces");
    let (status, _, stderr, _) = bus(&["sdo", "read", "1", "6064:0", "--type", "u16"]);
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(stderr.contains("4 bytes"), "{stderr}");
    let (status, _, stderr, _) = bus(&["sdo", "read", "2", "2000:0"]);
    assert_eq!(status, Some(i32::from(code::FAILED)));
    for part in ["2000:00", "0x06020000", "does not exist", "dictionary"] {
        assert!(stderr.contains(part), "{stderr}");
    }
}

#[test]
fn objects_are_written_in_pieces_and_a_number_out_of_range_never_reaches_the_bus() {
    let (status, _, stderr, asked) = bus(&["sdo", "write", "2", "60FF:0", "-2", "--type", "i32"]);
    assert_eq!(status, Some(0), "{stderr}");
    let expected = ServiceRequest::Download {
        slave: 1,
        object: Object::new(0x60FF, 0),
        complete: false,
        total: 4,
        offset: 0,
        piece: Piece::from_slice(&[0xFE, 0xFF, 0xFF, 0xFF]).expect("short"),
    };
    assert_eq!(asked, [expected]);
    let (status, _, stderr, asked) = bus(&["sdo", "write", "2", "2000:0", &"0a".repeat(300), "--type", "bytes"]);
    assert_eq!(status, Some(0), "{stderr}");
    let pieces: Vec<_> = asked
        .iter()
        .map(|request| match request {
            ServiceRequest::Download {
                total, offset, piece, ..
            } => (*total, *offset, piece.len()),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(pieces, [(300, 0, 256), (300, 256, 44)]);
    let nobody = ["--port", "tcp:127.0.0.1:9"];
    let write = ["bus", "sdo", "write", "1", "6060:0", "200", "--type", "i8"];
    let (status, _, stderr) = run(etherpen(&Folder::new()).args(write).args(nobody));
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(stderr.contains("-128 to 127"), "{stderr}");
}

#[test]
fn a_dictionary_is_listed_with_names() {
    let list = json(&["sdo", "list", "1", "--entries"]);
    let objects = list["objects"].as_array().expect("a list");
    assert_eq!(objects.len(), 3);
    assert_eq!(
        (&objects[2]["index"], &objects[2]["entries"][0]["type"]),
        (&0x6064.into(), &"i32".into())
    );
    let (status, stdout, stderr, _) = bus(&["sdo", "list", "1"]);
    assert_eq!(status, Some(0), "{stderr}");
    assert!(
        stdout.contains("6064    variable") && stdout.contains("an object"),
        "{stdout}"
    );
}

#[test]
fn registers_are_shown_with_names_or_as_they_are() {
    let (status, stdout, stderr, _) = bus(&["registers", "2", "0x1000", "300"]);
    assert_eq!(status, Some(0), "{stderr}");
    let lines: Vec<&str> = stdout.lines().collect();
    assert_eq!(lines.len(), 19);
    assert_eq!(lines[1], "1010  10 11 12 13 14 15 16 17 18 19 1a 1b 1c 1d 1e 1f");
    let named = json(&["registers"]);
    assert_eq!(named.as_array().map(Vec::len), Some(3));
    let status = named[2]["registers"].as_array().expect("a list").iter();
    let status = status.clone().find(|register| register["name"] == "AL status");
    assert_eq!(
        status.map(|register| &register["value"]),
        Some(&0x3130.into()),
        "little-endian"
    );
}

#[test]
fn error_counters_point_at_the_cable() {
    let (status, stdout, stderr, asked) = bus(&["errors", "--clear"]);
    assert_eq!(status, Some(0), "{stderr}");
    assert!(
        stdout.contains("slave 3 port 0: check the cable between slave 2 and 3"),
        "{stdout}"
    );
    assert_eq!(asked.last(), Some(&ServiceRequest::ClearErrors));
    let counted = json(&["errors"]);
    let port = &counted[2]["ports"][0];
    assert_eq!(
        (&port["invalid_frames"], &port["cable"]),
        (&7.into(), &"between slave 2 and 3".into())
    );
}

#[test]
fn a_busy_bus_is_asked_again() {
    let folder = Folder::new();
    let firmware = Firmware::new(2);
    let mut command = etherpen(&folder);
    command.args(["bus", "info", "1", "--port", &firmware.port]);
    let (status, _, stderr) = run(&mut command);
    assert_eq!(status, Some(0), "{stderr}");
    assert_eq!(firmware.asked().len(), 6, "each of two questions three times");
}
