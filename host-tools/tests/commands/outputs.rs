//! A command writes its output completely or not at all, and never over a file that it reads.

use crate::program::{Folder, etherpen, run, strokes};
use host_tools::error::code;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const LINES: &str = "<svg xmlns='http://www.w3.org/2000/svg' width='60mm' height='60mm' viewBox='0 0 60 60'>\
    <path d='M5 5H40' stroke='red'/><path d='M5 20H40' stroke='red'/><path d='M5 10H40' stroke='blue'/></svg>";

/// Names of a folder's files, including hidden ones.
fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("a folder").flatten();
    let mut names: Vec<String> = entries
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// A small photograph: a dark square on white.
fn photograph(folder: &Folder) -> PathBuf {
    let path = folder.join("photo.png");
    let dark = |x: u32, y: u32| (16..48).contains(&x) && (16..48).contains(&y);
    let picture = image::GrayImage::from_fn(64, 64, |x, y| image::Luma([if dark(x, y) { 0 } else { 255 }]));
    picture.save(&path).expect("a picture");
    path
}

/// A recording of the short drawing's first second.
fn recording(folder: &Folder) -> PathBuf {
    let path = folder.join("run.mcap");
    let mut command = etherpen(folder);
    command
        .args(["record", "--duration", "1", "--simulate"])
        .arg(strokes())
        .arg("-o")
        .arg(&path);
    let (status, _, stderr) = run(&mut command);
    assert_eq!(status, Some(0), "{stderr}");
    path
}

#[test]
fn no_command_overwrites_a_file_that_it_reads_under_any_of_its_names() {
    let folder = Folder::new();
    let svg = folder.file("lines.svg", LINES);
    let (photo, recorded) = (photograph(&folder), recording(&folder));
    let table = folder.join("strokes.csv");
    fs::copy(strokes(), &table).expect("the sample");
    let config = folder.file("robot.toml", "[motion]\nspeed_mm_s = 123.0\n");
    let faults = folder.file("faults.txt", "");
    let cases: [(&Path, &[&str], &[&str]); 12] = [
        (&svg, &["preview", "lines.svg", "-o"], &[]),
        (&svg, &["order", "lines.svg", "-o"], &[]),
        (&config, &["order", "lines.svg", "--config", "robot.toml", "-o"], &[]),
        (&photo, &["vectorize", "photo.png", "-o"], &[]),
        (&photo, &["preview", "photo.png", "-o"], &[]),
        (&table, &["plan", "strokes.csv", "--samples"], &[]),
        (&recorded, &["export", "run.mcap", "--csv"], &[]),
        (&recorded, &["export", "run.mcap", "--parquet"], &[]),
        (&recorded, &["plot", "run.mcap", "--signals", "mode", "-o"], &[]),
        (&table, &["record", "--simulate", "strokes.csv", "-o"], &[]),
        (
            &faults,
            &["segment", "--unix", "segment.sock", "--faults", "faults.txt", "--pcap"],
            &[],
        ),
        (
            &config,
            &["record", "--simulate", "strokes.csv", "--config", "robot.toml", "-o"],
            &[],
        ),
    ];
    for (input, words, more) in cases {
        let before = fs::read(input).expect("the input");
        // The extension of a plot selects its format.
        let end = if words[0] == "plot" || words[0] == "preview" {
            "svg"
        } else {
            "dat"
        };
        let (hard, soft) = (folder.join(&format!("hard.{end}")), folder.join(&format!("soft.{end}")));
        fs::hard_link(input, &hard).expect("a hard link");
        std::os::unix::fs::symlink(input, &soft).expect("a symbolic link");
        let own = (input
            .extension()
            .is_some_and(|extension| extension == end || end == "dat"))
        .then_some(input);
        for output in own.into_iter().chain([hard.as_path(), soft.as_path()]) {
            let (status, _, stderr) = run(etherpen(&folder).args(words).arg(output).args(more));
            assert_eq!(
                status,
                Some(i32::from(code::USAGE)),
                "{words:?} {}: {stderr}",
                output.display()
            );
            assert!(stderr.contains("is the input file"), "{words:?}: {stderr}");
            assert_eq!(fs::read(input).expect("the input"), before, "{words:?}");
        }
        fs::remove_file(hard).expect("the link");
        fs::remove_file(soft).expect("the link");
    }
    // A folder of results in which one is the input.
    fs::create_dir(folder.join("out")).expect("a folder");
    fs::write(folder.join("out/drawn.svg"), LINES).expect("a file");
    for words in [
        &["simulate"][..],
        &["draw", "--port", "tcp:127.0.0.1:1"],
        &["demo", "--photo"],
    ] {
        let (status, _, stderr) = run(etherpen(&folder).args(words).args(["out/drawn.svg", "--out", "out"]));
        assert_eq!(status, Some(i32::from(code::USAGE)), "{words:?}: {stderr}");
        assert_eq!(
            fs::read_to_string(folder.join("out/drawn.svg")).expect("the input"),
            LINES
        );
    }
    // Standard input is the output file.
    let input = fs::File::open(&svg).expect("the input");
    let (status, _, stderr) = run(etherpen(&folder).args(["order", "-", "-o", "lines.svg"]).stdin(input));
    assert_eq!(status, Some(i32::from(code::USAGE)), "{stderr}");
}

/// The program with a limit on the size of its files, in the shell's blocks. Without `killed`, a write beyond the limit
/// fails as on a full disk; with it, the kernel ends the program there.
fn limited(folder: &Folder, blocks: u32, killed: bool, words: &[&str]) -> Command {
    let program = etherpen(folder);
    let trap = if killed { "" } else { "trap '' XFSZ; " };
    let script = format!("{trap}ulimit -c 0; ulimit -f {blocks}; exec \"$@\"");
    let mut command = Command::new("/bin/sh");
    command
        .args(["-c", &script, "sh"])
        .arg(program.get_program())
        .args(words);
    command.current_dir(folder.join("."));
    for (name, value) in program.get_envs() {
        match value {
            Some(value) => command.env(name, value),
            None => command.env_remove(name),
        };
    }
    command
}

/// Runs a command with more and more space, with and without an earlier good run, until it succeeds. Its outputs are
/// always the last good ones or the new ones.
fn survives(folder: &Folder, words: &[&str], outputs: &[&str], steps: &[u32]) {
    let (status, _, stderr) = run(etherpen(folder).args(words));
    assert_eq!(status, Some(0), "{words:?}: {stderr}");
    let paths: Vec<PathBuf> = outputs.iter().map(|name| folder.join(name)).collect();
    let whole: Vec<Vec<u8>> = paths.iter().map(|path| fs::read(path).expect("an output")).collect();
    let clean = names(paths[0].parent().expect("a folder"));
    for path in &paths {
        fs::write(path, "the last good output").expect("an output");
    }
    for killed in [true, false] {
        let mut failures = 0;
        for blocks in steps {
            let (status, _, stderr) = run(&mut limited(folder, *blocks, killed, words));
            if status == Some(0) {
                break;
            }
            failures += 1;
            assert_eq!(status.is_none(), killed, "{words:?}, {blocks} blocks: {stderr}");
            for (path, whole) in paths.iter().zip(&whole) {
                let content = fs::read(path).expect("an output");
                let is_good = content == b"the last good output" || content == *whole;
                assert!(
                    is_good,
                    "{words:?}, {blocks} blocks: {} of {} bytes",
                    path.display(),
                    content.len()
                );
            }
            if !killed {
                assert!(
                    stderr.contains("cannot be written") || stderr.contains("could not be written"),
                    "{stderr}"
                );
                assert_eq!(
                    names(paths[0].parent().expect("a folder")),
                    clean,
                    "{words:?}: nothing is left behind"
                );
            }
        }
        assert!(failures > 0, "{words:?}: no write failed");
        // Files left by killed programs are removed.
        let (status, _, stderr) = run(etherpen(folder).args(words));
        assert_eq!(status, Some(0), "{words:?}: {stderr}");
        assert_eq!(names(paths[0].parent().expect("a folder")), clean, "{words:?}");
        println!(
            "{}: {failures} runs ended by {}",
            words[0],
            if killed { "a kill" } else { "a full disk" }
        );
        for path in &paths {
            fs::write(path, "the last good output").expect("an output");
        }
    }
}

#[test]
fn a_full_disk_and_a_kill_at_a_write_leave_the_last_good_output() {
    let folder = Folder::new();
    folder.file("lines.svg", LINES);
    photograph(&folder);
    recording(&folder);
    let input = strokes().to_string_lossy().into_owned();
    fs::create_dir(folder.join("to")).expect("a folder");
    let steps = [0, 1, 2, 3, 5, 8, 20, 100, 1_000];
    survives(
        &folder,
        &["order", "lines.svg", "-o", "to/ordered.svg"],
        &["to/ordered.svg"],
        &steps,
    );
    survives(
        &folder,
        &["preview", "lines.svg", "-o", "to/shown.svg"],
        &["to/shown.svg"],
        &steps,
    );
    survives(
        &folder,
        &["preview", "lines.svg", "-o", "to/shown.png"],
        &["to/shown.png"],
        &steps,
    );
    survives(
        &folder,
        &["vectorize", "photo.png", "-o", "to/lines.svg"],
        &["to/lines.svg"],
        &steps,
    );
    survives(
        &folder,
        &["export", "run.mcap", "--csv", "to/run.csv"],
        &["to/run.csv"],
        &steps,
    );
    survives(
        &folder,
        &["export", "run.mcap", "--parquet", "to/run.parquet"],
        &["to/run.parquet"],
        &steps,
    );
    let plot = ["plot", "run.mcap", "--signals", "q1_rad", "-o", "to/run.png"];
    survives(&folder, &plot, &["to/run.png"], &steps);
    let plan = ["plan", &input, "--samples", "to/plan.csv"];
    survives(&folder, &plan, &["to/plan.csv"], &[0, 1, 100, 1_000, 10_000]);
    let man = ["man", "pages"];
    survives(
        &folder,
        &man,
        &["pages/etherpen.1", "pages/etherpen-draw.1"],
        &[0, 1, 2, 1_000],
    );
}

/// The program in a namespace in which the folder `to` cannot be written.
fn read_only(folder: &Folder, words: &[&str]) -> Command {
    let program = etherpen(folder);
    let script = "mount --bind to to && mount -o remount,ro,bind to && exec \"$@\"";
    let mut command = Command::new("unshare");
    command.args(["-rm", "/bin/sh", "-c", script, "sh"]);
    command.arg(program.get_program()).args(words);
    command.current_dir(folder.join("."));
    command
}

#[test]
fn a_read_only_disk_is_told_and_what_was_good_stays_good() {
    let folder = Folder::new();
    folder.file("lines.svg", LINES);
    photograph(&folder);
    recording(&folder);
    fs::create_dir(folder.join("to")).expect("a folder");
    let input = strokes().to_string_lossy().into_owned();
    let mut probe = read_only(&folder, &[]);
    if !probe.args(["--version"]).status().is_ok_and(|status| status.success()) {
        println!("left out: this computer gives a user no namespace with mounts of its own");
        return;
    }
    let commands: [(&str, &[&str]); 8] = [
        ("ordered.svg", &["order", "lines.svg", "-o", "to/ordered.svg"]),
        ("shown.png", &["preview", "lines.svg", "-o", "to/shown.png"]),
        ("lines.svg", &["vectorize", "photo.png", "-o", "to/lines.svg"]),
        ("run.csv", &["export", "run.mcap", "--csv", "to/run.csv"]),
        ("run.parquet", &["export", "run.mcap", "--parquet", "to/run.parquet"]),
        ("plan.csv", &["plan", &input, "--samples", "to/plan.csv"]),
        (
            "run.mcap",
            &["record", "--duration", "1", "--simulate", &input, "-o", "to/run.mcap"],
        ),
        ("report.json", &["simulate", &input, "--out", "to"]),
    ];
    for (output, words) in commands {
        for there in [false, true] {
            let path = folder.join("to").join(output);
            if there {
                fs::write(&path, "the last good output").expect("an output");
            }
            let before = names(&folder.join("to"));
            let (status, _, stderr) = run(&mut read_only(&folder, words));
            assert!(
                status.is_some_and(|status| status > 0 && status < 100),
                "{words:?}: {status:?} {stderr}"
            );
            assert!(stderr.contains("Read-only file system"), "{words:?}: {stderr}");
            assert!(
                stderr.contains("to/") || stderr.contains(" to"),
                "{words:?} names what cannot be written: {stderr}"
            );
            assert_eq!(names(&folder.join("to")), before, "{words:?}");
            if there {
                assert_eq!(
                    fs::read(&path).expect("an output"),
                    b"the last good output",
                    "{words:?}"
                );
            }
        }
    }
}

#[test]
fn a_folder_of_results_stays_that_of_the_last_run_when_the_disk_is_full() {
    let folder = Folder::new();
    let input = strokes().to_string_lossy().into_owned();
    let outputs = [
        "intended.csv",
        "telemetry.csv",
        "telemetry.mcap",
        "report.json",
        "bus.pcapng",
        "drawn.svg",
    ];
    let paths: Vec<PathBuf> = outputs.iter().map(|name| folder.join("out").join(name)).collect();
    fs::create_dir(folder.join("out")).expect("a folder");
    let good = || {
        let read = |path: &PathBuf| fs::read(path).expect("a result");
        paths.iter().map(read).all(|content| content == b"the last good output")
    };
    for path in &paths {
        fs::write(path, "the last good output").expect("a result");
    }
    let words = ["simulate", &input, "--out", "out"];
    // The capture of the bus is the longest result.
    for (blocks, killed) in [(20, true), (20, false), (2_000, true), (2_000, false)] {
        let (status, _, stderr) = run(&mut limited(&folder, blocks, killed, &words));
        assert_eq!(status.is_none(), killed, "{blocks} blocks: {stderr}");
        assert!(good(), "{blocks} blocks: {stderr}");
    }
    let (status, _, stderr) = run(etherpen(&folder).args(words));
    assert_eq!(status, Some(0), "{stderr}");
    let whole = names(&folder.join("out"));
    assert!(whole.iter().all(|name| !name.starts_with('.')), "{whole:?}");
    assert!(
        paths
            .iter()
            .all(|path| fs::metadata(path).is_ok_and(|file| file.len() > 100))
    );
}

#[test]
fn a_reader_that_has_ended_ends_a_command_quietly_and_a_full_disk_is_an_error() {
    let folder = Folder::new();
    for words in [
        &["config", "show"][..],
        &["config", "show", "--json"],
        &["completions", "bash"],
        &["doctor"],
    ] {
        let (open, _, _) = run(etherpen(&folder).args(words));
        let (reader, writer) = std::io::pipe().expect("a pipe");
        drop(reader);
        let output = etherpen(&folder)
            .args(words)
            .stdout(writer)
            .stderr(Stdio::piped())
            .spawn();
        let output = output
            .and_then(std::process::Child::wait_with_output)
            .expect("the program starts");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), open, "{words:?}: {stderr}");
        assert!(
            !stderr.contains("panicked") && !stderr.contains("stdout"),
            "{words:?}: {stderr}"
        );
        let full = fs::OpenOptions::new()
            .write(true)
            .open("/dev/full")
            .expect("a full device");
        let output = etherpen(&folder)
            .args(words)
            .stdout(full)
            .stderr(Stdio::piped())
            .spawn();
        let output = output
            .and_then(std::process::Child::wait_with_output)
            .expect("the program starts");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_ne!(output.status.code(), Some(0), "{words:?}: {stderr}");
        assert!(
            !stderr.contains("panicked") && stderr.contains("stdout: "),
            "{words:?}: {stderr}"
        );
    }
}

#[test]
fn standard_output_pipes_and_devices_are_written_directly() {
    let folder = Folder::new();
    folder.file("lines.svg", LINES);
    let order = |output: &str| run(etherpen(&folder).args(["order", "lines.svg", "-o", output]));
    let (status, plain, stderr) = order("-");
    assert_eq!((status, plain.contains("<svg")), (Some(0), true), "{stderr}");
    assert_eq!(order("/dev/stdout").1, plain);
    assert_eq!(order("/dev/null").0, Some(0));
    let (status, _, stderr) = order("/dev/full");
    assert_eq!(status, Some(i32::from(code::FAILED)), "{stderr}");
    assert!(stderr.contains("/dev/full cannot be written"), "{stderr}");
    let program = env!("CARGO_BIN_EXE_etherpen");
    let shell = |script: &str| {
        let mut command = Command::new("/bin/sh");
        let status = command
            .args(["-c", script, "sh", program])
            .current_dir(folder.join("."))
            .status();
        assert!(status.expect("a shell").success(), "{script}");
    };
    shell("mkfifo pipe; cat pipe > piped & \"$1\" order lines.svg -o pipe && wait");
    shell("echo first > appended; \"$1\" order lines.svg -o /dev/stdout >> appended");
    assert_eq!(
        fs::read_to_string(folder.join("piped")).expect("what came through"),
        plain
    );
    let appended = fs::read_to_string(folder.join("appended")).expect("what was appended");
    assert_eq!(appended, format!("first\n{plain}"));
}

#[test]
fn a_layer_without_a_name_is_told_as_one_and_one_stroke_is_no_strokes() {
    let folder = Folder::new();
    let inkscape = "xmlns:inkscape='http://www.inkscape.org/namespaces/inkscape'";
    let layer = |name: &str, y: u32| {
        format!("<g inkscape:groupmode='layer' inkscape:label='{name}'><path d='M5 {y}H40' stroke='red'/></g>")
    };
    let loose = "<path d='M5 50H40' stroke='green'/>";
    let head =
        format!("<svg xmlns='http://www.w3.org/2000/svg' {inkscape} width='60mm' height='60mm' viewBox='0 0 60 60'>");
    folder.file(
        "layers.svg",
        format!("{head}{}{}{loose}</svg>", layer("red", 5), layer("blue", 20)),
    );
    let (status, _, stderr) = run(etherpen(&folder).args(["preview", "layers.svg", "-o", "out.svg"]));
    assert_eq!(status, Some(0), "{stderr}");
    assert!(
        stderr.contains("3 layers") && stderr.contains("red, blue, no name (--layer 3);"),
        "{stderr}"
    );
    let (status, _, stderr) = run(etherpen(&folder).args(["preview", "layers.svg", "--layer", "3", "-o", "out.svg"]));
    assert_eq!(status, Some(0), "{stderr}");
    assert!(stderr.contains("1 stroke, ") && stderr.contains("1 lift,"), "{stderr}");
}
