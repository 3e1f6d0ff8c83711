//! A drawing whose pen left its path: it does not count as drawn, and is resumed from the log with its original
//! options. The ink is the reference.

use crate::program::{Folder, Running, etherpen, run};
use etherpen::config::Config;
use host_tools::cell::{CellOptions, InkStroke};
use host_tools::console::virtual_cell::{Firmware, VirtualCell};
use host_tools::error::code;
use host_tools::link::port::PortName;
use rustix::process::Signal;
use std::fmt::Write as _;
use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;

/// Largest distance of a point of ink from the other run's ink, mm.
const SAME_MM: f64 = 0.1;
/// Drives that follow this badly leave their line by more than this, mm.
const BESIDE_MM: f64 = 1.0;

fn cell() -> VirtualCell {
    VirtualCell::start(&Config::default(), CellOptions::default(), Firmware::Simulated).expect("the cell starts")
}

/// Zigzags, each of them one stroke.
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

/// Controllers that let the joints lag without detecting a fault.
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

/// The farthest point of one run's ink from the other's, mm.
fn farthest_mm(of: &[InkStroke], from: &[InkStroke]) -> f64 {
    let points = of.iter().flat_map(|stroke| &stroke.points_mm);
    let nearest = |point| {
        let lines = from.iter().map(|stroke| stroke.distance_mm(point));
        lines.fold(f64::INFINITY, f64::min)
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

    // The options come from the job: repeating them without the file is an error.
    let (status, _, stderr) = draw(&cell, &["--resume", job, "--rotate", "90"]);
    assert_eq!(status, Some(i32::from(code::USAGE)), "{stderr}");
    assert!(stderr.contains("leave them out"), "{stderr}");
    // The better configuration loses the reference; a person measures the position of the platform.
    let (status, _, stderr) = draw(&cell, &["--resume", job]);
    assert_eq!(status, Some(i32::from(code::FAILED)), "{stderr}");
    assert!(stderr.contains("another configuration"), "{stderr}");
    assert!(stderr.contains("etherpen reference"), "{stderr}");
    let platform = cell.view().state().platform.expect("the robot holds a platform");
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

/// Share of bytes on their way to the host that are damaged, per million.
const DAMAGED_PER_MILLION: u32 = 1_500;

/// Copies bytes until the line ends; returns the number of damaged ones.
fn pass_on(mut from: UnixStream, mut to: UnixStream, damaged_per_million: u32) -> u32 {
    let (mut buffer, mut state, mut damaged) = ([0; 4096], 0x9E37_79B9_u32, 0);
    while let Ok(count @ 1..) = from.read(&mut buffer) {
        for byte in &mut buffer[..count] {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            if state % 1_000_000 < damaged_per_million {
                *byte ^= 0x20;
                damaged += 1;
            }
        }
        if to.write_all(&buffer[..count]).is_err() {
            break;
        }
    }
    // The other direction ends with this one; a line that is already down needs nothing more.
    let _ = from.shutdown(std::net::Shutdown::Both);
    let _ = to.shutdown(std::net::Shutdown::Both);
    damaged
}

/// A line to the cell that damages the firmware's bytes, for one connection; returns the number of damaged ones.
fn bad_line(socket: &Path, cell: &VirtualCell) -> std::thread::JoinHandle<u32> {
    let listener = UnixListener::bind(socket).expect("a socket");
    let PortName::Unix(firmware) = cell.port() else {
        panic!("the cell has a socket")
    };
    std::thread::spawn(move || {
        let (host, _) = listener.accept().expect("a connection");
        let firmware = UnixStream::connect(firmware).expect("the cell listens");
        let (to_firmware, from_host) = (firmware.try_clone().unwrap(), host.try_clone().unwrap());
        std::thread::spawn(move || pass_on(from_host, to_firmware, 0));
        pass_on(firmware, host, DAMAGED_PER_MILLION)
    })
}

#[test]
fn a_drawing_over_a_line_that_loses_telemetry_is_whole_and_says_how_much_was_not_seen() {
    let folder = Folder::new();
    let file = folder.file("zigzags.svg", svg()).to_string_lossy().into_owned();
    let undisturbed = cell();
    let port = undisturbed.port().to_string();
    let (status, _, stderr) = run(etherpen(&folder).args(["draw", &file, "--port", &port]));
    assert_eq!(status, Some(0), "{stderr}");

    let cell = cell();
    let socket = folder.join("line");
    let line = bad_line(&socket, &cell);
    let port = format!("unix:{}", socket.display());
    let (status, report, stderr) = run(etherpen(&folder).args(["draw", &file, "--json", "--port", &port]));
    println!("{stderr}");
    assert_eq!(status, Some(0), "{stderr}");
    let damaged = line.join().expect("the line");
    let report: serde_json::Value = serde_json::from_str(&report).expect("JSON");
    let length = |name: &str| report[name].as_f64().expect("a number");
    let unseen_mm = length("not_verified_mm");
    let share = unseen_mm / (unseen_mm + length("followed_mm"));
    println!("{damaged} bytes damaged, {unseen_mm:.1} mm not seen, {share:.3} of the drawing");
    assert!(damaged > 20 && share > 0.01 && share < 0.95, "{damaged} bytes, {share}");
    assert!(length("not_followed_mm") == 0.0, "{report}");
    let missing_mm = farthest_mm(&undisturbed.ink(), &cell.ink());
    assert!(
        missing_mm <= SAME_MM,
        "ink is missing {missing_mm} mm away from any other"
    );
}

/// The latest drawing in the log.
fn last_job(folder: &Folder) -> serde_json::Value {
    let (_, jobs, _) = run(etherpen(folder).args(["jobs", "--json"]));
    let jobs: serde_json::Value = serde_json::from_str(&jobs).expect("JSON");
    jobs.as_array().and_then(|jobs| jobs.last()).expect("a job").clone()
}

/// Whether the log knows that the first stroke was not followed, and that the drives have gone beyond the second.
fn is_recorded(job: &serde_json::Value) -> bool {
    job["missing_from"] == 0 && job["executed"].as_u64().is_some_and(|executed| executed > 26)
}

#[test]
fn a_drawing_that_is_cancelled_or_killed_behind_a_stroke_that_was_not_followed_begins_with_that_stroke_again() {
    let folder = Folder::new();
    let file = folder.file("zigzags.svg", svg()).to_string_lossy().into_owned();
    let whole = cell();
    let port = whole.port().to_string();
    let options = ["--size", "70mm", "--rotate", "90", "--origin", "30,20"];
    let (status, _, stderr) = run(etherpen(&folder).args(["draw", &file, "--port", &port]).args(options));
    assert_eq!(status, Some(0), "{stderr}");
    let whole = whole.ink();

    let weak = folder.file("weak.toml", toml(&weak())).to_string_lossy().into_owned();
    for (signal, has_result) in [(Signal::INT, true), (Signal::KILL, false)] {
        let cell = cell();
        let port = cell.port().to_string();
        let mut command = etherpen(&folder);
        command
            .args(["draw", &file, "--config", &weak, "--port", &port])
            .args(options);
        let mut program = Running::start(&mut command);
        program.wait_for("fourth stroke", |_| (cell.ink().len() >= 4).then_some(()));
        if !has_result {
            // What is killed writes no more: what it has seen of the first stroke has to be compared and written down.
            program.wait_for("record", |_| is_recorded(&last_job(&folder)).then_some(()));
        }
        program.signal(signal);
        if has_result {
            // Ctrl-C holds the drawing, a second one ends it.
            std::thread::sleep(std::time::Duration::from_millis(300));
            program.signal(signal);
        }
        let status = program.end();
        assert!(!status.success(), "{}", program.stderr());
        let job = last_job(&folder);
        assert_eq!(
            (&job["completed"], job["result"].is_null()),
            (&false.into(), !has_result)
        );
        // The drives lag so much that not even the first stroke is followed; they have gone on all the same.
        assert!(is_recorded(&job), "{job}");

        let name = job["job"].as_str().expect("a name");
        let resume = |what: &[&str]| run(etherpen(&folder).args(what).args(["--port", &port]));
        if !has_result {
            // The firmware holds what it has; going on there would leave the stroke out.
            let (status, _, stderr) = resume(&["draw", "--resume", name, "--config", &weak]);
            assert_eq!(status, Some(i32::from(code::FAILED)), "{stderr}");
            assert!(stderr.contains("stroke 1 of this drawing was not followed"), "{stderr}");
            for command in ["cancel", "disable"] {
                let (status, _, stderr) = resume(&[command]);
                assert_eq!(status, Some(0), "{stderr}");
            }
        }
        // The better configuration loses the reference; a person measures the position of the platform. It begins anew.
        let (status, _, stderr) = resume(&["draw", "--resume", name]);
        assert_eq!(status, Some(i32::from(code::FAILED)), "{stderr}");
        let platform = cell.view().state().platform.expect("the robot holds a platform");
        let position = format!("{:.0},{:.0},{:.0}", platform.x_mm, platform.y_mm, platform.z_mm);
        let (status, _, stderr) = resume(&["reference", "--position", &position]);
        assert_eq!(status, Some(0), "{stderr}");
        let (status, _, stderr) = resume(&["draw", "--resume", name]);
        println!("{stderr}");
        assert_eq!(status, Some(0), "{stderr}");
        let missing_mm = farthest_mm(&whole, &cell.ink());
        assert!(
            missing_mm <= SAME_MM,
            "ink is missing {missing_mm} mm away from any other"
        );
    }
}
