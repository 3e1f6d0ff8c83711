//! Output of the program about itself: its configuration, completions and manual pages.

use crate::program::{Folder, etherpen, run};
use host_tools::error::code;
use std::fs;

#[test]
fn every_value_in_force_is_shown_with_its_origin() {
    let folder = Folder::new();
    let file = folder.file("robot.toml", "[motion]\nspeed_mm_s = 123.0\n");
    let shown = |command: &mut std::process::Command| {
        let (status, stdout, stderr) = run(command.args(["config", "show", "--origin", "--json"]));
        assert_eq!(status, Some(0), "{stderr}");
        serde_json::from_str::<serde_json::Value>(&stdout).expect("JSON")
    };
    let values = shown(
        etherpen(&folder)
            .env("ETHERPEN_CONFIG", &file)
            .env("ETHERPEN_PORT", "tcp:1.2.3.4:5"),
    );
    assert_eq!(values["motion.speed_mm_s"]["value"], 123.0);
    let origin = |key: &str| values[key]["origin"].as_str().unwrap_or_default().to_owned();
    assert!(origin("motion.speed_mm_s").contains("robot.toml (environment ETHERPEN_CONFIG)"));
    assert_eq!(origin("motion.travel_speed_mm_s"), "built-in");
    assert_eq!(origin("port"), "environment ETHERPEN_PORT");
    folder.file("etherpen.toml", "[motion]\nspeed_mm_s = 77.0\n");
    let values = shown(&mut etherpen(&folder));
    assert_eq!(values["motion.speed_mm_s"]["value"], 77.0);
}

#[test]
fn shells_and_manuals_get_every_command() {
    let folder = Folder::new();
    let (status, script, _) = run(etherpen(&folder).args(["completions", "bash"]));
    assert_eq!(status, Some(0));
    let (status, _, stderr) = run(etherpen(&folder).args(["man", "pages"]));
    assert_eq!(status, Some(0), "{stderr}");
    for command in ["draw", "status", "override", "config", "jobs"] {
        assert!(script.contains(command), "{command}");
        let page = fs::read_to_string(folder.join("pages").join(format!("etherpen-{command}.1"))).expect("a page");
        assert!(page.contains(".TH") && page.contains("Exit codes"), "{command}");
    }
    for words in [
        &["--help"][..],
        &["order", "--help"],
        &["segment", "--help"],
        &["bus", "sdo", "read", "-h"],
    ] {
        let (status, help, _) = run(etherpen(&folder).args(words));
        assert_eq!(status, Some(0), "{words:?}");
        assert!(help.contains("7 the machine stopped with a fault"), "{words:?}: {help}");
    }
}

#[test]
fn orders_without_a_machine_or_with_nonsense_are_told() {
    let folder = Folder::new();
    let port = ["--port", "tcp:127.0.0.1:1"];
    for words in [
        &["status"][..],
        &["stop"],
        &["hold"],
        &["move", "0,0,-800"],
        &["override", "50"],
    ] {
        let (status, _, stderr) = run(etherpen(&folder).args(words).args(port));
        assert_eq!(status, Some(i32::from(code::CONNECTION)), "{words:?}: {stderr}");
        assert!(stderr.contains("nothing listens there"), "{words:?}: {stderr}");
    }
    for words in [
        &["override", "5"][..],
        &["move", "0,0"],
        &["jog", "nan,0,0"],
        &["pen", "sideways"],
        &["status"],
    ] {
        let (status, ..) = run(etherpen(&folder).args(words));
        assert_eq!(status, Some(i32::from(code::USAGE)), "{words:?}");
    }
    let (status, _, stderr) = run(etherpen(&folder).args(["status", "--port", "127.0.0.1:5000"]));
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(stderr.contains("tcp:127.0.0.1:5000"), "{stderr}");
}
