//! The firmware's link task with a host that sends any bytes, without bus and drives.

use etherpen::black_box::{Keep, Memory};
use etherpen::controller::{Channels, Parts};
use etherpen::link::device::LINE_BYTES_PER_MS;
use etherpen::link::frame::{FRAME_BYTES_MAX, encode};
use etherpen::link::message::Hello;
use etherpen::messages::{HostMessage, PROTOCOL_VERSION};
use etherpen::motion::PERIOD_MS;
use serde::Serialize;

/// Time for which the firmware runs after the last byte, ms.
const AFTER_MS: usize = 40;

/// Passes bytes to the link task as fast as the line carries them; returns what it sent.
pub(crate) fn talk(bytes: &[u8]) -> Vec<u8> {
    let black_box = Box::new(Memory::new());
    black_box.start(Keep::Nothing);
    let mut channels = Box::new(Channels::new());
    let Parts {
        mut link,
        mut host_bytes,
        mut trajectory,
        ..
    } = channels.split("fuzzing", &black_box);
    let mut sent = Vec::new();
    let mut room = [0; LINE_BYTES_PER_MS];
    let mut parts = bytes.chunks(LINE_BYTES_PER_MS);
    let mut left = AFTER_MS;
    for ms in 1.. {
        match parts.next() {
            Some(part) => assert_eq!(host_bytes.received(part), part.len(), "the link task keeps up"),
            None if left == 0 => break,
            None => left -= 1,
        }
        link.tick();
        if ms % PERIOD_MS == 0 {
            trajectory.release();
        }
        let length = host_bytes.to_send(&mut room);
        sent.extend_from_slice(&room[..length]);
    }
    sent
}

/// A message as its frame on the line.
pub(crate) fn framed(message: &impl Serialize) -> Vec<u8> {
    let mut frame = [0; FRAME_BYTES_MAX];
    let length = encode(message, &mut frame).expect("a message fits a frame");
    frame[..length].to_vec()
}

/// The greeting of a session.
pub(crate) fn greeting() -> HostMessage {
    HostMessage::Hello(Hello {
        protocol: PROTOCOL_VERSION,
        session: 7,
    })
}
