//! `etherpen flash` and `etherpen doctor` without a board: a small program stands in for probe-rs.

use crate::program::{Folder, etherpen, run};
use crate::{NOBODY, other_version};
use etherpen::messages::PROTOCOL_VERSION;
use host_tools::error::code;
use std::fs;
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Start of the chip's flash memory, and an address in it that is Thumb code.
const FLASH: u32 = 0x0800_0000;
const ENTRY: u32 = FLASH + 0x11;
/// End of the tightly coupled data memory.
const STACK: u32 = 0x2002_0000;
const EM_ARM: u16 = 40;
const EM_X86_64: u16 = 62;

/// An ELF file with one section, the vector table, at an address.
fn image(machine: u16, address: u32, vectors: [u32; 2]) -> Vec<u8> {
    const HEADER: u32 = 52;
    const PROGRAM: u32 = 32;
    const SECTION: u32 = 40;
    const NAMES: &[u8] = b"\0.vector_table\0.shstrtab\0";
    let mut code: Vec<u8> = vectors.iter().flat_map(|word| word.to_le_bytes()).collect();
    code.resize(0x20, 0);
    let code_at = HEADER + PROGRAM;
    let names_at = code_at + code.len() as u32;
    let sections_at = (names_at + NAMES.len() as u32).next_multiple_of(4);
    let mut file = b"\x7fELF\x01\x01\x01\0\0\0\0\0\0\0\0\0".to_vec();
    let halves = |file: &mut Vec<u8>, values: &[u16]| file.extend(values.iter().flat_map(|half| half.to_le_bytes()));
    let words = |file: &mut Vec<u8>, values: &[u32]| file.extend(values.iter().flat_map(|word| word.to_le_bytes()));
    halves(&mut file, &[2, machine]);
    words(&mut file, &[1, vectors[1], HEADER, sections_at, 0x0500_0400]);
    halves(&mut file, &[HEADER as u16, PROGRAM as u16, 1, SECTION as u16, 3, 2]);
    let size = code.len() as u32;
    words(&mut file, &[1, code_at, address, address, size, size, 5, 4]);
    file.extend(code);
    file.extend(NAMES);
    file.resize(sections_at as usize, 0);
    words(&mut file, &[0; 10]);
    words(&mut file, &[1, 1, 2, address, code_at, size, 0, 0, 4, 0]);
    words(&mut file, &[15, 3, 0, 0, names_at, NAMES.len() as u32, 0, 0, 1, 0]);
    file
}

fn good_image(folder: &Folder) -> PathBuf {
    folder.file("nucleo", image(EM_ARM, FLASH, [STACK, ENTRY]))
}

/// A program with this name that records its arguments and then runs `body`.
fn stand_in(folder: &Folder, bin: &Path, name: &str, body: &str) {
    let calls = folder.join("calls");
    let text = format!("#!/bin/sh\necho {name} \"$@\" >> '{}'\n{body}\n", calls.display());
    let path = bin.join(name);
    fs::write(&path, text).expect("a program");
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).expect("it may be started");
}

fn calls(folder: &Folder) -> String {
    fs::read_to_string(folder.join("calls")).unwrap_or_default()
}

/// A folder with a stand-in for probe-rs, and the program started with no other such tool on its path.
fn with_probe_rs(folder: &Folder, body: &str, words: &[&str]) -> Command {
    let bin = folder.join("bin");
    fs::create_dir_all(&bin).expect("a folder for programs");
    if !body.is_empty() {
        stand_in(folder, &bin, "probe-rs", body);
    }
    let mut command = etherpen(folder);
    command
        .args(words)
        .env("PATH", format!("{}:/usr/bin:/bin", bin.display()))
        .env("CARGO_HOME", folder.join("cargo"));
    command
}

#[test]
fn an_image_is_written_verified_and_started() {
    let folder = Folder::new();
    let image = good_image(&folder);
    let mut command = with_probe_rs(
        &folder,
        "echo written",
        &["flash", "--json", "--probe", "0483:374e:1", "--image"],
    );
    let (status, stdout, stderr) = run(command.arg(&image));
    assert_eq!(status, Some(0), "{stderr}");
    let answer: serde_json::Value = serde_json::from_str(&stdout).expect("one JSON document and nothing else");
    assert_eq!(answer["verified"], true);
    assert_eq!(answer["connect_under_reset"], false);
    assert_eq!(answer["flash_bytes"], 0x20);
    let selected = "--chip STM32H743ZITx --probe 0483:374e:1";
    let expected = format!(
        "probe-rs download {selected} --verify {}\nprobe-rs reset {selected}\n",
        image.display()
    );
    assert_eq!(calls(&folder), expected);
}

#[test]
fn a_chip_that_is_not_reached_is_held_in_reset_once() {
    let folder = Folder::new();
    let image = good_image(&folder);
    let body = "case \"$*\" in *--connect-under-reset*) ;; *) echo 'target did not respond' >&2; exit 1;; esac";
    let (status, _, stderr) = run(with_probe_rs(&folder, body, &["flash", "--image"]).arg(&image));
    assert_eq!(status, Some(0), "{stderr}");
    let seen = calls(&folder);
    assert_eq!(seen.lines().count(), 3, "{seen}");
    assert_eq!(seen.matches("--connect-under-reset").count(), 2, "{seen}");

    let folder = Folder::new();
    let image = good_image(&folder);
    let body = "echo 'target did not respond' >&2; exit 1";
    let (status, stdout, stderr) = run(with_probe_rs(&folder, body, &["flash", "--image"]).arg(&image));
    assert_eq!(status, Some(i32::from(code::FAILED)), "{stderr}");
    assert!(
        stderr.contains("target did not respond") && stderr.contains("supply and jumpers"),
        "{stderr}"
    );
    assert!(stdout.is_empty());
    assert_eq!(calls(&folder).lines().count(), 2, "retried once");
}

#[test]
fn a_probe_that_may_not_be_opened_is_answered_with_the_rule_for_udev() {
    let folder = Folder::new();
    let image = good_image(&folder);
    let body = "echo 'Failed to open probe: Permission denied (os error 13)' >&2; exit 1";
    let (status, _, stderr) = run(with_probe_rs(&folder, body, &["flash", "--image"]).arg(&image));
    assert_eq!(status, Some(i32::from(code::CONNECTION)), "{stderr}");
    for part in ["70-st-link.rules", "idVendor", "0483", "udevadm control --reload"] {
        assert!(stderr.contains(part), "{stderr}");
    }
    assert_eq!(
        calls(&folder).lines().count(),
        1,
        "a right is not gained by trying again"
    );
}

#[test]
fn a_missing_probe_is_told_from_a_missing_program() {
    let folder = Folder::new();
    let image = good_image(&folder);
    let body = "echo 'Error: No connected probes were found.' >&2; exit 1";
    let (status, _, stderr) = run(with_probe_rs(&folder, body, &["flash", "--image"]).arg(&image));
    assert_eq!(status, Some(i32::from(code::CONNECTION)), "{stderr}");

    let folder = Folder::new();
    let image = good_image(&folder);
    let (status, _, stderr) = run(with_probe_rs(&folder, "", &["flash", "--image"]).arg(&image));
    assert_eq!(status, Some(i32::from(code::TOOL)), "{stderr}");
    assert!(
        stderr.contains("cargo install probe-rs-tools --locked") && stderr.contains("--install"),
        "{stderr}"
    );
}

#[test]
fn probe_rs_is_installed_when_that_is_asked_for() {
    let folder = Folder::new();
    let image = good_image(&folder);
    let installed = folder.join("cargo").join("bin");
    fs::create_dir_all(&installed).expect("a folder for programs");
    let mut command = with_probe_rs(&folder, "", &["flash", "--install", "--image"]);
    let target = installed.join("probe-rs");
    let body = format!("printf '#!/bin/sh\\n' > '{0}' && chmod +x '{0}'", target.display());
    stand_in(&folder, &folder.join("bin"), "cargo", &body);
    command.env("CARGO", folder.join("bin").join("cargo"));
    let (status, _, stderr) = run(command.arg(&image));
    assert_eq!(status, Some(0), "{stderr}");
    assert_eq!(calls(&folder), "cargo install probe-rs-tools --locked\n");
}

#[test]
fn an_image_for_another_board_or_processor_is_never_written() {
    let cases = [
        (image(EM_ARM, 0, [STACK, 0x11]), "another board"),
        (image(EM_X86_64, FLASH, [STACK, ENTRY]), "another processor"),
        (image(EM_ARM, FLASH, [0x6000_0000, ENTRY]), "stack"),
        (image(EM_ARM, FLASH, [STACK, ENTRY + 1]), "Thumb"),
        (image(EM_ARM, FLASH, [STACK, 0x0900_0001]), "Thumb"),
        (b"\x7fELF".to_vec(), "not a firmware image"),
    ];
    for (bytes, hint) in cases {
        let folder = Folder::new();
        let file = folder.file("firmware", bytes);
        let (status, stdout, stderr) = run(with_probe_rs(&folder, "true", &["flash", "--image"]).arg(&file));
        assert_eq!(status, Some(i32::from(code::INPUT)), "{stderr}");
        assert!(stderr.contains(hint) && stdout.is_empty(), "{hint}: {stderr}");
        assert_eq!(calls(&folder), "");
    }
}

/// The checks by name: verdict, what was found, what to try.
fn diagnose(command: &mut Command) -> (Option<i32>, Vec<[String; 4]>, String) {
    let (status, stdout, stderr) = run(command);
    let answer: serde_json::Value = serde_json::from_str(&stdout).expect("a JSON array and nothing else");
    let checks =
        answer.as_array().expect("an array").iter().map(|check| {
            ["check", "verdict", "found", "try"].map(|key| check[key].as_str().expect("a text").to_owned())
        });
    (status, checks.collect(), stderr)
}

fn named<'a>(checks: &'a [[String; 4]], name: &str) -> &'a [String; 4] {
    checks
        .iter()
        .find(|check| check[0] == name)
        .expect("a check of this name")
}

#[test]
fn doctor_names_every_check_and_what_to_try_where_one_is_not_well() {
    let folder = Folder::new();
    let mut command = with_probe_rs(&folder, "echo probe-rs 9.9.9", &["doctor", "--json"]);
    let (_, checks, _) = diagnose(&mut command);
    let names: Vec<&str> = checks.iter().map(|check| check[0].as_str()).collect();
    for name in [
        "rust",
        "emulator",
        "probe-rs",
        "debug probe",
        "raw sockets",
        "namespaces",
        "configuration",
        "port",
    ] {
        assert!(names.contains(&name), "{names:?}");
    }
    for check in &checks {
        let well = check[1] == "ok";
        assert!(["ok", "warning", "failed"].contains(&check[1].as_str()));
        assert_eq!(well, check[3].is_empty(), "{check:?}");
    }
    assert!(named(&checks, "probe-rs")[2].contains("9.9.9"));
    assert!(named(&checks, "configuration")[2].contains("built-in"));
}

#[test]
fn doctor_fails_on_what_does_not_work_and_only_warns_of_what_is_missing() {
    let folder = Folder::new();
    let nowhere = folder.join("nowhere");
    let mut command = with_probe_rs(&folder, "", &["doctor", "--json"]);
    let (status, checks, _) = diagnose(command.env("PATH", &nowhere));
    assert_eq!(status, Some(i32::from(code::FAILED)));
    assert_eq!(named(&checks, "rust")[1], "failed");
    assert!(named(&checks, "emulator")[3].contains("apt-get install"));
    assert_eq!(named(&checks, "probe-rs")[1], "warning");
    assert!(named(&checks, "probe-rs")[3].contains("cargo install probe-rs-tools --locked"));

    folder.file("etherpen.toml", "[motion]\nspeed_mm_s = 20000.0\n");
    let mut command = with_probe_rs(&folder, "exit 1", &["doctor", "--json", "--port", NOBODY]);
    let (status, checks, stderr) = diagnose(&mut command);
    assert_eq!(status, Some(i32::from(code::FAILED)), "{stderr}");
    assert!(stderr.contains("checks failed"), "{stderr}");
    assert_eq!(named(&checks, "probe-rs")[1], "failed");
    assert!(named(&checks, "configuration")[2].contains("20000"));
    let port = named(&checks, "port");
    assert!(port[1] == "failed" && port[3].contains("etherpen emulate"), "{port:?}");

    let mut command = etherpen(&folder);
    let (status, _, _) = run(command.args(["doctor", "--port", "tcp:7000"]));
    assert_eq!(status, Some(i32::from(code::USAGE)));
}

#[test]
fn doctor_names_both_versions_when_the_firmware_is_older_and_what_brings_them_together() {
    let folder = Folder::new();
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = format!("tcp:{}", listener.local_addr().expect("an address"));
    let older = PROTOCOL_VERSION - 1;
    let firmware = std::thread::spawn(move || other_version(&listener, older));
    let mut command = with_probe_rs(&folder, "true", &["doctor", "--json", "--port", &port]);
    let (status, checks, _) = diagnose(&mut command);
    firmware.join().expect("the firmware ends with the connection");
    assert_eq!(status, Some(i32::from(code::FAILED)));
    assert_eq!(named(&checks, "port")[1], "ok");
    let [_, verdict, found, remedy] = named(&checks, "firmware");
    assert_eq!(verdict, "failed");
    for version in [PROTOCOL_VERSION, older] {
        assert!(found.contains(&format!("version {version}")), "{found}");
    }
    assert!(remedy.contains("etherpen flash"), "{remedy}");
}
