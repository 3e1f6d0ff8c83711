//! A millisecond of a recording: its ROS 2 definition and its bytes.
//!
//! A sample has the axes that the machine has, each in its own unit, and its definition says so: with four rotary axes 116 bytes
//! and 4 for each named word in it, a quarter of its size as JSON. Radians are bit-identical to the firmware's numbers.
//! Older recordings have four axes in radians, whatever the machine.
//!
//! Invariant: bytes that are not a valid message give `None`.

use super::bytes::Numbers;
use super::cdr::{Decoder, Encoder};
use crate::axes::{AxisView, Motion, axes as axes_of};
use etherpen::application::Mode;
use etherpen::config::{Config, SAMPLE_WORDS_MAX};
use etherpen::messages::{IoValues, IoWords, Sample};
use etherpen::motion::Pen;
use etherpen::robots::{AXES, Position};

/// Bytes of a sample without an axis in recordings from before it had named inputs and outputs.
const BYTES_WITHOUT_AXES: usize = 44;
/// Columns of an axis.
const COLUMNS: usize = 4;
/// Bytes of an axis.
const AXIS_BYTES: usize = 16;
/// Bytes of the named inputs and outputs.
const IO_BYTES: usize = 4;

/// One millisecond; its stroke and pen are those of the reference to which the measured position belongs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// The firmware's sample.
    pub sample: Sample,
    /// Measured position of the platform, mm.
    pub position: Position,
}

/// How the axes of a sample move; `None` for one that the machine has not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleAxes([Option<Motion>; AXES]);

impl SampleAxes {
    /// Four rotary axes, as in all older recordings.
    pub const ROTARY: Self = Self([Some(Motion::Rotary); AXES]);

    /// The axes of a machine.
    #[must_use]
    pub fn of(config: &Config) -> Self {
        let mut motions = [None; AXES];
        for (motion, axis) in motions.iter_mut().zip(axes_of(config)) {
            *motion = Some(axis.motion);
        }
        Self(motions)
    }

    /// The axes of a definition, one behind the other; `None` if there is none, or if it has a part of an axis's columns only.
    #[must_use]
    pub fn of_schema(schema: &str) -> Option<Self> {
        let columns: Vec<&str> = schema
            .lines()
            .filter_map(|line| line.strip_prefix("float32 "))
            .collect();
        let mut motions = [None; AXES];
        let mut left = columns.as_slice();
        for (index, motion) in motions.iter_mut().enumerate().take(columns.len().div_ceil(COLUMNS)) {
            let (own, rest) = left.split_at_checked(COLUMNS)?;
            let has_columns = |motion: &Motion| view(index, *motion).columns().iter().eq(own);
            *motion = Some([Motion::Rotary, Motion::Linear].into_iter().find(has_columns)?);
            left = rest;
        }
        (left.is_empty() && !columns.is_empty()).then_some(Self(motions))
    }

    /// The definition of a sample with these axes.
    #[must_use]
    pub fn schema(&self) -> String {
        let mut schema = BEFORE_AXES.to_owned();
        for axis in self.views() {
            for column in axis.columns() {
                schema.extend(["float32 ", &column, "\n"]);
            }
        }
        schema + BEHIND_AXES
    }

    fn views(&self) -> impl Iterator<Item = AxisView> {
        let motions = self.0.into_iter().enumerate();
        motions.filter_map(|(index, motion)| Some(view(index, motion?)))
    }

    /// Bytes of a sample from before it had named inputs and outputs.
    fn bytes_without_io(&self) -> usize {
        BYTES_WITHOUT_AXES + AXIS_BYTES * self.views().count()
    }
}

/// An axis without a name.
fn view(index: usize, motion: Motion) -> AxisView {
    AxisView {
        index,
        name: String::new(),
        label: String::new(),
        motion,
    }
}

/// The operating modes as constants of a schema.
macro_rules! modes {
    () => {
        "uint8 STARTUP=0\nuint8 BUS_CONFIGURING=1\nuint8 DRIVES_OFF=2\nuint8 UNREFERENCED=3\nuint8 IDLE=4\n\
         uint8 MOVING=5\nuint8 DRAWING=6\nuint8 HOLDING=7\nuint8 STOPPING=8\nuint8 FAULT=9\nuint8 HOMING=10\n"
    };
}
pub(super) use modes;

const BEFORE_AXES: &str = concat!(
    "# One millisecond as the controller saw it: device time, mode, stroke, pen, measured position of the\n\
     # platform (forward kinematics), and for each axis reference and measurement of position and speed.\n",
    modes!(),
    "uint32 t_ms\nuint32 stroke\nuint8 mode\nuint8 pen  # 1 is down\n\
     float64 x_mm\nfloat64 y_mm\nfloat64 z_mm\n"
);

const BEHIND_AXES: &str = "\
    # The named inputs and outputs, from the lowest bit in the order of the configuration: not 0; not exchanged.\n\
    uint16 io_set\nuint16 io_missing\n\
    # The bits of the first named words, in the order of the configuration; recordings from before protocol 16 have none:\n\
    uint32[] io_words\n";

impl Moment {
    /// Appends the message's bytes.
    pub fn encode(&self, on: &SampleAxes, out: &mut Vec<u8>) {
        let Self { sample, position } = self;
        let mut cdr = Encoder::new(out);
        cdr.word(sample.t_ms);
        cdr.word(sample.stroke);
        cdr.byte(sample.mode.number());
        cdr.byte(u8::from(sample.pen == Pen::Down));
        for value in [position.x_mm, position.y_mm, position.z_mm] {
            cdr.double(value);
        }
        for (motion, axis) in on.0.into_iter().zip(axes(sample)) {
            for value in axis.iter().filter_map(|value| Some(shown(motion?, *value))) {
                cdr.word(value.to_bits());
            }
        }
        cdr.short(sample.io.set);
        cdr.short(sample.io.missing);
        cdr.word(sample.io.words.values().count() as u32);
        sample.io.words.values().for_each(|value| cdr.word(value));
    }

    /// Reads a message's bytes. An axis that is not in them is at 0.
    pub fn decode(on: &SampleAxes, bytes: &[u8]) -> Option<Self> {
        let mut cdr = Decoder::new(bytes)?;
        let (t_ms, stroke) = (cdr.word()?, cdr.word()?);
        let mode = Mode::from_number(cdr.byte()?)?;
        let pen = if cdr.byte()? == 1 { Pen::Down } else { Pen::Up };
        let position = Position {
            x_mm: cdr.double()?,
            y_mm: cdr.double()?,
            z_mm: cdr.double()?,
        };
        let mut columns = [[0.0; AXES]; 4];
        for (axis, motion) in on.0.into_iter().enumerate() {
            let Some(motion) = motion else { continue };
            for column in &mut columns {
                *column.get_mut(axis)? = of_shown(motion, f32::from_bits(cdr.word()?));
            }
        }
        let without_io = on.bytes_without_io();
        let io = match bytes.len() {
            length if length == without_io => IoValues::UNKNOWN,
            length => IoValues {
                set: cdr.short()?,
                missing: cdr.short()?,
                words: match length == without_io + IO_BYTES {
                    true => IoWords::NONE,
                    false => io_words(&mut cdr)?,
                },
            },
        };
        let [setpoint_rad, measured_rad, setpoint_rad_s, measured_rad_s] = columns;
        let sample = Sample {
            t_ms,
            mode,
            stroke,
            pen,
            setpoint_rad,
            measured_rad,
            setpoint_rad_s,
            measured_rad_s,
            io,
        };
        cdr.is_at_end().then_some(Self { sample, position })
    }
}

/// A value of the controller in an axis's own unit.
fn shown(motion: Motion, value: f32) -> f32 {
    match motion {
        Motion::Rotary => value,
        Motion::Linear => (f64::from(value) * motion.factor()) as f32,
    }
}

/// The controller's value of one in an axis's own unit.
fn of_shown(motion: Motion, value: f32) -> f32 {
    match motion {
        Motion::Rotary => value,
        Motion::Linear => (f64::from(value) / motion.factor()) as f32,
    }
}

/// Reads the words of a sample; `None` if they are more than a sample has.
fn io_words(cdr: &mut Decoder<'_>) -> Option<IoWords> {
    let count = cdr.word()? as usize;
    let values: Option<Vec<u32>> = (0..count.min(SAMPLE_WORDS_MAX + 1)).map(|_| cdr.word()).collect();
    let words: IoWords = values?.into_iter().collect();
    (words.values().count() == count).then_some(words)
}

/// Reference position, position, reference speed and speed of each axis, as in the controller.
pub fn axes(sample: &Sample) -> impl Iterator<Item = [f32; 4]> {
    let angles = sample.setpoint_rad.into_iter().zip(sample.measured_rad);
    let speeds = sample.setpoint_rad_s.into_iter().zip(sample.measured_rad_s);
    angles.zip(speeds).map(|((q_ref, q), (v_ref, v))| [q_ref, q, v_ref, v])
}

#[cfg(test)]
mod tests {
    use super::*;

    const BYTES_WITHOUT_IO: usize = 108;
    const BYTES_WITHOUT_WORDS: usize = 112;

    fn moment() -> Moment {
        Moment {
            sample: Sample {
                t_ms: 12_345,
                mode: Mode::Drawing,
                stroke: 7,
                pen: Pen::Down,
                setpoint_rad: [0.1, -0.2, 0.3, 0.4],
                measured_rad: [1.1, 1.2, 1.3, f32::NAN],
                setpoint_rad_s: [2.1, 2.2, 2.3, 2.4],
                measured_rad_s: [3.1, 3.2, 3.3, -0.0],
                io: IoValues {
                    set: 0x8001,
                    missing: 0x0102,
                    words: [0xFFFF, 0, 0x1234].into_iter().collect(),
                },
            },
            position: Position {
                x_mm: 1.5,
                y_mm: -2.5,
                z_mm: -800.123_456_789,
            },
        }
    }

    #[test]
    fn a_sample_comes_back_bit_by_bit_and_is_as_long_as_the_header_says() {
        let mut bytes = Vec::new();
        moment().encode(&SampleAxes::ROTARY, &mut bytes);
        assert_eq!(bytes.len(), 116 + 3 * 4);
        let back = Moment::decode(&SampleAxes::ROTARY, &bytes).unwrap();
        let bits =
            |moment: &Moment| -> Vec<u32> { axes(&moment.sample).flat_map(|axis| axis.map(f32::to_bits)).collect() };
        assert_eq!(bits(&back), bits(&moment()));
        assert_eq!(back.position, moment().position);
        assert_eq!(format!("{back:?}"), format!("{:?}", moment()));
    }

    #[test]
    fn samples_from_before_they_had_inputs_or_words_are_read_and_half_of_them_are_not() {
        let mut bytes = Vec::new();
        moment().encode(&SampleAxes::ROTARY, &mut bytes);
        let older = Moment::decode(&SampleAxes::ROTARY, &bytes[..BYTES_WITHOUT_IO]).expect("a sample");
        assert_eq!((older.sample.io, older.sample.io.get(0)), (IoValues::UNKNOWN, None));
        assert_eq!(older.position, moment().position);
        assert_eq!(Moment::decode(&SampleAxes::ROTARY, &bytes[..110]), None);
        let without_words = Moment::decode(&SampleAxes::ROTARY, &bytes[..BYTES_WITHOUT_WORDS]).expect("a sample");
        let io = moment().sample.io;
        let words = IoWords::NONE;
        assert_eq!(without_words.sample.io, IoValues { words, ..io });
        assert_eq!(
            Moment::decode(&SampleAxes::ROTARY, &bytes[..BYTES_WITHOUT_WORDS + 4]),
            None
        );
    }

    #[test]
    fn more_words_than_a_sample_has_are_refused() {
        let mut bytes = Vec::new();
        moment().encode(&SampleAxes::ROTARY, &mut bytes);
        bytes.truncate(BYTES_WITHOUT_WORDS);
        for words in [&[1; SAMPLE_WORDS_MAX + 1][..], &[u32::MAX; 3]] {
            let mut longer = bytes.clone();
            longer.extend((words.len() as u32).to_le_bytes());
            longer.extend(words.iter().flat_map(|word| word.to_le_bytes()));
            assert_eq!(Moment::decode(&SampleAxes::ROTARY, &longer), None);
        }
        bytes.extend([0xFF; 4]);
        assert_eq!(Moment::decode(&SampleAxes::ROTARY, &bytes), None);
    }

    #[test]
    fn a_sample_that_was_cut_is_none_unless_it_ends_where_older_ones_do() {
        let mut bytes = Vec::new();
        moment().encode(&SampleAxes::ROTARY, &mut bytes);
        for length in 0..bytes.len() {
            let is_older = [BYTES_WITHOUT_IO, BYTES_WITHOUT_WORDS].contains(&length);
            let is_some = Moment::decode(&SampleAxes::ROTARY, &bytes[..length]).is_some();
            assert_eq!(is_some, is_older, "{length}");
        }
    }

    /// Two linear axes, a rotary one, and one that the machine has not.
    const MIXED: SampleAxes = SampleAxes([Some(Motion::Linear), Some(Motion::Linear), Some(Motion::Rotary), None]);

    #[test]
    fn each_axis_is_in_its_own_unit_and_one_that_the_machine_has_not_is_not_there() {
        let schema = MIXED.schema();
        let columns: Vec<&str> = schema
            .lines()
            .filter_map(|line| line.strip_prefix("float32 "))
            .collect();
        let wanted = [
            ["q1_ref_mm", "q1_mm", "v1_ref_mm_s", "v1_mm_s"],
            ["q2_ref_mm", "q2_mm", "v2_ref_mm_s", "v2_mm_s"],
            ["q3_ref_rad", "q3_rad", "v3_ref_rad_s", "v3_rad_s"],
        ];
        assert_eq!(columns, wanted.as_flattened());
        assert_eq!(SampleAxes::of_schema(&schema), Some(MIXED));
        let rotary = SampleAxes::ROTARY.schema();
        assert_eq!(SampleAxes::of_schema(&rotary), Some(SampleAxes::ROTARY));
        for damaged in [
            "",
            "uint32 t_ms\n",
            &rotary.replace("q2_rad", "q2_red"),
            &rotary.replace("float32 v4_rad_s\n", ""),
        ] {
            assert_eq!(SampleAxes::of_schema(damaged), None, "{damaged}");
        }
        let mut bytes = Vec::new();
        moment().encode(&MIXED, &mut bytes);
        assert_eq!(bytes.len(), 116 - AXIS_BYTES + 3 * 4);
        let at = |place: usize| f32::from_le_bytes(bytes[place..place + 4].try_into().expect("four bytes"));
        // Behind the header, 16 bytes and the position: q1_ref, and q3_ref.
        assert_eq!((at(44), at(44 + 2 * AXIS_BYTES)), (10.0, 0.3));
        let back = Moment::decode(&MIXED, &bytes).expect("a sample");
        let (is, was) = (back.sample, moment().sample);
        for (is, was) in axes(&is).zip(axes(&was)).take(2) {
            for (is, was) in is.into_iter().zip(was) {
                assert!((is - was).abs() <= f32::EPSILON * was.abs(), "{is} {was}");
            }
        }
        assert_eq!((is.setpoint_rad[2], is.measured_rad_s[2]), (0.3, 3.3));
        assert_eq!((is.setpoint_rad[3], is.measured_rad[3]), (0.0, 0.0));
        assert_eq!((is.io, back.position), (was.io, moment().position));
    }
}
