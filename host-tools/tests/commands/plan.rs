//! Output of `plan` and `kinematics` as documented.

use crate::program::{Folder, etherpen, run};
use host_tools::error::code;
use serde_json::Value;
use std::fs;

/// The path of a sample.
fn sample(name: &str) -> std::path::PathBuf {
    host_tools::setup::workspace().join("samples/motion").join(name)
}

/// Limits of the joints alone, for which the samples' optimal durations are known.
const JOINT_LIMITS: [&str; 12] = [
    "--joint-speed",
    "25",
    "--joint-acceleration",
    "250",
    "--speed",
    "1e5",
    "--acceleration",
    "1e7",
    "--tolerance",
    "0.1",
    "--jerk-window",
    "0",
];

fn json(stdout: &str) -> Value {
    serde_json::from_str(stdout).expect("JSON on stdout")
}

#[test]
fn a_listed_path_is_planned_as_it_stands_within_its_limits() {
    let folder = Folder::new();
    for (name, optimum_s, end) in [
        ("square.csv", 0.302, [-100.0, -100.0]),
        ("circle.csv", 0.137, [50.0, 0.0]),
    ] {
        let out = folder.join("out.csv");
        let mut command = etherpen(&folder);
        command.arg("plan").arg(sample(name)).args(JOINT_LIMITS);
        let (status, stdout, stderr) = run(command.args(["--json", "--samples"]).arg(&out));
        assert_eq!(status, Some(0), "{stderr}");
        let answer = json(&stdout);
        assert_eq!(answer["violations"], Value::Array(Vec::new()), "{name}");
        assert!(
            answer["deviation_max_mm"].as_f64().is_some_and(|mm| mm <= 0.1001),
            "{name}"
        );
        assert_eq!(answer["limits"]["joint_acceleration_rad_s2"][3], 250.0);
        let duration_s = answer["duration_s"].as_f64().expect("a duration");
        assert!(
            (optimum_s - 0.002..1.03 * optimum_s).contains(&duration_s),
            "{name}: {duration_s}"
        );
        let table = fs::read_to_string(&out).expect("the table");
        let mut rows = table.lines();
        assert_eq!(
            rows.next(),
            Some("t_ms,x_mm,y_mm,z_mm,q1_rad,q2_rad,q3_rad,q4_rad,v1_rad_s,v2_rad_s,v3_rad_s,v4_rad_s,pen")
        );
        let rows: Vec<Vec<&str>> = rows.map(|row| row.split(',').collect()).collect();
        assert_eq!(rows.len() as f64, (duration_s * 1_000.0).round() + 1.0);
        let last = rows.last().expect("rows");
        for (value, expected) in last[1..3].iter().zip(end) {
            let value: f64 = value.parse().expect("a number");
            assert!((value - expected).abs() < 1.0e-6, "{name} ends at {last:?}");
        }
        assert!(
            last[4]
                .split_once('.')
                .is_some_and(|(_, decimals)| decimals.len() >= 10)
        );
    }
}

#[test]
fn axis_4_keeps_its_angle_unless_it_is_to_follow_the_path() {
    let folder = Folder::new();
    let file = folder.file(
        "turn.csv",
        "x_mm,y_mm,z_mm,pen\n0,0,-800,1\n0,50,-800,1\n-50,50,-800,1\n",
    );
    for (orientation, expected) in [
        ("constant", [0.0, 0.0]),
        ("path", [90.0_f64, 180.0].map(f64::to_radians)),
    ] {
        let out = folder.join("out.csv");
        let mut command = etherpen(&folder);
        command
            .arg("plan")
            .arg(&file)
            .args(["--orientation", orientation, "--json", "--samples"]);
        let (status, stdout, stderr) = run(command.arg(&out));
        assert_eq!(status, Some(0), "{stderr}");
        assert_eq!(json(&stdout)["violation_count"], 0, "{stdout}");
        let table = fs::read_to_string(&out).expect("the table");
        let angle = |row: &str| row.split(',').nth(7).and_then(|angle| angle.parse::<f64>().ok());
        let (first, last) = (
            table.lines().nth(1).and_then(angle),
            table.lines().last().and_then(angle),
        );
        for (angle, expected) in [first, last].into_iter().zip(expected) {
            assert!(
                angle.is_some_and(|angle| (angle - expected).abs() < 1.0e-6),
                "{orientation}: {angle:?}"
            );
        }
    }
}

#[test]
fn without_z_the_path_is_drawn_on_the_paper() {
    let folder = Folder::new();
    let file = folder.file("sheet.csv", "x_mm,y_mm,pen\n10,10,1\n60,10,1\n60,40,1\n");
    let (status, stdout, stderr) = run(etherpen(&folder).arg("plan").arg(&file).arg("--json"));
    assert_eq!(status, Some(0), "{stderr}");
    let answer = json(&stdout);
    assert_eq!(answer["violation_count"], 0);
    // The pen is lowered, draws 80 mm and is lifted.
    assert!(
        answer["length_mm"].as_f64().is_some_and(|mm| mm > 83.0 && mm < 90.0),
        "{answer}"
    );
    let (status, stdout, _) = run(etherpen(&folder).arg("plan").arg(&file));
    assert_eq!(status, Some(0));
    assert!(stdout.contains("0 violations"), "{stdout}");
}

#[test]
fn bad_paths_are_refused_with_place_and_reason() {
    let folder = Folder::new();
    let heading = "x_mm,y_mm,z_mm,pen\n";
    let refusals: [(&str, String, &[&str]); 11] = [
        ("empty", String::new(), &["empty"]),
        ("heading only", heading.into(), &["two different vertices"]),
        (
            "one vertex",
            format!("{heading}0,0,-800,1\n"),
            &["two different vertices"],
        ),
        (
            "repeated",
            format!("{heading}0,0,-800,1\n0,0,-800,1\n"),
            &["two different vertices"],
        ),
        (
            "text",
            format!("{heading}0,0,-800,1\n0,zero,-800,1\n"),
            &["line 3", "column 2"],
        ),
        (
            "NaN",
            format!("{heading}0,0,-800,1\n0,NaN,-800,1\n"),
            &["line 3", "column 2"],
        ),
        (
            "infinite",
            format!("{heading}0,0,-800,1\ninf,0,-800,1\n"),
            &["line 3", "column 1"],
        ),
        (
            "columns",
            format!("{heading}0,0,-800,1\n0,0,-800\n"),
            &["line 3", "columns"],
        ),
        ("names", "x,y,z,pen\n0,0,-800,1\n".into(), &["heading"]),
        (
            "far",
            format!("{heading}0,0,-800,1\n10,0,-800,1\n900,0,-800,1\n"),
            &["line 4", "vertex 2", "axis"],
        ),
        (
            "high",
            format!("{heading}0,0,-800,1\n0,0,-20,1\n"),
            &["line 3", "vertex 1", "height"],
        ),
    ];
    for (name, text, expected) in refusals {
        let file = folder.file("bad.csv", text);
        let (status, stdout, stderr) = run(etherpen(&folder).arg("plan").arg(&file).arg("--json"));
        assert_eq!(status, Some(i32::from(code::INPUT)), "{name}: {stderr}");
        assert!(stdout.is_empty());
        assert!(expected.iter().all(|part| stderr.contains(part)), "{name}: {stderr}");
    }
    let (status, _, _) = run(etherpen(&folder).args(["plan", "nowhere.csv"]));
    assert_eq!(status, Some(i32::from(code::INPUT)));
    for (option, value) in [
        ("--speed", "0"),
        ("--tolerance", "nan"),
        ("--joint-speed", "-1"),
        ("--jerk-window", "33"),
    ] {
        let option = format!("{option}={value}");
        let (status, _, _) = run(etherpen(&folder).arg("plan").arg(sample("square.csv")).arg(&option));
        assert_eq!(status, Some(i32::from(code::USAGE)), "{option}");
    }
}

#[test]
fn awkward_paths_are_planned_within_their_limits() {
    let folder = Folder::new();
    let mut zigzag = String::from("x_mm,y_mm,z_mm,pen\n");
    let mut dense = zigzag.clone();
    for step in 0..2_000 {
        zigzag.push_str(&format!(
            "{},{},-800,1\n",
            f64::from(step) * 0.002,
            f64::from(step % 2) * 0.002
        ));
        dense.push_str(&format!(
            "{},{},-800,1\n",
            f64::from(step) * 0.01,
            f64::from(step) * 0.0001
        ));
    }
    let back = "x_mm,y_mm,z_mm,pen\n-500,0,-850,1\n500,0,-850,1\n500,0,-850,1\n-500,0,-850,0\n";
    for (name, text, merged) in [("zigzag", zigzag.as_str(), 0), ("dense", &dense, 0), ("back", back, 1)] {
        let file = folder.file("path.csv", text);
        let (status, stdout, stderr) = run(etherpen(&folder).arg("plan").arg(&file).arg("--json"));
        assert_eq!(status, Some(0), "{name}: {stderr}");
        let answer = json(&stdout);
        assert_eq!(answer["violation_count"], 0, "{name}: {}", answer["violations"]);
        assert_eq!(answer["vertices_merged"], merged, "{name}");
    }
}

#[test]
fn negative_coordinates_are_positions_and_angles_come_in_full_precision() {
    let folder = Folder::new();
    let position = ["kinematics", "inverse", "--position", "-10,0,-800", "--json"];
    let (status, stdout, stderr) = run(etherpen(&folder).args(position));
    assert_eq!(status, Some(0), "{stderr}");
    let joints: Vec<f64> = serde_json::from_value(json(&stdout)["joints_rad"].clone()).expect("three angles");
    let [a, b, c] = joints.as_slice() else {
        panic!("{joints:?}")
    };
    let (status, stdout, _) = run(etherpen(&folder)
        .args(["kinematics", "forward", "--json", "--joints"])
        .arg(format!("{a},{b},{c}")));
    assert_eq!(status, Some(0));
    let back: Vec<f64> = serde_json::from_value(json(&stdout)["position_mm"].clone()).expect("three lengths");
    for (value, expected) in back.iter().zip([-10.0, 0.0, -800.0]) {
        assert!((value - expected).abs() < 1.0e-9, "{back:?}");
    }
    let joints = ["kinematics", "forward", "--joints", "-0.1,-0.2,0.3", "--json"];
    assert_eq!(run(etherpen(&folder).args(joints)).0, Some(0));
}

#[test]
fn kinematics_of_another_geometry_and_of_none() {
    let folder = Folder::new();
    let geometry = folder.file(
        "small.toml",
        "base_side_mm = 457.3\nplatform_side_mm = 115.0\nupper_arm_mm = 112.0\nforearm_mm = 232.0\n",
    );
    let inverse = |position: &str| {
        let mut command = etherpen(&folder);
        command.args(["kinematics", "inverse", "--position", position, "--geometry"]);
        run(command.arg(&geometry))
    };
    assert_eq!(inverse("10,-20,-200").0, Some(0));
    let (status, stdout, stderr) = inverse("0,0,-500");
    assert_eq!((status, stdout.as_str()), (Some(i32::from(code::FAILED)), ""));
    assert!(stderr.contains("arm 1"), "{stderr}");
    assert_eq!(inverse("0,nan,-200").0, Some(i32::from(code::USAGE)));
    assert_eq!(inverse("0,0").0, Some(i32::from(code::USAGE)));
    fs::write(&geometry, "[geometry]\n").expect("a file of the test");
    let (status, _, stderr) = inverse("10,-20,-200");
    assert_eq!(status, Some(i32::from(code::INPUT)));
    assert!(stderr.contains("small.toml"), "{stderr}");
}

#[test]
fn a_jerk_window_has_its_full_length_or_is_refused() {
    let folder = Folder::new();
    let plan = |options: &[&str]| {
        run(etherpen(&folder)
            .arg("plan")
            .arg(sample("square.csv"))
            .arg("--json")
            .args(options))
    };
    let (status, stdout, stderr) = plan(&["--jerk-window", "32"]);
    assert_eq!(status, Some(i32::from(code::USAGE)));
    assert!(stdout.is_empty() && stderr.contains("at most 7 ms"), "{stderr}");
    for options in [
        ["--jerk-window", "7", "--tolerance", "0.05"],
        ["--jerk-window", "32", "--tolerance", "1"],
    ] {
        let (status, stdout, stderr) = plan(&options);
        assert_eq!(status, Some(0), "{stderr}");
        let answer = json(&stdout);
        assert_eq!(answer["limits"]["jerk_window_ms"].to_string(), options[1]);
        assert_eq!(answer["violation_count"], 0, "{}", answer["violations"]);
    }
}

#[test]
fn what_an_input_shaper_cannot_keep_is_refused() {
    let folder = Folder::new();
    let usual = include_str!("../../../samples/etherpen.toml");
    let shaped = usual.replacen("input_shaper = \"none\"", "input_shaper = \"zv\"", 1);
    assert_ne!(shaped, usual);
    folder.file("zv.toml", &shaped);
    let plan = |options: &[&str]| {
        let command = [
            "plan",
            &sample("square.csv").display().to_string(),
            "--json",
            "--config",
            "zv.toml",
        ]
        .map(String::from);
        run(etherpen(&folder).args(command).args(options))
    };
    let (status, stdout, stderr) = plan(&[]);
    assert_eq!(status, Some(0), "{stderr}");
    let answer = json(&stdout);
    assert_eq!(answer["violation_count"], 0, "{}", answer["violations"]);
    // The setpoints lie farther inside than the tolerance, and the answer says how far they may.
    let (off_mm, more_mm) = (
        answer["deviation_drawn_max_mm"].as_f64(),
        answer["limits"]["shaper_deviation_mm"].as_f64(),
    );
    assert!(
        off_mm > Some(0.05) && off_mm < more_mm.map(|mm| mm + 0.05),
        "{off_mm:?}, {more_mm:?}"
    );
    for (options, why) in [
        (vec!["--tolerance", "0.01"], "no resonance below"),
        (
            vec!["--tolerance", "0.001", "--acceleration", "100000"],
            "keeps no resonance quiet",
        ),
        (vec!["--certify"], "--certify"),
    ] {
        let (status, stdout, stderr) = plan(&options);
        assert_eq!(status, Some(i32::from(code::USAGE)), "{options:?}");
        assert!(stdout.is_empty() && stderr.contains(why), "{options:?}: {stderr}");
    }
}

#[test]
fn dense_points_on_a_circle_take_the_time_of_the_circle() {
    let folder = Folder::new();
    let planned_s = |vertices: u32| {
        let mut text = String::from("x_mm,y_mm,z_mm,pen\n");
        for number in 0..=vertices {
            let angle = std::f64::consts::TAU * f64::from(number) / f64::from(vertices);
            text.push_str(&format!(
                "{:.6},{:.6},-850,1\n",
                31.83 * angle.cos(),
                31.83 * angle.sin()
            ));
        }
        let file = folder.file("circle.csv", &text);
        let (status, stdout, stderr) = run(etherpen(&folder).arg("plan").arg(&file).arg("--json"));
        assert_eq!(status, Some(0), "{stderr}");
        let answer = json(&stdout);
        assert_eq!(answer["violation_count"], 0, "{vertices}: {}", answer["violations"]);
        answer["duration_s"].as_f64().expect("a duration")
    };
    let (few_s, dense_s) = (planned_s(200), planned_s(20_000));
    assert!(dense_s < 1.1 * few_s, "{dense_s} s of {few_s} s");
}
