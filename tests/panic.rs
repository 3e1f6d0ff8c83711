//! A firmware that ends in motion. After a panic one last telegram stops the drives and switches the outputs of
//! terminals off. A critical task that hangs sends none; the watchdog ends the firmware, and drives and terminals stop by
//! their own watchdogs. The watchdog also ends a firmware whose trajectory task hangs. Each time the cause is reported, and
//! the black box holds the last two seconds as they were on the wire.

use etherpen::application::Mode;
use etherpen::black_box::recording::{Origin, Recording};
use etherpen::black_box::{Direction, Event, SAMPLES, Sample};
use etherpen::config::{Config, IoDirection, IoPoint};
use etherpen::link::frame::{FRAME_BYTES_MAX, encode};
use etherpen::measurement::{MeasurementRequest, disturbance};
use etherpen::messages::{Command, HostMessage};
use host_tools::black_box::contents::Contents;
use host_tools::black_box::replay::replay;
use host_tools::cell::{AlState, Cell, CellOptions, DriveState, SlaveState};
use host_tools::drawing::preparation::prepare::prepare;
use host_tools::drawing::preparation::wire::to_wire;
use host_tools::emulator::{Emulator, EmulatorError, LINK_BYTES_MAX, Link, LogLine, Options, Segment};
use host_tools::job::{Job, JobOptions};
use host_tools::setup;
use std::ops::RangeInclusive;
use std::sync::{Arc, Mutex};

/// Exit code of an emulated firmware that has panicked.
const PANICKED: i32 = 101;
/// Exit code of an emulated firmware that its watchdog has ended.
const ENDED_BY_WATCHDOG: i32 = 103;
/// Time without food after which the watchdog acts, and that the report may add, ms of virtual time.
const WATCHDOG_MS: u32 = 50;
const WATCHDOG_LATE_MS: u32 = 1;
/// AL status code of a slave whose outputs were not written in time.
const SYNC_MANAGER_WATCHDOG: u16 = 0x1b;
/// Time in which the last telegram has to act: less than the drives' watchdog of 10 ms takes.
const ACTS_WITHIN_US: u64 = 4_000;
/// Time after which the watchdogs of drives and terminals have expired.
const EXPIRED_AFTER_US: u64 = 12_000;
/// Time from the first setpoint that a hanging trajectory task does not plan to the watchdog: up to eight periods of
/// 12 ms of its own that it may owe, without those planned ahead, then the timeout.
const STARVED_MS: RangeInclusive<u32> = 100..=8 * 12 + WATCHDOG_MS;
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

/// How the firmware is to end.
#[derive(Clone, Copy)]
enum End {
    Panic,
    /// The task of this bit of `disturbance` hangs.
    Hang(u8),
}

/// The drawing job at the link, for as long as there is a firmware, commands that switch the output on, and the request
/// to hang.
struct Host {
    job: Job,
    end: End,
}

impl Link for Host {
    fn exchange(&mut self, ms: u32, from_device: &[u8], to_device: &mut Vec<u8>) {
        self.job.step(u64::from(ms), from_device, to_device, LINK_BYTES_MAX);
        let id = FIRST_BESIDE | (ms / SET_EACH_MS) as u16;
        let message = match (ms % SET_EACH_MS, self.end) {
            (0, _) => HostMessage::Command {
                id,
                command: Command::SetOutput { io: 0, value: 1 },
            },
            (1, End::Hang(bits)) => {
                let request = MeasurementRequest::Disturb { bits }.into();
                HostMessage::Measure { id, request }
            }
            _ => return,
        };
        let mut frame = [0; FRAME_BYTES_MAX];
        let length = encode(&message, &mut frame).expect("a message fits a frame");
        to_device.extend_from_slice(&frame[..length]);
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

/// What is left of a firmware that has ended in motion.
struct Ended {
    watched: Watched,
    config: Config,
    status: Option<i32>,
    /// The report of the end, as a user sees it.
    report: String,
    black_box: Vec<u8>,
}

/// Draws until the firmware ends.
fn draw_until(end: End) -> Ended {
    let image = setup::build_variant("emulated", &["end-while-drawing"]).expect("the firmware builds");
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
        Host { job, end },
        |_: &LogLine| {},
    );
    let error = emulator
        .expect("the emulator starts")
        .wait()
        .expect_err("the firmware was to end");
    let report = error.to_string();
    let EmulatorError::Ended {
        status, log, black_box, ..
    } = error
    else {
        panic!("the firmware was to end by itself: {report}")
    };
    assert!(
        log.iter().any(|line| line.contains("Drawing")),
        "modes are in the log: {log:?}"
    );
    let path = black_box.unwrap_or_else(|| panic!("a black box: {report}"));
    let black_box = std::fs::read(&path).expect("it can be read");
    std::fs::remove_file(&path).expect("it is a file of this test");
    let watched = Arc::into_inner(watched).expect("the emulator has ended");
    Ended {
        watched: watched.into_inner().expect("nobody panics with the cell"),
        config,
        status: status.code(),
        report,
        black_box,
    }
}

#[test]
fn a_panic_in_motion_stops_the_drives_and_switches_outputs_off_by_one_last_telegram_and_names_its_cause() {
    let mut ended = draw_until(End::Panic);
    assert_eq!(ended.status, Some(PANICKED), "{}", ended.report);
    assert!(
        ended.report.contains("this image was built to end here"),
        "{}",
        ended.report
    );
    check_black_box(&ended);
    check_replay(&ended);
    assert!(samples(&ended).last().is_some_and(|last| last.flags.following()));
    let (cell, last_us) = (&mut ended.watched.cell, ended.watched.last_frame_us);
    let moving_rad_s = speed_rad_s(cell);
    cell.advance_to(last_us + ACTS_WITHIN_US);
    assert_eq!(ended.watched.outputs_before, Some(vec![1]), "the output was on");
    assert_eq!(cell.outputs(usize::from(TERMINAL) + 1), Some(vec![0]));
    for (place, slave) in cell.state().slaves.iter().enumerate() {
        assert_ne!(slave.drive, DriveState::OperationEnabled, "{slave:?}");
        // The coupler before the terminal is never used.
        if place + 1 != usize::from(TERMINAL) {
            assert_eq!(slave.al_state, AlState::Operational, "it was not the watchdog");
        }
    }
    cell.advance_to(last_us + STANDS_WITHIN_US);
    println!(
        "{} frames; {moving_rad_s:.2} rad/s at the last one",
        ended.watched.frames
    );
    assert!(moving_rad_s > 0.05, "it was in motion");
    assert!(speed_rad_s(cell) < STILL_RAD_S);
}

#[test]
fn a_critical_task_that_hangs_in_motion_is_ended_by_the_watchdog_and_the_last_two_seconds_survive() {
    let mut ended = draw_until(End::Hang(disturbance::HANG_SAMPLE));
    check_watchdog(&ended);
    check_black_box(&ended);
    check_replay(&ended);
    let following = samples(&ended).last().map(|last| last.flags.following());
    assert_eq!(following, Some(true), "up to the end");
    let (cell, last_us) = (&mut ended.watched.cell, ended.watched.last_frame_us);
    let moving_rad_s = speed_rad_s(cell);
    println!(
        "{} frames; {moving_rad_s:.2} rad/s at the last one",
        ended.watched.frames
    );
    assert!(moving_rad_s > 0.05, "it was in motion");
    // No telegram has told the slaves to stop.
    cell.advance_to(last_us + ACTS_WITHIN_US);
    assert_eq!(cell.outputs(usize::from(TERMINAL) + 1), Some(vec![1]));
    assert!(
        drives(cell)
            .iter()
            .all(|drive| drive.drive == DriveState::OperationEnabled)
    );
    cell.advance_to(last_us + EXPIRED_AFTER_US);
    assert_eq!(cell.outputs(usize::from(TERMINAL) + 1), Some(vec![0]));
    for drive in drives(cell) {
        assert_ne!(drive.drive, DriveState::OperationEnabled, "{drive:?}");
        assert_eq!(drive.al_status_code, SYNC_MANAGER_WATCHDOG, "{drive:?}");
    }
    cell.advance_to(last_us + STANDS_WITHIN_US);
    assert!(drives(cell).iter().all(|drive| drive.drive == DriveState::Fault));
    assert!(speed_rad_s(cell) < STILL_RAD_S);
}

#[test]
fn a_trajectory_task_that_hangs_leaves_the_robot_at_rest_and_is_ended_by_the_watchdog() {
    let ended = draw_until(End::Hang(disturbance::HANG_TRAJECTORY));
    check_watchdog(&ended);
    check_black_box(&ended);
    let speed_rad_s = speed_rad_s(&ended.watched.cell);
    // The sampler has lacked setpoints since shortly after the task hung, and stopped the drives.
    let faulted = samples(&ended).iter().filter(|sample| sample.flags.fault()).count();
    println!("{faulted} ms with a fault, {speed_rad_s:.5} rad/s at the end");
    assert!(STARVED_MS.contains(&(faulted as u32)), "{faulted} ms");
    assert!(
        samples(&ended).last().is_some_and(|last| last.flags.fault()),
        "up to the end"
    );
    assert!(speed_rad_s < STILL_RAD_S);
}

/// The end is the watchdog's, at its time, and reported as such.
fn check_watchdog(ended: &Ended) {
    let report = &ended.report;
    assert_eq!(ended.status, Some(ENDED_BY_WATCHDOG), "{report}");
    assert!(report.contains("watchdog: a required task has not run"), "{report}");
    assert!(report.contains("etherpen blackbox --image"), "{report}");
    let (_, unfed) = report.split_once("not fed for ").expect("the time is reported");
    let unfed_ms: u32 = unfed
        .split(' ')
        .next()
        .and_then(|ms| ms.parse().ok())
        .expect("a number");
    let on_time = WATCHDOG_MS..=WATCHDOG_MS + WATCHDOG_LATE_MS;
    assert!(on_time.contains(&unfed_ms), "{unfed_ms} ms");
}

fn drives(cell: &Cell) -> Vec<SlaveState> {
    let slaves = cell.state().slaves.into_iter().enumerate();
    let drives = slaves.filter(|(place, _)| !(usize::from(TERMINAL) - 1..=usize::from(TERMINAL)).contains(place));
    drives.map(|(_, slave)| slave).collect()
}

fn samples(ended: &Ended) -> Vec<Sample> {
    Recording::new(&ended.black_box)
        .expect("a recording")
        .samples()
        .collect()
}

/// The last two seconds without a gap, the motion in them, and the frames as they were on the wire, up to the last
/// millisecond.
fn check_black_box(ended: &Ended) {
    let (image, wire) = (&ended.black_box, &ended.watched.wire);
    let recording = Recording::new(image).expect("a recording");
    assert_eq!(recording.origin(), Origin::Crashed);
    let samples = samples(ended);
    assert_eq!(samples.len(), SAMPLES);
    assert!(
        samples.is_sorted_by(|one, next| one.cycle + 1 == next.cycle),
        "no millisecond is missing"
    );
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
}

/// Inputs that are given twice have equal results.
fn check_replay(ended: &Ended) {
    let contents = Contents::of(&ended.black_box).expect("a recording");
    let replayed = replay(&contents, &ended.config).expect("two seconds of a drawing");
    println!("{} ms replayed", replayed.agreed_ms);
    assert_eq!((replayed.difference, replayed.not_recorded), (None, None));
    assert!(replayed.agreed_ms as usize > SAMPLES / 2);
}

fn speed_rad_s(cell: &Cell) -> f64 {
    let speeds = cell.state().velocities.0;
    speeds.iter().fold(0.0, |most, speed| most.max(speed.abs()))
}
