//! The robot's messages fit the line and the frames.

use super::*;
use crate::config::SAMPLE_WORD_BYTES_MAX;
use crate::link::device::{Identity, LINE_BYTES_PER_MS};
use crate::link::frame::{Decoder, FRAME_BYTES_MAX, decode, encode};
use crate::link::message::{Hello, VERTICES_PER_MESSAGE};
use crate::link::ports::LinkPort;

const IDENTITY: Identity = Identity {
    firmware: "0.1.0",
    board: "simulation",
    capacity: 512,
};

/// Passes a message to the firmware's end, which has room for 500 vertices.
fn say(endpoint: &mut DeviceEndpoint, now_ms: u64, message: &HostMessage) {
    let (mut frame, mut decoder) = ([0; FRAME_BYTES_MAX], Decoder::new());
    let decoder: &mut Decoder = &mut decoder;
    let length = encode(message, &mut frame).unwrap();
    for byte in &frame[..length] {
        if let Some(payload) = decoder.push(*byte) {
            endpoint.receive(LinkPort::Serial, payload.unwrap(), now_ms, 500);
        }
    }
}

fn drawing() -> DeviceEndpoint {
    let mut endpoint = DeviceEndpoint::new(IDENTITY);
    let hello = Hello {
        protocol: PROTOCOL_VERSION,
        session: 1,
    };
    say(&mut endpoint, 0, &HostMessage::Hello(hello));
    let command = Command::Draw { job: 3 };
    say(&mut endpoint, 0, &HostMessage::Command { id: 1, command });
    endpoint.answer(1, Ok(()));
    let mut out = [0; FRAME_BYTES_MAX];
    endpoint.transmit(0, &mut out);
    endpoint
}

fn path(first: u32) -> HostMessage {
    let vertices = (first..).take(VERTICES_PER_MESSAGE).map(|index| PathVertex {
        position_um: [index as i32, 0, -850_000],
        pen: Pen::Down,
        stroke: 0,
    });
    HostMessage::Path {
        job: 3,
        first,
        vertices: vertices.collect(),
        last: false,
    }
}

fn sample(t_ms: u32) -> Sample {
    let angle = (t_ms as f32).sin();
    Sample {
        t_ms: 100_000_000 + t_ms,
        mode: Mode::Drawing,
        stroke: 20_000,
        pen: Pen::Down,
        setpoint_rad: [angle; 4],
        measured_rad: [angle * 0.999; 4],
        setpoint_rad_s: [angle * 7.1; 4],
        measured_rad_s: [angle * 7.3; 4],
        // All of them change each millisecond.
        io: IoValues {
            set: !(t_ms as u16),
            missing: t_ms as u16,
            words: [0xFFFF - t_ms % 0xFF; SAMPLE_WORD_BYTES_MAX / 2].into_iter().collect(),
        },
    }
}

fn full_status() -> Status {
    let slave = SlaveStatus {
        vendor: u32::MAX,
        product: u32::MAX,
        al_state: 8,
        al_code: 0,
        status_word: u16::MAX,
    };
    let point = IoState {
        raw: u32::MAX,
        valid: true,
    };
    Status {
        mode: Mode::Drawing,
        fault: None,
        recovering: false,
        interlock: Some(Interlock::Clock),
        port: PortState::Up,
        waiting_for: Some(u8::MAX),
        referenced: true,
        reference_lost: true,
        increments: [Some(i32::MIN); 4],
        config: Some(u64::MAX),
        override_percent: 100,
        counters: Counters {
            cycles: u32::MAX,
            ..Counters::default()
        },
        slaves: core::iter::repeat_n(slave, SLAVES_REPORTED).collect(),
        io: core::iter::repeat_n(point, IO_MAX).collect(),
    }
}

#[test]
fn a_sample_every_millisecond_fits_the_line_beside_acknowledgements_answers_and_status() {
    let mut endpoint = drawing();
    let mut decoder: Decoder = Decoder::new();
    let (mut received, mut bytes) = (0u32, 0usize);
    let duration_ms = 20_000u32;
    for t_ms in 0..duration_ms {
        let now_ms = u64::from(t_ms);
        endpoint.sample(sample(t_ms));
        if t_ms % 4 == 0 {
            say(&mut endpoint, now_ms, &path(t_ms * 4));
        }
        if t_ms % 500 == 0 {
            endpoint.status(full_status());
            let id = (t_ms / 500) as u16 + 2;
            let command = Command::Override { percent: 90 };
            say(&mut endpoint, now_ms, &HostMessage::Command { id, command });
            endpoint.answer(id, Ok(()));
        }
        endpoint.acknowledge(t_ms, 500, false);
        let mut line = [0; LINE_BYTES_PER_MS];
        let length = endpoint.transmit(now_ms, &mut line);
        bytes += length;
        for byte in &line[..length] {
            let Some(payload) = decoder.push(*byte) else { continue };
            if let Ok(DeviceMessage::Telemetry { sequence, samples }) = decode(payload.unwrap()) {
                assert_eq!(sequence, received);
                received += samples.len() as u32;
            }
        }
    }
    assert_eq!(endpoint.counts().samples_dropped, 0);
    assert!(duration_ms - received < 16, "{received} of {duration_ms}");
    let share = bytes as f64 / (duration_ms as usize * LINE_BYTES_PER_MS) as f64;
    // Every named word and bit changes in every millisecond.
    std::println!("{share} of the line is used");
    assert!(share < 0.97, "{share} of the line is used");
}

#[test]
fn a_stop_overtakes_and_a_drawing_opens_its_path() {
    assert_eq!(RobotProtocol::effect(&Command::Stop), CommandEffect::Stops);
    assert_eq!(RobotProtocol::effect(&Command::Cancel), CommandEffect::ClosesPath);
    let draw = Command::Draw { job: 7 };
    assert_eq!(RobotProtocol::effect(&draw), CommandEffect::OpensPath { job: 7 });
    assert_eq!(RobotProtocol::effect(&Command::Enable), CommandEffect::None);
}
