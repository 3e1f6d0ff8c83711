//! Files from other programs, and the trace of a drawing's border.

use crate::program::{Folder, Running, etherpen, run, strokes};
use etherpen::config::Config;
use host_tools::cell::CellOptions;
use host_tools::console::virtual_cell::{Firmware, VirtualCell};
use host_tools::drawing::preparation::confined;
use host_tools::error::code;
use std::fs;
use std::process::{Command, Stdio};

const HEAD: &str = "<svg xmlns='http://www.w3.org/2000/svg' width='100mm' height='100mm' viewBox='0 0 100 100'>";

#[test]
fn a_small_file_that_asks_for_terabytes_is_refused_with_its_line() {
    let folder = Folder::new();
    let text = format!("{HEAD}\n<path d='M 50 50 C 1e30 1e30 -1e30 -1e30 50 50'/></svg>");
    let file = folder.file("c.svg", text);
    let out = folder.join("out.svg");
    for command in ["preview", "order", "plan", "simulate"] {
        let mut words = etherpen(&folder);
        words.arg(command).arg(&file);
        if command == "preview" || command == "order" {
            words.arg("-o").arg(&out);
        }
        let (status, _, stderr) = run(&mut words);
        assert_eq!(status, Some(i32::from(code::INPUT)), "{command}: {stderr}");
        assert!(
            stderr.contains("c.svg: line 2: ") && stderr.contains("kilometre"),
            "{command}: {stderr}"
        );
    }
}

#[test]
fn a_file_is_prepared_in_a_process_with_limits() {
    // Those that the program itself was started with may be lower.
    for (given, seconds) in [("", "120"), ("ulimit -t 60; ", "60")] {
        assert_limited(given, seconds);
    }
}

fn assert_limited(given: &str, seconds: &str) {
    let folder = Folder::new();
    let program = etherpen(&folder).get_program().to_owned();
    let mut shell = Command::new("sh");
    let script = format!("{given}exec \"$0\" \"$1\"");
    shell.args(["-c", &script]).arg(program).arg(confined::COMMAND);
    let mut process = Running::start(shell.stdin(Stdio::piped()));
    let limits = format!("/proc/{}/limits", process.id());
    let limited = |name: &str| {
        let text = fs::read_to_string(&limits).unwrap_or_default();
        let line = text.lines().find(|line| line.starts_with(name)).map(str::to_owned);
        line.filter(|line| !line.contains("unlimited"))
    };
    let memory = process.wait_for("limit of its memory", |_| limited("Max address space"));
    let time = process.wait_for("limit of its time", |_| {
        limited("Max cpu time").filter(|_| limited("Max core file size").is_some_and(|core| core.contains(" 0 ")))
    });
    println!("{memory}\n{time}");
    assert!(
        memory.contains("4294967296")
            && time
                .split_whitespace()
                .rev()
                .skip(1)
                .take(2)
                .all(|limit| limit == seconds),
        "{memory}\n{time}"
    );
    process.press_enter();
}

#[test]
fn a_picture_comes_back_from_the_process_that_prepares_it() {
    let folder = Folder::new();
    let mut command = etherpen(&folder);
    let words = ["simulate", "--size", "30mm", "--max-time", "8s", "--json"];
    let photograph = host_tools::setup::workspace().join("samples/camera.png");
    let (status, stdout, stderr) = run(command.args(words).arg(photograph));
    assert_eq!(status, Some(0), "{stderr}");
    let report: serde_json::Value = serde_json::from_str(&stdout).expect("one JSON document");
    let figure = |key: &str| report[key].as_f64().expect(key);
    assert!(
        figure("tone_correlation") > 0.0 && figure("planned_s") <= 8.0,
        "{stdout}"
    );
    assert!(
        figure("not_followed_mm") < 1.0e-6 && figure("not_verified_mm") < 1.0e-6,
        "{stdout}"
    );
    assert!((figure("followed_mm") - figure("pen_down_mm")).abs() < 0.01, "{stdout}");
}

fn cell() -> VirtualCell {
    VirtualCell::start(&Config::default(), CellOptions::default(), Firmware::Simulated).expect("the cell starts")
}

#[test]
fn the_outline_is_gone_around_without_ink_and_the_drawing_waits_for_enter() {
    let (folder, cell) = (Folder::new(), cell());
    let mut command = etherpen(&folder);
    command
        .arg("draw")
        .arg(strokes())
        .arg("--outline")
        .env("ETHERPEN_PORT", cell.port().to_string());
    let mut draw = Running::start(command.stdin(Stdio::piped()));
    draw.wait_for("outline", |draw| {
        draw.stderr().contains("the pen went around").then_some(())
    });
    assert!(cell.ink().is_empty(), "{} lines of ink", cell.ink().len());
    draw.press_enter();
    assert!(draw.end().success(), "{}", draw.stderr());
    assert!(!cell.ink().is_empty());
}

#[test]
fn without_an_enter_the_outline_is_all() {
    let (folder, cell) = (Folder::new(), cell());
    let mut command = etherpen(&folder);
    command
        .arg("draw")
        .arg(strokes())
        .arg("--outline")
        .env("ETHERPEN_PORT", cell.port().to_string());
    let (status, _, stderr) = run(&mut command);
    assert_eq!(status, Some(i32::from(code::INTERRUPTED)), "{stderr}");
    assert!(stderr.contains("nothing was drawn"), "{stderr}");
    assert!(cell.ink().is_empty());
}
