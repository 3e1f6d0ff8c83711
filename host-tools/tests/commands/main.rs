//! The command line as a user runs it: outputs, messages and exit codes.
//!
//! The commands that need no emulator are tested here, the others in `emulator`.

mod bus;
mod bus_end_to_end;
// The tests there read the state of processes from /proc.
mod bench;
mod blackbox;
mod board;
mod calibration;
mod configuration;
mod dead_man;
mod dimensions;
mod drawing;
#[cfg(target_os = "linux")]
mod emulator;
mod ethercrab;
mod examples_on_a_cable;
mod files;
mod followed;
mod installed;
mod io;
mod kickcat;
#[cfg(target_os = "linux")]
mod layers;
#[cfg(target_os = "linux")]
mod machines;
mod network;
mod other_masters;
mod outputs;
#[cfg(target_os = "linux")]
mod outside;
mod paper;
mod pictures;
mod plan;
mod points;
mod program;
mod pysoem;
mod recording;
mod resonance;
#[cfg(target_os = "linux")]
mod restarted;
mod segment;
mod segment_docs;
#[cfg(target_os = "linux")]
mod sessions;
mod unreferenced;

use etherpen::board::PreviousRun;
use etherpen::link::frame::{Decoder, FRAME_BYTES_MAX, PAYLOAD_BYTES_MAX, decode, encode};
use etherpen::messages::{DeviceMessage, HostMessage, PROTOCOL_VERSION, Welcome};
use host_tools::error::code;
use host_tools::setup;
use program::{Folder, etherpen, run, strokes};
use std::fs;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::process::Command;

const FILES: [&str; 8] = [
    "drawn.png",
    "drawn.svg",
    "report.json",
    "telemetry.csv",
    "telemetry.mcap",
    "tracking.svg",
    "intended.csv",
    "bus.pcapng",
];
const KEYS: [&str; 28] = [
    "strokes",
    "followed_mm",
    "not_followed_mm",
    "not_verified_mm",
    "strokes_not_followed",
    "pen_down_mm",
    "pen_up_mm",
    "planned_s",
    "drawn_s",
    "path_deviation_max_mm",
    "path_deviation_rms_mm",
    "ink_deviation_max_mm",
    "ink_deviation_rms_mm",
    "shaping_deviation_max_mm",
    "shaping_tolerance_mm",
    "tracking_error_max_mm",
    "tracking_error_rms_mm",
    "ink_missing_mm",
    "following_error_max_rad",
    "limits",
    "platform",
    "cycles",
    "cycles_late",
    "frames_lost",
    "working_counter_errors",
    "reference_underruns",
    "image",
    "drives",
];
const TELEMETRY: &str = "t_ms,mode,stroke,pen,x_mm,y_mm,z_mm,\
    q1_ref_rad,q1_rad,v1_ref_rad_s,v1_rad_s,q2_ref_rad,q2_rad,v2_ref_rad_s,v2_rad_s,\
    q3_ref_rad,q3_rad,v3_ref_rad_s,v3_rad_s,q4_ref_rad,q4_rad,v4_ref_rad_s,v4_rad_s";
const INTENDED: &str = "stroke,x_mm,y_mm,z_mm";

/// Nothing listens on this port of the loopback interface.
const NOBODY: &str = "tcp:127.0.0.1:1";

#[test]
fn a_simulation_leaves_what_the_contract_names() {
    let folder = Folder::new();
    let out = folder.join("out");
    fs::create_dir(&out).expect("the folder may exist already");
    let mut command = etherpen(&folder);
    command
        .arg("simulate")
        .arg(strokes())
        .arg("--out")
        .arg(&out)
        .arg("--json");
    let (status, stdout, stderr) = run(&mut command);
    assert_eq!(status, Some(0), "{stderr}");

    let report: serde_json::Value = serde_json::from_str(&stdout).expect("one JSON document and nothing else");
    for key in KEYS {
        assert!(!report[key].is_null(), "{key} is missing in {stdout}");
    }
    assert_eq!(report["strokes"], 6);
    assert_eq!(report["image"], "simulation");
    for axis in 0..4 {
        assert!(report["following_error_max_rad"][axis].is_f64() && report["limits"][axis].is_object());
    }

    for name in FILES {
        let size = fs::metadata(out.join(name)).map_or(0, |file| file.len());
        assert!(size > 0, "{name} is missing or empty");
    }
    let read = |name: &str| fs::read_to_string(out.join(name)).expect("a text");
    let written: serde_json::Value = serde_json::from_str(&read("report.json")).expect("JSON");
    assert_eq!(written, report);
    for (name, heading) in [("telemetry.csv", TELEMETRY), ("intended.csv", INTENDED)] {
        let text = read(name);
        let columns = heading.split(',').count();
        assert_eq!(text.lines().next(), Some(heading));
        assert!(text.lines().count() > 100);
        assert!(text.lines().all(|line| line.split(',').count() == columns), "{name}");
    }
    assert!(read("drawn.svg").contains("<svg"));
    image::open(out.join("drawn.png")).expect("a picture");
    the_capture_is_sound(&out.join("bus.pcapng"));
}

/// An independent program reads EtherCAT frames in both directions and finds none of them malformed.
fn the_capture_is_sound(capture: &std::path::Path) {
    if setup::ensure_program("tshark").is_err() {
        eprintln!("tshark is not installed: the capture is not looked at");
        return;
    }
    let count = |filter: &str| {
        let mut command = Command::new("tshark");
        command
            .arg("-r")
            .arg(capture)
            .args(["-Y", filter, "-T", "fields", "-e", "frame.number"]);
        let output = command.output().expect("tshark starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        output.stdout.iter().filter(|byte| **byte == b'\n').count()
    };
    let frames = count("ecat");
    // An input and an output telegram and their replies in each millisecond.
    assert!(frames > 4 * 3_000, "{frames} EtherCAT frames");
    assert_eq!(count("not ecat"), 0);
    assert_eq!(count("_ws.malformed || _ws.expert.severity == error"), 0);
}

#[test]
fn a_file_that_cannot_be_drawn_is_named_with_what_to_try_and_nothing_is_written() {
    let folder = Folder::new();
    let cases = [
        (folder.file("notes.png", "no picture"), "PNG or JPEG"),
        (folder.file("notes.txt", "no picture"), "PNG or JPEG"),
        (folder.file("cut.png", b"\x89PNG\r\n\x1a\n"), "copy or export it again"),
        (folder.file("empty.csv", ""), "empty"),
        (folder.join("absent.jpg"), "check the path"),
        (folder.file("heading.csv", "x,y\n1,1\n"), "x_mm,y_mm,pen"),
        (folder.file("word.csv", "x_mm,y_mm,pen\n1,1,0\n1,one,1\n"), "line 3"),
        (folder.file("up.csv", "x_mm,y_mm,pen\n1,1,0\n"), "pen 1"),
        (
            folder.file("far.csv", "x_mm,y_mm,z_mm,pen\n0,0,-850,0\n600,0,-850,1\n"),
            "work area",
        ),
    ];
    let out = folder.join("out");
    // Neither a connection nor a tool is tried before the file is known to be valid.
    let nowhere = folder.join("nowhere");
    for (file, hint) in &cases {
        let name = file.file_name().and_then(|name| name.to_str()).expect("a name");
        let commands: [&[&str]; 3] = [&["simulate"], &["draw", "--port", NOBODY], &["demo", "--photo"]];
        for words in commands {
            let mut command = etherpen(&folder);
            command
                .args(words)
                .arg(file)
                .arg("--out")
                .arg(&out)
                .arg("--json")
                .env("PATH", &nowhere);
            let (status, stdout, stderr) = run(&mut command);
            assert_eq!(status, Some(i32::from(code::INPUT)), "{words:?} {name}: {stderr}");
            assert!(
                stderr.contains(name) && stderr.contains(hint),
                "{words:?} {name}: {stderr}"
            );
            assert!(stdout.is_empty() && !out.exists(), "{words:?} {name}: {stdout}");
        }
    }
}

#[test]
fn a_configuration_that_cannot_be_used_is_named_with_the_place_in_it() {
    let folder = Folder::new();
    let cases: [(&str, &[&str]); 4] = [
        ("[motion]\nspeed_mm_per_s = 100.0\n", &["speed_mm_per_s", "speed_mm_s"]),
        (
            "[motion]\nspeed_mm_s = 20000.0\n",
            &["motion.speed_mm_s", "20000", "1 to 10000"],
        ),
        ("[motion\n", &["line 1"]),
        ("[motion]\nspeed_mm_s = \"fast\"\n", &["line 2"]),
    ];
    let out = folder.join("out");
    for (text, hints) in cases {
        let config = folder.file("robot.toml", text);
        let mut command = etherpen(&folder);
        command
            .arg("simulate")
            .arg(strokes())
            .arg("--config")
            .arg(&config)
            .arg("--out")
            .arg(&out);
        let (status, _, stderr) = run(&mut command);
        assert_eq!(status, Some(i32::from(code::USAGE)), "{stderr}");
        assert!(
            hints.iter().chain(&["robot.toml"]).all(|hint| stderr.contains(hint)),
            "{stderr}"
        );
        assert!(!out.exists());
    }
    // The file with this name in the current folder is used without an option.
    folder.file("etherpen.toml", cases[1].0);
    let (status, _, stderr) = run(etherpen(&folder).arg("simulate").arg(strokes()));
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(stderr.contains("etherpen.toml") && stderr.contains("20000"), "{stderr}");
}

#[test]
fn a_missing_emulator_is_answered_with_the_command_that_installs_it() {
    let folder = Folder::new();
    let photo = strokes();
    let out = folder.join("out");
    for words in [&["emulate"][..], &["demo", "--photo", &photo.to_string_lossy()]] {
        let mut command = etherpen(&folder);
        command.args(words).env("PATH", folder.join("nowhere"));
        if words.len() > 1 {
            command.arg("--out").arg(&out);
        }
        let (status, stdout, stderr) = run(&mut command);
        assert_eq!(status, Some(i32::from(code::TOOL)), "{stderr}");
        let by_hand = "sudo apt-get install -y --no-install-recommends qemu-system-arm";
        assert!(
            stderr.contains("qemu-system-arm is needed") && stderr.contains(by_hand),
            "{stderr}"
        );
        assert!(stdout.is_empty() && !out.exists());
    }
}

#[test]
fn a_port_without_firmware_is_named_with_what_to_try() {
    let folder = Folder::new();
    let draw = |port: &str| run(etherpen(&folder).arg("draw").arg(strokes()).args(["--port", port]));
    let (status, _, stderr) = draw(NOBODY);
    assert_eq!(status, Some(i32::from(code::CONNECTION)), "{stderr}");
    assert!(
        stderr.contains(NOBODY) && stderr.contains("etherpen emulate"),
        "{stderr}"
    );
    let (status, _, stderr) = draw("/dev/etherpen-absent");
    assert_eq!(status, Some(i32::from(code::CONNECTION)), "{stderr}");
    assert!(
        stderr.contains("/dev/etherpen-absent") && stderr.contains("plug in"),
        "{stderr}"
    );
    let (status, _, stderr) = draw("tcp:7000");
    assert_eq!(status, Some(i32::from(code::USAGE)), "{stderr}");
    assert!(stderr.contains("tcp:host:port"), "{stderr}");
}

/// A firmware that answers one greeting as its own version would.
fn other_version(listener: &TcpListener, protocol: u16) {
    let (mut client, _) = listener.accept().expect("the program connects");
    let mut decoder = Decoder::<PAYLOAD_BYTES_MAX>::new();
    let mut byte = [0];
    while client.read(&mut byte).is_ok_and(|length| length > 0) {
        let Some(Ok(payload)) = decoder.push(byte[0]) else {
            continue;
        };
        let Ok(HostMessage::Hello(hello)) = decode(payload) else {
            panic!("a program greets first")
        };
        let welcome = DeviceMessage::Welcome(Welcome {
            protocol,
            session: hello.session,
            firmware: "9.9.9".try_into().expect("short"),
            board: "emulated".try_into().expect("short"),
            config: None,
            capacity: 64,
            previous: PreviousRun::default(),
        });
        let mut frame = [0; FRAME_BYTES_MAX];
        let length = encode(&welcome, &mut frame).expect("it fits");
        client.write_all(&frame[..length]).expect("the program reads");
        break;
    }
    // The program hangs up.
    let _ = client.read_to_end(&mut Vec::new());
}

#[test]
fn a_firmware_of_another_protocol_version_is_refused_with_both_versions() {
    let folder = Folder::new();
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = format!("tcp:{}", listener.local_addr().expect("an address"));
    let other = PROTOCOL_VERSION + 41;
    let firmware = std::thread::spawn(move || other_version(&listener, other));
    let out = folder.join("out");
    let mut command = etherpen(&folder);
    command
        .arg("draw")
        .arg(strokes())
        .args(["--port", &port])
        .arg("--out")
        .arg(&out);
    let (status, _, stderr) = run(&mut command);
    assert_eq!(status, Some(i32::from(code::VERSION)), "{stderr}");
    for version in [PROTOCOL_VERSION, other] {
        assert!(stderr.contains(&format!("version {version}")), "{stderr}");
    }
    firmware.join().expect("the firmware ends with the connection");
    let written = fs::read_dir(&out).map_or(0, |names| names.count());
    assert_eq!(written, 0, "a drawing that never began leaves no tables");
}
