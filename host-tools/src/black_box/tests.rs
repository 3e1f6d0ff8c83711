use super::Reader;
use super::contents::Contents;
use super::export::{json, mcap, pcapng};
use super::replay::replay;
use crate::random::Random;
use crate::recording::mcap::Reader as McapReader;
use crate::recording::messages::Severity;
use crate::recording::{Playback, RecordingEntry};
use etherpen::application::{Command, Fault, Mode};
use etherpen::black_box::recording::{NoRecording, Origin};
use etherpen::black_box::{
    Answer, Direction, Event, EventLog, FrameNote, FrameNotes, FrameSource, Keep, MEMORY_BYTES, Memory, Recorder,
    Request, SAMPLES,
};
use etherpen::config::Config;
use etherpen::control::sampler::CycleReport;
use heapless::spsc::Queue;

/// Rate of the board's counter, Hz: it starts again every 8.9 s.
const COUNTS_PER_S: u32 = 480_000_000;
const COUNTS_PER_MS: u32 = COUNTS_PER_S / 1_000;
/// Time from a sent frame to its reply, us.
const ROUND_TRIP_US: u32 = 200;
/// Milliseconds between two changes of the mode.
const MODE_MS: u32 = 10;
/// Events that a black box holds.
const EVENTS: usize = 100;

/// Frames whose words follow from their places.
#[derive(Default)]
struct Frames(FrameNotes);

impl FrameSource for Frames {
    fn notes(&self) -> &FrameNotes {
        &self.0
    }

    fn word(&self, note: &FrameNote, index: usize) -> u32 {
        word_at(note.place, index)
    }

    fn is_intact(&self, _: &FrameNote) -> bool {
        true
    }
}

fn word_at(place: u32, index: usize) -> u32 {
    place.wrapping_mul(0x9E37_79B9).wrapping_add(index as u32)
}

fn frame_bytes(place: u32, length: usize) -> Vec<u8> {
    let words = (0..length.div_ceil(4)).flat_map(|index| word_at(place, index).to_le_bytes());
    words.take(length).collect()
}

/// Lengths of the frame sent and of the frame received in a millisecond, bytes.
fn lengths(cycle: u32) -> [usize; 2] {
    [60 + cycle as usize % 7, 64]
}

fn report(cycle: u32) -> CycleReport {
    let mut report = CycleReport {
        cycle,
        following: cycle.is_multiple_of(2),
        measured_rad: [f64::from(cycle) / 1e3; 4],
        status_word: [0x0637, 0x0637, 0x0637, cycle as u16],
        valid: [true, true, false, true],
        homed: [false, true, true, true],
        increments: [-1, 65_536, 65_537, cycle.into()],
        clock_error_ns: (!cycle.is_multiple_of(3)).then_some(-25),
        ..CycleReport::default()
    };
    report.setpoint.position_rad = [f64::from(cycle) / 500.0; 4];
    report
}

fn mode(cycle: u32) -> Mode {
    match (cycle / MODE_MS).is_multiple_of(2) {
        true => Mode::Idle,
        false => Mode::Moving,
    }
}

const FAULT: Fault = Fault::Blind {
    blind_ms: 6,
    limit_ms: 5,
};

/// What happened in a run that goes on from `first` to `last`, with a fault in its last millisecond.
fn record(memory: &Memory, first: u32, last: u32) {
    let (mut new, mut passed) = (Queue::<CycleReport, 4>::new(), Queue::<CycleReport, 4>::new());
    let (mut reports, taken) = new.split();
    let (passed_on, mut link) = passed.split();
    let mut recorder = Recorder::new(memory, taken, passed_on);
    let mut events = EventLog::new(memory);
    let frames = Frames::default();
    let notes = frames.notes();
    for cycle in first..=last {
        assert!(reports.enqueue(report(cycle)).is_ok());
        let sent = cycle.wrapping_mul(COUNTS_PER_MS);
        let received = sent.wrapping_add(ROUND_TRIP_US * (COUNTS_PER_S / 1_000_000));
        let [long, short] = lengths(cycle);
        notes.note(Direction::Sent, cycle, long, sent);
        notes.note(Direction::Received, !cycle, short, received);
        recorder.tick(&frames);
        assert_eq!(link.dequeue().map(|report| report.cycle), Some(cycle));
        let fault = (cycle == last).then_some(FAULT);
        events.watch(cycle.into(), mode(cycle), fault);
    }
}

fn empty() -> Box<Memory> {
    let memory = Box::new(Memory::new());
    memory.start(Keep::Nothing);
    memory.set_counts_per_s(COUNTS_PER_S);
    memory
}

/// The memory of a run of so many milliseconds.
fn recorded(milliseconds: u32) -> Box<Memory> {
    let memory = empty();
    record(&memory, 1, milliseconds);
    memory
}

fn read(memory: &Memory) -> Vec<u8> {
    let mut reader = Reader::new();
    while let Some(request) = reader.request() {
        assert!(reader.take(&memory.answer(request)), "{request:?}");
    }
    reader.into_memory().expect("everything was read")
}

fn contents(memory: &Memory) -> Contents {
    Contents::of(&read(memory)).expect("a recording")
}

#[test]
fn wrong_repeated_and_incomplete_pieces_lose_nothing() {
    let memory = recorded(50);
    let expected = read(&memory);
    let mut reader = Reader::new();
    while let Some(request) = reader.request() {
        let Request::Read { offset } = request else {
            panic!("{request:?}")
        };
        let next = memory.answer(Request::Read { offset: offset + 1_024 });
        let empty = Answer::Piece {
            offset,
            bytes: heapless::Vec::new(),
        };
        for other in [Answer::Discarded, next, empty] {
            assert!(!reader.take(&other));
        }
        let Answer::Piece { bytes, .. } = memory.answer(request) else {
            panic!("no piece")
        };
        // In two parts, the first of which ends in the middle of a word.
        let length = bytes.len().min(511);
        let part = heapless::Vec::from_slice(&bytes[..length]).expect("it is shorter");
        let part = Answer::Piece { offset, bytes: part };
        assert!(reader.take(&part) && !reader.take(&part));
        assert_eq!(reader.bytes_read(), offset as usize + length - length % 4);
        if let Some(rest) = reader.request() {
            assert!(reader.take(&memory.answer(rest)));
        }
        assert!(!reader.take(&part));
    }
    let behind = Answer::Piece {
        offset: MEMORY_BYTES as u32,
        bytes: heapless::Vec::from_slice(&[1; 8]).expect("it is short"),
    };
    assert!(!reader.take(&behind));
    assert!(reader.into_memory() == Some(expected));
    assert_eq!(Reader::new().into_memory(), None);
}

#[test]
fn the_newest_samples_events_and_frames_are_read_when_all_rings_have_wrapped() {
    const END: u32 = 9_300;
    let contents = contents(&recorded(END));
    let summary = &contents.summary;
    assert_eq!((summary.origin, contents.end_ms), (Origin::Present, END));
    assert_eq!((summary.samples, summary.span_ms), (SAMPLES, SAMPLES as u32 - 1));
    assert_eq!(
        (summary.gaps, summary.samples_missing, summary.frames_missed),
        (0, 0, 0)
    );
    for (sample, cycle) in contents.samples.iter().rev().zip((1..=END).rev()) {
        let expected = report(cycle);
        assert_eq!(sample.t_ms, cycle);
        assert_eq!(sample.before_end_s, f64::from(END - cycle) / 1e3);
        assert_eq!(
            sample.setpoint_rad,
            expected.setpoint.position_rad.map(|angle| angle as f32)
        );
        assert_eq!(sample.measured_rad, expected.measured_rad.map(|angle| angle as f32));
        assert_eq!(sample.increments, [65_535, 0, 1, cycle as u16]);
        assert_eq!(sample.status_word, expected.status_word);
        assert_eq!((sample.valid, sample.homed), (expected.valid, expected.homed));
        assert_eq!((sample.following, sample.fault), (expected.following, false));
        assert_eq!(sample.clock_error_ns, expected.clock_error_ns);
    }
    let (last, before) = contents.events.split_last().expect("events");
    assert_eq!((last.event, last.t_ms), (Some(Event::Fault(Some(FAULT))), END));
    assert_eq!((before.len(), summary.events_unreadable), (EVENTS - 1, 0));
    for (event, cycle) in before.iter().rev().zip((1..=END / MODE_MS).rev()) {
        let t_ms = cycle * MODE_MS;
        assert_eq!((event.event, event.t_ms), (Some(Event::Mode(mode(t_ms))), t_ms));
    }
    let fault = summary.last_fault.as_ref().expect("a fault");
    assert_eq!(
        (fault.fault, fault.before_end_s, summary.last_mode),
        (FAULT, 0.0, Some(mode(END)))
    );
    assert!(summary.frames_sent > 500 && summary.frames_sent.abs_diff(summary.frames_received) <= 1);
    for (index, frame) in contents.frames.iter().rev().enumerate() {
        let cycle = END - index as u32 / 2;
        let [long, short] = lengths(cycle);
        let (direction, bytes, after_us) = match index % 2 {
            0 => (Direction::Received, frame_bytes(!cycle, short), ROUND_TRIP_US),
            _ => (Direction::Sent, frame_bytes(cycle, long), 0),
        };
        assert_eq!((frame.direction, &frame.bytes), (direction, &bytes));
        let expected_s = f64::from(END - cycle) / 1e3 + f64::from(ROUND_TRIP_US - after_us) / 1e6;
        assert!(
            (frame.before_end_s - expected_s).abs() < 1e-9,
            "{frame:?}, {expected_s}"
        );
    }
}

#[test]
fn a_turn_of_the_counter_between_two_frames_is_completed_from_the_milliseconds() {
    let memory = empty();
    record(&memory, 1, 10);
    record(&memory, 30_001, 30_010);
    let contents = contents(&memory);
    assert_eq!((contents.samples.len(), contents.frames.len()), (20, 40));
    assert_eq!((contents.summary.gaps, contents.summary.samples_missing), (1, 29_990));
    let oldest = contents.frames.first().expect("a frame");
    assert!((oldest.before_end_s - 30.009_2).abs() < 1e-9, "{oldest:?}");
}

#[test]
fn times_go_on_where_the_milliseconds_start_again() {
    let memory = empty();
    record(&memory, u32::MAX - 2, u32::MAX);
    record(&memory, 0, 2);
    let contents = contents(&memory);
    assert_eq!((contents.end_ms, contents.samples.len()), (2, 6));
    assert_eq!((contents.summary.span_ms, contents.summary.gaps), (5, 0));
    let times: Vec<f64> = contents.samples.iter().map(|sample| sample.before_end_s).collect();
    assert_eq!(times, [0.005, 0.004, 0.003, 0.002, 0.001, 0.0]);
    let oldest = contents.frames.first().expect("a frame");
    assert!((oldest.before_end_s - 0.005_2).abs() < 1e-9, "{oldest:?}");
}

#[test]
fn a_kept_recording_names_its_origin_and_other_memories_are_refused() {
    for (keep, origin) in [
        (Keep::UntilDiscarded, Origin::Crashed),
        (Keep::UntilEnabled, Origin::Reset),
    ] {
        let memory = recorded(20);
        memory.start(keep);
        assert_eq!(contents(&memory).summary.origin, origin);
    }
    let whole = read(&recorded(20));
    assert_eq!(Contents::of(&whole[1..]), Err(NoRecording::Length));
    assert_eq!(Contents::of(&[]), Err(NoRecording::Length));
    assert_eq!(Contents::of(&vec![0; MEMORY_BYTES]), Err(NoRecording::Unknown));
    let started = contents(&empty());
    assert_eq!(
        (started.samples.len(), started.events.len(), started.frames.len()),
        (0, 0, 0)
    );
    assert!(mcap(&started, None).is_ok() && pcapng(&started).is_ok() && json(&started).is_ok());
}

#[test]
fn the_mcap_file_holds_every_sample_and_event_for_the_commands_of_recordings() {
    let memory = recorded(3_000);
    let config = Config::default();
    let hash = config.hash().expect("it is short");
    EventLog::new(&memory).put(3_000, &Event::Configured { hash });
    EventLog::new(&memory).put(3_001, &Event::Command(Command::Enable));
    let contents = contents(&memory);
    assert_eq!((contents.config_hash(), contents.end_ms), (Some(hash), 3_001));
    let file = mcap(&contents, Some(&config)).expect("memory");
    let mut playback = Playback::new(file.as_slice()).expect("a recording");
    assert_eq!(playback.config(), Some(config));
    assert_eq!(playback.fact("source"), Some("black box"));
    let (mut moments, mut events) = (Vec::new(), Vec::new());
    while let Some((time_s, entry)) = playback.next_entry().expect("it can be read") {
        match entry {
            RecordingEntry::Moment(moment) => moments.push((time_s, moment)),
            RecordingEntry::Event(event) => events.push(event),
            other => panic!("{other:?}"),
        }
    }
    assert!(playback.is_complete());
    assert_eq!((moments.len(), events.len()), (SAMPLES, EVENTS));
    for (entry, (time_s, moment)) in contents.samples.iter().zip(&moments) {
        assert_eq!(moment.sample.t_ms, entry.t_ms);
        if entry.t_ms >= contents.events[0].t_ms {
            assert_eq!(moment.sample.mode, mode(entry.t_ms));
        }
        assert_eq!(moment.sample.setpoint_rad, entry.setpoint_rad);
        assert_eq!(moment.sample.measured_rad, entry.measured_rad);
        assert!((moment.sample.setpoint_rad_s[0] - 2.0).abs() < 1e-3, "{moment:?}");
        assert!((moment.sample.measured_rad_s[3] - 1.0).abs() < 1e-3, "{moment:?}");
        let (_, first) = moments[0];
        let since_s = f64::from(entry.t_ms - first.sample.t_ms) / 1e3;
        assert!((time_s - since_s).abs() < 0.002, "{time_s}, {since_s}");
    }
    let fault = events.iter().find(|event| event.name == "fault").expect("a fault");
    assert_eq!((fault.level, fault.time_ns), (Severity::Error, 3_000_000_000));
    assert!(
        events
            .last()
            .is_some_and(|event| event.text.contains("enabling the drives"))
    );

    let mut reader = McapReader::new(file.as_slice()).expect("a file");
    let mut found = 0;
    while let Some(message) = reader.next_message().expect("it can be read") {
        if message.topic == "/black_box" {
            let sample = &contents.samples[found];
            assert_eq!(message.data.len(), 4 + 2 * 4 + 10 * 2 + 4 + 8);
            assert_eq!(message.data[4..8], sample.t_ms.to_le_bytes());
            assert_eq!(message.data[16..18], sample.status_word[0].to_le_bytes());
            assert_eq!(message.data[32..36], [u8::from(sample.following), 0, 0, 0]);
            assert_eq!(message.data[40..44], [0, 1, 1, 1]);
            found += 1;
        }
    }
    assert_eq!(found, SAMPLES);
}

#[test]
fn a_gap_is_written_and_speeds_do_not_span_it() {
    let memory = empty();
    record(&memory, 1, 3);
    record(&memory, 10, 12);
    let file = mcap(&contents(&memory), None).expect("memory");
    let mut playback = Playback::new(file.as_slice()).expect("a recording");
    let (mut gaps, mut speeds) = (Vec::new(), Vec::new());
    while let Some((_, entry)) = playback.next_entry().expect("it can be read") {
        match entry {
            RecordingEntry::Gap(gap) => gaps.push((gap.before_ms, gap.t_ms, gap.missing)),
            RecordingEntry::Moment(moment) => {
                assert!(moment.position.x_mm.is_nan());
                speeds.push(moment.sample.measured_rad_s[0].round());
            }
            _ => {}
        }
    }
    assert_eq!((gaps, speeds), (vec![(3, 10, 6)], vec![1.0; 6]));
}

#[test]
fn the_capture_holds_every_frame_with_its_direction() {
    let contents = contents(&recorded(40));
    let file = pcapng(&contents).expect("memory");
    let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().expect("four bytes"));
    let (mut place, mut packets) = (0, Vec::new());
    while place < file.len() {
        if word(place) == 6 {
            let time_ns = u64::from(word(place + 12)) << 32 | u64::from(word(place + 16));
            let length = word(place + 20) as usize;
            let bytes = file[place + 28..place + 28 + length].to_vec();
            let flags = word(place + 28 + length.next_multiple_of(4) + 4);
            packets.push((time_ns, flags, bytes));
        }
        place += word(place + 4) as usize;
    }
    assert_eq!(packets.len(), 80);
    for (index, (time_ns, flags, bytes)) in packets.into_iter().enumerate() {
        let frame = &contents.frames[index];
        assert_eq!((flags, &bytes), (if index % 2 == 0 { 2 } else { 1 }, &frame.bytes));
        // The newest frame is at the last millisecond.
        let cycle = index as u64 / 2 + 1;
        let expected_us = cycle * 1_000 - if index % 2 == 0 { 200 } else { 0 };
        assert_eq!(time_ns, 1_000 * expected_us);
    }
}

#[test]
fn json_holds_the_same_contents() {
    let contents = contents(&recorded(30));
    let bytes = json(&contents).expect("memory");
    let value: serde_json::Value = serde_json::from_slice(&bytes).expect("JSON");
    assert_eq!(value["summary"]["origin"], "present");
    assert_eq!(value["samples"].as_array().map(Vec::len), Some(30));
    assert_eq!(value["events"].as_array().map(Vec::len), Some(contents.events.len()));
    assert_eq!(value["frames"].as_array().map(Vec::len), Some(60));
    assert_eq!(value["frames"][0]["direction"], "sent");
    let digits = value["frames"][0]["bytes"].as_str().expect("digits");
    assert_eq!(digits.len(), 2 * contents.frames[0].bytes.len());
}

/// Bytes that begin like a recording, so that they are not refused at once.
fn hostile(random: &mut Random, like: &[u8]) -> Vec<u8> {
    let mut memory = like.to_vec();
    let changes = [8, 200, 70_000];
    let count = changes[random.bits() as usize % changes.len()];
    for _ in 0..count {
        // Half of the changes hit the header behind state and layout.
        let place = match random.bits().is_multiple_of(2) {
            true => 8 + random.bits() as usize % 56,
            false => 8 + random.bits() as usize % (MEMORY_BYTES - 8),
        };
        memory[place] = random.bits() as u8;
    }
    memory
}

#[test]
fn any_bytes_are_taken_apart_exported_and_replayed_without_a_panic() {
    let like = read(&recorded(2_500));
    for seed in 0..40 {
        let mut random = Random::new(seed);
        let memory = hostile(&mut random, &like);
        let contents = Contents::of(&memory).unwrap_or_else(|why| panic!("seed {seed}: {why:?}"));
        assert!(
            contents.samples.len() <= SAMPLES && contents.events.len() <= EVENTS,
            "seed {seed}"
        );
        let file = mcap(&contents, Some(&Config::default())).expect("memory");
        let mut playback = Playback::new(file.as_slice()).expect("a recording");
        while playback.next_entry().expect("it can be read").is_some() {}
        assert!(pcapng(&contents).is_ok() && json(&contents).is_ok(), "seed {seed}");
        if let Ok(replay) = replay(&contents, &Config::default()) {
            assert!(replay.agreed_ms as usize <= contents.samples.len(), "seed {seed}");
        }
        let noise: Vec<u8> = (0..MEMORY_BYTES / 8)
            .flat_map(|_| random.bits().to_le_bytes())
            .collect();
        assert_eq!(Contents::of(&noise), Err(NoRecording::Unknown), "seed {seed}");
    }
}
