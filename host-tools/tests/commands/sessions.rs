//! One robot or several, controlled from other terminals: without `--port` if there is one, with a list if there are
//! several; and drawings resumed from the job log.

use crate::program::{Folder, PATIENCE, Running, etherpen, run, strokes, wait_until};
use etherpen::config::Config;
use host_tools::cell::{CellOptions, DriveState, InkStroke};
use host_tools::console::virtual_cell::{Firmware, VirtualCell};
use host_tools::error::code;
use std::fs;
use std::net::TcpStream;
use std::process::Command;
use tungstenite::client::IntoClientRequest;

type Json = serde_json::Value;

fn cell() -> VirtualCell {
    VirtualCell::start(&Config::default(), CellOptions::default(), Firmware::Simulated).expect("the cell starts")
}

/// State of the connection to the robot, as sent to a viewer of the page.
struct Page(tungstenite::WebSocket<TcpStream>);

impl Page {
    /// Opens the page at the address that a console prints.
    fn open(url: &str) -> Self {
        let address = url
            .strip_prefix("http://")
            .and_then(|rest| rest.split_once("/#"))
            .expect("an address")
            .0;
        let stream = TcpStream::connect(address).expect("the console listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
        let mut request = format!("ws://{address}/socket")
            .into_client_request()
            .expect("an address");
        request
            .headers_mut()
            .insert("Origin", format!("http://{address}").parse().expect("an origin"));
        let mut socket = tungstenite::client(request, stream).expect("a viewer is let in").0;
        let hello = serde_json::json!({"type": "hello", "token": "none", "page": "sessions"}).to_string();
        socket
            .send(tungstenite::Message::text(hello))
            .expect("a viewer may look");
        Self(socket)
    }

    /// Waits until the connection is in this state; returns its text.
    fn link(&mut self, state: &str) -> String {
        loop {
            let tungstenite::Message::Text(text) = self.0.read().expect("the console says something") else {
                continue;
            };
            let message: Json = serde_json::from_str(&text).expect("JSON");
            if message["section"] == "link" && message["data"]["state"] == state {
                return message["data"]["text"].as_str().expect("a text").to_owned();
            }
        }
    }
}

/// A program that has the cell's port and shares it.
fn recorder(folder: &Folder, cell: &VirtualCell, file: &str) -> Running {
    let mut command = etherpen(folder);
    let mut recorder = Running::start(command.args(["record", "-o", file, "--port", &cell.port().to_string()]));
    recorder.wait_for("connection", |recorder| {
        recorder.stderr().contains("connected:").then_some(())
    });
    recorder
}

fn json(command: &mut Command) -> Json {
    let (status, stdout, stderr) = run(command);
    assert_eq!(status, Some(0), "{stderr}");
    serde_json::from_str(&stdout).unwrap_or_else(|cause| panic!("{cause}: {stdout}"))
}

#[test]
fn the_one_robot_in_use_needs_no_port_and_several_are_listed_and_stopped_together() {
    let folder = Folder::new();
    let told = |words: &[&str]| run(etherpen(&folder).args(words));
    let (status, _, stderr) = told(&["stop"]);
    assert_eq!(status, Some(i32::from(code::USAGE)), "{stderr}");
    assert!(
        stderr.contains("No running program") && stderr.contains("--port /dev/ttyACM0"),
        "{stderr}"
    );
    let (status, _, stderr) = told(&["stop", "--all"]);
    assert_eq!(status, Some(i32::from(code::CONNECTION)), "{stderr}");

    let first = cell();
    let _first = recorder(&folder, &first, "first.mcap");
    for (words, end) in [
        (&["reference"][..], ""),
        (&["enable"], "enable: enabled and at rest"),
        (
            &["override", "50"],
            "override: enabled and at rest, speed override 50 %",
        ),
        (&["pen", "up"], "pen: enabled and at rest"),
        (&["move", "10,0,-830"], "move: enabled and at rest"),
        (&["jog", "5,0,0", "--for", "0.2"], "jog: enabled and at rest"),
        (&["stop"], "stop: standing still, fault latched: "),
        (&["acknowledge"], "acknowledge: ready, the drives are without power"),
        (&["disable"], ""),
    ] {
        let (status, _, stderr) = told(words);
        assert!(status == Some(0) || words[0] == "disable", "{words:?}: {stderr}");
        assert!(stderr.contains(end), "{words:?}: {stderr}");
    }
    let status = json(etherpen(&folder).args(["status", "--json"]));
    assert_eq!(status["mode"], "DrivesOff", "{status}");
    let also = json(etherpen(&folder).args(["record", "-o", "also.mcap", "--duration", "0.3", "--json"]));
    assert!(also["samples"].as_u64().is_some_and(|samples| samples > 0), "{also}");

    let second = cell();
    let _second = recorder(&folder, &second, "second.mcap");
    let ports = [first.port().to_string(), second.port().to_string()];
    for words in [&["stop"][..], &["hold"], &["status"], &["jog", "1,0,0"], &["reference"]] {
        let (status, _, stderr) = told(words);
        assert_eq!(status, Some(i32::from(code::USAGE)), "{words:?}: {stderr}");
        assert!(
            ports.iter().all(|port| stderr.contains(&format!("--port {port} "))),
            "{words:?}: {stderr}"
        );
        assert!(stderr.contains("etherpen stop --all"), "{words:?}: {stderr}");
    }
    let stopped = json(etherpen(&folder).args(["stop", "--all", "--json"]));
    let stopped = stopped.as_array().expect("one answer a robot");
    assert_eq!(stopped.len(), 2, "{stopped:?}");
    for answer in stopped {
        assert_eq!(
            (&answer["reached"], &answer["mode"]),
            (&true.into(), &"Fault".into()),
            "{answer}"
        );
        assert!(
            answer["state"]
                .as_str()
                .is_some_and(|state| state.starts_with("standing still")),
            "{answer}"
        );
    }
    for port in &ports {
        assert_eq!(
            json(etherpen(&folder).args(["status", "--json", "--port", port]))["mode"],
            "Fault"
        );
    }
}

#[test]
fn sockets_of_a_killed_program_are_removed_by_the_next_one() {
    let folder = Folder::new();
    let (first, second) = (cell(), cell());
    let mut killed = recorder(&folder, &first, "first.mcap");
    let _living = recorder(&folder, &second, "second.mcap");
    let left = || fs::read_dir(folder.join("run/etherpen")).map_or(0, |entries| entries.count());
    assert_eq!(left(), 4, "a lock and a socket of each");
    let pid = rustix::process::Pid::from_raw(killed.id() as i32).expect("an id");
    rustix::process::kill_process(pid, rustix::process::Signal::KILL).expect("the process runs");
    killed.end();
    // The remaining one needs no name.
    let status = json(etherpen(&folder).args(["status", "--json"]));
    assert!(
        status["owner"]["program"]
            .as_str()
            .is_some_and(|program| program.ends_with("record")),
        "{status}"
    );
    assert_eq!(left(), 2);
}

#[test]
fn the_socket_of_a_killed_console_is_removed_by_a_command_that_looks_for_a_robot() {
    let folder = Folder::new();
    let mut console = Running::start(etherpen(&folder).args(["console", "--simulate", "--listen", "127.0.0.1:0"]));
    console.wait_for("connection", |console| {
        console.stderr().contains("connected: firmware").then_some(())
    });
    let left = || fs::read_dir(folder.join("tmp")).expect("a folder").count();
    assert!(left() > 0, "its robot's socket");
    let pid = rustix::process::Pid::from_raw(console.id() as i32).expect("an id");
    rustix::process::kill_process(pid, rustix::process::Signal::KILL).expect("the process runs");
    console.end();
    let (status, _, stderr) = run(etherpen(&folder).arg("status"));
    assert_eq!(status, Some(i32::from(code::USAGE)), "{stderr}");
    assert_eq!(left(), 0);
}

#[test]
fn stops_from_several_terminals_at_once_all_stop() {
    let folder = Folder::new();
    let cell = cell();
    let _recorder = recorder(&folder, &cell, "run.mcap");
    let (status, _, stderr) = run(etherpen(&folder).arg("enable"));
    assert_eq!(status, Some(0), "{stderr}");
    std::thread::scope(|scope| {
        let stops: Vec<_> = (0..4)
            .map(|_| scope.spawn(|| run(etherpen(&folder).arg("stop"))))
            .collect();
        for stop in stops {
            let (status, _, stderr) = stop.join().expect("the program starts");
            assert_eq!(status, Some(0), "{stderr}");
            assert!(stderr.contains("stop: standing still, fault latched: "), "{stderr}");
        }
    });
    let slaves = cell.state().slaves;
    assert!(
        slaves.iter().all(|slave| slave.drive != DriveState::OperationEnabled),
        "{slaves:?}"
    );
}

#[test]
fn the_environments_port_counts_for_nothing_beside_another_place_to_work() {
    let folder = Folder::new();
    let file = strokes().to_string_lossy().into_owned();
    let record = ["record", "-o", "run.mcap", "--duration", "0.1", "--simulate", &file];
    let (status, _, stderr) = run(etherpen(&folder).args(record).env("ETHERPEN_PORT", "tcp:127.0.0.1:1"));
    assert_eq!(status, Some(0), "{stderr}");
    let (status, _, stderr) = run(etherpen(&folder).args(record).args(["--port", "tcp:127.0.0.1:1"]));
    assert_eq!(status, Some(i32::from(code::USAGE)), "{stderr}");
    assert!(stderr.contains("--port and --simulate exclude each other"), "{stderr}");
    for words in [
        &["doctor"][..],
        &["identify"],
        &["bus", "scan"],
        &["reference"],
        &["record", "-o", "x.mcap"],
    ] {
        let (status, stdout, stderr) = run(etherpen(&folder).args(words).env("ETHERPEN_PORT", "tcp:127.0.0.1:1"));
        assert_ne!(status, Some(0), "{words:?}");
        assert!(
            format!("{stdout}{stderr}").contains("tcp:127.0.0.1:1"),
            "{words:?}: {stdout}{stderr}"
        );
    }
}

#[test]
fn a_console_says_that_its_robot_is_not_there_and_connects_when_it_appears() {
    let folder = Folder::new();
    let later = folder.join("later.sock");
    let port = format!("unix:{}", later.display());
    let mut command = etherpen(&folder);
    let mut console = Running::start(command.args(["console", "--listen", "127.0.0.1:0", "--port", &port]));
    console.wait_for("word of the missing robot", |console| {
        let said = console.stderr();
        (said.contains("no robot: ") && said.contains(&port) && said.contains("trying again")).then_some(())
    });
    let mut page = Page::open(console.stdout().lines().next().expect("an address"));
    let text = page.link("lost");
    assert!(text.contains(&port), "{text}");
    let cell = cell();
    let host_tools::link::port::PortName::Unix(there) = cell.port() else {
        panic!("the cell's line is a Unix socket")
    };
    std::os::unix::fs::symlink(there, &later).expect("a name");
    console.wait_for("connection", |console| {
        console.stderr().contains("connected: firmware").then_some(())
    });
    page.link("connected");
    drop(cell);
    console.wait_for("word of the lost robot", |console| {
        (console.stderr().matches("no robot: ").count() > 1).then_some(())
    });
}

fn ink_mm(cell: &VirtualCell) -> f64 {
    cell.ink().iter().map(InkStroke::length_mm).sum()
}

#[test]
fn a_refused_drawing_does_not_shadow_the_one_that_broke_off_and_every_job_goes_on_by_its_name() {
    let folder = Folder::new();
    let file = strokes().to_string_lossy().into_owned();
    let whole = cell();
    let command = |cell: &VirtualCell, words: &[&str]| {
        let mut command = etherpen(&folder);
        command.args(words).env("ETHERPEN_PORT", cell.port().to_string());
        command
    };
    let (status, _, stderr) = run(&mut command(&whole, &["draw", &file]));
    assert_eq!(status, Some(0), "{stderr}");
    // The log of this undisturbed drawing must not be resumed.
    fs::remove_dir_all(folder.join("state")).expect("the log");

    let cell = cell();
    let mut broken = Running::start(&mut command(&cell, &["draw", &file]));
    broken.wait_for("third stroke", |_| (cell.ink().len() >= 3).then_some(()));
    let (status, _, stderr) = run(&mut command(&cell, &["stop"]));
    assert_eq!(status, Some(0), "{stderr}");
    broken.end();
    let before_mm = ink_mm(&cell);
    for _ in 0..2 {
        let (status, _, stderr) = run(&mut command(&cell, &["draw", &file]));
        assert_eq!(status, Some(i32::from(code::FAULT)), "{stderr}");
    }
    let (status, _, stderr) = run(&mut command(&cell, &["acknowledge"]));
    assert_eq!(status, Some(0), "{stderr}");
    let jobs = json(etherpen(&folder).args(["jobs", "--json"]));
    let jobs = jobs.as_array().expect("a list");
    assert_eq!(jobs.len(), 3, "{jobs:?}");
    let drawn = |job: &Json| job["strokes"].as_u64().expect("a number");
    assert!(
        drawn(&jobs[0]) >= 2 && jobs[1..].iter().all(|job| drawn(job) == 0),
        "{jobs:?}"
    );
    let (status, _, stderr) = run(&mut command(&cell, &["draw", &file, "--resume"]));
    assert_eq!(status, Some(0), "{stderr}");
    let stroke = drawn(&jobs[0]);
    assert!(!stderr.contains("at stroke 1 of"), "{stderr}");
    let (drawn_mm, whole_mm) = (ink_mm(&cell), ink_mm(&whole));
    println!(
        "stopped at stroke {stroke} after {before_mm:.1} mm; {whole_mm:.1} mm undisturbed, {drawn_mm:.1} mm after --resume"
    );
    // A complete second drawing over the ink would double it.
    assert!(
        drawn_mm > whole_mm - 1.0 && drawn_mm < whole_mm + before_mm - 20.0,
        "{drawn_mm} mm of {whole_mm} mm"
    );

    // By name: a job without a stroke starts at the first, a completed one has nothing left, an unknown name is not a
    // job.
    let name = |job: &Json| job["job"].as_str().expect("a name").to_owned();
    let (status, _, stderr) = run(&mut command(&cell, &["draw", "--resume", &name(&jobs[0])]));
    assert_eq!(status, Some(i32::from(code::INPUT)), "{stderr}");
    assert!(stderr.contains("to its end"), "{stderr}");
    let (status, _, stderr) = run(&mut command(&cell, &["draw", "--resume", "4711"]));
    assert_eq!(status, Some(i32::from(code::INPUT)), "{stderr}");
    assert!(stderr.contains("no job of the name 4711"), "{stderr}");
    let (status, _, stderr) = run(&mut command(&cell, &["draw", "--resume", &name(&jobs[1])]));
    assert_eq!(status, Some(0), "{stderr}");
    assert!(stderr.contains("at stroke 1 of 6"), "{stderr}");
    wait_until("the end of that job in the log", || {
        let jobs = json(etherpen(&folder).args(["jobs", "--json"]));
        jobs[1]["completed"] == true && jobs[2]["completed"] == false
    });
}
