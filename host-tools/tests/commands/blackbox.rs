//! `etherpen blackbox` with memory images: all outputs, replays, and images that are refused.

use crate::NOBODY;
use crate::program::{Folder, etherpen, run};
use etherpen::application::{Fault, Mode};
use etherpen::black_box::{
    Direction, EventLog, FrameNote, FrameNotes, FrameSource, Keep, MEMORY_BYTES, Memory, Recorder, SAMPLES,
};
use etherpen::config::Config;
use etherpen::control::sampler::CycleReport;
use heapless::spsc::Queue;
use host_tools::black_box;
use host_tools::cell::{Cell, CellOptions};
use host_tools::drawing::preparation::prepare::prepare;
use host_tools::drawing::preparation::wire::to_wire;
use host_tools::error::code;
use host_tools::job::{Job, JobOptions};
use host_tools::recording::{Playback, RecordingEntry};
use host_tools::setup;
use host_tools::simulation::{self, Host, Surroundings};
use std::fs;
use std::path::Path;

/// Milliseconds of the run that the image holds the end of.
const RUN_MS: u32 = 2_500;
/// When the button is pressed, ms.
const PRESSED_MS: u32 = 4_000;
/// Rate of the emulated board's counter, Hz.
const COUNTS_PER_S: u32 = 25_000_000;
/// Byte of the layout's version.
const LAYOUT_AT: usize = 4;

/// Frames of zeros.
#[derive(Default)]
struct Frames(FrameNotes);

impl FrameSource for Frames {
    fn notes(&self) -> &FrameNotes {
        &self.0
    }

    fn word(&self, _: &FrameNote, _: usize) -> u32 {
        0
    }

    fn is_intact(&self, _: &FrameNote) -> bool {
        true
    }
}

/// The memory of a run that ended with a fault and a panic. It contradicts itself: setpoints were followed while the
/// robot was idle.
fn image() -> Vec<u8> {
    let memory = Box::new(Memory::new());
    memory.start(Keep::Nothing);
    memory.set_counts_per_s(COUNTS_PER_S);
    let (mut new, mut passed) = (Queue::<CycleReport, 4>::new(), Queue::<CycleReport, 4>::new());
    let (mut reports, taken) = new.split();
    let (passed_on, mut link) = passed.split();
    let mut recorder = Recorder::new(&memory, taken, passed_on);
    let mut events = EventLog::new(&memory);
    let frames = Frames::default();
    for cycle in 1..=RUN_MS {
        let report = CycleReport {
            cycle,
            following: true,
            ..CycleReport::default()
        };
        assert!(reports.enqueue(report).is_ok());
        let counts = cycle.wrapping_mul(COUNTS_PER_S / 1_000);
        frames.notes().note(Direction::Sent, cycle, 60, counts);
        recorder.tick(&frames);
        assert!(link.dequeue().is_some());
        let fault = (cycle > RUN_MS - 5).then_some(Fault::SetpointUnderrun);
        let mode = if fault.is_some() { Mode::Fault } else { Mode::Idle };
        events.watch(cycle.into(), mode, fault);
    }
    memory.start(Keep::UntilDiscarded);
    let words = (0..).map_while(|index| memory.word(index));
    words.flat_map(u32::to_le_bytes).collect()
}

/// A drawing in virtual time during which the emergency-stop button is pressed.
struct Stopped {
    job: Job,
    now_ms: u32,
    memory: Vec<u8>,
}

impl Host for Stopped {
    fn exchange(&mut self, ms: u32, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
        self.now_ms = ms;
        self.job.step(u64::from(ms), from_firmware, to_firmware, room);
    }

    fn recorded(&mut self, memory: &Memory) {
        if self.is_over() {
            self.memory = black_box::image(memory);
        }
    }

    fn surroundings(&mut self) -> Surroundings {
        Surroundings {
            stop_shows_open: self.now_ms >= PRESSED_MS,
            ..Surroundings::default()
        }
    }

    fn is_over(&self) -> bool {
        self.now_ms >= PRESSED_MS + 200
    }
}

/// The memory after the stop of a drawing.
fn stopped_drawing(config: &Config) -> Vec<u8> {
    let prepared = prepare(&setup::workspace().join("samples/strokes.csv"), config).expect("the sample");
    let path: Vec<_> = prepared.path.iter().map(to_wire).collect();
    let mut host = Stopped {
        job: Job::draw(config.clone(), path, JobOptions::default()),
        now_ms: 0,
        memory: Vec::new(),
    };
    let mut cell = Cell::new(config, CellOptions::default());
    simulation::run(&mut cell, &mut host, 2 * PRESSED_MS);
    host.memory
}

#[test]
fn a_recording_replays_to_the_same_millisecond_and_another_one_does_not() {
    let folder = Folder::new();
    let config = Config::default();
    folder.file("stopped.bin", stopped_drawing(&config));
    let replay = ["blackbox", "--image", "stopped.bin", "--replay"];
    let (status, stdout, stderr) = run(etherpen(&folder).args(replay));
    assert_eq!(status, Some(0), "{stderr}");
    let same = "the same fault in the same millisecond, 197 ms before the end: emergency stop by the board's input";
    assert!(stdout.contains(same), "{stdout}");

    let (status, stdout, _) = run(etherpen(&folder).args(replay).arg("--json"));
    assert_eq!(status, Some(0));
    let printed: serde_json::Value = serde_json::from_str(&stdout).expect("JSON");
    assert_eq!(printed["replay"]["faults"][0]["fault"]["EmergencyStop"], "Input");
    assert!(printed["replay"]["agreed_ms"].as_u64() > Some(500), "{stdout}");
    assert!(printed["replay"]["difference"].is_null() && printed["replay"]["not_recorded"].is_null());

    // A measurement that would be older, and a limit that the error would then exceed.
    folder.file(
        "strict.toml",
        "[[axes]]\n[[axes]]\nfollowing_error_max_rad = 0.001\nmeasurement_age_ms = 8.0\n[[axes]]\n[[axes]]\n",
    );
    let (status, _, stderr) = run(etherpen(&folder).args(replay).args(["--config", "strict.toml"]));
    assert_eq!(status, Some(i32::from(code::FAILED)), "{stderr}");
    assert!(stderr.contains("the fault that this one would have raised"), "{stderr}");
    assert!(
        stderr.contains("recorded None, replayed Some(FollowingError { axis: 1"),
        "{stderr}"
    );

    folder.file("made-up.bin", image());
    let (status, _, stderr) = run(etherpen(&folder).args(["blackbox", "--image", "made-up.bin", "--replay"]));
    assert_eq!(status, Some(i32::from(code::FAILED)), "{stderr}");
    assert!(stderr.contains("the replay differs"), "{stderr}");
}

fn refused(folder: &Folder, arguments: &[&str], code: u8, words: &str) {
    let (status, _, stderr) = run(etherpen(folder).arg("blackbox").args(arguments));
    assert_eq!(status, Some(i32::from(code)), "{arguments:?}: {stderr}");
    assert!(stderr.contains(words), "{arguments:?}: {stderr}");
}

/// Number of frames in a pcapng file.
fn packets(path: &Path) -> usize {
    let file = fs::read(path).expect("a capture");
    let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().expect("four bytes"));
    assert_eq!(word(0), 0x0A0D_0D0A);
    let (mut place, mut found) = (0, 0);
    while place < file.len() {
        found += usize::from(word(place) == 6);
        place += word(place + 4) as usize;
    }
    found
}

#[test]
fn an_image_is_shown_and_becomes_every_output() {
    let folder = Folder::new();
    let image = image();
    assert_eq!(image.len(), MEMORY_BYTES);
    folder.file("black-box.bin", &image);

    let (status, stdout, stderr) = run(etherpen(&folder).args(["blackbox", "--image", "black-box.bin"]));
    assert_eq!(status, Some(0), "{stderr}");
    for words in [
        "until it is discarded",
        "2000 samples in 1999 ms",
        "last mode: Fault",
        "4 ms before the end",
    ] {
        assert!(stdout.contains(words), "{words}: {stdout}");
    }

    let all = [
        "blackbox",
        "--image",
        "black-box.bin",
        "--json",
        "-o",
        "run.mcap",
        "--frames",
        "run.pcapng",
        "--save",
        "copy.bin",
    ];
    let (status, stdout, stderr) = run(etherpen(&folder).args(all));
    assert_eq!(status, Some(0), "{stderr}");
    let printed: serde_json::Value = serde_json::from_str(&stdout).expect("JSON");
    assert_eq!(printed["summary"]["origin"], "crashed");
    assert_eq!(printed["summary"]["samples"], SAMPLES);
    assert_eq!(printed["summary"]["last_fault"]["before_end_s"], 0.004);
    let frames = printed["summary"]["frames_sent"].as_u64().expect("a number");
    assert_eq!(packets(&folder.join("run.pcapng")) as u64, frames);
    assert!(fs::read(folder.join("copy.bin")).expect("a copy") == image);

    let mut playback = Playback::open(&folder.join("run.mcap")).expect("a recording");
    let (mut samples, mut last) = (0, 0);
    while let Some((_, entry)) = playback.next_entry().expect("it can be read") {
        if let RecordingEntry::Moment(moment) = entry {
            (samples, last) = (samples + 1, moment.sample.t_ms);
        }
    }
    assert_eq!((samples, last, playback.is_complete()), (SAMPLES, RUN_MS, true));
    let (status, stdout, stderr) = run(etherpen(&folder).args(["stats", "run.mcap", "--json"]));
    assert_eq!(status, Some(0), "{stderr}");
    let figures: serde_json::Value = serde_json::from_str(&stdout).expect("JSON");
    assert_eq!((&figures["samples"], &figures["missing"]), (&SAMPLES.into(), &0.into()));

    let table = ["blackbox", "--image", "copy.bin", "-o", "run.json"];
    let (status, _, stderr) = run(etherpen(&folder).args(table).env("ETHERPEN_PORT", NOBODY));
    assert_eq!(status, Some(0), "{stderr}");
    let text = fs::read_to_string(folder.join("run.json")).expect("a file");
    let contents: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(contents["samples"].as_array().map(Vec::len), Some(SAMPLES));
    assert_eq!(contents["summary"], printed["summary"]);
}

#[test]
fn what_is_no_recording_is_refused_with_what_to_try() {
    let folder = Folder::new();
    let image = image();
    folder.file("black-box.bin", &image);
    folder.file("short.bin", &image[..MEMORY_BYTES - 1]);
    folder.file("long.bin", [&image[..], &[0]].concat());
    let mut other = image.clone();
    other[LAYOUT_AT] ^= 0x80;
    folder.file("other.bin", other);
    folder.file("never.bin", vec![0_u8; MEMORY_BYTES]);
    refused(
        &folder,
        &["--image", "short.bin"],
        code::INPUT,
        "fewer than 262144 bytes",
    );
    refused(&folder, &["--image", "long.bin"], code::INPUT, "more than 262144 bytes");
    refused(&folder, &["--image", "other.bin"], code::INPUT, "another layout");
    refused(&folder, &["--image", "never.bin"], code::INPUT, "nothing was recorded");
    refused(&folder, &["--image", "absent.bin"], code::INPUT, "absent.bin");
}

#[test]
fn options_that_do_not_fit_are_refused_before_anything_is_written() {
    let folder = Folder::new();
    let image = folder.file("black-box.bin", image());
    let from = ["--image", "black-box.bin"];
    let with = |more: &[&'static str]| [&from[..], more].concat();
    refused(&folder, &with(&["--port", NOBODY]), code::USAGE, "--port and --image");
    refused(&folder, &with(&["--discard"]), code::USAGE, "--discard");
    refused(&folder, &with(&["-o", "run.csv"]), code::USAGE, ".mcap or .json");
    refused(
        &folder,
        &with(&["--save", "black-box.bin"]),
        code::USAGE,
        "is the input file",
    );
    let twice = with(&["-o", "one.json", "--frames", "one.json"]);
    refused(&folder, &twice, code::USAGE, "two outputs");
    assert!(!folder.join("one.json").exists() && !folder.join("run.csv").exists());
    refused(
        &folder,
        &with(&["-o", "absent/run.mcap"]),
        code::FAILED,
        "absent/run.mcap",
    );
    assert_eq!(fs::read(image).expect("it stays").len(), MEMORY_BYTES);
    refused(&folder, &["--port", NOBODY], code::CONNECTION, "127.0.0.1:1");
}
