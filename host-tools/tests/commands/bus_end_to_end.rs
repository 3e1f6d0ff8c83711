//! `etherpen bus` with this computer's master, on segments in separate processes.

use crate::network::Network;
use crate::program::{Folder, Running, etherpen, run, wait_until};
use crate::segment::Segment;
use host_tools::error::code;
use rustix::process::{Pid, Signal, kill_process};

/// Runs `etherpen bus` with these options for the connection; returns stdout.
fn bus(folder: &Folder, way: &[&str], words: &[&str]) -> String {
    let (status, stdout, stderr) = run(etherpen(folder).arg("bus").args(words).args(way));
    assert_eq!(status, Some(0), "{words:?}: {stderr}");
    stdout
}

/// Runs `bus` with --json and returns what it prints.
fn json(folder: &Folder, way: &[&str], words: &[&str]) -> serde_json::Value {
    let words: Vec<&str> = words.iter().copied().chain(["--json"]).collect();
    serde_json::from_str(&bus(folder, way, &words)).expect("JSON")
}

/// Every sub-command of `bus` that ends by itself, on four virtual drives.
fn the_commands_tell_what_is_there(folder: &Folder, way: &[&str]) {
    let scan = json(folder, way, &["scan"]);
    let slaves = scan["slaves"].as_array().expect("a list");
    assert_eq!(slaves.len(), 4, "{scan}");
    for (slave, number) in slaves.iter().zip(1..) {
        let identity = ["slave", "vendor", "product"].map(|key| slave[key].as_u64());
        assert_eq!(identity, [Some(number), Some(2), Some(0x07D0_6014)], "{slave}");
    }
    assert!(bus(folder, way, &["scan"]).lines().count() >= 5);
    assert!(bus(folder, way, &["info", "3"]).contains("slave 3"));
    assert_eq!(json(folder, way, &["state", "2", "preop"])["al_state"], "PREOP");
    let vendor = json(folder, way, &["sdo", "read", "4", "1018:1", "--type", "u32"]);
    assert_eq!(vendor["value"], 2);
    bus(folder, way, &["sdo", "write", "1", "6060:0", "-2", "--type", "i8"]);
    let (status, _, stderr) = run(etherpen(folder).args(["bus", "sdo", "read", "1", "2FFF:0"]).args(way));
    assert_eq!(status, Some(i32::from(code::FAILED)));
    assert!(
        stderr.contains("0x06020000") && stderr.contains("does not exist"),
        "{stderr}"
    );
    let registers = json(folder, way, &["registers", "1", "10", "2"]);
    assert_eq!(registers["bytes"], "0110", "the first station address");
    the_dictionary_is_listed(folder, way);
    let errors = json(folder, way, &["errors"]);
    assert_eq!(errors[2]["ports"][0]["cable"], "between slave 2 and 3");
}

/// Slave 2 is in PREOP, set by another program.
fn the_dictionary_is_listed(folder: &Folder, way: &[&str]) {
    let list = json(folder, way, &["sdo", "list", "2"]);
    let objects = list["objects"].as_array().expect("a list");
    println!("{} objects", objects.len());
    assert!(objects.iter().any(|object| object["index"] == 0x6041), "{list}");
    assert!(bus(folder, way, &["sdo", "list", "2"]).contains("6041    variable"));
}

#[test]
fn the_bus_commands_work_on_a_segment_at_a_unix_socket() {
    let folder = Folder::new();
    let place = folder.join("segment.sock");
    let segment = Segment::start(etherpen(&folder).arg("segment").arg("--unix").arg(&place));
    the_commands_tell_what_is_there(&folder, &["--unix", &place.to_string_lossy()]);
    segment.end();
}

#[test]
fn the_bus_commands_work_on_a_segment_in_udp() {
    let folder = Folder::new();
    let segment = Segment::start(etherpen(&folder).args(["segment", "--udp", "127.0.0.1:0"]));
    the_commands_tell_what_is_there(&folder, &["--udp", segment.place()]);
    segment.end();
}

#[test]
fn the_bus_commands_work_on_a_segment_at_the_other_end_of_a_cable() {
    let Some(network) = Network::new("the test of the bus commands on an interface") else {
        return;
    };
    let folder = Folder::new();
    let [at_segment, at_master] = network.interfaces();
    let mut program = etherpen(&folder);
    program.args(["segment", "--interface", at_segment]);
    let segment = Segment::start(&mut network.command(0, &program));
    let mut program = etherpen(&folder);
    program.args(["bus", "scan", "--json", "--interface", at_master]);
    let (status, stdout, stderr) = run(&mut network.command(1, &program));
    assert_eq!(status, Some(0), "{stderr}");
    let scan: serde_json::Value = serde_json::from_str(&stdout).expect("JSON");
    assert_eq!(scan["slaves"].as_array().map(Vec::len), Some(4), "{scan}");
    let mut program = etherpen(&folder);
    program.args(["bus", "info", "3", "--interface", at_master]);
    let (status, stdout, stderr) = run(&mut network.command(1, &program));
    assert_eq!(status, Some(0), "{stderr}");
    assert!(stdout.contains("slave 3: AX2000-B110"), "{stdout}");
    segment.end();
}

#[test]
fn a_slave_is_brought_to_op_and_back_by_one_program_after_the_other() {
    let folder = Folder::new();
    let place = folder.join("segment.sock");
    let segment = Segment::start(etherpen(&folder).arg("segment").arg("--unix").arg(&place));
    let way = ["--unix", &*place.to_string_lossy()];
    for state in ["safeop", "op", "preop", "op", "init", "op"] {
        let reached = json(&folder, &way, &["state", "4", state]);
        let name = state.to_uppercase();
        assert_eq!(
            (&reached["al_state"], &reached["al_error"]),
            (&name.into(), &false.into())
        );
    }
    segment.end();
}

/// Entry of a process data object: index, sub-index, bits and name.
type ShownEntry = (u64, u64, u64, String);
/// Process data object: index, direction, source and entries.
type ShownObject = (u64, String, String, Vec<ShownEntry>);

/// The process data objects that `bus info` shows for a slave.
fn shown_objects(info: &serde_json::Value) -> Vec<ShownObject> {
    let text = |value: &serde_json::Value| value.as_str().expect("a text").to_owned();
    let number = |value: &serde_json::Value| value.as_u64().expect("a number");
    let pdos = info["slaves"][0]["pdos"].as_array().expect("a list");
    let shown = pdos.iter().map(|pdo| {
        let entries = pdo["entries"].as_array().expect("a list").iter().map(|entry| {
            let [index, sub, bits] = ["index", "sub", "bits"].map(|key| number(&entry[key]));
            (index, sub, bits, text(&entry["name"]))
        });
        let source = text(&pdo["source"]);
        (
            number(&pdo["index"]),
            text(&pdo["direction"]),
            source,
            entries.collect(),
        )
    });
    shown.collect()
}

#[test]
fn info_shows_the_entries_of_slaves_without_a_driver_by_their_memory_and_in_preop_by_themselves() {
    let folder = Folder::new();
    let place = folder.join("segment.sock");
    let description = folder.file("mixed.xml", include_str!("mixed_terminal.xml"));
    let list = format!("el2004,esi:{}#IO-1,ax2000", description.display());
    let mut command = etherpen(&folder);
    command.args(["segment", "--slaves", &list, "--unix"]).arg(&place);
    let segment = Segment::start(&mut command);
    let way = ["--unix", &*place.to_string_lossy()];

    let outputs = shown_objects(&json(&folder, &way, &["info", "1"]));
    let expected: Vec<_> = (0..4)
        .map(|channel| (0x1600 + channel, 0x7000 + 0x10 * channel))
        .collect();
    assert_eq!(outputs.len(), expected.len(), "{outputs:?}");
    for ((pdo, direction, source, entries), (index, object)) in outputs.iter().zip(expected) {
        assert_eq!((*pdo, direction.as_str(), source.as_str()), (index, "out", "SII"));
        let [(entry, 1, 1, _)] = entries[..] else {
            panic!("{entries:?}");
        };
        assert_eq!(entry, object);
    }
    for (state, source) in [("init", "SII"), ("preop", "CoE"), ("op", "CoE")] {
        json(&folder, &way, &["state", "2", state]);
        let value = (0x7000, 1, 16, String::new());
        let on = (0x6000, 1, 1, String::new());
        let gap = (0, 0, 15, String::new());
        let expected = [
            (0x1600, "out".to_owned(), source.to_owned(), vec![value]),
            (0x1A00, "in".to_owned(), source.to_owned(), vec![on, gap]),
        ];
        let info = json(&folder, &way, &["info", "2"]);
        assert_eq!(shown_objects(&info), expected, "{state}");
        assert_eq!(info["slaves"][0]["al_state"], state.to_uppercase(), "{state}");
    }
    let text = bus(&folder, &way, &["info", "2"]);
    for line in [
        "  PDO 1a00         in, sync manager 3, 16 bits, by CoE",
        "    6000:1           1 bits",
        "    gap             15 bits",
    ] {
        assert!(text.contains(line), "{text}");
    }
    assert!(
        json(&folder, &way, &["info", "3"])["slaves"][0]["pdos"].is_null(),
        "it has a driver"
    );
    segment.end();
}

#[test]
fn errors_shows_what_a_drives_diagnosis_history_tells() {
    let folder = Folder::new();
    let place = folder.join("segment.sock");
    let faults = folder.file("faults.txt", "ms 1000 fault 2 0x230A\n");
    let mut command = etherpen(&folder);
    command
        .args(["segment", "--slaves", "ax2000,cia402", "--unix"])
        .arg(&place);
    command.arg("--faults").arg(&faults);
    let segment = Segment::start(&mut command);
    let way = ["--unix", &*place.to_string_lossy()];
    for slave in ["1", "2"] {
        json(&folder, &way, &["state", slave, "preop"]);
    }
    // On a busy computer a program may find no answer in time; another one asks again.
    let errors = |options: &[&str]| {
        let (status, stdout, _) = run(etherpen(&folder).args(["bus", "errors"]).args(options).args(way));
        (status == Some(0)).then_some(stdout)
    };
    let mut messages = Vec::new();
    wait_until("the fault", || {
        let Some(found) = errors(&["--json"]) else {
            return false;
        };
        let found: serde_json::Value = serde_json::from_str(&found).expect("JSON");
        assert!(found[0]["messages"].is_null(), "an AX2000 has no history: {found}");
        messages = found[1]["messages"].as_array().cloned().unwrap_or_default();
        messages.first().is_some_and(|newest| newest["error_code"] == 0x230A)
    });
    assert_eq!(messages.len(), 1, "{messages:?}");
    assert_eq!(
        (&messages[0]["kind"], &messages[0]["text_id"]),
        (&"error".into(), &0x0101.into())
    );
    wait_until("the same in words", || {
        errors(&[]).is_some_and(|text| text.contains("slave 2 tells: error 0x230ae800, error code 0x230a, text 0x0101"))
    });
    segment.end();
}

#[test]
fn watch_tells_the_states_then_every_change_until_it_is_interrupted() {
    let folder = Folder::new();
    let place = folder.join("segment.sock");
    let segment = Segment::start(etherpen(&folder).arg("segment").arg("--unix").arg(&place));
    let way = ["--unix", &*place.to_string_lossy()];
    let mut watch = Running::start(etherpen(&folder).args(["bus", "watch", "--json"]).args(way));
    let lines = |running: &Running, least: usize| {
        let stdout = running.stdout();
        let lines = stdout
            .lines()
            .map(|line| serde_json::from_str(line).expect("a line is JSON"));
        let lines: Vec<serde_json::Value> = lines.collect();
        (lines.len() >= least).then_some(lines)
    };
    watch.wait_for("state of every slave", |running| lines(running, 4));
    bus(&folder, &way, &["state", "2", "preop"]);
    let told = watch.wait_for("change", |running| lines(running, 5));
    for (line, slave) in told.iter().zip([1, 2, 3, 4, 2]) {
        let state = ["INIT", "PREOP"][usize::from(line == &told[4])];
        assert_eq!(
            (&line["slave"], &line["seen"]["al_state"]),
            (&slave.into(), &state.into())
        );
    }
    assert!(told[4]["t_ms"].as_u64() > told[3]["t_ms"].as_u64(), "{told:?}");
    let id = i32::try_from(watch.id()).ok().and_then(Pid::from_raw);
    kill_process(id.expect("a process"), Signal::INT).expect("it runs");
    assert_eq!(watch.end().code(), Some(0), "{}", watch.stderr());
    segment.end();
}

#[test]
fn a_script_that_names_a_slave_that_is_not_there_is_refused_before_anything_starts() {
    let folder = Folder::new();
    let script = folder.join("faults.txt");
    std::fs::write(&script, "ms 10 cut 3\nms 20 remove 5\n").expect("the folder is there");
    for words in [&["emulate"][..], &["segment", "--udp", "127.0.0.1:0"]] {
        let (status, _, stderr) = run(etherpen(&folder).args(words).arg("--faults").arg(&script));
        assert_eq!(status, Some(i32::from(code::INPUT)), "{stderr}");
        assert!(stderr.contains("line 2: no such slave in this chain: '5'"), "{stderr}");
    }
}
