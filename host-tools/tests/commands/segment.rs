//! The segment in a separate process, and this project's master on it: sockets, captures, messages.

use crate::program::{Folder, Running, etherpen, run};
use etherpen::config::Config;
use etherpen::robot_bus::RobotBusSetup;
use etherpen_segment::transport::{self, Endpoint, udp_address};
use host_tools::error::code;
use host_tools::master::Master;
use host_tools::setup;
use rustix::process::{Pid, Signal, kill_process};
use std::path::Path;
use std::process::Command;
use std::time::Duration;

/// Longest wait for a bring-up; even a very busy machine needs less.
const PATIENCE: Duration = Duration::from_secs(120);

/// A running segment, and its address.
pub(crate) struct Segment {
    running: Running,
    pub(crate) endpoint: String,
}

impl Segment {
    /// Starts a segment and waits until it listens.
    pub(crate) fn start(command: &mut Command) -> Self {
        let mut running = Running::start(command);
        let endpoint = running.wait_for("segment", |running| {
            let (stdout, stderr) = (running.stdout(), running.stderr());
            let lines = stdout.lines().chain(stderr.lines());
            let ways = ["interface:", "udp:", "unix:"];
            let mut found = lines.filter(|line| ways.iter().any(|way| line.starts_with(way)));
            found.next().map(str::to_owned)
        });
        Self { running, endpoint }
    }

    /// Its address, without the kind.
    pub(crate) fn place(&self) -> &str {
        self.endpoint.split_once(':').map_or("", |(_, place)| place)
    }

    /// Ends the segment as Ctrl-C does; returns its stdout.
    pub(crate) fn end(mut self) -> String {
        let id = i32::try_from(self.running.id()).ok().and_then(Pid::from_raw);
        kill_process(id.expect("a process"), Signal::INT).expect("it runs");
        let status = self.running.end();
        assert_eq!(status.code(), Some(0), "{}", self.running.stderr());
        self.running.stdout()
    }

    pub(crate) fn stderr(&self) -> String {
        self.running.stderr()
    }
}

/// Brings the four drives of a segment to OP with this project's master; returns the number of frames sent.
fn bring_up(endpoint: &Endpoint) -> u32 {
    let config = Config::default();
    let setup = RobotBusSetup {
        watchdog_ms: 1_000,
        ..config.bus_setup()
    };
    let transport = transport::open(endpoint).expect("the segment listens");
    let master = Master::start(transport, setup, PATIENCE).expect("four drives are there");
    master.counters().frames_sent
}

/// An independent program finds EtherCAT and mailboxes in every frame of a capture, and no malformed frame.
pub(crate) fn the_capture_is_sound(capture: &Path, over: &str) {
    if setup::ensure_program("tshark").is_err() {
        eprintln!("tshark is not installed: the capture is not looked at");
        return;
    }
    let count = |filter: &str| {
        let mut command = Command::new("tshark");
        let command = command.arg("-r").arg(capture).args(["-Y", filter]);
        let output = command
            .args(["-T", "fields", "-e", "frame.number"])
            .output()
            .expect("tshark starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        output.stdout.iter().filter(|byte| **byte == b'\n').count()
    };
    let frames = count(&format!("ecat && {over}"));
    println!("{frames} frames, {} with a mailbox", count("ecat_mailbox"));
    assert!(frames > 200 && count("ecat_mailbox.coe") > 20, "{frames} frames");
    assert_eq!(count(&format!("!(ecat && {over})")), 0);
    assert_eq!(count("_ws.malformed || _ws.expert.severity == error"), 0);
}

/// Keys of the summary, and of a slave in it.
const SUMMARY: [&str; 6] = ["listens", "seconds", "frames", "replies", "ignored", "slaves"];

#[test]
fn a_whole_bring_up_over_a_unix_socket_is_told_and_captured() {
    let folder = Folder::new();
    let (place, capture) = (folder.join("segment.sock"), folder.join("bus.pcapng"));
    let mut command = etherpen(&folder);
    command
        .arg("segment")
        .arg("--unix")
        .arg(&place)
        .arg("--json")
        .arg("--pcap")
        .arg(&capture);
    let segment = Segment::start(&mut command);
    let sent = bring_up(&Endpoint::Unix(place.clone()));
    assert!(segment.stderr().contains("first frame"), "{}", segment.stderr());
    let summary: serde_json::Value = serde_json::from_str(&segment.end()).expect("JSON");
    println!("{sent} frames sent, {} seen", summary["frames"]);
    assert!(SUMMARY.iter().all(|key| summary.get(key).is_some()), "{summary}");
    assert!(summary["frames"].as_u64() >= Some(u64::from(sent)), "{summary}");
    assert_eq!(summary["frames"], summary["replies"]);
    let slaves = summary["slaves"].as_array().expect("a list");
    assert_eq!((slaves.len(), &slaves[3]["slave"]), (4, &4.into()));
    the_capture_is_sound(&capture, "eth.type == 0x88a4");
    assert!(!place.exists(), "the socket is removed");
}

#[test]
fn a_whole_bring_up_in_udp_is_captured_with_all_headers() {
    let folder = Folder::new();
    let capture = folder.join("bus.pcapng");
    let mut command = etherpen(&folder);
    command
        .args(["segment", "--udp", "127.0.0.1:0", "--pcap"])
        .arg(&capture);
    let segment = Segment::start(&mut command);
    let address = udp_address(segment.place()).expect("it prints an address");
    bring_up(&Endpoint::Udp(address));
    segment.end();
    the_capture_is_sound(&capture, "udp.port == 34980");
}

#[test]
fn a_place_that_is_taken_is_named_and_left_alone() {
    let folder = Folder::new();
    let place = folder.join("segment.sock");
    let command = || {
        let mut command = etherpen(&folder);
        command.arg("segment").arg("--unix").arg(&place);
        command
    };
    let first = Segment::start(&mut command());
    let (status, stdout, stderr) = run(&mut command());
    assert_eq!(status, Some(i32::from(code::CONNECTION)), "{stderr}");
    assert!(
        stderr.contains("another program listens") && stdout.is_empty(),
        "{stderr}"
    );
    bring_up(&Endpoint::Unix(place.clone()));
    first.end();
    let udp = Segment::start(etherpen(&folder).args(["segment", "--udp", "127.0.0.1:0"]));
    let (status, _, stderr) = run(etherpen(&folder).args(["segment", "--udp", udp.place()]));
    assert_eq!(status, Some(i32::from(code::CONNECTION)), "{stderr}");
    assert!(stderr.contains("taken by another program"), "{stderr}");
    udp.end();
}

#[test]
fn a_missing_interface_and_a_missing_way_are_answered_with_what_there_is() {
    let folder = Folder::new();
    for words in [&["segment"][..], &["bus", "scan"]] {
        let (status, _, stderr) = run(etherpen(&folder).args(words).args(["--interface", "absent0"]));
        assert_eq!(status, Some(i32::from(code::CONNECTION)), "{stderr}");
        assert!(stderr.contains("absent0") && stderr.contains("there are"), "{stderr}");
        let (status, _, stderr) = run(etherpen(&folder).args(words));
        assert_eq!(status, Some(i32::from(code::USAGE)), "{stderr}");
        assert!(stderr.contains("--interface") && stderr.contains("--udp"), "{stderr}");
    }
}

#[test]
fn a_missing_right_is_answered_with_the_command_that_gives_it() {
    let folder = Folder::new();
    let program = etherpen(&folder);
    let mut command = if rustix::process::geteuid().is_root() {
        let mut command = Command::new("setpriv");
        command.args(["--inh-caps=-net_raw", "--bounding-set=-net_raw"]);
        command.arg(program.get_program());
        command
    } else {
        program
    };
    let (status, stdout, stderr) = run(command.args(["segment", "--interface", "lo"]));
    assert_eq!(status, Some(i32::from(code::CONNECTION)), "{stderr}");
    let remedy = format!("sudo setcap cap_net_raw+ep {}", env!("CARGO_BIN_EXE_etherpen"));
    assert!(
        stderr.contains(&remedy) && stderr.contains("root") && stdout.is_empty(),
        "{stderr}"
    );
}

#[test]
fn a_list_of_slaves_makes_the_chain_and_a_wrong_word_is_named() {
    let folder = Folder::new();
    let place = folder.join("segment.sock");
    let words = ["segment", "--json", "--slaves", "ek1100,cia402,ax2000*2", "--unix"];
    let segment = Segment::start(etherpen(&folder).args(words).arg(&place));
    let summary: serde_json::Value = serde_json::from_str(&segment.end()).expect("JSON");
    let slaves = summary["slaves"].as_array().expect("a list");
    let kinds: Vec<_> = slaves.iter().filter_map(|slave| slave["kind"].as_str()).collect();
    assert_eq!(kinds, ["ek1100", "cia402", "ax2000", "ax2000"]);
    assert!(slaves[0]["drive"].is_null() && slaves[1]["drive"].is_string());
    let (status, _, stderr) = run(etherpen(&folder)
        .args(["segment", "--slaves", "ax200", "--unix"])
        .arg(&place));
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(stderr.contains("'ax200'") && stderr.contains("ek1100"), "{stderr}");
}
