//! A firmware that panics in motion: one last telegram stops the drives and switches the outputs of terminals off, then
//! silence; the cause is reported, and the black box holds the last two seconds as they were on the wire, and they replay.

use etherpen::application::Mode;
use etherpen::black_box::recording::{Origin, Recording};
use etherpen::black_box::{Direction, Event, SAMPLES};
use etherpen::config::{Config, IoDirection, IoPoint};
use etherpen::link::frame::{FRAME_BYTES_MAX, encode};
use etherpen::messages::{Command, HostMessage};
use host_tools::black_box::contents::Contents;
use host_tools::black_box::replay::replay;
use host_tools::cell::{AlState, Cell, CellOptions, DriveState};
use host_tools::drawing::preparation::prepare::prepare;
use host_tools::drawing::preparation::wire::to_wire;
use host_tools::emulator::{Emulator, EmulatorError, LINK_BYTES_MAX, Link, LogLine, Options, Segment};
use host_tools::job::{Job, JobOptions};
use host_tools::setup;
use std::sync::{Arc, Mutex};

/// Exit code of an emulated firmware that has panicked.
const PANICKED: i32 = 101;
/// Time in which the last telegram has to act: less than the drives' watchdog of 10 ms takes.
const ACTS_WITHIN_US: u64 = 4_000;
/// Time in which everything comes to rest.
const STANDS_WITHIN_US: u64 = 1_000_000;
const STILL_RAD_S: f64 = 1.0e-3;
/// Milliseconds of which the black box has to hold the frames.
const FRAMES_MS: u32 = 20;
/// Most frames between the recorder's last run and the end: those of a millisecond, and the last telegram with its reply.
const FRAMES_AFTER_MAX: usize = 6;

/// Place of the terminal with the lamp, from 0: behind the drives.
const TERMINAL: u8 = 4;

/// Time between two commands that set the output: the first ones come before the bus is brought up.
const SET_EACH_MS: u32 = 100;
/// First number of these commands, far from the job's own.
const FIRST_BESIDE: u16 = 0x8000;

/// A robot with an output that is off at a fault.
fn config() -> Config {
    let mut config = Config::default();
    let valve = IoPoint {
        name: "valve".try_into().expect("a short name"),
        slave: TERMINAL,
        direction: IoDirection::Out,
        bit: Some(0),
        ..IoPoint::default()
    };
    config.io.push(valve).expect("there is room");
    config
}

/// The drawing job at the link, for as long as there is a firmware, and commands that switch the output on.
struct Host(Job);

impl Link for Host {
    fn exchange(&mut self, ms: u32, from_device: &[u8], to_device: &mut Vec<u8>) {
        self.0.step(u64::from(ms), from_device, to_device, LINK_BYTES_MAX);
        if ms.is_multiple_of(SET_EACH_MS) {
            let message = HostMessage::Command {
                id: FIRST_BESIDE | (ms / SET_EACH_MS) as u16,
                command: Command::SetOutput { io: 0, value: 1 },
            };
            let mut frame = [0; FRAME_BYTES_MAX];
            let length = encode(&message, &mut frame).expect("a command fits a frame");
            to_device.extend_from_slice(&frame[..length]);
        }
    }
}

/// The cell, and when the last frame came.
struct Watched {
    cell: Cell,
    last_frame_us: u64,
    frames: u32,
    /// Outputs of the terminal before the last frame.
    outputs_before: Option<Vec<u8>>,
    /// The frames as they were on the wire, with their direction.
    wire: Vec<(Direction, Vec<u8>)>,
}

impl Segment for Watched {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.last_frame_us = time_us;
        self.frames += 1;
        self.outputs_before = self.cell.outputs(usize::from(TERMINAL) + 1);
        self.wire.push((Direction::Sent, frame.to_vec()));
        let replies = self.cell.frame(time_us, frame);
        self.wire
            .extend(replies.iter().map(|reply| (Direction::Received, reply.clone())));
        replies
    }

    fn advance_to(&mut self, time_us: u64) {
        self.cell.advance_to(time_us);
    }
}

#[test]
fn a_panic_in_motion_stops_the_drives_and_switches_outputs_off_by_one_last_telegram_and_names_its_cause() {
    let image = setup::build_variant("emulated", &["panic-while-drawing"]).expect("the firmware builds");
    let config = config();
    let file = setup::workspace().join("samples/strokes.csv");
    let prepared = prepare(&file, &config).unwrap_or_else(|error| panic!("{}", error.message));
    let path: Vec<_> = prepared.path.iter().map(to_wire).collect();
    let job = Job::draw(config.clone(), path, JobOptions::default());
    let watched = Arc::new(Mutex::new(Watched {
        cell: Cell::new(&config, CellOptions::default()),
        last_frame_us: 0,
        frames: 0,
        outputs_before: None,
        wire: Vec::new(),
    }));
    let emulator = Emulator::start(
        &image,
        &Options::default(),
        watched.clone(),
        Host(job),
        |_: &LogLine| {},
    );
    let image_of_the_end;
    let ended = emulator.expect("the emulator starts").wait();
    match ended {
        Err(EmulatorError::Ended {
            status,
            said,
            log,
            black_box,
        }) => {
            assert_eq!(status.code(), Some(PANICKED), "{said}");
            assert!(said.contains("this image was built to end here"), "{said}");
            assert!(
                log.iter().any(|line| line.contains("Drawing")),
                "modes are in the log: {log:?}"
            );
            let path = black_box.expect("a black box");
            image_of_the_end = std::fs::read(&path).expect("it can be read");
            std::fs::remove_file(&path).expect("it is a file of this test");
        }
        other => panic!("the firmware was to end by a panic: {other:?}"),
    }
    let mut watched = watched.lock().expect("nobody panics with the cell");
    check_black_box(&image_of_the_end, &watched.wire);
    let (last_us, frames) = (watched.last_frame_us, watched.frames);
    let moving_rad_s = speed_rad_s(&watched.cell);
    watched.cell.advance_to(last_us + ACTS_WITHIN_US);
    assert_eq!(watched.outputs_before, Some(vec![1]), "the output was on");
    assert_eq!(watched.cell.outputs(usize::from(TERMINAL) + 1), Some(vec![0]));
    for (place, slave) in watched.cell.state().slaves.iter().enumerate() {
        assert_ne!(slave.drive, DriveState::OperationEnabled, "{slave:?}");
        // The coupler before the terminal is never used.
        if place + 1 != usize::from(TERMINAL) {
            assert_eq!(slave.al_state, AlState::Operational, "it was not the watchdog");
        }
    }
    watched.cell.advance_to(last_us + STANDS_WITHIN_US);
    println!("{frames} frames; {moving_rad_s:.2} rad/s at the last one");
    assert!(moving_rad_s > 0.05, "it was in motion");
    assert!(speed_rad_s(&watched.cell) < STILL_RAD_S);
}

/// The last two seconds without a gap, the motion in them, and the frames as they were on the wire, up to the last
/// millisecond.
fn check_black_box(image: &[u8], wire: &[(Direction, Vec<u8>)]) {
    let recording = Recording::new(image).expect("a recording");
    assert_eq!(recording.origin(), Origin::Crashed);
    let samples: Vec<_> = recording.samples().collect();
    assert_eq!(samples.len(), SAMPLES);
    assert!(
        samples.is_sorted_by(|one, next| one.cycle + 1 == next.cycle),
        "no millisecond is missing"
    );
    assert!(samples.last().is_some_and(|last| last.flags.following()));
    let drawing = recording
        .events()
        .any(|(_, event)| event == Some(Event::Mode(Mode::Drawing)));
    assert!(drawing, "events: {:?}", recording.events().collect::<Vec<_>>());
    let frames: Vec<_> = recording.frames().collect();
    let recorded: Vec<(Direction, Vec<u8>)> = frames
        .iter()
        .map(|frame| (frame.direction, recording.frame_bytes(frame).collect()))
        .collect();
    println!("{} frames in the black box", recorded.len());
    assert_eq!(recording.frames_missed(), 0);
    let milliseconds = frames.last().map_or(0, |last| last.cycle) - frames.first().map_or(0, |first| first.cycle);
    assert!(milliseconds >= FRAMES_MS, "{milliseconds} ms of frames");
    // The last ones passed after the recorder's last run.
    let end = (wire.len() - FRAMES_AFTER_MAX..=wire.len())
        .find(|end| wire.get(..*end).is_some_and(|wire| wire.ends_with(&recorded)));
    assert!(end.is_some(), "the frames are those of the wire");
    let contents = Contents::of(image).expect("a recording");
    let replayed = replay(&contents, &config()).expect("two seconds of a drawing");
    println!("{} ms replayed", replayed.agreed_ms);
    assert_eq!((replayed.difference, replayed.not_recorded), (None, None));
    assert!(replayed.agreed_ms as usize > SAMPLES / 2);
}

fn speed_rad_s(cell: &Cell) -> f64 {
    let speeds = cell.state().velocities.0;
    speeds.iter().fold(0.0, |most, speed| most.max(speed.abs()))
}
