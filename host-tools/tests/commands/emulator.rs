//! The command line with the emulator: a drawing over the port, and exits that leave nothing behind.

use crate::program::{Folder, Running, emulator_of, etherpen, run, runs, strokes, wait_until};
use host_tools::error::code;
use host_tools::setup;
use rustix::process::{Pid, Signal, kill_process};

fn send(id: u32, signal: Signal) {
    let pid = Pid::from_raw(id as i32).expect("an id");
    kill_process(pid, signal).expect("the process runs");
}

/// `etherpen emulate`, its emulator's process and the port it prints.
fn emulate(folder: &Folder) -> (Running, u32, String) {
    setup::build_firmware("emulated").expect("the firmware builds");
    let mut program = Running::start(etherpen(folder).arg("emulate"));
    let port = program.wait_for("port", |program| program.stdout().lines().next().map(str::to_owned));
    assert!(port.starts_with("tcp:127.0.0.1:"), "{port}");
    let emulator = program.wait_for("emulator", |program| emulator_of(program.id()));
    (program, emulator, port)
}

fn draw(folder: &Folder, port: &str) -> Running {
    let mut command = etherpen(folder);
    command.arg("draw").arg(strokes()).args(["--port", port, "--json"]);
    Running::start(command.arg("--out").arg(folder.join("out")))
}

fn wait_for_drawing(program: &mut Running) {
    program.wait_for("beginning of the drawing", |program| {
        program.stderr().lines().any(|line| line == "drawing").then_some(())
    });
}

/// Waits until the emulator's process and its working directory are gone.
fn wait_until_all_is_gone(emulator: u32, folder: &Folder) {
    wait_until("end of the emulator", || !runs(emulator));
    let temporary = folder.join("tmp");
    wait_until("removal of its directory", || {
        let mut entries = std::fs::read_dir(&temporary).expect("the folder for temporary files");
        entries.next().is_none()
    });
}

fn draws_layers_with_a_pause_for_the_pen(folder: &Folder, port: &str) {
    let line = |colour: &str, y: u32| format!("<path d='M10 {y}H40' stroke='{colour}'/>");
    let file = folder.file(
        "pens.svg",
        format!(
            "<svg xmlns='http://www.w3.org/2000/svg' width='50mm' height='50mm' viewBox='0 0 50 50'>{}{}</svg>",
            line("red", 10),
            line("blue", 30)
        ),
    );
    let mut command = etherpen(folder);
    command
        .arg("draw")
        .arg(file)
        .args(["--pause", "--json", "--port", port]);
    command.arg("--out").arg(folder.join("pens"));
    let mut draw = Running::start(command.stdin(std::process::Stdio::piped()));
    draw.wait_for("pause", |draw| draw.stderr().contains("change the pen").then_some(()));
    let read = |layer: &str| {
        let report = std::fs::read_to_string(folder.join("pens").join(layer).join("report.json"));
        report.map(|text| serde_json::from_str::<serde_json::Value>(&text).expect("a report")["strokes"].clone())
    };
    assert_eq!(read("layer-1").expect("the first layer is drawn"), 1);
    let (_, status, _) = run(etherpen(folder).args(["status", "--json", "--port", port]));
    let status: serde_json::Value = serde_json::from_str(&status).expect("a status");
    assert_eq!(status["mode"], "DrivesOff", "a pen is changed without power: {status}");
    assert!(read("layer-2").is_err(), "nothing is drawn without Enter");
    draw.press_enter();
    assert_eq!(draw.end().code(), Some(0), "{}", draw.stderr());
    assert_eq!(read("layer-2").expect("the second layer is drawn"), 1);
}

#[test]
fn a_drawing_goes_over_the_port_that_the_emulator_prints_also_after_one_that_was_cancelled() {
    let folder = Folder::new();
    let (mut emulate, emulator, port) = emulate(&folder);
    let mut cancelled = draw(&folder, &port);
    wait_for_drawing(&mut cancelled);
    send(cancelled.id(), Signal::TERM);
    let status = cancelled.end();
    assert_eq!(
        status.code(),
        Some(i32::from(code::INTERRUPTED)),
        "{}",
        cancelled.stderr()
    );
    wait_until("message", || cancelled.stderr().contains("cancelled"));
    let mut draw = draw(&folder, &port);
    let status = draw.end();
    assert_eq!(status.code(), Some(0), "{}", draw.stderr());
    let mut written = None;
    wait_until("report on stdout", || {
        written = serde_json::from_str::<serde_json::Value>(&draw.stdout()).ok();
        written.is_some()
    });
    let report = written.expect("JSON");
    assert_eq!(report["strokes"], 6);
    for counter in [
        "cycles_late",
        "frames_lost",
        "working_counter_errors",
        "reference_underruns",
    ] {
        assert_eq!(report[counter], 0, "{counter}");
    }
    for name in ["report.json", "telemetry.csv", "intended.csv"] {
        assert!(folder.join("out").join(name).is_file(), "{name}");
    }
    draws_layers_with_a_pause_for_the_pen(&folder, &port);
    let (_, stdout, stderr) = run(etherpen(&folder).args(["doctor", "--json", "--port", &port]));
    let checks: serde_json::Value = serde_json::from_str(&stdout).expect("a JSON array and nothing else");
    for (name, part) in [
        ("port", port.as_str()),
        ("firmware", "on emulated"),
        ("machine", "without power"),
    ] {
        let mut named = checks.as_array().expect("an array").iter();
        let check = named
            .find(|check| check["check"] == name)
            .expect("a check of this name");
        let found = check["found"].as_str().expect("a text");
        assert!(check["verdict"] == "ok" && found.contains(part), "{check} {stderr}");
    }
    send(emulate.id(), Signal::INT);
    assert_eq!(emulate.end().code(), None, "the signal ends it: {}", emulate.stderr());
    wait_until_all_is_gone(emulator, &folder);
}

#[test]
fn an_emulator_ends_with_its_program_whatever_ends_that() {
    let folder = Folder::new();
    let (mut program, emulator, _) = emulate(&folder);
    send(program.id(), Signal::TERM);
    program.end();
    wait_until_all_is_gone(emulator, &folder);
    // This signal cannot be handled; the emulator may not have started its firmware yet.
    let (mut program, emulator, _) = emulate(&folder);
    send(program.id(), Signal::KILL);
    program.end();
    wait_until_all_is_gone(emulator, &folder);
}

#[test]
fn a_drawing_whose_emulator_dies_ends_with_the_lost_connection() {
    let folder = Folder::new();
    let (mut program, emulator, port) = emulate(&folder);
    let mut draw = draw(&folder, &port);
    wait_for_drawing(&mut draw);
    send(emulator, Signal::KILL);
    for (who, hint) in [(&mut program, "the emulator ended"), (&mut draw, &*port)] {
        let status = who.end();
        assert_eq!(status.code(), Some(i32::from(code::CONNECTION)), "{}", who.stderr());
        wait_until("message", || who.stderr().contains(hint));
    }
    wait_until_all_is_gone(emulator, &folder);
}

#[test]
fn a_demo_whose_emulator_dies_says_so_and_leaves_no_process() {
    let folder = Folder::new();
    setup::build_firmware("emulated").expect("the firmware builds");
    let mut command = etherpen(&folder);
    command
        .args(["demo", "--photo"])
        .arg(strokes())
        .arg("--out")
        .arg(folder.join("out"));
    let mut demo = Running::start(&mut command);
    wait_for_drawing(&mut demo);
    let emulator = emulator_of(demo.id()).expect("it draws in the emulator");
    send(emulator, Signal::KILL);
    let status = demo.end();
    assert_eq!(status.code(), Some(i32::from(code::CONNECTION)), "{}", demo.stderr());
    wait_until("message", || demo.stderr().contains("the emulator ended"));
    wait_until_all_is_gone(emulator, &folder);
}

/// A machine that receives commands.
struct Told<'a> {
    folder: &'a Folder,
    port: &'a str,
}

impl Told<'_> {
    /// Runs a command on the machine: exit code, stdout, stderr.
    fn tell(&self, words: &[&str]) -> (Option<i32>, String, String) {
        run(etherpen(self.folder).args(words).env("ETHERPEN_PORT", self.port))
    }

    fn done(&self, words: &[&str]) {
        let (status, _, stderr) = self.tell(words);
        assert_eq!(status, Some(0), "{words:?}: {stderr}");
    }

    fn refused(&self, words: &[&str], code: u8, hint: &str) {
        let (status, _, stderr) = self.tell(words);
        assert_eq!(status, Some(i32::from(code)), "{words:?}: {stderr}");
        assert!(stderr.contains(hint), "{words:?}: {stderr}");
    }

    fn status(&self) -> serde_json::Value {
        let (status, stdout, stderr) = self.tell(&["status", "--json"]);
        assert_eq!(status, Some(0), "{stderr}");
        serde_json::from_str(&stdout).expect("JSON")
    }

    fn wait_for_mode(&self, mode: &str) {
        wait_until(mode, || self.status()["mode"] == mode);
    }
}

#[test]
fn a_drawing_is_worked_with_from_another_terminal_and_goes_on_after_its_program_was_killed() {
    let folder = Folder::new();
    let (_emulate, _, port) = emulate(&folder);
    let machine = Told {
        folder: &folder,
        port: &port,
    };
    let mut first = draw(&folder, &port);
    wait_for_drawing(&mut first);
    let status = machine.status();
    assert_eq!(status["mode"], "Drawing", "{status}");
    assert_eq!(status["owner"]["pid"], first.id(), "{status}");
    assert!(
        status["owner"]["program"]
            .as_str()
            .is_some_and(|name| name.ends_with("draw")),
        "{status}"
    );
    assert!(
        status["progress"]["vertices_total"]
            .as_u64()
            .is_some_and(|count| count > 0),
        "{status}"
    );
    let file = strokes().to_string_lossy().into_owned();
    let in_use = format!("draw (process {})", first.id());
    machine.refused(&["draw", &file], code::CONNECTION, &in_use);
    machine.refused(&["reference", "--port", &port], code::FAILED, "busy with another order");
    machine.done(&["bus", "scan", "--port", &port]);
    machine.done(&["hold", "--at-pen-up"]);
    machine.wait_for_mode("Holding");
    machine.refused(&["hold"], code::FAILED, "the drawing is held");
    machine.refused(&["enable"], code::FAILED, "busy with another order");
    machine.done(&["override", "50"]);
    // The drawing's program reports the firmware's last status.
    wait_until("half the speed", || machine.status()["override_percent"] == 50);
    machine.done(&["resume"]);
    machine.wait_for_mode("Drawing");
    send(first.id(), Signal::KILL);
    first.end();
    machine.refused(&["resume"], code::FAILED, "--resume");
    let words = ["draw", &file, "--resume", "--json"];
    let (status, stdout, stderr) = machine.tell(&words);
    assert_eq!(status, Some(0), "{stderr}");
    assert!(stderr.contains("still holds this drawing"), "{stderr}");
    let report: serde_json::Value = serde_json::from_str(&stdout).expect("JSON");
    assert_eq!(report["completed"], true);
    let (_, jobs, _) = machine.tell(&["jobs", "--json"]);
    let jobs: serde_json::Value = serde_json::from_str(&jobs).expect("JSON");
    assert_eq!(jobs.as_array().map(Vec::len), Some(1), "{jobs}");
    assert_eq!(jobs[0]["completed"], true, "{jobs}");
    machine.refused(&words, code::INPUT, "to its end");
}

#[test]
fn a_reference_is_taken_through_the_program_that_has_the_port() {
    let folder = Folder::new();
    let (_emulate, _, port) = emulate(&folder);
    let machine = Told {
        folder: &folder,
        port: &port,
    };
    let mut command = etherpen(&folder);
    let mut owner = Running::start(command.args(["record", "-o", "run.mcap", "--port", &port]));
    let pid = owner.id();
    // A command given before the recorder has the port would take the port, and the recorder would follow that program.
    owner.wait_for("port", |owner| owner.stderr().contains("connected:").then_some(()));
    let (status, stdout, stderr) = machine.tell(&["reference", "--port", &port, "--json"]);
    assert_eq!(status, Some(0), "{stderr}");
    assert!(stderr.contains(&format!("record (process {pid})")), "{stderr}");
    let answer: serde_json::Value = serde_json::from_str(&stdout).expect("JSON");
    assert_eq!(answer["axes"].as_array().map(Vec::len), Some(4), "{answer}");
    let status = machine.status();
    assert_eq!(
        (&status["mode"], &status["referenced"]),
        (&"DrivesOff".into(), &true.into()),
        "{status}"
    );
    machine.refused(
        &["reference", "--port", &port, "--calibrate"],
        code::CONNECTION,
        "end that program",
    );
    let other = folder.file("other.toml", "[motion]\nspeed_mm_s = 77.0\n");
    let other = other.to_string_lossy();
    machine.refused(
        &["reference", "--port", &port, "--config", &other],
        code::USAGE,
        "another configuration",
    );
    send(pid, Signal::INT);
    assert_eq!(owner.end().code(), Some(0), "{}", owner.stderr());
    // Also without an owner.
    machine.done(&["reference", "--port", &port]);
}

#[test]
fn the_robot_is_moved_stopped_and_acknowledged_from_a_terminal() {
    let folder = Folder::new();
    let (_emulate, _, port) = emulate(&folder);
    let machine = Told {
        folder: &folder,
        port: &port,
    };
    assert_eq!(machine.status()["mode"], "Startup");
    machine.done(&["move", "10,-20,-830", "--json"]);
    let status = machine.status();
    assert_eq!(status["mode"], "DrivesOff", "{status}");
    assert!(status["owner"].is_null(), "{status}");
    let x_mm = status["position_mm"][0].as_f64().expect("a number");
    assert!((x_mm - 10.0).abs() < 0.5, "{status}");
    machine.done(&["enable"]);
    machine.done(&["jog", "-20,0,0", "--for", "0.5"]);
    let status = machine.status();
    assert_eq!(status["mode"], "Idle", "power is left as it was found: {status}");
    let jogged_mm = status["position_mm"][0].as_f64().expect("a number");
    // On a busy computer the order that ends the jog comes later.
    assert!((-60.0..8.0).contains(&jogged_mm), "{status}");
    machine.done(&["pen", "down"]);
    machine.refused(&["move", "0,0,-100"], code::FAILED, "work area");
    machine.done(&["stop"]);
    machine.wait_for_mode("Fault");
    assert!(
        machine.status()["fault"]
            .as_str()
            .is_some_and(|fault| fault.contains("stop by command"))
    );
    machine.refused(&["enable"], code::FAULT, "acknowledge");
    machine.done(&["acknowledge"]);
    assert_eq!(machine.status()["mode"], "DrivesOff");
    machine.refused(&["cancel"], code::FAILED, "not possible now");
}
