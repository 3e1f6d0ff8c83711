//! The virtual cell, with a foreign station on its cable.

use crate::cell::{Cell, Script};
use crate::emulator::Segment;

/// Position of the EtherType in an Ethernet frame, bytes.
const ETHER_TYPE: std::ops::Range<usize> = 12..14;
/// The EtherType of the firmware's requests for foreign frames.
const REQUEST: [u8; 2] = [0x88, 0xB5];
/// EtherTypes of the frames sent as answers: ARP, IPv4, and the one for local experiments.
const ANSWERS: [[u8; 2]; 3] = [[0x08, 0x06], [0x08, 0x00], REQUEST];

/// A foreign frame before every reply, if requested.
pub(super) fn faults(foreign: bool) -> Script {
    let script = if foreign { "every 1 foreign" } else { "" };
    script.parse().unwrap_or_default()
}

/// The cable.
pub(super) struct Cable {
    cell: Cell,
}

impl Cable {
    pub(super) fn new(cell: Cell) -> Self {
        Self { cell }
    }
}

impl Segment for Cable {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        if frame.get(ETHER_TYPE) != Some(&REQUEST) {
            return self.cell.frame(time_us, frame);
        }
        let answer = |ether_type: &[u8; 2]| {
            let mut answer = frame.to_vec();
            if let Some(place) = answer.get_mut(ETHER_TYPE) {
                place.copy_from_slice(ether_type);
            }
            answer
        };
        ANSWERS.iter().map(answer).collect()
    }

    fn advance_to(&mut self, time_us: u64) {
        self.cell.advance_to(time_us);
    }
}
