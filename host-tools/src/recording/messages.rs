//! The messages of a recording: their ROS 2 definitions and their bytes (CDR, little-endian).
//!
//! Foxglove and PlotJuggler decode the messages with the definitions in the file. A sample takes 116 bytes and 4 for
//! each named word in it, a quarter of its size as JSON, and its numbers are bit-identical to the firmware's. Fields are
//! named like the columns of `telemetry.csv`, units last. Every message is one struct; only the primitive types of CDR are used.
//!
//! Invariant: bytes that are not a valid message give `None`.

use super::bytes::Numbers;
use super::mcap::Topic;
use etherpen::application::Mode;
use etherpen::config::SAMPLE_WORDS_MAX;
use etherpen::messages::{Counters, IoValues, IoWords, Sample};
use etherpen::motion::Pen;
use etherpen::robots::{AXES, Position};

/// One millisecond; its stroke and pen are those of the reference to which the measured position belongs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// The firmware's sample.
    pub sample: Sample,
    /// Measured position of the platform, mm.
    pub position: Position,
}

/// A gap in the samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// Device time of the last sample before the gap, ms.
    pub before_ms: u32,
    /// Device time of the first sample after the gap, ms.
    pub t_ms: u32,
    /// Number of missing samples.
    pub missing: u32,
}

/// State of the controller.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Device time of the last sample before this state, ms.
    pub t_ms: u32,
    /// Operating mode.
    pub mode: Mode,
    /// Whether the joint angles are referenced.
    pub referenced: bool,
    /// Path speed override, percent.
    pub override_percent: u8,
    /// Counters of the firmware.
    pub counters: Counters,
    /// AL state and AL status code of each slave, and its CiA 402 status word.
    pub slaves: Vec<[u16; 3]>,
    /// The latched fault; empty without a fault.
    pub fault: String,
    /// The named inputs and outputs in the order of the configuration: their bits, `None` while the terminal does not
    /// exchange them.
    pub io: Vec<Option<u32>>,
}

/// Severity of an event, numbered as in `rcl_interfaces/msg/Log`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// An ordinary event.
    Info = 20,
    /// A condition that needs attention.
    Warning = 30,
    /// A fault.
    Error = 40,
}

/// An event.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Event {
    /// Time of the message, ns.
    pub time_ns: u64,
    /// Severity.
    pub level: Severity,
    /// Kind of event: `link`, `mode`, `fault`, `gap`, `job`.
    pub name: String,
    /// What happened.
    pub text: String,
}

/// Channel of the samples.
pub const SAMPLE: u16 = 1;
/// Channel of the gaps.
pub const GAP: u16 = 2;
/// Channel of the states.
pub const STATUS: u16 = 3;
/// Channel of the events.
pub const EVENT: u16 = 4;

/// Bytes of a sample in recordings from before it had named inputs and outputs.
const BYTES_WITHOUT_IO: usize = 108;
/// Bytes of a sample in recordings from before it had named words.
const BYTES_WITHOUT_WORDS: usize = 112;

/// Topic of what only a black box records; a recording has none.
pub const BLACK_BOX: &str = "/black_box";

/// The channels, in the order of their numbers.
pub const TOPICS: [Topic; 4] = [
    Topic {
        name: "/sample",
        schema_name: "etherpen/msg/Sample",
        schema: SAMPLE_SCHEMA,
    },
    Topic {
        name: "/gap",
        schema_name: "etherpen/msg/Gap",
        schema: "# Samples that are missing, stored before the first one after the gap.\n\
                 uint32 before_ms\nuint32 t_ms\nuint32 missing\n",
    },
    Topic {
        name: "/status",
        schema_name: "etherpen/msg/Status",
        schema: STATUS_SCHEMA,
    },
    Topic {
        name: "/event",
        schema_name: "rcl_interfaces/msg/Log",
        schema: EVENT_SCHEMA,
    },
];

macro_rules! modes {
    () => {
        "uint8 STARTUP=0\nuint8 BUS_CONFIGURING=1\nuint8 DRIVES_OFF=2\nuint8 UNREFERENCED=3\nuint8 IDLE=4\n\
         uint8 MOVING=5\nuint8 DRAWING=6\nuint8 HOLDING=7\nuint8 STOPPING=8\nuint8 FAULT=9\nuint8 HOMING=10\n"
    };
}

const SAMPLE_SCHEMA: &str = concat!(
    "# One millisecond as the controller saw it: device time, mode, stroke, pen, measured position of the\n\
     # platform (forward kinematics), and for each axis reference and measurement of angle and speed. The joint of\n\
     # a linear axis is a wheel that rolls along it: a radian is 100 mm. An axis without a drive has its setpoints.\n",
    modes!(),
    "uint32 t_ms\nuint32 stroke\nuint8 mode\nuint8 pen  # 1 is down\n\
     float64 x_mm\nfloat64 y_mm\nfloat64 z_mm\n\
     float32 q1_ref_rad\nfloat32 q1_rad\nfloat32 v1_ref_rad_s\nfloat32 v1_rad_s\n\
     float32 q2_ref_rad\nfloat32 q2_rad\nfloat32 v2_ref_rad_s\nfloat32 v2_rad_s\n\
     float32 q3_ref_rad\nfloat32 q3_rad\nfloat32 v3_ref_rad_s\nfloat32 v3_rad_s\n\
     float32 q4_ref_rad\nfloat32 q4_rad\nfloat32 v4_ref_rad_s\nfloat32 v4_rad_s\n\
     # The named inputs and outputs, from the lowest bit in the order of the configuration: not 0; not exchanged.\n\
     uint16 io_set\nuint16 io_missing\n\
     # The bits of the first named words, in the order of the configuration; recordings from before protocol 16 have none:\n\
     uint32[] io_words\n"
);

const STATUS_SCHEMA: &str = concat!(
    "# Where the controller stood, and what it has counted since it started.\n",
    modes!(),
    "uint32 t_ms\nuint8 mode\nuint8 referenced  # 1 is true\nuint8 override_percent\n\
     uint32 cycles\nuint32 cycles_late\nuint32 frames_lost\nuint32 working_counter_errors\nuint32 frames_ignored\n\
     uint32 reference_underruns\nuint32 path_starvations\nuint32 trajectory_overruns\nuint32 telemetry_dropped\n\
     uint32 link_errors\nuint32 ethernet_errors\n\
     # Of each slave on the bus:\nuint16[] al_state\nuint16[] al_code\nuint16[] status_word\n\
     string fault\n\
     # Of each named input and output, in the order of the configuration; old recordings have none:\n\
     uint32[] io_raw\nuint16[] io_valid\n"
);

const EVENT_SCHEMA: &str = "# Something that happened.\n\
    uint8 DEBUG=10\nuint8 INFO=20\nuint8 WARN=30\nuint8 ERROR=40\nuint8 FATAL=50\n\
    builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\nuint32 line\n\
    ================================================================================\n\
    MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n";

impl Moment {
    /// Appends the message's bytes.
    pub fn encode(&self, out: &mut Vec<u8>) {
        let Self { sample, position } = self;
        let mut cdr = Encoder::new(out);
        cdr.word(sample.t_ms);
        cdr.word(sample.stroke);
        cdr.byte(sample.mode.number());
        cdr.byte(u8::from(sample.pen == Pen::Down));
        for value in [position.x_mm, position.y_mm, position.z_mm] {
            cdr.double(value);
        }
        for axis in axes(sample) {
            axis.into_iter().for_each(|value| cdr.word(value.to_bits()));
        }
        cdr.short(sample.io.set);
        cdr.short(sample.io.missing);
        cdr.word(sample.io.words.values().count() as u32);
        sample.io.words.values().for_each(|value| cdr.word(value));
    }

    /// Reads a message's bytes.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
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
        for axis in 0..AXES {
            for column in &mut columns {
                *column.get_mut(axis)? = f32::from_bits(cdr.word()?);
            }
        }
        let io = match bytes.len() {
            BYTES_WITHOUT_IO => IoValues::UNKNOWN,
            _ => IoValues {
                set: cdr.short()?,
                missing: cdr.short()?,
                words: match bytes.len() {
                    BYTES_WITHOUT_WORDS => IoWords::NONE,
                    _ => cdr.io_words()?,
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
        Some(Self { sample, position })
    }
}

/// Reference angle, angle, reference speed and speed of each axis.
pub fn axes(sample: &Sample) -> impl Iterator<Item = [f32; 4]> {
    let angles = sample.setpoint_rad.into_iter().zip(sample.measured_rad);
    let speeds = sample.setpoint_rad_s.into_iter().zip(sample.measured_rad_s);
    angles.zip(speeds).map(|((q_ref, q), (v_ref, v))| [q_ref, q, v_ref, v])
}

impl Gap {
    /// Appends the message's bytes.
    pub fn encode(&self, out: &mut Vec<u8>) {
        let mut cdr = Encoder::new(out);
        for value in [self.before_ms, self.t_ms, self.missing] {
            cdr.word(value);
        }
    }

    /// Reads a message's bytes.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let mut cdr = Decoder::new(bytes)?;
        Some(Self {
            before_ms: cdr.word()?,
            t_ms: cdr.word()?,
            missing: cdr.word()?,
        })
    }
}

impl State {
    /// Appends the message's bytes.
    pub fn encode(&self, out: &mut Vec<u8>) {
        let mut cdr = Encoder::new(out);
        cdr.word(self.t_ms);
        cdr.byte(self.mode.number());
        cdr.byte(self.referenced.into());
        cdr.byte(self.override_percent);
        let mut counted = self.counters;
        counters(&mut counted).into_iter().for_each(|count| cdr.word(*count));
        for column in 0..3 {
            cdr.word(self.slaves.len() as u32);
            let values = self.slaves.iter().filter_map(|slave| slave.get(column));
            values.for_each(|value| cdr.short(*value));
        }
        cdr.text(&self.fault);
        cdr.word(self.io.len() as u32);
        self.io.iter().for_each(|raw| cdr.word(raw.unwrap_or(0)));
        cdr.word(self.io.len() as u32);
        self.io.iter().for_each(|raw| cdr.short(raw.is_some().into()));
    }

    /// Reads a message's bytes.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let mut cdr = Decoder::new(bytes)?;
        let t_ms = cdr.word()?;
        let (mode, referenced, override_percent) = (Mode::from_number(cdr.byte()?)?, cdr.byte()? == 1, cdr.byte()?);
        let mut counted = Counters::default();
        for count in counters(&mut counted) {
            *count = cdr.word()?;
        }
        let mut slaves: Vec<[u16; 3]> = Vec::new();
        for column in 0..3 {
            let length = cdr.word()? as usize;
            for slave in 0..length {
                let value = cdr.short()?;
                if slaves.get(slave).is_none() {
                    slaves.push([0; 3]);
                }
                *slaves.get_mut(slave)?.get_mut(column)? = value;
            }
        }
        let fault = cdr.text()?;
        let mut io = Vec::new();
        // Older recordings end here.
        for _ in 0..cdr.word().unwrap_or(0) {
            io.push(Some(cdr.word()?));
        }
        for point in 0..cdr.word().unwrap_or(0) as usize {
            let valid = cdr.short()? != 0;
            let raw = io.get_mut(point)?;
            *raw = raw.filter(|_| valid);
        }
        Some(Self {
            t_ms,
            mode,
            referenced,
            override_percent,
            counters: counted,
            slaves,
            fault,
            io,
        })
    }
}

/// The counters in the order of the schema.
fn counters(of: &mut Counters) -> [&mut u32; 11] {
    [
        &mut of.cycles,
        &mut of.cycles_late,
        &mut of.frames_lost,
        &mut of.working_counter_errors,
        &mut of.frames_ignored,
        &mut of.setpoint_underruns,
        &mut of.path_starvations,
        &mut of.trajectory_overruns,
        &mut of.telemetry_dropped,
        &mut of.link_errors,
        &mut of.ethernet_errors,
    ]
}

impl Event {
    /// Appends the message's bytes.
    pub fn encode(&self, out: &mut Vec<u8>) {
        let mut cdr = Encoder::new(out);
        cdr.word((self.time_ns / 1_000_000_000) as u32);
        cdr.word((self.time_ns % 1_000_000_000) as u32);
        cdr.byte(self.level as u8);
        for text in [&self.name, &self.text, "", ""] {
            cdr.text(text);
        }
        cdr.word(0);
    }

    /// Reads a message's bytes.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let mut cdr = Decoder::new(bytes)?;
        let (seconds, nanoseconds) = (cdr.word()?, cdr.word()?);
        let level = match cdr.byte()? {
            30 => Severity::Warning,
            40.. => Severity::Error,
            _ => Severity::Info,
        };
        Some(Self {
            time_ns: u64::from(seconds) * 1_000_000_000 + u64::from(nanoseconds),
            level,
            name: cdr.text()?,
            text: cdr.text()?,
        })
    }
}

/// Header of a message: plain CDR, little-endian.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Appends values, each aligned to its size from the end of the header.
struct Encoder<'a> {
    out: &'a mut Vec<u8>,
    begin: usize,
}

impl<'a> Encoder<'a> {
    fn new(out: &'a mut Vec<u8>) -> Self {
        out.extend(ENCAPSULATION);
        let begin = out.len();
        Self { out, begin }
    }

    fn put(&mut self, bytes: &[u8]) {
        let length = (self.out.len() - self.begin).next_multiple_of(bytes.len().max(1));
        self.out.resize(self.begin + length, 0);
        self.out.extend(bytes);
    }

    fn byte(&mut self, value: u8) {
        self.out.push(value);
    }

    fn short(&mut self, value: u16) {
        self.put(&value.to_le_bytes());
    }

    fn word(&mut self, value: u32) {
        self.put(&value.to_le_bytes());
    }

    fn double(&mut self, value: f64) {
        self.put(&value.to_le_bytes());
    }

    /// Writes the length including the final zero, the text, and the zero.
    fn text(&mut self, text: &str) {
        self.word(text.len() as u32 + 1);
        self.out.extend(text.as_bytes());
        self.out.push(0);
    }
}

/// Reads what [`Encoder`] has written.
struct Decoder<'a> {
    bytes: &'a [u8],
    place: usize,
}

impl<'a> Decoder<'a> {
    fn new(bytes: &'a [u8]) -> Option<Self> {
        let bytes = bytes.strip_prefix(&ENCAPSULATION)?;
        Some(Self { bytes, place: 0 })
    }

    /// Reads the words of a sample; none if they are more than a sample has.
    fn io_words(&mut self) -> Option<IoWords> {
        let count = self.word()? as usize;
        let values: Option<Vec<u32>> = (0..count.min(SAMPLE_WORDS_MAX + 1)).map(|_| self.word()).collect();
        let words: IoWords = values?.into_iter().collect();
        (words.values().count() == count).then_some(words)
    }

    fn text(&mut self) -> Option<String> {
        let length = self.word()? as usize;
        let end = self.place.checked_add(length)?;
        let text = self.bytes.get(self.place..end)?.strip_suffix(&[0])?;
        self.place = end;
        String::from_utf8(text.to_vec()).ok()
    }
}

impl Numbers for Decoder<'_> {
    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let begin = self.place.next_multiple_of(N);
        let end = begin.checked_add(N)?;
        self.place = end;
        self.bytes.get(begin..end)?.try_into().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        moment().encode(&mut bytes);
        assert_eq!(bytes.len(), 116 + 3 * 4);
        let back = Moment::decode(&bytes).unwrap();
        let bits =
            |moment: &Moment| -> Vec<u32> { axes(&moment.sample).flat_map(|axis| axis.map(f32::to_bits)).collect() };
        assert_eq!(bits(&back), bits(&moment()));
        assert_eq!(back.position, moment().position);
        assert_eq!(format!("{back:?}"), format!("{:?}", moment()));
    }

    #[test]
    fn samples_from_before_they_had_inputs_or_words_are_read_and_half_of_them_are_not() {
        let mut bytes = Vec::new();
        moment().encode(&mut bytes);
        let older = Moment::decode(&bytes[..BYTES_WITHOUT_IO]).expect("a sample");
        assert_eq!((older.sample.io, older.sample.io.get(0)), (IoValues::UNKNOWN, None));
        assert_eq!(older.position, moment().position);
        assert_eq!(Moment::decode(&bytes[..110]), None);
        let without_words = Moment::decode(&bytes[..BYTES_WITHOUT_WORDS]).expect("a sample");
        let io = moment().sample.io;
        let words = IoWords::NONE;
        assert_eq!(without_words.sample.io, IoValues { words, ..io });
        assert_eq!(Moment::decode(&bytes[..BYTES_WITHOUT_WORDS + 4]), None);
    }

    #[test]
    fn more_words_than_a_sample_has_are_refused() {
        let mut bytes = Vec::new();
        moment().encode(&mut bytes);
        bytes.truncate(BYTES_WITHOUT_WORDS);
        for words in [&[1; SAMPLE_WORDS_MAX + 1][..], &[u32::MAX; 3]] {
            let mut longer = bytes.clone();
            longer.extend((words.len() as u32).to_le_bytes());
            longer.extend(words.iter().flat_map(|word| word.to_le_bytes()));
            assert_eq!(Moment::decode(&longer), None);
        }
        bytes.extend([0xFF; 4]);
        assert_eq!(Moment::decode(&bytes), None);
    }

    #[test]
    fn states_events_and_gaps_come_back() {
        let state = State {
            t_ms: 9,
            mode: Mode::Fault,
            referenced: true,
            override_percent: 100,
            counters: Counters {
                cycles: 1,
                link_errors: 10,
                ..Counters::default()
            },
            slaves: vec![[8, 0, 0x1637], [0x14, 0x1b, 0x218], [1, 2, 3]],
            fault: "axis 2 is slow – 5 µs".into(),
            io: vec![Some(1), None, Some(u32::MAX)],
        };
        let event = Event {
            time_ns: 12_000_000_345,
            level: Severity::Warning,
            name: "gap".into(),
            text: String::new(),
        };
        let gap = Gap {
            before_ms: 1,
            t_ms: 5,
            missing: 3,
        };
        let mut bytes = [const { Vec::new() }; 3];
        let [of_state, of_event, of_gap] = &mut bytes;
        state.encode(of_state);
        event.encode(of_event);
        gap.encode(of_gap);
        assert_eq!(State::decode(of_state), Some(state));
        assert_eq!(Event::decode(of_event), Some(event));
        assert_eq!(Gap::decode(of_gap), Some(gap));
    }

    #[test]
    fn a_message_that_was_cut_is_none() {
        let mut bytes = Vec::new();
        moment().encode(&mut bytes);
        for length in 0..bytes.len() {
            let is_older = [BYTES_WITHOUT_IO, BYTES_WITHOUT_WORDS].contains(&length);
            assert_eq!(Moment::decode(&bytes[..length]).is_some(), is_older, "{length}");
            assert_eq!(State::decode(&bytes[..length]), None, "{length}");
            Event::decode(&bytes[..length]);
        }
    }

    #[test]
    fn every_mode_is_named_in_the_schema_by_its_number() {
        for mode in Mode::ALL {
            let name = format!("{mode:?}");
            let mut constant = String::new();
            for (k, letter) in name.char_indices() {
                if k > 0 && letter.is_uppercase() {
                    constant.push('_');
                }
                constant.push(letter.to_ascii_uppercase());
            }
            let line = format!("uint8 {constant}={}\n", mode.number());
            assert!(SAMPLE_SCHEMA.contains(&line) && STATUS_SCHEMA.contains(&line), "{line}");
        }
    }
}
