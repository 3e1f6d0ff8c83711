//! The segment in a separate process, and this project's master on it: sockets, captures, messages.

use crate::program::{Folder, Running, etherpen, run};
use etherpen::config::Config;
use etherpen::robot_bus::RobotBusSetup;
use etherpen_segment::transport::{self, Endpoint, udp_address};
use host_tools::error::code;
use host_tools::master::Master;
use host_tools::setup;
use rustix::process::{Pid, Signal, kill_process};
use std::io::{Read, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

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

    /// Types a command at the prompt and waits for the next line of stdout that begins so.
    fn answer(&mut self, command: &str, begins: &str) -> String {
        let before = self.running.stdout().lines().count();
        self.running.type_line(command);
        self.running.wait_for(command, |running| {
            let stdout = running.stdout();
            let mut lines = stdout.lines().skip(before);
            lines
                .find(|line| line.trim_start().starts_with(begins))
                .map(str::to_owned)
        })
    }
}

/// Sends a command to a control socket; the exit code and the answer.
pub(crate) fn tell(folder: &Folder, socket: &Path, command: &str) -> (Option<i32>, serde_json::Value, String) {
    let mut program = etherpen(folder);
    program
        .args(["segment", "--json", "--tell"])
        .arg(socket)
        .args(command.split_whitespace());
    let (status, stdout, stderr) = run(&mut program);
    (status, serde_json::from_str(&stdout).unwrap_or_default(), stderr)
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

/// Chain of the tests of commands: a junction with a terminal on one branch and a drive on the other.
const TREE: &str = "ek1100,el1008@name=door,ek1122(3:el2004@name=lamp)(cia402@name=arm)";

#[test]
fn the_prompt_sets_inputs_reads_outputs_and_says_what_it_does_not_understand() {
    let folder = Folder::new();
    let place = folder.join("segment.sock");
    let mut command = etherpen(&folder);
    command
        .args(["segment", "--slaves", TREE, "--unix"])
        .arg(&place)
        .stdin(Stdio::piped());
    let mut segment = Segment::start(&mut command);
    assert!(segment.answer("set door 0x81", "2 el1008").ends_with("in 81"));
    assert_eq!(segment.answer("get door.8", "1"), "1");
    assert_eq!(segment.answer("get door.1:8", "129"), "129");
    let listed = segment.answer("list", "5 cia402");
    assert!(listed.contains("INIT") && listed.contains("rad"), "{listed}");
    assert!(segment.answer("gte door", "no such command").contains("'gte'"));
    assert!(segment.answer("set lamp.1 1", "slave 4").contains("no inputs"));
    assert!(segment.answer("set door.9 1", "slave 2").contains("8 bits"));
    segment.answer("unplug lamp", "the cable to slave 4 is pulled");
    segment
        .running
        .wait_for("the pulled cable", |_| (scan(&folder, &place).len() == 4).then_some(()));
    segment.answer("plug lamp", "the cable to slave 4 is plugged in");
    segment
        .running
        .wait_for("the cable", |_| (scan(&folder, &place).len() == 5).then_some(()));
    segment.running.type_line("quit");
    assert_eq!(segment.running.end().code(), Some(0));
}

/// The slaves that this project's bus tool finds.
fn scan(folder: &Folder, place: &Path) -> Vec<serde_json::Value> {
    let (status, stdout, stderr) = run(etherpen(folder).args(["bus", "scan", "--json", "--unix"]).arg(place));
    assert_eq!(status, Some(0), "{stderr}");
    let found: serde_json::Value = serde_json::from_str(&stdout).expect("JSON");
    let slaves = found.as_array().or(found["slaves"].as_array()).expect("a list");
    slaves.clone()
}

#[test]
fn programs_give_commands_at_the_control_socket_and_the_bus_tool_sees_them() {
    let folder = Folder::new();
    let (place, socket) = (folder.join("segment.sock"), folder.join("control.sock"));
    let mut command = etherpen(&folder);
    command
        .args(["segment", "--slaves", TREE, "--control"])
        .arg(&socket)
        .arg("--unix")
        .arg(&place);
    let mut segment = Segment::start(&mut command);
    let told = |command: &str| tell(&folder, &socket, command);
    let (status, answer, _) = told("set door.in.3:2 2");
    assert_eq!(
        (status, &answer["inputs"], &answer["name"]),
        (Some(0), &"08".into(), &"door".into())
    );
    // The terminal shows its inputs in every state, as its silicon does.
    let read = ["bus", "registers", "2", "1000", "1", "--json", "--unix"];
    let (status, stdout, stderr) = run(etherpen(&folder).args(read).arg(&place));
    assert_eq!(status, Some(0), "{stderr}");
    assert!(stdout.contains("\"08\""), "{stdout}");
    let (_, list, _) = told("list");
    assert_eq!(list["slaves"].as_array().map(Vec::len), Some(5));
    assert_eq!(
        (&list["ok"], &list["slaves"][4]["kind"]),
        (&true.into(), &"cia402".into())
    );
    assert!(list["frames"].as_u64() > Some(0) && list["paused_ms"].is_u64() && list["travel_ns"].is_u64());
    let (status, _, stderr) = told("fault power arm");
    assert_eq!(status, Some(i32::from(code::FAILED)));
    assert!(stderr.contains("a number is missing"), "{stderr}");
    let (status, answer, _) = told("fault power arm 60000");
    assert_eq!((status, &answer["fault"]), (Some(0), &"power".into()));
    segment.running.wait_for("the power to go", |_| {
        (told("get arm").1["powered"] == false).then_some(())
    });
    assert_eq!(told("list").1["faults"]["power"], 1);
    assert_eq!(scan(&folder, &place).len(), 4);
    let (status, _, stderr) = told("get nothing");
    assert!(
        status == Some(i32::from(code::FAILED)) && stderr.contains("'nothing'"),
        "{stderr}"
    );
    assert_eq!(told("quit").0, Some(0));
    assert_eq!(segment.running.end().code(), Some(0));
    assert!(!socket.exists() && !place.exists(), "the sockets are removed");
    assert_eq!(told("list").0, Some(i32::from(code::CONNECTION)));
}

#[test]
fn several_commands_in_one_write_have_an_answer_each_in_order() {
    let folder = Folder::new();
    let (place, socket) = (folder.join("segment.sock"), folder.join("control.sock"));
    let mut command = etherpen(&folder);
    command
        .args(["segment", "--slaves", "el1008", "--control"])
        .arg(&socket)
        .arg("--unix")
        .arg(&place);
    let segment = Segment::start(&mut command);
    let mut stream = UnixStream::connect(&socket).expect("it listens");
    let lines: Vec<String> = (0..200)
        .map(|value| format!("set 1.1:8 {value}\n# nothing\n\n"))
        .collect();
    stream.write_all(lines.concat().as_bytes()).expect("it reads");
    stream.shutdown(Shutdown::Write).expect("a socket");
    let mut answers = String::new();
    stream.read_to_string(&mut answers).expect("it answers and closes");
    let inputs: Vec<String> = answers
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).expect("JSON")["inputs"].to_string())
        .collect();
    let expected: Vec<String> = (0..200).map(|value| format!("\"{value:02x}\"")).collect();
    assert_eq!(inputs, expected);
    let (status, _, stderr) = run(etherpen(&folder)
        .args(["segment", "--control"])
        .arg(&socket)
        .arg("--unix")
        .arg(folder.join("other.sock")));
    assert_eq!(status, Some(i32::from(code::CONNECTION)));
    assert!(stderr.contains("taken"), "{stderr}");
    segment.end();
}

#[test]
fn a_stopped_process_stops_the_segments_time_and_says_so() {
    let folder = Folder::new();
    let (place, socket) = (folder.join("segment.sock"), folder.join("control.sock"));
    let mut command = etherpen(&folder);
    command
        .args(["segment", "--slaves", "el1008", "--control"])
        .arg(&socket)
        .arg("--unix")
        .arg(&place);
    let segment = Segment::start(&mut command);
    let id = Pid::from_raw(i32::try_from(segment.running.id()).expect("a process")).expect("a process");
    let times = || {
        let (_, list, _) = tell(&folder, &socket, "list");
        (
            list["time_ms"].as_u64().expect("ms"),
            list["paused_ms"].as_u64().expect("ms"),
        )
    };
    let before = times();
    kill_process(id, Signal::STOP).expect("it runs");
    std::thread::sleep(Duration::from_millis(1_500));
    kill_process(id, Signal::CONT).expect("it is stopped");
    let after = times();
    assert!(after.1 - before.1 >= 1_400, "{before:?} {after:?}");
    assert!(
        segment.stderr().contains("the segment stood still"),
        "{}",
        segment.stderr()
    );
    segment.end();
}

#[test]
fn a_capture_has_the_times_of_this_computer() {
    let folder = Folder::new();
    let (place, capture) = (folder.join("segment.sock"), folder.join("bus.pcapng"));
    let mut command = etherpen(&folder);
    command
        .args(["segment", "--slaves", "el1008", "--unix"])
        .arg(&place)
        .arg("--pcap")
        .arg(&capture);
    let now_s = || {
        SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .expect("after 1970")
            .as_secs_f64()
    };
    let segment = Segment::start(&mut command);
    let begun_s = now_s();
    scan(&folder, &place);
    let ended_s = now_s();
    segment.end();
    let bytes = std::fs::read(&capture).expect("a capture");
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
    let (mut at, mut times_s) = (0, Vec::new());
    while at < bytes.len() {
        if word(at) == 6 {
            let time_ns = u64::from(word(at + 12)) << 32 | u64::from(word(at + 16));
            times_s.push(time_ns as f64 / 1e9);
        }
        at += word(at + 4) as usize;
    }
    assert!(times_s.len() > 20 && times_s.is_sorted(), "{} frames", times_s.len());
    let (first, last) = (times_s[0], times_s[times_s.len() - 1]);
    assert!(
        begun_s <= first && last <= ended_s,
        "{begun_s} {first} {last} {ended_s}"
    );
}

#[test]
fn a_slave_information_file_makes_a_slave_with_its_dictionary() {
    let folder = Folder::new();
    let place = folder.join("segment.sock");
    let description = folder.file("mixed.xml", include_str!("mixed_terminal.xml"));
    let list = format!("ek1100,esi:{}#IO-1", description.display());
    let mut command = etherpen(&folder);
    command.args(["segment", "--slaves", &list, "--unix"]).arg(&place);
    let segment = Segment::start(&mut command);
    let bus = |words: &[&str]| {
        let (status, stdout, stderr) = run(etherpen(&folder).arg("bus").args(words).arg("--unix").arg(&place));
        assert_eq!(status, Some(0), "{words:?}: {stderr}");
        stdout
    };
    assert!(bus(&["scan"]).contains("Mixed terminal"));
    bus(&["state", "2", "preop"]);
    assert!(bus(&["sdo", "read", "2", "2000:0"]).contains("-5"));
    bus(&["sdo", "write", "2", "2000:0", "17", "--type", "i16"]);
    assert!(bus(&["sdo", "read", "2", "2000:0"]).contains("17"));
    let objects = bus(&["sdo", "list", "2", "--entries"]);
    assert!(objects.contains("8000") && objects.contains("Settings"), "{objects}");
    segment.end();
    let list = format!("esi:{}#IO-9", description.display());
    let (status, _, stderr) = run(etherpen(&folder)
        .args(["segment", "--slaves", &list, "--unix"])
        .arg(&place));
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(stderr.contains("IO-1 (0x00000100:0x00020000)"), "{stderr}");
}
