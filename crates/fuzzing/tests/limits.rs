//! Files of 10 MiB that demand much are read or refused within 1 GiB of memory and, in a release build, within 10 s of
//! processor time.
//!
//! Each file is read by a process of its own whose limits the operating system enforces, so a busy computer fails nothing.

use etherpen_fuzzing::hostile::{FILE_BYTES, Hostile, files};
use etherpen_fuzzing::limits::{MEMORY_BYTES, SECONDS};
use std::path::PathBuf;
use std::process::Command;

/// How much slower a build for tests may be.
const SLOWER: u64 = if cfg!(debug_assertions) { 12 } else { 1 };

/// A folder that is removed in the end.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        // A folder that cannot be removed is left to the system.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Reads a file in a process with limits; returns what is wrong with that.
fn excess(file: &Hostile, folder: &Folder) -> Option<String> {
    let content = (file.make)();
    assert!(
        content.len() <= FILE_BYTES + 1_000,
        "{}: {} bytes",
        file.name,
        content.len()
    );
    let path = folder.0.join(file.name);
    std::fs::write(&path, content).expect("room for a file");
    let limits = [MEMORY_BYTES >> 20, SECONDS * SLOWER].map(|limit| limit.to_string());
    let mut reading = Command::new(env!("CARGO_BIN_EXE_etherpen-fuzzing"));
    let output = reading
        .arg("read")
        .args(limits)
        .arg(&path)
        .output()
        .expect("the reader");
    std::fs::remove_file(&path).expect("the file is there");
    let told = String::from_utf8_lossy(&output.stdout);
    println!("{}: {}", file.name, told.lines().next().unwrap_or("no answer"));
    let failed = || {
        let last = String::from_utf8_lossy(&output.stderr)
            .chars()
            .take(400)
            .collect::<String>();
        format!("{}: {}: {last}", file.name, output.status)
    };
    (!output.status.success()).then(failed)
}

/// Every so many files are read in an ordinary test run; another number than that of the kinds of files, so that all
/// kinds occur.
const PART: usize = 13;

/// Reads files, two at a time: one is made while another one is read.
fn read(chosen: &[&Hostile]) {
    let folder = Folder(std::env::temp_dir().join(format!("etherpen-limits-{}-{}", std::process::id(), chosen.len())));
    std::fs::create_dir_all(&folder.0).expect("a folder");
    let (first, second) = chosen.split_at(chosen.len() / 2);
    let read = |files: &[&Hostile]| {
        files
            .iter()
            .filter_map(|file| excess(file, &folder))
            .collect::<Vec<_>>()
    };
    let exceeding = std::thread::scope(|scope| {
        let second = scope.spawn(|| read(second));
        let mut exceeding = read(first);
        exceeding.extend(second.join().expect("the reader of the other half"));
        exceeding
    });
    assert!(exceeding.is_empty(), "{}", exceeding.join("\n"));
}

#[test]
fn a_part_of_the_files_of_10_mib_is_read_or_refused_within_the_limits() {
    let files = files();
    let chosen: Vec<&Hostile> = files.iter().step_by(PART).collect();
    assert!(chosen.len() >= 8, "{}", chosen.len());
    read(&chosen);
}

#[test]
#[ignore = "takes two minutes"]
fn every_file_of_10_mib_is_read_or_refused_within_the_limits() {
    let word = std::env::var("ETHERPEN_HOSTILE").unwrap_or_default();
    let files = files();
    let chosen: Vec<&Hostile> = files.iter().filter(|file| file.name.contains(&word)).collect();
    read(&chosen);
}
