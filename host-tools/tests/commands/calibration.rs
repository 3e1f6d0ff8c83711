//! `etherpen reference` and `etherpen identify` on the virtual cell: output, stored values, exit codes.

use super::program::{Folder, etherpen, run};
use host_tools::error::code;
use serde_json::Value;
use std::fs;
use std::io::Write;
use std::process::{Command, Stdio};

fn angles(answer: &Value) -> Vec<f64> {
    let axes = answer["axes"].as_array().expect("axes");
    axes.iter()
        .map(|axis| axis["angle_rad"].as_f64().expect("an angle"))
        .collect()
}

fn list(numbers: &[f64]) -> String {
    let words: Vec<String> = numbers.iter().map(ToString::to_string).collect();
    words.join(",")
}

fn answer(stdout: &str) -> Value {
    serde_json::from_str(stdout).expect("one JSON document and nothing else")
}

#[test]
fn a_reference_at_marks_pose_and_position_is_the_same_and_a_wrong_turn_names_its_axis() {
    let folder = Folder::new();
    let reference = |words: &[&str]| {
        let mut command = etherpen(&folder);
        command.args(["reference", "--simulate"]).args(words);
        run(&mut command)
    };
    let (status, stdout, stderr) = reference(&["--json"]);
    assert_eq!(status, Some(0), "{stderr}");
    let marks = answer(&stdout);
    let mut pose = angles(&marks);
    let position: Vec<f64> = serde_json::from_value(marks["position_mm"].clone()).expect("a platform");
    let (pose_words, position_words) = (list(&pose), list(&position));
    for words in [
        ["--json", "--pose", &pose_words],
        ["--json", "--position", &position_words],
    ] {
        let (status, stdout, stderr) = reference(&words);
        assert_eq!(status, Some(0), "{stderr}");
        assert_eq!(answer(&stdout), marks);
    }
    let (status, stdout, stderr) = reference(&[]);
    assert_eq!(status, Some(0), "{stderr}");
    assert_eq!(stdout.lines().count(), 5, "{stdout}");
    assert!(stdout.contains("axis 1") && stdout.contains("increments") && stdout.contains("platform"));

    pose[1] += std::f64::consts::TAU / 12.0;
    let (status, stdout, stderr) = reference(&["--pose", &list(&pose), "--position", &position_words]);
    assert_eq!(status, Some(i32::from(code::FAILED)), "{stderr}");
    assert!(stderr.contains("axis 2") && stderr.contains("wrong motor turn") && stdout.is_empty());
    for words in [
        ["--pose", "0.3,0.3,0.3"],
        ["--pose", "0,0,0,nan"],
        ["--position", "0,0,900"],
    ] {
        let (status, _, stderr) = reference(&words);
        assert_eq!(status, Some(i32::from(code::USAGE)), "{words:?}: {stderr}");
    }
}

#[test]
fn a_stored_reference_is_in_the_configuration_and_nothing_else_changes_there() {
    let folder = Folder::new();
    let config = folder.file("robot.toml", "# mine\n[motion]\nspeed_mm_s = 150.0\n");
    let mut command = etherpen(&folder);
    command
        .args(["reference", "--simulate", "--store", "--json", "--config"])
        .arg(&config);
    let (status, stdout, stderr) = run(&mut command);
    assert_eq!(status, Some(0), "{stderr}");
    let answer = answer(&stdout);
    assert!(answer["stored"].is_string() && stderr.contains("read back"), "{stderr}");
    let text = fs::read_to_string(&config).expect("the configuration");
    assert!(text.starts_with("# mine\n[motion]\nspeed_mm_s = 150.0\n"), "{text}");
    let stored: etherpen::config::Config = toml::from_str(&text).expect("a configuration");
    for (axis, angle) in stored.axes.iter().zip(angles(&answer)) {
        assert_eq!(axis.sync_angle_rad, angle);
        assert_ne!(axis.sync_increments, 0);
    }
}

#[test]
fn identify_measures_every_axis_and_stores_what_it_tried() {
    let folder = Folder::new();
    let mine = "# mine\n[motion]\norientation = \"constant\"\n";
    let config = folder.file("robot.toml", mine);
    let mut command = etherpen(&folder);
    command
        .args(["identify", "--simulate", "--store", "--json", "--config"])
        .arg(&config);
    let (status, stdout, stderr) = run(&mut command);
    assert_eq!(status, Some(0), "{stderr}");
    let answer = answer(&stdout);
    let axes = answer["axes"].as_array().expect("axes");
    let text = fs::read_to_string(&config).expect("the configuration");
    assert!(text.starts_with(mine), "{text}");
    let stored: etherpen::config::Config = toml::from_str(&text).expect("a configuration");
    assert_eq!(axes.len(), stored.axes.len());
    for (number, (axis, stored)) in (1..).zip(axes.iter().zip(&stored.axes)) {
        let after = |value: &str| axis[value]["after"].as_f64().expect("a value");
        assert_eq!(after("feed_forward_lead_ms"), stored.feed_forward_lead_ms);
        assert_eq!(after("feed_forward_gain"), stored.feed_forward_gain);
        assert!(axis["measured"].is_object(), "axis {number}: {stderr}");
        assert!(stderr.contains(&format!("axis {number}: lead")), "{stderr}");
        assert!((stored.feed_forward_gain - 1.0).abs() < 0.01, "axis {number}: {stderr}");
    }
}

#[test]
fn a_person_who_watches_one_axis_after_the_other_finds_exchanged_and_reversed_ones() {
    let folder = Folder::new();
    for (machine, said, code, advice) in [
        (
            "irb340",
            "\ny\n\n3\n",
            0,
            "axis 4 turns the tool in its place and was not tried",
        ),
        ("gantry", "\nmaybe\n2\n1\ny\n", 1, "axes 1 and 2 are exchanged"),
        ("corexy", "\ny\nr\n", 1, "axis 2 goes the other way"),
        ("scara", "\ny\ny\n", 130, "ended without an answer"),
        ("linear-delta", "\nn\ny\n1\n", 1, "axis 1 moved instead of axis 3"),
    ] {
        let words = ["identify", "--axes", "--simulate", "--json", "--machine", machine];
        let (status, stdout, stderr) = typed(etherpen(&folder).args(words), said);
        assert_eq!(status, Some(code), "{machine}: {stderr}");
        assert!(stderr.contains(advice), "{machine}: {stderr}");
        if code == 130 {
            continue;
        }
        let answer = answer(&stdout);
        assert_eq!(answer["confirmed"], code == 0, "{machine}: {answer}");
        for axis in answer["axes"].as_array().expect("axes") {
            let [by, measured] = ["by", "measured"].map(|value| axis[value].as_f64().expect("a number"));
            assert!((measured / by.abs() - 1.0).abs() < 0.03, "{machine}: {axis}");
        }
    }
    let (status, _, stderr) = typed(
        etherpen(&folder).args(["identify", "--axes", "--simulate", "--axis", "4"]),
        "y\n",
    );
    assert_eq!(status, Some(2), "{stderr}");
    let stored = ["identify", "--axes", "--simulate", "--store"];
    assert_eq!(typed(etherpen(&folder).args(stored), "").0, Some(2));
}

/// Runs a program to which this is typed.
fn typed(command: &mut Command, said: &str) -> (Option<i32>, String, String) {
    let streams = command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut program = streams.spawn().expect("the program starts");
    let mut input = program.stdin.take().expect("an input");
    // A program that needs no answer ends before it has read one.
    let _ = input.write_all(said.as_bytes());
    drop(input);
    let output = program.wait_with_output().expect("the program ends");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}
