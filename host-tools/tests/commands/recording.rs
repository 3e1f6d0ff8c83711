//! Recordings: written, killed, limited by a full disk, read by another program, and evaluated.

use crate::program::{Folder, Running, etherpen, run, strokes, wait_until};
use etherpen::application::Mode;
use etherpen::link::frame::{Decoder, FRAME_BYTES_MAX, PAYLOAD_BYTES_MAX, decode, encode};
use etherpen::messages::{DeviceMessage, HostMessage, IoValues, PROTOCOL_VERSION, Sample, Status, Welcome};
use etherpen::motion::Pen;
use host_tools::error::code;
use host_tools::setup;
use rustix::process::{Pid, Signal, kill_process};
use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Version of the `mcap` package from PyPI that reads the recordings.
const MCAP_PACKAGE: &str = "mcap==1.6.0";

fn figures(folder: &Folder, recording: &Path) -> serde_json::Value {
    let (status, stdout, stderr) = run(etherpen(folder).arg("stats").arg(recording).arg("--json"));
    assert_eq!(status, Some(0), "{stderr}");
    serde_json::from_str(&stdout).expect("JSON")
}

fn refused(folder: &Folder, arguments: &[&str], code: u8, words: &str) {
    let (status, _, stderr) = run(etherpen(folder).args(arguments));
    assert_eq!(status, Some(i32::from(code)), "{arguments:?}: {stderr}");
    assert!(stderr.contains(words), "{arguments:?}: {stderr}");
}

/// Python with the `mcap` package, in a folder next to cargo's output; `None` if it cannot be installed.
fn python() -> Option<PathBuf> {
    let folder = setup::target_dir().join("mcap-python");
    let python = folder.join("bin/python");
    let has_package = |python: &Path| {
        let package =
            format!("import importlib.metadata as m; assert 'mcap==' + m.version('mcap') == '{MCAP_PACKAGE}'");
        let output = Command::new(python).args(["-c", &package]).output();
        output.is_ok_and(|output| output.status.success())
    };
    if has_package(&python) {
        return Some(python);
    }
    let succeeds = |command: &mut Command| command.output().is_ok_and(|output| output.status.success());
    let made = succeeds(Command::new("python3").args(["-m", "venv"]).arg(&folder))
        && succeeds(Command::new(&python).args(["-m", "pip", "install", "--quiet", MCAP_PACKAGE]));
    (made && has_package(&python)).then_some(python)
}

#[test]
fn a_recording_holds_what_the_table_holds_for_an_independent_reader_too() {
    let folder = Folder::new();
    let out = folder.join("out");
    let (status, _, stderr) = run(etherpen(&folder).arg("simulate").arg(strokes()).arg("--out").arg(&out));
    assert_eq!(status, Some(0), "{stderr}");
    let (recording, table) = (out.join("telemetry.mcap"), out.join("telemetry.csv"));
    let exported = folder.join("exported.csv");
    let (status, _, stderr) = run(etherpen(&folder)
        .arg("export")
        .arg(&recording)
        .arg("--csv")
        .arg(&exported));
    assert_eq!(status, Some(0), "{stderr}");
    let read = |path: &Path| fs::read(path).expect("a table");
    assert!(read(&exported) == read(&table), "the tables differ");

    let report: serde_json::Value = serde_json::from_slice(&read(&out.join("report.json"))).expect("JSON");
    let figures = figures(&folder, &recording);
    assert_eq!(figures["missing"], 0);
    assert_eq!(figures["following_error_max_rad"], report["following_error_max_rad"]);

    let Some(python) = python() else {
        eprintln!("NOT TESTED: {MCAP_PACKAGE} cannot be installed (python3 with venv, and PyPI, are needed)");
        return;
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/commands/read_recording.py");
    let mut command = Command::new(python);
    let (status, stdout, stderr) = run(command.arg(script).arg(&recording).arg(&table));
    assert_eq!(status, Some(0), "{stderr}");
    eprintln!("mcap from PyPI: {}", stdout.trim());
}

#[test]
fn parts_of_a_recording_become_tables_and_pictures() {
    let folder = Folder::new();
    let recording = folder.join("r.mcap");
    let (status, _, stderr) = run(etherpen(&folder)
        .arg("record")
        .arg("-o")
        .arg(&recording)
        .arg("--simulate")
        .arg(strokes())
        .args(["--duration", "2.5"]));
    assert_eq!(status, Some(0), "{stderr}");
    let whole = figures(&folder, &recording);
    assert_eq!((&whole["samples"], &whole["gaps"]), (&2_500.into(), &0.into()));
    assert!(
        whole["events"].as_u64() > Some(5) && whole["statuses"].as_u64() > Some(5),
        "{whole}"
    );

    let name = recording.to_str().expect("a name");
    let part = [
        "export",
        name,
        "--from",
        "1",
        "--to",
        "1.5",
        "--signals",
        "q1_rad,mode,q1_error_rad",
        "--csv",
        "-",
    ];
    let (status, stdout, stderr) = run(etherpen(&folder).args(part));
    assert_eq!(status, Some(0), "{stderr}");
    let mut lines = stdout.lines();
    assert_eq!(lines.next(), Some("t_ms,q1_rad,mode,q1_error_rad"));
    assert_eq!(lines.count(), 501);

    for (picture, begin) in [("p.svg", &b"<svg"[..]), ("p.png", b"\x89PNG")] {
        let plot = ["plot", name, "--signals", "q*_rad,mode", "-o", picture];
        let (status, _, stderr) = run(etherpen(&folder).args(plot));
        assert_eq!(status, Some(0), "{stderr}");
        assert!(fs::read(folder.join(picture)).expect("a picture").starts_with(begin));
    }
    let parquet = folder.join("t.parquet");
    let (status, _, stderr) = run(etherpen(&folder).args(["export", name, "--parquet"]).arg(&parquet));
    assert_eq!(status, Some(0), "{stderr}");
    let bytes = fs::read(parquet).expect("a table");
    assert!(bytes.starts_with(b"PAR1") && bytes.ends_with(b"PAR1"));

    refused(
        &folder,
        &["plot", name, "--signals", "q7_rad", "-o", "p.svg"],
        code::USAGE,
        "q4_error_rad",
    );
    refused(
        &folder,
        &["plot", name, "--signals", "q1_rad", "-o", "p.jpg"],
        code::USAGE,
        ".svg or .png",
    );
    refused(
        &folder,
        &["stats", name, "--from", "2", "--to", "1"],
        code::USAGE,
        "after",
    );
    let late = ["plot", name, "--signals", "q1_rad", "-o", "p.svg", "--from", "100"];
    refused(&folder, &late, code::INPUT, "no sample");
    folder.file("text.mcap", "t_ms,mode\n");
    refused(&folder, &["stats", "text.mcap"], code::INPUT, "no MCAP file");
    refused(&folder, &["stats", "absent.mcap"], code::INPUT, "absent.mcap");
}

#[test]
fn the_file_of_a_recorder_that_was_killed_opens() {
    let folder = Folder::new();
    let recording = folder.join("r.mcap");
    let path = setup::workspace().join("samples/motion/text.csv");
    let mut command = etherpen(&folder);
    let mut recorder = Running::start(
        command
            .arg("record")
            .arg("-o")
            .arg(&recording)
            .arg("--simulate")
            .arg(path),
    );
    recorder.wait_for("recording", |_| {
        (fs::metadata(&recording).ok()?.len() > 500_000).then_some(())
    });
    let id = Pid::from_raw(recorder.id() as i32).expect("a process");
    kill_process(id, Signal::KILL).expect("it runs");
    recorder.end();
    let bytes = fs::metadata(&recording).expect("a recording").len();
    let figures = figures(&folder, &recording);
    assert_eq!((&figures["complete"], &figures["missing"]), (&false.into(), &0.into()));
    let samples = figures["samples"].as_u64().expect("a number");
    eprintln!("{samples} samples in {bytes} bytes");
    // As many as fit: 155 bytes each, with the indexes.
    assert!(samples > bytes / 170, "{figures}");
}

#[test]
fn a_full_disk_is_told_with_what_to_do() {
    let folder = Folder::new();
    let strokes = strokes();
    let drawing = strokes.to_str().expect("a name");
    let full = ["record", "-o", "/dev/full", "--simulate", drawing];
    refused(&folder, &full, code::FAILED, "No space left on device");
    refused(
        &folder,
        &["record", "-o", "absent/r.mcap", "--simulate", drawing],
        code::FAILED,
        "absent/r.mcap",
    );
}

fn say(client: &mut TcpStream, message: &DeviceMessage) {
    let mut frame = [0; FRAME_BYTES_MAX];
    let length = encode(message, &mut frame).expect("it fits");
    // The program may have hung up.
    let _ = client.write_all(&frame[..length]);
}

fn sample(t_ms: u32) -> Sample {
    Sample {
        t_ms,
        mode: Mode::DrivesOff,
        stroke: 0,
        pen: Pen::Up,
        setpoint_rad: [0.5; 4],
        measured_rad: [0.4; 4],
        setpoint_rad_s: [0.0; 4],
        measured_rad_s: [0.1; 4],
        io: IoValues::default(),
    }
}

/// A firmware that sends its first 40 samples except the tenth to the 21st, then listens.
fn firmware(listener: &TcpListener) {
    let (mut client, _) = listener.accept().expect("the program connects");
    let (mut decoder, mut byte) = (Decoder::<PAYLOAD_BYTES_MAX>::new(), [0]);
    while client.read(&mut byte).is_ok_and(|count| count == 1) {
        let Some(Ok(payload)) = decoder.push(byte[0]) else {
            continue;
        };
        let Ok(HostMessage::Hello(hello)) = decode(payload) else {
            continue;
        };
        let welcome = Welcome {
            protocol: PROTOCOL_VERSION,
            session: hello.session,
            firmware: "0.1.0".try_into().expect("short"),
            board: "emulated".try_into().expect("short"),
            config: None,
            capacity: 64,
            previous: Default::default(),
        };
        say(&mut client, &DeviceMessage::Welcome(welcome));
        for first in (0..40).step_by(4).filter(|first| !(8..20).contains(first)) {
            let samples = (first..first + 4).map(|k| sample(1_000 + k)).collect();
            say(
                &mut client,
                &DeviceMessage::Telemetry {
                    sequence: first,
                    samples,
                },
            );
        }
        let status = Status {
            mode: Mode::DrivesOff,
            fault: None,
            recovering: false,
            interlock: None,
            port: Default::default(),
            waiting_for: None,
            referenced: false,
            reference_lost: false,
            increments: [None; 4],
            config: None,
            override_percent: 100,
            counters: Default::default(),
            slaves: Default::default(),
            io: Default::default(),
        };
        say(&mut client, &DeviceMessage::Status(status));
    }
}

#[test]
fn a_machine_is_listened_to_until_ctrl_c_and_its_gaps_are_stored() {
    let folder = Folder::new();
    let recording = folder.join("r.mcap");
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = format!("tcp:{}", listener.local_addr().expect("an address"));
    let machine = std::thread::spawn(move || firmware(&listener));
    let mut command = etherpen(&folder);
    let mut recorder = Running::start(
        command
            .args(["record", "--json", "--port", &port, "-o"])
            .arg(&recording),
    );
    // The samples received are in the file a second later, without its regular end.
    wait_until("samples in the file", || {
        let (status, stdout, _) = run(etherpen(&folder).arg("stats").arg(&recording).arg("--json"));
        let figures: Option<serde_json::Value> = serde_json::from_str(&stdout).ok();
        status == Some(0) && figures.is_some_and(|figures| figures["samples"] == 28)
    });
    let id = Pid::from_raw(recorder.id() as i32).expect("a process");
    kill_process(id, Signal::INT).expect("it runs");
    assert!(recorder.end().success(), "{}", recorder.stderr());
    machine.join().expect("the firmware ends with the connection");
    let figures = figures(&folder, &recording);
    let counts = ["samples", "missing", "gaps", "complete"].map(|name| figures[name].clone());
    let expected: [serde_json::Value; 4] = [28.into(), 12.into(), 1.into(), true.into()];
    assert_eq!(counts, expected, "{figures}");
    let plot = etherpen(&folder)
        .arg("plot")
        .arg(&recording)
        .args(["--signals", "q1_rad", "-o", "gap.svg"])
        .output();
    assert!(plot.is_ok_and(|output| output.status.success()));
    let svg = fs::read_to_string(folder.join("gap.svg")).expect("a picture");
    assert!(
        svg.contains("samples are missing") && svg.matches("<polyline").count() == 3,
        "{svg}"
    );
}

#[test]
fn a_long_recording_takes_no_more_memory_than_a_short_one_and_loses_nothing() {
    let folder = Folder::new();
    let (status, stdout, stderr) = run(etherpen(&folder).args(["bench", "recording", "--hours", "0.1", "--json"]));
    assert_eq!(status, Some(0), "{stderr}");
    let report: serde_json::Value = serde_json::from_str(&stdout).expect("JSON");
    let rows = report["rows"].as_array().expect("rows");
    for row in rows {
        eprintln!("{}: {} {}", row["case"], row["value"], row["unit"]);
        if let Some(target) = row["target"].as_f64() {
            assert!(row["value"].as_f64().is_some_and(|value| value <= target), "{row}");
        }
    }
    assert!(rows.len() >= 6);
}
