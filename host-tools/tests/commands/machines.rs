//! The commands with machines of every kind: homing and what is stored of it, other configurations, identification.

use crate::program::{Folder, Running, etherpen, run};
use host_tools::cell::CellOptions;
use host_tools::console::virtual_cell::{Firmware, VirtualCell};
use host_tools::error::code;
use host_tools::settings::machines::MACHINES;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

const GANTRY: &str = MACHINES[1].text;
const COREXY: &str = MACHINES[2].text;

fn usage() -> Option<i32> {
    Some(i32::from(code::USAGE))
}

/// A command's JSON.
fn json(folder: &Folder, words: &[&str]) -> Value {
    let (status, stdout, stderr) = run(etherpen(folder).args(words).arg("--json"));
    assert_eq!(status, Some(0), "{words:?}: {stderr}");
    serde_json::from_str(&stdout).expect("one JSON document and nothing else")
}

fn numbers(value: &Value) -> Vec<f64> {
    serde_json::from_value(value.clone()).expect("numbers")
}

#[test]
fn home_switches_stay_in_the_file_and_the_machine_is_homed_at_the_same_place_again() {
    let folder = Folder::new();
    let file = folder.file("robot.toml", GANTRY);
    let home = ["home", "--simulate", "--store", "--config", "robot.toml"];
    let first = json(&folder, &home);
    assert_eq!(fs::read_to_string(&file).expect("the file"), GANTRY);
    assert!(first["stored"].is_null(), "{first}");
    let axes = first["axes"].as_array().expect("axes");
    assert_eq!(axes.len(), 3, "{first}");
    assert!(
        axes[0]["position_mm"].is_f64() && axes[0]["angle_rad"].is_null(),
        "{first}"
    );
    let again = json(&folder, &home);
    assert_eq!(again["position_mm"], first["position_mm"]);
    let [x_mm, y_mm, _] = numbers(&first["position_mm"])[..] else {
        panic!("{first}")
    };
    assert!(x_mm >= 10.0 && y_mm >= 10.0, "inside the work area: {first}");
}

#[test]
fn the_marks_of_linear_axes_are_stored_in_millimetres_and_found_again() {
    let folder = Folder::new();
    let text = MACHINES[4].text;
    let file = folder.file("robot.toml", text);
    let home = ["home", "--simulate", "--store", "--config", "robot.toml"];
    let first = json(&folder, &home);
    let stored = fs::read_to_string(&file).expect("the file");
    assert_eq!(stored.matches("sync_increments = ").count(), 3, "{stored}");
    assert!(!stored.contains("sync_angle_rad"), "{stored}");
    let config = host_tools::settings::load(Some(Path::new(&file))).expect("a configuration");
    for (axis, found) in config.axes.iter().zip(first["axes"].as_array().expect("axes")) {
        let apart_mm = axis.sync_angle_rad * 100.0 - found["position_mm"].as_f64().expect("mm");
        assert!(apart_mm.abs() < 1.0e-6, "{apart_mm}: {first}");
    }
}

#[test]
fn values_of_a_bundled_machine_and_of_another_kind_are_not_stored() {
    let folder = Folder::new();
    let (status, _, stderr) = run(etherpen(&folder).args(["home", "--simulate", "--store", "--machine", "gantry"]));
    assert_eq!(status, usage(), "{stderr}");
    assert!(
        stderr.contains("bundled") && stderr.contains("config new --kind gantry"),
        "{stderr}"
    );
    assert!(!folder.join("etherpen.toml").exists());
    folder.file("delta.toml", MACHINES[0].text);
    let words = ["identify", "--simulate", "--machine", "gantry", "-o", "delta.toml"];
    let (status, _, stderr) = run(etherpen(&folder).args(words));
    assert_eq!(status, usage(), "{stderr}");
    assert!(stderr.contains("describes a delta"), "{stderr}");
    let (status, _, stderr) = run(etherpen(&folder).args(["simulate", "x.svg", "--machine", "gantri"]));
    assert_eq!(status, usage(), "{stderr}");
    assert!(stderr.contains("gantri") && stderr.contains("linear-delta"), "{stderr}");
}

#[test]
fn a_pose_is_given_in_the_units_of_the_axes() {
    let folder = Folder::new();
    folder.file("robot.toml", MACHINES[4].text);
    let pose = ["home", "--simulate", "--config", "robot.toml", "--calibrate", "--pose"];
    let found = json(&folder, &[&pose[..], &["271,272,273"]].concat());
    let axes = found["axes"].as_array().expect("axes");
    for (axis, wanted_mm) in axes.iter().zip([271.0, 272.0, 273.0]) {
        let mm = axis["position_mm"].as_f64().expect("mm");
        assert!((mm - wanted_mm).abs() < 0.01, "{found}");
    }
    let (status, _, stderr) = run(etherpen(&folder).args(pose).arg("1,2,3,4"));
    assert_eq!(status, usage(), "{stderr}");
    assert!(stderr.contains("takes 3 numbers") && stderr.contains("mm"), "{stderr}");
}

#[test]
fn a_homed_machine_with_switches_goes_to_them_again() {
    let folder = Folder::new();
    folder.file("etherpen.toml", GANTRY);
    let config = MACHINES[1].load().expect("the gantry");
    let cell = VirtualCell::start(&config, CellOptions::default(), Firmware::Simulated).expect("the cell starts");
    let port = cell.port().to_string();
    let first = json(&folder, &["home", "--port", &port]);
    let motors = cell.view().state().joints.0;
    let (status, _, stderr) = run(etherpen(&folder).args(["move", "320,240,-10", "--port", &port]));
    assert_eq!(status, Some(0), "{stderr}");
    assert!(
        (cell.view().state().joints.0[0] - motors[0]).abs() > 2.0,
        "it moved by 0.3 m"
    );
    let again = json(&folder, &["home", "--port", &port]);
    let now = cell.view().state().joints.0;
    let apart = now.iter().zip(motors).take(3);
    let apart_rad = apart.map(|(now, then)| (now - then).abs()).fold(0.0, f64::max);
    assert!(apart_rad < 0.005, "{apart_rad} rad: {first} {again}");
}

#[test]
fn positions_of_a_machine_with_another_configuration_are_not_shown_and_not_recorded() {
    let folder = Folder::new();
    folder.file("etherpen.toml", GANTRY);
    let config = MACHINES[1].load().expect("the gantry");
    let cell = VirtualCell::start(&config, CellOptions::default(), Firmware::Simulated).expect("the cell starts");
    let port = cell.port().to_string();
    json(&folder, &["home", "--port", &port]);
    let own = json(&folder, &["status", "--port", &port]);
    assert!(own["position_mm"].is_array() && own["remark"].is_null(), "{own}");
    let mut console = Running::start(etherpen(&folder).args(["console", "--listen", "127.0.0.1:0", "--port", &port]));
    console.wait_for("connection", |console| {
        console.stderr().contains("connected: firmware").then_some(())
    });
    let is_shared = |answer: &Value| answer["owner"].is_object() && answer["config"].is_string();
    console.wait_for("owner", |_| {
        is_shared(&json(&folder, &["status", "--port", &port])).then_some(())
    });
    let other = json(&folder, &["status", "--port", &port, "--machine", "scara"]);
    assert!(is_shared(&other) && other["referenced"] == true, "{other}");
    assert!(other["position_mm"].is_null() && other["joints"].is_null(), "{other}");
    assert!(
        other["remark"]
            .as_str()
            .is_some_and(|text| text.contains("another configuration")),
        "{other}"
    );
    let record = ["record", "-o", "run.mcap", "--duration", "0.2", "--port", &port];
    let (status, _, stderr) = run(etherpen(&folder).args(record).args(["--machine", "scara"]));
    assert_eq!(status, usage(), "{stderr}");
    assert!(stderr.contains("another configuration"), "{stderr}");
    assert!(!folder.join("run.mcap").exists());
    let (status, _, stderr) = run(etherpen(&folder).args(record));
    assert_eq!(status, Some(0), "{stderr}");
}

#[test]
fn identification_measures_the_axes_that_a_machine_has() {
    let folder = Folder::new();
    for (machine, axes, measured) in [("corexy", 2, 2), ("scara", 4, 3)] {
        let found = json(&folder, &["identify", "--simulate", "--machine", machine]);
        let list = found["axes"].as_array().expect("axes");
        assert_eq!(list.len(), axes, "{machine}: {found}");
        assert!(
            list.iter().take(measured).all(|axis| axis["measured"].is_object()),
            "{machine}: {found}"
        );
    }
    let (status, _, stderr) =
        run(etherpen(&folder).args(["identify", "--simulate", "--machine", "corexy", "--axis", "3"]));
    assert_eq!(status, usage(), "{stderr}");
    assert!(stderr.contains("no axis 3") && stderr.contains("2 drives"), "{stderr}");
}

#[test]
fn findings_are_told_in_the_words_of_the_files_machine() {
    let folder = Folder::new();
    let scara = MACHINES[3]
        .text
        .replacen("centre_mm = [260.0, 0.0]", "centre_mm = [-260.0, 0.0]", 1);
    folder.file("scara.toml", scara);
    let (status, stdout, _) = run(etherpen(&folder).args(["config", "check", "scara.toml"]));
    assert_eq!(status, usage(), "{stdout}");
    assert!(stdout.contains("shoulder") && !stdout.contains("arm "), "{stdout}");
    let gantry = GANTRY.replacen("output_max_mm_s = 1300.0", "output_max_mm_s = 0.0", 1);
    folder.file("mine.toml", gantry);
    let (status, _, stderr) = run(etherpen(&folder).args(["simulate", "x.svg", "--config", "mine.toml"]));
    assert_eq!(status, usage(), "{stderr}");
    assert!(
        stderr.contains("mine.toml") && !stderr.contains("etherpen.toml"),
        "{stderr}"
    );
}

#[test]
fn a_plan_takes_the_limits_of_linear_axes_in_millimetres() {
    let folder = Folder::new();
    folder.file("line.csv", "x_mm,y_mm,z_mm,pen\n220,240,-20,0\n420,240,-20,0\n");
    let seconds = |limit: &[&str]| {
        let words = [&["plan", "line.csv", "--machine", "gantry"][..], limit].concat();
        json(&folder, &words)["duration_s"].as_f64().expect("a duration")
    };
    let slow_s = seconds(&["--joint-speed", "50"]);
    assert!((4.0..4.4).contains(&slow_s), "200 mm at 50 mm/s: {slow_s}");
}

#[test]
fn a_stderr_that_is_full_does_not_end_a_command_in_a_panic() {
    let folder = Folder::new();
    let full = || fs::OpenOptions::new().write(true).open("/dev/full").expect("/dev/full");
    let mut command = etherpen(&folder);
    command.args(["status", "--port", "tcp:127.0.0.1:1"]).stderr(full());
    let status = command.status().expect("the program starts");
    assert_eq!(status.code(), Some(i32::from(code::CONNECTION)));
    let mut command = etherpen(&folder);
    command.args(["home", "--simulate"]).stderr(full());
    let output = command.output().expect("the program starts");
    assert_eq!(output.status.code(), Some(0));
}

/// The CoreXY with multi-turn encoders.
fn with_multi_turn_encoders(folder: &Folder) -> PathBuf {
    let text = COREXY.replacen("[axis_defaults]", "[axis_defaults]\nencoder = \"multi-turn\"", 1);
    folder.file("robot.toml", &text)
}

#[test]
fn a_multi_turn_encoder_is_calibrated_once_and_its_machine_is_homed_at_the_same_place_again() {
    let folder = Folder::new();
    let file = with_multi_turn_encoders(&folder);
    let home = ["home", "--simulate", "--config", "robot.toml"];
    let first = json(&folder, &[&home[..], &["--store"]].concat());
    let stored = fs::read_to_string(&file).expect("the file");
    assert_eq!(stored.matches("sync_increments = ").count(), 2, "{stored}");
    let config = host_tools::settings::load(Some(Path::new(&file))).expect("a configuration");
    assert!(config.axes.iter().take(2).all(etherpen::config::Axis::knows_turns));
    // An encoder that shows 0 at its mark has the mark an increment farther.
    assert!(
        config
            .axes
            .iter()
            .take(2)
            .all(|axis| axis.sync_angle_rad.abs() < 1.0e-6)
    );
    let again = json(&folder, &home);
    let places = |answer: &Value| -> Vec<f64> {
        let axes = answer["axes"].as_array().expect("axes").clone();
        axes.iter()
            .map(|axis| axis["position_mm"].as_f64().expect("mm"))
            .collect()
    };
    println!("{first} {again}");
    assert!(
        places(&first).iter().all(|mm| mm.abs() < 1.0e-6),
        "at the marks: {first}"
    );
    // The virtual machine stands a little off its marks, and its encoders say so.
    assert!(places(&again).iter().all(|mm| mm.abs() < 10.5), "{again}");
}

#[test]
fn a_machine_is_simulated_with_the_drives_that_its_axes_name_and_with_encoders_that_know_nothing() {
    let folder = Folder::new();
    let named = COREXY
        .replacen("[[axes]]", "[[axes]]\nserial = 4711\nalias = 12", 1)
        .replacen("[axis_defaults]", "[axis_defaults]\nencoder = \"incremental\"", 1);
    folder.file("robot.toml", &named);
    let drawing = host_tools::setup::workspace().join("samples/strokes.csv");
    let drawing = drawing.display().to_string();
    let words = ["simulate", &drawing, "--config", "robot.toml", "--out", "out"];
    let report = json(&folder, &words);
    let [ink_mm, missing_mm] =
        ["ink_deviation_max_mm", "ink_missing_mm"].map(|name| report[name].as_f64().expect("mm"));
    assert!(ink_mm < 0.1 && missing_mm < 0.1, "{ink_mm} {missing_mm}");
}
