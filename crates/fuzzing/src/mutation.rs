//! Seeded changes of an input, for a replay without a fuzzer.

use etherpen_segment::random::Random;

/// Longest result, bytes.
const BYTES_MAX: usize = 8 * 1024;
/// Most changes of one input.
const CHANGES_MAX: u64 = 6;
/// Numbers at the edges of their types.
const EDGES: [u32; 8] = [0, 1, 0x7F, 0x80, 0xFFFF, 0x7FFF_FFFF, 0x8000_0000, u32::MAX];

/// An input with a few changes, which depend on the seed alone; `other` lends some of its bytes.
#[must_use]
pub fn mutated(input: &[u8], other: &[u8], seed: u64) -> Vec<u8> {
    let mut random = Random::new(seed);
    let mut bytes = input.to_vec();
    for _ in 0..=random.bits() % CHANGES_MAX {
        change(&mut bytes, other, &mut random);
    }
    bytes.truncate(BYTES_MAX);
    bytes
}

fn change(bytes: &mut Vec<u8>, other: &[u8], random: &mut Random) {
    let mut below = |count: usize| (random.bits() % count.max(1) as u64) as usize;
    let (kind, value) = (below(9), below(256) as u8);
    let at = below(bytes.len() + 1);
    let length = below(16).min(bytes.len() - at);
    match kind {
        0 | 1 => bytes
            .iter_mut()
            .skip(at)
            .take(1)
            .for_each(|byte| *byte ^= 1 << (value % 8)),
        2 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte = value),
        3 => bytes.insert(at, value),
        4 => drop(bytes.drain(at..at + length)),
        5 => {
            let part = bytes[at..at + length].to_vec();
            for _ in 0..=value % 8 {
                bytes.splice(at..at, part.iter().copied());
            }
        }
        6 => {
            let edge = EDGES[usize::from(value) % EDGES.len()].to_le_bytes();
            for (byte, edge) in bytes.iter_mut().skip(at).zip(edge) {
                *byte = edge;
            }
        }
        7 => {
            let from = below(other.len() + 1);
            let part = other[from..].iter().take(1 + usize::from(value) / 4).copied();
            bytes.splice(at..at + length, part);
        }
        _ => bytes.truncate(at),
    }
}
