extern crate std;

use super::memory::EVENTS;
use super::recording::{NoRecording, Origin, Recording};
use super::*;
use crate::application::{Command, Fault, Mode, Refusal, StopSource};
use crate::board::{Interlock, RunEnd};
use crate::control::sampler::CycleReport;
use crate::robots::{JointAngles, Position};
use heapless::spsc::{Consumer, Producer, Queue};
use std::boxed::Box;
use std::cell::{Cell, RefCell};
use std::vec::Vec;

/// Splitmix64: numbers that repeat in every run.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ self.0 >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ mixed >> 31
    }
}

fn memory() -> &'static Memory {
    let memory = Box::leak(Box::new(Memory::new()));
    memory.start(Keep::Nothing);
    memory
}

fn queue<T, const N: usize>() -> (Producer<'static, T>, Consumer<'static, T>) {
    Box::leak(Box::new(Queue::<T, N>::new())).split()
}

/// A recorder with the ends of its queues.
struct Rig {
    recorder: Recorder<'static>,
    reports: Producer<'static, CycleReport>,
    passed_on: Consumer<'static, CycleReport>,
}

impl Rig {
    fn new(memory: &'static Memory) -> Self {
        let ((reports, taken), (given, passed_on)) = (queue::<_, 5>(), queue::<_, 5>());
        Self {
            recorder: Recorder::new(memory, taken, given),
            reports,
            passed_on,
        }
    }

    fn tick(&mut self, report: CycleReport, frames: &impl FrameSource) {
        assert!(self.reports.enqueue(report).is_ok());
        self.recorder.tick(frames);
        assert_eq!(self.passed_on.dequeue().map(|report| report.cycle), Some(report.cycle));
    }
}

fn report(cycle: u32, random: &mut Random) -> CycleReport {
    let mut report = CycleReport {
        cycle,
        ..CycleReport::default()
    };
    for axis in 0..4 {
        report.measured_rad[axis] = random.next() as i32 as f64 / 1.0e9;
        report.setpoint.position_rad[axis] = random.next() as i32 as f64 / 1.0e9;
        report.increments[axis] = random.next() as i64;
        // No drive is enabled: nothing ends what is kept.
        report.status_word[axis] = random.next() as u16 & !0x6F;
        report.valid[axis] = random.next().is_multiple_of(2);
        report.homed[axis] = random.next().is_multiple_of(2);
    }
    report.following = random.next().is_multiple_of(2);
    report.standstill = random.next().is_multiple_of(2);
    report.clock_error_ns = random.next().is_multiple_of(2).then(|| random.next() as i32);
    report.interlock = [None, Some(Interlock::EmergencyStop), Some(Interlock::Clock)][random.next() as usize % 3];
    report.fault = random.next().is_multiple_of(2).then_some(Fault::SetpointUnderrun);
    report.bus.frames_lost = random.next() as u32;
    report.counters.cycles_late = random.next() as u32;
    report.io.set = random.next() as u16;
    report
}

fn image(memory: &Memory) -> Vec<u8> {
    let words = (0..).map_while(|index| memory.word(index));
    words.flat_map(u32::to_le_bytes).collect()
}

#[test]
fn the_last_two_thousand_milliseconds_are_there_and_the_slot_being_written_is_not() {
    let (memory, mut random) = (memory(), Random(1));
    let mut rig = Rig::new(memory);
    let frames = NoFrames::default();
    let mut given = Vec::new();
    for cycle in 0..5_003 {
        let report = report(cycle, &mut random);
        given.push(Sample::of(&report));
        rig.tick(report, &frames);
        if ![1, 7, 1_999, 2_000, 2_001, 2_002, 4_001, 5_002].contains(&cycle) {
            continue;
        }
        let mut image = image(memory);
        let expected = &given[given.len().saturating_sub(SAMPLES)..];
        let samples = |image: &[u8]| Recording::new(image).unwrap().samples().collect::<Vec<_>>();
        assert_eq!(samples(&image), expected);
        // A reset in the middle of the next sample.
        let next = (given.len() % (SAMPLES + 1)) * 64 + 64;
        image[next..next + 64].fill(0xEE);
        assert_eq!(samples(&image), expected);
    }
}

#[test]
fn a_sample_says_what_the_report_said() {
    let mut random = Random(2);
    for cycle in 0..1_000 {
        let report = report(cycle, &mut random);
        let sample = Sample::from_words(&Sample::of(&report).to_words());
        assert_eq!(sample, Sample::of(&report));
        assert_eq!(sample.flags.following(), report.following);
        assert_eq!(sample.flags.standstill(), report.standstill);
        assert_eq!(sample.flags.fault(), report.fault.is_some());
        assert_eq!(sample.flags.interlock(), report.interlock);
        for axis in 0..4 {
            assert_eq!(sample.flags.valid(axis), report.valid[axis]);
            assert_eq!(sample.flags.homed(axis), report.homed[axis]);
            assert_eq!(sample.increments[axis], report.increments[axis] as u16);
        }
    }
}

/// Frames of generated lengths; `during` is called at each word that is read.
struct Generated<'d> {
    notes: FrameNotes,
    frames: RefCell<Vec<Vec<u8>>>,
    lost: Cell<Option<u32>>,
    during: &'d dyn Fn(usize),
}

impl<'d> Generated<'d> {
    fn new(during: &'d dyn Fn(usize)) -> Self {
        Self {
            notes: FrameNotes::new(),
            frames: RefCell::default(),
            lost: Cell::new(None),
            during,
        }
    }

    fn pass(&self, random: &mut Random) {
        let length = 60 + random.next() as usize % 1_455;
        let frame = (0..length).map(|_| random.next() as u8).collect();
        let number = self.frames.borrow().len() as u32;
        self.frames.borrow_mut().push(frame);
        self.notes.note(way(number), number, length, number * 10);
    }
}

fn way(number: u32) -> Direction {
    [Direction::Sent, Direction::Received][number as usize % 2]
}

impl FrameSource for Generated<'_> {
    fn notes(&self) -> &FrameNotes {
        &self.notes
    }

    fn word(&self, note: &FrameNote, index: usize) -> u32 {
        (self.during)(note.number as usize);
        let frames = self.frames.borrow();
        let mut bytes = [0; 4];
        for (byte, of_frame) in bytes.iter_mut().zip(frames[note.place as usize][index * 4..].iter()) {
            *byte = *of_frame;
        }
        u32::from_le_bytes(bytes)
    }

    fn is_intact(&self, note: &FrameNote) -> bool {
        self.lost.get() != Some(note.number)
    }
}

/// The numbers of the frames in a memory, after their bytes have been compared.
fn numbers(image: &[u8], frames: &[Vec<u8>]) -> Vec<usize> {
    let recording = Recording::new(image).unwrap();
    let compared = recording.frames().map(|frame| {
        let number = frame.counts as usize / 10;
        assert_eq!(recording.frame_bytes(&frame).collect::<Vec<_>>(), frames[number]);
        assert_eq!(frame.direction, way(number as u32));
        number
    });
    compared.collect()
}

#[test]
fn the_last_frames_are_there_whenever_a_reset_comes() {
    let (memory, mut random) = (memory(), Random(3));
    let mut rig = Rig::new(memory);
    let looked = Cell::new(0_u32);
    let snapshots = RefCell::new(Vec::new());
    let during = |number: usize| {
        looked.set(looked.get() + 1);
        if looked.get().is_multiple_of(9_973) {
            snapshots.borrow_mut().push((number, image(memory)));
        }
    };
    let frames = Generated::new(&during);
    for cycle in 0..800 {
        for _ in 0..random.next() % 5 {
            frames.pass(&mut random);
        }
        rig.tick(report(cycle, &mut random), &frames);
    }
    let all = frames.frames.borrow();
    let last = numbers(&image(memory), &all);
    assert_eq!(last.last(), Some(&(all.len() - 1)));
    assert!(
        last.is_sorted_by(|one, next| one + 1 == *next),
        "none is missing between"
    );
    assert!(last.len() > 100, "the ring holds {} frames", last.len());
    assert!(snapshots.borrow().len() > 20);
    for (number, image) in snapshots.borrow().iter() {
        let there = numbers(image, &all);
        assert!(there.is_sorted_by(|one, next| one + 1 == *next));
        assert_eq!(
            there.last().map_or(0, |last| last + 1),
            *number,
            "only the one being copied is missing"
        );
    }
}

#[test]
fn frames_that_were_overwritten_or_not_fetched_in_time_are_counted() {
    let (memory, mut random) = (memory(), Random(4));
    let mut rig = Rig::new(memory);
    let frames = Generated::new(&|_| ());
    (0..5).for_each(|_| frames.pass(&mut random));
    frames.lost.set(Some(2));
    rig.tick(report(0, &mut random), &frames);
    let missed = || Recording::new(&image(memory)).unwrap().frames_missed();
    assert_eq!(missed(), 1);
    assert_eq!(numbers(&image(memory), &frames.frames.borrow()), [0, 1, 3, 4]);
    (0..100).for_each(|_| frames.pass(&mut random));
    rig.tick(report(1, &mut random), &frames);
    assert_eq!(missed(), 1 + 100 - 31);
    let there = numbers(&image(memory), &frames.frames.borrow());
    assert_eq!(there.len(), 4 + 31);
    assert_eq!(there.last(), Some(&104));
}

#[test]
fn what_happened_is_there_in_its_order() {
    let memory = memory();
    let mut log = EventLog::new(memory);
    let pose = JointAngles([1.0, -2.0, f64::MAX, f64::MIN_POSITIVE]);
    let position = Position {
        x_mm: f64::MAX,
        y_mm: -1.0e-300,
        z_mm: 3.0,
    };
    let longest = Event::Command(Command::HomeAt {
        pose,
        position: Some(position),
    });
    log.put(3, &Event::Configured { hash: u64::MAX });
    log.put(4, &longest);
    log.put(
        5,
        &Event::Refused(Refusal::CauseRemains(Fault::EmergencyStop(StopSource::Input))),
    );
    log.watch(6, Mode::DrivesOff, None);
    log.watch(7, Mode::DrivesOff, None);
    log.watch(8, Mode::Fault, Some(Fault::SetpointUnderrun));
    let image = image(memory);
    let events: Vec<_> = Recording::new(&image).unwrap().events().collect();
    let refused = Event::Refused(Refusal::CauseRemains(Fault::EmergencyStop(StopSource::Input)));
    let expected = [
        (3, Event::Configured { hash: u64::MAX }),
        (4, longest),
        (5, refused),
        (6, Event::Mode(Mode::DrivesOff)),
        (8, Event::Mode(Mode::Fault)),
        (8, Event::Fault(Some(Fault::SetpointUnderrun))),
    ];
    assert_eq!(events, expected.map(|(ms, event)| (ms, Some(event))));
}

#[test]
fn a_recording_begins_with_the_present_state_and_repeated_jogs_do_not_fill_it() {
    let (memory, mut random) = (memory(), Random(9));
    let mut log = EventLog::new(memory);
    let jog = |speed: f32| Command::Jog {
        velocity_mm_s: [speed, 0.0, 0.0],
    };
    log.watch(1, Mode::Idle, None);
    (2..500).for_each(|ms| log.command(ms, jog(5.0)));
    log.command(500, jog(-5.0));
    log.watch(501, Mode::Moving, None);
    let events = || -> Vec<_> {
        let image = image(memory);
        Recording::new(&image)
            .unwrap()
            .events()
            .map(|(ms, event)| (ms, event.unwrap()))
            .collect()
    };
    let idle = [(1, Event::Began), (1, Event::Mode(Mode::Idle))];
    let jogs = [(2, Event::Command(jog(5.0))), (500, Event::Command(jog(-5.0)))];
    assert_eq!(
        events(),
        [&idle[..], &jogs, &[(501, Event::Mode(Mode::Moving))]].concat()
    );
    memory.answer(Request::Discard);
    Rig::new(memory).tick(report(1, &mut random), &NoFrames::default());
    log.watch(600, Mode::Moving, None);
    assert_eq!(events(), [(600, Event::Began), (600, Event::Mode(Mode::Moving))]);
    // A read interrupts recordings, and is no beginning.
    memory.answer(Request::Read { offset: 0 });
    log.watch(601, Mode::Idle, None);
    let mut rig = Rig::new(memory);
    (0..5_000).for_each(|cycle| rig.tick(report(cycle, &mut random), &NoFrames::default()));
    log.watch(6_000, Mode::Idle, None);
    assert_eq!(events().last(), Some(&(6_000, Event::Mode(Mode::Idle))));
    assert_eq!(events().len(), 3);
}

#[test]
fn of_many_events_the_last_hundred_are_there() {
    let memory = memory();
    let mut log = EventLog::new(memory);
    (0..1_234).for_each(|ms| log.put(ms, &Event::Connected));
    let image = image(memory);
    let events: Vec<_> = Recording::new(&image).unwrap().events().map(|(ms, _)| ms).collect();
    assert_eq!(events, (1_234 - EVENTS as u32..1_234).collect::<Vec<_>>());
}

#[test]
fn the_recording_of_a_crash_is_kept_until_it_is_discarded_and_that_of_a_reset_until_a_drive_is_enabled() {
    let mut random = Random(5);
    let frames = NoFrames::default();
    let origin = |memory: &Memory| Recording::new(&image(memory)).map(|recording| recording.origin());
    let enabled = |cycle: u32| CycleReport {
        cycle,
        status_word: [0x27; 4],
        ..CycleReport::default()
    };
    for (end, expected) in [
        (RunEnd::PowerOff, Origin::Present),
        (RunEnd::Reset, Origin::Reset),
        (RunEnd::Watchdog, Origin::Crashed),
        (RunEnd::Panic("cause".try_into().unwrap()), Origin::Crashed),
    ] {
        let memory = memory();
        let mut rig = Rig::new(memory);
        (0..50).for_each(|cycle| rig.tick(report(cycle, &mut random), &frames));
        memory.start(Keep::after(&end));
        assert_eq!(origin(memory), Ok(expected));
        assert_eq!(memory.is_kept(), expected != Origin::Present);
        let before = image(memory);
        // The next run, and its reset.
        let (mut rig, mut log) = (Rig::new(memory), EventLog::new(memory));
        for cycle in 0..50 {
            rig.tick(report(cycle, &mut random), &frames);
            log.watch(u64::from(cycle), Mode::DrivesOff, None);
        }
        assert_eq!(
            before == image(memory),
            expected != Origin::Present,
            "nothing is recorded over it"
        );
        memory.start(Keep::UntilEnabled);
        let after_reset = if expected == Origin::Present {
            Origin::Reset
        } else {
            expected
        };
        assert_eq!(origin(memory), Ok(after_reset), "{end:?}");
        // A drive is enabled.
        Rig::new(memory).tick(enabled(1), &frames);
        let after_enabling = if after_reset == Origin::Reset {
            Origin::Present
        } else {
            expected
        };
        assert_eq!(origin(memory), Ok(after_enabling), "{end:?}");
        assert_eq!(memory.answer(Request::Discard), Answer::Discarded);
        Rig::new(memory).tick(enabled(2), &frames);
        assert_eq!(origin(memory), Ok(Origin::Present));
        let samples = Recording::new(&image(memory)).unwrap().samples().count();
        assert_eq!(samples, 1, "recordings go on in the same millisecond");
    }
}

#[test]
fn the_recording_of_a_reset_makes_way_after_two_minutes_and_that_of_a_crash_does_not() {
    let mut random = Random(10);
    let frames = NoFrames::default();
    for (keep, is_kept) in [(Keep::UntilEnabled, false), (Keep::UntilDiscarded, true)] {
        let memory = memory();
        Rig::new(memory).tick(report(1, &mut random), &frames);
        memory.start(keep);
        let mut rig = Rig::new(memory);
        (0..119_999).for_each(|cycle| rig.tick(report(cycle, &mut random), &frames));
        assert!(memory.is_kept());
        (0..2).for_each(|cycle| rig.tick(report(cycle, &mut random), &frames));
        assert_eq!(memory.is_kept(), is_kept);
    }
}

#[test]
fn a_planned_restart_leaves_nothing_and_keeps_an_earlier_crash() {
    let mut random = Random(6);
    let memory = memory();
    Rig::new(memory).tick(report(1, &mut random), &NoFrames::default());
    memory.end();
    memory.start(Keep::UntilDiscarded);
    assert!(!memory.is_kept());
    Rig::new(memory).tick(report(1, &mut random), &NoFrames::default());
    memory.start(Keep::UntilDiscarded);
    memory.end();
    memory.start(Keep::UntilDiscarded);
    assert!(memory.is_kept());
}

#[test]
fn a_host_reads_a_memory_that_rests_meanwhile() {
    let (memory, mut random) = (memory(), Random(7));
    let mut rig = Rig::new(memory);
    let frames = NoFrames::default();
    (0..3_000).for_each(|cycle| rig.tick(report(cycle, &mut random), &frames));
    let first = memory.answer(Request::Read { offset: 0 });
    let whole = image(memory);
    let mut read = Vec::new();
    for cycle in 3_000.. {
        let offset = read.len() as u32;
        let Answer::Piece { offset: of, bytes } = memory.answer(Request::Read { offset }) else {
            panic!("a piece");
        };
        assert_eq!(of, offset);
        if bytes.is_empty() {
            break;
        }
        read.extend_from_slice(&bytes);
        rig.tick(report(cycle, &mut random), &frames);
    }
    let differing = read.iter().zip(&whole).filter(|(one, other)| one != other).count();
    assert_eq!(read.len(), whole.len());
    assert!(differing <= 4, "only the time left differs");
    assert!(matches!(first, Answer::Piece { offset: 0, bytes } if bytes.len() == PIECE_BYTES));
    let count = |memory: &Memory| Recording::new(&image(memory)).unwrap().samples().last().unwrap().cycle;
    let before = count(memory);
    (0..4_999).for_each(|cycle| rig.tick(report(10_000 + cycle, &mut random), &frames));
    assert_eq!(count(memory), before, "recordings rest for five seconds");
    (0..2).for_each(|cycle| rig.tick(report(20_000 + cycle, &mut random), &frames));
    assert_eq!(count(memory), 20_001);
}

#[test]
fn bytes_that_are_no_black_box_are_refused_and_damaged_ones_break_nothing() {
    assert_eq!(Recording::new(&[0; 100]).err(), Some(NoRecording::Length));
    let zeros = std::vec![0; MEMORY_BYTES];
    assert_eq!(Recording::new(&zeros).err(), Some(NoRecording::Unknown));
    let mut random = Random(8);
    let memory = memory();
    let mut rig = Rig::new(memory);
    let frames = Generated::new(&|_| ());
    for cycle in 0..300 {
        frames.pass(&mut random);
        rig.tick(report(cycle, &mut random), &frames);
    }
    for round in 0..200 {
        let mut damaged = image(memory);
        // The header's counters, and then words anywhere.
        for _ in 0..=round {
            let index = match random.next() % 2 {
                0 => 8 + random.next() as usize % 56,
                _ => 8 + random.next() as usize % (MEMORY_BYTES - 8),
            };
            damaged[index] = random.next() as u8;
        }
        let recording = Recording::new(&damaged).unwrap();
        assert!(recording.samples().count() <= SAMPLES);
        assert!(recording.events().count() <= EVENTS);
        let bytes: usize = recording
            .frames()
            .map(|frame| recording.frame_bytes(&frame).count())
            .sum();
        assert!(bytes <= FRAME_WORDS * 4);
    }
}
