//! The contents of a black box as files: MCAP, JSON and pcapng.
//!
//! Times in the files are the controller's, from its start, so that MCAP and pcapng have one time axis.
//!
//! The MCAP file has the topics of a recording, so that `etherpen stats`, `plot` and `export` read it. A black box does
//! not record all of their fields: speeds are differences of two positions, stroke and pen are always 0, the platform's
//! position is NaN without a configuration, and the operating mode before the first recorded change follows from the
//! sample. Everything that a black box records itself is in the topic `/black_box`.

use super::contents::{Contents, EventEntry, SampleEntry};
use crate::recording::mcap::{Topic, Writer};
use crate::recording::messages::{self, BLACK_BOX, EVENT, GAP, Gap, NAMES, SAMPLE, Severity};
use crate::recording::moment::{Moment, SampleAxes};
use etherpen::application::Mode;
use etherpen::black_box::{Direction, Event};
use etherpen::board::Interlock;
use etherpen::config::Config;
use etherpen::drives::cia402::{DriveState, StatusWord};
use etherpen::messages::{IoValues, Sample};
use etherpen::motion::Pen;
use etherpen::robots::{AXES, JointAngles, Kinematics, Position};
use etherpen_segment::capture::{self, Capture};
use std::borrow::Cow;
use std::io;

/// Channel of the samples as recorded.
const RECORDED: u16 = NAMES.len() as u16 + 1;
/// Header of a message: plain CDR, little-endian.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];
const MILLISECOND_NS: u64 = 1_000_000;

/// The samples as recorded. Fields are ordered by size, so that none needs padding.
const RECORDED_TOPIC: Topic = Topic {
    name: BLACK_BOX,
    schema_name: "etherpen/msg/BlackBox",
    schema: Cow::Borrowed(
        "# What a black box records of one millisecond, beside the positions in /sample.\n\
             uint32 t_ms\nfloat32 clock_error_ns  # NaN without a clock\n\
             uint16 frames_lost  # lower 16 bits\nuint16 cycles_late  # lower 8 bits\n\
             uint16 status_word1\nuint16 status_word2\nuint16 status_word3\nuint16 status_word4\n\
             # Encoder positions, their lower 16 bits:\n\
             uint16 increments1\nuint16 increments2\nuint16 increments3\nuint16 increments4\n\
             uint8 following\nuint8 standstill\nuint8 fault\n\
             uint8 interlock  # 1 emergency stop, 2 clock, 3 emergency stop by a terminal\n\
             uint8 valid1\nuint8 valid2\nuint8 valid3\nuint8 valid4\n\
             uint8 homed1\nuint8 homed2\nuint8 homed3\nuint8 homed4\n",
    ),
};

const _: () = assert!(AXES == 4, "the schema lists four axes");

/// The contents as JSON.
///
/// # Errors
/// A value cannot be written as JSON.
pub fn json(contents: &Contents) -> io::Result<Vec<u8>> {
    serde_json::to_vec_pretty(contents).map_err(io::Error::from)
}

/// The frames as pcapng, with their directions seen from the board.
///
/// # Errors
/// A frame is too long for the format.
pub fn pcapng(contents: &Contents) -> io::Result<Vec<u8>> {
    let mut capture = Capture::new(Vec::new())?;
    for frame in &contents.frames {
        let time_us = f64::from(contents.end_ms) * 1e3 - frame.before_end_s * 1e6;
        let direction = match frame.direction {
            Direction::Sent => capture::Direction::Sent,
            Direction::Received => capture::Direction::Received,
        };
        // The conversion saturates at 0.
        capture.record(time_us.round() as u64, direction, &frame.bytes)?;
    }
    capture.finish()
}

/// Samples and events as MCAP. With `config` the file contains it, and the positions of the platform.
///
/// # Errors
/// The configuration cannot be written as text.
pub fn mcap(contents: &Contents, config: Option<&Config>) -> io::Result<Vec<u8>> {
    let library = concat!("etherpen ", env!("CARGO_PKG_VERSION"));
    let axes = config.map_or(SampleAxes::ROTARY, SampleAxes::of);
    let [sample, gap, status, event] = messages::topics(&axes);
    let mut writer = Writer::new(Vec::new(), &[sample, gap, status, event, RECORDED_TOPIC], library)?;
    let hash = config.and_then(Config::hash);
    let facts = [
        ("source", "black box".to_owned()),
        ("begin_ns", "0".to_owned()),
        (
            "config_hash",
            hash.map_or_else(String::new, |hash| format!("{hash:016x}")),
        ),
        ("program", library.to_owned()),
    ];
    writer.metadata("etherpen", &facts)?;
    if let Some(config) = config {
        let text = toml::to_string(config).map_err(io::Error::other)?;
        writer.attach("etherpen.toml", "application/toml", text.as_bytes(), 0)?;
    }
    let mut pending = event_messages(contents);
    pending.extend(sample_messages(contents, config, &axes));
    // Events come before the sample of their millisecond.
    pending.sort_by_key(|message| message.time_ns);
    for message in &pending {
        writer.message(message.channel, message.time_ns, &message.data);
    }
    writer.finish()?;
    Ok(std::mem::take(writer.sink_mut()))
}

/// A message of the file.
struct Message {
    time_ns: u64,
    channel: u16,
    data: Vec<u8>,
}

/// The controller's time, ns since it started.
fn device_ns(contents: &Contents, t_ms: u32) -> u64 {
    let before_ms = contents.end_ms.wrapping_sub(t_ms) as i32;
    let ms = i64::from(contents.end_ms) - i64::from(before_ms);
    u64::try_from(ms).unwrap_or(0) * MILLISECOND_NS
}

fn event_messages(contents: &Contents) -> Vec<Message> {
    let message = |entry: &EventEntry| {
        let time_ns = device_ns(contents, entry.t_ms);
        let (level, name) = severity(entry);
        let event = messages::Event {
            time_ns,
            level,
            name: name.to_owned(),
            text: entry.text.clone(),
        };
        let mut data = Vec::new();
        event.encode(&mut data);
        Message {
            time_ns,
            channel: EVENT,
            data,
        }
    };
    contents.events.iter().map(message).collect()
}

/// Severity of an event, and its kind as in recordings.
fn severity(entry: &EventEntry) -> (Severity, &'static str) {
    match entry.event {
        Some(Event::Began | Event::Connected | Event::Configured { .. }) => (Severity::Info, "link"),
        Some(Event::Command(_)) => (Severity::Info, "job"),
        Some(Event::Refused(_)) => (Severity::Warning, "job"),
        Some(Event::Mode(_)) => (Severity::Info, "mode"),
        Some(Event::Fault(Some(_))) => (Severity::Error, "fault"),
        Some(Event::Fault(None)) => (Severity::Info, "fault"),
        None => (Severity::Warning, "link"),
    }
}

fn sample_messages(contents: &Contents, config: Option<&Config>, axes: &SampleAxes) -> Vec<Message> {
    let kinematics = config.and_then(|config| Kinematics::new(&config.geometry).ok());
    let samples = &contents.samples;
    let mut modes = Modes::new(&contents.events);
    let mut found = Vec::with_capacity(3 * samples.len());
    for (index, entry) in samples.iter().enumerate() {
        let time_ns = device_ns(contents, entry.t_ms);
        let mut put = |channel: u16, encode: &dyn Fn(&mut Vec<u8>)| {
            let mut data = Vec::new();
            encode(&mut data);
            found.push(Message { time_ns, channel, data });
        };
        let before = index.checked_sub(1).and_then(|index| samples.get(index));
        if let Some(gap) = before.and_then(|before| gap(before, entry)) {
            put(GAP, &|data| gap.encode(data));
        }
        let moment = Moment {
            sample: sample(entry, modes.at(entry), speeds(before, entry, samples.get(index + 1))),
            position: position(kinematics.as_ref(), entry),
        };
        put(SAMPLE, &|data| moment.encode(axes, data));
        put(RECORDED, &|data| encode_recorded(entry, data));
    }
    found
}

/// The gap between two samples, if there is one.
fn gap(before: &SampleEntry, entry: &SampleEntry) -> Option<Gap> {
    let passed_ms = entry.t_ms.wrapping_sub(before.t_ms);
    (2..=u32::MAX / 2).contains(&passed_ms).then(|| Gap {
        before_ms: before.t_ms,
        t_ms: entry.t_ms,
        missing: passed_ms - 1,
    })
}

/// Speeds demanded and measured, rad/s.
type Speeds = [[f32; AXES]; 2];

/// Speeds of a sample: the difference from the millisecond before, else to the one behind it, else 0.
fn speeds(before: Option<&SampleEntry>, entry: &SampleEntry, behind: Option<&SampleEntry>) -> Speeds {
    let follows = |one: &SampleEntry, next: &SampleEntry| next.t_ms.wrapping_sub(one.t_ms) == 1;
    let pair = match (before, behind) {
        (Some(before), _) if follows(before, entry) => Some((before, entry)),
        (_, Some(behind)) if follows(entry, behind) => Some((entry, behind)),
        _ => None,
    };
    let Some((one, next)) = pair else {
        return [[0.0; AXES]; 2];
    };
    [
        difference_rad_s(&one.setpoint_rad, &next.setpoint_rad),
        difference_rad_s(&one.measured_rad, &next.measured_rad),
    ]
}

fn difference_rad_s(one_rad: &[f32; AXES], next_rad: &[f32; AXES]) -> [f32; AXES] {
    let mut speeds = *next_rad;
    for (speed, angle) in speeds.iter_mut().zip(one_rad) {
        *speed = (*speed - angle) * 1_000.0;
    }
    speeds
}

fn sample(entry: &SampleEntry, mode: Mode, [setpoint_rad_s, measured_rad_s]: Speeds) -> Sample {
    Sample {
        t_ms: entry.t_ms,
        mode,
        stroke: 0,
        pen: Pen::Up,
        setpoint_rad: entry.setpoint_rad,
        measured_rad: entry.measured_rad,
        setpoint_rad_s,
        measured_rad_s,
        // Words, and what is missing, are not recorded.
        io: IoValues {
            set: entry.io_set,
            ..IoValues::default()
        },
    }
}

/// Position of the platform; NaN where it is not known.
fn position(kinematics: Option<&Kinematics>, entry: &SampleEntry) -> Position {
    let joints = JointAngles(entry.measured_rad.map(f64::from));
    let known = kinematics.and_then(|kinematics| kinematics.forward(&joints).ok());
    known.unwrap_or(Position {
        x_mm: f64::NAN,
        y_mm: f64::NAN,
        z_mm: f64::NAN,
    })
}

/// The operating modes of samples, taken in their order.
struct Modes<'a> {
    events: std::iter::Peekable<std::slice::Iter<'a, EventEntry>>,
    mode: Option<Mode>,
}

impl<'a> Modes<'a> {
    fn new(events: &'a [EventEntry]) -> Self {
        Self {
            events: events.iter().peekable(),
            mode: None,
        }
    }

    fn at(&mut self, sample: &SampleEntry) -> Mode {
        let is_reached = |event: &&EventEntry| event.t_ms.wrapping_sub(sample.t_ms) as i32 <= 0;
        while let Some(entry) = self.events.next_if(is_reached) {
            if let Some(Event::Mode(mode)) = entry.event {
                self.mode = Some(mode);
            }
        }
        self.mode.unwrap_or_else(|| likely_mode(sample))
    }
}

/// The operating mode that a sample suggests.
fn likely_mode(sample: &SampleEntry) -> Mode {
    let is_enabled = |word: &u16| StatusWord(*word).state() == DriveState::OperationEnabled;
    if sample.fault {
        Mode::Fault
    } else if sample.following && !sample.standstill {
        Mode::Moving
    } else if !sample.status_word.iter().any(is_enabled) {
        Mode::DrivesOff
    } else if sample.homed.contains(&false) {
        Mode::Unreferenced
    } else {
        Mode::Idle
    }
}

/// Appends a message of [`RECORDED_TOPIC`].
fn encode_recorded(entry: &SampleEntry, out: &mut Vec<u8>) {
    out.extend(ENCAPSULATION);
    out.extend(entry.t_ms.to_le_bytes());
    let clock_error_ns = entry.clock_error_ns.map_or(f32::NAN, |error| error as f32);
    out.extend(clock_error_ns.to_le_bytes());
    let halves = [entry.frames_lost, entry.cycles_late.into()].into_iter();
    for half in halves.chain(entry.status_word).chain(entry.increments) {
        out.extend(half.to_le_bytes());
    }
    let interlock = match entry.interlock {
        None => 0,
        Some(Interlock::EmergencyStop) => 1,
        Some(Interlock::Clock) => 2,
        Some(Interlock::Input { .. }) => 3,
    };
    out.extend([entry.following, entry.standstill, entry.fault].map(u8::from));
    out.push(interlock);
    out.extend(entry.valid.map(u8::from));
    out.extend(entry.homed.map(u8::from));
}
