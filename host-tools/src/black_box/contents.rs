//! What a black box holds: samples, events and frames, with times that count back from the end of the recording.
//!
//! Samples and events carry the controller's milliseconds. Frames also carry counts of the board's counter: the times
//! between frames are as exact as that counter, and the newest frame is placed at the millisecond that recorded it.

use crate::link::text;
use etherpen::application::{Fault, Mode};
use etherpen::black_box::recording::{FrameHeader, NoRecording, Origin, Recording};
use etherpen::black_box::{Direction, Event, Sample};
use etherpen::board::Interlock;
use etherpen::robots::AXES;
use serde::{Serialize, Serializer};

/// Counts after which the board's counter starts again.
const COUNTER_TURN: f64 = 4_294_967_296.0;

/// A recorded millisecond.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SampleEntry {
    /// Time before the end of the recording, s.
    pub before_end_s: f64,
    /// The controller's time, ms since it started.
    pub t_ms: u32,
    /// Joint positions demanded, rad.
    #[serde(rename = "reference_rad")]
    pub setpoint_rad: [f32; AXES],
    /// Joint positions measured or predicted, rad.
    pub measured_rad: [f32; AXES],
    /// Encoder positions, increments, their lower 16 bits.
    pub increments: [u16; AXES],
    /// CiA 402 status words of the drives.
    pub status_word: [u16; AXES],
    /// Whether a setpoint was followed.
    pub following: bool,
    /// Whether all axes were at rest.
    pub standstill: bool,
    /// Whether a fault was latched.
    pub fault: bool,
    /// The board's input that kept the drives in quick stop.
    pub interlock: Option<Interlock>,
    /// Whether each axis delivered a valid position.
    pub valid: [bool; AXES],
    /// Whether each axis was homed.
    pub homed: [bool; AXES],
    /// Phase of the sample relative to the bus clock, ns; `None` without a clock.
    pub clock_error_ns: Option<i32>,
    /// Telegrams without a reply since the start, lower 16 bits.
    pub frames_lost: u16,
    /// Late output telegrams since the start, lower 8 bits.
    pub cycles_late: u8,
    /// The named inputs and outputs whose value was not 0, a bit for each in the order of the configuration.
    pub io_set: u16,
}

/// A recorded event.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EventEntry {
    /// Time before the end of the recording, s.
    pub before_end_s: f64,
    /// The controller's time, ms since it started.
    pub t_ms: u32,
    /// What happened; `None` if the bytes are not an event.
    pub event: Option<Event>,
    /// What happened, in words.
    pub text: String,
}

/// A recorded Ethernet frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameEntry {
    /// Time before the end of the recording, s.
    pub before_end_s: f64,
    /// Which way the frame went, seen from the board.
    #[serde(serialize_with = "direction_word")]
    pub direction: Direction,
    /// The frame without its check sequence, in hexadecimal digits in JSON.
    #[serde(serialize_with = "digits")]
    pub bytes: Vec<u8>,
}

/// The last fault of a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LastFault {
    /// Time before the end of the recording, s.
    pub before_end_s: f64,
    /// The fault.
    pub fault: Fault,
    /// Cause and what to try, in words.
    pub text: String,
}

/// A recording in a few figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Whose recording it is.
    #[serde(serialize_with = "origin_word")]
    pub origin: Origin,
    /// Time from the first to the last sample, ms.
    pub span_ms: u32,
    /// Number of samples.
    pub samples: usize,
    /// Number of places where samples are missing.
    pub gaps: usize,
    /// Number of missing samples.
    pub samples_missing: u64,
    /// Number of events.
    pub events: usize,
    /// Number of events that cannot be read.
    pub events_unreadable: usize,
    /// Number of recorded frames that the board sent.
    pub frames_sent: usize,
    /// Number of recorded frames that the board received.
    pub frames_received: usize,
    /// Number of frames that passed but were not recorded.
    pub frames_missed: u32,
    /// The last fault, which may have been cleared since.
    pub last_fault: Option<LastFault>,
    /// The last operating mode.
    pub last_mode: Option<Mode>,
}

/// Everything that a black box holds, oldest first.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Contents {
    /// The recording in a few figures.
    pub summary: Summary,
    /// The controller's time at the end of the recording, ms since it started.
    pub end_ms: u32,
    /// Recorded milliseconds.
    pub samples: Vec<SampleEntry>,
    /// Recorded events.
    pub events: Vec<EventEntry>,
    /// Recorded frames.
    pub frames: Vec<FrameEntry>,
}

impl Contents {
    /// Takes apart a memory of [`etherpen::black_box::MEMORY_BYTES`] bytes.
    ///
    /// # Errors
    /// See [`NoRecording`].
    pub fn of(memory: &[u8]) -> Result<Self, NoRecording> {
        let recording = Recording::new(memory)?;
        let samples: Vec<Sample> = recording.samples().collect();
        let events: Vec<(u32, Option<Event>)> = recording.events().collect();
        let headers: Vec<FrameHeader> = recording.frames().collect();
        let end_ms = end_ms(&samples, &events, &headers);
        let samples: Vec<SampleEntry> = samples.iter().map(|sample| sample_entry(sample, end_ms)).collect();
        let events: Vec<EventEntry> = events.iter().map(|found| event_entry(found, end_ms)).collect();
        let times_s = frame_times_s(&headers, recording.counts_per_s(), end_ms);
        let frame = |(header, before_end_s): (&FrameHeader, f64)| FrameEntry {
            before_end_s,
            direction: header.direction,
            bytes: recording.frame_bytes(header).collect(),
        };
        let frames: Vec<FrameEntry> = headers.iter().zip(times_s).map(frame).collect();
        Ok(Self {
            summary: summary(&recording, &samples, &events, &frames),
            end_ms,
            samples,
            events,
            frames,
        })
    }

    /// Hash of the last configuration that the controller accepted; `None` if that was not recorded.
    pub fn config_hash(&self) -> Option<u64> {
        self.events.iter().rev().find_map(|entry| match entry.event {
            Some(Event::Configured { hash }) => Some(hash),
            _ => None,
        })
    }
}

/// Whose recording it is, in words.
pub fn origin_text(origin: Origin) -> &'static str {
    match origin {
        Origin::Present => "the present run, which goes on",
        Origin::Crashed => "a run that ended with a panic or by the watchdog; kept until it is discarded",
        Origin::Reset => "a run that was reset from outside; kept until a drive is enabled, for two minutes at most",
    }
}

/// A recorded event in words.
fn event_text(event: &Event) -> String {
    match event {
        Event::Began => "recordings began".to_owned(),
        Event::Connected => "a host connected".to_owned(),
        Event::Configured { hash } => format!("configuration {hash:016x} accepted"),
        Event::Command(command) => format!("command: {}", text::command(command)),
        Event::Refused(refusal) => format!("refused: {}", text::refusal(refusal)),
        Event::Mode(mode) => format!("{mode:?}: {}", text::mode(*mode)),
        Event::Fault(Some(fault)) => format!("fault: {}", text::fault(fault)),
        Event::Fault(None) => "the fault was cleared".to_owned(),
    }
}

/// Milliseconds from an earlier time of the controller to a later one; negative if their order is the other way.
fn passed_ms(earlier_ms: u32, later_ms: u32) -> i32 {
    later_ms.wrapping_sub(earlier_ms) as i32
}

fn before_end_s(t_ms: u32, end_ms: u32) -> f64 {
    f64::from(passed_ms(t_ms, end_ms)) / 1_000.0
}

/// The latest millisecond of a recording.
fn end_ms(samples: &[Sample], events: &[(u32, Option<Event>)], frames: &[FrameHeader]) -> u32 {
    let sample = samples.last().map(|sample| sample.cycle);
    let event = events.last().map(|(t_ms, _)| *t_ms);
    // A frame of a moment without a sample has no millisecond.
    let frame = frames.iter().rev().map(|frame| frame.cycle).find(|cycle| *cycle != 0);
    let mut known = [sample, event, frame].into_iter().flatten();
    let first = known.next().unwrap_or(0);
    known.fold(first, |end, other| if passed_ms(end, other) > 0 { other } else { end })
}

fn sample_entry(sample: &Sample, end_ms: u32) -> SampleEntry {
    let flags = sample.flags;
    SampleEntry {
        before_end_s: before_end_s(sample.cycle, end_ms),
        t_ms: sample.cycle,
        setpoint_rad: sample.setpoint_rad,
        measured_rad: sample.measured_rad,
        increments: sample.increments,
        status_word: sample.status_word,
        following: flags.following(),
        standstill: flags.standstill(),
        fault: flags.fault(),
        interlock: flags.interlock(),
        valid: std::array::from_fn(|axis| flags.valid(axis)),
        homed: std::array::from_fn(|axis| flags.homed(axis)),
        clock_error_ns: sample.clock_error_ns,
        frames_lost: sample.frames_lost,
        cycles_late: sample.cycles_late,
        io_set: sample.io_set,
    }
}

fn event_entry(found: &(u32, Option<Event>), end_ms: u32) -> EventEntry {
    let (t_ms, event) = *found;
    let unreadable = || "an event that cannot be read".to_owned();
    EventEntry {
        before_end_s: before_end_s(t_ms, end_ms),
        t_ms,
        event,
        text: event.as_ref().map_or_else(unreadable, event_text),
    }
}

/// Times of frames before the end of the recording, s.
fn frame_times_s(frames: &[FrameHeader], counts_per_s: u32, end_ms: u32) -> Vec<f64> {
    let mut times_s = Vec::with_capacity(frames.len());
    let mut later: Option<(&FrameHeader, f64)> = None;
    for frame in frames.iter().rev() {
        let time_s = match later {
            Some((next, before_s)) => before_s + between_s(frame, next, counts_per_s),
            None if frame.cycle == 0 => 0.0,
            None => before_end_s(frame.cycle, end_ms),
        };
        times_s.push(time_s);
        later = Some((frame, time_s));
    }
    times_s.reverse();
    times_s
}

/// Time between two frames, s: that of the counter, its turns completed from the milliseconds.
fn between_s(earlier: &FrameHeader, later: &FrameHeader, counts_per_s: u32) -> f64 {
    let known = earlier.cycle != 0 && later.cycle != 0;
    let cycles_s = match known {
        true => before_end_s(earlier.cycle, later.cycle),
        false => 0.0,
    };
    if counts_per_s == 0 {
        return cycles_s;
    }
    let rate = f64::from(counts_per_s);
    let counts = f64::from(later.counts.wrapping_sub(earlier.counts) as i32);
    let turns = match known {
        true => ((cycles_s * rate - counts) / COUNTER_TURN).round(),
        false => 0.0,
    };
    (counts + turns * COUNTER_TURN) / rate
}

fn summary(recording: &Recording, samples: &[SampleEntry], events: &[EventEntry], frames: &[FrameEntry]) -> Summary {
    let steps = samples.iter().zip(samples.iter().skip(1));
    let steps_ms: Vec<i32> = steps.map(|(one, next)| passed_ms(one.t_ms, next.t_ms)).collect();
    let span_ms = match (samples.first(), samples.last()) {
        (Some(first), Some(last)) => passed_ms(first.t_ms, last.t_ms),
        _ => 0,
    };
    let missing = |step: &i32| u64::try_from(step.saturating_sub(1)).unwrap_or(0);
    let newest = events.iter().rev();
    let last_fault = newest.clone().find_map(|entry| match entry.event {
        Some(Event::Fault(Some(fault))) => Some(LastFault {
            before_end_s: entry.before_end_s,
            fault,
            text: text::fault(&fault),
        }),
        _ => None,
    });
    let last_mode = newest.clone().find_map(|entry| match entry.event {
        Some(Event::Mode(mode)) => Some(mode),
        _ => None,
    });
    let sent = frames.iter().filter(|frame| frame.direction == Direction::Sent).count();
    Summary {
        origin: recording.origin(),
        span_ms: u32::try_from(span_ms).unwrap_or(0),
        samples: samples.len(),
        gaps: steps_ms.iter().filter(|step| **step != 1).count(),
        samples_missing: steps_ms.iter().map(missing).sum(),
        events: events.len(),
        events_unreadable: events.iter().filter(|entry| entry.event.is_none()).count(),
        frames_sent: sent,
        frames_received: frames.len() - sent,
        frames_missed: recording.frames_missed(),
        last_fault,
        last_mode,
    }
}

fn origin_word<S: Serializer>(origin: &Origin, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(match origin {
        Origin::Present => "present",
        Origin::Crashed => "crashed",
        Origin::Reset => "reset",
    })
}

fn direction_word<S: Serializer>(direction: &Direction, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(match direction {
        Direction::Sent => "sent",
        Direction::Received => "received",
    })
}

fn digits<S: Serializer>(bytes: &[u8], to: S) -> Result<S::Ok, S::Error> {
    let digits: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    to.serialize_str(&digits)
}
