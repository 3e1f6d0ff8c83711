//! A drawing whose pen was not where the path wanted it: it does not count as drawn, and goes on from the log with the
//! options of then. The truth is the ink.

use crate::program::{Folder, etherpen, run};
use etherpen::config::Config;
use host_tools::cell::{CellOptions, InkStroke};
use host_tools::commands::code;
use host_tools::console::virtual_cell::{Firmware, VirtualCell};
use std::fmt::Write;

/// Farthest that a point of ink may lie from the other run's ink, mm.
const SAME_MM: f64 = 0.1;
/// Drives that follow so badly leave their line by more than this, mm.
const BESIDE_MM: f64 = 1.0;

type Point = [f64; 2];

fn cell() -> VirtualCell {
    VirtualCell::start(&Config::default(), CellOptions::default(), Firmware::Simulated).expect("the cell starts")
}

/// Zigzags of which each is a stroke.
fn svg() -> String {
    let mut text =
        "<svg xmlns='http://www.w3.org/2000/svg' width='120mm' height='80mm' viewBox='0 0 120 80'>".to_owned();
    for row in 0..4 {
        let points = (0..=12).map(|step| format!("{},{}", 10 * step, 20 * row + 8 * (step % 2) + 4));
        let points: Vec<String> = points.collect();
        write!(
            text,
            "<polyline fill='none' stroke='black' points='{}'/>",
            points.join(" ")
        )
        .expect("memory");
    }
    text + "</svg>"
}

/// Controllers that let the arms lag and see nothing wrong in it.
fn weak() -> Config {
    let mut config = Config::default();
    for axis in &mut config.axes {
        axis.feed_forward_gain = 0.0;
        axis.feedback_gain_per_s = 12.0;
        axis.following_error_max_rad = 1.0;
        axis.feedback_deviation_max_rad = 0.1;
    }
    config
}

fn toml(config: &Config) -> String {
    toml::to_string(config).expect("a configuration")
}

fn distance_mm(point: &Point, pair: &[Point]) -> f64 {
    let along = [pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]];
    let from = [point[0] - pair[0][0], point[1] - pair[0][1]];
    let squared = along[0].powi(2) + along[1].powi(2);
    let share = match squared > 0.0 {
        true => ((from[0] * along[0] + from[1] * along[1]) / squared).clamp(0.0, 1.0),
        false => 0.0,
    };
    (from[0] - share * along[0]).hypot(from[1] - share * along[1])
}

/// The farthest point of one run's ink from the other's, mm.
fn farthest_mm(of: &[InkStroke], from: &[InkStroke]) -> f64 {
    let pairs = || from.iter().flat_map(|stroke| stroke.points_mm.windows(2));
    let points = of.iter().flat_map(|stroke| &stroke.points_mm);
    let nearest = |point: &Point| {
        pairs()
            .map(|pair| distance_mm(point, pair))
            .fold(f64::INFINITY, f64::min)
    };
    points.map(nearest).fold(0.0, f64::max)
}

#[test]
fn a_drawing_that_was_not_followed_ends_with_code_8_and_goes_on_by_the_jobs_name_alone() {
    let folder = Folder::new();
    let file = folder.file("zigzags.svg", svg()).to_string_lossy().into_owned();
    let weak = folder.file("weak.toml", toml(&weak())).to_string_lossy().into_owned();
    let draw = |cell: &VirtualCell, words: &[&str]| {
        let mut command = etherpen(&folder);
        command
            .arg("draw")
            .args(words)
            .env("ETHERPEN_PORT", cell.port().to_string());
        run(&mut command)
    };
    let options = ["--size", "70mm", "--rotate", "90", "--origin", "30,20"];
    let whole = cell();
    let (status, _, stderr) = draw(&whole, &[&[file.as_str()], &options[..]].concat());
    assert_eq!(status, Some(0), "{stderr}");
    let whole = whole.ink();

    let cell = cell();
    let words = [&[file.as_str(), "--config", &weak], &options[..]].concat();
    let (status, _, stderr) = draw(&cell, &words);
    println!("{stderr}");
    let beside_mm = farthest_mm(&whole, &cell.ink());
    assert!(beside_mm > BESIDE_MM, "the drives followed too well: {beside_mm} mm");
    assert_eq!(status, Some(i32::from(code::INCOMPLETE)), "{stderr}");
    let (_, jobs, _) = run(etherpen(&folder).args(["jobs", "--json"]));
    let jobs: serde_json::Value = serde_json::from_str(&jobs).expect("JSON");
    let job = jobs[1]["job"].as_str().expect("a name");
    assert_eq!(jobs[1]["completed"], false, "{jobs}");

    // The options are the job's: given once more without the file they are a mistake, which is told.
    let (status, _, stderr) = draw(&cell, &["--resume", job, "--rotate", "90"]);
    assert_eq!(status, Some(i32::from(code::USAGE)), "{stderr}");
    assert!(stderr.contains("leave them out"), "{stderr}");
    // The better configuration costs the reference; somebody measures where the platform stands.
    let (status, _, stderr) = draw(&cell, &["--resume", job]);
    assert_eq!(status, Some(i32::from(code::FAILED)), "{stderr}");
    assert!(stderr.contains("another configuration"), "{stderr}");
    assert!(stderr.contains("etherpen reference"), "{stderr}");
    let platform = cell.view().state().platform.expect("the arms hold a platform");
    let position = format!("{:.0},{:.0},{:.0}", platform.x_mm, platform.y_mm, platform.z_mm);
    let port = cell.port().to_string();
    let (status, _, stderr) = run(etherpen(&folder).args(["reference", "--position", &position, "--port", &port]));
    assert_eq!(status, Some(0), "{stderr}");
    let (status, _, stderr) = draw(&cell, &["--resume", job]);
    println!("{stderr}");
    assert_eq!(status, Some(0), "{stderr}");
    let missing_mm = farthest_mm(&whole, &cell.ink());
    assert!(
        missing_mm <= SAME_MM,
        "ink is missing {missing_mm} mm away from any other"
    );
}
