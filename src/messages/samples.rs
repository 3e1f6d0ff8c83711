//! The bytes of the samples in a telemetry message.
//!
//! | bytes | content |
//! |---|---|
//! | 1 | mode (bits 0 to 3), pen down (bit 4), which of the following differ from the sample before |
//! | 8, if bit 5 | millisecond and stroke; otherwise the next millisecond, the same stroke |
//! | 4, if bit 6 | named inputs and outputs: set, missing |
//! | 1 to 9, if bit 7 | named words: two bits for the size of each, from the lowest; their bytes |
//! | 64 | setpoint angles of all axes, measured angles, setpoint speeds, measured speeds |
//!
//! Little-endian. The sample before the first of a message is all zeros, at millisecond 0. Sizes: 0 no word, 1 one byte, 2 two bytes, 3 four bytes;
//! a word has the shortest that holds it.
//!
//! Invariant: bytes that are no samples give an error.

use super::{IoValues, IoWords, RobotProtocol, Sample};
use crate::application::Mode;
use crate::config::SAMPLE_WORD_BYTES_MAX;
use crate::link::message::{SAMPLES_PER_MESSAGE, Samples};
use crate::motion::Pen;
use crate::robots::AXES;
use core::fmt;
use heapless::Vec;
use serde::de::{Deserializer, Visitor};
use serde::ser::{Error as _, Serializer};

const MODE: u8 = 0x0F;
const PEN: u8 = 1 << 4;
const PLACE: u8 = 1 << 5;
const IO: u8 = 1 << 6;
const WORDS: u8 = 1 << 7;
/// Longest sample, bytes.
const SAMPLE_BYTES_MAX: usize = 1 + 8 + 4 + 1 + SAMPLE_WORD_BYTES_MAX + 4 * 4 * AXES;
/// Longest samples of a message, bytes.
const BYTES_MAX: usize = SAMPLES_PER_MESSAGE * SAMPLE_BYTES_MAX;

const _: () = assert!(Mode::ALL.len() <= MODE as usize + 1, "four bits for the mode");

type Bytes = Vec<u8, BYTES_MAX>;

/// Time, stroke, and inputs and outputs of the sample before.
#[derive(Default)]
struct Before {
    t_ms: u32,
    stroke: u32,
    io: IoValues,
}

impl Before {
    const fn of(sample: &Sample) -> Self {
        Self {
            t_ms: sample.t_ms,
            stroke: sample.stroke,
            io: sample.io,
        }
    }

    const fn next_ms(&self) -> u32 {
        self.t_ms.wrapping_add(1)
    }
}

/// Writes the samples of a message as bytes.
///
/// # Errors
/// Errors of the serializer.
pub(super) fn serialize<S: Serializer>(samples: &[Sample], serializer: S) -> Result<S::Ok, S::Error> {
    let (mut bytes, mut before) = (Bytes::new(), Before::default());
    for sample in samples {
        put(sample, &before, &mut bytes).ok_or_else(|| S::Error::custom("too many samples"))?;
        before = Before::of(sample);
    }
    serializer.serialize_bytes(&bytes)
}

/// Appends a sample; `None` without room.
fn put(sample: &Sample, before: &Before, out: &mut Bytes) -> Option<()> {
    let Sample { t_ms, stroke, io, .. } = *sample;
    let has_place = t_ms != before.next_ms() || stroke != before.stroke;
    let has_io = (io.set, io.missing) != (before.io.set, before.io.missing);
    let has_words = io.words != before.io.words;
    let flag = |is_set: bool, flag: u8| if is_set { flag } else { 0 };
    let flags = flag(sample.pen == Pen::Down, PEN) | flag(has_place, PLACE) | flag(has_io, IO) | flag(has_words, WORDS);
    out.push(sample.mode.number() & MODE | flags).ok()?;
    if has_place {
        out.extend_from_slice(&t_ms.to_le_bytes()).ok()?;
        out.extend_from_slice(&stroke.to_le_bytes()).ok()?;
    }
    if has_io {
        out.extend_from_slice(&io.set.to_le_bytes()).ok()?;
        out.extend_from_slice(&io.missing.to_le_bytes()).ok()?;
    }
    if has_words {
        let (sizes, bytes) = io.words.packed();
        out.push(sizes).ok()?;
        out.extend_from_slice(bytes).ok()?;
    }
    let columns = [
        &sample.setpoint_rad,
        &sample.measured_rad,
        &sample.setpoint_rad_s,
        &sample.measured_rad_s,
    ];
    for value in columns.into_iter().flatten() {
        out.extend_from_slice(&value.to_le_bytes()).ok()?;
    }
    Some(())
}

/// Reads the samples of a message.
///
/// # Errors
/// Errors of the deserializer, and bytes that are no samples.
pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Samples<RobotProtocol>, D::Error> {
    deserializer.deserialize_bytes(OfBytes)
}

struct OfBytes;

impl Visitor<'_> for OfBytes {
    type Value = Samples<RobotProtocol>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("samples")
    }

    fn visit_bytes<E: serde::de::Error>(self, bytes: &[u8]) -> Result<Self::Value, E> {
        let (mut samples, mut before, mut rest) = (Samples::<RobotProtocol>::new(), Before::default(), bytes);
        while !rest.is_empty() {
            let sample = take(&mut rest, &before).ok_or_else(|| E::custom("no samples"))?;
            before = Before::of(&sample);
            samples.push(sample).map_err(|_| E::custom("too many samples"))?;
        }
        Ok(samples)
    }
}

fn take(rest: &mut &[u8], before: &Before) -> Option<Sample> {
    let [head] = array(rest)?;
    let mode = Mode::from_number(head & MODE)?;
    let pen = if head & PEN != 0 { Pen::Down } else { Pen::Up };
    let (t_ms, stroke) = match head & PLACE {
        0 => (before.next_ms(), before.stroke),
        _ => (u32::from_le_bytes(array(rest)?), u32::from_le_bytes(array(rest)?)),
    };
    let mut io = before.io;
    if head & IO != 0 {
        io.set = u16::from_le_bytes(array(rest)?);
        io.missing = u16::from_le_bytes(array(rest)?);
    }
    if head & WORDS != 0 {
        let [sizes] = array(rest)?;
        (io.words, *rest) = IoWords::unpack(sizes, rest)?;
    }
    let mut columns = [[0.0; AXES]; 4];
    for value in columns.as_flattened_mut() {
        *value = f32::from_le_bytes(array(rest)?);
    }
    let [setpoint_rad, measured_rad, setpoint_rad_s, measured_rad_s] = columns;
    Some(Sample {
        t_ms,
        mode,
        stroke,
        pen,
        setpoint_rad,
        measured_rad,
        setpoint_rad_s,
        measured_rad_s,
        io,
    })
}

fn array<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (taken, behind) = rest.split_first_chunk()?;
    *rest = behind;
    Some(*taken)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::SAMPLE_WORDS_MAX;
    use crate::link::frame::{Decoder, FRAME_BYTES_MAX, decode, encode};
    use crate::messages::DeviceMessage;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// Joint values by their bits: those that are no number included.
    fn joints() -> impl Strategy<Value = [f32; AXES]> {
        prop::array::uniform4(any::<u32>().prop_map(f32::from_bits))
    }

    fn io() -> impl Strategy<Value = IoValues> {
        // Short values as often as long ones.
        let value = (any::<u32>(), 0..32_u32).prop_map(|(value, shift)| value >> shift);
        let words = prop::collection::vec(value, 0..=SAMPLE_WORDS_MAX);
        (any::<u16>(), any::<u16>(), words).prop_map(|(set, missing, words)| IoValues {
            set,
            missing,
            words: words.into_iter().collect(),
        })
    }

    /// What makes the next sample: the mode, the pen, what is new, and the joints.
    fn sample() -> impl Strategy<Value = Sample> {
        let head = (any::<u32>(), any::<u32>(), 0..Mode::ALL.len(), any::<bool>(), io());
        let joints = (joints(), joints(), joints(), joints());
        (head, joints).prop_map(|((t_ms, stroke, mode, pen, io), joints)| Sample {
            t_ms,
            mode: Mode::ALL[mode],
            stroke,
            pen: if pen { Pen::Down } else { Pen::Up },
            setpoint_rad: joints.0,
            measured_rad: joints.1,
            setpoint_rad_s: joints.2,
            measured_rad_s: joints.3,
            io,
        })
    }

    /// Samples in which some of time and stroke, bits and words are as in the sample before.
    fn samples() -> impl Strategy<Value = Vec<Sample>> {
        let one = (sample(), prop::array::uniform3(any::<bool>()));
        prop::collection::vec(one, 0..=SAMPLES_PER_MESSAGE).prop_map(|drawn| {
            let mut samples: Vec<Sample> = Vec::new();
            for (mut sample, [place, bits, words]) in drawn {
                if let Some(before) = samples.last() {
                    if place {
                        (sample.t_ms, sample.stroke) = (before.t_ms.wrapping_add(1), before.stroke);
                    }
                    if bits {
                        (sample.io.set, sample.io.missing) = (before.io.set, before.io.missing);
                    }
                    if words {
                        sample.io.words = before.io.words;
                    }
                }
                samples.push(sample);
            }
            samples
        })
    }

    /// Everything of a sample, with the bits of its numbers.
    fn bits(sample: &Sample) -> impl PartialEq + core::fmt::Debug {
        let Sample {
            t_ms,
            mode,
            stroke,
            pen,
            io,
            ..
        } = *sample;
        let joints = [
            sample.setpoint_rad,
            sample.measured_rad,
            sample.setpoint_rad_s,
            sample.measured_rad_s,
        ];
        (
            t_ms,
            mode,
            stroke,
            pen,
            io,
            joints.map(|column| column.map(f32::to_bits)),
        )
    }

    fn framed(samples: &[Sample]) -> Vec<u8> {
        let message = DeviceMessage::Telemetry {
            sequence: 7,
            samples: samples.iter().copied().collect(),
        };
        let mut frame = [0; FRAME_BYTES_MAX];
        let length = encode(&message, &mut frame).unwrap();
        frame[..length].to_vec()
    }

    /// What the host reads of a frame.
    fn read(frame: &[u8]) -> Option<Vec<Sample>> {
        let mut decoder: Decoder = Decoder::new();
        let mut found = None;
        for byte in frame {
            let Some(Ok(payload)) = decoder.push(*byte) else {
                continue;
            };
            if let Ok(DeviceMessage::Telemetry { samples, .. }) = decode(payload) {
                found = Some(samples.to_vec());
            }
        }
        found
    }

    fn of(t_ms: u32, words: &[u32]) -> Sample {
        Sample {
            t_ms,
            mode: Mode::Idle,
            stroke: 0,
            pen: Pen::Up,
            setpoint_rad: [0.1; AXES],
            measured_rad: [0.2; AXES],
            setpoint_rad_s: [0.3; AXES],
            measured_rad_s: [0.4; AXES],
            io: IoValues {
                words: words.iter().copied().collect(),
                ..IoValues::default()
            },
        }
    }

    proptest! {
        #[test]
        fn samples_come_back_bit_by_bit(samples in samples()) {
            let back = read(&framed(&samples)).expect("a message");
            prop_assert_eq!(
                back.iter().map(bits).collect::<Vec<_>>(),
                samples.iter().map(bits).collect::<Vec<_>>()
            );
        }

        #[test]
        fn bytes_that_are_no_samples_are_refused(bytes in prop::collection::vec(any::<u8>(), 0..2 * BYTES_MAX)) {
            let visited: Result<_, serde::de::value::Error> = OfBytes.visit_bytes(&bytes);
            if let Ok(samples) = visited {
                let (mut again, mut before) = (Bytes::new(), Before::default());
                for sample in &samples {
                    prop_assert!(put(sample, &before, &mut again).is_some());
                    before = Before::of(sample);
                }
                let read: Result<_, serde::de::value::Error> = OfBytes.visit_bytes(&again);
                prop_assert_eq!(read.map(|samples| samples.len()), Ok(samples.len()));
                // What is longer than needed is not refused; nothing that was read needs more.
                prop_assert!(again.len() <= bytes.len());
            }
        }
    }

    #[test]
    fn a_message_that_ends_within_a_sample_is_refused() {
        let of_words = of(5, &[1, 0x100, 0x1_0000, 0]);
        let mut bytes = Bytes::new();
        put(&of_words, &Before::default(), &mut bytes).unwrap();
        assert_eq!(bytes.len(), 1 + 8 + 1 + (1 + 2 + 4 + 1) + 64);
        for length in 1..bytes.len() {
            let visited: Result<_, serde::de::value::Error> = OfBytes.visit_bytes(&bytes[..length]);
            assert!(visited.is_err(), "{length}");
        }
    }

    #[test]
    fn words_are_kept_as_far_as_there_is_room() {
        let kept = |words: &[u32]| of(5, words).io.words.values().collect::<Vec<_>>();
        assert_eq!(kept(&[u32::MAX, 0, u32::MAX]), [u32::MAX, 0]);
        assert_eq!(kept(&[0xFFFF; 5]), [0xFFFF; 4]);
        assert_eq!(kept(&[0; 5]), [0; 4]);
    }

    #[test]
    fn words_cost_their_bytes_and_one_more_and_nothing_while_they_stay() {
        let length = |words: &[u32]| {
            let (mut bytes, first) = (Bytes::new(), of(7, &[]));
            put(&of(8, words), &Before::of(&first), &mut bytes).unwrap();
            bytes.len()
        };
        let plain = length(&[]);
        assert_eq!(plain, 65);
        assert_eq!(length(&[0xFFFF; 4]), plain + 9);
        assert_eq!(length(&[0xFF]), plain + 2);
        let (mut bytes, words) = (Bytes::new(), of(7, &[0xFFFF; 4]));
        put(&of(8, &[0xFFFF; 4]), &Before::of(&words), &mut bytes).unwrap();
        assert_eq!(bytes.len(), plain);
    }
}
