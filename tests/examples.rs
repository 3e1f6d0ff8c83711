//! The examples: on the emulated board, and on this computer, each against a virtual chain.
//!
//! The chain's time follows the frames, a millisecond each, so a busy computer changes nothing.

use etherpen_segment::transport::{Endpoint, listen};
use etherpen_segment::{Flywheel, Segment, SegmentOptions, SlaveKind};
use host_tools::emulator::free_running::FreeRunning;
use host_tools::emulator::{self, EmulatorError};
use host_tools::setup;
use std::f64::consts::TAU;
use std::path::Path;
use std::process::{Command, ExitStatus};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Wall time that even a very busy machine does not exceed.
const PATIENCE: Duration = Duration::from_secs(300);
/// Time between two looks at the chain.
const LOOK: Duration = Duration::from_millis(20);

/// Inputs of the EL1008 in the order in which they are set; the EL2004 has the lower four.
const PATTERNS: [u8; 6] = [0x05, 0x0A, 0xF0, 0xFF, 0x08, 0x01];

/// A chain of slaves, and how far its motor has turned.
struct Chain {
    segment: Segment<Flywheel>,
    time_us: u64,
    turned_rad: (f64, f64),
}

impl Chain {
    fn new(slaves: &[SlaveKind]) -> Self {
        let options = SegmentOptions {
            slaves: slaves.to_vec(),
            ..SegmentOptions::default()
        };
        Self {
            segment: Segment::new(&options, Flywheel::default()),
            time_us: 0,
            turned_rad: (0.0, 0.0),
        }
    }

    fn answer(&mut self, frame: &[u8]) -> Vec<Vec<u8>> {
        self.time_us += 1_000;
        let replies = self.segment.frame(self.time_us, frame);
        for motor in self.segment.motors() {
            let (least, most) = self.turned_rad;
            self.turned_rad = (least.min(motor.angle_rad), most.max(motor.angle_rad));
        }
        replies
    }

    /// The motor made one turn and came back, and is at rest without power.
    fn assert_turned(&self) {
        let motor = self.segment.motors().next().expect("a motor");
        let (least, most) = self.turned_rad;
        println!("turned from {least:.3} to {most:.3} rad, now {motor:?}");
        assert!((most - TAU).abs() < 0.2, "one turn forward");
        assert!(least > -0.2 && motor.angle_rad.abs() < 0.2, "and back");
        assert!(motor.speed_rad_s.abs() < 0.5, "at rest");
    }
}

impl emulator::Segment for Chain {
    fn frame(&mut self, _: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.answer(frame)
    }

    fn advance_to(&mut self, _: u64) {}
}

/// Sets the EL1008's inputs one after the other, and expects the EL2004's outputs to follow. Returns true when all have
/// been tried.
fn follows(chain: &mut Chain, tried: &mut usize) -> bool {
    let Some(inputs) = PATTERNS.get(*tried) else {
        return true;
    };
    chain.segment.set_inputs(2, &[*inputs]);
    *tried += usize::from(chain.segment.outputs(3) == Some(vec![*inputs & 0x0F]));
    false
}

fn terminals() -> Chain {
    Chain::new(&[SlaveKind::Ek1100, SlaveKind::El1008, SlaveKind::El2004])
}

/// Runs an example on the emulated board until `done`, which gets the chain and whether the example has ended.
fn on_the_board(
    example: &str,
    chain: Chain,
    mut done: impl FnMut(&mut Chain, bool) -> bool,
) -> Result<(), EmulatorError> {
    setup::ensure_qemu().expect("the emulator is there");
    let image = setup::build_example(example).expect("the example builds");
    let log = |line: &emulator::LogLine| println!("{line}");
    let chain = Arc::new(Mutex::new(chain));
    let running = FreeRunning::start(&image, Path::new("qemu-system-arm"), 0, chain.clone(), log).expect("it starts");
    let started = Instant::now();
    while !done(&mut chain.lock().expect("nobody panics with it"), !running.is_running()) {
        assert!(started.elapsed() < PATIENCE, "the example goes on");
        std::thread::sleep(LOOK);
    }
    running.stop()
}

/// Runs an example on this computer until `done`, which gets the chain and whether the example has ended.
fn on_this_computer(example: &str, mut chain: Chain, mut done: impl FnMut(&mut Chain, bool) -> bool) -> ExitStatus {
    let program = setup::build_host_example(example).expect("the example builds");
    let folder = std::env::temp_dir().join(format!("etherpen-{example}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let path = folder.join("bus");
    let mut port = listen(&Endpoint::Unix(path.clone())).expect("a socket");
    let place = format!("unix:{}", path.display());
    let mut running = Command::new(program).arg(place).spawn().expect("it starts");
    let (started, mut status) = (Instant::now(), None);
    while !done(&mut chain, status.is_some()) {
        assert!(started.elapsed() < PATIENCE, "the example goes on");
        if let Some((master, frame)) = port.receive(LOOK).expect("the socket") {
            for reply in chain.answer(&frame) {
                port.send(master, &reply).expect("the socket");
            }
        }
        status = running.try_wait().expect("a child");
    }
    // One that goes on for ever has to be ended.
    let _ = running.kill();
    std::fs::remove_dir_all(&folder).expect("the folder just made");
    running.wait().expect("a child")
}

#[test]
fn the_drive_example_turns_a_motor_on_the_emulated_board() {
    let end = on_the_board("drive", Chain::new(&[SlaveKind::Cia402]), |chain, ended| {
        if ended {
            chain.assert_turned();
        }
        ended
    });
    match end {
        Err(EmulatorError::Ended { status, .. }) if status.success() => {}
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_drive_example_turns_a_motor_on_this_computer() {
    let status = on_this_computer("drive", Chain::new(&[SlaveKind::Cia402]), |chain, ended| {
        if ended {
            chain.assert_turned();
        }
        ended
    });
    assert!(status.success(), "{status}");
}

#[test]
fn the_terminals_example_passes_inputs_on_to_outputs_on_the_emulated_board() {
    let mut tried = 0;
    let end = on_the_board("terminals", terminals(), |chain, ended| {
        assert!(!ended, "the example goes on for ever");
        follows(chain, &mut tried)
    });
    assert!(end.is_ok(), "{end:?}");
}

#[test]
fn the_terminals_example_passes_inputs_on_to_outputs_on_this_computer() {
    let mut tried = 0;
    on_this_computer("terminals", terminals(), |chain, ended| {
        assert!(!ended, "the example goes on for ever");
        follows(chain, &mut tried)
    });
}
