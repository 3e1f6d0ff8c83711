//! The commands of `docs/segment.md` run as they are printed there.

use crate::program::{Folder, etherpen};
use std::fmt::Write;
use std::path::Path;
use std::process::{Command, Output};

const DOCS: &str = include_str!("../../../docs/segment.md");

/// The first fenced block of a language.
fn block(language: &str) -> &'static str {
    let (_, rest) = DOCS.split_once(&format!("```{language}\n")).expect("a block");
    rest.split_once("```").expect("its end").0
}

/// Runs a script with the program on its path; a command that fails ends it.
fn run_script(folder: &Folder, script: &str) -> (bool, String) {
    let program = etherpen(folder);
    let programs = Path::new(program.get_program()).parent().expect("a folder").to_owned();
    let path = std::env::var("PATH").unwrap_or_default();
    let mut command = Command::new("bash");
    command
        .args([
            "-e",
            "-c",
            &format!("trap 'kill $(jobs -p) 2>/dev/null || true' EXIT\n{script}"),
        ])
        .current_dir(program.get_current_dir().expect("the test's folder"))
        .env("PATH", format!("{}:{path}", programs.display()));
    let Output { status, stdout, stderr } = command.output().expect("bash");
    let text = [stdout, stderr]
        .map(|bytes| String::from_utf8_lossy(&bytes).into_owned())
        .concat();
    (status.success(), text)
}

#[test]
fn the_first_run_works_as_it_is_printed() {
    let folder = Folder::new();
    let (success, text) = run_script(&folder, block("sh"));
    assert!(success, "{text}");
    for part in [
        "EL1008",
        "the cable to slave 4 is pulled",
        "1000 bytes written to slave 4",
        "\"value\": 1",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(text.contains("1000  01"), "the input in the terminal's memory: {text}");
}

/// The scripts of the steps of the example, without building and uploading.
fn steps() -> String {
    let mut script = String::from("sudo() { \"$@\"; }\n");
    let mut inside = false;
    for line in block("yaml").lines() {
        match line.strip_prefix("          ") {
            Some(command) if inside => writeln!(script, "{command}").expect("a string"),
            _ => inside = line.trim_end().ends_with("run: |"),
        }
    }
    script
}

#[test]
fn the_example_for_continuous_integration_works_in_namespaces() {
    let has_tool = Command::new("ip").arg("-V").output().is_ok();
    if !rustix::process::geteuid().is_root() || !has_tool {
        println!("SKIPPED the example of docs/segment.md: it takes root and iproute2");
        return;
    }
    let mine = |name: &str| format!("{name}-{}", std::process::id());
    let script = ["bus-slaves", "bus-master"]
        .into_iter()
        .fold(steps(), |script, name| script.replace(name, &mine(name)));
    if !Command::new("ip")
        .args(["netns", "add", &mine("try")])
        .status()
        .is_ok_and(|status| status.success())
    {
        println!("SKIPPED the example of docs/segment.md: no network namespaces here");
        return;
    }
    let removed = Command::new("ip").args(["netns", "delete", &mine("try")]).status();
    assert!(removed.is_ok_and(|status| status.success()));
    let folder = Folder::new();
    let (success, text) = run_script(&folder, &script);
    for name in ["bus-slaves", "bus-master"] {
        // Gone already if the script ran to its end.
        let _ = Command::new("ip").args(["netns", "delete", &mine(name)]).output();
    }
    assert!(success && text.contains("EL2004") && text.contains("OP"), "{text}");
    let capture = std::fs::metadata(folder.join("bus.pcapng")).expect("a capture");
    assert!(capture.len() > 10_000, "{} bytes", capture.len());
}
