//! The format of the figures, checked with those that need no build.

use crate::program::{Folder, etherpen, run};
use host_tools::error::code;
use serde_json::Value;

#[test]
fn figures_come_as_rows_with_case_subject_value_unit_and_target() {
    let folder = Folder::new();
    let figure = ["--case", "bringup_frames", "--subject", "etherpen"];
    let (status, stdout, stderr) = run(etherpen(&folder).args(["bench", "ethercat", "--json"]).args(figure));
    assert_eq!(status, Some(0), "{stderr}");
    let checked = run(etherpen(&folder).args(["bench", "ethercat", "--check"]).args(figure));
    assert_eq!(checked.0, Some(0), "{}", checked.2);
    let report: Value = serde_json::from_str(&stdout).expect("JSON on stdout");
    assert_eq!(report["bench"], "ethercat");
    let rows = report["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 1);
    assert_eq!(rows[0]["case"], "bringup_frames");
    assert_eq!(rows[0]["subject"], "etherpen");
    assert_eq!(rows[0]["unit"], "frames");
    assert_eq!(rows[0]["target"], 400.0);
    let frames = rows[0]["value"].as_f64().expect("a number");
    assert!(
        (4.0..=400.0).contains(&frames),
        "{frames} acyclic frames until four drives with clocks are in OP"
    );
}

#[test]
fn the_planners_durations_stand_beside_those_of_its_peers() {
    let folder = Folder::new();
    let (status, stdout, stderr) = run(etherpen(&folder).args([
        "bench",
        "motion",
        "--quick",
        "--json",
        "--subject",
        "etherpen",
        "--case",
        "square",
    ]));
    assert_eq!(status, Some(0), "{stderr}");
    let report: Value = serde_json::from_str(&stdout).expect("JSON on stdout");
    assert_eq!(report["bench"], "motion");
    let rows = report["rows"].as_array().expect("rows");
    let value = |case: &str| {
        let row = rows.iter().find(|row| row["case"] == case);
        row.and_then(|row| row["value"].as_f64()).expect(case)
    };
    assert!((value("duration_s/square") - 0.302).abs() < 0.004);
    assert!(value("peer_ratio/square") < 1.0);
    assert!(value("peak_ratio/square") <= 1.001);
}

#[test]
fn a_case_that_does_not_exist_is_wrong_usage() {
    let folder = Folder::new();
    let (status, stdout, _) = run(etherpen(&folder).args(["bench", "ethercat", "--case", "nothing"]));
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(stdout.is_empty());
}

#[test]
fn a_disturbance_that_does_not_exist_is_wrong_usage_and_named() {
    let folder = Folder::new();
    let (status, stdout, stderr) = run(etherpen(&folder).args(["bench", "latency", "--disturbance", "serial,rain"]));
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(stdout.is_empty() && stderr.contains("`rain`"), "{stderr}");
}
