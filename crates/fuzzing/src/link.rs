//! Any bytes as the link's stream, and as the payload of its messages, at both ends.

use crate::firmware::{framed, greeting, talk};
use etherpen::black_box;
use etherpen::config::Config;
use etherpen::ethercat::diagnostics::ServiceRequest;
use etherpen::link::frame::decode;
use etherpen::link::message::MESSAGE_BYTES_MAX;
use etherpen::measurement::{MeasurementRequest, Quantity};
use etherpen::messages::Command;
use etherpen::messages::{DeviceMessage, HostMessage, PathVertex, RecordRequest, RobotProtocol};
use etherpen::motion::Pen;
use etherpen_link::host::Session;
use serde::{Serialize, Serializer, ser::SerializeTuple};

/// Time between two parts of a stream, ms, and bytes of a part.
const PART_MS: u64 = 5;
const PART_BYTES: usize = 64;

/// Passes a stream to the firmware's end and to the host's end.
pub(crate) fn stream(bytes: &[u8]) {
    let answered = talk(bytes);
    host(&answered);
    host(bytes);
}

/// A host that takes these bytes from the line.
fn host(bytes: &[u8]) {
    let mut session: Session<RobotProtocol> = Session::new(7);
    session.connect();
    session.configure(Config::default());
    let job: Vec<PathVertex> = (0..40).map(vertex).collect();
    session.start_path(1, job.into());
    let mut room = [0; 512];
    let mut now_ms = 0;
    for part in bytes.chunks(PART_BYTES) {
        now_ms += PART_MS;
        session.receive(part, now_ms);
        while session.next_event().is_some() {}
        session.command(Command::Hold);
        let sent = session.transmit(now_ms, &mut room);
        assert!(sent <= room.len());
    }
}

fn vertex(number: u32) -> PathVertex {
    PathVertex {
        position_um: [1_000 * number as i32, 0, -850_000],
        pen: Pen::Down,
        stroke: 0,
    }
}

/// Bytes that are encoded as they are.
struct Raw<'a>(&'a [u8]);

impl Serialize for Raw<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(self.0.len())?;
        for byte in self.0 {
            tuple.serialize_element(byte)?;
        }
        tuple.end()
    }
}

/// Parts between zeros are messages: each is decoded as a message of either side, then sent behind a greeting in a
/// frame with a correct checksum.
pub(crate) fn messages(bytes: &[u8]) {
    let mut to_firmware = framed(&greeting());
    let mut to_host = Vec::new();
    for payload in bytes.split(|byte| *byte == 0xFE).take(16) {
        let payload = payload.get(..MESSAGE_BYTES_MAX).unwrap_or(payload);
        same::<HostMessage>(payload);
        same::<DeviceMessage>(payload);
        to_firmware.extend(framed(&Raw(payload)));
        to_host.extend(framed(&Raw(payload)));
    }
    host(&talk(&to_firmware));
    host(&to_host);
}

/// What is decoded survives encoding and decoding: the bytes are compared, because a number may be none.
fn same<M: serde::de::DeserializeOwned + Serialize>(payload: &[u8]) {
    let Ok(message) = decode::<M>(payload) else { return };
    let encode = |message: &M| {
        let mut room = [0; 2 * MESSAGE_BYTES_MAX];
        postcard::to_slice(message, &mut room)
            .expect("a decoded message fits")
            .to_vec()
    };
    let bytes = encode(&message);
    let again = decode::<M>(&bytes).expect("what was encoded is decoded");
    assert_eq!(encode(&again), bytes);
}

/// Messages of a host.
fn said() -> Vec<HostMessage> {
    let vertices = (0..16).map(vertex).collect();
    let command = |command| HostMessage::Command { id: 3, command };
    vec![
        greeting(),
        HostMessage::Heartbeat,
        HostMessage::Configure {
            id: 1,
            config: Config::default(),
        },
        command(Command::Enable),
        command(Command::Draw { job: 1 }),
        command(Command::Jog {
            velocity_mm_s: [1.0, 2.0, 0.0],
        }),
        command(Command::Override { percent: 80 }),
        command(Command::Stop),
        command(Command::Acknowledge),
        HostMessage::Path {
            job: 1,
            first: 0,
            vertices,
            last: true,
        },
        HostMessage::Inquire,
        HostMessage::Bus {
            id: 4,
            request: ServiceRequest::Slave { slave: 1 },
        },
        HostMessage::Measure {
            id: 5,
            request: RecordRequest::Measurement(MeasurementRequest::Read {
                quantity: Quantity::Sample,
                first: 0,
            }),
        },
        HostMessage::Measure {
            id: 6,
            request: RecordRequest::BlackBox(black_box::Request::Read { offset: 1_024 }),
        },
    ]
}

/// Sessions of a host, and what the firmware answers.
pub(crate) fn stream_seeds() -> Vec<Vec<u8>> {
    let all: Vec<u8> = said().iter().flat_map(framed).collect();
    let few: Vec<u8> = said()
        .iter()
        .filter(|said| !matches!(said, HostMessage::Configure { .. }))
        .flat_map(framed)
        .collect();
    vec![talk(&all), all, few]
}

/// Every message by itself, and all in a row.
pub(crate) fn message_seeds() -> Vec<Vec<u8>> {
    let encode = |message: &HostMessage| {
        let mut room = [0; MESSAGE_BYTES_MAX];
        postcard::to_slice(message, &mut room).expect("a message fits").to_vec()
    };
    let mut seeds: Vec<Vec<u8>> = said().iter().map(encode).collect();
    seeds.push(seeds.join(&0xFE));
    let mut decoder: etherpen::link::frame::Decoder = etherpen::link::frame::Decoder::new();
    for byte in talk(&said().iter().flat_map(framed).collect::<Vec<u8>>()) {
        if let Some(Ok(payload)) = decoder.push(byte)
            && seeds.len() < 40
        {
            seeds.push(payload.to_vec());
        }
    }
    seeds
}
