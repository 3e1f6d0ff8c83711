//! Output of the program about itself: its configuration, completions and manual pages.

use crate::program::{Folder, PATIENCE, etherpen, run};
use crate::segment::Segment;
use etherpen::robot_bus::RobotBusSetup;
use etherpen_segment::transport::{self, Endpoint};
use host_tools::error::code;
use host_tools::master::Master;
use host_tools::settings::reading;
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

#[test]
fn a_new_configuration_passes_the_check_and_is_not_overwritten() {
    let folder = Folder::new();
    let new = [
        "config", "new", "--kind", "gantry", "--width", "900", "--depth", "600", "--pitch", "60",
    ];
    let (status, _, stderr) = run(etherpen(&folder).args(new));
    assert_eq!(status, Some(0), "{stderr}");
    let (status, stdout, stderr) = run(etherpen(&folder).args(["config", "check", "--json"]));
    assert_eq!(status, Some(0), "{stderr}");
    let checked: serde_json::Value = serde_json::from_str(&stdout).expect("JSON");
    assert_eq!(
        (&checked["valid"], &checked["findings"]),
        (&true.into(), &serde_json::json!([]))
    );
    let (status, _, stderr) = run(etherpen(&folder).args(new));
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(
        stderr.contains("etherpen.toml exists") && stderr.contains("--force"),
        "{stderr}"
    );
    assert_eq!(run(etherpen(&folder).args(new).arg("--force")).0, Some(0));
    // Nobody is there to be asked.
    let (status, _, stderr) = run(etherpen(&folder).args(["config", "new", "other.toml"]));
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(stderr.contains("--kind") && stderr.contains("linear-delta"), "{stderr}");
}

#[test]
fn a_new_configuration_has_the_drives_of_the_bus_and_brings_them_up() {
    let folder = Folder::new();
    let socket = folder.join("bus");
    let slaves = "ek1100,el1008,ax2000@serial=4,cia402@serial=8,cia402@serial=5";
    let start = |slaves: &str| {
        Segment::start(
            etherpen(&folder)
                .args(["segment", "--slaves", slaves, "--unix"])
                .arg(&socket),
        )
    };
    let new = ["config", "new", "--kind", "gantry", "--force", "--unix", "bus"];
    let (status, _, stderr) = run(etherpen(&folder).args(new));
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(stderr.contains("add --scan"), "{stderr}");

    let segment = start(slaves);
    let (status, _, stderr) = run(etherpen(&folder).args(new).arg("--scan"));
    assert_eq!(status, Some(0), "{stderr}");
    let scan = ["bus", "scan", "--unix", "bus", "--json"];
    let (status, stdout, stderr) = run(etherpen(&folder).args(scan));
    assert_eq!(status, Some(0), "{stderr}");
    let scan: serde_json::Value = serde_json::from_str(&stdout).expect("JSON");
    let text = fs::read_to_string(folder.join("etherpen.toml")).expect("a file");
    let config = reading::configuration(&text).expect("a configuration");
    for (axis, slave) in config.axes.iter().zip(2..5) {
        let slave = &scan["slaves"][slave];
        assert_eq!(
            (&slave["vendor"], &slave["product"]),
            (&axis.vendor.into(), &axis.product.into())
        );
        assert_eq!(slave["al_state"], "INIT", "as it was: {slave}");
    }
    assert_eq!([0, 1, 2].map(|axis| config.axes[axis].serial), [0, 8, 5]);
    let setup = RobotBusSetup {
        watchdog_ms: 1_000,
        ..config.bus_setup()
    };
    let transport = transport::open(&Endpoint::Unix(socket.clone())).expect("the segment listens");
    let master = Master::start(transport, setup, PATIENCE).expect("the drives of the file are there");
    assert!(master.counters().frames_sent > 0);
    drop(master);
    segment.end();

    let segment = start("ek1100,el1008");
    let (status, _, stderr) = run(etherpen(&folder).args(new).arg("--scan"));
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(stderr.contains("no drive was found"), "{stderr}");
    segment.end();
    let kept = fs::read_to_string(folder.join("etherpen.toml")).expect("a file");
    assert_eq!(kept, text, "a scan that fails leaves the file");
}

#[test]
fn a_wrong_configuration_is_told_with_file_line_and_remedy() {
    let folder = Folder::new();
    folder.file(
        "my.toml",
        "[geometry]\nkind = \"corexy\"\n[[axes]]\npitch_mm = 40.0\n[[axes]]\n",
    );
    let (status, stdout, _) = run(etherpen(&folder).args(["config", "check", "my.toml"]));
    assert_eq!(status, Some(i32::from(code::USAGE)));
    let first = stdout.lines().next().unwrap_or_default();
    assert!(
        first.starts_with("error: my.toml: line 5: axis 2 is linear: pitch_mm"),
        "{stdout}"
    );
    let (status, _, stderr) = run(etherpen(&folder).args(["simulate", "none.svg", "--config", "my.toml"]));
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(stderr.contains("my.toml") && stderr.contains("line 5"), "{stderr}");
    let (status, _, stderr) = run(etherpen(&folder).args(["config", "check"]));
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(stderr.contains("etherpen config new"), "{stderr}");
}

#[test]
fn kinematics_of_a_bundled_machine_are_in_millimetres_where_its_axes_are_linear() {
    let folder = Folder::new();
    let words = [
        "kinematics",
        "inverse",
        "--machine",
        "gantry",
        "--position",
        "320,240,-30",
        "--json",
    ];
    let (status, stdout, stderr) = run(etherpen(&folder).args(words));
    assert_eq!(status, Some(0), "{stderr}");
    let answer: serde_json::Value = serde_json::from_str(&stdout).expect("JSON");
    let joints: Vec<f64> = serde_json::from_value(answer["joints_mm"].clone()).expect("three lengths");
    assert!(
        joints
            .iter()
            .zip([320.0, 240.0, -30.0])
            .all(|(joint, mm)| (joint - mm).abs() < 1.0e-9)
    );
}
