//! A firmware that panics in motion: one last telegram stops the drives, then silence, and the cause is reported.

use etherpen::config::Config;
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

/// The drawing job at the link, for as long as there is a firmware.
struct Host(Job);

impl Link for Host {
    fn exchange(&mut self, ms: u32, from_device: &[u8], to_device: &mut Vec<u8>) {
        self.0.step(u64::from(ms), from_device, to_device, LINK_BYTES_MAX);
    }
}

/// The cell, and when the last frame came.
struct Watched {
    cell: Cell,
    last_frame_us: u64,
    frames: u32,
}

impl Segment for Watched {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.last_frame_us = time_us;
        self.frames += 1;
        self.cell.frame(time_us, frame)
    }

    fn advance_to(&mut self, time_us: u64) {
        self.cell.advance_to(time_us);
    }
}

#[test]
fn a_panic_in_motion_stops_the_drives_by_one_last_telegram_and_names_its_cause() {
    let image = setup::build_variant("emulated", &["panic-while-drawing"]).expect("the firmware builds");
    let config = Config::default();
    let file = setup::workspace().join("samples/strokes.csv");
    let prepared = prepare(&file, &config).unwrap_or_else(|error| panic!("{}", error.message));
    let path: Vec<_> = prepared.path.iter().map(to_wire).collect();
    let job = Job::draw(config.clone(), path, JobOptions::default());
    let watched = Arc::new(Mutex::new(Watched {
        cell: Cell::new(&config, CellOptions::default()),
        last_frame_us: 0,
        frames: 0,
    }));
    let emulator = Emulator::start(
        &image,
        &Options::default(),
        watched.clone(),
        Host(job),
        |_: &LogLine| {},
    );
    let ended = emulator.expect("the emulator starts").wait();
    match ended {
        Err(EmulatorError::Ended { status, said, log }) => {
            assert_eq!(status.code(), Some(PANICKED), "{said}");
            assert!(said.contains("this image was built to end here"), "{said}");
            assert!(
                log.iter().any(|line| line.contains("Drawing")),
                "modes are in the log: {log:?}"
            );
        }
        other => panic!("the firmware was to end by a panic: {other:?}"),
    }
    let mut watched = watched.lock().expect("nobody panics with the cell");
    let (last_us, frames) = (watched.last_frame_us, watched.frames);
    let moving_rad_s = speed_rad_s(&watched.cell);
    watched.cell.advance_to(last_us + ACTS_WITHIN_US);
    for slave in watched.cell.state().slaves {
        assert_ne!(slave.drive, DriveState::OperationEnabled, "{slave:?}");
        assert_eq!(slave.al_state, AlState::Operational, "it was not the watchdog");
    }
    watched.cell.advance_to(last_us + STANDS_WITHIN_US);
    println!("{frames} frames; {moving_rad_s:.2} rad/s at the last one");
    assert!(moving_rad_s > 0.05, "it was in motion");
    assert!(speed_rad_s(&watched.cell) < STILL_RAD_S);
}

fn speed_rad_s(cell: &Cell) -> f64 {
    let speeds = cell.state().velocities.0;
    speeds.iter().fold(0.0, |most, speed| most.max(speed.abs()))
}
