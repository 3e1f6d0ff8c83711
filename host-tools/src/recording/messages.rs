//! The messages of a recording: their ROS 2 definitions and their bytes (CDR, little-endian).
//!
//! Foxglove and PlotJuggler decode the messages with the definitions in the file. Fields are named like the columns of
//! `telemetry.csv`, units last. Every message is one struct; only the primitive types of CDR are used. The samples are in
//! [`super::moment`].
//!
//! Invariant: bytes that are not a valid message give `None`.

use super::bytes::Numbers;
use super::cdr::{Decoder, Encoder};
use super::mcap::Topic;
use super::moment::{SampleAxes, modes};
use etherpen::application::Mode;
use etherpen::messages::Counters;
use std::borrow::Cow;

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

/// Topic of what only a black box records; a recording has none.
pub const BLACK_BOX: &str = "/black_box";

/// Names of the channels, in the order of their numbers.
pub const NAMES: [&str; 4] = ["/sample", "/gap", "/status", "/event"];

/// The channels of a machine, in the order of their numbers.
#[must_use]
pub fn topics(axes: &SampleAxes) -> [Topic; 4] {
    let schemas = [
        ("etherpen/msg/Sample", axes.schema().into()),
        ("etherpen/msg/Gap", Cow::Borrowed(GAP_SCHEMA)),
        ("etherpen/msg/Status", STATUS_SCHEMA.into()),
        ("rcl_interfaces/msg/Log", EVENT_SCHEMA.into()),
    ];
    let mut names = NAMES.into_iter();
    schemas.map(|(schema_name, schema)| Topic {
        name: names.next().unwrap_or_default(),
        schema_name,
        schema,
    })
}

const GAP_SCHEMA: &str = "# Samples that are missing, stored before the first one after the gap.\n\
    uint32 before_ms\nuint32 t_ms\nuint32 missing\n";

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

#[cfg(test)]
mod tests {
    use super::*;

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
        let gap = Gap {
            before_ms: 1,
            t_ms: 5,
            missing: 3,
        };
        let mut bytes = Vec::new();
        gap.encode(&mut bytes);
        for length in 0..bytes.len() {
            assert_eq!(Gap::decode(&bytes[..length]), None, "{length}");
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
            let sample = SampleAxes::ROTARY.schema();
            assert!(sample.contains(&line) && STATUS_SCHEMA.contains(&line), "{line}");
        }
    }
}
