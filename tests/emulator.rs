//! The firmware image in QEMU: lockstep, and the errors for an emulator that does not work.

use host_tools::emulator::{Emulator, EmulatorError, Link, LogLine, Options, Segment};
use host_tools::setup;
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

const RUN_MS: u32 = 500;
/// A sample is released at the start of its millisecond; its telegram is out within this time, us.
const INPUT_WITHIN_US: u64 = 20;
/// Wall time that even a very busy machine does not exceed.
const PATIENCE: Duration = Duration::from_secs(120);

/// What the firmware sent, and when. Wire and line come to this program on ways of their own, in either order.
#[derive(Default)]
struct Records {
    wire: DefaultHasher,
    line: DefaultHasher,
    milliseconds: u32,
    first_frames: Vec<u64>,
    over: bool,
}

/// A cable without slaves: every frame comes back as it was sent.
struct Cable(Arc<Mutex<Records>>);

impl Segment for Cable {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        let mut records = self.0.lock().expect("nobody panics with the records");
        if time_us < u64::from(RUN_MS) * 1_000 {
            (time_us, frame).hash(&mut records.wire);
            if records
                .first_frames
                .last()
                .is_none_or(|last| last / 1000 < time_us / 1000)
            {
                records.first_frames.push(time_us);
            }
        }
        vec![frame.to_vec()]
    }

    fn advance_to(&mut self, _time_us: u64) {}
}

/// A host that sends invalid messages and reports the end of the run.
struct Noise(Arc<Mutex<Records>>, Sender<()>);

impl Link for Noise {
    fn exchange(&mut self, ms: u32, from_device: &[u8], to_device: &mut Vec<u8>) {
        let mut records = self.0.lock().expect("nobody panics with the records");
        if records.over {
            return;
        }
        assert_eq!(ms, records.milliseconds, "a millisecond was left out or came twice");
        records.milliseconds += 1;
        (ms, from_device).hash(&mut records.line);
        to_device.extend([ms as u8; 40]);
        if ms == RUN_MS {
            records.over = true;
            self.1.send(()).expect("the test waits");
        }
    }
}

fn run(image: &Path) -> Records {
    let records = Arc::new(Mutex::new(Records::default()));
    let (over, wait) = channel();
    let emulator = Emulator::start(
        image,
        &Options::default(),
        Cable(records.clone()),
        Noise(records.clone(), over),
        |_: &LogLine| {},
    )
    .expect("the emulator starts");
    let ended = wait.recv_timeout(PATIENCE);
    let traffic = emulator.stop().expect("the emulator runs to the end");
    assert_eq!(ended, Ok(()));
    assert_eq!((traffic.frames_missing, traffic.replies_dropped), (0, 0));
    let mut records = records.lock().expect("nobody panics with the records");
    std::mem::take(&mut *records)
}

#[test]
fn two_runs_send_the_same_records_at_the_same_times() {
    let image = setup::build_firmware("emulated").expect("the firmware builds");
    let (first, second) = (run(&image), run(&image));
    assert_eq!(first.wire.finish(), second.wire.finish(), "frames");
    assert_eq!(first.line.finish(), second.line.finish(), "bytes on the line");
    // One input telegram a millisecond, each at its beginning, none left out.
    for (ms, time_us) in (0..).zip(&first.first_frames) {
        assert!(
            (ms * 1000..=ms * 1000 + INPUT_WITHIN_US).contains(time_us),
            "the first frame of millisecond {ms} came at {time_us} us"
        );
    }
    assert!(first.first_frames.len() as u32 >= RUN_MS);
}

struct Nothing;

impl Segment for Nothing {
    fn frame(&mut self, _time_us: u64, _frame: &[u8]) -> Vec<Vec<u8>> {
        Vec::new()
    }

    fn advance_to(&mut self, _time_us: u64) {}
}

impl Link for Nothing {
    fn exchange(&mut self, _ms: u32, _from_device: &[u8], _to_device: &mut Vec<u8>) {}
}

/// Starts `program` in the emulator's place, with this test's own image for a firmware.
fn start(program: &str) -> Result<Emulator, EmulatorError> {
    let options = Options {
        qemu: PathBuf::from(program),
        ..Options::default()
    };
    let image = std::env::current_exe().expect("a test has an image");
    Emulator::start(&image, &options, Nothing, Nothing, |_: &LogLine| {})
}

#[test]
fn a_missing_emulator_is_named_with_the_command_that_installs_it() {
    let error = start("/nonexistent/qemu-system-arm")
        .err()
        .expect("there is no such program");
    assert!(matches!(error, EmulatorError::QemuMissing { .. }));
    let text = error.to_string();
    assert!(text.contains("/nonexistent/qemu-system-arm") && text.contains("apt-get install qemu-system-arm"));
}

#[test]
fn an_emulator_that_ends_by_itself_is_an_error_with_its_status() {
    let emulator = start("false").expect("the program starts");
    match emulator.wait() {
        Err(EmulatorError::Ended { status, .. }) => assert_eq!(status.code(), Some(1)),
        other => panic!("expected the end, got {other:?}"),
    }
}

#[test]
fn a_missing_image_is_named() {
    let image = Path::new("/nonexistent/image");
    let error = Emulator::start(image, &Options::default(), Nothing, Nothing, |_: &LogLine| {})
        .err()
        .expect("there is no such image");
    assert!(error.to_string().contains("/nonexistent/image"));
}
